"""The JSON file beside a file of another format, which has the facts of the content that the format cannot store.

Two files cannot be replaced at once. The JSON therefore states the checksum of the bytes that its facts belong to. A
save has three steps, and after each of them the JSON contains the facts of the file:

======  ======================================================  ============
step    JSON                                                    file
======  ======================================================  ============
before  the old facts                                           old
1       the new facts, and the old facts as ``previous``        old
2       the same                                                new
3       the new facts                                           new
======  ======================================================  ============

Versions up to 0.2 wrote no checksum; the only facts of a JSON then belong to any content. An entry that consists of a
checksum alone belongs to a file of another program.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from ..base.errors import FormatError
from .container import CHUNK_BYTES, atomic_write, check_version, followed
from .temporary import locked

#: Largest size of metadata, bytes. The JSON of an atlas has a few hundred bytes per volume.
MAX_SIDECAR_BYTES = 64 << 20

#: Most attempts to read a file that is being replaced.
_ATTEMPTS = 20


def beside(path: Path) -> Path:
    """Return the path of the sidecar of `path`: the same name with ``.json`` appended."""
    return path.with_name(path.name + ".json")


@contextmanager
def write(path: Path, facts: dict[str, Any]) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces `path` when the ``with`` block ends, together with the facts beside it."""
    with suppress(FileNotFoundError):
        beside(followed(path)).lstat()  # A name that is too long for the JSON is an error before any work.
    with atomic_write(path, lambda stream: _entered(path, facts, stream)) as stream:
        yield stream


@contextmanager
def _entered(path: Path, facts: dict[str, Any], stream: IO[bytes]) -> Iterator[None]:
    """Write the facts of the content of a stream, which replaces `path` meanwhile, and then drop the old facts."""
    facts = {**facts, "checksum": _checksum(stream)}
    with locked(followed(path).parent):
        previous = _current(path)
        _write_json(path, {**facts, "previous": previous} if previous else facts)
        yield
        if previous:
            _write_json(path, facts)


def _write_json(path: Path, facts: dict[str, Any]) -> None:
    with atomic_write(beside(followed(path))) as stream:
        stream.write(json.dumps(facts, indent=1).encode())


def _current(path: Path) -> list[dict[str, Any]]:
    """Return the entry of the file that has this path now, with its checksum; none if there is none."""
    if not path.exists():
        return []
    try:
        entries = _entries(path)
    except (FormatError, ValueError, RecursionError):  # A damaged JSON has no entry to keep.
        return []
    if len(entries) == 1 and "checksum" in entries[0]:
        return entries
    with path.open("rb") as stream:
        checksum = _checksum(stream)
    entry = _matching(entries, checksum) if entries else {}
    return [] if entry is None else [{**entry, "checksum": checksum}]


def read(path: Path) -> tuple[bytes, dict[str, Any] | None]:
    """Read a file and its facts; None if it has no sidecar."""
    for _ in range(_ATTEMPTS):
        with path.open("rb") as stream:
            content = stream.read()
            entries = _entries(path)
            if not entries:
                return content, None
            entry = _matching(entries, _text(zlib.crc32(content)))
            if entry is not None:
                return content, entry if entry.keys() - {"checksum"} else None
            # Another process may have replaced the file before the JSON was read.
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                break
    raise FormatError(
        f"{beside(path).name} does not have the checksum of this file, which another program changed; save the field "
        'again, or delete the line "checksum" if the facts are right'
    )


def read_both(path: Path) -> tuple[bytes, dict[str, Any]]:
    """Read a file and its facts, which must exist."""
    content, facts = read(path)
    if facts is None:
        raise FormatError(f"{beside(path).name} is missing: it describes the texels")
    return content, facts


def _entries(path: Path) -> list[dict[str, Any]]:
    """List all facts of a file: those beside a symbolic link, and those beside the file that it points to."""
    entries: list[dict[str, Any]] = []
    for sidecar in dict.fromkeys([beside(path), beside(followed(path))]):
        if not os.path.isfile(sidecar):  # noqa: PTH113 - False for a name that is too long
            continue
        # During a save the JSON has two entries.
        if sidecar.stat().st_size > 2 * MAX_SIDECAR_BYTES:
            raise FormatError(f"{sidecar.name} has more than {2 * MAX_SIDECAR_BYTES} bytes")
        facts = parse(sidecar.read_bytes(), 2 * MAX_SIDECAR_BYTES)
        previous = facts.pop("previous", [])
        if not isinstance(previous, list) or not all(isinstance(entry, dict) for entry in previous):
            raise FormatError(f"{sidecar.name}: previous must be a list of objects")
        entries += [facts, *previous]
    return entries


def _matching(entries: list[dict[str, Any]], checksum: str) -> dict[str, Any] | None:
    """Find the entry with a checksum. A single entry without one belongs to any content."""
    if len(entries) == 1 and "checksum" not in entries[0]:
        return entries[0]
    return next((entry for entry in entries if entry.get("checksum") == checksum), None)


def _checksum(stream: IO[bytes]) -> str:
    """Compute the checksum of a whole file."""
    stream.seek(0)
    code = 0
    while chunk := stream.read(CHUNK_BYTES):
        code = zlib.crc32(chunk, code)
    return _text(code)


def _text(code: int) -> str:
    return f"crc32 {code:08x}"


def parse(text: str | bytes, most: int = MAX_SIDECAR_BYTES) -> dict[str, Any]:
    """Parse the metadata in a JSON text of at most `most` bytes."""
    if len(text) > most:
        raise FormatError("the metadata is too long")
    facts = json.loads(text) if text else None
    if not isinstance(facts, dict):
        raise FormatError("is not a fieldbake file: its metadata is missing")
    return facts


def expect(facts: dict[str, Any], kind: str) -> None:
    """Check that metadata belongs to a file of this kind and of a known version."""
    check_version(facts)
    if facts.get("kind") != kind:
        raise FormatError(f"must hold a {kind}, got the kind {str(facts.get('kind'))[:60]}")
