"""Sharp edges of a mesh, and points on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, MeshError
from ..base.progress import Progress, progress_callback
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.measures import unit_rows
from ..meshes.mesh import Mesh
from .common import source_faces
from .sampling import MOST_SAMPLES, SurfaceSamples

#: Number of points that are drawn at once.
BATCH = 1 << 18


@dataclass(frozen=True)
class Edges:
    """Edges of a mesh whose equal positions are one vertex; one row per edge."""

    #: Welded vertices at both ends, (e, 2).
    vertices: NDArray[np.int64]
    #: One of the faces of each edge, and the corner of this face at which the edge starts, (e,).
    faces: NDArray[np.int64]
    corners: NDArray[np.int64]
    #: Angles between the normals of both faces, radians; infinite for edges without exactly two faces, (e,).
    angles: NDArray[np.float64]
    #: Unit means of the normals of the faces, (e, 3).
    normals: NDArray[np.float64]

    def rows(self, kept: NDArray[np.bool_]) -> Edges:
        """Select edges by a mask (e,)."""
        return Edges(self.vertices[kept], self.faces[kept], self.corners[kept], self.angles[kept], self.normals[kept])


def welded(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Merge vertices at equal positions; return the positions (n, 3) and the faces (m, 3)."""
    positions = np.asarray(mesh.vertices, np.float64) + 0.0  # negative zeros become positive
    order = np.lexsort(positions.T)
    ordered = positions[order]
    first = np.ones(len(order), bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    rows = np.empty(len(order), np.int64)
    rows[order] = np.cumsum(first) - 1
    return ordered[first], rows[mesh.faces]


def edges_of(mesh: Mesh, faces: NDArray[np.int64]) -> Edges:
    """List the edges between the welded `faces` (m, 3) of a mesh, without edges of length zero.

    If both faces use an edge in the same direction, one of them is flipped, and the angle is measured between the
    normals after that. An edge at a face without area has the angle 0, unless it is a boundary.
    """
    starts = faces.T.ravel()  # first all edges from corner 0 to corner 1
    ends = np.roll(faces, -1, axis=1).T.ravel()
    rows = np.flatnonzero(starts != ends)
    starts, ends = starts[rows], ends[rows]
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    order = np.argsort(low * (faces.max(initial=0) + 1) + high, kind="stable")
    low, high, rows, forward = low[order], high[order], rows[order], (starts < ends)[order]
    first = np.flatnonzero(np.concatenate([[True], (low[1:] != low[:-1]) | (high[1:] != high[:-1])])[: len(low)])
    counts = np.diff(first, append=len(low))
    owner, corner = rows % len(faces), rows // len(faces)
    normals = mesh.face_normals[owner]
    turned = forward == forward[np.repeat(first, counts)]
    two = counts == 2
    # The two faces of an edge use it in opposite directions; a face with the direction of the first one is flipped.
    turned[first] = False
    turned &= np.repeat(two, counts)
    normals[turned] *= -1
    one, other = normals[first[two]], normals[first[two] + 1]
    angles = np.full(len(first), np.inf)
    angles[two] = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("ij,ij->i", one, other))
    angles[two] *= one.any(axis=1) & other.any(axis=1)
    sums = np.add.reduceat(normals, first, axis=0) if len(first) else normals
    # Opposite normals have no mean; the normal of the first face stands in.
    folded = np.linalg.norm(sums, axis=1) <= 1e-9 * counts
    sums[folded] = normals[first[folded]]
    vertices = np.stack([low[first], high[first]], axis=1)
    swapped = ~forward[first]
    vertices[swapped] = vertices[swapped, ::-1]  # the direction of the face whose corner is stored
    return Edges(vertices, owner[first], corner[first], angles, unit_rows(sums))


def sharp_edges(mesh: Mesh, angle_deg: float) -> tuple[NDArray[np.float64], NDArray[np.int64], Edges]:
    """List the edges whose dihedral angle exceeds a limit, in degrees, after the welded positions and faces."""
    positions, faces = welded(mesh)
    edges = edges_of(mesh, faces)
    return positions, faces, edges.rows(edges.angles > np.radians(angle_deg))


def along_edges(
    lengths: NDArray[np.float64], n: int, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Draw places uniform by length: rows of the edges (n,), and fractions of their lengths from 0 to 1 (n,)."""
    numbers = random.random((n, 2))
    reached = np.cumsum(lengths)
    rows = np.searchsorted(reached, numbers[:, 0] * reached[-1], side="right")
    return np.minimum(rows, len(lengths) - 1), numbers[:, 1]


def sample_edges(
    mesh: MeshLike, n: int, *, angle_deg: float = 30.0, seed: int = 0, progress: Progress = None
) -> SurfaceSamples:
    """Draw points on the sharp edges of a mesh, uniform by length.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Vertices at equal positions count as one.
    n : int
        Number of points.
    angle_deg : float, default 30
        An edge is sharp if the angle between the normals of its two faces exceeds this, degrees from 0 to less than
        180. Edges with one face, or with three and more, are sharp too.
    seed : int, default 0
        From 0 to 2^64 - 1. The same seed gives the same points; a longer sample starts with the points of a shorter
        one.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    SurfaceSamples
        Points, normals, faces and barycentric coordinates. The normal is the unit mean of the normals of all faces at
        the edge. The face is one of them, and one of its three weights is 0.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used, or if no edge is sharp.
    ArgumentError
        If `n` or `seed` is negative, too large or not a whole number, or `angle_deg` is not from 0 to less than
        180.

    Examples
    --------
    >>> import fieldbake
    >>> cube = fieldbake.box(2).to_mesh(16)
    >>> samples = fieldbake.sample_edges(cube, 100)
    >>> samples.points.shape, (abs(samples.points) > 0.999).sum(axis=1).min().item()
    ((100, 3), 2)
    """
    count = checks.integer("n", n, least=0, most=MOST_SAMPLES)
    start = checks.integer("seed", seed, least=0, most=2**64 - 1)
    limit = checks.number("angle_deg", angle_deg, least=0)
    if limit >= 180:
        raise ArgumentError(f"angle_deg: must be from 0 to less than 180 degrees, got {angle_deg}")
    checked = as_mesh(mesh)
    with progress_callback(progress, "sample edges") as callback:
        positions, _, edges = sharp_edges(checked, limit)
        if not len(edges.faces):
            raise MeshError(
                f"mesh: no edge has a dihedral angle above {limit:g} degrees; lower angle_deg, or use sample_surface"
            )
        ends = positions[edges.vertices]
        # The places have a generator of their own, since the samples of the surface use the seed too.
        random = np.random.default_rng([start, 2])
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        points, normals, weights = (np.zeros((count, 3)) for _ in range(3))
        faces = np.zeros(count, edges.faces.dtype)
        # Ctrl-C ends the work between two batches.
        for first in range(0, count, BATCH):
            part = slice(first, min(first + BATCH, count))
            rows, along = along_edges(lengths, part.stop - first, random)
            points[part] = ends[rows, 0] + along[:, None] * (ends[rows, 1] - ends[rows, 0])
            normals[part], faces[part] = edges.normals[rows], edges.faces[rows]
            each = np.arange(first, part.stop)
            weights[each, edges.corners[rows]] = 1 - along
            weights[each, (edges.corners[rows] + 1) % 3] = along
            if callback is not None:
                callback(part.stop / count)
    return SurfaceSamples(points, normals, source_faces(mesh, checked, faces), weights)
