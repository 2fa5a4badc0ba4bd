"""Every kind of quadric on a floor, lit from the side: geometry that lives in a texture.

    python examples/quadrics.py [quadrics.png] [--size 960x540] [--device auto]

The scene of O. Lawlor, Storing Raytraced Geometry in Textures (2010), with one more kind for each row of the texture.
Half-opaque objects cast half a shadow; where two such shadows overlap, a quarter of the light remains.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from fieldbake import Quadric

#: Quadrics have z as their axis; the world's up is y.
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def scene() -> list[Quadric]:
    """Two rows of kinds and the floor, a single plane trimmed to a disc."""
    kinds = [
        Quadric.sphere(radius=0.8, reflectance=(0.9, 0.3, 0.2)),
        Quadric.ellipsoid(radii=(0.9, 0.5, 0.7), reflectance=(0.9, 0.6, 0.2), opacity=0.5),
        Quadric.cylinder(radius=0.5, height=1.6, reflectance=(0.8, 0.8, 0.2)),
        Quadric.cone(radius=0.7, height=1.5, reflectance=(0.3, 0.8, 0.3)),
        Quadric.cone(radius=0.5, height=0.8, sheets=2, reflectance=(0.3, 0.8, 0.8), opacity=0.5),
        Quadric.paraboloid(radius=0.8, height=1.2, reflectance=(0.3, 0.4, 0.9)),
        Quadric.hyperboloid(radii=(0.4, 0.4, 0.5), height=1.8, reflectance=(0.6, 0.3, 0.9)),
        Quadric.hyperboloid(radii=(0.3, 0.3, 0.25), height=1.8, sheets=2, reflectance=(0.9, 0.3, 0.7)),
        Quadric.hyperbolic_paraboloid(radii=(0.8, 0.8), radius=1, reflectance=(0.7, 0.7, 0.7)),
        Quadric.plane_pair(separation=0.6, radius=0.7, reflectance=(0.9, 0.9, 0.9), opacity=0.5),
    ]
    placed = []
    for i, kind in enumerate(kinds):
        place = UPRIGHT.copy()
        place[:3, 3] = (i % 5 - 2) * 2.2, 0, i // 5 * 2.5
        placed.append(kind.transformed(place))
    floor = np.zeros((4, 4))
    floor[1, 3] = floor[3, 1] = 0.5
    floor[3, 3] = 1.0
    return [*placed, Quadric(floor, (0, -1, 1), 11, reflectance=(0.65, 0.65, 0.6))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", default="quadrics.png")
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))

    quadrics = scene()
    packed = fb.pack_quadrics(quadrics)
    print(
        f"{len(quadrics)} quadrics are a texture of {packed.shape[1]} x {packed.shape[0]} texels, {packed.nbytes} bytes"
    )
    camera = fb.Camera((2.5, 5.5, 10.5), (0, -0.4, 1.2), fov_deg=42)
    light = fb.DirectionalLight((-0.6, -1, -0.35))
    frame = fb.raymarch(quadrics, camera, size=(width, height), lights=[light], device=options.device)
    frame.save(options.picture)
    print(f"{options.picture}: {1e3 * frame.report['seconds']:.0f} ms on {frame.report['device']}")


if __name__ == "__main__":
    main()
