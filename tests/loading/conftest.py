"""The field that the tests of files write."""

import pytest

import fieldbake as fb


@pytest.fixture(scope="module")
def solid():
    """A body without any symmetry, away from the origin, on a grid whose sides are no multiples of eight."""
    shape = (fb.box((2, 1, 0.5)).translate((4, -3, 2)) | fb.sphere(0.4).translate((5.2, -2.6, 2.5))).rotate("z", 20)
    return fb.bake(shape, 45)
