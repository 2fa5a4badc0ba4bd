"""Encodings of stored distances: their names, element types, integer steps and scales, in one table."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core

Encoding = Literal["float32", "float16", "snorm16", "snorm8"]

#: Element type of each encoding. All but float32 are multiplied by a scale in world units. A normalised integer counts
#: steps of 1 / STEPS of the scale.
DTYPES: dict[str, np.dtype[Any]] = {
    "float32": np.dtype(np.float32),
    "float16": np.dtype(np.float16),
    "snorm16": np.dtype(np.int16),
    "snorm8": np.dtype(np.int8),
}

#: Names of all encodings, and of those with fewer than 32 bits per sample.
NAMES = tuple(DTYPES)
QUANTIZED = NAMES[1:]

#: Largest magnitude of the normalised integers, which represents the scale.
STEPS = {"snorm16": 32767, "snorm8": 127}

#: Half width of the band of a normalised encoding, voxels.
DEFAULT_BAND = 4.0


def scale_of(encoding: str, spacing: Any, band: float) -> float:
    """The scale of `encoding` on a grid of voxels with the sides `spacing` (3,), world units; `band` is in voxels.

    The scale is 1 for float32. For float16 it is the largest power of two that does not exceed the longest side of a
    voxel. For the normalised encodings it is the half width of the band.
    """
    voxel = float(np.max(spacing))
    return _core.encoding_scale(encoding, voxel, band * voxel)


def largest_scale(distances: NDArray[np.float32]) -> float:
    """The smallest scale with which a normalised encoding represents all of these distances."""
    return _core.encoding_scale("snorm16", 1.0, float(np.abs(distances).max()))


def texel_rule(ending: str, encoding: str) -> dict[str, str]:
    """Type of the texels in a file with this ending, and the formula for the distance of a texel."""
    stored = DTYPES[encoding]
    if ending == ".png":
        bits = 8 * stored.itemsize
        middle = 1 << (bits - 1)
        return {"texel": f"uint{bits}", "decode": f"distance = (u{bits} - {middle}) / {middle - 1} * scale"}
    if stored.kind == "f" or ending == ".exr":
        kind = "float16" if encoding == "float16" else "float32"
        return {"texel": kind, "decode": "distance = texel * scale"}
    return {"texel": str(stored), "decode": f"distance = texel / {STEPS[encoding]} * scale"}
