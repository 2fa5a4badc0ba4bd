"""Meshes of a compiled MuJoCo model, in the coordinates of their files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..assemblies.mjcf_files import mesh_of, rotation
from ..meshes.mesh import Mesh

#: Largest depth of an octree. The surface of a box has about 24 * 4^12 leaves of depth 12, which fill the memory.
MAX_DEPTH = 12


def frame_in_file(model: Any, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The rotation (3, 3) and the offset (3,) to the mesh file, after its reference pose and scale, from the octree."""
    return rotation(model.mesh_quat[i]), np.array(model.mesh_pos[i], dtype=np.float64)


def mesh_in_file(model: Any, i: int) -> Mesh:
    """The triangles of mesh `i` in the coordinates of its file after its reference pose and scale."""
    turn, offset = frame_in_file(model, i)
    mesh = mesh_of(model, i)
    return Mesh(mesh.vertices @ turn.T + offset, mesh.faces)
