"""From a mesh to a sparse volume, without the dense grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.encodings import Encoding
from ..base.grid import Resolution
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.convert import MeshLike
from ..queries.common import Sign
from ..volumes.sparse import SparseVolume, sparse_options
from .dense import log_warnings, prepare


def bake_sparse(
    mesh: MeshLike,
    resolution: Resolution = 512,
    *,
    band: float = 4,
    tolerance: float | None = 0.05,
    encoding: Encoding = "float32",
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    margin: float = 0.1,
    sign: Sign = "auto",
    two_sided: bool = False,
    thickness: float | None = None,
    progress: Progress = None,
) -> SparseVolume:
    """Bake a mesh into bricks around its surface; the dense grid is never made.

    Parameters
    ----------
    mesh, voxel_size, bounds, margin, sign, two_sided, thickness, progress
        As for :func:`bake`.
    resolution : int or three ints, default 512
        Voxels of the grid that the bricks are part of.
    band : float, default 4
        Bricks with a sample nearer to the surface are stored, voxels; at least 2.
    tolerance : float or None, default 0.05
        Coarser bricks take the place of finer ones where they differ from no sample in the band by more, voxels. None:
        never; every stored sample is that of :func:`bake`.
    encoding : str, default "float32"
        Or ``"float16"``, ``"snorm16"``, ``"snorm8"``: rounded toward zero, the integers with the band as their scale.

    Returns
    -------
    SparseVolume
        Memory in proportion to the surface, but for 8 bytes a brick of 343 cells.

    Raises
    ------
    MeshError, ArgumentError, CapacityError
        As for :func:`bake`.

    Notes
    -----
    Runs on the CPU. Distances are those of :func:`bake`. A brick far from the surface is taken to be on one side: on
    closed meshes that is certain, on open ones all its samples are looked at, on mere soups its corners.

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
    job = prepare(mesh, resolution, voxel_size, bounds, margin, sign, two_sided, thickness)
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
    report = Report.of_mesh(job.mesh, facts)
    log_warnings(report)
    return SparseVolume._wrap(
        field, np.array([job.grid.lower, job.grid.upper]), job.inner, report, job.source(report.sign_method)
    )
