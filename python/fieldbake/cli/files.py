"""The commands ``info`` and ``convert``: a description of files, and conversion between formats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

import fieldbake as fb

from ..atlases.atlas import as_written
from ..files import sidecar
from ..files.registry import ENDINGS, WITH_SIDECAR
from ..meshes.convert import HEAD_BYTES
from ..points.files import READERS
from .application import app, show_rows
from .commands import MESHES
from .shared.saving import Encoding, Engine, check_encoding, save_field
from .shared.shapes import shape_in_file
from .shared.streams import check_output, input_file, is_stream, output_file
from .shared.tables import facts_of, rows_of

#: Endings of all fields and atlases.
FIELDS = tuple(dict.fromkeys(ending for kind in ENDINGS.values() for ending in kind))

Band = Annotated[
    float | None,
    typer.Option(
        help="Half width of a band around the surface, voxels: of snorm and unorm encodings (4), and of "
        "the narrow band of .vdb and .nvdb (3)."
    ),
]
Mipmaps = Annotated[bool, typer.Option("--mipmaps", help="Add coarser levels to .dds and .ktx2.")]


@app.command()
def info(
    files: Annotated[
        list[Path], typer.Argument(help="Files written by fieldbake, grids, meshes, shapes or points.", metavar="FILE")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per file.")] = False,
    kind: Annotated[str | None, typer.Option("--from", help="Format of the file if FILE is -, such as npz.")] = None,
) -> None:
    """Describe the contents of files."""
    # A glob such as a.* also names the files that a save wrote beside a field.
    for path in dict.fromkeys(map(_field_of, files)):
        with input_file(path, kind) as file:
            found = fb.load_points(file, opacity=0) if _holds_points(file) else _load(file)
            if as_json:
                typer.echo(json.dumps({"file": str(path), **facts_of(found)}))
            else:
                show_rows(str(path), rows_of(found, file.suffix.lower()))


@app.command()
def convert(
    file: Annotated[Path, typer.Argument(help="A baked field, a grid, an atlas or a mesh; - reads standard input.")],
    output: Annotated[
        Path, typer.Argument(help=f"The file to write: {', '.join((*FIELDS, *MESHES))}; - writes standard output.")
    ],
    encoding: Annotated[
        Encoding | None, typer.Option(help="Encoding of the samples; the default is the file's encoding.")
    ] = None,
    band: Band = None,
    engine: Engine = None,
    mipmaps: Mipmaps = False,
    source: Annotated[str | None, typer.Option("--from", help="Format of the input if it is -, such as npz.")] = None,
    kind: Annotated[str, typer.Option("--to", help="Format of the output if it is -, such as vdb.")] = "npz",
) -> None:
    """Write a field, an atlas or a mesh in another format; a field becomes a mesh as its zero surface."""
    if output.suffix.lower() == ".html":
        raise fb.FormatError(f"{output}: is a live view; `fieldbake view {file} -o {output}` writes it")
    check_output(output, (*FIELDS, *MESHES), "OUTPUT")
    ending = f".{kind.lstrip('.')}" if is_stream(output) else output.suffix.lower()
    if ending not in (*FIELDS, *MESHES):
        raise typer.BadParameter(f"'{kind}' is not one of {', '.join((*FIELDS, *MESHES))}", param_hint="--to")
    if encoding is not None:
        check_encoding(ending, encoding)
    with input_file(file, source) as path, output_file(output, ending) as target:
        found = _load(path)
        if ending == ".png" and not isinstance(found, fb.Atlas):
            raise fb.FormatError(
                f"{file}: holds a {type(found).__name__}, and only an atlas is written as .png; "
                f"`fieldbake render {file} -o {output}` draws a picture"
            )
        if isinstance(found, fb.Mesh):
            if ending not in MESHES:
                raise fb.FormatError(f"{file}: is a mesh and not a fieldbake file; `fieldbake bake` computes its field")
            found.save(target)
        elif isinstance(found, fb.Shape):
            if ending in MESHES:
                way = f"`fieldbake mesh {file} -o {output}` makes its mesh"
            else:
                way = f"`fieldbake bake {file} -o {output}` computes its field"
            raise fb.FormatError(f"{file}: holds a shape, which needs a resolution; {way}")
        elif ending in MESHES:
            if not isinstance(found, (fb.Volume, fb.SparseVolume)):
                raise fb.FormatError(f"{file}: holds a {type(found).__name__}, which has no single surface")
            found = found.to_mesh()
            found.save(target)
        elif isinstance(found, (fb.Volume, fb.SparseVolume)):
            found = save_field(found, target, encoding, band, engine, mipmaps=mipmaps)
        else:
            if encoding is not None or engine is not None:
                raise typer.BadParameter(
                    f"applies to volumes only, {file} holds a {type(found).__name__}",
                    param_hint="--engine" if encoding is None else "--encoding",
                )
            found.save(target)
    if not is_stream(output):
        written = as_written(found, ending) if isinstance(found, fb.Atlas) else found
        show_rows(str(output), rows_of(written, ending))


def _field_of(path: Path) -> Path:
    """Return the field or atlas beside which a save wrote this file, or else the path itself."""
    owner = path
    if path.suffix in (".json", ".meta", ".import"):
        owner = path.with_suffix("")
    elif path.name.endswith(".preview.png"):
        owner = path.with_name(path.name.removesuffix(".preview.png") + ".png")
    return owner if owner.suffix.lower() in WITH_SIDECAR and sidecar.beside(owner).is_file() else path


def _holds_points(path: Path) -> bool:
    """Whether a file can hold a cloud of points only: by its ending, or a PLY file by the elements of its header."""
    ending = path.suffix.lower()
    if ending != ".ply":
        return ending in READERS and ending != ".npz"
    with path.open("rb") as stream:
        header = stream.read(HEAD_BYTES).partition(b"end_header")[0]
    return b"element vertex" in header and b"element face" not in header and b"element tristrips" not in header


def _load(path: Path) -> Any:
    if path.suffix.lower() in FIELDS:
        return fb.load(path)
    shape = shape_in_file(path)
    return fb.load_mesh(path) if shape is None else shape
