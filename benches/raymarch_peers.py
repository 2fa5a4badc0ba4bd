"""Pictures of a sampled field beside mitsuba's `sdfgrid`: same samples, camera and pixels, one process, interleaved.

    python benches/raymarch_peers.py [mesh] [--resolution 128] [--size 512]

mitsuba draws depths only, with one ray a pixel; fieldbake draws depth, normals and colour. Both intersect the
trilinear interpolant of the samples. The grid is a cube, since mitsuba 3.9 misses the surface in
grids of unequal sides. mitsuba's LLVM variant needs an LLVM library of version 17 or newer, which DRJIT_LIBLLVM_PATH
names.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

import fieldbake as fb
from measuring import absent, interleaved, machine, record
from meshes import find, load


def mitsuba_picture(variant: str, volume: fb.Volume, camera: fb.Camera, size: int):
    """Return a function that draws the length of the ray of each pixel, and 0 for misses."""
    import mitsuba as mi

    mi.set_variant(variant)
    spacing, shape = volume.spacing, np.array(volume.resolution)
    first, extent = volume.origin, (shape - 1) * spacing
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "depth"},
            "shape": {
                "type": "sdfgrid",
                "grid": mi.TensorXf(np.ascontiguousarray(volume.distances.transpose(2, 1, 0))[..., None]),
                "to_world": mi.ScalarTransform4f().translate(first.tolist()).scale(extent.tolist()),
            },
            "sensor": {
                "type": "perspective",
                "fov": camera.fov_deg,
                "near_clip": 1e-4 * float(extent.max()),  # lengths of rays start there
                "to_world": mi.ScalarTransform4f().look_at(
                    origin=camera.eye.tolist(), target=(camera.eye - camera.pose[:3, 2]).tolist(), up=[0, 1, 0]
                ),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 1},
            },
        }
    )

    def draw() -> np.ndarray:
        mi.set_variant(variant)
        return np.array(mi.render(scene, spp=1))[..., 0]

    return draw


def probe(variant: str) -> None:
    """Draw a small picture, and end the process if the variant does not work."""
    volume = fb.bake(fb.sphere(1.0), 16)
    mitsuba_picture(variant, volume, fb.Camera.fit(volume.bounds), 16)()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", nargs="?", type=Path)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    name, vertices, faces = load(options.mesh) if options.mesh else next(find())
    volume = fb.bake(fb.Mesh(vertices, faces), (options.resolution,) * 3)
    camera, size = fb.Camera.fit(volume.inner_bounds), options.size
    jobs = {
        "fieldbake": lambda: fb.raymarch(volume, camera, size=(size, size), shadows="none", device="cpu").depth,
    }
    for variant in ("scalar_rgb", "llvm_ad_rgb"):
        try:
            # Older LLVM libraries end the process.
            probe = "import raymarch_peers as bench; bench.probe(" + repr(variant) + ")"
            ended = subprocess.run([sys.executable, "-c", probe], cwd=Path(__file__).parent, capture_output=True)
            if ended.returncode:
                raise OSError(f"its library ends the process with status {ended.returncode}")
            draw = mitsuba_picture(variant, volume, camera, size)
            draw()
        except Exception as error:
            absent(f"mitsuba {variant}", error)
        else:
            jobs[f"mitsuba {variant}"] = draw
    times = interleaved(jobs, options.repeat)
    ours = times.pop("fieldbake")
    print(f"{machine()}; {name} at {options.resolution}^3, {size} x {size} pixels, the least of {options.repeat} runs")
    print(f"fieldbake: {ours.least * 1e3:.1f} ms")
    for peer, theirs in times.items():
        hit = np.isfinite(ours.result)
        both = hit & (theirs.result > 0)
        middle = (np.arange(size) + 0.5 - size / 2) * 2 * np.tan(np.radians(camera.fov_deg) / 2) / size
        lengths = ours.result * np.sqrt(1 + middle**2 + middle[:, None] ** 2)
        # mitsuba's ray passes through a random point of the pixel, so the lengths agree to about a voxel.
        agree = np.mean(np.abs(lengths - theirs.result)[both] < 2 * volume.spacing.max())
        print(
            f"{peer}: {theirs.least * 1e3:.1f} ms, {theirs.least / ours.least:.1f} times as long; both hit "
            f"{both.sum() / hit.sum():.2%} of the hits, {agree:.2%} of them at the same depth to two voxels"
        )
        question = f"picture of a field, {name} at {options.resolution}^3, {size} px"
        record(question, peer.split("_", maxsplit=1)[0], ours.least, theirs.least)


if __name__ == "__main__":
    main()
