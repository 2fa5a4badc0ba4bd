"""Signed distances, gradients, closest points and the inside, against float64 brute force."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

ZOO = {**meshes.CLOSED, **meshes.OPEN}
#: Half an ulp of float64, relative.
FLOAT64_ROUNDING = 2.0**-53
PLACES = {
    "at home": (1.0, 0.0),
    "far": (1.0, 1e4),
    "tiny": (1e-3, 0.0),
    "large": (1e3, 0.0),
    "tiny and far": (1e-3, 1e4),
}


def placed(name, place):
    scale, shift = PLACES[place]
    return meshes.scale_and_shift(ZOO[name](), scale, (shift, -shift, shift / 2))


def rounding(geometry):
    """Bound on the rounding of float64 positions: a dozen operations on the largest coordinate and on the box."""
    used = geometry.vertices[geometry.faces].reshape(-1, 3)
    return 64 * FLOAT64_ROUNDING * (np.abs(used).max() + np.ptp(used, axis=0).max())


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", ["icosphere", "knot", "sliver_fin", "open_box", "soup", "size_ratio"])
def test_distances_and_points_are_those_of_float64(name, place):
    geometry = placed(name, place)
    points = meshes.points_around(geometry, 400)

    found = fb.query(geometry, points)

    expected = truth.closest_point(*geometry, points)
    room = rounding(geometry)
    assert found.distances.dtype == found.points.dtype == np.float64
    assert np.abs(np.abs(found.distances) - expected.distances).max() <= room
    # The point is on the named face, at the named weights, at the named distance.
    corners = truth.corners(*geometry)[found.faces]
    assert np.abs((found.barycentric[:, :, None] * corners).sum(axis=1) - found.points).max() <= 4 * room
    assert np.abs(np.linalg.norm(found.points - points, axis=1) - np.abs(found.distances)).max() <= 4 * room
    assert found.barycentric.min() >= 0
    assert np.abs(found.barycentric.sum(axis=1) - 1).max() <= 1e-12


@pytest.mark.parametrize("name", meshes.CLOSED)
def test_the_sign_is_that_of_the_winding_number(name):
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, 500)

    found = fb.query(geometry, points).distances

    winding = truth.winding_number(*geometry, points)
    clear = np.abs(found) > truth.tolerance(*geometry).item()
    assert np.array_equal((found < 0)[clear], (np.abs(winding) > 0.5)[clear])


@pytest.mark.parametrize("name", ZOO)
def test_gradients_are_unit_and_point_away_from_the_inside(name):
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, 500)

    found = fb.query(geometry, points)

    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-12
    # A step along the gradient changes the signed distance by the step, where the closest point does not jump.
    back = points - found.distances[:, None] * found.gradients
    assert np.abs(back - found.points).max() <= 64 * rounding(geometry)


@pytest.mark.parametrize("turned", [False, True])
def test_on_the_surface_the_gradient_is_the_pseudonormal(turned):
    cube = meshes.flip(meshes.box()) if turned else meshes.box()
    points = [(1, 0.25, 0.5), (1, 1, 0.25), (1, 1, 1), (-1, -1, -1), (0.5, -1, -1)]

    found = fb.query(cube, points)

    expected = np.array([(1, 0, 0), (1, 1, 0), (1, 1, 1), (-1, -1, -1), (0, -1, -1)], np.float64)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(found.distances).max() == 0
    assert np.abs(found.gradients - expected).max() <= 1e-12


def test_vertices_have_the_angle_weighted_normals():
    sphere = meshes.move(meshes.icosphere(3), np.diag([1.0, 0.6, 0.3, 1.0]))
    corners = truth.corners(*sphere)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = np.zeros_like(sphere.vertices)
    for i in range(3):
        u, v = (corners[:, (i + k) % 3] - corners[:, i] for k in (1, 2))
        cosine = truth.dot(u, v) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        np.add.at(expected, sphere.faces[:, i], normals * np.arccos(cosine)[:, None])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)

    found = fb.query(sphere, sphere.vertices)

    # Angles come from float32 positions, rounded by 3e-8 of the box where edges are 0.03 of it.
    assert np.abs(found.gradients - expected).max() <= 1e-5


@pytest.mark.parametrize("offset", [1e-12, 1e-9, 1e-8, 1e-7])
def test_the_side_is_right_at_any_distance(offset, random):
    knot = meshes.knot(96, 10)
    corners = truth.corners(*knot)
    weights = random.dirichlet((2, 2, 2), size=(len(corners), 1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    on_surface = (weights @ corners)[:, 0]

    for side in (1, -1):
        found = fb.query(knot, on_surface + side * offset * normals)

        assert (np.sign(found.distances) == side).all()
        assert np.abs(found.gradients - normals).max() <= 1e-6


def test_unsigned_queries_have_unsigned_gradients():
    found = fb.query(meshes.box(), [(0.9, 0, 0), (1.5, 0, 0)], sign="unsigned")

    assert found.distances == pytest.approx([0.1, 0.5])
    assert found.gradients.tolist() == [[-1, 0, 0], [1, 0, 0]]


def test_leading_shapes_are_kept(random):
    points = random.uniform(-2, 2, size=(2, 3, 4, 3))
    cube = meshes.box()

    found = fb.query(cube, points)
    closest = fb.closest_point(cube, points)

    assert found.distances.shape == found.faces.shape == closest.distances.shape == (2, 3, 4)
    assert (
        found.gradients.shape == found.points.shape == found.barycentric.shape == closest.normals.shape == points.shape
    )
    assert fb.query(cube, points[0, 0, 0]).distances.shape == ()
    assert fb.contains(cube, points).shape == fb.winding_number(cube, points).shape == (2, 3, 4)


def test_no_points_no_answers():
    cube = meshes.box()

    assert [array.shape for array in fb.query(cube, np.empty((0, 3)))[:5]] == [(0,), (0, 3), (0, 3), (0,), (0, 3)]
    assert fb.contains(cube, []).shape == (0,)
    assert fb.winding_number(cube, np.empty((5, 0, 3))).shape == (5, 0)


def test_one_point_equals_many(random):
    knot = fb.Mesh(*meshes.knot(64, 8))
    points = random.uniform(-3, 3, size=(3000, 3))
    together = fb.query(knot, points)

    for row in range(0, 3000, 300):
        alone = fb.query(knot, points[row])
        for one, many in zip(alone[:5], together[:5], strict=True):
            assert np.array_equal(one, many[row])


def test_normals_are_the_faces_own():
    geometry = meshes.flip_some(meshes.icosphere(2), 0.3)
    points = meshes.points_around(geometry, 200)

    found = fb.closest_point(geometry, points)

    a, b, c = truth.corners(*geometry)[found.faces].transpose(1, 0, 2)
    expected = np.cross(b - a, c - a)
    assert np.abs(found.normals - expected / np.linalg.norm(expected, axis=1, keepdims=True)).max() <= 1e-12


def test_closest_points_unpack_as_in_trimesh():
    points, distances, faces = fb.closest_point(meshes.box(), [(0, 0, 3)])

    assert (points.shape, distances.tolist(), faces.shape) == ((1, 3), [2.0], (1,))


def test_the_report_counts_points_and_names_the_device():
    report = fb.query(meshes.box(), [(0, 0, 0), (0, 0, 0.5), (0, 0, 2)]).report

    assert (report.points, report.inside_points, report.device, report.closed) == (3, 2, "cpu", True)
    assert "2 of 3 points" in str(report)
    assert report.warnings == ()


def test_a_device_answers_alike(gpu):
    knot = meshes.knot(48, 8)
    points = meshes.points_around(knot, 300)

    found, expected = fb.query(knot, points, device=gpu), fb.query(knot, points)

    assert found.report.device != "cpu"
    assert np.abs(found.distances - expected.distances).max() <= truth.tolerance(*knot).item()
    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-12


def test_few_points_stay_on_the_cpu_unless_the_environment_names_a_device(gpu, monkeypatch):
    monkeypatch.delenv("FIELDBAKE_DEVICE", raising=False)
    # A check for machines with a graphics card, since "auto" uses no software adapter.
    assert fb.query(meshes.box(), np.zeros((4095, 3))).report.device == "cpu"

    monkeypatch.setenv("FIELDBAKE_DEVICE", gpu)
    assert fb.query(meshes.box(), np.zeros((1, 3))).report.device != "cpu"


@pytest.mark.parametrize(
    "call",
    [
        lambda mesh, p: fb.query(mesh, p),
        lambda mesh, p: fb.signed_distance(mesh, p),
        lambda mesh, p: fb.contains(mesh, p),
        lambda mesh, _: fb.bake(mesh, 8),
    ],
)
def test_open_meshes_warn_once_per_call(call):
    with pytest.warns(fb.SurfaceWarning, match="surface is open") as caught:
        call(meshes.open_box(), [(0, 0, 0), (0, 0, 3)])

    assert len(caught) == 1
    assert caught[0].filename == __file__


@pytest.mark.filterwarnings("error")
def test_closed_meshes_and_unsigned_queries_do_not_warn():
    fb.query(meshes.box(), [(0, 0, 0)])
    fb.contains(meshes.knot(32, 6), [(0, 0, 0)])
    fb.query(meshes.open_box(), [(0, 0, 0)], sign="unsigned")
    fb.closest_point(meshes.open_box(), [(0, 0, 0)])


@pytest.mark.parametrize("count", [800, 40_000])
@pytest.mark.parametrize("name", ZOO)
def test_contains_is_the_side_of_the_signed_distance(name, count):
    # Many points are decided by the cells of a grid.
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, count)

    assert np.array_equal(fb.contains(geometry, points), fb.signed_distance(geometry, points) < 0)


@pytest.mark.parametrize("sign", ["parity", "pseudonormal", "normal", "winding", "unsigned"])
def test_contains_takes_every_method(sign):
    points = meshes.points_around(meshes.box(), 300)

    expected = fb.signed_distance(meshes.box(), points, sign=sign) < 0
    assert np.array_equal(fb.contains(meshes.box(), points, sign=sign), expected)


DIRTY = {
    **ZOO,
    "inside out": lambda: meshes.flip(meshes.icosphere(2)),
    "doubled": lambda: meshes.doubled(meshes.icosphere(2)),
    "doubled opposite": lambda: meshes.doubled_opposite(meshes.icosphere(2)),
    "half flipped": lambda: meshes.flip_some(meshes.icosphere(2), 0.5),
}


@pytest.mark.parametrize("place", ["at home", "far", "tiny"])
@pytest.mark.parametrize("name", DIRTY)
def test_winding_numbers_are_sums_of_solid_angles(name, place):
    scale, shift = PLACES[place]
    geometry = meshes.scale_and_shift(DIRTY[name](), scale, (shift, shift, shift))
    points = meshes.points_around(geometry, 300)

    found = fb.winding_number(geometry, points)

    expected = truth.winding_number(*geometry, points)
    assert found.dtype == np.float64
    # Solid angles jump at the surface, where the sum of rounded ones is either; no random point is that near.
    assert np.abs(found - expected).max() <= 1e-6


def test_a_looser_error_is_kept():
    soup = meshes.soup(6000)
    points = meshes.points_around(soup, 200)

    exact, fast = fb.winding_number(soup, points), fb.winding_number(soup, points, error=0.02)

    assert 0 < np.abs(exact - fast).max() <= 0.02


@pytest.mark.parametrize("function", [fb.query, fb.contains, fb.winding_number, fb.closest_point, fb.thickness])
@pytest.mark.parametrize(
    "points", [np.zeros((4, 2)), [[0, np.nan, 0]], [[np.inf, 0, 0]], np.zeros((2, 3), complex), None, "abc"]
)
def test_bad_points_are_refused(function, points):
    with pytest.raises(fb.ArgumentError, match="points"):
        function(meshes.box(), points)


@pytest.mark.parametrize("error", [0, -1, np.nan, "a"])
def test_bad_errors_are_refused(error):
    with pytest.raises(fb.ArgumentError, match="error"):
        fb.winding_number(meshes.box(), [(0, 0, 0)], error=error)


def test_unknown_words_are_refused():
    with pytest.raises(fb.ArgumentError, match="sign"):
        fb.query(meshes.box(), [(0, 0, 0)], sign="maybe")
    with pytest.raises(fb.ArgumentError, match="sign"):
        fb.contains(meshes.box(), [(0, 0, 0)], sign="maybe")
    with pytest.raises(fb.DeviceError, match="device"):
        fb.query(meshes.box(), [(0, 0, 0)], device="abacus")
