"""The comparisons fail where they must."""

import numpy as np
import pytest

from compare import close, exceeds


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1.2])
@pytest.mark.parametrize("swapped", [False, True])
def test_close_fails_on_what_is_not_close(bad, swapped):
    pair = [np.array([0.0, bad, 2.0]), np.array([0.0, 1.0, 2.0])]
    with pytest.raises(AssertionError):
        close(*(pair[::-1] if swapped else pair), 0.1)


def test_close_fails_on_equal_values_that_are_not_finite_and_on_other_shapes():
    for same in ([np.nan], [np.inf]):
        with pytest.raises(AssertionError, match="not finite"):
            close(same, same, 1.0)
    with pytest.raises(AssertionError, match="shape"):
        close([1.0, 1.0], [1.0], 1.0)
    with pytest.raises(AssertionError, match=r"at \(1,\)"):
        close([1.0, 1.5], [1.0, 1.0], 0.25)
    with pytest.raises(AssertionError):
        close([1.0], [1.0], np.nan)


def test_close_holds_up_to_the_tolerance():
    close([1.0, 2.0], [1.25, 2.0], 0.25)
    close([], [], 0.0)


def test_nan_exceeds_every_limit():
    assert exceeds([0.5, 1.0, 1.5, np.nan, np.inf], 1.0).tolist() == [False, False, True, True, True]
