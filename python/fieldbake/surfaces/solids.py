"""Closed meshes from meshes: solids, offsets, shells and Booleans through their distance fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, MeshError
from ..base.grid import Grid, Resolution, check_count, make_grid
from ..base.notices import warn_surface
from ..base.progress import Progress, part, watched
from ..base.report import count_text
from ..meshes.convert import MeshLike, as_mesh, named_mesh
from ..meshes.isosurface import MeshSource, Source, extract
from ..meshes.mesh import Mesh
from ..points.cloud import PointCloud
from ..points.interop import as_cloud
from ..queries.clouds import require_sides
from ..volumes.level_set_blocks import level_set
from .deviation import from_ideal, to_ideal
from .fields import CloudField, Field, Intersection, MeshField, OuterField, Shifted, TangentSource, Wall, complement
from .report import SolidReport
from .simplification import check_tolerance, simplified

Operation = Literal["union", "intersection", "difference"]
Side = Literal["inward", "outward", "both"]
Fill = Literal["winding", "outer"]

#: Cosine of the largest angle between the normal of a face and a direction of `open` for which the face is left out.
OPEN_COSINE = np.cos(np.radians(45.0)) - 1e-9

#: The axes by name, for `open`.
DIRECTIONS = {
    sign + axis: (-1.0 if sign == "-" else 1.0) * np.eye(3)[i]
    for sign in ("", "+", "-")
    for i, axis in enumerate("xyz")
}


def solid(
    mesh: MeshLike,
    resolution: Resolution = 256,
    *,
    fill: Fill = "winding",
    seal: float = 0,
    simplify: float = 0,
    progress: Progress = None,
) -> Mesh:
    """Make a closed two-manifold mesh of any triangles.

    Parameters
    ----------
    mesh : Mesh, PointCloud, or anything that `as_mesh` takes
        Triangles that may be open, doubled, intersecting or wound both ways; or points with normals, with
        ``fill="winding"`` and without `seal`.
    resolution : int or three ints, default 256
        Voxels along the longest side of the box, or along x, y and z. Parts thinner than a voxel may be lost.
    fill : "winding" or "outer", default "winding"
        ``"winding"``: a point is inside if the magnitude of its winding number exceeds 1/2; openings are closed.
        ``"outer"``: a point is inside if no path on the grid leads from outside to it without crossing a triangle, so
        that everything within the outer surface is filled.
    seal : float, default 0
        Diameter, voxels, of the largest hole that ``"outer"`` closes. The grid grows by it, and keeps the size of its
        voxels. With 0, a hole wider than a voxel connects the inside with the outside.
    simplify : float, default 0
        Largest movement of the surface, world units, by which manifold3d may remove faces (extra ``simplify``). The
        distances of the report are measured after it.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    Mesh
        Every edge belongs to two faces, every vertex has one fan of faces, and faces are counter-clockwise seen from
        outside. `report` is a :class:`SolidReport`.

    Warns
    -----
    SurfaceWarning
        If faces of the result pass through each other; `report.self_intersections` is their number.

    Raises
    ------
    ArgumentError
        If the resolution gives more than 2^40 voxels.
    MeshError
        If the mesh cannot be used, encloses nothing at this resolution, or an option is out of range.

    Examples
    --------
    >>> import fieldbake as fb
    >>> knot = fb.solid(fb.models.torus_knot(), 48)
    >>> knot.is_closed, knot.report.genus
    (True, 1)
    """
    if (cloud := as_cloud(mesh)) is not None:
        if fill != "winding" or seal != 0:
            raise ArgumentError(f"{'seal' if seal != 0 else 'fill'}: does not apply to a cloud of points")
        return _solid_of_cloud(cloud, resolution, check_tolerance(simplify), progress)
    source = as_mesh(mesh)
    _word("fill", fill, ("winding", "outer"))
    diameter = _number("seal", seal, least=0)
    tolerance = check_tolerance(simplify)
    field: MeshField | OuterField
    if diameter > 0 and fill == "winding":
        raise MeshError('seal: closes holes with fill="outer" only')
    # The flood needs free voxels between the mesh and the box, in which the seal fits.
    grid = _grid(source.bounds, resolution, border=2.0 if fill == "outer" else 1.0)
    grid = check_count(_enlarged(grid, math.ceil(diameter / 2)))
    nothing = "it encloses no voxel centre. Raise the resolution, or give sheets a thickness by shell(..., side='both')"
    if fill == "outer":
        nothing += f". If it has openings, close them by a larger seal=, got {seal} voxels, or use fill='winding'"
    with watched(progress, "solid"):
        if fill == "outer":
            radius = diameter / 2 * max(grid.spacing)
            with part(0.0, 0.2):
                sides = _core.OuterSides(source._core, grid.lower, grid.upper, grid.shape, radius)
            field = OuterField(source, sides)
        else:
            field = MeshField(source)
        with part(0.2, 0.6):
            surface = level_set(field.values, grid, 0.0, samples=field.samples)
        return _extracted(
            surface,
            MeshSource(source),
            grid,
            f"mesh: {nothing}",
            lambda made: made._core.deviation(source._core)[0],
            lambda made: source._core.deviation(made._core)[0],
            tolerance=tolerance,
        )


def _solid_of_cloud(cloud: PointCloud, resolution: Resolution, tolerance: float, progress: Progress) -> Mesh:
    """The solid that the points of a cloud enclose. Crossings are interpolated between signed distances.

    Closed surfaces below the volume of a voxel are dropped.
    """
    require_sides(cloud)
    grid, field = _grid(cloud.bounds, resolution), CloudField(cloud)
    nothing = "mesh: the cloud encloses no voxel centre. Raise the resolution, or check its normals"
    warn_surface(cloud.report.warnings)
    with watched(progress, "solid"):
        with part(0.0, 0.6):
            surface = level_set(field.values, grid, 0.0, samples=field.samples)
        return _extracted(
            surface,
            None,
            grid,
            nothing,
            lambda made: to_ideal(made, field, grid),
            lambda made: float(_core.closest_point(made._core, np.array(cloud.points))[1].max()),
            tolerance=tolerance,
        )


def offset(
    mesh: MeshLike,
    distance: float,
    resolution: Resolution = 256,
    *,
    simplify: float = 0,
    progress: Progress = None,
) -> Mesh:
    """Make the surface at a distance from a mesh.

    Parameters
    ----------
    mesh : Mesh or anything that `as_mesh` takes
        The source. Its inside is the same as in :func:`fieldbake.signed_distance`.
    distance : float
        Distance of the new surface from the mesh, world units. A positive distance grows the solid and rounds its
        convex edges; a negative one shrinks it.
    resolution : int or three ints, default 256
        Voxels along the longest side of the box of the result, or along x, y and z.
    simplify : float, default 0
        As for :func:`solid`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    Mesh
        As for :func:`solid`. The source of the report is the level set of the signed distance at `distance`.

    Raises
    ------
    MeshError
        If nothing is left, or `distance` is not a finite number.

    Examples
    --------
    >>> import fieldbake as fb
    >>> grown = fb.offset(fb.box(2).to_mesh(32), 0.5, 32)
    >>> grown.bounds.round(2).tolist()
    [[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]
    """
    source = as_mesh(mesh)
    distance = _number("distance", distance)
    tolerance = check_tolerance(simplify)
    bounds = source.bounds + max(distance, 0.0) * np.array([[-1.0], [1.0]])
    grid = _grid(bounds, resolution)
    field = Shifted(MeshField(source), distance)
    with watched(progress, "offset"):
        with part(0.0, 0.6):
            surface = level_set(field.field.values, grid, distance, samples=field.field.samples)
        return _extracted(
            surface,
            MeshSource(source),
            grid,
            f"distance: nothing of the mesh is left at {distance:g}, because its thickest part is thinner",
            lambda made: to_ideal(made, field, grid),
            lambda made: from_ideal(made, field, grid),
            level=distance,
            tolerance=tolerance,
        )


def shell(
    mesh: MeshLike,
    thickness: float,
    resolution: Resolution = 256,
    side: Side = "inward",
    open: ArrayLike | str | Sequence[str] = (),
    *,
    simplify: float = 0,
    progress: Progress = None,
) -> Mesh:
    """Hollow a mesh: make a wall of constant thickness along its surface.

    Parameters
    ----------
    mesh : Mesh or anything that `as_mesh` takes
        The source. Sheets without an inside need ``side="both"``.
    thickness : float
        Thickness of the wall, world units.
    resolution : int or three ints, default 256
        Voxels along the longest side of the box of the result, or along x, y and z.
    side : "inward", "outward" or "both", default "inward"
        Position of the wall: inside the surface, outside it, or half on each side.
    open : directions, default none
        Directions in which the wall is left open: ``"x"``, ``"-z"``, a vector (3,), or a sequence of those. Faces whose
        normal is within 45 degrees of a direction get no wall.
    simplify : float, default 0
        As for :func:`solid`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    Mesh
        As for :func:`solid`. The source of the report is the ideal surface of the wall.

    Warns
    -----
    SurfaceWarning
        As for :func:`solid`, and if the wall is thinner than a voxel.

    Raises
    ------
    MeshError
        If nothing is left, the thickness is not positive, or a word or a direction is unknown.

    Examples
    --------
    >>> import fieldbake as fb
    >>> cup = fb.shell(fb.box(2).to_mesh(32), 0.2, 40, open="z")
    >>> round(cup.volume, 1)
    3.4
    """
    source = as_mesh(mesh)
    thickness = _number("thickness", thickness)
    if thickness <= 0:
        raise MeshError(f"thickness: must be above 0, got {thickness:g}")
    _word("side", side, ("inward", "outward", "both"))
    tolerance = check_tolerance(simplify)
    kept = _without_open_faces(source, open)
    reach = {"inward": 0.0, "outward": thickness, "both": thickness / 2}[side]
    grid = _grid(source.bounds + reach * np.array([[-1.0], [1.0]]), resolution)
    field: Field
    if side == "both":
        field = Shifted(MeshField(kept, unsigned=True), thickness / 2)
    elif kept is source:
        lower, upper = (-thickness, 0.0) if side == "inward" else (0.0, thickness)
        field = Wall(MeshField(source), lower, upper)
    else:
        near = Shifted(MeshField(kept, unsigned=True), thickness)
        within = MeshField(source) if side == "inward" else complement(MeshField(source))
        field = Intersection(within, near)
    with watched(progress, "shell"):
        with part(0.0, 0.6):
            surface = level_set(field.values, grid, 0.0, samples=field.samples)
        return _extracted(
            surface,
            TangentSource(field),
            grid,
            f"thickness: no wall of {thickness:g} is left; it must be about a voxel ({max(grid.spacing):.3g}) or more",
            lambda made: to_ideal(made, field, grid),
            lambda made: from_ideal(made, field, grid),
            tolerance=tolerance,
            wall=thickness,
        )


def boolean(
    op: Operation,
    a: MeshLike,
    b: MeshLike,
    *,
    resolution: Resolution = 256,
    smooth: float = 0,
    simplify: float = 0,
    progress: Progress = None,
) -> Mesh:
    """Combine two solids.

    Parameters
    ----------
    op : "union", "intersection" or "difference"
        The operation; the difference is `a` without `b`.
    a, b : Mesh or anything that `as_mesh` takes
        The operands. They may be open, and may intersect themselves and each other.
    resolution : int or three ints, default 256
        Voxels along the longest side of the box of the result, or along x, y and z.
    smooth : float, default 0
        Width of a fillet along the intersection of the surfaces, world units. The surface changes only where the two
        distances differ by less than this width, by up to a quarter of it: faces of both in one plane bulge by that.
    simplify : float, default 0
        As for :func:`solid`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    Mesh
        As for :func:`solid`. The source of the report is the surface of the exact combination.

    Raises
    ------
    MeshError
        If nothing is left, the operation is unknown, or `smooth` is negative or not a number.

    Examples
    --------
    >>> import fieldbake as fb
    >>> ball, cube = fb.sphere(1.2).to_mesh(32), fb.box(2).to_mesh(32)
    >>> round(fb.boolean("intersection", cube, ball, resolution=48).volume, 1)
    6.4
    """
    _word("op", op, ("union", "intersection", "difference"))
    first, second = named_mesh("a", a), named_mesh("b", b)
    smooth = _number("smooth", smooth, least=0)
    tolerance = check_tolerance(simplify)
    # A fillet of the union reaches a quarter of its width outside the operands.
    grown = smooth / 4 * np.array([[-1.0], [1.0]])
    boxes = np.array([first.bounds, second.bounds])
    if op == "union":
        bounds = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]) + grown
    elif op == "intersection":
        bounds = np.array([boxes[:, 0].max(axis=0), boxes[:, 1].min(axis=0)])
    else:
        bounds = first.bounds
    nothing = f"op: the {op} is empty at this resolution"
    if not (bounds[0] < bounds[1]).all():
        raise MeshError(nothing)
    grid = _grid(bounds, resolution)
    one, two = MeshField(first), MeshField(second)
    field: Field
    if op == "union":
        field = complement(Intersection(complement(one), complement(two), smooth))
    else:
        field = Intersection(one, two if op == "intersection" else complement(two), smooth)
    with watched(progress, "boolean"):
        with part(0.0, 0.6):
            surface = level_set(field.values, grid, 0.0, samples=field.samples)
        return _extracted(
            surface,
            TangentSource(field),
            grid,
            nothing,
            lambda made: to_ideal(made, field, grid),
            lambda made: from_ideal(made, field, grid),
            tolerance=tolerance,
        )


def _extracted(
    surface: _core.Surface,
    source: Source | None,
    grid: Grid,
    nothing: str,
    to_source: Callable[[Mesh], float],
    from_source: Callable[[Mesh], float],
    *,
    tolerance: float,
    level: float = 0.0,
    wall: float = math.inf,
) -> Mesh:
    """Extract the mesh of a surface, simplify it, and attach its report; of an empty one raise `nothing`.

    A warning names a wall thinner than a voxel, and faces that cross each other.
    """
    with part(0.6, 0.9):
        # Without a source the planes would come from the samples, which points and noise make uneven.
        made = extract(surface, level, source, sharp=source is not None, capped=True)
    clamped = made.report.clamped_vertices if made.report else 0
    if not len(made.faces):
        raise MeshError(nothing)
    if source is None:
        made = _without_specks(made, float(np.prod(grid.spacing)))
    if tolerance > 0:
        made = simplified(made, tolerance)
    made._report = report = SolidReport(clamped, max(grid.spacing), made, to_source, from_source)
    warnings = []
    if wall < report.voxel_size:
        warnings.append(
            f"the wall of {wall:g} is thinner than a voxel ({report.voxel_size:.3g}), so it may have holes; raise the "
            "resolution"
        )
    with part(0.9, 1.0):
        if report.self_intersections:
            warnings.append(
                f"the result has {count_text(report.self_intersections, 'self-intersection')}, pairs of faces that "
                "pass through each other; raise the resolution"
            )
    warn_surface(warnings)
    return made


def _without_specks(mesh: Mesh, least: float) -> Mesh:
    """Return the mesh without closed surfaces of a volume below `least`, which wrong signs beside noisy points make.

    If it has no others, it is returned as it is.
    """
    faces = mesh.faces.astype(np.int64)
    # Each vertex takes the smallest row of its component: of its faces, then of the vertex with that row.
    rows, last = np.arange(len(mesh.vertices)), None
    while last is None or not np.array_equal(rows, last):
        last = rows.copy()
        np.minimum.at(rows, faces.ravel(), np.repeat(rows[faces].min(axis=1), 3))
        rows = rows[rows]
    a, b, c = np.moveaxis(mesh.vertices[faces] - mesh.bounds.mean(axis=0), 1, 0)
    volumes = np.bincount(rows[faces[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, len(rows))
    kept = np.abs(volumes)[rows[faces[:, 0]]] >= least
    if kept.all() or not kept.any():
        return mesh
    used, indices = np.unique(faces[kept], return_inverse=True)
    return Mesh(mesh.vertices[used], indices.reshape(-1, 3))


def _without_open_faces(mesh: Mesh, directions: ArrayLike | str | Sequence[str]) -> Mesh:
    """Return the mesh without the faces that point in one of the directions; without directions, the mesh itself."""
    vectors = [_direction(item) for item in _directions(directions)]
    if not vectors:
        return mesh
    kept = (mesh.face_normals @ np.array(vectors).T <= OPEN_COSINE).all(axis=1)
    if not kept.any():
        raise MeshError("open: every face of the mesh points in one of the directions")
    return Mesh(mesh.vertices, mesh.faces[kept].astype(np.int64))


def _directions(value: Any) -> Sequence[Any]:
    """The directions as a sequence. A single direction becomes a sequence of one."""
    if isinstance(value, str) or (not isinstance(value, (list, tuple)) and np.ndim(value) == 1):
        return [value]
    try:
        items = list(value)
    except TypeError:
        raise MeshError(f'open: must be directions such as "z" or a vector, got {checks.describe(value)}') from None
    is_vector = len(items) == 3 and all(np.ndim(item) == 0 and not isinstance(item, str) for item in items)
    return [items] if is_vector else items


def _direction(value: Any) -> NDArray[np.float64]:
    if isinstance(value, str):
        if value not in DIRECTIONS:
            raise MeshError(f'open: must hold directions such as "z", "-x" or a vector, got {checks.describe(value)}')
        named: NDArray[np.float64] = DIRECTIONS[value]
        return named
    vector = checks.vector("open", value, 3, MeshError)
    length = float(np.linalg.norm(vector))
    if not length > 0:
        raise MeshError("open: a direction must not be zero")
    unit: NDArray[np.float64] = vector / length
    return unit


def _grid(bounds: NDArray[np.float64], resolution: Resolution, border: float = 1.0) -> Grid:
    """The grid around a surface in a box, with `border` free voxels on each side."""
    return check_count(make_grid(bounds, resolution, margin=0.0, border=border))


def _enlarged(grid: Grid, count: int) -> Grid:
    """The grid with `count` more voxels of the same size on each side."""
    extra = count * np.array(grid.spacing)
    lower, upper = (np.array(grid.lower) - extra).tolist(), (np.array(grid.upper) + extra).tolist()
    x, y, z = (side + 2 * count for side in grid.shape)
    return Grid(tuple(lower), tuple(upper), (x, y, z)) if count else grid


def _number(name: str, value: object, *, least: float | None = None) -> float:
    try:
        return checks.number(name, value, least=least)
    except ArgumentError as error:
        raise MeshError(str(error)) from None


def _word(name: str, value: object, words: Sequence[str]) -> None:
    checks.choice(name, value, words, MeshError)
