"""Flat profiles: circles, rectangles and polygons, their moves and Booleans, and the solids made of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base import checks
from ..base.errors import ShapeError
from ..base.former_names import former_names
from .arguments import number, numbers
from .shape import Shape, combine

#: The public names; the package exports all of them.
__all__ = ["Profile", "circle", "extrude", "polygon", "rectangle", "revolve"]


@dataclass(frozen=True)
class _Leaf:
    """A primitive of the core, moved by `offset`."""

    kind: str
    numbers: tuple[float, ...]
    offset: tuple[float, float] = (0.0, 0.0)

    def moved(self, offset: tuple[float, float]) -> _Leaf:
        return _Leaf(self.kind, self.numbers, (self.offset[0] + offset[0], self.offset[1] + offset[1]))

    def scaled(self, factor: float) -> _Leaf:
        x, y = self.offset
        return _Leaf(self.kind, tuple(factor * x for x in self.numbers), (factor * x, factor * y))

    def rotated(self, degrees: float) -> _Leaf:
        sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
        turn = np.array([[cosine, -sine], [sine, cosine]])
        x, y = (turn @ self.offset).tolist()
        if self.kind == "circle":
            return _Leaf("circle", self.numbers, (x, y))
        corners = np.array(self._corners()) @ turn.T
        return _Leaf("polygon", tuple(corners.ravel().tolist()), (x, y))

    def _corners(self) -> list[tuple[float, float]]:
        if self.kind == "rectangle":
            w, h = (side / 2 for side in self.numbers)
            return [(-w, -h), (w, -h), (w, h), (-w, h)]
        return list(zip(self.numbers[::2], self.numbers[1::2], strict=True))

    def extruded(self, height: float) -> Shape:
        shape = Shape._wrap(_core.Shape.extrude(self.kind, list(self.numbers), height))
        x, y = self.offset
        return shape if x == 0 and y == 0 else shape.translate((x, y, 0.0))

    def revolved(self, offset: float) -> Shape:
        x, y = self.offset
        shape = Shape._wrap(_core.Shape.revolve(self.kind, list(self.numbers), offset + x))
        return shape if y == 0 else shape.translate((0.0, 0.0, y))


#: Height of a subtracted profile over the height of the extrusion, so that its end faces are far from the solid.
TALLER = 64.0


@dataclass(frozen=True)
class _Combined:
    """Profiles joined by an operator."""

    op: str
    parts: tuple[_Leaf | _Combined, ...]

    def moved(self, offset: tuple[float, float]) -> _Combined:
        return _Combined(self.op, tuple(part.moved(offset) for part in self.parts))

    def scaled(self, factor: float) -> _Combined:
        return _Combined(self.op, tuple(part.scaled(factor) for part in self.parts))

    def rotated(self, degrees: float) -> _Combined:
        return _Combined(self.op, tuple(part.rotated(degrees) for part in self.parts))

    def extruded(self, height: float) -> Shape:
        # A subtracted part is taller, since equal end faces would leave a film of distance zero over the hole.
        tall = TALLER * height
        if self.op == "difference":
            first, *others = self.parts
            return combine("difference", [first.extruded(height), *(part.extruded(tall) for part in others)])
        if self.op == "xor":
            either = combine("union", [part.extruded(height) for part in self.parts])
            return combine("difference", [either, combine("intersection", [p.extruded(tall) for p in self.parts])])
        return combine(self.op, [part.extruded(height) for part in self.parts])

    def revolved(self, offset: float) -> Shape:
        return combine(self.op, [part.revolved(offset) for part in self.parts])


class Profile:
    """A flat region in the xy plane that :func:`extrude` and :func:`revolve` turn into a shape. Immutable.

    ``a | b``, ``a & b``, ``a - b`` and ``a ^ b`` combine profiles as they do shapes.

    Examples
    --------
    >>> import fieldbake as fb
    >>> washer = (fb.circle(1) - fb.circle(0.4).translate((0.2, 0))).extrude(0.1)
    >>> washer.distance([(0, 0, 0), (0.9, 0, 0)]).round(2).tolist()
    [0.20..., -0.05...]
    """

    __slots__ = ("_tree",)

    def __init__(self, kind: str, numbers: list[float]) -> None:
        self._tree: _Leaf | _Combined = _Leaf(kind, tuple(numbers))
        # The core checks the parameters of a profile when it extrudes it, which is cheap.
        _core.Shape.extrude(kind, numbers, 1.0)

    @classmethod
    def _of(cls, tree: _Leaf | _Combined) -> Profile:
        profile = cls.__new__(cls)
        profile._tree = tree
        return profile

    def __or__(self, other: object) -> Profile:
        return self._combined("union", other)

    def __and__(self, other: object) -> Profile:
        return self._combined("intersection", other)

    def __sub__(self, other: object) -> Profile:
        return self._combined("difference", other)

    def __xor__(self, other: object) -> Profile:
        return self._combined("xor", other)

    def _combined(self, op: str, other: object) -> Profile:
        if not isinstance(other, Profile):
            return NotImplemented  # type: ignore[no-any-return]
        return Profile._of(_Combined(op, (self._tree, other._tree)))

    def translate(self, offset: ArrayLike) -> Profile:
        """Move the profile by a vector (2,), world units."""
        x, y = numbers("offset", offset, 2)
        return Profile._of(self._tree.moved((x, y)))

    @former_names(degrees="angle_deg")
    def rotate(self, angle_deg: float) -> Profile:
        """Rotate the profile counter-clockwise about the origin by an angle in degrees."""
        return Profile._of(self._tree.rotated(number("angle_deg", angle_deg)))

    def scale(self, factor: float) -> Profile:
        """Scale the profile about the origin by the same factor along both axes."""
        value = number("factor", factor)
        if value <= 0:
            raise ShapeError(f"factor: must be above 0, got {value:g}")
        return Profile._of(self._tree.scaled(value))

    def extrude(self, height: float) -> Shape:
        """Extrude the profile along z; see :func:`extrude`."""
        return extrude(self, height)

    def revolve(self, offset: float = 0.0) -> Shape:
        """Revolve the profile about z; see :func:`revolve`."""
        return revolve(self, offset)

    def __repr__(self) -> str:
        tree = self._tree
        if isinstance(tree, _Leaf):
            return f"Profile({tree.kind}, {list(tree.numbers)})"
        return f"Profile({tree.op} of {len(tree.parts)})"


def circle(radius: float = 1.0) -> Profile:
    """Make a disc with this radius, world units, about the origin.

    Examples
    --------
    >>> import fieldbake as fb
    >>> (fb.circle(1.0) - fb.circle(0.5)).extrude(2.0).distance([(0, 0, 0), (0.75, 0, 0)]).tolist()
    [0.5, -0.25]
    """
    return Profile("circle", [number("radius", radius)])


def rectangle(size: ArrayLike) -> Profile:
    """Make a rectangle with the full sides `size` (2,), world units, about the origin.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.rectangle((2, 1)).extrude(1.0).distance([(0, 0, 0), (2, 0, 0)]).tolist()
    [-0.5, 1.0]
    """
    return Profile("rectangle", numbers("size", size, 2))


def polygon(points: ArrayLike) -> Profile:
    """Make a closed polygon with the corners `points` (n, 2), world units, in either orientation; n is at least 3.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.polygon([(0, 0), (2, 0), (0, 2)]).extrude(1.0).distance([(0.5, 0.5, 2)]).tolist()
    [1.5]
    """
    array = checks.real_array("points", points, "(n, 2)", ShapeError)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
        raise ShapeError(f"points: must have shape (n, 2), three corners at least, got {checks.describe(array)}")
    return Profile("polygon", checks.as_float64(array).ravel().tolist())


def extrude(profile: Profile, height: float) -> Shape:
    """Extrude a profile along z to the height `height`, centred at z = 0.

    The field is exact if the profile is a single circle, rectangle or polygon that does not cross itself.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.extrude(fb.circle(1.0), 2.0).distance([(0, 0, 3)]).tolist()
    [2.0]
    """
    return _checked(profile)._tree.extruded(number("height", height))


def revolve(profile: Profile, offset: float = 0.0) -> Shape:
    """Revolve a profile about z. Its x plus `offset`, world units, is the distance from the axis, and its y is z.

    Examples
    --------
    >>> import fieldbake as fb
    >>> ring = fb.revolve(fb.circle(0.25), offset=1.0)
    >>> ring.distance([(1, 0, 0), (0, 0, 0)]).tolist()
    [-0.25, 0.75]
    """
    return _checked(profile)._tree.revolved(number("offset", offset))


def _checked(value: object) -> Profile:
    if not isinstance(value, Profile):
        raise ShapeError(f"profile: must be a Profile, got {checks.describe(value)}; see circle(), polygon()")
    return value
