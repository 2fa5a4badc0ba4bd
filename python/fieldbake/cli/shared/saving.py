"""Fields saved in the encoding and for the engine that the options of a command name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import fieldbake as fb

from ...base import encodings
from ...base.encodings import TextureEncoding
from ...files.registry import ENDINGS, format_of
from ...volumes import conventions, writers

Encoding = TextureEncoding
Engine = Annotated[
    conventions.Engine | None,
    typer.Option(help="Axes, units and import settings of an engine."),
]


def save_field(
    field: fb.Volume | fb.SparseVolume,
    target: Path,
    encoding: str | None,
    band: float | None,
    engine: Any,
    *,
    mipmaps: bool,
) -> fb.Volume | fb.SparseVolume:
    """Save a field in the requested encoding, and return the field as the file stores it."""
    ending = target.suffix.lower()
    options: dict[str, Any] = {"engine": engine} if engine is not None else {}
    if isinstance(field, fb.SparseVolume):
        as_bricks = ending in ENDINGS["sparse"][1:] or (ending == ".npz" and encoding is None and engine is None)
        if as_bricks:
            if ending in ENDINGS["sparse"][1:]:
                options |= {"band": band, "encoding": encoding}
            field.save(target, **options)
            return field
        field = field.to_volume()
    if encoding is not None and ending == ".npz":
        field = fb.Volume(field.distances, field.bounds, inner_bounds=field.inner_bounds, report=field.report)
        if encoding != "float32":
            field = field.quantize(encoding, band=4 if band is None else band)  # type: ignore[arg-type]
        encoding = None
    elif ending != ".npz":
        options |= {"band": band, "mipmaps": mipmaps}
    field.save(target, encoding=encoding, **options)
    return fb.load(target) if ending in writers.BANDED or encoding is not None else field


def check_encoding(ending: str, encoding: str) -> None:
    """Raise an error before any work if files with this ending do not have the encoding."""
    form = format_of(ending, "volume")
    known = encodings.NAMES if form is None or ending == ".npz" else form.encodings
    if encoding not in known:
        raise typer.BadParameter(f"{ending} files hold {', '.join(known)}, got {encoding}", param_hint="--encoding")
