"""Flat profiles: circles, rectangles and polygons, their moves and Booleans, and the solids made of them."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ShapeError
from ..base.former_names import former_names
from ..files.svg import svg_path, svg_text
from . import sweeping
from .arguments import number, numbers
from .flat_tree import Combined, Leaf, Tree, polygon_leaf
from .outlines.curves import Array
from .outlines.svg_paths import svg_loops
from .shape import Shape

#: The public names; the package exports all of them.
__all__ = ["Profile", "circle", "extrude", "polygon", "rectangle", "revolve"]

#: Rules that tell the inside of polygons that cross or nest.
Rule = Literal["even-odd", "nonzero"]

#: Longest side of the picture in notebooks, pixels.
PICTURE = 320


class Profile:
    """A flat region in the xy plane that :func:`extrude` and :func:`revolve` turn into a shape. Immutable.

    ``a | b``, ``a & b``, ``a - b`` and ``a ^ b`` combine profiles as they do shapes. Notebooks show a profile as a
    picture.

    Discs and rectangles stay exact when they are combined and extruded. :attr:`polygons`, :meth:`offset`, and
    extrusions of combined profiles with taper or chamfers replace a disc by a polygon of the same area, within 1e-4 of
    the radius.

    Examples
    --------
    >>> import fieldbake as fb
    >>> washer = (fb.circle(1) - fb.circle(0.4).translate((0.2, 0))).extrude(0.1)
    >>> washer.distance([(0, 0, 0), (0.9, 0, 0)]).round(2).tolist()
    [0.20..., -0.05...]
    """

    __slots__ = ("_polygons", "_tree")

    def __init__(self, kind: str, numbers: list[float]) -> None:
        self._tree: Tree = Leaf(kind, tuple(numbers))
        self._polygons: tuple[Array, ...] | None = None
        # The core checks the parameters of a profile when it extrudes it, which is cheap.
        self._tree.extruded(1.0)

    @classmethod
    def _of(cls, tree: Tree) -> Profile:
        profile = cls.__new__(cls)
        profile._tree = tree
        profile._polygons = None
        return profile

    @classmethod
    def from_svg(
        cls, source: str | os.PathLike[str], *, rule: Rule | None = None, tolerance: float | None = None
    ) -> Profile:
        """Read the filled outlines of an SVG picture, or of one path. Needs the extra ``svg`` (svgelements).

        Parameters
        ----------
        source : str or path
            A ``.svg`` file, or the data of a path, such as ``"M0 0 H10 A5 5 0 0 1 20 0 V8 Z"``. Text is data if it has
            commands and numbers of paths alone, and no file has this name. Open paths are closed.
        rule : "even-odd" or "nonzero", optional
            The rule of the inside. The default is the attribute ``fill-rule`` of each element, else ``"nonzero"``.
        tolerance : float, optional
            Distance of the polygons from arcs and Bezier curves, units of the picture; the default is 1e-4 of its
            longest side. The polygons have the area of the curves.

        Returns
        -------
        Profile
            The union of all filled elements. Strokes, text, and elements that are fully transparent are ignored, and so
            are the contents of symbols, masks and markers; ``<use>`` draws a symbol. Nested pictures and symbols are
            not cut at their viewports. One world unit is a millimetre of a picture with a physical size, as
            :meth:`Section.to_svg` writes it, else a pixel. Inside a picture, a millimetre is 96 / 25.4 user units, and
            a user unit without a ``viewBox`` is a pixel of 25.4 / 96 millimetres. In a picture without any size, a
            pixel and a millimetre are each one world unit. The origin is the origin of the user space of the outermost
            ``<svg>``, wherever its ``viewBox`` begins, and y points upwards. Thus the polygons of
            :meth:`Section.to_svg` keep their coordinates.

        Warns
        -----
        SurfaceWarning
            If an element has a clip path or a mask, which is ignored.

        Raises
        ------
        ShapeError
            If nothing is filled, for a path that cannot be read, or a picture whose size has an unknown unit.
        FileNotFoundError
            If there is no such file.

        Examples
        --------
        >>> import fieldbake as fb
        >>> slot = fb.Profile.from_svg("M0 0 H10 A5 5 0 0 1 10 10 H0 Z")
        >>> round(slot.area, 3)  # 100 + 12.5 pi
        139.27
        """
        if rule is not None:
            checks.choice("rule", rule, ("even-odd", "nonzero"), ShapeError)
        elements = svg_loops(source, None if tolerance is None else number("tolerance", tolerance))
        found: list[Array] = []
        for loops, own in elements:
            resolved = _core.resolved_polygons(loops, rule or own)
            found = _core.combined_polygons("union", found, resolved) if found else resolved
        if not found:
            raise ShapeError(f"source: {source!s:.60} has no filled outline")
        return cls._of(polygon_leaf(found))

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
        return Profile._of(Combined(op, (self._tree, other._tree)))

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

    def offset(self, distance: float) -> Profile:
        """Grow the profile by `distance`, world units; a negative distance shrinks it.

        The result is the set of points within `distance` of the profile, or of points farther than its magnitude from
        the outside. Its convex corners become arcs when it grows, concave ones when it shrinks. Arcs are polygons
        within 1.3e-4 of `distance`.

        Raises
        ------
        ShapeError
            If nothing is left, or for a distance that is not finite.

        Examples
        --------
        >>> import fieldbake as fb
        >>> wall = fb.rectangle((10, 6)).offset(1) - fb.rectangle((10, 6))
        >>> round(wall.area, 1)  # 32 + pi
        35.1
        """
        amount = number("distance", distance)
        grown = self._tree.grown(amount)
        if grown is None:
            loops = _core.offset_polygons(list(self.polygons), amount)
            if not loops:
                raise ShapeError(f"distance: nothing is left of the profile, got {amount:g}")
            grown = polygon_leaf(loops)
        return Profile._of(grown)

    @property
    def polygons(self) -> tuple[NDArray[np.float64], ...]:
        """Polygons (m, 2) around the region, world units, read-only: outer ones counter-clockwise, holes clockwise."""
        if self._polygons is None:
            self._polygons = tuple(checks.frozen(loop) for loop in self._tree.loops())
        return self._polygons

    @property
    def area(self) -> float:
        """Area of :attr:`polygons`, square world units."""
        return math.fsum(_area(loop) for loop in self.polygons)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """The box around :attr:`polygons`, (2, 2); ShapeError if the profile is empty."""
        if not self.polygons:
            raise ShapeError("profile: is empty, so it has no bounds")
        corners = np.concatenate(self.polygons)
        return checks.frozen(np.stack([corners.min(axis=0), corners.max(axis=0)]))

    def extrude(
        self,
        height: float,
        *,
        taper_deg: float = 0.0,
        chamfer: float | Sequence[float] = 0.0,
        twist_deg: float = 0.0,
    ) -> Shape:
        """Extrude the profile along z; see :func:`extrude`."""
        return extrude(self, height, taper_deg=taper_deg, chamfer=chamfer, twist_deg=twist_deg)

    def sweep(self, path: ArrayLike) -> Shape:
        """Move the profile along a polyline.

        Parameters
        ----------
        path : (n, 3) real
            Corners of the polyline, world units, at least two; see :func:`helix`. If the last point is the first one,
            the path is closed.

        Returns
        -------
        Shape
            The union of a prism for each segment, cut off at each corner by the plane that halves the angle. Its field
            is a lower bound on the distance; inside, about half of a short segment is its largest magnitude.

        Raises
        ------
        ShapeError
            For equal points in a row, or a corner that is too sharp for the profile and the length of its segments.

        Notes
        -----
        The profile is perpendicular to the path, with its origin on the path. Its y axis at the start is as near to +z
        as possible; at a start along z its x axis is the x axis of the world. From segment to segment the profile turns
        by the smallest rotation. A closed path must end with the rotation it began with, as flat ones do. For the swept
        volume of a moving body see :func:`sweep`.

        Examples
        --------
        >>> import fieldbake as fb
        >>> rail = fb.circle(0.5).sweep([(0, 0, 0), (10, 0, 0), (10, 6, 0)])
        >>> rail.distance([(10, 0, 0), (5, 0, 2)]).round(3).tolist()
        [-0.5, 1.5]
        """
        return sweeping.swept(self._tree.extruded, self.polygons, path)

    def revolve(self, offset: float = 0.0) -> Shape:
        """Revolve the profile about z; see :func:`revolve`."""
        return revolve(self, offset)

    def __repr__(self) -> str:
        tree = self._tree
        if isinstance(tree, Combined):
            return f"Profile({tree.op} of {len(tree.parts)})"
        if tree.kind == "polygon":
            return f"Profile({len(tree.counts)} polygons, {sum(tree.counts)} corners)"
        return f"Profile({tree.kind}, {list(tree.numbers)})"

    def _repr_svg_(self) -> str | None:
        if not self.polygons:
            return None
        lower, upper = self.bounds
        return svg_text(lower, upper, [svg_path(self.polygons)], pixels=PICTURE)


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


def polygon(points: ArrayLike | Sequence[ArrayLike], *, rule: Rule = "even-odd") -> Profile:
    """Make the region of one closed polygon, or of several with holes.

    Parameters
    ----------
    points : (n, 2) real, or a sequence of them
        Corners in order, world units, at least three for each polygon, in either orientation. Polygons may cross, touch
        and nest.
    rule : "even-odd" or "nonzero", default "even-odd"
        A point is inside if the polygons wind around it an odd number of times, or a number other than zero.

    Raises
    ------
    ShapeError
        For fewer than three corners, corners that are not finite, more than 65,536 corners, or a region without area.

    Notes
    -----
    Polygons that cross are cut at their crossings. The field of the extrusion is exact for all polygons. Its evaluation
    searches among the edges near a point, which a grid lists, so that its cost depends little on their number.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.polygon([(0, 0), (2, 0), (0, 2)]).extrude(1.0).distance([(0.5, 0.5, 2)]).tolist()
    [1.5]
    >>> frame = fb.polygon([[(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (3, 1), (3, 3), (1, 3)]])
    >>> frame.area
    12.0
    """
    checks.choice("rule", rule, ("even-odd", "nonzero"), ShapeError)
    return region(_loops(points), rule)


def region(loops: list[Array], rule: str) -> Profile:
    """The profile of polygons (m, 2) under a rule."""
    resolved = _core.resolved_polygons(loops, rule)
    if not resolved:
        raise ShapeError("points: the polygon has no area")
    return Profile._of(polygon_leaf(resolved))


def _loops(points: object) -> list[Array]:
    """Polygons from one array (n, 2) or a sequence of such arrays."""
    try:
        is_one = np.ndim(points) == 2  # type: ignore[arg-type]
    except ValueError:
        is_one = False
    parts = [("points", points)] if is_one or not isinstance(points, Sequence) else None
    if parts is None:
        assert isinstance(points, Sequence)
        parts = [(f"points[{i}]", part) for i, part in enumerate(points)]
    loops = []
    for name, part in parts:
        array = checks.real_array(name, part, "(n, 2)", ShapeError)
        if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
            raise ShapeError(f"{name}: must have shape (n, 2), three corners at least, got {checks.describe(array)}")
        loops.append(checks.as_float64(array))
    if not loops:
        raise ShapeError("points: must be one polygon (n, 2) or several, got none")
    return loops


def extrude(
    profile: Profile,
    height: float,
    *,
    taper_deg: float = 0.0,
    chamfer: float | Sequence[float] = 0.0,
    twist_deg: float = 0.0,
) -> Shape:
    """Extrude a profile along z to the height `height`, centred at z = 0.

    Parameters
    ----------
    profile : Profile
        The cross-section.
    height : float
        Height along z, world units.
    taper_deg : float, default 0
        Angle between the sides and the z axis, degrees, -89 to 89. The solid becomes narrower upwards for a positive
        angle and downwards for a negative one. Its wider end has the profile, and its other sections are the profile
        shrunk as by :meth:`Profile.offset`.
    chamfer : float or two floats, default 0
        Length that a chamfer of 45 degrees takes off the sides and off the ends, world units: for both ends, or for the
        lower and the upper end. With a taper both lengths are ``chamfer / cos(taper_deg)``.
    twist_deg : float, default 0
        Angle from the lower end to the upper end, degrees, right-handed. The section at z = 0 is not turned.

    Raises
    ------
    ShapeError
        For a value out of range.

    Notes
    -----
    The field is exact if the profile is a single circle, rectangle or polygon and has neither taper, chamfer nor twist.
    Otherwise it is a lower bound.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.extrude(fb.circle(1.0), 2.0).distance([(0, 0, 3)]).tolist()
    [2.0]
    >>> key = fb.rectangle((10, 10)).extrude(4, chamfer=(0, 1))
    >>> (key.distance([(4.9, 0, 1.9), (4.9, 0, -1.9)]) < 0).tolist()
    [False, True]
    """
    tall = number("height", height)
    ends = [number("chamfer", chamfer)] * 2 if np.ndim(chamfer) == 0 else numbers("chamfer", chamfer, 2)
    shape = _checked(profile)._tree.extruded(tall, number("taper_deg", taper_deg), (ends[0], ends[1]))
    turn = number("twist_deg", twist_deg)
    return shape.twist(per_unit_deg=turn / tall) if turn else shape


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


def _area(loop: Array) -> float:
    """Signed area of a polygon."""
    x, y = (loop - loop[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
