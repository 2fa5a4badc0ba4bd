"""Meshes that move: refit beside build, updates beside whole bakes. Processor time, interleaved in one run.

    .venv/bin/python benches/moving.py [name of a mesh]

Prints three tables in Markdown. Every ratio above 1 means that the moving mesh is faster. The bits are compared too.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import fieldbake as fb
from measuring import interleaved, timed
from meshes import find

ROUNDS = 5
RESOLUTION = 128


def seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time of all threads in one call, and the result."""
    times = timed(work)
    return times.least_cpu, times.result


def first_query(mesh: fb.Mesh) -> fb.Mesh:
    """Build what a query needs."""
    fb.signed_distance(mesh, mesh.bounds[:1])
    return mesh


def bent(vertices: np.ndarray, angle: float) -> np.ndarray:
    """Bend a mesh about its z axis, more with its height along y."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    turn = angle * ((vertices[:, 1] - low[1]) / (high[1] - low[1])) ** 2
    x, y = (vertices - low)[:, :2].T
    turned = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), vertices[:, 2] - low[2]]
    return np.stack(turned, axis=1) + low


def patch(vertices: np.ndarray, seed: int, share: float, size: float) -> np.ndarray:
    """Move the vertices next to one of them along a smooth bump."""
    center = vertices[np.random.default_rng(seed).integers(len(vertices))]
    away = np.linalg.norm(vertices - center, axis=1)
    reach = np.quantile(away, share)
    bump = np.clip(1 - (away / reach) ** 2, 0, None)[:, None]
    return vertices + bump * size * np.random.default_rng(seed + 1).normal(size=3)


def refit_table(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Build and first query beside motion and first query."""
    mesh = first_query(fb.Mesh(vertices, faces))
    print("| motion | build and first query, ms | moved and first query, ms | ratio |\n|---|---|---|---|")
    size = float(np.ptp(vertices, axis=0).max())
    for name, positions in (
        ("all vertices bend by 0.2", bent(vertices, 0.2)),
        ("5 % of the vertices", patch(vertices, 3, 0.05, 0.02 * size)),
    ):
        jobs = {
            "built": lambda p=positions: first_query(fb.Mesh(p, faces)),
            "moved": lambda p=positions: first_query(mesh.moved(p)),
        }
        built, moved = (times.least_cpu for times in interleaved(jobs, ROUNDS).values())
        print(f"| {name} | {built * 1e3:.1f} | {moved * 1e3:.1f} | {built / moved:.1f} |")


def update_table(vertices: np.ndarray, faces: np.ndarray) -> None:
    """A bake of the moved mesh beside motion and update."""
    mesh = fb.Mesh(vertices, faces)
    volume = fb.bake(mesh, RESOLUTION)
    size = float(np.ptp(vertices, axis=0).max())
    print(f"\n| moved, {RESOLUTION}^3 | bake, s | moved and update, s | ratio | changed bits |\n|---|---|---|---|---|")
    for share, places in ((0.05, 12), (0.2, 2)):
        for seed in range(places):
            positions = patch(vertices, seed, share, 0.02 * size)
            jobs = {
                "bake": lambda p=positions: fb.bake(fb.Mesh(p, faces), volume.resolution, bounds=volume.bounds),
                "update": lambda p=positions: volume.update(mesh.moved(p)),
            }
            bake, update = interleaved(jobs, ROUNDS).values()
            (baked, whole), (moved, updated) = ((times.least_cpu, times.result) for times in (bake, update))
            differ = int((whole.distances.view(np.uint32) != updated.distances.view(np.uint32)).sum())
            what = f"{share:.0%} of the vertices, at place {seed + 1}"
            print(f"| {what} | {baked:.2f} | {moved:.2f} | {baked / moved:.1f} | {differ} |")


def sequence_table(vertices: np.ndarray, faces: np.ndarray, frames: int = 10) -> None:
    """Frames of a bending mesh, where every vertex moves."""
    positions = [bent(vertices, 0.4 * np.sin(2 * np.pi * frame / frames)) for frame in range(frames)]
    print("\n| bending, 64^3 | new meshes, s a frame | bake_sequence, s a frame | ratio |\n|---|---|---|---|")
    ours, volumes = seconds(lambda: list(fb.bake_sequence([fb.Mesh(positions[0], faces), *positions[1:]], 64)))
    box, shape = volumes[0].bounds, volumes[0].resolution
    theirs, _ = seconds(lambda: [fb.bake(fb.Mesh(p, faces), shape, bounds=box) for p in positions])
    print(f"| {frames} frames | {theirs / frames:.3f} | {ours / frames:.3f} | {theirs / ours:.2f} |")


def main() -> None:
    """Measure the named mesh, or the first one that is there."""
    warnings.simplefilter("ignore", fb.SurfaceWarning)
    name, vertices, faces = next(find(sys.argv[1:] or None))
    vertices, faces = np.array(vertices, dtype=np.float64), np.asarray(faces)
    print(f"{name}: {len(faces):,} faces, {len(vertices):,} vertices\n")
    refit_table(vertices, faces)
    update_table(vertices, faces)
    sequence_table(vertices, faces)


if __name__ == "__main__":
    main()
