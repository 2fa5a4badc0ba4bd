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
