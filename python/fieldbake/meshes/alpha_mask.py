"""Masked surfaces for baking: triangles without the areas that the mask of a texture cuts out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

#: Triangles are divided until their edges are this long, in voxels. A field cannot represent finer detail.
EDGE_VOXELS = 0.75

#: Largest number of divisions of a triangle: 4^6 pieces.
MAX_CUTS = 6

#: A sheet extends beyond its outline by half its thickness, the diagonal of a voxel. The jagged edge of the pieces adds
#: a fifth of their size. The mask is eroded by the sum.
EROSION_VOXELS = 0.5 * 3**0.5 + 0.2 * EDGE_VOXELS

Corners = NDArray[np.float64]


def kept_triangles(mesh: Mesh, resolution: int, masks: Sequence[NDArray[np.bool_] | None]) -> Mesh:
    """Make a mesh without the areas that its alpha masks cut out. Without such areas the mesh is returned unchanged.

    `masks` has the kept texels of each part, (h, w) bool, or None. Triangles of masked parts are divided into pieces of
    about a voxel. A piece is kept if the mask keeps all texels around it, within the distance by which the sheet
    extends beyond its outline.
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
        # Everything is cut away: one tiny triangle remains, so that the mesh is valid.
        center = mesh.bounds.mean(axis=0)
        kept = (center + 1e-3 * voxel * np.eye(3))[None]
    return Mesh(kept.reshape(-1, 3), np.arange(3 * len(kept)).reshape(-1, 3))


def _standing(triangle: Corners, coordinates: Corners, mask: NDArray[np.bool_], voxel: float) -> Corners:
    """Divide one triangle, and return the pieces that the mask keeps, (n, 3 corners, 3)."""
    both = np.concatenate([triangle, coordinates], axis=1)[None]
    longest = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max()
    cuts = int(np.clip(np.ceil(np.log2(max(longest / (EDGE_VOXELS * voxel), 1))), 0, MAX_CUTS))
    for _ in range(cuts):
        both = _cut(both)
    # World length of one texture width along this triangle.
    uv_area = abs(np.linalg.det(np.stack([coordinates[1] - coordinates[0], coordinates[2] - coordinates[0]])))
    area = np.linalg.norm(np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0]))
    erosion = EROSION_VOXELS * voxel * np.sqrt(uv_area / area) if area > 0 else 0.0
    centers = both[:, :, 3:].mean(axis=1)
    # All samples around a piece must be kept, so the erosion removes pieces near the outline.
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    around = erosion * np.concatenate([[[0.0, 0.0]], np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    stays = _sample(mask, centers[:, None] + around[None]).all(axis=1)
    return np.asarray(both[stays][:, :, :3])


def _cut(both: Corners) -> Corners:
    """Divide every triangle into four, positions and texture coordinates alike."""
    a, b, c = both[:, 0], both[:, 1], both[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])


def _sample(mask: NDArray[np.bool_], uv: Corners) -> NDArray[np.bool_]:
    """Sample the nearest texel. Coordinates repeat, and v points upwards."""
    height, width = mask.shape
    wrapped = uv - np.floor(uv)
    x = np.minimum((wrapped[..., 0] * width).astype(np.int64), width - 1)
    y = np.minimum(((1 - wrapped[..., 1]) * height).astype(np.int64), height - 1)
    kept: NDArray[np.bool_] = mask[y, x]
    return kept
