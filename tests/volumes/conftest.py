"""Volumes that several tests of this folder use."""

import pytest

import fieldbake as fb
import meshes


@pytest.fixture
def noise(random):
    """Independent samples: any mix-up of neighbours or axes shows."""
    return fb.Volume(random.standard_normal((9, 7, 5)), [(-1.0, -2.0, -3.0), (1.5, 2.0, 1.0)])


@pytest.fixture(scope="module")
def sphere():
    return fb.bake(meshes.icosphere(3), resolution=32)
