"""Times of packing and sampling an atlas, compared with a plain copy and with sampling the volumes.

    python benches/atlas.py [--count 64] [--side 64]

Runs are interleaved and medians are shown: elapsed time, and processor time of all cores, which other programs affect
less. The copy writes as many bytes as packing does, into newly allocated memory.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from measuring import interleaved


def side_by_side(calls: dict, repeat: int) -> dict[str, tuple[float, float]]:
    """Median elapsed and processor times of each call, run in turn after one call that warms up."""
    interleaved(calls, 1)
    return {name: (took.median, float(np.median(took.cpu))) for name, took in interleaved(calls, repeat).items()}


def show(title: str, times: dict[str, tuple[float, float]], yardstick: str) -> None:
    print(f"{title}\n  {'':28} {'clock':>12} {'':9} {'all cores':>12}")
    for name, took in times.items():
        columns = (f"{a * 1e3:9.2f} ms {a / b:7.2f} x" for a, b in zip(took, times[yardstick], strict=True))
        print(f"  {name:28} {' '.join(columns)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=64)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--repeat", type=int, default=15)
    options = parser.parse_args()
    random = np.random.default_rng(0)
    side = options.side
    values = random.uniform(-1, 1, (options.count, side, side, side)).astype(np.float32)
    volumes = [fb.Volume(v, [(-1, -1, -1), (1, 1, 1)]) for v in values]
    page = max(side * side, 64)

    # NumPy copies on one core; packing uses all cores.
    calls = {"plain copy": values.copy}
    for layout in ("strips", "shelves"):
        for encoding in ("float32", "float16", "snorm8"):
            name = f"{layout}, {encoding}"
            calls[name] = lambda layout=layout, encoding=encoding: fb.pack(
                volumes, layout=layout, encoding=encoding, page_size=page, device="cpu"
            )
    title = f"packing {options.count} volumes of {side}^3 ({values.nbytes >> 20} MiB) on pages of {page}^2"
    show(title, side_by_side(calls, options.repeat), "plain copy")

    points = random.uniform(-1, 1, (1_000_000, 3))
    which = options.count // 2
    calls = {"volume.sample": lambda: volumes[which].sample(points)}
    for layout in ("strips", "shelves"):
        for encoding in ("float32", "float16", "snorm8"):
            atlas = fb.pack(volumes, layout=layout, encoding=encoding, page_size=page)
            calls[f"{layout}, {encoding}"] = lambda atlas=atlas: atlas.sample(which, points)
    show("sampling 1,000,000 points", side_by_side(calls, options.repeat), "volume.sample")

    sides = random.integers(4, 49, (200, 3))
    mixed = [fb.Volume(np.zeros(shape, np.float32), [(0, 0, 0), (1, 1, 1)]) for shape in sides.tolist()]
    for size in (512, 1024):
        atlas = fb.pack(mixed, page_size=size)
        print(f"200 volumes of 4 to 48 voxels a side fill {len(atlas.pages)} pages of {size}^2 to {atlas.fill:.3f}")


if __name__ == "__main__":
    main()
