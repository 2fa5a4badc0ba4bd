"""Recipes: normalisation, layouts that rewritten loaders read, offsets against their distributions, and arguments."""

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import kstest, norm, truncnorm, uniform

import fieldbake as fb
import meshes
import project_loaders as loaders
from fieldbake.scaling.rules import Drawing

#: Least probability of a Kolmogorov-Smirnov test. The seeds are fixed, so a test never fails by chance.
LEAST_P = 1e-3

#: A square sheet with the sides 1. The third coordinate of a point near it is the offset itself.
SHEET = (np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float), np.array([(0, 1, 2), (0, 2, 3)]))

#: Small numbers for each recipe, so that a test takes less than a second.
SMALL = {
    "deepsdf": {"n": 3000},
    "onet": {"n": 1001, "surface_n": 500},
    "vecset": {"n": 900, "near_n": 700, "surface_n": 500},
    "hunyuan": {"n": 600, "shell_resolution": 48},
    "dora": {"n": 1000, "surface_n": 2000, "uniform_n": 300},
}

RECIPES = list(SMALL)


def away(geometry, scale=3.0, shift=(50, -20, 7)):
    """The geometry with other units and another place, and a vertex without a face."""
    vertices, faces = meshes.scale_and_shift(geometry, scale, shift)
    return np.concatenate([vertices, [(1e3, 0, 0)]]), faces


@pytest.mark.parametrize("name", RECIPES)
def test_arrays_have_the_names_shapes_and_types_of_the_recipe(name):
    recipe = fb.training.recipes()[name]
    found = fb.training.sample(meshes.box(), name, **SMALL[name])
    assert list(found) == list(recipe.arrays)
    numbers = {**recipe.numbers, **SMALL[name], "len": len, "ceil": math.ceil}
    numbers["k"] = len(found["pos"]) if name == "deepsdf" else numbers["n"] // 2
    for key, layout in recipe.arrays.items():
        shape = tuple(eval(str(side), numbers) for side in layout.shape)
        assert found[key].shape == shape, key
        assert found[key].dtype.name == layout.dtype, key
        assert np.isfinite(found[key].astype(np.float64)).all()


def test_deepsdf_normalizes_by_the_radius_of_used_vertices():
    vertices, faces = away(meshes.box((-1, -2, -3), (1, 2, 3)))
    matrix = fb.training.recipes()["deepsdf"].transform((vertices, faces))
    used = vertices[:-1]
    center = (used.min(axis=0) + used.max(axis=0)) / 2
    expected = (used - center) / (1.03 * np.linalg.norm(used - center, axis=1).max())
    assert np.abs(used @ matrix[:3, :3].T + matrix[:3, 3] - expected).max() <= 1e-6


@pytest.mark.parametrize(
    ("name", "lower", "upper"),
    [("onet", -0.5, 0.5), ("vecset", -1, 1), ("dora", -1, 1), ("hunyuan", 0, 1 / 1.01)],
)
def test_others_normalize_by_the_longest_side(name, lower, upper):
    vertices, faces = away(meshes.box((-1, -2, -3), (1, 2, 3)))
    matrix = fb.training.recipes()[name].transform((vertices, faces))
    moved = vertices[:-1] @ matrix[:3, :3].T + matrix[:3, 3]
    assert moved[:, 2].min() == pytest.approx(lower, abs=1e-6)
    assert moved[:, 2].max() == pytest.approx(upper, abs=1e-6)
    middle = (moved.min(axis=0) + moved.max(axis=0)) / 2
    if name == "hunyuan":
        assert np.abs(moved.min(axis=0)).max() <= 1e-6
    else:
        assert np.abs(middle).max() <= 1e-6
    assert np.ptp(moved[:, 0]) == pytest.approx((upper - lower) / 3, abs=1e-6)


def test_deepsdf_has_two_offsets_for_each_point_and_then_the_cube():
    # A sheet has no inside, so all rows are in one array, in their order.
    found = fb.training.sample(SHEET, "deepsdf", n=212_766)
    rows = found["pos"]
    near = 2 * (int(0.94 * 212_766) // 2)
    assert (len(rows), len(found["neg"])) == (212_766, 0)
    for first, variance in enumerate((0.005, 0.0005)):
        heights = rows[first:near:2, 2]
        assert len(heights) >= 100_000 - 1
        assert kstest(heights, norm(scale=np.sqrt(variance)).cdf).pvalue > LEAST_P
    for axis in range(3):
        assert kstest(rows[near:, axis], uniform(-1, 2).cdf).pvalue > LEAST_P


def test_deepsdf_takes_the_numbers_of_the_code_for_tests():
    found = fb.training.sample(SHEET, "deepsdf", split="test", n=20_000)["pos"]
    near = 2 * (int(0.94 * 20_000) // 2)
    for first, variance in enumerate((0.05, 0.0005)):
        assert kstest(found[first:near:2, 2], norm(scale=np.sqrt(variance)).cdf).pvalue > LEAST_P
    assert len(fb.training.sample(SHEET, "deepsdf", split="test")["pos"]) == 250_000


def test_deepsdf_has_the_rows_of_odd_numbers():
    # 0.94 n is 47, 48.88, 94 and 0.94, of which the even part lies near the surface.
    for n in (50, 52, 100, 1):
        found = fb.training.sample(SHEET, "deepsdf", n=n)
        assert len(found["pos"]) + len(found["neg"]) == n
    assert len(fb.training.sample(SHEET, "deepsdf", n=100, variances=(0.1, 0.2, 0.3))["pos"]) == 100


def test_deepsdf_divides_by_the_side():
    found = fb.training.sample(meshes.box(), "deepsdf", n=5000)
    assert (found["pos"][:, 3] > 0).all()
    assert (found["neg"][:, 3] <= 0).all()
    half = 1 / np.sqrt(3) / 1.03
    assert (np.abs(found["neg"][:, :3]) <= half + 1e-6).all()


def test_onet_draws_uniform_points_and_then_near_ones():
    found = fb.training.sample(SHEET, "onet", n=200_000, uniform_ratio=0.5)
    points = found["points/points"].astype(np.float64)
    for axis in range(3):
        # Rounding to float16 moves a point by at most 2.4e-4, far less than the test resolves.
        assert kstest(points[:100_000, axis], uniform(-0.55, 1.1).cdf).pvalue > LEAST_P
    rounded = np.random.default_rng(0).uniform(-0.5, 0.5, 100_000) * np.spacing(found["points/points"][100_000:, 2])
    assert kstest(points[100_000:, 2] + rounded, norm(scale=0.01).cdf).pvalue > LEAST_P


def test_vecset_has_equal_parts_of_deviations():
    found = fb.training.sample(SHEET, "vecset", n=100_000, near_n=200_000)
    heights = found["points/near_points"][:, 2]
    for part, deviation in zip(np.split(heights, 2), (0.01, 0.1), strict=True):
        assert kstest(part, norm(scale=deviation).cdf).pvalue > LEAST_P
    assert kstest(found["points/vol_points"].ravel(), uniform(-1, 2).cdf).pvalue > LEAST_P


@pytest.mark.slow
def test_hunyuan_puts_points_near_both_walls_of_a_shell():
    found = fb.training.sample(SHEET, "hunyuan", n=400_000, shell_resolution=64)
    width = 2 / 256
    points = found["sdf/random_near_points"].astype(np.float64)
    # Points so far from the rim come from the flat walls at the heights +-width.
    inner = points[(np.abs(points[:, :2] - 0.495) < 0.495 - 0.25 - 0.02).all(axis=1), 2]
    assert len(inner) > 100_000

    def distribution(heights):
        parts = [
            truncnorm(-0.25 / one, 0.25 / one, loc=wall, scale=one).cdf(heights)
            for one in (0.005, 0.05)
            for wall in (-width, width)
        ]
        return np.mean(parts, axis=0)

    assert kstest(inner, distribution).pvalue > LEAST_P
    volume = found["sdf/vol_points"].astype(np.float64)
    assert kstest(volume.ravel()[:100_000], uniform(-1.05, 2.1).cdf).pvalue > LEAST_P
    surface = found["surface/random_surface"].astype(np.float64)
    flat = surface[(np.abs(surface[:, :2] - 0.495) < 0.4).all(axis=1)]
    # Half a unit of float16 at the width is 4e-6, at a coordinate of 1/2 it is 2.4e-4.
    assert np.abs(np.abs(flat[:, 2]) - width).max() <= 5e-4
    assert (flat[:, 5] * np.sign(flat[:, 2]) > 0.9).all()


def drawing(seed=0):
    return Drawing(fb.Mesh(*meshes.box()), np.zeros(3), 1.0, np.random.default_rng(seed), "auto", "cpu")


def test_offsets_of_edges_have_six_parts_and_the_last_has_the_rest():
    deviations = fb.training.recipes()["hunyuan"].numbers["edge_sigmas"]
    offsets = drawing().shells(np.zeros((124_928, 3)), deviations)
    assert len(offsets) == 124_928
    for part, deviation in enumerate(deviations):
        rows = offsets[part * 20_821 : (part + 1) * 20_821 if part < 5 else None]
        assert len(rows) == (20_821 if part < 5 else 20_823)
        assert kstest(rows.ravel(), norm(scale=deviation).cdf).pvalue > LEAST_P


def test_cut_offsets_are_those_of_a_truncated_normal():
    offsets = drawing().cut(np.zeros((40_000, 3)), 0.2, 0.25)
    assert np.abs(offsets).max() <= 0.25
    assert kstest(offsets.ravel(), truncnorm(-1.25, 1.25, scale=0.2).cdf).pvalue > LEAST_P


def test_creases_are_edges_between_vertices_with_a_steep_face():
    from fieldbake.scaling.rules import _crease_points

    made = drawing()
    vertices, faces = meshes.join(meshes.box(), meshes.icosphere(3, center=(5, 0, 0)))
    made.mesh = mesh = fb.Mesh(vertices, faces)
    found = _crease_points(made, 0.985, 5000)
    # All edges of the box are creases, also the diagonals of its faces, and no edge of the sphere is one.
    assert found[:, 0].max() <= 1
    on = np.abs(np.abs(found[:, :3]) - 1).min(axis=1)
    assert on.max() <= 1e-12
    nearest = fb.closest_point(mesh, found[:, :3])
    assert nearest.distances.max() <= 1e-9
    assert not made.warnings


def test_dora_takes_vertices_and_equal_steps():
    found = fb.training.sample(meshes.box(), "dora", n=1000, surface_n=5000)
    sharp = found["fps_sharp_surface"][:, 0]
    # 500 points are 8 corners and 41 steps inside each of 12 edges.
    assert (np.abs(np.abs(sharp[-8:, :3]) - 1) <= 1e-6).all()
    assert np.abs(np.abs(sharp[-8:, 3:]) - np.sqrt(1 / 3)).max() <= 1e-6
    inner = np.sort(np.abs(sharp[:-8, :3]), axis=1)
    assert np.abs(inner[:, 1:] - 1).max() <= 1e-6
    steps = sharp[:-8].reshape(12, 41, 6)
    for edge in steps:
        along = edge[:, np.ptp(edge[:, :3], axis=0).argmax()]
        assert np.abs(np.sort(along) - np.linspace(-1, 1, 43)[1:-1]).max() <= 1e-6
    assert np.abs(np.sort(np.abs(steps[..., 3:]), axis=2) - [0, np.sqrt(0.5), np.sqrt(0.5)]).max() <= 1e-6
    coarse = found["fps_coarse_surface"][:, 0]
    assert np.abs(np.abs(coarse[:, :3]).max(axis=1) - 1).max() <= 1e-6
    assert (np.einsum("ij,ij->i", coarse[:, :3], coarse[:, 3:]) > 0.99).all()


def test_dora_fills_up_with_single_points_and_keeps_more_vertices_than_points():
    sharp = fb.training.sample(meshes.box(), "dora", n=1010, surface_n=5000)["fps_sharp_surface"]
    assert sharp.shape == (505, 1, 6)
    found = fb.training.sample(meshes.icosphere(3), "dora", n=400, surface_n=5000, angle_deg=1.0)
    assert found["fps_sharp_surface"].shape == (200, 1, 6)
    assert found["sharp_near_surface"].shape == (4 * 642, 4)


def test_the_subsets_of_dora_are_spread_out():
    found = fb.training.sample(meshes.icosphere(3), "dora", n=1000, surface_n=20_000, angle_deg=1.0)
    points = found["fps_coarse_surface"][:, 0, :3].astype(np.float64)
    gaps = np.linalg.norm(points[:, None] - points, axis=2) + 10 * np.eye(len(points))
    # 500 farthest points keep gaps of about sqrt(4 pi / 500) = 0.16; the least gap of random points is near 0.005.
    assert gaps.min() > 0.08


def test_offsets_of_dora_have_their_deviations():
    found = fb.training.sample(SHEET, "dora", n=50_000, surface_n=100_000, uniform_n=100_000)
    rows = found["rand_points"]
    for part, deviation in enumerate((0.001, 0.005)):
        assert kstest(rows[part * 100_000 : (part + 1) * 100_000, 2], norm(scale=deviation).cdf).pvalue > LEAST_P
    assert kstest(rows[200_000:, :3].ravel(), uniform(-1.05, 2.1).cdf).pvalue > LEAST_P
    sharp = np.split(found["sharp_near_surface"], 4)
    for part, deviation in zip(sharp, (0.001, 0.005, 0.007, 0.01), strict=True):
        offsets = part[:, :3] - found["fps_sharp_surface"][:, 0, :3]
        assert kstest(offsets.ravel(), norm(scale=deviation).cdf).pvalue > LEAST_P


@pytest.mark.parametrize("name", ["hunyuan", "dora"])
def test_without_sharp_edges_the_surface_stands_in_with_a_warning(name):
    ball = meshes.icosphere(4)
    # On coarser grids the faces of the shell are so steep that they count as creases.
    numbers = {**SMALL[name], **({"shell_resolution": 96} if name == "hunyuan" else {})}
    with pytest.warns(fb.SurfaceWarning, match="no edge is sharp"):
        found = fb.training.sample(ball, name, **numbers)
    key = "surface/sharp_surface" if name == "hunyuan" else "fps_sharp_surface"
    assert len(found[key]) == (600 if name == "hunyuan" else 500)


@pytest.mark.parametrize("name", RECIPES)
def test_the_seed_decides(name):
    first, again, other = (fb.training.sample(meshes.box(), name, seed=s, **SMALL[name]) for s in (3, 3, 4))
    for key in first:
        assert first[key].tobytes() == again[key].tobytes()
    assert any(first[key].tobytes() != other[key].tobytes() for key in first)


def test_rewritten_loaders_read_the_files(tmp_path, random):
    boxes = {"one": meshes.box(), "two": away(meshes.box((0, 0, 0), (1, 2, 3)))}
    for name in RECIPES:
        rows = fb.training.sample_many(boxes, tmp_path / name, name, workers=1, **SMALL[name])
        assert [(row["status"], row["error"]) for row in rows] == [("done", None)] * 2
    assert loaders.deepsdf(tmp_path / "deepsdf" / "two.npz", 100, random).shape == (100, 4)

    found = loaders.onet(tmp_path / "onet" / "two")
    assert found["points"].shape == (1001, 3)
    assert found["loc"] == pytest.approx([51.5, -17, 11.5])
    assert found["scale"] == 9
    world = found["points"] * found["scale"] + found["loc"]
    # The side of a point within half a unit of float16 of the surface is not decided here.
    lower, upper = np.array([50, -20, 7]), np.array([53, -14, 16])
    gap = np.minimum(world - lower, upper - world).min(axis=1)
    decided = np.abs(gap) > 9 * 3e-4
    assert ((gap > 0) == found["occ"])[decided].all()

    points, labels, surface = loaders.vecset(tmp_path / "vecset", "03001627", "two", random, 300)
    half = np.array([1, 2, 3]) / 3
    gap = (half - np.abs(points)).min(axis=1)
    assert ((gap > 0) == labels)[np.abs(gap) > 1e-6].all()
    assert np.abs((half - np.abs(surface)).min(axis=1)).max() <= 1e-6
    assert surface.dtype == np.float32

    rows, found = loaders.hunyuan(tmp_path / "hunyuan" / "two", 500, random)
    assert rows.shape == (1000, 7)
    assert len(np.unique(rows[:500, :3], axis=0)) > 490
    assert np.abs(np.linalg.norm(rows[:, 3:6], axis=1) - 1).max() <= 1e-6
    assert found["vol_points"].shape == (1200, 3)
    assert (found["vol_label"] > 0).any()
    assert found["random_near_label"].shape == (1200,)

    found = loaders.dora(tmp_path / "dora" / "two.npz", near=4000)
    assert found["cube"].shape == (300, 4)
    assert found["sharp"].shape == found["coarse"].shape == (500, 6)


@pytest.mark.parametrize(
    ("recipe", "options", "text"),
    [
        ("deep", {}, 'recipe: must be one of "deepsdf", "onet", "vecset", "hunyuan", "dora"'),
        ("deepsdf", {"near": 0.1}, "near: is no number of the recipe 'deepsdf'; its numbers are n, variances"),
        ("deepsdf", {"n": 0}, "n: must be from 1"),
        ("deepsdf", {"n": 1.5}, "n: must be a whole number"),
        ("deepsdf", {"variances": (0.1, -1)}, "variances: must be a finite number above 0"),
        ("deepsdf", {"variances": ()}, "variances: must hold a number above 0"),
        ("deepsdf", {"variances": 0.1}, "variances: must be an iterable of numbers"),
        ("deepsdf", {"near_share": 1.5}, "near_share: must be from 0 to 1"),
        ("deepsdf", {"near_share": float("nan")}, "near_share: must be a finite number"),
        ("deepsdf", {"padding": 0}, "padding: must be a finite number above 0"),
        ("deepsdf", {"split": "val"}, 'split: must be one of "train", "test"'),
        ("deepsdf", {"seed": -1}, "seed: must be from 0"),
        ("deepsdf", {"sign": "unsigned"}, "sign: the labels of a recipe need a side"),
        ("deepsdf", {"sign": "best"}, "sign: must be one of"),
        ("vecset", {"category": "a/b"}, "category: must be the name of a folder"),
        ("vecset", {"category": ".."}, "category: must be the name of a folder"),
        ("hunyuan", {"cut": 0.01}, "cut: must be at least the largest of sigmas, 0.05"),
        ("hunyuan", {"shell_resolution": 4000}, "shell_resolution: must be from"),
        ("dora", {"n": 1}, "n: half of it must be from 1 to surface_n"),
        ("dora", {"n": 5000, "surface_n": 100}, "n: half of it must be from 1 to surface_n"),
    ],
)
def test_wrong_arguments_are_named(recipe, options, text):
    with pytest.raises(fb.ArgumentError, match=text):
        fb.training.sample(meshes.box(), recipe, **options)


def test_a_mesh_without_faces_has_no_samples():
    with pytest.raises(fb.MeshError, match="the mesh is empty"):
        fb.training.sample((np.zeros((3, 3)), np.zeros((0, 3), int)), "deepsdf")
    empty = fb.bake(fb.sphere(1), 12).to_mesh(-0.99)
    assert not len(empty.faces)
    with pytest.raises(fb.MeshError, match="mesh: has no faces"):
        fb.training.sample(empty, "deepsdf")
    with pytest.raises(fb.MeshError, match="mesh: has no faces"):
        fb.training.recipes()["deepsdf"].transform(empty)


def test_dora_names_the_package_that_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "fpsample", None)
    with pytest.raises(fb.Error, match=r"the recipe 'dora' needs the package fpsample.*fieldbake\[training\]"):
        fb.training.sample(meshes.box(), "dora", **SMALL["dora"])


def test_progress_reaches_1():
    seen = []
    fb.training.sample(meshes.box(), "deepsdf", n=1000, progress=seen.append)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


def test_recipes_are_tables_that_cannot_be_changed():
    recipes = fb.training.recipes()
    assert list(recipes) == RECIPES
    with pytest.raises(TypeError):
        recipes["mine"] = None
    for recipe in recipes.values():
        with pytest.raises(TypeError):
            recipe.numbers["n"] = 1
        assert recipe.source
        assert len(recipe.commit) == 40
        assert recipe.deviations
        assert pickle.loads(pickle.dumps(recipe)) is recipe


def test_the_module_imports_neither_torch_nor_fpsample():
    script = (
        "import sys, fieldbake as fb; fb.training.Dataset({'a': fb.models.gear()}, 'deepsdf', n=50)[0];"
        "assert not {'torch', 'fpsample', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
