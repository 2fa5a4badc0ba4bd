"""Layout of a field in a Zarr store: grids of the levels, attributes, and the OME-Zarr description.

One group has::

    0                 level 0, (nz, ny, nx), one file per shard
    levels/1, ...     coarser levels: voxels twice as long, baked from the mesh, with the same scale
    far/distances     exact signed distances at the corners of the shards of level 0, float32
    far/states/0, ... for each shard of a level 0 if it is wholly fill, 1 if it is stored; lost chunks are read as 1
    mesh/...          vertices and faces, and their hash

Stored values are fractions of ``scale``, world units. Distances beyond the band are clamped to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ... import _core
from ...base import checks, encodings
from ...base.errors import Error, FormatError
from ...base.grid import Grid

#: Version of the layout.
VERSION = 1

#: Levels are added until the longest side has at most this many voxels.
COARSEST = 64

#: Largest number of samples along a side of the grid, and of a shard; smallest voxel whose square is a float64 above 0.
MOST_SAMPLES, MOST_SHARD, SMALLEST_VOXEL = 2**31, 4096, 1e-150

#: Windows are baked with a band that is wider by this fraction, so that clamped values have the largest code despite
#: rounding.
MARGIN = 1e-6


@dataclass(frozen=True)
class Layout(Grid):
    """All settings that determine the contents of a store, besides the mesh itself: the grid of level 0 and these."""

    #: Half width of the band, voxels of level 0.
    band: float
    #: Samples along the side of a shard and of a chunk.
    shard: int
    chunk: int
    encoding: str
    sign: str
    #: Hash of the mesh.
    mesh: str
    inner: tuple[tuple[float, float, float], tuple[float, float, float]]

    @property
    def voxel(self) -> float:
        """Longest side of a voxel of level 0, world units."""
        return max(self.spacing)

    @property
    def band_width(self) -> float:
        """Half width of the band, world units."""
        return self.band * self.voxel

    @property
    def scale(self) -> float:
        """Distance that a stored fraction of 1 represents, world units."""
        return float(encodings.scale_of(self.encoding, self.spacing, self.band))

    @property
    def fill(self) -> Any:
        """Stored value of all points outside the surface and beyond the band."""
        width = np.full((1, 1, 1), np.float32(self.band_width), order="F")
        return _core.encode(width, self.encoding, self.scale)[0, 0, 0]

    @property
    def level_count(self) -> int:
        """Number of levels."""
        count = 1
        while max(self.level(count - 1).shape) > COARSEST:
            count += 1
        return count

    def level(self, level: int) -> Grid:
        """Make the grid of a level. It has the same lower corner, and voxels ``2**level`` times as long."""
        if level == 0:
            return self
        step = 2**level
        x, y, z = (-(-n // step) for n in self.shape)
        upper = [l + n * step * s for l, n, s in zip(self.lower, (x, y, z), self.spacing, strict=True)]
        return Grid(self.lower, (upper[0], upper[1], upper[2]), (x, y, z))

    def counts(self, level: int) -> tuple[int, int, int]:
        """Number of shards of a level along x, y and z."""
        x, y, z = (-(-n // self.shard) for n in self.level(level).shape)
        return x, y, z

    def band_of(self, level: int) -> float:
        """The band in voxels of a level, with the margin for rounding."""
        return float(self.band / 2**level * (1 + MARGIN))

    def box(self, level: int, index: tuple[int, int, int]) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """Index of the first sample and number of samples of a shard, along x, y and z."""
        low = tuple(i * self.shard for i in index)
        size = tuple(min(self.shard, n - a) for n, a in zip(self.level(level).shape, low, strict=True))
        return low, size  # type: ignore[return-value]

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON can store."""
        return asdict(self)

    @classmethod
    def from_dict(cls, facts: Mapping[str, Any]) -> Layout:
        """Restore a layout from the attributes of a store. All values are checked; a damaged one is a FormatError."""
        try:
            lower, upper = checks.box("lower, upper", [facts["lower"], facts["upper"]])
            inner = checks.box("inner", facts["inner"], flat=True)
            nx, ny, nz = (checks.integer("shape", side, least=1, most=MOST_SAMPLES) for side in facts["shape"])
            shard = checks.integer("shard", facts["shard"], least=1, most=MOST_SHARD)
            chunk = checks.integer("chunk", facts["chunk"], least=1, most=shard)
            layout = cls(
                lower=checks.triple(lower),
                upper=checks.triple(upper),
                shape=(nx, ny, nz),
                band=checks.number("band", facts["band"], above=0),
                shard=shard,
                chunk=chunk,
                encoding=checks.choice("encoding", facts["encoding"], encodings.NAMES),
                sign=checks.text("sign", facts["sign"]),
                mesh=checks.text("mesh", facts["mesh"]),
                inner=(checks.triple(inner[0]), checks.triple(inner[1])),
            )
            if shard % chunk:
                raise FormatError(f"chunk: must divide shard ({shard}), got {chunk}")
            checks.number("band", layout.band_width, above=0)
            checks.number("spacing", min(layout.spacing), above=SMALLEST_VOXEL)
        except (Error, LookupError, TypeError, ValueError) as error:
            raise FormatError(f"the store's attributes are damaged: {error}") from error
        return layout


def path_of(level: int) -> str:
    """Path of a level in the group."""
    return "0" if level == 0 else f"levels/{level}"


def shard_key(level: int, index: tuple[int, int, int]) -> str:
    """Key of a shard in the store, relative to the group."""
    x, y, z = index
    return f"{path_of(level)}/c/{z}/{y}/{x}"


def ome_attributes(layout: Layout, name: str) -> dict[str, Any]:
    """The multiscales entry of OME-Zarr 0.5; translations are the centres of voxel 0, world units, in z, y, x order."""
    datasets = []
    for level in range(layout.level_count):
        grid = layout.level(level)
        scale = list(reversed(grid.spacing))
        translation = [l + s / 2 for l, s in zip(reversed(grid.lower), scale, strict=True)]
        transforms = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": translation}]
        datasets.append({"path": path_of(level), "coordinateTransformations": transforms})
    axes = [{"name": axis, "type": "space"} for axis in "zyx"]
    return {"version": "0.5", "multiscales": [{"name": name, "axes": axes, "datasets": datasets}]}


def attributes(layout: Layout, name: str, report: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of the group."""
    return {
        "ome": ome_attributes(layout, name),
        "scale": float(layout.scale),
        "bounds": [list(layout.lower), list(layout.upper)],
        "spacing": list(layout.spacing),
        "mesh_hash": layout.mesh,
        "fieldbake": {"layout": VERSION, "version": _core.__version__, **layout.to_dict(), "report": dict(report)},
    }
