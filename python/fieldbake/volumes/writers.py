"""Volumes in the space of a file, and the options of ``save``. The records of the formats write the files.

The facts in a file are JSON: the grid, the encoding, the report, and ``decode``, the formula for the distance of a
texel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError
from ..files import container, flipbook, registry
from ..files.formats import FieldFile
from ..files.grids.band_blocks import BandBlocks
from .conventions import Convention, convention
from .grid_field import GridField

#: Endings of textures, whose files can have mipmaps, and of files with a band: the narrow band of a level set, or the
#: band of a normalised encoding.
MIPMAPPED, BANDED = registry.endings_with("mipmaps"), registry.endings_with("band")

#: Options of ``save`` that only some formats have.
OPTIONS = ("band", "compression", "mipmaps", "columns")

#: Makes the level set of a volume in the space of a file; the number is the half width of its band, units of the file.
Blocks = Callable[["Placed", float], BandBlocks]


class Placed:
    """A volume in the space of a file.

    Attributes
    ----------
    way : Convention
        Axes and units of the file.
    scale : float
        Length in the file of a world unit.
    bounds : (2, 3) float64
        Lower and upper corner of the box in the space of the file.
    resolution : tuple of int
        Voxels along the axes of the file.
    spacing, origin : (3,) float64
        Size of a voxel, and centre of the first voxel.
    """

    def __init__(self, field: GridField, blocks: Blocks, way: Convention) -> None:
        self._field, self._blocks, self.way = field, blocks, way
        self.scale = way.scale(field.bounds)
        self.bounds = way.box(field.bounds, way.transform(field.bounds))
        nx, ny, nz = (field.resolution[axis] for axis in way.order)
        self.resolution = (nx, ny, nz)
        self.spacing = (self.bounds[1] - self.bounds[0]) / np.array(self.resolution)
        self.origin = self.bounds[0] + self.spacing / 2

    @property
    def distances(self) -> NDArray[np.float32]:
        """Samples along the axes of the file, x fastest, in units of the file."""
        samples: NDArray[np.float32] = self.way.array(self._field.distances)
        return samples * np.float32(self.scale) if self.way.normalize else samples

    @property
    def facts(self) -> dict[str, Any]:
        """Metadata of the field that a file stores besides the samples."""
        field, scale, report = self._field, self.scale, self._field.report
        inner = self.way.box(field.inner_bounds, self.way.transform(field.bounds))
        lengths = {name: getattr(report, name) * scale for name in ("band", "thickness", "chord_error")}
        scaled = replace(report, **lengths)
        return {
            **field._facts(),
            "resolution": list(self.resolution),
            "bounds": self.bounds.tolist(),
            "inner_bounds": inner.tolist(),
            "report": scaled.to_dict(),
            **self.way.facts(field.bounds),
        }

    @property
    def kept_distance(self) -> float | None:
        """Largest magnitude of a stored distance, units of the file; None without a limit."""
        kept = self._field._kept_distance()
        return None if kept is None else kept * self.scale

    def blocks(self, band: float) -> BandBlocks:
        """The level set with the half width `band`, units of the file."""
        return self._blocks(self, band)


@dataclass(frozen=True)
class SaveOptions:
    """Options of ``save``. None selects the default of the format."""

    encoding: str | None = None
    band: float | None = None
    compression: str | None = None
    mipmaps: bool = False
    columns: int | None = None
    engine: str | None = None
    handedness: str | None = None
    up: str | None = None
    normalize: bool | None = None

    def convention(self) -> Convention:
        """Axes and units of the file."""
        return convention(self.engine, self.handedness, self.up, self.normalize)

    def check(self, ending: str) -> None:
        """Raise ArgumentError for an option that a format does not have."""
        form = registry.format_of(ending)
        known = ("float32",) if form is None else form.encodings
        if self.encoding is not None and self.encoding not in known:
            words = container.listed(f'"{name}"' for name in known)
            raise ArgumentError(
                f"encoding: {ending or 'such'} files hold {words}, got {checks.describe(self.encoding)}"
            )
        if self.band is not None:
            checks.number("band", self.band, above=0)
        if self.compression is not None:
            checks.choice("compression", self.compression, ("zip", "none"))
        checks.flag("mipmaps", self.mipmaps)
        if self.columns is not None:
            checks.integer("columns", self.columns, least=1, most=flipbook.MAX_SIDE)
        for name in OPTIONS:
            endings = registry.endings_with(name)
            if getattr(self, name) not in (None, False) and ending not in endings:
                raise ArgumentError(f"{name}: {ending} files have no {name}; {container.listed(endings)} have")


def write(target: Path, field: GridField, blocks: Blocks, options: SaveOptions) -> None:
    """Write a volume as the file that the ending of `target` names; `blocks` makes its level set."""
    ending = target.suffix.lower()
    options.check(ending)
    form = registry.format_of(ending, "volume")
    assert form is not None
    assert form.write is not None
    form.write(FieldFile(target, Placed(field, blocks, options.convention()), options))
