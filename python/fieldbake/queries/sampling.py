"""Samples of surfaces, training samples of distance fields, and local thickness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh
from .common import Sign, checked_points, source_faces
from .nearest import query, winding_number

#: Largest number of samples of one call. The core counts them in 32 bits.
MOST_SAMPLES = 2**32 - 1

#: Factor by which the box of the mesh is scaled about its centre for uniform training samples.
UNIFORM_BOX = 1.1

#: Largest number of points at which :func:`count_uncertain` evaluates the winding number. The standard error of a share
#: of 1 % is a tenth of it.
MOST_TESTED = 1 << 14
#: Largest error of these winding numbers. A smaller one takes a hundred times as long where a surface has many holes.
TESTED_ERROR = 0.01

#: A sign is uncertain if the winding number is closer to the middle between two whole numbers than this, as in a bake.
UNDECIDED = 0.05

#: Type of the numbers of training samples.
SampleType = Literal["float64", "float32"]


class SurfaceSamples(NamedTuple):
    """Points on a surface, uniform by area.

    Examples
    --------
    >>> import fieldbake as fb
    >>> samples = fb.sample_surface(fb.models.gear(), 100)
    >>> samples.points.shape, samples.normals.shape, samples.faces.shape
    ((100, 3), (100, 3), (100,))
    """

    #: Positions, (n, 3) float64, world units.
    points: NDArray[np.float64]
    #: Unit normals of the faces by their own winding, (n, 3) float64.
    normals: NDArray[np.float64]
    #: Faces, (n,) int64; rows as in `ClosestPoints`.
    faces: NDArray[np.int64]
    #: Weights of the face's corners, (n, 3) float64.
    barycentric: NDArray[np.float64]


class TrainingSamples(NamedTuple):
    """Points around a surface with their signed distances, float64 or the `dtype` of :func:`sample_training`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> samples = fb.sample_training(fb.models.gear(), 100)
    >>> samples.points.shape, samples.distances.shape, samples.gradients.shape
    ((100, 3), (100,), (100, 3))
    """

    #: Positions, (n, 3), world units: near points first, then uniform ones.
    points: NDArray[Any]
    #: Signed distances at these points, (n,), world units, negative inside.
    distances: NDArray[Any]
    #: Unit gradients of the signed distance, (n, 3).
    gradients: NDArray[Any]


def sample_surface(mesh: MeshLike, n: int, *, seed: int = 0, progress: Progress = None) -> SurfaceSamples:
    """Draw points on a surface, uniform by area.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` to several calls.
    n : int
        Number of points.
    seed : int, default 0
        From 0 to 2^64 - 1. The same seed gives the same points on every platform and any number of threads; a longer
        sample starts with the points of a shorter one.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    SurfaceSamples
        Points, face normals, faces and barycentric coordinates.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ArgumentError
        If `n` or `seed` is negative, too large or not a whole number.

    Examples
    --------
    >>> import fieldbake
    >>> knot = fieldbake.models.torus_knot(segments=64, sides=8)
    >>> samples = sample_surface(knot, 1000)
    >>> samples.points.shape, float(fieldbake.closest_point(knot, samples.points).distances.max()) < 1e-12
    ((1000, 3), True)
    """
    count = checks.integer("n", n, least=0, most=MOST_SAMPLES)
    start = checks.integer("seed", seed, least=0, most=2**64 - 1)
    checked = as_mesh(mesh)
    with progress_callback(progress, "sample surface") as callback:
        points, normals, faces, weights = _core.sample_surface(checked._core, count, seed=start, progress=callback)
    return SurfaceSamples(points, normals, source_faces(mesh, checked, faces), weights)


def sample_training(
    mesh: MeshLike,
    n: int,
    *,
    near: Sequence[float] = (0.005, 0.05),
    uniform: float = 0.1,
    seed: int = 0,
    sign: Sign = "auto",
    device: str = "auto",
    progress: Progress = None,
    dtype: SampleType = "float64",
) -> TrainingSamples:
    """Draw points near a surface and around it, with their signed distances and gradients.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` to several calls.
    n : int
        Number of points, exactly.
    near : sequence of float, default (0.005, 0.05)
        Standard deviations of Gaussian offsets from points of the surface, as fractions of the diagonal of the mesh's
        box. Each applies to an equal part of the near points.
    uniform : float, default 0.1
        Fraction of the points that are uniform in the mesh's box, scaled by 1.1 about its centre. The other points are
        near the surface.
    seed : int, default 0
        From 0 to 2^64 - 1. The same seed gives the same points on any number of threads.
    sign, progress
        As for :func:`bake`.
    device : str, default "auto"
        As for :func:`closest_point`.
    dtype : "float64" or "float32", default "float64"
        Type of the points, distances and gradients. With ``"float32"`` the points are rounded first and the distances
        belong to the rounded points. Far from the origin the rounding moves points by more than they are from the
        surface; :func:`normalize` the mesh there.

    Returns
    -------
    TrainingSamples
        Points, signed distances and unit gradients: the near points in the order of `near`, then the uniform ones.

    Raises
    ------
    MeshError, ArgumentError, DeviceError
        As for :func:`query`; ArgumentError also for a fraction outside 0 to 1, a deviation that is not positive and
        another `dtype`.

    Warns
    -----
    SurfaceWarning
        Once per call if the surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The table has the settings of published work. Their deviations are those for a normalised mesh (see
    :func:`normalize`), divided by the diagonal of its box.

    ===========================  ================================================  =========
    recipe                       near                                              uniform
    ===========================  ================================================  =========
    DeepSDF, paper (Park et al.  variances 0.0025 and 0.00025 in the unit          ``0.05``
    2019)                        sphere: ``(0.05 / diagonal, 0.0158 / diagonal)``
    DeepSDF, code                variances 0.005 and 0.0005 in a sphere of radius  ``0.06``
                                 1 / 1.03: ``(0.0707 / diagonal, 0.0224 /
                                 diagonal)``
    Hunyuan3D 2.1, random part   deviations 0.005 and 0.05 in its normalised       ``0.5``
                                 box: ``(0.005 / diagonal, 0.05 / diagonal)``
    ===========================  ================================================  =========

    Hunyuan3D also samples near sharp edges, which this function does not. :func:`fieldbake.training.sample` follows the
    code of these projects and others in all details; :func:`sample_edges` draws points on sharp edges.

    Examples
    --------
    >>> import fieldbake
    >>> samples = sample_training(fieldbake.models.torus_knot(segments=64, sides=8), 1000)
    >>> samples.points.shape, samples.distances.shape, samples.gradients.shape
    ((1000, 3), (1000,), (1000, 3))
    """
    samples, _ = draw_training(
        mesh, n, near=near, uniform=uniform, seed=seed, sign=sign, device=device, progress=progress, dtype=dtype
    )
    return samples


def draw_training(
    mesh: MeshLike,
    n: int,
    *,
    near: Sequence[float] = (0.005, 0.05),
    uniform: float = 0.1,
    seed: int = 0,
    sign: Sign = "auto",
    device: str = "auto",
    progress: Progress = None,
    dtype: SampleType = "float64",
) -> tuple[TrainingSamples, Report]:
    """Draw the samples of :func:`sample_training`, with the report of their query."""
    count = checks.integer("n", n, least=0, most=MOST_SAMPLES)
    start = checks.integer("seed", seed, least=0, most=2**64 - 1)
    share = checks.number("uniform", uniform, least=0)
    if share > 1:
        raise ArgumentError(f"uniform: must be a fraction from 0 to 1, got {uniform}")
    deviations = _deviations(near)
    if not deviations and share < 1:
        raise ArgumentError("near: must hold a standard deviation unless uniform is 1")
    kind = np.dtype(checks.choice("dtype", dtype, ("float64", "float32")))
    checked = as_mesh(mesh)

    spread = round(count * share)
    shells = len(deviations)
    lower, upper = checked.bounds
    diagonal = float(np.linalg.norm(upper - lower))
    surface = sample_surface(checked, count - spread, seed=start).points
    # The offsets have a generator of their own, since the surface samples use the seed too.
    random = np.random.default_rng([start, 1])
    # If the near points cannot be divided equally, the first deviations get one point more.
    sizes = [(count - spread) // shells + (shell < (count - spread) % shells) for shell in range(shells)]
    deviation = np.repeat(np.array(deviations, np.float64) * diagonal, sizes)
    near_points = surface + deviation[:, None] * random.standard_normal((count - spread, 3))
    half = np.maximum(upper - lower, 1e-3 * diagonal) * (UNIFORM_BOX / 2)
    uniform_points = (lower + upper) / 2 + half * random.uniform(-1, 1, size=(spread, 3))
    # The distances belong to the points that are returned, so the points are rounded first.
    points = np.concatenate([near_points, uniform_points]).astype(kind, copy=False)
    found = query(checked, points, sign=sign, device=device, progress=progress)
    samples = TrainingSamples(
        points, found.distances.astype(kind, copy=False), found.gradients.astype(kind, copy=False)
    )
    return samples, found.report


def count_uncertain(mesh: Mesh, points: NDArray[Any], report: Report) -> int:
    """Count the points (n, 3) whose sign is uncertain, or estimate their number from equally spaced rows.

    The winding number of the faces as they are wound decides: it is whole inside and outside a closed surface. Methods
    other than the winding number have no such measure; the count is 0 then.
    """
    if report.closed or report.sign_method != "winding" or not len(points):
        return 0
    tested = points[:: -(-len(points) // MOST_TESTED)]
    winding = winding_number(mesh, tested, error=TESTED_ERROR)
    count = int((np.abs(winding - np.round(winding)) > 0.5 - UNDECIDED).sum())
    return round(count * len(points) / len(tested))


def thickness(
    mesh: MeshLike, points: ArrayLike, normals: ArrayLike | None = None, *, progress: Progress = None
) -> NDArray[np.float64]:
    """Measure the local thickness of a solid: the diameter of the largest inscribed ball that touches each point.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Pass the same `Mesh` to several calls.
    points : (..., 3) real
        Points of the surface, world positions. A point off the surface is replaced by its closest point.
    normals : (..., 3) real, optional
        Normals of the surface at the points, which point away from the inside, of any length except zero. The default
        is the angle-weighted pseudonormals at the closest points.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    (...) float64
        Diameters, world units; infinite where nothing bounds the ball, which happens on open surfaces only.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ArgumentError
        For points or normals of a wrong shape or that are not finite, and for normals of length zero.

    Notes
    -----
    The balls are found by the shrinking ball method (Ma, Bae and Choi 2012) with exact closest points. Walls beside the
    point bound the ball as well as the wall opposite to it: near the edge of a cube the thickness goes to zero. Surface
    that is seen from the point at less than 15 degrees above the tangent plane belongs to the same side and does not
    bound the ball, so that the facets of a smooth body do not count as walls.

    References
    ----------
    Ma, Bae, Choi, *3D medial axis point approximation using nearest neighbors and the normal field*, The Visual
    Computer 28, 2012.

    Examples
    --------
    >>> import fieldbake
    >>> slab = fieldbake.box((4, 4, 0.5))
    >>> mesh = fieldbake.bake(slab, resolution=(8, 8, 8)).to_mesh()
    >>> thickness(mesh, [(0, 0, 0.25)]).round(6).tolist()
    [0.5]
    """
    checked, flat, shape = checked_points(mesh, points)
    vectors = None
    if normals is not None:
        vectors, vector_shape = checks.points(normals, "normals")
        if vector_shape != shape:
            raise ArgumentError(
                f"normals: must have the shape of points, {(*shape, 3)}, got an array of shape {(*vector_shape, 3)}"
            )
    with progress_callback(progress, "thickness") as callback:
        found = _core.thickness(checked._core, flat, vectors, progress=callback)
    return found.reshape(shape)


def _deviations(near: Sequence[float]) -> list[float]:
    """Check the standard deviations: one number above 0, or a sequence of them."""
    values = [near] if np.ndim(near) == 0 else list(near)
    return [checks.number("near", value, above=0) for value in values]
