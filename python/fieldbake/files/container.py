"""The .npz container of fieldbake. Plain NumPy can read it. All sizes are checked before any content is read.

A container is a zip archive of uncompressed members. Files with float16 samples, which have a scale since version 3,
are version 3. Other quantised, sparse and nested volumes are version 2, and all else is version 1. A volume has two
members:

``header.npy``
    A zero-dimensional string: JSON with ``format``, ``kind``, ``version``, ``bounds``, ``inner_bounds``, ``report``.
``distances.npy``
    float32 little-endian, Fortran order (x fastest), shape (nx, ny, nz). For the kind ``quantized`` float16, int16 or
    int8; the header has ``encoding`` and ``scale``. A distance is the float16, or the integer / 32767 or / 127, times
    the scale.
``index.npy``, ``nodes.npy``, ``bricks.npy``
    These replace the distances for the kind ``sparse``; the header has ``encoding``, ``scale`` and ``band``.

A nested field has ``level_0.npy``, ``level_1.npy``, ... instead of the distances, finest first, and their ``boxes``.

An atlas has the header, ``pages.npy``, one row of ``blocks``, ``boxes``, ``models``, ``scales`` and ``names`` per
index, and the reports as JSON in bytes.

Members must be stored uncompressed, so the contents cannot exceed the size of the archive. The sizes in the zip
directory, in the array headers and in the JSON are compared before memory is allocated. Nothing is unpickled.
"""

from __future__ import annotations

import errno
import json
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import FormatError
from ..base.report import Report
from . import temporary
from .formats import VERSION, Format

#: Each class fills its own container, and ``loading/npz.py`` reads them.
FORMATS = (Format(".npz", ("volume", "quantized", "sparse", "nested", "atlas"), None, None, (b"PK\x03\x04",)),)

#: Largest size of the JSON header, bytes. It usually has about a kilobyte.
MAX_HEADER_BYTES = 4 << 20

#: Number of bytes that are read at once, so that a large member is not held in memory twice.
CHUNK_BYTES = 16 << 20


def write(path: str | os.PathLike[str], header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write an archive of a header and arrays. The file appears only when it is complete."""
    target = checks.path(path)
    members: dict[str, Any] = {"header": np.array(json.dumps(header)), **arrays}
    with atomic_write(target) as stream:
        np.savez(stream, **members)


def listed(words: Iterable[str]) -> str:
    """Join words for a message: "a, b or c"."""
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def check_target(target: Path) -> None:
    """Raise an error if the folder of a file is missing, or if a file cannot replace what has this path."""
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "the folder does not exist", os.fspath(target))
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a directory", os.fspath(target))
    if not target.exists():
        return
    if not target.is_file():
        raise OSError(errno.EINVAL, "is a device or a pipe, and only files are replaced", os.fspath(target))
    if not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "is read-only", os.fspath(target))


def followed(path: Path) -> Path:
    """Return the file that a symbolic link points to, or else the path itself."""
    if not path.is_symlink():
        return path
    real = Path(os.path.realpath(path))
    if real.is_symlink():
        raise OSError(errno.ELOOP, "is a loop of symbolic links", os.fspath(path))
    return real


@contextmanager
def atomic_write(
    target: Path, replacing: Callable[[IO[bytes]], AbstractContextManager[object]] = nullcontext
) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces the target when the ``with`` block ends without an error.

    A symbolic link stays, and the file that it points to is replaced. Other hard links keep the old content. The file
    has the permissions of the old file, or those that `open` gives to a new one. ``replacing(stream)`` is entered when
    the content is complete and left when the target is replaced.
    """
    # An error raised here names the target. An error raised later would name the temporary file.
    check_target(target)
    real = followed(target)
    check_target(real)
    mode = real.stat().st_mode & 0o777 if real.exists() else None
    stream = temporary.create(real.parent, 0o666 if mode is None else mode)
    try:
        with stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            if mode is not None:
                Path(stream.name).chmod(mode)
            with replacing(stream):
                if os.name == "nt":  # Windows renames closed files only.
                    stream.close()
                os.replace(stream.name, real)  # noqa: PTH105 - the system call by its name
    except BaseException:
        Path(stream.name).unlink(missing_ok=True)
        raise


def members(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """Read the directory of an archive of `size` bytes and check that it is safe to read."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        if info.filename in members:
            raise FormatError(f"member '{info.filename}' appears twice")
        if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
            raise FormatError(f"member '{info.filename}' is compressed or encrypted; fieldbake writes neither")
        if info.file_size != info.compress_size or not 0 <= info.header_offset <= size - info.file_size:
            raise FormatError(f"member '{info.filename}' claims {info.file_size} bytes, the file has {size}")
        members[info.filename] = info
    return members


def read_header(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]) -> dict[str, Any]:
    """Read the JSON header and check its format and version."""
    if "header.npy" not in members:
        raise FormatError("is not a fieldbake file: it has no header; read it with numpy.load")
    if members["header.npy"].file_size > MAX_HEADER_BYTES:
        raise FormatError(f"the header has {members['header.npy'].file_size} bytes, more than {MAX_HEADER_BYTES}")
    text = read_array(archive, members, "header.npy")
    if text.ndim != 0 or text.dtype.kind != "U":
        raise FormatError(f"is not a fieldbake file: its header is {checks.describe(text)}")
    header = json.loads(str(text))
    if not isinstance(header, dict):
        raise FormatError("is not a fieldbake file: its header does not name the format")
    check_version(header)
    return header


def check_version(header: dict[str, Any]) -> None:
    """Check that fieldbake wrote the file and that this version can read it."""
    if header.get("format") != "fieldbake":
        raise FormatError("is not a fieldbake file: its header does not name the format")
    version = header.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise FormatError(f"the header has the invalid version {version!r}")
    if version > VERSION:
        raise FormatError(
            f"is of version {version}, this fieldbake reads up to {VERSION}; install a newer fieldbake "
            f"(written by {str(header.get('written_by'))[:60]})"
        )


def read_array(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> NDArray[Any]:
    """Read one .npy member. Its size is checked before memory is allocated."""
    if name not in members:
        raise FormatError(f"member '{name}' is missing")
    with archive.open(members[name]) as stream:
        major, minor = npy.read_magic(stream)
        if (major, minor) not in ((1, 0), (2, 0)):
            raise FormatError(f"member '{name}' has .npy version {major}.{minor}; versions 1.0 and 2.0 are read")
        read = npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0
        shape, fortran_order, dtype = read(stream)
        if dtype.hasobject or dtype.kind not in "fiuU":
            raise FormatError(f"member '{name}' holds {dtype}, a type that no fieldbake file has")
        # Python integers do not overflow for a huge shape.
        expected = dtype.itemsize
        for side in shape:
            if side < 0:
                raise FormatError(f"member '{name}' has the invalid shape {shape}")
            expected *= side
        remaining = members[name].file_size - stream.tell()
        if expected != remaining:
            raise FormatError(f"member '{name}' should hold {expected} bytes for {shape} {dtype}, it has {remaining}")
        array = np.empty(shape, dtype=dtype, order="F" if fortran_order else "C")
        if expected:
            _fill(stream, array)
        # zipfile compares the checksum at the end of the member.
        if stream.read(1):
            raise FormatError(f"member '{name}' is longer than its header states")
    return array


def _fill(stream: IO[bytes], array: NDArray[Any]) -> None:
    """Read directly into the array, in chunks."""
    memory = array.reshape(-1, order="A").view(np.uint8)
    done = 0
    while done < len(memory):
        piece = stream.read(min(CHUNK_BYTES, len(memory) - done))
        if not piece:
            raise FormatError("the file is shorter than its directory states")
        memory[done : done + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        done += len(piece)


def read_facts(header: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], Report]:
    """Read the outer box, the inner box and the report of a volume."""
    return _corners(header, "bounds", flat=False), _corners(header, "inner_bounds", flat=True), read_report(header)


def _corners(header: dict[str, Any], name: str, *, flat: bool) -> NDArray[np.float64]:
    try:
        return checks.box(name, header.get(name, []), FormatError, flat=flat)
    except FormatError as error:
        raise FormatError(f"header: {error}") from None


def read_report(header: dict[str, Any]) -> Report:
    """Read the report and check the type of each entry."""
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
