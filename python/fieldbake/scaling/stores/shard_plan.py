"""The plan of a bake in shards: which shards are stored. The blocks of the grid are classified by balls around them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...base.grid import Grid
from ...meshes.mesh import Mesh
from .layout import Layout

#: Largest number of equal blocks of shards that cover the grid at the start. Only blocks near the surface are divided.
FIRST_BLOCKS = 4096

#: Relative rounding of radii and distances.
ROUNDING = 1e-6


class Blocks:
    """Boxes of samples of a grid, and the balls around them."""

    def __init__(self, mesh: Mesh, grid: Grid, sign: str) -> None:
        self.mesh, self.sign = mesh, sign
        self.lower = np.array(grid.lower)
        self.spacing = np.array(grid.spacing)
        self.shape = np.array(grid.shape, dtype=np.int64)

    def balls(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Centres (n, 3) and radii (n,) of the balls that hold the samples ``low`` to ``high - 1``, world units."""
        centers = self.lower + (low + high) / 2 * self.spacing
        radii = np.linalg.norm((high - low - 1) / 2 * self.spacing, axis=1)
        return centers, radii * (1 + ROUNDING) + ROUNDING * self.spacing.max()

    def sides(
        self, low: NDArray[np.int64], high: NDArray[np.int64], beyond: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
        """Distances of the centres from the surface, radii, and sides of the balls enlarged by `beyond`, (n,) each."""
        centers, radii = self.balls(low, high)
        distances, sides = _core.sides_of_balls(self.mesh._core, centers, radii + beyond, sign=self.sign)
        return distances, radii, sides

    def nearest_samples(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.float64]:
        """Evaluate the distance at one sample per box, (n,): the sample next to the closest point of the box centre."""
        centers, _ = self.balls(low, high)
        found = _core.closest_point(self.mesh._core, centers, device="cpu")[0]
        index = np.clip(np.rint((found - self.lower) / self.spacing - 0.5), low, high - 1)
        samples = self.lower + (index + 0.5) * self.spacing
        distances: NDArray[np.float64] = _core.closest_point(self.mesh._core, samples, device="cpu")[1]
        return distances


def stored_shards(mesh: Mesh, layout: Layout, level: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Decide which shards of a level are stored, and which of those have samples in the band, both (sx, sy, sz) bool.

    Shards without a sample in the band are stored unless they are wholly outside. Where the sign rule decides each
    sample by itself, a stored shard may turn out to be wholly outside.
    """
    counts = np.array(layout.counts(level), dtype=np.int64)
    blocks = Blocks(mesh, layout.level(level), layout.sign)
    stored = np.zeros(counts, dtype=bool)
    near = np.zeros(counts, dtype=bool)

    side = 1
    while np.prod(-(-counts // side)) > FIRST_BLOCKS:
        side *= 2
    first = np.stack(np.meshgrid(*[np.arange(-(-n // side)) for n in counts], indexing="ij"), axis=-1).reshape(-1, 3)
    low = first * side
    while True:
        high = np.minimum(low + side, counts)
        samples = low * layout.shard, np.minimum(high * layout.shard, blocks.shape)
        _, _, sides = blocks.sides(*samples, beyond=layout.band_width)
        for a, b in zip(low[sides < 0], high[sides < 0], strict=True):
            stored[a[0] : b[0], a[1] : b[1], a[2] : b[2]] = True
        low = low[sides == 0]
        if side == 1:
            break
        side //= 2
        low = (low[:, None] + _corners() * side).reshape(-1, 3)
        low = low[(low < counts).all(axis=1)]

    # The remaining shards are near the surface, or their side is not known.
    samples = low * layout.shard, np.minimum((low + 1) * layout.shard, blocks.shape)
    in_band = samples_in_band(blocks, *samples, layout.band_width)
    near[tuple(low[in_band].T)] = True
    rest = low[~in_band]
    if len(rest):
        stored[tuple(rest.T)] = _may_be_inside(blocks, rest, layout, level)
    return stored | near, near


def samples_in_band(blocks: Blocks, low: NDArray[np.int64], high: NDArray[np.int64], width: float) -> NDArray[np.bool_]:
    """Decide which boxes have a sample nearer to the surface than `width`, (n,). Undecided boxes are divided."""
    found = np.zeros(len(low), dtype=bool)
    owner = np.arange(len(low))
    while len(low):
        distances, radii, _ = blocks.sides(low, high)
        may = distances <= radii + width
        low, high, owner = low[may], high[may], owner[may]
        if not len(low):
            break
        found[owner[blocks.nearest_samples(low, high) < width]] = True
        # A single sample has been decided.
        go_on = ~found[owner] & ((high - low) > 1).any(axis=1)
        low, high, owner = low[go_on], high[go_on], owner[go_on]
        middle = (low + high + 1) // 2
        corners = _corners()[None].astype(bool)
        lows = np.where(corners, middle[:, None], low[:, None]).reshape(-1, 3)
        highs = np.where(corners, high[:, None], middle[:, None]).reshape(-1, 3)
        owner = np.repeat(owner, 8)
        whole = (highs > lows).all(axis=1)
        low, high, owner = lows[whole], highs[whole], owner[whole]
    return found


def _may_be_inside(blocks: Blocks, shards: NDArray[np.int64], layout: Layout, level: int) -> NDArray[np.bool_]:
    """Whether shards without a sample in the band may have samples inside.

    On a closed surface all their samples are on one side: of two neighbours on different sides, one would be at
    most half a voxel from the surface, and so in the band if that is at least half a voxel wide.
    """
    is_counted = layout.sign in ("auto", "winding") and bool(blocks.mesh.topology()["closed"])
    if not is_counted or layout.band / 2**level <= 0.5:
        return np.ones(len(shards), dtype=bool)
    centers = blocks.lower + (shards * layout.shard + 0.5) * blocks.spacing
    return np.asarray(_core.contains(blocks.mesh._core, centers, sign=layout.sign))


def _corners() -> NDArray[np.int64]:
    return np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=np.int64)


def morton_order(shards: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort rows (n, 3) in Morton order, along a Z-shaped curve."""
    codes = np.zeros(len(shards), dtype=np.int64)
    for bit in range(20):
        for axis in range(3):
            codes |= (shards[:, axis] >> bit & 1) << (3 * bit + axis)
    return shards[np.argsort(codes, kind="stable")]


def far_distances(mesh: Mesh, layout: Layout) -> NDArray[np.float32]:
    """Signed distances at the corners of the shards of level 0, (cz, cy, cx)."""
    counts = np.array(layout.counts(0)) + 1
    spacing = np.array(layout.spacing) * layout.shard
    index = np.stack(np.meshgrid(*[np.arange(n) for n in counts[::-1]], indexing="ij"), axis=-1)[..., ::-1]
    points = np.ascontiguousarray((np.array(layout.lower) + index * spacing).reshape(-1, 3))
    return _core.signed_distance(mesh._core, points, sign=layout.sign, device="cpu").reshape(tuple(counts[::-1]))
