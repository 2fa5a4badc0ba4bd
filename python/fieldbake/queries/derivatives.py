"""The query behind the differentiable distances of PyTorch and JAX."""

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
    rows = mesh._core.source_faces[found.faces]
    if rows.size and rows.max() >= len(faces):
        raise ArgumentError(f"mesh: has {len(mesh.faces)} faces, which are not those of faces ({len(faces)} rows)")
    kind = np.asarray(points).dtype
    return Linear(
        found.distances.astype(kind),
        found.gradients.astype(kind),
        np.asarray(faces)[rows].astype(np.int64),
        found.barycentric.astype(kind),
    )
