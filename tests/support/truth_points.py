"""Truth of clouds of points in float64 NumPy: the dipole sum and the distance to disks, over all points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Number of pairs evaluated at once.
PAIRS = 1 << 21


def _batches(count: int, others: int) -> list[slice]:
    step = max(1, PAIRS // others)
    return [slice(first, first + step) for first in range(0, count, step)]


def winding_number(points: Array, normals: Array, areas: Array, queries: Array) -> Array:
    """The sum ``a n.(p - q) / (4 pi |p - q|^3)`` at queries (m, 3), (m,)."""
    found = np.empty(len(queries))
    for rows in _batches(len(queries), len(points)):
        away = points - queries[rows, None]
        cubed = np.einsum("mnk,mnk->mn", away, away) ** 1.5
        found[rows] = (areas * np.einsum("mnk,nk->mn", away, normals) / cubed).sum(axis=1) / (4 * np.pi)
    return found


def distance_to_disks(points: Array, normals: Array, areas: Array, queries: Array) -> Array:
    """Unsigned distances to the union of the disks at queries (m, 3), (m,)."""
    found = np.empty(len(queries))
    radii = np.sqrt(areas / np.pi)
    for rows in _batches(len(queries), len(points)):
        away = queries[rows, None] - points
        height = np.einsum("mnk,nk->mn", away, normals)
        across = np.linalg.norm(away - height[..., None] * normals, axis=-1)
        found[rows] = np.hypot(height, np.maximum(across - radii, 0)).min(axis=1)
    return found
