"""Comparisons of arrays that NaN fails: `(error > tolerance).mean() < 0.01` holds where all errors are NaN."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def close(found: ArrayLike, expected: ArrayLike, tolerance: float) -> None:
    """Assert that both arrays are finite, of one shape, and differ by at most `tolerance` everywhere."""
    found, expected = np.asarray(found, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert found.shape == expected.shape, f"shape {found.shape}, expected {expected.shape}"
    for name, values in (("found", found), ("expected", expected)):
        assert np.isfinite(values).all(), f"{name}: {np.count_nonzero(~np.isfinite(values))} values are not finite"
    difference = np.abs(found - expected)
    worst = np.unravel_index(difference.argmax(), difference.shape) if difference.size else ()
    assert (difference <= tolerance).all(), (
        f"at {tuple(map(int, worst))}: {found[worst]} is not within {tolerance} of {expected[worst]}"
    )


def exceeds(values: ArrayLike, limit: ArrayLike) -> NDArray[np.bool_]:
    """Where values are larger than a limit, or NaN."""
    below: NDArray[np.bool_] = np.less_equal(values, limit)
    return ~below
