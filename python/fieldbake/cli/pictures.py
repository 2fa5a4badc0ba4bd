"""The commands ``render``, ``csg``, ``devices`` and ``demo``: pictures of scenes and shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

import fieldbake as fb

from ..drawing.frame import check_picture, save_image
from ..drawing.raymarching import PICTURE_SAMPLES
from ..files.registry import ENDINGS
from . import demo as demonstration
from .application import app, err, out
from .commands import MESHES, Device, Resolution, parse_vector
from .shared.picture_options import Size, with_picture_options
from .shared.shapes import read_sexpr, shape_in_file
from .shared.streams import check_clobber, check_output


@app.command()
@with_picture_options
def render(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Scenes, meshes, baked fields and shapes (.csg or implicit .3mf), drawn in one picture.",
            metavar="FILE",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture to write: .png, .jpg, ...")],
    resolution: Resolution = "64",
    eye: Annotated[Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Position of the camera.")] = None,
    target: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Point in the middle of the picture.")
    ] = None,
    up: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Direction that points upwards in the picture.")
    ] = "0,1,0",
    fov_deg: Annotated[float, typer.Option(help="Vertical field of view, degrees.")] = 45.0,
    color: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="R,G,B", help="Colour of all surfaces, linear RGB from 0 to 1.")
    ] = None,
    light: Annotated[
        list[Any] | None,
        typer.Option(
            parser=parse_vector,
            metavar="X,Y,Z",
            help="Direction in which a sun shines; replaces the lights of the file. May be repeated.",
        ),
    ] = None,
    angle_deg: Annotated[
        float, typer.Option(help="Angular diameter of --light, degrees. Larger values give softer shadows.")
    ] = 2.0,
    floor: Annotated[bool, typer.Option("--floor", help="Add a floor below the scene.")] = False,
    heatmap: Annotated[
        Literal["steps", "rays", "depth", "shadow"] | None, typer.Option(help="Show this quantity instead of colours.")
    ] = None,
    **picture: Any,
) -> None:
    """Draw scenes: glTF or any mesh files with their textures, cameras and lights, or baked fields."""
    if target is not None and eye is None:
        raise typer.BadParameter("needs --eye", param_hint="--target")
    check_picture(output)
    check_clobber(output)
    scene = _scene(files, resolution, color, light, angle_deg, floor)
    camera = None
    if eye is not None:
        camera = fb.Camera(eye, scene.bounds.mean(axis=0) if target is None else target, up, fov_deg)
    elif not scene.cameras:
        geometries = scene.instances[:-1] if floor else scene.instances
        boxes = np.stack([instance.bounds for instance in geometries])
        bounds = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        camera = fb.Camera.fit(bounds, up=up, fov_deg=fov_deg, aspect=picture["size"][0] / picture["size"][1])
    frame = fb.render(scene, camera, progress=err.is_terminal, **picture)
    if heatmap is None:
        frame.save(output)
    else:
        save_image(frame.heatmap(heatmap), output)
    out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(frame))}", soft_wrap=True)


def _scene(
    files: list[Path],
    resolution: Any,
    color: tuple[float, float, float] | None,
    light: list[Any] | None,
    angle_deg: float,
    floor: bool,
) -> fb.Scene:
    """Build the scene that `render` draws."""
    material = None if color is None else fb.Material(color=color)
    lights: list[Any] | None = None if not light else [fb.DirectionalLight(way, angle_deg=angle_deg) for way in light]
    voxels = resolution if isinstance(resolution, int) else max(resolution)
    scenes = []
    for file in files:
        found: Any = fb.load(file) if file.suffix.lower() in ENDINGS["volume"] else shape_in_file(file)
        scenes.append(fb.load_scene(file, resolution=voxels) if found is None else fb.Scene([fb.Instance(found)]))
    instances = [
        item if material is None else fb.Instance(item.geometry, item.transform, material, resolution=item.resolution)
        for scene in scenes
        for item in scene.instances
    ]
    cameras = [camera for scene in scenes for camera in scene.cameras]
    if floor:
        lower, upper = fb.Scene(instances).bounds
        middle, reach = (lower + upper) / 2, 1.5 * float(np.linalg.norm(upper - lower))
        corners = [
            (middle[0] + x * reach, lower[1], middle[2] + z * reach) for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        instances.append(fb.Instance(fb.Mesh(corners, [(0, 2, 1), (0, 3, 2)])))
    if lights is None:
        lights = [light for scene in scenes for light in scene.lights or ()] or None
    return fb.Scene(instances, lights, cameras=cameras)


@app.command()
def csg(
    model: Annotated[Path, typer.Argument(help="A text file with one s-expression, or an implicit .3mf.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help=f"The file to write: a picture, a baked field ({', '.join(ENDINGS['volume'])}) or a mesh "
            f"({', '.join(MESHES)}).",
        ),
    ],
    size: Size = "512x512",
    resolution: Resolution = "128",
    method: Annotated[
        Literal["auto", "whole", "aabb", "octree"],
        typer.Option(
            help="Method of drawing. auto draws four samples per pixel, the others one. All draw the same surface."
        ),
    ] = "auto",
    direction: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Viewing direction of the camera.")
    ] = "-0.6,0.8,-0.6",
    parts: Annotated[bool, typer.Option("--parts", help="List the parts of the decomposition.")] = False,
    device: Device = "auto",
) -> None:
    """Draw, bake or mesh a shape from a file with its s-expression. The z axis points upwards in pictures."""
    suffix = output.suffix.lower()
    if suffix in (*ENDINGS["volume"], *MESHES):
        check_output(output, (suffix,))
    else:
        check_picture(output)
        check_clobber(output)
    shape = shape_in_file(model)
    if shape is None:
        shape = read_sexpr(model)
    if parts:
        found = fb.csg.decompose(shape, "aabb" if method == "aabb" else "octree")
        table = Table("boxes", "part", title=f"{len(found)} parts, {found.structures} structures", title_justify="left")
        for part in found:
            table.add_row(str(len(part.boxes)), escape(repr(part.shape)))
        out.print(table)
    if suffix in (*ENDINGS["volume"], *MESHES):
        volume = fb.bake(shape, resolution, device=device, progress=err.is_terminal)
        if suffix in MESHES:
            volume.to_mesh().save(output)
        else:
            volume.save(output)
        out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(volume))}", soft_wrap=True)
        return
    camera = fb.Camera.fit(shape.bounds, direction=direction, up=(0, 0, 1), aspect=size[0] / size[1])
    frame = fb.raymarch(
        shape,
        camera,
        size=size,
        samples=PICTURE_SAMPLES if method == "auto" else 1,
        method=method,
        device=device,
        progress=err.is_terminal,
    )
    frame.save(output)
    out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(frame))}", soft_wrap=True)


@app.command()
def devices() -> None:
    """List the compute devices."""
    table = Table("name", "backend", "type", "hardware")
    for device in fb.devices():
        table.add_row(escape(device.name), device.backend, device.type, "yes" if device.hardware else "no")
    out.print(table)


@app.command()
def demo(
    mesh: Annotated[
        list[Path] | None, typer.Argument(help="Mesh files; the default is two models made in code.")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the files that the demo writes.")] = Path(
        "out"
    ),
    resolution: Annotated[int, typer.Option("--resolution", "-r", help="Voxels along the longest side.")] = 128,
) -> None:
    """Bake, save, load and draw meshes; write pictures and print the steps."""
    demonstration.run(
        output,
        [str(path) for path in mesh or []],
        resolution=resolution,
        progress=err.is_terminal,
        tell=lambda line: out.print(escape(line), soft_wrap=True),
    )
