"""The commands ``query`` and ``check``: distances at points from a file, and the defects of a mesh."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

import fieldbake as fb

from ..files.container import atomic_write
from ..points.files import read_table
from ..queries.common import Sign
from ..surfaces.report import thinnest_part
from .application import app, show_rows, show_warning
from .commands import Device
from .shared.streams import check_output, input_file, is_stream, output_file

#: Names of the columns of a result.
COLUMNS = (
    "distance",
    *(f"gradient_{axis}" for axis in "xyz"),
    *(f"closest_{axis}" for axis in "xyz"),
    "face",
    *(f"weight_{corner}" for corner in range(3)),
)


@app.command()
def query(
    mesh: Annotated[Path, typer.Argument(help="A mesh file.")],
    points: Annotated[Path, typer.Argument(help="Points: .npy (n, 3), .csv, .xyz or .ply; - is standard input.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .npy or .csv file to write; - is standard output.")
    ],
    sign: Annotated[Sign, typer.Option(help="Method that decides between inside and outside.")] = "auto",
    source: Annotated[
        str | None, typer.Option("--from", help="Format of the points if they are -, such as csv.")
    ] = None,
    kind: Annotated[Literal["csv", "npy"], typer.Option("--to", help="Format of the output if it is -.")] = "csv",
    device: Device = "auto",
) -> None:
    """Write signed distance, gradient, closest point, face and weights of every point."""
    ending = f".{kind}" if is_stream(output) else output.suffix.lower()
    if not (is_stream(output) and kind == "csv"):  # a terminal shows text
        check_output(output, (".npy", ".csv"))
    with input_file(points, source, kind_of_points) as file:
        positions = read_points(file)
    found = fb.query(mesh, positions, sign=sign, device=device)
    table = np.column_stack(
        [found.distances, found.gradients, found.points, found.faces.astype(np.float64), found.barycentric]
    )
    with output_file(output, ending) as target, atomic_write(target) as stream:
        if ending == ".npy":
            np.save(stream, table)
        else:
            whole = ["%d" if name == "face" else "%.17g" for name in COLUMNS]
            np.savetxt(stream, table, fmt=whole, delimiter=",", header=",".join(COLUMNS), comments="")
    if is_stream(output):
        for warning in found.report.warnings:
            show_warning(warning)
    else:
        show_rows(str(output), [("columns", ", ".join(COLUMNS)), *found.report.rows()])


def kind_of_points(first: bytes) -> str:
    """Return the ending of the format of points with these first bytes."""
    if first.startswith(b"\x93NUMPY"):
        return ".npy"
    if first.startswith(b"ply"):
        return ".ply"
    return ".csv" if b"," in first else ".xyz"


def read_points(path: Path) -> NDArray[np.float64]:
    """Read positions (n, 3) from a file: its first three columns."""
    kind = path.suffix.lower()
    try:
        if kind == ".npy":
            array = np.load(path, allow_pickle=False)
        elif kind == ".csv":
            with path.open(encoding="utf-8") as stream:
                first = stream.readline()
            array = read_table(path, ",", 0 if _is_numbers(first) else 1)
        elif kind == ".xyz":
            array = read_table(path)
        elif kind == ".ply":
            import trimesh

            cloud: Any = trimesh.load(str(path), process=False)
            array = np.asarray(cloud.vertices)
        else:
            raise fb.FormatError(f"{path}: points are read from .npy, .csv, .xyz and .ply, got '{path.suffix}'")
    except fb.Error:
        raise
    except (ValueError, AttributeError, IndexError, KeyError) as error:
        raise fb.FormatError(f"{path}: cannot be read as points: {error}") from error
    if array.ndim != 2 or array.shape[1] < 3:
        raise fb.FormatError(f"{path}: must hold rows of three numbers, got an array of shape {array.shape}")
    return np.ascontiguousarray(array[:, :3], dtype=np.float64)


def _is_numbers(line: str) -> bool:
    try:
        [float(part) for part in line.split(",")]
    except ValueError:
        return False
    return True


@app.command()
def check(
    meshes: Annotated[list[Path], typer.Argument(help="Mesh files.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per file.")] = False,
) -> None:
    """Report whether meshes are closed, oriented and free of self-intersections, and how thin they are.

    The thinnest part is the shortest of 20,000 perpendicular paths from the surface to a face that is turned by at
    least 120 degrees, world units. It is near 0 at an edge sharper than 60 degrees. Vertices are counted as the
    file stores them: an .stl has three for each face.
    """
    for path in meshes:
        facts = facts_of(fb.load_mesh(path))
        if as_json:
            typer.echo(json.dumps({"file": str(path), **facts}))
        else:
            show_rows(str(path), [(name.replace("_", " "), _text(value)) for name, value in facts.items()])


def facts_of(mesh: fb.Mesh) -> dict[str, Any]:
    """Collect the properties that `check` prints."""
    topology = mesh.topology()
    return {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "closed": topology["closed"],
        "components": topology["components"],
        "boundary_edges": topology["boundary_edges"],
        "nonmanifold_edges": topology["nonmanifold_edges"],
        "flipped_faces": topology["flipped_faces"],
        "duplicate_faces": topology["duplicate_faces"],
        "degenerate_faces": topology["degenerate_faces"],
        "self_intersections": mesh._core.self_intersections(),
        "inside_out": topology["closed"] and mesh.volume < 0,
        "area": mesh.area,
        "volume": mesh.volume if topology["closed"] else None,
        "bounds": mesh.bounds.tolist(),
        "thinnest_part": thinnest_part(mesh),
    }


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "unknown"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    return f"{value:,}" if isinstance(value, int) else str(value)
