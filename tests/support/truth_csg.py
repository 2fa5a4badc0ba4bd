"""Reference results for the primitives of shapes in float64 NumPy, without a distance formula.

:data:`SOLIDS` describes each primitive by inequalities for its inside and by points on its surface.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import fieldbake as fb


@dataclass(frozen=True)
class Solid:
    """A primitive: the shape, a test for its inside, and points no farther than `gap` from any point of its surface."""

    name: str
    shape: fb.Shape
    inside: Callable[[np.ndarray], np.ndarray]
    surface: np.ndarray
    gap: float


#: Steps of a parameter over a side or a circle.
STEPS = 220


def _patch(function, u_range, v_range, steps=STEPS):
    """Points of a parametric patch, and the largest distance from a point of it to the nearest of them."""
    u, v = np.meshgrid(np.linspace(*u_range, steps), np.linspace(*v_range, steps), indexing="ij")
    points = np.stack(np.broadcast_arrays(*function(u, v)), axis=-1)
    # Half the longer diagonal of a cell covers it, curved cells being flatter than they are wide.
    across = np.linalg.norm(points[1:, 1:] - points[:-1, :-1], axis=-1)
    along = np.linalg.norm(points[1:, :-1] - points[:-1, 1:], axis=-1)
    return points.reshape(-1, 3), float(max(across.max(), along.max())) / 2 * 1.01


def _join(*patches):
    return np.concatenate([points for points, _ in patches]), max(gap for _, gap in patches)


def _turned(radius_of, height_of, t_range):
    """The surface of a curve (radius, z) turned about z."""
    return _patch(
        lambda t, a: (radius_of(t) * np.cos(a), radius_of(t) * np.sin(a), height_of(t)), t_range, (0, 2 * np.pi)
    )


def _side(corner, edge_u, edge_v):
    corner, edge_u, edge_v = (np.asarray(x, dtype=float) for x in (corner, edge_u, edge_v))
    return _patch(
        lambda u, v: np.moveaxis(corner + u[..., None] * edge_u + v[..., None] * edge_v, -1, 0), (0, 1), (0, 1)
    )


def _triangle(a, b, c):
    a, b, c = (np.asarray(x, dtype=float) for x in (a, b, c))
    points = lambda u, v: np.moveaxis(a + u[..., None] * ((b - a) + v[..., None] * (c - b)), -1, 0)  # noqa: E731
    return _patch(points, (0, 1), (0, 1))


def _box_sides(half):
    lower = -np.asarray(half, dtype=float)
    sides = []
    for u, v, w in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        edge_u, edge_v, out = np.zeros((3, 3))
        edge_u[u], edge_v[v], out[w] = 2 * half[u], 2 * half[v], 2 * half[w]
        sides += [_side(lower, edge_u, edge_v), _side(lower + out, edge_u, edge_v)]
    return _join(*sides)


def _hexagon(radius):
    angles = np.radians([0, 60, 120, 180, 240, 300])
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _prism(corners, half_height):
    """Sides and caps over a star-shaped polygon about the origin."""
    ends = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    sides = [_side((*a, -half_height), (*(b - a), 0), (0, 0, 2 * half_height)) for a, b in ends]
    caps = [_triangle((0, 0, z), (*a, z), (*b, z)) for a, b in ends for z in (-half_height, half_height)]
    return _join(*sides, *caps)


def _in_polygon(x, y, corners):
    inside = np.zeros(np.shape(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spans = (y0 > y) != (y1 > y)
        at = x0 + (y - y0) * (x1 - x0) / (y1 - y0 if y1 != y0 else 1.0)
        inside ^= spans & (x < at)
    return inside


def _capped_torus_surface(radius, tube, half_angle):
    ring = _patch(
        lambda a, b: (
            (radius + tube * np.cos(b)) * np.cos(a),
            (radius + tube * np.cos(b)) * np.sin(a),
            tube * np.sin(b),
        ),
        (-half_angle, half_angle),
        (0, 2 * np.pi),
    )
    ends = []
    for sign in (-1, 1):
        end = radius * np.array([np.cos(half_angle), sign * np.sin(half_angle), 0])
        ahead = np.array([-np.sin(half_angle), sign * np.cos(half_angle), 0])
        points, gap = _turned(lambda t: tube * np.sin(t), lambda t: tube * np.cos(t), (0, np.pi))
        ends.append(((points + end)[points @ ahead >= -gap], gap))
    return _join(ring, *ends)


def _solids():
    r = lambda p: np.hypot(p[:, 0], p[:, 1])  # noqa: E731
    low = lambda p, size: (np.abs(p) <= size).all(axis=1)  # noqa: E731
    z = lambda p: p[:, 2]  # noqa: E731
    half_circle = (0, np.pi)

    yield (
        "sphere",
        fb.sphere(0.8),
        lambda p: np.linalg.norm(p, axis=1) <= 0.8,
        _turned(lambda t: 0.8 * np.sin(t), lambda t: 0.8 * np.cos(t), half_circle),
    )
    radii = np.array([1.0, 0.5, 0.7])
    yield (
        "ellipsoid",
        fb.ellipsoid(radii),
        lambda p: np.linalg.norm(p / radii, axis=1) <= 1,
        _patch(
            lambda t, a: (radii[0] * np.sin(t) * np.cos(a), radii[1] * np.sin(t) * np.sin(a), radii[2] * np.cos(t)),
            half_circle,
            (0, 2 * np.pi),
        ),
    )
    half = np.array([0.9, 0.6, 0.4])
    yield "box", fb.box(2 * half), lambda p: low(p, half), _box_sides(half)
    yield (
        "torus",
        fb.torus(0.8, 0.3),
        lambda p: np.hypot(r(p) - 0.8, z(p)) <= 0.3,
        _turned(lambda t: 0.8 + 0.3 * np.cos(t), lambda t: 0.3 * np.sin(t), (0, 2 * np.pi)),
    )
    angle = np.radians(75)

    def in_arc(p):
        at = np.arctan2(p[:, 1], p[:, 0]).clip(-angle, angle)
        return np.linalg.norm(p - 0.8 * np.stack([np.cos(at), np.sin(at), 0 * at], axis=-1), axis=1) <= 0.25

    yield "capped_torus", fb.capped_torus(0.8, 0.25, 150), in_arc, _capped_torus_surface(0.8, 0.25, angle)
    yield (
        "cylinder",
        fb.cylinder(0.6, 1.4),
        lambda p: (r(p) <= 0.6) & (np.abs(z(p)) <= 0.7),
        _join(
            _turned(lambda t: 0.6 + 0 * t, lambda t: t, (-0.7, 0.7)),
            _turned(lambda t: t, lambda t: 0.7 + 0 * t, (0, 0.6)),
            _turned(lambda t: t, lambda t: -0.7 + 0 * t, (0, 0.6)),
        ),
    )
    yield (
        "rounded_cylinder",
        fb.rounded_cylinder(0.7, 1.2, 0.2),
        lambda p: np.hypot((r(p) - 0.5).clip(0), (np.abs(z(p)) - 0.4).clip(0)) <= 0.2,
        _join(
            _turned(lambda t: 0.7 + 0 * t, lambda t: t, (-0.4, 0.4)),
            *(_turned(lambda t: t, lambda t, end=end: end + 0 * t, (0, 0.5)) for end in (-0.6, 0.6)),
            *(
                _turned(lambda t: 0.5 + 0.2 * np.cos(t), lambda t, up=up: up * (0.4 + 0.2 * np.sin(t)), (0, np.pi / 2))
                for up in (-1, 1)
            ),
        ),
    )

    def in_capsule(p):
        return np.hypot(r(p), z(p) - z(p).clip(-0.5, 0.5)) <= 0.4

    yield (
        "capsule",
        fb.capsule(0.4, 1.0),
        in_capsule,
        _turned(lambda t: 0.4 * np.sin(t), lambda t: 0.4 * np.cos(t) + 0.5 * np.sign(np.cos(t)), half_circle),
    )
    yield (
        "cone",
        fb.cone(0.7, 1.6),
        lambda p: (np.abs(z(p)) <= 0.8) & (r(p) <= 0.7 * (0.8 - z(p)) / 1.6),
        _join(
            _turned(lambda t: 0.7 * (1 - t), lambda t: -0.8 + 1.6 * t, (0, 1)),
            _turned(lambda t: t, lambda t: -0.8 + 0 * t, (0, 0.7)),
        ),
    )
    yield (
        "truncated_cone",
        fb.truncated_cone(0.4, 0.8, 1.2),
        lambda p: (np.abs(z(p)) <= 0.6) & (r(p) <= 0.6 + 0.4 * z(p) / 1.2),
        _join(
            _turned(lambda t: 0.4 + 0.4 * t, lambda t: -0.6 + 1.2 * t, (0, 1)),
            _turned(lambda t: t, lambda t: -0.6 + 0 * t, (0, 0.4)),
            _turned(lambda t: t, lambda t: 0.6 + 0 * t, (0, 0.8)),
        ),
    )
    sin, cos = 0.3, np.sqrt(1 - 0.3**2)

    def in_rounded_cone(p):
        # The hull is the union of the balls between the ends; the depth in them is a concave quadratic of the position.
        t = ((0.6 * -0.3 + (z(p) + 0.5)) / (1 - 0.3**2)).clip(0, 1)
        return (0.6 - 0.3 * t) ** 2 - r(p) ** 2 - (z(p) + 0.5 - t) ** 2 >= 0

    yield (
        "rounded_cone",
        fb.rounded_cone(0.6, 0.3, 1.0),
        in_rounded_cone,
        _join(
            _turned(lambda t: 0.6 * np.sin(t), lambda t: -0.5 - 0.6 * np.cos(t), (0, np.pi / 2 + np.arcsin(sin))),
            _turned(lambda t: 0.3 * np.sin(t), lambda t: 0.5 + 0.3 * np.cos(t), (0, np.pi / 2 - np.arcsin(sin))),
            _turned(lambda t: (0.6 - 0.3 * t) * cos, lambda t: -0.5 + t + (0.6 - 0.3 * t) * sin, (0, 1)),
        ),
    )
    base = np.array([(0.7, 0.7), (-0.7, 0.7), (-0.7, -0.7), (0.7, -0.7)])
    edges = list(zip(base, np.roll(base, -1, axis=0), strict=True))
    yield (
        "pyramid",
        fb.pyramid(1.4, 1.2),
        lambda p: (z(p) >= -0.6) & (np.abs(p[:, :2]).max(axis=1) <= 0.7 * (0.6 - z(p)) / 1.2),
        _join(
            *(_triangle((0, 0, 0.6), (*a, -0.6), (*b, -0.6)) for a, b in edges),
            _side((-0.7, -0.7, -0.6), (1.4, 0, 0), (0, 1.4, 0)),
        ),
    )
    signs = [(x, y, s) for x in (-1, 1) for y in (-1, 1) for s in (-1, 1)]
    yield (
        "octahedron",
        fb.octahedron(0.9),
        lambda p: np.abs(p).sum(axis=1) <= 0.9,
        _join(*(_triangle((0.9 * x, 0, 0), (0, 0.9 * y, 0), (0, 0, 0.9 * s)) for x, y, s in signs)),
    )
    hexagon = _hexagon(0.8)
    yield (
        "hex_prism",
        fb.hex_prism(0.8, 0.9),
        lambda p: _in_polygon(p[:, 0], p[:, 1], hexagon) & (np.abs(z(p)) <= 0.45),
        _prism(hexagon, 0.45),
    )
    arrow = np.array([(0.8, 0.1), (0.1, 0.7), (-0.6, 0.5), (-0.2, 0.05), (-0.7, -0.5), (0.2, -0.6)])
    yield (
        "extruded polygon",
        fb.polygon(arrow).extrude(0.8),
        lambda p: _in_polygon(p[:, 0], p[:, 1], arrow) & (np.abs(z(p)) <= 0.4),
        _prism(arrow, 0.4),
    )
    ring = np.array([(0.3, -0.4), (0.8, -0.3), (0.6, 0.1), (0.9, 0.5), (0.4, 0.4)])
    yield (
        "revolved polygon",
        fb.polygon(ring).revolve(),
        lambda p: _in_polygon(r(p), z(p), ring),
        _join(
            *(
                _turned(lambda t, a=a, b=b: a[0] + t * (b - a)[0], lambda t, a=a, b=b: a[1] + t * (b - a)[1], (0, 1))
                for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)
            )
        ),
    )
    yield (
        "revolved circle",
        fb.circle(0.3).revolve(0.6),
        lambda p: np.hypot(r(p) - 0.6, z(p)) <= 0.3,
        _turned(lambda t: 0.6 + 0.3 * np.cos(t), lambda t: 0.3 * np.sin(t), (0, 2 * np.pi)),
    )
    yield (
        "extruded rectangle",
        fb.rectangle((1.2, 0.8)).extrude(0.6),
        lambda p: low(p, (0.6, 0.4, 0.3)),
        _box_sides((0.6, 0.4, 0.3)),
    )

    outer, hole = (
        np.array([(-1, -0.8), (0.9, -0.8), (0.9, 0.7), (-1, 0.7)]),
        np.array([(-0.5, -0.4), (0.5, -0.4), (0, 0.3)]),
    )
    walls = [_side((*a, -0.3), (*(b - a), 0), (0, 0, 0.6)) for loop in (outer, hole) for a, b in _edges(loop)]
    # The triangle between the hole and the outer corners, in pieces that meet at the corners of both.
    strips = [(outer[0], outer[1], hole[0]), (outer[1], hole[1], hole[0]), (outer[1], outer[2], hole[1])]
    strips += [(outer[2], hole[2], hole[1]), (outer[2], outer[3], hole[2]), (outer[3], outer[0], hole[2])]
    strips += [(outer[0], hole[0], hole[2])]
    ends = [_triangle(*((*corner, end) for corner in strip)) for strip in strips for end in (-0.3, 0.3)]
    yield (
        "extruded polygon with a hole",
        fb.polygon([outer, hole]).extrude(0.6),
        lambda p: _in_polygon(p[:, 0], p[:, 1], outer) & ~_in_polygon(p[:, 0], p[:, 1], hole) & (np.abs(z(p)) <= 0.3),
        _join(*walls, *ends),
    )
    slope, bottom, top = (
        np.tan(np.radians(20)),
        np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]),
        1 - np.tan(np.radians(20)),
    )
    faces = [(*_lifted(bottom, -0.5), *_lifted(top * bottom, 0.5))]
    yield (
        "tapered rectangle",
        fb.rectangle((2, 2)).extrude(1, taper_deg=20),
        lambda p: (np.abs(p[:, :2]).max(axis=1) <= 1 - (z(p) + 0.5) * slope) & (np.abs(z(p)) <= 0.5),
        _join(
            *(_triangle(c[i], c[(i + 1) % 4], c[4 + i]) for c in faces for i in range(4)),
            *(_triangle(c[(i + 1) % 4], c[4 + (i + 1) % 4], c[4 + i]) for c in faces for i in range(4)),
            *(_triangle(c[j], c[j + 1], c[j + 2]) for c in faces for j in (0, 4)),
            *(_triangle(c[j], c[j + 2], c[j + 3]) for c in faces for j in (0, 4)),
        ),
    )
    yield ("thread", fb.thread(2, 0.4, 1.0), _in_thread, _thread_surface())


def _edges(corners):
    return zip(corners, np.roll(corners, -1, axis=0), strict=True)


def _lifted(corners, height):
    return [(*corner, height) for corner in corners]


#: Corners (r, u) of a period of the thread: ISO 68-1 with the major radius 1 and the pitch 0.4.
THREAD = np.array(
    [
        (1, -0.025),
        (1, 0.025),
        (1 - 0.625 * np.sqrt(0.75) * 0.4, 0.15),
        (1 - 0.625 * np.sqrt(0.75) * 0.4, 0.25),
        (1, 0.375),
    ]
)


def _in_thread(p):
    u = p[:, 2] - 0.4 * np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi)
    limit = np.interp((u + 0.025) % 0.4 - 0.025, THREAD[:, 1], THREAD[:, 0])
    return (np.hypot(p[:, 0], p[:, 1]) <= limit) & (np.abs(p[:, 2]) <= 0.5)


def _thread_surface():
    def strip(a, b):
        points, gap = _patch(
            lambda t, angle: (
                (a[0] + t * (b - a)[0]) * np.cos(angle),
                (a[0] + t * (b - a)[0]) * np.sin(angle),
                a[1] + t * (b - a)[1] + 0.4 * angle / (2 * np.pi),
            ),
            (0, 1),
            (-6 * np.pi, 6 * np.pi),
            900,
        )
        return points[np.abs(points[:, 2]) <= 0.5], gap

    def cap(height):
        def at(share, angle):
            u = height - 0.4 * angle / (2 * np.pi)
            limit = np.interp((u + 0.025) % 0.4 - 0.025, THREAD[:, 1], THREAD[:, 0])
            return share * limit * np.cos(angle), share * limit * np.sin(angle), 0 * angle + height

        return _patch(at, (0, 1), (-np.pi, np.pi))

    return _join(*(strip(a, b) for a, b in itertools.pairwise(THREAD)), cap(-0.5), cap(0.5))


def _frame_solid():
    """Twelve bars: inside the box and in no more than one of the three windows' ranges."""
    half, bar = np.array([0.9, 0.7, 0.6]), 0.2

    def inside(p):
        near = np.abs(p) >= half - bar
        return (np.abs(p) <= half).all(axis=1) & (near.sum(axis=1) >= 2)

    return "box_frame", fb.box_frame(2 * half, bar), inside


def _rounded_solid():
    half, radius = np.array([0.8, 0.6, 0.5]), 0.2
    inner = half - radius

    def inside(p):
        return np.linalg.norm(np.abs(p) - np.abs(p).clip(max=inner), axis=1) <= radius

    return "rounded_box", fb.rounded_box(2 * half, radius), inside


#: Every bounded primitive with points on its surface.
SOLIDS = [Solid(name, shape, inside, *surface) for name, shape, inside, surface in _solids()]

#: Primitives that are checked by their inside alone.
MEMBERSHIPS = [_frame_solid(), _rounded_solid()]
