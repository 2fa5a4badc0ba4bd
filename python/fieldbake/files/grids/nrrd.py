"""``.nrrd`` files: grids for ParaView and 3D Slicer, with their position in space; compressed by gzip or plain.

Source: "Definition of NRRD File Format" (Teem). The header is text; an empty line ends it, and the samples follow.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import FormatError
from .. import sidecar
from ..compression import GZIP_WINDOW, gzip_pieces, inflate
from ..container import MAX_HEADER_BYTES, atomic_write
from ..formats import FieldFile, Format
from .grid_samples import GridSamples, as_samples, checked_count, samples_of

#: Element types by their names in the format; aliases follow C.
_TYPES = {
    "float": "f4",
    "double": "f8",
    "signed char": "i1",
    "int8": "i1",
    "int8_t": "i1",
    "uchar": "u1",
    "unsigned char": "u1",
    "uint8": "u1",
    "uint8_t": "u1",
    "short": "i2",
    "int16": "i2",
    "int16_t": "i2",
    "ushort": "u2",
    "unsigned short": "u2",
    "uint16": "u2",
    "uint16_t": "u2",
    "int": "i4",
    "int32": "i4",
    "int32_t": "i4",
    "uint": "u4",
    "unsigned int": "u4",
    "uint32": "u4",
    "uint32_t": "u4",
    "longlong": "i8",
    "long long": "i8",
    "int64": "i8",
    "int64_t": "i8",
    "ulonglong": "u8",
    "unsigned long long": "u8",
    "uint64": "u8",
    "uint64_t": "u8",
}
#: The end of the header: an empty line, after lines that end as on Unix or as on Windows.
_END = re.compile(rb"\r?\n\r?\n")
_VECTOR = re.compile(r"\(([^()]*)\)")
#: Level of compression. Higher levels make fields only a little smaller.
_LEVEL = 3


def write(stream: IO[bytes], grid: GridSamples, *, compressed: bool) -> None:
    """Write a grid. Its metadata is JSON, the value of the key ``fieldbake``."""
    directions = " ".join(
        "(" + ",".join(repr(float(grid.spacing[axis])) if axis == row else "0" for axis in range(3)) + ")"
        for row in range(3)
    )
    lines = [
        "NRRD0005",
        "type: float",
        "dimension: 3",
        "space: 3D-right-handed",
        f"sizes: {' '.join(map(str, grid.samples.shape))}",
        f"space directions: {directions}",
        "centerings: cell cell cell",
        "kinds: domain domain domain",
        "endian: little",
        f"encoding: {'gzip' if compressed else 'raw'}",
        f"space origin: ({','.join(repr(float(x)) for x in grid.origin)})",
        f"fieldbake:={json.dumps(grid.facts)}",
    ]
    stream.write("\n".join(lines).encode() + b"\n\n")
    content = np.ascontiguousarray(grid.samples.T, "<f4").data.cast("B")
    if not compressed:
        stream.write(content)
        return
    stream.writelines(gzip_pieces(content, _LEVEL))


#: Names of header fields that have a second spelling.
_ALIASES = {"axismins": "axis mins", "axismaxs": "axis maxs", "centers": "centerings"}


def read(data: bytes) -> GridSamples:
    """Read the grid of a file."""
    end = _END.search(data, 0, MAX_HEADER_BYTES)
    head, content = (data[:MAX_HEADER_BYTES], b"") if end is None else (data[: end.start()], data[end.end() :])
    lines = head.decode("utf-8", "replace").replace("\r", "").split("\n")
    if not lines[0].startswith("NRRD"):
        raise FormatError("is not a .nrrd file")
    header, pairs = {}, {}
    for line in lines[1:]:
        if not line or line.startswith("#"):
            continue
        name, colon, value = line.partition(":")
        if not colon:
            raise FormatError(f"the header has the invalid line {line[:60]!r}")
        if value.startswith("="):
            pairs[name] = value[1:]
        else:
            header[_ALIASES.get(name.strip().lower(), name.strip().lower())] = value.strip()
    sizes = _whole_numbers(header, "sizes")
    if "data file" in header or "datafile" in header or any(header.get(f"{skip} skip") for skip in ("line", "byte")):
        raise FormatError("the samples must be in the file itself, right after its header, not in a data file")
    kind = _TYPES.get(header.get("type", "").lower())
    if kind is None or header.get("dimension") != "3":
        raise FormatError(
            f"the samples must be numbers in three dimensions, got the type {header.get('type', '')[:40]!r} and the "
            f"dimension {header.get('dimension', '')[:40]!r}"
        )
    order = ">" if header.get("endian") == "big" else "<"
    dtype = np.dtype(order + kind)
    size = checked_count(sizes) * dtype.itemsize
    encoding = header.get("encoding", "").lower()
    if encoding in ("gzip", "gz"):
        content = inflate(content, size, GZIP_WINDOW)
    elif encoding != "raw":
        raise FormatError(f"the encoding is {encoding[:40]!r}; raw and gzip are read")
    if len(content) != size:
        raise FormatError(f"{sizes} samples need {size} bytes, the file has {len(content)}")
    samples = as_samples(np.frombuffer(content, dtype), sizes)
    facts = sidecar.parse(pairs["fieldbake"]) if "fieldbake" in pairs else None
    return _placed(samples, *_place(header, sizes), facts)


def _whole_numbers(header: dict[str, str], name: str) -> list[int]:
    try:
        return [int(word) for word in header.get(name, "").split()]
    except ValueError:
        raise FormatError(f"{name} must be whole numbers, got {header[name][:60]!r}") from None


def _numbers(text: str) -> NDArray[np.float64]:
    try:
        numbers = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        raise FormatError(f"the header has {text[:60]!r} in place of numbers") from None
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise FormatError(f"the header has {text[:60]!r} in place of three numbers")
    return numbers


def _place(header: dict[str, str], sizes: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the centre of the first sample, (3,), and the step along each axis of the array, (3, 3), one row an axis."""
    if "space directions" in header:
        rows = [_numbers(text) for text in _VECTOR.findall(header["space directions"])]
        directions = np.array(rows).reshape(-1, 3)
        if directions.shape != (3, 3):
            raise FormatError(f"the header must have three space directions, got {header['space directions'][:60]!r}")
        origin = _numbers(header["space origin"].strip("() ")) if "space origin" in header else np.zeros(3)
        return origin, directions
    is_cell = "cell" in header.get("centerings", "")
    spacing = _numbers(header["spacings"]) if "spacings" in header else np.ones(3)
    origin = _numbers(header["axis mins"]) if "axis mins" in header else np.zeros(3)
    if "axis mins" in header and "axis maxs" in header:
        # The range from the first to the last sample, or of all cells.
        steps = np.array(sizes) - (0 if is_cell else 1)
        spacing = (_numbers(header["axis maxs"]) - origin) / np.where(steps > 0, steps, 1)
    if "axis mins" in header and is_cell:
        origin = origin + spacing / 2
    return origin, np.diag(spacing)


def _placed(
    samples: NDArray[np.float32],
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    facts: dict[str, Any] | None,
) -> GridSamples:
    """Turn the axes of an array so that they point along x, y and z. Scanners store some of them backwards."""
    steps = directions != 0
    if not ((steps.sum(axis=0) == 1).all() and (steps.sum(axis=1) == 1).all()):
        if not directions.any(axis=1).all():
            raise FormatError(f"the voxels must have sizes other than 0, got the steps {directions.tolist()}")
        raise FormatError(
            "the axes of the grid are rotated or sheared; resample it onto an axis-aligned grid, for example by "
            '"Resample Scalar Volume" of 3D Slicer'
        )
    order = np.argmax(steps, axis=0)
    samples, spacing = samples.transpose(order), directions[order, range(3)]
    backwards = tuple(np.flatnonzero(spacing < 0).tolist())
    origin = origin + np.where(spacing < 0, (np.array(samples.shape) - 1) * spacing, 0.0)
    return GridSamples(np.asfortranarray(np.flip(samples, backwards)), origin, np.abs(spacing), facts)


def _save(file: FieldFile) -> None:
    with atomic_write(file.target) as stream:
        write(stream, samples_of(file), compressed=file.options.compression != "none")


def _load(path: Path) -> GridSamples:
    return read(path.read_bytes())


FORMATS = (Format(".nrrd", ("volume", "quantized"), _save, _load, (b"NRRD",), options=("compression",)),)
