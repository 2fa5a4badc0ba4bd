"""3D textures with one channel and their mipmaps: ``.dds`` with the extended header, and ``.ktx2``.

Sources: "Programming Guide for DDS" (Microsoft), KTX File Format Specification 2.0 and Khronos Data Format
Specification 1.3. All numbers are little-endian. A DDS file stores level 0 first, a KTX2 file stores it last.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.encodings import TEXTURE_DTYPES
from ..base.errors import ArgumentError, FormatError
from . import sidecar
from .container import atomic_write
from .cursor import Cursor
from .formats import WRITER, FieldFile, Format, Texels

#: DXGI_FORMAT and VkFormat of each encoding.
DXGI = {"float32": 41, "float16": 54, "snorm16": 58, "snorm8": 63, "unorm8": 61}
VULKAN = {"float32": 100, "float16": 76, "snorm16": 71, "snorm8": 10, "unorm8": 9}

KTX_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
#: Offset of the level index, bytes of an entry, and most levels of a texture.
KTX_LEVELS_AT, KTX_LEVEL_BYTES, MAX_LEVELS = 80, 24, 31
#: Keys of the metadata and of the directions of x, y and z: right, up, and out of the picture ("o") or into it ("i").
KTX_FACTS, KTX_ORIENTATION = b"fieldbake", b"KTXorientation"

DDS_MAGIC, DDS_HEADER_BYTES, DDS_START = b"DDS ", 124, 148
DDS_TEXTURE_3D = 4
#: Largest number of bytes of texels in a DDS file.
DDS_LIMIT = 2**32 - 1


@dataclass(frozen=True)
class Texture:
    """A 3D texture.

    Attributes
    ----------
    encoding : str
        Name of the format of its texels.
    levels : list of (nx, ny, nz) arrays
        Texels, x fastest; each level has half the sides of the one before, rounded down, at least 1.
    facts : str
        Metadata of the field as JSON; empty in formats that cannot store it.
    """

    encoding: str
    levels: Sequence[NDArray[Any]]
    facts: str = ""


def level_shapes(shape: Sequence[int]) -> list[tuple[int, int, int]]:
    """List the shapes (nx, ny, nz) of all mipmaps, from the whole texture to a single texel."""
    shapes = []
    for level in range(max(shape).bit_length()):
        nx, ny, nz = (max(side >> level, 1) for side in shape)
        shapes.append((nx, ny, nz))
    return shapes


def _bytes(level: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(level.T, level.dtype.newbyteorder("<")).data.cast("B")


def write_dds(stream: IO[bytes], texture: Texture) -> None:
    """Write a DDS file."""
    total = sum(level.nbytes for level in texture.levels)
    if total > DDS_LIMIT:
        raise ArgumentError(f"path: a DDS file holds at most {DDS_LIMIT} bytes of texels, got {total}")
    width, height, depth = texture.levels[0].shape
    count = len(texture.levels)
    mipmapped = count > 1
    # Caps, height, width, pitch, pixel format, depth; then the number of mipmaps.
    flags = 0x1 | 0x2 | 0x4 | 0x8 | 0x1000 | 0x800000 | (0x20000 if mipmapped else 0)
    caps = 0x1000 | 0x8 | (0x400000 if mipmapped else 0)
    pitch = width * texture.levels[0].itemsize
    stream.write(DDS_MAGIC + struct.pack("<7I", DDS_HEADER_BYTES, flags, height, width, pitch, depth, count))
    # The pixel format has only the four characters. With the flag for RGB as well, readers would take the file for a
    # picture.
    stream.write(bytes(44) + struct.pack("<2I4s5I", 32, 0x4, b"DX10", 0, 0, 0, 0, 0))
    stream.write(struct.pack("<5I", caps, 0x200000, 0, 0, 0))
    stream.write(struct.pack("<5I", DXGI[texture.encoding], DDS_TEXTURE_3D, 0, 1, 0))
    for level in texture.levels:
        stream.write(_bytes(level))


def read_dds(data: bytes) -> Texture:
    """Read the texture of a DDS file with the extended header."""
    cursor = Cursor(data)
    if bytes(cursor.take(4)) != DDS_MAGIC:
        raise FormatError("is not a DDS file")
    size, _, height, width, _, depth, count = cursor.unpack("<7I")
    cursor.seek(76)
    format_size, format_flags, four = cursor.unpack("<2I4s")
    cursor.seek(128)
    dxgi, dimension, _, array_size, _ = cursor.unpack("<5I")
    if size != DDS_HEADER_BYTES or format_size != 32 or not format_flags & 0x4 or four != b"DX10":
        raise FormatError("the file has no extended DDS header")
    if dimension != DDS_TEXTURE_3D or array_size > 1:
        raise FormatError("must hold one 3D texture")
    encoding = _encoding(DXGI, dxgi)
    shapes = _shapes([width, height, depth], max(count, 1))
    levels = [_level(cursor, shape, encoding) for shape in shapes]
    if cursor.at != len(data):
        raise FormatError(f"{len(data) - DDS_START} bytes do not match {width} x {height} x {depth} texels")
    return Texture(encoding, levels)


def write_ktx2(stream: IO[bytes], texture: Texture, orientation: str, writer: str) -> None:
    """Write a KTX2 file; `orientation` is ``"ruo"`` for right-handed axes or ``"rui"`` for left-handed ones."""
    shape, itemsize = texture.levels[0].shape, texture.levels[0].itemsize
    descriptor = _descriptor(texture.encoding)
    pairs = bytearray()
    values = {KTX_ORIENTATION: orientation, b"KTXwriter": writer, KTX_FACTS: texture.facts}
    for key, value in sorted(values.items()):
        content = key + b"\0" + value.encode() + (b"" if key == KTX_FACTS else b"\0")
        pairs += struct.pack("<I", len(content)) + content + bytes(-len(content) % 4)
    descriptor_at = KTX_LEVELS_AT + KTX_LEVEL_BYTES * len(texture.levels)
    pairs_at = descriptor_at + len(descriptor)
    alignment = math.lcm(itemsize, 4)
    at = pairs_at + len(pairs)
    index = []
    for level in reversed(texture.levels):
        at += -at % alignment
        index.append((at, level.nbytes, level.nbytes))
        at += level.nbytes
    stream.write(KTX_MAGIC + struct.pack("<9I", VULKAN[texture.encoding], itemsize, *shape, 0, 1, len(index), 0))
    stream.write(struct.pack("<4I2Q", descriptor_at, len(descriptor), pairs_at, len(pairs), 0, 0))
    for entry in reversed(index):
        stream.write(struct.pack("<3Q", *entry))
    stream.write(descriptor + pairs)
    at = pairs_at + len(pairs)
    for level, (start, length, _) in zip(reversed(texture.levels), index, strict=True):
        stream.write(bytes(start - at))
        stream.write(_bytes(level))
        at = start + length


def _descriptor(encoding: str) -> bytes:
    """Make the data format descriptor: one basic block with one linear red sample."""
    dtype = TEXTURE_DTYPES[encoding]
    bits, qualifiers = 8 * dtype.itemsize, 0
    if dtype.kind == "f":
        qualifiers, lower, upper = 0xC0, struct.pack("<f", -1), struct.pack("<f", 1)
    elif dtype.kind == "i":
        largest = np.iinfo(dtype).max
        qualifiers, lower, upper = 0x40, struct.pack("<i", -largest), struct.pack("<i", largest)
    else:
        lower, upper = struct.pack("<I", 0), struct.pack("<I", np.iinfo(dtype).max)
    sample = struct.pack("<H2B4x", 0, bits - 1, qualifiers) + lower + upper
    # Khronos' basic descriptor, version 2, of RGB with the primaries of BT.709 and linear values.
    block = struct.pack("<I2H4B4B8B", 0, 2, 24 + len(sample), 1, 1, 1, 0, 0, 0, 0, 0, dtype.itemsize, *[0] * 7) + sample
    return struct.pack("<I", 4 + len(block)) + block


def read_ktx2(data: bytes) -> Texture:
    """Read the texture of a KTX2 file without supercompression."""
    cursor = Cursor(data)
    if bytes(cursor.take(12)) != KTX_MAGIC:
        raise FormatError("is not a KTX2 file")
    vulkan, _, width, height, depth, layers, faces, count, scheme = cursor.unpack("<9I")
    encoding = _encoding(VULKAN, vulkan)
    if scheme or layers > 1 or faces != 1 or count > MAX_LEVELS:
        raise FormatError("must hold one 3D texture without supercompression")
    _, _, pairs_at, pairs_size, _, _ = cursor.unpack("<4I2Q")
    shapes = _shapes([width, height, depth], max(count, 1))
    index = [cursor.unpack("<3Q") for _ in shapes]
    levels = []
    for shape, (offset, length, _) in zip(shapes, index, strict=True):
        if length != _size(shape, encoding):
            raise FormatError(f"{length} bytes do not match {' x '.join(map(str, shape))} texels")
        cursor.seek(offset)
        levels.append(_level(cursor, shape, encoding))
    cursor.seek(pairs_at)
    pairs = Cursor(bytes(cursor.take(pairs_size)))
    facts = ""
    while pairs.at + 4 <= len(pairs.data):
        key, _, value = bytes(pairs.take(pairs.one("<I"))).partition(b"\0")
        pairs.take(min(-pairs.at % 4, len(pairs.data) - pairs.at))
        if key == KTX_FACTS:
            facts = value.decode("utf-8", "replace")
    return Texture(encoding, levels, facts)


def _encoding(formats: dict[str, int], number: int) -> str:
    for name, value in formats.items():
        if value == number:
            return name
    names = json.dumps(list(formats))[1:-1]
    raise FormatError(f"a field has one channel, as {names}; the file has format {number}")


def _size(shape: tuple[int, int, int], encoding: str) -> int:
    return math.prod(shape) * TEXTURE_DTYPES[encoding].itemsize


def _shapes(shape: list[int], count: int) -> list[tuple[int, int, int]]:
    shapes = level_shapes(shape) if min(shape) > 0 else []
    if not 0 < count <= len(shapes):
        raise FormatError(f"a texture of {shape} texels cannot have {count} levels")
    return shapes[:count]


def _level(cursor: Cursor, shape: tuple[int, int, int], encoding: str) -> NDArray[Any]:
    dtype = TEXTURE_DTYPES[encoding]
    content = cursor.take(_size(shape, encoding))
    return np.array(np.frombuffer(content, dtype.newbyteorder("<")), dtype).reshape(shape, order="F")


def as_texels(distances: NDArray[np.float32], encoding: str, scale: float) -> NDArray[Any]:
    """Convert distances to texels."""
    if encoding == "unorm8":
        return encodings.to_unorm8(distances, scale)
    return distances if encoding == "float32" else _core.encode(distances, encoding, scale)


def _save(file: FieldFile) -> None:
    encoding = file.options.encoding or "float32"
    band = encodings.DEFAULT_BAND if file.options.band is None else file.options.band
    scale = encodings.scale_of(encoding, file.field.spacing, band)
    facts = file.facts(encoding, scale)
    levels = [file.field.distances]
    if file.options.mipmaps:
        corners = checks.triple(file.field.bounds[0]), checks.triple(file.field.bounds[1])
        for shape in level_shapes(file.field.resolution)[1:]:
            levels.append(_core.resample(levels[-1], *corners, shape, scale=1.0))
    texture = Texture(encoding, [as_texels(level, encoding, scale) for level in levels], json.dumps(facts))
    if file.target.suffix.lower() == ".dds":
        with sidecar.write(file.target, facts) as stream:
            write_dds(stream, texture)
    else:
        with atomic_write(file.target) as stream:
            write_ktx2(stream, texture, "rui" if file.field.way.handedness == "left" else "ruo", WRITER)


def _load_dds(path: Path) -> Texels:
    data, facts = sidecar.read_both(path)
    texture = read_dds(data)
    return Texels(texture.levels[0], texture.encoding, facts)


def _load_ktx2(path: Path) -> Texels:
    texture = read_ktx2(path.read_bytes())
    return Texels(texture.levels[0], texture.encoding, sidecar.parse(texture.facts))


_KINDS, _OPTIONS = ("volume", "quantized"), ("band", "mipmaps")

FORMATS = (
    Format(".dds", _KINDS, _save, _load_dds, (DDS_MAGIC,), tuple(TEXTURE_DTYPES), _OPTIONS, has_sidecar=True),
    Format(".ktx2", _KINDS, _save, _load_ktx2, (KTX_MAGIC[:7],), tuple(TEXTURE_DTYPES), _OPTIONS),
)
