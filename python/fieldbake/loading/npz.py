"""Readers of the .npz container, one for each kind of object that it can store."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import Atlas
from ..atlases.pages import ARRAYS, BLOCK_NUMBERS, MAX_GUTTER, MAX_PAGE_SIZE, VACANT, blocks_of
from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from ..files.container import members, read_array, read_facts, read_header, read_report
from ..files.formats import SCALED_FLOAT16_VERSION
from ..merging.nested import MAX_LEVELS, NestedField
from ..volumes.quantized import QuantizedVolume
from ..volumes.sparse import SparseVolume, restore_field
from ..volumes.stored_samples import check_distances
from ..volumes.volume import Volume


def read_archive(archive: zipfile.ZipFile, size: int) -> Volume | SparseVolume | NestedField | Atlas:
    """Read the object in an archive of `size` bytes."""
    found = members(archive, size)
    header = read_header(archive, found)
    reader = _READERS.get(str(header.get("kind")))
    if reader is None:
        raise FormatError(f"must hold a field or an atlas, got the kind {str(header.get('kind'))[:60]}")
    try:
        return reader(archive, found, header)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def _read_dense(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> Volume:
    bounds, inner_bounds, report = read_facts(header)
    distances = read_array(archive, members, "distances.npy")
    _check_samples(header, distances, "float32", 3)
    return Volume._wrap(check_distances(distances), bounds, inner_bounds, report)


def _read_quantized(
    archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]
) -> QuantizedVolume:
    bounds, inner_bounds, report = read_facts(header)
    encoding = _encoding(header, encodings.QUANTIZED)
    encoded = read_array(archive, members, "distances.npy")
    _check_samples(header, encoded, encoding, 3)
    scale = read_scale(header, encoding)
    _check_magnitude("distances", encoded, encoding, scale)
    return QuantizedVolume._of(np.asfortranarray(encoded), encoding, scale, bounds, inner_bounds, report)


def _read_sparse(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> SparseVolume:
    bounds, inner_bounds, report = read_facts(header)
    encoding = _encoding(header, encodings.NAMES)
    arrays = {name: read_array(archive, members, f"{name}.npy") for name in ("index", "nodes", "bricks")}
    _check_samples(header, arrays["bricks"], encoding, 4)
    shape = header.get("resolution")
    if not isinstance(shape, list) or len(shape) != 3 or not all(type(n) is int and 0 < n < 2**31 for n in shape):
        raise FormatError(f"the header's resolution must be three whole numbers, got {shape!r:.60}")
    if arrays["bricks"].shape[1:] != (8, 8, 8) or arrays["index"].ndim != 3 or arrays["nodes"].ndim != 3:
        raise FormatError("the bricks, their index or their nodes have the wrong shape")
    if arrays["index"].dtype != np.dtype("<u4") or arrays["nodes"].dtype != np.dtype("<f4"):
        raise FormatError("the index or the nodes have the wrong type")
    scale = read_scale(header, encoding)
    _check_magnitude("bricks", arrays["bricks"], encoding, scale)
    if not ((arrays["nodes"] >= 0) & (arrays["nodes"] <= checks.FAR)).all():
        raise FormatError(f"the nodes must be from 0 to {checks.FAR:g}")
    corners = checks.triple(bounds[0]), checks.triple(bounds[1])
    size = int(shape[0]), int(shape[1]), int(shape[2])
    field = restore_field(corners, size, _positive(header, "band"), scale, arrays)
    return SparseVolume._wrap(field, bounds, inner_bounds, report)


def _read_nested(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> NestedField:
    _, inner_bounds, report = read_facts(header)
    count = checks.integer("header: levels", header.get("levels"), least=1, most=MAX_LEVELS, error=FormatError)
    boxes = read_array(archive, members, "boxes.npy")
    if boxes.dtype != np.dtype("<f8") or boxes.shape != (count, 2, 3):
        raise FormatError(f"boxes must be float64 of shape ({count}, 2, 3), got {checks.describe(boxes)}")
    levels = []
    for i in range(count):
        box = checks.box(f"boxes[{i}]", boxes[i], FormatError)
        distances = read_array(archive, members, f"level_{i}.npy")
        _check_samples(header, distances, "float32", 3)
        levels.append(Volume._wrap(check_distances(distances), box, inner_bounds, report))
    return NestedField(levels)


def _read_atlas(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> Atlas:
    arrays = {name: read_array(archive, members, f"{name}.npy") for name in (*ARRAYS, "pages", "reports")}
    reports = json.loads(arrays.pop("reports").tobytes())
    # Files of earlier versions have no names.
    names = read_array(archive, members, "names.npy").tolist() if "names.npy" in members else None
    return make_atlas(header, arrays, reports, names, arrays.pop("pages"))


#: Reader of each kind of file.
_READERS: dict[str, Callable[..., Volume | SparseVolume | NestedField | Atlas]] = {
    "volume": _read_dense,
    "quantized": _read_quantized,
    "sparse": _read_sparse,
    "nested": _read_nested,
    "atlas": _read_atlas,
}


def _check_samples(header: dict[str, Any], samples: NDArray[Any], encoding: str, ndim: int) -> None:
    """Check that samples have the type and the grid that the header states."""
    dtype = encodings.DTYPES[encoding]
    if samples.dtype != dtype.newbyteorder("<") or samples.ndim != ndim or (ndim == 3 and samples.size == 0):
        expected = "(nx, ny, nz)" if ndim == 3 else "(n, 8, 8, 8)"
        raise FormatError(f"distances must be {dtype} of shape {expected}, got {checks.describe(samples)}")
    if ndim == 3 and header.get("resolution") != list(samples.shape):
        raise FormatError(f"the header states {header.get('resolution')} voxels, the distances are {samples.shape}")


def _check_magnitude(name: str, samples: NDArray[Any], encoding: str, scale: float) -> None:
    """Check that samples of floats are finite and in the range of the package; normalized integers always are."""
    if encoding in encodings.STEPS or not samples.size:
        return
    with np.errstate(invalid="ignore"):
        lowest, highest = scale * float(samples.min()), scale * float(samples.max())
    # Both comparisons are false for nan.
    if not (lowest >= -checks.FAR and highest <= checks.FAR):
        raise FormatError(f"the {name} must be finite and at most {checks.FAR:g} from 0, got {lowest:g} to {highest:g}")


def _encoding(header: dict[str, Any], known: tuple[str, ...]) -> str:
    encoding = header.get("encoding")
    if not isinstance(encoding, str) or encoding not in known:
        raise FormatError(f"header: encoding must be one of {', '.join(known)}, got {encoding!r:.60}")
    return encoding


def _positive(header: dict[str, Any], name: str) -> float:
    try:
        return checks.number(name, header.get(name), above=0)
    except ArgumentError as error:
        raise FormatError(f"header: {error}") from None


def read_scale(header: dict[str, Any], encoding: str) -> float:
    """Read the scale of the stored samples, and check that it suits their encoding."""
    if encoding == "float16" and header["version"] < SCALED_FLOAT16_VERSION:
        return 1.0
    scale = _positive(header, "scale")
    _check_scales(encoding, [scale])
    return scale


def _check_scales(encoding: str, scales: list[float]) -> None:
    try:
        _core.check_scales(encoding, scales)
    except ArgumentError as error:
        raise FormatError(f"header: {error}") from None


def make_atlas(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], reports: Any, names: Any, pages: NDArray[Any]
) -> Atlas:
    """Check the contents of a file and compare them with each other, then make an atlas of them."""
    try:
        atlas = Atlas(
            layout=checks.choice("layout", header.get("layout"), ("shelves", "strips")),
            page_size=checks.integer("page_size", header.get("page_size"), least=1, most=MAX_PAGE_SIZE),
            gutter=checks.integer("gutter", header.get("gutter"), least=0, most=MAX_GUTTER),
            encoding=checks.choice("encoding", header.get("encoding"), encodings.NAMES),
            band=checks.number("band", header.get("band"), above=0),
        )
    except ArgumentError as error:
        raise FormatError(f"header: {error}") from None
    size = atlas.page_size
    if pages.dtype != encodings.DTYPES[atlas.encoding] or pages.ndim != 3 or pages.shape[1:] != (size, size):
        raise FormatError(f"pages must be (pages, {size}, {size}) {atlas.encoding}, got {checks.describe(pages)}")
    if not pages.flags.c_contiguous:
        raise FormatError("pages must be stored row by row")
    _check_magnitude("pages", pages, atlas.encoding, 1.0)

    rows = len(arrays["blocks"]) if arrays["blocks"].ndim else 0
    expected: dict[str, tuple[tuple[int, ...], str]] = {
        "blocks": ((rows, BLOCK_NUMBERS), "u4"),
        "boxes": ((rows, 4, 3), "f8"),
        "models": ((rows, 4, 4), "f8"),
        "scales": ((rows,), "f4"),
    }
    for name, (shape, kind) in expected.items():
        array = arrays[name]
        if array.shape != shape or array.dtype != np.dtype(kind) or not array.flags.c_contiguous:
            raise FormatError(f"{name} must have shape {shape} and dtype {kind}, got {checks.describe(array)}")
        if not _all_finite(array):
            raise FormatError(f"{name} must be finite")
    blocks, boxes = blocks_of(arrays["blocks"]), arrays["boxes"]
    sound = np.array(_core.atlas_sound(arrays["blocks"], size, len(pages)), bool)
    if atlas.layout == "strips":
        side = blocks["shape"][:, 0]
        cube = (blocks["shape"] == side[:, None]).all(axis=1) & (blocks["columns"] == side) & (blocks["gutter"] == 0)
        left, top = blocks["corner"].T
        placed = (left == 0) & (top % np.maximum(side, 1) == 0)
        sound &= (cube & placed) | (blocks["page"] == VACANT)
    if not sound.all():
        raise FormatError(f"blocks[{int(np.argmin(sound))}] does not lie on the pages")
    live = blocks["page"] != VACANT
    ordered = (boxes[:, 0] <= boxes[:, 1]).all(axis=1) & (boxes[:, 2] < boxes[:, 3]).all(axis=1)
    valid = (ordered | ~live) & (np.abs(boxes) <= checks.FAR).all(axis=(1, 2))
    if not valid.all():
        raise FormatError(f"boxes[{int(np.argmin(valid))}] is not a valid box")
    for i in np.flatnonzero(live):
        checks.affine(f"models[{i}]", arrays["models"][i], FormatError)
    if not (arrays["scales"] > 0).all():
        raise FormatError("scales must be above 0")
    is_old = header["version"] < SCALED_FLOAT16_VERSION
    if atlas.encoding == "float32" or (atlas.encoding == "float16" and is_old):
        # Earlier versions wrote the width of the band here and did not use it.
        arrays["scales"] = np.ones(rows, np.float32)
    _check_scales(atlas.encoding, arrays["scales"].tolist())
    if not isinstance(reports, list) or len(reports) != rows:
        raise FormatError(f"there must be {rows} reports")
    if names is None:
        names = [""] * rows
    if not isinstance(names, list) or len(names) != rows or not all(isinstance(name, str) for name in names):
        raise FormatError(f"there must be {rows} names")

    atlas._pages = pages
    atlas._blocks, atlas._boxes, atlas._models, atlas._scales = blocks, boxes, arrays["models"], arrays["scales"]
    atlas._names = names
    atlas._reports = [read_report({"report": facts}) for facts in reports]
    return atlas


def _all_finite(array: NDArray[Any]) -> bool:
    """Whether an array contains no inf and no nan."""
    if array.dtype.kind != "f":
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum(dtype=np.float64)) or np.isfinite(array).all())
