"""Tests and measurements of a graphics card: the tests of devices, then each job on the card beside the processor.

    make hardware    or    python benches/hardware.py [--device gpu] [--small] [--only bake,scene] [--tests BINARY]

The command needs an installed fieldbake and no network, no compiler and no files: all meshes are made in code. Each
stage is a process of its own with a time limit, and the results file is written after each, so a crash or a hang costs
one stage. The stages together take at most 25 minutes. On a software adapter the sizes are small, since the figures do
not represent a card. `--tests` names the test program of the crate, built before by `cargo test --no-run`.

Times are wall-clock times, the best of several, with the result read back to the host. "error" is the largest
difference from the processor's result.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.util
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import fieldbake as fb

#: Time limits, seconds: of one stage, and of all stages together.
STAGE_LIMIT, TOTAL_LIMIT = 480, 1500
#: Time limit of the test suites together, seconds: their results so far are shown before the stage is stopped.
SUITES_LIMIT = STAGE_LIMIT - 30
ROOT = Path(__file__).parents[1]


class Job(NamedTuple):
    """The parameters of a stage."""

    device: str
    small: bool
    #: The test program of the crate.
    tests: str | None


def best(call: Callable[[], object], repeat: int = 3) -> tuple[object, float]:
    """The result and the shortest time, after one call that warms up."""
    result, shortest = call(), np.inf
    for _ in range(repeat):
        start = time.perf_counter()
        result = call()
        shortest = min(shortest, time.perf_counter() - start)
    return result, shortest


def meshes(small: bool) -> Iterator[tuple[str, fb.Mesh]]:
    """Closed meshes of different fineness."""
    for faces in (2_000, 8_000) if small else (5_000, 70_000, 300_000, 1_000_000):
        sides = round((faces / 20) ** 0.5)
        mesh = fb.models.torus_knot(segments=round(faces / 2 / sides), sides=sides)
        yield f"knot, {len(mesh.faces):,} faces", mesh


def check(_job: Job) -> None:
    """The adapters, and the self-tests of each path."""
    for found in fb.devices():
        print(f"- {found}")
    print()
    doctor = subprocess.run([sys.executable, "-m", "fieldbake", "doctor"], capture_output=True, text=True, check=False)
    print(f"```text\n{doctor.stdout.strip()}\n```")


def suites(job: Job) -> None:
    """The tests of devices in Rust, if the test program is there, and in Python."""
    commands = []
    if job.tests:
        commands.append([job.tests, "gpu", "--test-threads", "1"])
    if importlib.util.find_spec("pytest") and (ROOT / "tests").is_dir():
        commands.append(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "gpu or device", "tests"]
        )
    if not commands:
        print("No test program was given and pytest is not installed: no tests were run.")
    end = time.monotonic() + SUITES_LIMIT
    for command in commands:
        limit = max(1, end - time.monotonic())
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        try:
            done = subprocess.run(command, cwd=ROOT, check=False, timeout=limit, **pipes)
            output, how = done.stdout, f"ended with status {done.returncode}"
        except subprocess.TimeoutExpired as error:
            output, how = error.stdout or b"", f"was stopped after {limit:.0f} s"
        print(f"`{Path(command[0]).name} {' '.join(command[1:])}` {how}:\n")
        print("```text\n" + "\n".join(output.decode(errors="replace").strip().splitlines()[-25:]) + "\n```\n")


def bake(job: Job) -> None:
    """Signed distances on grids of 64 to 512 samples along each side."""
    print("| mesh | grid | cpu, ms | device, ms | cpu / device | error / diagonal | signs that differ |")
    print("|---|---|---|---|---|---|---|")
    for name, mesh in meshes(job.small):
        for side in (16, 32) if job.small else (64, 128, 256, 512):
            grid = (side, side, side)
            cpu, cpu_seconds = best(lambda: fb.bake(mesh, grid, device="cpu"), 1)  # noqa: B023
            gpu, gpu_seconds = best(lambda: fb.bake(mesh, grid, device=job.device), 1 if side > 256 else 3)  # noqa: B023
            error = np.abs(cpu.distances - gpu.distances).max() / np.linalg.norm(np.ptp(cpu.bounds, axis=0))
            signs = np.count_nonzero(np.signbit(cpu.distances) != np.signbit(gpu.distances))
            times = f"{cpu_seconds * 1e3:,.1f} | {gpu_seconds * 1e3:,.1f} | {cpu_seconds / gpu_seconds:.2f}"
            print(f"| {name} | {side}^3 | {times} | {error:.1e} | {signs} |", flush=True)


def queries(job: Job) -> None:
    """Signed distances of random points."""
    print("| mesh | points | cpu, ns a point | device, ns a point | cpu / device | error / diagonal |")
    print("|---|---|---|---|---|---|")
    name, mesh = list(meshes(job.small))[1]
    lower, upper = mesh.bounds
    for count in (10_000, 40_000) if job.small else (1_000_000, 10_000_000, 100_000_000):
        points = np.random.default_rng(1).uniform(lower, upper, (count, 3))
        cpu, cpu_seconds = best(lambda: fb.signed_distance(mesh, points, device="cpu"), 1)  # noqa: B023
        gpu, gpu_seconds = best(lambda: fb.signed_distance(mesh, points, device=job.device), 1)  # noqa: B023
        error = np.abs(cpu - gpu).max() / np.linalg.norm(upper - lower)
        times = f"{cpu_seconds / count * 1e9:.0f} | {gpu_seconds / count * 1e9:.0f} | {cpu_seconds / gpu_seconds:.2f}"
        print(f"| {name} | {count:,} | {times} | {error:.1e} |", flush=True)


def raymarch(job: Job) -> None:
    """Pictures of one field."""
    print("| field | size | cpu, ms | device, ms | cpu / device | pixels that differ by more than 2 of 255 |")
    print("|---|---|---|---|---|---|")
    size = (160, 90) if job.small else (1920, 1080)
    for side in (32,) if job.small else (128, 256):
        volume = fb.bake(fb.models.torus_knot(), side)
        cpu, cpu_seconds = best(lambda: fb.raymarch(volume, size=size, device="cpu"))  # noqa: B023
        gpu, gpu_seconds = best(lambda: fb.raymarch(volume, size=size, device=job.device))  # noqa: B023
        apart = np.abs(cpu.image.astype(int) - gpu.image).max(axis=2) > 2
        times = f"{cpu_seconds * 1e3:,.1f} | {gpu_seconds * 1e3:,.1f} | {cpu_seconds / gpu_seconds:.2f}"
        print(f"| {side} | {size[0]} x {size[1]} | {times} | {100 * apart.mean():.3f} % |", flush=True)


def scene(job: Job) -> None:
    """Frames of a renderer that moves its camera, with soft shadows."""
    print("| instances | size | device | frames a second | primary, ms | light, ms | uploaded bytes | read-backs |")
    print("|---|---|---|---|---|---|---|---|")
    size = (160, 90) if job.small else (1920, 1080)
    random = np.random.default_rng(7)
    knot, ball = fb.models.torus_knot(segments=60, sides=12), fb.bake(fb.sphere(0.5), 32)
    for count in (10, 40) if job.small else (10, 200):
        instances = []
        for i in range(count):
            place = np.eye(4)
            place[[0, 2], 3] = random.uniform(-1, 1, 2) * 3 * np.sqrt(count)
            instances.append(fb.Instance(ball if i % 3 == 0 else knot, place))
        floor = np.eye(4)
        floor[1, 3] = -2
        instances.append(fb.Instance(fb.box((12 * np.sqrt(count), 0.5, 12 * np.sqrt(count))), floor))
        lights = [fb.PointLight((10, 30, 20), intensity=1, radius=2)]
        for where in ("cpu", job.device):
            renderer = fb.Renderer(fb.Scene(instances, lights=lights), size=size, device=where)
            frames = 2 if job.small or where == "cpu" else 30
            distance = 5 * np.sqrt(count)
            cameras = [
                fb.Camera((distance * np.sin(angle), 0.6 * distance, distance * np.cos(angle)), (0, 0, 0))
                for angle in np.linspace(0, 0.5, frames + 1)
            ]
            renderer.frame(cameras[0])
            before, start = renderer.counters, time.perf_counter()
            stages = [frame.report["milliseconds"] for frame in renderer.frames(cameras[1:])]
            seconds = (time.perf_counter() - start) / frames
            moved = [(renderer.counters[name] - before[name]) / frames for name in ("upload_bytes", "readbacks")]
            spent = " | ".join(f"{np.median([stage[name] for stage in stages]):,.1f}" for name in ("primary", "light"))
            row = f"| {count} | {size[0]} x {size[1]} | {where} | {1 / seconds:.1f} | {spent} "
            print(f"{row}| {moved[0]:,.0f} | {moved[1]:.0f} |", flush=True)


def csg(job: Job) -> None:
    """Pictures of a shape of many leaves."""
    print("| leaves | size | cpu, ms | device, ms | cpu / device | pixels with another depth |")
    print("|---|---|---|---|---|---|")
    size = (120, 90) if job.small else (1280, 960)
    random = np.random.default_rng(3)
    for count in (30,) if job.small else (100, 1000):
        shape = fb.sphere(0.2)
        for at in random.uniform(-2, 2, (count - 1, 3)):
            shape = shape | fb.box(random.uniform(0.1, 0.4, 3)).rotate("x", random.uniform(0, 90)).translate(at)
        cpu, cpu_seconds = best(lambda: fb.raymarch(shape, size=size, device="cpu"), 1)  # noqa: B023
        gpu, gpu_seconds = best(lambda: fb.raymarch(shape, size=size, device=job.device), 1)  # noqa: B023
        apart = ~np.isclose(cpu.depth, gpu.depth, rtol=1e-3)
        times = f"{cpu_seconds * 1e3:,.1f} | {gpu_seconds * 1e3:,.1f} | {cpu_seconds / gpu_seconds:.2f}"
        print(f"| {count:,} | {size[0]} x {size[1]} | {times} | {100 * apart.mean():.3f} % |", flush=True)


def merge(job: Job) -> None:
    """One field for many instances."""
    print("| instances | grid | cpu, ms | device, ms | cpu / device | samples that differ |")
    print("|---|---|---|---|---|---|")
    side = 24 if job.small else 128
    volume = fb.bake(fb.models.torus_knot(), 32)
    instances = []
    for at in np.random.default_rng(5).uniform(-8, 8, (20 if job.small else 200, 3)):
        place = np.eye(4)
        place[:3, 3] = at
        instances.append((volume, place))
    cpu, cpu_seconds = best(lambda: fb.merge(instances, side, device="cpu"), 1)
    gpu, gpu_seconds = best(lambda: fb.merge(instances, side, device=job.device), 1)
    times = f"{cpu_seconds * 1e3:,.1f} | {gpu_seconds * 1e3:,.1f} | {cpu_seconds / gpu_seconds:.2f}"
    apart = np.count_nonzero(cpu.distances != gpu.distances)
    print(f"| {len(instances)} | {side} | {times} | {apart} |")


def warp(job: Job) -> None:
    """Closest points of NVIDIA warp on the same card, if it is installed."""
    if importlib.util.find_spec("warp") is None:
        print("warp is not installed.")
        return
    import warp as wp

    wp.init()
    name, mesh = list(meshes(job.small))[1]
    count = 40_000 if job.small else 10_000_000
    lower, upper = mesh.bounds
    points = np.random.default_rng(1).uniform(lower, upper, (count, 3)).astype(np.float32)

    @wp.kernel  # type: ignore[misc]
    def distances(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):  # type: ignore[valid-type,no-untyped-def]
        i = wp.tid()
        found = wp.mesh_query_point_sign_normal(mesh, points[i], 1.0e6)
        out[i] = found.sign * wp.length(points[i] - wp.mesh_eval_position(mesh, found.face, found.u, found.v))

    theirs = wp.Mesh(wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3), wp.array(mesh.faces.ravel(), dtype=int))
    out = wp.zeros(count, dtype=float)

    def call() -> np.ndarray:
        inputs = [theirs.id, wp.array(points, dtype=wp.vec3), out]
        wp.launch(distances, dim=count, inputs=inputs)
        return out.numpy()

    _, warp_seconds = best(call, 2)
    _, own_seconds = best(lambda: fb.signed_distance(mesh, points, device=job.device), 2)
    print(f"{name}, {count:,} points on {wp.get_device()}: warp {warp_seconds / count * 1e9:.1f} ns a point, ", end="")
    print(f"fieldbake {own_seconds / count * 1e9:.1f} ns on {job.device}.")


STAGES: dict[str, Callable[[Job], None]] = {
    stage.__name__: stage for stage in (check, suites, bake, queries, raymarch, scene, csg, merge, warp)
}


def adapter(device: str) -> tuple[str, bool]:
    """Name of the adapter, and whether software emulates it."""
    found = [info for info in fb.devices() if info.type != "cpu" and (device == "gpu" or device in info.name)]
    if not found:
        sys.exit("no graphics adapter: install a Vulkan driver, for example Mesa's lavapipe")
    hardware = [info for info in found if info.hardware]
    chosen = (hardware or found)[0]
    return chosen.name, not hardware


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="gpu", help='"gpu" or the name of an adapter')
    parser.add_argument("--small", action="store_true", help="small sizes, also on a card")
    parser.add_argument("--only", default=",".join(STAGES), help="stages, separated by commas")
    parser.add_argument("--tests", help="the test program of the crate")
    parser.add_argument("--output", type=Path, default=ROOT / "benches" / "results", help="folder of the results file")
    parser.add_argument("--stage", help=argparse.SUPPRESS)
    options = parser.parse_args()
    name, is_software = adapter(options.device)
    small = options.small or is_software
    if options.stage:
        STAGES[options.stage](Job(options.device, small, options.tests))
        return
    today = datetime.datetime.now(tz=datetime.UTC).date()
    word = "-".join("".join(c if c.isalnum() else " " for c in name).lower().split()[:4])
    path = options.output / f"{today}-hardware-{word}.md"
    options.output.mkdir(parents=True, exist_ok=True)
    text = f"# {name}, {today}\n\nfieldbake {fb.__version__}, Python {platform.python_version()}, {platform.machine()}."
    text += " Sizes are small: a software adapter.\n" if small else "\n"
    start = time.monotonic()
    for stage in options.only.split(","):
        left = TOTAL_LIMIT - (time.monotonic() - start)
        begun = time.monotonic()
        command = [sys.executable, __file__, "--stage", stage, "--device", options.device]
        command += ["--small"] * small + (["--tests", options.tests] if options.tests else [])
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=max(1, min(STAGE_LIMIT, left))
            )
            output = done.stdout
            if done.returncode:
                output += (
                    f"\n**The stage ended with status {done.returncode}.**\n\n```text\n{done.stderr[-2000:]}\n```\n"
                )
        except subprocess.TimeoutExpired as error:
            output = (error.stdout or b"").decode() + f"\n**The stage was stopped after {error.timeout:.0f} s.**\n"
        title = (STAGES[stage].__doc__ or "").strip()
        text += f"\n## {stage}\n\n{title}\n\n{output.strip()}\n\n({time.monotonic() - begun:.0f} s)\n"
        path.write_text(text)
        print(f"{stage}: {time.monotonic() - begun:.0f} s", flush=True)
    print(path)


if __name__ == "__main__":
    main()
