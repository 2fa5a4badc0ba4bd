"""The commands ``mesh``, ``solid`` and ``boolean``: closed meshes from fields, shapes and other meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import fieldbake as fb

from ..files.registry import ENDINGS
from .application import app, show_rows
from .commands import MESHES, parse_vector, resolution_option
from .shared.shapes import shape_in_file
from .shared.streams import check_output

Output = Annotated[Path, typer.Option("--output", "-o", help="The mesh file to write: .stl, .obj, .ply, .glb or .3mf.")]
Resolution = Annotated[Any, resolution_option(256)]
Measure = Annotated[
    bool, typer.Option("--measure", help="Also report the largest distances between the result and its source.")
]
Simplify = Annotated[
    float, typer.Option(help="Remove faces while the surface moves by less than this, world units; by manifold3d.")
]
#: Operations of `boolean` by their symbols.
OPERATIONS = {"-": "difference", "+": "union", "|": "union", "&": "intersection"}


@app.command()
def mesh(
    file: Annotated[
        Path, typer.Argument(help="A baked field (.npz, .dds, ...), a shape (.csg or implicit .3mf) or a mesh.")
    ],
    output: Output,
    level: Annotated[
        float, typer.Option(help="Value of the field on the surface, world units; for fields and shapes.")
    ] = 0.0,
    inside: Annotated[
        Literal["below", "above"],
        typer.Option(help="Side of --level that is solid: below for distances, above for intensities such as CT."),
    ] = "below",
    offset: Annotated[
        float | None, typer.Option(help="Grow a mesh by this distance, world units; a negative one shrinks it.")
    ] = None,
    shell: Annotated[float | None, typer.Option(help="Hollow a mesh: thickness of its wall, world units.")] = None,
    side: Annotated[
        Literal["inward", "outward", "both"], typer.Option(help="Side of the surface on which --shell puts the wall.")
    ] = "inward",
    open: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIRECTION",
            help="Direction in which --shell leaves the wall open: z, -x or 0,0,1. May be repeated.",
        ),
    ] = None,
    resolution: Resolution = "256",
    simplify: Simplify = 0.0,
    measure: Measure = False,
) -> None:
    """Write the surface of a field, a shape or a mesh as a closed mesh."""
    check_output(output, MESHES)
    if shell is None and open:
        raise typer.BadParameter("needs --shell", param_hint="--open")
    if offset is not None and shell is not None:
        raise typer.BadParameter("give either --offset or --shell", param_hint="--shell")
    is_field = file.suffix.lower() in ENDINGS["volume"]
    if inside == "above" and not is_field:
        raise typer.BadParameter("is for fields, not for shapes and meshes", param_hint="--inside")
    shape = None if is_field else shape_in_file(file)
    if is_field or shape is not None:
        if offset is not None or shell is not None:
            raise typer.BadParameter("is for meshes; use --level for fields and shapes", param_hint="--offset, --shell")
        if simplify:
            raise typer.BadParameter("is for meshes, not for fields and shapes", param_hint="--simplify")
        if shape is None:
            field = fb.load(file)
            if not hasattr(field, "to_mesh"):
                raise fb.FormatError(f"{file}: holds a {type(field).__name__}, which has no surface")
            made = field.to_mesh(level, inside=inside)
        else:
            made = (shape.offset(level) if level else shape).to_mesh(resolution)
        if not len(made.faces):
            raise fb.MeshError(f"{file}: has no surface at the level {level:g}")
    else:
        if level:
            raise typer.BadParameter("is for fields and shapes; use --offset for meshes", param_hint="--level")
        if shell is not None:
            directions = [parse_vector(text) if "," in text else text for text in open or []]
            made = fb.shell(file, shell, resolution, side, directions, simplify=simplify)
        elif offset is not None:
            made = fb.offset(file, offset, resolution, simplify=simplify)
        else:
            made = fb.solid(file, resolution, simplify=simplify)
    _finish(made, output, measure)


@app.command()
def solid(
    mesh: Annotated[Path, typer.Argument(help="A mesh file: open, doubled, intersecting or wound both ways.")],
    output: Output,
    resolution: Resolution = "256",
    fill: Annotated[
        Literal["winding", "outer"],
        typer.Option(help="winding: inside by the winding number; outer: all that the outer surface encloses."),
    ] = "winding",
    seal: Annotated[float, typer.Option(help="Diameter of the holes that --fill outer closes, voxels.")] = 0.0,
    simplify: Simplify = 0.0,
    measure: Measure = False,
) -> None:
    """Write a closed two-manifold mesh made from any triangles."""
    check_output(output, MESHES)
    _finish(fb.solid(mesh, resolution, fill=fill, seal=seal, simplify=simplify), output, measure)


@app.command(context_settings={"ignore_unknown_options": True})
def boolean(
    a: Annotated[Path, typer.Argument(help="The first mesh file.")],
    operation: Annotated[str, typer.Argument(metavar="-|+|&", help="Difference, union or intersection.")],
    b: Annotated[Path, typer.Argument(help="The second mesh file.")],
    output: Output,
    resolution: Resolution = "256",
    smooth: Annotated[float, typer.Option(help="Width of a fillet where the surfaces meet, world units.")] = 0.0,
    simplify: Simplify = 0.0,
    measure: Measure = False,
) -> None:
    """Combine two meshes: fieldbake boolean a.stl - b.stl -o c.stl."""
    check_output(output, MESHES)
    op: Any = OPERATIONS.get(operation, operation)
    _finish(fb.boolean(op, a, b, resolution=resolution, smooth=smooth, simplify=simplify), output, measure)


def _finish(made: fb.Mesh, output: Path, measure: bool) -> None:
    """Write a mesh and describe it."""
    made.save(output)
    rows = [("mesh", f"{len(made.vertices):,} vertices, {len(made.faces):,} faces")]
    rows += [("volume", f"{made.volume:.6g}"), ("area", f"{made.area:.6g}")]
    report = made.report
    if isinstance(report, fb.SolidReport):
        rows.append(("bodies", f"{report.bodies:,}, genus {report.genus}"))
        rows.append(("crossing faces", f"{report.self_intersections:,} pairs"))
        if report.thinnest_part is not None:
            rows.append(("thinnest part", f"{report.thinnest_part:.4g}"))
        if measure:
            rows.append(("to source", f"{report.distance_to_source:.4g}; a voxel is {report.voxel_size:.4g}"))
            rows.append(("from source", f"{report.distance_from_source:.4g}"))
    rows += [("warning", warning) for warning in getattr(report, "warnings", ())]
    show_rows(str(output), rows)
