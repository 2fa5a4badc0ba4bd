"""Windows of a grid have the bits of the whole bake, and balls are classified as their points are."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
from fieldbake import _core


def grid_of(volume):
    lower, upper = volume.bounds.tolist()
    return tuple(lower), tuple(upper), volume.resolution


@pytest.mark.parametrize("sign", ["auto", "parity", "pseudonormal", "unsigned"])
@pytest.mark.parametrize("cut", [0, 2], ids=["closed", "open"])
def test_a_window_equals_the_whole_bake_bit_for_bit(sign, cut):
    vertices, faces = meshes.box()
    mesh = fb.Mesh(vertices + 0.017, faces[cut:])
    volume = fb.bake(mesh, (45, 38, 41), sign=sign)
    encoded = volume.quantize("snorm16", band=2.5)
    rng = np.random.default_rng(7)
    for _ in range(6):
        low = rng.integers(0, np.array(volume.resolution))
        size = rng.integers(1, np.array(volume.resolution) - low + 1)
        window = _core.bake_window(mesh._core, *grid_of(volume), tuple(low), tuple(size), sign=sign)
        banded = _core.bake_window(mesh._core, *grid_of(volume), tuple(low), tuple(size), sign=sign, band=2.5)
        part = tuple(slice(a, a + n) for a, n in zip(low, size, strict=True))

        assert window.tobytes() == volume.distances[part].tobytes()
        assert np.array_equal(_core.encode(banded, "snorm16", encoded.scale), encoded.encoded[part])


def test_a_window_must_lie_in_the_grid():
    mesh = fb.Mesh(*meshes.box())
    with pytest.raises(fb.ArgumentError, match="window"):
        _core.bake_window(mesh._core, (-2, -2, -2), (2, 2, 2), (8, 8, 8), (4, 0, 0), (5, 8, 8))


@pytest.mark.parametrize("cut", [0, 2], ids=["closed", "open"])
def test_a_ball_has_one_side_only_if_all_its_points_have(cut):
    vertices, faces = meshes.box()
    mesh = fb.Mesh(vertices, faces[cut:])
    rng = np.random.default_rng(3)
    centers, radii = rng.uniform(-1.5, 1.5, (300, 3)), rng.uniform(0.01, 0.6, 300)

    distances, sides = _core.sides_of_balls(mesh._core, centers, radii)

    assert np.abs(distances - fb.closest_point(mesh, centers).distances).max() <= 1e-6
    assert (sides[distances <= radii] == 0).all()
    assert {-1, 0, 1} <= set(sides.tolist())
    around = rng.normal(size=(300, 50, 3))
    around *= (radii[:, None] * rng.uniform(0, 1, (300, 50)) / np.linalg.norm(around, axis=2))[..., None]
    inside = fb.contains(mesh, centers[:, None] + around)
    assert inside[sides == -1].all()
    assert not inside[sides == 1].any()
