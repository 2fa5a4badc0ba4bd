"""Plane sections of meshes, exact, and of fields, by marching squares."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.notices import warn_surface
from ..files.container import atomic_write
from ..files.svg import svg_path, svg_text
from .loops import Array, area, chains, cycles, length, nested, simple, successors, without_copies
from .outlines import NOISE, PlaneField, cut_by_box

#: Offset of the first node of a grid from the border, cells. Faces along the border then lie between nodes.
SHIFT = 0.62

#: Heights of vertices closer to the plane count as above it, as a fraction of the largest coordinate: the rounding of
#: float64 in turned positions and in products with the normal.
ROUNDING = 16 * float(np.finfo(np.float64).eps)

#: Longest side of the picture in notebooks, pixels.
PICTURE = 320

#: Reasons for which the loops of a mesh may not be the border of a solid.
OPEN = "the section has open chains, because the mesh is open; fieldbake.solid closes it"
WINDING = (
    "the winding of the faces is inconsistent, so the inside of the section is where loops nest an odd number deep"
)
CROSSING = "parts of the mesh pass through each other, so loops of the section cross; fieldbake.solid unites them"


@dataclass(frozen=True, eq=False)
class Section:
    """The part of a plane inside a solid. Notebooks show it as a picture.

    Attributes
    ----------
    polygons : tuple of (m, 2) float64
        Closed loops in the coordinates of the plane, world units, read-only. Outer loops are counter-clockwise seen
        against the normal, holes are clockwise, and the first point is not repeated.
    plane : (4, 4) float64
        World from section, a rigid transform: the section has z = 0, and the z axis is the normal.
    open_chains : tuple of (m, 2) float64
        Lines where an open mesh meets the plane without closing a loop; empty for closed meshes and for fields.

    Examples
    --------
    >>> import fieldbake as fb
    >>> ring = fb.torus(2, 0.5).section((0, 0, 0), "z")
    >>> len(ring.polygons), f"{ring.area:.2f}"  # 4 pi is 12.57
    (2, '12.57')
    """

    polygons: tuple[Array, ...]
    plane: Array
    open_chains: tuple[Array, ...] = ()

    def __post_init__(self) -> None:
        for array in (*self.polygons, *self.open_chains, self.plane):
            checks.frozen(array)

    @property
    def area(self) -> float:
        """Area inside the polygons, square world units."""
        return math.fsum(map(area, self.polygons))

    @property
    def perimeter(self) -> float:
        """Length of all polygons, world units."""
        return math.fsum(map(length, self.polygons))

    def to_svg(self, path: str | os.PathLike[str] | None = None) -> str:
        """Write the polygons as an SVG picture, filled by the even-odd rule.

        Parameters
        ----------
        path : str or path, optional
            The file to write. The text is returned in any case.

        Returns
        -------
        str
            The text of the picture. A world unit is a millimetre on paper, as in .3mf files; y points upwards. The
            polygons keep their coordinates with ten digits, and :meth:`Profile.from_svg` reads them back.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        text = self._svg()
        if path is not None:
            with atomic_write(checks.path(path)) as stream:
                stream.write(text.encode("ascii"))
        return text

    def _svg(self, pixels: int | None = None) -> str:
        points = np.concatenate([*self.polygons, *([] if self.polygons else [np.zeros((1, 2))])])
        return svg_text(points.min(axis=0), points.max(axis=0), [svg_path(self.polygons)], pixels=pixels)

    def _repr_svg_(self) -> str:
        return self._svg(PICTURE)

    def __reduce__(self) -> tuple[Any, ...]:
        return Section, (self.polygons, self.plane, self.open_chains)

    def __repr__(self) -> str:
        return f"Section({len(self.polygons)} polygons, area {self.area:.4g}, perimeter {self.perimeter:.4g})"


class Sectioned:
    """Base class of objects that have plane sections."""

    __slots__ = ()

    def section(self, origin: ArrayLike, normal: ArrayLike | str) -> Section:
        """Cut the solid by a plane.

        Parameters
        ----------
        origin : (3,) real
            A point of the plane, world units. It is the origin of the section's coordinates.
        normal : (3,) real, or "x", "y", "z", "-x", "-y" or "-z"
            Normal of the plane, of any length. The x and y axes of a section are the world's x and y axes for the
            normal z, y and z for x, and z and x for y.

        Returns
        -------
        Section
            Polygons of the inside, in the coordinates of the plane.

        Raises
        ------
        ArgumentError
            For a point that is not finite, or a normal that is zero.

        Warns
        -----
        SurfaceWarning
            If the mesh is open at the plane, if its faces are wound inconsistently there, or if loops cross.

        Notes
        -----
        The section of a mesh is exact: each polygon has a vertex on each edge that the plane crosses, in float64. Loops
        follow the edges, so they always close. Vertices and faces in the plane count as above it, so a section through
        a flat face is that just below the face, on the side opposite to the normal. A point is inside if the winding
        number is not 0; faces that are wound inconsistently are divided by the even-odd rule instead.

        The section of a field is found by marching squares in cells of the smallest side of a voxel. Vertices lie on
        the zero level of the field to 1e-5 of a cell, and corners are restored. Features thinner than a cell may be
        missed. A solid that leaves the box of the field is closed there.

        Examples
        --------
        >>> import fieldbake as fb
        >>> gear = fb.models.gear().section((0, 0, 0), "z")
        >>> len(gear.polygons), gear.plane[:3, 2].tolist()
        (2, [0.0, 0.0, 1.0])
        """
        return self.sections(checks.vector("origin", origin, 3)[None], normal)[0]

    def sections(self, origins: ArrayLike, normal: ArrayLike | str) -> list[Section]:
        """Cut the solid by parallel planes.

        Parameters
        ----------
        origins : (n, 3) real
            A point of each plane, world units.
        normal : (3,) real, or "x", "y", "z", "-x", "-y" or "-z"
            The common normal, as for :meth:`section`.

        Returns
        -------
        list of Section
            One section for each origin; errors, warnings and methods are the same as in :meth:`section`.

        Examples
        --------
        >>> import fieldbake as fb
        >>> cone = fb.cone(1, 2).to_mesh(48)
        >>> [round(one.area, 2) for one in cone.sections([(0, 0, -0.5), (0, 0, 0.5)], "z")]
        [1.77, 0.2]
        """
        return self._sections(frames(origins, normal))

    def _sections(self, planes: list[Array]) -> list[Section]:
        raise NotImplementedError


def frames(origins: ArrayLike, normal: ArrayLike | str) -> list[Array]:
    """World from section for planes through `origins` (n, 3), (4, 4) each.

    The x axis is the world axis after the axis of the largest component of the normal, moved into the plane.
    """
    points, shape = checks.points(origins, "origins")
    if len(shape) > 1:
        raise ArgumentError(f"origins: must have shape (n, 3), got {checks.describe(origins)}")
    if isinstance(normal, str):
        word = checks.choice("normal", normal, ("x", "y", "z", "-x", "-y", "-z"))
        normal = np.eye(3)["xyz".index(word[-1])] * (-1 if len(word) > 1 else 1)
    z = checks.vector("normal", normal, 3)
    if not np.abs(z).max() > 0:
        raise ArgumentError("normal: must not be zero")
    # Dividing by the largest component first keeps the squares in range.
    z /= np.abs(z).max()
    z /= np.linalg.norm(z)
    axis = (int(np.abs(z).argmax()) + 1) % 3
    x = np.eye(3)[axis] - z * z[axis]
    x /= np.linalg.norm(x)
    made = []
    for point in points:
        frame = np.eye(4)
        # Adding 0 turns -0 into 0.
        frame[:3] = np.column_stack([x, np.cross(z, x), z, point]) + 0.0
        made.append(frame)
    return made


@dataclass
class MeshCut:
    """The sections of a mesh by planes with one normal."""

    vertices: Array
    faces: NDArray[np.uint32]
    normal: Array

    def __post_init__(self) -> None:
        self._heights = _products(self.vertices, self.normal)
        corners = self._heights[self.faces]
        self._low, self._high = corners.min(axis=1), corners.max(axis=1)
        self._rounding = ROUNDING * float(np.abs(self.vertices).max(initial=0.0))

    def loops(self, frame: Array) -> tuple[list[Array], list[Array], list[str]]:
        """Closed loops and open chains, (m, 2) each, in the plane of a frame, and warnings."""
        # Vertices of a face in the plane lie on both sides of it by rounding. They count as above.
        level = _products(frame[None, :3, 3], self.normal)[0] - self._rounding
        faces = self.faces[(self._low < level) & (self._high >= level)].astype(np.int64)
        if not len(faces):
            return [], [], []
        above = self._heights[faces] >= level
        used, corners = np.unique(faces, return_inverse=True)
        # Vertices at equal positions are one vertex; adding 0 turns -0 into 0.
        welded = np.unique(self.vertices[used] + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
        rows, following = np.arange(len(faces)), np.roll(above, -1, axis=1)
        keys, points = [], []
        # Seen from outside a counter-clockwise face, the section runs from its edge that descends to the ascending one.
        for edge, low_first in ((above & ~following, 0), (~above & following, 1)):
            first = edge.argmax(axis=1)
            both = np.stack([first, (first + 1) % 3])
            low, high = both[1 - low_first], both[low_first]
            local = corners.reshape(-1, 3)
            keys.append(welded[local[rows, low]] * len(used) + welded[local[rows, high]])
            points.append(self._crossings(faces[rows, low], faces[rows, high], level))
        pairs = np.unique(np.stack(keys), axis=1, return_index=True)[1]  # repeated faces count once
        pairs.sort()
        if successors(*(key[pairs] for key in keys)) is None:
            pairs = pairs[without_copies(*(key[pairs] for key in keys))]
        start, end = (key[pairs] for key in keys)
        places = np.concatenate([point[pairs] for point in points])
        flat = np.stack([_products(places - frame[:3, 3], axis) for axis in frame[:3, :2].T], axis=1)
        order = successors(start, end)
        closed, open = (cycles(order), []) if order is not None else chains(start, end)
        rings = [ring for loop in closed for ring in simple(flat[loop])]
        loops, regular = nested(rings, oriented=order is not None)
        reasons = ((bool(open), OPEN), (order is None and not open, WINDING), (not regular, CROSSING))
        return loops, [flat[chain] for chain in open], [text for holds, text in reasons if holds]

    def _crossings(self, low: NDArray[np.int64], high: NDArray[np.int64], level: float) -> Array:
        """Points where edges cross the plane, (n, 3). An edge gives the same point in both of its faces."""
        below, above = self._heights[low], self._heights[high]
        share = ((level - below) / (above - below))[:, None]
        found: Array = self.vertices[low] * (1 - share) + self.vertices[high] * share
        return found


def _products(points: Array, vector: Array) -> Array:
    """Scalar products of points (n, 3) with a vector, (n,). Equal points have equal products, unlike in BLAS."""
    found: Array = points[:, 0] * vector[0] + points[:, 1] * vector[1] + points[:, 2] * vector[2]
    return found


def mesh_sections(vertices: Array, faces: NDArray[np.uint32], planes: list[Array]) -> list[Section]:
    """Cut triangles by parallel planes."""
    if not planes:
        return []
    cut = MeshCut(vertices, faces, planes[0][:3, 2])
    found: list[Section] = []
    warnings: dict[str, None] = {}
    for plane in planes:
        loops, open, reasons = cut.loops(plane)
        found.append(Section(tuple(loops), plane, tuple(open)))
        warnings.update(dict.fromkeys(reasons))
    warn_surface(list(warnings))
    return found


def field_sections(
    values: Callable[[Array], NDArray[Any]],
    bounds: Array,
    spacing: float,
    planes: list[Array],
    *,
    slope: float = math.inf,
    clipped: bool = False,
) -> list[Section]:
    """Cut the solid of a field by planes.

    Parameters
    ----------
    values, slope
        As for `PlaneField`.
    bounds : (2, 3) float64
        Box that contains the solid, or the part of it to keep if `clipped`.
    spacing : float
        Side of a cell, world units.
    planes
        Frames of the sections.
    clipped : bool
        Intersect the solid with the box.
    """
    noise = NOISE * float((bounds[1] - bounds[0]).max())
    solid = cut_by_box(values, bounds) if clipped else values
    found = []
    for plane in planes:
        lower, upper = _cut_of_box(bounds, plane)
        # The box of an empty shape is a point, and so are its cells.
        counts = np.ceil((upper - lower) / spacing + 2) if spacing > 0 else np.full(2, -1.0)
        loops: list[Array] = []
        if (counts >= 0).all():
            # Samples and masks take about 16 bytes a node.
            what = f"a section of {counts[0]:.0f} x {counts[1]:.0f} nodes"
            _core.require_memory(what, int(16 * counts.prod()), "use a lower resolution")
            x, y = (
                start + (np.arange(int(count)) - SHIFT) * spacing for start, count in zip(lower, counts, strict=True)
            )
            loops = PlaneField(solid, plane, slope, noise).outlines(x, y)
        found.append(Section(tuple(loops), plane))
    return found


def _cut_of_box(bounds: Array, plane: Array) -> tuple[Array, Array]:
    """Lower and upper limits (2,) of the section of a box, in the plane; lower limits are above if there is none."""
    corners = np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]])
    local = (corners - plane[:3, 3]) @ plane[:3, :3]
    points = [*local[local[:, 2] == 0, :2]]
    for a, b in combinations(range(8), 2):
        low, high = local[a], local[b]
        if np.count_nonzero(corners[a] != corners[b]) == 1 and (low[2] < 0) != (high[2] < 0):
            points.append((low + (high - low) * (low[2] / (low[2] - high[2])))[:2])
    if not points:
        return np.full(2, np.inf), np.full(2, -np.inf)
    return np.min(points, axis=0), np.max(points, axis=0)
