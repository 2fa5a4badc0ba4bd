"""Octrees of MuJoCo models as arrays of corners, and a solid of overlapping parts with its closed form."""

import importlib

import numpy as np

import fieldbake as fb
import meshes
import truth

#: The boxes (2, 1, 1) and (1, 2, 1) with their centres (0.3, 0.2, 0.25) apart.
BOXES = (((-1.0, -0.5, -0.5), (1.0, 0.5, 0.5)), ((-0.2, -0.8, -0.25), (0.8, 1.2, 0.75)))


def overlapping_boxes():
    return fb.Mesh(*meshes.join(*(meshes.box(*corners) for corners in BOXES)))


def distance_to_boxes(points):
    """The signed distance outside the boxes, and a value of the right sign inside."""
    return np.min([truth.box(points, *corners) for corners in BOXES], axis=0)


def leaf_corners(model):
    """Positions (l, 8, 3) of the corners of all leaves in the coordinates of the file, and their values (l, 8)."""
    leaves = (model.oct_child < 0).all(axis=1)
    boxes = model.oct_aabb[leaves]
    bits = np.array([(j & 1, j >> 1 & 1, j >> 2) for j in range(8)])
    local = boxes[:, None, :3] + (2 * bits - 1) * boxes[:, None, 3:]
    turn = np.empty(9)
    mujoco = importlib.import_module("mujoco")
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
    return local @ turn.reshape(3, 3).T + model.mesh_pos[0], model.oct_coeff[leaves]
