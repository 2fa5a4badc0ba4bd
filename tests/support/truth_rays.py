"""Exact first hits of rays with solids in float64.

A ray changes sides only where it crosses the surface of a leaf. So the crossings of all leaves are sorted, the tree of
operators is evaluated by inequalities in the middle of each interval between two crossings, and the first interval that
is inside begins at the hit. No distance and no library code is involved. An interval shorter than :data:`SAME` is
skipped, because faces that coincide are crossed at places that differ by rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import fieldbake as fb
from fieldbake.shapes.shape import combine as combine_shapes
from truth_trees import turn

#: Crossings that are nearer to each other, world units, are one. Rounding is below 1e-12 where the sine of the angle
#: between ray and face is above 1e-3, and the models' features are 0.1 apart.
SAME = 1e-9

#: A pixel differs if its depth, world units, does by more. Pictures may erode a solid by 1e-6 of the frame's size, at
#: most 4 here (`ERODED` of src/csg/parts/chord.rs), and float32 rounds as much again: a face at an angle whose sine is
#: 0.01, which is what a pixel away from creases may show, moves in depth by 100 times 8e-6.
DEPTH_TOLERANCE = 1e-3

#: And its normal: differences of a float32 field over 1e-4 are good to some 6e-8 / 1e-4 times a few roundings.
NORMAL_TOLERANCE = 0.02

#: Neighbouring pixels are on two surfaces if one is so far off the other's tangent plane, world units, or if their
#: normals differ by so much. Steps of the models are 0.1 high; curved surfaces that are not edge-on bend away by less.
STEP = 0.02
BEND = 0.2


@dataclass(frozen=True)
class Leaf:
    """A primitive about the origin, moved rigidly: `world = turned @ leaf + moved`.

    `roots` are the crossings of lines with the planes, spheres, cylinders and cones that its faces lie on, (n, k), NaN
    where there is none.
    """

    roots: Callable[[np.ndarray, np.ndarray], np.ndarray]
    inside: Callable[[np.ndarray], np.ndarray]
    normal: Callable[[np.ndarray], np.ndarray]
    turned: np.ndarray
    moved: np.ndarray

    def local(self, points):
        return (points - self.moved) @ self.turned

    def crossings(self, origin, directions):
        """Where lines pass from one side of the leaf to the other, (n, k), inf where there is none."""
        start, along = np.broadcast_to(self.local(origin), directions.shape), directions @ self.turned
        t = np.sort(np.nan_to_num(self.roots(start, along), nan=np.inf), axis=1)
        last = np.where(np.isfinite(t), t, -np.inf).max(axis=1, keepdims=True)
        # Missing crossings lie behind the last one, 1 apart: the middle of an empty interval would be on the surface.
        behind = last + np.arange(1, t.shape[1] + 2)
        ends = np.concatenate([t[:, :1] - 1, np.where(np.isfinite(t), t, behind[:, :-1]), behind[:, -1:]], axis=1)
        ends = np.where(np.isfinite(ends), ends, 0)
        middle = (ends[:, 1:] + ends[:, :-1]) / 2
        is_inside = self.inside(start[:, None] + middle[..., None] * along[:, None])
        return np.where(is_inside[:, 1:] != is_inside[:, :-1], t, np.inf)


@dataclass(frozen=True)
class Node:
    """An operator over operands."""

    op: str
    operands: tuple

    def inside(self, points):
        result = inside(self.operands[0], points)
        for operand in self.operands[1:]:
            other = inside(operand, points)
            if self.op == "union":
                result |= other
            elif self.op == "intersection":
                result &= other
            elif self.op == "difference":
                result &= ~other
            else:
                result ^= other
        return result


@dataclass(frozen=True)
class Model:
    """A shape, and the same solid as a tree of :class:`Leaf` and :class:`Node`."""

    shape: fb.Shape
    tree: Leaf | Node
    text: str


def inside(tree, points):
    return tree.inside(points) if isinstance(tree, Node) else tree.inside(tree.local(points))


def leaves_of(tree):
    return [leaf for operand in tree.operands for leaf in leaves_of(operand)] if isinstance(tree, Node) else [tree]


# --- primitives


def _leaf(shape, roots, inside, normal, text):
    return Model(shape, Leaf(roots, inside, normal, np.eye(3), np.zeros(3)), text)


def _plane_roots(o, d, half):
    """Crossings of the planes at plus and minus `half` along an axis."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([(-half - o) / d, (half - o) / d], axis=-1)
    return np.where(np.isfinite(t), t, np.nan)


def _quadratic(a, b, c):
    """Roots of `a t^2 + 2 b t + c`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = -(b + np.copysign(np.sqrt(b * b - a * c), b))
        t = np.stack([far / a, c / far], axis=-1)
    return np.where(np.isfinite(t), t, np.nan)


def _nearest_side(distances, normals):
    """The normal of the side whose distance is nearest to zero; `distances` (n, k), `normals` k arrays (n, 3)."""
    nearest = np.abs(np.stack(distances, axis=-1)).argmin(axis=-1)
    return np.stack(np.broadcast_arrays(*normals), axis=1)[np.arange(len(nearest)), nearest]


def box(size):
    half = np.asarray(size, dtype=float) / 2

    def normal(p):
        axis = (np.abs(p) - half).argmax(axis=1)
        return np.eye(3)[axis] * np.sign(p[np.arange(len(p)), axis])[:, None]

    return _leaf(
        fb.box(tuple(size)),
        lambda o, d: np.concatenate([_plane_roots(o[:, i], d[:, i], half[i]) for i in range(3)], axis=1),
        lambda p: (np.abs(p) < half).all(axis=-1),
        normal,
        f"box{tuple(size)}",
    )


def sphere(radius):
    return _leaf(
        fb.sphere(radius),
        lambda o, d: _quadratic((d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - radius**2),
        lambda p: (p * p).sum(axis=-1) < radius**2,
        lambda p: p / np.linalg.norm(p, axis=1, keepdims=True),
        f"sphere({radius})",
    )


def _across(p):
    """Unit vectors away from the z axis."""
    flat = p * (1, 1, 0)
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)


def cylinder(radius, height):
    def roots(o, d):
        side = _quadratic((d[:, :2] ** 2).sum(1), (o[:, :2] * d[:, :2]).sum(1), (o[:, :2] ** 2).sum(1) - radius**2)
        return np.concatenate([side, _plane_roots(o[:, 2], d[:, 2], height / 2)], axis=1)

    def normal(p):
        distances = np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(p[:, 2]) - height / 2
        return _nearest_side(distances, (_across(p), np.sign(p[:, 2:]) * (0, 0, 1)))

    return _leaf(
        fb.cylinder(radius, height),
        roots,
        lambda p: (np.hypot(p[..., 0], p[..., 1]) < radius) & (np.abs(p[..., 2]) < height / 2),
        normal,
        f"cylinder({radius}, {height})",
    )


def cone(radius, height):
    """The base at the bottom, the tip on top."""
    slope = radius / height

    def room(p):
        return slope * (height / 2 - p[..., 2])

    def roots(o, d):
        r, s = room(o), -slope * d[:, 2]
        side = _quadratic(
            (d[:, :2] ** 2).sum(1) - s * s,
            (o[:, :2] * d[:, :2]).sum(1) - r * s,
            (o[:, :2] ** 2).sum(1) - r * r,
        )
        return np.concatenate([side, _plane_roots(o[:, 2], d[:, 2], height / 2)], axis=1)

    def normal(p):
        slant = (_across(p) + np.array([0, 0, slope])) / np.hypot(1, slope)
        return _nearest_side((np.hypot(p[:, 0], p[:, 1]) - room(p), p[:, 2] + height / 2), (slant, (0.0, 0.0, -1.0)))

    return _leaf(
        fb.cone(radius, height),
        roots,
        lambda p: (np.hypot(p[..., 0], p[..., 1]) < room(p)) & (np.abs(p[..., 2]) < height / 2),
        normal,
        f"cone({radius}, {height})",
    )


def torus(radius, tube):
    def roots(o, d):
        # (|p|^2 + R^2 - r^2)^2 = 4 R^2 (x^2 + y^2), about the place nearest to the middle; d is unit.
        shift = -(o * d).sum(1)
        o = o + shift[:, None] * d
        m, k = (o * o).sum(1) + radius**2 - tube**2, 4 * radius**2
        flat = [(a[:, :2] * b[:, :2]).sum(1) for a, b in ((d, d), (o, d), (o, o))]
        companion = np.zeros((len(o), 4, 4))
        companion[:, [1, 2, 3], [0, 1, 2]] = 1
        companion[:, :, 3] = -np.stack(
            [m * m - k * flat[2], -2 * k * flat[1], 2 * m - k * flat[0], np.zeros(len(o))], axis=-1
        )
        t = np.linalg.eigvals(companion)
        return np.where(np.abs(t.imag) < 1e-9, t.real + shift[:, None], np.nan)

    def normal(p):
        away = p - radius * _across(p)
        return away / np.linalg.norm(away, axis=1, keepdims=True)

    return _leaf(
        fb.torus(radius, tube),
        roots,
        lambda p: np.hypot(np.hypot(p[..., 0], p[..., 1]) - radius, p[..., 2]) < tube,
        normal,
        f"torus({radius}, {tube})",
    )


# --- trees


def combine(op, *models):
    shape = combine_shapes(op, [model.shape for model in models])
    sign = {"union": " | ", "intersection": " & ", "difference": " - ", "xor": " ^ "}[op]
    text = "(" + sign.join(model.text for model in models) + ")"
    return Model(shape, Node(op, tuple(model.tree for model in models)), text)


def _moved(tree, matrix, offset):
    if isinstance(tree, Node):
        return Node(tree.op, tuple(_moved(operand, matrix, offset) for operand in tree.operands))
    return replace(tree, turned=matrix @ tree.turned, moved=matrix @ tree.moved + offset)


def placed(model, offset=(0, 0, 0), axis=(0, 0, 1), degrees=0):
    """Turned, then moved."""
    shape, text, matrix = model.shape, model.text, np.eye(3)
    if degrees:
        shape, matrix = shape.rotate(axis, degrees), turn(axis, degrees)
        text += f".rotate({tuple(axis)}, {degrees})"
    if np.any(offset):
        shape = shape.translate(tuple(offset))
        text += f".translate({tuple(offset)})"
    return Model(shape, _moved(model.tree, matrix, np.asarray(offset, dtype=float)), text)


# --- pictures


@dataclass(frozen=True)
class Picture:
    """The hit of each pixel's ray: depth along the view (inf for a miss), unit normal, and if it can be compared."""

    depth: np.ndarray
    normal: np.ndarray
    is_smooth: np.ndarray


def _first_hits(tree, origin, directions):
    """Distance along each ray, inf for none, and the leaf that is crossed there."""
    leaves = leaves_of(tree)
    crossings = [leaf.crossings(origin, directions) for leaf in leaves]
    owners = [index for index, t in enumerate(crossings) for _ in range(t.shape[1])]
    t = np.concatenate(crossings, axis=1)
    t = np.where(t > 0, t, np.inf)
    order = np.argsort(t, axis=1)
    t, owners = np.take_along_axis(t, order, axis=1), np.asarray(owners)[order]
    ends = np.concatenate([t[:, 1:], np.full((len(t), 1), np.inf)], axis=1)
    is_stretch = np.isfinite(ends) & np.isfinite(t)
    is_stretch[is_stretch] = (ends - np.where(np.isfinite(t), t, 0))[is_stretch] > SAME
    middle = np.where(is_stretch, (np.where(is_stretch, t, 0) + np.where(is_stretch, ends, 0)) / 2, 0)
    is_inside = is_stretch & inside(tree, origin + middle[..., None] * directions[:, None])
    first = is_inside.argmax(axis=1)
    rows = np.arange(len(t))
    hit = is_inside.any(axis=1)
    return np.where(hit, t[rows, first], np.inf), owners[rows, first]


def picture(model, camera, size):
    """The exact picture of a model; the eye is outside."""
    width, height = size
    half = np.tan(np.radians(camera.fov_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * half * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * half
    along = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1).reshape(-1, 3)
    lengths = np.linalg.norm(along, axis=1)
    pose = np.asarray(camera.pose)
    directions = along / lengths[:, None] @ pose[:3, :3].T
    t, owners = _first_hits(model.tree, pose[:3, 3], directions)
    hit = np.isfinite(t)
    points = pose[:3, 3] + np.where(hit, t, 0)[:, None] * directions
    normals = np.zeros_like(points)
    for index, leaf in enumerate(leaves_of(model.tree)):
        own = hit & (owners == index)
        normals[own] = leaf.normal(leaf.local(points[own])) @ leaf.turned.T
    # A surface that is seen faces the ray, whichever of the leaves that share it was crossed.
    normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
    grid = lambda a: a.reshape(height, width, *a.shape[1:])  # noqa: E731
    return Picture(grid(t / lengths), grid(normals), ~_near_creases(grid(hit), grid(points), grid(normals)))


def _near_creases(hit, points, normals):
    """Pixels within 2 of a neighbour that is not on the same smooth surface."""
    crease = np.zeros(hit.shape, dtype=bool)
    for here, there in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        step = np.abs(((points[there] - points[here]) * normals[here]).sum(-1))
        bend = np.abs(normals[there] - normals[here]).max(axis=-1)
        is_apart = (hit[here] != hit[there]) | (hit[here] & hit[there] & ((step > STEP) | (bend > BEND)))
        crease[here] |= is_apart
        crease[there] |= is_apart
    padded = np.pad(crease, 2)
    rows, columns = hit.shape
    return np.any([padded[y : y + rows, x : x + columns] for y in range(5) for x in range(5)], axis=0)


def wrong_share(truth, frame):
    """Share of the pixels away from creases whose hit, depth or normal is not the truth's. NaN counts as wrong."""
    hit = np.isfinite(truth.depth)
    with np.errstate(invalid="ignore"):
        is_right = np.where(
            hit,
            (np.abs(frame.depth - truth.depth) <= DEPTH_TOLERANCE)
            & (np.abs(frame.normal - truth.normal).max(axis=-1) <= NORMAL_TOLERANCE),
            np.isposinf(frame.depth),
        )
    return float((~is_right & truth.is_smooth).sum()) / max(int(truth.is_smooth.sum()), 1)


# --- random models with faces that coincide


def _tenths(random, low, high, count):
    return [round(0.1 * int(n), 1) for n in random.integers(round(10 * low), round(10 * high) + 1, count)]


def _random_leaf(random, kinds, low=0.3, high=1.6):
    kind = kinds[random.integers(len(kinds))]
    a, b, c = _tenths(random, low, high, 3)
    if kind == "box":
        leaf = box((a, b, c))
    elif kind == "sphere":
        leaf = sphere(round(a / 2, 2))
    elif kind == "cylinder":
        leaf = cylinder(round(a / 2, 2), b)
    elif kind == "cone":
        leaf = cone(round(a / 2, 2), b)
    else:
        leaf = torus(round(0.2 + a / 3, 1), 0.1)
    axis = np.eye(3, dtype=int)[random.integers(3)]
    degrees = int(random.choice([0, 0, 0, 90])) if kind != "sphere" else 0
    return placed(leaf, _tenths(random, -0.6, 0.6, 3), axis.tolist(), degrees)


def random_model(seed, kinds=("box", "box", "box", "sphere", "cylinder"), ops=("union", "intersection", "nested")):
    """Sizes and offsets on a grid of 0.1, so that many faces coincide; one in three is turned as a whole."""
    random = np.random.default_rng(seed)
    leaf = lambda **sizes: _random_leaf(random, kinds, **sizes)  # noqa: E731

    def cut():
        cuts = [leaf(low=0.2, high=1.2) for _ in range(random.integers(1, 3))]
        return combine("difference", leaf(low=0.6), *cuts)

    kind = ops[seed % len(ops)]
    if kind == "union":
        model = combine("union", *(placed(cut(), _tenths(random, -1, 1, 3)) for _ in range(random.integers(2, 4))))
    elif kind == "intersection":
        model = combine("union", combine("intersection", cut(), leaf(low=0.8)), cut())
    else:
        inner = combine("difference", leaf(low=0.6), combine("difference", leaf(low=0.4), leaf(low=0.2, high=0.8)))
        model = combine("difference", combine("union", inner, leaf()), combine("union", leaf(high=0.9), leaf(high=0.9)))
    if random.integers(3) == 0:
        model = placed(model, (0.1, -0.2, 0.3), (1, 2, -1), 37)
    return model


def random_camera(model, seed):
    """Some side of it, never along an axis."""
    direction = np.random.default_rng(seed + 1000).normal(size=3)
    direction /= np.linalg.norm(direction)
    return fb.Camera.fit(model.shape.bounds, direction=tuple(direction + 0.013), up=(0.3, 0.9, 0.2))
