"""Random trees: NumPy has the same field, parts cover the surface and equal the whole there, pictures are equal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldbake as fb
import truth_trees as truth
from pictures import differing_pixels, has_volume

#: Distances are rounded to float32 once: half an ulp of the largest, which is below 8 here, and rounding in float64.
ROUNDING = 8 * 2.0**-24


def sample_points(bounds, count, seed=0):
    """Points in a box a little larger than the bounds."""
    lower, upper = np.asarray(bounds, dtype=float)
    pad = 0.1 + 0.2 * (upper - lower)
    return np.random.default_rng(seed).uniform(lower - pad, upper + pad, (count, 3))


def in_boxes(points, boxes):
    """Which points lie in one of the boxes, (n,); lower faces belong to a box."""
    inside = np.zeros(len(points), dtype=bool)
    for lower, upper in boxes:
        inside |= ((points >= lower) & (points < upper)).all(axis=1)
    return inside


@given(truth.trees)
@settings(max_examples=120)
def test_fields_are_those_of_numpy(tree):
    points = sample_points(tree.shape.bounds if has_volume(tree.shape) else ((-2,) * 3, (2,) * 3), 200)
    expected = tree.field(points)

    assert np.abs(tree.shape.distance(points) - expected).max() <= ROUNDING


@given(truth.trees, st.integers(0, 2**16))
@settings(max_examples=60)
def test_fields_bound_the_distance(tree, seed):
    """The values at two points differ by at most the Lipschitz constant times the distance between them."""
    first = sample_points(((-2,) * 3, (2,) * 3), 200, seed)
    second = first + np.random.default_rng(seed).normal(0, 0.3, first.shape)
    change = np.abs(tree.shape.distance(first).astype(float) - tree.shape.distance(second))
    apart = np.linalg.norm(first - second, axis=1)

    if (
        "twist" not in tree.text
    ):  # its divisor grows away from it: a lower bound of the distance, but no Lipschitz function
        assert (change <= tree.shape.lipschitz * apart + 2 * ROUNDING).all()


@given(truth.trees)
@settings(max_examples=60)
def test_nothing_is_inside_beyond_the_bounds(tree):
    points = np.random.default_rng(1).uniform(-4, 4, (2000, 3))
    outside = ~in_boxes(points, [tree.shape.bounds])

    assert (tree.field(points[outside]) > 0).all()


@pytest.mark.parametrize("method", ["aabb", "octree"])
@given(tree=truth.trees)
@settings(max_examples=30)
def test_parts_make_the_solid(tree, method):
    points = sample_points(tree.shape.bounds if has_volume(tree.shape) else ((-2,) * 3, (2,) * 3), 1500)
    inside = tree.field(points) < -ROUNDING
    outside = tree.field(points) > ROUNDING
    parts = fb.csg.decompose(tree.shape, method=method)

    covered = np.zeros(len(points), dtype=bool)
    for part in parts:
        here = in_boxes(points, part.boxes)
        value = part.shape.distance(points[here])
        assert (value[outside[here]] > 0).all()
        if method == "octree":
            assert (value[inside[here]] < 0).all()
            # One box a point: they do not overlap.
            assert not (covered & here).any()
            covered |= here
        else:
            covered[here] |= value < 0
    if method == "aabb":
        assert covered[inside].all()


@given(tree=truth.trees)
@settings(max_examples=20)
def test_cells_cover_the_surface(tree):
    """Roots along random lines lie in cells, and the roots of the part are the roots of the whole."""
    if not has_volume(tree.shape):
        return
    ends = sample_points(tree.shape.bounds, 400, seed=2).reshape(2, -1, 3)
    share = np.linspace(0, 1, 400)[:, None, None]
    line = ends[0] + share * (ends[1] - ends[0])
    values = tree.field(line.reshape(-1, 3)).reshape(line.shape[:2])
    crosses = (values[:-1] > 0) != (values[1:] > 0)
    low, high = line[:-1][crosses], line[1:][crosses]
    rises = values[:-1][crosses] < 0
    for _ in range(40):
        middle = (low + high) / 2
        is_before = (tree.field(middle) < 0) == rises
        low, high = np.where(is_before[:, None], middle, low), np.where(is_before[:, None], high, middle)
    parts = fb.csg.decompose(tree.shape)

    found = np.zeros(len(low), dtype=bool)
    for part in parts:
        here = in_boxes(low, part.boxes)
        if here.any():
            assert np.abs(part.shape.distance(low[here])).max() <= 2 * ROUNDING
            found |= here
    assert found.all()


@pytest.mark.parametrize("method", ["aabb", "octree"])
@given(tree=truth.trees, direction=st.tuples(*[st.floats(-1, 1)] * 3))
@settings(max_examples=100)
def test_pictures_are_the_same(tree, direction, method):
    if not has_volume(tree.shape):
        return
    camera = fb.Camera.fit(tree.shape.bounds, direction=np.add(direction, (0.07, 0.04, -1.2)))
    wrong, _ = differing_pixels(tree, camera, (40, 40), method, "cpu")

    # 0.1 % of 1600 pixels: one or two on an outline.
    assert wrong <= 2, tree.text


def some_trees():
    """One tree for each group of operators; a software adapter takes a second a picture."""
    ball, block = truth.sphere(0.8), truth.box((1.2, 1.0, 0.8))
    bar = truth.placed(truth.cylinder(0.3, 3.0), (0.1, 0, 0), (1, 1, 0.5), 30, 0.9)
    yield truth.combine("difference", [truth.combine("union", [ball, block], k=0.2), bar])
    yield truth.combine("xor", [truth.shell(truth.torus(0.8, 0.3), 0.1), truth.offset(block, 0.1)], chamfer=0.1)
    yield truth.twist(
        truth.combine("intersection", [truth.elongate(block, (0.3, 0, 0.2)), truth.ellipsoid((1, 0.7, 0.8))]), 50
    )
    yield truth.mirror(truth.placed(truth.capsule(0.2, 1.0), (0.6, 0.1, 0), (0, 1, 0), 40, 1.2), 0)


TREES = list(some_trees())


@pytest.mark.parametrize(
    ("tree", "method"), [(TREES[0], "whole"), (TREES[1], "octree"), (TREES[2], "octree")], ids=["whole", "xor", "twist"]
)
def test_devices_draw_the_same(tree, method, gpu):
    camera = fb.Camera.fit(tree.shape.bounds, direction=(0.07, 0.04, -1.2))
    wrong, _ = differing_pixels(tree, camera, (16, 16), method, gpu)

    assert wrong == 0


@pytest.mark.parametrize("tree", TREES, ids=[tree.text[:24] for tree in TREES])
def test_devices_agree_on_distances(tree, gpu):
    points = sample_points(((-2,) * 3, (2,) * 3), 100)
    # In float32 and local units: the points are 4 units away at most, a tree is a few operators deep.
    tolerance = 4 * 16 * 2.0**-24

    assert np.abs(tree.shape.distance(points, device=gpu) - tree.field(points)).max() <= tolerance
