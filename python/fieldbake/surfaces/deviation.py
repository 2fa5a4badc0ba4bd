"""Distances between a mesh and the zero level set of a field: the largest of samples, which are then refined.

Each distance is computed at a point that the search found, so it never exceeds the true largest distance. Samples are
at most a voxel apart, and the neighbourhoods of the largest ones are searched to a thousandth of a voxel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.grid import Grid
from ..meshes.mesh import Mesh
from .fields import CORNERS, Field, projected

Array = NDArray[np.float64]

#: Points evaluated at once.
BATCH = 1 << 20

#: Places whose neighbourhood is searched, and the number of times that the search is narrowed by half.
PLACES = 512
ROUNDS = 10

#: Longest edge of a face whose distance is sampled at its corners, middles of edges and centre, voxels.
MOST_EDGE = 2.0

#: Steps of Newton's method onto a level set, and the largest error after them, voxels.
STEPS = 3
ON_SURFACE = 1e-3

#: Distance from a point of the level set at which the field must have both signs, voxels.
ACROSS = 2 * ON_SURFACE


def to_ideal(mesh: Mesh, field: Field, grid: Grid) -> float:
    """Measure the largest distance from the surface of a mesh to the zero level set of a field, world units."""
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    corners, most = vertices[faces], MOST_EDGE * max(grid.spacing)
    # Corners and middles of edges are shared by several faces. Each is evaluated once.
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
    edges, edge_of = np.unique(ends[..., 0] * len(vertices) + ends[..., 1], return_inverse=True)
    middles = (vertices[edges // len(vertices)] + vertices[edges % len(vertices)]) / 2
    scores = np.maximum(
        np.maximum(_distances(field, vertices)[faces].max(axis=1), _distances(field, corners.mean(axis=1))),
        _distances(field, middles)[edge_of.reshape(faces.shape)].max(axis=1),
    )
    long = _longest_edges(corners) > most
    if long.any():
        parts = _short(corners[long], most)
        corners = np.concatenate([corners[~long], parts])
        scores = np.concatenate([scores[~long], _scores(field, parts)])
    kept = _largest(scores)
    pieces, best = corners[kept], float(scores.max())
    for _ in range(ROUNDS):
        quarters = _quarters(pieces)
        scores = _scores(field, quarters.reshape(-1, 3, 3)).reshape(-1, 4)
        best = max(best, float(scores.max()))
        pieces = quarters[np.arange(len(pieces)), scores.argmax(axis=1)]
    return best


def _distances(field: Field, points: Array) -> Array:
    """Distances of points (n, 3) from the zero level set, (n,), in batches."""
    parts = [field.distances(points[first : first + BATCH]) for first in range(0, len(points), BATCH)]
    return np.concatenate(parts)


def _scores(field: Field, triangles: Array) -> Array:
    """Largest distance at the corners, the middles of the edges and the centre of triangles (m, 3, 3), (m,)."""
    middles = (triangles + np.roll(triangles, -1, axis=1)) / 2
    points = np.concatenate([triangles, middles, triangles.mean(axis=1, keepdims=True)], axis=1)
    found: Array = _distances(field, points.reshape(-1, 3)).reshape(-1, 7).max(axis=1)
    return found


def _longest_edges(triangles: Array) -> Array:
    """Length of the longest edge of each of the triangles (m, 3, 3), (m,)."""
    lengths: Array = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2).max(axis=1)
    return lengths


def _short(triangles: Array, most: float) -> Array:
    """Divide triangles (m, 3, 3) into quarters until no edge is longer than `most`."""
    parts = []
    while len(triangles):
        long = _longest_edges(triangles) > most
        parts.append(triangles[~long])
        triangles = _quarters(triangles[long]).reshape(-1, 3, 3)
    return np.concatenate(parts)


def from_ideal(mesh: Mesh, field: Field, grid: Grid) -> float:
    """Measure the largest distance from the zero level set of a field to the surface of a mesh, world units."""
    spacing = np.array(grid.spacing)
    voxel = float(spacing.max())

    def measure(points: Array) -> tuple[Array, Array]:
        """Move points onto the level set; return them and their distances from the mesh, -1 where that fails."""
        for _ in range(STEPS):
            points, normals = projected(field, points)
            points[~np.isfinite(points).all(axis=1)] = mesh.vertices[0]
        found = _core.closest_point(mesh._core, np.ascontiguousarray(points))[1]
        is_surface = np.abs(field.values(points)) <= ON_SURFACE * voxel
        return points, np.where(is_surface & ~_is_inner(field, points, normals, voxel), found, -1.0)

    tops, scores = [np.empty((0, 3))], [np.empty(0)]
    for centers in _near(field, grid):
        # One step of Newton's method is exact where the field is a distance. The few farthest points are measured.
        moved, normals = projected(field, centers)
        moved[~np.isfinite(moved).all(axis=1)] = mesh.vertices[0]
        order = _largest(_core.closest_point(mesh._core, np.ascontiguousarray(moved))[1], len(moved))
        rows = order[:0]
        while len(order) and len(rows) < 8 * PLACES:
            first, order = order[: 8 * PLACES], order[8 * PLACES :]
            rows = np.concatenate([rows, first[~_is_inner(field, moved[first], normals[first], voxel)]])
        points, found = measure(moved[rows])
        kept = _largest(found)
        tops.append(points[kept])
        scores.append(found[kept])
    points, found = np.concatenate(tops), np.concatenate(scores)
    kept = _largest(found)
    points, found = points[kept], found[kept]
    # A pattern search around each place: its step is halved where no neighbour is farther from the mesh.
    steps = np.concatenate([np.eye(3), -np.eye(3)]) * voxel
    size = np.full(len(points), 0.5)
    for _ in range(2 * ROUNDS):
        near, scores_near = measure((points[:, None] + steps * size[:, None, None]).reshape(-1, 3))
        scores_near = scores_near.reshape(-1, len(steps))
        farthest = scores_near.argmax(axis=1)
        rows = np.arange(len(points))
        better = scores_near[rows, farthest] > found
        points = np.where(better[:, None], near.reshape(-1, len(steps), 3)[rows, farthest], points)
        found = np.where(better, scores_near[rows, farthest], found)
        size = np.where(better, size, size / 2)
    return max(float(found.max(initial=0.0)), 0.0)


def _is_inner(field: Field, points: Array, normals: Array, voxel: float) -> NDArray[np.bool_]:
    """Whether the field is 0 at points (n, 3) and has one sign around them, (n,).

    Such points lie on faces of operands that are no surface of the combination, as the common face of two touching
    boxes in their union.
    """

    def has_one_sign(points: Array, offsets: Array) -> NDArray[np.bool_]:
        around = points[:, None] + ACROSS * voxel * offsets
        around = field.values(around.reshape(-1, 3)).reshape(around.shape[:2])
        found: NDArray[np.bool_] = (around.min(axis=1) >= 0) | (around.max(axis=1) <= 0)
        return found

    inner = has_one_sign(points, np.stack([normals, -normals], axis=1))
    # Both ends of the normal of an operand may lie outside at an edge between two operands.
    inner[inner] = has_one_sign(points[inner], CORNERS)
    inner[inner] = np.abs(field.values(points[inner])) <= ON_SURFACE * voxel
    return inner


def _near(field: Field, grid: Grid) -> list[Array]:
    """Find the cubes of half a voxel that the zero level set may cross; return their centres in batches of (n, 3)."""
    lower, spacing = np.array(grid.lower), np.array(grid.spacing)
    shape = np.array(grid.shape)
    corner = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    side = float(2 ** int(np.ceil(np.log2(shape.max()))))
    batches = [np.zeros((1, 3))]
    while side > 0.5:
        side /= 2
        reach = side / 2 * float(np.linalg.norm(spacing)) * (1 + 1e-5)
        next_batches = []
        for origins in batches:
            for part in np.array_split(origins, max(1, 8 * len(origins) // BATCH)):
                children = (part[:, None] + corner * side).reshape(-1, 3)
                children = children[(children < shape).all(axis=1)]
                values = field.values(lower + (children + side / 2) * spacing)
                next_batches.append(children[np.abs(values) <= reach])
        batches = next_batches
    return [lower + (origins + side / 2) * spacing for origins in batches]


def _largest(scores: Array, most: int = PLACES) -> NDArray[np.intp]:
    """Rows of the largest scores, at most `most`, the same on every run."""
    count = min(most, len(scores))
    return np.argsort(-scores, kind="stable")[:count]


def _quarters(triangles: Array) -> Array:
    """Four similar triangles for each of (m, 3, 3), (m, 4, 3, 3)."""
    a, b, c = (triangles[:, i] for i in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.stack(parts, axis=1)
