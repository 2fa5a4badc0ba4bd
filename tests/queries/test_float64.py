"""Distances in float64, against 50 digits."""

import itertools
import math
import time

import numpy as np
import pytest
from mpmath import mp

import fieldbake as fb
import meshes
import truth
import truth_exact as exact

ZOO = {**meshes.CLOSED, **meshes.OPEN}
OFFSETS = [0.0, 1e6]

HALF, ONE, TWO = mp.mpf(1) / 2, mp.mpf(1), mp.mpf(2)
SLANTED = exact.vector((1, 2, -2))
CORNERS = [(0.5, -0.5), (1.0, 0.25), (-0.25, 1.0)]


def bound(distances, points, vertices=0.0):
    """The promise: 1e-12 of the distance and 1e-15 of the coordinates of the point and of the mesh."""
    return 1e-12 * np.abs(distances) + 1e-15 * np.maximum(np.abs(points).max(axis=1), np.abs(vertices).max())


def square_pyramid(p):
    base = exact.exact([(-1, -1, -0.75), (1, -1, -0.75), (1, 1, -0.75), (-1, 1, -0.75)])
    top = (mp.mpf(0), mp.mpf(0), mp.mpf("0.75"))
    a, b, c, d = base
    return exact.hull(p, [*exact.quads((a, d, c, b)), (a, b, top), (b, c, top), (c, d, top), (d, a, top)])


def eight_faces(p):
    faces = []
    for signs in itertools.product((1, -1), repeat=3):
        a, b, c = (tuple(sign * ONE if i == axis else mp.mpf(0) for i in range(3)) for axis, sign in enumerate(signs))
        faces.append((a, b, c) if math.prod(signs) > 0 else (a, c, b))
    return exact.hull(p, faces)


def six_sides(p):
    ring = [(mp.cos(mp.pi * k / 3), mp.sin(mp.pi * k / 3)) for k in range(6)]
    return prism(exact.polygon(p[0], p[1], ring), p[2], HALF)


def prism(flat, z, half):
    q = [flat, abs(z) - half]
    return exact.length(*(max(c, mp.mpf(0)) for c in q)) + min(max(q), mp.mpf(0))


def frame(p):
    bar, half = mp.mpf(0.125), [ONE, mp.mpf(0.75), HALF]
    bars = []
    for axis in range(3):
        at = [abs(c) - (h - bar) for c, h in zip(p, half, strict=True)]
        at[axis] = p[axis]
        bars.append(exact.box(*at, [half[i] if i == axis else bar for i in range(3)]))
    return min(bars)


def capped(p):
    half = mp.pi / 4
    x, y, z = p[0], abs(p[1]), p[2]
    ring = exact.length(exact.length(x, y) - 1, z)
    end = exact.length(x - mp.cos(half), y - mp.sin(half), z)
    return (ring if mp.atan2(y, x) <= half else end) - mp.mpf(0.25)


def two_balls(p):
    """The envelope of the balls about the points of the segment between the two centres."""
    r, z = exact.length(p[0], p[1]), p[2]
    low, high, height = mp.mpf(0.75), mp.mpf(0.25), mp.mpf(1.5)
    base = -height / 2
    sine = (low - high) / height
    cosine = mp.sqrt(1 - sine**2)
    along = ((z - base) * cosine - r * sine) / (height * cosine)
    share = max(mp.mpf(0), min(ONE, along))
    return exact.length(r, z - base - share * height) - (low + share * (high - low))


def periodic(level, slope):
    scale = 2 * mp.pi
    return lambda p: abs(level(*(scale * c for c in p))) / (slope * scale) - mp.mpf(0.1) / 2


def cone_section(low, high, half):
    top = [(high, half), (-high, half)] if high else [(0, half)]
    return exact.turned(exact.exact([(-low, -half), (low, -half), *top]))


SHAPES = {
    "sphere": (fb.sphere(0.75), lambda p: exact.length(*p) - mp.mpf(0.75)),
    "ellipsoid": (fb.ellipsoid((1.0, 0.75, 0.25)), lambda p: exact.ellipsoid(*p, exact.vector((1, 0.75, 0.25)))),
    "flat ellipsoid": (fb.ellipsoid((1.0, 1.0, 0.125)), lambda p: exact.ellipsoid(*p, exact.vector((1, 1, 0.125)))),
    "box": (fb.box((2, 1, 0.5)), lambda p: exact.box(*p, (ONE, HALF, HALF / 2))),
    "rounded box": (
        fb.rounded_box((2, 1, 0.5), 0.125),
        lambda p: exact.box(*p, (ONE - HALF / 4, HALF - HALF / 4, HALF / 2 - HALF / 4)) - HALF / 4,
    ),
    "frame": (fb.box_frame((2, 1.5, 1), 0.25), frame),
    "torus": (fb.torus(1.0, 0.25), lambda p: exact.length(exact.length(p[0], p[1]) - 1, p[2]) - mp.mpf(0.25)),
    "capped torus": (fb.capped_torus(1.0, 0.25, 90), capped),
    "cylinder": (fb.cylinder(0.75, 1.0), lambda p: prism(exact.length(p[0], p[1]) - mp.mpf(0.75), p[2], HALF)),
    "rounded cylinder": (
        fb.rounded_cylinder(0.75, 1.0, 0.125),
        lambda p: prism(exact.length(p[0], p[1]) - mp.mpf(0.625), p[2], HALF - HALF / 4) - HALF / 4,
    ),
    "capsule": (
        fb.capsule(0.5, 1.0),
        lambda p: exact.segment(list(p), exact.vector((0, 0, -0.5)), exact.vector((0, 0, 0.5))) - HALF,
    ),
    "cone": (fb.cone(0.75, 1.5), lambda p: cone_section(0.75, 0, 0.75)(*p)),
    "truncated cone": (fb.truncated_cone(0.75, 0.25, 1.5), lambda p: cone_section(0.75, 0.25, 0.75)(*p)),
    "rounded cone": (fb.rounded_cone(0.75, 0.25, 1.5), two_balls),
    "plane": (fb.plane((1, 2, -2), 0.25), lambda p: exact.dot(p, SLANTED) / 3 - mp.mpf(0.25)),
    "slab": (fb.slab(0.5, (1, 2, -2)), lambda p: abs(exact.dot(p, SLANTED)) / 3 - mp.mpf(0.25)),
    "pyramid": (fb.pyramid(2.0, 1.5), square_pyramid),
    "octahedron": (fb.octahedron(1.0), eight_faces),
    "hex prism": (fb.hex_prism(1.0, 1.0), six_sides),
    "gyroid": (
        fb.gyroid(1.0, 0.1),
        periodic(lambda x, y, z: mp.sin(x) * mp.cos(y) + mp.sin(y) * mp.cos(z) + mp.sin(z) * mp.cos(x), mp.sqrt(3)),
    ),
    "extruded": (
        fb.extrude(fb.polygon(CORNERS), 1.0),
        lambda p: prism(exact.polygon(p[0], p[1], exact.exact(CORNERS)), p[2], HALF),
    ),
    "revolved": (
        fb.revolve(fb.circle(0.25), 0.75),
        lambda p: exact.length(exact.length(p[0], p[1]) - mp.mpf(0.75), p[2]) - mp.mpf(0.25),
    ),
    "smooth union": (
        fb.sphere(0.5) | fb.sphere(0.5).translate((0.5, 0, 0)),
        lambda p: min(exact.length(*p), exact.length(p[0] - HALF, p[1], p[2])) - HALF,
    ),
}


def points_of(shape, offset):
    """Random points, half of them moved near the surface."""
    random = np.random.default_rng(5)
    points = random.uniform(-1.5, 1.5, (100, 3))
    step = shape.distance(points, dtype="float64")[:, None] * shape.gradient(points)
    points[::2] -= (step * random.uniform(0.9, 1.1, (100, 1)))[::2]
    return points + offset


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("name", SHAPES)
def test_primitives_equal_fifty_digits(name, offset):
    shape, field = SHAPES[name]
    points = points_of(shape, offset)

    found = shape.translate((offset,) * 3).distance(points, dtype="float64")

    expected = np.array([float(field([mp.mpf(float(c)) - mp.mpf(offset) for c in p])) for p in points])
    assert found.dtype == np.float64
    assert (np.abs(found - expected) <= bound(expected, points)).all(), np.abs(found - expected).max()


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("name", ["soup", "needle_fan", "icosphere"])
def test_meshes_equal_fifty_digits(name, offset, device):
    geometry = ZOO[name]()
    mesh = fb.Mesh(geometry.vertices + offset, geometry.faces)
    points = meshes.points_around(geometry, 200) + offset
    points[::2] = fb.closest_point(mesh, points[::2]).points + 1e-9

    found = fb.signed_distance(mesh, points, dtype="float64", device=device)

    # The nearest face is among those that float64 brute force finds near enough.
    corners = truth.corners(mesh.vertices, mesh.faces)
    expected = []
    for point in points:
        distances = truth.distance_to_triangle(point, *corners.transpose(1, 0, 2))
        near = np.flatnonzero(distances <= distances.min() + 1e-14 * (1 + offset))
        p = exact.vector(point)
        expected.append(min(float(exact.triangle(p, [exact.vector(c) for c in corners[face]])) for face in near))
    expected = np.array(expected)
    error = np.abs(np.abs(found) - expected)
    assert found.dtype == np.float64
    assert (error <= bound(expected, points, mesh.vertices)).all(), error.max()


@pytest.mark.parametrize("sign", ["auto", "parity", "pseudonormal", "normal", "unsigned"])
@pytest.mark.parametrize("name", ["knot", "open_box", "soup"])
def test_signs_are_those_of_float32(name, sign):
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, 3000)

    single = fb.signed_distance(geometry, points, sign=sign)
    double = fb.signed_distance(geometry, points, sign=sign, dtype="float64")

    assert (np.signbit(single) == np.signbit(double)).all()
    assert np.abs(single - double).max() <= 1e-6 * truth.diagonal(*geometry)


def test_a_grid_has_the_distances_of_its_points(device):
    vertices, faces = ZOO["knot"]()
    box = (-2, -2, -1), (2, 2.5, 1), (12, 10, 9)

    single = fb.arrays.bake(vertices, faces, *box, device=device)
    double = fb.arrays.bake(vertices, faces, *box, dtype="float64", device=device)

    points = truth.grid_points(*box).reshape(-1, 3)
    expected = fb.signed_distance((vertices, faces), points, dtype="float64")
    assert double.dtype == np.float64
    assert double.flags.f_contiguous
    assert np.array_equal(double.ravel(), expected)
    assert np.array_equal(np.signbit(single), np.signbit(double))


def test_a_shape_with_a_baked_leaf_and_unknown_types_are_refused():
    baked = fb.volume_shape(fb.bake(fb.sphere(), 16)) | fb.box()
    with pytest.raises(fb.ShapeError, match='dtype: "float64" does not apply to a shape with a volume_shape'):
        baked.distance([(0, 0, 0)], dtype="float64")
    tetrahedron = meshes.tetrahedron()
    for call in (
        lambda dtype: fb.sphere().distance([(0, 0, 0)], dtype=dtype),
        lambda dtype: fb.signed_distance(tetrahedron, [(0, 0, 0)], dtype=dtype),
        lambda dtype: fb.arrays.bake(*tetrahedron, (0, 0, 0), (1, 1, 1), (2, 2, 2), dtype=dtype),
    ):
        for wrong in ("float16", np.float64, None):
            with pytest.raises(fb.ArgumentError, match='dtype: must be one of "float32", "float64"'):
                call(wrong)


@pytest.mark.slow
def test_float64_takes_little_longer():
    mesh = fb.models.torus_knot()
    points = np.random.default_rng(1).uniform(*mesh.bounds, (100_000, 3))
    ratios = []
    for _ in range(5):
        times = []
        for dtype in ("float32", "float64"):
            start = time.process_time()
            fb.signed_distance(mesh, points, dtype=dtype, device="cpu")
            times.append(time.process_time() - start)
        ratios.append(times[1] / times[0])
    assert np.median(ratios) <= 1.3
