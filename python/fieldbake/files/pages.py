"""Images of the pages of an atlas: the checks of their metadata before their texels are decoded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from numpy.typing import NDArray

from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from . import sidecar
from .formats import Pages


def pages_of(
    content: bytes,
    facts: dict[str, Any],
    read: Callable[[bytes, int, int, str], NDArray[Any]],
    texels: Literal["pages", "png"] = "pages",
) -> Pages:
    """Decode the pages of an image by ``read(content, width, height, encoding)``."""
    sidecar.expect(facts, "atlas image")
    try:
        size = checks.integer("page_size", facts.get("page_size"), least=1, most=1 << 15)
        count = checks.integer("pages", facts.get("pages"), least=1, most=1 << 16)
        encoding = checks.choice("encoding", facts.get("encoding"), encodings.NAMES)
    except ArgumentError as error:
        raise FormatError(str(error)) from None
    return Pages(read(content, size, count * size, encoding).reshape(count, size, size), facts, texels)
