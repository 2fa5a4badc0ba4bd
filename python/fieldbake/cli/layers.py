"""The command ``slice``: images or outlines of the layers of a solid."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import fieldbake as fb

from ..files.registry import ENDINGS
from ..slicing import files
from .application import app, err, show_rows
from .commands import Device, parse_bounds
from .shared.shapes import geometry_in_file
from .shared.streams import check_output


def parse_pixel(text: str) -> list[float]:
    """Parse the side of a pixel, or its width and height: ``0.05`` or ``0.05x0.04``."""
    try:
        sides = [float(side) for side in text.lower().split("x")]
    except ValueError:
        sides = []
    if len(sides) not in (1, 2):
        raise typer.BadParameter(f"'{text}' is not a number such as 0.05, nor two such as 0.05x0.04")
    return [sides[0], sides[-1]]


@app.command()
def slice(
    file: Annotated[
        Path, typer.Argument(help="A mesh, a baked field (.npz, .dds, ...) or a shape (.csg or implicit .3mf).")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The file to write: .zip with an image of each layer, or .svg.")
    ],
    layer: Annotated[float, typer.Option(help="Thickness of a layer along z, world units.")],
    pixel: Annotated[
        Any,
        typer.Option(
            parser=parse_pixel, metavar="N|NxN", help="Side of a pixel, or its width and height, world units."
        ),
    ],
    bounds: Annotated[
        Any,
        typer.Option(parser=parse_bounds, metavar="X,Y,Z,X,Y,Z", help="Lower and upper corner of the box to slice."),
    ] = None,
    device: Device = "auto",
) -> None:
    """Slice a solid into layers for a printer: images in a .zip archive, or outlines as .svg."""
    check_output(output, files.ENDINGS)
    solid: Any
    if file.suffix.lower() in ENDINGS["volume"]:
        solid = fb.load(file)
        if not isinstance(solid, (fb.Volume, fb.SparseVolume)):
            raise fb.FormatError(f"{file}: holds a {type(solid).__name__}, which has no single surface")
    else:
        solid = geometry_in_file(file)
    layers = fb.slices(solid, layer, pixel=pixel, bounds=bounds, device=device, progress=err.is_terminal)
    layers.save(output)
    width, height = layers.size
    rows = [("layers", f"{len(layers):,} from z = {layers.z[0]:.6g} to {layers.z[-1]:.6g}")]
    rows += [("pixels", f"{width} x {height}"), ("volume", f"{layers.areas.sum() * layers.layer:.6g}")]
    show_rows(str(output), rows)
