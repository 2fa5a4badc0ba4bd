"""Results of many meshes in a folder: the bake of each, and the summary that is printed at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from rich.markup import escape

import fieldbake as fb

from ...base.notices import about_surface
from ...scaling import library, records
from ..application import err, out
from .shapes import geometry_in_file


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
    items: Any = [geometry_in_file(path) for path in meshes]
    if any(isinstance(item, fb.Shape) for item in items):
        stems = [stem for stem, _ in library.distinct_stems([(path.stem, path) for path in meshes])]
        items = dict(zip(stems, items, strict=True))
    rows = fb.bake_many(items, folder, workers=jobs, limit_s=limit_s, resume=not fresh, progress=bar, **options)
    finish(rows, folder)


def finish(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Print the number of results by status, of those in doubt, and the failed items; exit with status 1 for these."""
    counts = Counter(row["status"] for row in rows)
    text = ", ".join(f"{counts[status]} {status}" for status in ("done", "skipped", "failed") if counts[status])
    out.print(f"[bold]{escape(str(folder))}[/]  {text or 'nothing to do'}", soft_wrap=True)
    doubtful = sum(is_doubtful(row["report"]) for row in rows if row["report"] is not None)
    if doubtful:
        where = escape(str(folder / records.NAME))
        text = f"{doubtful} of {len(rows)} results have warnings or uncertain signs; {where} has their reports"
        out.print(f"[yellow]warning:[/] {text}", soft_wrap=True)
    for row in rows:
        if row["status"] == "failed":
            err.print(f"[bold red]failed:[/] {escape(str(row['item']))}: {escape(str(row['error']))}", soft_wrap=True)
    if counts["failed"]:
        raise typer.Exit(1)


def is_doubtful(report: Mapping[str, Any]) -> bool:
    """Whether a report has a warning about the surface, or signs that are uncertain."""
    if report["sign_method"] == "unsigned":
        return False
    return bool(about_surface(report["warnings"]) or report["undecided_voxels"])
