"""Every development model as a solid: closed, oriented, two-manifold, accepted by other libraries."""

import numpy as np
import pytest

import fieldbake as fb
from manifold import faults

MODELS = (
    "AlphaBlendModeTest.glb",
    "CesiumMilkTruck.glb",
    "armadillo.obj",
    "fandisk.obj",
    "foliage_cards.glb",
    "rocker-arm.obj",
    "soup.stl",
    "spider/spider.obj",
    "spot/spot.obj",
    "stanford-bunny.obj",
    "suzanne.obj",
    "teapot.obj",
    "woody.obj",
    "bad/deg_faces.obj",
    "bad/empty.ply",
    "bad/inf_nan.obj",
    "bad/malformed.obj",
)

#: Files without an inside or without a usable triangle: a clear error is the right answer.
ERRORS_ALLOWED = ("AlphaBlendModeTest.glb", "soup.stl", "woody.obj", "bad/", "foliage_cards.glb")


def assert_solid(mesh):
    manifold3d = pytest.importorskip("manifold3d")
    assert faults(mesh.vertices, mesh.faces) == []
    parts = np.array(mesh.vertices, np.float32, order="C"), np.array(mesh.faces, np.uint32, order="C")
    assert manifold3d.Manifold(manifold3d.Mesh(*parts)).status() == manifold3d.Error.NoError
    assert mesh.to_trimesh().is_watertight


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [32, 64, 128])
@pytest.mark.parametrize("name", MODELS)
def test_every_model_gives_a_solid_or_a_clear_error(name, resolution, model_path):
    try:
        mesh = fb.solid(model_path(name), resolution)
    except fb.MeshError:
        assert name.startswith(ERRORS_ALLOWED)
        return
    assert_solid(mesh)


@pytest.mark.slow
@pytest.mark.parametrize("fill", ["winding", "outer"])
@pytest.mark.parametrize("name", ["spider/spider.obj", "CesiumMilkTruck.glb", "teapot.obj", "spot/spot.obj"])
def test_dirty_models_are_filled_both_ways(name, fill, model_path):
    assert_solid(fb.solid(model_path(name), 64, fill=fill, **({"seal": 3} if fill == "outer" else {})))


def random_shape(random, depth=3):
    if depth == 0 or random.random() < 0.2:
        size = random.uniform(0.3, 1, 3)
        made = random.choice(4)
        leaf = (
            fb.sphere(size[0])
            if made == 0
            else fb.box(size)
            if made == 1
            else fb.cylinder(size[0], size[1])
            if made == 2
            else fb.torus(size[0], 0.3 * size[0])
        )
        return leaf.rotate(random.normal(size=3).tolist(), random.uniform(0, 360)).translate(
            random.uniform(-0.7, 0.7, 3)
        )
    op = random.choice(["union", "intersection", "difference"], p=[0.5, 0.2, 0.3])
    pair = random_shape(random, depth - 1), random_shape(random, depth - 1)
    return getattr(pair[0], op)(pair[1], k=float(random.choice([0, 0.1])))


@pytest.mark.slow
def test_three_hundred_random_shapes_give_solids():
    random = np.random.default_rng(7)
    empty = 0
    for _ in range(300):
        mesh = random_shape(random).to_mesh(24, bounds=[(-2, -2, -2), (2, 2, 2)])
        if len(mesh.faces):
            assert_solid(mesh)
        empty += not len(mesh.faces)
    assert empty < 150
