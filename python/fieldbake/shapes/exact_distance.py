"""The distance from the surface of a shape as a leaf, for shapes whose field is no distance."""

from __future__ import annotations

import math

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

#: Faces of the contour at which its error is evaluated.
FACES = 100_000


def distance_leaf(
    core: _core.Shape,
    name: str,
    reach: float,
    resolution: int,
    bounds: NDArray[np.float64] | None = None,
) -> _core.Shape:
    """Bake the signed distance from the surface of a shape.

    The contour of the shape is extracted with sharp edges. Each voxel has the distance to the nearest point of the
    contour, computed in float64, and the leaf interpolates it linearly.

    Parameters
    ----------
    core : _core.Shape
        The shape.
    name : str
        The method of the caller, for messages.
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
    distances, _ = _core.bake(mesh._core, grid.lower, grid.upper, grid.shape, device="cpu")
    voxel = max(grid.spacing)
    error = INTERPOLATION * voxel + _contour_error(core, mesh.vertices, mesh.faces.astype(np.int64), voxel)
    return _core.Shape.volume(np.asarray(distances), grid.lower, grid.upper, error)


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


def _contour_error(core: _core.Shape, vertices: NDArray[np.float64], faces: NDArray[np.int64], voxel: float) -> float:
    """Largest distance of the contour from the surface at centres of its faces, to first order, world units.

    It is at most the diagonal of a voxel, because the surface passes through every cell of the contour.
    """
    chosen = faces[:: max(1, len(faces) // FACES)]
    points = vertices[chosen].mean(axis=1)
    slopes = np.linalg.norm(core.gradient(points), axis=1)
    found = np.abs(core.distance(points, "cpu")) / np.maximum(slopes, 1e-6)
    return min(float(found.max()), math.sqrt(3) * voxel)
