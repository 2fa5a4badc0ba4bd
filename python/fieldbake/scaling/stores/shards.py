"""The work of one task: bake a shard and store it. A process keeps the mesh and its tree from task to task."""

from __future__ import annotations

import os
import platform
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ... import _core
from ...base import encodings
from ...base.threads import set_threads
from ...meshes.mesh import Mesh
from .layout import Layout, path_of
from .shard_plan import Blocks, samples_in_band
from .store import Place, read_mesh

#: Samples along the side of a window; a shard is baked window by window. Smaller windows skip more far samples.
WINDOW = 64

_lock = threading.Lock()
#: The mesh of this process, by its hash.
_meshes: dict[str, Mesh] = {}
#: The process that has set its number of threads, and the number.
_threads: tuple[int, int] | None = None


@dataclass(frozen=True)
class Threads:
    """Number of threads of a worker process; None changes nothing.

    It is not applied in the process of the client, which `limited_threads` limits during the bake.
    """

    count: int | None
    client: tuple[str, int] = field(default_factory=lambda: (platform.node(), os.getpid()))

    def apply(self) -> None:
        """Set the number of threads of a worker process."""
        global _threads
        if self.count is None or self.client == (platform.node(), os.getpid()) or _threads == (os.getpid(), self.count):
            return
        set_threads(self.count)
        _threads = (os.getpid(), self.count)


def keep_mesh(key: str, mesh: Mesh) -> None:
    """Keep one mesh in this process. It replaces the mesh kept before."""
    with _lock:
        _meshes.clear()
        _meshes[key] = mesh


def mesh_of(place: Place, layout: Layout) -> Mesh:
    """Return the mesh of a store: the mesh that this process keeps, or else the one in the store."""
    with _lock:
        if layout.mesh not in _meshes:
            _meshes.clear()
            _meshes[layout.mesh] = read_mesh(place.open("r"))
        return _meshes[layout.mesh]


def store_shard(place: Place, layout: Layout, level: int, index: tuple[int, int, int], threads: Threads) -> bool:
    """Bake one shard and store it in one write. Return whether it is stored.

    A shard with only fill values is stored if samples in the band are rounded to them, as float16 does.
    """
    threads.apply()
    mesh = mesh_of(place, layout)
    samples = bake_shard(mesh, layout, level, index)
    array = place.open("r+")[path_of(level)]
    low, size = layout.box(level, index)
    if (samples == layout.fill).all():
        box = np.array([low], dtype=np.int64), np.array([low], dtype=np.int64) + size
        blocks = Blocks(mesh, layout.level(level), layout.sign)
        if not samples_in_band(blocks, *box, layout.band_width).any():
            return False
        array = array.with_config({"write_empty_chunks": True})
    (x, y, z), (nx, ny, nz) = low, size
    array[z : z + nz, y : y + ny, x : x + nx] = samples
    return True


def bake_shard(mesh: Mesh, layout: Layout, level: int, index: tuple[int, int, int]) -> Any:
    """Compute the stored values of a shard, (nz, ny, nx)."""
    low, size = layout.box(level, index)
    return bake_box(mesh, layout, level, low, size)


def bake_box(mesh: Mesh, layout: Layout, level: int, low: Any, size: Any) -> Any:
    """Compute the stored values of a box of `size` samples from index `low` on, (nz, ny, nx)."""
    grid = layout.level(level)
    scale, width, band = layout.scale, layout.band_width, layout.band_of(level)
    fill = layout.fill
    out = np.full(tuple(reversed(size)), fill, dtype=encodings.DTYPES[layout.encoding])
    steps = [range(0, n, WINDOW) for n in size]
    lows = np.array(low) + np.array([(x, y, z) for z in steps[2] for y in steps[1] for x in steps[0]], dtype=np.int64)
    highs = np.minimum(lows + WINDOW, np.array(low) + np.array(size))
    _, _, sides = Blocks(mesh, grid, layout.sign).sides(lows, highs, beyond=width)
    for a, b, side in zip(lows.tolist(), highs.tolist(), sides.tolist(), strict=True):
        if side > 0:
            continue
        part = tuple(slice(p - o, q - o) for p, q, o in zip(reversed(a), reversed(b), reversed(low), strict=True))
        if side < 0:
            out[part] = -fill
            continue
        counts = tuple(q - p for p, q in zip(a, b, strict=True))
        window = _core.bake_window(
            mesh._core, grid.lower, grid.upper, grid.shape, tuple(a), counts, sign=layout.sign, band=band
        )
        if layout.encoding not in encodings.STEPS:
            np.clip(window, -np.float32(width), np.float32(width), out=window)
        out[part] = _core.encode(window, layout.encoding, scale).T
    return out
