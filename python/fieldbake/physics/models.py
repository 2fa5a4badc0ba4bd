"""Meshes of a compiled MuJoCo model, in the coordinates of their files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..meshes.mesh import Mesh

#: Largest depth of an octree. The surface of a box has about 24 * 4^12 leaves of depth 12, which fill the memory.
MAX_DEPTH = 12


def mesh_of(model: Any, i: int) -> Mesh:
    """The triangles of mesh `i` in the frame of its octree, which is that of its inertia."""
    vertex, face = model.mesh_vertadr[i], model.mesh_faceadr[i]
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[i]]
    return Mesh(vertices, model.mesh_face[face : face + model.mesh_facenum[i]])


def frame_in_file(model: Any, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The rotation (3, 3) and the offset (3,) to the mesh file, after its reference pose and scale, from the octree."""
    w, x, y, z = model.mesh_quat[i].tolist()
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return turn, np.array(model.mesh_pos[i], dtype=np.float64)


def mesh_in_file(model: Any, i: int) -> Mesh:
    """The triangles of mesh `i` in the coordinates of its file after its reference pose and scale."""
    turn, offset = frame_in_file(model, i)
    mesh = mesh_of(model, i)
    return Mesh(mesh.vertices @ turn.T + offset, mesh.faces)
