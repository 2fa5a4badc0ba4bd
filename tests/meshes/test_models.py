"""Real models: exact distances and signs over whole grids, and clear errors for damaged files."""

import numpy as np
import pytest

import fieldbake as fb
import truth

RESOLUTION = 32
RANDOM_POINTS = 2_000

#: Closed and consistently oriented models, as the README of the mesh folder lists them. All signs must be correct.
CLOSED = ["spot/spot.obj", "armadillo.obj", "rocker-arm.obj", "fandisk.obj"]

#: Open, flat, doubled and flipped models, whose distances are exact too.
OTHERS = [
    "stanford-bunny.obj",
    "suzanne.obj",
    "teapot.obj",
    "woody.obj",
    "soup.stl",
    "spider/spider.obj",
    "AlphaBlendModeTest.glb",
    "CesiumMilkTruck.glb",
    "foliage_cards.glb",
]

#: In the wheel of pymeshlab, so that some real models are always there; both are closed.
SAMPLES = ["bunny.obj", "cow.obj"]

#: Open models whose openings are few: their sign is exact too.
FEW_OPENINGS = ["stanford-bunny.obj", "suzanne.obj", "teapot.obj"]


def assert_exact(mesh, signs):
    """Distances against float64 on a whole grid and at random points; signs too on request."""
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    reference = truth.Reference(vertices, faces)
    volume = fb.bake(mesh, resolution=RESOLUTION)
    grid = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    somewhere = np.random.default_rng(7).uniform(*volume.bounds, size=(RANDOM_POINTS, 3))

    # Positions are kept as float32 offsets from the centre; as float32 world positions, read back here, they are
    # rounded once more.
    rounding = np.sqrt(3) * truth.FLOAT32_ROUNDING * np.abs(volume.bounds).max()
    tolerance = truth.tolerance(vertices, faces).item() + rounding
    for points, found in ((grid, volume.distances.ravel()), (somewhere, fb.signed_distance(mesh, somewhere))):
        distance = reference.distance(points)
        assert np.abs(np.abs(found) - distance).max() <= tolerance
        if signs:
            inside = np.abs(reference.winding_number(points)) > 0.5
            assert truth.sign_errors(found, distance, inside, tolerance) == 0


@pytest.mark.parametrize("name", SAMPLES)
def test_sample_models_are_exact_and_never_wrong_about_the_side(sample_path, name):
    mesh = fb.load_mesh(sample_path(name))

    assert mesh.topology()["closed"]
    assert_exact(mesh, signs=True)


@pytest.mark.parametrize("name", CLOSED)
def test_closed_models_are_exact_and_never_wrong_about_the_side(model_path, name):
    mesh = fb.load_mesh(model_path(name))

    assert mesh.topology()["closed"]
    assert_exact(mesh, signs=True)


@pytest.mark.parametrize("name", OTHERS)
def test_open_and_dirty_models_are_exact(model_path, name):
    assert_exact(fb.load_mesh(model_path(name)), signs=False)


@pytest.mark.parametrize("name", FEW_OPENINGS)
def test_models_with_few_openings_follow_the_winding_number(model_path, name):
    mesh = fb.load_mesh(model_path(name))
    volume = fb.bake(mesh, resolution=RESOLUTION)
    reference = truth.Reference(mesh.vertices, mesh.faces)
    points = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)

    winding = np.abs(reference.winding_number(points))

    # Both sums are float64; where they stand a millionth of a turn from the threshold, either side will do.
    decided = (np.abs(winding - 0.5) > 1e-6) & (reference.distance(points) > truth.tolerance(mesh.vertices, mesh.faces))
    assert ((volume.distances.ravel() < 0) == (winding > 0.5))[decided].all()


def test_all_signs_agree_on_a_clean_model(sample_path):
    mesh = fb.load_mesh(sample_path("bunny.obj"))  # the cow pierces itself, which pseudonormals cannot see
    points = np.random.default_rng(8).uniform(*mesh.bounds, size=(RANDOM_POINTS, 3))
    expected = fb.signed_distance(mesh, points)
    clear = np.abs(expected) > truth.tolerance(mesh.vertices, mesh.faces)

    for method in ("winding", "parity", "pseudonormal"):
        found = fb.signed_distance(mesh, points, sign=method)
        assert np.array_equal((found < 0)[clear], (expected < 0)[clear]), method


@pytest.mark.parametrize("name", ["empty.ply", "inf_nan.obj", "malformed.obj"])
def test_a_broken_file_is_refused_by_name(model_path, name):
    with pytest.raises(fb.MeshError, match=name):
        fb.load_mesh(model_path(f"bad/{name}"))


def test_a_file_with_a_degenerate_face_is_read_without_it(model_path):
    mesh = fb.load_mesh(model_path("bad/deg_faces.obj"))

    assert mesh.topology()["degenerate_faces"] == 1
    assert len(mesh.faces) == 3


def test_the_textured_model_brings_its_texture(model_path):
    mesh = fb.load_mesh(model_path("spot/spot.obj"))

    assert mesh.uv.shape == (len(mesh.vertices), 2)
    assert mesh.texture.dtype == np.uint8
    assert mesh.texture.shape[2] == 4


def test_nodes_of_a_scene_are_placed(model_path):
    mesh = fb.load_mesh(model_path("CesiumMilkTruck.glb"))

    # The front and rear wheels are one mesh, placed twice.
    assert len(mesh.parts) == 5 or len(mesh.faces) > 3624
    assert np.isfinite(mesh.bounds).all()


def test_cut_out_leaves_know_their_opacity(model_path):
    mesh = fb.load_mesh(model_path("foliage_cards.glb"))

    masked = [part for part in mesh.parts if part.alpha_mode == "mask"]
    assert masked
    assert set(np.unique(masked[0].alpha)) == {0.0, 1.0}
