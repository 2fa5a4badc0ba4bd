"""Readers of the formats that other programs share: grids and textures of volumes, images of atlases.

The writers are in ``volumes/writers.py`` and ``atlases/images.py``, and the layouts of the files in ``files/``. A file
of another program has no metadata of fieldbake, and the box of the volume is that of its grid. The JSON beside
``name.exr`` is ``name.exr.json``. Sizes are compared with each other and with the bytes of the file before anything is
unpacked.
"""

from __future__ import annotations

import io
from collections.abc import Callable
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
from ..files import flipbook, nanovdb_reader, nrrd, openvdb_reader, sidecar, texture_files, vector_field, vti
from ..files.container import read_facts
from ..files.grid_samples import GridSamples
from ..files.openvdb_reader import VdbGrid
from ..volumes.quantized import QuantizedVolume
from ..volumes.stored_samples import check_distances
from ..volumes.volume import Volume
from .npz import make_atlas, read_scale


def load_volume(path: Path) -> Volume:
    """Read a grid that :meth:`Volume.save` or another program wrote."""
    kind = path.suffix.lower()
    if kind == ".dds":
        data, own = sidecar.read_both(path)
        texture = texture_files.read_dds(data)
        return _decoded(texture.levels[0], texture.encoding, own)
    if kind == ".vf":
        data, facts = sidecar.read(path)
        samples = vector_field.read(data)
        if facts is not None:
            return _own(samples, facts)
        # Unity's own fields have a longest side of 1, about the origin.
        spacing = np.full(3, 1 / max(samples.shape))
        return _placed(GridSamples(samples, (1 - np.array(samples.shape)) * spacing / 2, spacing))
    if kind == ".nvdb":
        data, facts = sidecar.read(path)
        return _placed(_on_grid(nanovdb_reader.read(data), facts))
    data = path.read_bytes()
    if kind == ".ktx2":
        texture = texture_files.read_ktx2(data)
        return _decoded(texture.levels[0], texture.encoding, sidecar.parse(texture.facts))
    if kind == ".vdb":
        return _placed(_read_level_set(data))
    return _placed(vti.read(data) if kind == ".vti" else nrrd.read(data))


def _decoded(texels: NDArray[Any], encoding: str, facts: dict[str, Any]) -> Volume:
    """Make the volume of texels (nx, ny, nz) with the metadata of their file. Encodings other than unorm8 are kept."""
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


def _read_level_set(data: bytes) -> GridSamples:
    grid = openvdb_reader.read(data)
    text = grid.metadata.get("fieldbake")
    return _on_grid(grid, None if text is None else sidecar.parse(text))


def _on_grid(grid: VdbGrid, facts: dict[str, Any] | None) -> GridSamples:
    """Make the dense grid of a tree: the grid of the metadata if it fits, else the active voxels and one around."""
    band = grid.background if grid.kind == "level set" else 0.0
    window = None if facts is None else _window_of(grid, facts)
    if window is None:
        facts = None
        low, high = grid.active_box()
        window = low - 1, high + 1
    return GridSamples(grid.dense(*window), grid.origin + window[0] * grid.spacing, grid.spacing, facts, band)


def _window_of(grid: VdbGrid, facts: dict[str, Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Find the first and last voxel of the grid in the metadata; None if another program moved or scaled the tree."""
    box = read_facts(facts)[0]
    sizes = facts.get("resolution")
    if not isinstance(sizes, list) or len(sizes) != 3 or not all(type(n) is int and 0 < n < 2**31 for n in sizes):
        raise FormatError(f"the metadata must state three numbers of voxels, got {str(sizes)[:60]}")
    spacing = (box[1] - box[0]) / sizes
    first = (box[0] + spacing / 2 - grid.origin) / spacing
    is_near = np.abs(first - np.rint(first)).max() <= 1e-3 and np.abs(first).max() <= openvdb_reader.FARTHEST
    if not (is_near and np.allclose(spacing, grid.spacing, rtol=1e-6)):
        return None
    low = np.rint(first).astype(np.int64)
    return low, low + np.array(sizes) - 1


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
    """Make a volume of a grid. Without metadata its box is that of the grid."""
    if grid.facts is not None:
        return _own(grid.samples, grid.facts, grid.band)
    try:
        bounds = checks.box("bounds", grid.bounds)
        return Volume._wrap(check_distances(grid.samples), bounds, bounds.copy(), Report(band=grid.band))
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def load_sheet(path: Path) -> Volume | Atlas:
    """Read an .exr image: the sheet of a volume or the pages of an atlas, as its sidecar states."""
    content, facts = sidecar.read_both(path)
    if facts.get("kind") != "volume texture":
        return _atlas(content, facts, _read_exr)
    sidecar.expect(facts, "volume texture")
    sizes = facts.get("resolution")
    sheet = flipbook.read_sheet(facts.get("sheet"), sizes if isinstance(sizes, list) else [])
    encoding = checks.choice("encoding", facts.get("encoding"), ("float32", "float16"), FormatError)
    texels = _core.exr_read(content, *sheet.size, encoding)
    pixels = np.frombuffer(bytearray(texels), encodings.DTYPES[encoding])
    return _decoded(flipbook.from_pixels(pixels, sheet), encoding, facts)


def load_image(path: Path) -> Atlas:
    """Read a .png file that :meth:`Atlas.save` wrote."""
    atlas = _atlas(*sidecar.read_both(path), _read_png)
    atlas._texels = "png"
    return atlas


def _atlas(content: bytes, facts: dict[str, Any], read: Callable[[bytes, int, int, str], NDArray[Any]]) -> Atlas:
    """Make the atlas of an image with the metadata of its file; `read` decodes its texels."""
    sidecar.expect(facts, "atlas image")
    try:
        size = checks.integer("page_size", facts.get("page_size"), least=1, most=1 << 15)
        count = checks.integer("pages", facts.get("pages"), least=1, most=1 << 16)
        encoding = checks.choice("encoding", facts.get("encoding"), encodings.NAMES)
    except ArgumentError as error:
        raise FormatError(str(error)) from None
    pages = read(content, size, count * size, encoding).reshape(count, size, size)
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
    return make_atlas(facts, arrays, columns["report"], names, pages)


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


# --- images


def _read_exr(data: bytes, width: int, height: int, encoding: str) -> NDArray[Any]:
    content = _core.exr_read(data, width, height, encoding)
    if encoding.startswith("float"):
        return np.frombuffer(bytearray(content), encodings.DTYPES[encoding])
    values = np.frombuffer(content, np.float32)
    if not (np.abs(values) <= 1).all():
        raise FormatError("normalised texels must be from -1 to 1")
    texel = encodings.DTYPES[encoding]
    return np.round(values.astype(np.float64) * np.iinfo(texel).max).astype(texel)


def _read_png(data: bytes, width: int, height: int, encoding: str) -> NDArray[Any]:
    from PIL.PngImagePlugin import PngImageFile

    if not encoding.startswith("snorm"):
        raise FormatError(f"a .png holds normalised texels, but its JSON file has the encoding {encoding}")
    texel = encodings.DTYPES[encoding]
    # Image.open is not used, because it refuses large images as decompression bombs. The size is compared before
    # decoding.
    try:
        with PngImageFile(io.BytesIO(data)) as image:
            modes = ("L",) if texel.itemsize == 1 else ("I;16", "I")
            if image.size != (width, height) or image.mode not in modes:
                told = f"{image.size} {image.mode}, the metadata states {(width, height)} {encoding}"
                raise FormatError(f"the image is {told}")
            values = np.asarray(image).astype(np.int32)
    except (OSError, SyntaxError) as error:  # Pillow raises these for a damaged file
        raise FormatError(f"the image is damaged ({error})") from None
    return (values - (1 << (8 * texel.itemsize - 1))).astype(texel)
