"""Samples of a regular grid in files that other programs read and write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import FormatError
from ..formats import FieldFile


@dataclass(frozen=True)
class GridSamples:
    """Samples (nx, ny, nz) with their positions.

    Attributes
    ----------
    samples : (nx, ny, nz) float32
        Distances at the voxel centres.
    origin, spacing : (3,) float64
        Centre of voxel (0, 0, 0) and size of a voxel, world units.
    facts : dict or None
        Metadata that fieldbake wrote; None in files of other programs.
    band : float
        Magnitude to which larger distances are clamped, world units; 0 if they are not clamped.
    """

    samples: NDArray[np.float32]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    facts: dict[str, Any] | None = None
    band: float = 0.0

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box, (2, 3)."""
        lower = self.origin - self.spacing / 2
        return np.stack([lower, lower + self.samples.shape * self.spacing])


def checked_count(sizes: list[int]) -> int:
    """Compute the number of samples of a grid with these sides, or raise FormatError for invalid sides."""
    if len(sizes) != 3 or not all(0 < n < 2**31 for n in sizes):
        raise FormatError(f"a grid must have three sides, got {sizes}")
    return sizes[0] * sizes[1] * sizes[2]


def as_samples(values: NDArray[Any], sizes: list[int]) -> NDArray[np.float32]:
    """Convert numbers with x fastest to float32 samples (nx, ny, nz), or raise FormatError if one is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        samples = np.array(values, np.float32).reshape(sizes, order="F")
    if not np.isfinite(samples).all():
        raise FormatError("a sample is not finite")
    return samples


def samples_of(file: FieldFile) -> GridSamples:
    """Collect the samples, the positions and the metadata of a field that is written as a grid."""
    return GridSamples(file.field.distances, file.field.origin, file.field.spacing, file.facts("float32", 1.0))
