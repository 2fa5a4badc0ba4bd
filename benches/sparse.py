"""Sparse volumes beside dense ones: time to bake, time to draw, bytes.

    python benches/sparse.py            # the bunny at 256 and 512
    python benches/sparse.py -r 128     # another resolution

Runs alternate, so that other work on the machine touches both alike; the least time of each is shown.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import fieldbake as fb
from measuring import interleaved
from meshes import find

#: Pixels of the pictures.
SIZE = (512, 512)


def compare(mesh: fb.Mesh, resolution: int, rounds: int) -> None:
    """Bake and draw each form, and print a table."""
    forms: dict[str, Callable[[], fb.Volume | fb.SparseVolume]] = {
        "dense": lambda: fb.bake(mesh, resolution, device="cpu"),
        "dense, band=4": lambda: fb.bake(mesh, resolution, band=4, device="cpu"),
        "sparse, tolerance=None": lambda: fb.bake_sparse(mesh, resolution, tolerance=None),
        "sparse": lambda: fb.bake_sparse(mesh, resolution),
        "sparse, float16": lambda: fb.bake_sparse(mesh, resolution, encoding="float16"),
        "sparse, snorm8": lambda: fb.bake_sparse(mesh, resolution, encoding="snorm8"),
    }
    baked = {name: form() for name, form in forms.items()}
    camera = fb.Camera.fit(baked["dense"].inner_bounds)
    baking = interleaved(forms, rounds)
    pictures = {
        name: lambda volume=volume: fb.raymarch(volume, camera, size=SIZE, device="cpu")
        for name, volume in baked.items()
    }
    drawing = interleaved(pictures, 3 * rounds)
    dense = baked["dense"].nbytes
    print(f"\n{mesh} at {resolution}\n{'':<24} {'bake':>8} {'draw':>8} {'MiB':>8} {'share':>7}")
    for name, volume in baked.items():
        size = f"{volume.nbytes / 2**20:8.1f} {volume.nbytes / dense:7.1%}"
        print(f"{name:<24} {baking[name].least:6.2f} s {drawing[name].least * 1e3:5.0f} ms {size}")


def main() -> None:
    """Compare at the requested resolutions."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("-r", "--resolution", type=int, nargs="*", default=[256, 512])
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    _, vertices, faces = next(find())
    for resolution in options.resolution:
        compare(fb.Mesh(vertices, faces), resolution, options.rounds)


if __name__ == "__main__":
    main()
