"""OpenVDB files, versions 222 to 224: the reader of scalar grids with the standard tree.

The layout is described in :mod:`.openvdb`. Values may be floats or halves; plain, or packed by zip or Blosc; with or
without the inactive values. Every size is compared with the number of bytes of the file before anything is unpacked.
The dense grid may have at most `VOXELS_PER_BYTE` voxels for each byte of the file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import CapacityError, Error, FormatError
from ...base.optional import optional_module
from ..compression import inflate
from ..cursor import Cursor
from .band_blocks import SIDE
from .openvdb import ACTIVE_MASK, BLOSC, HALF_SUFFIX, LOWER, LOWER_VOXELS, MAGIC, TREE, UPPER, UPPER_VOXELS, ZIP

#: Versions with this layout. OpenVDB 2 wrote the first of them.
VERSIONS = range(222, 225)
#: Voxels of a dense grid that are always allowed, and those allowed for each byte of a file. A closed surface in a grid
#: of 4096^3 voxels takes about one byte for 100 of them.
LEAST_VOXELS, VOXELS_PER_BYTE = 1 << 22, 1024
#: Blosc pads the data to a multiple of this size before packing.
BLOSC_LEAST = 128
#: How the values of a node are stored.
BACKGROUND, MINUS_BACKGROUND, ONE_VALUE, SIGNS, SIGN_AND_VALUE, TWO_VALUES, ALL_VALUES = range(7)
#: Largest magnitude of a voxel's index.
FARTHEST = 1 << 28

_MAPS = {
    "UniformScaleMap": (False, 5),
    "ScaleMap": (False, 5),
    "UniformScaleTranslateMap": (True, 6),
    "ScaleTranslateMap": (True, 6),
    "TranslationMap": (True, 1),
}


@dataclass
class VdbGrid:
    """One grid of a file.

    Attributes
    ----------
    name, kind : str
        Name and class of the grid; the class of distances is ``"level set"``.
    metadata : dict
        Strings of the grid.
    background : float
        Value of all voxels that have no value of their own.
    origin, spacing : (3,) float64
        World position of the index (0, 0, 0), which is the centre of that voxel, and size of a voxel.
    corners : list of (3,) int, and values : list of (8, 8, 8) float32
        The leaves.
    active : list of (8, 8, 8) bool
        Active voxels of the leaves.
    tiles : list of (corner, voxels along a side, value)
        Regions of one value other than the background.
    """

    name: str
    metadata: dict[str, str]
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    spacing: NDArray[np.float64] = field(default_factory=lambda: np.ones(3))
    background: float = 0.0
    corners: list[tuple[int, int, int]] = field(default_factory=list)
    values: list[NDArray[np.float32]] = field(default_factory=list)
    active: list[NDArray[np.bool_]] = field(default_factory=list)
    tiles: list[tuple[tuple[int, int, int], int, float]] = field(default_factory=list)
    file_bytes: int = 0

    @property
    def kind(self) -> str:
        """Class of the grid."""
        return self.metadata.get("class", "unknown")

    def active_box(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the first and last index of the active voxels, (3,) each."""
        low, high = np.full(3, FARTHEST), np.full(3, -FARTHEST)
        for corner, active in zip(self.corners, self.active, strict=True):
            held = np.argwhere(active)
            if len(held):
                low = np.minimum(low, held.min(axis=0) + corner)
                high = np.maximum(high, held.max(axis=0) + corner)
        if (low > high).any():
            raise FormatError(f"grid '{self.name}' has no active voxel")
        return low, high

    def dense(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.float32]:
        """Make an array of the values of all voxels from index `low` to index `high`, both included, x fastest."""
        shape = [int(n) for n in high - low + 1]
        count = shape[0] * shape[1] * shape[2]
        if min(shape) < 1 or count > max(LEAST_VOXELS, VOXELS_PER_BYTE * self.file_bytes):
            text = " x ".join(map(str, shape))
            raise CapacityError(
                f"grid '{self.name}' would take {text} voxels as a dense grid, more than {VOXELS_PER_BYTE} for each "
                "byte of the file"
            )
        distances = np.full(shape, self.background, np.float32, order="F")
        for corner, side, value in self.tiles:
            where = _overlap(corner, side, low, shape)
            if where is not None:
                distances[where[0]] = value
        for corner, values in zip(self.corners, self.values, strict=True):
            where = _overlap(corner, SIDE, low, shape)
            if where is not None:
                distances[where[0]] = values[where[1]]
        return distances


def _overlap(corner: Any, side: int, low: Any, shape: list[int]) -> tuple[Any, Any] | None:
    """Compute the slices of a grid and of a cube at `corner` where they overlap; None if they do not."""
    here, there = [], []
    for at, start, size in zip(corner, low, shape, strict=True):
        first = int(at) - int(start)
        begin, end = max(first, 0), min(first + side, size)
        if begin >= end:
            return None
        here.append(slice(begin, end))
        there.append(slice(begin - first, end - first))
    return tuple(here), tuple(there)


def read(data: bytes) -> VdbGrid:
    """Read the level set of a file, or its first float grid."""
    cursor = Cursor(data)
    if bytes(cursor.take(8)) != MAGIC:
        raise FormatError("is not an OpenVDB file")
    version = cursor.one("<I")
    if version not in VERSIONS:
        raise FormatError(f"is OpenVDB version {version}; versions 222 to 224 are read: save it again with OpenVDB 3+")
    _, _, has_offsets = cursor.unpack("<IIB")
    if not has_offsets:
        raise FormatError("the grids have no offsets; write the file again, and not to a stream")
    cursor.take(36)
    _metadata(cursor)
    count = cursor.one("<I")
    found: list[tuple[str, str]] = []
    chosen: VdbGrid | None = None
    for _ in range(min(count, len(data) // 32)):
        name, tree = _text(cursor).split("\x1e")[0], _text(cursor)
        parent = _text(cursor)
        at, _, end = cursor.unpack("<3q")
        grid = None
        found.append((name, tree))
        if tree in (TREE, TREE + HALF_SUFFIX) and not parent:
            cursor.seek(at)
            compression = cursor.one("<I")
            grid = VdbGrid(name, _metadata(cursor), file_bytes=len(data))
            if chosen is None or (chosen.kind != "level set" and grid.kind == "level set"):
                chosen = grid
                _Reader(cursor, grid, compression, tree.endswith(HALF_SUFFIX)).read()
                if grid.kind == "level set":
                    break
        if end <= at:
            raise FormatError(f"grid '{name[:60]}' ends before it starts")
        cursor.seek(end)
    if chosen is None:
        listed = ", ".join(f"{name[:40]} ({tree[:40]})" for name, tree in found[:8]) or "none"
        raise FormatError(f"has no grid of the type {TREE}; its grids: {listed}")
    if chosen.kind == "fog volume":
        raise FormatError(f"grid '{chosen.name}' is a fog volume, whose values are densities, not distances")
    return chosen


def _text(cursor: Cursor) -> str:
    content = bytes(cursor.take(cursor.one("<I")))
    return content.decode("utf-8", "replace")


def _metadata(cursor: Cursor) -> dict[str, str]:
    """The strings among the metadata."""
    strings = {}
    for _ in range(cursor.one("<I")):
        name, kind = _text(cursor), _text(cursor)
        content = bytes(cursor.take(cursor.one("<I")))
        if kind == "string":
            strings[name] = content.decode("utf-8", "replace")
    return strings


class _Reader:
    """Reads the parts of a grid after its metadata."""

    def __init__(self, cursor: Cursor, grid: VdbGrid, compression: int, is_half: bool) -> None:
        self.cursor, self.grid = cursor, grid
        self.compression, self.is_half = compression, is_half
        self.background = np.float32(0)

    def read(self) -> None:
        """Read the map, the topology and the voxels."""
        self._map()
        cursor = self.cursor
        if cursor.one("<I") != 1:
            raise FormatError("a tree must have one buffer")
        self.background = np.float32(cursor.one("<f"))
        if not np.isfinite(self.background):
            raise FormatError("the background is not finite")
        self.grid.background = float(self.background)
        tiles, children = cursor.unpack("<2I")
        for _ in range(tiles):
            *corner, value, _ = cursor.unpack("<3ifB")
            self._tile(self._corner(corner), UPPER_VOXELS, value)
        for _ in range(children):
            self._internal(self._corner(cursor.unpack("<3i")), UPPER, LOWER_VOXELS)
        for _ in self.grid.corners:
            mask = self._mask(SIDE)
            values = self._values(mask)
            self.grid.active.append(mask.reshape(SIDE, SIDE, SIDE))
            self.grid.values.append(values.reshape(SIDE, SIDE, SIDE))

    def _corner(self, corner: Any) -> tuple[int, int, int]:
        x, y, z = corner
        if max(abs(x), abs(y), abs(z)) > FARTHEST:
            raise FormatError(f"a node lies at {list(corner)}, too far from the origin")
        return x, y, z

    def _map(self) -> None:
        kind = _text(self.cursor)
        if kind == "AffineMap":
            matrix = self.cursor.array(16, "<f8").reshape(4, 4)
            linear, origin = matrix[:3, :3], matrix[3, :3]
            if not np.array_equal(linear, np.diag(np.diag(linear))):
                raise FormatError("the grid is rotated or sheared; resample it onto an axis-aligned grid")
            scale = np.diag(linear)
        elif kind in _MAPS:
            is_moved, count = _MAPS[kind]
            vectors = self.cursor.array(3 * count, "<f8").reshape(count, 3)
            origin = vectors[0] if is_moved else np.zeros(3)
            scale = np.ones(3) if kind == "TranslationMap" else vectors[1 if is_moved else 0]
        else:
            raise FormatError(f"the grid has the transform {kind[:60]!r}; scales and translations are read")
        if not (np.isfinite(origin).all() and np.isfinite(scale).all() and (scale > 0).all()):
            raise FormatError("the transform of the grid is not a positive scale")
        self.grid.origin, self.grid.spacing = np.array(origin), np.array(scale)

    def _mask(self, side: int) -> NDArray[np.bool_]:
        bits = self.cursor.array(side**3 // 8, "u1")
        return np.unpackbits(bits, bitorder="little").view(np.bool_)

    def _values(self, active: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Read the values of a node; see ``readCompressedValues`` of OpenVDB."""
        rule = self.cursor.one("b")
        if not BACKGROUND <= rule <= ALL_VALUES:
            raise FormatError(f"a node stores its values by the unknown rule {rule}")
        others = [self.background if rule == BACKGROUND else -self.background, self.background]
        if rule in (ONE_VALUE, SIGN_AND_VALUE, TWO_VALUES):
            others[0] = np.float32(self.cursor.one("<f"))
        if rule == TWO_VALUES:
            others[1] = np.float32(self.cursor.one("<f"))
        selected = self._mask(round(len(active) ** (1 / 3))) if rule in (SIGNS, SIGN_AND_VALUE, TWO_VALUES) else None
        count = len(active)
        is_partial = bool(self.compression & ACTIVE_MASK) and rule != ALL_VALUES
        if is_partial:
            count = int(active.sum())
        stored = self._numbers(count)
        if not np.isfinite(stored).all():
            raise FormatError("a value is not finite")
        if not is_partial:
            return stored
        values = np.full(len(active), others[0], np.float32)
        if selected is not None:
            values[selected] = others[1]
        if not np.isfinite(values).all():
            raise FormatError("a value is not finite")
        values[active] = stored
        return values

    def _numbers(self, count: int) -> NDArray[np.float32]:
        kind = "<f2" if self.is_half else "<f4"
        if self.is_half and not count:
            return np.empty(0, np.float32)
        size = count * np.dtype(kind).itemsize
        content: bytes | memoryview
        if self.compression & (ZIP | BLOSC):
            packed = self.cursor.one("<q")
            if packed <= 0:
                if -packed != size:
                    raise FormatError(f"a node has {-packed} bytes, expected {size}")
                content = self.cursor.take(size)
            elif self.compression & BLOSC:
                content = unpack_blosc(self.cursor.take(packed), max(size, BLOSC_LEAST))[:size]
            else:
                content = inflate(self.cursor.take(packed), size)
        else:
            content = self.cursor.take(size)
        if len(content) != size:
            raise FormatError(f"a node has {len(content)} bytes, expected {size}")
        return np.frombuffer(content, kind).astype(np.float32)

    def _tile(self, corner: tuple[int, int, int], side: int, value: float) -> None:
        if not np.isfinite(value):
            raise FormatError("a tile is not finite")
        if np.float32(value) != self.background:
            self.grid.tiles.append((corner, side, float(value)))

    def _internal(self, corner: tuple[int, int, int], side: int, step: int) -> None:
        """Read an internal node with `side` children of `step` voxels along each axis, and the nodes below it."""
        children, active = self._mask(side), self._mask(side)
        values = self._values(active)
        own = np.flatnonzero(~children & (values != self.background))
        for slot in own.tolist():
            self._tile(child_corner(corner, slot, side, step), step, float(values[slot]))
        for slot in np.flatnonzero(children).tolist():
            at = child_corner(corner, slot, side, step)
            if step == SIDE:
                self._mask(SIDE)
                self.grid.corners.append(at)
            else:
                self._internal(at, LOWER, SIDE)


def unpack_blosc(buffer: memoryview, most: int) -> bytes:
    """Unpack a buffer of the library Blosc 1, the default of OpenVDB files, of at most `most` bytes.

    The header has the size of the content and of the buffer; both are compared before the package numcodecs unpacks.
    """
    _, size, _, packed_size = Cursor(buffer).unpack("<4s3I")  # type: ignore[arg-type]
    if not size <= most or packed_size != len(buffer):
        raise FormatError("a Blosc buffer has a damaged header")
    try:
        library = optional_module("numcodecs.blosc", "a .vdb file with Blosc", extra="blosc")
    except Error as error:
        raise FormatError(f"{error}, or save the file again with zip") from None
    try:
        return bytes(library.decompress(buffer))
    except (RuntimeError, ValueError) as error:
        raise FormatError(f"a Blosc buffer is damaged ({error})") from None


def child_corner(corner: tuple[int, int, int], slot: int, side: int, step: int) -> tuple[int, int, int]:
    """Compute the index of the first voxel of the child in a slot of a node."""
    x, y, z = corner
    return x + slot // (side * side) * step, y + slot // side % side * step, z + slot % side * step
