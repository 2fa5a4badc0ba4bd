"""Roots of a field on line segments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Largest number of steps of the search for a crossing. Every second step at least halves the interval.
ROOT_STEPS = 24

#: A crossing is found once the interval is this fraction of an edge, a tenth of the resolution of the vertices.
ROOT_SHARE = 1e-5


def roots(
    evaluate: Callable[[NDArray[np.float64]], NDArray[Any]],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    shares: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Find where a field crosses zero between pairs of points, and whether it does, by the Illinois method.

    Parameters
    ----------
    evaluate : callable
        Values of the field at points (n, 3), (n,).
    starts, ends : (n, 3) float64
        Ends of the segments.
    shares : (n,) float64
        Fractions of the segments at which the search starts.

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
    found = (at_low < 0) != (at_high < 0)
    share = np.clip(shares, 0.0, 1.0)
    open_rows = np.flatnonzero(found)
    side = np.zeros(len(starts), dtype=np.int8)
    for step in range(ROOT_STEPS):
        if not len(open_rows):
            break
        rows = open_rows
        if step > 0:
            share[rows] = low[rows] + (high[rows] - low[rows]) * at_low[rows] / (at_low[rows] - at_high[rows])
        value = values(starts[rows] + (ends[rows] - starts[rows]) * share[rows, None])
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
