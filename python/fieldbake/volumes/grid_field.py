"""The base class of dense and sparse volumes: an immutable box with voxels and a report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.report import Report


class GridField(ABC):
    """A field on a grid over a box. Immutable."""

    __slots__ = ("_bounds", "_inner_bounds", "_report")

    _bounds: NDArray[np.float64]
    _inner_bounds: NDArray[np.float64]
    _report: Report

    def _stand_in(self, bounds: NDArray[np.float64], inner_bounds: NDArray[np.float64], report: Report) -> None:
        """Set the box, the inner box and the report, which have been checked."""
        self._bounds = checks.frozen(bounds)
        self._inner_bounds = checks.frozen(inner_bounds)
        self._report = report

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box, (2, 3); samples lie half a voxel inside."""
        return self._bounds

    @property
    def inner_bounds(self) -> NDArray[np.float64]:
        """Box that contains the whole surface, (2, 3), world units."""
        return self._inner_bounds

    @property
    @abstractmethod
    def resolution(self) -> tuple[int, int, int]:
        """Voxels along x, y and z."""

    @property
    def spacing(self) -> NDArray[np.float64]:
        """Size of a voxel, (3,), world units."""
        return np.asarray((self._bounds[1] - self._bounds[0]) / np.array(self.resolution))

    @property
    def origin(self) -> NDArray[np.float64]:
        """Centre of voxel (0, 0, 0), (3,), world units."""
        corner: NDArray[np.float64] = self._bounds[0]
        return corner + self.spacing / 2

    @property
    def report(self) -> Report:
        """Properties of the surface and cost of the bake."""
        return self._report

    def _facts(self) -> dict[str, Any]:
        """What a file says about the field besides its samples."""
        return {
            "resolution": list(self.resolution),
            "bounds": self._bounds.tolist(),
            "inner_bounds": self._inner_bounds.tolist(),
            "report": self._report.to_dict(),
        }

    def _corners(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        return checks.triple(self._bounds[0]), checks.triple(self._bounds[1])

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name):
            raise AttributeError(f"a {type(self).__name__} cannot be changed ({name}); make a new one")
        super().__setattr__(name, value)
