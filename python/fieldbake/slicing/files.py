"""Layers as files: images in a .zip archive, and outlines as .svg."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..files.png import write_grey
from ..files.svg import svg_path, svg_text

Array = NDArray[np.float64]

ENDINGS = (".zip", ".svg")


def write_images(stream: IO[bytes], facts: dict[str, Any], images: Iterable[NDArray[np.uint8]]) -> None:
    """Write `facts` as ``manifest.json`` and images as ``layer_00000.png``, ..."""
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        _add(archive, "manifest.json", json.dumps(facts, indent=1).encode("ascii"))
        for index, image in enumerate(images):
            _add(archive, f"layer_{index:05}.png", write_grey(image))


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    # A fixed date, so that equal slices make equal files.
    archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content)


def write_outlines(
    stream: IO[bytes], lower: Array, upper: Array, layers: Iterable[tuple[float, Sequence[Array]]]
) -> None:
    """Write pairs of a height and the loops of a layer as one group each, in the box from `lower` to `upper` (2,)."""
    groups = [
        f'<g id="layer_{index:05}" data-z="{z:.10g}">{svg_path(loops)}</g>' for index, (z, loops) in enumerate(layers)
    ]
    stream.write(svg_text(lower, upper, groups).encode("ascii"))
