"""Pictures of 10, 1,000 and 100,000 quadrics: rays per second, and numbers of quadrics and boxes tested per ray.

    python benches/quadrics.py [--size 256] [--device cpu] [--repeat 3]

The last two columns compare the tree with the article's loop over all rows: tries a ray, counted, and the time of the
loop, measured with up to 64 quadrics (that many are tried one by one) and scaled.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from fieldbake import _core
from fieldbake.drawing.raymarching import picture_arguments
from measuring import timed

LOOP = 64


def balls(count: int, random: np.random.Generator) -> np.ndarray:
    """Rows of spheres that fill a cube, at the same density for any number."""
    rows = np.zeros((count, 24))
    centers = random.uniform(-1, 1, (count, 3))
    radius = 0.6 / count ** (1 / 3)
    matrices = np.broadcast_to(np.diag([1.0, 1, 1, 0]), (count, 4, 4)).copy()
    matrices[:, :3, 3] = matrices[:, 3, :3] = -centers
    matrices[:, 3, 3] = np.sum(centers**2, axis=1) - radius**2
    rows[:, :16] = matrices.reshape(count, 16)
    rows[:, 16:19], rows[:, 19], rows[:, 20:23], rows[:, 23] = centers, radius, 0.8, 0.5
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    camera = fb.Camera.fit([(-1, -1, -1), (1, 1, 1)])

    def seconds(rows):
        quadrics = _core.Quadrics(rows)
        picture = picture_arguments(camera, (options.size, options.size), shadows="none")
        drawn = timed(lambda: quadrics.draw(picture, options.device), options.repeat)
        return drawn.least, float(drawn.result["steps"].mean())

    rays = options.size**2
    loop, _ = seconds(balls(LOOP, np.random.default_rng(2)))
    row = "{:>9} {:>12} {:>11} {:>14}"
    print(row.format("quadrics", "rays/s", "tries/ray", "loop/tree"))
    for count in (10, 1_000, 100_000):
        spent, tried = seconds(balls(count, np.random.default_rng(2)))
        ratio = f"{loop * count / LOOP / spent:.1f}" if count > LOOP else "-"
        print(row.format(f"{count:,}", f"{rays / spent:.3g}", f"{tried:.0f}", ratio))


if __name__ == "__main__":
    main()
