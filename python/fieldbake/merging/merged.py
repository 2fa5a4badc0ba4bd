"""Merged fields: one field for many instances, and its update after instances have moved."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import AtlasEntry
from ..baking.dense import bake
from ..base import checks
from ..base.errors import DeviceError, Error, SceneError
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..base.viewable import Viewable
from ..meshes.convert import is_arrays
from ..shapes.quadric import Quadric, bounds_of, check_quadrics, is_quadrics, rows_of
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import HasVolume, Volume, plain_field

#: Voxels along the longest side of meshes and shapes that are baked, unless their instance has a resolution.
GEOMETRY_RESOLUTION = 64


class Placed(NamedTuple):
    """A volume or a list of quadrics, and its transform to the world."""

    geometry: Volume | tuple[Quadric, ...]
    transform: NDArray[np.float64]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around the surface, (2, 3), world units."""
        if isinstance(self.geometry, tuple):
            return bounds_of(self.quadrics)
        # The part of the surface box inside the box of the volume.
        box = np.clip(self.geometry.inner_bounds, self.geometry.bounds[0], self.geometry.bounds[1])
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        world = corners @ self.transform[:3, :3].T + self.transform[:3, 3]
        return np.stack([world.min(axis=0), world.max(axis=0)])

    @property
    def quadrics(self) -> list[Quadric]:
        """The quadrics of a list, transformed to the world."""
        return (
            [quadric.transformed(self.transform) for quadric in self.geometry]
            if isinstance(self.geometry, tuple)
            else []
        )


class MergedField(HasVolume, Viewable):
    """The field of a scene, made by :func:`merge`: its volume, and the instances that it was merged from.

    It has the attributes and methods of a :class:`Volume` except `quantize`, `from_xarray` and `load`, and functions of
    volumes accept it too. A saved field is loaded as a Volume, and a copied or pickled one is a Volume, without
    the instances that `update` needs.

    Attributes
    ----------
    volume : Volume
        The samples and their box.

    Examples
    --------
    >>> import numpy as np
    >>> import fieldbake as fb
    >>> ball = fb.bake(fb.sphere(), 16)
    >>> place = np.eye(4)
    >>> place[0, 3] = 1.5
    >>> field = fb.merge([ball, (ball, place)], resolution=32)
    >>> place[0, 3] = 1.25
    >>> field.update([(1, place)]).resolution == field.resolution
    True
    """

    __slots__ = ("_owners", "_placed")

    _owners: NDArray[np.uint32]
    _placed: tuple[Placed, ...]

    def __init__(self, volume: Volume, owners: NDArray[np.uint32], placed: Sequence[Placed]) -> None:
        self.volume = volume
        self._owners = checks.frozen(owners)
        self._placed = tuple(placed)

    def __reduce__(self) -> tuple[Any, ...]:
        return self.volume.__reduce__()

    def __repr__(self) -> str:
        return f"MergedField({self.volume!r})"

    def update(
        self, changed: Sequence[Any], *, scene: Any = None, device: str = "auto", progress: Progress = None
    ) -> MergedField:
        """Update the field after instances have moved; only the affected samples are evaluated.

        Parameters
        ----------
        changed : sequence
            ``(index, transform)`` or ``(index, instance)`` pairs, or indices if `scene` is given. An index is the
            position in the list of instances.
        scene : Scene, optional
            The scene after the change; `changed` then lists the indices of the changed instances.
        device : str, default "auto"
            As for :func:`merge`. The update itself runs on the CPU.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        MergedField
            A field on the same grid, bit for bit equal to a new merge of all instances on that grid.

        Raises
        ------
        SceneError
            For an index out of range, an instance with another number of quadrics, or another number of instances.

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
        placed, indices = self._changed(changed, scene)
        for index in indices:
            if len(placed[index].quadrics) != len(self._placed[index].quadrics):
                raise SceneError(f"changed: instance {index} has another number of quadrics than before; merge again")
        return merge_placed(placed, self.volume.bounds, self.volume.resolution, device, progress, (self, indices))

    def _changed(self, changed: Sequence[Any], scene: Any) -> tuple[list[Placed], list[int]]:
        """List all instances after the change, and the indices of the changed ones."""
        if isinstance(changed, (str, bytes)) or not isinstance(changed, (Sequence, np.ndarray)):
            raise SceneError(f"changed: must be a list, got {checks.describe(changed)}")
        count = len(self._placed)
        if scene is not None:
            indices = [_index(number, item, count) for number, item in enumerate(changed)]
            items = items_of(scene)
            if len(items) != count:
                raise SceneError(f"scene: has {len(items)} instances, the field was merged from {count}; merge again")
            baked: dict[tuple[int, int], Volume] = {}
            replaced = set(indices)
            rest = list(self._placed)
            return [
                place(f"instances[{i}]", items[i], baked) if i in replaced else rest[i] for i in range(count)
            ], sorted(replaced)
        placed = list(self._placed)
        touched = set()
        for number, item in enumerate(changed):
            if not (isinstance(item, (tuple, list)) and len(item) == 2):
                raise SceneError(
                    f"changed[{number}]: must be (index, transform) or (index, instance) unless scene is given, "
                    f"got {checks.describe(item)}"
                )
            index = _index(number, item[0], count)
            if is_instance(item[1]):
                placed[index] = place(f"changed[{number}]", item[1], {})
            else:
                transform = checks.affine(f"changed[{number}]: transform", item[1], SceneError)
                placed[index] = placed[index]._replace(transform=transform)
            touched.add(index)
        return placed, sorted(touched)


def merge_placed(
    placed: Sequence[Placed],
    bounds: NDArray[np.float64],
    shape: tuple[int, int, int],
    device: str,
    progress: Progress,
    earlier: tuple[MergedField, Sequence[int]] | None,
) -> MergedField:
    """Merge placed fields on a grid. With `earlier`, only samples that the listed items affect are evaluated again."""
    # The core takes the volumes first, each once, and then the quadrics.
    volumes: dict[int, Volume] = {}
    numbers: dict[int, int] = {}
    instances: list[int] = []
    transforms: list[NDArray[np.float64]] = []
    quadrics: list[Quadric] = []
    # The rows of each item in the core.
    spans: list[range] = []
    count = sum(isinstance(item.geometry, Volume) for item in placed)
    for item in placed:
        if isinstance(item.geometry, Volume):
            number = numbers.setdefault(id(item.geometry), len(numbers))
            volumes[number] = item.geometry
            spans.append(range(len(instances), len(instances) + 1))
            instances.append(number)
            transforms.append(item.transform)
        else:
            spans.append(range(count + len(quadrics), count + len(quadrics) + len(item.geometry)))
            quadrics += item.quadrics

    start = time.perf_counter()
    previous = None
    if earlier is not None:
        previous = earlier[0].volume.distances, earlier[0]._owners, [i for item in earlier[1] for i in spans[item]]
    with progress_callback(progress, "merge") as callback:
        distances, owners, facts = _core.merge(
            [_volume_row(volume) for volume in volumes.values()],
            instances,
            np.array(transforms, np.float64).reshape(-1, 4, 4),
            rows_of(quadrics),
            checks.triple(bounds[0]),
            checks.triple(bounds[1]),
            shape,
            previous=previous,
            device=device,
            progress=callback,
        )
    boxes = np.stack([item.bounds for item in placed])
    inner = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    seconds = {"merge": time.perf_counter() - start}
    report = Report(device=facts["device"], seconds=seconds, warnings=tuple(facts.get("warnings", ())))
    assert owners is not None
    return MergedField(Volume._wrap(distances, np.array(bounds), inner, report), owners, placed)


def _volume_row(volume: Volume) -> tuple[Any, ...]:
    lower, upper = volume._corners()
    return volume._distances, lower, upper, *(checks.triple(corner) for corner in volume.inner_bounds)


def items_of(scene: Any) -> Sequence[Any]:
    """List the instances of a scene or of a list."""
    items = plain_field(getattr(scene, "instances", scene))
    if isinstance(items, (Volume, SparseVolume, Quadric)):
        items = [items]
    if isinstance(items, (str, bytes)) or not isinstance(items, Sequence):
        raise SceneError(f"scene: must be a Scene or a list of objects, got {checks.describe(scene)}")
    if not items:
        raise SceneError("scene: is empty; give at least one instance")
    return items


def is_instance(item: object) -> bool:
    """Whether an item has the attributes of an instance of a scene. A `trimesh.Scene` has a geometry only."""
    return hasattr(item, "geometry") and hasattr(item, "transform")


def place(name: str, item: Any, baked: dict[tuple[int, int], Volume]) -> Placed:
    """Make a placed field of an item; `baked` keeps the fields of meshes and shapes by identity."""
    geometry, transform, resolution = item, None, GEOMETRY_RESOLUTION
    if is_instance(item):
        geometry, transform = item.geometry, item.transform
        resolution = getattr(item, "resolution", GEOMETRY_RESOLUTION)
    elif (
        isinstance(item, tuple)
        and len(item) == 2
        and (isinstance(item[0], (Volume, HasVolume, SparseVolume, AtlasEntry, Quadric, Shape)) or not is_arrays(item))
    ):
        geometry, transform = item
    geometry = plain_field(geometry)
    matrix = np.eye(4) if transform is None else checks.affine(f"{name}: transform", transform, SceneError)
    if is_quadrics(geometry):
        return Placed(tuple(check_quadrics(geometry)), matrix)
    if isinstance(geometry, (SparseVolume, AtlasEntry)):
        geometry = geometry.to_volume()
    if isinstance(geometry, Volume):
        return Placed(geometry, matrix)
    key = (id(geometry), resolution)
    if key not in baked:
        try:
            baked[key] = bake(geometry, resolution)
        except DeviceError:
            raise
        except Error as error:
            raise type(error)(f"{name}: {error}") from error
    return Placed(baked[key], matrix)


def _index(number: int, value: object, count: int) -> int:
    return checks.integer(f"changed[{number}]", value, least=0, most=count - 1, error=SceneError)
