"""Fields whose zero level set is an offset, a shell or a Boolean of meshes. Their slope is at most 1."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..meshes.mesh import Mesh
from ..points.cloud import PointCloud
from ..queries.clouds import gradients_of
from ..volumes.level_set_blocks import SIDE, Blocks

Array = NDArray[np.float64]

#: A tangent plane is rejected if it lies more than this many voxels from its crossing: it then belongs to another part
#: of the surface.
REACH_VOXELS = 0.9

#: Steps of Newton's method onto the curve where two surfaces meet.
CURVE_STEPS = 4

#: Crossings whose tangent planes are computed at once.
BATCH = 1 << 20


#: A sample counts as on a face up to this distance, voxels: the rounding of the level in the extraction of surfaces.
ON_FACE = 2.0**-14

#: Distance along each axis of the points around such a sample, voxels. A solid without a surface there contains them.
AROUND = 2.0**-10

#: The corners of the cube from -1 to 1.
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


class Field(Protocol):
    """A field with a slope of at most 1, negative inside."""

    def values(self, points: Array) -> Array:
        """Values at points (n, 3), (n,)."""

    def samples(self, blocks: Blocks) -> Array:
        """Values at the samples of k blocks, (k, n)."""

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3) at points (n, 3)."""

    def distances(self, points: Array) -> Array:
        """Unsigned distances from the zero level set, (n,), of points (n, 3) near it."""


@dataclass(frozen=True)
class MeshField:
    """The signed distance of a mesh; the magnitude alone with `unsigned`."""

    mesh: Mesh
    unsigned: bool = False

    @property
    def sign(self) -> str:
        """The sign method."""
        return "unsigned" if self.unsigned else "auto"

    def values(self, points: Array) -> Array:
        """Distances at points (n, 3), (n,)."""
        found = _core.signed_distance(self.mesh._core, np.ascontiguousarray(points), sign=self.sign)
        return found.astype(np.float64)

    def samples(self, blocks: Blocks) -> Array:
        """Distances at the samples of k blocks, (k, n)."""
        grid, origins = blocks.grid, blocks.origins.astype(np.int32)
        found = _core.bake_blocks(
            self.mesh._core, grid.lower, grid.upper, grid.shape, origins, SIDE, unsigned=self.unsigned
        )
        distances = found.astype(np.float64)
        if not self.unsigned:
            self._move_off_inner_faces(distances, blocks)
        return distances

    def _move_off_inner_faces(self, distances: Array, blocks: Blocks) -> None:
        """Give samples on faces inside the solid a negative value, because a sample on the level counts as outside."""
        voxel = min(blocks.grid.spacing)
        rows, columns = np.nonzero(np.abs(distances) <= ON_FACE * voxel)
        if len(rows):
            points = blocks.points.reshape(*distances.shape, 3)[rows, columns]
            around = points[:, None] + AROUND * voxel * CORNERS
            is_inside = (self.values(around.reshape(-1, 3)).reshape(len(rows), -1) < 0).all(axis=1)
            distances[rows[is_inside], columns[is_inside]] = -AROUND * voxel

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Distances (n,) and unit gradients (n, 3)."""
        distances, gradients, *_ = _core.query(self.mesh._core, np.ascontiguousarray(points), sign=self.sign)
        return distances, gradients

    def distances(self, points: Array) -> Array:
        """Unsigned distances (n,)."""
        return _core.closest_point(self.mesh._core, np.ascontiguousarray(points))[1]


@dataclass(frozen=True)
class CloudField:
    """The signed distance of a cloud of points."""

    cloud: PointCloud

    def values(self, points: Array) -> Array:
        """Distances at points (n, 3), (n,)."""
        return self.cloud._core.query(np.ascontiguousarray(points), signed=True)[0]

    def samples(self, blocks: Blocks) -> Array:
        """Distances at the samples of k blocks, (k, n)."""
        return self.values(blocks.points).reshape(len(blocks.origins), -1)

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Distances (n,) and unit gradients (n, 3)."""
        points = np.ascontiguousarray(points)
        distances, nearest, rows, *_ = self.cloud._core.query(points, signed=True)
        return distances, gradients_of(self.cloud, points, distances, nearest, rows)

    def distances(self, points: Array) -> Array:
        """Unsigned distances from the disks (n,)."""
        return self.cloud._core.query(np.ascontiguousarray(points), signed=False)[0]


@dataclass(frozen=True)
class OuterField:
    """The distance of a mesh at samples of a grid, negative where a flood from outside does not reach."""

    mesh: Mesh
    sides: _core.OuterSides

    def values(self, points: Array) -> Array:
        """Signed distances at samples (n, 3), (n,)."""
        return self._with_sides(MeshField(self.mesh, unsigned=True).values(points), points)

    def samples(self, blocks: Blocks) -> Array:
        """Signed distances at the samples of k blocks, (k, n)."""
        # Samples on faces inside the solid must not count as outside.
        least = AROUND * min(blocks.grid.spacing)
        distances = self._with_sides(MeshField(self.mesh, unsigned=True).samples(blocks), blocks.points)
        return np.where(np.signbit(distances), np.minimum(distances, -least), distances)

    def _with_sides(self, distances: Array, points: Array) -> Array:
        outside = self.sides.is_outside(np.ascontiguousarray(points)).reshape(distances.shape)
        return np.where(outside, distances, -distances)


@dataclass(frozen=True)
class Shifted:
    """``sign * field - distance``: an offset surface. With the sign -1 it is an offset surface of the complement."""

    field: Field
    distance: float = 0.0
    sign: float = 1.0

    def values(self, points: Array) -> Array:
        """Values at points (n, 3), (n,)."""
        return self.sign * self.field.values(points) - self.distance

    def samples(self, blocks: Blocks) -> Array:
        """Values at the samples of k blocks, (k, n)."""
        return self.sign * self.field.samples(blocks) - self.distance

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3)."""
        values, gradients = self.field.tangents(points)
        return self.sign * values - self.distance, self.sign * gradients

    def distances(self, points: Array) -> Array:
        """Unsigned distances (n,)."""
        return np.abs(self.values(points)) if self.distance else self.field.distances(points)


@dataclass(frozen=True)
class Wall:
    """The points between two offset surfaces of one field, ``lower <= field <= upper``."""

    field: Field
    lower: float
    upper: float

    def values(self, points: Array) -> Array:
        """Values at points (n, 3), (n,)."""
        return self._between(self.field.values(points))

    def samples(self, blocks: Blocks) -> Array:
        """Values at the samples of k blocks, (k, n)."""
        return self._between(self.field.samples(blocks))

    def _between(self, found: Array) -> Array:
        return np.maximum(self.lower - found, found - self.upper)

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3)."""
        found, gradients = self.field.tangents(points)
        above = found > 0.5 * (self.lower + self.upper)
        values = np.where(above, found - self.upper, self.lower - found)
        return values, np.where(above[:, None], gradients, -gradients)

    def distances(self, points: Array) -> Array:
        """Unsigned distances (n,)."""
        return np.abs(self.values(points))


@dataclass(frozen=True)
class Intersection:
    """The larger of two fields, with a fillet where they differ by less than `smooth`.

    The fillet is the quadratic polynomial of I. Quilez, ``max(a, b) + max(smooth - |a - b|, 0)^2 / (4 smooth)``. Its
    gradient is a convex combination of the two gradients, so its length is at most 1 too.
    """

    first: Field
    second: Field
    smooth: float = 0.0

    def values(self, points: Array) -> Array:
        """Values at points (n, 3), (n,)."""
        return self._blend(self.first.values(points), self.second.values(points))

    def samples(self, blocks: Blocks) -> Array:
        """Values at the samples of k blocks, (k, n)."""
        found = self.first.samples(blocks)
        # A block outside the first solid lies outside the intersection, so the second field is not needed there.
        rows = np.flatnonzero(~(found > 0).all(axis=1))
        found[rows] = self._blend(found[rows], self.second.samples(Blocks(blocks.grid, blocks.origins[rows])))
        return found

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3)."""
        (a, along_a), (b, along_b) = self.first.tangents(points), self.second.tangents(points)
        share = (a >= b).astype(np.float64)
        if self.smooth > 0:
            share = np.clip(0.5 + (a - b) / (2 * self.smooth), 0.0, 1.0)
        return self._blend(a, b), share[:, None] * along_a + (1 - share)[:, None] * along_b

    def distances(self, points: Array) -> Array:
        """Unsigned distances (n,): to the part of either surface inside the other field, or to their common curve."""
        (a, along_a), (b, along_b) = self.first.tangents(points), self.second.tangents(points)
        if self.smooth > 0:
            return np.abs(self._blend(a, b))
        on_a = self.second.values(points - a[:, None] * along_a) <= 0
        on_b = self.first.values(points - b[:, None] * along_b) <= 0
        found = np.minimum(np.where(on_a, np.abs(a), np.inf), np.where(on_b, np.abs(b), np.inf))
        rows = np.flatnonzero(~np.isfinite(found))
        curve = points[rows]
        for _ in range(CURVE_STEPS):
            (a, along_a), (b, along_b) = self.first.tangents(curve), self.second.tangents(curve)
            # The shortest step that cancels both values in the linear functions around the point.
            mixed = np.einsum("ij,ij->i", along_a, along_b)
            share = 1 / np.maximum(1 - mixed**2, 1e-6)
            curve = curve - ((a - mixed * b) * share)[:, None] * along_a - ((b - mixed * a) * share)[:, None] * along_b
        found[rows] = np.linalg.norm(curve - points[rows], axis=1)
        return found

    def _blend(self, a: Array, b: Array) -> Array:
        found = np.maximum(a, b)
        if self.smooth > 0:
            found += np.maximum(self.smooth - np.abs(a - b), 0.0) ** 2 / (4 * self.smooth)
        return found


def complement(field: Field) -> Field:
    """The field of the complement."""
    return Shifted(field, sign=-1.0)


@dataclass(frozen=True)
class TangentSource:
    """Tangent planes of the zero level set of a field, by one step of Newton's method from each crossing."""

    field: Field

    def apply(self, surface: _core.Surface, level: float) -> None:
        """Set the tangent planes of `surface`, the level set of the field at `level`."""
        starts, ends, shares = surface.edges()
        points, normals = np.empty_like(starts), np.empty_like(starts)
        for first in range(0, len(starts), BATCH):
            rows = slice(first, first + BATCH)
            length = np.linalg.norm(ends[rows] - starts[rows], axis=1)
            points[rows] = starts[rows] + (ends[rows] - starts[rows]) * shares[rows, None]
            points[rows], normals[rows] = projected(self.field, points[rows], level)
            far = np.linalg.norm(points[rows] - 0.5 * (starts[rows] + ends[rows]), axis=1) > (
                (0.5 + REACH_VOXELS) * length
            )
            normals[rows][far] = np.nan
        surface.use_planes(points, normals)

    def opposite(self) -> TangentSource:
        """Make the source of the negative field."""
        return TangentSource(complement(self.field))

    def planes(self, points: Array, level: float) -> tuple[Array, Array]:
        """Evaluate tangent planes next to points (n, 3): a point and a normal of each, (n, 3)."""
        return projected(self.field, points, level)


def projected(field: Field, points: Array, level: float = 0.0) -> tuple[Array, Array]:
    """Move points (n, 3) onto the tangent planes of the level set; return them and the normals of the planes (n, 3).

    A distance is linear along its gradient up to the nearest point of the surface, so for a distance the step is exact.
    """
    values, gradients = field.tangents(points)
    square = np.einsum("ij,ij->i", gradients, gradients)
    # A gradient vanishes where the gradients of two blended fields cancel. Such a row keeps its plane.
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(square > 1e-12, (values - level) / square, np.nan)
    return points - gradients * step[:, None], gradients
