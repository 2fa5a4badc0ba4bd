"""Arrays in place of single values: an error that names the argument, and no ambiguous truth value."""

import numpy as np
import pytest

import fieldbake as fb

VOLUME = fb.bake(fb.sphere(1), 8)
SCENE = fb.Scene([fb.Instance(fb.sphere(1))])
CAMERA = fb.Camera((3, 3, 3), (0, 0, 0))

CALLS = {
    "page_size": lambda value: fb.pack([VOLUME], page_size=value),
    "layout": lambda value: fb.pack([VOLUME], layout=value),
    "encoding": lambda value: fb.pack([VOLUME], encoding=value),
    "lights": lambda value: fb.raymarch(VOLUME, lights=value),
    "filter": lambda value: fb.raymarch(SCENE, filter=value),
    "shadows": lambda value: fb.raymarch(VOLUME, shadows=value),
    "bounces": lambda value: fb.render(SCENE, CAMERA, size=(8, 8), bounces=value),
    "ambient_occlusion": lambda value: fb.render(SCENE, CAMERA, size=(8, 8), ambient_occlusion=value),
    "bounce_samples": lambda value: fb.Renderer(SCENE, size=(8, 8), bounce_samples=value),
    "report": lambda value: fb.Volume(VOLUME.distances, VOLUME.bounds, report=value),
    "over": lambda value: fb.sphere(1).paint((1, 0, 0), over=value),
    "inside": lambda value: VOLUME.to_mesh(inside=value),
    "level": lambda value: VOLUME.to_mesh(value),
    "margin": lambda value: fb.bake(fb.sphere(1), 8, margin=value),
    "storage_options": lambda value: fb.open_zarr("memory://none", storage_options=value),
    "folder": lambda value: fb.cache.use_disk(value),
}


@pytest.mark.parametrize(
    "value", [np.array([1.0, 2.0]), np.array([True, False]), np.array(["a", "b"]), np.zeros((2, 2))], ids="fbsm"
)
@pytest.mark.parametrize("name", CALLS)
def test_an_array_is_an_error_that_names_the_argument(name, value):
    if name == "storage_options":
        pytest.importorskip("zarr")
    with pytest.raises(fb.Error, match=f"^{name}"):
        CALLS[name](value)


def test_arrays_that_are_not_aligned_are_taken():
    random = np.random.default_rng(0)
    points, corners = random.uniform(-1, 1, (9, 3)), random.integers(0, 9, (4, 3))
    shifted = [np.frombuffer(b"head" + array.tobytes(), array.dtype, offset=4) for array in (points, corners)]
    odd_points, odd_corners = shifted[0].reshape(-1, 3), shifted[1].reshape(-1, 3)
    assert not odd_points.flags.aligned

    assert np.array_equal(fb.sphere(1).distance(odd_points), fb.sphere(1).distance(points))
    mesh, odd = fb.Mesh(points, corners), fb.Mesh(odd_points, odd_corners)
    assert np.array_equal(fb.signed_distance(odd, odd_points), fb.signed_distance(mesh, points))
