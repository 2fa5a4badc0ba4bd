"""The core functions for bare arrays: arrays in, arrays out, no objects kept between calls.

They suit programs that have mesh and image types of their own. Arrays are used without a copy if their type fits:
float32 distances with x fastest in memory, float64 vertices, int64 faces. All others are converted once.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .atlases.packing import pack as pack_volumes
from .atlases.pages import Layout
from .base import checks
from .base.checks import DistanceType
from .base.errors import ArgumentError
from .base.grid import MAX_SIDE
from .base.report import Report
from .drawing.raymarching import raymarch as draw
from .meshes.input_arrays import check_faces, check_vertices
from .queries.common import Sign
from .scenes.camera import Camera
from .scenes.field_cache import forget
from .volumes.stored_samples import check_distances
from .volumes.volume import Volume

Method = Literal["tree", "brute"]

__all__ = ["bake", "pack", "raymarch"]


def __dir__() -> list[str]:
    return sorted(__all__)


def bake(
    vertices: ArrayLike,
    faces: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    shape: tuple[int, int, int],
    *,
    sign: Sign = "auto",
    method: Method = "tree",
    dtype: DistanceType = "float32",
    device: str = "auto",
) -> NDArray[Any]:
    """Compute the distances of a mesh at the voxel centres of a box.

    Parameters
    ----------
    vertices : (n, 3) real
        Positions, world units.
    faces : (m, 3) integer
        Rows of `vertices`.
    lower, upper : (3,) real
        Corners of the box, world units.
    shape : (nx, ny, nz)
        Number of voxels along x, y and z.
    sign, device
        As for :func:`fieldbake.bake`.
    method : "tree" or "brute", default "tree"
        ``"tree"`` searches a bounding volume hierarchy. ``"brute"`` is the bake of the articles: every sample visits
        every triangle, in float32 on a graphics device. It is the reference for comparisons, in
        ``shaders/mesh/bake_brute.wgsl``.
        It supports ``sign="normal"`` (article 001), ``"parity"`` (article 003) and ``"unsigned"``. Its time is
        proportional to samples times faces.
    dtype : "float32" or "float64", default "float32"
        Type of the distances. ``"float64"`` evaluates them from the float64 vertices after the bake, with the signs of
        ``"float32"``; each sample needs a search of its own.

    Returns
    -------
    (nx, ny, nz) float32 or float64
        Signed distances, negative inside, x fastest in memory: voxel (i, j, k) at
        ``lower + (index + 0.5) * (upper - lower) / shape``.

    Raises
    ------
    MeshError, ArgumentError, CapacityError, DeviceError
        As for :func:`fieldbake.bake`.

    Examples
    --------
    >>> from fieldbake import arrays
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    >>> distances = arrays.bake(corners, faces, (-1, -1, -1), (2, 2, 2), (12, 12, 12))
    >>> distances.shape, bool(distances[4, 4, 4] < 0)
    ((12, 12, 12), True)
    """
    corners = _box(lower, upper)
    nx, ny, nz = (checks.integer("shape", n, least=1, most=MAX_SIDE) for n in _three(shape))
    mesh = _core.Mesh(checks.as_float64(check_vertices(vertices)), check_faces(faces))
    checks.text("sign", sign)
    checks.text("device", device)
    checks.choice("method", method, get_args(Method))
    checks.choice("dtype", dtype, get_args(DistanceType))
    if method == "brute":
        distances: NDArray[np.float32] = _core.bake_brute(mesh, *corners, (nx, ny, nz), sign, device)
    else:
        found, _ = _core.bake(mesh, *corners, (nx, ny, nz), sign=sign, device=device)
        distances = found.read() if isinstance(found, _core.DeviceField) else found
    return _core.refined(mesh, distances, *corners) if dtype == "float64" else distances


def pack(
    distances: Iterable[ArrayLike], *, layout: Layout = "shelves", page_size: int = 4096
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Pack grids of distances into the pages of an atlas.

    Parameters
    ----------
    distances : list of (nx, ny, nz) real
        Grids of distances. For strips they must be equal cubes.
    layout, page_size
        As for :func:`fieldbake.pack`.

    Returns
    -------
    pages : (pages, page_size, page_size) float32
        Texels, row 0 first.
    entries : (n,) structured
        As :attr:`fieldbake.Atlas.entries`; the boxes are in voxels, from (0, 0, 0) to (nx, ny, nz).

    Raises
    ------
    AtlasError, ArgumentError, CapacityError
        As for :func:`fieldbake.pack`.

    Examples
    --------
    >>> pages, entries = pack([np.ones((8, 8, 8))], layout="strips", page_size=64)
    >>> pages.shape, entries.itemsize
    ((1, 64, 64), 208)
    """
    volumes = []
    for samples in map(check_distances, checks.items("distances", distances, "arrays")):
        box = np.array([(0, 0, 0), samples.shape], np.float64)
        volumes.append(Volume._wrap(samples[...], box, box.copy(), Report()))
    atlas = pack_volumes(volumes, layout=layout, page_size=page_size)
    return atlas.pages, atlas.entries


def raymarch(
    distances: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    pose: ArrayLike,
    *,
    fov_deg: float = 45.0,
    size: tuple[int, int] = (512, 512),
    device: str = "auto",
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw the zero level set of a grid of distances, with the default light and colours of :func:`fieldbake.raymarch`.

    Parameters
    ----------
    distances : (nx, ny, nz) real
        Samples at the voxel centres.
    lower, upper : (3,) real
        Corners of the box, world units.
    pose : (4, 4) real
        World from camera. The camera looks along its -Z axis, and +Y points upwards.
    fov_deg : float, default 45
        Vertical field of view, degrees.
    size : (width, height), default (512, 512)
        Size of the picture, pixels.
    device : str, default "auto"
        As for :func:`fieldbake.raymarch`.

    Returns
    -------
    color : (h, w, 4) float32
        Linear RGB and opacity.
    depth : (h, w) float32
        Distance along the viewing axis, world units; inf for pixels without a hit.

    Raises
    ------
    ArgumentError, SceneError, DeviceError
        As for :func:`fieldbake.raymarch`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> from fieldbake import arrays
    >>> volume = fb.bake(fb.sphere(), 32)
    >>> pose = fb.Camera((0, 0, 4), (0, 0, 0)).pose
    >>> color, depth = arrays.raymarch(volume.distances, *volume.bounds, pose, size=(65, 65))
    >>> round(float(depth[32, 32]), 2)
    3.0
    """
    box = np.array(_box(lower, upper))
    volume = Volume._wrap(check_distances(distances)[...], box, box.copy(), Report())
    try:
        frame = draw(volume, Camera.from_pose(pose, fov_deg), size=size, device=device)
    finally:
        forget(volume)
    return frame.color, frame.depth


def _box(lower: ArrayLike, upper: ArrayLike) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    first, second = checks.vector("lower", lower, 3), checks.vector("upper", upper, 3)
    corners = checks.box("lower, upper", np.stack([first, second]))
    return checks.triple(corners[0]), checks.triple(corners[1])


def _three(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    try:
        x, y, z = shape
    except (TypeError, ValueError):
        raise ArgumentError(f"shape: must be (nx, ny, nz), got {checks.describe(shape)}") from None
    return x, y, z
