"""Makers: polygons of many edges, text, threads and two pages, beside build123d and OpenSCAD where installed.

    python benches/makers.py [--only NAME ...]

Times are the least wall time of three calls. build123d (`pip install build123d`) and OpenSCAD (the program `openscad`)
are measured where they are installed; both triangulate exact or faceted surfaces, and fieldbake samples a field.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import fieldbake as fb

PAGES = Path(__file__).parents[1] / "docs" / "howto"


def least(call, rounds=3):
    """The least wall time and the result of a call."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times), result


def polygons():
    """Cost of a distance by the number of edges."""
    points = np.column_stack([np.random.default_rng(0).uniform(-1.5, 1.5, (200_000, 2)), np.zeros(200_000)])
    for count in (20, 200, 2000, 20000):
        angles = 2 * np.pi * np.arange(count) / count
        radii = 1 + 0.3 * np.sin(9 * angles)
        corners = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
        made, profile = least(lambda corners=corners: fb.polygon(corners).extrude(1))
        seconds, _ = least(lambda solid=profile: solid.distance(points, device="cpu"))
        print(f"polygon of {count:,} edges: {1e3 * made:.1f} ms to make, {seconds / 0.2:.2f} us a point")


def text():
    """A plate with engraved text."""
    seconds, profile = least(lambda: fb.text("fieldbake 0123", 10))
    print(f"text of 14 letters: {1e3 * seconds:.1f} ms, {sum(map(len, profile.polygons)):,} corners")
    plate = fb.box((80, 14, 3)) - profile.extrude(1).translate((-37, -3, 1.5))
    seconds, mesh = least(lambda: plate.to_mesh(voxel_size=0.2))
    print(f"plate with the text, voxel 0.2 mm: {seconds:.2f} s, {len(mesh.faces):,} faces")
    if importlib.util.find_spec("build123d"):
        import build123d

        def made():
            with build123d.BuildPart() as part:
                build123d.Box(80, 14, 3)
                with build123d.BuildSketch(part.faces().sort_by(build123d.Axis.Z)[-1]):
                    build123d.Text("fieldbake 0123", 10)
                build123d.extrude(amount=-0.5, mode=build123d.Mode.SUBTRACT)
            return part.part.tessellate(0.01)

        print(f"  build123d: {least(made)[0]:.2f} s")
    openscad(
        'difference(){cube([80,14,3],center=true);translate([-37,-3,1])linear_extrude(2)text("fieldbake 0123",10);}'
    )


def thread():
    """An M16 rod."""
    seconds, mesh = least(lambda: fb.thread(16, 2, 20).to_mesh(voxel_size=0.125))
    corners = np.array([(8, 0.25), (8 - 0.625 * math.sqrt(0.75) * 2, 0.5)])
    flats = (corners[:, 0] ** 2 * corners[:, 1]).sum()
    a, b = corners[0, 0], corners[1, 0]
    slopes = 2 * 0.625 * (a * a + a * b + b * b) / 3
    volume = math.pi / 2 * (flats + slopes) * 20
    print(
        f"M16 x 20, voxel 0.125 mm: {seconds:.2f} s, {len(mesh.faces):,} faces, volume {mesh.volume / volume - 1:+.1e}"
    )


def pages():
    """The code of the two how-to pages, cell by cell."""
    for name in ("enclosure", "bolt_and_nut"):
        code = re.findall(r"^```\{code-cell\} python\n(.*?)^```\n", (PAGES / f"{name}.md").read_text(), re.M | re.S)
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            program = f"import os\nos.chdir({folder!r})\n" + "\n".join(code)
            exec(compile(program, name, "exec"), {})
        print(f"page {name}: {time.perf_counter() - start:.1f} s")


def openscad(program):
    """Time of OpenSCAD for a program, where it is installed."""
    if not shutil.which("openscad"):
        return
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "part.scad"
        source.write_text(program)
        command = ["openscad", "-o", str(Path(folder) / "part.stl"), str(source)]
        seconds, _ = least(lambda: subprocess.run(command, check=True, capture_output=True))
    print(f"  OpenSCAD: {seconds:.2f} s")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=["polygons", "text", "thread", "pages"])
    for name in parser.parse_args().only:
        globals()[name]()


if __name__ == "__main__":
    main()
