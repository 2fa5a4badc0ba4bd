"""The base class of dense and sparse volumes: an immutable box with voxels and a report."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.report import Report
from ..base.viewable import Viewable
from ..meshes.isosurface import Source, as_source, extract
from ..meshes.mesh import Mesh
from .conventions import Convention
from .neighbours import Neighbours


class GridField(Viewable, Neighbours):
    """A field on a grid over a box. Immutable."""

    __slots__ = ("_bounds", "_geometry", "_inner_bounds", "_report")

    _bounds: NDArray[np.float64]
    _inner_bounds: NDArray[np.float64]
    _report: Report
    #: Mesh or shape that the field was computed from; None if it is not known.
    _geometry: Source | None

    def _stand_in(
        self,
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
        geometry: Source | None = None,
    ) -> None:
        """Set the box, the inner box, the report and the geometry, which have been checked."""
        self._geometry = geometry
        self._bounds = checks.frozen(bounds)
        self._inner_bounds = checks.frozen(inner_bounds)
        self._report = report

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box, (2, 3), world units. Samples lie half a voxel inside the box."""
        return self._bounds

    @property
    def inner_bounds(self) -> NDArray[np.float64]:
        """Box that contains the whole surface, (2, 3), world units."""
        return self._inner_bounds

    @property
    @abstractmethod
    def resolution(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""

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

    def to_mesh(self, level: float = 0.0, *, sharp: bool = True, source: object = None, capped: bool = True) -> Mesh:
        """Extract the surface where the field has the value `level`, as a closed triangle mesh.

        Parameters
        ----------
        level : float, default 0
            World units. The solid is the set of points where the field is below the level. A positive level gives a
            grown solid, a negative one a shrunk solid.
        sharp : bool, default True
            Place vertices at the intersections of the tangent planes of the surface, which keeps edges and corners.
            False gives smooth vertices on the trilinear surface.
        source : mesh, shape or volume, optional
            Geometry that supplies exact tangent planes. The default is the mesh or the shape that the field was baked
            from, if it is known. Fields read from a file use their own gradients.
        capped : bool, default True
            Close a surface that leaves the box by the faces of the box. False leaves it open there.

        Returns
        -------
        Mesh
            Triangles counter-clockwise as seen from the larger values. Every edge belongs to two faces that use it in
            opposite directions. Every vertex has one fan of faces, every face has an area, and no vertex lies outside
            `bounds`. The mesh has no faces if there is no surface. `report` counts the clamped vertices.

        Raises
        ------
        ArgumentError
            If `level` is not finite, or beyond the distances that the field stores.
        MeshError
            If `source` is not a mesh, a shape or a volume.

        Notes
        -----
        One vertex is made for each surface patch of a cell (G. Nielson, "Dual Marching Cubes", IEEE Visualization
        2004). A quadratic error function places it within its cell (T. Ju et al., "Dual Contouring of Hermite Data",
        SIGGRAPH 2002). The planes are those at the crossed edges of the grid and, if the source is known, those at
        points around the vertices. Time and additional memory grow with the surface. Straight edges and corners of the
        source that are some voxels apart are reproduced to a fiftieth of a voxel.

        Examples
        --------
        >>> import fieldbake as fb
        >>> cube = fb.bake(fb.box(2).rotate("z", 30), 32).to_mesh()
        >>> cube.topology()["closed"]
        True
        """
        level = checks.number("level", level)
        kept = self._kept_distance()
        if kept is not None and abs(level) > kept:
            raise ArgumentError(f"level: must be at most {kept:g} in magnitude, where the distances end, got {level:g}")
        planes = self._geometry if source is None else as_source(source)
        return extract(self._surface(level), level, planes, sharp=sharp, capped=capped)

    @abstractmethod
    def _surface(self, level: float) -> _core.Surface:
        """Find the cells that a level set crosses."""

    def _kept_distance(self) -> float | None:
        """Largest magnitude of a stored distance, world units; None without a limit."""
        return self._report.band or None

    def _facts(self) -> dict[str, Any]:
        """Metadata of the field that a file stores besides the samples."""
        return {
            "resolution": list(self.resolution),
            "bounds": self._bounds.tolist(),
            "inner_bounds": self._inner_bounds.tolist(),
            "report": self._report.to_dict(),
        }

    def _turned_boxes(self, way: Convention) -> tuple[NDArray[np.float64], NDArray[np.float64], Report]:
        """Box, inner box and report in the space of a convention."""
        placed = way.transform(self._bounds)
        scale = way.scale(self._bounds)
        found = self._report
        report = replace(found, band=found.band * scale, chord_error=found.chord_error * scale)
        return way.box(self._bounds, placed), way.box(self._inner_bounds, placed), report

    def _corners(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        return checks.triple(self._bounds[0]), checks.triple(self._bounds[1])

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name):
            raise AttributeError(f"a {type(self).__name__} cannot be changed ({name}); make a new one")
        super().__setattr__(name, value)
