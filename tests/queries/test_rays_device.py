"""Rays on a graphics device: the bits of the CPU, whose hits `test_rays.py` compares with brute force."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

ZOO = {**meshes.CLOSED, **meshes.OPEN}
FUNCTIONS = [fb.cast_rays, fb.occluded, fb.count_intersections, fb.all_intersections]
PLACES = [(1, 0), (1, 1e4), (1e-3, 0), (1e3, 0)]


def assert_same_bits(mesh, origins, directions, gpu, **limits):
    """Compare the results of all functions on a device with the results of the CPU; return the first hits."""
    mesh = mesh if isinstance(mesh, fb.Mesh) else fb.Mesh(*mesh)
    for function in FUNCTIONS:
        found = function(mesh, origins, directions, device=gpu, **limits)
        expected = function(mesh, origins, directions, device="cpu", **limits)
        pairs = zip(found, expected, strict=True) if isinstance(found, tuple) else [(found, expected)]
        for one, other in pairs:
            assert one.dtype == other.dtype
            assert one.shape == other.shape
            assert one.tobytes() == other.tobytes(), function.__name__
    return fb.cast_rays(mesh, origins, directions, device="cpu", **limits)


def special_targets(geometry, limit=400):
    """Vertices and midpoints of edges, at most `limit` of each."""
    corners = truth.corners(*geometry)
    midpoints = ((corners + np.roll(corners, 1, axis=1)) / 2).reshape(-1, 3)
    step = max(1, len(midpoints) // limit)
    return np.concatenate([geometry.vertices[:limit], midpoints[::step]])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", ZOO)
def test_a_device_returns_the_bits_of_the_cpu(name, place, gpu):
    scale, shift = place
    geometry = meshes.scale_and_shift(ZOO[name](), scale, (shift, -shift, shift))
    origins = meshes.points_around(geometry, 200, 6, spread=2)
    random = meshes.points_around(geometry, 200, 7, spread=0.8)
    # The last origins are inside the box; their rays pass exactly through vertices and midpoints of edges.
    targets = special_targets(geometry, 150)
    start = meshes.points_around(geometry, 1, 8, spread=0.5)
    origins = np.concatenate([origins, np.broadcast_to(start, targets.shape)])
    directions = np.concatenate([random, targets]) - origins

    hits = assert_same_bits(geometry, origins, directions, gpu)

    assert hits.hit.any()


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("name", "inside"), [("icosphere", (0.1, 0.2, 0.05)), ("knot", (3, 0, 0)), ("cube", (0, 0, 0))]
)
def test_no_ray_leaves_through_a_vertex_or_an_edge(name, inside, place, gpu):
    scale, shift = place
    geometry = meshes.scale_and_shift(ZOO[name](), scale, (shift, shift, shift))
    origin = np.array(inside, np.float64) * scale + shift
    corners = truth.corners(*geometry)
    targets = np.concatenate([geometry.vertices, (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2])

    hits = fb.cast_rays(geometry, origin, targets - origin, device=gpu)

    assert hits.hit.all()
    assert fb.occluded(geometry, origin, targets - origin, device=gpu).all()


def test_limits_that_equal_a_hit_are_the_same_on_a_device(gpu):
    knot = fb.Mesh(*meshes.knot(96, 10))
    origins = meshes.points_around(meshes.Geometry(knot.vertices, knot.faces), 60, spread=2)
    directions = meshes.points_around(meshes.Geometry(knot.vertices, knot.faces), 60, 5, spread=0.8) - origins
    first = fb.cast_rays(knot, origins, directions, device="cpu").t
    for row in np.flatnonzero(np.isfinite(first))[:12]:
        t = first[row]
        for limits in ({"t_min": t}, {"t_max": t}, {"t_min": np.nextafter(t, 9)}, {"t_max": np.nextafter(t, 0)}):
            assert_same_bits(knot, origins[row : row + 3], directions[row : row + 3], gpu, **limits)
    assert_same_bits(knot, origins, directions, gpu, t_min=-2, t_max=0.5)
    assert_same_bits(knot, origins, directions, gpu, t_min=-np.inf)
    assert_same_bits(knot, origins, directions, gpu, t_min=0.7, t_max=0.7)


@pytest.mark.parametrize("gap", [0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-2])
@pytest.mark.parametrize("layers", [2, 8, 9, 30])
def test_near_layers_have_the_hits_of_the_cpu(layers, gap, gpu):
    """More faces than a device returns, and faces that are nearer to each other than float32 resolves."""
    sheet = meshes.flat_sheet(2)
    order = np.random.default_rng(1).permutation(layers)
    stack = meshes.join(*(meshes.scale_and_shift(sheet, 1, (0, 0, gap * i)) for i in order))
    corners = stack.vertices[stack.faces].mean(axis=1)
    inside = np.concatenate([corners, stack.vertices, [(0.5, 0.5, 0), (0.25, 0.5, 0)]])
    for direction in [(0, 0, -1), (0.3, 0.1, -1), (0.9, 0.4, -0.01), (1, 0, 0)]:
        vector = np.array(direction, np.float64)
        assert_same_bits(stack, inside - 3 * vector, np.broadcast_to(vector, inside.shape), gpu)


def test_rays_in_the_planes_of_faces_are_the_same_on_a_device(gpu):
    box = meshes.join(meshes.box(), meshes.flat_sheet(4), meshes.doubled(meshes.icosphere(1)))
    lattice = np.linspace(-1, 1, 9)
    places = np.stack(np.meshgrid(lattice, lattice, [-3.0], indexing="ij"), axis=-1).reshape(-1, 3)
    for turn in range(3):
        origins = np.roll(places, turn, axis=1)
        for tiny in (0, 1e-300, 1e-35, 1e-20, 1e-8, -1e-8):
            direction = np.roll(np.array([tiny, -tiny, 2.0]), turn)
            assert_same_bits(box, origins, np.broadcast_to(direction, origins.shape), gpu)


@pytest.mark.parametrize("far", [1e2, 1e5, 1e7, 1e11, 1e15, 1e30])
@pytest.mark.parametrize("length", [1e-307, 1e-12, 1, 1e12, 1e36])
def test_far_origins_and_any_length_are_the_same_on_a_device(far, length, gpu):
    sphere = meshes.icosphere(2)
    targets = meshes.points_around(sphere, 40, spread=0.9)
    directions = meshes.points_around(sphere, 40, 9)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    hits = assert_same_bits(sphere, targets - far * directions, length * directions, gpu)

    # The rounding of the origin exceeds the size of the sphere from 1e16 on; `t` overflows for short directions.
    assert hits.hit.any() or far * 1e-16 > 1 or far / length > 1e307


def test_many_rays_at_a_large_soup_are_the_same_on_a_device(gpu):
    soup = meshes.soup(3000)
    origins = meshes.points_around(soup, 5000, 6, spread=1.5)
    directions = meshes.points_around(soup, 5000, 7, spread=0.8) - origins

    hits = assert_same_bits(soup, origins, directions, gpu)

    assert hits.hit.mean() > 0.5


def test_moved_meshes_are_the_same_on_a_device(gpu):
    knot = meshes.knot(48, 8)
    mesh = fb.Mesh(*knot)
    fb.cast_rays(mesh, (0, 0, 0), (0, 0, 1))
    moved = mesh.moved(knot.vertices * (1, 1.2, 0.8) + np.sin(knot.vertices[:, [1, 2, 0]]))
    origins = meshes.points_around(knot, 300, 6, spread=2)

    assert_same_bits(moved, origins, -origins, gpu)


def test_shapes_and_empty_inputs(gpu):
    cube = fb.Mesh(*meshes.box())

    assert fb.cast_rays(cube, np.zeros((4, 1, 3)), np.ones((1, 5, 3)), device=gpu).normals.shape == (4, 5, 3)
    assert fb.cast_rays(cube, (0, 0, 0), (0, 0, 1), device=gpu).t == 1
    assert fb.occluded(cube, np.empty((0, 3)), (0, 0, 1), device=gpu).shape == (0,)
    assert fb.count_intersections(cube, np.empty((0, 3)), (0, 0, 1), device=gpu).shape == (0,)
    assert fb.all_intersections(cube, np.empty((0, 3)), np.empty((0, 3)), device=gpu).t.shape == (0,)


def test_faces_are_rows_of_what_was_passed(gpu):
    vertices, faces = meshes.triangle()
    padded = np.concatenate([[[0, 0, 1], [1, 1, 1]], faces])

    assert fb.cast_rays((vertices, padded), (0.2, 0.2, 1), (0, 0, -1), device=gpu).faces == 2
    assert fb.all_intersections((vertices, padded), (0.2, 0.2, 1), (0, 0, -1), device=gpu).faces.tolist() == [2]


def test_progress_ends_at_one(gpu):
    fractions = []

    fb.cast_rays(meshes.box(), np.zeros((3000, 3)), (0, 0, 1), device=gpu, progress=fractions.append)

    assert fractions[-1] == 1
    assert fractions == sorted(fractions)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_unknown_devices_are_named(function):
    with pytest.raises(fb.DeviceError, match="abacus"):
        function(meshes.box(), (0, 0, 0), (0, 0, 1), device="abacus")
    with pytest.raises(fb.ArgumentError, match="device"):
        function(meshes.box(), (0, 0, 0), (0, 0, 1), device=3)
