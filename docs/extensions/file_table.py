"""The table of all files of the source, for the page *Files of the source*."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: Folders of the source and the ending of their files.
SOURCES = {"src": ".rs", "shaders": ".wgsl", "python/fieldbake": ".py", "web/src": ".ts"}

#: Mark of a comment at the top of a file, by the ending of the file. A docstring ends with its mark too.
_MARKS = {".rs": "//!", ".wgsl": "//", ".ts": "//", ".py": '"""'}


def cell(text: str) -> str:
    """A text as one cell of a table of Markdown."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")


def first_sentence(path: Path) -> str:
    """The first sentence of the comment or docstring at the top of a source file; empty if the file has none."""
    mark = _MARKS[path.suffix]
    paragraph = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines()):
        text = line.removeprefix(mark).removesuffix('"""').strip()
        if not text or not (line.startswith(mark) or (path.suffix == ".py" and number)):
            break
        paragraph.append(text)
    return re.split(r"(?<=\.)(?:\s|$)", " ".join(paragraph), maxsplit=1)[0]


def files() -> str:
    """A table for each folder of the source: its files, each with the first sentence of its header."""
    lines = [
        "# Files of the source",
        "",
        "Each file starts with a comment that states its subject; this page is generated from the first sentences.",
        "",
    ]
    for root, ending in SOURCES.items():
        found = [path for path in sorted((ROOT / root).rglob(f"*{ending}")) if first_sentence(path)]
        for folder in sorted({path.parent for path in found}):
            lines += [f"## {folder.relative_to(ROOT).as_posix()}", "", "| file | contents |", "|---|---|"]
            lines += [f"| `{path.name}` | {cell(first_sentence(path))} |" for path in found if path.parent == folder]
            lines.append("")
    return "\n".join(lines)
