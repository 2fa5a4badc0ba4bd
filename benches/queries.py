"""Points and rays beside Open3D (Embree): processor time, interleaved in one run.

    make bench     or     .venv/bin/python benches/queries.py [mesh ...] [--count 1000000]

Prints a table of nanoseconds per item and ratios (above 1: fieldbake is faster). Times are processor time of all
threads, the smallest of several rounds, so other programs affect them little.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fieldbake as fb
from measuring import interleaved, record

ROUNDS = 3


def least(*works: Callable[[], object]) -> list[float]:
    """Least processor time of each, taken in turns."""
    return [times.least_cpu for times in interleaved(dict(enumerate(works)), ROUNDS).values()]


def one_point(work: Callable[[], object], count: int = 300) -> float:
    """Processor time of one short call."""
    return least(lambda: [work() for _ in range(count)])[0] / count


def rays_of(mesh: fb.Mesh, kind: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Make coherent rays, as of a picture of the mesh, and random rays between points of its box."""
    lower, upper = mesh.bounds
    center, size = (lower + upper) / 2, float((upper - lower).max())
    if kind == "coherent":
        side = int(np.sqrt(count))
        x, y = np.meshgrid(np.linspace(-0.6, 0.6, side), np.linspace(-0.6, 0.6, side))
        eye = center + size * np.array([0.2, 0.1, 2.0])
        targets = center + size * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
        return np.broadcast_to(eye, targets.shape).copy(), targets - eye
    random = np.random.default_rng(1)
    starts, targets = (center + size * 0.6 * random.uniform(-1, 1, (count, 3)) for _ in range(2))
    return starts, targets - starts


def ray_times(mesh: fb.Mesh, scene: Any, kind: str, count: int) -> list[float]:
    """Processor times of first hits and of occlusion by fieldbake and by Open3D."""
    origins, directions = rays_of(mesh, kind, count)
    rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
    return least(
        lambda: fb.cast_rays(mesh, origins, directions),
        lambda: fb.occluded(mesh, origins, directions),
        lambda: scene.cast_rays(rays),
        lambda: scene.test_occlusions(rays),
    )


def bench(name: str, mesh: fb.Mesh, count: int) -> None:
    """Measure one mesh: a row for each kind of query."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.faces.astype(np.uint32))
    )
    lower, upper = mesh.bounds
    center, half = (lower + upper) / 2, (upper - lower) / 2
    points = center + 1.2 * half * np.random.default_rng(2).uniform(-1, 1, (count, 3))
    single = points.astype(np.float32)
    few, few_single = points[:1000], single[:1000]
    one, one_single = points[:1], single[:1]
    rows = []

    def row(label: str, items: int, ours: float, theirs: float) -> None:
        rows.append(
            f"| {name} | {label} | {ours / items * 1e9:,.0f} | {theirs / items * 1e9:,.0f} | {theirs / ours:.2f} |"
        )
        record(f"{label}, {name}", "Embree" if "rays" in label else "Open3D", ours / items, theirs / items)

    # The trees are built first.
    fb.query(mesh, one), fb.cast_rays(mesh, one, one), scene.compute_signed_distance(one_single)
    row(
        "one point",
        1,
        one_point(lambda: fb.signed_distance(mesh, one)),
        one_point(lambda: scene.compute_signed_distance(one_single)),
    )
    row(
        "1,000 points",
        1000,
        *least(lambda: fb.signed_distance(mesh, few), lambda: scene.compute_signed_distance(few_single)),
    )
    plain, full, inside, theirs, occupancy = least(
        lambda: fb.signed_distance(mesh, points),
        lambda: fb.query(mesh, points),
        lambda: fb.contains(mesh, points),
        lambda: scene.compute_signed_distance(single),
        lambda: scene.compute_occupancy(single),
    )
    row("signed distances", count, plain, theirs)
    row("queries with gradients", count, full, theirs)
    row("contains", count, inside, occupancy)
    for kind in ("coherent", "random"):
        hits, shadow, their_hits, their_shadow = ray_times(mesh, scene, kind, count)
        row(f"{kind} rays", count, hits, their_hits)
        row(f"{kind} occlusion rays", count, shadow, their_shadow)
    samples = least(lambda: fb.sample_surface(mesh, count))[0]
    rows.append(f"| {name} | surface samples | {samples / count * 1e9:,.0f} | | |")
    print("\n".join(rows), flush=True)


def main() -> None:
    """Every mesh of the command line, or two made in code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", help="mesh files; two meshes made in code if none is given")
    parser.add_argument("--count", type=int, default=1_000_000, help="points and rays")
    arguments = parser.parse_args()
    meshes = {Path(path).stem: fb.load_mesh(path) for path in arguments.meshes} or {
        "torus knot, 46 k faces": fb.models.torus_knot(),
        "torus knot, 1 M faces": fb.models.torus_knot(segments=2600, sides=200),
    }
    print("| mesh | question | fieldbake, ns | Open3D, ns | ratio |\n|---|---|---|---|---|")
    for name, mesh in meshes.items():
        bench(name, mesh, arguments.count)


if __name__ == "__main__":
    main()
