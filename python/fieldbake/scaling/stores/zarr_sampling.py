"""Samples, gradients and lower bounds of a truncated field in a Zarr store."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from .layout import Layout
from .reader import Reader

#: Lower bounds are reduced by this fraction, which covers the rounding of stored distances.
ROUNDING = 1e-6


class Sampler:
    """The function that a store represents, evaluated at checked points, (n, 3) float64 in world units.

    Parameters
    ----------
    layout, reader
        The layout and the reader of the store.
    """

    def __init__(self, layout: Layout, reader: Reader) -> None:
        self.reader, self.far = reader, reader.far
        self.scale = layout.scale
        self.lower, self.upper = np.array(layout.lower), np.array(layout.upper)
        self.inner = np.array(layout.inner)
        self.shape, self.spacing = np.array(layout.shape), np.array(layout.spacing)
        #: Size of a shard, world units.
        self.shard = self.spacing * layout.shard
        #: Smallest magnitude of a clamped sample, world units.
        self.cut = abs(float(self.decode(np.array([reader.fill]))[0])) * (1 - ROUNDING)

    def sample(self, points: NDArray[np.float64], filter: str) -> NDArray[np.float64]:
        """Distances within the band, and lower bounds with the sign beyond it, (n,).

        A point in the outer half voxel of the box has the distance at the nearest point of the hull of the centres.
        """
        places = self._hull(points)
        corners, share = self._cells(places)
        centers = self.lower + (places + 0.5) * self.spacing
        values = _trilinear(corners, share)
        far = self._is_far(corners)
        if filter == "nearest":
            rounded = (share >= 0.5).astype(np.int64)
            values = corners[np.arange(len(corners)), rounded[:, 0], rounded[:, 1], rounded[:, 2]]
        # Jensen's inequality for the squares of the samples: see the core's module on bounds outside a box.
        variance = (self.spacing**2 * share * (1 - share)).sum(axis=1)
        squares = np.maximum(_trilinear(corners**2, share) - variance, 0)
        outside = (places != (points - self.lower) / self.spacing - 0.5).any(axis=1)
        needed = far | outside
        squares[needed] = np.maximum(squares[needed], self.far_bound(centers[needed]) ** 2)
        bound = np.sqrt(squares) * (1 - ROUNDING)
        bound[outside] = self._outside(points[outside], centers[outside], squares[outside])
        values = np.where(far, np.copysign(bound, corners[:, 0, 0, 0]), values)
        in_box = ((points >= self.lower) & (points <= self.upper)).all(axis=1)
        found: NDArray[np.float64] = np.where(in_box, values, bound)
        return found

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Slopes of the trilinear field, and beyond the band of the distances at the corners of shards, (n, 3)."""
        places = self._hull(points)
        corners, share = self._cells(places)
        slopes: NDArray[np.float64] = _slopes(corners, share) / self.spacing
        far = self._is_far(corners)
        if far.any():
            centers = self.lower + (places[far] + 0.5) * self.spacing
            around, share = self._far_cells(centers)
            coarse = _slopes(around, np.clip(share, 0, 1)) / self.shard
            coarse /= np.maximum(np.linalg.norm(coarse, axis=1, keepdims=True), 1)
            slopes[far] = coarse * np.sign(corners[far, 0, 0, 0])[:, None]
        return slopes

    def far_bound(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """A lower bound of the unsigned distance, from the corners of the shards."""
        corners, share = self._far_cells(points)
        within = ((share >= 0) & (share <= 1)).all(axis=1)
        clipped = np.clip(share, 0, 1)
        variance = (self.shard**2 * clipped * (1 - clipped)).sum(axis=1)
        found = np.sqrt(np.maximum(_trilinear(corners**2, clipped) - variance, 0)) * within
        # The distance changes by at most the distance to the corner.
        low, high = (share * self.shard) ** 2, ((share - 1) * self.shard) ** 2
        for i in range(8):
            x, y, z = i >> 2, i >> 1 & 1, i & 1
            way = (high if x else low)[:, 0] + (high if y else low)[:, 1] + (high if z else low)[:, 2]
            found = np.maximum(found, corners[:, x, y, z] - np.sqrt(way))
        bound: NDArray[np.float64] = np.maximum(found * (1 - ROUNDING), 0)
        return bound

    def decode(self, codes: NDArray[Any]) -> NDArray[np.float64]:
        """Distances of stored values, world units."""
        if not codes.size:
            return np.zeros(codes.shape)
        values = _core.decode(np.asfortranarray(codes.reshape(-1, 1, 1)), self.scale)
        return np.asarray(values, dtype=np.float64).reshape(codes.shape)

    def _hull(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (n, 3) in voxels, moved to the hull of the voxel centres."""
        places = (points - self.lower) / self.spacing - 0.5
        clipped: NDArray[np.float64] = np.clip(places, 0, self.shape - 1.0)
        return clipped

    def _cells(self, places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances at the eight samples around each place, (n, 2, 2, 2) in x, y, z order, and the fractions (n, 3)."""
        last = self.shape - 1
        base = np.minimum(np.floor(places), np.maximum(last - 1, 0)).astype(np.int64)
        offsets = np.array([[i >> 2, i >> 1 & 1, i & 1] for i in range(8)])
        index = np.minimum(base[:, None] + offsets, last).reshape(-1, 3)
        return self.decode(self.reader.values_at(0, index)).reshape(-1, 2, 2, 2), places - base

    def _is_far(self, corners: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether all samples of a cell are clamped and on the same side, (n,)."""
        low, high = corners.min(axis=(1, 2, 3)), corners.max(axis=(1, 2, 3))
        far: NDArray[np.bool_] = (low >= self.cut) | (high <= -self.cut)
        return far

    def _outside(
        self, points: NDArray[np.float64], centers: NDArray[np.float64], squares: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Lower bounds outside the hull, from the squared bounds at its nearest points and the box of the surface."""
        away = np.linalg.norm(points - centers, axis=1)
        to_inner = np.linalg.norm(points - np.clip(points, *self.inner), axis=1)
        half = self.spacing / 2
        lower, upper = self.lower + half, self.upper - half
        if (self.inner[0] >= lower).all() and (self.inner[1] <= upper).all():
            found = np.maximum(np.sqrt(away**2 + squares), to_inner)
        else:
            found = np.maximum(np.sqrt(squares) - away, to_inner)
        bound: NDArray[np.float64] = np.maximum(found, 0) * (1 - ROUNDING)
        return bound

    def _far_cells(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances at the corners of the shard of each point, (n, 2, 2, 2) in x, y, z order, and fractions (n, 3)."""
        places = (points - self.lower) / self.shard
        last = np.array(self.far.shape[::-1]) - 2
        base = np.clip(np.floor(places), 0, last).astype(np.int64)
        corners = np.empty((len(points), 2, 2, 2))
        for i in range(8):
            x, y, z = i >> 2, i >> 1 & 1, i & 1
            corners[:, x, y, z] = self.far[base[:, 2] + z, base[:, 1] + y, base[:, 0] + x]
        return corners, places - base


def _trilinear(corners: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate (n, 2, 2, 2) at fractions (n, 3)."""
    x, y, z = share.T
    along_x = corners[:, 0] * (1 - x)[:, None, None] + corners[:, 1] * x[:, None, None]
    along_y = along_x[:, 0] * (1 - y)[:, None] + along_x[:, 1] * y[:, None]
    values: NDArray[np.float64] = along_y[:, 0] * (1 - z) + along_y[:, 1] * z
    return values


def _slopes(corners: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of the trilinear function along x, y and z, for cells of side 1, (n, 3)."""
    x, y, z = (part[:, None, None] for part in share.T)

    def mean(differences: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        rows = differences[:, 0] * (1 - a[:, :, 0]) + differences[:, 1] * a[:, :, 0]
        result: NDArray[np.float64] = rows[:, 0] * (1 - b[:, 0, 0]) + rows[:, 1] * b[:, 0, 0]
        return result

    return np.stack(
        [
            mean(corners[:, 1] - corners[:, 0], y, z),
            mean(corners[:, :, 1] - corners[:, :, 0], x, z),
            mean(corners[:, :, :, 1] - corners[:, :, :, 0], x, y),
        ],
        axis=1,
    )
