"""Samples of a field in blocks around a level set. The Lipschitz bound of the field excludes all other blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.grid import Grid

#: Cells along the side of a block. Smaller blocks evaluate fewer samples far from the surface, but share more samples
#: on their faces.
SIDE = 8

#: Number of blocks evaluated at once: 12 million samples.
BATCH = 16_384

Evaluate = Callable[[NDArray[np.float64]], NDArray[Any]]


def level_set(evaluate: Evaluate, lipschitz: float, grid: Grid, level: float) -> _core.Surface:
    """Find the cells of a grid that the level set of a field crosses.

    Parameters
    ----------
    evaluate : callable
        Maps points, (n, 3) float64, to values, (n,). The values change by at most `lipschitz` per unit of length.
    lipschitz : float
        Upper bound on the length of the gradient.
    grid : Grid
        Box and voxels of the samples.
    level : float
        Value of the field on the surface.

    Notes
    -----
    A block whose value at the centre differs from the level by more than `lipschitz` times its half diagonal has no
    surface. Blocks start as large as the grid and are divided into eight until they have `SIDE` cells a side.
    """
    lower, shape = np.array(grid.lower), np.array(grid.shape)
    spacing = (np.array(grid.upper) - lower) / shape
    # Cells run from -1 to n - 1, so there are n + 1 along each axis.
    side = SIDE
    while side < (shape + 1).max():
        side *= 2
    origins = np.full((1, 3), -1, dtype=np.int64)
    while True:
        centers = lower + (origins + side / 2 + 0.5) * spacing
        reach = lipschitz * side / 2 * float(np.linalg.norm(spacing))
        values = np.asarray(evaluate(centers), dtype=np.float64)
        # Values are float32. A relative margin of 1e-5 covers their rounding.
        origins = origins[np.abs(values - level) <= reach * (1 + 1e-5)]
        if side == SIDE:
            break
        side //= 2
        steps = np.stack(np.meshgrid(*[[0, side]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        origins = (origins[:, None] + steps).reshape(-1, 3)
        origins = origins[(origins < shape).all(axis=1)]

    around = np.stack(np.meshgrid(*[np.arange(SIDE + 1)] * 3, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    kept_origins, kept_values = [np.empty((0, 3), np.int64)], [np.empty((0, len(around)), np.float32)]
    for first in range(0, len(origins), BATCH):
        batch = origins[first : first + BATCH]
        index = np.clip(batch[:, None] + around, 0, shape - 1)
        samples = np.asarray(evaluate((lower + (index + 0.5) * spacing).reshape(-1, 3)), dtype=np.float32)
        samples = samples.reshape(len(batch), -1)
        # A block that lies inside completely has a surface only where the box cuts it.
        inside = samples < level
        at_box = (batch < 0).any(axis=1) | (batch + SIDE >= shape).any(axis=1)
        crossed = inside.any(axis=1) & (at_box | ~inside.all(axis=1))
        kept_origins.append(batch[crossed])
        kept_values.append(samples[crossed])
    blocks = np.concatenate(kept_values).reshape(-1, SIDE + 1, SIDE + 1, SIDE + 1)
    starts = np.concatenate(kept_origins).astype(np.int32)
    return _core.Surface.of_blocks(starts, blocks, grid.lower, grid.upper, grid.shape, level)
