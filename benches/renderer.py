"""Frames of a renderer: processor time of the first and of later frames, and transfers of a frame.

    python benches/renderer.py [--size 640x480] [--instances 10,200] [--frames 5] [--devices cpu,gpu]

The scenes are the forests of `scene.py` under soft shadow. The first frame includes the conversion and the bake of the
objects and, on a device, the compilation of the kernels. Later frames have another camera each. A dimmed frame has the
camera of the frame before, and a light of another intensity. Times are processor times, since the machine may be
busy; a software adapter uses the processor too.
"""

from __future__ import annotations

import argparse
import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np

import fieldbake as fb
from measuring import machine, timed
from scene import forest


def turned(camera: fb.Camera, angle: float) -> fb.Camera:
    """The camera, turned around the vertical axis through the origin."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return fb.Camera.from_pose(turn @ camera.pose, camera.fov_deg)


def row(count: int, size: tuple[int, int], frames: int, device: str) -> str:
    scene, camera = forest(count, np.random.default_rng(7))
    fb.cache.clear()

    def start() -> fb.Renderer:
        renderer = fb.Renderer(scene, size=size, device=device)
        renderer.frame(camera)
        return renderer

    started = timed(start)
    renderer, first = started.result, started.least_cpu
    before = renderer.counters
    times, stages = [], []
    for i in range(frames):
        drawn = timed(lambda i=i: renderer.frame(turned(camera, 0.1 * (i + 1))))
        times.append(drawn.least_cpu)
        stages.append(drawn.result.report["milliseconds"])
    after = renderer.counters
    lights = [replace(light, intensity=0.5) for light in scene.lights]
    dimmed = timed(lambda: renderer.frame(turned(camera, 0.1 * frames), lights)).least_cpu
    moved = [(after[name] - before[name]) / frames for name in ("uploads", "upload_bytes", "submits", "readbacks")]
    walls = " | ".join(f"{min(stage[name] for stage in stages):,.0f}" for name in ("primary", "light"))
    transfers = " | ".join(f"{value:,.0f}" for value in moved)
    return f"| {count} | {device} | {first:.2f} | {min(times):.2f} | {dimmed:.3f} | {walls} | {transfers} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--instances", default="10,200")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--devices", default="cpu,gpu")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    lines = [
        f"# Frames of a renderer, {datetime.datetime.now(tz=datetime.UTC).date()}",
        "",
        f"{machine()}; `benches/renderer.py`, {width} x {height} pixels, soft shadows, "
        f"the best of {options.frames} frames.",
        "",
        "| instances | device | first frame, s | later frame, s | dimmed frame, s | primary pass, ms | light pass, ms "
        "| uploads | uploaded bytes | submits | read-backs |",
        "|---" * 11 + "|",
    ]
    for count in map(int, options.instances.split(",")):
        for device in options.devices.split(","):
            lines.append(row(count, (width, height), options.frames, device))
            print(lines[-1], flush=True)
    path = Path(__file__).parent / "results" / f"{datetime.datetime.now(tz=datetime.UTC).date()}-renderer.md"
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
