"""The commands ``cook`` and ``sweep``: collision fields of robots, and the space that a motion covers."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

import fieldbake as fb

from ..assemblies.mjcf_files import compiled, read_spec
from ..base.optional import optional_module
from ..files.container import atomic_write
from ..files.registry import ENDINGS
from ..physics.closing import closed_mesh, has_one_side
from ..physics.models import MAX_DEPTH, mesh_in_file
from .application import app, show_rows
from .commands import MESHES, parse_bounds, resolution_option
from .shared.shapes import shape_in_file
from .shared.streams import check_clobber, check_output


@app.command()
def cook(
    files: Annotated[
        list[Path],
        typer.Argument(help="An MJCF file with geoms of type sdf; with --for newton mesh files.", metavar="FILE"),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="The .mjb file to write; with --solid an .xml file, with --for newton a folder."
        ),
    ],
    engine: Annotated[
        Literal["mujoco", "newton"], typer.Option("--for", help="The engine that reads the result.")
    ] = "mujoco",
    depth: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_DEPTH, help="Largest depth of the octrees; the default is the depth in the file."),
    ] = None,
    solid: Annotated[
        bool,
        typer.Option("--solid", help="Write closed meshes, and a copy of the MJCF file that names them."),
    ] = False,
    resolution: Annotated[Any, resolution_option(128)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per mesh.")] = False,
) -> None:
    """Write collision fields with exact distances, for MuJoCo from a robot or for Newton from meshes.

    For MuJoCo the file is compiled, and the octrees of its SDF geoms are filled. For Newton each mesh becomes a file of
    its cache, for the folder that `build_sdf` gets as `cache_dir`; --resolution is its `max_resolution`.
    """
    if engine == "newton":
        if solid or depth is not None:
            raise typer.BadParameter("--solid and --depth belong to MuJoCo", param_hint="--for")
        _cook_for_newton(files, output, resolution, as_json)
        return
    if len(files) > 1:
        raise typer.BadParameter(f"MuJoCo compiles one file, got {len(files)}", param_hint="FILE")
    (robot,) = files
    check_output(output, (".xml",) if solid else (".mjb",))
    mujoco = optional_module("mujoco", "fieldbake cook", extra="mujoco")
    spec = read_spec(robot, "fieldbake cook")
    if depth is not None:
        for mesh in spec.meshes:
            mesh.octree_maxdepth = depth
    model = compiled(spec, robot)
    if not (model.mesh_octadr >= 0).any():
        raise fb.FormatError(f"{robot}: no geom with type='sdf' names a mesh, so there is no octree to fill")
    if solid:
        written = _write_solid(spec, model, robot, output, 128 if resolution is None else resolution)
        # The written file leaves its values to MuJoCo; the table compares them with distances.
        fields = fb.mujoco.refine(compiled(spec, output))
    else:
        fields, written = fb.mujoco.refine(model), []
        buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        with atomic_write(output) as stream:
            stream.write(buffer.tobytes())
    for field in fields:
        if as_json:
            facts = {"file": str(output), "mujoco": mujoco.__version__, **field._asdict()}
            typer.echo(json.dumps(facts))
        else:
            show_rows(f"{output}: {field.name}", _rows(field))
    if not as_json:
        version = f"{mujoco.__version__}; other versions of MuJoCo refuse the file"
        rows = [("meshes", ", ".join(map(str, written)) or "none needed a change")] if solid else [("MuJoCo", version)]
        show_rows(str(output), rows)


def _cook_for_newton(files: list[Path], output: Path, resolution: Any, as_json: bool) -> None:
    """Write the files of Newton's cache."""
    if not (resolution is None or isinstance(resolution, int)):
        raise typer.BadParameter("Newton takes one number of voxels", param_hint="--resolution")
    for file in files:
        written = fb.newton.cook(fb.load_mesh(file), output, max_resolution=resolution)
        if as_json:
            typer.echo(json.dumps({"mesh": str(file), "file": str(written)}))
        else:
            show_rows(str(written), [("mesh", str(file)), ("size", f"{written.stat().st_size:,} bytes")])


@app.command()
def sweep(
    geometry: Annotated[
        Path, typer.Argument(help="The moving body: a mesh, a shape, or a robot as .urdf or .xml (MJCF).")
    ],
    motion: Annotated[
        Path,
        typer.Argument(
            help="The motion, .npy: poses (t, 4, 4); for a robot joint values (t, m) or poses (t, n, 4, 4)."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help=f"The file to write: {', '.join((*MESHES, *ENDINGS['sparse']))}."),
    ],
    resolution: Annotated[Any, resolution_option(128)] = "128",
    voxel_size: Annotated[
        float | None, typer.Option(help="Side of a cubic voxel, world units; replaces --resolution.")
    ] = None,
    bounds: Annotated[
        Any, typer.Option(parser=parse_bounds, metavar="X,Y,Z,X,Y,Z", help="Lower and upper corner of the box.")
    ] = None,
    closed: Annotated[bool, typer.Option("--closed", help="Return from the last row to the first.")] = False,
    contain: Annotated[
        bool,
        typer.Option("--contain/--no-contain", help="Move the surface outside the swept solid, by a proven distance."),
    ] = True,
    tolerance: Annotated[float, typer.Option(help="Largest difference of a sample from the distance, voxels.")] = 0.25,
    sign: Annotated[
        Literal["auto", "winding", "unsigned"],
        typer.Option(help="unsigned sweeps open meshes as sheets; the others use the winding number."),
    ] = "auto",
) -> None:
    """Write the space that a moving part or robot covers, as a closed mesh or a field."""
    check_output(output, (*MESHES, *ENDINGS["sparse"]))
    body: Any
    ending = geometry.suffix.lower()
    if ending == ".urdf":
        body = fb.Assembly.from_urdf(geometry)
    elif ending in (".xml", ".mjcf"):
        body = fb.Assembly.from_mjcf(geometry)
    else:
        shape = shape_in_file(geometry)
        body = fb.load_mesh(geometry) if shape is None else shape
    try:
        rows = np.load(motion, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise fb.FormatError(f"{motion}: is no .npy array of a motion ({str(error).splitlines()[0]})") from None
    swept = fb.sweep(
        body,
        rows,
        resolution,
        voxel_size=voxel_size,
        bounds=bounds,
        closed=closed,
        contain=contain,
        tolerance=tolerance,
        sign=sign,
    )
    facts = [("size", " x ".join(map(str, swept.resolution)))]
    if output.suffix.lower() in MESHES:
        made = swept.to_mesh(sharp=False)
        made.save(output)
        facts = [("surface", f"{len(made.faces):,} faces, volume {made.volume:.4g}")]
    else:
        swept.save(output)
    show_rows(str(output), [*facts, *swept.report.rows()])


def _rows(field: Any) -> list[tuple[str, str]]:
    """Labels and texts of a filled octree."""
    return [
        ("octree", f"{field.nodes:,} nodes, {field.corners:,} corners of leaves"),
        ("wrong signs", f"{field.wrong_signs:,} corners in the octree of MuJoCo"),
        ("largest change", f"{field.largest_change:.4g}"),
        ("time", f"{field.seconds:.2f} s"),
    ]


def _write_solid(spec: Any, model: Any, robot: Path, output: Path, resolution: Any) -> list[Path]:
    """Write closed meshes beside `output`, and the MJCF file that names them; return the new files."""
    folder = output.resolve().parent
    source = robot.resolve().parent
    strip = spec.strippath
    for assets, kind in ((spec.meshes, "meshdir"), (spec.hfields, "meshdir"), (spec.textures, "texturedir")):
        for asset in assets:
            if asset.file:
                name = os.path.basename(asset.file.replace("\\", "/")) if strip else asset.file  # noqa: PTH119
                asset.file = os.path.relpath(source / getattr(spec, kind) / name, folder)
    spec.strippath, spec.meshdir, spec.texturedir, spec.modelfiledir = False, "", "", str(folder)
    by_name = {mesh.name: mesh for mesh in spec.meshes}
    written: list[Path] = []
    for i in np.flatnonzero(model.mesh_octadr >= 0):
        name = model.mesh(i).name
        mesh = mesh_in_file(model, int(i))
        if has_one_side(mesh):
            continue
        file = folder / f"{output.stem}_{len(written)}.obj"
        check_clobber(file)
        closed_mesh(mesh, resolution).save(file)
        written.append(file)
        asset = by_name[name]
        asset.file, asset.content_type, asset.scale = file.name, "", np.ones(3)
        asset.refpos, asset.refquat = np.zeros(3), np.eye(4)[0]
        asset.uservert, asset.userface = [], []  # of a mesh that the file lists in numbers
    with atomic_write(output) as stream:
        stream.write(spec.to_xml().encode())
    return written
