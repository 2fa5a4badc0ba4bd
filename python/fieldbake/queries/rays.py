"""Rays against a mesh: first hits, occlusion, counts and all intersections."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.progress import Progress, progress_callback
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh
from .common import shaped, source_faces


class RayHits(NamedTuple):
    """First hits of rays; arrays keep the leading shape of the rays.

    Examples
    --------
    >>> import fieldbake as fb
    >>> hits = fb.cast_rays(fb.models.gear(), [(0.7, 0, 3)], [(0, 0, -1)])
    >>> hits.hit.tolist(), hits.t.round(3).tolist(), hits.normals.tolist()
    ([True], [2.825], [[0.0, 0.0, 1.0]])
    """

    #: Distance to the hit in lengths of the direction, (...) float64; infinite for a miss.
    t: NDArray[np.float64]
    #: Faces that were hit, (...) int64; -1 for a miss. Rows as in `ClosestPoints`.
    faces: NDArray[np.int64]
    #: Weights of the face's corners, (..., 3) float64; zero for a miss.
    barycentric: NDArray[np.float64]
    #: Unit normals of the faces by their own winding, (..., 3) float64; zero for a miss.
    normals: NDArray[np.float64]

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Whether each ray hits a face, (...) bool."""
        found: NDArray[np.bool_] = self.faces >= 0
        return found


class Intersections(NamedTuple):
    """All intersections of rays, sorted by ray and then `t`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> found = fb.all_intersections(fb.models.gear(), [(0.7, 0, 3)], [(0, 0, -1)])
    >>> found.rays.tolist(), found.t.round(3).tolist()
    ([0, 0], [2.825, 3.175])
    """

    #: Rows of the rays in C order, (k,) int64.
    rays: NDArray[np.int64]
    #: Distances in lengths of the direction, (k,) float64.
    t: NDArray[np.float64]
    #: Faces, (k,) int64; rows as in `ClosestPoints`.
    faces: NDArray[np.int64]
    #: Weights of the face's corners, (k, 3) float64.
    barycentric: NDArray[np.float64]


def cast_rays(
    mesh: MeshLike,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: float = 0.0,
    t_max: float = math.inf,
    device: str = "auto",
    progress: Progress = None,
) -> RayHits:
    """Find the first face that each ray hits.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` to several calls: its search tree is built once.
    origins : (..., 3) real
        World positions.
    directions : (..., 3) real
        World vectors of any length except zero. A single origin or direction is used for all rays.
    t_min, t_max : float, default 0 and infinity
        Range of the ray, both ends included, in lengths of the direction.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. ``"auto"`` uses the CPU if there are fewer
        than 4,096 rays, or fewer rays than an eighth of the number of vertices: copying the mesh takes longer.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    RayHits
        Distances, faces, barycentric coordinates and face normals. Both sides of a face are hit.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ArgumentError
        For shapes that do not fit together, positions or directions that are not finite, a direction of length zero,
        a direction whose largest component is below 2.3e-308, and ``t_min > t_max``.
    DeviceError
        If the device is unknown or fails.

    Notes
    -----
    The intersections are watertight: a ray from inside a closed mesh always hits a face, also through an edge or a
    vertex. The test follows Woop, Benthin and Wald, *Watertight Ray/Triangle Intersection* (2013), in float64, with
    exact predicates where it gives zero.

    A graphics device searches in float32 for the faces that a ray may hit, and the CPU computes the hits of these faces
    in float64. The CPU searches the rays that float32 does not decide, those with more than eight candidate faces, and
    those that start more than a million box sizes away. All devices therefore return the same bits.

    Examples
    --------
    >>> import fieldbake
    >>> triangle = fieldbake.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    >>> hits = cast_rays(triangle, [(0.25, 0.25, 3), (2, 2, 3)], (0, 0, -2))
    >>> hits.t.tolist(), hits.faces.tolist(), hits.hit.tolist()
    ([1.5, inf], [0, -1], [True, False])
    """
    checked, rays, shape, options = _checked_rays(mesh, origins, directions, t_min, t_max, device)
    with progress_callback(progress, "cast rays") as callback:
        t, faces, weights, normals = _core.cast_rays(checked._core, *rays, **options, progress=callback)
    return RayHits(*shaped(shape, t, source_faces(mesh, checked, faces), weights, normals))


def occluded(
    mesh: MeshLike,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: float = 0.0,
    t_max: float = math.inf,
    device: str = "auto",
    progress: Progress = None,
) -> NDArray[np.bool_]:
    """Test which rays hit a face; this is faster than :func:`cast_rays`.

    Parameters
    ----------
    mesh, origins, directions, t_min, t_max, device, progress
        As for :func:`cast_rays`.

    Returns
    -------
    (...) bool
        True where a face lies between `t_min` and `t_max`.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`cast_rays`.

    Examples
    --------
    >>> import fieldbake
    >>> triangle = fieldbake.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    >>> occluded(triangle, [(0.25, 0.25, 3), (2, 2, 3)], (0, 0, -1)).tolist()
    [True, False]
    """
    checked, rays, shape, options = _checked_rays(mesh, origins, directions, t_min, t_max, device)
    with progress_callback(progress, "occlusion") as callback:
        return _core.occluded(checked._core, *rays, **options, progress=callback).reshape(shape)


def count_intersections(
    mesh: MeshLike,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: float = 0.0,
    t_max: float = math.inf,
    device: str = "auto",
    progress: Progress = None,
) -> NDArray[np.int64]:
    """Count the intersections of each ray; an edge or a vertex that several faces share counts once.

    Parameters
    ----------
    mesh, origins, directions, t_min, t_max, device, progress
        As for :func:`cast_rays`.

    Returns
    -------
    (...) int64
        Number of entries that :func:`all_intersections` returns for each ray.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`cast_rays`.

    Examples
    --------
    >>> import fieldbake
    >>> knot = fieldbake.models.torus_knot(segments=64, sides=8)
    >>> count_intersections(knot, (-9, 0.1, 0.2), (1, 0, 0)).item() % 2
    0
    """
    checked, rays, shape, options = _checked_rays(mesh, origins, directions, t_min, t_max, device)
    with progress_callback(progress, "count intersections") as callback:
        return _core.count_intersections(checked._core, *rays, **options, progress=callback).reshape(shape)


def all_intersections(
    mesh: MeshLike,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: float = 0.0,
    t_max: float = math.inf,
    device: str = "auto",
    progress: Progress = None,
) -> Intersections:
    """List every intersection of every ray.

    Parameters
    ----------
    mesh, origins, directions, t_min, t_max, device, progress
        As for :func:`cast_rays`.

    Returns
    -------
    Intersections
        Rows of the rays in C order, distances, faces and barycentric coordinates, sorted by ray and then distance. An
        edge or a vertex that several faces share counts once, with the face of the lowest row.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`cast_rays`.

    Examples
    --------
    >>> import fieldbake
    >>> corners = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 1), (4, 0, 1), (0, 4, 1)]
    >>> sheets = fieldbake.Mesh(corners, [(0, 1, 2), (3, 4, 5)])
    >>> found = all_intersections(sheets, [(9, 9, 3), (1, 1, 3)], (0, 0, -1))
    >>> found.rays.tolist(), found.t.tolist(), found.faces.tolist()
    ([1, 1], [2.0, 3.0], [1, 0])
    """
    checked, rays, _, options = _checked_rays(mesh, origins, directions, t_min, t_max, device)
    with progress_callback(progress, "all intersections") as callback:
        rows, t, faces, weights = _core.all_intersections(checked._core, *rays, **options, progress=callback)
    return Intersections(rows, t, source_faces(mesh, checked, faces), weights)


def _checked_rays(
    mesh: MeshLike, origins: ArrayLike, directions: ArrayLike, t_min: float, t_max: float, device: str
) -> tuple[Mesh, tuple[NDArray[np.float64], NDArray[np.float64]], tuple[int, ...], dict[str, Any]]:
    """Check mesh, origins, directions, limits and device of rays.

    Origins and directions become (n, 3) arrays of equal length; their leading shape is returned too.
    """
    starts, start_shape = checks.points(origins, "origins")
    vectors, vector_shape = checks.points(directions, "directions")
    if start_shape == vector_shape:
        shape = start_shape
    else:
        try:
            shape = np.broadcast_shapes(start_shape, vector_shape)
        except ValueError:
            raise ArgumentError(
                f"directions: must be one for all origins or as many as origins, got shape {(*vector_shape, 3)} for "
                f"origins of shape {(*start_shape, 3)}"
            ) from None
        starts = np.ascontiguousarray(np.broadcast_to(starts.reshape(*start_shape, 3), (*shape, 3))).reshape(-1, 3)
        vectors = np.ascontiguousarray(np.broadcast_to(vectors.reshape(*vector_shape, 3), (*shape, 3))).reshape(-1, 3)
    first, last = checks.limit("t_min", t_min), checks.limit("t_max", t_max)
    if first > last:
        raise ArgumentError(f"t_min: must be at most t_max ({t_max:g}), got {t_min:g}")
    options = {"t_min": first, "t_max": last, "device": checks.text("device", device)}
    return as_mesh(mesh), (starts, vectors), shape, options
