"""Reading of shards. Errors name the damaged shard, bricks are kept in bounded memory, and several threads may read."""

from __future__ import annotations

import itertools
import threading
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import FormatError
from .layout import Layout, path_of, shard_key
from .store import REPAIR, Place, checked_array, read_array, reading, size_of, stored_keys

#: Memory of the bricks that a reader keeps, bytes.
CACHE_BYTES = 256 << 20

Triple = tuple[int, int, int]


class Reader:
    """The arrays of a store, and the bricks that were read last."""

    def __init__(self, place: Place, layout: Layout, group: Any) -> None:
        self.place, self.layout = place, layout
        self.fill = layout.fill
        self._group = group
        self._arrays = [
            checked_array(
                group,
                path_of(level),
                layout.level(level).shape[::-1],
                self.fill.dtype,
                layout.shard,
                layout.chunk,
                self.fill,
            )
            for level in range(layout.level_count)
        ]
        #: For each level an array (sx, sy, sz): whether each shard is stored.
        self.states = [
            _plan_array(group, f"far/states/{level}", layout.counts(level)[::-1], np.uint8).transpose(2, 1, 0) != 0
            for level in range(layout.level_count)
        ]
        #: Unsigned distances at the corners of the shards, (cz, cy, cx).
        corners = tuple(count + 1 for count in layout.counts(0)[::-1])
        self.far = np.abs(_plan_array(group, "far/distances", corners, np.float32).astype(np.float64))
        if not np.isfinite(self.far).all():
            raise FormatError(f"{place}: far/distances is not complete; {REPAIR}")
        self._known: set[tuple[int, Triple]] = set()
        self._bricks: OrderedDict[tuple[int, Triple], NDArray[Any]] = OrderedDict()
        self._most = max(64, CACHE_BYTES // (layout.chunk**3 * self.fill.dtype.itemsize))
        self._lock = threading.Lock()

    def read(self, level: int, low: Triple, size: Triple) -> NDArray[Any]:
        """Read the stored values of a box of `size` samples from index `low` on, (nz, ny, nx)."""
        shard = self.layout.shard
        first = [a // shard for a in low]
        last = [(a + n - 1) // shard + 1 for a, n in zip(low, size, strict=True)]
        box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        stored = self.states[level][box]
        if not stored.any():
            return np.full(size[::-1], self.fill)
        shards = [tuple((index + first).tolist()) for index in np.argwhere(stored)]
        for index in shards:
            self._check(level, index)
        part = tuple(slice(a, a + n) for a, n in zip(reversed(low), reversed(size), strict=True))
        with reading(self.place, path_of(level)):
            try:
                values = np.asarray(self._arrays[level][part])
            except Exception as error:
                self._blame(level, shards, error)
                raise
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise FormatError(f"{self.place}: {path_of(level)} has samples that are not finite; {REPAIR}")
        return values

    def _check(self, level: int, index: Triple) -> None:
        """Raise an error if a shard of the plan is missing in the store."""
        if (level, index) in self._known:
            return
        key = shard_key(level, index)
        size = size_of(self.place, self._group, key)
        if size is None:
            raise self._missing(key)
        if size == 0:
            # Zarr treats an empty file as a missing one.
            raise self._damage(key, "the file is empty")
        if self.place.folder is None:
            # A request takes long. The size of a file is read each time, since it may be deleted meanwhile.
            self._known.add((level, index))

    def require(self, level: int) -> None:
        """Raise an error if any shard of a level is missing in the store."""
        keys = stored_keys(self._group, level)
        for x, y, z in np.argwhere(self.states[level]).tolist():
            key = shard_key(level, (x, y, z))
            if key not in keys:
                raise self._missing(key)

    def _missing(self, key: str) -> FormatError:
        advice = "call bake_to_zarr with the same mesh and options to bake it"
        return FormatError(f"shard {key} of {self.place} is missing; {advice}")

    def _blame(self, level: int, shards: list[Triple], error: Exception) -> None:
        """Raise FormatError for the shard that cannot be read."""
        for index in shards:
            low, size = self.layout.box(level, index)
            part = tuple(slice(a, a + n) for a, n in zip(reversed(low), reversed(size), strict=True))
            try:
                self._arrays[level][part]
            except Exception as failure:  # each codec has errors of its own
                raise self._damage(shard_key(level, index), failure) from error

    def _damage(self, key: str, reason: object) -> FormatError:
        advice = "delete it and call bake_to_zarr with the same mesh and options"
        return FormatError(f"shard {key} of {self.place} is damaged: {reason}; {advice}")

    def bricks(self, level: int, requested: NDArray[np.int64]) -> NDArray[Any]:
        """Read the stored values of chunks (k, 3), (k, c, c, c) in z, y, x order; beyond the grid the fill value."""
        chunk = self.layout.chunk
        out = np.empty((len(requested), chunk, chunk, chunk), dtype=self.fill.dtype)
        missing = []
        with self._lock:
            for row, (x, y, z) in enumerate(requested.tolist()):
                brick = self._bricks.get((level, (x, y, z)))
                if brick is None:
                    missing.append(row)
                else:
                    self._bricks.move_to_end((level, (x, y, z)))
                    out[row] = brick
        if not missing:
            return out
        per_shard = self.layout.shard // chunk
        rows = np.array(missing)
        shards = requested[rows] // per_shard
        for shard in np.unique(shards, axis=0):
            of_shard = rows[(shards == shard).all(axis=1)]
            self._load(level, requested, of_shard, out)
        return out

    def _load(self, level: int, requested: NDArray[np.int64], rows: NDArray[np.int64], out: NDArray[Any]) -> None:
        """Read the bricks of one shard in one piece, and keep them."""
        chunk = self.layout.chunk
        low = requested[rows].min(axis=0) * chunk
        high = np.minimum((requested[rows].max(axis=0) + 1) * chunk, self.layout.level(level).shape)
        x, y, z = low.tolist()
        nx, ny, nz = (high - low).tolist()
        piece = self.read(level, (x, y, z), (nx, ny, nz))
        full = -(-np.array(piece.shape) // chunk) * chunk
        if tuple(full) != piece.shape:
            piece = np.pad(
                piece, [(0, b - a) for a, b in zip(piece.shape, full, strict=True)], constant_values=self.fill
            )
        for row in rows.tolist():
            x, y, z = (requested[row] * chunk - low).tolist()
            out[row] = piece[z : z + chunk, y : y + chunk, x : x + chunk]
            self._keep((level, tuple(requested[row].tolist())), out[row].copy())

    def _keep(self, key: Any, brick: NDArray[Any]) -> None:
        with self._lock:
            self._bricks[key] = brick
            while len(self._bricks) > self._most:
                self._bricks.popitem(last=False)

    def values_at(self, level: int, index: NDArray[np.int64]) -> NDArray[Any]:
        """Read the stored values at samples with the indices (n, 3), (n,)."""
        chunk = self.layout.chunk
        counts = -(-np.array(self.layout.level(level).shape) // chunk)
        brick, inner = index // chunk, index % chunk
        flat = (brick[:, 2] * counts[1] + brick[:, 1]) * counts[0] + brick[:, 0]
        unique, place = np.unique(flat, return_inverse=True)
        requested = np.stack(
            [unique % counts[0], unique // counts[0] % counts[1], unique // (counts[0] * counts[1])], axis=1
        )
        out = np.empty(len(index), dtype=self.fill.dtype)
        most = max(1, self._most // 2)
        order = np.argsort(place, kind="stable")
        edges = np.searchsorted(place[order], np.arange(0, len(unique) + most, most))
        for number, (start, stop) in enumerate(itertools.pairwise(edges.tolist())):
            rows = order[start:stop]
            if len(rows):
                first = number * most
                bricks = self.bricks(level, requested[first : first + most])
                x, y, z = inner[rows].T
                out[rows] = bricks[place[rows] - first, z, y, x]
        return out

    def blocks(
        self, level: int, cells: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[Any], NDArray[Any], NDArray[Any]]]:
        """Blocks of `cells`^3 cells, cell -1 first, in groups of about a shard.

        Yields the position of the first block of each group, (3,), the stored values (bz, by, bx, c + 1, c + 1, c + 1),
        and the least and the largest value of each block, (bz, by, bx). Samples outside the grid repeat its border.
        Groups that are wholly outside are left out.
        """
        shape = np.array(self.layout.level(level).shape)
        counts = -(-(shape + 1) // cells)
        per_group = max(1, self.layout.shard // cells)
        for group in np.ndindex(*(-(-counts // per_group))[::-1].tolist()):
            first = np.array(group[::-1], dtype=np.int64) * per_group
            blocks = np.minimum(per_group, counts - first)
            origin = first * cells - 1
            end = origin + blocks * cells + 1
            low, high = np.maximum(origin, 0), np.minimum(end, shape)
            x, y, z = low.tolist()
            nx, ny, nz = (high - low).tolist()
            last = (high - 1) // self.layout.shard + 1
            touched = tuple(
                slice(a, b) for a, b in zip((low // self.layout.shard).tolist(), last.tolist(), strict=True)
            )
            if not self.states[level][touched].any():
                continue
            values = self.read(level, (x, y, z), (nx, ny, nz))
            margins = [(a, b) for a, b in zip((low - origin).tolist(), (end - high).tolist(), strict=True)]
            padded = np.pad(values, margins[::-1], mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, (cells + 1,) * 3)
            least, largest = (_over_blocks(fold, padded, cells) for fold in (np.minimum, np.maximum))
            yield first, windows[::cells, ::cells, ::cells], least, largest


def _plan_array(group: Any, path: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    checked_array(group, path, shape, dtype, 0, 0, None)
    return read_array(group, path)


def _over_blocks(fold: np.ufunc, samples: NDArray[Any], cells: int) -> NDArray[Any]:
    """Fold the samples of each block, one axis after the other; blocks share the samples on their faces."""
    for axis in range(3):
        rows = np.moveaxis(samples, axis, 0)
        count = (len(rows) - 1) // cells
        folded = rows[: count * cells : cells].copy()
        for offset in range(1, cells + 1):
            fold(folded, rows[offset : offset + (count - 1) * cells + 1 : cells], out=folded)
        samples = np.moveaxis(folded, 0, axis)
    return samples
