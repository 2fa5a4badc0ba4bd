"""The distance from the surface of a shape as a leaf, for shapes whose field is no distance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.errors import ShapeError
from ..base.grid import Grid, check_count
from ..meshes.isosurface import ShapeSource, extract

#: Voxels along the longest side of the box of a shape, unless the caller chooses.
RESOLUTION = 128

#: Free voxels around the level sets that a leaf is used for.
BORDER = 3

#: Largest error of linear interpolation between distances at the corners of a voxel, voxels: the mean distance of the
#: corners from the centre. A distance changes by at most the length of a step.
INTERPOLATION = math.sqrt(3) / 2

#: Parts of a divided cell along each axis, as in the core, and the positions of its samples in parts, x fastest.
PARTS = 4
LATTICE = np.stack(np.meshgrid(*[np.arange(PARTS + 1)] * 3, indexing="ij")[::-1], axis=-1).reshape(-1, 3)

#: The corners of a cell, x fastest, and the weights of linear interpolation at the positions of `LATTICE`, (125, 8).
CORNERS = LATTICE[(LATTICE % PARTS == 0).all(axis=1)] // PARTS
WEIGHTS = np.where(CORNERS, LATTICE[:, None] / PARTS, 1 - LATTICE[:, None] / PARTS).prod(axis=2)

#: A cell is divided if linear interpolation is off by more than this at a middle of its edges, faces or body, voxels.
DIVISION_ERROR = 0.04

#: Largest movement of a point of the contour to the surface, voxels. It is longer only at features that the contour
#: does not resolve.
CORRECTION = 0.25

#: Cells whose distances are evaluated together.
BATCH = 20_000

#: Faces of the contour at which its error is evaluated.
FACES = 100_000


def distance_leaf(
    core: _core.Shape,
    name: str,
    levels: Sequence[float],
    reach: float,
    resolution: int,
    bounds: NDArray[np.float64] | None = None,
) -> _core.Shape:
    """Bake the signed distance from the surface of a shape.

    The contour of the shape is extracted with sharp edges. Each voxel has the distance to the nearest point of the
    contour, computed in float64, and the leaf interpolates it linearly. At the level sets, the distances are corrected
    for the error of the contour, and cells where linear interpolation is not accurate, for instance where the nearest
    part of the surface changes, are divided into 4 x 4 x 4 parts.

    Parameters
    ----------
    core : _core.Shape
        The shape.
    name : str
        The method of the caller, for messages.
    levels : sequence of float
        Distances of the level sets that must be accurate, world units.
    reach : float
        Largest distance outside the surface at which the field is used, world units.
    resolution : int
        Voxels along the longest side of the box of the shape.
    bounds : (2, 3) array, optional
        Box around the part of the surface to bake, world units; the default is the box of the shape.

    Raises
    ------
    ShapeError
        If the shape has no bounds and `bounds` is not given, or no surface at this resolution.
    """
    box = _box(core, name) if bounds is None else bounds
    grid = _grid(box, reach, resolution)
    surface, _ = _core.Surface.of_shape(core, grid.lower, grid.upper, grid.shape, 0.0)
    mesh = extract(surface, 0.0, ShapeSource(core), sharp=True, capped=True)
    if not len(mesh.faces):
        raise ShapeError(f"{name}: the shape has no surface at {resolution} voxels; raise resolution=")
    samples, _ = _core.bake(mesh._core, grid.lower, grid.upper, grid.shape, device="cpu")
    distances, voxel = np.array(samples, order="F"), max(grid.spacing)
    divided = _Distance(core, mesh._core, grid).divide(distances, levels)
    error = INTERPOLATION * voxel + _contour_error(core, mesh.vertices, mesh.faces.astype(np.int64), voxel)
    return _core.Shape.volume(distances, grid.lower, grid.upper, error, divided)


def _box(core: _core.Shape, name: str) -> NDArray[np.float64]:
    try:
        return np.array(core.bounds())
    except ShapeError as error:
        problem = "the field is no distance, and a bake of the distance needs bounds"
        raise ShapeError(f"{name}: {problem}: {error}") from None


def _grid(box: NDArray[np.float64], reach: float, resolution: int) -> Grid:
    """The grid around a box, with space for the level sets up to `reach`."""
    voxel = float((box[1] - box[0]).max()) / resolution
    if not voxel > 0:
        raise ShapeError("shape: is empty, so it has no distance")
    grown = box + (reach + BORDER * voxel) * np.array([[-1.0], [1.0]])
    counts = np.ceil((grown[1] - grown[0]) / voxel - 1e-6)
    middle, half = grown.mean(axis=0), counts * voxel / 2
    x, y, z = counts.astype(int).tolist()
    lower, upper = (middle - half).tolist(), (middle + half).tolist()
    return check_count(Grid((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]), (x, y, z)))


class _Distance:
    """The distance from the surface of a shape, by the nearest point of its contour."""

    def __init__(self, core: _core.Shape, contour: _core.Mesh, grid: Grid) -> None:
        self._core, self._contour, self._grid = core, contour, grid
        self._voxel = max(grid.spacing)

    def divide(
        self, distances: NDArray[np.float32], levels: Sequence[float]
    ) -> tuple[NDArray[np.uint64], NDArray[np.float32]]:
        """Correct the samples at level sets, and return the numbers (n,) of the cells to divide and their samples.

        Cells are numbered with x fastest. The samples (125 n,) of a divided cell lie at quarters of its sides.
        """
        is_near = _is_near(distances, levels, self._voxel / 2)
        is_divided = np.zeros(is_near.shape, bool)
        # The corners, and the middles of the edges, of the faces and of the body.
        halves = (LATTICE % (PARTS // 2) == 0).all(axis=1)
        is_corner = (LATTICE[halves] % PARTS == 0).all(axis=1)
        for cells in _batches(np.argwhere(is_near)):
            exact = self._at(cells, LATTICE[halves], _at_corners(distances, cells) @ WEIGHTS[halves].T)
            x, y, z = np.moveaxis(cells[:, None] + CORNERS, 2, 0)
            distances[x, y, z] = exact[:, is_corner]
            error = np.abs(exact - exact[:, is_corner] @ WEIGHTS[halves].T).max(axis=1)
            # A level set of the exact distance passes the cell, or is near it.
            is_crossed = _contains(exact.min(axis=1), exact.max(axis=1), levels, self._voxel / 4)
            is_divided[tuple(cells[is_crossed & (error > DIVISION_ERROR * self._voxel)].T)] = True
        count = int(is_divided.sum())
        what = f"the finer samples of {count} cells"
        _core.require_memory(what, 3 * 4 * len(LATTICE) * count, "use a lower resolution")
        samples, filled = np.empty((count, len(LATTICE)), np.float32), 0
        for cells in _batches(np.argwhere(is_divided.T)[:, ::-1]):
            # The field is continuous: it is linear on the faces and edges that a whole cell shares.
            linear = _at_corners(distances, cells) @ WEIGHTS.T
            exact = self._at(cells, LATTICE, linear)
            exact = np.where(_is_shared_by_whole_cells(is_divided, cells), linear, exact)
            samples[filled : filled + len(cells)] = exact
            filled += len(cells)
        return np.flatnonzero(is_divided.T).astype(np.uint64), samples.ravel()

    def _at(
        self, cells: NDArray[np.int64], offsets: NDArray[np.int64], linear: NDArray[np.floating[Any]]
    ) -> NDArray[np.float64]:
        """Signed distances (n, k) at k positions in each of n cells; offsets from the first corner are in parts.

        Values `linear` (n, k) that are interpolated have the signs, except within half a voxel of the surface.
        """
        places = PARTS * cells[:, None] + offsets
        x, y, z = (PARTS * n for n in self._grid.shape)
        keys, rows = np.unique(np.ravel_multi_index(np.moveaxis(places, 2, 0), (x, y, z)), return_inverse=True)
        unique = np.stack(np.unravel_index(keys, (x, y, z)), axis=1)
        points = np.array(self._grid.lower) + np.array(self._grid.spacing) * (unique / PARTS + 0.5)
        feet, lengths, *_ = _core.closest_point(self._contour, points, device="cpu")
        # A step of Newton's method moves the nearest point of the contour to the surface.
        slopes = self._core.gradient(feet).astype(np.float64)
        values = self._core.distance(feet, "cpu").astype(np.float64)
        moved = feet - (values / np.maximum((slopes**2).sum(axis=1), 1e-12))[:, None] * slopes
        is_nearer = np.linalg.norm(moved - feet, axis=1) <= CORRECTION * self._voxel
        is_nearer &= np.abs(self._core.distance(moved, "cpu")) <= np.abs(values) / 4
        lengths = np.where(is_nearer, np.linalg.norm(points - moved, axis=1), lengths)
        close, sides = lengths <= self._voxel / 2, np.zeros(len(lengths))
        sides[close] = self._core.distance(points[close], "cpu")
        rows = rows.reshape(linear.shape)
        return np.copysign(lengths[rows], np.where(close[rows], sides[rows], linear))


def _is_near(distances: NDArray[np.float32], levels: Sequence[float], margin: float) -> NDArray[np.bool_]:
    """Whether the field of each cell may have one of the values."""
    counts = np.array(distances.shape) - 1
    corners = [distances[tuple(slice(i, i + n) for i, n in zip(at, counts, strict=True))] for at in CORNERS.tolist()]
    return _contains(reduce(np.minimum, corners), reduce(np.maximum, corners), levels, margin)


def _contains(
    low: NDArray[np.floating[Any]], high: NDArray[np.floating[Any]], levels: Sequence[float], margin: float
) -> NDArray[np.bool_]:
    """Whether intervals, which are extended by a margin, contain one of the values."""
    found = np.zeros(low.shape, bool)
    for level in levels:
        found |= (low - margin <= level) & (level <= high + margin)
    return found


def _batches(cells: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    return (cells[first : first + BATCH] for first in range(0, len(cells), BATCH))


def _at_corners(distances: NDArray[np.float32], cells: NDArray[np.int64]) -> NDArray[np.float32]:
    """The samples (n, 8) at the corners of cells."""
    x, y, z = np.moveaxis(cells[:, None] + CORNERS, 2, 0)
    samples: NDArray[np.float32] = distances[x, y, z]
    return samples


def _is_shared_by_whole_cells(is_divided: NDArray[np.bool_], cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each sample (n, 125) lies on a face or edge of a cell that is not divided, inside the grid."""
    padded = np.pad(is_divided, 1, constant_values=True)
    shared = np.zeros((len(cells), len(LATTICE)), bool)
    ends = np.where(LATTICE == 0, -1, np.where(LATTICE == PARTS, 1, 0))
    for step in np.argwhere(np.ones((3, 3, 3))) - 1:
        is_whole = ~padded[tuple((cells + 1 + step).T)]
        shared |= is_whole[:, None] & ((step == 0) | (step == ends)).all(axis=1)
    return shared


def _contour_error(core: _core.Shape, vertices: NDArray[np.float64], faces: NDArray[np.int64], voxel: float) -> float:
    """Largest distance of the contour from the surface at centres of its faces, to first order, world units.

    It is at most the diagonal of a voxel, because the surface passes through every cell of the contour.
    """
    chosen = faces[:: max(1, len(faces) // FACES)]
    points = vertices[chosen].mean(axis=1)
    slopes = np.linalg.norm(core.gradient(points), axis=1)
    found = np.abs(core.distance(points, "cpu")) / np.maximum(slopes, 1e-6)
    return min(float(found.max()), math.sqrt(3) * voxel)
