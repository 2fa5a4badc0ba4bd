"""Results of many meshes in a folder: the bake of each, and the summary that is printed at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape

import fieldbake as fb

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def bake_folder(
    meshes: Sequence[Path],
    folder: Path,
    options: Mapping[str, Any],
    *,
    jobs: int | None,
    limit_s: float | None,
    fresh: bool,
) -> None:
    """Bake each mesh into the folder; exit with status 1 if one failed."""
    bar = err.is_terminal
    rows = fb.bake_many(meshes, folder, workers=jobs, limit_s=limit_s, resume=not fresh, progress=bar, **options)
    finish(rows, folder)


def finish(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Print the number of results by status and the items that failed; exit with status 1 if an item failed."""
    counts = Counter(row["status"] for row in rows)
    text = ", ".join(f"{counts[status]} {status}" for status in ("done", "skipped", "failed") if counts[status])
    out.print(f"[bold]{escape(str(folder))}[/]  {text or 'nothing to do'}", soft_wrap=True)
    for row in rows:
        if row["status"] == "failed":
            err.print(f"[bold red]failed:[/] {escape(str(row['item']))}: {escape(str(row['error']))}", soft_wrap=True)
    if counts["failed"]:
        raise typer.Exit(1)
