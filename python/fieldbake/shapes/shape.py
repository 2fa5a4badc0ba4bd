"""Shapes: trees of primitives and operators that can be evaluated, drawn and baked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._core import Shape as CoreShape
from ..base import checks
from ..base.errors import ShapeError
from ..base.former_names import former_names
from ..meshes.mesh import Mesh
from ..volumes.volume import Volume, plain_field
from . import arguments, exact_distance
from .arguments import Axis
from .field import Field
from .representation import python_text


class Shape(Field):
    """A solid made of primitives and operators. Immutable; every method returns a new shape.

    ``a | b`` is the union, ``a & b`` the intersection, ``a - b`` the difference, ``a ^ b`` the symmetric
    difference, and ``~a`` the complement. An operand may be a Volume, which becomes a leaf. Shapes share their
    subtrees, so large models are cheap to build. All lengths are in world units. Methods raise ShapeError for an
    argument that is not finite or out of range.

    Examples
    --------
    >>> import fieldbake as fb
    >>> dice = fb.rounded_box((2, 2, 2), 0.3) & fb.sphere(1.35)
    >>> drilled = dice - fb.cylinder(radius=0.4, height=4).rotate("x", 90)
    >>> drilled.distance([(0, 0, 0), (0, 0, 2)]).astype(float).round(3).tolist()
    [0.4, 1.0]
    >>> drilled.bounds.tolist()
    [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    """

    __slots__ = ("_core",)

    def __init__(self) -> None:
        raise ShapeError("shape: is made by functions such as sphere() and box(), or by csg.parse()")

    @classmethod
    def _wrap(cls, core: CoreShape) -> Shape:
        shape = cls.__new__(cls)
        object.__setattr__(shape, "_core", core)
        return shape

    # --- operators

    def __or__(self, other: object) -> Shape:
        return self._combined("union", other)

    def __ror__(self, other: object) -> Shape:
        return self._combined("union", other, is_second=True)

    def __and__(self, other: object) -> Shape:
        return self._combined("intersection", other)

    def __rand__(self, other: object) -> Shape:
        return self._combined("intersection", other, is_second=True)

    def __sub__(self, other: object) -> Shape:
        return self._combined("difference", other)

    def __rsub__(self, other: object) -> Shape:
        return self._combined("difference", other, is_second=True)

    def __xor__(self, other: object) -> Shape:
        return self._combined("xor", other)

    def __rxor__(self, other: object) -> Shape:
        return self._combined("xor", other, is_second=True)

    def __invert__(self) -> Shape:
        return self._changed("complement")

    def _combined(self, op: str, other: object, *, is_second: bool = False) -> Shape:
        """Combine the shape with another operand. A volume becomes a leaf."""
        operand = operand_of(other)
        if isinstance(other, Mesh):
            raise ShapeError(
                "operand: must be a Shape or a Volume, got a Mesh; fb.boolean combines meshes, and "
                "fb.volume_shape(fb.bake(mesh)) makes a shape of one"
            )
        if operand is None:
            return NotImplemented  # type: ignore[no-any-return]
        return combine(op, [operand, self] if is_second else [self, operand])

    def union(
        self, *others: Shape, k: float = 0.0, chamfer: float = 0.0, resolution: int = exact_distance.RESOLUTION
    ) -> Shape:
        """Unite the shapes.

        Parameters
        ----------
        *others : Shape
            Further operands.
        k : float, default 0
            Width of a smooth joint, world units: the field changes where two operands differ by less, by up to a
            quarter of it. So faces of both operands in one plane bulge by a quarter of `k`. 0 is sharp.
        chamfer : float, default 0
            Width of a chamfered joint, world units. 0 is sharp. A joint is smooth or chamfered, and not both.
        resolution : int, default 128
            Voxels along the longest side of the box of an operand whose field is scaled by `twist`, `bend`,
            `elongate`, `times` or a periodic sheet. Its distance is baked for a smooth or chamfered joint, so that the
            width is in world units. Sharp joints, and joints of other operands, have no use for it.

        Raises
        ------
        ShapeError
            For an operand that is not a Shape, a negative width, both widths, or a scaled operand without bounds.
        """
        return combine("union", [self, *others], k=k, chamfer=chamfer, resolution=resolution)

    def intersection(
        self, *others: Shape, k: float = 0.0, chamfer: float = 0.0, resolution: int = exact_distance.RESOLUTION
    ) -> Shape:
        """Intersect the shapes; operands, joints and errors are the same as in :meth:`union`."""
        return combine("intersection", [self, *others], k=k, chamfer=chamfer, resolution=resolution)

    def difference(
        self, *others: Shape, k: float = 0.0, chamfer: float = 0.0, resolution: int = exact_distance.RESOLUTION
    ) -> Shape:
        """Subtract the other shapes; operands, joints and errors are the same as in :meth:`union`."""
        return combine("difference", [self, *others], k=k, chamfer=chamfer, resolution=resolution)

    def xor(
        self, *others: Shape, k: float = 0.0, chamfer: float = 0.0, resolution: int = exact_distance.RESOLUTION
    ) -> Shape:
        """Take the symmetric difference from left to right; operands, joints and errors as in :meth:`union`."""
        return combine("xor", [self, *others], k=k, chamfer=chamfer, resolution=resolution)

    def smooth(self, k: float, *, resolution: int = exact_distance.RESOLUTION) -> Shape:
        """Replace the joint of the root operator by a fillet, as in ``(a | b).smooth(0.2)``.

        The field changes only where the two operands differ by less than `k`, world units, by up to a quarter of it:
        faces of both operands in one plane bulge by that. `resolution` is as for :meth:`union`.
        """
        return self._jointed(arguments.number("k", k), 0.0, resolution)

    def chamfer(self, width: float, *, resolution: int = exact_distance.RESOLUTION) -> Shape:
        """Replace the joint of the root operator by a flat at 45 degrees that takes `width` off each side.

        The flat also cuts a wall no thicker than `width` between two operands that do not meet.
        `width` is in world units, and `resolution` is as for :meth:`union`.
        """
        return self._jointed(0.0, arguments.number("chamfer", width), resolution)

    def _jointed(self, k: float, chamfer: float, resolution: int) -> Shape:
        op, operands = self._core.operands() or ("", [])
        if all(operand.field_kind != "scaled" for operand in operands):
            return Shape._wrap(self._core.reblended(k, chamfer))
        return combine(op, [Shape._wrap(core) for core in operands], k=k, chamfer=chamfer, resolution=resolution)

    # --- placement

    def translate(self, offset: ArrayLike) -> Shape:
        """Move the shape by a vector (3,), world units."""
        return self._changed("translate", *arguments.numbers("offset", offset, 3))

    @former_names(degrees="angle_deg")
    def rotate(self, axis: Axis, angle_deg: float) -> Shape:
        """Rotate about ``"x"``, ``"y"``, ``"z"`` or a vector (3,) through the origin, right-handed, by degrees."""
        swapped: object = angle_deg
        if isinstance(swapped, str) or (np.ndim(axis) == 0 and not isinstance(axis, str)):
            raise ShapeError(
                "axis: rotate(axis, angle_deg) takes the axis first, "
                f"got rotate({checks.describe(axis)}, {checks.describe(angle_deg)})"
            )
        return self._changed("rotate", *arguments.axis_of("axis", axis), arguments.number("angle_deg", angle_deg))

    def orient(self, axis: str | Sequence[float]) -> Shape:
        """Rotate the z axis of the shape to ``"x"``, ``"-x"``, ... or a vector, by the smallest angle."""
        letter: Any = axis[1:] if isinstance(axis, str) and axis[:1] == "-" else axis
        direction: NDArray[np.float64] = np.array(arguments.axis_of("axis", letter), dtype=np.float64)
        length = float(np.linalg.norm(direction))
        if not length > 0:
            raise ShapeError("axis: must not be zero")
        direction *= (1.0 if letter is axis else -1.0) / length
        across = np.cross((0.0, 0.0, 1.0), direction)
        sine = float(np.linalg.norm(across))
        # Opposite to z, half a turn about any perpendicular axis is the smallest rotation.
        turn = across / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
        degrees = float(np.degrees(np.arctan2(sine, direction[2])))
        return self.rotate(turn.tolist(), degrees) if degrees else self

    def scale(self, factor: float) -> Shape:
        """Scale about the origin by the same factor, above 0, along all axes."""
        return self._changed("scale", arguments.number("factor", factor))

    def align(self, anchor: ArrayLike) -> Shape:
        """Move the point `anchor` (3,) of the bounding box to the origin; -1 is the lower side, 1 the upper side.

        The bounding box encloses the shape with sharp joints; fillets do not enlarge it.
        """
        x, y, z = arguments.numbers("anchor", anchor, 3)
        return Shape._wrap(self._core.aligned((x, y, z)))

    def reflect(self, axis: Axis) -> Shape:
        """Reflect the shape in the plane through the origin with this normal."""
        return self._changed("reflect", *arguments.axis_of("axis", axis))

    def mirror(self, axis: Axis) -> Shape:
        """Unite the shape with its reflection in the plane through the origin with this normal."""
        return self._changed("mirror", *arguments.axis_of("axis", axis))

    def repeat(self, spacing: ArrayLike, counts: ArrayLike) -> Shape:
        """Repeat the shape on a centred lattice: `counts` (3,) copies along the axes, at the distances `spacing` (3,).

        The result is the union of all copies, which may overlap. More than 64 copies of one primitive that fits into
        its cell, a box with the sides `spacing`, are evaluated at the two nearest ones along each axis. Their cost does
        not depend on their number. The field is the field of the union if the primitive is exact, else a lower bound.
        Decomposition makes other repetitions cheap to draw.
        """
        return self._changed(
            "repeat", *arguments.numbers("spacing", spacing, 3), *arguments.numbers("counts", counts, 3)
        )

    def circular_array(self, count: int, radius: float = 0.0) -> Shape:
        """Unite `count` copies at equal angles about z; each is first moved by `radius` along x."""
        number = checks.integer("count", count, least=1, most=100_000, error=ShapeError)
        first = self.translate((arguments.number("radius", radius), 0.0, 0.0))
        return combine("union", [first.rotate("z", 360.0 * i / number) for i in range(number)])

    # --- deformation

    def offset(self, distance: float, *, resolution: int | None = None) -> Shape:
        """Grow the shape by `distance`, world units; a negative distance shrinks it.

        Parameters
        ----------
        distance : float
            Distance of the new surface from the old one, world units.
        resolution : int, optional
            Voxels along the longest side of the box for a bake of the distance. The default is 128 where a bake is
            needed, and none elsewhere.

        Raises
        ------
        ShapeError
            If `distance` is not finite, or a bake is needed and the shape has no bounds or no surface.

        Notes
        -----
        Unions, intersections and differences of exact shapes shift their field: all faces move by the distance, and the
        edges between them stay sharp. The fields of `twist`, `bend`, most `elongate`, periodic sheets, `xor`, smooth
        and chamfered joints, and volumes are no distances. For these the distance from the surface is baked, as it is
        for any shape with `resolution`: the result then has round convex edges, no colours, and a volume as a leaf,
        which shader text and the language of shapes do not support. :attr:`field_error` bounds its error. The offset
        of ``shape.times(factor)`` is ``shape.offset(distance).times(factor)``.

        Examples
        --------
        >>> import fieldbake as fb
        >>> fb.box(2).offset(0.5).distance([(2, 0, 0)]).tolist()
        [0.5]
        >>> bar = fb.box((1, 1, 4)).twist(per_unit_deg=30)
        >>> grown = bar.offset(0.1)
        >>> grown.distance([(0.6, 0, 0)]).astype(float).round(2).tolist()
        [0.0]
        """
        amount = arguments.number("distance", distance)
        scaled = self._core.without_factor()
        if scaled is not None and resolution is None:
            factor, operand = scaled
            return Shape._wrap(operand).offset(amount).times(factor)
        return self._distance("offset", (amount,), resolution)._changed("offset", amount)

    def shell(self, thickness: float, *, resolution: int | None = None) -> Shape:
        """Replace the solid by a shell about its surface. Half of `thickness`, world units, lies on each side.

        `resolution`, errors and bakes are as for :meth:`offset`.
        """
        amount = arguments.number("thickness", thickness)
        scaled = self._core.without_factor()
        if scaled is not None and resolution is None:
            factor, operand = scaled
            return Shape._wrap(operand).shell(amount).times(factor)
        if not amount > 0:
            return self._changed("shell", amount)
        return self._distance("shell", (-amount / 2, amount / 2), resolution)._changed("shell", amount)

    def _distance(self, name: str, levels: tuple[float, ...], resolution: int | None) -> Shape:
        """The shape itself if its field is a distance, else a leaf with its baked distance at `levels`."""
        if resolution is None and self._core.field_kind == "distance":
            return self
        count = _count(exact_distance.RESOLUTION if resolution is None else resolution)
        return Shape._wrap(exact_distance.distance_leaf(self._core, name, levels, max(*levels, 0.0), count))

    def times(self, factor: float, *, add: float = 0.0) -> Shape:
        """Multiply the field by `factor`, 1e-6 to 1e6, then add `add`. Without `add` the solid stays.

        The field ``shape.times(0.1, add=0.02)`` is 0.02 on the surface and changes by 0.1 per unit of distance. It
        may be the thickness of :func:`gyroid`. The result is a distance only for the factor 1.
        """
        scaled = self._changed("times", arguments.number("factor", factor))
        added = arguments.number("add", add)
        return scaled._changed("offset", -added) if added else scaled

    def elongate(self, size: ArrayLike) -> Shape:
        """Cut the shape at the coordinate planes and pull the pieces apart by `size` (3,) in total."""
        x, y, z = arguments.numbers("size", size, 3)
        return self._changed("elongate", x / 2, y / 2, z / 2)

    @former_names(
        "per_unit_deg= (degrees per world unit of z) or pitch= (world units of z per turn)",
        degrees="per_unit_deg or pitch",
    )
    def twist(self, *, per_unit_deg: float | None = None, pitch: float | None = None) -> Shape:
        """Twist about z, right-handed. The field is divided by the largest stretch of space.

        Parameters
        ----------
        per_unit_deg : float
            Angle of the twist per world unit of z, degrees. Either this or `pitch` must be given.
        pitch : float
            Length of a full turn along z, world units, not 0; a negative one is left-handed.

        Raises
        ------
        ShapeError
            For none or both of the two, or a value out of range.

        Examples
        --------
        >>> import fieldbake as fb
        >>> fb.box((1, 1, 4)).twist(pitch=8) == fb.box((1, 1, 4)).twist(per_unit_deg=45)
        True
        """
        return self._changed("twist", arguments.per_unit_deg(per_unit_deg, "pitch", pitch, turn_deg=360.0))

    @former_names(
        "per_unit_deg= (degrees per world unit of x) or radius= (world units)", degrees="per_unit_deg or radius"
    )
    def bend(self, *, per_unit_deg: float | None = None, radius: float | None = None) -> Shape:
        """Bend about z. The field is divided by the largest stretch of space.

        Parameters
        ----------
        per_unit_deg : float
            Angle of the bend per world unit of x, degrees. Either this or `radius` must be given.
        radius : float
            Distance along x in which the angle grows by one radian, world units, not 0. A negative one bends the other
            way.

        Raises
        ------
        ShapeError
            For none or both of the two, or a value out of range.

        Notes
        -----
        Each point is rotated about z by an angle in proportion to its own x. The x axis becomes a curve through the
        origin and not a circle: its radius of curvature there is half of `radius`.

        Examples
        --------
        >>> import fieldbake as fb
        >>> bent = fb.box((4, 0.4, 0.4)).bend(radius=2)
        >>> bent.exact
        False
        """
        return self._changed("bend", arguments.per_unit_deg(per_unit_deg, "radius", radius, turn_deg=math.degrees(1)))

    # --- colour

    def paint(self, color: ArrayLike, *, over: bool = False) -> Shape:
        """Paint the parts that have no colour yet, or all parts with `over`; linear RGB (3,)."""
        return self._changed(
            "paint_over" if checks.flag("over", over) else "paint", *arguments.numbers("color", color, 3)
        )

    def stencil(self, mask: Shape, color: ArrayLike) -> Shape:
        """Paint the surface inside `mask`; linear RGB (3,)."""
        return self._painted(mask, color, outside=False)

    def mask(self, mask: Shape, color: ArrayLike) -> Shape:
        """Paint the surface outside `mask`; linear RGB (3,)."""
        return self._painted(mask, color, outside=True)

    def _painted(self, mask: Shape, color: ArrayLike, *, outside: bool) -> Shape:
        r, g, b = arguments.numbers("color", color, 3)
        return Shape._wrap(self._core.stencil(checked_shape("mask", mask)._core, (r, g, b), outside))

    def color(self, points: ArrayLike) -> NDArray[np.float32]:
        """Evaluate the colour of the surface near points (n, 3): linear RGB (n, 3), nan where it is not painted."""
        flat, shape = checks.points(points)
        return self._core.color(flat).reshape(*shape, 3)

    def _changed(self, name: str, *numbers: float) -> Shape:
        return Shape._wrap(self._core.changed(name, list(numbers)))

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a Shape cannot be changed ({name}); its methods return new ones")

    def __eq__(self, other: object) -> bool:
        return self._core == other._core if isinstance(other, Shape) else NotImplemented

    # Hashing a large tree would visit all of it.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        leaves = self._core.leaf_count
        if leaves > 12:
            return f"Shape({leaves:,} leaves)"
        try:
            return f"Shape({python_text(self.to_sexpr())})"
        except ShapeError:
            error = self.field_error
            bound = f", field_error={error:.2g}" if 0 < error < math.inf else ""
            return f"Shape({leaves} {'leaf' if leaves == 1 else 'leaves'}, one of them a volume{bound})"

    def __copy__(self) -> Shape:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Shape:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        try:
            return _from_sexpr, (self.to_sexpr(),)
        except ShapeError as error:
            raise ShapeError(f"{error}; to pickle it, save the volume and make the shape of it again") from None


def _from_sexpr(text: str) -> Shape:
    return Shape._wrap(_core.Shape.parse(text))


def combine(
    op: str,
    shapes: Iterable[object],
    *,
    k: float = 0.0,
    chamfer: float = 0.0,
    resolution: int = exact_distance.RESOLUTION,
) -> Shape:
    """Combine shapes from the left; `op` is "union", "intersection", "difference" or "xor".

    Operands of a smooth or chamfered joint whose field is scaled are replaced by their baked distance.
    """
    checked = [
        checked_shape(f"shapes[{number}]", operand_of(shape) or shape)._core for number, shape in enumerate(shapes)
    ]
    widths = arguments.number("k", k), arguments.number("chamfer", chamfer)
    scaled = [core.field_kind == "scaled" for core in checked]
    if max(widths) > 0 and any(scaled) and len(checked) > 1:
        count = _count(resolution)
        reach = max(widths)
        box = _joint_box(op, checked, reach)
        checked = [
            exact_distance.distance_leaf(core, op, (0.0,), reach, count, box) if is_scaled else core
            for core, is_scaled in zip(checked, scaled, strict=True)
        ]
    return Shape._wrap(_core.Shape.combine(op, checked, *widths))


def _joint_box(op: str, operands: list[CoreShape], width: float) -> NDArray[np.float64]:
    """The box (2, 3) in which a joint of this width needs the fields of its operands."""
    sharp = Shape._wrap(_core.Shape.combine(op, operands, 0.0, 0.0))
    try:
        return sharp.bounds + width * np.array([[-1.0], [1.0]])
    except ShapeError as error:
        raise ShapeError(
            f"{op}: a smooth or chamfered joint bakes the distance of operands whose field is scaled, which needs "
            f"bounds: {error}"
        ) from None


def _count(resolution: object) -> int:
    return checks.integer("resolution", resolution, least=1, most=1 << 20, error=ShapeError)


def operand_of(value: object) -> Shape | None:
    """Convert an operand to a shape: a Shape stays, a Volume becomes a leaf; None for any other object."""
    if isinstance(value, Shape):
        return value
    value = plain_field(value)
    if isinstance(value, Volume):
        lower, upper = value._corners()
        return Shape._wrap(_core.Shape.volume(value._distances, lower, upper))
    return None


def all_shapes(geometries: object) -> bool:
    """Whether the value is a non-empty sequence of shapes, which is baked as their union."""
    return (
        isinstance(geometries, Sequence)
        and len(geometries) > 0
        and all(isinstance(geometry, Shape) for geometry in geometries)
    )


def checked_shape(name: str, value: object) -> Shape:
    """Check that a value is a Shape."""
    if not isinstance(value, Shape):
        raise ShapeError(f"{name}: must be a Shape, got {checks.describe(value)}")
    return value
