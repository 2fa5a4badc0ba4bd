"""Every sample of a grid around every model against float64: distances by brute force, sides by the winding number.

    python benches/exactness.py                      # every readable file of the mesh folder, 48^3
    python benches/exactness.py --mesh bunny.obj -r 64 --device gpu

Distances are computed by the small Rust library in `brute/`, which visits every triangle; exact winding numbers by
libigl. Sides are compared on closed meshes, where the distance exceeds 1e-6 of the box's diagonal.
"""

import argparse
import ctypes
import datetime
import subprocess
from pathlib import Path

import numpy as np

import meshes
from measuring import machine
from peers import HERE


def brute_library() -> ctypes.CDLL:
    """Build the library, once."""
    folder = HERE / "brute"
    subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=folder, check=True)
    built = [path for path in (folder / "target/release").glob("*fieldbake_bench_brute*") if path.suffix != ".d"]
    return ctypes.CDLL(str(built[0]))


def distances(brute: ctypes.CDLL, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Unsigned distance of each point to the nearest triangle."""
    doubles = ctypes.POINTER(ctypes.c_double)
    corners, points = np.ascontiguousarray(triangles, float), np.ascontiguousarray(points, float)
    out = np.empty(len(points))
    brute.brute_distances(
        corners.ctypes.data_as(doubles),
        ctypes.c_size_t(len(corners)),
        points.ctypes.data_as(doubles),
        ctypes.c_size_t(len(points)),
        out.ctypes.data_as(doubles),
    )
    return out


def row(brute: ctypes.CDLL, path: Path, resolution: int, device: str) -> str:
    """A line of the table, or the reason why it is missing."""
    import igl

    import fieldbake as fb

    try:
        mesh = fb.load_mesh(path)
    except fb.MeshError as error:
        return f"| {path.name} | refused: {type(error).__name__} | | | |"
    volume = fb.bake(mesh, (resolution,) * 3, device=device)
    axes = [volume.origin[a] + volume.spacing[a] * np.arange(resolution) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    vertices, faces = mesh.vertices.astype(float), mesh.faces.astype(np.int64)
    values = volume.distances.reshape(-1)
    exact = distances(brute, vertices[faces], points)
    diagonal = np.linalg.norm(volume.bounds[1] - volume.bounds[0])
    error = np.abs(np.abs(values) - exact).max() / diagonal
    signs = "open"
    if volume.report.closed:
        winding = igl.winding_number(vertices, faces, points)
        clear = exact > 1e-6 * diagonal
        wrong = ((values < 0) != (np.abs(winding) > 0.5)) & clear
        signs = f"{wrong.sum()} of {clear.sum():,}"
    return f"| {path.name} | {len(faces):,} | {error:.1e} | {signs} | {volume.report.device} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, action="append", help="a mesh file; the whole mesh folder if not given")
    parser.add_argument("-r", "--resolution", type=int, default=48)
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "-o", "--output", type=Path, help="Markdown file; benches/results/DATE-exactness.md if not given"
    )
    arguments = parser.parse_args()

    files = (path for folder in meshes.FOLDERS for path in sorted(folder.rglob("*")))
    chosen = arguments.mesh or [path for path in files if path.suffix in {".obj", ".ply", ".stl", ".glb"}]
    if not chosen:
        parser.error("there are no meshes; name one by --mesh, or a folder by FIELDBAKE_MESHES")
    brute = brute_library()
    today = datetime.date.today().isoformat()
    text = f"# Exactness, {today}\n\n{machine()}. "
    text += f"Every sample of {arguments.resolution}^3 against float64 brute force.\n\n"
    text += "| mesh | faces | max error / diagonal | wrong sides | device |\n|---|---|---|---|---|\n"
    print(text, end="")
    for path in chosen:
        line = row(brute, path, arguments.resolution, arguments.device)
        print(line, flush=True)
        text += line + "\n"
    output = arguments.output or HERE / "results" / f"{today}-exactness.md"
    output.write_text(text)


if __name__ == "__main__":
    main()
