"""Checks of arguments for the whole package. Each returns the clean value or raises an error that names it."""

from __future__ import annotations

import operator
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .errors import ArgumentError, CapacityError, Error

#: Largest magnitude of a number or coordinate. Sums and differences of such values still fit in float32.
FAR = 1e37

#: Types of distances that functions with `dtype` return.
DistanceType = Literal["float32", "float64"]

#: Number of values from which a copy is compared with the free memory first.
LONG = 1 << 24


def describe(value: object) -> str:
    """Describe a value in one short line for an error message."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and dtype {value.dtype}"
    text = repr(value)
    hint = "; its to_volume() is a Volume" if hasattr(value, "to_volume") else ""
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__}{hint})"


def number(name: str, value: object, *, above: float | None = None, least: float | None = None) -> float:
    """Check a real number that float32 can represent, optionally bounded below."""
    expected = "a finite number"
    if above is not None:
        expected += f" above {above:g}"
    if least is not None:
        expected += f" of at least {least:g}"
    result = _real(name, value, expected)
    if not abs(result) <= FAR or (above is not None and result <= above) or (least is not None and result < least):
        raise ArgumentError(f"{name}: must be {expected} (at most {FAR:g}), got {describe(value)}")
    return result


def limit(name: str, value: object) -> float:
    """Check a real number that may be infinite."""
    result = _real(name, value, "a number")
    if result != result:
        raise ArgumentError(f"{name}: must be a number, got nan")
    return result


def _real(name: str, value: Any, expected: str) -> float:
    """Convert a real number; ``expected`` is the wording of the message. NaN and infinities are left to the caller."""
    try:
        # float() drops the imaginary part of a NumPy complex number with a warning only.
        if isinstance(value, (bool, str, bytes, np.bool_)) or _is_complex_array(value):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{name}: must be {expected}, got {describe(value)}") from None


def _is_complex_array(value: Any) -> bool:
    """Whether a value has a complex type of NumPy. The test neither converts nor copies arrays of other libraries."""
    return getattr(getattr(value, "dtype", None), "kind", "") == "c"


def integer(name: str, value: object, *, least: int, most: int, error: type[Error] = ArgumentError) -> int:
    """Check a whole number from ``least`` to ``most``. Floats and booleans are refused."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        result = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise error(f"{name}: must be a whole number, got {describe(value)}") from None
    if not least <= result <= most:
        raise error(f"{name}: must be from {least} to {most}, got {result}")
    return result


def real_array(name: str, value: object, shape: str, error: type[Error] = ArgumentError) -> NDArray[Any]:
    """Check a real numeric array without converting it; ``shape`` is the wording of the message."""
    try:
        array = as_array(value)
    except (ValueError, TypeError, RuntimeError, BufferError) as reason:
        raise error(f"{name}: must be an array of shape {shape}, got {describe(value)} ({reason})") from None
    if array.dtype.kind not in "fiu":
        raise error(f"{name}: must hold real numbers in shape {shape}, got {describe(array)}")
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        count = int(np.ma.getmaskarray(value).sum())
        raise error(f"{name}: must have no masked entries, got {count}; fill them first, as value.filled(x) does")
    return array


def as_array(value: object) -> NDArray[Any]:
    """Convert an array-like to an array, without a copy where its library offers ``__array__`` or ``__dlpack__``."""
    if hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
        return np.from_dlpack(value)
    return np.asarray(value)


def as_float64(array: NDArray[Any]) -> NDArray[np.float64]:
    """Convert to C-contiguous, aligned float64. Values out of its range become infinite, and later checks report them.

    A long array is copied only if the memory suffices: the values of a broadcast array may take a million times the
    memory of the array.
    """
    if array.dtype == np.float64 and array.flags.c_contiguous and array.flags.aligned:
        return array
    if array.size >= LONG:
        what = f"a float64 array of shape {array.shape}"
        _core.require_memory(what, 8 * array.size, "pass fewer values at a time")
    with np.errstate(over="ignore", invalid="ignore"):
        return np.require(array, np.float64, ["C_CONTIGUOUS", "ALIGNED"])


def vector(name: str, value: ArrayLike, length: int, error: type[Error] = ArgumentError) -> NDArray[np.float64]:
    """Check a finite vector of the given length; return a new float64 array."""
    return matrix(name, value, (length,), error)


def matrix(
    name: str, value: ArrayLike, shape: tuple[int, ...], error: type[Error] = ArgumentError
) -> NDArray[np.float64]:
    """Check a finite array of exactly this shape; return a new float64 array."""
    result = _shaped(name, value, shape, error)
    if not np.isfinite(result).all():
        raise error(f"{name}: must be finite, got {result.tolist()}")
    return result


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...], error: type[Error]) -> NDArray[np.float64]:
    """Check an array of exactly this shape; return a new float64 array."""
    array = real_array(name, value, str(shape), error)
    if array.shape != shape:
        raise error(f"{name}: must have shape {shape}, got {describe(array)}")
    return np.array(as_float64(array))


def flag(name: str, value: object) -> bool:
    """Check a boolean. Other types are refused, since a number was likely meant for the next argument."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"{name}: must be True or False, got {describe(value)}")
    return bool(value)


def text(name: str, value: object) -> str:
    """Check a string. The core checks its value."""
    if not isinstance(value, str):
        raise ArgumentError(f"{name}: must be text, got {describe(value)}")
    if not value:
        raise ArgumentError(f"{name}: must not be empty text")
    return value


def path(value: object, name: str = "path", error: type[Error] = ArgumentError) -> Path:
    """Check a path: text, bytes or an object with ``__fspath__``."""
    try:
        text = os.fsdecode(value)  # type: ignore[arg-type]
    except TypeError:
        raise error(f"{name}: must be text or a path, got {describe(value)}") from None
    if not text or "\0" in text:
        raise error(f"{name}: must be a path, got {text!r}")
    return Path(text)


def finite_file(file: Path, error: type[Error]) -> None:
    """Raise if a path names a pipe or a device, whose content may never come or never end."""
    kind = file.stat().st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise error(f"{file}: is a pipe or a device, not a file; copy its content to a file first")


def too_large(file: Path) -> CapacityError:
    """Make the error for a file whose content does not fit in memory."""
    return CapacityError(f"{file}: needs more memory to read than is free ({file.stat().st_size} bytes)")


def items(name: str, value: Any, of: str, error: type[Error] = ArgumentError) -> Iterator[Any]:
    """Return an iterator over a value that is neither text nor a path; ``of`` names the items in the message."""
    try:
        if isinstance(value, (str, bytes, os.PathLike)):
            raise TypeError
        return iter(value)
    except TypeError:
        raise error(f"{name}: must be an iterable of {of}, got {describe(value)}") from None


def choice(name: str, value: object, words: Sequence[str], error: type[Error] = ArgumentError) -> Any:
    """Check that a value is one of a few words."""
    if not isinstance(value, str) or value not in words:
        listed = ", ".join(f'"{word}"' for word in words)
        raise error(f"{name}: must be one of {listed}, got {describe(value)}")
    return value


def points(value: object, name: str = "points") -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Check finite positions (..., 3); return them as (n, 3) float64, and the leading shape."""
    array = real_array(name, value, "(n, 3)")
    if array.shape == (0,):
        array = array.reshape(0, 3)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ArgumentError(f"{name}: must have shape (n, 3), got {describe(array)}")
    flat = as_float64(array).reshape(-1, 3)
    # Reductions need no temporary array. Both comparisons are false for nan.
    if flat.size and not (flat.min() >= -FAR and flat.max() <= FAR):
        row = int(np.flatnonzero(~(np.abs(flat) <= FAR).all(axis=1))[0])
        raise ArgumentError(f"{name}[{row}]: must be finite and at most {FAR:g} from 0, got {flat[row].tolist()}")
    return flat, array.shape[:-1]


def box(name: str, value: ArrayLike, error: type[Error] = ArgumentError, *, flat: bool = False) -> NDArray[np.float64]:
    """Check two corners (2, 3), the lower one first. With ``flat`` they may be equal along some axes."""
    corners = matrix(name, value, (2, 3), error)
    if not (np.abs(corners) <= FAR).all():
        raise error(f"{name}: must be at most {FAR:g} from 0, got {corners.tolist()}")
    extent = corners[1] - corners[0]
    if not ((extent >= 0).all() if flat else (extent > 0).all()):
        raise error(f"{name}: the upper corner must exceed the lower on every axis, got {corners.tolist()}")
    return corners


def affine(name: str, value: ArrayLike, error: type[Error]) -> NDArray[np.float64]:
    """Check a 4x4 affine transform for column vectors that has an inverse."""
    transform = matrix(name, value, (4, 4), error)
    _check_affine(lambda _: name, transform[None], error)
    return transform


def affine_list(name: str, value: ArrayLike, count: int, error: type[Error]) -> NDArray[np.float64]:
    """Check affine transforms as :func:`affine` does, (count, 4, 4); the message names the index of the wrong one."""
    transforms = _shaped(name, value, (count, 4, 4), error)
    is_finite = np.isfinite(transforms).all(axis=(1, 2))
    if not is_finite.all():
        index = int(np.argmin(is_finite))
        raise error(f"{name}[{index}]: must be finite, got {transforms[index].tolist()}")
    _check_affine(lambda index: f"{name}[{index}]", transforms, error)
    return transforms


#: Largest differences of the last row of an affine transform from (0, 0, 0, 1).
_ROW_TOLERANCE = np.array([1e-12, 1e-12, 1e-12, 1e-5])


def _check_affine(name_of: Callable[[int], str], transforms: NDArray[np.float64], error: type[Error]) -> None:
    has_row = np.asarray((np.abs(transforms[:, 3] - (0, 0, 0, 1)) <= _ROW_TOLERANCE).all(axis=1))
    # The determinant is compared with the size of the transform, so that a uniform scale by 1e-6 is valid.
    linear = transforms[:, :3, :3]
    scale = np.abs(linear).max(axis=(1, 2), keepdims=True)
    has_inverse = np.abs(np.linalg.det(linear / np.where(scale > 0, scale, 1))) >= 1e-12
    is_valid = has_row & has_inverse
    if is_valid.all():
        return
    index = int(np.argmin(is_valid))
    name = name_of(index)
    if not has_row[index]:
        row = transforms[index, 3].tolist()
        raise error(f"{name}: the last row must be (0, 0, 0, 1), got {row}; is it transposed?")
    raise error(f"{name}: cannot be undone, its 3x3 part is singular: {linear[index].tolist()}")


def triple(corner: NDArray[np.float64]) -> tuple[float, float, float]:
    """Convert a corner to three Python floats for the core."""
    x, y, z = corner.tolist()
    return float(x), float(y), float(z)


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only and return it."""
    array.flags.writeable = False
    return array
