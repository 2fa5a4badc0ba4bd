"""Forward kinematics and its derivative: poses of the bodies of a tree of joints.

The pose of a child is the pose of its parent times, for each joint between them in order, the origin of the joint and
its motion: a rotation by Rodrigues' formula, or a translation. The functions take the array module, so that NumPy,
PyTorch and JAX share them, and the last two differentiate them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ArgumentError
from .joint import Joint


@dataclass(frozen=True, eq=False)
class Tree:
    """Bodies and joints by rows.

    Attributes
    ----------
    parents : (n,) int64
        Row of the parent of each body, -1 for a root.
    chains : tuple of tuple of int
        Rows of the joints of each body to its parent, in order.
    order : tuple of int
        Rows of the bodies, each after its parent.
    joints : tuple of Joint
        All joints.
    free : tuple of int
        Rows of the joints with a value of their own.
    rates, offsets : (j, m), (j,) float64
        The value of each joint is ``rates @ values + offsets``; both are zero for fixed joints.
    above : (n, j) bool
        Whether a joint moves a body.
    """

    parents: NDArray[np.int64]
    chains: tuple[tuple[int, ...], ...]
    order: tuple[int, ...]
    joints: tuple[Joint, ...]
    free: tuple[int, ...]
    rates: NDArray[np.float64]
    offsets: NDArray[np.float64]
    above: NDArray[np.bool_]


def tree_of(names: Sequence[str], joints: Sequence[Joint]) -> Tree:
    """Order bodies and joints; ArgumentError for joints that do not form trees."""
    rows = {name: i for i, name in enumerate(names)}
    known: dict[str, int] = {}
    parents = np.full(len(names), -1, dtype=np.int64)
    chains: list[list[int]] = [[] for _ in names]
    for j, joint in enumerate(joints):
        if joint.name in known:
            raise ArgumentError(f"joints: two joints have the name {joint.name!r}")
        known[joint.name] = j
        for role, body in (("parent", joint.parent), ("child", joint.child)):
            if body not in rows:
                raise ArgumentError(f"joint {joint.name!r}: the {role} {body!r} is no body; these are {list(names)}")
        child, parent = rows[joint.child], rows[joint.parent]
        if child == parent:
            raise ArgumentError(f"joint {joint.name!r}: {joint.child!r} is its own parent")
        if chains[child] and parents[child] != parent:
            other = names[parents[child]]
            raise ArgumentError(
                f"joint {joint.name!r}: {joint.child!r} has two parents, {other!r} and {joint.parent!r}"
            )
        parents[child] = parent
        chains[child].append(j)
    order = _ordered(names, parents)
    free, rates, offsets = _values(joints, known)
    above = np.zeros((len(names), len(joints)), dtype=bool)
    for i in order:
        if parents[i] >= 0:
            above[i] = above[parents[i]]
            above[i, chains[i]] = True
    return Tree(parents, tuple(map(tuple, chains)), order, tuple(joints), free, rates, offsets, above)


def _ordered(names: Sequence[str], parents: NDArray[np.int64]) -> tuple[int, ...]:
    """Rows of bodies, each after its parent."""
    children: list[list[int]] = [[] for _ in names]
    for i, parent in enumerate(parents.tolist()):
        if parent >= 0:
            children[parent].append(i)
    order = [i for i, parent in enumerate(parents.tolist()) if parent < 0]
    for i in order:
        order.extend(children[i])
    if len(order) < len(names):
        remaining = sorted(set(range(len(names))) - set(order))
        raise ArgumentError(
            f"joints: the bodies {[names[i] for i in remaining]} are in a cycle of joints, or below one"
        )
    return tuple(order)


def _values(
    joints: Sequence[Joint], known: Mapping[str, int]
) -> tuple[tuple[int, ...], NDArray[np.float64], NDArray[np.float64]]:
    """The joints with values of their own, and the linear map from their values to the values of all joints."""
    free = tuple(j for j, joint in enumerate(joints) if joint.moves and joint.mimic is None)
    column = {j: i for i, j in enumerate(free)}
    rates, offsets = np.zeros((len(joints), len(free))), np.zeros(len(joints))
    for j, joint in enumerate(joints):
        if not joint.moves:
            continue
        at, rate, offset, seen = j, 1.0, 0.0, {j}
        while (mimic := joints[at].mimic) is not None:
            name, multiplier, shift = mimic
            if name not in known or not joints[known[name]].moves:
                raise ArgumentError(f"joint {joints[at].name!r}: mimics {name!r}, which is no joint with a value")
            at = known[name]
            if at in seen:
                raise ArgumentError(f"joint {joint.name!r}: mimics itself through {name!r}")
            seen.add(at)
            offset += rate * shift
            rate *= multiplier
        rates[j, column[at]], offsets[j] = rate, offset
    return free, rates, offsets


def forward(tree: Tree, values: Any, roots: Sequence[Any], xp: Any) -> tuple[Any, list[Any]]:
    """Poses of all bodies, and the frames in which joints turn or slide.

    Parameters
    ----------
    tree : Tree
        Bodies and joints.
    values : (..., m) array of `xp`
        Values of the free joints.
    roots : sequence of (..., 4, 4)
        Poses of the bodies without a parent, in their order; one entry for each body, None for the others.
    xp : module
        NumPy, `jax.numpy` or `torch`.

    Returns
    -------
    (..., n, 4, 4) array, list of (..., 4, 4) or None
        Poses, and one frame for each joint.
    """
    shape = tuple(values.shape[:-1])
    constant = _constants(values, xp)
    all_values = values @ constant(tree.rates.T) + constant(tree.offsets)
    poses: list[Any] = [None] * len(tree.parents)
    frames: list[Any] = [None] * len(tree.joints)
    for i in tree.order:
        if tree.parents[i] < 0:
            poses[i] = xp.broadcast_to(constant(roots[i]), (*shape, 4, 4))
            continue
        pose = poses[tree.parents[i]]
        for j in tree.chains[i]:
            joint = tree.joints[j]
            pose = frames[j] = pose @ constant(joint.origin)
            if joint.moves:
                pose = pose @ _motion(joint, all_values[..., j], constant, xp)
        poses[i] = pose
    return xp.stack(poses, -3), frames


def _constants(values: Any, xp: Any) -> Any:
    """A function that makes constants of the type and on the device of some values."""
    if xp.__name__ == "torch":
        return lambda array: xp.tensor(np.array(array), dtype=values.dtype, device=values.device)
    return lambda array: xp.asarray(np.asarray(array), dtype=values.dtype)


def _motion(joint: Joint, value: Any, constant: Any, xp: Any) -> Any:
    """The motion of a joint by its values (...), as (..., 4, 4)."""
    x, y, z = np.asarray(joint.axis).tolist()
    value = value[..., None, None]
    matrix = np.zeros((4, 4))
    if joint.kind == "prismatic":
        matrix[:3, 3] = x, y, z
        return constant(np.eye(4)) + value * constant(matrix)
    # Rodrigues: R = I + sin(t) K + (1 - cos(t)) K^2, with K p = axis x p.
    matrix[:3, :3] = (0, -z, y), (z, 0, -x), (-y, x, 0)
    half = xp.sin(0.5 * value)
    return constant(np.eye(4)) + xp.sin(value) * constant(matrix) + 2 * half * half * constant(matrix @ matrix)


def jacobian(
    tree: Tree, frames: Sequence[Any], bodies: NDArray[np.int64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Derivative of the world positions of points that are fixed to bodies by the free joint values.

    A revolute joint with the axis a through o moves a point p by a x (p - o) per radian, a prismatic one by a.

    Parameters
    ----------
    tree : Tree
        Bodies and joints.
    frames : sequence of (..., 4, 4)
        Frames of the joints, from :func:`forward`.
    bodies : (..., k) int64
        Row of the body of each point; -1 for none.
    points : (..., k, 3) float64
        World positions.

    Returns
    -------
    (..., k, 3, m) float64
    """
    result = np.zeros((*points.shape, len(tree.free)))
    for j, joint in enumerate(tree.joints):
        if not joint.moves:
            continue
        frame = frames[j][..., None, :, :]
        axis = frame[..., :3, :3] @ np.asarray(joint.axis)
        if joint.kind == "revolute":
            change = np.cross(axis, points - frame[..., :3, 3])
        else:
            change = np.broadcast_to(axis, points.shape)
        moved = tree.above[bodies, j] & (bodies >= 0)
        result += np.where(moved[..., None], change, 0.0)[..., None] * tree.rates[j]
    return result
