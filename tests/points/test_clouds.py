"""Clouds of points: winding numbers and distances against sums over all points, sides against the mesh."""

import copy
import pickle

import igl
import numpy as np
import pytest
from scipy.spatial import cKDTree

import fieldbake as fb
import meshes
import truth_points as truth

#: Twelve meshes, from smooth to sharp, closed, hollow and open.
MESHES = {**meshes.CLOSED, "open_box": meshes.open_box, "flat_sheet": meshes.flat_sheet}
NAMES = [name for name in MESHES if name not in ("tetrahedron", "triangle")][:12]


def cloud_of(geometry, count, seed=0):
    samples = fb.sample_surface(geometry, count, seed=seed)
    return fb.PointCloud(samples.points, samples.normals)


def points_near(cloud, count, seed=1):
    """Half of the points within 3 spacings of the cloud, half in its box and around it."""
    random = np.random.default_rng(seed)
    near = random.choice(cloud.points, count // 2) + random.uniform(-3, 3, (count // 2, 3)) * cloud.spacing
    extent = np.ptp(cloud.bounds, axis=0).max()
    around = random.uniform(-1, 1, (count - count // 2, 3)) * extent + cloud.bounds.mean(axis=0)
    return np.concatenate([near, around])


@pytest.mark.parametrize(
    "name", [name if name in NAMES[:3] else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]
)
def test_winding_numbers_are_within_the_error_of_the_sum(name):
    cloud = cloud_of(MESHES[name](), 20_000)
    points = points_near(cloud, 2_000)

    exact = truth.winding_number(cloud.points, cloud.normals, cloud.areas, points)

    for error in (1e-2, 1e-3, 1e-5):
        found = fb.winding_number(cloud, points, error=error)
        assert np.abs(found - exact).max() <= error
    assert np.abs(fb.winding_number(cloud, points) - exact).max() <= 1e-3
    # The sum decides the side, without exception.
    turned = -1.0 if cloud.report.inside_out else 1.0
    decided = np.abs(turned * exact - 0.5) > 1e-6
    assert (fb.contains(cloud, points) == (turned * exact > 0.5))[decided].all()


def test_the_sum_is_that_of_igl():
    cloud = cloud_of(meshes.knot(), 3_000)
    points = points_near(cloud, 400)

    # Far from the points the tree of igl is accurate.
    far = points[fb.closest_point(cloud, points).distances > 10 * cloud.spacing]
    theirs = igl.fast_winding_number(cloud.points, cloud.normals, cloud.areas, far)

    assert np.abs(fb.winding_number(cloud, far, error=1e-6) - theirs).max() <= 5e-3


@pytest.mark.parametrize("name", ["knot", "size_ratio", "flat_sheet"])
def test_distances_are_those_of_the_disks(name):
    cloud = cloud_of(MESHES[name](), 2_000)
    points = points_near(cloud, 10_000)

    found = fb.closest_point(cloud, points)

    diagonal = np.linalg.norm(np.ptp(cloud.bounds, axis=0))
    expected = truth.distance_to_disks(cloud.points, cloud.normals, cloud.areas, points)
    assert np.abs(found.distances - expected).max() <= 1e-6 * diagonal
    # The nearest point is on the named disk, at the distance.
    away = found.points - cloud.points[found.faces]
    assert np.abs(np.einsum("ij,ij->i", away, cloud.normals[found.faces])).max() <= 1e-12 * diagonal
    radius = np.sqrt(cloud.areas[found.faces] / np.pi)
    assert (np.linalg.norm(away, axis=1) <= radius * (1 + 1e-12)).all()
    assert np.abs(np.linalg.norm(found.points - points, axis=1) - found.distances).max() <= 1e-12 * diagonal
    assert (found.barycentric == (1, 0, 0)).all()
    assert np.array_equal(found.normals, cloud.normals[found.faces])
    # All functions return the same distance.
    query = fb.query(cloud, points)
    assert np.array_equal(np.abs(query.distances), found.distances)
    assert np.array_equal(query.distances < 0, fb.contains(cloud, points))
    assert np.array_equal(fb.signed_distance(cloud, points, dtype="float64"), query.distances)
    assert np.array_equal(fb.signed_distance(cloud, points), query.distances.astype(np.float32))
    assert np.array_equal(fb.signed_distance(cloud, points, sign="unsigned", dtype="float64"), found.distances)


@pytest.mark.parametrize("normals", [True, False])
def test_points_without_areas_have_the_distances_of_a_kd_tree(normals):
    samples = fb.sample_surface(meshes.knot(), 5_000)
    cloud = fb.PointCloud(samples.points, samples.normals if normals else None, areas=0)
    points = points_near(cloud, 10_000)

    found = fb.closest_point(cloud, points)

    expected, rows = cKDTree(cloud.points).query(points)
    assert np.abs(found.distances - expected).max() <= 1e-12
    assert (found.faces == rows).mean() == 1
    if not normals:
        assert (found.normals == 0).all()


def test_gradients_point_away_from_the_inside():
    cloud = cloud_of(meshes.icosphere(4), 4_000)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (500, 3))

    found = fb.query(cloud, points)

    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-9
    radius = np.linalg.norm(points, axis=1)
    clear = (np.abs(radius - 1) > 3 * cloud.spacing) & (radius > 0.3)
    along = np.einsum("ij,ij->i", found.gradients, points)[clear] / radius[clear]
    assert along.min() > 0.9
    # On the disks the gradient is the normal.
    assert np.abs(fb.query(cloud, cloud.points).gradients - cloud.normals).max() <= 1e-12


def test_areas_follow_the_eighth_neighbour_and_are_shared_by_copies():
    samples = fb.sample_surface(meshes.icosphere(4), 3_000)
    cloud = fb.PointCloud(samples.points, samples.normals)
    distance = cKDTree(cloud.points).query(cloud.points, 9)[0][:, 8]
    assert np.allclose(cloud.areas, np.pi * distance**2 / 8, rtol=1e-12)
    assert cloud.spacing == pytest.approx(np.median(distance) * np.sqrt(np.pi / 8), rel=1e-3)

    thrice = fb.PointCloud(np.tile(samples.points, (3, 1)), np.tile(samples.normals, (3, 1)))
    assert thrice.report.duplicates == 6_000
    assert np.allclose(thrice.areas, np.tile(cloud.areas, 3) / 3, rtol=1e-12)

    far = fb.PointCloud(np.concatenate([samples.points, [(40, 0, 0)]]), np.concatenate([samples.normals, [(1, 0, 0)]]))
    assert far.report.outliers == 1
    assert far.areas[-1] == pytest.approx(25 * np.median(far.areas), rel=1e-2)
    with pytest.warns(fb.SurfaceWarning, match="1 point of the cloud lie far from all others"):
        fb.contains(far, [(0, 0, 0)])


def test_inside_out_clouds_have_their_air_inside():
    samples = fb.sample_surface(meshes.icosphere(4), 4_000)
    room = fb.PointCloud(samples.points, -samples.normals)
    points = np.random.default_rng(2).uniform(-1.5, 1.5, (1_000, 3))
    clear = np.abs(np.linalg.norm(points, axis=1) - 1) > 2 * room.spacing

    assert room.report.inside_out
    assert np.array_equal(fb.contains(room, points)[clear], (np.linalg.norm(points, axis=1) < 1)[clear])
    assert fb.winding_number(room, [(0, 0, 0)])[0] == pytest.approx(-1, abs=0.05)
    assert fb.query(room, [(0, 0, 0.5)]).gradients[0, 2] > 0.9


def test_given_normals_are_normalised_and_never_turned():
    samples = fb.sample_surface(meshes.icosphere(), 500)
    lengths = np.random.default_rng(0).uniform(1e-200, 1e30, (500, 1))
    cloud = fb.PointCloud(samples.points, -samples.normals * lengths)
    assert np.abs(cloud.normals + samples.normals).max() <= 1e-15
    assert cloud.report.normals == "given"


@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_grids_have_the_distances_of_their_points(kind):
    cloud = cloud_of(meshes.torus(), 4_000)
    volume = fb.bake(cloud, 24) if kind == "dense" else fb.bake_sparse(cloud, 24, tolerance=None).to_volume()
    corners = np.meshgrid(*volume.coordinates, indexing="ij")
    points = np.stack(corners, axis=-1)
    expected = fb.signed_distance(cloud, points)
    near = np.abs(expected) < (np.inf if kind == "dense" else 3 * volume.spacing.max())
    assert np.array_equal(volume.distances[near], expected[near])
    assert np.array_equal(volume.distances < 0, expected < 0)
    report = volume.report
    assert (report.sign_method, report.faces, report.vertices, report.closed) == ("winding", 0, 4_000, False)
    assert report.inside_voxels == np.count_nonzero(expected < 0)
    assert report.undecided_voxels == 0
    unsigned = fb.bake(cloud, 24, sign="unsigned")
    assert np.array_equal(unsigned.distances, np.abs(fb.bake(cloud, 24).distances))


def test_a_hole_is_reported_and_nothing_else():
    vertices, faces = meshes.icosphere(5)
    samples = fb.sample_surface((vertices, faces), 6_000)
    removed = samples.points[:, 2] > 0.6  # a fifth of the area
    assert 0.19 < removed.mean() < 0.21
    cloud = fb.PointCloud(samples.points[~removed], samples.normals[~removed])
    with pytest.warns(fb.SurfaceWarning, match="is a guess: they lie far from all points, across a hole"):
        volume = fb.bake(cloud, 28)
    assert volume.report.undecided_voxels > 0
    # The undecided samples lie within the radius of the hole, 0.8, of the removed cap.
    points = np.stack(np.meshgrid(*volume.coordinates, indexing="ij"), axis=-1).reshape(-1, 3)
    winding = fb.winding_number(cloud, points, error=1e-6)
    undecided = (np.abs(winding - 0.5) < 0.15) & (fb.closest_point(cloud, points).distances > 2 * cloud.spacing)
    assert volume.report.undecided_voxels == np.count_nonzero(undecided)
    with pytest.warns(fb.SurfaceWarning, match="is a guess"):
        assert fb.query(cloud, points).report.undecided_points == np.count_nonzero(undecided)
    # Samples on the common faces of bricks count once.
    with pytest.warns(fb.SurfaceWarning, match="is a guess"):
        sparse = fb.bake_sparse(cloud, 28)
    assert sparse.report.undecided_voxels == np.count_nonzero(undecided)
    assert cKDTree(samples.points[removed]).query(points[undecided])[0].max() < 0.8

    whole = fb.PointCloud(samples.points, samples.normals)
    assert fb.bake(whole, 28).report.undecided_voxels == 0
    assert fb.query(whole, points).report.undecided_points == 0


def test_flipped_normals_are_reported():
    samples = fb.sample_surface(meshes.icosphere(5), 5_000)
    cloud = fb.PointCloud(samples.points, samples.normals)
    assert cloud.report.agreement > 0.99
    normals = samples.normals.copy()
    normals[::10] *= -1
    flipped = fb.PointCloud(samples.points, normals)
    assert flipped.report.agreement == pytest.approx(0.9, abs=0.03)
    with pytest.warns(fb.SurfaceWarning, match="of the normals contradict the other points"):
        fb.signed_distance(flipped, [(0, 0, 0)])


def test_geo_referenced_clouds_are_those_at_the_origin():
    samples = fb.sample_surface(meshes.icosphere(4), 20_000)
    shift = np.array([5e6, 4.5e6, 300.0])
    near, far = (fb.PointCloud(samples.points + move, samples.normals) for move in (np.zeros(3), shift))
    assert near.spacing == pytest.approx(0.025, rel=0.2)
    points = points_near(near, 1_000)
    # Positions there are multiples of 1e-9.
    assert np.abs(fb.query(near, points).distances - fb.query(far, points + shift).distances).max() <= 1e-8
    assert np.abs(fb.winding_number(near, points) - fb.winding_number(far, points + shift)).max() <= 2e-3


def test_clouds_pickle_and_are_immutable():
    cloud = cloud_of(meshes.torus(), 1_000)
    points = points_near(cloud, 50)
    for other in (pickle.loads(pickle.dumps(cloud)), copy.deepcopy(cloud)):
        assert np.array_equal(other.points, cloud.points)
        assert np.array_equal(fb.query(other, points).distances, fb.query(cloud, points).distances)
        assert str(other.report) == str(cloud.report)
    assert np.array_equal(np.asarray(cloud), cloud.points)
    assert len(cloud) == 1_000
    for array in (cloud.points, cloud.normals, cloud.areas, cloud.bounds):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_threads_change_no_bit():
    cloud = cloud_of(meshes.knot(), 5_000)
    points = points_near(cloud, 5_000)
    results = []
    for threads in (1, 3):
        fb.set_threads(threads)
        again = fb.PointCloud(cloud.points, cloud.normals)
        results.append((again.areas, fb.query(again, points).distances, fb.winding_number(again, points)))
    fb.set_threads(2)
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))


def test_solids_of_clouds_are_closed():
    mesh = fb.Mesh(*meshes.torus())
    cloud = cloud_of(mesh, 10_000)

    made = fb.solid(cloud, 96)

    assert made.is_closed
    assert made.topology()["nonmanifold_edges"] == 0
    assert made.report.genus == 1
    assert made.report.distance_to_source <= 2 * cloud.spacing
    assert made.report.distance_from_source <= 2 * cloud.spacing
    distance = fb.closest_point(mesh, fb.sample_surface(made, 5_000).points).distances
    assert distance.mean() <= 0.25 * cloud.spacing
    assert np.quantile(distance, 0.99) <= cloud.spacing


@pytest.mark.parametrize("resolution", [64, 80, 128])
def test_noise_makes_no_voids(resolution):
    random = np.random.default_rng(5)
    samples = fb.sample_surface(fb.ellipsoid((30, 20, 12)).to_mesh(128), 8_000, seed=1)
    cloud = fb.PointCloud(samples.points + random.normal(size=(8_000, 3)) * 0.15, samples.normals)

    made = fb.solid(cloud, resolution)

    assert made.report.bodies == 1
    # A mean shift of the surface by a tenth of the noise is a volume of 0.26 %.
    assert made.volume == pytest.approx(4 / 3 * np.pi * 30 * 20 * 12, rel=5e-3)
