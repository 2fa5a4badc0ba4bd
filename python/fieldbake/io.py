"""Our files: an .npz archive that plain NumPy can read, and that is checked before a byte of it is believed.

Layout: a zip archive of uncompressed members. A volume is version 1, the others are version 2.

``header.npy``
    A zero-dimensional string: JSON with ``format``, ``kind``, ``version``, ``bounds``, ``inner_bounds``, ``report``.
``distances.npy``
    float32 little-endian, Fortran order (x fastest), shape (nx, ny, nz). For the kind ``quantized`` float16, int16 or
    int8; the header has ``encoding`` and ``scale``.
``index.npy``, ``nodes.npy``, ``bricks.npy``
    In place of the distances for the kind ``sparse``; the header has ``encoding``, ``scale`` and ``band``.

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
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from . import _checks, _core
from .errors import ArgumentError, FormatError
from .quantized import DTYPES, STEPS, QuantizedVolume
from .report import Report
from .sparse import SparseVolume, restore_field
from .volume import Volume, check_distances

VERSION = 2

#: The JSON of a volume takes about a kilobyte.
MAX_HEADER_BYTES = 4 << 20

#: Read in pieces, so that a large member is not held twice.
CHUNK_BYTES = 16 << 20


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


def _header(kind: str, volume: Volume | SparseVolume) -> dict[str, Any]:
    return {
        "format": "fieldbake",
        "kind": kind,
        "version": 1 if kind == "volume" else VERSION,
        "written_by": f"fieldbake {_core.__version__}",
        "resolution": list(volume.resolution),
        "bounds": volume.bounds.tolist(),
        "inner_bounds": volume.inner_bounds.tolist(),
        "report": volume.report.to_dict(),
    }


def _write(path: str | os.PathLike[str], header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    target = Path(path)
    if target.suffix.lower() != ".npz":
        raise FormatError(f"{path}: a volume is written as .npz, got the ending '{target.suffix}'")
    text = np.array(json.dumps(header))
    with atomic_write(target) as stream:
        members: dict[str, Any] = {"header": text, **arrays}
        np.savez(stream, **members)


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


def load(path: str | os.PathLike[str]) -> Volume | SparseVolume:
    """Read what fieldbake wrote.

    Parameters
    ----------
    path : str or path
        An .npz file of :meth:`Volume.save`.

    Returns
    -------
    Volume, QuantizedVolume or SparseVolume
        Bit for bit what was saved.

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
            with zipfile.ZipFile(stream) as archive:
                return _read_volume(archive, size)
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


def _read_volume(archive: zipfile.ZipFile, size: int) -> Volume | SparseVolume:
    members = _members(archive, size)
    header = _read_header(archive, members)
    try:
        return READERS[header["kind"]](archive, members, header)
    except ArgumentError as error:
        raise FormatError(str(error)) from None


def _read_dense(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> Volume:
    bounds, inner_bounds = _boxes(header)
    distances = _read_array(archive, members, "distances.npy")
    _check_samples(header, distances, "float32", 3)
    return Volume._wrap(check_distances(distances), bounds, inner_bounds, _report(header))


def _read_quantized(
    archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]
) -> QuantizedVolume:
    bounds, inner_bounds = _boxes(header)
    encoding = _encoding(header, tuple(name for name in DTYPES if name != "float32"))
    encoded = _read_array(archive, members, "distances.npy")
    _check_samples(header, encoded, encoding, 3)
    if encoding == "float16" and not np.isfinite(encoded).all():
        raise FormatError("the distances are not all finite")
    scale = _positive(header, "scale")
    return QuantizedVolume._of(np.asfortranarray(encoded), encoding, scale, bounds, inner_bounds, _report(header))


def _read_sparse(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], header: dict[str, Any]) -> SparseVolume:
    bounds, inner_bounds = _boxes(header)
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
    corners = _checks.triple(bounds[0]), _checks.triple(bounds[1])
    size = int(shape[0]), int(shape[1]), int(shape[2])
    field = restore_field(corners, size, _positive(header, "band"), _positive(header, "scale"), arrays)
    return SparseVolume._wrap(field, bounds, inner_bounds, _report(header))


#: How each kind of file is read.
READERS: dict[str, Callable[..., Volume | SparseVolume]] = {
    "volume": _read_dense,
    "quantized": _read_quantized,
    "sparse": _read_sparse,
}


def _check_samples(header: dict[str, Any], samples: NDArray[Any], encoding: str, ndim: int) -> None:
    """Samples of the type that the header says, on the grid that it says."""
    dtype = DTYPES[encoding]
    if samples.dtype != dtype.newbyteorder("<") or samples.ndim != ndim or (ndim == 3 and samples.size == 0):
        wanted = "(nx, ny, nz)" if ndim == 3 else "(n, 8, 8, 8)"
        raise FormatError(f"distances must be {dtype} of shape {wanted}, got {_checks.describe(samples)}")
    if ndim == 3 and header.get("resolution") != list(samples.shape):
        raise FormatError(f"the header says {header.get('resolution')} voxels, the distances are {samples.shape}")


def _encoding(header: dict[str, Any], known: tuple[str, ...]) -> str:
    encoding = header.get("encoding")
    if not isinstance(encoding, str) or encoding not in known:
        raise FormatError(f"header: encoding must be one of {', '.join(known)}, got {encoding!r:.60}")
    return encoding


def _positive(header: dict[str, Any], name: str) -> float:
    try:
        return _checks.number(name, header.get(name), above=0)
    except ArgumentError as error:
        raise FormatError(f"header: {error}") from None


def _boxes(header: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return _corners(header, "bounds", flat=False), _corners(header, "inner_bounds", flat=True)


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
        raise FormatError(f"is not a fieldbake file: its header is {_checks.describe(text)}")
    header = json.loads(str(text))
    if not isinstance(header, dict) or header.get("format") != "fieldbake":
        raise FormatError("is not a fieldbake file: its header does not say so")
    version = header.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise FormatError(f"the header's version is {version!r}")
    if version > VERSION:
        raise FormatError(
            f"is of version {version}, this fieldbake reads up to {VERSION}; install a newer fieldbake "
            f"(written by {str(header.get('written_by'))[:60]})"
        )
    if header.get("kind") not in READERS:
        raise FormatError(f"holds something else than a volume: {str(header.get('kind'))[:60]}")
    return header


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


def _corners(header: dict[str, Any], name: str, *, flat: bool) -> NDArray[np.float64]:
    try:
        return _checks.box(name, header.get(name, []), FormatError, flat=flat)
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
