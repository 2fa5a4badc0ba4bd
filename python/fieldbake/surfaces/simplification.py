"""Closed meshes with fewer faces, by the package manifold3d."""

from __future__ import annotations

import numpy as np

from ..base import checks
from ..base.errors import ArgumentError, MeshError
from ..base.optional import optional_module
from ..base.report import SurfaceReport
from ..meshes.mesh import Mesh

#: Trials with a smaller tolerance; the mesh itself is the result if none succeeds.
MOST_TRIALS = 8


def check_tolerance(value: float) -> float:
    """Check the argument `simplify`; above 0 it needs manifold3d."""
    try:
        tolerance = checks.number("simplify", value, least=0)
    except ArgumentError as error:
        raise MeshError(str(error)) from None
    if tolerance > 0:
        optional_module("manifold3d", "simplify", extra="simplify")
    return tolerance


def simplified(mesh: Mesh, tolerance: float) -> Mesh:
    """Collapse edges of a closed two-manifold while the surface moves by at most `tolerance`, world units.

    The vertices of the result are a subset of the vertices of the mesh. manifold3d moves a surface by up to about twice
    its own tolerance. That tolerance is reduced until the measured distance, in both directions, is at most
    `tolerance`.
    """
    body = mesh.to_manifold()
    # A tolerance beyond the size of the mesh removes every face.
    tried = min(tolerance, float(np.ptp(mesh.bounds, axis=0).max()))
    for _ in range(MOST_TRIALS):
        made = body.simplify(tried).to_mesh64()
        count = len(made.tri_verts)
        if count == len(mesh.faces):
            return mesh  # A smaller tolerance removes no more faces.
        if count == 0:
            tried /= 2
            continue
        kept = np.array(made.vert_properties[:, :3])
        result = Mesh._extracted(kept, np.array(made.tri_verts, np.uint32), mesh.report or SurfaceReport())
        # The second value of a deviation is its upper bound.
        moved = max(result._core.deviation(mesh._core)[1], mesh._core.deviation(result._core)[1])
        if moved <= tolerance:
            return result
        tried *= 0.9 * tolerance / moved
    return mesh
