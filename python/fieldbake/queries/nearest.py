"""Closest points, signed distances, gradients and the inside of a mesh at any points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.checks import DistanceType
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.convert import MeshLike
from ..meshes.mesh import Mesh
from ..points.interop import as_cloud
from .clouds import WINDING_ERROR, is_signed, query_cloud, require_sides
from .common import Sign, checked_points, choices, shaped, source_faces, warn_of_signs

#: Largest error of the winding number of a mesh, unless the caller chooses.
MESH_WINDING_ERROR = 1e-6


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """The nearest points of a surface; arrays keep the leading shape of the query points.

    Unpacks as ``points, distances, faces``, the order of `trimesh.proximity.closest_point`.

    Attributes
    ----------
    points : (..., 3) float64
        Closest points on the surface, world units.
    distances : (...) float64
        Unsigned distances, world units.
    faces : (...) int64
        Faces that contain the points: rows of `Mesh.faces` for a Mesh, rows of the points for a cloud, rows of the
        faces as passed or read for anything else.
    barycentric : (..., 3) float64
        Weights of the face's corners, from 0 to 1; their sum is 1. (1, 0, 0) for a cloud.
    normals : (..., 3) float64
        Unit normals of the faces, by their own winding; normals of the points for a cloud, zeros if it has none.

    Examples
    --------
    >>> import fieldbake as fb
    >>> points, distances, faces = fb.closest_point(fb.models.gear(), [(0, 0, 3), (0, 0, -3)])
    >>> distances.round(3).tolist()
    [2.853, 2.853]
    """

    points: NDArray[np.float64]
    distances: NDArray[np.float64]
    faces: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    normals: NDArray[np.float64]

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return iter((self.points, self.distances, self.faces))


class Query(NamedTuple):
    """Signed distances of points with the nearest points of the surface; arrays keep the leading shape.

    Examples
    --------
    >>> import fieldbake as fb
    >>> found = fb.query(fb.models.gear(), [(0.7, 0, 3)])
    >>> found.distances.round(3).tolist(), found.gradients.round(3).tolist()
    ([2.825], [[0.0, 0.0, 1.0]])
    """

    #: Signed distances, (...) float64, world units, negative inside.
    distances: NDArray[np.float64]
    #: Unit gradients of the signed distance, (..., 3) float64: they point away from the inside.
    gradients: NDArray[np.float64]
    #: Closest points on the surface, (..., 3) float64, world units.
    points: NDArray[np.float64]
    #: Faces that contain the closest points, (...) int64; rows as in `ClosestPoints`.
    faces: NDArray[np.int64]
    #: Weights of the face's corners, (..., 3) float64, from 0 to 1.
    barycentric: NDArray[np.float64]
    #: Properties of the surface and cost of the work, as for a bake.
    report: Report
    #: Index in `Scene.instances` of the instance that contains the closest point, (...) int64; None for a mesh.
    instances: NDArray[np.int64] | None = None


@runtime_checkable
class Queryable(Protocol):
    """An object that evaluates its own distances: a scene of placed meshes and shapes."""

    def _query(self, points: Any, *, sign: str, device: str, progress: Progress) -> Query:
        """Evaluate distances, gradients and nearest points."""


def closest_point(
    mesh: MeshLike, points: ArrayLike, *, device: str = "auto", progress: Progress = None
) -> ClosestPoints:
    """Find the nearest point of a mesh for any points.

    Parameters
    ----------
    mesh : Mesh, PointCloud, or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` or `PointCloud` to several calls: its search tree is built once.
    points : (..., 3) real
        World positions.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. ``"auto"`` uses the CPU if there are fewer
        than 4,096 points, or fewer points than an eighth of the number of vertices: copying the mesh takes longer.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    ClosestPoints
        Points, unsigned distances, faces, barycentric coordinates and face normals.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`bake`; ArgumentError also for a point that is not finite.

    Notes
    -----
    The CPU chooses the nearest face in float64. Among equally near faces it takes the lowest row. A graphics device
    chooses in float32, so its distances may be larger by up to 1e-6 of the mesh's size.

    Examples
    --------
    >>> import fieldbake
    >>> triangle = fieldbake.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    >>> closest = closest_point(triangle, [(0.25, 0.25, 3.0)])
    >>> closest.points.tolist(), closest.distances.tolist(), closest.faces.tolist()
    ([[0.25, 0.25, 0.0]], [3.0], [0])
    >>> closest.barycentric.tolist(), closest.normals.tolist()
    ([[0.5, 0.25, 0.25]], [[0.0, 0.0, 1.0]])
    """
    where = checks.text("device", device)
    if (cloud := as_cloud(mesh)) is not None:
        is_signed(cloud, "unsigned", where)
        flat, shape = checks.points(points)
        with progress_callback(progress, "closest point") as callback:
            distances, nearest, faces, *_ = cloud._core.query(flat, signed=False, progress=callback)
        normals = cloud._normals_of(faces)
        return ClosestPoints(*shaped(shape, nearest, distances, faces, _first_weights(len(flat)), normals))
    checked, flat, shape = checked_points(mesh, points)
    with progress_callback(progress, "closest point") as callback:
        nearest, distances, faces, weights, normals = _core.closest_point(
            checked._core, flat, device=where, progress=callback
        )
    faces = source_faces(mesh, checked, faces)
    return ClosestPoints(*shaped(shape, nearest, distances, faces, weights, normals))


def query(
    mesh: MeshLike,
    points: ArrayLike,
    *,
    sign: Sign = "auto",
    device: str = "auto",
    progress: Progress = None,
) -> Query:
    """Evaluate signed distances, gradients and closest points in one pass.

    Parameters
    ----------
    mesh : Mesh, PointCloud, Scene or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` or `PointCloud` to several calls: its search tree is built once. The distance of a scene
        is the smallest one over its instances, which are meshes and shapes under rotations, translations, reflections
        and uniform scales. A shape that is not exact counts as its closed mesh.
    points : (..., 3) real
        World positions.
    sign, progress
        As for :func:`bake`.
    device : str, default "auto"
        As for :func:`closest_point`.

    Returns
    -------
    Query
        Signed distances, unit gradients, closest points, faces, barycentric coordinates, and a report that names the
        device. For a scene `instances` has the index of the nearest instance, and `faces` the row in its mesh, -1 for
        an exact shape.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`bake`; ArgumentError also for a point that is not finite.
    SceneError
        For an instance whose transform is not a similarity, or with an object other than a mesh or a shape.

    Warns
    -----
    SurfaceWarning
        Once per call if the surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The gradient at p with closest point c is ``(p - c) / |p - c|``, negated inside. On the surface it is the
    angle-weighted pseudonormal, turned away from the inside. Where several closest points are equally near (on the
    medial axis) the distance has no gradient, and the one of the face with the lowest row is returned.
    With ``sign="unsigned"`` distances are unsigned, and gradients are gradients of the unsigned distance.

    A scene is searched on the CPU, by the winding number. Where instances overlap, the distance is the depth in one of
    them, not the distance from the surface of their union.

    Examples
    --------
    >>> import fieldbake
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = fieldbake.Mesh(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    >>> found = query(tetrahedron, [(0.1, 0.1, -2), (0.25, 0.25, 0.125)])
    >>> found.distances.tolist(), found.gradients.tolist()
    ([2.0, -0.125], [[0.0, 0.0, -1.0], [0.0, 0.0, -1.0]])
    >>> found.report.inside_points
    1
    """
    if not isinstance(mesh, Mesh) and isinstance(mesh, Queryable):
        return mesh._query(points, sign=sign, device=device, progress=progress)
    method, where = choices(sign, device)
    if (cloud := as_cloud(mesh)) is not None:
        flat, shape = checks.points(points)
        distances, gradients, nearest, faces, report = query_cloud(
            cloud, flat, is_signed(cloud, method, where), progress
        )
        warn_surface(report.warnings)
        weights = _first_weights(len(flat))
        distances, gradients, nearest, faces, weights = shaped(shape, distances, gradients, nearest, faces, weights)
        return Query(distances, gradients, nearest, faces, weights, report)
    checked, flat, shape = checked_points(mesh, points)
    with progress_callback(progress, "query") as callback:
        distances, gradients, nearest, faces, weights, facts = _core.query(
            checked._core, flat, sign=method, device=where, progress=callback
        )
    report = Report.of_mesh(checked, facts)
    warn_surface(report.warnings)
    faces = source_faces(mesh, checked, faces)
    distances, gradients, nearest, faces, weights = shaped(shape, distances, gradients, nearest, faces, weights)
    return Query(distances, gradients, nearest, faces, weights, report)


@overload
def signed_distance(
    mesh: MeshLike,
    points: ArrayLike,
    *,
    sign: Sign = "auto",
    dtype: Literal["float32"] = "float32",
    device: str = "auto",
    progress: Progress = None,
) -> NDArray[np.float32]: ...


@overload
def signed_distance(
    mesh: MeshLike,
    points: ArrayLike,
    *,
    sign: Sign = "auto",
    dtype: Literal["float64"],
    device: str = "auto",
    progress: Progress = None,
) -> NDArray[np.float64]: ...


def signed_distance(
    mesh: MeshLike,
    points: ArrayLike,
    *,
    sign: Sign = "auto",
    dtype: DistanceType = "float32",
    device: str = "auto",
    progress: Progress = None,
) -> NDArray[np.float32] | NDArray[np.float64]:
    """Evaluate the signed distance of a mesh at any points.

    Parameters
    ----------
    mesh : Mesh, PointCloud, Scene or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` or `PointCloud` to several calls: its search tree is built once. A scene is evaluated as
        by :func:`query`.
    points : (..., 3) real
        World positions.
    sign, progress
        As for :func:`bake`.
    dtype : "float32" or "float64", default "float32"
        Type of the distances. ``"float64"`` evaluates them from the float64 vertices, with the signs of ``"float32"``.
        A device finds a near face, and the CPU finds the nearest one.
    device : str, default "auto"
        As for :func:`closest_point`.

    Returns
    -------
    (...) float32 or float64
        World units, negative inside.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`bake`; ArgumentError also for a point that is not finite and an unknown `dtype`.

    Warns
    -----
    SurfaceWarning
        Once per call if the surface is open, inside out, or has flipped or one-sided parts.

    Examples
    --------
    >>> import fieldbake
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = fieldbake.Mesh(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    >>> signed_distance(tetrahedron, [(0, 0, -2), (0.25, 0.25, 0.125)]).tolist()
    [2.0, -0.125]
    """
    is_double = checks.choice("dtype", dtype, get_args(DistanceType)) == "float64"
    if not isinstance(mesh, Mesh) and isinstance(mesh, Queryable):
        distances = mesh._query(points, sign=sign, device=device, progress=progress).distances
        return distances if is_double else distances.astype(np.float32)
    method, where = choices(sign, device)
    if (cloud := as_cloud(mesh)) is not None:
        flat, shape = checks.points(points)
        distances, *_, report = query_cloud(cloud, flat, is_signed(cloud, method, where), progress)
        warn_surface(report.warnings)
        return (distances if is_double else distances.astype(np.float32)).reshape(shape)
    checked, flat, shape = checked_points(mesh, points)
    evaluate = _core.signed_distance_float64 if is_double else _core.signed_distance
    with progress_callback(progress, "signed distance") as callback:
        values = evaluate(checked._core, flat, sign=method, device=where, progress=callback)
    warn_of_signs(checked, method)
    found: NDArray[Any] = values.reshape(shape)
    return found


def contains(mesh: MeshLike, points: ArrayLike, *, sign: Sign = "auto", progress: Progress = None) -> NDArray[np.bool_]:
    """Test which points are inside a mesh, without computing distances.

    Parameters
    ----------
    mesh : Mesh, PointCloud, or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` or `PointCloud` to several calls: its search tree is built once.
    points : (..., 3) real
        World positions.
    sign, progress
        As for :func:`bake`. With ``sign="unsigned"`` no point is inside.

    Returns
    -------
    (...) bool
        True where the signed distance is negative. A point that is nearer to the surface than 1e-7 of the size of the
        mesh may be classified either way.

    Raises
    ------
    MeshError, ArgumentError
        As for :func:`bake`; ArgumentError also for a point that is not finite.

    Warns
    -----
    SurfaceWarning
        Once per call if the surface is open, inside out, or has flipped or one-sided parts.

    Examples
    --------
    >>> import fieldbake
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = fieldbake.Mesh(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    >>> contains(tetrahedron, [(0, 0, -2), (0.25, 0.25, 0.125)]).tolist()
    [False, True]
    """
    method = checks.text("sign", sign)
    if (cloud := as_cloud(mesh)) is not None:
        flat, shape = checks.points(points)
        if not is_signed(cloud, method):
            return np.zeros(shape, np.bool_)
        with progress_callback(progress, "contains") as callback:
            inside = cloud._core.contains(flat, progress=callback)
        warn_surface(cloud.report.warnings)
        return inside.reshape(shape)
    checked, flat, shape = checked_points(mesh, points)
    with progress_callback(progress, "contains") as callback:
        inside = _core.contains(checked._core, flat, sign=method, progress=callback)
    warn_of_signs(checked, method)
    return inside.reshape(shape)


def winding_number(
    mesh: MeshLike, points: ArrayLike, *, error: float | None = None, progress: Progress = None
) -> NDArray[np.float64]:
    """Evaluate the signed generalised winding number of the faces as they are wound.

    Parameters
    ----------
    mesh : Mesh, PointCloud, or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` or `PointCloud` to several calls: its search tree is built once.
    points : (..., 3) real
        World positions.
    error : float, optional
        Largest absolute error; the default is 1e-6 for meshes and 1e-3 for clouds of points. For clouds it is a proven
        bound. For meshes it is one below 0.01. From 0.01 on, meshes with many openings are evaluated faster, by
        dipoles. Their error has no bound: it is mostly below 0.01, but 0.1 was measured close to a large smooth sheet.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    (...) float64
        1 inside a closed mesh that faces outwards, -1 inside one that is inside out, 0 outside; fractions near
        openings.

    Raises
    ------
    MeshError, ArgumentError
        As for :func:`bake`; ArgumentError also for a point that is not finite and an `error` that is not positive.

    Notes
    -----
    Faces count as they are wound: flipped and repeated faces are not repaired, unlike for the sign of distances. The
    openings are closed by cones, the winding number of the closed surface is computed exactly, and the solid angle of
    the cones is subtracted. The cost of a point grows with the number of open edges. Solid angles are computed by the
    formula of Van Oosterom and Strackee (1983), and dipoles as by Barill et al. (2018).

    Examples
    --------
    >>> import fieldbake
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> inside_out = fieldbake.Mesh(corners, [(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    >>> winding_number(inside_out, [(0, 0, -2), (0.25, 0.25, 0.125)]).tolist()
    [0.0, -1.0]
    """
    largest = None if error is None else checks.number("error", error, above=0)
    if (cloud := as_cloud(mesh)) is not None:
        require_sides(cloud)
        flat, shape = checks.points(points)
        with progress_callback(progress, "winding number") as callback:
            found = cloud._core.winding_number(flat, error=largest or WINDING_ERROR, progress=callback)
        return found.reshape(shape)
    checked, flat, shape = checked_points(mesh, points)
    with progress_callback(progress, "winding number") as callback:
        found = _core.winding_number(checked._core, flat, error=largest or MESH_WINDING_ERROR, progress=callback)
    return found.reshape(shape)


def _first_weights(count: int) -> NDArray[np.float64]:
    """Barycentric coordinates of the points of a cloud: all weight is on the first."""
    weights = np.zeros((count, 3))
    weights[:, 0] = 1.0
    return weights
