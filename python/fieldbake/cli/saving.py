"""Fields saved in the encoding and for the engine that the options of a command name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import fieldbake as fb

from ..volumes import conventions, writers

Encoding = Literal["float32", "float16", "snorm16", "snorm8", "unorm8"]
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
        as_bricks = ending in writers.SPARSE_ENDINGS or (ending == ".npz" and encoding is None and engine is None)
        if as_bricks:
            if ending in writers.SPARSE_ENDINGS:
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
    known = writers.ENCODINGS.get(ending, ("float32", "float16", "snorm16", "snorm8"))
    if encoding not in known:
        raise typer.BadParameter(f"{ending} files hold {', '.join(known)}, got {encoding}", param_hint="--encoding")
