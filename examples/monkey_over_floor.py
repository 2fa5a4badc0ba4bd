"""The scene of the article "Mesh Distance Field + Shadow": a model over a floor, lit from above.

Three pictures side by side: hard shadows, and the penumbrae of a lamp with a size by cones and by 64 rays.

    python examples/monkey_over_floor.py [model.obj] [-o monkey.png]
"""

import argparse
from pathlib import Path

import numpy as np

import fieldbake as fb
from fieldbake.drawing.frame import save_image

SHADOWS = ("hard", "soft", "area")


def floor_under(bounds: np.ndarray, size: float = 4.0) -> fb.Mesh:
    """A square on the ground below a box, a tenth of the box's height away."""
    center, extent = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    y = bounds[0, 1] - 0.1 * extent[1]
    half = size / 2 * extent.max()
    corners = [(center[0] + x * half, y, center[2] + z * half) for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return fb.Mesh(corners, [(0, 2, 1), (0, 3, 2)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", nargs="?", help="a mesh file; a knot made in code if not given")
    parser.add_argument("-o", "--output", type=Path, default=Path("monkey.png"))
    parser.add_argument("--size", type=int, default=360, help="of each picture, pixels")
    parser.add_argument("--device", default="auto")
    arguments = parser.parse_args()

    model = fb.load_mesh(arguments.model) if arguments.model else fb.models.torus_knot()
    bounds = model.bounds
    extent = np.ptp(bounds, axis=0).max()
    lamp = bounds.mean(axis=0) + extent * np.array([0.9, 2.2, 0.7])
    scene = fb.Scene(
        [fb.Instance(model, material=fb.Material(color=(0.85, 0.45, 0.15))), fb.Instance(floor_under(bounds))],
        lights=[fb.PointLight(lamp.tolist(), radius=0.25 * extent)],
    )
    camera = fb.Camera.fit(bounds, direction=(-0.7, -0.7, -1.0), border=0.35)
    size = (arguments.size, arguments.size)
    frames = [
        fb.render(scene, camera, size=size, shadows=shadows, samples=4, device=arguments.device) for shadows in SHADOWS
    ]
    save_image(np.concatenate([frame.image for frame in frames], axis=1), arguments.output)
    for name, frame in zip(SHADOWS, frames, strict=True):
        light = frame.report["milliseconds"]["light"]
        print(f"{name:8} {light:7.0f} ms of light, {frame.steps.mean():6.1f} steps a pixel")


if __name__ == "__main__":
    main()
