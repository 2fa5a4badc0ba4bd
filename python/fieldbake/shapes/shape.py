"""Shapes: solids made in code, combined with operators, drawn, baked and asked for distances."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._core import Shape as CoreShape
from ..base import checks
from ..base.errors import ArgumentError, ShapeError
from ..volumes.volume import Volume

Axis = Literal["x", "y", "z"] | Sequence[float]
Language = Literal["wgsl", "glsl", "hlsl", "msl"]

#: The axes by name.
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Shape:
    """A solid: a primitive, or others combined and changed. Immutable; every method returns a new shape.

    ``a | b`` is the union, ``a & b`` the intersection, ``a - b`` the difference, ``a ^ b`` what is in one of the
    two, and ``~a`` everything else. Shapes share their parts, so building large models is cheap.

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

    _core: CoreShape

    def __init__(self) -> None:
        raise ShapeError("shape: is made by sphere(), box() and the like, or csg.parse()")

    @classmethod
    def _wrap(cls, core: CoreShape) -> Shape:
        shape = cls.__new__(cls)
        object.__setattr__(shape, "_core", core)
        return shape

    # --- combining

    def __or__(self, other: object) -> Shape:
        return combine("union", [self, other]) if isinstance(other, Shape) else NotImplemented

    def __and__(self, other: object) -> Shape:
        return combine("intersection", [self, other]) if isinstance(other, Shape) else NotImplemented

    def __sub__(self, other: object) -> Shape:
        return combine("difference", [self, other]) if isinstance(other, Shape) else NotImplemented

    def __xor__(self, other: object) -> Shape:
        return combine("xor", [self, other]) if isinstance(other, Shape) else NotImplemented

    def __invert__(self) -> Shape:
        return self._changed("complement")

    def union(self, *others: Shape, k: float = 0.0, chamfer: float = 0.0) -> Shape:
        """All of these together, with a smooth (`k`) or chamfered joint of that width."""
        return combine("union", [self, *others], k=k, chamfer=chamfer)

    def intersection(self, *others: Shape, k: float = 0.0, chamfer: float = 0.0) -> Shape:
        """What is in all of these, with a smooth (`k`) or chamfered joint of that width."""
        return combine("intersection", [self, *others], k=k, chamfer=chamfer)

    def difference(self, *others: Shape, k: float = 0.0, chamfer: float = 0.0) -> Shape:
        """What is in none of the others, with a smooth (`k`) or chamfered joint of that width."""
        return combine("difference", [self, *others], k=k, chamfer=chamfer)

    def xor(self, *others: Shape, k: float = 0.0, chamfer: float = 0.0) -> Shape:
        """What is in one of two, from the left, with a smooth (`k`) or chamfered joint of that width."""
        return combine("xor", [self, *others], k=k, chamfer=chamfer)

    def smooth(self, k: float) -> Shape:
        """The operator at the root with a fillet: ``(a | b).smooth(0.2)``. The field differs within `k`."""
        return Shape._wrap(self._core.reblended(_number("k", k), 0.0))

    def chamfer(self, width: float) -> Shape:
        """The operator at the root with a flat at 45 degrees, which takes `width` off each side."""
        return Shape._wrap(self._core.reblended(0.0, _number("chamfer", width)))

    # --- placing

    def translate(self, offset: ArrayLike) -> Shape:
        """Moved by a vector (3,)."""
        return self._changed("translate", *_numbers("offset", offset, 3))

    def rotate(self, axis: Axis, degrees: float) -> Shape:
        """Turned about an axis through the origin, right-handed: ``"x"``, ``"y"``, ``"z"`` or a vector."""
        return self._changed("rotate", *_axis("axis", axis), _number("degrees", degrees))

    def scale(self, factor: float) -> Shape:
        """Scaled about the origin, the same on all axes."""
        return self._changed("scale", _number("factor", factor))

    def align(self, anchor: ArrayLike) -> Shape:
        """Moved so that the origin lies at `anchor` of its box: -1 the lower side, 0 the middle, 1 the upper side.

        The box is that of the sharp shape: the room that fillets take does not count.
        """
        x, y, z = _numbers("anchor", anchor, 3)
        return Shape._wrap(self._core.aligned((x, y, z)))

    def reflect(self, axis: Axis) -> Shape:
        """The mirror image in the plane through the origin that has this normal."""
        return self._changed("reflect", *_axis("axis", axis))

    def mirror(self, axis: Axis) -> Shape:
        """Together with its mirror image in the plane through the origin that has this normal."""
        return self._changed("mirror", *_axis("axis", axis))

    def repeat(self, spacing: ArrayLike, counts: ArrayLike) -> Shape:
        """Copies on a lattice about the origin, `counts` (3,) of them along the axes, `spacing` (3,) apart.

        They are a union of so many copies, which may overlap; decomposition makes them cheap to draw.
        """
        return self._changed("repeat", *_numbers("spacing", spacing, 3), *_numbers("counts", counts, 3))

    # --- changing

    def offset(self, distance: float) -> Shape:
        """All points within `distance`; a negative one takes away."""
        return self._changed("offset", _number("distance", distance))

    def shell(self, thickness: float) -> Shape:
        """A skin about the surface, half inside and half outside."""
        return self._changed("shell", _number("thickness", thickness))

    def elongate(self, size: ArrayLike) -> Shape:
        """Cut at the planes through the origin and pulled apart by `size` (3,) in all."""
        x, y, z = _numbers("size", size, 3)
        return self._changed("elongate", x / 2, y / 2, z / 2)

    def twist(self, degrees: float) -> Shape:
        """Turned about z by so many degrees a unit of z. Its field is divided by how much that stretches space."""
        return self._changed("twist", _number("degrees", degrees))

    def bend(self, degrees: float) -> Shape:
        """Turned about z by so many degrees a unit of x. Its field is divided by how much that stretches space."""
        return self._changed("bend", _number("degrees", degrees))

    # --- colour

    def paint(self, color: ArrayLike, *, over: bool = False) -> Shape:
        """Linear RGB for what is not painted yet; with `over`, for everything."""
        return self._changed("paint_over" if over else "paint", *_numbers("color", color, 3))

    def stencil(self, mask: Shape, color: ArrayLike) -> Shape:
        """Painted where it is inside `mask`."""
        return self._painted(mask, color, outside=False)

    def mask(self, mask: Shape, color: ArrayLike) -> Shape:
        """Painted where it is outside `mask`."""
        return self._painted(mask, color, outside=True)

    def _painted(self, mask: Shape, color: ArrayLike, *, outside: bool) -> Shape:
        r, g, b = _numbers("color", color, 3)
        return Shape._wrap(self._core.stencil(checked_shape("mask", mask)._core, (r, g, b), outside))

    def color(self, points: ArrayLike) -> NDArray[np.float32]:
        """Linear RGB of the surface near points (n, 3), (n, 3); nan where it is not painted."""
        flat, shape = checks.points(points)
        return self._core.color(flat).reshape(*shape, 3)

    # --- asking

    def distance(self, points: ArrayLike, *, device: str = "auto") -> NDArray[np.float32]:
        """Signed distance at any points, negative inside.

        Parameters
        ----------
        points : (n, 3) real
            World positions; any leading shape will do.
        device : str, default "auto"
            ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`fieldbake.devices`.

        Returns
        -------
        (n,) float32
            The Euclidean distance where :attr:`exact` says so; otherwise a number of the same sign that is never
            larger in size than :attr:`lipschitz` times it.

        Raises
        ------
        ArgumentError
            For a wrong shape or a point that is not finite.
        """
        flat, shape = checks.points(points)
        return self._core.distance(flat, checks.text("device", device)).reshape(shape)

    def gradient(self, points: ArrayLike) -> NDArray[np.float32]:
        """Gradient of the field at points (n, 3), (n, 3); on the surface it points outwards.

        By central differences in float64, so it is a mean of both sides on a crease.
        """
        flat, shape = checks.points(points)
        return self._core.gradient(flat).reshape(*shape, 3)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the solid, (2, 3), world units; not always the smallest. ShapeError if a part has no bounds."""
        return checks.frozen(np.array(self._core.bounds()))

    @property
    def exact(self) -> bool:
        """Whether :meth:`distance` is the Euclidean distance everywhere, inside too."""
        return self._core.is_exact

    @property
    def lipschitz(self) -> float:
        """The most that the field changes over a unit of length; 1 but for chamfers and volumes."""
        return self._core.lipschitz

    def to_sexpr(self) -> str:
        """The shape in the language of :func:`fieldbake.csg.parse`."""
        return self._core.to_sexpr()

    def shader(self, language: Language = "wgsl") -> str:
        """The field as shader text, ready to compile: ``distance_to_shape`` and a compute entry point that calls it.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            WGSL is written for readers, indented and commented; the others are its translations by naga.

        Returns
        -------
        str
            Positions and distances are in world units. Numbers are read from a buffer whose content is
            :meth:`shader_numbers`: shapes of the same structure share one text, and one pipeline.

        Raises
        ------
        ShapeError
            For another language, or a shape with a baked volume in it.
        """
        return self._core.shader(checks.text("language", language))[0]

    def shader_numbers(self) -> NDArray[np.float32]:
        """What the shader reads from its buffer ``numbers``, in order."""
        return self._core.shader("wgsl")[1]

    def _changed(self, name: str, *numbers: float) -> Shape:
        return Shape._wrap(self._core.changed(name, list(numbers)))

    def _repr_png_(self) -> bytes:
        """A picture, for notebooks."""
        from ..drawing.raymarching import raymarch

        return raymarch(self, size=(256, 256), device="cpu")._repr_png_()

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a Shape cannot be changed ({name}); its methods return new ones")

    def __eq__(self, other: object) -> bool:
        return self._core == other._core if isinstance(other, Shape) else NotImplemented

    # Equal trees may be large: hashing one would walk all of it.
    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        leaves = self._core.leaf_count
        if leaves > 12:
            return f"Shape({leaves:,} leaves)"
        try:
            return f"Shape({self.to_sexpr()})"
        except ShapeError:
            return f"Shape({leaves} leaves, one of them a volume)"

    def __reduce__(self) -> tuple[Any, ...]:
        return _from_sexpr, (self.to_sexpr(),)


def _from_sexpr(text: str) -> Shape:
    return Shape._wrap(_core.Shape.parse(text))


class Profile:
    """A flat solid in the xy plane, for :func:`extrude` and :func:`revolve`."""

    __slots__ = ("kind", "numbers")

    def __init__(self, kind: str, numbers: list[float]) -> None:
        self.kind = kind
        self.numbers = numbers
        # The core checks the numbers when it builds something of them; an extrusion costs nothing.
        _core.Shape.extrude(kind, numbers, 1.0)

    def extrude(self, height: float) -> Shape:
        """Drawn out along z; see :func:`extrude`."""
        return extrude(self, height)

    def revolve(self, offset: float = 0.0) -> Shape:
        """Turned about z; see :func:`revolve`."""
        return revolve(self, offset)

    def __repr__(self) -> str:
        return f"Profile({self.kind}, {self.numbers})"


# --- primitives, about the origin; round ones along z


def sphere(radius: float = 1.0) -> Shape:
    """A ball. Exact."""
    return _primitive("sphere", _number("radius", radius))


def ellipsoid(radii: ArrayLike) -> Shape:
    """An ellipsoid with half axes (3,). Exact."""
    return _primitive("ellipsoid", *_numbers("radii", radii, 3))


def box(size: ArrayLike = 1.0) -> Shape:
    """A box with full sides (3,), or a cube with one side. Exact."""
    return _primitive("box", *_sides(size))


def rounded_box(size: ArrayLike, radius: float) -> Shape:
    """A box of the same outer size with edges rounded by `radius`. Exact."""
    return _primitive("rounded_box", *_sides(size), _number("radius", radius))


def box_frame(size: ArrayLike, thickness: float) -> Shape:
    """The twelve edges of a box, square bars inside it. Exact outside."""
    return _primitive("box_frame", *_sides(size), _number("thickness", thickness))


def torus(radius: float = 1.0, tube: float = 0.25) -> Shape:
    """A tube of radius `tube` round a circle of `radius` in the plane z = 0. Exact while the tube is the thinner."""
    return _primitive("torus", _number("radius", radius), _number("tube", tube))


def capped_torus(radius: float, tube: float, angle_deg: float) -> Shape:
    """The arc of `angle_deg` degrees of a torus, half on each side of +x, with round ends. Exact up to 180 degrees."""
    return _primitive("capped_torus", _number("radius", radius), _number("tube", tube), _number("angle_deg", angle_deg))


def cylinder(radius: float = 1.0, height: float = 2.0) -> Shape:
    """A cylinder along z, centred. Exact."""
    return _primitive("cylinder", _number("radius", radius), _number("height", height))


def capsule(radius: float = 0.5, height: float = 1.0) -> Shape:
    """All points within `radius` of a segment of z of length `height`. Exact."""
    return _primitive("capsule", _number("radius", radius), _number("height", height))


def cone(radius: float = 1.0, height: float = 2.0) -> Shape:
    """A cone along z, centred, with its apex on top. Exact."""
    return _primitive("cone", _number("radius", radius), 0.0, _number("height", height))


def truncated_cone(radius: float, top_radius: float, height: float) -> Shape:
    """A cone along z, centred, from `radius` at the bottom to `top_radius` at the top. Exact."""
    return _primitive("cone", _number("radius", radius), _number("top_radius", top_radius), _number("height", height))


def plane(normal: Axis = "z", offset: float = 0.0) -> Shape:
    """The half space below the plane that has this normal and lies `offset` along it. Exact; it has no bounds."""
    return _primitive("plane", *_axis("normal", normal), _number("offset", offset))


def pyramid(base: float = 1.0, height: float = 1.0) -> Shape:
    """A pyramid along z, centred, over a square of side `base`. Exact."""
    return _primitive("pyramid", _number("base", base), _number("height", height))


def octahedron(radius: float = 1.0) -> Shape:
    """An octahedron with its corners on the axes at `radius`. Exact."""
    return _primitive("octahedron", _number("radius", radius))


def hex_prism(radius: float = 1.0, height: float = 1.0) -> Shape:
    """A prism along z, centred, over a regular hexagon with its corners at `radius`, two of them on x. Exact."""
    return _primitive("hex_prism", _number("radius", radius), _number("height", height))


def gyroid(cell: float = 1.0, thickness: float = 0.1) -> Shape:
    """A sheet about the gyroid, at least `thickness` thick, that repeats every `cell`. A bound; it has no bounds."""
    return _primitive("gyroid", _number("cell", cell), _number("thickness", thickness))


def circle(radius: float = 1.0) -> Profile:
    """A disc."""
    return Profile("circle", [_number("radius", radius)])


def rectangle(size: ArrayLike) -> Profile:
    """A rectangle with full sides (2,)."""
    return Profile("rectangle", _numbers("size", size, 2))


def polygon(points: ArrayLike) -> Profile:
    """A closed polygon with corners (n, 2), in either order."""
    array = checks.real_array("points", points, "(n, 2)", ShapeError)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
        raise ShapeError(f"points: must have shape (n, 2), three corners at least, got {checks.describe(array)}")
    return Profile("polygon", checks.as_float64(array).ravel().tolist())


def extrude(profile: Profile, height: float) -> Shape:
    """A profile drawn out along z, `height` in all, centred. Exact if the profile does not cross itself."""
    _profile(profile)
    return Shape._wrap(_core.Shape.extrude(profile.kind, profile.numbers, _number("height", height)))


def revolve(profile: Profile, offset: float = 0.0) -> Shape:
    """A profile turned about z: its x, plus `offset`, is the distance from the axis, its y is z."""
    _profile(profile)
    return Shape._wrap(_core.Shape.revolve(profile.kind, profile.numbers, _number("offset", offset)))


def volume_shape(volume: Volume) -> Shape:
    """A baked field as a shape: a mesh among the primitives.

    Parameters
    ----------
    volume : Volume
        Its zero level set is the surface. What its box cuts is closed by the box.

    Returns
    -------
    Shape
        In the box the trilinear field, outside it ``sqrt(a^2 + s^2)`` with the distance `a` to the box and the
        field `s` there. `Shape.lipschitz` is the slope of the samples.

    Examples
    --------
    >>> import fieldbake as fb
    >>> ball = fb.volume_shape(fb.bake(fb.sphere(1.0), 32))
    >>> bitten = ball - fb.box((1, 1, 1)).translate((1, 0, 0))
    >>> bool(bitten.distance([(0.9, 0, 0)])[0] > 0)
    True
    """
    if not isinstance(volume, Volume):
        raise ShapeError(f"volume: must be a Volume, got {checks.describe(volume)}; {_cure(volume)}")
    lower, upper = volume._corners()
    return Shape._wrap(_core.Shape.volume(volume._distances, lower, upper))


def combine(op: str, shapes: Iterable[Shape], *, k: float = 0.0, chamfer: float = 0.0) -> Shape:
    """Shapes under one operator, from the left; `op` is "union", "intersection", "difference" or "xor"."""
    checked = [checked_shape(f"shapes[{number}]", shape)._core for number, shape in enumerate(shapes)]
    return Shape._wrap(_core.Shape.combine(op, checked, _number("k", k), _number("chamfer", chamfer)))


# --- checks


def all_shapes(things: object) -> bool:
    """Whether this is a list of shapes, which is baked as their union."""
    return isinstance(things, Sequence) and len(things) > 0 and all(isinstance(thing, Shape) for thing in things)


def _cure(thing: object) -> str:
    """How to make a Volume of what is none."""
    # Where a sparse volume stores nothing it has bounds, and the steps between them would make a steep shape.
    return "bake a Volume, or give volume.to_volume()" if hasattr(thing, "to_volume") else "see bake()"


def _primitive(name: str, *numbers: float) -> Shape:
    return Shape._wrap(_core.Shape.primitive(name, list(numbers)))


def _number(name: str, value: object) -> float:
    try:
        return checks.number(name, value)
    except ArgumentError as error:
        raise ShapeError(str(error)) from None


def _numbers(name: str, value: ArrayLike, length: int) -> list[float]:
    return [float(number) for number in checks.vector(name, value, length, ShapeError)]


def _sides(size: ArrayLike) -> list[float]:
    return [_number("size", size)] * 3 if np.ndim(size) == 0 else _numbers("size", size, 3)


def _axis(name: str, axis: Axis) -> list[float]:
    if isinstance(axis, str):
        if axis not in AXES:
            raise ShapeError(f'{name}: must be "x", "y", "z" or a vector, got {checks.describe(axis)}')
        return list(AXES[axis])
    return _numbers(name, axis, 3)


def checked_shape(name: str, value: object) -> Shape:
    """The value, if it is a Shape."""
    if not isinstance(value, Shape):
        raise ShapeError(f"{name}: must be a Shape, got {checks.describe(value)}")
    return value


def _profile(value: object) -> None:
    if not isinstance(value, Profile):
        raise ShapeError(f"profile: must be a Profile, got {checks.describe(value)}; see circle(), polygon()")
