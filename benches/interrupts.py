"""Longest time from Ctrl-C to KeyboardInterrupt, for every public call that can last a second.

A child process prepares each call, starts it, and is sent SIGINT at several moments. A delay is the time from the
signal to the exception in Python code:

    python benches/interrupts.py            # all calls; delays above half a second end the program with status 1
    python benches/interrupts.py thickness "bake sparse" --moments 12

Delays grow when other programs use the processors. `--repeat` takes the least delay of several runs at each moment, so
that a delay comes from the code. Calls that spend their time in manifold3d or trimesh are not listed here but in
docs/limits.md.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

#: Longest delay that is accepted, seconds.
LIMIT = 0.5

#: Geometry that the calls share, made once in each child.
SHARED = """
import os, tempfile, warnings
import numpy as np
import fieldbake as fb
warnings.simplefilter("ignore")
folder = tempfile.mkdtemp()
os.environ["FIELDBAKE_CACHE"] = folder + "/cache"

def ball(n, bumps=0.1):
    "A sphere with bumps, n^2 faces."
    along, down = np.linspace(0, 2 * np.pi, n, endpoint=False), np.linspace(0.001, np.pi - 0.001, n // 2)
    u, v = np.meshgrid(along, down, indexing="ij")
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], -1)
    points *= (1 + bumps * np.sin(9 * u) * np.sin(v))[..., None]
    i, j = np.meshgrid(np.arange(n), np.arange(n // 2 - 1), indexing="ij")
    at = lambda i, j: i % n * (n // 2) + j
    a, b, c, d = at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    caps = []
    for j in (0, n // 2 - 1):
        ring = np.array([at(k, j) for k in range(n)])
        fan = np.stack([np.full(n - 2, ring[0]), ring[1:-1], ring[2:]], -1)
        caps.append(fan if j == 0 else fan[:, ::-1])
    return points.reshape(-1, 3), np.concatenate([faces, *caps])

def scattered(n, seed=1):
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (n, 3))

def rays(n):
    origins = scattered(n)
    return origins, scattered(n, 2)

def placed(m, n):
    rows = [[0.0, 0.0, 0.0, 1.0]]
    poses = [np.concatenate([np.c_[np.eye(3), 4 * p], rows]) for p in scattered(n)]
    return fb.Scene([fb.Instance(m, transform=pose) for pose in poses])

def star(n):
    angles = 2 * np.pi * np.arange(n) / n
    return (1 + 0.3 * np.sin(9 * angles))[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)

def blobs(n, seed=3):
    rng = np.random.default_rng(seed)
    shape = fb.sphere(0.3)
    for at in rng.uniform(-2, 2, (n, 3)):
        shape |= fb.box((0.3, 0.2, 0.4)).rotate("z", at[0] * 90).translate(at)
    return shape
"""

#: Setup and call of each row.
CALLS: dict[str, tuple[str, str]] = {
    "Mesh": ("v, f = ball(2000)", "fb.Mesh(v, f)"),
    "Mesh.topology": ("m = fb.Mesh(*ball(2000))", "m.topology()"),
    "Mesh.moved": ("m = fb.Mesh(*ball(1600)); m.topology()", "m.moved(m.vertices * 1.1)"),
    "Mesh.save stl": ("m = fb.Mesh(*ball(2400))", "m.save(folder + '/x.stl')"),
    "Mesh.save obj": ("m = fb.Mesh(*ball(1000))", "m.save(folder + '/x.obj')"),
    "Mesh.save ply": ("m = fb.Mesh(*ball(2400))", "m.save(folder + '/x.ply')"),
    "Mesh.save glb": ("m = fb.Mesh(*ball(2400))", "m.save(folder + '/x.glb')"),
    "Mesh.save 3mf": ("m = fb.Mesh(*ball(800))", "m.save(folder + '/x.3mf')"),
    "Mesh pickle": ("import pickle; m = fb.Mesh(*ball(2000))", "pickle.loads(pickle.dumps(m))"),
    "normalize": ("m = fb.Mesh(*ball(2000))", "fb.normalize(m, 'unit sphere')"),
    "face_normals": ("m = fb.Mesh(*ball(2000))", "m.face_normals; m.area; m.volume"),
    "signed_distance": ("m = fb.Mesh(*ball(300)); p = scattered(20_000_000)", "fb.signed_distance(m, p)"),
    "signed_distance, first": ("m = fb.Mesh(*ball(2000)); p = scattered(100)", "fb.signed_distance(m, p)"),
    "signed_distance, parity": (
        "m = fb.Mesh(*ball(300)); p = scattered(3_000_000)",
        "fb.signed_distance(m, p, sign='parity')",
    ),
    "signed_distance, one place": (
        "m = fb.Mesh(*ball(300)); p = np.concatenate([scattered(1), 1e-9 * scattered(20_000_000)])",
        "fb.signed_distance(m, p)",
    ),
    "closest_point": ("m = fb.Mesh(*ball(300)); p = scattered(10_000_000)", "fb.closest_point(m, p)"),
    "query": ("m = fb.Mesh(*ball(300)); p = scattered(10_000_000)", "fb.query(m, p)"),
    "contains": ("m = fb.Mesh(*ball(300)); p = scattered(20_000_000)", "fb.contains(m, p)"),
    "winding_number": ("m = fb.Mesh(*ball(300)); p = scattered(4_000_000)", "fb.winding_number(m, p)"),
    "thickness": ("m = fb.Mesh(*ball(250, 0.0)); p = scattered(2_000_000)", "fb.thickness(m, p)"),
    "cast_rays": ("m = fb.Mesh(*ball(300)); o, d = rays(10_000_000)", "fb.cast_rays(m, o, d)"),
    "occluded": ("m = fb.Mesh(*ball(300)); o, d = rays(20_000_000)", "fb.occluded(m, o, d)"),
    "count_intersections": ("m = fb.Mesh(*ball(300)); o, d = rays(10_000_000)", "fb.count_intersections(m, o, d)"),
    "all_intersections": ("m = fb.Mesh(*ball(300)); o, d = rays(10_000_000)", "fb.all_intersections(m, o, d)"),
    "sample_surface": ("m = fb.Mesh(*ball(1000))", "fb.sample_surface(m, 30_000_000)"),
    "sample_training": ("m = fb.Mesh(*ball(300))", "fb.sample_training(m, 10_000_000)"),
    "bake": ("m = fb.Mesh(*ball(600))", "fb.bake(m, 320)"),
    "bake of few faces": ("m = fb.box(2).to_mesh(8)", "fb.bake(m, 700)"),
    "bake, open": ("v, f = ball(200); m = fb.Mesh(v, f[:-5000])", "fb.bake(m, 128)"),
    "bake band": ("m = fb.Mesh(*ball(600))", "fb.bake(m, 500, band=3)"),
    "bake two-sided": ("m = fb.Mesh(*ball(400))", "fb.bake(m, 400, two_sided=True)"),
    "bake_sparse": ("m = fb.Mesh(*ball(600))", "fb.bake_sparse(m, 1000)"),
    "bake_sequence": ("m = fb.Mesh(*ball(300))", "list(fb.bake_sequence([m, m.moved(m.vertices * 1.01), m], 256))"),
    "Volume.update": ("m = fb.Mesh(*ball(300)); a = fb.bake(m, 400); n = m.moved(m.vertices * 1.001)", "a.update(n)"),
    "bake_to_zarr": ("m = fb.Mesh(*ball(300))", "fb.bake_to_zarr(m, folder + f'/{len(os.listdir(folder))}.zarr', 700)"),
    "bake_many": (
        "m = fb.Mesh(*ball(300))",
        "fb.bake_many([m] * 3, folder + f'/{len(os.listdir(folder))}', resolution=200)",
    ),
    "ZarrVolume.sample": (
        "m = fb.Mesh(*ball(100)); z = fb.bake_to_zarr(m, folder + '/s.zarr', 300); p = scattered(5_000_000)",
        "z.sample(p)",
    ),
    "ZarrVolume.to_mesh": ("m = fb.Mesh(*ball(100)); z = fb.bake_to_zarr(m, folder + '/t.zarr', 500)", "z.to_mesh()"),
    "Volume.sample": ("a = fb.bake(fb.Mesh(*ball(100)), 128); p = scattered(50_000_000)", "a.sample(p)"),
    "Volume.gradient": ("a = fb.bake(fb.Mesh(*ball(100)), 128); p = scattered(30_000_000)", "a.gradient(p)"),
    "Volume.downsample": ("a = fb.bake(fb.box(2), 900)", "a.downsample()"),
    "Volume.quantize": ("a = fb.bake(fb.box(2), 900)", "a.quantize('snorm8')"),
    "Volume.check": ("a = fb.bake(fb.box(2), 700)", "a.check()"),
    "Volume.to_mesh": ("a = fb.bake(fb.Mesh(*ball(300)), 500, band=4)", "a.to_mesh()"),
    "Volume.to_mesh, no source": (
        "a = fb.bake(blobs(20), 500); a.save(folder + '/a.npz'); a = fb.load(folder + '/a.npz')",
        "a.to_mesh()",
    ),
    "SparseVolume.to_mesh": ("a = fb.bake_sparse(fb.Mesh(*ball(300)), 700)", "a.to_mesh()"),
    "SparseVolume.sample": ("a = fb.bake_sparse(fb.Mesh(*ball(300)), 256); p = scattered(30_000_000)", "a.sample(p)"),
    "SparseVolume.to_volume": ("a = fb.bake_sparse(fb.Mesh(*ball(300)), 800)", "a.to_volume()"),
    "Volume.to_sparse": ("a = fb.bake(fb.Mesh(*ball(100)), 500)", "a.to_sparse()"),
    "cast_rays, first": ("m = fb.Mesh(*ball(2000)); m.topology(); o, d = rays(100)", "fb.cast_rays(m, o, d)"),
    "winding_number, first": ("m = fb.Mesh(*ball(2000)); m.topology(); p = scattered(100)", "fb.winding_number(m, p)"),
    "query, first": ("m = fb.Mesh(*ball(2000)); m.topology(); p = scattered(100)", "fb.query(m, p)"),
    "pack": ("a = fb.bake(fb.box(2), 256)", "fb.pack([a] * 16, page_size=8192)"),
    "Atlas.unpack": ("a = fb.pack([fb.bake(fb.box(2), 700)], page_size=32768)", "a.unpack(0)"),
    "Shape.distance": ("s = blobs(200); p = scattered(5_000_000)", "s.distance(p)"),
    "Shape.gradient": ("s = blobs(200); p = scattered(3_000_000)", "s.gradient(p)"),
    "Shape.bounds": ("s = blobs(2000)", "s.bounds"),
    "bake of a shape": ("s = blobs(100)", "fb.bake(s, 256)"),
    "bake_sparse of a shape": ("s = blobs(100)", "fb.bake_sparse(s, 256)"),
    "Shape.to_mesh": ("s = blobs(100)", "s.to_mesh(256)"),
    "Shape.save": ("s = blobs(30)", "s.save(folder + '/s.stl', 256)"),
    "Shape.shader": ("s = blobs(1500)", "s.shader('glsl')"),
    "Shape.to_sexpr, parse": ("s = blobs(3000)", "fb.csg.parse(s.to_sexpr())"),
    "decompose aabb": ("s = blobs(400)", "fb.csg.decompose(s, method='aabb')"),
    "decompose octree": ("s = blobs(400)", "fb.csg.decompose(s, method='octree')"),
    "raymarch of a shape": ("s = blobs(100)", "fb.raymarch(s, size=(1920, 1080))"),
    "raymarch of a volume": ("a = fb.bake(fb.Mesh(*ball(100)), 256)", "fb.raymarch(a, size=(4000, 3000))"),
    "raymarch of a sparse volume": (
        "a = fb.bake_sparse(fb.Mesh(*ball(100)), 256)",
        "fb.raymarch(a, size=(4000, 3000))",
    ),
    "raymarch of quadrics": (
        "q = [fb.Quadric.sphere(p, .2) for p in scattered(3000)]",
        "fb.raymarch(q, size=(3000, 2000))",
    ),
    "render": (
        "m = fb.Mesh(*ball(200)); s = placed(m, 60)",
        "fb.render(s, fb.Camera.fit(s.bounds), size=(1280, 720))",
    ),
    "render, occlusion": (
        "m = fb.Mesh(*ball(200)); s = placed(m, 20)",
        "fb.render(s, fb.Camera.fit(s.bounds), size=(640, 480), ambient_occlusion=True)",
    ),
    "render, bounces": (
        "m = fb.Mesh(*ball(60)); s = placed(m, 20)",
        "fb.render(s, fb.Camera.fit(s.bounds), size=(320, 240), bounces=1, bounce_samples=64)",
    ),
    "render, fields of many meshes": (
        "s = fb.Scene([fb.Instance(fb.Mesh(*ball(200 + 2 * i))) for i in range(30)])",
        "fb.render(s, fb.Camera.fit(s.bounds), size=(160, 120))",
    ),
    "Renderer.frame": (
        "m = fb.Mesh(*ball(100)); s = placed(m, 60); r = fb.Renderer(s, size=(1920, 1080))",
        "r.frame(fb.Camera.fit(s.bounds))",
    ),
    "merge": (
        "m = fb.Mesh(*ball(100)); s = placed(m, 60)",
        "fb.merge(s, 256)",
    ),
    "to_html": ("m = fb.Mesh(*ball(600))", "m.to_html()"),
    "to_html of a volume": ("a = fb.bake(fb.box(2), 250)", "a.to_html(encoding='float32')"),
    "solid": ("m = fb.Mesh(*ball(300))", "fb.solid(m, 300)"),
    "solid, outer": ("m = fb.Mesh(*ball(300))", "fb.solid(m, 300, fill='outer', seal=8)"),
    "offset": ("m = fb.Mesh(*ball(200))", "fb.offset(m, 0.1, 256)"),
    "shell": ("m = fb.Mesh(*ball(200))", "fb.shell(m, 0.1, 200)"),
    "boolean": (
        "m = fb.Mesh(*ball(200)); n = fb.box(1.5).to_mesh(32)",
        "fb.boolean('difference', m, n, resolution=256)",
    ),
    "SolidReport.distance_to_source": ("r = fb.offset(fb.Mesh(*ball(100)), 0.1, 128).report", "r.distance_to_source"),
    "SolidReport.distance_from_source": (
        "r = fb.offset(fb.Mesh(*ball(100)), 0.1, 128).report",
        "r.distance_from_source",
    ),
    "distances of a solid": (
        "r = fb.solid(fb.Mesh(*ball(400)), 200).report",
        "r.distance_to_source; r.distance_from_source",
    ),
    "SolidReport.self_intersections": (
        "r = fb.solid(fb.Mesh(*ball(300)), 400).report",
        "r.self_intersections; r.genus; r.thinnest_part",
    ),
    "load_mesh stl": ("fb.Mesh(*ball(2000)).save(folder + '/l.stl')", "fb.load_mesh(folder + '/l.stl')"),
    "sweep": (
        "m = fb.Mesh(*ball(60)); t = np.linspace(0, 3, 40)[:, None, None]; poses = np.eye(4) + t * np.eye(4, k=3)",
        "fb.sweep(m, poses, 200)",
    ),
    "clearance": (
        "a, b = fb.Mesh(*ball(400)), fb.Mesh(*ball(400)); p = np.eye(4) + 1.9 * np.eye(4, k=3)",
        "fb.clearance(a, b, pose_b=p)",
    ),
    "slices": ("m = fb.Mesh(*ball(100))", "fb.slices(m, 0.002, pixel=0.002)"),
    "sample_edges": ("m = fb.box(1).to_mesh(4)", "fb.sample_edges(m, 20_000_000)"),
    "PointCloud, areas": (
        "p = fb.sample_surface(fb.Mesh(*ball(100)), 1_000_000)",
        "fb.PointCloud(p.points, p.normals).areas",
    ),
    "PointCloud.oriented": (
        "p = fb.sample_surface(fb.Mesh(*ball(100)), 200_000)",
        "fb.PointCloud(p.points).oriented()",
    ),
    "contains of a cloud": (
        "p = fb.sample_surface(fb.Mesh(*ball(100)), 200_000); c = fb.PointCloud(p.points, p.normals); "
        "q = scattered(3_000_000)",
        "fb.contains(c, q)",
    ),
    "solid of a cloud": (
        "p = fb.sample_surface(fb.Mesh(*ball(100)), 200_000); c = fb.PointCloud(p.points, p.normals)",
        "fb.solid(c, 256)",
    ),
    "polygon of many corners": ("p = fb.polygon(star(65_536)); q = scattered(2_000_000)", "p.extrude(1).distance(q)"),
    "bake of a polygon": ("p = fb.polygon(star(20_000)).extrude(1)", "fb.bake(p, 300)"),
    "Profile.offset": ("p = fb.polygon(star(65_536))", "p.offset(0.01)"),
    "text": ("t = fb.text('fieldbake ' * 40, 1).extrude(1)", "t.to_mesh(256)"),
    "thread": ("t = fb.thread(10, 1.5, 60)", "t.to_mesh(300)"),
    "Shape.offset, baked": ("s = blobs(100).twist(per_unit_deg=60)", "s.offset(0.05, resolution=300)"),
    "sections": (
        "m = fb.Mesh(*ball(600)); o = np.linspace(-1, 1, 4000)[:, None] * [0, 0, 1]",
        "m.sections(o, (0, 0, 1))",
    ),
    "section of a shape": ("s = blobs(100)", "s.section((0, 0, 0), (0, 0, 1), resolution=1024)"),
    "query of a scene": ("s = placed(fb.Mesh(*ball(100)), 50); p = scattered(2_000_000)", "fb.query(s, p)"),
    "training.sample_many": (
        "import itertools, fieldbake.training; count = itertools.count(); m = fb.Mesh(*ball(100))",
        "fb.training.sample_many([m] * 40, folder + f'/many{next(count)}', 'deepsdf')",
    ),
    "devices": ("", "fb.devices()"),
}
for _ending in ("npz", "vdb", "nvdb", "vti", "vf", "dds", "ktx2", "nrrd", "exr"):
    _made = "a = fb.bake(fb.Mesh(*ball(60)), 400)"
    CALLS[f"Volume.save {_ending}"] = (_made, f"a.save(folder + '/v.{_ending}')")
    CALLS[f"load {_ending}"] = (f"{_made}; a.save(folder + '/w.{_ending}')", f"fb.load(folder + '/w.{_ending}')")
CALLS["Atlas.save"] = ("a = fb.pack([fb.bake(fb.box(2), 400)], page_size=8192)", "a.save(folder + '/a.npz')")

#: The loop of the child: prepare, announce, call, and report the outcome with its time.
CHILD = """
import sys, time, json, signal
signal.signal(signal.SIGINT, signal.default_int_handler)
space = {}
exec(sys.stdin.readline() and SHARED, space)
setup, call = SETUP, CALL
exec(setup, space)
print("ready", flush=True)
for line in sys.stdin:
    if line.strip() == "next":
        # A late signal has interrupted the wait for this line, or arrived just after it.
        continue
    if line.strip() == "again":
        exec(setup, space)
    code = compile(call, "call", "exec")
    print("start", time.monotonic(), flush=True)
    try:
        exec(code, space)
        outcome = "done"
    except KeyboardInterrupt:
        outcome = "interrupted"
    at = time.monotonic()
    try:
        print(outcome, at, flush=True)
        sys.stdin.readline()
    except KeyboardInterrupt:
        print("late", at, flush=True)
"""


class Child:
    """A process that runs one call again and again."""

    def __init__(self, setup: str, call: str) -> None:
        text = CHILD.replace("SHARED", repr(SHARED)).replace("SETUP", repr(setup)).replace("CALL", repr(call))
        self.process = subprocess.Popen(
            [sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        self.received = b""
        self.write("begin")
        self.expect("ready")

    def write(self, line: str) -> None:
        assert self.process.stdin
        self.process.stdin.write(line.encode() + b"\n")

    def read(self, within: float | None = None) -> list[str]:
        """The words of the next line; none if it does not arrive within some seconds."""
        assert self.process.stdout
        while b"\n" not in self.received:
            if not select.select([self.process.stdout], [], [], within)[0]:
                return []
            part = os.read(self.process.stdout.fileno(), 4096)
            if not part:
                raise RuntimeError(f"the child ended with status {self.process.wait()}")
            self.received += part
        line, _, self.received = self.received.partition(b"\n")
        return line.decode().split()

    def expect(self, word: str) -> float:
        found = self.read()
        if found[0] != word:
            raise RuntimeError(f"expected {word}, got {found}")
        return float(found[1]) if len(found) > 1 else 0.0

    def interrupted_after(self, seconds: float, again: bool) -> tuple[str, float, float]:
        """Call, send SIGINT after some seconds; return the outcome, the seconds of the call and the delay."""
        self.write("again" if again else "first")
        start = self.expect("start")
        time.sleep(max(0.0, start + seconds - time.monotonic()))
        sent = time.monotonic()
        os.kill(self.process.pid, signal.SIGINT)
        outcome, at = self.read()
        self.write("next")
        if outcome == "done":
            # Either the call ended just before the signal arrived, or it caught the exception and went on.
            late = self.read(within=2.0)
            if not late:
                return "ignored", float(at) - start, math.inf
            outcome = late[0]
        return outcome, float(at) - start, float(at) - sent

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


def measure(name: str, moments: int, repeat: int, longest: float) -> dict[str, object]:
    """Longest delay of one call, over moments that divide its duration evenly."""
    setup, call = CALLS[name]
    child = Child(setup, call)
    try:
        child.write("first")
        start = child.expect("start")
        first = child.read(within=longest)
        worst, worst_at = 0.0, 0.0
        if first:
            outcome, at = first
            lasted = float(at) - start
            if outcome != "done":
                raise RuntimeError(f"{name}: {outcome}")
        else:
            sent = time.monotonic()
            os.kill(child.process.pid, signal.SIGINT)
            _, at = child.read()
            lasted, worst, worst_at = sent - start, float(at) - sent, sent - start
        child.write("next")
        span = min(lasted, longest)
        for number in range(moments):
            moment = span * (number + 0.5) / moments
            delays = [child.interrupted_after(moment, again=True)[2] for _ in range(repeat)]
            if min(delays) > worst:
                worst, worst_at = min(delays), moment
    finally:
        child.close()
    return {"call": name, "seconds": round(lasted, 2), "delay": round(worst, 3), "at": round(worst_at, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="calls by name, or parts of their names; all if not set")
    parser.add_argument("--moments", type=int, default=8)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--longest", type=float, default=8.0, help="seconds after which a call is interrupted at last")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    names = [name for name in CALLS if not options.names or any(part in name for part in options.names)]
    rows = []
    print(f"{'call':34} {'seconds':>8} {'longest delay':>14} {'at':>7}")
    for name in names:
        try:
            row = measure(name, options.moments, options.repeat, options.longest)
        except (RuntimeError, ValueError, OSError) as error:
            print(f"{name:34} failed: {error}", flush=True)
            rows.append({"call": name, "error": str(error)})
            continue
        rows.append(row)
        print(f"{name:34} {row['seconds']:8} {row['delay']:14} {row['at']:7}", flush=True)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1))
    slow = [row for row in rows if not float(str(row.get("delay", "inf"))) <= LIMIT]
    if slow:
        sys.exit(f"{len(slow)} of {len(rows)} calls take longer than {LIMIT} s to stop")


if __name__ == "__main__":
    main()
