"""Atlases as images: one channel in an .exr file, or unsigned integers of 16 or 8 bits in a .png file.

The pages lie below each other. A JSON file beside the image stores the metadata of the atlas, with one entry per
volume. In this file ``decode`` is the formula for the distance of a texel, ``texel`` is the type of its operand, and
each entry has the ``scale`` of its volume.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.encodings import texel_rule
from ..files import container, sidecar
from ..files.container import atomic_write, head
from ..files.exr import write_channel
from ..files.png import write_grey

#: Endings of the files that :func:`write` can write.
ENDINGS = container.ENDINGS["atlas"][1:]


def write(target: Path, pages: NDArray[Any], facts: dict[str, Any]) -> None:
    """Write pages (count, size, size) as .exr or .png with the metadata of their atlas.

    A .png file stores normalised integers only. A preview of 8 bits is written beside it.
    """
    ending = target.suffix.lower()
    is_png = ending == ".png"
    stacked = pages.reshape(-1, pages.shape[-1])
    # An .exr stores the value that a sampler returns for a normalised integer. Rounding recovers the integer.
    is_float = stacked.dtype.kind == "f"
    content = write_grey(stacked, _unsigned) if is_png else write_channel(stacked if is_float else _shares(stacked))
    encoding = facts["encoding"]
    if is_png:
        # The preview has a longer name, so a name that is too long is an error before the image is replaced.
        with atomic_write(target.with_suffix(".preview.png")) as stream:
            stream.write(write_grey(stacked, _preview))
    with sidecar.write(target, {**head("atlas image", encoding), **texel_rule(ending, encoding), **facts}) as stream:
        stream.write(content)


def _shares(texels: NDArray[Any]) -> NDArray[np.float32]:
    shares: NDArray[np.float32] = (texels / np.float64(np.iinfo(texels.dtype).max)).astype(np.float32)
    return shares


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
    return np.round(127.5 + 127.5 * _shares(texels.astype(kind))).astype(np.uint8)
