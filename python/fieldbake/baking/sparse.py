"""Baking to a sparse volume. For a mesh the dense grid is never made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base import checks
from ..base.encodings import Encoding
from ..base.grid import Resolution
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.convert import MeshLike
from ..points.interop import as_cloud
from ..queries.clouds import is_signed, report_of
from ..queries.common import Sign
from ..shapes.shape import Shape, all_shapes
from ..volumes.sparse import SparseVolume, sparse_options
from .dense import bake_shape, grid_around, log_warnings, prepare, refuse_devices, refuse_for_clouds, refuse_for_shapes

#: Voxels along the longest side, unless the caller chooses.
SPARSE_RESOLUTION = 512


def bake_sparse(
    mesh: MeshLike | Shape | Sequence[Shape],
    resolution: Resolution = SPARSE_RESOLUTION,
    *,
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    margin: float = 0.1,
    sign: Sign = "auto",
    band: float = 4,
    two_sided: bool = False,
    thickness: float | None = None,
    tolerance: float | None = 0.05,
    encoding: Encoding = "float32",
    device: str = "auto",
    progress: Progress = None,
) -> SparseVolume:
    """Bake a mesh or a shape into bricks around its surface.

    Parameters
    ----------
    mesh, voxel_size, bounds, margin, sign, two_sided, thickness, progress
        As for :func:`bake`.
    resolution : int or three ints, default 512
        Voxels of the whole grid, as for :func:`bake`.
    band : float, default 4
        A brick is stored if one of its samples is at most this far from the surface, voxels; at least 2.
    tolerance : float or None, default 0.05
        Largest difference, in voxels, by which a coarser brick may differ from the samples in the band that it
        replaces. None never uses coarser bricks, so every stored sample equals the sample of :func:`bake`. With
        ``"snorm16"`` and ``"snorm8"`` it holds within half the band; beyond it a brick may have lower bounds.
    encoding : str, default "float32"
        ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``, rounded toward zero. The largest integer represents
        the band.
    device : str, default "auto"
        ``"auto"`` or ``"cpu"``: the bake runs on the CPU.

    Returns
    -------
    SparseVolume
        The field. Its memory is proportional to the area of the surface, plus 8 bytes for each brick of 7^3 cells.

    Raises
    ------
    MeshError, ShapeError, ArgumentError, CapacityError
        As for :func:`bake`.

    Notes
    -----
    The bake of a mesh never makes the dense grid. A shape is evaluated on the dense grid first, 4 bytes per sample.

    Stored distances equal the distances of :func:`bake`. A brick far from the surface is inside or outside as a whole.
    On closed meshes this is exact. On open meshes all samples of the brick are tested, and on triangle soups its
    corners.

    Examples
    --------
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> tetrahedron = (corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    >>> sparse = bake_sparse(tetrahedron, resolution=128)
    >>> bool(sparse.sample([(0.2, 0.2, 0.2)])[0] < 0)
    True
    >>> sparse.nbytes < 4 * 128**3 / 2
    True
    """
    options = sparse_options(band, tolerance, encoding)
    refuse_devices("bake_sparse", device)
    if isinstance(mesh, Shape) or all_shapes(mesh):
        unused = {"sign": (checks.text("sign", sign), "auto"), "thickness": (thickness, None)}
        refuse_for_shapes(unused, checks.flag("two_sided", two_sided))
        dense = bake_shape(mesh, resolution, voxel_size, bounds, margin, "cpu", progress, default=SPARSE_RESOLUTION)
        return dense.to_sparse(tolerance=tolerance, band=band, encoding=encoding)
    if (cloud := as_cloud(mesh)) is not None:
        refuse_for_clouds({"thickness": thickness}, checks.flag("two_sided", two_sided))
        signed = is_signed(cloud, checks.text("sign", sign))
        grid = grid_around(cloud, resolution, voxel_size, bounds, margin, SPARSE_RESOLUTION)
        start = perf_counter()
        with progress_callback(progress, "bake") as callback:
            field, inside, undecided = _core.bake_cloud_sparse(
                cloud._core, grid.lower, grid.upper, grid.shape, signed=signed, progress=callback, **options
            )
        counts = {"inside_voxels": inside, "undecided_voxels": undecided}
        report = report_of(cloud, signed, undecided, math.prod(grid.shape), start, **counts)
        log_warnings(report)
        return SparseVolume._wrap(field, np.array([grid.lower, grid.upper]), np.array(cloud.bounds), report, None)
    job = prepare(mesh, resolution, voxel_size, bounds, margin, sign, two_sided, thickness, default=SPARSE_RESOLUTION)
    with progress_callback(progress, "bake") as callback:
        field, facts = _core.bake_sparse(
            job.mesh._core,
            job.grid.lower,
            job.grid.upper,
            job.grid.shape,
            sign=job.sign,
            thickness=job.thickness,
            progress=callback,
            **options,
        )
    report = Report.of_mesh(job.mesh, {**facts, "thickness": job.thickness or 0.0})
    log_warnings(report)
    return SparseVolume._wrap(
        field, np.array([job.grid.lower, job.grid.upper]), job.inner, report, job.source(report.sign_method)
    )
