"""Files for other programs: textures of volumes, images of atlases, grids for ParaView and 3D Slicer.

=========  ========  ===================================================================================
ending     what      contents
=========  ========  ===================================================================================
``.dds``   Volume    3D texture: R32_FLOAT, R16_FLOAT, R16_SNORM or R8_SNORM; facts in a JSON beside it
``.ktx2``  Volume    the same formats of Vulkan; facts as JSON under the key ``fieldbake``
``.nrrd``  Volume    float, with the grid's place in space; needs ``pynrrd``
``.exr``   Atlas     one channel ``Y``, pages below each other; facts in a JSON beside it
``.png``   Atlas     16 bits (8 for snorm8) around the middle, pages below each other; facts in a JSON beside it
=========  ========  ===================================================================================

The JSON beside ``name.exr`` is ``name.exr.json``. Sizes are compared with it before anything is unpacked.
"""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import Atlas, normalised_copy
from ..atlases.pages import TEXELS, choice, scale_of
from ..base import checks
from ..base.errors import ArgumentError, FormatError
from ..volumes.volume import Volume, check_distances
from .npz import ATLAS_ARRAYS, MAX_HEADER_BYTES, atomic_write, check_version, head, make_atlas, read_facts

#: Endings of each kind of object, besides .npz.
VOLUME_ENDINGS = (".dds", ".ktx2", ".nrrd")
ATLAS_ENDINGS = (".exr", ".png")

#: The JSON of an atlas has a few hundred bytes for each volume.
MAX_SIDECAR_BYTES = 64 << 20


def save_volume_as(volume: Volume, path: str | os.PathLike[str], encoding: str, band: float) -> None:
    """Write a volume as .dds, .ktx2 or .nrrd."""
    target = Path(path)
    kind = target.suffix.lower()[1:]
    encoding = choice("encoding", encoding, tuple(TEXELS))
    scale = scale_of(volume, checks.number("band", band, above=0))
    facts = {
        **head("volume texture"),
        "resolution": list(volume.resolution),
        "encoding": encoding,
        "scale": scale if encoding.startswith("snorm") else 1.0,
        "bounds": volume.bounds.tolist(),
        "inner_bounds": volume.inner_bounds.tolist(),
        "report": volume.report.to_dict(),
    }
    if kind == "nrrd":
        if encoding != "float32":
            raise ArgumentError(f'encoding: .nrrd files hold "float32", got {encoding!r}')
        _write_nrrd(volume, target, json.dumps(facts))
        return
    content = _core.texture_write(kind, volume.distances, encoding, scale, json.dumps(facts))
    with atomic_write(target) as stream:
        stream.write(content)
    if kind == "dds":
        _write_sidecar(target, facts)


def load_volume_from(path: Path) -> Volume:
    """Read what :func:`save_volume_as` wrote."""
    kind = path.suffix.lower()[1:]
    if kind == "nrrd":
        return _read_nrrd(path)
    encoding, size, texels, text = _core.texture_read(kind, path.read_bytes())
    facts = _read_sidecar(path) if kind == "dds" else _parse(text)
    _expect(facts, "volume texture")
    if facts.get("encoding") != encoding or facts.get("resolution") != list(size):
        raise FormatError(f"the texture is {list(size)} {encoding}, its facts are of another one")
    try:
        scale = checks.number("scale", facts.get("scale"), above=0)
    except ArgumentError as error:
        raise FormatError(str(error)) from None
    samples = _core.texture_decode(np.frombuffer(texels, np.uint8), size, encoding, scale)
    return _volume(samples, facts)


def save_atlas_as(atlas: Atlas, path: str | os.PathLike[str]) -> None:
    """Write an atlas as .exr or .png, with its JSON; .png with a preview for people beside it."""
    target = Path(path)
    if not len(atlas._pages):
        raise FormatError(f"{path}: the atlas is empty, and an image of nothing cannot be written")
    is_png = target.suffix.lower() == ".png"
    if is_png and not atlas.encoding.startswith("snorm"):
        atlas = normalised_copy(atlas, "snorm16")
    size = atlas.page_size
    stacked = atlas._pages.reshape(-1, size)
    facts = {
        **head("atlas image"),
        "layout": atlas.layout,
        "page_size": size,
        "pages": len(atlas._pages),
        "gutter": atlas.gutter,
        "encoding": atlas.encoding,
        "band": atlas.band,
        "volumes": [_volume_facts(atlas, i) for i in range(len(atlas._blocks))],
    }
    content = _png(stacked) if is_png else _exr(stacked)
    _write_sidecar(target, facts)
    with atomic_write(target) as stream:
        stream.write(content)
    if is_png:
        with atomic_write(target.with_suffix(".preview.png")) as stream:
            stream.write(_preview(stacked))


def load_atlas_from(path: Path) -> Atlas:
    """Read what :func:`save_atlas_as` wrote."""
    facts = _read_sidecar(path)
    _expect(facts, "atlas image")
    try:
        size = checks.integer("page_size", facts.get("page_size"), least=1, most=1 << 15)
        count = checks.integer("pages", facts.get("pages"), least=1, most=1 << 16)
        encoding = choice("encoding", facts.get("encoding"), tuple(TEXELS))
    except ArgumentError as error:
        raise FormatError(str(error)) from None
    read = _read_png if path.suffix.lower() == ".png" else _read_exr
    pages = read(path, size, count * size, encoding).reshape(count, size, size)
    volumes = facts.get("volumes")
    if not isinstance(volumes, list):
        raise FormatError("volumes must be a list")
    columns = {name: [_column(facts, name) for facts in volumes] for name in (*ATLAS_ARRAYS, "report")}
    kinds = {"blocks": (np.uint32, (10,)), "boxes": (np.float64, (4, 3)), "models": (np.float64, (4, 4))}
    arrays: dict[str, NDArray[Any]] = {
        name: np.array(columns[name], kind).reshape(-1, *shape) for name, (kind, shape) in kinds.items()
    }
    arrays["scales"] = np.array(columns["scales"], np.float32)
    return make_atlas(facts, arrays, columns["report"], pages)


# --- facts


def _expect(facts: dict[str, Any], kind: str) -> None:
    check_version(facts)
    if facts.get("kind") != kind:
        raise FormatError(f"holds something else than a {kind}: {str(facts.get('kind'))[:60]}")


def _sidecar(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def _write_sidecar(path: Path, facts: dict[str, Any]) -> None:
    with atomic_write(_sidecar(path)) as stream:
        stream.write(json.dumps(facts, indent=1).encode())


def _read_sidecar(path: Path) -> dict[str, Any]:
    beside = _sidecar(path)
    if not beside.is_file():
        raise FormatError(f"{beside.name} is missing: it says what the texels are")
    if beside.stat().st_size > MAX_SIDECAR_BYTES:
        raise FormatError(f"{beside.name} has more than {MAX_SIDECAR_BYTES} bytes")
    return _parse(beside.read_bytes())


def _parse(text: str | bytes) -> dict[str, Any]:
    if len(text) > MAX_SIDECAR_BYTES:
        raise FormatError("the facts are too long")
    facts = json.loads(text) if text else None
    if not isinstance(facts, dict):
        raise FormatError("is not a fieldbake file: it has no facts of ours")
    return facts


def _volume(samples: NDArray[np.float32], facts: dict[str, Any]) -> Volume:
    bounds, inner, report = read_facts(facts)
    try:
        return Volume._wrap(check_distances(samples), bounds, inner, report)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


#: The numbers of a block by name, in their order.
_BLOCK = {"page": 1, "corner": 2, "tile": 2, "columns": 1, "gutter": 1, "shape": 3}


def _volume_facts(atlas: Atlas, i: int) -> dict[str, Any]:
    """An entry for people and engines."""
    block: dict[str, Any] = {}
    numbers = iter(atlas._blocks[i].tolist())
    for name, count in _BLOCK.items():
        values = [next(numbers) for _ in range(count)]
        block[name] = values if count > 1 else values[0]
    inner_lower, inner_upper, lower, upper = atlas._boxes[i].tolist()
    return {
        **block,
        "bounds": [lower, upper],
        "inner_bounds": [inner_lower, inner_upper],
        "model": atlas._models[i].tolist(),
        "scale": float(atlas._scales[i]),
        "report": atlas._reports[i].to_dict(),
    }


def _column(facts: Any, name: str) -> Any:
    """What :func:`_volume_facts` said, as the arrays of an atlas have it."""
    if not isinstance(facts, dict):
        raise FormatError("volumes must be objects")
    if name == "blocks":
        return [n for key, count in _BLOCK.items() for n in (facts[key] if count > 1 else [facts[key]])]
    if name == "boxes":
        return [*facts["inner_bounds"], *facts["bounds"]]
    return facts[{"models": "model", "scales": "scale", "report": "report"}[name]]


# --- images


def _exr(stacked: NDArray[Any]) -> bytes:
    height, width = stacked.shape
    encoding = "float16" if stacked.dtype == np.float16 else "float32"
    # What a sampler returns for a normalised integer; the integer is found again by rounding.
    values = stacked if stacked.dtype.kind == "f" else _shares(stacked)
    return _core.exr_write(np.ascontiguousarray(values).reshape(-1).view(np.uint8), width, height, encoding)


def _read_exr(path: Path, width: int, height: int, encoding: str) -> NDArray[Any]:
    content = _core.exr_read(path.read_bytes(), width, height, encoding)
    if encoding.startswith("float"):
        return np.frombuffer(bytearray(content), TEXELS[encoding])
    values = np.frombuffer(content, np.float32)
    if not (np.abs(values) <= 1).all():
        raise FormatError("normalised texels must be from -1 to 1")
    texel = TEXELS[encoding]
    return np.round(values.astype(np.float64) * np.iinfo(texel).max).astype(texel)


def _shares(texels: NDArray[Any]) -> NDArray[np.float32]:
    shares: NDArray[np.float32] = (texels / np.float64(np.iinfo(texels.dtype).max)).astype(np.float32)
    return shares


def _png(stacked: NDArray[Any]) -> bytes:
    # Counted from the middle: 0 becomes 32768 or 128.
    bits = 8 * stacked.itemsize
    unsigned = np.uint8 if bits == 8 else np.uint16
    return _png_bytes((stacked.astype(np.int32) + (1 << (bits - 1))).astype(unsigned))


def _read_png(path: Path, width: int, height: int, encoding: str) -> NDArray[Any]:
    from PIL.PngImagePlugin import PngImageFile

    if not encoding.startswith("snorm"):
        raise FormatError(f"a .png holds normalised texels, the facts say {encoding}")
    texel = TEXELS[encoding]
    # Not Image.open, which takes large atlases for bombs; their size is compared before they are unpacked.
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


def _preview(stacked: NDArray[Any]) -> bytes:
    """Grey for people: the surface in the middle, dark inside."""
    return _png_bytes(np.round(127.5 + 127.5 * _shares(stacked)).astype(np.uint8))


def _png_bytes(pixels: NDArray[Any]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()


# --- NRRD


def _nrrd() -> Any:
    try:
        import nrrd
    except ImportError:
        raise FormatError(".nrrd files need the package pynrrd: pip install pynrrd") from None
    return nrrd


def _write_nrrd(volume: Volume, target: Path, facts: str) -> None:
    header = {
        "space": "3D-right-handed",
        "space directions": np.diag(volume.spacing),
        "space origin": volume.origin,
        "centerings": ["cell"] * 3,
        "kinds": ["domain"] * 3,
        "encoding": "raw",
        "endian": "little",
        "fieldbake": facts,
    }
    nrrd = _nrrd()
    with atomic_write(target) as stream:
        nrrd.write(stream, volume.distances, header, index_order="F")


def _read_nrrd(path: Path) -> Volume:
    nrrd = _nrrd()
    with open(path, "rb") as stream:
        # One line at a time, and never another file: the header may name one.
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
    facts = _parse(str(header.get("fieldbake", "")))
    _expect(facts, "volume texture")
    if facts.get("resolution") != sizes:
        raise FormatError(f"the samples are {sizes}, their facts are of {facts.get('resolution')}")
    return _volume(samples, facts)
