"""The commands ``bake``, ``merge`` and ``pack``, and the options and tables that commands share."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import fieldbake as fb

from ..atlases.atlas import as_written
from ..base import encodings
from ..base.languages import Language
from ..files.registry import ENDINGS
from ..queries.common import Sign
from ..scaling import library
from ..volumes import writers
from .application import app, err, show_rows
from .shared.folders import bake_folder
from .shared.saving import Encoding, Engine, check_encoding, save_field
from .shared.shapes import geometry_in_file, shape_in_file
from .shared.streams import check_output, input_file, is_stream, output_file
from .shared.tables import atlas_rows, volume_rows

#: Endings of meshes that can be written.
MESHES = (".stl", ".obj", ".ply", ".glb", ".3mf")

Device = Annotated[str, typer.Option(help='Compute device: "auto", "cpu", "gpu" or a name from `fieldbake devices`.')]


def parse_resolution(text: str) -> int | tuple[int, int, int]:
    """Parse a resolution: ``64`` or ``64x48x32``."""
    try:
        sides = [int(side) for side in text.lower().split("x")]
    except ValueError:
        sides = []
    if len(sides) == 1:
        return sides[0]
    if len(sides) == 3:
        return sides[0], sides[1], sides[2]
    raise typer.BadParameter(f"'{text}' is not a number such as 64, nor three such as 64x48x32")


def parse_bounds(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Parse the lower and the upper corner of a box: ``-1,-1,-1,1,1,1``."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 6:
        raise typer.BadParameter(f"'{text}' is not six numbers such as -1,-1,-1,1,1,1")
    return tuple(numbers[:3]), tuple(numbers[3:])


def parse_page_size(text: str) -> int | Literal["fit"]:
    """Parse the size of a page: ``4096`` or ``fit``."""
    if text == "fit":
        return "fit"
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a number such as 4096, nor fit") from None


def parse_size(text: str) -> tuple[int, int]:
    """Parse the width and the height of a picture: ``640x480``."""
    try:
        width, height = (int(side) for side in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if min(width, height) < 1:
        raise typer.BadParameter(f"'{text}' is not a size such as 640x480")
    return width, height


def parse_vector(text: str) -> tuple[float, float, float]:
    """Parse three numbers: ``1,2.5,-3``."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not three numbers such as 1,2.5,-3") from None
    return x, y, z


def resolution_option(example: int) -> Any:
    """Make the option ``--resolution``; its help has `example` as the number of voxels along the longest side."""
    three = f"{example}x{example // 2}x{example // 4}"
    text = f"Voxels along the longest side ({example}), or along x, y and z ({three})."
    return typer.Option("--resolution", "-r", parser=parse_resolution, metavar="N|NxNxN", help=text)


Resolution = Annotated[Any, resolution_option(64)]


@app.command()
def bake(
    mesh: Annotated[
        list[Path],
        typer.Argument(
            help="Meshes or shapes (.csg or implicit .3mf): baked into one field, or into a folder one by one. - reads "
            "standard input.",
            metavar="MESH",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help=f"The file to write: {', '.join(ENDINGS['volume'])}; with --sparse {', '.join(ENDINGS['sparse'])}. "
            "A folder: one file for each mesh. - is standard output.",
        ),
    ],
    resolution: Resolution = "64",
    voxel_size: Annotated[
        float | None, typer.Option(help="Side of a cubic voxel, world units; replaces --resolution.")
    ] = None,
    margin: Annotated[float, typer.Option(help="Margin around the mesh, as a fraction of its box.")] = 0.1,
    sign: Annotated[Sign, typer.Option(help="Method that decides between inside and outside.")] = "auto",
    band: Annotated[
        float | None,
        typer.Option(
            help="Distances are exact within this many voxels of the surface, and lower bounds beyond. It is also the "
            "half width of the level set in .vdb and .nvdb (3), and of snorm and unorm encodings (4)."
        ),
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
        Encoding,
        typer.Option(help="Encoding of the stored samples; unorm8 for .dds and .ktx2."),
    ] = "float32",
    bounds: Annotated[
        Any,
        typer.Option(parser=parse_bounds, metavar="X,Y,Z,X,Y,Z", help="Lower and upper corner of the box to sample."),
    ] = None,
    engine: Engine = None,
    mipmaps: Annotated[bool, typer.Option("--mipmaps", help="Add coarser levels to .dds and .ktx2.")] = False,
    source: Annotated[str | None, typer.Option("--from", help="Format of the mesh if MESH is -, such as glb.")] = None,
    kind: Annotated[
        str, typer.Option("--to", help="Format of the output if it is - or a folder, such as vdb.")
    ] = "npz",
    jobs: Annotated[
        int | None,
        typer.Option(help="Number of meshes baked at the same time; for a folder. The default is one per core."),
    ] = None,
    limit_s: Annotated[
        float | None, typer.Option("--limit", help="Time limit for each mesh, seconds; for a folder.")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Bake all meshes again, even if their results are up to date; for a folder.")
    ] = False,
    device: Device = "auto",
) -> None:
    """Bake the signed distance field of a mesh into a file, or the fields of many meshes into a folder."""
    if not is_stream(output) and (not output.suffix or output.is_dir()):
        if sparse or engine is not None or mipmaps:
            raise typer.BadParameter(
                "do not apply to the files in a folder", param_hint="--sparse, --engine, --mipmaps"
            )
        check_encoding(f".{kind.lstrip('.')}", encoding)
        options = {"resolution": resolution, "voxel_size": voxel_size, "margin": margin, "sign": sign, "band": band}
        if voxel_size is not None:
            del options["resolution"]
        options |= {"two_sided": two_sided, "thickness": thickness, "device": device, "format": kind}
        options |= {"bounds": bounds, "encoding": None if encoding == "float32" else encoding}
        bake_folder(mesh, output, options, jobs=jobs, limit_s=limit_s, fresh=fresh)
        return
    if jobs is not None or limit_s is not None or fresh:
        raise typer.BadParameter(f"'{output}' is a file; these options are for a folder", param_hint="--jobs, --limit")
    known = ENDINGS["sparse" if sparse else "volume"]
    check_output(output, known)
    ending = f".{kind.lstrip('.')}" if is_stream(output) else output.suffix.lower()
    if ending not in known:
        raise typer.BadParameter(f"'{kind}' is not one of {', '.join(known)}", param_hint="--to")
    if not sparse:
        check_encoding(ending, encoding)
    surface: dict[str, Any] = {
        "voxel_size": voxel_size,
        "margin": margin,
        "bounds": bounds,
        "sign": sign,
        "two_sided": two_sided,
        "thickness": thickness,
        "progress": err.is_terminal,
    }
    volume: fb.Volume | fb.SparseVolume
    with ExitStack() as stack:
        paths = [stack.enter_context(input_file(path, source)) for path in mesh]
        target = stack.enter_context(output_file(output, ending))
        geometries: Any = [geometry_in_file(path) for path in paths]
        if len(paths) == 1:
            (geometries,) = geometries
        if sparse:
            if device not in ("auto", "cpu"):
                raise typer.BadParameter("bricks are baked on the CPU", param_hint="--device")
            if encoding == "unorm8":
                raise typer.BadParameter("unorm8 is for textures, and not for bricks", param_hint="--encoding")
            bricks: dict[str, Any] = {"tolerance": tolerance, "encoding": encoding, **surface}
            # Bricks have all distances up to their band minus half the diagonal of a voxel. A level set from them needs
            # a band that is wider by a voxel.
            reach = 4.0 if band is None else band + (ending in ENDINGS["sparse"][1:])
            volume = fb.bake_sparse(geometries, resolution, band=reach, **bricks)
            volume = save_field(volume, target, None, band, engine, mipmaps=mipmaps)
        else:
            volume = fb.bake(geometries, resolution, band=band, device=device, **surface)
            requested = None if encoding == "float32" else encoding
            is_texture = ending in writers.MIPMAPPED
            is_stored = ending == ".npz" or (ending in writers.BANDED and not (is_texture and requested is None))
            volume = save_field(volume, target, requested, band if is_stored else None, engine, mipmaps=mipmaps)
    if not is_stream(output):
        show_rows(f"{output}", volume_rows(volume))


@app.command()
def merge(
    scene: Annotated[Path, typer.Argument(help="A glTF or GLB scene, or any mesh or shape file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help=f"The file to write: {', '.join(ENDINGS['volume'])}.")],
    resolution: Resolution = "128",
    device: Device = "auto",
) -> None:
    """Merge all instances of a scene into one field whose samples never exceed the distance."""
    check_output(output, ENDINGS["volume"])
    is_scene = scene.suffix.lower() in (".gltf", ".glb")
    geometries: Any
    if is_scene:
        geometries = fb.load_scene(scene)
    else:
        shape = shape_in_file(scene)
        geometries = [fb.load_mesh(scene) if shape is None else shape]
    field = fb.merge(geometries, resolution, device=device, progress=err.is_terminal)
    field.save(output)
    show_rows(f"{output}", volume_rows(field.volume))


@app.command()
def pack(
    files: Annotated[
        list[Path], typer.Argument(help="Baked fields (.npz, .dds, ...), and meshes and shapes, which are baked first.")
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
            parser=parse_page_size,
            metavar="N|fit",
            help="Width and height of a page, texels; fit: the smallest power of two that holds all volumes.",
        ),
    ] = "4096",
    gutter: Annotated[int, typer.Option(help="Width of the copied border around each slice, texels.")] = 1,
    encoding: Annotated[encodings.Encoding, typer.Option(help="Encoding of the stored distances.")] = "float32",
    band: Annotated[float, typer.Option(help="Half width of the band that snorm encodings represent, voxels.")] = 4.0,
    shader: Annotated[
        Path | None, typer.Option(help="File for the sampling functions: .wgsl, .glsl, .hlsl or .metal.")
    ] = None,
    device: Device = "auto",
) -> None:
    """Pack baked fields and meshes into a texture atlas."""
    check_output(output, ENDINGS["atlas"])
    languages: dict[str, Language] = {".wgsl": "wgsl", ".glsl": "glsl", ".hlsl": "hlsl", ".metal": "msl"}
    if shader is not None:
        check_output(shader, tuple(languages), "--shader")
    # The article's strips hold cubes.
    sides = (resolution,) * 3 if layout == "strips" and isinstance(resolution, int) else resolution
    volumes = []
    for file in files:
        if file.suffix.lower() in ENDINGS["volume"]:
            volume = fb.load(file)
            if isinstance(volume, fb.SparseVolume):
                volume = volume.to_volume()
            if not isinstance(volume, fb.Volume):
                kind = type(volume).__name__
                raise fb.FormatError(f"{file}: must hold a volume, a mesh or a sparse volume to be packed, got: {kind}")
        else:
            volume = fb.bake(geometry_in_file(file), sides, device=device, progress=err.is_terminal)
        volumes.append(volume)
    atlas = fb.pack(
        volumes,
        layout=layout,
        page_size=page_size,
        gutter=gutter,
        encoding=encoding,
        band=band,
        progress=err.is_terminal,
        names=[stem for stem, _ in library.distinct_stems([(file.stem, file) for file in files])],
    )
    ending = output.suffix.lower()
    atlas = as_written(atlas, ending)
    atlas.save(output)
    if shader is not None:
        text = atlas.shader(languages[shader.suffix.lower()], texels="png" if ending == ".png" else "pages")
        shader.write_text(text, encoding="utf-8")
    show_rows(f"{output}", atlas_rows(atlas, ending))
