"""The ledger of a folder of results: one line of JSON for each finished item, the newest last."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from . import content
from .results import size_of

NAME = "ledger.jsonl"


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the newest line of each result, by the name of its file. Lines that a crash cut short are left out."""
    newest: dict[str, dict[str, Any]] = {}
    try:
        lines = (folder / NAME).read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return newest
    for line in lines:
        try:
            row = json.loads(line)
            newest[Path(row["path"]).name] = row
        except (ValueError, KeyError, TypeError):  # noqa: PERF203 - each line by itself
            continue
    return newest


def append(folder: Path, row: Mapping[str, Any]) -> None:
    """Add a line in one write. If a crash has left an incomplete last line, a line break ends it first."""
    path = folder / NAME
    line = json.dumps(dict(row), default=content.plain) + "\n"
    with path.open("ab+") as stream:
        if stream.tell():
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                line = "\n" + line
        stream.write(line.encode())


def is_done(row: Mapping[str, Any] | None, targets: Sequence[Path], content: str | None, options: str) -> bool:
    """Whether files were made from this content with these options, and still have the size in the ledger."""
    if row is None or row.get("status") != "done":
        return False
    if (row.get("content"), row.get("options")) != (content, options):
        return False
    size = size_of(targets)
    return size is not None and size == row.get("bytes")
