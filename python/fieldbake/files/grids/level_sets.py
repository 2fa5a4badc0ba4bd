"""Level sets in sparse trees: ``.vdb`` of OpenVDB and ``.nvdb`` of NanoVDB. Their readers make dense grids."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import ArgumentError, FormatError
from .. import sidecar
from ..container import atomic_write, read_facts
from ..formats import WRITER, FieldFile, Format
from . import nanovdb, nanovdb_reader, openvdb, openvdb_reader
from .band_blocks import BandBlocks
from .grid_samples import GridSamples
from .openvdb_reader import VdbGrid

#: Half width of the band of a level set, voxels.
LEVEL_SET_BAND = 3.0
#: Smallest voxel of a level set of float16, units of the file: the step of the smallest numbers is 1/1024 of it.
SMALLEST_HALF_VOXEL = 2.0**-14
LARGEST_HALF = float(np.finfo(np.float16).max)
#: Name of the grid in the files.
GRID_NAME = "surface"


def _level_set(file: FieldFile) -> tuple[BandBlocks, dict[str, Any]]:
    """Make the blocks of the narrow band of a field, and the metadata of its file."""
    kept = file.field.kept_distance
    voxel = float(file.field.spacing.max())
    band = (LEVEL_SET_BAND if file.options.band is None else file.options.band) * voxel
    if kept is not None and kept < band:
        if file.options.band is not None:
            raise ArgumentError(
                f"band: the volume keeps distances up to {kept / voxel:.3g} voxels, got {file.options.band:g}"
            )
        band = kept
    blocks = file.field.blocks(band)
    return blocks, {**file.facts(file.options.encoding or "float32", 1.0), "band": blocks.band}


def _save_vdb(file: FieldFile) -> None:
    blocks, facts = _level_set(file)
    is_zipped, is_half = file.options.compression != "none", file.options.encoding == "float16"
    if is_half:
        _check_halves(blocks)
    with atomic_write(file.target) as stream:
        strings = {"creator": WRITER, "fieldbake": json.dumps(facts)}
        openvdb.write(stream, blocks, strings, name=GRID_NAME, zipped=is_zipped, half=is_half)


def _check_halves(blocks: BandBlocks) -> None:
    """Raise an error if float16 has no number for the band, or its steps are too wide for the smallest voxel."""
    least, most = float(blocks.spacing.min()), float(blocks.spacing.max())
    if blocks.band > LARGEST_HALF or least < SMALLEST_HALF_VOXEL:
        largest = most * LARGEST_HALF / blocks.band
        raise ArgumentError(
            f"encoding: float16 stores voxels from {SMALLEST_HALF_VOXEL:.2g} to {largest:.3g} in units of the file, "
            f"for a band of {blocks.band / most:.3g} voxels, got {least if least < SMALLEST_HALF_VOXEL else most:.3g}; "
            'use encoding="float32"'
        )


def _save_nvdb(file: FieldFile) -> None:
    blocks, facts = _level_set(file)
    with sidecar.write(file.target, facts) as stream:
        nanovdb.write(stream, blocks, name=GRID_NAME)


def _load_vdb(path: Path) -> GridSamples:
    grid = openvdb_reader.read(path.read_bytes())
    text = grid.metadata.get("fieldbake")
    return _on_grid(grid, None if text is None else sidecar.parse(text))


def _load_nvdb(path: Path) -> GridSamples:
    data, facts = sidecar.read(path)
    return _on_grid(nanovdb_reader.read(data), facts)


def _on_grid(grid: VdbGrid, facts: dict[str, Any] | None) -> GridSamples:
    """Make the dense grid of a tree: the grid of the metadata if it fits, else the active voxels and one around."""
    band = grid.background if grid.kind == "level set" else 0.0
    window = None if facts is None else _window_of(grid, facts)
    if window is None:
        facts = None
        low, high = grid.active_box()
        window = low - 1, high + 1
    return GridSamples(grid.dense(*window), grid.origin + window[0] * grid.spacing, grid.spacing, facts, band)


def _window_of(grid: VdbGrid, facts: dict[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Find the first and last voxel of the grid in the metadata; None if another program moved or scaled the tree."""
    box = read_facts(facts)[0]
    sizes = facts.get("resolution")
    if not isinstance(sizes, list) or len(sizes) != 3 or not all(type(n) is int and 0 < n < 2**31 for n in sizes):
        raise FormatError(f"the metadata must state three numbers of voxels, got {str(sizes)[:60]}")
    spacing = (box[1] - box[0]) / sizes
    first = (box[0] + spacing / 2 - grid.origin) / spacing
    is_near = np.abs(first - np.rint(first)).max() <= 1e-3 and np.abs(first).max() <= openvdb_reader.FARTHEST
    if not (is_near and np.allclose(spacing, grid.spacing, rtol=1e-6)):
        return None
    low = np.rint(first).astype(np.int64)
    return low, low + np.array(sizes) - 1


_KINDS = ("volume", "quantized", "sparse")

FORMATS = (
    Format(".vdb", _KINDS, _save_vdb, _load_vdb, (openvdb.MAGIC,), ("float32", "float16"), ("band", "compression")),
    Format(".nvdb", _KINDS, _save_nvdb, _load_nvdb, (b"NanoVDB",), options=("band",), has_sidecar=True),
)
