"""The command line: ``fieldbake bake | query | check | info | convert | pack | render | merge | csg | devices | demo``.

Exit codes: 0 for success, 1 for an error in the input (one line on stderr), 2 for wrong usage.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from typer.core import TyperGroup

import fieldbake as fb

from ..atlases import images
from ..atlases.atlas import Language, as_written
from ..base.encodings import texel_rule
from ..base.report import bytes_text
from ..drawing.frame import save_image
from ..files.container import ENDINGS, atomic_write, check_target, listed
from ..volumes import writers as textures
from . import demo as demonstration
from .folders import bake_folder

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


class Group(TyperGroup):
    """Prints errors in the input as one line, with exit code 1; other exceptions keep their traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; see the description of the class."""
        try:
            return super().invoke(ctx)
        except (fb.Error, OSError) as error:
            text = str(error)
            if isinstance(error, OSError) and error.strerror:
                text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
            err.print(f"[bold red]error:[/] {escape(text)}", soft_wrap=True)
            raise typer.Exit(1) from None


app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Exact signed distance fields from triangle meshes and CSG shapes.",
)

Device = Annotated[str, typer.Option(help='Compute device: "auto", "cpu", "gpu" or a name from `fieldbake devices`.')]
Sign = Literal["auto", "winding", "parity", "pseudonormal", "normal", "unsigned"]


def _version(wanted: bool) -> None:
    if wanted:
        out.print(f"fieldbake {fb.__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Options that come before the command."""


def parse_resolution(text: str) -> int | tuple[int, int, int]:
    """``64`` or ``64x48x32``."""
    try:
        sides = [int(side) for side in text.lower().split("x")]
    except ValueError:
        sides = []
    if len(sides) == 1:
        return sides[0]
    if len(sides) == 3:
        return sides[0], sides[1], sides[2]
    raise typer.BadParameter(f"'{text}' is not a number such as 64, nor three such as 64x48x32")


def parse_page_size(text: str) -> int | Literal["fit"]:
    """``4096`` or ``fit``."""
    if text == "fit":
        return "fit"
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a number such as 4096, nor fit") from None


def parse_size(text: str) -> tuple[int, int]:
    """``640x480``."""
    try:
        width, height = (int(side) for side in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if min(width, height) < 1:
        raise typer.BadParameter(f"'{text}' is not a size such as 640x480")
    return width, height


def parse_vector(text: str) -> tuple[float, float, float]:
    """``1,2.5,-3``."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not three numbers such as 1,2.5,-3") from None
    return x, y, z


Resolution = Annotated[
    Any,
    typer.Option(
        "--resolution",
        "-r",
        parser=parse_resolution,
        metavar="N|NxNxN",
        help="Voxels along the longest side (64), or along x, y and z (64x48x32).",
    ),
]


@app.command()
def bake(
    mesh: Annotated[
        list[Path], typer.Argument(help="Mesh files. Several are baked into one field, or with a folder one by one.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="The file to write: .npz, .dds, .ktx2 or .nrrd; with --sparse .npz. A folder: one .npz for each mesh.",
        ),
    ],
    resolution: Resolution = "64",
    voxel_size: Annotated[
        float | None, typer.Option(help="Side of a cubic voxel, world units; replaces --resolution.")
    ] = None,
    margin: Annotated[float, typer.Option(help="Margin around the mesh, as a share of its box.")] = 0.1,
    sign: Annotated[Sign, typer.Option(help="Method that tells inside from outside.")] = "auto",
    band: Annotated[
        float | None,
        typer.Option(help="Distances are exact within this many voxels of the surface, and lower bounds beyond."),
    ] = None,
    two_sided: Annotated[
        bool, typer.Option("--two-sided", help="Treat the surface as a sheet with a thickness.")
    ] = False,
    thickness: Annotated[
        float | None, typer.Option(help="Thickness of the sheet, world units; the default is the diagonal of a voxel.")
    ] = None,
    sparse: Annotated[bool, typer.Option("--sparse", help="Store bricks around the surface only.")] = False,
    tolerance: Annotated[float, typer.Option(help="Largest error of coarser bricks, voxels; for --sparse.")] = 0.05,
    encoding: Annotated[
        Literal["float32", "float16", "snorm16", "snorm8"], typer.Option(help="Encoding of the stored samples.")
    ] = "float32",
    jobs: Annotated[
        int | None,
        typer.Option(help="Meshes that are baked at the same time; for a folder. One per core if not given."),
    ] = None,
    limit_s: Annotated[
        float | None, typer.Option("--limit", help="Seconds after which a mesh is given up; for a folder.")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Bake meshes again whose results are up to date; for a folder.")
    ] = False,
    device: Device = "auto",
) -> None:
    """Bake the signed distance field of a mesh into a file, or those of many meshes into a folder."""
    if not output.suffix or output.is_dir():
        if sparse or encoding != "float32":
            raise typer.BadParameter("a folder takes dense float32 fields", param_hint="--sparse, --encoding")
        options = {"resolution": resolution, "voxel_size": voxel_size, "margin": margin, "sign": sign, "band": band}
        if voxel_size is not None:
            del options["resolution"]
        options |= {"two_sided": two_sided, "thickness": thickness, "device": device}
        bake_folder(mesh, output, options, jobs=jobs, limit_s=limit_s, fresh=fresh)
        return
    if jobs is not None or limit_s is not None or fresh:
        raise typer.BadParameter(f"'{output}' is a file; these options are for a folder", param_hint="--jobs, --limit")
    _check_output(output, ENDINGS["sparse" if sparse else "volume"])
    _check_encoding(output, encoding)
    things: Any = [str(path) for path in mesh] if len(mesh) > 1 else mesh[0]
    surface: dict[str, Any] = {
        "voxel_size": voxel_size,
        "margin": margin,
        "sign": sign,
        "two_sided": two_sided,
        "thickness": thickness,
        "progress": err.is_terminal,
    }
    width = 4.0 if band is None else band
    volume: fb.Volume | fb.SparseVolume
    if sparse:
        if device not in ("auto", "cpu"):
            raise typer.BadParameter("bricks are baked on the CPU", param_hint="--device")
        volume = fb.bake_sparse(things, resolution, band=width, tolerance=tolerance, encoding=encoding, **surface)
    else:
        volume = fb.bake(things, resolution, band=band, device=device, **surface)
        if encoding != "float32":
            volume = volume.quantize(encoding, band=width)
    volume.save(output)
    show_rows(f"{output}", _volume_rows(volume))


@app.command()
def merge(
    scene: Annotated[Path, typer.Argument(help="A glTF or GLB scene, or any mesh file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file to write: .npz, .dds, .ktx2 or .nrrd.")],
    resolution: Resolution = "128",
    device: Device = "auto",
) -> None:
    """Merge all instances of a scene into one field that never exceeds the distance to them."""
    _check_output(output, ENDINGS["volume"])
    is_scene = scene.suffix.lower() in (".gltf", ".glb")
    things = fb.load_scene(scene) if is_scene else [fb.load_mesh(scene)]
    field = fb.merge(things, resolution, device=device, progress=err.is_terminal)
    field.save(output)
    show_rows(f"{output}", _volume_rows(field))


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="A file written by fieldbake, or a mesh.")],
) -> None:
    """Describe the contents of a file."""
    if file.suffix.lower() in (".npz", *textures.ENDINGS, *images.ENDINGS):
        found = fb.load(file)
        is_atlas = isinstance(found, fb.Atlas)
        show_rows(str(file), _atlas_rows(found, file.suffix.lower()) if is_atlas else _volume_rows(found))
    else:
        show_rows(str(file), _mesh_rows(fb.load_mesh(file)))


@app.command()
def convert(
    file: Annotated[Path, typer.Argument(help="A baked field or an atlas, in any format of fieldbake's.")],
    output: Annotated[Path, typer.Argument(help="The file to write: .npz, .dds, .ktx2, .nrrd, or .exr or .png.")],
    encoding: Annotated[
        Literal["float32", "float16", "snorm16", "snorm8"] | None,
        typer.Option(help="How samples are stored; if not given, as in the file."),
    ] = None,
    band: Annotated[float, typer.Option(help="Voxels that snorm encodings keep on each side of the surface.")] = 4.0,
) -> None:
    """Write a baked field or an atlas in another format, or in another encoding."""
    _check_output(output, tuple(dict.fromkeys(ending for kind in ENDINGS.values() for ending in kind)))
    if encoding is not None:
        _check_encoding(output, encoding)
    ending = output.suffix.lower()
    found = fb.load(file)
    if isinstance(found, fb.SparseVolume) and (ending in textures.ENDINGS or encoding is not None):
        found = found.to_volume()
    if encoding is not None:
        if not isinstance(found, fb.Volume):
            raise typer.BadParameter(
                f"changes volumes only, {file} holds a {type(found).__name__}", param_hint="--encoding"
            )
        found = fb.Volume(found.distances, found.bounds, inner_bounds=found.inner_bounds, report=found.report)
        if encoding != "float32":
            found = found.quantize(encoding, band=band)
    found.save(output)
    if isinstance(found, fb.Atlas):
        show_rows(str(output), _atlas_rows(as_written(found, ending), ending))
    elif isinstance(found, (fb.Volume, fb.SparseVolume)):
        show_rows(str(output), _volume_rows(found))
    else:
        out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(found))}", soft_wrap=True)


@app.command()
def pack(
    files: Annotated[
        list[Path], typer.Argument(help="Baked fields (.npz, .dds, ...), and meshes, which are baked first.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The atlas to write: .npz, .exr or .png.")],
    layout: Annotated[
        Literal["shelves", "strips"],
        typer.Option(help="shelves: volumes of any size; strips: equal cubes, as in the article."),
    ] = "shelves",
    resolution: Resolution = "64",
    page_size: Annotated[
        Any,
        typer.Option(
            parser=parse_page_size, metavar="N|fit", help="Width and height of a page, texels; fit: as needed."
        ),
    ] = "4096",
    gutter: Annotated[int, typer.Option(help="Width of the copied border around each slice, texels.")] = 1,
    encoding: Annotated[
        Literal["float32", "float16", "snorm16", "snorm8"], typer.Option(help="Encoding of the stored distances.")
    ] = "float32",
    band: Annotated[
        float, typer.Option(help="Distance that snorm encodings keep on each side of the surface, voxels.")
    ] = 4.0,
    shader: Annotated[
        Path | None, typer.Option(help="File for the sampling functions: .wgsl, .glsl, .hlsl or .metal.")
    ] = None,
    device: Device = "auto",
) -> None:
    """Pack baked fields and meshes into a texture atlas."""
    _check_output(output, ENDINGS["atlas"])
    languages: dict[str, Language] = {".wgsl": "wgsl", ".glsl": "glsl", ".hlsl": "hlsl", ".metal": "msl"}
    if shader is not None:
        _check_output(shader, tuple(languages), "--shader")
    # The article's strips hold cubes.
    sides = (resolution,) * 3 if layout == "strips" and isinstance(resolution, int) else resolution
    volumes = []
    for file in files:
        if file.suffix.lower() in (".npz", *textures.ENDINGS):
            volume = fb.load(file)
            if isinstance(volume, fb.SparseVolume):
                volume = volume.to_volume()
            if not isinstance(volume, fb.Volume):
                raise fb.FormatError(f"{file}: holds an atlas, only volumes and meshes can be packed")
        else:
            volume = fb.bake(file, sides, device=device, progress=err.is_terminal)
        volumes.append(volume)
    atlas = fb.pack(
        volumes,
        layout=layout,
        page_size=page_size,
        gutter=gutter,
        encoding=encoding,
        band=band,
        progress=err.is_terminal,
    )
    ending = output.suffix.lower()
    atlas = as_written(atlas, ending)
    atlas.save(output)
    if shader is not None:
        text = atlas.shader(languages[shader.suffix.lower()], texels="png" if ending == ".png" else "pages")
        shader.write_text(text, encoding="utf-8")
    show_rows(f"{output}", _atlas_rows(atlas, ending))


@app.command()
def render(
    file: Annotated[Path, typer.Argument(help="A scene, a mesh, or a baked .npz file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture to write: .png, .jpg, ...")],
    size: Annotated[
        Any, typer.Option(parser=parse_size, metavar="WxH", help="Size of the picture, pixels.")
    ] = "640x480",
    resolution: Resolution = "64",
    eye: Annotated[Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Position of the camera.")] = None,
    target: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Point in the middle of the picture.")
    ] = None,
    up: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Direction that points upwards in the picture.")
    ] = "0,1,0",
    fov: Annotated[float, typer.Option(help="Vertical field of view, degrees.")] = 45.0,
    color: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="R,G,B", help="Colour of all surfaces, linear RGB from 0 to 1.")
    ] = None,
    shadows: Annotated[
        Literal["soft", "hard", "none", "area"],
        typer.Option(help="Kind of shadows; area is slow, and the reference for soft."),
    ] = "soft",
    primary: Annotated[
        Literal["auto", "raster", "raymarch"],
        typer.Option(help="auto: meshes are rasterised, fields marched; raster: meshes only; raymarch: fields only."),
    ] = "auto",
    occlusion: Annotated[bool, typer.Option("--occlusion", help="Add ambient occlusion.")] = False,
    samples: Annotated[int, typer.Option(help="Colour samples per pixel for smooth edges: 1, 4, 9, 16, ...")] = 1,
    light: Annotated[
        list[Any] | None,
        typer.Option(
            parser=parse_vector,
            metavar="X,Y,Z",
            help="Direction in which a sun shines; replaces the lights of the file. May be repeated.",
        ),
    ] = None,
    angle: Annotated[
        float, typer.Option(help="Angular diameter of --light, degrees. Larger values give softer shadows.")
    ] = 2.0,
    floor: Annotated[bool, typer.Option("--floor", help="Add a floor below the scene.")] = False,
    heatmap: Annotated[
        Literal["steps", "depth", "shadow"] | None, typer.Option(help="Show this quantity instead of colours.")
    ] = None,
    device: Device = "auto",
) -> None:
    """Draw a scene: a glTF or any mesh file with its textures, cameras and lights, or a baked field."""
    if target is not None and eye is None:
        raise typer.BadParameter("needs --eye", param_hint="--target")
    scene = _scene(file, resolution, color, light, angle, floor)
    camera = None
    if eye is not None:
        camera = fb.Camera(eye, scene.bounds.mean(axis=0) if target is None else target, up, fov)
    elif not scene.cameras:
        things = scene.instances[:-1] if floor else scene.instances
        boxes = np.stack([instance.bounds for instance in things])
        bounds = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        camera = fb.Camera.fit(bounds, up=up, fov_deg=fov, aspect=size[0] / size[1])
    frame = fb.render(
        scene,
        camera,
        size=size,
        primary=primary,
        shadows=shadows,
        ambient_occlusion=occlusion,
        samples=samples,
        device=device,
        progress=err.is_terminal,
    )
    if heatmap is None:
        frame.save(output)
    else:
        save_image(frame.heatmap(heatmap), output)
    out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(frame))}", soft_wrap=True)


def _scene(
    file: Path,
    resolution: Any,
    color: tuple[float, float, float] | None,
    light: list[Any] | None,
    angle: float,
    floor: bool,
) -> fb.Scene:
    """Build the scene that `render` draws."""
    material = None if color is None else fb.Material(color=color)
    lights = None if not light else [fb.DirectionalLight(way, angle_deg=angle) for way in light]
    if file.suffix.lower() == ".npz":
        scene = fb.Scene([fb.Instance(fb.load(file), material=material)])
    else:
        voxels = resolution if isinstance(resolution, int) else max(resolution)
        scene = fb.load_scene(file, resolution=voxels)
    instances = [
        item if material is None else fb.Instance(item.thing, item.transform, material, resolution=item.resolution)
        for item in scene.instances
    ]
    if floor:
        lower, upper = scene.bounds
        middle, reach = (lower + upper) / 2, 1.5 * float(np.linalg.norm(upper - lower))
        corners = [
            (middle[0] + x * reach, lower[1], middle[2] + z * reach) for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        instances.append(fb.Instance(fb.Mesh(corners, [(0, 2, 1), (0, 3, 2)])))
    return fb.Scene(instances, scene.lights if lights is None else lights, cameras=scene.cameras)


@app.command()
def csg(
    model: Annotated[Path, typer.Argument(help="A text file with one s-expression.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="The file to write: a picture, .npz (a baked field) or .stl (a mesh)."),
    ],
    size: Annotated[
        Any, typer.Option(parser=parse_size, metavar="WxH", help="Size of the picture, pixels.")
    ] = "640x480",
    resolution: Resolution = "128",
    method: Annotated[
        Literal["auto", "whole", "aabb", "octree"],
        typer.Option(help="Method of drawing; all methods give the same picture."),
    ] = "auto",
    direction: Annotated[
        Any, typer.Option(parser=parse_vector, metavar="X,Y,Z", help="Viewing direction of the camera.")
    ] = "-0.6,0.8,-0.6",
    parts: Annotated[bool, typer.Option("--parts", help="List the parts of the decomposition.")] = False,
    device: Device = "auto",
) -> None:
    """Draw, bake or mesh a shape from its s-expression. The z axis points upwards in pictures."""
    shape = fb.csg.parse(model.read_text(encoding="utf-8"))
    if parts:
        found = fb.csg.decompose(shape, "aabb" if method == "aabb" else "octree")
        table = Table("boxes", "part", title=f"{len(found)} parts, {found.structures} structures", title_justify="left")
        for part in found:
            table.add_row(str(len(part.boxes)), escape(repr(part.shape)))
        out.print(table)
    suffix = output.suffix.lower()
    if suffix in (".npz", ".stl"):
        volume = fb.bake(shape, resolution, device=device, progress=err.is_terminal)
        if suffix == ".npz":
            volume.save(output)
        else:
            mesh = volume.to_mesh().to_trimesh()
            with atomic_write(output) as stream:
                mesh.export(stream, file_type="stl")
        out.print(f"[bold]{escape(str(output))}[/]  {escape(repr(volume))}", soft_wrap=True)
        return
    camera = fb.Camera.fit(shape.bounds, direction=direction, up=(0, 0, 1), aspect=size[0] / size[1])
    frame = fb.raymarch(shape, camera, size=size, method=method, device=device, progress=err.is_terminal)
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


def _check_output(output: Path, endings: tuple[str, ...], option: str = "--output") -> None:
    """Fail before any work if the output could not be written at its end."""
    if output.suffix.lower() not in endings:
        raise typer.BadParameter(f"'{output}' must end in {listed(endings)}", param_hint=option)
    check_target(output)


def _check_encoding(output: Path, encoding: str) -> None:
    if output.suffix.lower() == ".nrrd" and encoding != "float32":
        raise typer.BadParameter(f".nrrd files hold float32, got {encoding}", param_hint="--encoding")


def show_rows(title: str, rows: list[tuple[str, str]]) -> None:
    """Print labels and texts as a table."""
    table = Table(title=escape(title), title_justify="left", show_header=False, title_style="bold")
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in rows:
        table.add_row(label, escape(text), style="yellow" if label == "warning" else None)
    out.print(table)


def _box_text(bounds: Any) -> str:
    lower, upper = ("(" + ", ".join(f"{x:.5g}" for x in corner) + ")" for corner in bounds)
    return f"{lower} to {upper}"


def _volume_rows(volume: fb.Volume | fb.SparseVolume) -> list[tuple[str, str]]:
    nx, ny, nz = volume.resolution
    size = bytes_text(volume.nbytes)
    if isinstance(volume, fb.Volume):
        stored = f"{size} as {volume.encoding}" if isinstance(volume, fb.QuantizedVolume) else size
        low, high = float(volume.distances.min()), float(volume.distances.max())
        contents = [("distances", f"{low:.5g} to {high:.5g}")]
    else:
        stored = f"{size} as {volume.encoding}, {volume.nbytes / (4 * nx * ny * nz):.1%} of a dense volume"
        counts = volume.brick_counts.items()
        contents = [
            ("bricks", ", ".join(f"{count:,} with cells of {side}" for side, count in counts if count) or "none"),
            ("band", f"{volume.band:.5g}"),
        ]
    rows = [
        ("voxels", f"{nx} x {ny} x {nz}, {stored}"),
        ("voxel size", " x ".join(f"{side:.5g}" for side in volume.spacing)),
        ("box", _box_text(volume.bounds)),
        ("surface box", _box_text(volume.inner_bounds)),
        *contents,
    ]
    return rows + (volume.report.rows() if volume.report.sign_method else [])


def _atlas_rows(atlas: fb.Atlas, ending: str) -> list[tuple[str, str]]:
    count, size = len(atlas.pages), atlas.page_size
    rule = texel_rule(ending, atlas.encoding)
    rows = [
        ("pages", f"{count} of {size} x {size} {atlas.encoding}, {bytes_text(atlas.nbytes)}, {atlas.fill:.0%} full"),
        ("texels", f"{rule['texel']}, {rule['decode']}"),
        ("layout", atlas.layout if atlas.layout == "strips" else f"{atlas.layout}, gutter {atlas.gutter}"),
    ]
    for i in atlas.indices:
        entry = atlas.entries[i]
        shape = " x ".join(map(str, atlas.resolution(i)))
        place = f"page {entry['atlas_index']}, offset {entry['atlas_offset']}"
        rows.append((f"volume {i}", f"{shape} voxels, {place}"))
    return rows


def _mesh_rows(mesh: fb.Mesh) -> list[tuple[str, str]]:
    rows = [
        ("vertices", f"{len(mesh.vertices):,}"),
        ("faces", f"{len(mesh.faces):,}"),
        ("box", _box_text(mesh.bounds)),
        ("memory", bytes_text(mesh.nbytes)),
    ]
    facts = mesh.topology()
    rows.append(("closed", "yes" if facts.pop("closed") else "no"))
    rows += [(name.replace("_", " "), f"{count:,}") for name, count in facts.items()]
    rows += [("part", f"{part.name or '-'}: {len(part.faces):,} faces, {part.alpha_mode}") for part in mesh.parts]
    return rows


def main() -> None:
    """Run the command line."""
    # What deserves a warning is a row of the tables that commands print.
    warnings.simplefilter("ignore", fb.SurfaceWarning)
    app(prog_name="fieldbake")
