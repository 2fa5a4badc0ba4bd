"""The reference results: brute force against closed forms, a second formula and libigl; and the test meshes."""

import numpy as np
import pytest

import meshes
import truth

#: float64 throughout, coordinates near 1, some twenty operations.
FLOAT64_NOISE = 1e-13


@pytest.fixture
def random():
    return np.random.default_rng(0)


def distance_by_regions(p, a, b, c):
    """The same distance by Voronoi regions of corners, edges and the face (Ericson 2005, 5.1.5), for one point."""
    ab, ac = b - a, c - a
    d1, d2 = ab @ (p - a), ac @ (p - a)
    d3, d4 = ab @ (p - b), ac @ (p - b)
    d5, d6 = ab @ (p - c), ac @ (p - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        q = a
    elif d3 >= 0 and d4 <= d3:
        q = b
    elif d6 >= 0 and d5 <= d6:
        q = c
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        q = a + d1 / (d1 - d3) * ab
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        q = a + d2 / (d2 - d6) * ac
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        q = b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    else:
        q = a + (vb * ab + vc * ac) / (va + vb + vc)
    return np.linalg.norm(p - q)


def test_two_formulas_for_a_triangle_agree(random):
    p, a, b, c = random.standard_normal((4, 3_000, 3))

    by_regions = [distance_by_regions(*one) for one in zip(p, a, b, c, strict=True)]

    assert np.abs(truth.distance_to_triangle(p, a, b, c) - by_regions).max() <= 1e-10  # needles among random triangles


def test_the_closest_point_lies_in_the_triangle(random):
    p, a, b, c = random.standard_normal((4, 5_000, 3))

    nearest = truth.closest_point_on_triangle(p, a, b, c)

    assert truth.distance_to_triangle(nearest, a, b, c).max() <= 1e-10


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-7])
def test_slivers_are_exact_too(random, width):
    # Points straight above one long edge: their distance is their height.
    a, b, c = np.array([[0, 0, 0], [1, 0, 0], [0.4, width, 0]])
    height = random.uniform(-1, 1, size=1_000)
    above = np.stack([random.uniform(0, 1, size=1_000), np.zeros(1_000), height], axis=1)
    turn = meshes.rotation(6)

    found = truth.distance_to_triangle(above @ turn.T, turn @ a, turn @ b, turn @ c)

    # The normal of a sliver is known to a rounding over its width.
    assert np.abs(found - np.abs(height)).max() <= FLOAT64_NOISE + 2.0**-50 / width


@pytest.mark.parametrize(
    ("p", "nearest"),
    [
        ((-1, -1, 2), (0, 0, 0)),  # corner a
        ((2, -1, 0), (1, 0, 0)),  # corner b
        ((-1, 2, 1), (0, 1, 0)),  # corner c
        ((0.5, -1, 3), (0.5, 0, 0)),  # edge ab
        ((-1, 0.5, 0), (0, 0.5, 0)),  # edge ca
        ((1, 1, 5), (0.5, 0.5, 0)),  # edge bc
        ((0.25, 0.25, -7), (0.25, 0.25, 0)),  # the face
    ],
)
def test_every_region_of_the_unit_triangle(p, nearest):
    vertices, faces = meshes.triangle()

    found = truth.closest_point(vertices, faces, [p])

    assert found.points[0] == pytest.approx(nearest, abs=FLOAT64_NOISE)


def test_a_triangle_without_area_is_its_edges():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float64)

    found = truth.closest_point(vertices, [[0, 1, 2], [0, 0, 0]], [[1.5, 1, 0], [-3, 0, 4]])

    assert found.distances == pytest.approx([1, 5])


def test_box_mesh_equals_the_closed_form(random):
    vertices, faces = meshes.box((-1, -2, -3), (1, 2, 3))
    points = random.uniform(-5, 5, size=(2_000, 3))

    found = truth.signed_distance(vertices, faces, points)

    assert np.abs(found - truth.box(points, (-1, -2, -3), (1, 2, 3))).max() <= FLOAT64_NOISE


CURVED = {
    "sphere": (lambda: meshes.icosphere(3), truth.sphere, 1.0),
    "uv_sphere": (lambda: meshes.uv_sphere(24, 48), truth.sphere, 1.0),
    "torus": (lambda: meshes.torus(1.0, 0.4, 72, 32), lambda p: truth.torus(p, 1.0, 0.4), 1 / 0.4),
    "capsule": (lambda: meshes.capsule(1.0, 0.5, 12, 48), lambda p: truth.capsule(p, 1.0, 0.5), 1 / 0.5),
}


@pytest.mark.parametrize("name", CURVED)
def test_curved_meshes_equal_their_closed_forms_within_the_facet_error(name, random):
    make, closed_form, curvature = CURVED[name]
    geometry = make()
    points = random.uniform(-1.6, 1.6, size=(1_000, 3))
    bound = truth.facet_error(*geometry, curvature)

    error = np.abs(truth.signed_distance(*geometry, points) - closed_form(points)).max()

    assert error <= bound
    assert error >= bound / 20  # a bound that says something


@pytest.mark.parametrize("name", meshes.CLOSED)
def test_the_winding_number_of_a_closed_mesh_is_whole(name, random):
    geometry = meshes.CLOSED[name]()
    points = meshes.points_around(geometry, 300)

    winding = truth.winding_number(*geometry, points)

    assert np.abs(winding - winding.round()).max() <= 1e-9


def test_the_winding_number_counts_shells():
    centre = [[0.0, 0.0, 0.0]]

    counts = [
        truth.winding_number(*make(), centre)[0]
        for make in (meshes.icosphere, meshes.nested_shells, meshes.hollow_sphere)
    ]

    assert counts == pytest.approx([1, 2, 0])


def test_half_a_sphere_of_directions_sees_a_large_sheet():
    sheet = meshes.scale_and_shift(meshes.flat_sheet(), 1e6)

    below, above = truth.winding_number(*sheet, [[0, 0, -1], [0, 0, 1]])

    assert (below, above) == pytest.approx((0.5, -0.5), abs=1e-5)


@pytest.mark.parametrize("name", [*meshes.CLOSED, *meshes.OPEN])
def test_libigl_agrees_with_brute_force(name):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    points = meshes.points_around(geometry, 200)
    reference = truth.Reference(*geometry)

    assert np.abs(reference.distance(points) - truth.closest_point(*geometry, points).distances).max() <= 1e-12
    assert np.abs(reference.winding_number(points) - truth.winding_number(*geometry, points)).max() <= 1e-9


@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("cube", 8),
        ("tetrahedron", 8 / 3),
        ("overlapping_boxes", 16),
        ("sliver_fin", 5e-5),
        ("icosphere", 4 / 3 * np.pi),
        ("torus", 2 * np.pi**2 / 16),
    ],
)
def test_meshes_face_outwards_and_have_their_volume(name, volume):
    # Inscribed polyhedra: a few per cent below the smooth body.
    assert truth.volume(*meshes.CLOSED[name]()) == pytest.approx(volume, rel=0.07)


@pytest.mark.parametrize("name", meshes.CLOSED)
def test_closed_meshes_use_every_edge_once_each_way(name):
    _, faces = meshes.CLOSED[name]()
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)

    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))


def test_trilinear_is_exact_for_a_linear_field(random):
    points = truth.grid_points((0, 0, 0), (4, 3, 2), (8, 6, 4))
    inside = random.uniform((0.25, 0.25, 0.25), (3.75, 2.75, 1.75), size=(500, 3))

    found = truth.trilinear(points @ (1, 2, -3), (0, 0, 0), (4, 3, 2), inside)

    assert np.abs(found - inside @ (1, 2, -3)).max() <= FLOAT64_NOISE * 10


def test_trimesh_counts_the_other_way_round():
    trimesh = pytest.importorskip("trimesh")
    body = trimesh.Trimesh(*meshes.box(), process=False)
    points = [[0.1, 0.2, 0.3], [3, 0.2, 0.3]]

    converted = truth.from_trimesh(trimesh.proximity.signed_distance(body, points))

    assert converted == pytest.approx(truth.box(points))
