"""Constructive solid geometry: the language, and decomposition.

>>> import fieldbake as fb
>>> model = fb.csg.parse("(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))")
>>> for part in fb.csg.decompose(model, method="aabb"):
...     print(len(part.boxes), part.shape.to_sexpr())
1 (cube 3)
1 (diff (cube 4) (move -2 -2 2 (sphere 5)))
7 (cube 4)
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .base import checks
from .base.errors import ShapeError
from .base.former_names import refusal
from .base.languages import Language
from .base.notices import warn_surface
from .shapes.shader_function import FUNCTION
from .shapes.shape import Shape, checked_shape

Method = Literal["octree", "aabb"]

#: The start of a program of OpenSCAD: comments, then an assignment, an `include`, a module or a call.
OPENSCAD = re.compile(
    r"(?:\s|//[^\n]*\n|/\*.*?\*/)*(?:[#%!*]\s*)?"
    r"(\$?\w+\s*=[^=]|(?:include|use)\s*<|(?:module|function)\s+\w+|\w+\s*\()",
    re.DOTALL,
)

__all__ = ["Part", "PartGroup", "Parts", "decompose", "parse"]

#: Former functions, and the methods with their work.
FORMER_NAMES = {
    "union": "the operator | or Shape.union(*others, k=)",
    "intersection": "the operator & or Shape.intersection(*others, k=)",
    "difference": "the operator - or Shape.difference(*others, k=)",
    "xor": "the operator ^ or Shape.xor(*others, k=)",
}


def __getattr__(name: str) -> Any:
    raise refusal(name, __name__, FORMER_NAMES)


def __dir__() -> list[str]:
    return sorted(__all__)


class Part(NamedTuple):
    """A part of a decomposed shape: a smaller shape, and the boxes in which it replaces the whole shape.

    Attributes
    ----------
    shape : Shape
        The smaller shape.
    boxes : (k, 2, 3) float64
        Lower and upper corners, world units. A box contains its lower faces, but not its upper faces.

    Examples
    --------
    >>> import fieldbake as fb
    >>> part = fb.csg.decompose(fb.sphere() | fb.box().translate((3, 0, 0)), method="aabb")[0]
    >>> part.shape.to_sexpr(), part.boxes.shape
    ('(sphere 2)', (1, 2, 3))
    """

    shape: Shape
    boxes: NDArray[np.float64]

    def shader(self, language: Language = "wgsl", *, name: str = FUNCTION) -> str:
        """Write the field of this part as a function with its own leaves only, to paste into a fragment shader.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            GLSL is written for WebGL 2 (ES 3.00).
        name : str, default "distance_to_shape"
            Name of the function. Another name is also put before the names of all other definitions, so that the texts
            of several parts fit into one shader.

        Returns
        -------
        str
            Functions and constants without buffers and without an entry point. ``name(p)`` is the signed distance at a
            world position. The parameters of the part are constants; :attr:`PartGroup.text` reads them from a buffer.

        Raises
        ------
        ShapeError
            For an unknown language, a name that is no identifier, or a part that contains a baked volume.

        Examples
        --------
        >>> import fieldbake as fb
        >>> part = fb.csg.decompose(fb.sphere() | fb.box().translate((3, 0, 0)), method="aabb")[0]
        >>> "fn ball(p0: vec3f) -> f32" in part.shader(name="ball"), "rounded_box" in part.shader()
        (True, False)
        """
        return self.shape.shader(language, form="function", name=checks.text("name", name))

    def shader_numbers(self) -> NDArray[np.float32]:
        """List the parameters of the part, (m,) float32: one row of :attr:`PartGroup.numbers`."""
        return self.shape.shader_numbers()

    def __repr__(self) -> str:
        return f"Part({self.shape!r}, {len(self.boxes)} boxes)"


class PartGroup(NamedTuple):
    """Parts of one structure, drawn as instances of a box by one draw call.

    Attributes
    ----------
    text : str
        The field of the structure as a compute shader, in the form of :meth:`Shape.shader`.
    boxes : (n, 2, 3) float64
        Lower and upper corner of the box of each instance, world units.
    numbers : (n, m) float32
        Parameters of each instance: the contents of the buffer ``numbers`` of the text.
    parts : (n,) int64
        Index in the list of the part that each instance belongs to.

    Examples
    --------
    >>> import fieldbake as fb
    >>> balls = fb.sphere() | fb.sphere(0.5).translate((3, 0, 0))
    >>> groups = fb.csg.decompose(balls, method="aabb").groups()
    >>> [group.boxes.shape for group in groups]
    [(2, 2, 3)]
    """

    text: str
    boxes: NDArray[np.float64]
    numbers: NDArray[np.float32]
    parts: NDArray[np.int64]


class Parts(list[Part]):
    """A list of parts.

    Attributes
    ----------
    structures : int
        Number of different structures, which are parts without their parameters. Each needs its own shader.

    Examples
    --------
    >>> import fieldbake as fb
    >>> parts = fb.csg.decompose(fb.sphere() | fb.box().translate((3, 0, 0)))
    >>> len(parts), parts.structures
    (1, 1)
    """

    def __init__(self, parts: Iterable[Part] = (), structures: int = 0) -> None:
        super().__init__(parts)
        self.structures = structures

    def __reduce__(self) -> tuple[Any, ...]:
        return Parts, (list(self), self.structures)

    def groups(self, language: Language = "wgsl", *, eye: ArrayLike | None = None) -> list[PartGroup]:
        """Group the boxes of all parts by structure, for drawing them as instances.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            Language of the texts.
        eye : (3,) array, optional
            Position of the camera. Instances of a group, and groups, are then in the order of the distance from the
            eye to their nearest box, so that hidden fragments fail the depth test early. The default is the order of
            the list. The picture is the same in any order: the depth buffer keeps the nearest hit.

        Returns
        -------
        list of PartGroup
            One group for each of the :attr:`structures`; every box of every part is one instance.

        Raises
        ------
        ShapeError
            For an unknown language, a position that is not finite, or a part that contains a baked volume.

        Examples
        --------
        >>> import fieldbake as fb
        >>> balls = fb.sphere().translate((-2, 0, 0)) | fb.sphere().translate((2, 0, 0))
        >>> (group,) = fb.csg.decompose(balls, method="aabb").groups("glsl", eye=(9, 0, 0))
        >>> group.boxes[:, 0, 0].tolist(), group.parts.tolist()
        ([1.0, -3.0], [1, 0])
        """
        place = None if eye is None else checks.vector("eye", eye, 3, ShapeError)
        found: dict[str, list[int]] = {}
        for index, part in enumerate(self):
            found.setdefault(part.shape.shader(language), []).append(index)
        groups, nearest = [], []
        for text, members in found.items():
            counts = [len(self[index].boxes) for index in members]
            boxes = np.concatenate([self[index].boxes for index in members])
            numbers = np.stack([self[index].shader_numbers() for index in members])
            rows = np.repeat(np.arange(len(members)), counts)
            if place is not None:
                distances = np.linalg.norm(place - np.clip(place, boxes[:, 0], boxes[:, 1]), axis=1)
                order = np.argsort(distances, kind="stable")
                boxes, rows = boxes[order], rows[order]
                nearest.append(float(distances.min()))
            groups.append(PartGroup(text, boxes, numbers[rows], np.array(members, np.int64)[rows]))
        return groups if place is None else [groups[i] for i in np.argsort(nearest, kind="stable")]


def parse(text: str) -> Shape:
    """Parse a shape in the language of "SDF Decomposition".

    Parameters
    ----------
    text : str
        One s-expression. Sizes are full lengths and diameters, angles are in degrees, and round primitives have z as
        their axis. A comment runs from ``;`` to the end of its line.

    Returns
    -------
    Shape

    Raises
    ------
    ShapeError
        For a syntax error or an unknown name, with its line and column.

    Warns
    -----
    SurfaceWarning
        If ``flate``, ``shell`` or ``blend`` is applied to a field that is no distance. The language shifts and joins
        fields as they are.

    Notes
    -----
    Shapes: ``(sphere d)``, ``(ellipsoid x y z)``, ``(box x y z)``, ``(cube s)``, ``(torus outer tube)``,
    ``(cylinder d h)``, ``(cone d h)``, ``(coninder low high h)``, ``(plane nx ny nz)``. Every other primitive has its
    Python name with hyphens and its Python arguments in order, with diameters in place of radii:
    ``(rounded-box x y z r)``, ``(capped-torus outer tube degrees)``, ``(hex-prism d h)``. The radius of a rounded edge
    stays a radius. Threads: ``(iso-thread d pitch offset)`` and ``(trapezoidal-thread d pitch offset)``. Profiles:
    ``(extrude h PROFILE)``, ``(extrude h taper chamfer chamfer PROFILE)`` and ``(revolve offset PROFILE)`` with
    ``(circle d)``, ``(rectangle w h)``, ``(polygon x y x y ...)`` or ``(polygons POLYGON ...)``. The error for a wrong
    count of numbers states the right form.

    Operators: ``union``, ``inter``, ``diff``, ``xor``; ``(blend union k a b ...)`` and ``(chamfer union k a b ...)``.
    Modifiers: ``move``, ``move-x``, ``rotate`` (a quaternion x y z w), ``rotate-x``, ``scale``, ``flate`` (offset),
    ``shell``, ``times``, ``align``, ``elongate``, ``mirror``, ``reflect``, ``repeat``, ``twist`` and ``bend``
    (degrees per world unit), ``not``, and ``(paint COLOR a)``, ``(paint-over COLOR a)``, ``(stencil COLOR a mask)``,
    ``(mask COLOR a mask)`` with a colour as three linear numbers or ``#rrggbb``.

    References
    ----------
    A. Palecek, SDF Decomposition, 2021; the language comes from her program Tangerine.

    Examples
    --------
    >>> parse("(diff (cube 2) (move-x 1 (sphere 1)))").to_sexpr()
    '(diff (cube 2) (move 1 0 0 (sphere 1)))'
    """
    if not isinstance(text, str):
        raise ShapeError(f"text: must be text, got {checks.describe(text)}")
    found = OPENSCAD.match(text)
    if found:
        raise ShapeError(
            f"text: '{found[1]}' begins a program of OpenSCAD, a language that is not supported. "
            "Write an s-expression such as (diff (cube 3) (sphere 4)), where sizes are full lengths and diameters"
        )
    shape = Shape._wrap(_core.Shape.parse(text))
    if shape._core.is_misused:
        warn_surface(
            [
                "text: flate, shell or blend is applied to a field that is no distance, so its size is not in world "
                "units; the methods offset, shell and smooth of a Shape bake the distance"
            ]
        )
    return shape


def decompose(shape: Shape, method: Method = "octree") -> Parts:
    """Split a shape into smaller shapes, each valid in its own boxes.

    Parameters
    ----------
    shape : Shape
        A shape with bounds.
    method : "octree" or "aabb", default "octree"
        ``"aabb"`` is the method of the article: operators split and discard boxes on the way from the leaves to the
        root. The solid is the union of the parts, each cut to its boxes; boxes may overlap, and the nearest hit along a
        ray is correct. ``"octree"`` prunes the tree in each cell by Lipschitz bounds: boxes do not overlap, and inside
        its boxes a part has the sign and the roots of the whole shape. The boxes contain the whole surface. Cells that
        a bound proves to lie wholly outside or wholly inside the solid have no box, so a point in no box may be inside
        the solid: use ``"aabb"`` or :meth:`Shape.distance` to decide inside or outside.

    Returns
    -------
    Parts
        A list of :class:`Part` with the number of different ``structures``. An empty shape has no parts.

    Raises
    ------
    ShapeError
        For a shape without bounds (the message names the leaf), or an unknown method.

    References
    ----------
    A. Palecek, SDF Decomposition, 2021. W. Barbier et al., Lipschitz Pruning: Hierarchical Simplification of
    Primitive-Based SDFs, Eurographics 2025.

    Examples
    --------
    >>> import fieldbake as fb
    >>> model = fb.csg.parse("(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))")
    >>> [len(part.boxes) for part in fb.csg.decompose(model, method="aabb")]
    [1, 1, 7]
    """
    checks.choice("method", method, ("octree", "aabb"), ShapeError)
    core = checked_shape("shape", shape)._core
    found, firsts = core.decompose(method)
    boxes = checks.frozen(found)
    spans = enumerate(pairwise(firsts))
    parts = [Part(Shape._wrap(core.part(method, index)), boxes[first:end]) for index, (first, end) in spans]
    return Parts(parts, core.structures(method))
