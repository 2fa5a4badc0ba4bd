"""The sparse grid of Newton's cooked distance fields, layout version 2.

The grid of voxels is divided into cells of 8^3 voxels. The corners of the cells have the coarse samples. A cell near
the surface has 9^3 fine samples besides, in a cubic array of blocks, unless the coarse samples interpolate to them.

    coarse_sdf[z, y, x]            (d + 1, h + 1, w + 1) float32, at the corners of the w x h x d cells
    subgrid_start_slots[x, y, z]   uint32: x | y << 10 | z << 20 of the block; 0xFFFFFFFF without fine samples,
                                   0xFFFFFFFE where the coarse samples are enough
    subgrid_required[i]            int32, 1 where a cell has a block; i = (z h + y) w + x
    subgrid_data[z, y, x]          blocks of 9^3 samples: float32 distances, or codes of (d - lowest) / range

Source: Newton 1.8, its modules `sdf_texture` and `_sdf_cache` in `newton._src.geometry`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.progress import part

#: Voxels along the side of a cell, and fine samples of a block.
CELL = 8
SAMPLES = CELL + 1

#: Slots of cells without fine samples, and of cells whose coarse samples are enough.
EMPTY, LINEAR = 0xFFFFFFFF, 0xFFFFFFFE

#: A cell needs no fine samples if its coarse samples differ from them by less than this share of the diagonal.
LINEAR_ERROR = 1e-6

#: The stored type and the code of each format.
FORMATS: dict[str, tuple[Any, int]] = {"uint8": (np.uint8, 1), "uint16": (np.uint16, 2), "float32": (np.float32, 4)}

#: Cells that are evaluated at once.
BATCH = 256

Field = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def sparse_grid(
    field: Field, bounds: NDArray[np.float64], resolution: int, band: float, texture_format: str
) -> dict[str, Any]:
    """Evaluate a field in the layout of Newton.

    Parameters
    ----------
    field : callable
        Maps positions (k, 3) to signed distances (k,).
    bounds : (2, 3) float64
        Lower and upper corner of the grid before it is filled up to whole cells.
    resolution : int
        Voxels along the longest side.
    band : float
        Cells that may come this near to the surface have fine samples.
    texture_format : "uint8", "uint16" or "float32"
        Type of the fine samples.
    """
    extent = bounds[1] - bounds[0]
    # Rounding must not add a voxel to the longest side.
    voxels = np.ceil(extent / extent.max() * resolution - 1e-9).astype(np.int64)
    voxel = extent / voxels
    counts = -(-voxels // CELL)
    with part(0.0, 0.1):
        coarse = field(bounds[0] + np.stack(np.meshgrid(*map(np.arange, counts + 1), indexing="ij"), -1).reshape(-1, 3)
                       * CELL * voxel).reshape(counts + 1).astype(np.float32)  # fmt: skip
    # Cells with x fastest.
    cells = np.stack(np.unravel_index(np.arange(counts.prod()), counts, order="F"), -1)
    reach = band + 0.5 * CELL * float(np.linalg.norm(voxel))
    with part(0.1, 0.2):
        near = np.abs(field(bounds[0] + (cells + 0.5) * CELL * voxel)) < reach
    offsets = np.stack(np.meshgrid(*[np.arange(SAMPLES)] * 3, indexing="ij"), -1).reshape(-1, 3)
    weights = offsets / CELL
    refined = np.flatnonzero(near)
    kept, blocks = np.zeros(len(cells), dtype=bool), []
    error = LINEAR_ERROR * float(np.linalg.norm(extent))
    for start in range(0, len(refined), BATCH):
        rows = refined[start : start + BATCH]
        with part(0.2 + 0.8 * start / len(refined), 0.2 + 0.8 * min(1.0, (start + BATCH) / len(refined))):
            places = cells[rows, None] * CELL + offsets
            values = field((bounds[0] + places * voxel).reshape(-1, 3)).reshape(len(rows), -1)
        needed = np.abs(values - _interpolated(coarse, cells[rows], weights)).max(axis=1) >= error
        kept[rows[needed]] = True
        blocks.append(_codes(values[needed], reach, texture_format))
    return {
        "coarse_sdf": np.ascontiguousarray(coarse.transpose(2, 1, 0)),
        **_packed(cells, counts, near, kept, np.concatenate(blocks) if blocks else None, texture_format),
        "coarse_dims": tuple(counts.tolist()),
        "min_extents": bounds[0],
        "max_extents": bounds[0] + counts * CELL * voxel,
        "cell_size": voxel,
        "subgrid_size": CELL,
        "quantization_mode": FORMATS[texture_format][1],
        "subgrids_min_sdf_value": 0.0 if texture_format == "float32" or not kept.any() else -reach,
        "subgrids_sdf_value_range": 1.0 if texture_format == "float32" or not kept.any() else 2 * reach,
    }


def _codes(values: NDArray[np.float64], reach: float, texture_format: str) -> NDArray[Any]:
    """Distances in the stored type; whole numbers are codes from -reach to reach."""
    kind, _ = FORMATS[texture_format]
    if texture_format == "float32":
        return values.astype(kind)
    most = np.iinfo(kind).max
    return np.rint(np.clip((values + reach) / (2 * reach), 0.0, 1.0) * most).astype(kind)


def _interpolated(
    coarse: NDArray[np.float32], cells: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Trilinear values of the coarse samples at the fine ones, (cells, 9^3)."""
    total = np.zeros((len(cells), len(weights)))
    for corner in np.ndindex(2, 2, 2):
        share = np.prod(np.where(corner, weights, 1 - weights), axis=1)
        total += coarse[tuple((cells + corner).T)][:, None] * share
    return total


def _packed(
    cells: NDArray[np.int64],
    counts: NDArray[np.int64],
    near: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    blocks: NDArray[Any] | None,
    texture_format: str,
) -> dict[str, Any]:
    """The fine samples in one cubic array, and the place of each cell in it."""
    slots = np.full(counts, EMPTY, dtype=np.uint32)
    slots[tuple(cells[near & ~kept].T)] = LINEAR
    total = int(kept.sum())
    side = 0
    while side**3 < total:
        side += 1
    data = np.zeros((1, 1, 1), dtype=np.float32)
    if total and blocks is not None:
        address = np.stack(np.unravel_index(np.arange(total), (side,) * 3, order="F"), -1)
        slots[tuple(cells[kept].T)] = (address << (0, 10, 20)).sum(axis=1).astype(np.uint32)
        data = np.zeros((side * SAMPLES,) * 3, dtype=FORMATS[texture_format][0])
        # Axes of the array: block and sample of z, of y, of x. Blocks have their samples as x, y, z.
        divided = data.reshape((side, SAMPLES) * 3)
        x, y, z = address.T
        divided[z, :, y, :, x, :] = blocks.reshape(-1, SAMPLES, SAMPLES, SAMPLES).transpose(0, 3, 2, 1)
    return {
        "subgrid_data": data,
        "subgrid_start_slots": slots,
        "subgrid_tex_size": len(data),
        "num_subgrids": total,
        "subgrid_required": kept.astype(np.int32),
    }
