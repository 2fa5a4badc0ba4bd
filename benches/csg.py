"""Drawing by parts compared with tracing the whole tree: field evaluations per pixel and time, on the same pictures.

    python benches/csg.py [--size 128] [--repeats 5] [--device cpu]

Each row is one model. The two methods are interleaved, and the best of several runs counts. "octree" is the time of the
decomposition, "auto" the method that pictures choose. "/px" counts evaluations of a primitive's field or chord by the
rays of the pixels, divided by the number of pixels.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from measuring import interleaved, timed

ARTICLE = "(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))"


def scattered_leaves(count: int) -> list[tuple[str, np.ndarray, float, np.ndarray]]:
    """Kind, axis, angle of rotation and position of leaves in a cube; the density hardly depends on the count."""
    random = np.random.default_rng(7)
    kinds = ("sphere", "box", "cylinder")
    return [
        (kinds[i % 3], random.normal(size=3), random.uniform(0, 360), random.uniform(-1, 1, 3))
        for i in range(count - 1)
    ]


def leaf_size(count: int) -> float:
    return 1.6 * count ** (-1 / 3)


def scattered(count: int) -> fb.Shape:
    """Balls and blocks united with a block, with bars subtracted."""
    size = leaf_size(count)
    makers = {
        "sphere": lambda: fb.sphere(size / 2),
        "box": lambda: fb.box((size, 0.7 * size, 0.5 * size)),
        "cylinder": lambda: fb.cylinder(0.3 * size, 1.5 * size),
    }
    added, removed = [fb.box((1.6, 1.6, 0.4))], []
    for kind, axis, degrees, place in scattered_leaves(count):
        leaf = makers[kind]().rotate(axis, degrees).translate(place)
        (removed if kind == "cylinder" else added).append(leaf)
    return fb.Shape.union(*added) - fb.Shape.union(*removed) if removed else fb.Shape.union(*added)


def fresh(shape: fb.Shape) -> fb.Shape:
    """The same shape without its cached results."""
    made = shape.translate((0, 0, 0))
    _ = made.bounds
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=128, help="pixels along a side")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--device", default="cpu", help="cpu, gpu, or the name of a device")
    options = parser.parse_args()
    size = (options.size, options.size)
    models = [("the article, 3 leaves", fb.csg.parse(ARTICLE))]
    models += [(f"scattered, {count} leaves", scattered(count)) for count in (10, 100, 1000)]
    print(
        f"{'model':26} {'octree':>10} {'parts':>6} {'boxes':>6} {'shaders':>7}"
        f" {'whole':>20} {'auto':>20} {'boxes':>6} {'ratios':>14}"
    )
    for name, shape in models:
        camera = fb.Camera.fit(shape.bounds, direction=(-0.5, -0.4, -1))
        unsplit = iter([fresh(shape) for _ in range(3)])
        decomposition = timed(lambda unsplit=unsplit: fb.csg.decompose(next(unsplit)), 3)
        split, parts = decomposition.least, decomposition.result
        times = interleaved(
            {
                method: lambda shape=shape, camera=camera, method=method: fb.raymarch(
                    shape, camera, size=size, method=method, device=options.device
                )
                for method in ("whole", "auto")
            },
            options.repeats,
        )
        whole, frame = times["whole"].result, times["auto"].result
        slow, fast = times["whole"].least, times["auto"].least
        many, few = (found.report["leaf_evaluations"] / (size[0] * size[1]) for found in (whole, frame))
        drawn = frame.report["boxes"]
        boxes = sum(len(part.boxes) for part in parts)
        print(
            f"{name:26} {split * 1e3:7.1f} ms {len(parts):6} {boxes:6} {parts.structures:7}"
            f" {many:8.1f}/px {slow * 1e3:6.0f} ms {few:8.1f}/px {fast * 1e3:6.0f} ms {drawn:6}"
            f" {many / few:5.1f}x {slow / fast:5.1f}x"
        )
    if options.device != "cpu":
        print(f"kernels that the device keeps: {frame.report['pipelines']}")


if __name__ == "__main__":
    main()
