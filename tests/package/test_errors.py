"""The exceptions: one base class, and the built-in ones that other code catches."""

import numpy as np
import pytest

import fieldbake as fb

OF_A_VALUE = [fb.ArgumentError, fb.MeshError, fb.ShapeError, fb.SceneError, fb.AtlasError, fb.FormatError]


@pytest.mark.parametrize("error", [*OF_A_VALUE, fb.DeviceError, fb.CapacityError])
def test_everything_is_a_fieldbake_error(error):
    assert issubclass(error, fb.Error)
    assert error.__module__.startswith("fieldbake")
    assert error.__doc__


@pytest.mark.parametrize("error", OF_A_VALUE)
def test_errors_of_a_value_are_value_errors(error):
    assert issubclass(error, ValueError)


def test_a_device_error_is_a_runtime_error():
    assert issubclass(fb.DeviceError, RuntimeError)


def test_a_capacity_error_is_a_memory_error():
    assert issubclass(fb.CapacityError, MemoryError)


@pytest.mark.parametrize("name", ["ArgumentError", "MeshError", "CapacityError", "DeviceError"])
def test_errors_of_the_core_are_the_same_classes(name):
    """The core raises by name; the class it finds must be the public one."""
    from fieldbake import _core

    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    good = _core.Mesh(triangle, np.array([[0, 1, 2]]))
    box = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    causes = {
        "ArgumentError": lambda: _core.bake(good, *box, (0, 1, 1)),
        "MeshError": lambda: _core.Mesh(triangle, np.array([[0, 1, 3]])),
        "CapacityError": lambda: _core.bake(good, *box, (8000, 8000, 8000)),
        "DeviceError": lambda: _core.bake(good, *box, (1, 1, 1), device="abacus"),
    }

    with pytest.raises(getattr(fb, name)) as caught:
        causes[name]()

    assert type(caught.value) is getattr(fb, name)


def test_the_public_names_are_there():
    assert set(fb.__all__) <= set(dir(fb))
    contract = {
        "Camera",
        "DirectionalLight",
        "PointLight",
        "arrays",
        "bake",
        "closest_point",
        "devices",
        "load",
        "load_mesh",
        "raymarch",
        "signed_distance",
    }
    assert contract <= set(fb.__all__)


def test_devices_begin_with_the_cpu():
    devices = fb.devices()

    assert devices[0] == "cpu"
    assert devices[0].type == "cpu"
    assert not devices[0].hardware


# --- arguments of a wrong type

BALL = fb.sphere()
TRIANGLE = ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])

NUMBERS = {
    "t_min": lambda value: fb.cast_rays(TRIANGLE, (0, 0, 1), (0, 0, -1), t_min=value),
    "uniform": lambda value: fb.sample_training(TRIANGLE, 2, uniform=value),
    "margin": lambda value: fb.bake(TRIANGLE, 2, margin=value),
    "angle_deg": lambda value: BALL.rotate("x", value),
    "level": lambda value: fb.bake(BALL, 4).to_mesh(value),
    "fov_deg": lambda value: fb.Camera((0, 0, 5), (0, 0, 0), fov_deg=value),
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [1 + 1j, np.complex128(1 + 1j), np.complex64(1), np.array(1 + 1j)])
def test_a_complex_number_is_refused(name, value):
    with pytest.raises(fb.Error, match=rf"{name}: must be a .*number"):
        NUMBERS[name](value)


PATHS = {
    "load": fb.load,
    "Volume.load": fb.Volume.load,
    "load_mesh": fb.load_mesh,
    "load_scene": fb.load_scene,
    "Mesh.save": lambda path: fb.Mesh(*TRIANGLE).save(path),
    "Shape.save": lambda path: BALL.save(path, 4),
    "Volume.save": lambda path: fb.bake(BALL, 4).save(path),
    "SparseVolume.save": lambda path: fb.bake_sparse(BALL, 16).save(path),
    "Atlas.save": lambda path: fb.pack([BALL], resolution=4).save(path),
    "Frame.save": lambda path: fb.raymarch(BALL, size=(4, 4), device="cpu").save(path),
    "bake_many": lambda path: fb.bake_many([], path),
}


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("value", [None, 3.5, [], "", "nul\0.npz"])
def test_a_value_that_is_no_path_is_refused(name, value):
    with pytest.raises(fb.ArgumentError, match=r"(path|out): must be .*(a path|the path of a file), got"):
        PATHS[name](value)


def test_a_page_is_not_written_to_a_number():
    with pytest.raises(fb.ArgumentError, match="path: must be text or a path, got 3"):
        BALL.to_html(3, size=(8, 8))


@pytest.mark.parametrize("call", [fb.arrays.pack, lambda value: fb.bake_many(value, "results")])
@pytest.mark.parametrize("value", [None, 3])
def test_a_value_that_is_no_list_is_refused(call, value):
    with pytest.raises(fb.ArgumentError, match=r"must be an iterable of \w+, got"):
        call(value)


def test_an_empty_name_of_a_device_is_refused():
    """Every adapter's name contains the empty text, so it would select an arbitrary adapter."""
    with pytest.raises(fb.ArgumentError, match="device: must not be empty text"):
        fb.signed_distance(TRIANGLE, (0, 0, 1), device="")
