"""Masked surfaces for baking: the parts of triangles that a texture leaves standing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

#: Triangles are cut until their edges are this long, in voxels: finer detail is lost in the field anyway.
EDGE_VOXELS = 0.75

#: Cuts of a triangle at most: 4^6 pieces.
MAX_CUTS = 6

#: A sheet grows by half its thickness, the diagonal of a voxel, past its outline, and the jags of the pieces stick out
#: by a fifth of their size. The mask is eroded by as much.
EROSION_VOXELS = 0.5 * 3**0.5 + 0.2 * EDGE_VOXELS

Corners = NDArray[np.float64]


def kept_triangles(mesh: Mesh, resolution: int, masks: Sequence[NDArray[np.bool_] | None]) -> Mesh:
    """A mesh without the texels that its alpha masks cut out; the mesh itself where nothing is cut.

    `masks` has the kept texels of each part, (h, w), or None. Triangles of masked parts are cut into pieces of a
    voxel's size. A piece is kept if the mask keeps all texels around it, as far as the sheet grows past its outline.
    """
    if all(mask is None for mask in masks) or mesh.uv is None:
        return mesh
    voxel = float((mesh.bounds[1] - mesh.bounds[0]).max()) * 1.1 / resolution
    vertices, uv = mesh.vertices, mesh.uv.astype(np.float64)
    pieces = []
    for part, mask in zip(mesh.parts, masks, strict=True):
        faces = mesh.faces[part.faces.start : part.faces.stop]
        corners = vertices[faces]
        if mask is None:
            pieces.append(corners)
            continue
        for triangle, coordinates in zip(corners, uv[faces], strict=True):
            pieces.append(_standing(triangle, coordinates, mask, voxel))
    kept = np.concatenate(pieces)
    if len(kept) == 0:
        # Everything is cut away: one speck, so that there is something to bake.
        center = mesh.bounds.mean(axis=0)
        kept = (center + 1e-3 * voxel * np.eye(3))[None]
    return Mesh(kept.reshape(-1, 3), np.arange(3 * len(kept)).reshape(-1, 3))


def _standing(triangle: Corners, coordinates: Corners, mask: NDArray[np.bool_], voxel: float) -> Corners:
    """The pieces of one triangle that stay, (n, 3 corners, 3)."""
    both = np.concatenate([triangle, coordinates], axis=1)[None]
    longest = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max()
    cuts = int(np.clip(np.ceil(np.log2(max(longest / (EDGE_VOXELS * voxel), 1))), 0, MAX_CUTS))
    for _ in range(cuts):
        both = _cut(both)
    # World length of a texture width, along this triangle.
    uv_area = abs(np.linalg.det(np.stack([coordinates[1] - coordinates[0], coordinates[2] - coordinates[0]])))
    area = np.linalg.norm(np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0]))
    erosion = EROSION_VOXELS * voxel * np.sqrt(uv_area / area) if area > 0 else 0.0
    centers = both[:, :, 3:].mean(axis=1)
    # Pieces near the outline fall to the erosion: all around must stand.
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    around = erosion * np.concatenate([[[0.0, 0.0]], np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    stays = _sample(mask, centers[:, None] + around[None]).all(axis=1)
    return np.asarray(both[stays][:, :, :3])


def _cut(both: Corners) -> Corners:
    """Every triangle in four, positions and coordinates alike."""
    a, b, c = both[:, 0], both[:, 1], both[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])


def _sample(mask: NDArray[np.bool_], uv: Corners) -> NDArray[np.bool_]:
    """Nearest texel, coordinates repeated, v upwards."""
    height, width = mask.shape
    wrapped = uv - np.floor(uv)
    x = np.minimum((wrapped[..., 0] * width).astype(np.int64), width - 1)
    y = np.minimum(((1 - wrapped[..., 1]) * height).astype(np.int64), height - 1)
    kept: NDArray[np.bool_] = mask[y, x]
    return kept
