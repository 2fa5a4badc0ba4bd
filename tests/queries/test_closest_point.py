"""The closest point against brute force in float64 on every mesh: near, far, on the surface and at ties."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

CUBE = meshes.box()
ZOO = {**meshes.CLOSED, **meshes.OPEN}


@pytest.mark.parametrize("name", ZOO)
def test_distances_equal_brute_force(name):
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, 1_000)

    found = fb.closest_point(geometry, points)

    expected = truth.closest_point(*geometry, points).distances
    assert (np.abs(found.distances - expected) <= truth.tolerance(*geometry, expected)).all()


@pytest.mark.parametrize("name", ZOO)
def test_the_point_lies_on_the_named_face_at_the_named_distance(name):
    geometry = ZOO[name]()
    points = meshes.points_around(geometry, 500)
    tolerance = 2 * truth.tolerance(*geometry).item()  # of the point, and of the distance

    found = fb.closest_point(geometry, points)

    a, b, c = truth.corners(*geometry)[found.faces].transpose(1, 0, 2)
    assert truth.distance_to_triangle(found.points, a, b, c).max() <= tolerance
    assert np.abs(np.linalg.norm(found.points - points, axis=1) - found.distances).max() <= tolerance


def test_shapes_and_types(random):
    found = fb.closest_point(CUBE, random.uniform(-2, 2, size=(7, 3)))

    assert found.points.shape == (7, 3)
    assert found.distances.shape == found.faces.shape == (7,)
    assert found.distances.dtype == found.points.dtype == found.barycentric.dtype == found.normals.dtype == np.float64
    assert found.faces.dtype == np.int64
    assert (found.distances >= 0).all()


def test_no_points_no_answers():
    found = fb.closest_point(CUBE, np.empty((0, 3)))

    assert (found.points.shape, found.distances.shape, found.faces.shape) == ((0, 3), (0,), (0,))
    assert fb.signed_distance(CUBE, np.empty((0, 3))).shape == (0,)


def test_signed_distance_is_the_same_distance_with_a_sign(random):
    points = random.uniform(-2, 2, size=(1_000, 3))

    signed = fb.signed_distance(CUBE, points)

    assert signed.dtype == np.float32
    unsigned = fb.closest_point(CUBE, points).distances
    assert (np.abs(np.abs(signed) - unsigned) <= truth.tolerance(*CUBE, unsigned)).all()


@pytest.mark.parametrize(
    ("p", "distance"),
    [
        ((0, 0, 0), 1),  # all six sides tie
        ((0.5, 0.5, 0), 0.5),  # two sides
        ((2, 2, 2), np.sqrt(3)),  # a corner, six triangles
        ((0, 2, 2), np.sqrt(2)),  # an edge
        ((3, 0.25, -0.5), 2),  # a side
        ((3, 0, 0), 2),  # above the diagonal of a side
    ],
)
def test_ties_have_the_right_distance(p, distance):
    found = fb.closest_point(CUBE, [p])

    assert found.distances[0] == pytest.approx(distance, rel=2 * truth.FLOAT32_ROUNDING)


def test_all_triangles_at_the_same_distance():
    sphere = meshes.icosphere(4)  # 5,120 triangles around the centre

    found = fb.closest_point(sphere, np.zeros((3, 3)))

    expected = truth.closest_point(*sphere, np.zeros((1, 3))).distances
    assert np.abs(found.distances - expected).max() <= truth.tolerance(*sphere).item()


def test_equal_points_get_equal_answers():
    sphere = meshes.icosphere(3)

    found = fb.closest_point(sphere, np.zeros((1_000, 3)))

    assert len(np.unique(found.faces)) == 1
    assert len(np.unique(found.points, axis=0)) == 1


def test_vertices_are_on_the_surface():
    sphere = meshes.icosphere(3)

    assert fb.closest_point(sphere, sphere.vertices).distances.max() <= truth.tolerance(*sphere).item()


def test_points_on_faces_are_on_the_surface(random):
    knot = meshes.knot(64, 8)
    weights = random.dirichlet((1, 1, 1), size=(len(knot.faces), 1))
    on_surface = (weights @ truth.corners(*knot))[:, 0]

    assert fb.closest_point(knot, on_surface).distances.max() <= truth.tolerance(*knot).item()


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7])
def test_slivers_are_as_exact_as_any_triangle(random, width):
    for seed in range(40):
        corners = np.array([[0, 0, 0], [random.uniform(0.1, 1), 0, 0], [random.uniform(-0.2, 1.2), width, 0]])
        sliver = meshes.Geometry((corners @ meshes.rotation(seed).T), np.array([[0, 1, 2]]))
        on_it = random.dirichlet((1, 1, 1), size=200) @ sliver.vertices
        points = on_it + random.choice([0, 1e-6, 1e-3, 0.1], size=(200, 1)) * random.standard_normal((200, 3))

        found = fb.closest_point(sliver, points).distances

        expected = truth.closest_point(*sliver, points).distances
        assert (np.abs(found - expected) <= truth.tolerance(*sliver, expected)).all()


@pytest.mark.parametrize("reach", [1e2, 1e4, 1e7, 1e12])
def test_far_points(random, reach):
    knot = meshes.knot(64, 8)
    direction = random.standard_normal((200, 3))
    points = direction / np.linalg.norm(direction, axis=1, keepdims=True) * reach

    found = fb.closest_point(knot, points).distances

    expected = truth.closest_point(*knot, points).distances
    assert (np.abs(found - expected) <= truth.tolerance(*knot, expected)).all()


def test_the_million_times_smaller_ball_is_found(random):
    geometry = meshes.size_ratio()
    around = np.array([1.5, 0, 0]) + 1e-5 * random.standard_normal((300, 3))

    found = fb.closest_point(geometry, around)

    assert (found.faces >= len(meshes.icosphere(3).faces)).all()
    expected = truth.closest_point(*geometry, around).distances
    assert np.abs(found.distances - expected).max() <= truth.tolerance(*geometry).item()


def test_faces_are_rows_of_what_was_passed():
    useless = [[0, 0, 1], [3, 3, 3]]
    vertices, faces = meshes.triangle()
    two = meshes.Geometry(
        np.concatenate([vertices, vertices - (0, 0, -5)]), np.concatenate([useless, faces, useless, faces + 3])
    )

    found = fb.closest_point(two, [[0.2, 0.2, 1], [0.2, 0.2, 4]])

    assert found.faces.tolist() == [2, 5]


def test_faces_of_a_mesh_are_its_own_rows():
    vertices, faces = meshes.triangle()
    mesh = fb.Mesh(vertices, np.concatenate([[[0, 0, 1]], faces]))

    found = fb.closest_point(mesh, [[0.2, 0.2, 1]])

    assert len(mesh.faces) == 1
    assert found.faces.tolist() == [0]


@pytest.mark.parametrize("count", [1, 2, 7, 1_001])
def test_the_answer_does_not_depend_on_the_company(random, count):
    knot = meshes.knot(64, 8)
    points = random.uniform(-3, 3, size=(2_000, 3))
    together = fb.closest_point(knot, points)

    apart = fb.closest_point(knot, points[:count])

    assert np.array_equal(apart.distances, together.distances[:count])
    assert np.array_equal(apart.points, together.points[:count])
    assert np.array_equal(apart.faces, together.faces[:count])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((4, 2)), r"points.*\(n, 3\)"),
        (np.zeros(()), r"points.*\(n, 3\)"),
        (np.zeros((2, 3), complex), r"points"),
        ([["a", "b", "c"]], r"points"),
        ([[0, 0, 0], [0, np.nan, 0]], r"points\[1\].*finite"),
        ([[np.inf, 0, 0]], r"points\[0\].*finite"),
    ],
)
@pytest.mark.parametrize("function", [fb.closest_point, fb.signed_distance])
def test_bad_points_are_refused(function, points, message):
    with pytest.raises(fb.ArgumentError, match=message):
        function(CUBE, points)


def test_unsigned_and_signed_agree_with_trimesh():
    trimesh = pytest.importorskip("trimesh")
    knot = meshes.knot(48, 8)
    points = meshes.points_around(knot, 300, spread=1.0)

    theirs = truth.from_trimesh(trimesh.proximity.signed_distance(trimesh.Trimesh(*knot, process=False), points))

    # trimesh merges and works in float64 with a tolerance of its own, 1e-8 absolute.
    assert np.abs(fb.signed_distance(knot, points) - theirs).max() <= truth.tolerance(*knot).item() + 1e-8
