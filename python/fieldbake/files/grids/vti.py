"""``.vti`` files: VTK's ImageData as XML, for ParaView, PyVista and VTK.

The samples are point data: VTK's points are the voxel centres. The writer appends the samples as raw bytes or as zlib
blocks. The reader accepts both, and also base64 and text within the XML.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import struct
import zlib
from pathlib import Path
from typing import IO, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...base.errors import FormatError
from .. import sidecar
from ..compression import inflate
from ..container import MAX_HEADER_BYTES, atomic_write
from ..cursor import Cursor
from ..formats import FieldFile, Format
from .grid_samples import GridSamples, as_samples, checked_count, samples_of

NAME = "distances"
#: Bytes of a compressed block.
BLOCK_BYTES = 1 << 20
_TYPES = {
    "Float32": "f4",
    "Float64": "f8",
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
}
_ZLIB = "vtkZLibDataCompressor"
_APPENDED = re.compile(rb'<AppendedData\s+encoding="(raw|base64)"\s*>\s*_')


def write(stream: IO[bytes], grid: GridSamples, *, compressed: bool) -> None:
    """Write a grid. Its metadata is JSON, in the text array ``fieldbake`` of the field data."""
    extent = " ".join(f"0 {side - 1}" for side in grid.samples.shape)
    codes = " ".join(map(str, [*json.dumps(grid.facts).encode(), 0]))
    compressor = f' compressor="{_ZLIB}"' if compressed else ""
    stream.write(
        f'<?xml version="1.0"?>\n'
        f'<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"{compressor}>\n'
        f'<ImageData WholeExtent="{extent}" Origin="{_words(grid.origin)}" Spacing="{_words(grid.spacing)}" '
        f'Direction="1 0 0 0 1 0 0 0 1">\n'
        f'<FieldData><DataArray type="String" Name="fieldbake" NumberOfTuples="1" format="ascii">{codes}</DataArray>'
        f"</FieldData>\n"
        f'<Piece Extent="{extent}"><PointData Scalars="{NAME}">'
        f'<DataArray type="Float32" Name="{NAME}" format="appended" offset="0"/>'
        f'</PointData><CellData/></Piece>\n</ImageData>\n<AppendedData encoding="raw">\n_'.encode()
    )
    content = np.ascontiguousarray(grid.samples.T, "<f4").data.cast("B")
    if compressed:
        pieces = [content[at : at + BLOCK_BYTES] for at in range(0, len(content), BLOCK_BYTES)]
        packed = [zlib.compress(piece, 3) for piece in pieces]
        last = len(content) % BLOCK_BYTES
        stream.write(struct.pack(f"<3Q{len(packed)}Q", len(packed), BLOCK_BYTES, last, *map(len, packed)))
        for piece in packed:
            stream.write(piece)
    else:
        stream.write(struct.pack("<Q", len(content)))
        stream.write(content)
    stream.write(b"\n</AppendedData>\n</VTKFile>\n")


def _words(vector: NDArray[np.float64]) -> str:
    return " ".join(repr(float(x)) for x in vector)


def read(data: bytes) -> GridSamples:
    """Read the grid of a file: the point data named ``distances``, or else the first numeric array."""
    start = _APPENDED.search(data)
    is_raw = start is not None and start[1] == b"raw"
    text = data if start is None else data[: start.start()] + b"</VTKFile>"
    appended = b"" if start is None else data[start.end() :]
    if b"<!" in text[:MAX_HEADER_BYTES] or b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise FormatError("the XML has a document type or comments, which are not read")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise FormatError(f"the XML is damaged ({error})") from None
    image = root.find("ImageData")
    pieces = [] if image is None else image.findall("Piece")
    if root.get("type") != "ImageData" or image is None or len(pieces) != 1:
        raise FormatError("must hold one piece of ImageData")
    extent = _vector(image, "WholeExtent", 6).astype(np.int64)
    if pieces[0].get("Extent") not in (None, image.get("WholeExtent")):
        raise FormatError("the piece does not have the whole extent")
    if image.get("Direction") is not None and not np.array_equal(_vector(image, "Direction", 9), np.eye(3).reshape(-1)):
        raise FormatError("the grid is rotated; resample it onto an axis-aligned grid")
    spacing, origin = _vector(image, "Spacing", 3), _vector(image, "Origin", 3)
    if not (spacing > 0).all():
        raise FormatError(f"the voxels must have sizes above 0, got {spacing.tolist()}")
    cells = [int(n) for n in extent[1::2] - extent[::2]]
    origin = origin + extent[::2] * spacing
    arrays = _Arrays(root, appended, is_raw)
    array = _choose(pieces[0].find("PointData"))
    sizes = [n + 1 for n in cells]
    if array is None:
        array, sizes, origin = _choose(pieces[0].find("CellData")), cells, origin + spacing / 2
    if array is None:
        raise FormatError("has no array of numbers with one component")
    samples = as_samples(arrays.numbers(array, checked_count(sizes)), sizes)
    return GridSamples(samples, origin, spacing, _facts(image))


def _facts(image: Any) -> dict[str, Any] | None:
    for array in image.iterfind("FieldData/DataArray"):
        if array.get("Name") == "fieldbake":
            try:
                codes = bytes(int(word) for word in (array.text or "").split())
            except ValueError:
                raise FormatError("the field data is damaged") from None
            return sidecar.parse(codes.rstrip(b"\0"))
    return None


def _choose(data: Any) -> Any:
    if data is None:
        return None
    arrays = [
        array
        for array in data.findall("DataArray")
        if array.get("type") in _TYPES and array.get("NumberOfComponents", "1") == "1"
    ]
    names = (NAME, data.get("Scalars"))
    return next((array for name in names for array in arrays if array.get("Name") == name), next(iter(arrays), None))


def _vector(element: Any, name: str, length: int) -> NDArray[np.float64]:
    try:
        vector = np.array([float(word) for word in element.get(name, "").split()])
    except ValueError:
        raise FormatError(f"{name} must be numbers, got {element.get(name)[:60]!r}") from None
    if vector.shape != (length,) or not (np.abs(vector) < 2**53).all():
        raise FormatError(f"{name} must be {length} numbers")
    return vector


class _Arrays:
    """Reads the data arrays of one file."""

    def __init__(self, root: Any, appended: bytes, is_raw: bool) -> None:
        self.appended, self.is_raw = appended, is_raw
        self.order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self.word = self.order + {"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"), "u4")
        compressor = root.get("compressor")
        if compressor not in (None, "", _ZLIB):
            raise FormatError(f"is compressed by {compressor[:60]}; {_ZLIB} and plain samples are read")
        self.is_packed = compressor == _ZLIB

    def numbers(self, array: Any, count: int) -> NDArray[Any]:
        """Read the `count` numbers of a data array."""
        dtype = np.dtype(self.order + _TYPES[array.get("type")])
        form = array.get("format", "ascii")
        if form == "ascii":
            try:
                values = np.array((array.text or "").split(), np.float64)
            except ValueError:
                raise FormatError("the samples are not numbers") from None
            if len(values) != count:
                raise FormatError(f"{count} samples are expected, the file has {len(values)}")
            return values
        if form == "appended":
            try:
                offset = int(array.get("offset", "0"))
            except ValueError:
                raise FormatError(f"the offset must be a whole number, got {array.get('offset')[:60]!r}") from None
            content = self.appended[offset:] if offset >= 0 else b""
            if not self.is_raw:
                content = _base64(content)
        else:
            content = _base64((array.text or "").encode())
        size = count * dtype.itemsize
        return np.frombuffer(self._unpacked(Cursor(content), size), dtype)

    def _unpacked(self, cursor: Cursor, size: int) -> bytes:
        if not self.is_packed:
            if cursor.array(1, self.word)[0] != size:
                raise FormatError(f"the samples must have {size} bytes")
            return bytes(cursor.take(size))
        blocks, block, last = (int(n) for n in cursor.array(3, self.word))
        if block and blocks * block - (block - last if last else 0) != size:
            raise FormatError(f"the samples must have {size} bytes")
        packed = cursor.array(min(blocks, len(cursor.data)), self.word).tolist()
        sizes = [block] * (blocks - 1) + [last or block]
        return b"".join(inflate(cursor.take(n), unpacked) for n, unpacked in zip(packed, sizes, strict=True))


def _base64(text: bytes) -> bytes:
    """Decode base64 of a header and its data, padded separately, up to the first other character."""
    words = re.match(rb"[\sA-Za-z0-9+/=]*", text)
    compact = b"".join(words[0].split()) if words is not None else b""
    parts = re.findall(rb"[^=]+=*", compact)
    try:
        return b"".join(base64.b64decode(part) for part in parts)
    except binascii.Error:
        raise FormatError("the base64 data is damaged") from None


def _save(file: FieldFile) -> None:
    with atomic_write(file.target) as stream:
        write(stream, samples_of(file), compressed=file.options.compression != "none")


def _load(path: Path) -> GridSamples:
    return read(path.read_bytes())


FORMATS = (Format(".vti", ("volume", "quantized"), _save, _load, (b"<?xml", b"<VTKFile"), options=("compression",)),)
