"""Closed triangle meshes from level sets, with exact tangent planes where the source of a field is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.notices import warn_surface
from ..base.progress import part
from ..base.report import SurfaceReport
from .convert import as_mesh
from .mesh import Mesh
from .roots import roots

#: Steps of Newton's method from a probe onto a level set. Fields of distances need one on smooth parts.
NEWTON_STEPS = 2

#: Probes whose tangent planes are evaluated at once: 100 MB of results of a query.
BATCH = 1 << 20

#: Faces at which the thickness of walls and gaps is examined, and the fraction of the surface that may bound walls or
#: gaps thinner than a voxel, as at the tips and edges of an ordinary solid. The edges of the grid pass through thinner
#: ones between two samples.
WALL_FACES = 2048
THIN_SHARE = 0.05

#: A gradient shorter than this fraction of a nearby one is the mean of both sides of a crease, of 23 degrees or more.
CREASE_SLOPE = 0.98


#: A point (n, 3) and a normal (n, 3) of each tangent plane.
Planes = tuple[NDArray[np.float64], NDArray[np.float64]]


class Source(Protocol):
    """Geometry that a field was computed from. It replaces the tangent planes of the samples by exact ones."""

    def apply(self, surface: _core.Surface, level: float) -> None:
        """Set the tangent planes of `surface`, the level set of the field at `level`, and join those around it."""

    def opposite(self) -> Source:
        """Make the source of the negative field, whose inside is the outside of this one."""


@dataclass(frozen=True)
class MeshSource:
    """A mesh, or the sheet around it if it has a half thickness."""

    mesh: Mesh
    half_thickness: float | None = None

    def apply(self, surface: _core.Surface, level: float) -> None:
        """Use the faces that edges cross. At a level other than zero, use spheres around the nearest points."""
        level += self.half_thickness or 0.0
        surface.use_mesh(self.mesh._core, level, unsigned=self.half_thickness is not None)
        facts = self.mesh._core.topology()
        if level == 0 and facts["flipped_faces"] == 0 and facts["duplicate_faces"] == 0:
            # All faces are oriented alike, so the side of each point is not needed.
            surface.join_mesh(self.mesh._core, inward=self.mesh.volume < 0)
        elif not surface.join_offset(self.mesh._core, level, unsigned=self.half_thickness is not None):
            join_probes(surface, lambda points: self._planes(points, level))

    def opposite(self) -> FieldSource:
        """Make the source of the negative distance."""
        mesh, sign, shift = self.mesh._core, self._sign, self.half_thickness or 0.0
        return FieldSource(
            lambda points: shift - _core.query(mesh, points, sign=sign)[0],
            lambda points: -_core.query(mesh, points, sign=sign)[1],
        )

    @property
    def _sign(self) -> str:
        return "auto" if self.half_thickness is None else "unsigned"

    def _planes(self, points: NDArray[np.float64], level: float) -> Planes:
        """Evaluate the planes of the nearest faces; at other levels than zero, of spheres around the nearest points."""
        distances, gradients, nearest, faces, *_ = _core.query(self.mesh._core, points, sign=self._sign)
        if level != 0:
            return points + gradients * (level - distances)[:, None], gradients
        normals = self.mesh.face_normals[faces]
        turned = np.einsum("ij,ij->i", normals, gradients) < 0
        return nearest, np.where(turned[:, None], -normals, normals)


@dataclass(frozen=True)
class ShapeSource:
    """A shape, evaluated by the core."""

    shape: _core.Shape

    def apply(self, surface: _core.Surface, level: float) -> None:
        """Find the root on each crossed edge and the tangent plane there, then the planes around the vertices."""
        surface.use_shape(self.shape, level)

    def opposite(self) -> FieldSource:
        """Make the source of the negative field."""
        shape = self.shape
        return FieldSource(lambda points: -shape.distance(points, "cpu"), lambda points: -shape.gradient(points))


@dataclass(frozen=True)
class FieldSource:
    """A field that can be evaluated at any point.

    Attributes
    ----------
    evaluate : callable
        Values at points (n, 3), (n,), below zero inside.
    gradient : callable
        Gradients at points (n, 3), (n, 3), of any length.
    """

    evaluate: Callable[[NDArray[np.float64]], NDArray[Any]]
    gradient: Callable[[NDArray[np.float64]], NDArray[Any]]

    def apply(self, surface: _core.Surface, level: float) -> None:
        """Find the root on each crossed edge by the Illinois method, and the gradient there."""
        starts, ends, shares = surface.edges()
        share, found = roots(lambda points: self._values(points, level), starts, ends, shares)
        points = starts + (ends - starts) * share[:, None]
        normals = np.full(points.shape, np.nan)
        normals[found] = self.gradient(points[found])
        surface.use_planes(points, normals)
        join_probes(surface, lambda points: self._planes(points, level))

    def opposite(self) -> FieldSource:
        """Make the source of the negative field."""
        return FieldSource(
            lambda points: np.negative(self.evaluate(points)), lambda points: np.negative(self.gradient(points))
        )

    def _planes(self, points: NDArray[np.float64], level: float) -> Planes:
        """Move points to the level set by Newton's method, and evaluate the planes there.

        A plane is the level set of the linear function with the value and the gradient at the last point. At a sharp
        edge steps alternate between its sides; the plane of a flat side is exact although the point lies off it. Rows
        are nan where the gradient is the mean of two sides of a crease: it is shorter there than at the probe.
        """
        slopes, before = np.zeros(len(points)), np.full(len(points), np.inf)
        lost = np.zeros(len(points), dtype=np.bool_)
        for _ in range(NEWTON_STEPS + 1):
            values, gradients = self._values(points, level), np.asarray(self.gradient(points), dtype=np.float64)
            square = np.einsum("ij,ij->i", gradients, gradients)
            kept = (np.abs(values) <= before + 1e-12) & (np.sqrt(square) >= CREASE_SLOPE * slopes)
            slopes, before = np.maximum(slopes, np.sqrt(square)), np.abs(values)
            with np.errstate(divide="ignore", invalid="ignore"):
                points = points - gradients * np.where(square > 1e-12, values / square, np.nan)[:, None]
            lost |= ~np.isfinite(points).all(axis=1)
            points[lost] = 0.0
        return np.where((kept & ~lost)[:, None], points, np.nan), gradients

    def _values(self, points: NDArray[np.float64], level: float) -> NDArray[np.float64]:
        return np.asarray(self.evaluate(points), dtype=np.float64) - level


def as_source(source: object) -> Source:
    """Make a source of a mesh, of an object that converts to one, or of an object with a field and its gradient."""
    core = getattr(source, "_core", None)
    if isinstance(core, _core.Shape):
        return ShapeSource(core)
    evaluate = getattr(source, "distance", None) or getattr(source, "sample", None)
    gradient = getattr(source, "gradient", None)
    if callable(evaluate) and callable(gradient):
        return FieldSource(evaluate, gradient)
    return MeshSource(as_mesh(source))


def join_probes(surface: _core.Surface, planes: Callable[[NDArray[np.float64]], Planes]) -> None:
    """Join the planes that `planes` evaluates at points (n, 3) around the vertices."""
    # The second probes lie around the places where the planes of the first have put the sharp vertices.
    for sharp_only in (False, True):
        points = surface.probes(sharp_only=sharp_only)
        if len(points):
            normals = np.empty_like(points)
            for first in range(0, len(points), BATCH):
                rows = slice(first, first + BATCH)
                with part(first / len(points), min(1.0, (first + BATCH) / len(points))):
                    points[rows], normals[rows] = planes(points[rows])
            surface.join_planes(points, normals)


def extract(
    surface: _core.Surface,
    level: float,
    source: Source | None,
    *,
    sharp: bool,
    capped: bool,
    warnings: tuple[str, ...] = (),
) -> Mesh:
    """Extract the mesh of a level set; see :meth:`fieldbake.Volume.to_mesh`. Its report has the `warnings`."""
    sharp, capped = checks.flag("sharp", sharp), checks.flag("capped", capped)
    warn_surface(warnings)
    with part(0.0, 0.6):
        if sharp and source is not None:
            source.apply(surface, level)
        elif isinstance(source, ShapeSource):
            # The crossings are roots of the field; linear interpolation of its samples misses the roots of thin walls.
            surface.use_shape(source.shape, level, sharp=False)
    with part(0.6, 1.0):
        vertices, faces, clamped = surface.mesh(sharp=sharp, capped=capped)
    return Mesh._extracted(vertices, faces, SurfaceReport(clamped_vertices=clamped, warnings=warnings))


def with_thin_features(mesh: Mesh, shape: _core.Shape, voxel: float, missed: int) -> Mesh:
    """Warn if many walls or gaps of the mesh of a shape are thinner than a voxel, and add the warning to its report.

    `missed` is the area of walls without a sample inside and of gaps without one outside, in squares of a voxel.
    """
    step = -(-len(mesh.faces) // WALL_FACES) or 1
    corners = mesh.vertices[mesh.faces[::step]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    # A face without an area has no normal, and bounds no wall.
    corners, normals, areas = (values[areas > 0] for values in (corners, normals, areas))
    centers, outward = corners.mean(axis=1), voxel * normals / areas[:, None]
    is_thin = (shape.distance(centers - outward, "cpu") > 0) | (shape.distance(centers + outward, "cpu") < 0)
    # Each entry of `areas` is twice the area of a face, and a wall has two sides.
    missing = 4 * missed * voxel**2 / step
    thin = missing + float(areas[is_thin].sum())
    share = thin / max(missing + float(areas.sum()), np.finfo(float).tiny)
    if share > THIN_SHARE:
        warnings = (
            f"resolution: about {100 * share:.0f} % of the surface bounds walls or gaps thinner than a voxel "
            f"({voxel:.3g}), which the mesh may lose or close; choose more voxels",
        )
        warn_surface(warnings)
        mesh._report = replace(mesh._report or SurfaceReport(), warnings=warnings)
    return mesh
