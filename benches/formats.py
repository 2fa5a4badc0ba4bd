"""Size of each file format, and the processor time of writing and reading it: the bunny at 256^3, or any mesh.

python benches/formats.py bunny.obj --resolution 256
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import fieldbake as fb
from measuring import timed

FORMATS = (
    (".npz", {}),
    (".vdb", {}),
    (".vdb", {"encoding": "float16"}),
    (".vdb", {"compression": "none"}),
    (".nvdb", {}),
    (".vti", {}),
    (".nrrd", {}),
    (".dds", {}),
    (".ktx2", {"encoding": "unorm8"}),
    (".ktx2", {"encoding": "float16", "mipmaps": True}),
    (".vf", {}),
    (".exr", {}),
)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--resolution", type=int, default=256)
    options = parser.parse_args()
    mesh = fb.load_mesh(options.mesh)
    volume = fb.bake(mesh, options.resolution)
    sparse = fb.bake_sparse(mesh, options.resolution)
    print(f"{' x '.join(map(str, volume.resolution))} voxels, {volume.nbytes / 2**20:.1f} MiB as float32\n")
    print("| file | options | MiB | seconds to write | seconds to read |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        rows = [(volume, *row) for row in FORMATS] + [(sparse, ".vdb", {}), (sparse, ".nvdb", {})]
        for field, ending, extra in rows:
            path = Path(folder) / f"field{ending}"
            written = timed(lambda field=field, path=path, extra=extra: field.save(path, **extra)).least_cpu
            read = timed(lambda path=path: fb.load(path)).least_cpu
            words = ", ".join(f"{name} {value}" for name, value in extra.items()) or "-"
            words = f"sparse, {words}" if field is sparse else words
            size = path.stat().st_size / 2**20
            print(f"| {ending} | {words} | {size:.2f} | {written:.2f} | {read:.2f} |")


if __name__ == "__main__":
    main()
