"""Hashes of training samples. Spawned workers import this module; they cannot import test modules."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """A hash of names, types, shapes and bytes."""
    text = hashlib.sha256()
    for name, array in arrays.items():
        text.update(f"{name} {array.dtype} {array.shape}".encode())
        text.update(array.tobytes())
    return text.hexdigest()


def digest_of(data: Any, index: int) -> str:
    """The hash of one item of a data set."""
    return digest(data[index])


def digest_of_batch(batch: Sequence[Mapping[str, np.ndarray]]) -> str:
    """The hash of a batch of one item."""
    (arrays,) = batch
    return digest(arrays)
