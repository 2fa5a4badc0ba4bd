"""Baking of a mesh that moved, into the grid of an earlier volume."""

from __future__ import annotations

from typing import get_args

from ..base.grid import Grid
from ..base.report import Report
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh
from ..queries.common import Sign
from ..volumes.volume import Recipe, Volume
from .dense import bake_job, log_warnings, place


def update(volume: Volume, mesh: MeshLike) -> Volume:
    """Bake a mesh into the grid of a volume, with the options of that volume; see :meth:`Volume.update`."""
    checked = as_mesh(mesh)
    lower, upper = volume._corners()
    grid = Grid(lower, upper, volume.resolution)
    options = volume._recipe or _recipe_of(checked, volume.report, max(grid.spacing))
    job = place(checked, grid, options.sign, options.thickness)
    updated = bake_job(job, options.band, options.device, None, before=volume)
    log_warnings(updated.report)
    return updated


def _recipe_of(mesh: Mesh, report: Report, voxel: float) -> Recipe:
    """Restore the options of a bake from its report. Options that the report does not state have their defaults."""
    sign = report.sign_method if report.sign_method in get_args(Sign) else "auto"
    # Twelve digits restore a number of voxels from its product with the size of a voxel.
    band = float(f"{report.band / voxel:.12g}") if report.band > 0 else None
    return Recipe(mesh, sign, band, report.thickness or None, "auto")
