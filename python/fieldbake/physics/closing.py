"""Closed meshes without overlaps, for engines that take the side of a point from the nearest face."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base.errors import MeshError
from ..meshes.convert import named_mesh
from ..meshes.mesh import Mesh
from ..queries.nearest import winding_number
from ..shapes.shape import Shape
from ..surfaces.solids import solid

#: Distance from a face at which its outside is tested, in sizes of the mesh.
STEP = 1e-5


def closed_mesh(geometry: Any, resolution: int) -> Mesh:
    """Make a closed mesh whose nearest face decides between inside and outside.

    Parameters
    ----------
    geometry : Shape, Mesh or anything that `as_mesh` takes
        A shape becomes its own surface. A mesh is returned as it is if :func:`has_one_side`, and else becomes
        :func:`fieldbake.solid` of it.
    resolution : int
        Voxels along the longest side of the box, for geometry that is converted.
    """
    if isinstance(geometry, Shape):
        mesh = geometry.to_mesh(resolution)
        if not len(mesh.faces):
            raise MeshError(f"geometry: the shape has no surface at the resolution {resolution}; raise it")
        return mesh
    mesh = named_mesh("geometry", geometry)
    return mesh if has_one_side(mesh) else solid(mesh, resolution)


def has_one_side(mesh: Mesh) -> bool:
    """Whether a mesh is closed, faces outwards, and has neither overlaps nor crossing faces.

    In front of a face of such a mesh the winding number is 0, and behind it 1. It is 1 or more in front of a face that
    lies inside another part, and -1 behind a face of a part that is inside out.
    """
    facts = mesh.topology()
    if not facts["closed"] or facts["flipped_faces"] or facts["duplicate_faces"]:
        return False
    size = float((mesh.bounds[1] - mesh.bounds[0]).max())
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    winding = winding_number(mesh, middles + STEP * size * mesh.face_normals)
    return bool((np.abs(winding) <= 0.5).all()) and mesh._core.self_intersections() == 0
