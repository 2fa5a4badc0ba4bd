"""Curves as polylines of the same area within a tolerance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Distance of a polyline from its curve, as a share of the size: the radius of a circle, the em of letters, the longest
#: side of an SVG picture.
TOLERANCE = 1e-4

#: The corners of a polyline of equal area are up to 4/3 of its largest chord error away from the curve.
CHORD_SHARE = 0.75

#: Nodes and weights of Gauss and Legendre on [0, 1], exact for polynomials of degree 5.
NODES, WEIGHTS = (0.5 * (x + 1) if i == 0 else 0.5 * x for i, x in enumerate(np.polynomial.legendre.leggauss(3)))


def circle_points(radius: float) -> Array:
    """A regular polygon (n, 2) about the origin with the area of the circle, within `TOLERANCE` of the radius."""
    count = math.ceil(math.pi / math.acos(1 - TOLERANCE))
    angles = 2 * math.pi / count * np.arange(count)
    outer = radius * math.sqrt(2 * math.pi / count / math.sin(2 * math.pi / count))
    return outer * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def bezier_points(controls: Sequence[ArrayLike], tolerance: float) -> Array:
    """A polyline along a Bezier curve of degree 2 or 3, without its first point, (n, 2).

    The polyline has the ends of the curve. The signed area between it and the chord equals the area of the curve: its
    inner corners lie beside the curve by the same distance, along the normals. The distance from the curve is at most
    `tolerance`. The chords of a curve cut into n pieces are within ``max |B''| / (8 n^2)`` of it.
    """
    points = np.array(controls, dtype=np.float64)
    degree = len(points) - 1
    bends = np.linalg.norm(points[:-2] - 2 * points[1:-1] + points[2:], axis=1)
    error = degree * (degree - 1) / 8 * float(bends.max())
    count = math.ceil(math.sqrt(error / (CHORD_SHARE * tolerance)))
    if error <= 1e-3 * tolerance:
        return points[-1:]
    count = max(count, 2)
    on_curve = _evaluated(points, np.linspace(0.0, 1.0, count + 1))
    on_curve[0], on_curve[-1] = points[0], points[-1]
    # The derivative of the area by a corner is half the chord past it, turned by a right angle.
    chords = on_curve[2:] - on_curve[:-2]
    normals = np.stack([chords[:, 1], -chords[:, 0]], axis=1)
    lengths = np.linalg.norm(normals, axis=1)
    if not lengths.min() > 0:
        return on_curve[1:]
    normals /= lengths[:, None]
    moves = np.zeros_like(on_curve)
    moves[1:-1] = normals
    missing = _area(points) - _polyline_area(on_curve)
    linear, square = 0.5 * float(lengths.sum()), _polyline_area(moves)
    shift = missing / linear
    for _ in range(4):
        shift -= (shift * (linear + shift * square) - missing) / (linear + 2 * shift * square)
    found: Array = (on_curve + shift * moves)[1:]
    return found


def _evaluated(points: Array, at: Array) -> Array:
    """Points of a Bezier curve by de Casteljau's algorithm."""
    level = [np.broadcast_to(point, (len(at), 2)) for point in points]
    while len(level) > 1:
        level = [a + at[:, None] * (b - a) for a, b in itertools.pairwise(level)]
    return np.array(level[0])


def _area(points: Array) -> float:
    """Signed area swept by the vector from the origin along a Bezier curve of degree 3 at most, exact."""
    places = _evaluated(points, NODES)
    slopes = (len(points) - 1) * _evaluated(np.diff(points, axis=0), NODES)
    return 0.5 * float(WEIGHTS @ (places[:, 0] * slopes[:, 1] - places[:, 1] * slopes[:, 0]))


def _polyline_area(points: Array) -> float:
    """Signed area swept by the vector from the origin along a polyline."""
    a, b = points[:-1], points[1:]
    return 0.5 * float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
