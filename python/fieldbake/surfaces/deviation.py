"""Distances between a mesh and the zero level set of a field: the largest of samples, which are then refined.

Each distance is computed at a point that the search found, so up to rounding it does not exceed the true largest
distance. Samples are at most a voxel apart. The pieces around them that may hold a larger distance are divided, and
those with the largest scores come first. A distance has a slope of at most 1, so the size of a piece bounds what it
can hold.

The number of pieces is limited, so the search may miss the largest distance. In 159 Booleans of turned boxes, offsets
and shells, one distance was 0.12 % below a wider search and the others at most 0.1 %. Where the mesh deviates by less
than a tenth of a voxel, a distance was up to 0.6 % low.
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

#: Pieces of the surface that are divided in each round, and in the first; each round halves their size.
PLACES = 2048
FIRST = 4 * PLACES
ROUNDS = 12

#: A piece is dropped if no point of it exceeds the largest distance found so far by more than this share.
ENOUGH = 5e-4

#: Longest edge of a face whose distance is sampled at its corners, middles of edges and centre, voxels.
MOST_EDGE = 2.0

#: Steps of Newton's method onto a level set, the error at which they end, and the largest error after them, voxels.
STEPS = 6
LEAST_ERROR = 1e-6
ON_SURFACE = 1e-4

#: Distance from a point of the level set at which the field must have both signs, voxels, and the number of directions
#: that are tried for each.
ACROSS = 2e-3
PROBES = 32


def to_ideal(mesh: Mesh, field: Field, grid: Grid) -> float:
    """Measure the largest distance from the surface of a mesh to the zero level set of a field, world units."""
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    corners, most = vertices[faces], MOST_EDGE * max(grid.spacing)
    # Corners and middles of edges are shared by several faces. Each is evaluated once.
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
    edges, edge_of = np.unique(ends[..., 0] * len(vertices) + ends[..., 1], return_inverse=True)
    middles = (vertices[edges // len(vertices)] + vertices[edges % len(vertices)]) / 2
    before = _distances(field, corners.mean(axis=1))
    scores = np.maximum(
        np.maximum(_distances(field, vertices)[faces].max(axis=1), before),
        _distances(field, middles)[edge_of.reshape(faces.shape)].max(axis=1),
    )
    long = _longest_edges(corners) > most
    if long.any():
        parts = _short(corners[long], most)
        corners = np.concatenate([corners[~long], parts])
        scores = np.concatenate([scores[~long], _scores(field, parts)])
        before = np.concatenate([before[~long], _distances(field, parts.mean(axis=1))])
    # Samples lie at the corners of each quarter. No point is farther from one than in an equilateral triangle.
    bounds = scores + _longest_edges(corners) / np.sqrt(12)
    pieces, best, most = corners, float(scores.max()), FIRST
    for _ in range(ROUNDS):
        kept = _largest(scores, before, bounds, best, most)
        if not len(kept):
            break
        pieces, before, most = _quarters(pieces[kept]).reshape(-1, 3, 3), np.repeat(scores[kept], 4), PLACES
        centers = pieces.mean(axis=1)
        scores = _distances(field, centers)
        bounds = scores + np.linalg.norm(pieces - centers[:, None], axis=2).max(axis=1)
        best = max(best, float(scores.max()))
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

    def measured(points: Array) -> Array:
        """Distances of points from the mesh; a point that Newton's method lost is moved to a vertex first."""
        points[~np.isfinite(points).all(axis=1)] = mesh.vertices[0]
        return _core.closest_point(mesh._core, np.ascontiguousarray(points))[1]

    cells, best, side = [np.empty((0, 4))], 0.0, 0.5
    for centers in _near(field, grid):
        # One step of Newton's method is exact where the field is a distance.
        points, normals = projected(field, centers)
        scores = measured(points)
        order = np.argsort(-scores, kind="stable")
        rows = order[:0]
        while len(order) and len(rows) < FIRST:
            first, order = order[:FIRST], order[FIRST:]
            rows = np.concatenate([rows, first[~_is_inner(field, points[first], normals[first], voxel)]])
        cells.append(np.column_stack([centers, scores])[rows[:FIRST]])
    found = np.concatenate(cells)
    found = found[np.argsort(-found[:, 3], kind="stable")[:FIRST]]
    centers, before = found[:, :3], found[:, 3]
    for _ in range(ROUNDS):
        reach = side / 2 * float(np.linalg.norm(spacing)) * (1 + 1e-5)
        may_cross = np.abs(field.values(centers)) <= reach
        centers, before = centers[may_cross], before[may_cross]
        if not len(centers):
            break
        points, normals, errors = _on_level(field, centers, LEAST_ERROR * voxel)
        scores = measured(points)
        bounds = scores + np.linalg.norm(points - centers, axis=1) + reach
        kept = _largest(scores, before, bounds, best, PLACES)
        kept = kept[~_is_inner(field, points[kept], normals[kept], voxel)]
        # A point beside the level set counts with the distance that it has in any case.
        on_surface = kept[errors[kept] <= ON_SURFACE * voxel]
        best = max(best, float((scores - errors)[on_surface].max(initial=0.0)))
        side /= 2
        centers = (centers[kept][:, None] + CORNERS * side / 2 * spacing).reshape(-1, 3)
        before = np.repeat(scores[kept], len(CORNERS))
    return best


def _on_level(field: Field, points: Array, least: float) -> tuple[Array, Array, Array]:
    """Move points (n, 3) onto the level set; return them, their normals, and the magnitudes of the field there (n,)."""
    points, normals, errors = points.copy(), np.empty_like(points), np.empty(len(points))
    rows = np.arange(len(points))
    for _ in range(STEPS):
        points[rows], normals[rows] = projected(field, points[rows])
        errors[rows] = np.abs(field.values(points[rows]))
        rows = rows[errors[rows] > least]
    return points, normals, errors


def _is_inner(field: Field, points: Array, normals: Array, voxel: float) -> NDArray[np.bool_]:
    """Whether the field is 0 at points (n, 3) and has one sign around them, (n,).

    Such points lie on faces of operands that are no surface of the combination, as the common face of two touching
    boxes in their union.
    """
    inner = np.abs(field.values(points)) <= ON_SURFACE * voxel
    rows, crosses = np.flatnonzero(inner), np.ones(np.count_nonzero(inner), bool)
    for sign in (-1.0, 1.0):
        crosses[crosses] = _has_sign(field, points[rows[crosses]], normals[rows[crosses]], sign, ACROSS * voxel)
    inner[rows[crosses]] = False
    return inner


def _has_sign(field: Field, points: Array, normals: Array, sign: float, reach: float) -> NDArray[np.bool_]:
    """Whether the field has a sign at a distance `reach` from points (n, 3) where it is 0, (n,).

    At an edge or a corner, a sum of the normals of its faces leads there. Each step that fails adds the normal of the
    face that it is beyond.
    """
    found = np.zeros(len(points), bool)
    sums, rows = normals.copy(), np.arange(len(points))
    for _ in range(PROBES):
        if not len(rows):
            break
        lengths = np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
        values, gradients = field.tangents(points[rows] + sign * reach * sums / lengths)
        # Opposite normals cancel, which leaves a step along the face, where the field is 0 up to rounding.
        fails = sign * values <= 1e-2 * reach
        found[rows[~fails]] = True
        sums, rows = (sums + gradients)[fails], rows[fails]
    return found


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


def _largest(scores: Array, before: Array, bounds: Array, best: float, most: int) -> NDArray[np.intp]:
    """Rows of at most `most` pieces that may exceed the largest distance found so far, the same on every run.

    The scores are extrapolated: a piece whose score differs much from the score before may rise as much again.
    """
    rows = np.flatnonzero(bounds > (1 + ENOUGH) * best)
    ranks = scores[rows] + np.abs(scores[rows] - before[rows])
    return rows[np.argsort(-ranks, kind="stable")[:most]]


def _quarters(triangles: Array) -> Array:
    """Four similar triangles for each of (m, 3, 3), (m, 4, 3, 3)."""
    a, b, c = (triangles[:, i] for i in range(3))
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.stack(parts, axis=1)
