"""Fixtures shared by all tests: the device, real models, reproducible random numbers."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

#: Devices that the `device` fixture runs a test on.
DEVICES = ["cpu", "gpu"]

#: A module without tests, which imports an optional package.
collect_ignore = ["support/warp_kernels.py"]

# The same examples on every run; `HYPOTHESIS_PROFILE=search` looks for new ones.
settings.register_profile(
    "ci", derandomize=True, deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("search", deadline=None, max_examples=1_000, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture
def gpu() -> str:
    """The device "gpu". Without an adapter the test is skipped, or fails where FIELDBAKE_REQUIRE_GPU=1."""
    import fieldbake as fb

    if all(found.type == "cpu" for found in fb.devices()):
        complain = pytest.fail if os.environ.get("FIELDBAKE_REQUIRE_GPU") == "1" else pytest.skip
        complain("no GPU adapter found: install a Vulkan driver, for example Mesa's lavapipe")
    return "gpu"


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    """Each device in turn."""
    return request.getfixturevalue("gpu") if request.param == "gpu" else request.param


@pytest.fixture
def random() -> np.random.Generator:
    """Random numbers that are the same on every run."""
    return np.random.default_rng(20)


def mesh_folder() -> Path:
    """Where the development meshes are looked for; they are not part of the repository."""
    beside = Path(__file__).parents[2] / "shared" / "meshes"
    return Path(os.environ.get("FIELDBAKE_MESHES", beside))


@pytest.fixture(scope="session")
def model_path() -> Callable[[str], Path]:
    """Path of a development mesh by its name in the mesh folder; the test is skipped where that is absent."""

    def find(name: str) -> Path:
        path = mesh_folder() / name
        if not path.is_file():
            pytest.skip(f"{path} is not there; set FIELDBAKE_MESHES to the folder of development meshes")
        return path

    return find


@pytest.fixture(scope="session")
def sample_path() -> Callable[[str], Path]:
    """Path of a model that ships in the PyPI package pymeshlab."""

    def find(name: str) -> Path:
        package = importlib.util.find_spec("pymeshlab")
        if package is None or package.origin is None:
            pytest.skip("pymeshlab, whose wheel carries sample meshes, is not installed")
        return Path(package.origin).parent / "tests" / "sample_meshes" / name

    return find
