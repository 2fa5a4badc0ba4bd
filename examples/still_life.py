"""One scene with every kind of object: a mesh, a baked volume, a shape, quadrics, and their shadows on each other.

    python examples/still_life.py [still_life.png] [--size 1024x576] [--samples 4] [--device auto]

The gear consists of triangles, the knot is a distance field, the die is drawn from its operators, and bowls, vase and
balls are equations in trim spheres. They share one depth buffer, and each of them shades the others. Beyond a distance,
shadow rays use one coarse field merged from all objects.
"""

from __future__ import annotations

import argparse

import numpy as np
from PIL import Image

import fieldbake as fb
from fieldbake import Material, Quadric

STEEL = Material(color=(0.32, 0.38, 0.45), specular=0.6, shininess=60)
CLAY = Material(color=(0.72, 0.28, 0.12), specular=0.35, shininess=40)
PAPER = Material(color=(0.80, 0.77, 0.72), specular=0.0)
GLAZE = Material(specular=0.6, shininess=90)


def place(x: float, y: float, z: float, *, scale: float = 1.0, tilt: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Place an object with z as its axis upright, tilt it to the viewer, rotate it about the vertical, and move it."""
    tilt, turn = np.radians(tilt), np.radians(turn)
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    back = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    about = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    world = np.eye(4)
    world[:3, :3] = scale * about @ back @ upright
    world[:3, 3] = x, y, z
    return world


def backdrop() -> fb.Mesh:
    """A sheet that lies on the table and rises behind it, without an edge between."""
    angles = np.linspace(0, np.pi / 2, 33)
    bend = 3.0
    curve = [
        (0.0, 9.0),
        *zip(bend * (1 - np.cos(angles)), -4.5 - bend * np.sin(angles), strict=True),
        (9.0, -4.5 - bend),
    ]
    left = [(-16.0, y, z) for y, z in curve]
    right = [(16.0, y, z) for y, z in curve]
    count = len(curve)
    faces = [(i, count + i, i + 1) for i in range(count - 1)]
    faces += [(count + i, count + i + 1, i + 1) for i in range(count - 1)]
    return fb.Mesh(left + right, faces)


def die() -> fb.Shape:
    """A cube with round corners and three bores. Each surface has the colour of the solid that cut it."""
    body = (fb.rounded_box((2, 2, 2), 0.25) & fb.sphere(1.38)).paint((0.80, 0.74, 0.62))
    bore = fb.cylinder(radius=0.62, height=4).paint((0.10, 0.32, 0.30))
    return body - bore - bore.rotate("x", 90) - bore.rotate("y", 90)


def instances() -> list[fb.Instance]:
    """The still life."""
    knot = fb.bake(fb.models.torus_knot(), 96)
    bowl = Quadric.paraboloid((0, 0, 0), 0.95, 0.75, reflectance=(0.10, 0.35, 0.60), opacity=0.6)
    fruit = [
        Quadric.sphere((0.05, 0.1, 0.62), 0.42, reflectance=(0.85, 0.50, 0.08)),
        Quadric.ellipsoid((-0.42, -0.25, 0.72), (0.26, 0.26, 0.34), reflectance=(0.60, 0.12, 0.10)),
    ]
    vase = Quadric.hyperboloid((0, 0, 0.95), (0.32, 0.32, 0.55), 1.9, reflectance=(0.45, 0.52, 0.40))
    pearl = Quadric.sphere((0, 0, 0), 0.6, reflectance=(0.85, 0.80, 0.72))
    pane = Quadric.plane_pair((0, 0, 0), 0.06, 0.85, reflectance=(0.75, 0.35, 0.30), opacity=0.5)
    return [
        fb.Instance(backdrop(), material=PAPER, casts_shadow=False),
        fb.Instance(fb.models.gear(teeth=16), place(-2.75, 1.02, -0.9, tilt=78, turn=28), STEEL, resolution=96),
        fb.Instance(knot, place(-0.75, 0.86, -0.55, scale=0.78, tilt=70, turn=-15), CLAY),
        fb.Instance(die(), place(1.35, 0.93, -0.35, scale=0.9, turn=33), GLAZE),
        fb.Instance([bowl, *fruit], place(-0.55, 0.0, 1.75, scale=0.95), GLAZE),
        fb.Instance(pearl, place(1.35, 2.12, -0.35), GLAZE),
        fb.Instance(vase, place(3.15, 0.0, -1.5), GLAZE),
        fb.Instance(pane, place(2.7, 0.84, 0.9, tilt=80, turn=-35), GLAZE, opacity=0.7),
    ]


def scene() -> fb.Scene:
    """With a lamp on the left, large enough for soft shadows, and a little light from the right."""
    lamp = fb.PointLight((-4.5, 6.5, 4.5), color=(1.0, 0.95, 0.86), intensity=0.85, radius=0.8)
    window = fb.DirectionalLight((-1, -0.9, -0.8), color=(0.75, 0.85, 1.0), intensity=0.18, angle_deg=20)
    return fb.Scene(instances(), [lamp, window], ambient=0.22, background=(0.8, 0.77, 0.72))


CAMERA = fb.Camera((0.35, 3.1, 9.2), (0.2, 0.75, 0), fov_deg=32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", default="still_life.png")
    parser.add_argument("--size", default="1024x576")
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))

    still_life = scene()
    far = fb.merge(still_life.instances[1:], 96, device=options.device)
    frame = fb.render(
        still_life,
        CAMERA,
        size=(width, height),
        samples=options.samples,
        ambient_occlusion=1.2,
        far=far,
        far_distance=2.5,
        device=options.device,
        progress=True,
    )
    # The image is opaque, so it is saved without opacity, which would add a fifth to its size.
    Image.fromarray(frame.image[..., :3]).save(options.picture, optimize=True)
    for stage, duration in frame.report["milliseconds"].items():
        print(f"{stage:8} {duration:8.0f} ms on {frame.report['devices'][stage]}")
    rays, far_rays = frame.report["rays"], frame.report["far_rays"]
    print(f"{far_rays / rays:.0%} of {rays:,} rays went on in the merged field")


if __name__ == "__main__":
    main()
