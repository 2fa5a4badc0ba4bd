"""A forest merged into one field at 128, 64 and 32 voxels, drawn side by side, and the trees themselves.

    python examples/merged_forest.py [merged_forest.png] [--trees 60] [--size 320]

Two fields, a trunk and a crown, have many instances. The merged field is one grid with the distance to the nearest of
them. It cannot represent details thinner than its voxels, so trunks appear only at high resolutions. In the last
picture the trees are drawn directly, and the field of 128 voxels is used for their far shadow rays.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from PIL import Image

import fieldbake as fb


def forest(count: int, seed: int = 3) -> list[tuple[fb.Volume, np.ndarray]]:
    """Trees at random on a disc, no two alike."""
    random = np.random.default_rng(seed)
    trunk = fb.bake(trimesh.creation.cylinder(radius=0.12, height=1.2, sections=24), 48)
    crown = fb.bake(trimesh.creation.cone(radius=0.6, height=1.8, sections=32), 48)
    upright = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    instances = []
    for _ in range(count):
        angle, radius = random.uniform(0, 2 * np.pi), 6 * np.sqrt(random.uniform())
        tree = np.eye(4)
        tree[:3, :3] *= random.uniform(0.7, 1.4)
        tree[:3, 3] = radius * np.cos(angle), 0, radius * np.sin(angle)
        for field, height in ((trunk, 0.6), (crown, 1.0)):
            part = upright.copy()
            part[1, 3] = height
            instances.append((field, tree @ part))
    return instances


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", default="merged_forest.png")
    parser.add_argument("--trees", type=int, default=60)
    parser.add_argument("--size", type=int, default=320)
    options = parser.parse_args()

    instances = forest(options.trees)
    pictures, fields = [], []
    for resolution in (128, 64, 32):
        field = fb.merge(instances, resolution)
        fields.append(field)
        camera = fb.Camera.fit(field.inner_bounds, direction=(-0.4, -0.55, -1))
        frame = fb.raymarch(field, camera, size=(options.size, options.size), color=(0.35, 0.6, 0.3))
        pictures.append(frame.image)
        print(f"{resolution}: {len(instances)} instances in {1e3 * field.report.seconds['merge']:.0f} ms")

    green = fb.Material(color=(0.35, 0.6, 0.3))
    scene = fb.Scene([fb.Instance(field, transform, green) for field, transform in instances])
    camera = fb.Camera.fit(fields[0].inner_bounds, direction=(-0.4, -0.55, -1))
    frame = fb.render(scene, camera, size=(options.size, options.size), far=fields[0])
    pictures.append(frame.image)
    print(f"far field: {frame.report['far_rays'] / frame.report['rays']:.0%} of the rays went on in it")
    Image.fromarray(np.concatenate(pictures, axis=1)).save(options.picture)
    print(options.picture)


if __name__ == "__main__":
    main()
