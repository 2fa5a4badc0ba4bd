"""The JSON file beside a file of another format, which describes its content."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..base.errors import FormatError
from .container import atomic_write, check_version

#: Largest size of a sidecar, bytes. The JSON of an atlas has a few hundred bytes per volume.
MAX_SIDECAR_BYTES = 64 << 20


def beside(path: Path) -> Path:
    """Return the path of the sidecar of `path`: the same name with ``.json`` appended."""
    return path.with_name(path.name + ".json")


def write_beside(path: Path, facts: dict[str, Any]) -> None:
    """Write the sidecar of `path`."""
    with atomic_write(beside(path)) as stream:
        stream.write(json.dumps(facts, indent=1).encode())


def read_beside(path: Path) -> dict[str, Any]:
    """Read the sidecar of `path`."""
    sidecar = beside(path)
    if not sidecar.is_file():
        raise FormatError(f"{sidecar.name} is missing: it describes the texels")
    if sidecar.stat().st_size > MAX_SIDECAR_BYTES:
        raise FormatError(f"{sidecar.name} has more than {MAX_SIDECAR_BYTES} bytes")
    return parse(sidecar.read_bytes())


def parse(text: str | bytes) -> dict[str, Any]:
    """Parse the metadata in a JSON text."""
    if len(text) > MAX_SIDECAR_BYTES:
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
