"""Options of every picture: the size, the background, and the frame made of the core's result."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError
from .frame import Frame

#: Largest number of pixels along one side of a picture.
MAX_SIDE_PX = 16384


def checked_size(size: tuple[int, int]) -> tuple[int, int]:
    """Check a size; the result is width and height in pixels."""
    try:
        width, height = size
    except (TypeError, ValueError):
        raise SceneError(f"size: must be (width, height), got {checks.describe(size)}") from None
    return (
        checks.integer("size", width, least=1, most=MAX_SIDE_PX, error=SceneError),
        checks.integer("size", height, least=1, most=MAX_SIDE_PX, error=SceneError),
    )


def checked_color(name: str, value: ArrayLike, channels: int) -> NDArray[np.float64]:
    """Check a linear colour with this many channels; a missing opacity is 1."""
    if channels == 4 and np.shape(value) == (3,):
        return np.append(checks.vector(name, value, 3), 1.0)
    color = checks.vector(name, value, channels)
    if color.min() < 0:
        raise ArgumentError(f"{name}: must not be negative, got {color.tolist()}")
    return color


def frame_of(result: dict[str, Any]) -> Frame:
    """Make a frame from a result of the core: arrays become its arrays, and the other entries its report."""
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    return Frame(arrays, {name: value for name, value in result.items() if name not in arrays})
