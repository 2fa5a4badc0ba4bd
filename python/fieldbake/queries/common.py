"""Helpers that all queries of a mesh share: sign methods, limits of positions, and rows of faces."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.notices import warn_surface
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh

Sign = Literal["auto", "winding", "parity", "pseudonormal", "normal", "unsigned"]


def choices(sign: Sign, device: str) -> tuple[str, str]:
    """Check two options that are strings. The core checks their values."""
    return checks.text("sign", sign), checks.text("device", device)


def checked_points(mesh: MeshLike, points: object) -> tuple[Mesh, NDArray[np.float64], tuple[int, ...]]:
    """Check the mesh and the points; return the points as (n, 3) float64, and their leading shape."""
    flat, shape = checks.points(points)
    return as_mesh(mesh), flat, shape


def source_faces(mesh: MeshLike, checked: Mesh, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert rows of the core to rows of a Mesh argument, or of the faces that were passed or read. -1 stays."""
    kept = checked._core.source_faces
    if mesh is checked or kept is None:
        return faces
    rows: NDArray[np.int64] = np.where(faces >= 0, kept[faces], -1)
    return rows


def warn_of_signs(mesh: Mesh, sign: str) -> None:
    """Issue one warning if the inside of the surface is ambiguous."""
    warn_surface(mesh._core.sign_warnings(sign))


def shaped(shape: tuple[int, ...], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Give results of points or rays, (n, ...) each, the leading shape of the points or rays."""
    return tuple(array.reshape(shape + array.shape[1:]) for array in arrays)
