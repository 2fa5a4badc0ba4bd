"""From a mesh to a truncated field in a Zarr store, shard by shard."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _core
from ...baking.dense import log_warnings, prepare, refuse_devices
from ...base import checks, encodings
from ...base.encodings import Encoding
from ...base.errors import ArgumentError
from ...base.grid import Resolution
from ...base.progress import Progress, progress_callback
from ...base.report import Report
from ...base.threads import limited_threads
from ...meshes.convert import MeshLike
from ...meshes.mesh import Mesh
from ...queries.common import Sign
from .. import content, executors
from . import shard_plan, shards, store
from .layout import MOST_SHARD, Layout, path_of, shard_key
from .zarr_volume import ZarrVolume

if TYPE_CHECKING:
    from zarr.abc.store import Store

ZARR_RESOLUTION = 4096

#: Progress reaches a callback at most this often, seconds.
INTERVAL = 0.1


def bake_to_zarr(
    mesh: MeshLike,
    store: str | os.PathLike[str] | Store,
    resolution: Resolution = ZARR_RESOLUTION,
    *,
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    margin: float = 0.1,
    sign: Sign = "auto",
    band: float = 3,
    two_sided: bool = False,
    thickness: float | None = None,
    shard: int = 256,
    chunk: int = 32,
    encoding: Encoding = "snorm16",
    executor: Any = None,
    resume: bool = True,
    threads: int | None = None,
    storage_options: Mapping[str, Any] | None = None,
    device: str = "auto",
    progress: Progress = None,
) -> ZarrVolume:
    """Bake a mesh into a Zarr store; the grid may be larger than memory.

    Parameters
    ----------
    mesh, voxel_size, bounds, margin, sign
        As for :func:`bake`.
    store : path, URL or Zarr store
        A folder, a URL of fsspec (``s3://bucket/name``, ``memory://name``, ...) or any store of Zarr 3.
    resolution : int or three ints, default 4096
        As for :func:`bake`.
    band : float, default 3
        Half width of the band around the surface, voxels. Larger distances are clamped to it.
    two_sided, thickness
        Not available: :func:`bake` and :func:`bake_sparse` bake sheets with a thickness.
    shard : int, default 256
        Samples along the side of a shard: one task, and one file or object of the store.
    chunk : int, default 32
        Samples along the side of a chunk, the smallest part of a shard that is read; it divides `shard`.
    encoding : str, default "snorm16"
        ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``. The largest integer represents the band.
    executor : optional
        A pool of `concurrent.futures`, a ``dask.distributed.Client`` or the address of its scheduler, or anything with
        ``submit`` whose futures have ``result``, ``done``, ``cancel`` and ``add_done_callback``. By default the threads
        of this process work on one shard after another.
    resume : bool, default True
        Keep the shards that a run with the same mesh and options has stored. False deletes the contents of the store.
    threads : int, optional
        Threads of each worker process. By default processes times threads is the number of cores.
    storage_options : mapping, optional
        Options of the file system of a URL.
    device : str, default "auto"
        ``"auto"`` or ``"cpu"``: shards are baked on the CPU.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction of shards.

    Returns
    -------
    ZarrVolume
        The field, opened for reading.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ArgumentError
        If an option is invalid, or the store has a bake of another mesh, with other options or by another version.
    FormatError
        If the store has other contents; they stay as they are.
    Error
        If the package zarr is not installed.
    OSError
        If the store cannot be written, for instance because the disk is full. A later call resumes.

    Warns
    -----
    SurfaceWarning
        Once per call if the surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The store is a group of Zarr v3 with sharding and OME-Zarr 0.5 metadata, in the order z, y, x. Its array ``0`` has
    the distances of :func:`bake` with `band`, encoded as :meth:`Volume.quantize` does, bit for bit. Coarser levels
    are baked from the mesh on grids with voxels 2, 4, ... times as long, and have the same scale. Shards wholly outside
    the solid and the band are not stored: their value is the fill value. The mesh is stored too, and each worker
    process reads it once.

    A shard is stored in one atomic write. Ctrl-C, a killed worker or a killed client leave a store that the same call
    completes: it repeats the plan and bakes what is missing.

    Examples
    --------
    >>> import fieldbake
    >>> knot = fieldbake.models.torus_knot(segments=64, sides=8)
    >>> fieldbake.bake_to_zarr(knot, "memory://knot", 96, shard=64).resolution
    (93, 96, 42)
    """
    place = _place(store, storage_options)
    checks.flag("resume", resume)
    refuse_devices("bake_to_zarr", device)
    if checks.flag("two_sided", two_sided) or thickness is not None:
        raise ArgumentError("two_sided, thickness: bake_to_zarr bakes no sheets; use bake or bake_sparse")
    limit = None if threads is None else checks.integer("threads", threads, least=1, most=2**16)
    executors.checked_executor(executor)
    if not place.is_shared and not executors.is_local(executor):
        raise ArgumentError(
            f"executor: its processes cannot see {place}, which is in the memory of this process; use a path or a URL, "
            "or executor=None"
        )
    layout, surface = _checked_layout(mesh, resolution, voxel_size, bounds, margin, sign, band, shard, chunk, encoding)
    shards.keep_mesh(layout.mesh, surface)
    group, tasks = _planned(place, layout, surface, resume)
    if tasks:
        _check_version(place, group)
        with executors.opened(executor) as pool:
            if limit is None:
                limit = executors.threads_per_worker(pool)
            with limited_threads(limit):
                _work(place, layout, tasks, pool, shards.Threads(limit), progress)
    elif callable(progress):
        progress(1.0)
    volume = ZarrVolume._open(place)
    log_warnings(volume.report)
    return volume


def _place(target: Any, options: Mapping[str, Any] | None) -> store.Place:
    return store.Place.of(target, options)


def _checked_layout(
    mesh: MeshLike,
    resolution: Resolution,
    voxel_size: float | None,
    bounds: ArrayLike | None,
    margin: float,
    sign: Sign,
    band: float,
    shard: int,
    chunk: int,
    encoding: str,
) -> tuple[Layout, Mesh]:
    width = checks.number("band", band, above=0)
    side = checks.integer("shard", shard, least=1, most=MOST_SHARD)
    part = checks.integer("chunk", chunk, least=1, most=side)
    if side % part:
        raise ArgumentError(f"chunk: must divide shard ({side}), got {part}")
    checks.choice("encoding", encoding, encodings.NAMES)
    job = prepare(mesh, resolution, voxel_size, bounds, margin, sign, False, None, default=ZARR_RESOLUTION)
    # The names of the sign methods are checked by the core.
    _core.contains(job.mesh._core, np.empty((0, 3)), sign=job.sign)
    grid = job.grid
    inner = checks.triple(job.inner[0]), checks.triple(job.inner[1])
    facts = content.of_mesh(job.mesh)
    layout = Layout(grid.lower, grid.upper, grid.shape, width, side, part, encoding, job.sign, facts, inner)
    return layout, job.mesh


def _planned(place: store.Place, layout: Layout, mesh: Mesh, resume: bool) -> tuple[Any, list[Task]]:
    with store.reading(place):
        group = _prepared_group(place, layout, mesh, resume)
        return group, _planned_tasks(group, layout, mesh)


def _prepared_group(place: store.Place, layout: Layout, mesh: Mesh, resume: bool) -> Any:
    """The group of the store, created if there is none, with the whole mesh."""
    group = place.existing("r+")
    if group is not None and "fieldbake" in group.attrs and resume:
        _check_same(place, store.read_layout(group, place), layout)
        if not store.has_mesh(group):
            store.write_mesh(group, mesh)
        return group
    facts = _core.query(mesh._core, mesh.bounds.mean(axis=0)[None], sign=layout.sign, device="cpu")[-1]
    facts.update(band=layout.band_width, points=0, inside_points=0, seconds={})
    return store.create(place, group, layout, mesh, Report.of_mesh(mesh, facts).to_dict())


def _check_same(place: store.Place, found: Layout, requested: Layout) -> None:
    if found == requested:
        return
    differences = [
        "another mesh" if name == "mesh" else f"{name} {old}, not {new}"
        for (name, old), new in zip(found.to_dict().items(), requested.to_dict().values(), strict=True)
        if old != new and name != "inner"
    ]
    raise ArgumentError(
        f"store: {place} has a bake with {'; '.join(differences)}. Pass the same options to resume it, "
        "another store, or resume=False to delete it"
    )


def _check_version(place: store.Place, group: Any) -> None:
    """Raise an error if another version would bake the missing shards: its samples may differ in the last bit."""
    version = group.attrs["fieldbake"].get("version")
    if version != _core.__version__:
        raise ArgumentError(
            f"store: {place} was begun by fieldbake {version}, and this is {_core.__version__}; finish it with that "
            "version, or pass resume=False to delete it"
        )


Task = tuple[int, tuple[int, int, int]]


def _planned_tasks(group: Any, layout: Layout, mesh: Mesh) -> list[Task]:
    """The shards that are not stored yet: those near the surface first, in Morton order, level by level.

    The far distances and the states are completed. A run may have been killed between an array and its chunks.
    """
    tasks: list[Task] = []
    shape = tuple(n + 1 for n in reversed(layout.counts(0)))

    def distances(found: NDArray[np.float32]) -> NDArray[np.float32]:
        return shard_plan.far_distances(mesh, layout) if np.isnan(found).any() else found

    store.complete(group, "far/distances", shape, np.float32, np.nan, distances)
    for level in range(layout.level_count):
        stored, near = shard_plan.stored_shards(mesh, layout, level)
        # Some shards of the plan turned out to be wholly outside; their state is 0.
        planned = stored.transpose(2, 1, 0)
        path = f"far/states/{level}"
        states = store.complete(group, path, planned.shape, np.uint8, 1, partial(np.multiply, planned))
        stored &= states.transpose(2, 1, 0) != 0
        keys = store.stored_keys(group, level, clean=True)
        for part in (stored & near, stored & ~near):
            for x, y, z in shard_plan.morton_order(np.argwhere(part)).tolist():
                if shard_key(level, (x, y, z)) not in keys:
                    tasks.append((level, (x, y, z)))
    return tasks


def _work(
    place: store.Place, layout: Layout, tasks: list[Task], executor: Any, threads: shards.Threads, progress: Progress
) -> None:
    with progress_callback(progress, "bake") as callback:
        last = 0.0
        for done, (index, stored, error) in enumerate(_results(place, layout, tasks, executor, threads), 1):
            level, shard = tasks[index]
            if error is not None:
                raise _explained(error, place, level, shard) from error
            if not stored:
                # The bake found the shard to be wholly outside, which the plan cannot always decide.
                x, y, z = shard
                place.open("r+")[f"far/states/{level}"][z, y, x] = 0
            now = time.monotonic()
            if callback is not None and (done == len(tasks) or now - last >= INTERVAL):
                last = now
                callback(done / len(tasks))


def _results(place: store.Place, layout: Layout, tasks: list[Task], executor: Any, threads: shards.Threads) -> Any:
    if executor is not None:
        calls = [(place, layout, level, shard, threads) for level, shard in tasks]
        yield from executors.run_tasks(executor, shards.store_shard, calls)
        return
    for index, (level, shard) in enumerate(tasks):
        try:
            yield index, shards.store_shard(place, layout, level, shard, threads), None
        except Exception as error:  # noqa: PERF203 - as executors report it
            yield index, None, error


def _explained(error: BaseException, place: store.Place, level: int, shard: tuple[int, int, int]) -> BaseException:
    """Return the error of a task with the shard and a remedy in its message."""
    if not isinstance(error, Exception):
        return error
    key = shard_key(level, shard)
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        message = f"no space left for shard {key} of {place}; free some space and call again to resume"
        return OSError(error.errno, message)
    if isinstance(error, OSError):
        return OSError(error.errno, f"shard {key} of {place} cannot be written: {error}; call again to resume")
    if hasattr(error, "add_note"):
        error.add_note(f"in shard {key} of {place}; call again to resume")
    return error


__all__ = ["bake_to_zarr", "path_of"]
