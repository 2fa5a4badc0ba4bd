"""Streams of zlib and gzip, in pieces: Ctrl-C ends between two calls of zlib, not within one."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

from ..base.errors import FormatError

#: Packed bytes that are unpacked in one call. A byte unpacks to at most 1,032 bytes.
_PACKED_PIECE = 1 << 16


def inflate(packed: bytes | memoryview, size: int, window: int = 15) -> bytes:
    """Unpack a zlib stream of `size` bytes. Unpacking stops at that size."""
    unpacker = zlib.decompressobj(window)
    content = bytearray()
    data = memoryview(packed)
    try:
        for start in range(0, len(data), _PACKED_PIECE):
            # One byte more than expected shows that the stream is too long.
            content += unpacker.decompress(data[start : start + _PACKED_PIECE], size + 1 - len(content))
            if unpacker.eof or len(content) > size:
                break
    except zlib.error as error:
        raise FormatError(f"compressed bytes are damaged ({error})") from None
    if len(content) != size:
        raise FormatError(f"compressed bytes do not hold {size} bytes")
    return bytes(content)


#: Window of a zlib stream in the gzip format.
GZIP_WINDOW = 31

#: Bytes that are compressed in one call.
_UNPACKED_PIECE = 1 << 20


def gzip_pieces(content: bytes | memoryview, level: int) -> Iterator[bytes]:
    """Compress bytes by gzip. The same content gives the same bytes, which have no time of the day."""
    packer = zlib.compressobj(level, wbits=GZIP_WINDOW)
    data = memoryview(content)
    for start in range(0, len(data), _UNPACKED_PIECE):
        yield packer.compress(data[start : start + _UNPACKED_PIECE])
    yield packer.flush()
