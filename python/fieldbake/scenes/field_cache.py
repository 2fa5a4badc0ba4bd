"""Distance fields of the objects in scenes: baked on demand, kept in memory and, on request, on disk.

The key of a field is a hash of the triangles, the options and the version of the package, so a changed mesh never uses
an old field. On disk each field is one ``.npz`` file that appears only when it is complete, so any number of processes
may share the folder. The folder is ``platformdirs.user_cache_dir("fieldbake")`` or the value of ``FIELDBAKE_CACHE``.
Nothing is written unless that variable is set or :func:`use_disk` was called.
"""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import AtlasEntry
from ..baking.dense import bake, bake_job, prepare
from ..base import checks
from ..base.errors import FormatError
from ..base.log import logger
from ..loading.readers import load
from ..merging.nested import NestedField
from ..meshes.alpha_mask import kept_triangles
from ..meshes.mesh import Mesh
from ..shapes.quadric import Quadric, rows_of
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume
from .sheets import FLAT, Appearance, sheet_of

#: Memory limit of the fields, bytes. The least recently used field is dropped first.
MEMORY_BYTES = 1 << 30

#: Thickness of a flat sheet, voxels. The samples lie on a plate, so its field is exact at any thickness. Points inside
#: the plate are dark; a thin plate therefore leaves no dark row at the contact line of an object. For any other flat
#: outline the field is right on average if it reaches 0.36 voxels below zero.
PLATE_VOXELS = 2e-4
OUTLINE_VOXELS = 0.36

#: Approximate memory of a leaf of a shape, bytes.
SHAPE_BYTES = 4096

_lock = Lock()
_kept: OrderedDict[object, tuple[_core.SceneField, int, object]] = OrderedDict()
_disk: Path | None = None


def use_disk(folder: str | os.PathLike[str] | None = None) -> Path:
    """Store the fields of scenes on disk from now on.

    Parameters
    ----------
    folder : path, optional
        Folder for the fields. The default is the user's cache folder for fieldbake.

    Returns
    -------
    Path
        The folder in use. It is created if it is missing.

    Raises
    ------
    OSError
        If the folder cannot be created.

    Examples
    --------
    >>> import fieldbake as fb
    >>> folder = fb.cache.use_disk("fields")  # doctest: +SKIP
    """
    global _disk
    if folder is None:
        import platformdirs

        folder = platformdirs.user_cache_dir("fieldbake")
    _disk = checks.path(folder, "folder")
    _disk.mkdir(parents=True, exist_ok=True)
    return _disk


def clear() -> None:
    """Drop the fields in memory; files stay.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.cache.clear()
    """
    with _lock:
        _kept.clear()


def of_mesh(
    mesh: Mesh, resolution: int, device: str, appearances: Sequence[Appearance] | None = None
) -> _core.SceneField:
    """Field of a mesh, baked at its first use. `appearances` has one for each part, by default its own."""
    key = ("mesh", content_hash(mesh, resolution, appearances))
    found = _find(key)
    if found is None:
        volume = _from_disk(key[1])
        if volume is None:
            volume = bake_for_scene(mesh, resolution, device, appearances)
            _to_disk(key[1], volume)
        found = _keep(key, _field(volume), volume.nbytes, None)
    return found


def of_geometry(
    geometry: Volume | SparseVolume | NestedField | AtlasEntry | Shape, divisor: float | None = None
) -> _core.SceneField:
    """Field of an object that has one, converted for the core once.

    A grid that is steeper than a distance is divided by its slope, or by `divisor` if it is a level of a nested field:
    cones past it would take its values for clearances.
    """
    if isinstance(geometry, NestedField):
        return _core.SceneField.nested(levels_of(geometry))
    # The key of an entry includes the current contents of its atlas.
    key: tuple[object, ...] = (
        geometry._key if isinstance(geometry, AtlasEntry) else (type(geometry), id(geometry), divisor)
    )
    found = _find(key)
    if found is not None:
        return found
    # The cache keeps the object, so that its id is not reused.
    if isinstance(geometry, AtlasEntry):
        volume = geometry.to_volume()
        return _keep(key, _field(volume), volume.nbytes, geometry)
    if isinstance(geometry, Shape):
        return _keep(
            key, _core.SceneField.shape(geometry._core), SHAPE_BYTES * geometry._core.evaluated_leaves, geometry
        )
    if isinstance(geometry, SparseVolume):
        inner = (checks.triple(corner) for corner in geometry.inner_bounds)
        return _keep(key, _core.SceneField.sparse(geometry._core_field, *inner), geometry.nbytes, geometry)
    return _keep(key, _field(geometry, divisor), geometry.nbytes, geometry)


def forget(volume: Volume) -> None:
    """Release the field of a volume that no later call can have."""
    with _lock:
        _kept.pop((type(volume), id(volume), None), None)


def levels_of(field: Volume | NestedField) -> list[_core.SceneField]:
    """List the fields of the levels of a nested field, finest first, or the one field of a volume.

    All levels are divided by the largest slope of them all, so that they stay equal where they meet.
    """
    levels = field._joined_levels() if isinstance(field, NestedField) else (field,)
    fields = [of_geometry(level, divisor=1.0) for level in levels]
    divisor = max(one.divisor for one in fields)
    return fields if divisor == 1.0 else [of_geometry(level, divisor=divisor) for level in levels]


def of_quadrics(quadrics: Sequence[Quadric]) -> list[_core.SceneField]:
    """Make the field of each quadric."""
    return _core.SceneField.quadrics(rows_of(quadrics))


def content_hash(mesh: Mesh, resolution: int, appearances: Sequence[Appearance] | None = None) -> str:
    """Hash of all inputs that determine the field of a mesh."""
    appearances = _appearances(mesh, appearances)
    digest = hashlib.blake2b(digest_size=20)
    digest.update(f"{_core.__version__} {resolution} {sheet_of(mesh, appearances).is_traced}".encode())
    for array in (mesh.vertices, mesh.faces, mesh.center):
        digest.update(np.ascontiguousarray(array).tobytes())
    for part, appearance in zip(mesh.parts, appearances, strict=True):
        mask = appearance.mask
        digest.update(f"{part.faces} {None if mask is None else mask.shape}".encode())
        if mask is not None and mesh.uv is not None:
            digest.update(np.packbits(mask).tobytes())
            digest.update(np.ascontiguousarray(mesh.uv).tobytes())
    return digest.hexdigest()


def bake_for_scene(
    mesh: Mesh, resolution: int, device: str = "auto", appearances: Sequence[Appearance] | None = None
) -> Volume:
    """Bake a mesh for a scene: masked texels are cut out, sheets get a thickness, solids are baked unchanged."""
    appearances = _appearances(mesh, appearances)
    if sheet_of(mesh, appearances).is_traced:
        masks = [appearance.mask for appearance in appearances]
        axis = _flat_axis(mesh.bounds)
        if axis is not None and all(mask is None for mask in masks):
            return _bake_plate(mesh, axis, resolution, device)
        return bake(kept_triangles(mesh, resolution, masks), resolution, two_sided=True, device=device)
    volume = bake(mesh, resolution, device=device)
    if volume.report.inside_voxels == 0:
        # A surface without an inside has a field only if it gets a thickness.
        volume = bake(mesh, resolution, two_sided=True, device=device)
    return volume


def _appearances(mesh: Mesh, appearances: Sequence[Appearance] | None) -> Sequence[Appearance]:
    return [Appearance.of(None, part) for part in mesh.parts] if appearances is None else appearances


def _flat_axis(bounds: NDArray[np.float64]) -> int | None:
    """Return the axis along which a box has no extent; None if there is none."""
    extent = bounds[1] - bounds[0]
    axis = int(extent.argmin())
    return axis if extent[axis] <= FLAT * extent.max() else None


def _bake_plate(mesh: Mesh, axis: int, resolution: int, device: str) -> Volume:
    """Bake a flat mesh on a grid whose samples lie on its plane and on the edges of its box."""
    lower, upper = mesh.bounds
    extent = upper - lower
    voxel = float(extent.max()) / max(resolution - 4, 4)
    # Whole cells between the edges and two cells beyond them; across the plane, two samples on each side.
    cells = np.maximum(np.round(extent / voxel), 1).astype(np.int64)
    spacing = np.where(extent > 0, extent / cells, voxel)
    cells[axis], spacing[axis] = 0, voxel
    box = np.stack([lower - 2.5 * spacing, upper + 2.5 * spacing])
    thin = PLATE_VOXELS if _is_rectangle(mesh, axis) else OUTLINE_VOXELS
    nx, ny, nz = (cells + 5).tolist()
    job = prepare(mesh, (nx, ny, nz), None, box, 0.0, "auto", True, thin * voxel)
    return bake_job(job, None, device, None)


def _is_rectangle(mesh: Mesh, axis: int) -> bool:
    """Whether a flat mesh fills its box completely."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    sides = np.delete(mesh.bounds[1] - mesh.bounds[0], axis)
    return bool(abs(area - sides.prod()) <= 1e-4 * sides.prod())


def _field(volume: Volume, divisor: float | None = None) -> _core.SceneField:
    lower, upper = volume._corners()
    inner = volume.inner_bounds
    return _core.SceneField(volume._distances, lower, upper, checks.triple(inner[0]), checks.triple(inner[1]), divisor)


def _find(key: object) -> _core.SceneField | None:
    with _lock:
        if key not in _kept:
            return None
        _kept.move_to_end(key)
        return _kept[key][0]


def _keep(key: object, field: _core.SceneField, size: int, owner: object) -> _core.SceneField:
    with _lock:
        _kept[key] = (field, size, owner)
        total = sum(entry[1] for entry in _kept.values())
        while total > MEMORY_BYTES and len(_kept) > 1:
            total -= _kept.popitem(last=False)[1][1]
    return field


def _folder() -> Path | None:
    named = os.environ.get("FIELDBAKE_CACHE")
    if _disk is None and named:
        return use_disk(named)
    return _disk


def _from_disk(name: str) -> Volume | None:
    folder = _folder()
    if folder is None or not (folder / f"{name}.npz").is_file():
        return None
    try:
        found = load(folder / f"{name}.npz")
        return found if isinstance(found, Volume) else None
    except (FormatError, OSError) as error:
        logger.warning("a cached field cannot be used and is baked again: %s", error)
        return None


def _to_disk(name: str, volume: Volume) -> None:
    folder = _folder()
    if folder is None:
        return
    try:
        volume.save(folder / f"{name}.npz")
    except OSError as error:
        logger.warning("a field could not be kept on disk: %s", error)
