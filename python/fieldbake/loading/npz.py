"""Our files: an .npz archive that plain NumPy can read, and that is checked before a byte of it is believed.

Layout: a zip archive of uncompressed members. Quantised, sparse and nested volumes are version 2, all else is version
1. A volume has two members:

``header.npy``
    A zero-dimensional string: JSON with ``format``, ``kind``, ``version``, ``bounds``, ``inner_bounds``, ``report``.
``distances.npy``
    float32 little-endian, Fortran order (x fastest), shape (nx, ny, nz). For the kind ``quantized`` float16, int16 or
    int8; the header has ``encoding`` and ``scale``.
``index.npy``, ``nodes.npy``, ``bricks.npy``
    In place of the distances for the kind ``sparse``; the header has ``encoding``, ``scale`` and ``band``.

A nested field has ``level_0.npy``, ``level_1.npy``, ... in place of the distances, finest first, and their ``boxes``.

An atlas has the header, ``pages.npy``, a row of ``blocks``, ``boxes``, ``models`` and ``scales`` for each index, and
the reports as JSON in bytes.

Because members must be stored uncompressed, an archive cannot unfold to more than its own size. The sizes in the zip
directory, in the array headers and in the JSON are compared before anything is allocated, and nothing is unpickled.
"""

from __future__ import annotations

import errno
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, FormatError
from ..base.report import Report
from ..volumes.quantized import DTYPES, STEPS, QuantizedVolume
from ..volumes.sparse import SparseVolume, restore_field
from ..volumes.volume import Volume, check_distances

if TYPE_CHECKING:
    from ..atlases.atlas import Atlas
    from ..merging.nested import NestedField

#: The newest version of a file, and that of each kind which readers of version 1 do not know.
VERSION = 2
FIRST_VERSION = {"quantized": 2, "sparse": 2, "nested": 2}

#: The JSON of a volume takes about a kilobyte.
MAX_HEADER_BYTES = 4 << 20

#: Read in pieces, so that a large member is not held twice.
CHUNK_BYTES = 16 << 20

#: What an atlas keeps for each of its volumes.
ATLAS_ARRAYS = ("blocks", "boxes", "models", "scales")


def save_volume(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Write a volume; the file appears whole or not at all."""
    _write(path, _header("volume", volume), {"distances": volume.distances})


def save_quantized(volume: QuantizedVolume, path: str | os.PathLike[str]) -> None:
    """Write a quantised volume: the stored numbers, and in the header how to read them."""
    header = _header("quantized", volume)
    header |= {"encoding": volume.encoding, "scale": volume.scale}
    _write(path, header, {"distances": volume.encoded})


def save_sparse(volume: SparseVolume, path: str | os.PathLike[str]) -> None:
    """Write a sparse volume: its index, the distances at the corners of bricks, and the bricks."""
    field = volume._core_field
    header = _header("sparse", volume)
    header |= {"encoding": field.encoding, "scale": field.scale, "band": field.band}
    _write(path, header, field.arrays())


def save_nested(field: NestedField, path: str | os.PathLike[str]) -> None:
    """Write a nested field: the levels as they were merged, finest first."""
    outermost = field.levels[-1]
    arrays: dict[str, NDArray[Any]] = {f"level_{i}": level.distances for i, level in enumerate(field.levels)}
    arrays["boxes"] = np.stack([level.bounds for level in field.levels])
    _write(path, {**_header("nested", outermost), "levels": len(field.levels)}, arrays)


def head(kind: str) -> dict[str, Any]:
    """How every header starts."""
    version = FIRST_VERSION.get(kind, 1)
    return {"format": "fieldbake", "kind": kind, "version": version, "written_by": f"fieldbake {_core.__version__}"}


def _header(kind: str, volume: Volume | SparseVolume) -> dict[str, Any]:
    return {
        **head(kind),
        "resolution": list(volume.resolution),
        "bounds": volume.bounds.tolist(),
        "inner_bounds": volume.inner_bounds.tolist(),
        "report": volume.report.to_dict(),
    }


def _write(path: str | os.PathLike[str], header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    target = Path(path)
    if target.suffix.lower() != ".npz":
        what = "an atlas" if header["kind"] == "atlas" else "a volume"
        raise FormatError(f"{path}: {what} is written as .npz, got the ending '{target.suffix}'")
    members: dict[str, Any] = {"header": np.array(json.dumps(header)), **arrays}
    with atomic_write(target) as stream:
        np.savez(stream, **members)


def save_atlas(atlas: Atlas, path: str | os.PathLike[str]) -> None:
    """Write an atlas; the file appears whole or not at all."""
    header = {
        **head("atlas"),
        "layout": atlas.layout,
        "page_size": atlas.page_size,
        "gutter": atlas.gutter,
        "encoding": atlas.encoding,
        "band": atlas.band,
    }
    reports = json.dumps([report.to_dict() for report in atlas._reports]).encode()
    arrays = {name: getattr(atlas, f"_{name}") for name in ("pages", *ATLAS_ARRAYS)}
    _write(path, header, {**arrays, "reports": np.frombuffer(reports, np.uint8)})


@contextmanager
def atomic_write(target: Path) -> Iterator[IO[bytes]]:
    """A temporary file beside the target that takes its place when the block ends well."""
    import tempfile

    # Said here, about the file that was asked for; below it would be about the temporary one.
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "the folder does not exist", os.fspath(target))
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a directory", os.fspath(target))

    mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
    descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "w+b") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.chmod(mode)
        os.replace(temporary, target)  # noqa: PTH105 - the system call by its name
    except BaseException:
        temporary.unlink()
        raise


def _umask() -> int:
    """The process's umask; it can only be read by setting it."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def load(path: str | os.PathLike[str]) -> Any:
    """Read what fieldbake wrote.

    Parameters
    ----------
    path : str or path
        A file of :meth:`Volume.save` or :meth:`Atlas.save`, of any of their endings.

    Returns
    -------
    Volume, QuantizedVolume, SparseVolume, NestedField or Atlas
        Bit for bit what was saved, in the encoding that the file has.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FormatError
        If the file is of another kind, damaged, unsafe to read, or written by a newer version.
    """
    if Path(path).is_dir():
        raise FormatError(f"{path}: is a directory, not a fieldbake file")
    with open(path, "rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        try:
            if (foreign := _foreign_reader(path)) is not None:
                return foreign(Path(path))
            with zipfile.ZipFile(stream) as archive:
                return _read(archive, size)
        except FormatError as error:
            raise FormatError(f"{path}: {error}") from None
        except zipfile.BadZipFile as error:
            if Path(path).suffix.lower() == ".npz":
                raise FormatError(f"{path}: is damaged or not an .npz file ({error})") from None
            raise FormatError(f"{path}: is not a fieldbake file; meshes are read by load_mesh or bake") from None
        except MemoryError:
            raise
        except Exception as error:  # A damaged archive fails in every way there is, seeking before its start too.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            raise FormatError(f"{path}: is damaged ({type(error).__name__}: {error})") from error


def _foreign_reader(path: str | os.PathLike[str]) -> Callable[[Path], Volume | Atlas] | None:
    """Who reads files of this ending, if it is not ours."""
    from . import foreign

    ending = Path(path).suffix.lower()
    if ending in foreign.VOLUME_ENDINGS:
        return foreign.load_volume_from
    return foreign.load_atlas_from if ending in foreign.ATLAS_ENDINGS else None


def _read(archive: zipfile.ZipFile, size: int) -> Volume | SparseVolume | NestedField | Atlas:
    members = _members(archive, size)
    header = _read_header(archive, members)
    reader = READERS.get(str(header.get("kind")))
    if reader is None:
        raise FormatError(f"holds something else than a volume: {str(header.get('kind'))[:60]}")
    try:
        return reader(archive, members, header)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def _read_dense(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> Volume:
    bounds, inner_bounds, report = read_facts(header)
    distances = _read_array(archive, members, "distances.npy")
    _check_samples(header, distances, "float32", 3)
    return Volume._wrap(check_distances(distances), bounds, inner_bounds, report)


def _read_quantized(
    archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]
) -> QuantizedVolume:
    bounds, inner_bounds, report = read_facts(header)
    encoding = _encoding(header, tuple(name for name in DTYPES if name != "float32"))
    encoded = _read_array(archive, members, "distances.npy")
    _check_samples(header, encoded, encoding, 3)
    if encoding == "float16" and not np.isfinite(encoded).all():
        raise FormatError("the distances are not all finite")
    scale = _positive(header, "scale")
    return QuantizedVolume._of(np.asfortranarray(encoded), encoding, scale, bounds, inner_bounds, report)


def _read_sparse(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> SparseVolume:
    bounds, inner_bounds, report = read_facts(header)
    encoding = _encoding(header, tuple(DTYPES))
    arrays = {name: _read_array(archive, members, f"{name}.npy") for name in ("index", "nodes", "bricks")}
    _check_samples(header, arrays["bricks"], encoding, 4)
    shape = header.get("resolution")
    if not isinstance(shape, list) or len(shape) != 3 or not all(type(n) is int and 0 < n < 2**31 for n in shape):
        raise FormatError(f"the header's resolution is {shape!r:.60}")
    if arrays["bricks"].shape[1:] != (8, 8, 8) or arrays["index"].ndim != 3 or arrays["nodes"].ndim != 3:
        raise FormatError("the bricks, their index or their nodes have the wrong shape")
    if arrays["index"].dtype != np.dtype("<u4") or arrays["nodes"].dtype != np.dtype("<f4"):
        raise FormatError("the index or the nodes have the wrong type")
    if encoding not in STEPS and not np.isfinite(arrays["bricks"]).all():
        raise FormatError("the bricks are not all finite")
    if not (np.isfinite(arrays["nodes"]).all() and (arrays["nodes"] >= 0).all()):
        raise FormatError("the nodes are not all finite and 0 or more")
    corners = checks.triple(bounds[0]), checks.triple(bounds[1])
    size = int(shape[0]), int(shape[1]), int(shape[2])
    field = restore_field(corners, size, _positive(header, "band"), _positive(header, "scale"), arrays)
    return SparseVolume._wrap(field, bounds, inner_bounds, report)


def _read_nested(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> NestedField:
    from ..merging.nested import MAX_LEVELS, NestedField

    _, inner_bounds, report = read_facts(header)
    count = checks.integer("header: levels", header.get("levels"), least=1, most=MAX_LEVELS, error=FormatError)
    boxes = _read_array(archive, members, "boxes.npy")
    if boxes.dtype != np.dtype("<f8") or boxes.shape != (count, 2, 3):
        raise FormatError(f"boxes must be float64 of shape ({count}, 2, 3), got {checks.describe(boxes)}")
    levels = []
    for i in range(count):
        box = checks.box(f"boxes[{i}]", boxes[i], FormatError)
        distances = _read_array(archive, members, f"level_{i}.npy")
        _check_samples(header, distances, "float32", 3)
        levels.append(Volume._wrap(check_distances(distances), box, inner_bounds, report))
    return NestedField(levels)


def _read_atlas(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> Atlas:
    arrays = {name: _read_array(archive, members, f"{name}.npy") for name in (*ATLAS_ARRAYS, "pages", "reports")}
    reports = json.loads(arrays.pop("reports").tobytes())
    return make_atlas(header, arrays, reports, arrays.pop("pages"))


#: How each kind of file is read.
READERS: dict[str, Callable[..., Volume | SparseVolume | NestedField | Atlas]] = {
    "volume": _read_dense,
    "quantized": _read_quantized,
    "sparse": _read_sparse,
    "nested": _read_nested,
    "atlas": _read_atlas,
}


def _check_samples(header: dict[str, Any], samples: NDArray[Any], encoding: str, ndim: int) -> None:
    """Samples of the type that the header says, on the grid that it says."""
    dtype = DTYPES[encoding]
    if samples.dtype != dtype.newbyteorder("<") or samples.ndim != ndim or (ndim == 3 and samples.size == 0):
        wanted = "(nx, ny, nz)" if ndim == 3 else "(n, 8, 8, 8)"
        raise FormatError(f"distances must be {dtype} of shape {wanted}, got {checks.describe(samples)}")
    if ndim == 3 and header.get("resolution") != list(samples.shape):
        raise FormatError(f"the header says {header.get('resolution')} voxels, the distances are {samples.shape}")


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


def make_atlas(header: dict[str, Any], arrays: dict[str, NDArray[Any]], reports: Any, pages: NDArray[Any]) -> Atlas:
    """An atlas from what a file says, once all of it is known to fit together."""
    from ..atlases.atlas import Atlas
    from ..atlases.pages import BLOCK_NUMBERS, MAX_GUTTER, MAX_PAGE_SIZE, TEXELS, VACANT, choice

    try:
        atlas = Atlas(
            layout=choice("layout", header.get("layout"), ("shelves", "strips")),
            page_size=checks.integer("page_size", header.get("page_size"), least=1, most=MAX_PAGE_SIZE),
            gutter=checks.integer("gutter", header.get("gutter"), least=0, most=MAX_GUTTER),
            encoding=choice("encoding", header.get("encoding"), tuple(TEXELS)),
            band=checks.number("band", header.get("band"), above=0),
        )
    except ArgumentError as error:
        raise FormatError(f"header: {error}") from None
    size = atlas.page_size
    if pages.dtype != TEXELS[atlas.encoding] or pages.ndim != 3 or pages.shape[1:] != (size, size):
        raise FormatError(f"pages must be (pages, {size}, {size}) {atlas.encoding}, got {checks.describe(pages)}")
    if not pages.flags.c_contiguous or not _all_finite(pages):
        raise FormatError("pages must be finite, and row by row")

    rows = len(arrays["blocks"]) if arrays["blocks"].ndim else 0
    wanted: dict[str, tuple[tuple[int, ...], str]] = {
        "blocks": ((rows, BLOCK_NUMBERS), "u4"),
        "boxes": ((rows, 4, 3), "f8"),
        "models": ((rows, 4, 4), "f8"),
        "scales": ((rows,), "f4"),
    }
    for name, (shape, kind) in wanted.items():
        array = arrays[name]
        if array.shape != shape or array.dtype != np.dtype(kind) or not array.flags.c_contiguous:
            raise FormatError(f"{name} must have shape {shape} and dtype {kind}, got {checks.describe(array)}")
        if not _all_finite(array):
            raise FormatError(f"{name} must be finite")
    blocks, boxes = arrays["blocks"], arrays["boxes"]
    sound = np.array(_core.atlas_sound(blocks, size, len(pages)), bool)
    if atlas.layout == "strips":
        side = blocks[:, 9]
        cube = (blocks[:, 7:] == side[:, None]).all(axis=1) & (blocks[:, 5] == side) & (blocks[:, 6] == 0)
        placed = (blocks[:, 1] == 0) & (blocks[:, 2] % np.maximum(side, 1) == 0)
        sound &= (cube & placed) | (blocks[:, 0] == VACANT)
    if not sound.all():
        raise FormatError(f"blocks[{int(np.argmin(sound))}] does not lie on the pages")
    live = blocks[:, 0] != VACANT
    ordered = (boxes[:, 0] <= boxes[:, 1]).all(axis=1) & (boxes[:, 2] < boxes[:, 3]).all(axis=1)
    if not (ordered | ~live).all() or not (np.abs(boxes) <= checks.FAR).all():
        raise FormatError(f"boxes[{int(np.argmin(ordered | ~live))}] is no box")
    for i in np.flatnonzero(live):
        checks.affine(f"models[{i}]", arrays["models"][i], FormatError)
    if not (arrays["scales"] > 0).all():
        raise FormatError("scales must be above 0")
    if not isinstance(reports, list) or len(reports) != rows:
        raise FormatError(f"there must be {rows} reports")

    atlas._pages = pages
    atlas._blocks, atlas._boxes, atlas._models, atlas._scales = (arrays[name] for name in ATLAS_ARRAYS)
    atlas._reports = [_report({"report": facts}) for facts in reports]
    return atlas


def _all_finite(array: NDArray[Any]) -> bool:
    """Whether there is no inf and no nan."""
    if array.dtype.kind != "f":
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum(dtype=np.float64)) or np.isfinite(array).all())


def _members(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The directory of the archive, if it is harmless."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        if info.filename in members:
            raise FormatError(f"member '{info.filename}' is there twice")
        if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
            raise FormatError(f"member '{info.filename}' is compressed or encrypted; ours are stored plainly")
        if info.file_size != info.compress_size or not 0 <= info.header_offset <= size - info.file_size:
            raise FormatError(f"member '{info.filename}' claims {info.file_size} bytes, the file has {size}")
        members[info.filename] = info
    return members


def _read_header(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]) -> dict[str, Any]:
    """The JSON, checked for kind and version."""
    if "header.npy" not in members:
        raise FormatError("is not a fieldbake file: it has no header; read it with numpy.load")
    if members["header.npy"].file_size > MAX_HEADER_BYTES:
        raise FormatError(f"the header has {members['header.npy'].file_size} bytes, more than {MAX_HEADER_BYTES}")
    text = _read_array(archive, members, "header.npy")
    if text.ndim != 0 or text.dtype.kind != "U":
        raise FormatError(f"is not a fieldbake file: its header is {checks.describe(text)}")
    header = json.loads(str(text))
    if not isinstance(header, dict):
        raise FormatError("is not a fieldbake file: its header does not say so")
    check_version(header)
    return header


def check_version(header: dict[str, Any]) -> None:
    """Fails unless we wrote this, and know how to read it."""
    if header.get("format") != "fieldbake":
        raise FormatError("is not a fieldbake file: its header does not say so")
    version = header.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise FormatError(f"the header's version is {version!r}")
    if version > VERSION:
        raise FormatError(
            f"is of version {version}, this fieldbake reads up to {VERSION}; install a newer fieldbake "
            f"(written by {str(header.get('written_by'))[:60]})"
        )


def _read_array(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> NDArray[Any]:
    """One .npy member, allocated only once its size is known to be true."""
    if name not in members:
        raise FormatError(f"member '{name}' is missing")
    with archive.open(members[name]) as stream:
        major, minor = npy.read_magic(stream)
        if (major, minor) not in ((1, 0), (2, 0)):
            raise FormatError(f"member '{name}' is .npy version {major}.{minor}")
        read = npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0
        shape, fortran_order, dtype = read(stream)
        if dtype.hasobject or dtype.kind not in "fiuU":
            raise FormatError(f"member '{name}' holds {dtype}, which is never read")
        # Python integers: a huge shape cannot overflow here.
        expected = dtype.itemsize
        for side in shape:
            if side < 0:
                raise FormatError(f"member '{name}' has shape {shape}")
            expected *= side
        left = members[name].file_size - stream.tell()
        if expected != left:
            raise FormatError(f"member '{name}' should hold {expected} bytes for {shape} {dtype}, it has {left}")
        array = np.empty(shape, dtype=dtype, order="F" if fortran_order else "C")
        if expected:
            _fill(stream, array)
        # At the end of the member zipfile compares its checksum.
        if stream.read(1):
            raise FormatError(f"member '{name}' is longer than it says")
    return array


def _fill(stream: IO[bytes], array: NDArray[Any]) -> None:
    """Read straight into the array, in pieces."""
    memory = array.reshape(-1, order="A").view(np.uint8)
    done = 0
    while done < len(memory):
        piece = stream.read(min(CHUNK_BYTES, len(memory) - done))
        if not piece:
            raise FormatError("the file ends too early")
        memory[done : done + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        done += len(piece)


def read_facts(header: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], Report]:
    """Outer and inner box and report of a volume."""
    return _corners(header, "bounds", flat=False), _corners(header, "inner_bounds", flat=True), _report(header)


def _corners(header: dict[str, Any], name: str, *, flat: bool) -> NDArray[np.float64]:
    try:
        return checks.box(name, header.get(name, []), FormatError, flat=flat)
    except FormatError as error:
        raise FormatError(f"header: {error}") from None


def _report(header: dict[str, Any]) -> Report:
    """The report, each fact only if it has the type it should have."""
    facts = header.get("report", {})
    if not isinstance(facts, dict):
        raise FormatError("header: report must be an object")
    blank = Report().to_dict()
    for name, value in facts.items():
        if name in blank and type(value) is not type(blank[name]):
            raise FormatError(f"header: report.{name} must be {type(blank[name]).__name__}, got {value!r:.60}")
    if not all(isinstance(text, str) for text in facts.get("warnings", [])):
        raise FormatError("header: report.warnings must be text")
    if not all(isinstance(seconds, (int, float)) for seconds in facts.get("seconds", {}).values()):
        raise FormatError("header: report.seconds must be numbers")
    return Report.from_dict(facts)
