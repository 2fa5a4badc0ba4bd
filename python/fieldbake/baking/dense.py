"""Baking of a mesh or a shape: distances on a grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, ShapeError
from ..base.grid import DEFAULT_RESOLUTION, Grid, Resolution, check_count, make_grid
from ..base.log import logger
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.isosurface import MeshSource, ShapeSource
from ..meshes.mesh import Mesh
from ..points.cloud import PointCloud
from ..points.interop import as_cloud
from ..queries.clouds import is_signed, report_of
from ..queries.common import Sign, choices
from ..shapes.shape import Shape, all_shapes, combine
from ..volumes.volume import Recipe, Volume

#: Largest distance of a sample from the centre of the mesh, in mesh sizes. The core squares it in float32.
MAX_GRID_REACH = 1e15


def bake(
    mesh: MeshLike | Shape | Sequence[Shape],
    resolution: Resolution = DEFAULT_RESOLUTION,
    *,
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    margin: float = 0.1,
    sign: Sign = "auto",
    band: float | None = None,
    two_sided: bool = False,
    thickness: float | None = None,
    device: str = "auto",
    progress: Progress = None,
) -> Volume:
    """Bake the signed distance field of a mesh or a shape.

    Parameters
    ----------
    mesh : Mesh, path, trimesh.Trimesh, trimesh.Scene, (vertices, faces), PointCloud, Shape, or a list
        A list of meshes is baked as one mesh; its items may be ``(mesh, transform)`` pairs. A list of shapes is baked
        as their union. A cloud needs normals, and takes neither `band`, `two_sided` nor a graphics device. Pass the
        same `Mesh` to several calls to build its search tree only once.
    resolution : int or three ints, default 64
        One number: voxels along the longest side of the padded box. The voxels are cubic, and the other sides have
        whole voxels. Three numbers: voxels along x, y and z, which may be oblong.
    voxel_size : float, optional
        Side of a cubic voxel, world units. It replaces `resolution`, so only one of the two may be given.
    bounds : (2, 3) array, optional
        Box to sample, world units. The default is the box of the mesh and its margin. With a single number as
        `resolution`, the box is enlarged about its centre to whole voxels. It may cut the mesh or lie beside it. The
        volume of a box that cuts the mesh is about the part in the box: outside it :meth:`Volume.sample` is positive.
    margin : float, default 0.1
        The box of the mesh is scaled by ``1 + margin`` about its centre. At least one voxel remains on each side.
    sign : str, default "auto"
        ``"auto"`` chooses a method and states the reason in the report. ``"winding"``: generalised winding number, for
        open and dirty meshes. ``"parity"``: ray crossings. ``"pseudonormal"``: angle-weighted normals. ``"normal"``:
        normal of the nearest face. ``"unsigned"``: no sign.
    band : float, optional
        Half width, in voxels, of the band around the surface in which distances are exact. Outside the band the sign is
        correct and the magnitude is a lower bound. A narrow band takes less time. The default is all distances.
    two_sided : bool, default False
        Treat the surface as a sheet with a thickness: the distance is the unsigned distance minus half the thickness.
    thickness : float, optional
        Thickness of the sheet, world units. The default is the diagonal of a voxel (1.73 voxels for cubic ones), which
        represents every sheet at any angle and offset. The report warns if a sheet is thinner than a voxel. Requires
        `two_sided`.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`.
    progress : bool or callable, optional
        True draws a bar on stderr. A callable receives the finished fraction from 0 to 1 about ten times a second.

    Returns
    -------
    Volume
        Distances (nx, ny, nz), float32, world units, negative inside, with a report on the surface and the bake.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ShapeError
        If a shape is unbounded and `bounds` is not given. The message names the leaf.
    ArgumentError
        If an option is out of range, or does not apply to shapes (`sign`, `band`, `two_sided`, `thickness`).
    CapacityError
        If the result would not fit in memory. The check runs before any work.
    DeviceError
        If the device does not exist.
    KeyboardInterrupt
        Within half a second of Ctrl-C.

    Notes
    -----
    Every sample is exact to 1e-6 of the diagonal of the box. The same input gives the same bytes on any number of
    threads. Warnings of the report are issued once per call as a `SurfaceWarning` and logged to the ``fieldbake``
    logger.

    Examples
    --------
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = (corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    >>> volume = bake(tetrahedron, resolution=16)
    >>> volume.resolution
    (16, 16, 16)
    >>> bool(volume.sample([(0.2, 0.2, 0.2)])[0] < 0)
    True
    """
    method, where = choices(sign, device)
    two_sided = checks.flag("two_sided", two_sided)
    if isinstance(mesh, Shape) or all_shapes(mesh):
        unused = {"sign": (method, "auto"), "band": (band, None), "thickness": (thickness, None)}
        refuse_for_shapes(unused, two_sided)
        return bake_shape(mesh, resolution, voxel_size, bounds, margin, where, progress)
    if (cloud := as_cloud(mesh)) is not None:
        refuse_for_clouds({"band": band, "thickness": thickness}, two_sided)
        return bake_cloud(cloud, resolution, voxel_size, bounds, margin, is_signed(cloud, method, where), progress)
    if band is not None:
        band = checks.number("band", band, above=0)
    job = prepare(mesh, resolution, voxel_size, bounds, margin, sign, two_sided, thickness)
    volume = bake_job(job, band, where, progress)
    log_warnings(volume.report)
    return volume


class Job(NamedTuple):
    """The checked input of a bake."""

    mesh: Mesh
    grid: Grid
    #: Box of the surface, (2, 3).
    inner: NDArray[np.float64]
    sign: str
    thickness: float | None

    def source(self, sign_method: str) -> MeshSource:
        """Return the source of exact tangent planes, given the sign method that was used."""
        if self.thickness is None:
            return MeshSource(self.mesh, 0.0 if sign_method == "unsigned" else None)
        return MeshSource(self.mesh, self.thickness / 2)

    def on_same_grid(self, mesh: Mesh) -> Job:
        """Prepare another mesh on the same grid with the same options."""
        return place(mesh, self.grid, self.sign, self.thickness)


def place(mesh: Mesh, grid: Grid, sign: str, thickness: float | None) -> Job:
    """Prepare a bake on a given grid with checked options."""
    grown = 0.0 if thickness is None else thickness / 2
    reach = float(np.abs([grid.lower - mesh.center, grid.upper - mesh.center]).max())
    size = float((mesh.bounds[1] - mesh.bounds[0]).max())
    if reach > MAX_GRID_REACH * size:
        raise ArgumentError(
            f"bounds: {reach:.3g} away from a mesh of size {size:.3g} is too far; "
            f"at most {MAX_GRID_REACH:g} times its size"
        )
    return Job(mesh, grid, mesh.bounds + np.array([[-grown], [grown]]), sign, thickness)


def prepare(
    mesh: MeshLike,
    resolution: Resolution,
    voxel_size: float | None,
    bounds: ArrayLike | None,
    margin: float,
    sign: Sign,
    two_sided: bool,
    thickness: float | None,
    box: NDArray[np.float64] | None = None,
    *,
    default: int = DEFAULT_RESOLUTION,
) -> Job:
    """Check the arguments that every bake has, and choose the grid around `box`, (2, 3), or the box of the mesh."""
    method = checks.text("sign", sign)
    two_sided = checks.flag("two_sided", two_sided)
    if thickness is not None:
        thickness = checks.number("thickness", thickness, above=0)
        if not two_sided:
            raise ArgumentError("thickness: applies only with two_sided=True")
    checked = as_mesh(mesh)

    # A sheet extends half its thickness beyond the triangles.
    grown = 0.0 if thickness is None else thickness / 2
    inner = (checked.bounds if box is None else box) + np.array([[-grown], [grown]])
    make = partial(make_grid, inner, resolution, voxel_size=voxel_size, bounds=bounds, margin=margin, default=default)
    grid = make()
    if two_sided and thickness is None:
        # Samples of the last voxel lie half a voxel inside the box. The sheet must end before them.
        border = 0.5 + sheet_thickness(grid) / (2 * np.array(grid.spacing))
        grid = make(border=1.01 * border)
        thickness = sheet_thickness(grid)
    return place(checked, check_count(grid), method, thickness)


def bake_job(job: Job, band: float | None, device: str, progress: Progress, before: Volume | None = None) -> Volume:
    """Bake a prepared job. Its warnings are in the report and are not issued.

    `before` may be a volume on the same grid with the same options. If it was baked on the CPU from a known mesh, only
    the samples that may differ are evaluated.
    """
    grid = job.grid
    distances: NDArray[np.float32] | _core.DeviceField
    with progress_callback(progress, "bake") as callback:
        if before is not None and before._recipe is not None and before.report.device == "cpu":
            distances, facts = _core.bake_update(
                job.mesh._core,
                before._recipe.mesh._core,
                before._distances,
                before.report.undecided_voxels,
                grid.lower,
                grid.upper,
                sign=job.sign,
                band=band,
                thickness=job.thickness,
                progress=callback,
            )
        else:
            distances, facts = _core.bake(
                job.mesh._core,
                grid.lower,
                grid.upper,
                grid.shape,
                sign=job.sign,
                band=band,
                thickness=job.thickness,
                device=device,
                progress=callback,
            )
    reach = 0.0 if band is None else band * max(grid.spacing)
    report = Report.of_mesh(job.mesh, {**facts, "band": reach, "thickness": job.thickness or 0.0})
    source = job.source(report.sign_method)
    recipe = Recipe(job.mesh, job.sign, band, job.thickness, device)
    return Volume._wrap(distances, np.array([grid.lower, grid.upper]), job.inner, report, source, recipe)


def sheet_thickness(grid: Grid) -> float:
    """The default thickness of a sheet: a thousandth more than the diagonal of a voxel, world units.

    With this thickness the trilinear field is negative on the whole sheet, at any angle and offset.

    Proof. Let p be a point of the sheet in a cell with sides s, at position f in the cell, 0 to 1 along each axis. Let
    X be a random corner of the cell, drawn with its trilinear weight, so the mean of X is p. The distance of X to the
    sheet is at most |X - p|. The interpolated distance at p is therefore at most E|X - p| <= sqrt(E|X - p|^2) =
    sqrt(sum of s_k^2 f_k (1 - f_k)) <= |s| / 2. The field is that distance minus half the thickness.
    """
    return 1.001 * math.hypot(*grid.spacing)


def log_warnings(report: Report) -> None:
    """Log the warnings of the report, and issue one `SurfaceWarning` with them unless the distances are unsigned."""
    for warning in report.warnings:
        logger.warning("%s", warning)
    if report.sign_method != "unsigned":
        warn_surface(report.warnings)


def refuse_devices(function: str, device: str) -> None:
    """Refuse every device but the CPU, for a function that runs nowhere else."""
    if checks.text("device", device) not in ("auto", "cpu"):
        raise ArgumentError(f'device: {function} runs on the CPU only; leave it out or pass "cpu", got {device!r}')


def refuse_for_shapes(options: Mapping[str, tuple[Any, Any]], two_sided: bool) -> None:
    """Raise ArgumentError for an option of meshes that is given for a shape: names with values and defaults."""
    for name, (value, default) in options.items():
        if value is not default and not (isinstance(value, str) and value == default):
            raise ArgumentError(f"{name}: does not apply to a shape, whose field is signed and complete")
    if two_sided:
        raise ArgumentError("two_sided: does not apply to a shape; see Shape.shell")


def refuse_for_clouds(options: Mapping[str, Any], two_sided: bool) -> None:
    """Raise ArgumentError for an option of meshes that is given for a cloud: names with values."""
    for name, value in {**options, "two_sided": two_sided or None}.items():
        if value is not None:
            raise ArgumentError(f"{name}: does not apply to a cloud of points")


def grid_around(
    cloud: PointCloud,
    resolution: Resolution,
    voxel_size: float | None,
    bounds: ArrayLike | None,
    margin: float,
    default: int = DEFAULT_RESOLUTION,
) -> Grid:
    """The grid around the points of a cloud."""
    box = {"voxel_size": voxel_size, "bounds": bounds, "margin": margin, "default": default}
    return check_count(make_grid(cloud.bounds, resolution, **box))  # type: ignore[arg-type]


def bake_cloud(
    cloud: PointCloud,
    resolution: Resolution,
    voxel_size: float | None,
    bounds: ArrayLike | None,
    margin: float,
    signed: bool,
    progress: Progress,
) -> Volume:
    """Bake a cloud of points."""
    grid = grid_around(cloud, resolution, voxel_size, bounds, margin)
    start = perf_counter()
    with progress_callback(progress, "bake") as callback:
        distances, inside, undecided = cloud._core.bake(
            grid.lower, grid.upper, grid.shape, signed=signed, progress=callback
        )
    report = report_of(
        cloud,
        signed,
        undecided,
        distances.size,
        start,
        inside_voxels=inside,
        undecided_voxels=undecided,
        peak_bytes=distances.nbytes + cloud._core.nbytes,
    )
    log_warnings(report)
    return Volume._wrap(distances, np.array([grid.lower, grid.upper]), np.array(cloud.bounds), report)


def bake_shape(
    shapes: Shape | Sequence[Shape],
    resolution: Resolution,
    voxel_size: float | None,
    bounds: ArrayLike | None,
    margin: float,
    device: str,
    progress: Progress,
    *,
    default: int = DEFAULT_RESOLUTION,
) -> Volume:
    """Bake a shape, or the union of several. `default` is the default resolution of the calling function."""
    shape = shapes if isinstance(shapes, Shape) else combine("union", shapes)
    try:
        inner = shape.bounds
    except ShapeError:
        if bounds is None:
            raise
        inner = checks.box("bounds", bounds)
    grid = check_count(
        make_grid(inner, resolution, voxel_size=voxel_size, bounds=bounds, margin=margin, default=default)
    )
    start = perf_counter()
    with progress_callback(progress, "bake") as callback:
        distances, where = shape._core.bake(grid.lower, grid.upper, grid.shape, device=device, progress=callback)
    kind = "exact distances" if shape.exact else "distances or lower bounds of them"
    inside = int(np.count_nonzero(distances < 0))
    nothing = (
        "no sample is inside: the box does not contain the shape, or the shape is thinner than a voxel of "
        f"{max(grid.spacing):.3g}"
    )
    report = Report(
        sign_method="shape",
        sign_reason=f"the field of a shape, {kind}",
        closed=True,
        inside_voxels=inside,
        device=where,
        seconds={"evaluate": perf_counter() - start},
        peak_bytes=distances.nbytes,
        warnings=() if inside else (nothing,),
    )
    log_warnings(report)
    source = ShapeSource(shape._core)
    return Volume._wrap(distances, np.array([grid.lower, grid.upper]), inner.copy(), report, source)
