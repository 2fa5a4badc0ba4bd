"""Fields and atlases of the contents of files that other programs share.

The records of the formats read the files. A file of another program has no metadata of fieldbake, and the box of the
volume is the box of its grid. The JSON beside ``name.exr`` is ``name.exr.json``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import Atlas
from ..atlases.pages import ARRAYS, BLOCK, BLOCK_NUMBERS
from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from ..base.report import Report
from ..files import sidecar
from ..files.container import read_facts
from ..files.formats import Format, Pages, Texels
from ..files.grids.grid_samples import GridSamples
from ..volumes.quantized import QuantizedVolume
from ..volumes.stored_samples import check_distances
from ..volumes.volume import Volume
from .npz import make_atlas, read_scale


def load_format(path: Path, form: Format) -> Volume | Atlas:
    """Read a file of a format other than the container."""
    assert form.read is not None
    content = form.read(path)
    if isinstance(content, Pages):
        return _atlas(content)
    return _decoded(content) if isinstance(content, Texels) else _placed(content)


def _decoded(content: Texels) -> Volume:
    """Make the volume of texels with the metadata of their file. Encodings other than unorm8 are kept."""
    texels, encoding, facts = content.texels, content.encoding, content.facts
    sidecar.expect(facts, "volume texture")
    if facts.get("encoding") != encoding:
        raise FormatError(f"the texels are {encoding}, the metadata states {str(facts.get('encoding'))[:40]}")
    if encoding == "float32":
        return _own(texels, facts)
    scale = read_scale(facts, "snorm8" if encoding == "unorm8" else encoding)
    if encoding == "unorm8":
        return _own(encodings.from_unorm8(texels, scale), facts)
    if encoding == "float16" and not np.isfinite(texels).all():
        raise FormatError("a texel is not finite")
    texels = np.asfortranarray(texels)
    own = _own(_core.decode(texels, scale), facts)
    return QuantizedVolume._of(texels, encoding, scale, own.bounds, own.inner_bounds, own.report)


def _own(samples: NDArray[np.float32], facts: dict[str, Any], band: float = 0.0) -> Volume:
    """Make a volume of samples and the metadata that fieldbake wrote."""
    sidecar.expect(facts, "volume texture")
    if facts.get("resolution") != list(samples.shape):
        raise FormatError(f"the samples are {samples.shape}, the metadata states {str(facts.get('resolution'))[:60]}")
    bounds, inner, report = read_facts(facts)
    if band:
        report = replace(report, band=min(band, report.band or band))
    try:
        return Volume._wrap(check_distances(samples), bounds, inner, report)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def _placed(grid: GridSamples) -> Volume:
    """Make a volume of a grid. Without metadata its box is the box of the grid."""
    if grid.facts is not None:
        return _own(grid.samples, grid.facts, grid.band)
    try:
        bounds = checks.box("bounds", grid.bounds)
        return Volume._wrap(check_distances(grid.samples), bounds, bounds.copy(), Report(band=grid.band))
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def _atlas(content: Pages) -> Atlas:
    """Make the atlas of an image with the metadata of its file."""
    facts = content.facts
    volumes = facts.get("volumes")
    if not isinstance(volumes, list):
        raise FormatError("volumes must be a list")
    columns = {name: [_column(facts, name) for facts in volumes] for name in (*ARRAYS, "report")}
    kinds = {"blocks": (np.uint32, (BLOCK_NUMBERS,)), "boxes": (np.float64, (4, 3)), "models": (np.float64, (4, 4))}
    arrays: dict[str, NDArray[Any]] = {
        name: np.array(columns[name], kind).reshape(-1, *shape) for name, (kind, shape) in kinds.items()
    }
    arrays["scales"] = np.array(columns["scales"], np.float32)
    names = [volume.get("name", "") for volume in volumes]
    atlas = make_atlas(facts, arrays, columns["report"], names, content.pages)
    atlas._texels = content.texels
    return atlas


def _column(facts: Any, name: str) -> Any:
    """Extract one entry of all volumes from the metadata of :meth:`Atlas.save`, as an array."""
    if not isinstance(facts, dict):
        raise FormatError("volumes must be objects")
    if name == "blocks":
        parts = [np.array(facts[field], np.uint32) for field in BLOCK.names or ()]
        if any(part.shape != BLOCK[field].shape for part, field in zip(parts, BLOCK.names or (), strict=True)):
            raise FormatError("a volume must have a page, corner, tile, columns, gutter and shape")
        return np.concatenate([part.reshape(-1) for part in parts])
    if name == "boxes":
        return [*facts["inner_bounds"], *facts["bounds"]]
    return facts[{"models": "model", "scales": "scale", "report": "report"}[name]]
