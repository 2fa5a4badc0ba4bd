"""Growth of time and memory: faces, resolution, instances, leaves, threads, and meshes that are hard for a search tree.

    python benches/curves.py [--limit 60] [--only hard]

Each point is measured in a process of its own with a time limit: the least of up to three runs, and the peak of the
memory above its level before. A curve has the exponent e of the fit "time is proportional to x^e" to its last three
points. Every hard mesh stands beside a plain one with as many faces and samples, so a quadratic case is a large ratio.
docs/benchmarks.md draws the curves from the JSON file.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import meshes
from measuring import machine, peak_mib, reset_peak, timed

HERE = Path(__file__).parent
USUAL_RESOLUTION, USUAL_FACES = 128, 100_000

#: A function that prepares the job for one value of x; only the job is measured.
Maker = Callable[[Any], Callable[[], object]]


def bake(faces: int, size: int, **options: Any) -> Callable[[], object]:
    """Build the tree of a trefoil and bake it on a grid of equal sides."""
    import fieldbake as fb

    _, vertices, indices = meshes.knot(faces)
    return lambda: fb.bake((vertices, indices), (size,) * 3, **options)


def sparse(size: int) -> Callable[[], object]:
    """Bake bricks near the surface only."""
    import fieldbake as fb

    _, vertices, indices = meshes.knot(USUAL_FACES)
    return lambda: fb.bake_sparse((vertices, indices), size)


def instances(count: int) -> Callable[[], object]:
    """Build a scene of many trees and draw it with hard shadows, 320 x 240 pixels."""
    import fieldbake as fb
    from scene import forest

    scene, camera = forest(count, np.random.default_rng(7))
    fb.render(scene, camera, size=(8, 8), device="cpu")  # bakes the tree
    return lambda: fb.render(
        fb.Scene(scene.instances, lights=scene.lights), camera, size=(320, 240), shadows="hard", device="cpu"
    )


def leaves(count: int) -> Callable[[], object]:
    """Split a shape of scattered leaves into parts."""
    import fieldbake as fb
    from csg import fresh, scattered

    shape = scattered(count)
    return lambda: fb.csg.decompose(fresh(shape))


def fan(count: int, rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Slivers around one vertex: a disc, or a cone of this height."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    around = np.arange(count)
    return np.vstack([(0, 0, rise), ring]), np.stack([0 * around, 1 + around, 1 + (around + 1) % count], axis=1)


def plane(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of 2 * side^2 faces."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-1, 1, side + 1)], indexing="ij"))
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    lower = np.stack([corner, corner + side + 1, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + side + 1, corner + side + 2], axis=1)
    return np.stack([x, y, 0 * x], axis=1), np.vstack([lower, upper])


def cylinder(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Slivers side by side, along the whole height of an open cylinder."""
    angle = np.linspace(0, 2 * np.pi, count // 2, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    a = np.arange(len(ring))
    b, up = (a + 1) % len(ring), len(ring)
    faces = np.vstack([np.stack([a, b, up + a], axis=1), np.stack([b, up + b, up + a], axis=1)])
    return np.vstack([ring, ring + np.array([0, 0, 2])]), faces


def equal(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The same triangle many times, with vertices of its own each time."""
    corners = np.tile(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0.5)], float), (count, 1))
    return corners, np.arange(3 * count).reshape(-1, 3)


UNSIGNED = {"sign": "unsigned"}
#: Time limit of a hard mesh, seconds. The plain meshes take less than a tenth of it.
HARD_LIMIT_S = 20

#: Hard meshes, and the options of their bake at 64^3.
HARD: dict[str, tuple[Callable[[], tuple[np.ndarray, np.ndarray]], dict[str, Any]]] = {
    "trefoil, 100,000 faces (plain)": (lambda: meshes.knot(100_000)[1:], {}),
    "disc, 100,000 slivers at one vertex, unsigned": (lambda: fan(100_000, 0.0), UNSIGNED),
    "cone, 100,000 slivers at one vertex, unsigned": (lambda: fan(100_000, 1.0), UNSIGNED),
    "cylinder of 100,000 slivers, unsigned": (lambda: cylinder(100_000), UNSIGNED),
    "1,000 equal triangles": (lambda: equal(1_000), {}),
    "100,000 equal triangles": (lambda: equal(100_000), {}),
    "cone, 2,000 slivers at one vertex": (lambda: fan(2_000, 1.0), {}),
    "cone, 4,000 slivers at one vertex": (lambda: fan(4_000, 1.0), {}),
    "cone, 100,000 slivers at one vertex": (lambda: fan(100_000, 1.0), {}),
    "trefoil, 100,000 faces, far from the box": (
        lambda: meshes.knot(100_000)[1:],
        {"bounds": [(1000, 1000, 1000), (1001, 1001, 1001)]},
    ),
    "trefoil, 1,000,000 faces (plain)": (lambda: meshes.knot(1_000_000)[1:], {}),
    "plane of 1,000,000 faces": (lambda: plane(707), {}),
}


def hard(name: str) -> Callable[[], object]:
    """Bake a hard mesh at 64^3, tree and signs included."""
    import fieldbake as fb

    make, options = HARD[name]
    vertices, faces = make()
    return lambda: fb.bake((vertices, faces), (64, 64, 64), **options)


#: Name of each curve: its values of x, and the job.
CURVES: dict[str, tuple[list[Any], Maker]] = {
    "faces": ([1_000, 10_000, 100_000, 1_000_000, 10_000_000], lambda x: bake(x, USUAL_RESOLUTION)),
    "resolution": ([32, 64, 128, 256, 512], lambda x: bake(USUAL_FACES, x)),
    "resolution, sparse": ([32, 64, 128, 256, 512, 1024], sparse),
    "instances": ([10, 100, 1_000, 10_000, 100_000], instances),
    "leaves": ([10, 100, 1_000, 10_000, 100_000], leaves),
    "threads": ([], lambda _: bake(USUAL_FACES, USUAL_RESOLUTION)),
    "hard": (list(HARD), hard),
}


def one(curve: str, x: Any) -> dict[str, float]:
    """Measure one point in this process: seconds, processor seconds and peak memory above the level before, MiB."""
    job = CURVES[curve][1](x)
    reset_peak()
    before = peak_mib()
    times = timed(job)
    while sum(times.wall) < 5 and len(times.wall) < 3:
        times.run(job)
    return {"seconds": times.least, "processor_seconds": times.least_cpu, "peak_mib": peak_mib() - before}


def measure(curve: str, x: Any, limit_s: float) -> dict[str, Any]:
    """Measure the same in a fresh process, whose preparation counts toward the limit too."""
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    if curve == "threads":
        environment["RAYON_NUM_THREADS"] = str(x)
    command = [sys.executable, __file__, "--one", curve, json.dumps(x)]
    point: dict[str, Any] = {"x": x}
    try:
        result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        point["end"] = f"stopped at {limit_s:.0f} s"
    else:
        if result.returncode == 0:
            point |= json.loads(result.stdout)
        else:
            point["end"] = (result.stderr.strip().splitlines() or [f"status {result.returncode}"])[-1]
    return point


def exponent(points: list[dict[str, Any]]) -> float | None:
    """Exponent of the power law through the last three points that were measured, by least squares."""
    last = [(point["x"], point["seconds"]) for point in points if "seconds" in point][-3:]
    return float(np.polyfit(*np.log(np.array(last, float)).T, 1)[0]) if len(last) >= 2 else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--only", action="append", choices=CURVES, help="a curve; all if not given, and stored")
    parser.add_argument("--limit", type=float, default=60, help="seconds for each point")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(options.one[0], json.loads(options.one[1]))))
        return

    cores = os.cpu_count() or 1
    CURVES["threads"][0][:] = sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores), cores})
    curves: dict[str, Any] = {}
    for name, (values, _) in CURVES.items():
        if options.only and name not in options.only:
            continue
        print(f"\n| {name} | seconds | processor seconds | peak, MiB |\n|---|---|---|---|", flush=True)
        points = []
        for x in values:
            points.append(point := measure(name, x, HARD_LIMIT_S if name == "hard" else options.limit))
            cells = " | ".join(
                f"{point[key]:.3g}" for key in ("seconds", "processor_seconds", "peak_mib") if key in point
            )
            print(f"| {x if isinstance(x, str) else f'{x:,}'} | {cells or point['end'] + ' | | '} |", flush=True)
        curves[name] = {"points": points}
        if name != "hard":
            curves[name]["exponent"] = exponent(points)
            print(f"\nThe exponent of the last three points is {curves[name]['exponent']:.2f}.")
    if not options.only:
        path = HERE / "results" / f"{datetime.datetime.now(tz=datetime.UTC).date()}-curves.json"
        path.write_text(json.dumps({"machine": machine(), "curves": curves}, indent=1))


if __name__ == "__main__":
    main()
