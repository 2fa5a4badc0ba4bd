"""The command ``view``: live views of files as pages that a browser opens."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

import fieldbake as fb

from ..base.encodings import PAGE_NAMES
from .application import app, out
from .shared.shapes import shape_in_file

#: Kinds of files that hold a whole scene.
SCENES = (".glb", ".gltf")


@app.command()
def view(
    files: Annotated[
        list[Path], typer.Argument(help="Meshes, volumes, atlases, shapes (.csg or implicit .3mf) or scenes.")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The page, or with several files the folder, to write.")
    ] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    encoding: Annotated[str, typer.Option(help="Samples on the page: snorm8, float16 or float32.")] = "snorm8",
    size: Annotated[str, typer.Option(help="Width and height of the canvas, CSS pixels.")] = "960x720",
) -> None:
    """Write a live view of each file as one HTML page, and open it.

    Views draw distance fields: meshes have the colours of their materials, and no textures and no opacity. The command
    render draws both.
    """
    if encoding not in PAGE_NAMES:
        raise typer.BadParameter(f"'{encoding}' must be one of {', '.join(PAGE_NAMES)}", param_hint="--encoding")
    try:
        width, height = (int(side) for side in size.lower().split("x"))
    except ValueError:
        raise typer.BadParameter(f"'{size}' must be WIDTHxHEIGHT, such as 960x720", param_hint="--size") from None
    is_folder = output is not None and (len(files) > 1 or output.is_dir())
    folder = Path(tempfile.mkdtemp(prefix="fieldbake-")) if output is None else output
    if is_folder:
        folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        page = folder / f"{file.stem}.html" if output is None or is_folder else folder
        _read(file).to_html(page, encoding=encoding, size=(width, height))
        out.print(f"{page}  {page.stat().st_size / 1e3:,.0f} kB", soft_wrap=True, highlight=False)
        if open_page:
            webbrowser.open(page.resolve().as_uri())


def _read(file: Path) -> Any:
    """Read the object of a file."""
    shape = shape_in_file(file)
    if shape is not None:
        return shape
    if file.suffix.lower() in SCENES:
        return fb.load_scene(file)
    try:
        return fb.load(file)
    except fb.FormatError:
        return fb.load_mesh(file)
