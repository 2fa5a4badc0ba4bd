"""``.vf`` files, version 1: the grids that Unity's Visual Effect Graph imports as 3D textures.

======  ========  ====================================
offset  type      contents
======  ========  ====================================
0       4 bytes   ``VF_F``: one float for each sample
4       3 uint16  samples along x, y and z
10      float32   the samples, x fastest
======  ========  ====================================

A file has no box. fieldbake stores it in the JSON beside the file.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from ...base.errors import ArgumentError, FormatError
from ...base.notices import warn
from .. import sidecar
from ..cursor import Cursor
from ..formats import FieldFile, Format
from .grid_samples import GridSamples, as_samples, checked_count

MAGIC = b"VF_F"
MAX_SIDE = 2**16 - 1


def write(stream: IO[bytes], samples: NDArray[np.float32]) -> None:
    """Write samples (nx, ny, nz)."""
    if max(samples.shape) > MAX_SIDE:
        raise ArgumentError(f"path: .vf files have at most {MAX_SIDE} voxels along a side, got {samples.shape}")
    stream.write(MAGIC + struct.pack("<3H", *samples.shape))
    stream.write(np.ascontiguousarray(samples.T, "<f4").data)


def read(data: bytes) -> NDArray[np.float32]:
    """Read the samples of a file, (nx, ny, nz)."""
    cursor = Cursor(data)
    magic = bytes(cursor.take(4))
    if magic == b"VF_V":
        raise FormatError("holds vectors; a distance field has one float for each sample")
    if magic != MAGIC:
        raise FormatError("is not a .vf file of version 1")
    sizes = list(cursor.unpack("<3H"))
    if 4 * checked_count(sizes) != len(data) - cursor.at:
        raise FormatError(
            f"{sizes} samples need {4 * checked_count(sizes)} bytes, the file has {len(data) - cursor.at}"
        )
    return as_samples(cursor.array(checked_count(sizes), "<f4"), sizes)


def _save(file: FieldFile) -> None:
    with sidecar.write(file.target, file.facts("float32", 1.0)) as stream:
        write(stream, file.field.distances)


def _load(path: Path) -> GridSamples:
    data, facts = sidecar.read(path)
    samples = read(data)
    if facts is None:
        warn(
            f"{path.name}: .vf files state no place and no size, and {sidecar.beside(path).name} is missing or has "
            "none; the longest side of the box is 1, about the origin. Copy the JSON of a file that fieldbake saved, "
            "or pass the box: fieldbake.Volume(volume.distances, bounds)",
            UserWarning,
        )
    # Unity's own fields have a longest side of 1, about the origin.
    spacing = np.full(3, 1 / max(samples.shape))
    return GridSamples(samples, (1 - np.array(samples.shape)) * spacing / 2, spacing, facts)


FORMATS = (Format(".vf", ("volume", "quantized"), _save, _load, (MAGIC[:3],), has_sidecar=True),)
