"""The CPU and a graphics device side by side: the same bake and picture, how long, and how far apart.

    python benches/devices.py [--device gpu] [--resolution 64] mesh ...

Without meshes a knot is baked. Each line names the device; a software adapter says so by its name (llvmpipe,
SwiftShader) and tells nothing about a GPU.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import fieldbake as fb


def best_of(count, call):
    """Result and the shortest time, after one call that warms up."""
    result, shortest = call(), float("inf")
    for _ in range(count):
        start = time.perf_counter()
        result = call()
        shortest = min(shortest, time.perf_counter() - start)
    return result, shortest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*")
    parser.add_argument("--device", default="gpu")
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=1)
    options = parser.parse_args()

    print(
        f"{'mesh':24} {'faces':>8} {'cpu s':>9} {'device s':>9} {'cpu/device':>10} {'error/diag':>11} {'signs':>6} {'pixels':>7}"
    )
    name = ""
    for path in options.meshes or [None]:
        mesh = fb.load_mesh(path) if path else fb.models.knot()
        cpu, cpu_s = best_of(options.repeat, lambda: fb.bake(mesh, options.resolution, device="cpu"))
        gpu, gpu_s = best_of(options.repeat, lambda: fb.bake(mesh, options.resolution, device=options.device))
        name = gpu.report.device
        frames = [fb.raymarch(volume, device=device) for volume, device in ((cpu, "cpu"), (gpu, options.device))]
        diagonal = np.linalg.norm(cpu.bounds[1] - cpu.bounds[0])
        error = np.abs(cpu.distances - gpu.distances).max() / diagonal
        signs = np.count_nonzero(np.signbit(cpu.distances) != np.signbit(gpu.distances))
        pixels = np.count_nonzero(frames[0].object_id != frames[1].object_id)
        label = str(path or "knot").rsplit("/", 1)[-1]
        print(
            f"{label:24} {len(mesh.faces):8} {cpu_s:9.3f} {gpu_s:9.3f} {cpu_s / gpu_s:10.2f} {error:11.1e} {signs:6} {pixels:7}"
        )
    print(f"device: {name}")


if __name__ == "__main__":
    main()
