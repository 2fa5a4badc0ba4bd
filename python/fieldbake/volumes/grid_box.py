"""A box divided into voxels, with the report of the computation of its samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.report import Report

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


class Coordinates(NamedTuple):
    """Positions of the voxel centres along each axis, world units."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]


class GridBox(ABC):
    """The box and the voxels of a field. Immutable."""

    __slots__ = ("_bounds", "_inner_bounds", "_report", "_shape")

    _shape: tuple[int, int, int]
    _bounds: NDArray[np.float64]
    _inner_bounds: NDArray[np.float64]
    _report: Report

    def _set_box(
        self,
        shape: tuple[int, ...],
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
    ) -> None:
        """Set the number of voxels, the boxes and the report, which have been checked."""
        nx, ny, nz = shape
        self._shape = (nx, ny, nz)
        self._bounds = checks.frozen(bounds)
        self._inner_bounds = checks.frozen(inner_bounds)
        self._report = report

    @property
    @abstractmethod
    def distances(self) -> NDArray[np.float32]:
        """Samples (nx, ny, nz), world units."""

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box, (2, 3), world units. Samples lie half a voxel inside the box."""
        return self._bounds

    @property
    def inner_bounds(self) -> NDArray[np.float64]:
        """Box that contains the whole surface, (2, 3), world units."""
        return self._inner_bounds

    @property
    def resolution(self) -> tuple[int, int, int]:
        """Number of voxels of the whole grid along x, y and z."""
        return self._shape

    @property
    def spacing(self) -> NDArray[np.float64]:
        """Size of a voxel, (3,), world units."""
        return np.asarray((self._bounds[1] - self._bounds[0]) / np.array(self._shape))

    @property
    def origin(self) -> NDArray[np.float64]:
        """Centre of voxel (0, 0, 0), (3,), world units."""
        corner: NDArray[np.float64] = self._bounds[0]
        return corner + self.spacing / 2

    @property
    def coordinates(self) -> Coordinates:
        """Positions of the voxel centres along x, y and z: three float64 arrays of lengths nx, ny and nz."""
        x, y, z = (
            start + np.arange(count) * step
            for start, count, step in zip(self.origin, self._shape, self.spacing, strict=True)
        )
        return Coordinates(x, y, z)

    @property
    def report(self) -> Report:
        """Properties of the surface and cost of the bake."""
        return self._report

    def _facts(self) -> dict[str, Any]:
        """Metadata of the field that a file stores besides the samples."""
        return {
            "resolution": list(self._shape),
            "bounds": self._bounds.tolist(),
            "inner_bounds": self._inner_bounds.tolist(),
            "report": self._report.to_dict(),
        }

    def _corners(self) -> Corners:
        return checks.triple(self._bounds[0]), checks.triple(self._bounds[1])

    def _inner_corners(self) -> Corners:
        return checks.triple(self._inner_bounds[0]), checks.triple(self._inner_bounds[1])

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name):
            raise AttributeError(f"a {type(self).__name__} cannot be changed ({name}); make a new one")
        super().__setattr__(name, value)
