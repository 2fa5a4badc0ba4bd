"""Random scenes for tests of merging, their float64 distance, and a grove over a floor."""

from __future__ import annotations

import numpy as np

import fieldbake as fb
import meshes
import truth
from scenes import moved

#: Direction in which the sun of the grove shines.
GROVE_SUN = (-1.0, -0.9, -0.4)


def turn(random, mirrored=False):
    """A random rotation, or a rotation with a reflection."""
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q)) * (-1 if mirrored else 1)


def placed(matrix, place):
    transform = np.eye(4)
    transform[:3, :3] = matrix
    transform[:3, 3] = place
    return transform


def random_scene(random, count, *, rigid=False, spread=4.0):
    """Instances of three volumes, and the triangles of all of them in the world."""
    geometries = [meshes.icosphere(2), meshes.torus(segments=24, sides=12), meshes.box((-1, -0.5, -0.3), (1, 0.5, 0.3))]
    volumes = [fb.bake(geometry, 20 + 6 * i) for i, geometry in enumerate(geometries)]
    instances, triangles = [], []
    for i in range(count):
        matrix = turn(random, mirrored=i % 3 == 1 and not rigid)
        if not rigid:
            matrix = matrix @ np.diag(random.uniform(0.3, 1.5, 3)) @ turn(random)
        transform = placed(matrix, random.uniform(-spread, spread, 3))
        vertices = geometries[i % 3].vertices @ transform[:3, :3].T + transform[:3, 3]
        faces = geometries[i % 3].faces[:, ::-1] if np.linalg.det(matrix) < 0 else geometries[i % 3].faces
        instances.append((volumes[i % 3], transform))
        triangles.append((vertices, faces))
    return instances, triangles


def union(triangles):
    first = np.cumsum([0] + [len(vertices) for vertices, _ in triangles])
    return (
        np.concatenate([vertices for vertices, _ in triangles]),
        np.concatenate([faces + start for (_, faces), start in zip(triangles, first, strict=False)]),
    )


def signed_distance(triangles, points):
    """To the union, by libigl in float64."""
    reference = truth.Reference(*union(triangles))
    distance = reference.distance(points)
    return np.where(reference.winding_number(points) > 0.5, -distance, distance)


def centers(volume):
    """World positions of the samples, (nx * ny * nz, 3)."""
    axes = [
        lower + (np.arange(n) + 0.5) * h
        for lower, n, h in zip(volume.bounds[0], volume.resolution, volume.spacing, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def exactness(instances):
    """How far the samples of the volumes may be off, world units: 1e-6 of a box's diagonal, stretched."""
    return max(
        truth.EXACT * np.linalg.norm(np.diff(volume.bounds, axis=0)) * np.linalg.norm(transform[:3, :3], 2)
        for volume, transform in instances
    )


def floor(side: float) -> fb.Instance:
    """A square of that half side in the plane y = 0."""
    corners = [(-side, 0, -side), (side, 0, -side), (side, 0, side), (-side, 0, side)]
    return fb.Instance(fb.Mesh(corners, [(0, 2, 1), (0, 3, 2)]))


def grove(count=60, seed=5, angle_deg=0.0):
    """Balls of radius 1/2 over a floor, and their centres."""
    random = np.random.default_rng(seed)
    centers = random.uniform((-6, 0.6, -6), (6, 3.5, 6), (count, 3))
    ball = fb.bake(fb.Mesh(*meshes.icosphere(4, radius=0.5)), 32)
    balls = [fb.Instance(ball, moved(*center)) for center in centers]
    return fb.Scene([*balls, floor(9)], lights=[fb.DirectionalLight(GROVE_SUN, angle_deg=angle_deg)]), balls, centers


CAMERA = fb.Camera((0.5, 16.0, 6.0), (0, 0, 0), fov_deg=50)
