"""`clearance`: the distance of two solids, or a bound of their depth in each other."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import MIXED_SIGN_REASON, Report
from ..meshes.mesh import Mesh
from ..shapes.field import MESH_RESOLUTION
from ..shapes.shape import Shape
from .geometry import BodyLike, core_element, elements_of, rigid
from .results import Clearance

Elements = Sequence[tuple[Mesh | Shape, NDArray[np.float64]]]


def clearance(
    a: BodyLike,
    b: BodyLike,
    *,
    pose_a: ArrayLike | None = None,
    pose_b: ArrayLike | None = None,
    cutoff: float = np.inf,
    relative_tolerance: float = 1e-3,
) -> Clearance:
    """Compute the distance of two solids, or a bound of their depth in each other where they overlap.

    Parameters
    ----------
    a, b : geometry
        A `Mesh`, a `Shape`, anything that :func:`fieldbake.bake` takes, or a list of (geometry, (4, 4) rigid
        transform).
    pose_a, pose_b : (4, 4), optional
        Rigid world-from-solid poses. The default is the identity.
    cutoff : float, default inf
        Beyond this distance the result is a proven lower bound of at least the cutoff, with NaN for its points. Where
        `errors` reaches below the cutoff, nothing is proven, and the result is the same as without it.
    relative_tolerance : float, default 1e-3
        Largest error of a depth, as a share of the depth.

    Returns
    -------
    Clearance
        Arrays of shape (1,); `pairs` is -1.

    Raises
    ------
    ArgumentError
        For a pose that is not rigid, two unbounded solids, or an option out of range.
    MeshError, ShapeError
        If a geometry cannot be used.

    Warns
    -----
    SurfaceWarning
        If a surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The clearance is ``2 min over x of max(d_a(x), d_b(x))`` with the signed distances of both solids. For separate
    solids it is their distance. For overlapping solids its negative is the diameter of the largest ball in the
    overlap. To separate them, one must move at least that far, so it is a lower bound of the translational penetration
    depth, and equal to it for two balls, a ball and a half-space, and flat faces in contact. It is a depth of overlap
    and not a way out: where one solid contains the other, it is the diameter of the largest ball in the inner one.

    Meshes, boxes, balls and capsules that are separate are compared exactly in float64, by trees of triangles.
    Other exact shapes begin with alternating projections. Planes of support prove the result between convex ones, and
    tangents that for a mesh and a convex one, in most cases to 1e-9 of the size. Overlaps, and pairs without such a
    proof, are searched by branch and bound in a limited number of cells. `errors` is the proven gap in every case.

    A shape that is not `exact` becomes its closed mesh of 128 voxels along the longest side. The distance of the meshes
    is the start of projections onto the surfaces of the shapes themselves, whose end is the result. `errors` then
    contains the deviation of the meshes, which is measured at vertices and centres of faces. A volume is its mesh.

    Examples
    --------
    >>> import fieldbake as fb
    >>> found = fb.clearance(fb.sphere(1), fb.box((2, 2, 2)).translate((3, 0, 0)))
    >>> found.distances.tolist(), found.points_b.tolist()
    ([1.0], [[2.0, 0.0, 0.0]])
    """
    places = [
        np.eye(4) if pose is None else rigid(name, pose) for name, pose in (("pose_a", pose_a), ("pose_b", pose_b))
    ]
    bodies = [elements_of(name, geometry, MESH_RESOLUTION)[0] for name, geometry in (("a", a), ("b", b))]
    for name, elements in zip("ab", bodies, strict=True):
        if not elements:
            raise ArgumentError(f"{name}: has no geometry")
    try:
        found = of_pairs(bodies, np.array(places), [(0, 1)], cutoff, relative_tolerance, None)
    except ArgumentError as error:
        if not str(error).startswith("pairs: "):
            raise
        # The only pair is wrong if both bodies are unbounded.
        raise ArgumentError(
            "a, b: both solids are unbounded, so they have no clearance; intersect one of them with a box"
        ) from None
    return found._replace(pairs=np.full((1, 2), -1, dtype=np.int64))


def of_pairs(
    bodies: Sequence[Elements],
    poses: NDArray[np.float64],
    pairs: Sequence[tuple[int, int]],
    cutoff: float,
    relative_tolerance: float,
    progress: Progress,
) -> Clearance:
    """Compute the clearance of pairs of bodies with poses (n, 4, 4) or (b, n, 4, 4)."""
    limit = checks.limit("cutoff", cutoff)
    if not limit > 0:
        raise ArgumentError(f"cutoff: must be above 0, got {limit:g}")
    tolerance = checks.number("relative_tolerance", relative_tolerance, above=0)
    start = time.perf_counter()
    elements = [core_element(i, *element, with_source=True) for i, own in enumerate(bodies) for element in own]
    core = _core.Bodies(len(bodies), elements)
    with progress_callback(progress, "clearance") as callback:
        distances, errors, first, second, normals = core.clearance(
            np.ascontiguousarray(poses.reshape(-1, 4, 4)),
            list(pairs),
            cutoff=limit,
            relative_tolerance=tolerance,
            progress=callback,
        )
    used = {i for pair in pairs for i in pair}
    meshes = {id(s): s for i, own in enumerate(bodies) if i in used for s, _ in own if isinstance(s, Mesh)}
    warnings = tuple(dict.fromkeys(text for mesh in meshes.values() for text in mesh._core.sign_warnings("auto")))
    warn_surface(warnings)
    shape = (*poses.shape[:-3], len(pairs))
    report = Report(
        sign_method="winding",
        sign_reason=MIXED_SIGN_REASON,
        points=len(distances),
        inside_points=int((distances < 0).sum()),
        device="cpu",
        seconds={"clearance": time.perf_counter() - start},
        peak_bytes=distances.nbytes * 11,
        warnings=warnings,
    )
    return Clearance(
        distances.reshape(shape), first.reshape(*shape, 3), second.reshape(*shape, 3), normals.reshape(*shape, 3),
        errors.reshape(shape), np.array(pairs, dtype=np.int64).reshape(-1, 2), report,
    )  # fmt: skip


def with_environment(
    bodies: list[Elements], poses: NDArray[np.float64], pairs: list[tuple[int, int]], environment: Any, resolution: int
) -> NDArray[np.float64]:
    """Add the geometry of the world as a last body with a pair for each body with geometry; return the poses."""
    elements, _ = elements_of("environment", environment, resolution)
    if not elements:
        raise ArgumentError("environment: has no geometry")
    pairs.extend((i, len(bodies)) for i, own in enumerate(bodies) if own)
    bodies.append(elements)
    here = np.broadcast_to(np.eye(4), (*poses.shape[:-3], 1, 4, 4))
    return np.concatenate([poses, here], axis=-3)
