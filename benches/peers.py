"""Signed distance grids side by side with other tools: same mesh, same samples, same threads, one process.

    make bench                                      # bunny, armadillo, spot (and dragon if it is there) at 64 and 128
    python benches/peers.py --mesh bunny.obj -r 64  # any mesh
    python benches/peers.py -p 1 -p 1000000         # random points instead of grids; a single one is the tree's build

Runs are interleaved, so that a machine that slows down slows everything; medians are compared as ratios. Each time
includes the tool's own tree. Memory is the peak of a process of its own, above its level when mesh and samples are
there. Errors are against float64: distances by libigl's tree, signs by its exact winding number, at random samples
of the grid. Signs are judged where the distance exceeds 1e-6 of the diagonal; on an open mesh the winding number
is a convention, which tools for closed meshes do not share.
"""

import argparse
import ctypes
import datetime
import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import meshes
from measuring import absent, interleaved, machine, peak_mib, record, reset_peak

HERE = Path(__file__).parent
MARGIN = 1.1
#: Number of checked samples. A fault of one sample in a thousand is found. For large meshes the exact winding number of
#: all checked samples takes half a minute.
CHECKED = 50_000
CHECKED_TIMES_FACES = 6e9
#: Voxels on both sides of the surface, for tools that find a band only.
BAND = 3
#: trimesh needs about 0.2 ms a point, and minutes for the tree of a mesh with more faces than this.
TRIMESH_POINTS = 1_000
TRIMESH_FACES = 200_000


@dataclass
class Case:
    """A mesh, and the samples of a grid around it with z fastest, or random points in the same box."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    resolution: int = 0
    random_points: int = 0

    def __post_init__(self) -> None:
        lower, upper = self.vertices.min(0).astype(float), self.vertices.max(0).astype(float)
        half = (upper - lower).max() / 2 * MARGIN
        center = (lower + upper) / 2
        self.bounds = np.array([center - half, center + half])
        if self.random_points:
            self.points = np.random.default_rng(1).uniform(*self.bounds, (self.random_points, 3))
            self.points32 = self.points.astype(np.float32)
            self.points = self.points32.astype(np.float64)
            self.diagonal = float(np.linalg.norm(self.bounds[1] - self.bounds[0]))
            return
        axes = [self.bounds[0, a] + (np.arange(self.resolution) + 0.5) * 2 * half / self.resolution for a in range(3)]
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        self.points32 = self.points.astype(np.float32)
        self.diagonal = float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def samples(self) -> str:
        """Description of the samples for headings."""
        return f"{self.random_points:,} random points" if self.random_points else f"{self.resolution}^3"


#: The values, or a way to collect them that is not the tool's own work and is not timed.
Run = Callable[[Case], "np.ndarray | Callable[[], np.ndarray]"]

#: Tools that return unsigned distances.
UNSIGNED = {"FCPW, unsigned", "fieldbake, unsigned"}

#: Tools that compute less than signed distances: the job of fieldbake that they are compared with, and its name.
OURS = {
    "FCPW, unsigned": ("fieldbake, unsigned", "unsigned distances"),
    "OpenVDB, band=3": ("fieldbake, band=3", "a band of 3 voxels"),
}


def fieldbake(case: Case, sign: str = "auto") -> np.ndarray:
    import fieldbake as fb

    if case.random_points:
        return fb.signed_distance((case.vertices, case.faces), case.points32, sign=sign)
    volume = fb.bake((case.vertices, case.faces), (case.resolution,) * 3, bounds=case.bounds, sign=sign)
    return volume.distances


def fieldbake_unsigned(case: Case) -> np.ndarray:
    return fieldbake(case, "unsigned")


def fieldbake_band(case: Case) -> np.ndarray:
    import fieldbake as fb

    return fb.bake((case.vertices, case.faces), (case.resolution,) * 3, bounds=case.bounds, band=BAND).distances


def open3d(case: Case) -> np.ndarray:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(case.vertices), o3d.core.Tensor(case.faces))
    return scene.compute_signed_distance(o3d.core.Tensor(case.points32)).numpy()


def fcpw(case: Case) -> Callable[[], np.ndarray]:
    import fcpw as package

    scene = package.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.asfortranarray(case.vertices), 0)
    scene.set_object_triangles(np.asfortranarray(case.faces.astype(np.int32)), 0)
    scene.build(package.aggregate_type.bvh_surface_area, True)
    found = package.interaction_3D_list()
    points = np.asfortranarray(case.points32)
    scene.find_closest_points(points, np.full(len(points), np.inf, np.float32), found)
    return lambda: np.array([interaction.d for interaction in found], np.float32)


def libigl(case: Case) -> np.ndarray:
    import igl

    vertices, faces = case.vertices.astype(np.float64), case.faces.astype(np.int64)
    tree, winding = igl.AABB(), igl.FastWindingNumberBVH()
    tree.init(vertices, faces)
    winding.init(vertices, faces)
    unsigned = np.sqrt(tree.squared_distance(vertices, faces, case.points)[0])
    # The sign alone: libigl's own signed distance multiplies by 1 - 2w, which is off where w is not whole.
    return np.where(np.asarray(winding.winding_number(case.points)) > 0.5, -unsigned, unsigned)


def pysdf(case: Case) -> np.ndarray:
    from pysdf import SDF

    return -SDF(case.vertices, case.faces)(case.points32)


def warp() -> Run:
    """Closest points with the sign of the fast winding number, on one thread: its kernels use no more on a CPU."""
    import warp as wp

    wp.config.quiet = True

    @wp.kernel
    def signed(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.float32)):
        i = wp.tid()
        found = wp.mesh_query_point_sign_winding_number(mesh, points[i], 1.0e30)
        out[i] = found.sign * wp.length(points[i] - wp.mesh_eval_position(mesh, found.face, found.u, found.v))

    def run(case: Case) -> np.ndarray:
        with wp.ScopedDevice("cpu"):
            points, faces = wp.array(case.vertices, dtype=wp.vec3), wp.array(case.faces.ravel().astype(np.int32))
            mesh = wp.Mesh(points=points, indices=faces, support_winding_number=True)
            samples = wp.array(case.points32, dtype=wp.vec3)
            out = wp.empty(len(samples), dtype=wp.float32)
            wp.launch(signed, dim=len(samples), inputs=[mesh.id, samples, out])
            return out.numpy()

    return run


def parry() -> Run:
    """Build the small Rust library beside this file, once."""
    folder = HERE / "parry"
    subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=folder, check=True)
    built = [path for path in (folder / "target/release").glob("*fieldbake_bench_parry*") if path.suffix != ".d"]
    library = ctypes.CDLL(str(built[0]))
    library.parry_build.restype = ctypes.c_void_p
    floats, indices = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint32)

    def run(case: Case) -> np.ndarray:
        mesh = library.parry_build(
            case.vertices.ctypes.data_as(floats),
            ctypes.c_size_t(len(case.vertices)),
            case.faces.ctypes.data_as(indices),
            ctypes.c_size_t(len(case.faces)),
        )
        if not mesh:
            raise RuntimeError("parry refuses this mesh")
        out = np.empty(len(case.points32), np.float32)
        library.parry_signed_distance(
            ctypes.c_void_p(mesh),
            case.points32.ctypes.data_as(floats),
            ctypes.c_size_t(len(out)),
            out.ctypes.data_as(floats),
        )
        library.parry_free(ctypes.c_void_p(mesh))
        return out

    return run


def openvdb() -> Run:
    """The narrow band of `openvdb/band.cpp`, built once. It exists for grids only."""
    folder = HERE / "openvdb"
    built = folder / "target" / "libband.so"
    built.parent.mkdir(exist_ok=True)
    compiler = ["g++", "-O3", "-DNDEBUG", "-std=c++17", "-shared", "-fPIC", "band.cpp", "-o", str(built)]
    subprocess.run([*compiler, "-lopenvdb", "-ltbb"], cwd=folder, check=True, capture_output=True)
    library = ctypes.CDLL(str(built))
    library.band_of_mesh.restype = ctypes.c_void_p
    floats, indices = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint32)

    def run(case: Case) -> Callable[[], np.ndarray]:
        spacing = (case.bounds[1] - case.bounds[0])[0] / case.resolution
        vertices = ((case.vertices - case.bounds[0]) / spacing - 0.5).astype(np.float32)
        grid = ctypes.c_void_p(
            library.band_of_mesh(
                vertices.ctypes.data_as(floats),
                ctypes.c_size_t(len(vertices)),
                case.faces.ctypes.data_as(indices),
                ctypes.c_size_t(len(case.faces)),
                ctypes.c_float(BAND),
                ctypes.c_double(spacing),
            )
        )

        def samples() -> np.ndarray:
            out = np.empty((case.resolution,) * 3, np.float32)
            library.band_samples(grid, ctypes.c_uint32(case.resolution), out.ctypes.data_as(floats))
            library.band_free(grid)
            return out

        return samples

    return run


def trimesh_points(case: Case) -> np.ndarray:
    """A few points only; scaled to size 100, below which its closest point is off by up to 0.2 %."""
    import trimesh

    scale = 100 / case.diagonal
    mesh = trimesh.Trimesh(case.vertices * scale, case.faces, process=False)
    return -trimesh.proximity.signed_distance(mesh, checked(case, TRIMESH_POINTS)[1] * scale) / scale


def peers(names: list[str] | None = None) -> dict[str, Run]:
    """All installed tools, or those that are named; missing ones are listed with the reason."""
    wanted: dict[str, Callable[[], Run]] = {
        "fieldbake": lambda: fieldbake,
        "fieldbake, unsigned": lambda: fieldbake_unsigned,
        "fieldbake, band=3": lambda: fieldbake_band,
        "OpenVDB, band=3": openvdb,
        "parry3d": parry,
        "Open3D": lambda: open3d,
        "FCPW, unsigned": lambda: fcpw,
        "libigl": lambda: libigl,
        "pysdf": lambda: pysdf,
        "warp, one thread": warp,
        "trimesh": lambda: trimesh_points,
    }
    tiny = Case("tiny", *_tetrahedron(), 4)
    found = {}
    for name, make in wanted.items():
        if names is not None and name not in names:
            continue
        try:
            run = make()
            run(tiny)
        except Exception as error:
            absent(name, error)
        else:
            found[name] = run
    return found


def _tetrahedron() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
    return corners, np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.uint32)


def checked(case: Case, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random samples of the grid: their numbers and positions."""
    rows = np.random.default_rng(0).choice(len(case.points), min(count, len(case.points)), replace=False)
    return rows, case.points[rows]


def truth(case: Case, count: int) -> tuple[np.ndarray, np.ndarray]:
    """float64 distance and exact winding number at so many checked samples."""
    import igl

    vertices, faces = case.vertices.astype(np.float64), case.faces.astype(np.int64)
    tree = igl.AABB()
    tree.init(vertices, faces)
    points = checked(case, count)[1]
    distances = np.sqrt(tree.squared_distance(vertices, faces, points)[0])
    return distances, np.abs(igl.winding_number(vertices, faces, points))


def judge(case: Case, name: str, values: np.ndarray, exact: np.ndarray, winding: np.ndarray) -> dict[str, Any]:
    """Largest error as a fraction of the diagonal, and number of wrong signs."""
    error = np.abs(np.abs(values) - exact)
    if "band" in name:
        error = error[exact <= BAND * (case.bounds[1] - case.bounds[0])[0] / case.resolution]
    clear = exact > 1e-6 * case.diagonal
    wrong = ((values < 0) != (winding > 0.5)) & clear
    facts = {"error": float(error.max() / case.diagonal), "checked": int(clear.sum())}
    return facts if name in UNSIGNED else {**facts, "wrong": int(wrong.sum())}


def peak_of(case: Case, name: str) -> float:
    """Peak memory of a tool in a process of its own, above the level before it starts, MiB."""
    code = "import peers, sys; print(peers.own_peak_mib(sys.stdin.buffer, sys.argv[1], *map(int, sys.argv[2:])))"
    numbers = [str(n) for n in (case.resolution, case.random_points, len(case.vertices))]
    mesh = case.vertices.tobytes() + case.faces.tobytes()
    command = [sys.executable, "-c", code, name, *numbers]
    done = subprocess.run(command, input=mesh, cwd=HERE, capture_output=True, check=True)
    return float(done.stdout.split()[-1])


def own_peak_mib(mesh: Any, name: str, resolution: int, random_points: int, vertex_count: int) -> float:
    """The same, in that process; `mesh` streams float32 vertices, then uint32 faces."""
    vertices = np.frombuffer(mesh.read(12 * vertex_count), np.float32).reshape(-1, 3)
    faces = np.frombuffer(mesh.read(), np.uint32).reshape(-1, 3)
    case = Case("mesh", vertices, faces, resolution, random_points)
    # Its library, its threads.
    run = peers([name])[name]
    reset_peak()
    before = peak_mib()
    run(case)
    return peak_mib() - before


def measure(case: Case, runs: dict[str, Run], repetitions: int) -> list[dict[str, Any]]:
    """Times and errors of every tool, the runs in turn."""
    if case.random_points:
        # A band exists for grids only. trimesh takes a fifth of a millisecond per point.
        runs = {name: run for name, run in runs.items() if "band" not in name and name != "trimesh"}
    if len(case.faces) > TRIMESH_FACES:
        runs = {name: run for name, run in runs.items() if name != "trimesh"}
    times = interleaved({name: lambda run=run: run(case) for name, run in runs.items()}, repetitions)
    values = {name: took.result() if callable(took.result) else took.result for name, took in times.items()}
    many = min(CHECKED, int(CHECKED_TIMES_FACES / len(case.faces)))
    sampled = checked(case, many)[0]
    usual, few = truth(case, many), truth(case, TRIMESH_POINTS)
    base = times["fieldbake"].median
    rows = []
    for name in runs:
        median = times[name].median
        count = min(TRIMESH_POINTS, len(case.points)) if name == "trimesh" else len(case.points)
        rows.append(
            {
                "tool": name,
                "seconds": median,
                "nanoseconds": median / count * 1e9,
                # Per sample, so that tools that computed only some samples are comparable.
                "ratio": (median / count) / (base / len(case.points)),
                "threads": statistics.median(times[name].cpu) / median,
                "peak_mib": peak_of(case, name),
                **(
                    judge(case, name, values[name], *few)
                    if name == "trimesh"
                    else judge(case, name, values[name].reshape(-1)[sampled], *usual)
                ),
            }
        )
    for row in rows:
        ours, question = OURS.get(row["tool"], ("fieldbake", "signed distances"))
        if not row["tool"].startswith("fieldbake"):
            took = next(other["nanoseconds"] for other in rows if other["tool"] == ours)
            peer, seconds = row["tool"].split(",")[0], 1e-9 * row["nanoseconds"]
            record(f"{question}, {case.name}, {case.samples}", peer, 1e-9 * took, seconds)
    return rows


def table(case: Case, rows: list[dict[str, Any]]) -> str:
    columns = [
        "tool",
        "time",
        "ns a sample",
        "times fieldbake",
        "threads busy",
        "peak",
        "error / diagonal",
        "wrong signs",
    ]
    lines = [
        f"### {case.name}, {len(case.faces):,} faces, {case.samples}",
        "",
        "| " + " | ".join(columns) + " |",
        "|---" * len(columns) + "|",
    ]
    for row in sorted(rows, key=lambda row: row["ratio"]):
        signs = f"{row['wrong']} of {row['checked']:,}" if "wrong" in row else ""
        lines.append(
            f"| {row['tool']} | {row['seconds']:.3f} s | {row['nanoseconds']:,.0f} | {row['ratio']:.2f} "
            f"| {row['threads']:.1f} | {row['peak_mib']:,.0f} MiB | {row['error']:.1e} | {signs} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, action="append", help="a mesh file; the usual ones if not given")
    parser.add_argument("-r", "--resolution", type=int, action="append", help="64 and 128 if not given")
    parser.add_argument("-p", "--points", type=int, action="append", help="so many random points instead of a grid")
    parser.add_argument("-n", "--repetitions", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, help="Markdown file; benches/results/DATE-peers.md if not given")
    arguments = parser.parse_args()

    runs = peers()
    chosen = [meshes.load(path) for path in arguments.mesh] if arguments.mesh else list(meshes.find())
    today = datetime.date.today().isoformat()
    text = f"# Peers, {today}\n\n{machine()}. Medians of {arguments.repetitions}, tree included.\n"
    print(text)
    results = []
    for name, vertices, faces in chosen:
        grids = arguments.resolution or ([] if arguments.points else [64, 128])
        cases = [Case(name, vertices, faces, resolution) for resolution in grids]
        cases += [Case(name, vertices, faces, random_points=count) for count in arguments.points or []]
        for case in cases:
            rows = measure(case, runs, arguments.repetitions)
            results.append({"mesh": name, "faces": len(faces), "samples": case.samples, "rows": rows})
            print(table(case, rows), flush=True)
            text += "\n" + table(case, rows)
    output = arguments.output or HERE / "results" / f"{today}-peers.md"
    output.write_text(text)
    output.with_suffix(".json").write_text(json.dumps({"machine": machine(), "results": results}, indent=1))


if __name__ == "__main__":
    main()
