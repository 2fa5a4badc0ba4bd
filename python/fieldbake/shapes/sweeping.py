"""Profiles moved along polylines, and the polyline of a helix."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ShapeError
from .arguments import number
from .outlines.curves import Array
from .primitives import plane
from .shape import Shape, combine

#: The public names; the package exports all of them.
__all__ = ["helix"]

#: Length of a prism past the plane of a corner, as a share of the largest distance of the profile from the path.
OVERLAP = 1.0

#: Sine of the angle of a corner below which two segments are one.
STRAIGHT = 1e-9


def helix(radius: float, pitch: float, turns: float, *, segments: int = 48) -> NDArray[np.float64]:
    """Make the corners of a right-handed helix about z, for :meth:`Profile.sweep`.

    Parameters
    ----------
    radius : float
        Distance from the z axis, world units.
    pitch : float
        Height of a turn, world units; a negative one makes a left-handed helix from the top.
    turns : float
        Number of turns, above 0.
    segments : int, default 48
        Segments of a turn. The corners lie on the helix, and the segments are within 0.2 % of the radius of it.

    Returns
    -------
    (n, 3) float64
        Points from (radius, 0, 0) on.

    Raises
    ------
    ShapeError
        For a value out of range.

    Examples
    --------
    >>> import fieldbake as fb
    >>> spring = fb.circle(0.4).sweep(fb.helix(radius=4, pitch=2, turns=3))
    >>> (spring.distance([(4, 0, 2), (4.3, 0, 2), (4.5, 0, 2)]) < 0).tolist()
    [True, True, False]
    """
    wide, rise, count = number("radius", radius), number("pitch", pitch), number("turns", turns)
    pieces = checks.integer("segments", segments, least=3, most=4096, error=ShapeError)
    if not wide > 0:
        raise ShapeError(f"radius: must be above 0, got {wide:g}")
    if not 0 < count <= 1e4:
        raise ShapeError(f"turns: must be above 0 and at most 10000, got {count:g}")
    at = np.linspace(0.0, count, max(1, math.ceil(count * pieces - 1e-9)) + 1)
    angles = 2 * math.pi * at
    points: NDArray[np.float64] = np.stack([wide * np.cos(angles), wide * np.sin(angles), rise * at], axis=1)
    return points


@dataclass
class _Corner:
    """The plane that halves a corner of the path, and its tangent of half the angle."""

    normal: Array
    offset: float
    tangent: float

    def before(self) -> Shape:
        return plane(self.normal.tolist(), self.offset)

    def after(self) -> Shape:
        return plane((-self.normal).tolist(), -self.offset)


def swept(extruded: Callable[[float], Shape], polygons: Sequence[Array], path: ArrayLike) -> Shape:
    """The solid of a profile along a polyline; see :meth:`Profile.sweep`."""
    points = _corners_of(path)
    is_closed = bool((points[0] == points[-1]).all()) and len(points) > 3
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    along = steps / lengths[:, None]
    reach = max(float(np.linalg.norm(loop, axis=1).max()) for loop in polygons)
    corners = [_corner(points[i + 1], along[i], along[i + 1], i + 1) for i in range(len(along) - 1)]
    ends: list[_Corner | None] = [None, *corners, None]
    if is_closed:
        ends[0] = ends[-1] = _corner(points[0], along[-1], along[0], 0)
    frames = _frames(along)
    prisms = []
    for i, length in enumerate(lengths):
        tangents = [0.0 if corner is None else corner.tangent for corner in ends[i : i + 2]]
        if reach * sum(tangents) > length:
            raise ShapeError(
                f"path: the segment from [{i}] has the length {length:g} and needs {reach * sum(tangents):g} for its "
                f"corners and this profile, whose corners are up to {reach:g} from the path"
            )
        before, after = (0.0 if corner is None else reach * (corner.tangent + OVERLAP) for corner in ends[i : i + 2])
        prism = extruded(length + before + after)
        middle = points[i] + along[i] * 0.5 * (length + after - before)
        prisms.append(_placed(prism, frames[i], middle))
    parts = []
    for i, prism in enumerate(prisms):
        start, end = ends[i], ends[i + 1]
        parts.append(_cut(prism, start, end))
        following = i + 1 if i + 1 < len(prisms) else 0
        if end is not None:
            # Points of both prisms are inside on either side of the plane, where the two parts end with distance 0.
            last = ends[following + 1]
            parts.append(_cut(prism & prisms[following], start if start is not end else None, last))
    return combine("union", parts)


def _corners_of(path: ArrayLike) -> Array:
    """The corners of a path, without those at which it goes straight on."""
    points, shape = checks.points(path, "path")
    if len(shape) != 1 or len(points) < 2:
        raise ShapeError(f"path: must have shape (n, 3), two points at least, got {checks.describe(path)}")
    steps = np.diff(points, axis=0)
    still = np.flatnonzero(~(np.linalg.norm(steps, axis=1) > 0))
    if len(still):
        raise ShapeError(f"path: [{still[0]}] and [{still[0] + 1}] are the same point")
    along = steps / np.linalg.norm(steps, axis=1)[:, None]
    sines = np.linalg.norm(np.cross(along[:-1], along[1:]), axis=1)
    is_corner = (sines > STRAIGHT) | ((along[:-1] * along[1:]).sum(axis=1) < 0)
    found: Array = points[np.concatenate([[True], is_corner, [True]])]
    return found


def _corner(point: Array, before: Array, after: Array, index: int) -> _Corner:
    normal = before + after
    length = float(np.linalg.norm(normal))
    if not length > 1e-3:
        raise ShapeError(f"path: turns back at [{index}]")
    normal /= length
    cosine = float(normal @ before)
    return _Corner(normal, float(normal @ point), math.sqrt(max(0.0, 1 - cosine * cosine)) / cosine)


def _frames(along: Array) -> list[Array]:
    """World from profile for each segment, (3, 3): the smallest rotations from one direction to the next."""
    first = along[0]
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(up, first)) > 1e-9:
        y = up - first * (up @ first)
        y /= np.linalg.norm(y)
        x = np.cross(y, first)
    else:
        x = np.array([1.0, 0.0, 0.0])
        y = np.cross(first, x)
    frames = [np.stack([x, y, first], axis=1)]
    for before, after in itertools.pairwise(along):
        # Two reflections, first in the plane across `before`, then in the plane between.
        between = before + after
        reflected = frames[-1] - 2 * np.outer(before, before @ frames[-1])
        turned = reflected - 2 * np.outer(between, between @ reflected) / (between @ between)
        frames.append(turned)
    return frames


def _placed(shape: Shape, frame: Array, origin: Array) -> Shape:
    """A shape in a frame: its rotation about an axis, then its translation."""
    # The quaternion of the rotation, from its largest component, so that nothing cancels.
    trace = float(np.trace(frame))
    squares = [trace, *np.diag(frame).tolist()]
    largest = int(np.argmax(squares))
    skew = np.array([frame[2, 1] - frame[1, 2], frame[0, 2] - frame[2, 0], frame[1, 0] - frame[0, 1]])
    if largest == 0:
        w, vector = 1 + trace, skew
    else:
        i = largest - 1
        vector = frame[i] + frame[:, i]
        vector[i] = 1 + 2 * frame[i, i] - trace
        w = float(skew[i])
    sine = float(np.linalg.norm(vector))
    angle = math.degrees(2 * math.atan2(sine, w))
    turned = shape.rotate((vector / sine).tolist(), angle) if sine > 0 and angle else shape
    return turned.translate(origin.tolist())


def _cut(shape: Shape, start: _Corner | None, end: _Corner | None) -> Shape:
    planes = [corner.after() for corner in (start,) if corner is not None]
    planes += [corner.before() for corner in (end,) if corner is not None]
    return combine("intersection", [shape, *planes])
