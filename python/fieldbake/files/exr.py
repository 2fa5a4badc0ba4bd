"""OpenEXR files with one channel, ``Y``, compressed without loss (ZIP) on several threads.

A file is a header, a table with the position of each block, and the blocks of 16 rows:

    magic | version | attributes ... 0 | position of each block, uint64 | first row, size, deflate stream | ...

Before compression the even bytes of a block are placed before the odd ones, and each byte is replaced by its
difference from the byte before it. `zlib.Z_RLE` finds the long runs of equal bytes that result in half of the time of
a general search, and the files are 5 % longer. Blocks do not depend on the number of threads, so the bytes do not
either. Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html.
"""

from __future__ import annotations

import json
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.errors import FormatError
from ..base.threads import thread_count
from . import flipbook, sidecar
from .cursor import Cursor
from .formats import FieldFile, Format, Pages, PagesFile, Texels, shares
from .pages import pages_of
from .texture_files import as_texels

#: Rows of a block, and the code of the compression with such blocks.
BLOCK_ROWS, ZIP = 16, 3

#: Name of the attribute that has the metadata as JSON.
FACTS = "fieldbake"

#: Codes of the types of a channel.
TYPES = {np.dtype("<f2"): 1, np.dtype("<f4"): 2}


def write_channel(values: NDArray[Any], facts: dict[str, Any]) -> bytes:
    """Encode float16 or float32 values (height, width) and the metadata of a field or an atlas as an .exr file."""
    stored = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    height, width = stored.shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channel = b"Y\0" + struct.pack("<iB3xii", TYPES[stored.dtype], 0, 1, 1) + b"\0"
    header = b"v/1\x01" + struct.pack("<i", 2)
    for name, kind, content in (
        ("channels", "chlist", channel),
        ("compression", "compression", bytes([ZIP])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        (FACTS, "string", json.dumps(facts).encode()),
        ("lineOrder", "lineOrder", b"\0"),
        ("name", "string", b"fieldbake atlas"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ):
        header += f"{name}\0{kind}\0".encode() + struct.pack("<i", len(content)) + content
    header += b"\0"
    # zlib and NumPy release the lock of the interpreter.
    with ThreadPoolExecutor(thread_count()) as pool:
        blocks = list(pool.map(lambda row: _block(stored, row), range(0, height, BLOCK_ROWS)))
    first = len(header) + 8 * len(blocks)
    starts = first + np.cumsum([0, *(len(block) for block in blocks[:-1])], dtype="<u8")
    return b"".join([header, starts.astype("<u8").tobytes(), *blocks])


def _block(stored: NDArray[Any], row: int) -> bytes:
    """Compress the rows of a block, or store them if that is shorter."""
    rows = stored[row : row + BLOCK_ROWS]
    plain = rows.reshape(-1).view(np.uint8)
    sorted_bytes = np.concatenate([plain[0::2], plain[1::2]])
    differences = sorted_bytes.copy()
    np.subtract(sorted_bytes[1:], sorted_bytes[:-1], out=differences[1:])
    differences[1:] += 128
    stream = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    content = stream.compress(differences.data) + stream.flush()
    if len(content) >= plain.nbytes:
        content = plain.tobytes()
    return struct.pack("<2i", row, len(content)) + content


def _save(file: FieldFile) -> None:
    """Write the slices of a field as tiles of one image."""
    encoding = file.options.encoding or "float32"
    scale = encodings.scale_of(encoding, file.field.spacing, 1.0)
    engine = file.field.way.engine
    columns = 1 if file.options.columns is None and engine == "godot" else file.options.columns
    sheet = flipbook.arrange(file.field.resolution, columns, upwards=engine == "unity")
    facts = {**file.facts(encoding, scale), "sheet": sheet.facts()}
    content = write_channel(flipbook.to_pixels(as_texels(file.field.distances, encoding, scale), sheet), facts)
    with sidecar.write(file.target, facts) as stream:
        stream.write(content)
    if engine == "unity":
        flipbook.write_unity(file.target, sheet, encoding)
    elif engine == "godot":
        flipbook.write_godot(file.target, sheet)


def _save_pages(file: PagesFile) -> None:
    """Write the pages of an atlas. An .exr stores the value that a sampler returns for a normalised integer."""
    stacked = file.stacked
    facts = file.header()
    content = write_channel(stacked if stacked.dtype.kind == "f" else shares(stacked), facts)
    with sidecar.write(file.target, facts) as stream:
        stream.write(content)


def _load(path: Path) -> Texels | Pages:
    """Read the sheet of a field or the pages of an atlas, as the metadata in the file states.

    A file of version 0.2 has its metadata in the JSON beside it only.
    """
    content = path.read_bytes()
    facts = _facts(content)
    if facts is None:
        content, facts = sidecar.read_both(path)
    if facts.get("kind") != "volume texture":
        return pages_of(content, facts, _read_pages)
    sidecar.expect(facts, "volume texture")
    sizes = facts.get("resolution")
    sheet = flipbook.read_sheet(facts.get("sheet"), sizes if isinstance(sizes, list) else [])
    encoding = checks.choice("encoding", facts.get("encoding"), ("float32", "float16"), FormatError)
    texels = _core.exr_read(content, *sheet.size, encoding)
    pixels = np.frombuffer(bytearray(texels), encodings.DTYPES[encoding])
    return Texels(flipbook.from_pixels(pixels, sheet), encoding, facts)


def _facts(content: bytes) -> dict[str, Any] | None:
    """Parse the metadata in the header of a file; None if it has none."""
    cursor = Cursor(content, at=len(_MAGIC[0]) + 4)
    while name := cursor.name():
        cursor.name()  # the type
        value = cursor.take(cursor.one("<i"))
        if name == FACTS:
            return sidecar.parse(bytes(value))
    return None


def _read_pages(data: bytes, width: int, height: int, encoding: str) -> NDArray[Any]:
    content = _core.exr_read(data, width, height, encoding)
    if encoding.startswith("float"):
        return np.frombuffer(bytearray(content), encodings.DTYPES[encoding])
    values = np.frombuffer(content, np.float32)
    if not (np.abs(values) <= 1).all():
        raise FormatError("normalised texels must be from -1 to 1")
    texel = encodings.DTYPES[encoding]
    # Rounding recovers the integer.
    return np.round(values.astype(np.float64) * np.iinfo(texel).max).astype(texel)


_MAGIC = (b"\x76\x2f\x31\x01",)

FORMATS = (
    Format(
        ".exr", ("volume", "quantized"), _save, _load, _MAGIC, ("float32", "float16"), ("columns",), has_sidecar=True
    ),
    Format(".exr", ("atlas",), _save_pages, _load, _MAGIC, has_sidecar=True),
)
