"""Standard input and output in place of files, and the checks of outputs before any work.

Readers and writers need a named file, so the bytes pass through a temporary file. The format of the input follows from
its first bytes, or from ``--from``.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

import fieldbake as fb

from ...files.container import check_target, listed
from ...files.registry import FORMATS
from ..application import Clobber

#: First bytes of files, and the endings of their names: fields, atlases and meshes.
_SIGNATURES = (
    *((first, one.ending) for one in FORMATS for first in one.sniff),
    (b"glTF", ".glb"),
    (b"ply", ".ply"),
    (b"OFF", ".off"),
    (b"solid ", ".stl"),
    (b"{", ".gltf"),
)
#: A line of an OBJ file, which has no signature.
_OBJ_LINE = re.compile(rb"^[ \t]*(v|vn|vt|f|o|g|s|usemtl|mtllib)[ \t]", re.MULTILINE)
#: Number of bytes from which the format of an input is recognised. Exporters may write a long comment first.
_HEAD = 4096


def is_stream(path: Path) -> bool:
    """Whether a path means standard input or output."""
    return str(path) in ("-", "/dev/stdin", "/dev/stdout")


def _kind(first: bytes) -> str | None:
    """Return the ending of the format that the first bytes of a file imply; None if no format is recognised."""
    found = next((ending for signature, ending in _SIGNATURES if first.startswith(signature)), None)
    return ".obj" if found is None and _OBJ_LINE.search(first) else found


def check_output(output: Path, endings: tuple[str, ...], option: str = "--output") -> None:
    """Raise an error before any work if the output could not be written."""
    if is_stream(output):
        if sys.stdout.isatty():
            raise typer.BadParameter("standard output is a terminal; name a file, or redirect it", param_hint=option)
        return
    if output.suffix.lower() not in endings:
        raise typer.BadParameter(f"'{output}' must end in {listed(endings)}", param_hint=option)
    check_target(output)
    check_clobber(output)


def check_clobber(output: Path) -> None:
    """Raise an error if the output exists and --no-clobber is given."""
    if not Clobber.allowed and output.exists():
        raise FileExistsError(17, "exists, and --no-clobber is given", str(output))


@contextmanager
def input_file(path: Path, kind: str | None, recognise: Callable[[bytes], str | None] | None = None) -> Iterator[Path]:
    """Yield a file to read: `path`, or a copy of standard input if the path names a stream.

    `recognise` returns the ending of the format that the first bytes imply, by default one of a mesh or a field.
    """
    if not is_stream(path):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "input"
        with raw.open("wb") as stream:
            shutil.copyfileobj(sys.stdin.buffer, stream)
        if raw.stat().st_size == 0:
            raise fb.FormatError("-: standard input is empty, or has been read before")
        with raw.open("rb") as stream:
            ending = f".{kind.lstrip('.')}" if kind else (recognise or _kind)(stream.read(_HEAD))
        if ending is None:
            raise fb.FormatError("-: the first bytes of the input show no known format; name the format with --from")
        named = raw.with_name(f"standard input{ending}")
        raw.rename(named)
        yield named


@contextmanager
def output_file(path: Path, kind: str) -> Iterator[Path]:
    """Yield a file to write: `path`, or a file that is copied to standard output if the path names a stream."""
    if not is_stream(path):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"output.{kind.lstrip('.')}"
        yield target
        with target.open("rb") as stream:
            shutil.copyfileobj(stream, sys.stdout.buffer)
        sys.stdout.buffer.flush()
