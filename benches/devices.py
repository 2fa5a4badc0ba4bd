"""The same bake and picture on the CPU and on a graphics device: times, and the largest difference.

    python benches/devices.py [--device gpu] [--resolution 64] mesh ...

Without arguments a knot is baked. Each line names the device. A software adapter (llvmpipe, SwiftShader) does not
represent a GPU.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path

import numpy as np

import fieldbake as fb
from measuring import timed


def best_of(count, call):
    """Result and the shortest time, after one call that warms up."""
    call()
    times = timed(call, count)
    return times.result, times.least


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*")
    parser.add_argument("--device", default="gpu")
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=1)
    options = parser.parse_args()

    if all(found.type == "cpu" for found in fb.devices()):
        print("no graphics adapter: install a Vulkan driver, for example Mesa's lavapipe")
        return
    row = "{:24} {:>8} {:>9} {:>9} {:>10} {:>11} {:>6} {:>7}"
    print(row.format("mesh", "faces", "cpu s", "device s", "cpu/device", "error/diag", "signs", "pixels"))
    name = ""
    for path in options.meshes or [None]:
        mesh = fb.load_mesh(path) if path else fb.models.torus_knot()
        bake = functools.partial(fb.bake, mesh, options.resolution)
        cpu, cpu_s = best_of(options.repeat, functools.partial(bake, device="cpu"))
        gpu, gpu_s = best_of(options.repeat, functools.partial(bake, device=options.device))
        name = gpu.report.device
        frames = [fb.raymarch(volume, device=device) for volume, device in ((cpu, "cpu"), (gpu, options.device))]
        diagonal = np.linalg.norm(cpu.bounds[1] - cpu.bounds[0])
        error = np.abs(cpu.distances - gpu.distances).max() / diagonal
        signs = np.count_nonzero(np.signbit(cpu.distances) != np.signbit(gpu.distances))
        pixels = np.count_nonzero(frames[0].object_id != frames[1].object_id)
        label = Path(path).name if path else "knot"
        times = f"{cpu_s:.3f}", f"{gpu_s:.3f}", f"{cpu_s / gpu_s:.2f}"
        print(row.format(label, len(mesh.faces), *times, f"{error:.1e}", signs, pixels))
    print(f"device: {name}")


if __name__ == "__main__":
    main()
