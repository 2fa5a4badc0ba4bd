"""Grey .png files of 8 or 16 bits, compressed in blocks of rows on several threads.

Each block is a deflate stream of its own without an end, so that the blocks joined are one stream. The differences
between rows (filter "up") of a distance field have long runs of equal bytes, which `zlib.Z_RLE` finds in a third of
the time of a general search. Blocks do not depend on the number of threads, so the bytes do not either.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.threads import thread_count

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
