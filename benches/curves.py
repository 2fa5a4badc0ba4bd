"""Time and memory of a bake over the resolution, the number of faces and the number of threads.

    python benches/curves.py

Each point is the median of three whole bakes, tree included, of the trefoil from `fieldbake.models`; threads are set by
RAYON_NUM_THREADS in a process of their own. Memory is the process's peak above its level before the bake.
docs/benchmarks.md draws the curves from the JSON file.
"""

import argparse
import datetime
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import memory
import meshes

HERE = Path(__file__).parent
RESOLUTIONS = [32, 64, 128, 256, 512]
FACES = [1_000, 10_000, 100_000, 1_000_000]
USUAL_RESOLUTION, USUAL_FACES = 128, 100_000


def one(faces: int, size: int) -> dict[str, float]:
    """Bake in this process. Returns seconds, and the peak of the memory above the level before, MiB."""
    import fieldbake as fb

    _, vertices, indices = meshes.knot(faces)
    memory.reset_peak()
    before = memory.peak_mib()
    seconds = []
    for _ in range(3 if size < 512 else 1):
        start = time.perf_counter()
        volume = fb.bake((vertices, indices), (size,) * 3)
        seconds.append(time.perf_counter() - start)
    return {
        "seconds": statistics.median(seconds),
        "peak_mib": memory.peak_mib() - before,
        "output_mib": volume.nbytes / 2**20,
    }


def measure(faces: int, size: int, threads: int) -> dict[str, float]:
    """The same in a fresh process."""
    environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
    command = [sys.executable, __file__, "--one", str(faces), str(size)]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    point = {"faces": faces, "resolution": size, "threads": threads, **json.loads(result.stdout)}
    print(
        f"{faces:>9,} faces  {size:>3}^3  {threads:>2} threads  {point['seconds']:8.3f} s  "
        f"{point['seconds'] / size**3 * 1e9:7.0f} ns a sample  {point['peak_mib']:6.0f} MiB above the start"
    )
    return point


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--one", nargs=2, type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(one(*arguments.one)))
        return

    cores = os.cpu_count() or 1
    threads = sorted({1, *(2**k for k in range(1, 8) if 2**k <= cores), cores})
    curves = {
        "resolution": [measure(USUAL_FACES, size, cores) for size in RESOLUTIONS],
        "faces": [measure(faces, USUAL_RESOLUTION, cores) for faces in FACES],
        "threads": [measure(USUAL_FACES, USUAL_RESOLUTION, count) for count in threads],
    }
    path = HERE / "results" / f"{datetime.date.today().isoformat()}-curves.json"
    path.write_text(json.dumps(curves, indent=1))


if __name__ == "__main__":
    main()
