"""Flipbook sheets: the slices of a field as tiles of one ``.exr`` image, which engines cut into a 3D texture.

Slice z is the tile in column ``z % columns`` of row ``z // columns``, counted from the top left corner. Within a tile
x runs to the right, and y downwards (the order of the samples in memory) or upwards (for Unity, which flips images
vertically). Beside the sheet lie the metadata as JSON and, for Unity and Godot, the import settings. They switch
off sRGB, compression and mipmaps, which would change the distances.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ArgumentError, FormatError
from .container import atomic_write

#: Longest side of an image that Unity, Unreal and Godot import.
MAX_SIDE = 16_384
#: TextureImporterFormat of Unity.
_UNITY_FORMATS = {"float32": 18, "float16": 15}


@dataclass(frozen=True)
class Sheet:
    """Arrangement of the tiles of a sheet: `shape` is (nx, ny, nz), and ``rows * columns >= nz``."""

    shape: tuple[int, int, int]
    columns: int
    rows: int
    upwards: bool

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image, pixels."""
        return self.columns * self.shape[0], self.rows * self.shape[1]

    def facts(self) -> dict[str, Any]:
        """Describe the arrangement for the JSON, with the names that the engines use."""
        nx, ny, _ = self.shape
        return {
            "columns": self.columns,
            "rows": self.rows,
            "tile": [nx, ny],
            "slices": self.shape[2],
            "y": "up" if self.upwards else "down",
            "unity": {"flipbookColumns": self.columns, "flipbookRows": self.rows},
            "unreal": {"Source2DTileSizeX": nx, "Source2DTileSizeY": ny},
            "godot": {"slices/horizontal": self.columns, "slices/vertical": self.rows},
        }


def arrange(shape: tuple[int, int, int], columns: int | None, *, upwards: bool) -> Sheet:
    """Choose the most nearly square sheet, or the sheet with the given number of columns.

    A sheet without empty tiles is preferred, because engines count all tiles as slices. A prime number of slices has
    only sheets of one row or one column without empty tiles, which may exceed `MAX_SIDE`.
    """
    nx, ny, nz = shape
    if columns is None:
        fitting = [n for n in range(1, nz + 1) if max(n * nx, -(-nz // n) * ny) <= MAX_SIDE]
        full = [n for n in fitting if nz % n == 0]
        columns = min(full or fitting or [nz], key=lambda n: abs(math.log(n * nx / (-(-nz // n) * ny))))
    sheet = Sheet(shape, columns, -(-nz // columns), upwards)
    if max(sheet.size) > MAX_SIDE:
        width, height = sheet.size
        raise ArgumentError(
            f"path: the sheet would have {width} x {height} pixels, engines import at most {MAX_SIDE}; "
            "downsample the volume, or save .dds or .ktx2"
        )
    return sheet


def read_sheet(facts: Any, shape: list[int]) -> Sheet:
    """Read the arrangement from the metadata of a file, and check that it fits a field of this shape."""
    if not isinstance(facts, dict) or len(shape) != 3 or not all(type(n) is int and 0 < n <= MAX_SIDE for n in shape):
        raise FormatError("the metadata does not describe a sheet")
    columns, rows = facts.get("columns"), facts.get("rows")
    if type(columns) is not int or type(rows) is not int or columns < 1 or rows != -(-shape[2] // columns):
        raise FormatError(f"a sheet of {columns} columns and {rows} rows does not fit {shape[2]} slices")
    sheet = Sheet((shape[0], shape[1], shape[2]), columns, rows, facts.get("y") == "up")
    if max(sheet.size) > MAX_SIDE:
        raise FormatError(f"a sheet of {sheet.size[0]} x {sheet.size[1]} pixels exceeds {MAX_SIDE} pixels a side")
    return sheet


def to_pixels(samples: NDArray[Any], sheet: Sheet) -> NDArray[Any]:
    """Arrange samples (nx, ny, nz) as an image (height, width). Empty tiles repeat the last slice."""
    nx, ny, nz = sheet.shape
    tiles = np.empty((sheet.rows * sheet.columns, ny, nx), samples.dtype)
    tiles[:nz] = samples.T[:, ::-1] if sheet.upwards else samples.T
    tiles[nz:] = tiles[nz - 1]
    by_row = tiles.reshape(sheet.rows, sheet.columns, ny, nx).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(by_row.reshape(sheet.rows * ny, sheet.columns * nx))


def from_pixels(pixels: NDArray[Any], sheet: Sheet) -> NDArray[Any]:
    """Extract the samples (nx, ny, nz), x fastest, from an image (height, width)."""
    nx, ny, nz = sheet.shape
    tiles = pixels.reshape(sheet.rows, ny, sheet.columns, nx).transpose(0, 2, 1, 3).reshape(-1, ny, nx)[:nz]
    return np.asfortranarray((tiles[:, ::-1] if sheet.upwards else tiles).T)


def write_unity(path: Path, sheet: Sheet, encoding: str) -> None:
    """Write the import settings of Unity. The GUID of existing settings is kept, because scenes refer to it."""
    beside = path.with_name(path.name + ".meta")
    found = (
        re.search(r"^guid: ([0-9a-f]{32})$", beside.read_text("utf-8", "replace"), re.M) if beside.exists() else None
    )
    guid = found[1] if found else hashlib.md5(path.name.encode(), usedforsecurity=False).hexdigest()
    text = _UNITY.format(
        guid=guid,
        columns=sheet.columns,
        rows=sheet.rows,
        format=_UNITY_FORMATS[encoding],
        size=1 << (max(sheet.size) - 1).bit_length(),
    )
    with atomic_write(beside) as stream:
        stream.write(text.encode())


def write_godot(path: Path, sheet: Sheet) -> None:
    """Write the import settings of Godot 4."""
    text = _GODOT.format(name=path.name, columns=sheet.columns, rows=sheet.rows)
    with atomic_write(path.with_name(path.name + ".import")) as stream:
        stream.write(text.encode())


_UNITY = """\
fileFormatVersion: 2
guid: {guid}
TextureImporter:
  serializedVersion: 12
  mipmaps:
    mipMapMode: 0
    enableMipMap: 0
    sRGBTexture: 0
    linearTexture: 1
  isReadable: 1
  maxTextureSize: {size}
  textureSettings:
    serializedVersion: 2
    filterMode: 1
    aniso: 1
    mipBias: 0
    wrapU: 1
    wrapV: 1
    wrapW: 1
  nPOTScale: 0
  alphaUsage: 0
  alphaIsTransparency: 0
  textureType: 0
  textureShape: 8
  flipbookRows: {rows}
  flipbookColumns: {columns}
  platformSettings:
  - serializedVersion: 3
    buildTarget: DefaultTexturePlatform
    maxTextureSize: {size}
    resizeAlgorithm: 0
    textureFormat: {format}
    textureCompression: 0
    crunchedCompression: 0
    overridden: 0
"""

_GODOT = """\
[remap]

importer="3d_texture"
type="CompressedTexture3D"

[deps]

source_file="res://{name}"

[params]

compress/mode=3
compress/channel_pack=1
mipmaps/generate=false
mipmaps/limit=-1
slices/horizontal={columns}
slices/vertical={rows}
"""
