"""The primitives: simple solids about the origin, and round ones between two points.

All sizes are in world units, and every function raises ShapeError for a size out of range. "Exact" means that the field
is the Euclidean distance, inside and outside.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ShapeError
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume, plain_field
from .arguments import Axis, axis_of, number, numbers, sides
from .shape import Shape

#: The public functions; the package exports all of them.
__all__ = [
    "box",
    "box_frame",
    "capped_torus",
    "capsule",
    "cone",
    "cylinder",
    "diamond",
    "ellipsoid",
    "gyroid",
    "hex_prism",
    "iwp",
    "octahedron",
    "plane",
    "pyramid",
    "rounded_box",
    "rounded_cone",
    "rounded_cylinder",
    "schwarz_p",
    "slab",
    "sphere",
    "torus",
    "truncated_cone",
    "volume_shape",
]

#: A number, or a point (3,) where a primitive may lie between two points.
Number = float | ArrayLike

Point = NDArray[np.float64]


# --- primitives, about the origin; round ones along z


def sphere(radius: float = 1.0) -> Shape:
    """Make a ball with this radius, world units, about the origin. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.sphere(1.0).distance([(0, 0, 0), (3, 0, 0)]).tolist()
    [-1.0, 2.0]
    """
    return _primitive("sphere", number("radius", radius))


def ellipsoid(radii: ArrayLike) -> Shape:
    """Make an ellipsoid with the half axes `radii` (3,), world units, about the origin. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.ellipsoid((1, 2, 3)).distance([(2, 0, 0), (0, 0, 4)]).tolist()
    [1.0, 1.0]
    """
    return _primitive("ellipsoid", *numbers("radii", radii, 3))


def box(size: ArrayLike = 1.0) -> Shape:
    """Make a centred box with the full sides `size` (3,), world units, or a cube with one side. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.box((2, 2, 4)).distance([(0, 0, 0), (2, 0, 0)]).tolist()
    [-1.0, 1.0]
    """
    return _primitive("box", *sides(size))


def rounded_box(size: ArrayLike, radius: float) -> Shape:
    """Make a centred box with the full sides `size` (3,) and edges of the radius `radius`. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.rounded_box((2, 2, 2), 0.2).distance([(2, 0, 0), (0, 0, 0)]).tolist()
    [1.0, -1.0]
    """
    return _primitive("rounded_box", *sides(size), number("radius", radius))


def box_frame(size: ArrayLike, thickness: float) -> Shape:
    """Make the edges of a box with the full sides `size` (3,), as square bars inside it. Its field is exact outside.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.box_frame((2, 2, 2), 0.2).distance([(0, 0, 0), (2, 1, 0)])
    array([1.1313709, 1.       ], dtype=float32)
    """
    return _primitive("box_frame", *sides(size), number("thickness", thickness))


def torus(radius: float = 1.0, tube: float = 0.25) -> Shape:
    """Make a torus: a tube of radius `tube` around a circle of `radius` at z = 0. Exact while `tube` <= `radius`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.torus(1.0, 0.25).distance([(1, 0, 0), (0, 0, 0)]).tolist()
    [-0.25, 0.75]
    """
    return _primitive("torus", number("radius", radius), number("tube", tube))


def capped_torus(radius: float, tube: float, angle_deg: float) -> Shape:
    """Make an arc of a torus with round ends, `angle_deg` degrees wide about +x. Exact up to 180 degrees.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.capped_torus(1.0, 0.25, 90).distance([(1, 0, 0), (-1, 0, 0)])
    array([-0.25    ,  1.597759], dtype=float32)
    """
    return _primitive("capped_torus", number("radius", radius), number("tube", tube), number("angle_deg", angle_deg))


def cylinder(radius: Number = 1.0, height: Number = 2.0, *rest: float) -> Shape:
    """Make a centred cylinder along z of this radius and height, world units. Its field is exact.

    ``cylinder(a, b, radius)`` makes one between two points (3,).

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.cylinder(1.0, 2.0).distance([(0, 0, 0), (2, 0, 0)]).tolist()
    [-1.0, 1.0]
    """
    if _is_point(radius):
        start, end, (size,) = _segment("cylinder(a, b, radius)", radius, height, rest, ("radius",))
        return _between(cylinder(size, _length(start, end)), start, end)
    _no_more("cylinder(radius, height)", rest)
    return _primitive("cylinder", number("radius", radius), number("height", height))


def rounded_cylinder(radius: float = 1.0, height: float = 2.0, rounding: float = 0.1) -> Shape:
    """Make a centred cylinder along z whose edges are rounded; the sizes include the rounding. Its field is exact.

    Parameters
    ----------
    radius : float, default 1.0
        Radius of the side.
    height : float, default 2.0
        Distance between the two flat faces.
    rounding : float, default 0.1
        Radius of the edges, at most `radius` and half of `height`.

    Returns
    -------
    Shape

    Raises
    ------
    ShapeError
        If a size is not positive, or `rounding` is negative or larger than its limit.

    Examples
    --------
    >>> import fieldbake as fb
    >>> peg = fb.rounded_cylinder(1, 2, 0.5)
    >>> peg.distance([(2, 0, 0), (0, 0, 0)]).tolist()
    [1.0, -1.0]
    """
    return _primitive(
        "rounded_cylinder", number("radius", radius), number("height", height), number("rounding", rounding)
    )


def capsule(radius: Number = 0.5, height: Number = 1.0, *rest: float) -> Shape:
    """Make a capsule: the points within `radius` of a centred segment of length `height` along z. Its field is exact.

    ``capsule(a, b, radius)`` takes the ends of the segment, two points (3,).

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.capsule(0.5, 2.0).distance([(0, 0, 0), (0, 0, 2)]).tolist()
    [-0.5, 0.5]
    """
    if _is_point(radius):
        start, end, (size,) = _segment("capsule(a, b, radius)", radius, height, rest, ("radius",))
        return _between(capsule(size, _length(start, end)), start, end)
    _no_more("capsule(radius, height)", rest)
    return _primitive("capsule", number("radius", radius), number("height", height))


def cone(radius: Number = 1.0, height: Number = 2.0, *rest: float) -> Shape:
    """Make a cone along z: a base of `radius` at -height / 2, the apex at height / 2. Its field is exact.

    ``cone(a, b, radius)`` has its base at `a` and its apex at `b`, two points (3,). A fourth argument is the radius at
    `b` of a truncated cone.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.cone(1.0, 2.0).distance([(0, 0, 2), (0, 0, -2)]).tolist()
    [1.0, 1.0]
    """
    if _is_point(radius):
        named = ("radius", "top_radius")[: max(1, len(rest))]
        start, end, sizes = _segment("cone(a, b, radius)", radius, height, rest, named)
        top = sizes[1] if len(sizes) > 1 else 0.0
        length = _length(start, end)
        made = cone(sizes[0], length) if top == 0 else truncated_cone(sizes[0], top, length)
        return _between(made, start, end)
    _no_more("cone(radius, height)", rest)
    return _primitive("cone", number("radius", radius), 0.0, number("height", height))


def truncated_cone(radius: float, top_radius: float, height: float) -> Shape:
    """Make a centred cone along z from `radius` at the bottom to `top_radius` at the top. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.truncated_cone(1.0, 0.5, 2.0).distance([(0, 0, 2), (0, 0, 0)])
    array([ 1.       , -0.7276069], dtype=float32)
    """
    return _primitive("cone", number("radius", radius), number("top_radius", top_radius), number("height", height))


def rounded_cone(radius: float, top_radius: float, height: float) -> Shape:
    """Make the convex hull of two balls on the z axis. Its field is exact.

    Parameters
    ----------
    radius : float
        Radius of the ball at the bottom, 0 or more.
    top_radius : float
        Radius of the ball at the top, 0 or more. One of the two radii is above 0.
    height : float
        Distance between the centres of the balls, 0 or more; the origin is halfway. If it is smaller than the
        difference of the radii, the larger ball contains the other and is the result.

    Returns
    -------
    Shape

    Raises
    ------
    ShapeError
        If a size is negative, or both radii are 0.

    Examples
    --------
    >>> import fieldbake as fb
    >>> drop = fb.rounded_cone(1, 0.5, 3)
    >>> drop.bounds.tolist()
    [[-1.0, -1.0, -2.5], [1.0, 1.0, 2.0]]
    """
    return _primitive(
        "rounded_cone", number("radius", radius), number("top_radius", top_radius), number("height", height)
    )


def plane(normal: Axis = "z", offset: float = 0.0) -> Shape:
    """Make the half space ``dot(p, normal) <= offset`` of a unit normal. Its field is exact; it has no bounds.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.plane("z", 0.5).distance([(0, 0, 0), (5, 5, 2)]).tolist()
    [-0.5, 1.5]
    """
    return _primitive("plane", *axis_of("normal", normal), number("offset", offset))


def slab(thickness: float = 1.0, normal: Axis = "z") -> Shape:
    """Make the space between two parallel planes, centred at the origin. Its field is exact; it has no bounds.

    Parameters
    ----------
    thickness : float, default 1.0
        Distance between the two planes.
    normal : {"x", "y", "z"} or array_like (3,), default "z"
        Direction across the slab, of any length.

    Returns
    -------
    Shape
        A shape that is infinite along its planes, as :func:`plane` is. Intersect it with a bounded shape to bake or
        draw it.

    Raises
    ------
    ShapeError
        If `thickness` is not positive, or `normal` is zero.

    Examples
    --------
    >>> import fieldbake as fb
    >>> disc = fb.sphere(2) & fb.slab(1)
    >>> disc.distance([(0, 0, 1), (0, 0, 0)]).tolist()
    [0.5, -0.5]
    >>> disc.bounds[:, 2].tolist()
    [-0.5, 0.5]
    """
    return _primitive("slab", number("thickness", thickness), *axis_of("normal", normal))


def pyramid(base: float = 1.0, height: float = 1.0) -> Shape:
    """Make a centred pyramid along z of this height over a square of side `base`. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.pyramid(1.0, 1.0).distance([(0, 0, 1), (0, 0, -1)]).tolist()
    [0.5, 0.5]
    """
    return _primitive("pyramid", number("base", base), number("height", height))


def octahedron(radius: float = 1.0) -> Shape:
    """Make an octahedron with its corners on the axes at `radius`. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.octahedron(1.0).distance([(2, 0, 0), (1, 1, 1)])
    array([1.       , 1.1547005], dtype=float32)
    """
    return _primitive("octahedron", number("radius", radius))


def hex_prism(radius: float = 1.0, height: float = 1.0) -> Shape:
    """Make a centred prism along z over a hexagon with corners at `radius`, two of them on x. Its field is exact.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.hex_prism(1.0, 1.0).distance([(0, 0, 0), (2, 0, 0)]).tolist()
    [-0.5, 1.0]
    """
    return _primitive("hex_prism", number("radius", radius), number("height", height))


def gyroid(cell: float = 1.0, thickness: float | Shape | Volume | SparseVolume = 0.1) -> Shape:
    """Make a sheet about the gyroid.

    Parameters
    ----------
    cell : float, default 1
        Period of the surface, world units.
    thickness : float, Shape, Volume or SparseVolume, default 0.1
        The sheet is at least this thick, world units. A shape or a volume is a field that gives the thickness at each
        point; the sheet may be thinner where the field changes, and is absent where it is 0 or less. See
        :meth:`Shape.times` for its slope.

    Returns
    -------
    Shape
        A shape without bounds. Its field divided by `Shape.lipschitz` is a lower bound of the distance. For a number
        `lipschitz` is 1.

    Examples
    --------
    >>> import fieldbake as fb
    >>> core = fb.sphere(1.0) & fb.gyroid(cell=0.5, thickness=0.05)
    >>> core.bounds.tolist()
    [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]

    The sheet of this core is 0.02 thick at the bottom and 0.12 at the top:

    >>> height = fb.plane("z", -1.0)
    >>> graded = fb.sphere(1.0) & fb.gyroid(cell=0.5, thickness=height.times(0.05, add=0.02))
    >>> graded.lipschitz
    1.0
    """
    return _sheet("gyroid", cell, thickness)


def schwarz_p(cell: float = 1.0, thickness: float | Shape | Volume | SparseVolume = 0.1) -> Shape:
    """Make a sheet about the primitive surface of Schwarz.

    Parameters
    ----------
    cell, thickness
        As for :func:`gyroid`.

    Returns
    -------
    Shape
        A shape without bounds, as for :func:`gyroid`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> core = fb.sphere(1.0) & fb.schwarz_p(cell=0.5, thickness=0.05)
    >>> core.bounds.tolist()
    [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    """
    return _sheet("schwarz_p", cell, thickness)


def diamond(cell: float = 1.0, thickness: float | Shape | Volume | SparseVolume = 0.1) -> Shape:
    """Make a sheet about the diamond surface of Schwarz.

    Parameters
    ----------
    cell, thickness
        As for :func:`gyroid`.

    Returns
    -------
    Shape
        A shape without bounds, as for :func:`gyroid`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> core = fb.sphere(1.0) & fb.diamond(cell=0.5, thickness=0.05)
    >>> core.bounds.tolist()
    [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    """
    return _sheet("diamond", cell, thickness)


def iwp(cell: float = 1.0, thickness: float | Shape | Volume | SparseVolume = 0.1) -> Shape:
    """Make a sheet about the I-WP surface of Schoen.

    Parameters
    ----------
    cell, thickness
        As for :func:`gyroid`.

    Returns
    -------
    Shape
        A shape without bounds, as for :func:`gyroid`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> core = fb.sphere(1.0) & fb.iwp(cell=0.5, thickness=0.05)
    >>> core.bounds.tolist()
    [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    """
    return _sheet("iwp", cell, thickness)


def volume_shape(volume: Volume | SparseVolume) -> Shape:
    """Make a shape from a baked field, so that a mesh can be combined with primitives.

    Parameters
    ----------
    volume : Volume or SparseVolume
        The volume whose zero level set is the surface. The faces of the box close a surface that the box cuts. A sparse
        volume is converted to its dense grid.

    Returns
    -------
    Shape
        A shape whose field is trilinear inside the box. Outside the box the field is ``sqrt(a^2 + s^2)``, where `a` is
        the distance to the box and `s` the field at the nearest point of the box. `Shape.lipschitz` is the largest
        slope.

    Examples
    --------
    >>> import fieldbake as fb
    >>> ball = fb.volume_shape(fb.bake(fb.sphere(1.0), 32))
    >>> bitten = ball - fb.box((1, 1, 1)).translate((1, 0, 0))
    >>> bool(bitten.distance([(0.9, 0, 0)])[0] > 0)
    True
    """
    volume = plain_field(volume)
    if isinstance(volume, SparseVolume):
        volume = volume.to_volume()
    if not isinstance(volume, Volume):
        raise ShapeError(f"volume: must be a Volume, got {checks.describe(volume)}; see bake()")
    lower, upper = volume._corners()
    return Shape._wrap(_core.Shape.volume(volume._distances, lower, upper))


def _primitive(name: str, *numbers: float) -> Shape:
    return Shape._wrap(_core.Shape.primitive(name, list(numbers)))


#: Largest magnitude of the level function of each periodic surface, divided by the bound of its gradient (these bounds
#: are in src/csg/tree/primitive.rs). I-WP is 3 - (X - Y)^2 - (Y - Z)^2 - (Z - X)^2 for the cosines X, Y and Z, so it
#: lies between -5 and 3.
_LARGEST = {
    "gyroid": 1.5 / math.sqrt(3),
    "schwarz_p": 3 / math.sqrt(3),
    "diamond": math.sqrt(2) / math.sqrt(3),
    "iwp": 5 / math.sqrt(27),
}


def _sheet(name: str, cell: float, thickness: float | Shape | Volume | SparseVolume) -> Shape:
    """Make a sheet about a periodic surface, whose thickness is a number or a field."""
    cell = number("cell", cell)
    thickness = plain_field(thickness)
    if isinstance(thickness, Volume | SparseVolume):
        thickness = volume_shape(thickness)
    if not isinstance(thickness, Shape):
        return _primitive(name, cell, number("thickness", thickness))
    # Let g be the distance of the sheet of thickness 0, t the thickness, and T/2 the largest value of g. The chamfered
    # intersection of g - T/2 and -t/2 with the width T/2 is max(g - T/2, -t/2, (g - t/2) / sqrt(2)). The first is at
    # most 0 everywhere, so the result is at most 0 where t >= 0 and g <= t/2.
    width = 1.0001 * cell * _LARGEST[name] / (2 * math.pi)
    whole = _primitive(name, cell, 2 * width)
    half = ~thickness.times(0.5)
    return Shape._wrap(_core.Shape.combine("intersection", [whole._core, half._core], 0.0, width))


def _is_point(value: object) -> bool:
    return np.ndim(value) == 1  # type: ignore[arg-type]


def _segment(
    usage: str, start: ArrayLike, end: ArrayLike, rest: tuple[float, ...], names: tuple[str, ...]
) -> tuple[Point, Point, list[float]]:
    """Check the two ends and the sizes of a primitive between two points."""
    if len(rest) != len(names):
        raise ShapeError(f"{names[0]}: use {usage} with two points (3,)")
    ends = np.array([numbers("a", start, 3), numbers("b", end, 3)])
    if (ends[0] == ends[1]).all():
        raise ShapeError(f"b: must differ from a, got {ends[1].tolist()} twice")
    return ends[0], ends[1], [number(name, value) for name, value in zip(names, rest, strict=True)]


def _length(start: Point, end: Point) -> float:
    return float(np.linalg.norm(end - start))


def _between(shape: Shape, start: Point, end: Point) -> Shape:
    """Move a shape centred on the z axis so that its axis runs from one point to another."""
    return shape.orient((end - start).tolist()).translate(((start + end) / 2).tolist())


def _no_more(usage: str, rest: tuple[float, ...]) -> None:
    if rest:
        raise ShapeError(f"radius: use {usage}, or two points (3,) before the radius")
