"""Writers of volumes for other programs, by file ending.

=========  ==========================================================  ==========================================
ending     contents                                                    facts
=========  ==========================================================  ==========================================
``.dds``   3D texture with mipmaps on request                          sidecar
``.ktx2``  the same; its axes are ``ruo``, or ``rui`` if left-handed    value of the key ``fieldbake``
``.exr``   the slices as tiles of one image                            sidecar; settings for Unity and Godot
``.vf``    grid of Unity's Visual Effect Graph                         sidecar
``.vdb``   OpenVDB level set                                           string ``fieldbake`` of the grid
``.nvdb``  NanoVDB level set                                           sidecar
``.vti``   VTK ImageData                                               text ``fieldbake`` of the field data
``.nrrd``  grid with its position                                      value of the key ``fieldbake``
=========  ==========================================================  ==========================================

The facts are JSON: the grid, the encoding, the report, and ``decode``, the formula for the distance of a texel.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.errors import ArgumentError
from ..files import container, flipbook, nanovdb, nrrd, openvdb, sidecar, texture_files, vector_field, vti
from ..files.band_blocks import BandBlocks
from ..files.container import atomic_write, head
from ..files.exr import write_channel
from ..files.grid_samples import GridSamples
from .conventions import Convention, convention
from .grid_field import GridField

#: Endings of the files that :func:`write` can write for a dense and for a sparse volume.
ENDINGS = container.ENDINGS["volume"][1:]
SPARSE_ENDINGS = container.ENDINGS["sparse"][1:]

#: Encodings that each ending has; the first is the default.
ENCODINGS: dict[str, tuple[str, ...]] = {
    ".dds": tuple(encodings.TEXTURE_DTYPES),
    ".ktx2": tuple(encodings.TEXTURE_DTYPES),
    ".exr": ("float32", "float16"),
    ".vf": ("float32",),
    ".vdb": ("float32", "float16"),
    ".nvdb": ("float32",),
    ".vti": ("float32",),
    ".nrrd": ("float32",),
}
#: Endings whose files can have mipmaps.
MIPMAPPED = (".dds", ".ktx2")
#: Endings whose files have a band, the narrow band of a level set or that of a normalised encoding.
BANDED = (".vdb", ".nvdb", *MIPMAPPED)
#: Endings of the files that have an option.
_ENDINGS_WITH = {
    "band": BANDED,
    "compression": (".vdb", ".vti", ".nrrd"),
    "mipmaps": MIPMAPPED,
    "columns": (".exr",),
}
#: Half width of the band of a level set, voxels.
LEVEL_SET_BAND = 3.0
#: Name of the grid in OpenVDB files.
GRID_NAME = "surface"
WRITER = f"fieldbake {_core.__version__}"

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
        known = ENCODINGS.get(ending, ("float32",))
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
        for name, endings in _ENDINGS_WITH.items():
            if getattr(self, name) not in (None, False) and ending not in endings:
                raise ArgumentError(f"{name}: {ending} files have no {name}; {container.listed(endings)} have")


class _File(NamedTuple):
    """A file to write: a volume in the space of the file, and the options."""

    target: Path
    field: Placed
    options: SaveOptions


def write(target: Path, field: GridField, blocks: Blocks, options: SaveOptions) -> None:
    """Write a volume as the file that the ending of `target` names; `blocks` makes its level set."""
    ending = target.suffix.lower()
    options.check(ending)
    _WRITERS[ending](_File(target, Placed(field, blocks, options.convention()), options))


def _texture(file: _File) -> None:
    encoding = file.options.encoding or "float32"
    band = encodings.DEFAULT_BAND if file.options.band is None else file.options.band
    scale = encodings.scale_of(encoding, file.field.spacing, band)
    facts = _texel_facts(file.target, encoding, scale, file.field.facts)
    levels = [file.field.distances]
    if file.options.mipmaps:
        corners = checks.triple(file.field.bounds[0]), checks.triple(file.field.bounds[1])
        for shape in texture_files.level_shapes(file.field.resolution)[1:]:
            levels.append(_core.resample(levels[-1], *corners, shape, scale=1.0))
    texture = texture_files.Texture(encoding, [_texels(level, encoding, scale) for level in levels], json.dumps(facts))
    if file.target.suffix.lower() == ".dds":
        with sidecar.write(file.target, facts) as stream:
            texture_files.write_dds(stream, texture)
    else:
        with atomic_write(file.target) as stream:
            texture_files.write_ktx2(stream, texture, "rui" if file.field.way.handedness == "left" else "ruo", WRITER)


def _texel_facts(target: Path, encoding: str, scale: float, facts: dict[str, Any]) -> dict[str, Any]:
    rule = encodings.texel_rule(target.suffix.lower(), encoding)
    return {**head("volume texture", encoding), **facts, "encoding": encoding, "scale": scale, **rule}


def _texels(distances: NDArray[np.float32], encoding: str, scale: float) -> NDArray[Any]:
    if encoding == "unorm8":
        return encodings.to_unorm8(distances, scale)
    return distances if encoding == "float32" else _core.encode(distances, encoding, scale)


def _sheet(file: _File) -> None:
    encoding = file.options.encoding or "float32"
    scale = encodings.scale_of(encoding, file.field.spacing, 1.0)
    columns = 1 if file.options.columns is None and file.field.way.engine == "godot" else file.options.columns
    sheet = flipbook.arrange(file.field.resolution, columns, upwards=file.field.way.engine == "unity")
    pixels = flipbook.to_pixels(_texels(file.field.distances, encoding, scale), sheet)
    content = write_channel(pixels)
    facts = {**_texel_facts(file.target, encoding, scale, file.field.facts), "sheet": sheet.facts()}
    with sidecar.write(file.target, facts) as stream:
        stream.write(content)
    if file.field.way.engine == "unity":
        flipbook.write_unity(file.target, sheet, encoding)
    elif file.field.way.engine == "godot":
        flipbook.write_godot(file.target, sheet)


def _vector_field(file: _File) -> None:
    with sidecar.write(file.target, _texel_facts(file.target, "float32", 1.0, file.field.facts)) as stream:
        vector_field.write(stream, file.field.distances)


def _level_set(file: _File) -> None:
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
    facts = {
        **_texel_facts(file.target, file.options.encoding or "float32", 1.0, file.field.facts),
        "band": blocks.band,
    }
    if file.target.suffix.lower() == ".vdb":
        with atomic_write(file.target) as stream:
            strings = {"creator": WRITER, "fieldbake": json.dumps(facts)}
            is_zipped, is_half = file.options.compression != "none", file.options.encoding == "float16"
            openvdb.write(stream, blocks, strings, name=GRID_NAME, zipped=is_zipped, half=is_half)
    else:
        with sidecar.write(file.target, facts) as stream:
            nanovdb.write(stream, blocks, name=GRID_NAME)


def _grid(file: _File) -> None:
    facts = _texel_facts(file.target, "float32", 1.0, file.field.facts)
    grid = GridSamples(file.field.distances, file.field.origin, file.field.spacing, facts)
    save = vti.write if file.target.suffix.lower() == ".vti" else nrrd.write
    is_packed = file.options.compression != "none"
    with atomic_write(file.target) as stream:
        save(stream, grid, compressed=is_packed)


_WRITERS: dict[str, Callable[[_File], None]] = {
    ".dds": _texture,
    ".ktx2": _texture,
    ".exr": _sheet,
    ".vf": _vector_field,
    ".vdb": _level_set,
    ".nvdb": _level_set,
    ".vti": _grid,
    ".nrrd": _grid,
}
