"""Encodings of stored distances: their names, element types, integer steps and scales, in one table."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from . import checks

Encoding = Literal["float32", "float16", "snorm16", "snorm8"]

#: Element type of each encoding. A normalised integer is a share of a scale in world units.
DTYPES: dict[str, np.dtype[Any]] = {
    "float32": np.dtype(np.float32),
    "float16": np.dtype(np.float16),
    "snorm16": np.dtype(np.int16),
    "snorm8": np.dtype(np.int8),
}

#: Every encoding, and those with fewer than 32 bits a sample.
NAMES = tuple(DTYPES)
QUANTIZED = NAMES[1:]

#: Largest magnitude of the normalised integers, which stands for the scale.
STEPS = {"snorm16": 32767, "snorm8": 127}

#: Half the width of the band that a normalised encoding keeps, voxels.
DEFAULT_BAND = 4.0


def scale_of(spacing: Any, band: float) -> float:
    """The world width of `band` voxels with the sides `spacing` (3,), as float32 holds it."""
    return positive(band * float(np.max(spacing)))


def positive(scale: float) -> float:
    """The nearest positive scale that float32 holds."""
    return float(np.clip(np.float32(min(scale, checks.FAR)), np.finfo(np.float32).tiny, None))
