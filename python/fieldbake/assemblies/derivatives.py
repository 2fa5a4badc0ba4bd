"""First derivatives of the distances to an assembly and of its clearances, for `torch` and `jax`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .assembly import Assembly


class LinearDistances(NamedTuple):
    """Distances and what their derivatives need: arrays of shape (b, ...) or (...)."""

    #: In the dtype of the points.
    distances: NDArray[Any]
    #: Unit gradients, (..., 3), in the dtype of the points.
    gradients: NDArray[Any]
    #: Rows of the nearest bodies.
    bodies: NDArray[np.int64]
    #: Closest points in the frames of their bodies, with a 1: (..., 4) float64.
    local: NDArray[np.float64]
    #: Shape of the poses.
    shape: tuple[int, ...]


def linearize_assembly(assembly: Assembly, poses: NDArray[Any], points: NDArray[Any]) -> LinearDistances:
    """Evaluate distances with the closest points in the frames of their bodies."""
    kind = points.dtype if points.dtype.kind == "f" else np.dtype(np.float64)
    found = assembly.query(points, poses)
    pose = np.asarray(poses, dtype=np.float64)
    lead = pose.shape[:-3]
    rows = found.bodies.reshape(*lead, -1)
    own = np.take_along_axis(pose, np.maximum(rows, 0)[..., None, None], axis=-3)
    offset = found.points.reshape(*lead, -1, 3) - own[..., :3, 3]
    local = np.einsum("...ji,...j->...i", own[..., :3, :3], offset).reshape(found.points.shape)
    with_one = np.concatenate([local, np.ones((*local.shape[:-1], 1))], axis=-1)
    # Without geometry there is no closest point, and the gradient is zero.
    with_one = np.where(found.bodies[..., None] >= 0, with_one, 0.0)
    distances, gradients = found.distances.astype(kind), found.gradients.astype(kind)
    return LinearDistances(distances, gradients, found.bodies, with_one, pose.shape)


def pose_changes(found: LinearDistances, change: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """The derivatives with respect to poses and points, for the derivative `change` of a result by the distances.

    With d = g . (p - T y) the derivative by the upper rows of T is -outer(g, y), where y ends in 1.
    """
    along = change[..., None] * found.gradients
    lead = found.shape[:-3]
    of_rows = -(along[..., :, None] * found.local[..., None, :]).reshape(*lead, -1, 3, 4)
    rows = np.maximum(found.bodies, 0).reshape(*lead, -1)
    result = np.zeros(found.shape)
    if lead:
        np.add.at(result[..., :3, :], (np.arange(lead[0])[:, None], rows), of_rows)
        return result, along.sum(axis=0)
    np.add.at(result[..., :3, :], rows, of_rows)
    return result, along


def linearize_clearance(
    assembly: Assembly, poses: NDArray[Any], pairs: Sequence[tuple[int, int]]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Evaluate the clearances of pairs, and their derivatives by the poses of both bodies.

    The derivatives have shape (..., k, 2, 3, 4): the upper rows of the poses of both bodies. With c = n . (A x - B y),
    where x and y are the nearest points in the frames of the bodies, they are outer(n, (x, 1)) and -outer(n, (y, 1)).
    Both arrays have the dtype of the poses.
    """
    kind = poses.dtype if poses.dtype.kind == "f" else np.dtype(np.float64)
    found = assembly.clearance(poses, pairs=pairs)
    pose = np.asarray(poses, dtype=np.float64)
    slopes = np.zeros((*found.distances.shape, 2, 3, 4))
    for side, (points, sign) in enumerate(((found.points_a, 1.0), (found.points_b, -1.0))):
        own = pose[..., found.pairs[:, side], :, :]
        local = np.einsum("...ji,...j->...i", own[..., :3, :3], points - own[..., :3, 3])
        with_one = np.concatenate([local, np.ones((*local.shape[:-1], 1))], axis=-1)
        slopes[..., side, :, :] = sign * found.normals[..., :, None] * with_one[..., None, :]
    # A body without geometry is infinitely far in every pose.
    slopes[np.isinf(found.distances)] = 0.0
    return found.distances.astype(kind), slopes.astype(kind)
