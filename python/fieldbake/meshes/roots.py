"""Roots of a field on line segments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Largest number of steps of the search for a crossing. Three of them at least halve the interval.
ROOT_STEPS = 60

#: A crossing is found once the interval is this fraction of an edge, a tenth of the resolution of the vertices.
ROOT_SHARE = 1e-5

#: Fraction of a segment before an end where the field is zero again, if it is zero in an area.
INWARDS = 1e-3


def roots(
    evaluate: Callable[[NDArray[np.float64]], NDArray[Any]],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    shares: NDArray[np.float64],
    noise: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Find where a field crosses zero between pairs of points, and whether it does.

    By the Illinois method, and by bisection where two of its steps did not halve the interval, as beside an area of
    zeros.

    Parameters
    ----------
    evaluate : callable
        Values of the field at points (n, 3), (n,).
    starts, ends : (n, 3) float64
        Ends of the segments.
    shares : (n,) float64
        Fractions of the segments at which the search starts.
    noise : float, default 0
        Rounding of the values. A segment that ends in an area of zeros, as on the tread of a step, leaves the inside
        where the field is -`noise`.

    Returns
    -------
    shares : (n,) float64
        Fractions of the segments before the crossings.
    found : (n,) bool
        Whether the field has different signs at both ends.

    References
    ----------
    M. Dowell and P. Jarratt, "A modified regula falsi method for computing the root of an equation", BIT 11 (1971).
    """

    def values(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(evaluate(points), dtype=np.float64)

    low, high = np.zeros(len(starts)), np.ones(len(starts))
    at_low, at_high = values(starts), values(ends)
    levels = np.zeros(len(starts))
    if noise > 0:
        rows = np.flatnonzero(np.minimum(np.abs(at_low), np.abs(at_high)) <= noise)
        inwards = np.where(np.abs(at_low) <= noise, INWARDS, 1 - INWARDS)[rows, None]
        is_area = np.abs(values(starts[rows] + (ends[rows] - starts[rows]) * inwards)) <= noise
        levels[rows[is_area]] = -noise
        at_low, at_high = at_low - levels, at_high - levels
    found = (at_low < 0) != (at_high < 0)
    share = np.clip(shares, 0.0, 1.0)
    open_rows = np.flatnonzero(found)
    side = np.zeros(len(starts), dtype=np.int8)
    widths = np.ones((2, len(starts)))  # of the intervals two steps ago and one step ago
    for step in range(ROOT_STEPS):
        if not len(open_rows):
            break
        rows = open_rows
        if step > 0:
            width = high[rows] - low[rows]
            secant = at_low[rows] / (at_low[rows] - at_high[rows])
            is_slow = width > 0.5 * widths[0, rows]
            share[rows] = low[rows] + width * np.where(is_slow & (step > 2), 0.5, secant)
            widths[:, rows] = widths[1, rows], width
        value = values(starts[rows] + (ends[rows] - starts[rows]) * share[rows, None]) - levels[rows]
        as_low = (value < 0) == (at_low[rows] < 0)
        # The value at an end that stays twice in a row is halved, so that the interval shrinks from both sides.
        at_high[rows] = np.where(as_low & (side[rows] == 1), at_high[rows] / 2, at_high[rows])
        at_low[rows] = np.where(~as_low & (side[rows] == -1), at_low[rows] / 2, at_low[rows])
        low[rows] = np.where(as_low, share[rows], low[rows])
        at_low[rows] = np.where(as_low, value, at_low[rows])
        high[rows] = np.where(as_low, high[rows], share[rows])
        at_high[rows] = np.where(as_low, at_high[rows], value)
        side[rows] = np.where(as_low, 1, -1)
        open_rows = rows[(value != 0) & (high[rows] - low[rows] > ROOT_SHARE)]
    return share, found
