"""Helpers that all queries of a mesh share: sign methods, limits of positions, and rows of faces."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError
from ..base.notices import warn_surface
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh

Sign = Literal["auto", "winding", "parity", "pseudonormal", "normal", "unsigned"]

#: Largest distance of a point from the centre of the mesh, in mesh sizes. The core squares it in float64.
MAX_POINT_REACH = 1e36


def choices(sign: Sign, device: str) -> tuple[str, str]:
    """Check two options that are strings. The core checks their values."""
    return checks.text("sign", sign), checks.text("device", device)


def checked_points(mesh: MeshLike, points: object) -> tuple[Mesh, NDArray[np.float64], tuple[int, ...]]:
    """Check the mesh and the points; return the points as (n, 3) float64, and their leading shape."""
    flat, shape = checks.points(points)
    checked = as_mesh(mesh)
    check_reach("points", checked, flat, MAX_POINT_REACH)
    return checked, flat, shape


def check_reach(name: str, mesh: Mesh, positions: NDArray[np.float64], limit: float) -> None:
    """Raise ArgumentError for positions so far out that distances, in mesh sizes, would overflow."""
    if positions.size == 0:
        return
    # Plain floats are faster here: a NumPy reduction of three numbers takes longer than a query of one point.
    lower, upper = mesh.bounds.tolist()
    center = mesh.center.tolist()
    size = max(high - low for low, high in zip(lower, upper, strict=True))
    reach = max(float(positions.max()) - min(center), max(center) - float(positions.min()))
    if reach > limit * size:
        raise ArgumentError(
            f"{name}: {reach:.3g} away from a mesh of size {size:.3g} is too far; at most {limit:g} times its size"
        )


def source_faces(mesh: MeshLike, checked: Mesh, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert rows of the core to rows of a Mesh argument, or of the faces that were passed or read. -1 stays."""
    if mesh is checked:
        return faces
    rows: NDArray[np.int64] = np.where(faces >= 0, checked._core.source_faces[faces], -1)
    return rows


def warn_of_signs(mesh: Mesh, sign: str) -> None:
    """Issue one warning if the inside of the surface is ambiguous."""
    warn_surface(mesh._core.sign_warnings(sign))


def shaped(shape: tuple[int, ...], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Give results of points or rays, (n, ...) each, the leading shape of the points or rays."""
    return tuple(array.reshape(shape + array.shape[1:]) for array in arrays)
