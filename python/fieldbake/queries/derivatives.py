"""First derivatives of distances and trilinear samples, for the functions of PyTorch and JAX."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ArgumentError, Error
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
    """Evaluate the signed distance and its first derivatives, in the dtype of the points, or float64 for integers."""
    if mesh is not None and not isinstance(mesh, Mesh):
        raise ArgumentError(f"mesh: must be a Mesh of the same vertices and faces, got {type(mesh).__name__}")
    used = Mesh(vertices, faces) if mesh is None else mesh
    kept = used._core.source_faces
    if kept is not None and len(faces) > max(len(used.faces), kept[-1]):
        faces = faces[kept]
    if mesh is not None and not _is_made_of(mesh, vertices, faces):
        raise ArgumentError(
            f"mesh: its {len(mesh.vertices)} vertices and {len(mesh.faces)} faces differ from vertices of shape "
            f"{vertices.shape} and faces of shape {faces.shape}; pass a Mesh of both arrays, or none"
        )
    found = query(used, points)
    kind = points.dtype if points.dtype.kind == "f" else np.dtype(np.float64)
    return Linear(
        found.distances.astype(kind),
        found.gradients.astype(kind),
        faces[found.faces].astype(np.int64),
        found.barycentric.astype(kind),
    )


def _is_made_of(mesh: Mesh, vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Whether a mesh has the corners of these faces, after rounding to the dtype of the vertices."""
    if faces.shape != mesh.faces.shape:
        return False
    positions = mesh.vertices.astype(np.result_type(vertices, np.float16))
    if np.array_equal(faces, mesh.faces) and np.array_equal(vertices, positions):
        return True
    # A mesh drops vertices that are not finite and renumbers the others.
    is_valid = faces.min() >= 0 and faces.max() < len(vertices)
    return bool(is_valid) and np.array_equal(vertices[faces], positions[mesh.faces])


def check_shape(name: str, array: Any, shape: str, error: type[Error] = ArgumentError) -> None:
    """Check the shape of an array of any library, such as ``"(n, 3)"``, ``"(2, 3)"`` or ``"(..., 3)"``."""
    lengths, got = shape.strip("()").split(", "), tuple(array.shape)
    trailing = len(lengths) - 1 if lengths[0] == "..." else 0
    lengths, kept = (lengths[1:], got[-trailing:]) if trailing else (lengths, got)
    if len(kept) != len(lengths) or any(
        word.isdigit() and int(word) != length for word, length in zip(lengths, kept, strict=True)
    ):
        raise error(f"{name}: must have shape {shape}, got {got}")


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
