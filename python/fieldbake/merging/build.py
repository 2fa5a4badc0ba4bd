"""One coarse field for a whole scene: :func:`merge`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from ..base import checks
from ..base.errors import ArgumentError
from ..base.former_names import former_names
from ..base.grid import Grid, Resolution, make_grid
from ..base.progress import Progress, part_of, progress_callback
from ..volumes.volume import Volume
from .merged import MergedField, Placed, items_of, merge_placed, place
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
    device: str = "auto",
    progress: Progress = None,
) -> NestedField: ...


@former_names(method="the page docs/articles/fields_in_unity, which computes the sum of the article")
def merge(
    scene: Any,
    resolution: Resolution = MERGE_RESOLUTION,
    *,
    bounds: ArrayLike | None = None,
    levels: int | None = None,
    center: ArrayLike | None = None,
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
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. A graphics device finds the instance with the
        least bound at each sample and the CPU evaluates the bound, so the field is the same bit for bit. If the volumes
        are too large for the device that ``"auto"`` chose, the CPU does all the work and ``report.warnings`` says so.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    MergedField
        A volume with the method :meth:`~MergedField.update` that follows moving instances. With `levels`, a
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
    the error of the samples of the volumes. A volume whose box cuts its solid counts as the part in the box, so the
    field may exceed the distance from the whole solid outside that box. Inside a SparseVolume, beyond its band, the
    bound is one of the depth: the field may exceed the negative distance by up to 12 voxels of that volume. Between
    samples, trilinear interpolation exceeds the distance by at most half the diagonal of a merged voxel; 8 % of a voxel
    was measured around seven links of a robot.

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
    if levels is None and center is not None:
        raise ArgumentError("center: is the point that nested levels surround; give levels too")
    baked: dict[tuple[int, int], Volume] = {}
    items = items_of(scene)
    placed = [place(f"instances[{number}]", item, baked) for number, item in enumerate(items)]
    boxes = np.stack([item.bounds for item in placed])
    inner = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    grid = make_grid(inner, resolution, bounds=bounds)
    if levels is not None:
        may_grow = bounds is None and np.ndim(resolution) == 0
        return _merge_nested(placed, grid, levels, center, may_grow, device, progress)
    return merge_placed(placed, np.array([grid.lower, grid.upper]), grid.shape, device, progress, None)


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
            merged.append(merge_placed(placed, bounds, grid.shape, device, part, None))
    return NestedField(merged)
