"""All file formats of fields and atlases, by the records of their modules."""

from __future__ import annotations

from pathlib import Path

from ..base.errors import FormatError
from . import container, exr, png, texture_files
from .container import listed
from .formats import Format
from .grids import level_sets, nrrd, vector_field, vti

#: The formats in the order of messages and help texts.
FORMATS: tuple[Format, ...] = (
    *container.FORMATS,
    *level_sets.FORMATS,
    *vti.FORMATS,
    *nrrd.FORMATS,
    *texture_files.FORMATS,
    *vector_field.FORMATS,
    *exr.FORMATS,
    *png.FORMATS,
)

#: Name of each kind of object in messages.
_NAMES = {
    "volume": "a volume",
    "quantized": "a volume",
    "sparse": "a sparse volume",
    "nested": "a nested field",
    "atlas": "an atlas",
}

#: Endings of the files that can store each kind of object.
ENDINGS = {kind: tuple(one.ending for one in FORMATS if kind in one.kinds) for kind in _NAMES}

#: Endings of the files that have a sidecar.
WITH_SIDECAR = tuple(sorted({one.ending for one in FORMATS if one.has_sidecar}))


def format_of(ending: str, kind: str | None = None) -> Format | None:
    """Find the format with an ending that stores a kind of object, by default the first one with the ending."""
    return next((one for one in FORMATS if one.ending == ending and (kind is None or kind in one.kinds)), None)


def endings_with(option: str) -> tuple[str, ...]:
    """List the endings of the formats that have an option of `Volume.save`."""
    return tuple(one.ending for one in FORMATS if option in one.options)


def check_ending(target: Path, kind: str) -> None:
    """Raise unless a file is an .npz archive; the message names all endings of this kind of object."""
    if (ending := target.suffix.lower()) != ".npz":
        hint = "; to_volume().save() writes it" if kind in ("sparse", "nested") and ending in ENDINGS["volume"] else ""
        raise FormatError(
            f"{target}: {_NAMES[kind]} is written as {listed(ENDINGS[kind])}, got the ending '{target.suffix}'{hint}"
        )
