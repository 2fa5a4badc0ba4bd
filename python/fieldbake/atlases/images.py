"""Atlases as images: one channel in an .exr file, or unsigned integers of 16 or 8 bits in a .png file.

The pages lie below each other. A JSON file beside the image stores the metadata of the atlas, with one entry per
volume. There ``decode`` is the formula for the distance of a texel, and ``texel`` the type of its operand. An entry has
a ``scale``.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.encodings import texel_rule
from ..files import container, sidecar
from ..files.container import atomic_write, head

#: Endings of the files that :func:`write` can write.
ENDINGS = container.ENDINGS["atlas"][1:]


def write(path: str | os.PathLike[str], pages: NDArray[Any], facts: dict[str, Any]) -> None:
    """Write pages (count, size, size) as .exr or .png with the metadata of their atlas.

    A .png file stores normalised integers only. A preview of 8 bits is written beside it.
    """
    target = Path(path)
    ending = target.suffix.lower()
    is_png = ending == ".png"
    stacked = pages.reshape(-1, pages.shape[-1])
    content = _png(stacked) if is_png else _exr(stacked)
    encoding = facts["encoding"]
    sidecar.write_beside(target, {**head("atlas image", encoding), **texel_rule(ending, encoding), **facts})
    with atomic_write(target) as stream:
        stream.write(content)
    if is_png:
        with atomic_write(target.with_suffix(".preview.png")) as stream:
            stream.write(_preview(stacked))


def _exr(stacked: NDArray[Any]) -> bytes:
    height, width = stacked.shape
    encoding = "float16" if stacked.dtype == np.float16 else "float32"
    # The value that a sampler returns for a normalised integer. Rounding recovers the integer.
    values = stacked if stacked.dtype.kind == "f" else _shares(stacked)
    return _core.exr_write(np.ascontiguousarray(values).reshape(-1).view(np.uint8), width, height, encoding)


def _shares(texels: NDArray[Any]) -> NDArray[np.float32]:
    shares: NDArray[np.float32] = (texels / np.float64(np.iinfo(texels.dtype).max)).astype(np.float32)
    return shares


def _png(stacked: NDArray[Any]) -> bytes:
    # Integers are offset by half the range: 0 becomes 32768 or 128.
    bits = 8 * stacked.itemsize
    unsigned = np.uint8 if bits == 8 else np.uint16
    return _png_bytes((stacked.astype(np.int32) + (1 << (bits - 1))).astype(unsigned))


def _preview(stacked: NDArray[Any]) -> bytes:
    """Make a grey preview: the surface is mid-grey, the inside dark."""
    return _png_bytes(np.round(127.5 + 127.5 * _shares(stacked)).astype(np.uint8))


def _png_bytes(pixels: NDArray[Any]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()
