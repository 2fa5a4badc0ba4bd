"""Meshes far from the origin keep their shape, and their positions, in float64."""

import numpy as np
import pytest
import trimesh

import fieldbake as fb

#: An offset as in a national grid in metres, and one where float32 has steps of a quarter of a unit.
OFFSETS = [np.array([512345.678, 4187654.321, -30.0]), np.full(3, 4e6)]


@pytest.fixture(scope="module")
def sphere():
    return trimesh.creation.icosphere(4)


def rounding(offset):
    """Largest rounding of a float64 position there."""
    return float(np.spacing(np.abs(offset).max()))


@pytest.mark.parametrize("offset", OFFSETS, ids=["grid", "4e6"])
def test_vertices_are_those_that_came(sphere, offset):
    vertices = 3 * sphere.vertices + offset
    mesh = fb.Mesh(vertices, sphere.faces)
    assert mesh.vertices.dtype == np.float64
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.to_trimesh().vertices, vertices)
    assert np.array_equal(mesh.bounds, [vertices.min(axis=0), vertices.max(axis=0)])
    again = fb.as_mesh([(mesh, np.eye(4))])
    assert np.array_equal(again.vertices, vertices)


def test_vertices_are_copied_when_they_enter_and_read_only_after():
    vertices = np.array([(0.1, 0.2, 0.3), (1, 0, 0), (0, 1, 0)])
    mesh = fb.Mesh(vertices, [(0, 1, 2)])
    vertices[0] = 9
    assert mesh.vertices[0].tolist() == [0.1, 0.2, 0.3]
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 1
    view = mesh.vertices
    del mesh
    assert view[0].tolist() == [0.1, 0.2, 0.3]


def test_float32_vertices_come_back_with_the_same_values():
    vertices = np.array([(0.1, 0.2, 0.3), (1, 0, 0), (0, 1, 0)], dtype=np.float32)
    assert np.array_equal(fb.Mesh(vertices, [(0, 1, 2)]).vertices, vertices.astype(np.float64))


def test_rows_of_dropped_vertices_are_left_out():
    vertices = np.array([(0.1, 0, 0), (np.nan, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh = fb.Mesh(vertices, [(0, 2, 3)])
    assert np.array_equal(mesh.vertices, vertices[[0, 2, 3]])


@pytest.mark.parametrize("offset", OFFSETS, ids=["grid", "4e6"])
def test_a_mesh_of_a_field_is_that_of_the_field_at_the_origin(sphere, offset, tmp_path):
    near = fb.bake((3 * sphere.vertices, sphere.faces), 32, device="cpu")
    far = fb.bake((3 * sphere.vertices + offset, sphere.faces), 32, device="cpu")
    near.save(tmp_path / "near.npz")
    far.save(tmp_path / "far.npz")
    pairs = ((far, near), (fb.load(tmp_path / "far.npz"), fb.load(tmp_path / "near.npz")))
    for there, here in pairs:
        # The input's positions are rounded to float64 there, and samples to float32: 6e-8 of distances below 3.
        tolerance = 1e-6 * 6
        mesh, expected = there.to_mesh(sharp=False), here.to_mesh(sharp=False)
        assert mesh.faces.shape == expected.faces.shape
        np.testing.assert_allclose(mesh.vertices - offset, expected.vertices, rtol=0, equal_nan=False, atol=tolerance)
        # In a cell that is its own mirror image, rounding may choose either of two mirrored vertices of the edge. They
        # have the same distance from the surface.
        mesh, expected = there.to_mesh(), here.to_mesh()
        assert mesh.faces.shape == expected.faces.shape
        source = (3 * sphere.vertices, sphere.faces)
        distances = (
            fb.closest_point(source, vertices).distances for vertices in (mesh.vertices - offset, expected.vertices)
        )
        np.testing.assert_allclose(*distances, rtol=0, equal_nan=False, atol=tolerance)


@pytest.mark.parametrize("offset", OFFSETS, ids=["grid", "4e6"])
def test_samples_and_bounds_keep_the_position(sphere, offset, device):
    vertices = 3 * sphere.vertices
    near = fb.bake((vertices, sphere.faces), 16, device=device)
    far = fb.bake((vertices + offset, sphere.faces), 16, device=device)
    np.testing.assert_allclose(far.bounds - offset, near.bounds, rtol=0, equal_nan=False, atol=4 * rounding(offset))
    points = np.random.default_rng(1).uniform(-3, 3, (200, 3))
    # A gradient of one carries the rounding of a position into the distance, besides float32's own.
    tolerance = 1e-6 * 6 + 4 * rounding(offset)
    np.testing.assert_allclose(far.distances, near.distances, rtol=0, equal_nan=False, atol=tolerance)
    np.testing.assert_allclose(
        far.sample(points + offset), near.sample(points), rtol=0, equal_nan=False, atol=tolerance
    )


@pytest.mark.parametrize("offset", OFFSETS, ids=["grid", "4e6"])
def test_pictures_are_those_at_the_origin(sphere, offset, device):
    def pictures(shift):
        mesh = fb.Mesh(3 * sphere.vertices + shift, sphere.faces)
        camera = fb.Camera((7 + shift[0], -6 + shift[1], 5 + shift[2]), shift)
        volume = fb.bake(mesh, 16, device="cpu")
        shape = fb.sphere(3).translate(tuple(shift))
        yield fb.raymarch(volume, camera, size=(24, 18), device=device)
        yield fb.raymarch(shape, camera, size=(24, 18), device=device)
        yield fb.render(fb.Scene([fb.Instance(mesh, resolution=16)]), camera, size=(24, 18), device=device)

    for far, near in zip(pictures(offset), pictures(np.zeros(3)), strict=True):
        assert np.isfinite(near.depth).sum() > 50
        # Rays are float32 relative to the camera or the scene, 12 units across: a few roundings of 1e-6 each, carried
        # along a grazing ray at most ten times as far.
        np.testing.assert_allclose(far.depth, near.depth, rtol=0, equal_nan=False, atol=1e-4)
        np.testing.assert_allclose(far.normal, near.normal, rtol=0, equal_nan=False, atol=1e-3)
