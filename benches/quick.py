"""The core figures in about three minutes, as ratios to reference work of the same run.

    make bench-quick     or     python benches/quick.py [--record]

Every figure is processor time divided by the time of a reference: arithmetic on arrays that fit in the cache, or a copy
and a gather where memory is the limit. Jobs and references run in turns, and the least times of both count, so a slower
machine changes both. `--record` stores the ratios in `results/quick.json` by machine, and other runs compare themselves
with them. A figure that is more than 15 % above its record is printed in red. The exit status is always 0, because
timings of a shared machine are no test.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import fieldbake as fb
from csg import fresh, scattered
from measuring import Times, machine
from scene import forest

RECORD = Path(__file__).parent / "results" / "quick.json"
#: Growth of a ratio that is printed in red.
LIMIT = 0.15
#: Time for each figure and its reference, seconds, and the least number of turns.
BUDGET_S, LEAST_TURNS = 7.0, 5


def arithmetic() -> None:
    """Take 0.05 s of processor time in the caches."""
    x = np.linspace(0.1, 1, 4096, dtype=np.float32)
    for _ in range(6000):
        x = np.sqrt(x * x + np.float32(0.25)) * np.float32(0.9)


def memory() -> Callable[[], None]:
    """Make a job that copies 64 MiB and gathers 1 M random values of it."""
    values = np.zeros(1 << 24, np.float32)
    rows = np.random.default_rng(0).integers(0, len(values), 1_000_000)

    def job() -> None:
        values.copy()
        values[rows]

    return job


def figures(folder: Path) -> dict[str, tuple[str, Callable[[], object]]]:
    """The reference and the job of each figure."""
    knot = fb.models.torus_knot(segments=720, sides=48)
    random = np.random.default_rng(1)
    lower, upper = knot.bounds
    many = random.uniform(lower, upper, (1_000_000, 3))
    points = many[:100_000]
    volume = fb.bake(knot, 128)
    sparse = fb.bake_sparse(knot, 128)
    camera = fb.Camera.fit(volume.inner_bounds)
    atlas = fb.pack([fb.bake(knot, (64, 64, 64))] * 16, page_size=2048)
    shape = scattered(1000)
    scene, eye = forest(100, random)
    fb.render(scene, eye, size=(8, 8), device="cpu")
    knot.save(folder / "knot.glb")

    def draw(field: fb.Volume | fb.SparseVolume) -> Callable[[], object]:
        return lambda: fb.raymarch(field, camera, size=(320, 240), shadows="none", device="cpu")

    def build() -> fb.Mesh:
        mesh = fb.Mesh(knot.vertices, knot.faces)
        fb.closest_point(mesh, points[:1])
        return mesh

    return {
        "tree of 69 k faces": ("arithmetic", build),
        "bake at 64^3, tree included": ("arithmetic", lambda: fb.bake((knot.vertices, knot.faces), (64, 64, 64))),
        "bake at 128^3": ("arithmetic", lambda: fb.bake(knot, (128, 128, 128))),
        "sparse bake at 256": ("arithmetic", lambda: fb.bake_sparse(knot, 256)),
        "signed distances of 100,000 points": ("arithmetic", lambda: fb.signed_distance(knot, points)),
        "100,000 rays": ("arithmetic", lambda: fb.cast_rays(knot, points, -points)),
        "picture of a volume": ("arithmetic", draw(volume)),
        "picture of a sparse volume": ("arithmetic", draw(sparse)),
        "picture of 100 trees, hard shadows": (
            "arithmetic",
            lambda: fb.render(scene, eye, size=(320, 240), shadows="hard", device="cpu"),
        ),
        "decomposition of 1,000 leaves": ("arithmetic", lambda: fb.csg.decompose(fresh(shape))),
        "mesh of a volume": ("arithmetic", volume.to_mesh),
        "samples at 1,000,000 points": ("memory", lambda: volume.sample(many)),
        "quantize, snorm16": ("memory", lambda: volume.quantize("snorm16")),
        "to_volume of bricks": ("memory", sparse.to_volume),
        "atlas to .exr": ("arithmetic", lambda: atlas.save(folder / "atlas.exr")),
        "atlas to .png": ("arithmetic", lambda: atlas.save(folder / "atlas.png")),
        "load .glb": ("memory", lambda: fb.load_mesh(folder / "knot.glb")),
    }


def ratio(job: Callable[[], object], reference: Callable[[], object]) -> float:
    """Ratio of the least processor times of a job and its reference in turns."""
    job(), reference()
    ours, theirs, start = Times(), Times(), time.monotonic()
    while len(ours.cpu) < LEAST_TURNS or time.monotonic() - start < BUDGET_S:
        ours.run(job)
        theirs.run(reference)
    return ours.least_cpu / theirs.least_cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="store the ratios of this run")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    records = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    last = records.get(machine(), {})
    if not last:
        print(f"there is no record of this machine ({machine()}): --record stores one")
    references = {"arithmetic": arithmetic, "memory": memory()}
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (reference, job) in figures(Path(folder)).items():
            found[name] = ratio(job, references[reference])
            change = found[name] / last[name] - 1 if name in last else 0.0
            is_red = change > LIMIT and sys.stdout.isatty()
            mark = "\x1b[31m" if is_red else "", "\x1b[0m" if is_red else ""
            beside = f"{change:+7.1%}" + (" slower" if change > LIMIT else "") if name in last else ""
            print(f"{mark[0]}{name:<36} {found[name]:9.3f} x {reference:<11} {beside}{mark[1]}", flush=True)
    if options.record:
        RECORD.write_text(json.dumps({**records, machine(): found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
