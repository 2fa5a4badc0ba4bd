"""The base class of dense and sparse volumes: an immutable box with voxels and a report."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.viewable import Viewable
from ..meshes.isosurface import Source, as_source, extract
from ..meshes.mesh import Mesh
from .neighbours import Neighbours

Filter = Literal["linear", "nearest"]


class GridField(Viewable, Neighbours):
    """A field on a grid over a box. Immutable."""

    __slots__ = ("_geometry",)

    #: Mesh or shape that the field was computed from; None if it is not known.
    _geometry: Source | None

    def sample(self, points: ArrayLike, *, filter: Filter = "linear") -> NDArray[np.float32]:
        """Evaluate the field at points.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape.
        filter : "linear" or "nearest", default "linear"
            Trilinear interpolation of the eight surrounding samples, or the nearest sample.

        Returns
        -------
        (n,) float32
            Distances, world units. Beyond the band of a sparse volume or of a field in a Zarr store the field has no
            samples, and the value is a proven lower bound on the distance, with its sign. Outside the box it is the
            proven lower bound ``sqrt(a^2 + s^2)``, where `a` is the distance from the box of the outermost samples and
            `s` a lower bound at the nearest point of that box.

        Raises
        ------
        ArgumentError
            For a wrong shape, a point that is not finite, or an unknown filter.
        FormatError
            If a shard of a Zarr store is missing or damaged; the message has its key.
        """
        flat, shape = checks.points(points)
        return self._sample(flat, checks.choice("filter", filter, ("linear", "nearest"))).reshape(shape)

    def gradient(self, points: ArrayLike) -> NDArray[np.float32]:
        """Evaluate the gradient of the trilinear field at points. On the surface it points outwards.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape. A point outside the box is replaced by the nearest point of the box.

        Returns
        -------
        (n, 3) float32
            Distance per world unit. The length is about 1 away from edges of the field. Beyond the band of a field in a
            Zarr store, distances at the corners of the shards are interpolated, and the length is at most 1.

        Raises
        ------
        ArgumentError
            For a wrong shape or a point that is not finite.
        FormatError
            As for :meth:`sample`.
        """
        flat, shape = checks.points(points)
        return self._gradient(flat).reshape(*shape, 3)

    @abstractmethod
    def _sample(self, points: NDArray[np.float64], filter: str) -> NDArray[np.float32]:
        """Evaluate the field at checked points, (n, 3)."""

    @abstractmethod
    def _gradient(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Evaluate the gradient at checked points, (n, 3)."""

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
        points around the vertices. Time and additional memory grow with the area of the surface. Straight edges and
        corners of the source that are some voxels apart are reproduced to a fiftieth of a voxel.

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
            raise ArgumentError(f"level: must be within {kept:g} of 0, the largest stored distance, got {level:g}")
        planes = self._geometry if source is None else as_source(source)
        return extract(self._surface(level), level, planes, sharp=sharp, capped=capped)

    @abstractmethod
    def _surface(self, level: float) -> _core.Surface:
        """Find the cells that a level set crosses."""

    def _kept_distance(self) -> float | None:
        """Largest magnitude of a stored distance, world units; None without a limit."""
        return self._report.band or None
