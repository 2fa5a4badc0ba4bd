"""Samples of surfaces and training samples by their statistics, thickness by closed forms."""

import itertools
import subprocess
import sys

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth


def test_samples_lie_on_their_faces_at_their_weights():
    knot = meshes.knot(96, 10)

    found = fb.sample_surface(knot, 5000)

    corners = truth.corners(*knot)[found.faces]
    assert np.abs((found.barycentric[:, :, None] * corners).sum(axis=1) - found.points).max() <= 1e-14 * 10
    assert found.barycentric.min() >= 0
    assert np.abs(found.barycentric.sum(axis=1) - 1).max() <= 1e-15 * 4
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(found.normals - normals / np.linalg.norm(normals, axis=1, keepdims=True)).max() <= 1e-12


def test_samples_are_uniform_by_area():
    fin = meshes.join(meshes.sliver_fin(), meshes.icosphere(1, 0.3, (3, 0, 0)))
    corners = truth.corners(*fin)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    n = 200_000

    found = fb.sample_surface(fin, n, seed=3)

    share = areas / areas.sum()
    counts = np.bincount(found.faces, minlength=len(areas))
    # Binomial counts: six standard deviations and one.
    assert (np.abs(counts - n * share) <= 6 * np.sqrt(n * share * (1 - share)) + 1).all()
    # Within a face every weight has the mean 1/3 and the variance 1/18.
    assert np.abs(found.barycentric.mean(axis=0) - 1 / 3).max() <= 6 * np.sqrt(1 / 18 / n)
    assert found.barycentric.var(axis=0) == pytest.approx([1 / 18] * 3, rel=0.02)


def test_a_seed_names_its_points():
    sphere = meshes.icosphere(2)
    first = fb.sample_surface(sphere, 3000, seed=7)

    assert np.array_equal(fb.sample_surface(sphere, 100_000, seed=7).points[:3000], first.points)
    assert not np.array_equal(fb.sample_surface(sphere, 3000, seed=8).points, first.points)
    # Recorded: the same numbers on every platform.
    box = fb.sample_surface(meshes.box(), 2, seed=1)
    assert box.faces.tolist() == RECORDED_FACES
    assert box.points.tolist() == RECORDED_POINTS


RECORDED_FACES = [4, 9]
RECORDED_POINTS = [
    [-0.9120772080426172, 0.9427446881820105, -1.0],
    [-0.06380529774748522, 1.0, -0.7887936996910552],
]


def test_threads_change_no_bit():
    script = """
import sys
import numpy as np
import fieldbake as fb
fb.set_threads(int(sys.argv[1]))
knot = fb.models.torus_knot(segments=96, sides=12)
points = np.random.default_rng(1).uniform(-2, 2, (5000, 3))
found = [*fb.sample_surface(knot, 50_000), *fb.query(knot, points)[:5], *fb.cast_rays(knot, points, -points)]
found += [*fb.sample_training(knot, 3000), fb.contains(knot, points), fb.bake(knot, 24).distances]
import hashlib
print(hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in found)).hexdigest())
"""
    runs = [
        subprocess.run(
            [sys.executable, "-c", script, n], capture_output=True, text=True, check=True, timeout=120
        ).stdout
        for n in ("1", "2", "5")
    ]

    assert runs[0] == runs[1] == runs[2]


@pytest.mark.parametrize("n", [0, 1, 2, 3, 17, 1000])
def test_training_samples_are_exactly_as_many(n):
    found = fb.sample_training(meshes.icosphere(2), n)

    assert (found.points.shape, found.distances.shape, found.gradients.shape) == ((n, 3), (n,), (n, 3))


def test_training_samples_have_the_named_spreads():
    cube = meshes.box()
    diagonal = np.sqrt(12)
    n = 60_000

    found = fb.sample_training(cube, n, near=(0.002, 0.02), uniform=0.25, seed=5)

    fine, coarse, spread = np.split(found.points, [n * 3 // 8, n * 3 // 4])
    expected = truth.closest_point(*cube, found.points[::10])
    assert np.abs(np.abs(found.distances[::10]) - expected.distances).max() <= 1e-12
    inside = (np.abs(found.points) < 1).all(axis=1)
    assert np.array_equal(found.distances < 0, inside)
    # Offsets of a flat surface along its normal are Gaussian; edges touch a few percent.
    for part, deviation in ((fine, 0.002), (coarse, 0.02)):
        off = np.abs(fb.closest_point(cube, part).distances)
        assert np.median(off) == pytest.approx(0.6745 * deviation * diagonal, rel=0.05)
    assert (np.abs(spread) <= 1.1).all()
    assert spread.var(axis=0) == pytest.approx([1.1**2 / 3] * 3, rel=0.05)
    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-12


def test_training_samples_may_be_all_uniform_or_all_near():
    sphere = meshes.icosphere(2)

    assert np.abs(fb.sample_training(sphere, 500, uniform=0).distances).max() < 0.05 * 2 * np.sqrt(3) * 6
    assert fb.sample_training(sphere, 500, uniform=1, near=()).points.shape == (500, 3)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_training_distances_belong_to_the_points_far_from_the_origin(dtype):
    center = np.array((512345.0, 4187654.0, 100.0))
    sphere = meshes.icosphere(3, center=center)

    found = fb.sample_training(sphere, 2000, seed=2, dtype=dtype)

    assert {array.dtype.name for array in found} == {dtype}
    expected = truth.closest_point(*sphere, found.points.astype(np.float64)).distances
    # Rounding of a distance below 4 to the type, and of positions of 4e6 in float64.
    error = np.abs(np.abs(found.distances) - expected).max()
    assert error <= 4 * np.finfo(dtype).eps + 4e6 * 4 * np.finfo(np.float64).eps
    # The points of float32 are the points of float64, rounded; steps there are 0.03 along x and 0.25 along y.
    assert np.array_equal(found.points, fb.sample_training(sphere, 2000, seed=2).points.astype(dtype))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n": 10, "dtype": "float16"}, 'dtype: must be one of "float64", "float32"'),
        ({"n": -1}, "n"),
        ({"n": 2.5}, "n"),
        ({"n": 10, "seed": -1}, "seed"),
        ({"n": 10, "uniform": 1.5}, "uniform"),
        ({"n": 10, "uniform": -0.1}, "uniform"),
        ({"n": 10, "near": (0.1, 0)}, "near"),
        ({"n": 10, "near": ()}, "near"),
        ({"n": 10, "near": (np.nan,)}, "near"),
    ],
)
def test_bad_numbers_are_refused(options, message):
    with pytest.raises(fb.ArgumentError, match=message):
        fb.sample_training(meshes.box(), **options)


# --- thickness


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-3, 0), (1e3, 1e4)])
def test_the_thickness_of_a_slab_is_exact(scale, shift, random):
    slab = meshes.scale_and_shift(meshes.box((-5, -5, -0.25), (5, 5, 0.25)), scale, (shift, shift, shift))
    points = np.column_stack([random.uniform(-4, 4, (50, 2)), random.choice([-0.25, 0.25], 50)]) * scale + shift

    found = fb.thickness(slab, points)

    assert found == pytest.approx(np.full(50, 0.5 * scale), rel=1e-9 + 1e-15 * shift / scale * 10)


@pytest.mark.parametrize("height", [1e-2, 1e-3, 1e-5, 1e-6])
def test_the_thickness_of_a_thin_turned_plate_is_its_height(height, random):
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    vertices, faces = meshes.box((-1, -1, -height / 2), (1, 1, height / 2))
    plate = fb.Mesh(vertices @ turn.T + 0.3, faces)
    points = np.column_stack([random.uniform(-0.8, 0.8, (500, 2)), np.full(500, height / 2)]) @ turn.T + 0.3
    normals = np.tile(turn[:, 2], (500, 1))

    # Coordinates near 1 are rounded by 2^-53, on both sides of the plate.
    bound = 1e-9 * height + 8 * 2.0**-53
    assert np.abs(fb.thickness(plate, points, normals) - height).max() <= bound
    assert np.abs(fb.thickness(plate, points) - height).max() <= bound


def test_side_walls_bound_the_ball():
    cube = meshes.box()
    points = [(1, 0, 0), (1, 0.9, 0), (1, 0.5, -0.7), (1, 0.99, 0.999)]

    # The ball touches the side and the nearest wall beside it: its radius is the distance to that wall.
    assert fb.thickness(cube, points) == pytest.approx([2, 0.2, 0.6, 0.002], rel=1e-9)
    assert fb.thickness(cube, points, [(3, 0, 0)] * 4) == pytest.approx([2, 0.2, 0.6, 0.002], rel=1e-9)
    assert fb.thickness(meshes.flip(cube), points) == pytest.approx([2, 0.2, 0.6, 0.002], rel=1e-9)


@pytest.mark.parametrize("corner", list(itertools.product((-1, 1), repeat=3)))
def test_the_thickness_at_a_corner_is_zero(corner):
    half = np.array([1, 0.5, 1.5])
    assert fb.thickness(meshes.box(-half, half), [corner * half])[0] <= 1e-12


def test_the_thickness_of_a_torus_is_its_tube():
    torus = meshes.torus(1.0, 0.25, segments=192, sides=64)

    found = fb.thickness(torus, torus.vertices[::37])

    # A facet deeper than the surface by e, seen at 15 degrees or more, makes the ball smaller by e / (2 sin^2).
    room = truth.facet_error(*torus, 4.0) / (2 * np.sin(np.radians(15)) ** 2)
    assert np.abs(found - 0.5).max() <= 2 * room


def test_the_thickness_of_a_sphere_is_its_diameter():
    sphere = meshes.icosphere(4, 2.0)

    found = fb.thickness(sphere, sphere.vertices[::50], sphere.vertices[::50])

    # A point p of a sphere of radius R sees the sphere of radius R - e at the angle a above its tangent plane at two
    # distances L. A ball through p and the farther point has the radius L / (2 sin a), the least one at 15 degrees.
    depth, sine = truth.facet_error(*sphere, 0.5) / 2, np.sin(np.radians(15))
    least = 2 / sine * (sine + np.sqrt(sine**2 - 2 * depth + depth**2))
    assert (found >= least).all()
    assert (found <= 4 + 1e-12).all()


def test_nothing_bounds_an_open_sheet():
    assert np.isinf(fb.thickness(meshes.flat_sheet(), [(0.1, 0.2, 0)])).all()


def test_shapes_of_thickness():
    cube = meshes.box()

    assert fb.thickness(cube, np.ones((2, 3, 3))).shape == (2, 3)
    assert fb.thickness(cube, []).shape == (0,)
    with pytest.raises(fb.ArgumentError, match="normals"):
        fb.thickness(cube, np.ones((2, 3)), np.ones((3, 3)))
    with pytest.raises(fb.ArgumentError, match="normals"):
        fb.thickness(cube, np.ones((1, 3)), np.zeros((1, 3)))
