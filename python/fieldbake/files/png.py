"""Grey .png files of 8 or 16 bits, compressed in blocks of rows on several threads.

Each block is a deflate stream of its own without an end, so that the blocks joined are one stream. The differences
between rows (filter "up") of a distance field have long runs of equal bytes, which `zlib.Z_RLE` finds in a third of
the time of a general search. Blocks do not depend on the number of threads, so the bytes do not either.
"""

from __future__ import annotations

import functools
import io
import struct
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import encodings
from ..base.errors import FormatError
from ..base.threads import thread_count
from . import sidecar
from .container import atomic_write
from .formats import Format, Pages, PagesFile, shares
from .pages import pages_of

#: Size of a block before compression, bytes: large compared with the window of deflate, 32 KiB.
BLOCK_BYTES = 4 << 20

#: Filter "up" of the PNG specification: each byte minus the byte above it.
UP = 2


def write_grey(values: NDArray[Any], grey: Callable[[NDArray[Any]], NDArray[Any]] = np.asarray) -> bytes:
    """Encode values (height, width) as a .png file. `grey` converts rows of them to unsigned integers, 8 or 16 bits."""
    height, width = values.shape
    itemsize = grey(values[:1]).itemsize
    step = max(1, BLOCK_BYTES // (width * itemsize + 1))
    starts = range(0, height, step)
    # zlib and NumPy release the lock of the interpreter.
    with ThreadPoolExecutor(thread_count()) as pool:
        blocks = list(pool.map(lambda start: _compressed(values, grey, start, step), starts))
    checksum = 1
    for filtered, _ in blocks:
        checksum = zlib.adler32(filtered.data, checksum)
    header = struct.pack(">IIBBBBB", width, height, 8 * itemsize, 0, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header), _chunk(b"IDAT", b"\x78\x01")]
    chunks += [_chunk(b"IDAT", stream) for _, stream in blocks]
    # Two bytes end the stream: an empty block that is marked as the last.
    chunks += [_chunk(b"IDAT", b"\x03\x00" + struct.pack(">I", checksum)), _chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _compressed(
    values: NDArray[Any], grey: Callable[[NDArray[Any]], NDArray[Any]], start: int, step: int
) -> tuple[NDArray[np.uint8], bytes]:
    """Convert, filter and compress a block of rows."""
    greys = grey(values[max(start - 1, 0) : start + step])
    rows = greys.astype(greys.dtype.newbyteorder(">"), order="C").view(np.uint8)
    filtered = np.empty((len(rows) - (start > 0), rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = UP
    if not start:
        # The row above the first one of the image is zero.
        filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[int(start == 0) :, 1:])
    stream = zlib.compressobj(1, zlib.DEFLATED, -15, 9, zlib.Z_RLE)
    return filtered, stream.compress(filtered.data) + stream.flush(zlib.Z_FULL_FLUSH)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(content, zlib.crc32(kind)))


def _save(file: PagesFile) -> None:
    """Write the pages of an atlas with normalised integers, and a preview of 8 bits beside them."""
    content = write_grey(file.stacked, _unsigned)
    # The preview has a longer name, so a name that is too long is an error before the image is replaced.
    with atomic_write(file.target.with_suffix(".preview.png")) as stream:
        stream.write(write_grey(file.stacked, _preview))
    with sidecar.write(file.target, file.header()) as stream:
        stream.write(content)


def _unsigned(stacked: NDArray[Any]) -> NDArray[Any]:
    """Offset normalised integers by half their range: 0 becomes 32768 or 128."""
    bits = 8 * stacked.itemsize
    unsigned = np.dtype(f"u{stacked.itemsize}").type
    texels: NDArray[Any] = np.ascontiguousarray(stacked).view(unsigned) ^ unsigned(1 << (bits - 1))
    return texels


def _preview(stacked: NDArray[Any]) -> NDArray[np.uint8]:
    """Make a grey preview: the surface is mid-grey, the inside dark."""
    return _greys(stacked.dtype.newbyteorder("=").str).take(_unsigned(stacked))


@functools.cache
def _greys(kind: str) -> NDArray[np.uint8]:
    """One grey for each of the 256 or 65,536 texels that exist, by :func:`_unsigned` of the texel."""
    bits = 8 * np.dtype(kind).itemsize
    texels = np.arange(1 << bits, dtype=np.int64) - (1 << (bits - 1))
    return np.round(127.5 + 127.5 * shares(texels.astype(kind))).astype(np.uint8)


def _load(path: Path) -> Pages:
    return pages_of(*sidecar.read_both(path), _read, "png")


def _read(data: bytes, width: int, height: int, encoding: str) -> NDArray[Any]:
    from PIL.PngImagePlugin import PngImageFile

    if not encoding.startswith("snorm"):
        raise FormatError(f"a .png holds normalised texels, but its JSON file has the encoding {encoding}")
    texel = encodings.DTYPES[encoding]
    # Image.open is not used, because it refuses large images as decompression bombs. The size is compared before
    # decoding.
    try:
        with PngImageFile(io.BytesIO(data)) as image:
            modes = ("L",) if texel.itemsize == 1 else ("I;16", "I")
            if image.size != (width, height) or image.mode not in modes:
                told = f"{image.size} {image.mode}, the metadata states {(width, height)} {encoding}"
                raise FormatError(f"the image is {told}")
            values = np.asarray(image).astype(np.int32)
    except (OSError, SyntaxError) as error:  # Pillow raises these for a damaged file
        raise FormatError(f"the image is damaged ({error})") from None
    return (values - (1 << (8 * texel.itemsize - 1))).astype(texel)


FORMATS = (Format(".png", ("atlas",), _save, _load, (b"\x89PNG",), has_sidecar=True),)
