"""Encodings of stored distances: their names, element types, integer steps and scales, in one table."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .. import _core

#: Names of encodings: of all samples, of those with fewer than 32 bits, of pages on the web, and of the texels of 3D
#: textures.
Encoding = Literal["float32", "float16", "snorm16", "snorm8"]
QuantizedEncoding = Literal["float16", "snorm16", "snorm8"]
PageEncoding = Literal["snorm8", "float16", "float32"]
TextureEncoding = Literal[Encoding, "unorm8"]

#: Element type of each encoding. All but float32 are multiplied by a scale in world units. A normalised integer counts
#: steps of 1 / STEPS of the scale.
DTYPES: dict[str, np.dtype[Any]] = {
    "float32": np.dtype(np.float32),
    "float16": np.dtype(np.float16),
    "snorm16": np.dtype(np.int16),
    "snorm8": np.dtype(np.int8),
}

#: Element type of the texels of 3D textures: the encodings, and unsigned bytes with distance 0 at 127.5, for readers
#: such as three.js that do not support signed bytes.
TEXTURE_DTYPES = {**DTYPES, "unorm8": np.dtype(np.uint8)}

#: Names of all encodings, of encodings with fewer than 32 bits per sample, and of encodings of pages on the web.
NAMES: tuple[str, ...] = get_args(Encoding)
QUANTIZED: tuple[str, ...] = get_args(QuantizedEncoding)
PAGE_NAMES: tuple[str, ...] = get_args(PageEncoding)

#: Largest magnitude of the normalised integers, which represents the scale.
STEPS = {"snorm16": 32767, "snorm8": 127}

#: Half width of the band of a normalised encoding, voxels.
DEFAULT_BAND = 4.0


def to_unorm8(distances: NDArray[np.float32], scale: float) -> NDArray[np.uint8]:
    """Convert distances to the nearest unsigned bytes. A byte represents ``(byte / 127.5 - 1) * scale``.

    Distance 0 lies between 127 and 128, so a byte is off by up to half a step, scale / 255. Negative distances become
    127 or less, others 128 or more.
    """
    shares = np.clip(distances.astype(np.float64) / scale, -1, 1)
    return np.asfortranarray(
        np.where(shares < 0, np.ceil(127 + 127.5 * shares), np.floor(128 + 127.5 * shares)).clip(0, 255), np.uint8
    )


def from_unorm8(texels: NDArray[np.uint8], scale: float) -> NDArray[np.float32]:
    """Convert unsigned bytes to distances, world units, x fastest in memory."""
    return np.asfortranarray((texels / 127.5 - 1) * scale, np.float32)


def scale_of(encoding: str, spacing: Any, band: float) -> float:
    """Compute the scale of `encoding`, world units, for voxels with the sides `spacing` (3,); `band` is in voxels.

    The scale is 1 for float32. For float16 it is the largest power of two that does not exceed the longest side of a
    voxel. For the normalised encodings it is the half width of the band.
    """
    voxel = float(np.max(spacing))
    encoding = "snorm8" if encoding == "unorm8" else encoding
    return _core.encoding_scale(encoding, voxel, band * voxel)


def largest_scale(distances: NDArray[np.float32]) -> float:
    """Compute the smallest scale with which a normalised encoding represents all of these distances."""
    return _core.encoding_scale("snorm16", 1.0, float(np.abs(distances).max()))


def texel_rule(ending: str, encoding: str) -> dict[str, str]:
    """Return the type of the texels in a file with this ending, and the formula for the distance of a texel."""
    stored = TEXTURE_DTYPES[encoding]
    if encoding == "unorm8":
        return {"texel": "uint8", "decode": "distance = (texel / 127.5 - 1) * scale"}
    if ending == ".png":
        bits = 8 * stored.itemsize
        middle = 1 << (bits - 1)
        return {"texel": f"uint{bits}", "decode": f"distance = (u{bits} - {middle}) / {middle - 1} * scale"}
    if stored.kind == "f" or ending == ".exr":
        kind = "float16" if encoding == "float16" else "float32"
        return {"texel": kind, "decode": "distance = texel * scale"}
    return {"texel": str(stored), "decode": f"distance = texel / {STEPS[encoding]} * scale"}
