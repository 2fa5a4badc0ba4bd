"""Checks of the arguments of shapes; failures are ShapeErrors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..base import checks
from ..base.errors import ArgumentError, ShapeError

Axis = Literal["x", "y", "z"] | Sequence[float]

#: The axes by name.
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def number(name: str, value: object) -> float:
    """Check one real number."""
    try:
        return checks.number(name, value)
    except ArgumentError as error:
        raise ShapeError(str(error)) from None


def numbers(name: str, value: ArrayLike, length: int) -> list[float]:
    """Check a vector of real numbers."""
    return [float(number) for number in checks.vector(name, value, length, ShapeError)]


def sides(size: ArrayLike) -> list[float]:
    """Check the sides (3,) of a box, or the one side of a cube."""
    return [number("size", size)] * 3 if np.ndim(size) == 0 else numbers("size", size, 3)


def axis_of(name: str, axis: Axis) -> list[float]:
    """Check an axis: its letter or a vector (3,)."""
    if isinstance(axis, str):
        if axis not in AXES:
            raise ShapeError(f'{name}: must be "x", "y", "z" or a vector, got {checks.describe(axis)}')
        return list(AXES[axis])
    return numbers(name, axis, 3)


def per_unit_deg(angle: float | None, length_name: str, length: float | None, *, turn_deg: float) -> float:
    """Check the angle of a deformation per world unit, degrees.

    It is given as `per_unit_deg`, or as the length along which space turns by `turn_deg`. `length_name` is the name of
    that option.
    """
    if (angle is None) == (length is None):
        count = "none" if angle is None else "both"
        raise ShapeError(f"per_unit_deg, {length_name}: exactly one of the two must be given, got {count}")
    if length is None:
        return number("per_unit_deg", angle)
    checked = number(length_name, length)
    if checked == 0:
        raise ShapeError(f"{length_name}: must not be 0; per_unit_deg=0 leaves the shape as it is")
    return number(length_name, turn_deg / checked)
