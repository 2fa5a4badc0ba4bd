"""`sweep`: the space that a moving body or robot covers, as a sparse field with a proof."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..assemblies.assembly import Assembly
from ..assemblies.geometry import check_rigid, core_element, searchable
from ..base import checks
from ..base.encodings import Encoding
from ..base.errors import ArgumentError, ShapeError
from ..base.grid import Grid, Resolution, check_count, make_grid
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import MIXED_SIGN_REASON, Report, bytes_text, count_text, seconds_text
from ..meshes.convert import MeshLike
from ..shapes.field import MESH_RESOLUTION
from ..shapes.shape import Shape, all_shapes, combine
from ..volumes.sparse import SparseVolume, sparse_options

#: Voxels along the longest side, unless the caller chooses.
SWEEP_RESOLUTION = 128

#: Largest number of grids that are tried for a swept solid. Each has the border that the last one lacked.
GRIDS = 24

#: Steps of float32 of the box by which samples lie below the bound that contains the solid: zero counts as outside.
ROUNDING = 4


@dataclass(frozen=True)
class SweepReport(Report):
    """The report of a sweep: the report of a bake, with the motion and the offset.

    Attributes
    ----------
    segments : int
        Number of steps of the motion.
    voxel_size : float
        Longest side of a voxel, world units.
    offset : float
        Amount that was subtracted from the distance, world units.
    evaluations : float
        Distances from a posed body, per evaluated sample.
    """

    segments: int = 0
    voxel_size: float = 0.0
    offset: float = 0.0
    evaluations: float = 0.0

    def rows(self) -> list[tuple[str, str]]:
        """List the label and the text of each line of the report."""
        seconds = ", ".join(f"{stage} {seconds_text(value)}" for stage, value in self.seconds.items())
        return [
            ("motion", f"{count_text(self.segments, 'step')}, {self.evaluations:.1f} distances a sample"),
            ("voxel", f"{self.voxel_size:.4g}, offset {self.offset:.4g}"),
            ("time", f"{seconds} on {self.device}"),
            ("memory", f"{bytes_text(self.peak_bytes)} at most"),
            *(("warning", warning) for warning in self.warnings),
        ]


def sweep(
    geometry: MeshLike | Shape | Sequence[Shape] | Assembly,
    motion: ArrayLike,
    resolution: Resolution = SWEEP_RESOLUTION,
    *,
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    closed: bool = False,
    contain: bool = True,
    tolerance: float = 0.25,
    band: float = 3,
    encoding: Encoding = "float32",
    sign: Literal["auto", "winding", "unsigned"] = "auto",
    progress: Progress = None,
) -> SparseVolume:
    """Compute the space that a moving body covers, with a proof between the given poses.

    Parameters
    ----------
    geometry : Mesh, path, Shape, anything that :func:`bake` takes, or Assembly
        The moving bodies. Exact shapes are evaluated in closed form; other shapes become their closed mesh.
    motion : (t, 4, 4), (t, n, 4, 4) or (t, m) float
        Rigid world-from-body poses of one body; poses of the n bodies of an assembly; or values of its m joints.
        Between poses a body follows the screw motion, between joint values every joint moves linearly. One row stands
        still.
    resolution : int or three ints, default 128
        Voxels of the whole grid, as for :func:`bake`.
    voxel_size : float, optional
        Side of a cubic voxel, world units. It replaces `resolution`.
    bounds : (2, 3) array, optional
        Box to sample, world units. The default contains the whole surface.
    closed : bool, default False
        Whether the motion returns from the last row to the first.
    contain : bool, default True
        Whether the surface contains the swept solid: every point of it inside `bounds` is inside the field and inside
        the mesh of :meth:`SparseVolume.to_mesh`. The surface is at most 2 sqrt(3) + `tolerance` voxels outside, and
        about sqrt(3) + `tolerance` on smooth parts. False gives the distance without an offset.
    tolerance : float, default 0.25
        Largest difference of a sample in the band from the distance, voxels, above 0. A sample is a lower bound.
    band : float, default 3
        A brick is stored if one of its samples is at most this far from the surface, voxels; at least 2.
    encoding : str, default "float32"
        ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``. Samples are rounded down inside, toward zero
        outside.
    sign : "auto", "winding" or "unsigned", default "auto"
        ``"auto"`` and ``"winding"``: the inside by the winding number. ``"unsigned"``: a mesh is a sheet without an
        inside; it needs `contain`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    SparseVolume
        The smallest signed distance over the motion, minus the offset. ``to_mesh(sharp=False)`` is the closed surface.
        Its `report` has the offset, the number of steps and the evaluations per sample.

    Raises
    ------
    ArgumentError
        For a motion of another shape, a pose that is not rigid, or two rows that differ by half a turn, whose screw is
        not unique.
    MeshError
        If a mesh is open, and `sign` is not ``"unsigned"``.
    ShapeError
        If a geometry is unbounded and `bounds` is not given.
    CapacityError
        If the index of the grid would not fit in memory.

    Notes
    -----
    The signed distance of a point from a moving body changes by at most the distance that the point moves in the frame
    of the body. A search over intervals of time (Piyavskii 1972, Shubert 1972) finds the smallest distance with a lower
    bound that holds between the poses. Outside the swept solid the field is its distance. Inside it is the depth in the
    body at one of its poses, a lower bound of the distance from the outer surface. The closed mesh of a shape that is
    not exact deviates from the shape; with `contain` the largest deviation found is part of the offset. The
    sweep runs on the CPU.

    Examples
    --------
    A ball along a line sweeps a capsule:

    >>> import fieldbake as fb
    >>> start, end = np.eye(4), np.eye(4)
    >>> end[0, 3] = 2.0
    >>> swept = fb.sweep(fb.sphere(0.5), [start, end], 48, contain=False)
    >>> abs(float(swept.sample([(1.0, 0.6, 0.0)])[0]) - 0.1) <= 0.25 * swept.report.voxel_size
    True
    """
    start = perf_counter()
    box = None if bounds is None else checks.box("bounds", bounds)
    is_closed, is_contained = checks.flag("closed", closed), checks.flag("contain", contain)
    options = sparse_options(band, None, encoding)
    slack = checks.number("tolerance", tolerance, above=0)
    is_unsigned = checks.choice("sign", sign, ("auto", "winding", "unsigned")) == "unsigned"
    if is_unsigned and not is_contained:
        raise ArgumentError('contain: must be True with sign="unsigned", whose distance is never negative')
    if isinstance(geometry, Assembly):
        job, deviation = _of_assembly(geometry, motion, is_closed, is_unsigned), geometry.report.largest_deviation
        warnings = geometry._surface_warnings([True] * geometry._core_bodies.count)
    else:
        shape = combine("union", list(geometry)) if all_shapes(geometry) else geometry  # type: ignore[arg-type]
        if is_unsigned and isinstance(shape, Shape):
            raise ArgumentError("sign: does not apply to a shape, whose field is signed and complete")
        source, deviation = searchable(shape, MESH_RESOLUTION)
        poses = _poses("motion", motion, (4, 4))
        bodies = _core.Bodies(1, [core_element(0, source, np.eye(4))])
        job = _core.Sweep.of_poses(bodies, poses, closed=is_closed, unsigned=is_unsigned)
        # A shape has no surface warnings.
        warnings = () if isinstance(source, Shape) or is_unsigned else tuple(source._core.sign_warnings("auto"))
        warn_surface(warnings)
    found = job.bounds()
    if found is None and box is None:
        raise ShapeError("a geometry is unbounded, or there is none; give the box to sample (bounds)")
    inner = np.array(box if found is None else found)
    grown = deviation if is_contained else 0.0
    grid = _grid(inner, resolution, voxel_size, box, slack, grown, is_contained)
    voxel = max(grid.spacing)
    # The diagonal of a cell, and the rounding of samples.
    diagonal = float(np.linalg.norm(grid.spacing))
    size = float(np.subtract(grid.upper, grid.lower).max())
    offset = diagonal + grown + ROUNDING * float(np.finfo(np.float32).eps) * size if is_contained else 0.0
    with progress_callback(progress, "sweep") as callback:
        field, samples, evaluations = job.bake(
            grid.lower,
            grid.upper,
            grid.shape,
            offset=offset,
            tolerance=slack * voxel,
            band=options["band"] * voxel,
            encoding=options["encoding"],
            progress=callback,
        )
    report = SweepReport(
        sign_method="unsigned" if is_unsigned else "winding",
        sign_reason="chosen by the caller" if is_unsigned else MIXED_SIGN_REASON,
        closed=True,
        device="cpu",
        seconds={"sweep": perf_counter() - start},
        peak_bytes=field.nbytes,
        band=options["band"] * voxel,
        warnings=warnings,
        segments=job.steps,
        voxel_size=voxel,
        offset=offset,
        evaluations=evaluations / max(samples, 1),
    )
    reach = offset + slack * voxel
    surface = inner + np.array([[-reach], [reach]])
    return SparseVolume._wrap(field, np.array([grid.lower, grid.upper]), surface, report)


def _grid(
    inner: NDArray[np.float64],
    resolution: Resolution,
    voxel_size: float | None,
    box: NDArray[np.float64] | None,
    tolerance: float,
    grown: float,
    is_contained: bool,
) -> Grid:
    """Choose the grid. Without a given box it has space for the surface, which lies outside the solid."""
    solid = inner + np.array([[-grown], [grown]])
    make = partial(
        make_grid, solid, resolution, voxel_size=voxel_size, bounds=box, margin=0.0, default=SWEEP_RESOLUTION
    )
    border = np.ones(3)
    for _ in range(GRIDS):
        grid = check_count(make(border=border))
        spacing = np.array(grid.spacing)
        # The samples of the outer half voxel repeat those at the centres of voxels.
        diagonals = 2.0 if is_contained else 0.0
        needed = (diagonals * np.linalg.norm(spacing) + tolerance * spacing.max()) / spacing + 1.0
        free = np.minimum(solid[0] - grid.lower, grid.upper - solid[1]) / spacing
        if box is not None or (free >= needed).all():
            return grid
        border = 1.01 * needed
        if np.ptp(spacing) > 0:
            # Oblong voxels grow with the border, each side by its own factor, so the border is kept as a length.
            reach = border * spacing
            border = reach * grid.shape / (solid[1] - solid[0] + 2 * reach)
    raise ArgumentError(
        f"resolution: {max(grid.shape)} voxels leave no space for the surface, which lies up to {needed.max():.1f} "
        "voxels outside the solid; use more"
    )


def _poses(name: str, motion: ArrayLike, tail: tuple[int, ...]) -> NDArray[np.float64]:
    """Check rows of poses (t, *tail), and return them as (k, 4, 4)."""
    shape = f"(t, {', '.join(map(str, tail))})"
    array = checks.real_array(name, motion, shape)
    if array.ndim != len(tail) + 1 or array.shape[1:] != tail or len(array) == 0:
        raise ArgumentError(f"{name}: must have shape {shape} with at least one row, got {checks.describe(array)}")
    poses = checks.as_float64(array)
    check_rigid(name, poses)
    return np.ascontiguousarray(poses.reshape(-1, 4, 4))


def _of_assembly(assembly: Assembly, motion: ArrayLike, is_closed: bool, is_unsigned: bool) -> _core.Sweep:
    """Prepare the motion of an assembly: joint values (t, m), or poses (t, n, 4, 4)."""
    bodies, count = assembly._core_bodies, len(assembly.body_names)
    array = checks.real_array("motion", motion, f"(t, {len(assembly.joint_names)}) or (t, {count}, 4, 4)")
    if array.ndim == 4:
        poses = _poses("motion", array, (count, 4, 4))
        return _core.Sweep.of_poses(bodies, poses, closed=is_closed, unsigned=is_unsigned)
    if array.ndim != 2 or len(array) == 0:
        raise ArgumentError(
            f"motion: must be joint values (t, {len(assembly.joint_names)}) or poses (t, {count}, 4, 4) with at least "
            f"one row, got {checks.describe(array)}"
        )
    chains = assembly._chains(array)
    return _core.Sweep.of_joints(bodies, chains, rows=len(array), closed=is_closed, unsigned=is_unsigned)
