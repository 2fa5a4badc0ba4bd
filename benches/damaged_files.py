"""Damaged files through every reader of fields: no crash, no other exception than FormatError, no hang, bounded memory.

Each file follows from its seed. Finished blocks of seeds are kept in a JSON file, where an interrupted run goes on:

    python benches/damaged_files.py --count 100000 --state damaged.json
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fieldbake as fb

#: Seeds that are finished together, and the seconds of processor time that one file may take.
BLOCK, MOST_SECONDS = 500, 5.0
#: Address space of the process, bytes. A reader that allocates an unchecked size from a file exceeds it.
MEMORY = 6 << 30
WORDS = (0, 1, 4, 2**31, 2**32 - 1)


def sources(folder: Path) -> list[tuple[Path, Path, bytes]]:
    """Valid files of every format and encoding: the file to damage, the file to read, and the bytes of the first.

    The first is the JSON beside the second, or the second itself.
    """
    volume = fb.bake(fb.models.gear(), (13, 12, 9))
    wanted: list[tuple[str, dict[str, object]]] = [
        (".npz", {}),
        (".nrrd", {}),
        (".nrrd", {"compression": "none"}),
        (".vti", {}),
        (".vti", {"compression": "none"}),
        (".vf", {}),
        (".exr", {}),
        (".exr", {"encoding": "float16"}),
        (".vdb", {}),
        (".vdb", {"compression": "none"}),
        (".vdb", {"encoding": "float16"}),
        (".nvdb", {}),
    ]
    wanted += [(ending, {"encoding": name}) for ending in (".dds", ".ktx2") for name in ("float32", "snorm8", "unorm8")]
    wanted += [(".ktx2", {"mipmaps": True, "encoding": "float16"})]
    atlas = fb.pack([volume, volume.quantize("snorm16")], page_size="fit")
    aside = np.eye(4)
    aside[0, 3] = 5
    nested = fb.merge([volume, (volume, aside)], 8, levels=2, center=(0, 0, 0))
    stored: list[tuple[Any, str, dict[str, object]]] = [(volume, *one) for one in wanted]
    stored += [(one, ".npz", {}) for one in (volume.to_sparse(), volume.quantize("snorm8"), nested, atlas)]
    stored += [(atlas, ".exr", {}), (atlas, ".png", {})]
    found = []
    for number, (one, ending, options) in enumerate(stored):
        path = folder / f"{number}{ending}"
        one.save(path, **options)
        beside = path.with_name(f"{path.name}.json")
        if beside.exists():
            # Without the checksum the damage reaches the readers.
            facts = json.loads(beside.read_text())
            del facts["checksum"]
            beside.write_text(json.dumps(facts))
        found += [(one, path, one.read_bytes()) for one in (path, beside) if one.exists()]
    return found


def samples(found: Any) -> list[NDArray[np.float32]]:
    """All distances of any object that a file can hold."""
    if isinstance(found, fb.Atlas):
        return [found.unpack(i).distances for i in found.indices]
    if isinstance(found, fb.NestedField):
        return [level.distances for level in found.levels]
    return [(found.to_volume() if isinstance(found, fb.SparseVolume) else found).distances]


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """A file with bits, bytes or words changed, parts left out or repeated, or its end cut off."""
    data = bytearray(content)
    # Most damage goes to the first bytes, whose fields the reader follows.
    reach = len(data) if random.integers(3) == 0 else min(len(data), 600)
    for _ in range(int(random.integers(1, 6))):
        if not data:
            break
        at = int(random.integers(min(reach, len(data))))
        kind = int(random.integers(6))
        if kind == 0:
            data[at] ^= 1 << int(random.integers(8))
        elif kind == 1:
            data[at] = int(random.choice([0, 1, 0x7F, 0x80, 0xFF]))
        elif kind == 2:
            data[at : at + 4] = int(random.choice(WORDS)).to_bytes(4, "little")
        elif kind == 3:
            del data[at : at + int(random.integers(1, 9))]
        elif kind == 4:
            data[at:at] = data[at : at + int(random.integers(1, 65))]
        else:
            data = data[: max(at, 1)]
    return bytes(data)


def main() -> None:
    """Run the seeds that the state does not have."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--state", type=Path, default=Path("damaged.json"))
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    state = json.loads(options.state.read_text()) if options.state.exists() else {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = sources(folder)
        for first in range(0, options.count, BLOCK):
            if str(first) in state:
                continue
            counts = {"refused": 0, "read": 0, "slowest": 0.0}
            for seed in range(first, min(first + BLOCK, options.count)):
                target, path, content = files[seed % len(files)]
                target.write_bytes(damaged(content, np.random.default_rng(seed)))
                start = time.process_time()
                try:
                    found = fb.load(path)
                    assert all(np.isfinite(one).all() for one in samples(found)), f"seed {seed}: not finite"
                    counts["read"] += 1
                except (fb.FormatError, fb.CapacityError):
                    counts["refused"] += 1
                except BaseException:
                    print(f"seed {seed}, {target.name}")
                    raise
                target.write_bytes(content)
                counts["slowest"] = max(counts["slowest"], time.process_time() - start)
            assert counts["slowest"] <= MOST_SECONDS, f"block {first}: {counts['slowest']:.1f} s"
            state[str(first)] = counts
            options.state.write_text(json.dumps(state))
    blocks = list(state.values())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    refused, read = (sum(block[key] for block in blocks) for key in ("refused", "read"))
    slowest = max(block["slowest"] for block in blocks)
    print(f"{refused + read:,} files: {refused:,} refused, {read:,} read; slowest {slowest:.2f} s; peak {peak:.0f} MiB")


if __name__ == "__main__":
    main()
