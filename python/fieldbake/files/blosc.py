"""Buffers that the library Blosc 1 packed with LZ4, zlib or plain copies: the default of OpenVDB files.

A buffer has a header of 16 bytes, the offset of each block, and the blocks. A block has one stream, or one for each
byte of an element; each stream starts with its size. The bytes of the elements are shuffled within a block.
"""

from __future__ import annotations

import numpy as np

from ..base.errors import FormatError
from .cursor import Cursor, inflate

SHUFFLED, COPIED, BIT_SHUFFLED, ONE_STREAM = 1, 2, 4, 16
LZ4, ZLIB = 1, 3
#: A block is divided into streams only if each stream has at least this many bytes, and an element at most this many.
LEAST_STREAM, MOST_STREAMS = 128, 16


def unpack(buffer: memoryview, most: int) -> bytes:
    """Unpack a buffer of at most `most` bytes."""
    cursor = Cursor(buffer)  # type: ignore[arg-type]
    _, _, flags, typesize, size, block_size, packed_size = cursor.unpack("<4B3I")
    if size == 0:
        return b""
    if not size <= most or packed_size != len(buffer) or not 0 < block_size <= size or not typesize:
        raise FormatError("a Blosc buffer has a damaged header")
    if flags & COPIED:
        return bytes(cursor.take(size))
    codec = flags >> 5
    if flags & BIT_SHUFFLED or codec not in (LZ4, ZLIB):
        raise FormatError("a Blosc buffer has a codec other than LZ4 and zlib; save the file again with zip")
    blocks = -(-size // block_size)
    content = bytearray()
    for start in cursor.array(blocks, "<i4").tolist():
        cursor.seek(start)
        length = min(block_size, size - len(content))
        is_split = not flags & ONE_STREAM and typesize <= MOST_STREAMS and block_size // typesize >= LEAST_STREAM
        streams = typesize if is_split and length == block_size else 1
        block = b"".join(_stream(cursor, length // streams, codec) for _ in range(streams))
        content += _unshuffled(block, typesize) if flags & SHUFFLED and typesize > 1 else block
    return bytes(content)


def _stream(cursor: Cursor, size: int, codec: int) -> bytes:
    packed = cursor.take(cursor.one("<i"))
    if len(packed) == size:
        return bytes(packed)
    return _unpack_lz4(packed, size) if codec == LZ4 else inflate(packed, size)


def _unshuffled(block: bytes, typesize: int) -> bytes:
    count = len(block) // typesize
    shuffled = np.frombuffer(block, np.uint8, count * typesize).reshape(typesize, count)
    return bytes(shuffled.T.tobytes()) + block[count * typesize :]


def _unpack_lz4(packed: memoryview, size: int) -> bytes:
    """Unpack one LZ4 block: literals, then a copy of earlier bytes, and so on; it ends with literals."""
    content = bytearray()
    cursor = Cursor(packed)  # type: ignore[arg-type]
    while True:
        token = cursor.one("B")
        content += cursor.take(_length(cursor, token >> 4))
        if len(content) > size:
            raise FormatError("an LZ4 block is longer than its header states")
        if cursor.at == len(packed):
            break
        offset = cursor.one("<H")
        length = _length(cursor, token & 15) + 4
        if not 0 < offset <= len(content) or len(content) + length > size:
            raise FormatError("an LZ4 block is damaged")
        start = len(content) - offset
        piece = content[start : start + length]
        # A copy may overlap the bytes that it produces; then it repeats.
        content += (piece * (length // len(piece) + 1))[:length]
    if len(content) != size:
        raise FormatError("an LZ4 block is shorter than its header states")
    return bytes(content)


def _length(cursor: Cursor, first: int) -> int:
    length = first
    more = 255 if first == 15 else 0
    while more == 255:
        more = cursor.one("B")
        length += more
    return length
