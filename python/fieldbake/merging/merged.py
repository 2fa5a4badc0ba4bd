"""One coarse field for a whole scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..atlases.atlas import AtlasEntry
from ..baking.dense import bake
from ..base import checks
from ..base.errors import ArgumentError, DeviceError, Error, SceneError
from ..base.grid import Grid, Resolution, make_grid
from ..base.progress import Progress, part_of, progress_callback
from ..base.report import Report
from ..meshes.convert import _is_arrays
from ..shapes.quadric import Quadric, bounds_of, check_quadrics, is_quadrics, rows_of
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume

if TYPE_CHECKING:
    from .nested import NestedField

Method = Literal["bound", "article"]

#: Voxels along the longest side of a merged field.
MERGE_RESOLUTION = 128

#: What is neither a Volume nor a Quadric is baked with so many voxels, unless its instance says otherwise.
THING_RESOLUTION = 64

#: No owner: a merged field that cannot be updated.
NOBODY = np.empty(0, np.uint32)


class _Placed(NamedTuple):
    """A field and where it stands."""

    thing: Volume | tuple[Quadric, ...]
    transform: NDArray[np.float64]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around the surface, (2, 3), world units."""
        if isinstance(self.thing, tuple):
            return bounds_of(self.quadrics)
        # Where the box cuts the surface, what is left of it.
        box = np.clip(self.thing.inner_bounds, self.thing.bounds[0], self.thing.bounds[1])
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        world = corners @ self.transform[:3, :3].T + self.transform[:3, 3]
        return np.stack([world.min(axis=0), world.max(axis=0)])

    @property
    def quadrics(self) -> list[Quadric]:
        """Those of a list, in the world."""
        return [quadric.transformed(self.transform) for quadric in self.thing] if isinstance(self.thing, tuple) else []


class MergedField(Volume):
    """The field of a scene: a :class:`Volume` that remembers what it was merged from. Made by :func:`merge`.

    Saved and loaded, it is a plain Volume.
    """

    __slots__ = ("_owners", "_placed")

    _owners: NDArray[np.uint32]
    _placed: tuple[_Placed, ...]

    def update(
        self, changed: Sequence[Any], *, scene: Any = None, device: str = "auto", progress: Progress = None
    ) -> MergedField:
        """The field after some instances have moved; only what they touched is done anew.

        Parameters
        ----------
        changed : sequence
            Either ``(index, transform)`` or ``(index, instance)`` pairs, or, with `scene`, indices. An index is the
            place in the list of instances.
        scene : Scene, optional
            The scene as it is now, in which `changed` are the indices of what differs.
        device : str, default "auto"
            As for :func:`merge`. The update itself runs on the CPU.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable gets a share from 0 to 1.

        Returns
        -------
        MergedField
            On the same grid: bit for bit what merging everything anew on that grid gives.

        Raises
        ------
        SceneError
            For an index that is not there, an instance that had another number of quadrics, or another number of
            instances.

        Examples
        --------
        >>> import fieldbake as fb
        >>> ball = fb.bake(fb.models.gear(teeth=6), 16)
        >>> field = fb.merge([ball, (ball, np.diag([1.0, 1, 1, 1]))], 16, bounds=[(-2, -2, -2), (2, 2, 2)])
        >>> moved = np.eye(4)
        >>> moved[0, 3] = 0.5
        >>> field.update([(1, moved)]).sample([(1.2, 0.0, 0.0)]).shape
        (1,)
        """
        if not self._owners.size:
            raise SceneError('changed: a field merged with method="article" cannot be updated; merge it anew')
        placed, indices = self._changed(changed, scene)
        for index in indices:
            if len(placed[index].quadrics) != len(self._placed[index].quadrics):
                raise SceneError(f"changed: instance {index} is of another kind now; merge anew")
        return _merge(placed, self._bounds, self._shape, "bound", device, progress, (self, indices))

    def _changed(self, changed: Sequence[Any], scene: Any) -> tuple[list[_Placed], list[int]]:
        """All instances as they are now, and which have changed."""
        if isinstance(changed, (str, bytes)) or not isinstance(changed, (Sequence, np.ndarray)):
            raise SceneError(f"changed: must be a list, got {checks.describe(changed)}")
        count = len(self._placed)
        if scene is not None:
            indices = [_index(number, item, count) for number, item in enumerate(changed)]
            items = _items(scene)
            if len(items) != count:
                raise SceneError(f"scene: has {len(items)} instances, it was merged with {count}; merge anew")
            baked: dict[tuple[int, int], Volume] = {}
            wanted = set(indices)
            rest = list(self._placed)
            return [
                _place(f"instances[{i}]", items[i], baked) if i in wanted else rest[i] for i in range(count)
            ], sorted(wanted)
        placed = list(self._placed)
        touched = set()
        for number, item in enumerate(changed):
            if not (isinstance(item, (tuple, list)) and len(item) == 2):
                raise SceneError(
                    f"changed[{number}]: must be (index, transform) or (index, instance) unless scene is given, "
                    f"got {checks.describe(item)}"
                )
            index = _index(number, item[0], count)
            if hasattr(item[1], "thing"):
                placed[index] = _place(f"changed[{number}]", item[1], {})
            else:
                transform = checks.affine(f"changed[{number}]: transform", item[1], SceneError)
                placed[index] = placed[index]._replace(transform=transform)
            touched.add(index)
        return placed, sorted(touched)


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
    """Join everything in a scene in one world-aligned field that is never larger than the distance to it.

    Parameters
    ----------
    scene : Scene, or a list
        Of instances, things, and ``(thing, transform)`` pairs. A thing is a Volume, a SparseVolume, an atlas entry, a
        Quadric or a list of them, or anything that :func:`bake` takes; that is baked first, once for all its
        instances.
    resolution : int or three ints, default 128
        As for :func:`bake`.
    bounds : (2, 3) array, optional
        Box to sample, world units; the box of all surfaces and a tenth more if not given.
    levels : int, optional
        Nested grids round a point, up to 12: the outermost has the box and the resolution that one grid would have,
        each other one as many voxels in a box half as long and wide.
    center : (3,) array, optional
        What the levels are nested round, the camera say; the middle of the box if not given. Near the edge of a level
        the next finer one is moved inwards.
    method : "bound" or "article", default "bound"
        ``"article"`` is the loop of the article that this follows: at every sample over all instances, the distance
        to the box plus the sample there. Slow, and not a lower bound: in random scenes of six volumes of 20 to 32
        voxels it exceeds the distance at 39 to 57 % of the samples outside the boxes, by up to 1.23 times. For
        comparison.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. A graphics device looks for the instance that
        is nearest to each sample; the distance is found on the CPU, so the field is the same bit for bit. If the
        volumes are too large for the device that ``"auto"`` chose, the CPU does all, and ``report.warnings`` says so.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable gets a share from 0 to 1.

    Returns
    -------
    MergedField
        A Volume; its :meth:`~MergedField.update` follows moving instances. With `levels` a :class:`NestedField`.

    Raises
    ------
    SceneError
        For an empty scene, or an instance that cannot be placed.
    ArgumentError
        For an option that makes no sense.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    Each sample is the least, over the instances, of a proven lower bound of the signed distance: exact where it falls
    on a voxel centre of one rigidly placed volume; less than the distance by up to half a voxel of that volume
    elsewhere in its box; ``sqrt(a^2 + s^2)`` at distance `a` from the box, with `s` the bound at its nearest point.
    Under scale, times the least stretch. So it is true up to the error of the volumes' own samples. Between the
    samples of the merged field itself, trilinear interpolation may exceed the distance by a part of a merged voxel.

    Quadrics are sheets: their distance is not negative. Inside overlapping solids the most negative value wins.

    References
    ----------
    *Signed Distance Fields in Unity*, the section on a coarse aggregate field. What surrounds its loop here, the bound
    and the culling, is not from there.

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
    if method not in ("bound", "article"):
        raise ArgumentError(f'method: must be "bound" or "article", got {checks.describe(method)}')
    if levels is None and center is not None:
        raise ArgumentError("center: is what levels are nested round; give levels too")
    baked: dict[tuple[int, int], Volume] = {}
    items = _items(scene)
    placed = [_place(f"instances[{number}]", item, baked) for number, item in enumerate(items)]
    boxes = np.stack([item.bounds for item in placed])
    inner = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    grid = make_grid(inner, resolution, bounds=bounds)
    if levels is not None:
        if method != "bound":
            raise ArgumentError('levels: are merged with method="bound" only')
        may_grow = bounds is None and np.ndim(resolution) == 0
        return _merge_nested(placed, grid, levels, center, may_grow, device, progress)
    return _merge(placed, np.array([grid.lower, grid.upper]), grid.shape, method, device, progress, None)


def _merge_nested(
    placed: Sequence[_Placed],
    outer: Grid,
    levels: int,
    center: ArrayLike | None,
    may_grow: bool,
    device: str,
    progress: Progress,
) -> NestedField:
    from .nested import LEAST_SIDE, MAX_LEVELS, NestedField, nested_grids

    count = checks.integer("levels", levels, least=1, most=MAX_LEVELS)
    box = np.array([outer.lower, outer.upper])
    middle = box.mean(axis=0)
    point = middle if center is None else checks.vector("center", center, 3)
    if may_grow and min(outer.shape) < LEAST_SIDE:
        # A flat scene: more of the voxels that it has.
        x, y, z = (max(side, LEAST_SIDE) for side in outer.shape)
        half = np.array([x, y, z]) * np.asarray(outer.spacing) / 2
        outer = Grid(checks.triple(middle - half), checks.triple(middle + half), (x, y, z))
    merged = []
    with progress_callback(progress, "merge") as callback:
        for number, grid in enumerate(nested_grids(outer, count, point)):
            bounds = np.array([grid.lower, grid.upper])
            part = part_of(callback, number, count)
            merged.append(_merge(placed, bounds, grid.shape, "bound", device, part, None))
    return NestedField(merged)


def _merge(
    placed: Sequence[_Placed],
    bounds: NDArray[np.float64],
    shape: tuple[int, int, int],
    method: Method,
    device: str,
    progress: Progress,
    earlier: tuple[MergedField, Sequence[int]] | None,
) -> MergedField:
    # To the core volumes come first, each once, then quadrics.
    volumes: dict[int, Volume] = {}
    numbers: dict[int, int] = {}
    instances: list[int] = []
    transforms: list[NDArray[np.float64]] = []
    quadrics: list[Quadric] = []
    # Where each item is in the core.
    spans: list[range] = []
    count = sum(isinstance(item.thing, Volume) for item in placed)
    for item in placed:
        if isinstance(item.thing, Volume):
            number = numbers.setdefault(id(item.thing), len(numbers))
            volumes[number] = item.thing
            spans.append(range(len(instances), len(instances) + 1))
            instances.append(number)
            transforms.append(item.transform)
        else:
            spans.append(range(count + len(quadrics), count + len(quadrics) + len(item.thing)))
            quadrics += item.quadrics

    start = time.perf_counter()
    previous = None
    if earlier is not None:
        previous = earlier[0]._distances, earlier[0]._owners, [i for item in earlier[1] for i in spans[item]]
    with progress_callback(progress, "merge") as callback:
        distances, owners, facts = _core.merge(
            [_volume_row(volume) for volume in volumes.values()],
            instances,
            np.array(transforms, np.float64).reshape(-1, 4, 4),
            rows_of(quadrics),
            checks.triple(bounds[0]),
            checks.triple(bounds[1]),
            shape,
            method=method,
            previous=previous,
            device=device,
            progress=callback,
        )
    boxes = np.stack([item.bounds for item in placed])
    inner = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    seconds = {"merge": time.perf_counter() - start}
    report = Report(device=facts["device"], seconds=seconds, warnings=tuple(facts.get("warnings", ())))
    field = MergedField._wrap(distances, np.array(bounds), inner, report)
    assert isinstance(field, MergedField)
    field._owners = NOBODY if owners is None else checks.frozen(owners)
    field._placed = tuple(placed)
    return field


def _volume_row(volume: Volume) -> tuple[Any, ...]:
    lower, upper = volume._corners()
    return volume._distances, lower, upper, *(checks.triple(corner) for corner in volume.inner_bounds)


def _items(scene: Any) -> Sequence[Any]:
    """The instances of a scene, or of a list."""
    items = getattr(scene, "instances", scene)
    if isinstance(items, (Volume, SparseVolume, Quadric)):
        items = [items]
    if isinstance(items, (str, bytes)) or not isinstance(items, Sequence):
        raise SceneError(f"scene: must be a Scene or a list of things, got {checks.describe(scene)}")
    if not items:
        raise SceneError("scene: is empty; give at least one instance")
    return items


def _place(name: str, item: Any, baked: dict[tuple[int, int], Volume]) -> _Placed:
    """A field and where it stands; `baked` keeps the fields of things by identity."""
    thing, transform, resolution = item, None, THING_RESOLUTION
    if hasattr(item, "thing"):
        thing, transform = item.thing, item.transform
        resolution = getattr(item, "resolution", THING_RESOLUTION)
    elif (
        isinstance(item, tuple)
        and len(item) == 2
        and (isinstance(item[0], (Volume, SparseVolume, Quadric)) or not _is_arrays(item))
    ):
        thing, transform = item
    matrix = np.eye(4) if transform is None else checks.affine(f"{name}: transform", transform, SceneError)
    if is_quadrics(thing):
        return _Placed(tuple(check_quadrics(thing)), matrix)
    if isinstance(thing, (SparseVolume, AtlasEntry)):
        thing = thing.to_volume()
    if isinstance(thing, Volume):
        return _Placed(thing, matrix)
    key = (id(thing), resolution)
    if key not in baked:
        try:
            baked[key] = thing.to_volume() if isinstance(thing, SparseVolume) else bake(thing, resolution)
        except DeviceError:
            raise
        except Error as error:
            raise type(error)(f"{name}: {error}") from error
    return _Placed(baked[key], matrix)


def _index(number: int, value: object, count: int) -> int:
    return checks.integer(f"changed[{number}]", value, least=0, most=count - 1, error=SceneError)


class SphereIntersection(NamedTuple):
    """The circle in which two spheres meet."""

    #: Of the circle, (3,).
    center: NDArray[np.float64]
    #: From the first centre to the second, unit, (3,).
    normal: NDArray[np.float64]
    radius: float


def sphere_intersection(s0: ArrayLike, r0: float, s1: ArrayLike, r1: float) -> SphereIntersection:
    """Where two spheres meet: the construction by which the article looks for a distance beyond a box.

    With `p` outside a box, `b` its nearest point, `a = |p - b|` and `s` the distance at `b`: the surface lies beyond
    the plane of the box through `b` and outside the sphere of radius `s` round `b`. The nearest that is left is the
    circle in which that sphere meets the plane, at ``sqrt(a^2 + s^2)`` from `p`; the sphere of that radius round `p`
    passes through the same circle. That is the bound of :func:`merge`.

    Parameters
    ----------
    s0, s1 : (3,)
        Centres.
    r0, r1 : float
        Radii.

    Returns
    -------
    SphereIntersection
        ``.center``, ``.normal``, ``.radius``.

    Raises
    ------
    ArgumentError
        If the spheres do not meet, or have the same centre.

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
        raise ArgumentError(f"r0, r1: spheres of radii {r0:g} and {r1:g} at distance {d:g} do not meet in a circle")
    h = 0.5 + (r0 * r0 - r1 * r1) / (2 * d * d)
    return SphereIntersection(first + h * apart, apart / d, float(np.sqrt(max(0.0, r0 * r0 - (h * d) ** 2))))
