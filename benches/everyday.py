"""Everyday costs: imports, the command line, files, conversions of volumes, samples, and the first picture of a mesh.

    python benches/everyday.py [mesh]

Prints the least elapsed and processor time of several runs in turns. Where a line names a reference, it is the same
work by that tool, or a copy of as many bytes by NumPy.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fieldbake as fb
from measuring import absent, interleaved, record
from meshes import find, load

ROUNDS = 5


def show(name: str, job: Callable[[], Any], reference: str = "", peer: Callable[[], Any] | None = None) -> None:
    """Measure a job beside its reference, and print a line."""
    times = interleaved({"ours": job, "theirs": peer} if peer else {"ours": job}, ROUNDS)
    ours = times["ours"]
    line = f"| {name} | {ours.least * 1e3:.1f} | {ours.least_cpu * 1e3:.1f} |"
    if peer:
        theirs = times["theirs"]
        line += f" {reference}: {theirs.least * 1e3:.1f} | {theirs.least / ours.least:.2f} |"
        if reference not in ("import numpy", "copy"):
            record(name, reference, ours.least, theirs.least)
    else:
        line += " | |"
    print(line, flush=True)


def processes() -> None:
    """Imports and the command line, each in a new process."""

    def python(code: str) -> Callable[[], object]:
        return lambda: subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)

    show("import fieldbake", python("import fieldbake"), "import numpy", python("import numpy"))
    cli = "import sys; from fieldbake.cli import main; sys.argv = ['fieldbake', '--version']; main()"
    show("fieldbake --version", python(cli), "import numpy", python("import numpy"))
    show("fieldbake --help", python(cli.replace("version", "help")), "import numpy", python("import numpy"))


def files(folder: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Atlases, meshes and scenes."""
    random = np.random.default_rng(0)
    values = random.uniform(-1, 1, (64, 64, 64, 64)).astype(np.float32)
    smooth = fb.bake(fb.Mesh(vertices, faces), (64, 64, 64)).distances
    atlas = fb.pack([fb.Volume(smooth + 0.01 * i, [(0, 0, 0), (1, 1, 1)]) for i in range(len(values))], page_size=2048)
    size = f"{len(atlas.pages)} pages of {atlas.page_size}^2"
    for ending in (".npz", ".exr", ".png"):
        show(f"save an atlas, {size}, {ending}", lambda ending=ending: atlas.save(folder / f"atlas{ending}"))
    mesh = fb.Mesh(vertices, faces)
    for ending in (".obj", ".ply", ".stl", ".glb"):
        mesh.save(folder / f"mesh{ending}")
    long = fb.models.torus_knot(segments=2000, sides=160)
    long.save(folder / "long.glb")
    try:
        import trimesh
    except ImportError as error:
        absent("trimesh", error)
        return
    for ending in (".obj", ".ply", ".stl", ".glb"):
        path = folder / f"mesh{ending}"
        read = lambda path=path: trimesh.load(path, force="mesh", process=False)  # noqa: E731
        show(f"load a mesh, {len(faces):,} faces, {ending}", lambda path=path: fb.load_mesh(path), "trimesh", read)
    path = folder / "long.glb"
    megabytes = path.stat().st_size / 1e6
    show(f"load a scene, {megabytes:.0f} MB .glb", lambda: fb.load_scene(path), "trimesh", lambda: trimesh.load(path))


def volumes(mesh: fb.Mesh) -> None:
    """Samples and conversions of a volume of 256^3."""
    volume = fb.bake(mesh, (256, 256, 256))
    sparse, coded = fb.bake_sparse(mesh, 256), volume.quantize("snorm16")
    decoded = lambda: coded.distances  # noqa: E731
    copy = volume.distances.copy
    show("quantize, snorm16, 256^3", lambda: volume.quantize("snorm16"), "copy", copy)
    show("quantize, float16, 256^3", lambda: volume.quantize("float16"), "copy", copy)
    show("decode snorm16, 256^3", decoded, "copy", copy)
    show("to_volume of sparse, 256^3", sparse.to_volume, "copy", copy)
    show("downsample, 256^3", volume.downsample, "copy", copy)

    lower, upper = volume.bounds
    points = np.random.default_rng(0).uniform(lower, upper, (2_000_000, 3))
    show("gradient, 2 M random points", lambda: volume.gradient(points))
    try:
        from scipy.ndimage import map_coordinates
    except ImportError as error:
        absent("scipy", error)
        return
    grid = np.ascontiguousarray(volume.distances)
    scaled = lambda: map_coordinates(grid, ((points - volume.origin) / volume.spacing).T, order=1)  # noqa: E731
    fb.set_threads(1)
    show("sample, 2 M random points, one thread", lambda: volume.sample(points), "scipy", scaled)
    show("gradient, 2 M random points, one thread", lambda: volume.gradient(points))


def first_picture(path: Path) -> None:
    """A mesh from its file to its picture, in one process."""
    show(
        f"load, bake at 64 and draw {path.name}, 640 x 480 pixels",
        lambda: fb.raymarch(fb.bake(fb.load_mesh(path), 64), size=(640, 480)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", nargs="?", type=Path)
    options = parser.parse_args()
    name, vertices, faces = load(options.mesh) if options.mesh else next(find())
    print(f"{name}, {len(faces):,} faces; the least of {ROUNDS} runs\n")
    print("| job | ms | processor ms | reference, ms | ratio |\n|---|---|---|---|---|")
    processes()
    with tempfile.TemporaryDirectory() as folder:
        files(Path(folder), vertices, faces)
        first_picture(Path(folder) / "mesh.obj")
    volumes(fb.Mesh(vertices, faces))


if __name__ == "__main__":
    main()
