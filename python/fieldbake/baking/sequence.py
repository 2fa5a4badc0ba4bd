"""Baking of an animated mesh, frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import MeshError
from ..base.grid import DEFAULT_RESOLUTION, Resolution
from ..base.progress import Progress
from ..meshes.convert import as_mesh
from ..meshes.mesh import Mesh
from ..queries.common import Sign, choices
from ..volumes.volume import Volume
from .dense import Job, bake_job, log_warnings, prepare


def bake_sequence(
    frames: Iterable[Any],
    resolution: Resolution = DEFAULT_RESOLUTION,
    bounds: str | ArrayLike = "common",
    *,
    voxel_size: float | None = None,
    margin: float = 0.1,
    sign: Sign = "auto",
    band: float | None = None,
    two_sided: bool = False,
    thickness: float | None = None,
    device: str = "auto",
    progress: Progress = None,
) -> Iterator[Volume]:
    """Bake the signed distance field of each frame of an animated mesh.

    Parameters
    ----------
    frames : iterable
        The first frame is a mesh: anything that :func:`bake` accepts except shapes. Each other frame is a mesh too, or
        an array (n, 3) of new positions for the vertices of the previous frame, as for :meth:`Mesh.moved`. Generators
        are accepted.
    resolution : int or three ints, default 64
        As for :func:`bake`.
    bounds : "common", "follow" or (2, 3) array, default "common"
        Box to sample. ``"common"``: one box around all frames, with `margin`. All frames are read and kept in memory
        before the first volume, so a generator must be finite. ``"follow"``: each frame has the box that :func:`bake`
        chooses for it. An array is the box of all frames, world units. The last two read one frame at a time.
    voxel_size, margin, sign, band, two_sided, thickness, device, progress
        As for :func:`bake`.

    Returns
    -------
    iterator of Volume
        One volume for each frame, in order. Each is equal, bit for bit, to ``bake(frame, volume.resolution,
        bounds=volume.bounds, ...)`` with the same options.

    Raises
    ------
    MeshError
        If a frame cannot be used. The message names the frame. Raised when the frame is read.
    ArgumentError
        If an option is out of range.

    Notes
    -----
    A frame with the faces of the previous frame reuses its work: the search tree is refitted to an array of positions,
    and samples that no moved triangle can change are kept; see :meth:`Volume.update`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> knot = fb.models.torus_knot()
    >>> rising = [knot] + [knot.vertices + [0, 0, height] for height in (0.1, 0.2)]
    >>> [volume.resolution for volume in fb.bake_sequence(rising, 24)]
    [(23, 24, 13), (23, 24, 13), (23, 24, 13)]
    """
    shared = bounds != "follow" if isinstance(bounds, str) else True
    if isinstance(bounds, str):
        checks.choice("bounds", bounds, ("common", "follow"))
    box = None if isinstance(bounds, str) else checks.box("bounds", bounds)
    checks.choice("sign", sign, get_args(Sign))
    _, where = choices(sign, device)
    if band is not None:
        band = checks.number("band", band, above=0)
    read = checks.items("frames", frames, "meshes and vertices")

    def choose(mesh: Mesh, around: NDArray[np.float64] | None) -> Job:
        return prepare(mesh, resolution, voxel_size, box, margin, sign, two_sided, thickness, around)

    def volumes() -> Iterator[Volume]:
        source, around = (read, None) if box is not None or not shared else _gather(read)
        job: Job | None = None
        before: Volume | None = None
        for mesh in _meshes(source):
            job = job.on_same_grid(mesh) if job is not None and shared else choose(mesh, around)
            before = bake_job(job, band, where, progress, before if _is_like(before, job) else None)
            log_warnings(before.report)
            yield before

    return volumes()


def _meshes(frames: Iterable[Any]) -> Iterator[Mesh]:
    """Convert each frame to a mesh. An array moves the vertices of the previous frame."""
    mesh: Mesh | None = None
    for index, frame in enumerate(frames):
        try:
            if getattr(frame, "ndim", None) != 2:
                mesh = as_mesh(frame)
            elif mesh is not None:
                mesh = mesh.moved(frame)
            else:
                raise MeshError("must be a mesh; an array of vertices needs a previous frame with faces")
        except MeshError as error:
            raise MeshError(f"frames[{index}]: {error}") from None
        yield mesh


def _gather(frames: Iterator[Any]) -> tuple[list[Any], NDArray[np.float64] | None]:
    """Read all frames. Return them, and the box around all of them, (2, 3); None without a frame."""
    kept: list[Any] = []

    def remembered() -> Iterator[Any]:
        for frame in frames:
            # A generator may fill the same array again.
            kept.append(np.array(frame) if isinstance(frame, np.ndarray) else frame)
            yield frame

    boxes = [mesh.bounds for mesh in _meshes(remembered())]
    if not boxes:
        return kept, None
    return kept, np.array([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])


def _is_like(volume: Volume | None, job: Job) -> bool:
    """Whether a volume was baked on the grid and with the options of a job."""
    if volume is None or volume._recipe is None:
        return False
    is_same_box = volume._corners() == (job.grid.lower, job.grid.upper) and volume.resolution == job.grid.shape
    return is_same_box and volume._recipe.thickness == job.thickness
