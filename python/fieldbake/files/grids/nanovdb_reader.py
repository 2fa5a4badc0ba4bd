"""NanoVDB files, ABI 32: the reader of float grids that are not compressed.

Every offset in a file is checked against its end. The number of visited nodes is limited by the number of bytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import FormatError
from ..cursor import Cursor
from .band_blocks import SIDE
from .nanovdb import (
    FLOAT,
    GRID_BYTES,
    LEAF,
    LEVEL_SET,
    LOWER_NODE,
    ROOT_BYTES,
    TILE_BYTES,
    UPPER_NODE,
)
from .openvdb import LOWER, LOWER_VOXELS, UPPER, UPPER_VOXELS
from .openvdb_reader import FARTHEST, VdbGrid, child_corner

#: "NanoVDB" followed by a digit.
_MAGIC = b"NanoVDB"
_ABI = 32
#: Bytes of the header of a file and of the metadata of a grid, and offset of the size of the name in the metadata.
_HEADER_BYTES, _FACTS_BYTES, _NAME_SIZE_AT = 16, 176, 136
#: Offsets in the record of a grid.
_MAP_AT, _CLASS_AT = 296, 632


def read(data: bytes) -> VdbGrid:
    """Read the only grid of a file, which holds floats."""
    cursor = Cursor(data)
    magic, version, count, codec = cursor.unpack("<8sI2H")
    if magic[:7] != _MAGIC:
        raise FormatError("is not a NanoVDB file")
    if version >> 21 != _ABI or codec:
        raise FormatError("is not an uncompressed NanoVDB file of ABI 32; save it again without a codec")
    if not count:
        raise FormatError("has no grid")
    cursor.seek(_HEADER_BYTES + _NAME_SIZE_AT)
    name_size = cursor.one("<I")
    cursor.seek(_HEADER_BYTES + _FACTS_BYTES * count)
    name = bytes(cursor.take(name_size)).rstrip(b"\0").decode("utf-8", "replace")
    if count > 1:
        raise FormatError(f"holds {count} grids; write a file with one grid only")
    return _Reader(memoryview(data)[cursor.at :], name, len(data)).grid


class _Reader:
    """Walks the tree of a grid, which is one block of memory."""

    def __init__(self, block: memoryview, name: str, file_bytes: int) -> None:
        self.block = block
        cursor = Cursor(block)  # type: ignore[arg-type]
        cursor.seek(_CLASS_AT)
        grid_class, grid_type = cursor.unpack("<2I")
        if grid_type != FLOAT:
            raise FormatError(f"grid '{name[:60]}' does not hold floats")
        kind = "level set" if grid_class == LEVEL_SET else "unknown"
        self.grid = VdbGrid(name, {"class": kind}, file_bytes=file_bytes)
        cursor.seek(_MAP_AT + 88)
        matrix, _, origin = cursor.array(9, "<f8"), cursor.array(9, "<f8"), cursor.array(3, "<f8")
        scale = matrix.reshape(3, 3).diagonal()
        is_plain = np.array_equal(matrix.reshape(3, 3), np.diag(scale)) and np.isfinite(origin).all()
        if not (is_plain and np.isfinite(scale).all() and (scale > 0).all()):
            raise FormatError("the transform of the grid is not a positive scale")
        self.grid.origin, self.grid.spacing = np.array(origin), np.array(scale)
        self.left = {kind: len(block) // kind.itemsize for kind in (UPPER_NODE, LOWER_NODE, LEAF)}
        cursor.seek(GRID_BYTES + 24)
        root_at = GRID_BYTES + cursor.one("<q")
        cursor.seek(root_at + 24)
        tiles, background = cursor.unpack("<If")
        if not np.isfinite(background):
            raise FormatError("the background is not finite")
        self.grid.background = float(background)
        for i in range(min(tiles, len(block) // TILE_BYTES)):
            cursor.seek(root_at + ROOT_BYTES + i * TILE_BYTES)
            key, child, _, value = cursor.unpack("<QqIf")
            corner = tuple(_signed(key >> shift & 0x1FFFFF) * UPPER_VOXELS for shift in (42, 21, 0))
            if max(map(abs, corner)) > FARTHEST:
                raise FormatError(f"a node lies at {list(corner)}, too far from the origin")
            if child:
                self._node(root_at + child, corner, UPPER, LOWER_VOXELS)
            else:
                self._tile(corner, UPPER_VOXELS, value)

    def _record(self, at: int, kind: np.dtype[Any]) -> NDArray[Any]:
        self.left[kind] -= 1
        if self.left[kind] < 0 or not 0 <= at <= len(self.block) - kind.itemsize:
            raise FormatError(f"a node at byte {at} is not in the file, or the tree has a loop")
        record: NDArray[Any] = np.frombuffer(self.block, kind, 1, at)[0]
        return record

    def _tile(self, corner: Any, side: int, value: float) -> None:
        if not np.isfinite(value):
            raise FormatError("a tile is not finite")
        if np.float32(value) != np.float32(self.grid.background):
            self.grid.tiles.append((corner, side, float(value)))

    def _node(self, at: int, corner: Any, side: int, step: int) -> None:
        node = self._record(at, UPPER_NODE if side == UPPER else LOWER_NODE)
        children = np.unpackbits(node["child_mask"], bitorder="little").view(np.bool_)
        values = np.ascontiguousarray(node["table"]).view("<f4")[::2]
        for slot in np.flatnonzero(~children & (values != np.float32(self.grid.background))).tolist():
            self._tile(child_corner(corner, slot, side, step), step, float(values[slot]))
        for slot in np.flatnonzero(children).tolist():
            place, below = child_corner(corner, slot, side, step), at + int(node["table"][slot])
            if step == SIDE:
                self._leaf(below, place)
            else:
                self._node(below, place, LOWER, SIDE)

    def _leaf(self, at: int, corner: Any) -> None:
        leaf = self._record(at, LEAF)
        values = np.array(leaf["values"], np.float32)
        if not np.isfinite(values).all():
            raise FormatError("a value is not finite")
        self.grid.corners.append(corner)
        self.grid.values.append(values.reshape(SIDE, SIDE, SIDE))
        active = np.unpackbits(leaf["mask"], bitorder="little").view(np.bool_)
        self.grid.active.append(active.reshape(SIDE, SIDE, SIDE))


def _signed(key: int) -> int:
    """Decode a voxel index shifted right by 12 bits: the lower 20 of the 21 bits of `key`, in two's complement."""
    key &= 0xFFFFF
    return key - (1 << 20) if key >= 1 << 19 else key
