"""Pictures of 10, 1,000 and 100,000 quadrics: rays per second, and numbers of quadrics tested per ray.

    python benches/quadrics.py [--size 256] [--device cpu] [--repeat 3]

The time of a call contains the conversion of the list to a scene. The other time is the time of the primary pass.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from measuring import timed


def balls(count: int, random: np.random.Generator) -> list[fb.Quadric]:
    """Spheres that fill a cube, at the same density for any number."""
    radius = 0.6 / count ** (1 / 3)
    return [fb.Quadric.sphere(center, radius, opacity=0.5) for center in random.uniform(-1, 1, (count, 3))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    camera = fb.Camera.fit([(-1, -1, -1), (1, 1, 1)])
    size = (options.size, options.size)
    row = "{:>9} {:>10} {:>11} {:>10}"
    print(row.format("quadrics", "call, ms", "primary, ms", "tests/ray"))
    for count in (10, 1_000, 100_000):
        quadrics = balls(count, np.random.default_rng(2))
        drawn = timed(
            lambda quadrics=quadrics: fb.raymarch(quadrics, camera, size=size, shadows="none", device=options.device),
            options.repeat,
        )
        primary = drawn.result.report["milliseconds"]["primary"]
        tests = float(drawn.result.steps.mean())
        print(row.format(f"{count:,}", f"{drawn.least * 1e3:.0f}", f"{primary:.0f}", f"{tests:.1f}"))


if __name__ == "__main__":
    main()
