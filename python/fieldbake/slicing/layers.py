"""The layers of a solid along z: an image and the outlines of each."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, FormatError, ShapeError
from ..base.progress import Progress, progress_callback
from ..files.container import atomic_write, listed
from ..files.svg import svg_path, svg_text
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.loops import Array, area, cut
from ..meshes.mesh import Mesh
from ..meshes.outlines import BATCH, NOISE, PlaneField, cut_by_box
from ..meshes.section import PICTURE, MeshCut
from ..queries.common import warn_of_signs
from ..shapes.shape import Shape
from ..volumes.grid_field import GridField
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume, plain_field
from .files import ENDINGS, write_images, write_outlines

Result = TypeVar("Result")

#: Fraction of a layer or pixel by which the box may exceed a whole number of them: the rounding of a division.
WHOLE = 1e-9

#: Largest number of pixels of an image, and of layers.
MOST_PIXELS, MOST_LAYERS = 1 << 31, 10_000_000

#: Layers that are kept.
KEPT = 4

#: A layer in the plane of flat faces is sliced this fraction of the longest side of the mesh outside them.
LIFT = 10 * NOISE

#: Pixels across the outlines of a layer below which they are traced in parts of pixels, and the number of parts across
#: them: the area of a circle is then accurate to 1e-3 or better.
FEW_PIXELS, PARTS = 32, 64

#: Distance from the centre of a pixel to the points that show a flat face, pixels.
BESIDE = 0.25

#: Flat faces within this fraction of the lift lie in one plane: the rounding of float64 positions.
SAME = 1e-3


@dataclass(frozen=True)
class Solid:
    """The geometry of slices: its field, its box, and the exact section of a mesh that has one."""

    values: Callable[[Array], NDArray[Any]]
    bounds: Callable[[], Array]
    slope: float = math.inf
    #: Rounding of the values, as a fraction of the longest side of the box; 0 if their signs are exact.
    noise: float = NOISE
    #: Values with the exact sign, for points where the rounding may have changed it.
    exact: Callable[[Array], NDArray[Any]] | None = None
    #: Distances and sides of balls, as in `PlaneField`.
    sides: Callable[[Array, Array], tuple[Array, NDArray[np.int8]]] | None = None
    cut: MeshCut | None = None
    #: The height at which a layer is sliced, from the height of its middle.
    height: Callable[[float], float] = float


def _solid(geometry: Shape | GridField | Mesh, device: str) -> Solid:
    if isinstance(geometry, Shape):
        core = geometry._core

        def exact(points: Array) -> NDArray[Any]:
            try:
                return core.distance_float64(points, device)
            except ShapeError:  # the samples of a baked volume are float32
                return core.distance(points, device)

        return Solid(
            lambda points: core.distance(points, device), lambda: geometry.bounds, geometry.lipschitz, exact=exact
        )
    if isinstance(geometry, GridField):
        options = (device,) if isinstance(geometry, Volume) else ()
        return Solid(
            cut_by_box(lambda points: geometry._sample(points, "linear", *options), geometry.bounds),
            lambda: geometry.inner_bounds,
        )
    mesh, facts = geometry, geometry.topology()
    faults = facts["flipped_faces"] + facts["duplicate_faces"]
    is_exact = facts["closed"] and not faults and not mesh._core.self_intersections()
    return Solid(
        lambda points: _core.signed_distance(mesh._core, np.ascontiguousarray(points), sign="auto", device=device),
        lambda: mesh.bounds,
        noise=0.0,
        # The sides of an open mesh also change away from its faces, so its distances prove no sides.
        sides=lambda centers, radii: _core.sides_of_balls(mesh._core, centers, radii),
        cut=MeshCut(mesh.vertices, mesh.faces, np.array([0.0, 0.0, 1.0])) if is_exact else None,
        height=_outside_of_flat_faces(mesh),
    )


def _outside_of_flat_faces(mesh: Mesh) -> Callable[[float], float]:
    """Make the function that moves a height out of the flat faces in its plane, to their side with the larger area.

    A height between two sides of a thin wall, or of a gap, stays.
    """
    lift = LIFT * float((mesh.bounds[1] - mesh.bounds[0]).max())
    corners = mesh.vertices[mesh.faces[np.ptp(mesh.vertices[:, 2][mesh.faces], axis=1) <= 0.5 * lift]]
    corners = corners[np.argsort(corners[:, 0, 2], kind="stable")]
    levels = corners[:, 0, 2]
    (ax, ay), (bx, by) = (corners[:, i, :2].T - corners[:, 0, :2].T for i in (1, 2))
    # Twice the areas, positive if they face up.
    areas = math.copysign(1.0, mesh.volume) * (ax * by - ay * bx)

    def height(middle: float) -> float:
        first, below, above, end = np.searchsorted(levels, middle + lift * np.array([-0.5, -SAME, SAME, 0.5]))
        is_between = areas[first:below].sum() * areas[above:end].sum() < 0
        return middle if first == end or is_between else middle + math.copysign(lift, areas[first:end].sum())

    return height


class Slices:
    """The layers of a solid along z, computed when they are used; the last four are kept.

    Made by :func:`fieldbake.slices`. Notebooks show the outlines of the layer in the middle.

    Examples
    --------
    >>> import fieldbake as fb
    >>> layers = fb.slices(fb.sphere(1), 0.1, pixel=0.02)
    >>> len(layers), layers.size, int(layers.image(10).max())
    (20, (100, 100), 255)
    >>> f"{layers.areas.sum() * layers.layer:.2f}"  # 4 pi / 3 is 4.19
    '4.19'
    """

    def __init__(
        self,
        geometry: Shape | GridField | MeshLike,
        layer: float,
        pixel: ArrayLike,
        bounds: ArrayLike | None,
        device: str,
        progress: Progress = None,
    ) -> None:
        self._layer = checks.number("layer", layer, above=0)
        sides = [pixel] * 2 if np.ndim(pixel) == 0 else checks.vector("pixel", pixel, 2).tolist()
        px, py = (checks.number("pixel", side, above=0) for side in sides)
        self._pixel = (px, py)
        self._progress = progress
        geometry = plain_field(geometry)
        self._geometry = geometry if isinstance(geometry, (Shape, GridField)) else as_mesh(geometry)
        self._device = checks.text("device", device)
        self._solid = _solid(self._geometry, self._device)
        self._bounds = checks.frozen(checks.box("bounds", self._solid.bounds() if bounds is None else bounds))
        width, height, count = (
            max(1, math.ceil(side / step - WHOLE))
            for side, step in zip((self._bounds[1] - self._bounds[0]).tolist(), (px, py, self._layer), strict=True)
        )
        if width * height > MOST_PIXELS:
            raise ArgumentError(
                f"pixel: {width} x {height} pixels are more than 2^31; use pixels of at least "
                f"{math.sqrt(width * height / MOST_PIXELS) * max(px, py):.3g}, got {checks.describe(pixel)}"
            )
        if count > MOST_LAYERS:
            raise ArgumentError(f"layer: {count} layers are more than {MOST_LAYERS}; use thicker layers, got {layer}")
        self._solid.values(self._bounds[:1])  # raises an error if there is no such device
        self._size = (width, height)
        self._z = checks.frozen(self._bounds[0, 2] + (np.arange(count) + 0.5) * self._layer)
        self._images = lru_cache(KEPT)(self._draw)
        self._loops = lru_cache(KEPT)(self._trace)

    def __len__(self) -> int:
        return len(self._z)

    @property
    def z(self) -> Array:
        """Heights of the middles of the layers, (k,) float64, world units, read-only."""
        return self._z

    @property
    def layer(self) -> float:
        """Thickness of a layer, world units."""
        return self._layer

    @property
    def pixel(self) -> tuple[float, float]:
        """Width and height of a pixel, world units."""
        return self._pixel

    @property
    def bounds(self) -> Array:
        """The sliced box, (2, 3) float64, world units. Pixels and layers start at its lower corner."""
        return self._bounds

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
        return self._size

    def image(self, index: int) -> NDArray[np.uint8]:
        """Draw a layer, (height, width) uint8, read-only.

        Row 0 has the largest y. A pixel is ``255 * clip(1/2 - d / pixel, 0, 1)`` for the distance d at its centre. It
        is rounded so that 128 and more means that the centre is inside: by the float64 distance of a shape, the samples
        of a volume, or :func:`contains` of a mesh. A layer in the plane of a flat face takes one side of the face. The
        side of oblong pixels counts as the geometric mean of both sides.

        Raises
        ------
        ArgumentError
            If there is no layer of this index.
        CapacityError
            If the image does not fit into the free memory.
        """
        return self._images(self._index(index))

    def outlines(self, index: int) -> list[Array]:
        """Closed loops of a layer, (m, 2) float64 each, world x and y, read-only.

        Outer loops are counter-clockwise, holes are clockwise, and the first point is not repeated. Loops are cut at
        the border of the image.

        Raises
        ------
        ArgumentError, CapacityError
            As for :meth:`image`.
        """
        return list(self._loops(self._index(index)))

    @cached_property
    def areas(self) -> Array:
        """Areas inside the outlines of all layers, (k,) float64, square world units, read-only."""
        return checks.frozen(np.array([math.fsum(map(area, loops)) for loops in self._each(self._loops)]))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all layers to a file. An existing file is replaced after the new one is complete.

        Parameters
        ----------
        path : str or path
            ``.zip``: ``manifest.json`` with the layer, the pixel, the bounds, the unit and the heights, and the images
            as ``layer_00000.png``, 8 bits. ``.svg``: the outlines, one group for each layer with its height as
            ``data-z``, filled by the even-odd rule. A world unit is a millimetre, as in .3mf files.

        Raises
        ------
        FormatError
            For another ending.
        OSError
            If the file cannot be written.

        Notes
        -----
        Equal slices give equal bytes.
        """
        target = checks.path(path)
        ending = target.suffix.lower()
        if ending not in ENDINGS:
            raise FormatError(f"{target}: slices are written as {listed(ENDINGS)}, got the ending '{target.suffix}'")
        with atomic_write(target) as stream:
            if ending == ".zip":
                facts = {
                    "layer": self._layer,
                    "pixel": list(self._pixel),
                    "size": list(self._size),
                    "bounds": self._bounds.tolist(),
                    "unit": "millimeter",
                    "z": self._z.tolist(),
                }
                write_images(stream, facts, self._each(self._images))
            else:
                layers = zip(self._z.tolist(), self._each(self._loops), strict=True)
                write_outlines(stream, *self._rectangle, layers)

    def _each(self, layer: Callable[[int], Result]) -> Iterator[Result]:
        """Compute a result of every layer, with progress."""
        with progress_callback(self._progress, "slice") as callback:
            for index in range(len(self)):
                yield layer(index)
                if callback:
                    callback((index + 1) / len(self))

    def _index(self, index: int) -> int:
        return checks.integer("index", index, least=0, most=len(self) - 1)

    def _frame(self, index: int) -> Array:
        frame = np.eye(4)
        frame[2, 3] = self._solid.height(self._z[index])
        return frame

    def _field(self, index: int, noise: float) -> PlaneField:
        """The field of a layer; `noise` is a fraction of the longest side of the box."""
        # Samples, masks and the image take about 12 bytes a pixel, and the pixels of a flat face are listed by 16 more.
        what = f"a layer of {self._size[0]} x {self._size[1]} pixels"
        _core.require_memory(what, 28 * self._size[0] * self._size[1], "use larger pixels")
        noise *= float((self._bounds[1] - self._bounds[0]).max())
        return PlaneField(self._solid.values, self._frame(index), self._solid.slope, noise, self._solid.sides)

    def _places(self, offset: float, more: int) -> tuple[Array, Array]:
        x, y = (
            self._bounds[0, axis] + (np.arange(self._size[axis] + more) + offset) * self._pixel[axis] for axis in (0, 1)
        )
        return x, y

    def _draw(self, index: int) -> NDArray[np.uint8]:
        side = math.sqrt(self._pixel[0] * self._pixel[1])
        field, places = self._field(index, self._solid.noise), self._places(0.5, 0)
        distances = field.samples(*places, reach=0.5 * side)
        inside = distances < 0
        row, column = np.nonzero(np.abs(distances) <= field.noise)
        reach, exact = (BESIDE * self._pixel[0], BESIDE * self._pixel[1]), self._solid.exact or field.values
        for first in range(0, len(row) if field.noise > 0 else 0, BATCH):
            rows, columns = row[first : first + BATCH], column[first : first + BATCH]
            x, y = places[0][columns], places[1][rows]
            is_flat = field.flat(x, y, reach, field.rounding(*places))
            inside[rows, columns] = (exact(field.world(x, y)) < 0) & ~is_flat
        shares = distances * np.float32(-255 / side)
        shares += 127.5
        image = np.rint(np.clip(shares, 0, 255, out=shares), out=shares).astype(np.uint8)
        np.maximum(image, 128, out=image, where=inside)
        np.minimum(image, 127, out=image, where=~inside)
        return checks.frozen(np.ascontiguousarray(image[::-1]))

    def _trace(self, index: int) -> tuple[Array, ...]:
        found = None
        if self._solid.cut is not None:
            found, _, warnings = self._solid.cut.loops(self._frame(index))
            # Bodies that overlap along their faces have no crossings of faces, and loops that are not their union's.
            found = None if warnings else cut(found, *self._rectangle)
        if found is None:
            found = self._outlines(self._field(index, NOISE))
        return tuple(checks.frozen(loop) for loop in found)

    def _outlines(self, field: PlaneField) -> list[Array]:
        """Loops of a field in the grid of the pixels. A layer of few pixels is traced again in parts of pixels."""
        places = self._places(0.0, 1)
        found = field.outlines(*places)
        if not found:
            return found
        points = np.concatenate(found)
        ranges = [
            (max(np.searchsorted(nodes, low) - 2, 0), min(np.searchsorted(nodes, high) + 1, len(nodes) - 1))
            for nodes, low, high in zip(places, points.min(axis=0), points.max(axis=0), strict=True)
        ]
        across = max(last - first for first, last in ranges)
        if across >= FEW_PIXELS:
            return found
        parts = -(-PARTS // across)
        x, y = (
            np.linspace(nodes[first], nodes[last], parts * (last - first) + 1)
            for nodes, (first, last) in zip(places, ranges, strict=True)
        )
        return field.outlines(x, y)

    @property
    def _rectangle(self) -> tuple[Array, Array]:
        """Lower and upper corner of the images, (2,), world units."""
        x, y = self._places(0.0, 1)
        return np.array([x[0], y[0]]), np.array([x[-1], y[-1]])

    def _repr_svg_(self) -> str:
        return svg_text(*self._rectangle, [svg_path(self._loops(len(self) // 2))], pixels=PICTURE)

    def __reduce__(self) -> tuple[Any, ...]:
        return Slices, (self._geometry, self._layer, self._pixel, self._bounds, self._device)

    def __repr__(self) -> str:
        width, height = self._size
        return f"Slices({len(self)} layers of {self._layer:.4g} units, {width} x {height} pixels)"


def slices(
    geometry: Shape | Volume | SparseVolume | MeshLike,
    layer: float,
    *,
    pixel: ArrayLike,
    bounds: ArrayLike | None = None,
    device: str = "auto",
    progress: Progress = None,
) -> Slices:
    """Slice a solid into layers along z, for printers.

    Parameters
    ----------
    geometry : Shape, Volume, SparseVolume, Mesh or anything :func:`bake` takes as a mesh
        The solid.
    layer : float
        Thickness of a layer, world units. Layers are sliced at their middles, ``bounds[0].z + (i + 1/2) * layer``.
    pixel : float or (2,)
        Side of a pixel, or its width and height, world units.
    bounds : (2, 3) array, optional
        Box to slice. The default is the box of the surface. As many layers and pixels as cover it start at its lower
        corner; what is over lies beyond the upper one.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. Sparse volumes are sampled on the CPU.
    progress : bool or callable, optional
        Progress of `Slices.areas` and `Slices.save`: True draws a bar on stderr; a callable receives the finished
        fraction from 0 to 1.

    Returns
    -------
    Slices
        Images, outlines and areas of the layers, which are computed when they are used.

    Raises
    ------
    ArgumentError
        For a layer or a pixel that is not positive, an image of more than 2^31 pixels, or an empty box.
    ShapeError
        For an unbounded shape without `bounds`.
    MeshError, DeviceError
        As for :func:`bake`.

    Warns
    -----
    SurfaceWarning
        If the surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The outlines of a closed mesh with consistent winding, whose faces do not pass through each other, are its exact
    section, in float64. Other outlines are found by marching squares at the corners of the pixels; their vertices lie
    within 1e-3 pixels of the zero level of the field. Features thinner than a pixel may be missed there. A layer in the
    plane of a flat face of a mesh is sliced 2e-6 of the longest side of the mesh outside it, since the surface is no
    part of the inside. The common face of two parts of a shape or a volume is inside.

    Distances of meshes and shapes are evaluated near the surface only. The slope of the field of a shape, and the
    winding number of a mesh, prove the side of the other pixels.

    Examples
    --------
    >>> import fieldbake as fb
    >>> layers = fb.slices(fb.models.gear(), 0.05, pixel=0.01)
    >>> layers
    Slices(7 layers of 0.05 units, 200 x 200 pixels)
    >>> [len(loop) for loop in layers.outlines(3)]
    [288, 288]
    """
    made = Slices(geometry, layer, pixel, bounds, device, progress)
    if not isinstance(made._geometry, (Shape, GridField)):
        warn_of_signs(made._geometry, "auto")
    return made
