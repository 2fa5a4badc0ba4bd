"""The commands ``query`` and ``check``: distances at points from a file, and the defects of a mesh."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import fieldbake as fb

from ..files.container import atomic_write
from ..queries.common import Sign
from ..surfaces.report import thinnest_part
from .application import app, show_rows
from .commands import Device

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
    points: Annotated[Path, typer.Argument(help="Points: .npy (n, 3), .csv, .xyz or .ply.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The .npy or .csv file to write.")],
    sign: Annotated[Sign, typer.Option(help="Method that decides between inside and outside.")] = "auto",
    device: Device = "auto",
) -> None:
    """Write signed distance, gradient, closest point, face and weights of every point."""
    kind = output.suffix.lower()
    if kind not in (".npy", ".csv"):
        raise typer.BadParameter(f"'{output}' must end in .npy or .csv", param_hint="--output")
    if not output.absolute().parent.is_dir():
        raise typer.BadParameter(f"the folder of '{output}' does not exist", param_hint="--output")
    found = fb.query(mesh, read_points(points), sign=sign, device=device)
    table = np.column_stack(
        [found.distances, found.gradients, found.points, found.faces.astype(np.float64), found.barycentric]
    )
    with atomic_write(output) as stream:
        if kind == ".npy":
            np.save(stream, table)
        else:
            whole = ["%d" if name == "face" else "%.17g" for name in COLUMNS]
            np.savetxt(stream, table, fmt=whole, delimiter=",", header=",".join(COLUMNS), comments="")
    show_rows(str(output), [("columns", ", ".join(COLUMNS)), *found.report.rows()])


def read_points(path: Path) -> NDArray[np.float64]:
    """Read positions (n, 3) from a file: its first three columns."""
    kind = path.suffix.lower()
    try:
        if kind == ".npy":
            array = np.load(path, allow_pickle=False)
        elif kind == ".csv":
            with path.open(encoding="utf-8") as stream:
                first = stream.readline()
            array = np.loadtxt(path, delimiter=",", skiprows=0 if _is_numbers(first) else 1, ndmin=2)
        elif kind == ".xyz":
            array = np.loadtxt(path, ndmin=2)
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
    """Report whether meshes are closed, oriented and free of self-intersections, and how thin they are."""
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
