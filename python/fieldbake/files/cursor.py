"""A position in the bytes of a file. Every read is checked against the end of the bytes."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import FormatError


class Cursor:
    """Reads parts of a file in order."""

    __slots__ = ("at", "data")

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data = memoryview(data)
        self.at = at

    def seek(self, at: int) -> None:
        """Go to an offset in the file."""
        if not 0 <= at <= len(self.data):
            raise FormatError(f"byte {at} is not in the file, which has {len(self.data)}")
        self.at = at

    def take(self, count: int) -> memoryview:
        """Return the next `count` bytes."""
        if not 0 <= count <= len(self.data) - self.at:
            raise FormatError(f"{count} bytes from byte {self.at} on are not in the file, which has {len(self.data)}")
        start, self.at = self.at, self.at + count
        return self.data[start : self.at]

    def unpack(self, layout: str) -> tuple[Any, ...]:
        """Return the next values, of a struct with this layout."""
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def one(self, layout: str) -> Any:
        """Return the next value, of this layout."""
        (value,) = self.unpack(layout)
        return value

    def name(self) -> str:
        """Return the next text of at most 255 bytes, which ends with a zero byte."""
        text, end, _ = bytes(self.data[self.at : self.at + 256]).partition(b"\0")
        self.take(len(text) + 1 if end else 256)
        return text.decode("utf-8", "replace")

    def array(self, count: int, kind: str) -> NDArray[Any]:
        """Return the next `count` numbers as a view of the bytes."""
        return np.frombuffer(self.take(count * np.dtype(kind).itemsize), kind)
