"""The narrow band of a sparse volume in blocks of 8^3 voxels, made from its bricks without the dense grid.

A brick has the samples of 7^3 cells and their corners; its first sample is the voxel ``7 * brick - 1``. Bricks with
cells of one voxel store the samples themselves. In coarser ones the field is evaluated at the voxel centres.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..files.grids.band_blocks import SIDE, BandBlocks

#: Cells along the side of a brick.
CELLS = 7
#: Words of the index: bits 31-30 are the level, 3 for an empty brick. Bit 0 of an empty brick is 1 inside the surface.
LEVEL_SHIFT, EMPTY = 30, 3
EMPTY_INSIDE = EMPTY << LEVEL_SHIFT | 1
#: Bricks or blocks that are handled at once.
BATCH = 4096

_LOCAL = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1)


def blocks_of_bricks(
    field: _core.SparseField,
    sample: Callable[[Any], NDArray[np.float32]],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    band: float,
) -> BandBlocks:
    """Make the blocks of a sparse field. `sample` evaluates the field at world positions (..., 3)."""
    arrays = field.arrays()
    index, bricks = arrays["index"], arrays["bricks"]
    shape, width = np.array(field.shape), np.float32(band)
    counts = -(-shape // SIDE)
    inside_brick = index == EMPTY_INSIDE
    # A block without samples has the sign of the brick with its first voxel.
    first = [
        np.minimum((np.arange(n) * SIDE + 1) // CELLS, along - 1) for n, along in zip(counts, index.shape, strict=True)
    ]
    inside = inside_brick[np.ix_(*first)]
    stored = np.argwhere(index >> LEVEL_SHIFT < EMPTY)
    # Blocks that hold samples, and those inside that reach beyond the grid, where all voxels are outside.
    touched = np.zeros(inside.shape, np.bool_)
    for axis, side in enumerate(shape):
        if side % SIDE:
            last = [slice(None)] * 3
            last[axis] = slice(-1, None)
            touched[tuple(last)] |= inside[tuple(last)]
    low = np.maximum(stored * CELLS - 1, 0) // SIDE
    high = np.minimum(stored * CELLS + CELLS - 1, shape - 1) // SIDE
    for corner in np.ndindex(2, 2, 2):
        touched[tuple(np.where(corner, high, low).T)] = True
    places = np.argwhere(touched)
    leaf = np.full(touched.shape, -1, np.int32)
    leaf[tuple(places.T)] = np.arange(len(places))
    values = np.empty((len(places), SIDE, SIDE, SIDE), np.float32)
    for at in range(0, len(places), BATCH):
        voxels = places[at : at + BATCH, None, None, None] * SIDE + _LOCAL
        brick = np.minimum((voxels + 1) // CELLS, np.array(index.shape) - 1)
        is_inside = inside_brick[tuple(np.moveaxis(brick, -1, 0))] & (voxels < shape).all(axis=-1)
        values[at : at + BATCH] = np.where(is_inside, -width, width)
    # Finer bricks last: where two share a face, their samples are the exact ones.
    level = index[tuple(stored.T)] >> LEVEL_SHIFT
    order = np.argsort(level, kind="stable")[::-1]
    stored, level = stored[order], level[order]
    for at in range(0, len(stored), BATCH):
        batch, levels = stored[at : at + BATCH], level[at : at + BATCH]
        voxels = batch[:, None, None, None] * CELLS - 1 + _LOCAL
        samples = np.empty(voxels.shape[:4], np.float32)
        fine = levels == 0
        rows = index[tuple(batch[fine].T)] & ((1 << LEVEL_SHIFT) - 1)
        samples[fine] = decoded(bricks[rows], field)
        samples[~fine] = sample(origin + voxels[~fine] * spacing)
        held = ((voxels >= 0) & (voxels < shape)).all(axis=-1)
        at_voxel = voxels[held]
        block = leaf[tuple((at_voxel // SIDE).T)]
        place = (block, *(at_voxel % SIDE).T)
        values[place] = np.clip(samples[held], -width, width)
    lowest, highest = values.min(axis=(1, 2, 3)), values.max(axis=(1, 2, 3))
    kept = (lowest < width) & (highest > -width)
    inside[tuple(places.T)] = (highest < 0) & ~kept
    nx, ny, nz = field.shape
    return BandBlocks((nx, ny, nz), origin, spacing, float(width), places[kept] * SIDE, values[kept], inside)


def decoded(bricks: NDArray[Any], field: _core.SparseField) -> NDArray[np.float32]:
    """Distances of the samples of bricks, (n, 8, 8, 8)."""
    if field.encoding == "float32" or not len(bricks):
        return np.asarray(bricks, np.float32)
    flat = np.asfortranarray(bricks.reshape(len(bricks), 1, -1))
    return _core.decode(flat, field.scale).reshape(bricks.shape)
