"""Reference fields of whole trees of shapes in float64 NumPy.

:class:`Tree` builds a shape and a NumPy function side by side; the functions follow the definitions (the distance to a
profile turned or drawn out, the minimum, the fillet), not the core. :data:`trees` draws random ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

import fieldbake as fb
from fieldbake import _core


@dataclass(frozen=True)
class Tree:
    """A shape and the same field in NumPy, (n, 3) to (n,)."""

    shape: fb.Shape
    field: Callable[[np.ndarray], np.ndarray]
    text: str


def sphere(radius):
    return Tree(fb.sphere(radius), lambda p: np.linalg.norm(p, axis=1) - radius, f"sphere {radius}")


def box(size):
    half = np.asarray(size) / 2

    def field(p):
        q = np.abs(p) - half
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)

    return Tree(fb.box(size), field, f"box {size}")


def torus(radius, tube):
    def field(p):
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - radius, p[:, 2]) - tube

    return Tree(fb.torus(radius, tube), field, f"torus {radius} {tube}")


def cylinder(radius, height):
    def field(p):
        q = np.stack([np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(p[:, 2]) - height / 2], axis=-1)
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)

    return Tree(fb.cylinder(radius, height), field, f"cylinder {radius} {height}")


def capsule(radius, height):
    def field(p):
        z = p[:, 2] - p[:, 2].clip(-height / 2, height / 2)
        return np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + z**2) - radius

    return Tree(fb.capsule(radius, height), field, f"capsule {radius} {height}")


def ellipsoid(radii):
    """The nearest point is `x = r^2 p / (r^2 + t)`, on the surface; `t` is halved into place (D. Eberly)."""
    radii = np.asarray(radii, dtype=float)
    squares = radii**2
    shortest = squares.min()

    def field(p):
        inside = ((p / radii) ** 2).sum(axis=1) < 1
        # From the pole at the shortest radius, so that nothing cancels. In the plane of the pole that may be the root.
        low, high = np.zeros(len(p)), np.linalg.norm(radii * p, axis=1) + 1e-300
        for _ in range(200):
            middle = np.where(high < 1e-6, np.sqrt(np.maximum(low, 1e-40) * high), (low + high) / 2)
            total = ((radii * p / (squares - shortest + middle[:, None])) ** 2).sum(axis=1)
            low, high = np.where(total > 1, middle, low), np.where(total > 1, high, middle)
        nearest = squares * p / (squares - shortest + high[:, None])
        # In that plane the nearest point lies off it, as far as the surface has room.
        axis = squares.argmin()
        room = 1 - ((nearest / radii) ** 2).sum(axis=1) + (nearest[:, axis] / radii[axis]) ** 2
        is_pole = high < 1e-30
        nearest[is_pole, axis] = radii[axis] * np.sqrt(np.maximum(room[is_pole], 0))
        return np.where(inside, -1, 1) * np.linalg.norm(p - nearest, axis=1)

    return Tree(fb.ellipsoid(radii), field, f"ellipsoid {radii}")


def plane(normal):
    unit = np.asarray(normal) / np.linalg.norm(normal)
    return Tree(fb.plane(unit), lambda p: p @ unit, f"plane {unit}")


def _least(a, b, k, chamfer):
    if k > 0:
        h = np.maximum(k - np.abs(a - b), 0)
        return np.minimum(a, b) - h * h / (4 * k)
    if chamfer > 0:
        return np.minimum(np.minimum(a, b), (a + b - chamfer) / np.sqrt(2))
    return np.minimum(a, b)


def combine(op, trees, k=0.0, chamfer=0.0):
    def field(p):
        result = trees[0].field(p)
        for tree in trees[1:]:
            a, b = result, tree.field(p)
            if op == "union":
                result = _least(a, b, k, chamfer)
            elif op == "intersection":
                result = -_least(-a, -b, k, chamfer)
            elif op == "difference":
                result = -_least(-a, b, k, chamfer)
            else:
                either, both = _least(a, b, k, chamfer), -_least(-a, -b, k, chamfer)
                result = -_least(-either, both, k, chamfer)
        return result

    # The fields are joined, also where they are no distances; the joints of `Shape` would bake the distances there.
    shape = fb.Shape._wrap(_core.Shape.combine(op, [tree.shape._core for tree in trees], k, chamfer))
    inner = ", ".join(tree.text for tree in trees)
    return Tree(shape, field, f"{op} k={k} chamfer={chamfer} ({inner})")


def turn(axis, degrees):
    """Rotation matrix, by Rodrigues."""
    axis = np.asarray(axis) / np.linalg.norm(axis)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def placed(tree, offset, axis, degrees, factor):
    matrix = turn(axis, degrees)
    shape = tree.shape.scale(factor).rotate(axis, degrees).translate(offset)
    text = f"[{tree.text}] * {factor} rotated {axis} {degrees} moved {offset}"
    return Tree(shape, lambda p: tree.field((p - np.asarray(offset)) @ matrix / factor) * factor, text)


def offset(tree, distance):
    # The field is shifted, also where it is no distance; `Shape.offset` would bake the distance there.
    shape = tree.shape._changed("offset", distance)
    return Tree(shape, lambda p: tree.field(p) - distance, f"offset {distance} [{tree.text}]")


def shell(tree, thickness):
    field = lambda p: np.abs(tree.field(p)) - thickness / 2  # noqa: E731
    return Tree(tree.shape._changed("shell", thickness), field, f"shell {thickness} [{tree.text}]")


def mirror(tree, axis):
    flip = np.ones(3)
    flip[axis] = -1

    def field(p):
        return np.minimum(tree.field(p), tree.field(p * flip))

    return Tree(tree.shape.mirror("xyz"[axis]), field, f"mirror {axis} [{tree.text}]")


def elongate(tree, size):
    half = np.asarray(size) / 2
    return Tree(
        tree.shape.elongate(size), lambda p: tree.field(p - p.clip(-half, half)), f"elongate {size} [{tree.text}]"
    )


def twist(tree, degrees):
    lower, upper = tree.shape.bounds
    reach = 2 * np.hypot(*np.maximum(np.abs(lower), np.abs(upper))[:2])
    rate = np.radians(degrees)

    def field(p):
        angle = -rate * p[:, 2]
        x = np.cos(angle) * p[:, 0] - np.sin(angle) * p[:, 1]
        y = np.sin(angle) * p[:, 0] + np.cos(angle) * p[:, 1]
        stretch = 1 + abs(rate) * np.maximum(np.hypot(p[:, 0], p[:, 1]), reach)
        return tree.field(np.stack([x, y, p[:, 2]], axis=-1)) / stretch

    return Tree(tree.shape.twist(per_unit_deg=degrees), field, f"twist {degrees} [{tree.text}]")


# --- random trees

length = st.floats(0.2, 1.2).map(lambda x: round(x, 3))
shift = st.floats(-1.0, 1.0).map(lambda x: round(x, 3))

leaves = st.one_of(
    st.builds(sphere, length),
    st.builds(box, st.tuples(length, length, length)),
    st.builds(torus, st.floats(0.5, 1.0), st.floats(0.1, 0.4)),
    st.builds(cylinder, length, length),
    st.builds(capsule, st.floats(0.1, 0.5), length),
    st.builds(ellipsoid, st.tuples(length, length, length)),
)

moves = st.tuples(shift, shift, shift)
#: Mostly straight, sometimes askew.
turns = st.tuples(st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0.5)]), st.sampled_from([0, 90, 30, -45]))


@st.composite
def placed_leaves(draw):
    axis, degrees = draw(turns)
    return placed(draw(leaves), draw(moves), axis, degrees, draw(st.sampled_from([1.0, 0.7, 1.3])))


@st.composite
def joints(draw, children):
    op = draw(st.sampled_from(["union", "union", "intersection", "difference", "difference", "xor"]))
    kind = draw(st.sampled_from(["sharp", "sharp", "smooth", "chamfer"]))
    width = draw(st.floats(0.05, 0.5)) if kind != "sharp" else 0.0
    operands = draw(st.lists(children, min_size=2, max_size=3))
    return combine(op, operands, k=width * (kind == "smooth"), chamfer=width * (kind == "chamfer"))


@st.composite
def changes(draw, children):
    tree = draw(children)
    change = draw(st.sampled_from(["offset", "shell", "mirror", "elongate", "twist", "cut"]))
    if change == "offset":
        return offset(tree, draw(st.floats(-0.1, 0.2)))
    if change == "shell":
        return shell(tree, draw(st.floats(0.05, 0.2)))
    if change == "mirror":
        return mirror(tree, draw(st.integers(0, 2)))
    if change == "elongate":
        return elongate(tree, draw(st.tuples(st.floats(0, 0.6), st.floats(0, 0.6), st.floats(0, 0.6))))
    if change == "twist":
        return twist(tree, draw(st.floats(-60, 60)))
    normal = draw(st.sampled_from([(0, 0, 1), (1, 0, 0), (1, 2, -1)]))
    return combine("difference", [tree, plane(normal)])


#: Trees of up to about a dozen leaves, with every operator.
trees = st.recursive(
    placed_leaves(), lambda children: st.one_of(joints(children), joints(children), changes(children)), max_leaves=7
)
