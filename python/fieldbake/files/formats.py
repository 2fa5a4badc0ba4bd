"""The record of a file format. Each module with a layout of files has the records of its formats in `FORMATS`.

``files/registry.py`` lists the modules. Names of endings, kinds, encodings and options follow from the records.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.encodings import texel_rule

#: The program that wrote a file.
WRITER = f"fieldbake {_core.__version__}"

#: The newest version of the metadata, and the first version that contains each later kind.
VERSION = 3
FIRST_VERSION = {"quantized": 2, "sparse": 2, "nested": 2}
#: Since this version float16 has a scale. Before it, stored values were distances.
SCALED_FLOAT16_VERSION = 3


@dataclass(frozen=True)
class Format:
    """A file format.

    Attributes
    ----------
    ending : str
        Ending of the files, such as ``".vti"``.
    kinds : tuple of str
        Kinds of objects that the files store: ``"volume"``, ``"quantized"``, ``"sparse"``, ``"nested"``, ``"atlas"``.
    write : callable, optional
        Writes a :class:`FieldFile`, or a :class:`PagesFile` for atlases. None for the container, which each class
        fills itself.
    read : callable, optional
        Reads the file at a path: a `GridSamples`, a :class:`Texels` or a :class:`Pages`. None for the container.
    sniff : tuple of bytes
        First bytes of the files, one of which identifies the format.
    encodings : tuple of str
        Encodings of the samples; the first is the default.
    options : tuple of str
        Options of `Volume.save` that the format has: ``"band"``, ``"compression"``, ``"mipmaps"``, ``"columns"``.
    has_sidecar : bool
        Whether a JSON file beside the file stores the metadata.
    """

    ending: str
    kinds: tuple[str, ...]
    write: Callable[[Any], None] | None
    read: Callable[[Path], Any] | None
    sniff: tuple[bytes, ...]
    encodings: tuple[str, ...] = ("float32",)
    options: tuple[str, ...] = ()
    has_sidecar: bool = False


@dataclass(frozen=True)
class FieldFile:
    """A file of a field to write.

    Attributes
    ----------
    target : Path
        The file.
    field : volumes.writers.Placed
        The field in the space of the file.
    options : volumes.writers.SaveOptions
        The options of ``save``.
    """

    target: Path
    field: Any
    options: Any

    def facts(self, encoding: str, scale: float) -> dict[str, Any]:
        """Metadata of the file: the field, the encoding, and the formula for the distance of a texel."""
        rule = texel_rule(self.target.suffix.lower(), encoding)
        own: dict[str, Any] = self.field.facts
        return {**head("volume texture", encoding), **own, "encoding": encoding, "scale": scale, **rule}


@dataclass(frozen=True)
class PagesFile:
    """An image of the pages of an atlas to write: pages (count, size, size), and the metadata of the atlas."""

    target: Path
    pages: NDArray[Any]
    facts: dict[str, Any]

    @property
    def stacked(self) -> NDArray[Any]:
        """The pages below each other, (count * size, size)."""
        return self.pages.reshape(-1, self.pages.shape[-1])

    def header(self) -> dict[str, Any]:
        """Metadata of the file."""
        encoding = self.facts["encoding"]
        return {**head("atlas image", encoding), **texel_rule(self.target.suffix.lower(), encoding), **self.facts}


@dataclass(frozen=True)
class Texels:
    """Texels (nx, ny, nz) that a file stores, their encoding, and the metadata of the file."""

    texels: NDArray[Any]
    encoding: str
    facts: dict[str, Any]


@dataclass(frozen=True)
class Pages:
    """Pages (count, size, size) that an image stores, the metadata of their atlas, and the word of their texels."""

    pages: NDArray[Any]
    facts: dict[str, Any]
    texels: Literal["pages", "png"] = "pages"


def head(kind: str, encoding: str = "float32") -> dict[str, Any]:
    """Make the first entries of a header."""
    version = SCALED_FLOAT16_VERSION if encoding == "float16" else FIRST_VERSION.get(kind, 1)
    return {"format": "fieldbake", "kind": kind, "version": version, "written_by": WRITER}


def shares(texels: NDArray[Any]) -> NDArray[np.float32]:
    """Convert normalised integers to the values that a sampler returns, -1 to 1."""
    values: NDArray[np.float32] = (texels / np.float64(np.iinfo(texels.dtype).max)).astype(np.float32)
    return values
