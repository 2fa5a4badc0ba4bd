"""Samples of a field of distances in blocks around a level set. The values at the centres exclude all other blocks.

``src/csg/level_set.rs`` divides a grid in the same way for shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.grid import Grid
from ..base.progress import part

#: Cells along the side of a block. Smaller blocks evaluate fewer samples far from the surface, but share more samples
#: on their faces.
SIDE = 8

#: Number of blocks evaluated at once: 3 million samples, whose positions take 70 MB.
BATCH = 4_096

Evaluate = Callable[[NDArray[np.float64]], NDArray[Any]]

#: Offsets of the samples of a block from its first one, x fastest, ((SIDE + 1)^3, 3).
AROUND = np.stack(np.meshgrid(*[np.arange(SIDE + 1)] * 3, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)


@dataclass(frozen=True)
class Blocks:
    """Blocks of `SIDE`^3 cells of a grid, each with the samples at the corners of its cells.

    Attributes
    ----------
    grid : Grid
        Box and voxels of the samples.
    origins : (k, 3) int64
        The first sample of each block. A sample outside the grid repeats the nearest one of the grid.
    """

    grid: Grid
    origins: NDArray[np.int64]

    @property
    def points(self) -> NDArray[np.float64]:
        """World positions of all samples, (k * n, 3), n = (SIDE + 1)^3."""
        index = np.clip(self.origins[:, None] + AROUND, 0, np.array(self.grid.shape) - 1)
        points: NDArray[np.float64] = self.grid.lower + (index + 0.5) * self.grid.spacing
        return points.reshape(-1, 3)


def level_set(
    evaluate: Evaluate,
    grid: Grid,
    level: float,
    *,
    samples: Callable[[Blocks], NDArray[Any]],
) -> _core.Surface:
    """Find the cells of a grid that the level set of a field crosses.

    Parameters
    ----------
    evaluate : callable
        Maps points, (n, 3) float64, to values, (n,). Their absolute values change by at most 1 per unit of length.
    grid : Grid
        Box and voxels of the samples.
    level : float
        Value of the field on the surface.
    samples : callable
        Maps blocks to the values of all their samples, (k, n).

    Notes
    -----
    A block whose value at the centre differs from the level by more than its half diagonal has no surface, unless it
    lies at the box inside the solid. Blocks start as large as the grid and are divided into eight until they have
    `SIDE` cells a side. This does not find the blocks where the sign of the field jumps, as across the opening of a
    mesh. Every block that the surface enters from an evaluated one is therefore evaluated too.
    """
    lower, shape, spacing = (np.array(values) for values in (grid.lower, grid.shape, grid.spacing))
    # Cells run from -1 to n - 1, so there are n + 1 along each axis.
    side = SIDE
    while side < (shape + 1).max():
        side *= 2
    origins = np.full((1, 3), -1, dtype=np.int64)
    while True:
        centers = lower + (origins + side / 2 + 0.5) * spacing
        reach = side / 2 * float(np.linalg.norm(spacing))
        with part(0.0, 0.1):
            values = np.asarray(evaluate(centers), dtype=np.float64) - level
        # The box cuts the solid in blocks that are inside everywhere.
        cut = (values < 0) & ((origins < 0) | (origins + side >= shape)).any(axis=1)
        # Values are float32. A relative margin of 1e-5 covers their rounding.
        origins = origins[cut | (np.abs(values) <= reach * (1 + 1e-5))]
        if side == SIDE:
            break
        side //= 2
        steps = np.stack(np.meshgrid(*[[0, side]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        origins = (origins[:, None] + steps).reshape(-1, 3)
        origins = origins[(origins < shape).all(axis=1)]

    blocks = _Crossed(samples, grid, level)
    with part(0.1, 0.9):
        blocks.add(origins)
    with part(0.9, 1.0):
        while len(origins):
            origins = blocks.entered()
            blocks.add(origins)
        return blocks.cells.surface()


class _Crossed:
    """Blocks of samples that the surface crosses."""

    def __init__(self, evaluate: Callable[[Blocks], NDArray[Any]], grid: Grid, level: float) -> None:
        self.evaluate, self.grid, self.level = evaluate, grid, level
        self.shape = np.array(grid.shape)
        self.cells = _core.SurfaceBlocks(grid.lower, grid.upper, grid.shape, level)
        #: Blocks along each axis, and the numbers of those that were evaluated.
        self.counts = (self.shape + SIDE) // SIDE
        self.known = np.empty(0, np.int64)
        #: Blocks that the surface enters from blocks added since the last search.
        self.next = [np.empty((0, 3), np.int64)]

    def numbers(self, origins: NDArray[np.int64]) -> NDArray[np.int64]:
        """Number of each block among all blocks of the grid."""
        x, y, z = ((origins + 1) // SIDE).T
        return np.asarray(x + self.counts[0] * (y + self.counts[1] * z))

    def add(self, origins: NDArray[np.int64]) -> None:
        """Evaluate blocks, and keep those that the surface crosses."""
        self.known = np.union1d(self.known, self.numbers(origins))
        for first in range(0, len(origins), BATCH):
            batch = origins[first : first + BATCH]
            with part(first / len(origins), (first + len(batch)) / len(origins)):
                samples = np.asarray(self.evaluate(Blocks(self.grid, batch)), dtype=np.float32)
            inside = self.inside(batch, samples)
            crossed = inside.any(axis=1) & ~inside.all(axis=1)
            kept = samples[crossed].reshape(-1, SIDE + 1, SIDE + 1, SIDE + 1)
            self.cells.add(batch[crossed].astype(np.int32), kept)
            self.next += self.neighbours(batch[crossed], inside[crossed].reshape(kept.shape))

    def inside(self, origins: NDArray[np.int64], samples: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Find the samples (k, n) of blocks that lie inside. Places beyond the box are outside: there the box cuts."""
        inside: NDArray[np.bool_] = samples < self.level
        at_box = np.flatnonzero((origins < 0).any(axis=1) | (origins + SIDE >= self.shape).any(axis=1))
        places = origins[at_box, None] + AROUND
        inside[at_box] &= ((places >= 0) & (places < self.shape)).all(axis=2)
        return inside

    def neighbours(self, origins: NDArray[np.int64], inside: NDArray[np.bool_]) -> Iterator[NDArray[np.int64]]:
        """Yield the blocks that the surface enters through the faces of blocks; `inside` has all their samples."""
        for axis in range(3):
            for end, step in ((0, -SIDE), (SIDE, SIDE)):
                face = np.take(inside, end, axis=3 - axis).reshape(len(inside), (SIDE + 1) ** 2)
                entered = origins[face.any(axis=1) & ~face.all(axis=1)]
                entered[:, axis] += step
                yield entered

    def entered(self) -> NDArray[np.int64]:
        """Find the blocks, not yet evaluated, that the surface enters from those added since the last call."""
        origins = np.unique(np.concatenate(self.next), axis=0)
        self.next = [np.empty((0, 3), np.int64)]
        origins = origins[((origins >= -1) & (origins < self.shape)).all(axis=1)]
        return origins[~np.isin(self.numbers(origins), self.known)]
