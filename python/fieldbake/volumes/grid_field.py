"""The base class of dense and sparse volumes: an immutable box with voxels and a report."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.progress import Progress, part, watched
from ..base.viewable import Viewable
from ..meshes.isosurface import Source, as_source, extract
from ..meshes.mesh import Mesh
from ..meshes.section import Section, Sectioned, field_sections
from .interop import Interop

Filter = Literal["linear", "nearest"]

#: Samples along each axis of the faces of the box, and the fraction of those inside above which `to_mesh` warns.
BORDER, MOSTLY = 32, 0.5


class GridField(Viewable, Sectioned, Interop):
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
            World positions of any leading shape. A point beyond the outermost voxel centres is replaced by the nearest
            point between them.

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

    def to_mesh(
        self,
        level: float = 0.0,
        *,
        inside: Literal["below", "above"] = "below",
        sharp: bool = True,
        source: object = None,
        capped: bool = True,
        progress: Progress = None,
    ) -> Mesh:
        """Extract the surface where the field has the value `level`, as a closed triangle mesh.

        Parameters
        ----------
        level : float, default 0
            Value of the field on the surface, world units for distances. A positive level gives a grown solid, a
            negative one a shrunk solid.
        inside : "below" or "above", default "below"
            The solid is the set of points where the field is below the level, as distances have it, or above it, as
            intensities and densities have it: a bone in a CT scan is brighter than 300 Hounsfield units. ``"above"``
            needs the memory of two dense grids.
        sharp : bool, default True
            Place vertices at the intersections of the tangent planes of the surface, which keeps edges and corners.
            False gives smooth vertices on the trilinear surface.
        source : mesh, shape or volume, optional
            Geometry that supplies exact tangent planes. The default is the mesh or the shape that the field was baked
            from, if it is known. Fields read from a file use their own gradients.
        capped : bool, default True
            Close a surface that leaves the box by the faces of the box. False leaves it open there.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        Mesh
            Triangles counter-clockwise as seen from the larger values. Every edge belongs to two faces that use it in
            opposite directions. Every vertex has one fan of faces, every face has an area, and no vertex lies outside
            `bounds`. No two faces cross. The mesh has no faces if there is no surface. `report` counts the clamped
            vertices.

        Raises
        ------
        ArgumentError
            If `level` is not finite, or beyond the distances that the field stores, or `inside` is another word.
        MeshError
            If `source` is not a mesh, a shape or a volume.

        Warns
        -----
        SurfaceWarning
            If the source of the field is not known and most of the border of the box is inside. That is the negative of
            the solid where the samples are intensities.

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

        Intensities are larger inside.

        >>> scan = fb.Volume(100 - 50 * fb.bake(fb.sphere(1), 48).distances, [(-1.1,) * 3, (1.1,) * 3])
        >>> f"{scan.to_mesh(100, inside='above').volume:.2f}"  # 4 pi / 3 is 4.19
        '4.19'
        """
        level = checks.number("level", level)
        above = checks.choice("inside", inside, ("below", "above")) == "above"
        kept = self._kept_distance()
        if kept is not None and abs(level) > kept:
            raise ArgumentError(f"level: must be within {kept:g} of 0, the largest stored distance, got {level:g}")
        planes = self._geometry if source is None else as_source(source)
        warnings = () if above else self._border_warnings(level)
        with watched(progress, "mesh"):
            if above:
                opposite = None if planes is None else planes.opposite()
                with part(0.0, 0.4):
                    surface = _core.Surface.of_field(np.negative(self.distances), *self._corners(), -level)
                with part(0.4, 1.0):
                    return extract(surface, -level, opposite, sharp=sharp, capped=capped)
            with part(0.0, 0.4):
                surface = self._surface(level)
            with part(0.4, 1.0):
                return extract(surface, level, planes, sharp=sharp, capped=capped, warnings=warnings)

    def _sections(self, planes: list[NDArray[np.float64]]) -> list[Section]:
        spacing = float(self.spacing.min())
        return field_sections(
            lambda points: self._sample(points, "linear"), self._bounds, spacing, planes, clipped=True
        )

    def _border_warnings(self, level: float) -> tuple[str, ...]:
        """Describe a field of unknown origin that is below the level on most of the border of its box."""
        if self._geometry is not None:
            return ()
        axes = [
            centers[np.unique(np.linspace(0, len(centers) - 1, BORDER).astype(int))] for centers in self.coordinates
        ]
        faces = [
            np.meshgrid(*[centers[[0, -1]] if own == axis else centers for own, centers in enumerate(axes)])
            for axis in range(3)
        ]
        points = np.concatenate([np.stack(face, axis=-1).reshape(-1, 3) for face in faces])
        share = float((self._sample(points, "nearest") < level).mean())
        if share <= MOSTLY:
            return ()
        return (
            f"{share:.0%} of the border of the box is below the level {level:g}, which is inside, and the solid is "
            'closed there; for intensities, such as CT, MRI or densities, pass inside="above"',
        )

    @abstractmethod
    def _surface(self, level: float) -> _core.Surface:
        """Find the cells that a level set crosses."""

    def _kept_distance(self) -> float | None:
        """Largest magnitude of a stored distance, world units; None without a limit."""
        return self._report.band or None
