"""Readers of the formats of other programs: textures of volumes, images of atlases, .nrrd grids.

=========  ========  ===================================================================================
ending     what      contents
=========  ========  ===================================================================================
``.dds``   Volume    3D texture: R32_FLOAT, R16_FLOAT, R16_SNORM or R8_SNORM; facts in a JSON beside it
``.ktx2``  Volume    the same formats of Vulkan; facts as JSON under the key ``fieldbake``; orientation ``ruo``
``.nrrd``  Volume    float, with the grid's place in space; needs ``pynrrd``
``.exr``   Atlas     one channel ``Y``, pages below each other; facts in a JSON beside it
``.png``   Atlas     unsigned 16 bits (8 for snorm8), pages below each other; facts in a JSON beside it
=========  ========  ===================================================================================

The JSON file beside ``name.exr`` is ``name.exr.json``. Sizes are compared with it before anything is decompressed.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import Atlas
from ..atlases.pages import ARRAYS, BLOCK, BLOCK_NUMBERS
from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from ..files import sidecar
from ..files.container import MAX_HEADER_BYTES, read_facts
from ..volumes.textures import nrrd_package
from ..volumes.volume import Volume, check_distances
from .npz import make_atlas, read_scale


def load_texture(path: Path) -> Volume:
    """Read a file that :meth:`Volume.save` wrote."""
    kind = path.suffix.lower()[1:]
    if kind == "nrrd":
        return _read_nrrd(path)
    encoding, size, texels, text = _core.texture_read(kind, path.read_bytes())
    facts = sidecar.read_beside(path) if kind == "dds" else sidecar.parse(text)
    sidecar.expect(facts, "volume texture")
    if facts.get("encoding") != encoding or facts.get("resolution") != list(size):
        raise FormatError(f"the texture is {list(size)} {encoding}, its facts are of another one")
    scale = read_scale(facts, encoding)
    samples = _core.texture_decode(np.frombuffer(texels, np.uint8), size, encoding, scale)
    return _volume(samples, facts)


def load_image(path: Path) -> Atlas:
    """Read a file that :meth:`Atlas.save` wrote."""
    facts = sidecar.read_beside(path)
    sidecar.expect(facts, "atlas image")
    try:
        size = checks.integer("page_size", facts.get("page_size"), least=1, most=1 << 15)
        count = checks.integer("pages", facts.get("pages"), least=1, most=1 << 16)
        encoding = checks.choice("encoding", facts.get("encoding"), encodings.NAMES)
    except ArgumentError as error:
        raise FormatError(str(error)) from None
    is_png = path.suffix.lower() == ".png"
    read = _read_png if is_png else _read_exr
    pages = read(path, size, count * size, encoding).reshape(count, size, size)
    volumes = facts.get("volumes")
    if not isinstance(volumes, list):
        raise FormatError("volumes must be a list")
    columns = {name: [_column(facts, name) for facts in volumes] for name in (*ARRAYS, "report")}
    kinds = {"blocks": (np.uint32, (BLOCK_NUMBERS,)), "boxes": (np.float64, (4, 3)), "models": (np.float64, (4, 4))}
    arrays: dict[str, NDArray[Any]] = {
        name: np.array(columns[name], kind).reshape(-1, *shape) for name, (kind, shape) in kinds.items()
    }
    arrays["scales"] = np.array(columns["scales"], np.float32)
    atlas = make_atlas(facts, arrays, columns["report"], pages)
    atlas._texels = "png" if is_png else "pages"
    return atlas


def _volume(samples: NDArray[np.float32], facts: dict[str, Any]) -> Volume:
    bounds, inner, report = read_facts(facts)
    try:
        return Volume._wrap(check_distances(samples), bounds, inner, report)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


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


def _read_exr(path: Path, width: int, height: int, encoding: str) -> NDArray[Any]:
    content = _core.exr_read(path.read_bytes(), width, height, encoding)
    if encoding.startswith("float"):
        return np.frombuffer(bytearray(content), encodings.DTYPES[encoding])
    values = np.frombuffer(content, np.float32)
    if not (np.abs(values) <= 1).all():
        raise FormatError("normalised texels must be from -1 to 1")
    texel = encodings.DTYPES[encoding]
    return np.round(values.astype(np.float64) * np.iinfo(texel).max).astype(texel)


def _read_png(path: Path, width: int, height: int, encoding: str) -> NDArray[Any]:
    from PIL.PngImagePlugin import PngImageFile

    if not encoding.startswith("snorm"):
        raise FormatError(f"a .png holds normalised texels, the facts say {encoding}")
    texel = encodings.DTYPES[encoding]
    # Image.open is not used, because it refuses large images as decompression bombs. The size is compared before
    # decoding.
    try:
        with PngImageFile(io.BytesIO(path.read_bytes())) as image:
            modes = ("L",) if texel.itemsize == 1 else ("I;16", "I")
            if image.size != (width, height) or image.mode not in modes:
                told = f"{image.size} {image.mode}, its facts are of {(width, height)} {encoding}"
                raise FormatError(f"the image is {told}")
            values = np.asarray(image).astype(np.int32)
    except (OSError, SyntaxError) as error:  # Pillow's words for a damaged file
        raise FormatError(f"the image is damaged ({error})") from None
    return (values - (1 << (8 * texel.itemsize - 1))).astype(texel)


# --- NRRD


def _read_nrrd(path: Path) -> Volume:
    nrrd = nrrd_package()
    with open(path, "rb") as stream:
        # The header is parsed line by line. A header that names another file is refused.
        text = stream.read(MAX_HEADER_BYTES).partition(b"\n\n")[0]
        stream.seek(0)
        header = nrrd.read_header(io.BytesIO(text + b"\n\n"))
        if "data file" in header or "datafile" in header or header.get("encoding") != "raw":
            raise FormatError("the samples must be in the file itself, and not compressed")
        if header.get("type") not in ("float", "float32") or len(header.get("sizes", ())) != 3:
            raise FormatError("the samples must be float32 in three dimensions")
        sizes = [int(n) for n in header["sizes"]]
        start = len(text) + 2
        expected = 4
        for n in sizes:
            expected *= max(n, 0)
        left = os.fstat(stream.fileno()).st_size - start
        if expected != left or not expected:
            raise FormatError(f"{sizes} samples need {expected} bytes, the file has {left}")
        stream.seek(start)
        samples = np.frombuffer(stream.read(), "<f4").reshape(sizes, order="F")
    facts = sidecar.parse(str(header.get("fieldbake", "")))
    sidecar.expect(facts, "volume texture")
    if facts.get("resolution") != sizes:
        raise FormatError(f"the samples are {sizes}, their facts are of {facts.get('resolution')}")
    return _volume(samples, facts)
