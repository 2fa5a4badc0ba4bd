"""One field for a whole scene: the article's loop against the culled merge, more instances, one that moves.

    python benches/merge.py [--resolution 128] [--instances 500] [--repeat 3]

All on the CPU. The loop is timed on a grid of a quarter of the side, 1/64 of the samples: its time is proportional to
them.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import fieldbake as fb


def scattered(count: int, random: np.random.Generator) -> list[tuple[fb.Volume, np.ndarray]]:
    """Gears and knots, turned at random, in a layer whose area grows with their number."""
    volumes = [fb.bake(fb.models.gear(teeth=8), 32), fb.bake(fb.models.torus_knot(segments=160, sides=16), 32)]
    side = 3.0 * np.sqrt(count)
    instances = []
    for i in range(count):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        transform = np.eye(4)
        transform[:3, :3] = turn
        transform[:3, 3] = random.uniform((0, 0, 0), (side, side / 4, side))
        instances.append((volumes[i % 2], transform))
    return instances


def shortest(repeat, call):
    """The result and the shortest time."""
    best = float("inf")
    for _ in range(repeat):
        start = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - start)
    return result, best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--instances", type=int, default=500)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    random = np.random.default_rng(1)
    sizes = (options.resolution,) * 3
    instances = scattered(options.instances, random)
    field, full = shortest(options.repeat, lambda: fb.merge(instances, sizes, device="cpu"))
    quarter = (options.resolution // 4,) * 3
    _, loop = shortest(1, lambda: fb.merge(instances, quarter, method="article", device="cpu"))
    loop *= np.prod(sizes) / np.prod(quarter)
    print(f"{options.instances} instances at {options.resolution}^3: {full:.3f} s; the article's loop {loop:.1f} s")
    print(f"  {loop / full:.0f} times the speed of the loop")

    twice = scattered(2 * options.instances, random)
    _, double = shortest(options.repeat, lambda: fb.merge(twice, sizes, device="cpu"))
    print(f"{2 * options.instances} instances: {double:.3f} s, {double / full:.2f} times as long")

    moved = instances[7][1].copy()
    moved[:3, 3] += 1.0
    after, update = shortest(options.repeat, lambda: field.update([(7, moved)]))
    instances[7] = (instances[7][0], moved)
    whole = fb.merge(instances, sizes, bounds=field.bounds, device="cpu")
    same = np.array_equal(after.distances, whole.distances)
    print(f"one moved: {1e3 * update:.1f} ms, {full / update:.0f} times faster than a full merge, same bits: {same}")


if __name__ == "__main__":
    main()
