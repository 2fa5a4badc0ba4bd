"""One coarse field for a whole scene: :func:`merge`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError
from ..base.grid import Grid, Resolution, make_grid
from ..base.progress import Progress, part_of, progress_callback
from ..volumes.volume import Volume
from .merged import MergedField, Method, Placed, items_of, merge_placed, place
from .nested import LEAST_SIDE, MAX_LEVELS, NestedField, nested_grids

#: Voxels along the longest side of a merged field.
MERGE_RESOLUTION = 128


@overload
def merge(
    scene: Any,
    resolution: Resolution = MERGE_RESOLUTION,
    *,
    bounds: ArrayLike | None = None,
    levels: None = None,
    center: None = None,
    method: Method = "bound",
    device: str = "auto",
    progress: Progress = None,
) -> MergedField: ...


@overload
def merge(
    scene: Any,
    resolution: Resolution = MERGE_RESOLUTION,
    *,
    bounds: ArrayLike | None = None,
    levels: int,
    center: ArrayLike | None = None,
    method: Method = "bound",
    device: str = "auto",
    progress: Progress = None,
) -> NestedField: ...


def merge(
    scene: Any,
    resolution: Resolution = MERGE_RESOLUTION,
    *,
    bounds: ArrayLike | None = None,
    levels: int | None = None,
    center: ArrayLike | None = None,
    method: Method = "bound",
    device: str = "auto",
    progress: Progress = None,
) -> MergedField | NestedField:
    """Merge all instances of a scene into one world-aligned field whose samples never exceed the distance.

    Parameters
    ----------
    scene : Scene, or a list
        The scene, or a list of instances, objects and ``(object, transform)`` pairs. An object is a Volume, a
        SparseVolume, an atlas entry, a Quadric or a list of quadrics, or anything that :func:`bake` takes. Meshes and
        shapes are baked first, once for all their instances.
    resolution : int or three ints, default 128
        As for :func:`bake`.
    bounds : (2, 3) array, optional
        Box of the field, world units. The default is the box of all surfaces, enlarged by a tenth.
    levels : int, optional
        Number of nested grids, 1 to 12. The outermost grid has the box and the resolution of a single grid. Each finer
        grid has the same number of voxels in a box of half the size.
    center : (3,) array, optional
        Point that the levels surround, such as the position of the camera, world units. The default is the centre of
        the box. Near the edge of a level, the next finer level is moved inwards.
    method : "bound" or "article", default "bound"
        ``"article"`` is the loop of the article, for comparison: each sample is the minimum over all instances of the
        distance to the box plus the value at the nearest point of the box. It is slow and not a lower bound: in random
        scenes of six volumes of 20 to 32 voxels it exceeds the distance at 39 to 57 % of the samples outside the boxes,
        by factors up to 1.23.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. A graphics device finds the instance with the
        least bound at each sample and the CPU evaluates the bound, so the field is the same bit for bit. If the volumes
        are too large for the device that ``"auto"`` chose, the CPU does all the work and ``report.warnings`` says so.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    MergedField
        A Volume whose method :meth:`~MergedField.update` follows moving instances. With `levels`, a
        :class:`NestedField`.

    Raises
    ------
    SceneError
        For an empty scene, or an instance that cannot be placed.
    ArgumentError
        For an option out of range.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    Each sample is the minimum over the instances of a proven lower bound on the signed distance. The bound is exact at
    a voxel centre of a rigidly placed volume. Elsewhere in the box of that volume it is less than the distance by up to
    half the diagonal of its voxel, 0.87 voxels. At distance `a` from the box it is ``sqrt(a^2 + s^2)``, where `s` is
    the bound at the nearest point of the box. Under scale it is multiplied by the least stretch. The bound holds up to
    the error of the samples of the volumes. Between samples, trilinear interpolation exceeds the distance by at most
    half the diagonal of a merged voxel; 8 % of a voxel was measured around seven links of a robot.

    A merged surface therefore lies up to 0.87 voxels of its volume outside the surface, and flat faces at an angle to
    the grid ripple in pictures. A box of 44 voxels, turned by 0.4 radians about (1, 2, 3) and merged at 96 voxels, is
    off by up to 0.3 voxels; the normals of a face lean by 6 degrees in the mean and by 23 at most. Finer volumes ripple
    less in world units. Instances of a scene are drawn without a merged field and do not ripple.

    Quadrics are sheets, so their distance is never negative. Inside overlapping solids the field is the most negative
    of their values.

    References
    ----------
    *Signed Distance Fields in Unity*, the section on a coarse aggregate field. The bound and the culling are not from
    that article.

    Examples
    --------
    >>> import fieldbake as fb
    >>> gear = fb.bake(fb.models.gear(teeth=6), 24)
    >>> aside = np.eye(4)
    >>> aside[0, 3] = 3
    >>> field = fb.merge([gear, (gear, aside)], 32)
    >>> field.resolution
    (32, 14, 5)
    >>> bool(field.sample([(1.5, 0, 0)])[0] > 0)
    True
    """
    checks.text("device", device)
    checks.choice("method", method, ("bound", "article"))
    if levels is None and center is not None:
        raise ArgumentError("center: is the point that nested levels surround; give levels too")
    baked: dict[tuple[int, int], Volume] = {}
    items = items_of(scene)
    placed = [place(f"instances[{number}]", item, baked) for number, item in enumerate(items)]
    boxes = np.stack([item.bounds for item in placed])
    inner = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    grid = make_grid(inner, resolution, bounds=bounds)
    if levels is not None:
        if method != "bound":
            raise ArgumentError('levels: are merged with method="bound" only')
        may_grow = bounds is None and np.ndim(resolution) == 0
        return _merge_nested(placed, grid, levels, center, may_grow, device, progress)
    return merge_placed(placed, np.array([grid.lower, grid.upper]), grid.shape, method, device, progress, None)


def _merge_nested(
    placed: Sequence[Placed],
    outer: Grid,
    levels: int,
    center: ArrayLike | None,
    may_grow: bool,
    device: str,
    progress: Progress,
) -> NestedField:
    count = checks.integer("levels", levels, least=1, most=MAX_LEVELS)
    box = np.array([outer.lower, outer.upper])
    middle = box.mean(axis=0)
    point = middle if center is None else checks.vector("center", center, 3)
    if may_grow and min(outer.shape) < LEAST_SIDE:
        # A flat scene gets more voxels of the same size.
        x, y, z = (max(side, LEAST_SIDE) for side in outer.shape)
        half = np.array([x, y, z]) * np.asarray(outer.spacing) / 2
        outer = Grid(checks.triple(middle - half), checks.triple(middle + half), (x, y, z))
    merged = []
    with progress_callback(progress, "merge") as callback:
        for number, grid in enumerate(nested_grids(outer, count, point)):
            bounds = np.array([grid.lower, grid.upper])
            part = part_of(callback, number, count)
            merged.append(merge_placed(placed, bounds, grid.shape, "bound", device, part, None))
    return NestedField(merged)


class SphereIntersection(NamedTuple):
    """The circle in which two spheres intersect."""

    #: Centre of the circle, (3,).
    center: NDArray[np.float64]
    #: Unit vector from the first centre to the second, (3,).
    normal: NDArray[np.float64]
    radius: float


def sphere_intersection(s0: ArrayLike, r0: float, s1: ArrayLike, r1: float) -> SphereIntersection:
    """Intersect two spheres, the construction by which the article bounds the distance beyond a box.

    Let `p` be a point outside a box, `b` the nearest point of the box, `a = |p - b|` and `s` the distance at `b`. The
    surface lies beyond the plane of the box through `b` and outside the sphere of radius `s` around `b`. The nearest
    possible points form the circle in which that sphere intersects the plane, at the distance ``sqrt(a^2 + s^2)`` from
    `p`. The sphere of that radius around `p` passes through the same circle. This is the bound of :func:`merge`.

    Parameters
    ----------
    s0, s1 : (3,)
        Centres of the spheres.
    r0, r1 : float
        Radii of the spheres.

    Returns
    -------
    SphereIntersection
        ``.center``, ``.normal``, ``.radius``.

    Raises
    ------
    ArgumentError
        If the spheres do not intersect, or have the same centre.

    Examples
    --------
    >>> a, s = 3.0, 4.0
    >>> circle = sphere_intersection((0, 0, 0), np.hypot(a, s), (0, 0, a), s)
    >>> circle.center.tolist(), circle.radius
    ([0.0, 0.0, 3.0], 4.0)
    """
    first, second = checks.vector("s0", s0, 3), checks.vector("s1", s1, 3)
    r0, r1 = checks.number("r0", r0, least=0), checks.number("r1", r1, least=0)
    apart = second - first
    d = float(np.linalg.norm(apart))
    if d == 0 or not abs(r0 - r1) <= d <= r0 + r1:
        raise ArgumentError(f"r0, r1: spheres of radii {r0:g} and {r1:g} do not intersect at the distance {d:g}")
    h = 0.5 + (r0 * r0 - r1 * r1) / (2 * d * d)
    return SphereIntersection(first + h * apart, apart / d, float(np.sqrt(max(0.0, r0 * r0 - (h * d) ** 2))))
