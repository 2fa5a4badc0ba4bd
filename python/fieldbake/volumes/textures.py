"""Volumes as 3D textures (.dds, .ktx2) and as .nrrd grids for ParaView and 3D Slicer.

A .ktx2 file stores the metadata as JSON under the key ``fieldbake``, a .nrrd file in a field of that name, and a .dds
file in a JSON file beside it. The entry ``decode`` is the formula for the distance of a texel.

The axes of the texture are those of the volume: x runs to the right, y up, and z towards the viewer. KTX 2 calls this
orientation ``ruo``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from ..files import container, sidecar
from ..files.container import atomic_write, head

#: Endings of the files that :func:`write` can write.
ENDINGS = container.ENDINGS["volume"][1:]


def write(
    path: str | os.PathLike[str],
    samples: NDArray[np.float32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    facts: dict[str, Any],
    encoding: str,
    band: float,
) -> None:
    """Write samples (nx, ny, nz) as .dds, .ktx2 or .nrrd, with the metadata of their grid."""
    target = Path(path)
    kind = target.suffix.lower()[1:]
    encoding = checks.choice("encoding", encoding, encodings.NAMES)
    scale = encodings.scale_of(encoding, spacing, checks.number("band", band, above=0))
    rule = encodings.texel_rule(target.suffix.lower(), encoding)
    facts = {**head("volume texture", encoding), **facts, "encoding": encoding, "scale": scale, **rule}
    if kind == "nrrd":
        if encoding != "float32":
            raise ArgumentError(f'encoding: .nrrd files hold "float32", got {encoding!r}')
        _write_nrrd(target, samples, origin, spacing, json.dumps(facts))
        return
    content = _core.texture_write(kind, samples, encoding, scale, json.dumps(facts))
    with atomic_write(target) as stream:
        stream.write(content)
    if kind == "dds":
        sidecar.write_beside(target, facts)


def _write_nrrd(
    target: Path, samples: NDArray[np.float32], origin: NDArray[np.float64], spacing: NDArray[np.float64], facts: str
) -> None:
    header = {
        "space": "3D-right-handed",
        "space directions": np.diag(spacing),
        "space origin": origin,
        "centerings": ["cell"] * 3,
        "kinds": ["domain"] * 3,
        "encoding": "raw",
        "endian": "little",
        "fieldbake": facts,
    }
    nrrd = nrrd_package()
    with atomic_write(target) as stream:
        nrrd.write(stream, samples, header, index_order="F")


def nrrd_package() -> Any:
    """Import the optional package pynrrd."""
    try:
        import nrrd
    except ImportError:
        raise FormatError(".nrrd files need the package pynrrd: pip install pynrrd") from None
    return nrrd
