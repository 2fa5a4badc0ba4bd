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
