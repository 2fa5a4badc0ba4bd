"""Signs on closed, open and dirty surfaces, against exact winding numbers.

Whole grids are judged by libigl's exact summation, which `test_truth.py` holds against brute force on every shape used
here.
"""

import itertools

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

#: Largest error of the fast winding number on a triangle soup (Barill et al. 2018, second order, beta 2).
#: Where the exact number is closer to 1/2 than this, either sign will do.
FAST_WINDING_ERROR = 0.02

SIGNED_METHODS = ["auto", "winding", "parity", "pseudonormal", "normal"]


def assert_signs(geometry, points, found, undecided=0.0):
    """Assert correct signs for points off the surface whose winding number is not within `undecided` of 1/2."""
    reference = truth.Reference(*geometry)
    winding, distance = np.abs(reference.winding_number(points)), reference.distance(points)
    clear = np.abs(winding - 0.5) > undecided
    tolerance = truth.tolerance(*geometry).item()
    assert truth.sign_errors(found[clear], distance[clear], winding[clear] > 0.5, tolerance) == 0


def assert_same_field(geometry, found, expected):
    """Assert equal fields up to rounding, which depends on the order and the direction of faces."""
    assert np.abs(found.distances - expected.distances).max() <= 2 * truth.tolerance(*geometry).item()


def voxel_centres(volume):
    return truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)


# --- closed


@pytest.mark.parametrize("name", meshes.CLOSED)
def test_no_wrong_sign_on_a_closed_mesh_over_a_whole_grid(name):
    geometry = meshes.CLOSED[name]()

    volume = fb.bake(geometry, resolution=20)

    assert volume.report.closed
    assert volume.report.undecided_voxels == 0
    assert_signs(geometry, voxel_centres(volume), volume.distances.ravel())


@pytest.mark.parametrize("name", meshes.CLOSED)
def test_no_wrong_sign_on_a_closed_mesh_at_random_points(name):
    geometry = meshes.CLOSED[name]()
    points = meshes.points_around(geometry, 1_000)

    assert_signs(geometry, points, fb.signed_distance(geometry, points))


@pytest.mark.parametrize("method", SIGNED_METHODS)
@pytest.mark.parametrize("name", ["cube", "tetrahedron", "icosphere", "uv_sphere", "torus", "knot", "capsule"])
def test_all_methods_agree_on_clean_meshes(name, method):
    geometry = meshes.CLOSED[name]()
    points = meshes.points_around(geometry, 1_000)

    assert_signs(geometry, points, fb.signed_distance(geometry, points, sign=method))


@pytest.mark.parametrize("name", ["knot", "open_box", "soup"])
def test_the_method_never_changes_the_magnitude(name):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    points = meshes.points_around(geometry, 500)
    unsigned = fb.signed_distance(geometry, points, sign="unsigned")

    assert (unsigned >= 0).all()
    for method in SIGNED_METHODS:
        assert np.array_equal(np.abs(fb.signed_distance(geometry, points, sign=method)), unsigned)


@pytest.mark.parametrize("method", SIGNED_METHODS)
def test_a_cube_aligned_with_the_grid(method):
    # Voxel centres at -2, -1.5, ..., 2: rows of them lie on the faces, edges and corners of the cube from -1 to 1.
    volume = fb.bake(meshes.box(), resolution=(9, 9, 9), bounds=[(-2.25,) * 3, (2.25,) * 3], sign=method)

    expected = truth.box(truth.grid_points(*volume.bounds, volume.resolution))
    off_surface = expected != 0  # by half a unit or more
    assert np.abs(volume.distances - expected).max() <= truth.tolerance(*meshes.box()).item()
    assert np.array_equal(volume.distances[off_surface] < 0, expected[off_surface] < 0)
    assert not off_surface.all()


@pytest.mark.parametrize("method", SIGNED_METHODS)
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_a_tetrahedron_with_points_exactly_above_its_edges_and_corners(method, shift):
    vertices, faces = meshes.scale_and_shift(meshes.tetrahedron(), 1.0, (shift, -shift, shift))
    middles = [vertices[list(pair)].mean(axis=0) for pair in itertools.combinations(range(4), 2)]
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    outward = [p + reach * (p - vertices.mean(axis=0)) for p in [*vertices, *middles] for reach in (0.125, 1, 16)]
    straight = [p + reach * axis for p in [*vertices, *middles] for axis in axes for reach in (0.25, 1, 16)]
    inward = [p - 0.25 * (p - vertices.mean(axis=0)) for p in [*vertices, *middles]]
    points = np.array([*outward, *straight, *inward])

    found = fb.signed_distance((vertices, faces), points, sign=method)

    # Corners are whole numbers: the four half-spaces decide without rounding.
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    heights = truth.dot(np.cross(b - a, c - a), points[:, None] - a)
    inside, outside = (heights < 0).all(axis=1), (heights > 0).any(axis=1)
    assert (found[inside] < 0).all()
    assert (found[outside] > 0).all()
    assert inside.any()


def test_a_sphere_seen_from_its_centre():
    sphere = meshes.icosphere(4)

    assert fb.signed_distance(sphere, [[0, 0, 0]])[0] == pytest.approx(-1, abs=truth.facet_error(*sphere, 1.0))


def test_both_sides_of_a_sliver_fin():
    fin = meshes.sliver_fin()
    height = np.linspace(0.1, 0.9, 9)
    inside = np.stack([0 * height + 0.37, 0 * height, height], axis=1)
    beside = inside - (0, 2e-4, 0)

    assert (fb.signed_distance(fin, inside) < 0).all()
    assert (fb.signed_distance(fin, beside) > 0).all()


def test_an_inside_out_sphere_is_the_same_solid():
    sphere = meshes.icosphere()

    volume = fb.bake(meshes.flip(sphere), resolution=24)

    assert_same_field(sphere, volume, fb.bake(sphere, resolution=24))
    assert any("inside out" in warning for warning in volume.report.warnings)


def test_a_hollow_sphere_stays_hollow():
    values = fb.signed_distance(meshes.hollow_sphere(1.0, 0.6), [[0, 0, 0], [0.8, 0, 0], [1.2, 0, 0]])

    assert (np.sign(values) == [1, -1, 1]).all()


def test_nested_shells_are_solid():
    values = fb.signed_distance(meshes.nested_shells(1.0, 0.6), [[0, 0, 0], [0.8, 0, 0], [1.2, 0, 0]])

    assert (np.sign(values) == [-1, -1, 1]).all()


def test_parity_makes_nested_shells_hollow():
    values = fb.signed_distance(meshes.nested_shells(1.0, 0.6), [[0, 0, 0], [0.8, 0, 0]], sign="parity")

    assert (np.sign(values) == [1, -1]).all()


def test_two_overlapping_boxes_are_solid_where_they_overlap():
    values = fb.signed_distance(meshes.overlapping_boxes(), [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [2, 0, 0]])

    assert (np.sign(values) == [-1, -1, -1, 1]).all()


def test_shared_corners_or_separate_ones_make_no_difference():
    knot = meshes.knot(48, 8)

    separate = fb.bake(meshes.split_vertices(knot), resolution=20)

    assert separate.report.closed
    assert np.array_equal(separate.distances, fb.bake(knot, resolution=20).distances)


def test_two_cubes_that_share_an_edge():
    touching = meshes.join(meshes.box((0, 0, 0), (1, 1, 1)), meshes.box((1, 1, 0), (2, 2, 1)))

    volume = fb.bake(touching, resolution=20)

    assert volume.report.closed
    assert_signs(touching, voxel_centres(volume), volume.distances.ravel())


# --- open and dirty


@pytest.mark.parametrize("name", meshes.OPEN)
@pytest.mark.parametrize("method", ["auto", "winding"])
def test_open_and_dirty_meshes_follow_the_winding_number(name, method):
    geometry = meshes.OPEN[name]()
    # Faces turned against their neighbours are turned back.
    reference = meshes.icosphere() if name == "flipped_faces" else geometry
    points = meshes.points_around(geometry, 1_000)

    assert_signs(reference, points, fb.signed_distance(geometry, points, sign=method), undecided=FAST_WINDING_ERROR)


@pytest.mark.parametrize("method", [*SIGNED_METHODS, "unsigned"])
@pytest.mark.parametrize("name", meshes.OPEN)
def test_no_method_loses_its_distance_on_a_dirty_mesh(name, method):
    geometry = meshes.OPEN[name]()

    volume = fb.bake(geometry, resolution=12, sign=method)

    expected = truth.Reference(*geometry).distance(voxel_centres(volume))
    assert np.abs(np.abs(volume.distances.ravel()) - expected).max() <= truth.tolerance(*geometry, expected).max()


def test_a_box_without_a_lid_still_has_an_inside():
    volume = fb.bake(meshes.open_box(), resolution=24)

    assert volume.report.boundary_edges == 4
    assert not volume.report.closed
    assert any("open" in warning for warning in volume.report.warnings)
    assert (np.sign(volume.sample([[0, 0, 0], [0, 0, -0.9], [0, 0, 1.15], [0, 0, -1.05]])) == [-1, -1, 1, 1]).all()
    assert_signs(meshes.open_box(), voxel_centres(volume), volume.distances.ravel(), undecided=FAST_WINDING_ERROR)


def test_a_surface_that_is_open_without_a_boundary_says_where():
    """A wall between two edges of a box: three faces meet at each edge of the wall."""
    vertices, faces = meshes.box()
    corners = [(-1, -1, -1), (-1, -1, 1), (1, 1, 1), (1, 1, -1)]
    a, b, c, d = (int(np.abs(vertices - corner).sum(axis=1).argmin()) for corner in corners)
    walled = vertices, np.vstack([faces, [(a, b, c), (a, c, d)]])
    for warnings in (fb.bake(walled, 16).report.warnings, fb.query(walled, [(0, 0, 0)]).report.warnings):
        assert warnings == (
            "the surface is open (it has no boundary, but 4 edges of more than two faces, which do not pair up): "
            "inside is where its winding number exceeds 1/2",
        )


def test_the_opening_of_a_cone_of_100_000_slivers_is_exact():
    """The opening covers at most half of the sphere of directions, so the inside is the cone with its base."""
    angle = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    around = np.arange(len(ring))
    faces = np.stack([0 * around, 1 + around, 1 + (around + 1) % len(ring)], axis=1)
    cone = fb.Mesh(np.vstack([(0.0, 0.0, 1.0), ring]), faces)
    points = np.random.default_rng(4).uniform((-1.2, -1.2, -0.5), (1.2, 1.2, 1.2), (2000, 3))
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    clear = (np.abs(radius + height - 1) > 1e-6) & (np.abs(height) > 1e-6)
    found = fb.contains(cone, points)
    np.testing.assert_array_equal(found[clear], ((height > 0) & (radius + height < 1))[clear])
    assert found.any()


@pytest.mark.parametrize("name", ["triangle", "flat_sheet"])
def test_a_sheet_has_no_inside_and_the_report_says_what_to_do(name):
    volume = fb.bake(meshes.OPEN[name](), resolution=16)

    assert (volume.distances >= 0).all()
    assert volume.report.inside_voxels == 0
    assert any("two_sided" in warning for warning in volume.report.warnings)


def test_a_cracked_sphere_is_as_solid_as_a_whole_one():
    sphere = meshes.icosphere()
    volume = fb.bake(meshes.cracked(sphere, 1e-5), resolution=24)

    reference = truth.Reference(*sphere)
    distance, winding = reference.distance(voxel_centres(volume)), reference.winding_number(voxel_centres(volume))
    expected = np.where(winding > 0.5, -distance, distance)
    # Every corner moved by 1e-5 at most, so the surface did too.
    assert np.abs(volume.distances.ravel() - expected).max() <= 1e-5 + truth.tolerance(*sphere).item()
    assert volume.report.boundary_edges == 3 * len(sphere.faces)


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_flipped_faces_are_turned_and_counted(share):
    sphere = meshes.icosphere()
    flipped = meshes.flip_some(sphere, share)
    turned = int((flipped.faces != sphere.faces).any(axis=1).sum())

    volume = fb.bake(flipped, resolution=24)

    assert volume.report.flipped_faces == turned
    assert_same_field(sphere, volume, fb.bake(sphere, resolution=24))


@pytest.mark.parametrize("double", [meshes.doubled, meshes.doubled_opposite])
def test_a_doubled_mesh_is_the_same_solid(double):
    sphere = meshes.icosphere()

    volume = fb.bake(double(sphere), resolution=24)

    assert volume.report.duplicate_faces == len(sphere.faces)
    assert_same_field(sphere, volume, fb.bake(sphere, resolution=24))


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_a_long_opening_is_exact():
    # A cone of 2,500 slivers without its base: the opening has as many edges as the mesh has faces.
    count = 2_500
    angle = 2 * np.pi * np.arange(count) / count
    vertices = np.concatenate([[(0, 0, 1.5)], np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)])
    corners = np.arange(count)
    cone = vertices, np.stack([0 * corners, 1 + corners, 1 + (corners + 1) % count], axis=1)

    volume = fb.bake(cone, resolution=12)

    assert 0 < volume.report.inside_voxels < volume.distances.size
    assert_signs(cone, voxel_centres(volume), volume.distances.ravel(), undecided=1e-9)


def test_a_hole_the_size_of_one_triangle_does_not_leak():
    sphere = meshes.icosphere()
    pierced = meshes.Geometry(sphere.vertices, sphere.faces[1:])

    volume = fb.bake(pierced, resolution=24)

    assert volume.report.boundary_edges == 3
    assert_signs(pierced, voxel_centres(volume), volume.distances.ravel(), undecided=FAST_WINDING_ERROR)


# --- the report


@pytest.mark.parametrize(
    ("make", "facts"),
    [
        (meshes.box, {"closed": True, "components": 1, "boundary_edges": 0, "nonmanifold_edges": 0}),
        (meshes.nested_shells, {"closed": True, "components": 2}),
        (meshes.triangle, {"closed": False, "components": 1, "boundary_edges": 3}),
        (lambda: meshes.flat_sheet(4), {"closed": False, "boundary_edges": 16}),
        (lambda: meshes.soup(50), {"closed": False, "components": 50, "boundary_edges": 150}),
        (
            lambda: meshes.Geometry(
                np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], float),
                np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
            ),
            {"nonmanifold_edges": 1, "boundary_edges": 6},
        ),
    ],
    ids=["box", "nested shells", "triangle", "sheet", "soup", "three faces on one edge"],
)
def test_the_report_counts_what_is_there(make, facts):
    report = fb.bake(make(), resolution=6).report

    assert {name: getattr(report, name) for name in facts} == facts


def test_the_report_says_which_rule_and_why():
    report = fb.bake(meshes.icosphere(), resolution=8).report

    assert report.sign_method in ("scan", "winding")
    assert "closed" in report.sign_reason
    assert report.device == "cpu"
    assert report.inside_voxels > 0
    assert all(seconds >= 0 for seconds in report.seconds.values())
    assert "closed" in str(report)


@pytest.mark.parametrize("method", ["winding", "parity", "pseudonormal", "normal", "unsigned"])
def test_an_explicit_method_is_the_one_reported(method):
    assert fb.bake(meshes.box(), resolution=6, sign=method).report.sign_method == method


def test_inside_voxels_counts_the_negative_ones():
    volume = fb.bake(meshes.icosphere(), resolution=16)

    assert volume.report.inside_voxels == np.count_nonzero(volume.distances < 0)


def test_warnings_are_logged(caplog):
    fb.bake(meshes.open_box(), resolution=6)

    assert "open" in caplog.text


@pytest.mark.parametrize("method", ["", "Winding", "flood", None, 3])
def test_an_unknown_method_is_refused(method):
    with pytest.raises((fb.ArgumentError, TypeError), match="sign"):
        fb.bake(meshes.box(), resolution=6, sign=method)
