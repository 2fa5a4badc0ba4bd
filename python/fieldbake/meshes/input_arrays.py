"""Checks of the arrays that a mesh is made from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import MeshError


def check_vertices(value: ArrayLike) -> NDArray[Any]:
    """Check real positions (n, 3), or raise MeshError. The core checks the values of the vertices that are used."""
    array = checks.real_array("vertices", value, "(n, 3)", MeshError)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"vertices: must have shape (n, 3), got {checks.describe(array)}")
    return array


def check_faces(value: ArrayLike) -> NDArray[np.uint32 | np.int64]:
    """Check whole numbers (m, 3), or raise MeshError. The core checks the range.

    The result is C-contiguous uint32 if the input is, else int64.
    """
    try:
        array = checks.as_array(value)
    except (ValueError, TypeError, RuntimeError, BufferError) as error:
        raise MeshError(f"faces: must be an array of shape (m, 3), got {checks.describe(value)} ({error})") from None
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 3), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = "; split polygons into triangles first" if array.ndim == 2 and array.shape[1] > 3 else ""
        raise MeshError(f"faces: must have shape (m, 3), got {checks.describe(array)}{hint}")
    if array.dtype.kind not in "iu":
        raise MeshError(
            f"faces: must be whole numbers, got dtype {array.dtype} (faces[0] = {array[0].tolist()}); "
            "convert with faces.astype(int)"
        )
    if array.dtype == np.uint32:
        return np.require(array, requirements=["C_CONTIGUOUS", "ALIGNED"])
    if array.dtype.kind == "u" and array.max() > np.iinfo(np.int64).max:
        raise MeshError(f"faces: index {array.max()} is out of range")
    return np.require(array, np.int64, ["C_CONTIGUOUS", "ALIGNED"])


def check_uv(value: ArrayLike, vertices: int) -> NDArray[np.float32]:
    """Check texture coordinates, one row per vertex, or raise MeshError."""
    array = checks.real_array("uv", value, "(n, 2)", MeshError)
    if array.shape != (vertices, 2):
        raise MeshError(f"uv: must have shape ({vertices}, 2), one row per vertex, got {checks.describe(array)}")
    with np.errstate(over="ignore"):
        coordinates = checks.as_float64(array).astype(np.float32)
    if not np.isfinite(coordinates).all():
        row = int(np.flatnonzero(~np.isfinite(coordinates).all(axis=1))[0])
        raise MeshError(f"uv[{row}]: must be finite, got {array[row].tolist()}")
    return coordinates


def check_colors(name: str, value: ArrayLike, count: int, row: str) -> NDArray[np.float32]:
    """Convert colours to (n, 4) float32, linear RGB and opacity, or raise MeshError. uint8 values are sRGB."""
    array = checks.real_array(name, value, "(n, 3) or (n, 4)", MeshError)
    if array.ndim != 2 or array.shape[0] != count or array.shape[1] not in (3, 4):
        expected = f"({count}, 3) or ({count}, 4), one row per {row}"
        raise MeshError(f"{name}: must have shape {expected}, got {checks.describe(array)}")
    colors = np.ones((count, 4), dtype=np.float32)
    if array.dtype == np.uint8:
        unit = array.astype(np.float64) / 255
        rgb = unit[:, :3]
        colors[:, :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        colors[:, 3 : array.shape[1]] = unit[:, 3:]
        return colors
    if array.dtype.kind != "f":
        raise MeshError(f"{name}: must be uint8 (sRGB) or real numbers (linear), got {checks.describe(array)}")
    if not (array >= 0).all() or not (array[:, 3:] <= 1).all() or not np.isfinite(array).all():
        raise MeshError(f"{name}: must be finite and not negative, opacity at most 1")
    colors[:, : array.shape[1]] = array
    return colors
