"""First derivatives of distances and trilinear samples, for the functions of PyTorch and JAX."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ArgumentError
from ..meshes.mesh import Mesh
from .nearest import query


class Linear(NamedTuple):
    """Signed distances and their first derivatives: d(p + dp, v + dv) = d + g.dp - sum_k b_k g.dv_k."""

    #: Signed distances, (...).
    distances: NDArray[Any]
    #: Unit gradients g, (..., 3).
    gradients: NDArray[Any]
    #: Rows of the vertices of the nearest face, (..., 3) int64.
    corners: NDArray[np.int64]
    #: Weights b of those vertices, (..., 3).
    weights: NDArray[Any]


def linearize(vertices: NDArray[Any], faces: NDArray[Any], points: NDArray[Any], mesh: Mesh | None) -> Linear:
    """Evaluate the signed distance and its first derivatives, in the dtype of the points."""
    if mesh is None:
        mesh = Mesh(vertices, faces)
    elif not isinstance(mesh, Mesh):
        raise ArgumentError(f"mesh: must be a Mesh of the same vertices and faces, got {type(mesh).__name__}")
    found = query(mesh, points)
    kept = mesh._core.source_faces
    rows = found.faces if kept is None else kept[found.faces]
    if rows.size and rows.max() >= len(faces):
        raise ArgumentError(f"mesh: has {len(mesh.faces)} faces, which differ from faces ({len(faces)} rows)")
    kind = np.asarray(points).dtype
    return Linear(
        found.distances.astype(kind),
        found.gradients.astype(kind),
        np.asarray(faces)[rows].astype(np.int64),
        found.barycentric.astype(kind),
    )


def vertex_changes(weights: Any, change: Any) -> Any:
    """Compute derivatives by the corners of the nearest faces, (..., 3, 3), from those by the points, (..., 3)."""
    return -weights[..., :, None] * change[..., None, :]


def interpolate(distances: Any, grid: Any, low: Any, high: Any) -> Any:
    """Interpolate a grid of distances trilinearly, with the operators of the library that made the arrays.

    Parameters
    ----------
    distances : (nx, ny, nz)
        Samples at voxel centres.
    grid : (..., 3)
        Positions in grid space, where voxel centres are at whole numbers.
    low, high : (..., 3) integers
        Lower and upper corner of the cells that contain the positions.

    Returns
    -------
    (...)
        Trilinear values.
    """
    part = grid - low
    total = 0
    for corner in np.ndindex(2, 2, 2):
        rows = tuple((high if bit else low)[..., axis] for axis, bit in enumerate(corner))
        weights = [part[..., axis] if bit else 1 - part[..., axis] for axis, bit in enumerate(corner)]
        total = total + weights[0] * weights[1] * weights[2] * distances[rows]
    return total
