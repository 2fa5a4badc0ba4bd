"""Rounded cylinders, slabs and rounded cones against closed forms in float64, on every device."""

import numpy as np
import pytest

import fieldbake as fb

#: Rounding of float32 in a distance of up to 4 units: a few operations on numbers of that size.
ROUNDING = 8 * 4 * 2.0**-24


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(11).uniform(-2, 2, (3000, 3))


def compare(shape, points, truth, device):
    assert np.abs(shape.distance(points, device=device).astype(float) - truth).max() <= ROUNDING
    # The language writes the shape so that it reads back the same.
    assert fb.csg.parse(shape.to_sexpr()) == shape


@pytest.mark.parametrize("sizes", [(0.7, 1.2, 0.2), (0.7, 1.2, 0.0), (0.5, 2.0, 0.5), (1.0, 0.6, 0.3)])
def test_a_rounded_cylinder_is_a_cylinder_and_all_points_near_it(sizes, points, device):
    radius, height, rounding = sizes
    inner = np.stack(
        [
            np.hypot(points[:, 0], points[:, 1]) - (radius - rounding),
            np.abs(points[:, 2]) - (height / 2 - rounding),
        ],
        axis=-1,
    )
    truth = np.linalg.norm(inner.clip(0), axis=1) + inner.max(axis=1).clip(max=0) - rounding

    compare(fb.rounded_cylinder(*sizes), points, truth, device)


def test_the_rounding_of_a_cylinder_has_a_limit():
    with pytest.raises(fb.ShapeError, match=r"rounding: must be at most .* half the height, 0\.5, got 0\.6"):
        fb.rounded_cylinder(1.0, 1.0, 0.6)


@pytest.mark.parametrize("normal", ["x", "z", (1, 2, -2)])
def test_a_slab_is_exact_between_and_beyond_its_planes(normal, points, device):
    vector = np.eye(3)["xyz".index(normal)] if isinstance(normal, str) else np.asarray(normal) / 3

    compare(fb.slab(0.5, normal), points, np.abs(points @ vector) - 0.25, device)


def test_a_slab_has_no_bounds_but_cuts_those_of_others(points):
    with pytest.raises(fb.ShapeError, match="no bounds because of a slab"):
        _ = fb.slab().bounds
    disc = fb.sphere(1.5) & fb.slab(0.5).translate((0, 0, 0.25))
    inside = (np.linalg.norm(points, axis=1) < 1.5) & (points[:, 2] > 0) & (points[:, 2] < 0.5)

    assert disc.bounds.tolist() == [[-1.5, -1.5, 0.0], [1.5, 1.5, 0.5]]
    assert ((disc.distance(points) < 0) == inside).all()
    with pytest.raises(fb.ShapeError, match="normal: is zero"):
        fb.slab(1.0, (0, 0, 0))


@pytest.mark.parametrize("sizes", [(0.6, 0.3, 1.0), (0.2, 0.9, 1.5), (0.5, 0.5, 1.0), (0.0, 0.7, 1.2)])
def test_a_rounded_cone_is_the_union_of_balls_between_its_ends(sizes, points, device):
    low, high, height = sizes
    # Outside, the distance is the smallest distance to any of the balls. It is a convex function of the position along
    # the axis, so a ternary search finds its minimum. Inside, the largest depth in a ball is the distance to the hull.
    lower, upper = np.zeros(len(points)), np.ones(len(points))

    def to_ball(t):
        centre = -height / 2 + t * height
        return np.hypot(np.hypot(points[:, 0], points[:, 1]), points[:, 2] - centre) - (low + t * (high - low))

    for _ in range(120):
        a, b = lower + (upper - lower) / 3, upper - (upper - lower) / 3
        is_left = to_ball(a) < to_ball(b)
        lower, upper = np.where(is_left, lower, a), np.where(is_left, b, upper)

    compare(fb.rounded_cone(*sizes), points, to_ball((lower + upper) / 2), device)


@pytest.mark.parametrize(("sizes", "z", "radius"), [((1.0, 0.2, 0.8), -0.4, 1.0), ((0.3, 0.9, 0.1), 0.05, 0.9)])
def test_a_ball_that_contains_the_other_is_the_whole_cone(sizes, z, radius, points, device):
    truth = np.linalg.norm(points - (0, 0, z), axis=1) - radius

    compare(fb.rounded_cone(*sizes), points, truth, device)
    assert np.abs(fb.rounded_cone(*sizes).bounds - np.array([[-radius] * 3, [radius] * 3]) - (0, 0, z)).max() <= 1e-15


def test_a_rounded_cone_needs_a_radius():
    with pytest.raises(fb.ShapeError, match="both radii are 0"):
        fb.rounded_cone(0, 0, 1)
