"""Every query on real models, closed and open, moved and scaled, against float64 brute force."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

MODELS = [
    "armadillo.obj",
    "fandisk.obj",
    "rocker-arm.obj",
    "spot/spot.obj",
    "stanford-bunny.obj",
    "suzanne.obj",
    "teapot.obj",
    "woody.obj",
]
PLACES = {"as loaded": (1, 0), "far": (1, 1e4), "small": (1e-3, 0), "large": (1e3, 0)}
#: Points and rays for each model and place.
COUNT = 24


@pytest.fixture(scope="module", params=MODELS)
def model(request, model_path):
    loaded = fb.load_mesh(model_path(request.param))
    return meshes.Geometry(loaded.vertices, loaded.faces.astype(np.int64))


@pytest.fixture(params=PLACES)
def geometry(request, model):
    scale, shift = PLACES[request.param]
    return meshes.scale_and_shift(model, scale, (shift, -shift, shift / 2))


def rounding(geometry):
    """Bound on the rounding of positions: 2^-53 of the largest coordinate, in some 64 operations."""
    return 64 * 2.0**-53 * (np.abs(geometry.vertices).max() + np.ptp(geometry.vertices, axis=0).max())


@pytest.mark.slow
def test_points_agree_with_brute_force(geometry):
    mesh = fb.Mesh(*geometry)
    points = meshes.points_around(geometry, COUNT)

    closest, found = fb.closest_point(mesh, points), fb.query(mesh, points)

    expected = truth.closest_point(*geometry, points)
    winding = truth.winding_number(*geometry, points)
    room = rounding(geometry)
    assert np.abs(closest.distances - expected.distances).max() <= room
    assert np.abs(np.abs(found.distances) - expected.distances).max() <= room
    for result in (closest, found):
        corners = truth.corners(*geometry)[result.faces]
        at_weights = (result.barycentric[:, :, None] * corners).sum(axis=1)
        assert np.abs(at_weights - result.points).max() <= 4 * room
        assert np.abs(np.linalg.norm(result.points - points, axis=1) - expected.distances).max() <= 4 * room
    assert np.abs(fb.winding_number(mesh, points) - winding).max() <= 1e-6
    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-5
    single = fb.signed_distance(mesh, points).astype(np.float64)
    assert (np.abs(single - found.distances) <= truth.tolerance(*geometry, expected.distances)).all()
    if mesh.is_closed:
        assert np.array_equal(found.distances < 0, np.abs(winding) > 0.5)
        assert np.array_equal(fb.contains(mesh, points), found.distances < 0)


@pytest.mark.slow
def test_rays_agree_with_brute_force(geometry):
    mesh = fb.Mesh(*geometry)
    origins = meshes.points_around(geometry, COUNT, 6, spread=2)
    directions = meshes.points_around(geometry, COUNT, 7, spread=0.8) - origins

    hits, listed = fb.cast_rays(mesh, origins, directions), fb.all_intersections(mesh, origins, directions)

    t, least = truth.all_intersections(*geometry, origins, directions)
    t[t < 0] = np.inf
    # The weights of faces that are a thousandth of the model are rounded by a million roundings of its positions.
    room = 1e6 * 2.0**-53 * (1 + np.abs(geometry.vertices).max() / np.ptp(geometry.vertices, axis=0).max())
    clear = ~(np.abs(least) <= room).any(axis=1)
    assert clear.mean() > 0.9
    first = t.min(axis=1)
    assert np.array_equal(hits.hit[clear], np.isfinite(first[clear]))
    both = clear & hits.hit
    assert both.any()
    assert np.abs(hits.t[both] / first[both] - 1).max() <= 1e-6
    counts = np.isfinite(t).sum(axis=1)
    assert np.array_equal(fb.count_intersections(mesh, origins, directions)[clear], counts[clear])
    assert np.array_equal(np.bincount(listed.rays, minlength=COUNT)[clear], counts[clear])
    assert np.array_equal(fb.occluded(mesh, origins, directions), hits.hit)


@pytest.mark.slow
def test_samples_agree_with_brute_force(geometry):
    mesh = fb.Mesh(*geometry)

    surface, training = fb.sample_surface(mesh, COUNT, seed=3), fb.sample_training(mesh, COUNT, seed=3)

    room = rounding(geometry)
    assert truth.closest_point(*geometry, surface.points).distances.max() <= room
    corners = truth.corners(*geometry)[surface.faces]
    assert np.abs((surface.barycentric[:, :, None] * corners).sum(axis=1) - surface.points).max() <= room
    expected = truth.closest_point(*geometry, training.points).distances
    assert np.abs(np.abs(training.distances) - expected).max() <= room
    if mesh.is_closed:
        inside = np.abs(truth.winding_number(*geometry, training.points)) > 0.5
        assert np.array_equal(training.distances < 0, inside)


@pytest.mark.slow
def test_thickness_agrees_with_brute_force(geometry):
    mesh = fb.Mesh(*geometry)
    surface = fb.sample_surface(mesh, COUNT, seed=5)
    normals = mesh.face_normals[surface.faces]

    diameters = fb.thickness(mesh, surface.points, normals)

    largest = 4 * np.ptp(geometry.vertices, axis=0).max()
    for point, normal, diameter in zip(surface.points, normals, diameters, strict=True):
        radius = min(diameter / 2, largest)
        # Surface below 15 degrees does not bound the ball. Without other surface in it, a ball is too small.
        bounded = [
            truth.is_ball_bounded(*geometry, point, normal, radius * factor, np.sin(np.radians(15)))
            for factor in (1 - 1e-4, 1 + 1e-4)
        ]
        assert bounded == [False, np.isfinite(diameter)]
