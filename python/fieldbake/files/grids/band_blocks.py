"""A level set in blocks of 8^3 voxels: the form that the writers of OpenVDB and NanoVDB share.

A block is stored if one of its voxels is nearer to the surface than the band, or if its signs differ. For every other
block only the sign is kept. All magnitudes are at most the band. OpenVDB defines level sets so: wherever no voxel is
active, the value is ``+band`` outside and ``-band`` inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Voxels along the side of a block, which is a leaf of OpenVDB.
SIDE = 8


@dataclass(frozen=True)
class BandBlocks:
    """Blocks of a narrow-band level set.

    Attributes
    ----------
    shape : tuple of int
        Voxels of the grid along x, y and z.
    origin, spacing : (3,) float64
        Centre of voxel (0, 0, 0) and size of a voxel, world units.
    band : float
        Half width of the band, world units; a float32 number.
    corners : (n, 3) int64
        Index of the first voxel of each stored block, multiples of 8, in the order of x, y, z.
    values : (n, 8, 8, 8) float32
        Distances ``[x, y, z]`` of the stored blocks. Voxels outside the grid have the value ``band``.
    inside : (bx, by, bz) bool
        Whether a block lies inside the surface; read for blocks that are not stored.
    """

    shape: tuple[int, int, int]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    band: float
    corners: NDArray[np.int64]
    values: NDArray[np.float32]
    inside: NDArray[np.bool_]

    @property
    def active(self) -> NDArray[np.bool_]:
        """Voxels nearer to the surface than the band, (n, 8, 8, 8)."""
        return np.asarray(np.abs(self.values) < np.float32(self.band))


def blocks_of_grid(
    distances: NDArray[np.float32], origin: NDArray[np.float64], spacing: NDArray[np.float64], band: float
) -> BandBlocks:
    """Divide a dense grid (nx, ny, nz) into blocks. The grid is read in slabs of eight slices."""
    nx, ny, nz = distances.shape
    bx, by, bz = (-(-side // SIDE) for side in distances.shape)
    width = np.float32(band)
    inside = np.zeros((bx, by, bz), np.bool_)
    corners, kept = [np.empty((0, 3), np.int64)], [np.empty((0, SIDE, SIDE, SIDE), np.float32)]
    for k in range(bz):
        slab = np.full((bx * SIDE, by * SIDE, SIDE), width, np.float32)
        part = distances[:, :, k * SIDE : (k + 1) * SIDE]
        slab[:nx, :ny, : part.shape[2]] = np.clip(part, -width, width)
        blocks = slab.reshape(bx, SIDE, by, SIDE, SIDE).transpose(0, 2, 1, 3, 4)
        lowest, highest = blocks.min(axis=(2, 3, 4)), blocks.max(axis=(2, 3, 4))
        stored = (lowest < width) & (highest > -width)
        inside[:, :, k] = (highest < 0) & ~stored
        places = np.argwhere(stored)
        corners.append(np.column_stack([places, np.full(len(places), k)]) * SIDE)
        kept.append(blocks[stored])
    all_corners, values = np.concatenate(corners), np.concatenate(kept)
    order = np.lexsort(all_corners.T[::-1])
    return BandBlocks((nx, ny, nz), origin, spacing, float(width), all_corners[order], values[order], inside)
