"""Check that every path of this repository that a comment or a document names exists.

A path is a file name with an ending of source code, or anything that starts with a folder of the repository. It may be
written from the root, from the folder of the file that names it, or as the end of a path.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: Folders whose paths are checked to any depth, with or without an ending.
FOLDERS = ("src", "shaders", "python", "tests", "benches", "examples", "scripts", "docs")

NAME = re.compile(
    rf"(?<![\w./:*{{<-])(?:(?:{'|'.join(FOLDERS)})/[\w./-]*[\w/]|[\w][\w./-]*\.(?:rs|wgsl|py|pyi|sh|toml))(?![\w*{{])"
)

#: Stands for any name in a path that is a pattern.
PATTERN = "NAME"


def tracked() -> list[str]:
    """All files of the repository, new ones included."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return [name for name in listed if (ROOT / name).is_file()]


def texts(name: str) -> Iterator[tuple[int, str]]:
    """The lines of a file that are comments or prose, with their numbers."""
    text = (ROOT / name).read_text(encoding="utf-8")
    lines = text.splitlines()
    if name.endswith(".md"):
        yield from enumerate(lines, 1)
    elif name.endswith((".rs", ".wgsl")):
        for number, line in enumerate(lines, 1):
            _, mark, comment = line.partition("//")
            if mark:
                yield number, comment
    else:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.string
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node):
                docstring = node.body[0]
                for number in range(docstring.lineno, (docstring.end_lineno or docstring.lineno) + 1):
                    yield number, lines[number - 1]


def exists(path: str, where: str, files: list[str]) -> bool:
    """Whether a path names a file or a folder, seen from the root or from a file."""
    path = path.rstrip("/")
    beside = (Path(where).parent / path).as_posix()
    wanted = "/" + path
    return any(
        "/" + file == wanted or ("/" + file).endswith(wanted) or f"/{file}".find(wanted + "/") >= 0 for file in files
    ) or any(file == beside or file.startswith(beside + "/") for file in files)


def main() -> int:
    """Print each path that does not exist; the exit status is 1 if there is one."""
    files = tracked()
    missing = 0
    for name in files:
        if not name.endswith((".md", ".rs", ".wgsl", ".py")) or name.startswith("benches/results/"):
            continue
        for number, text in texts(name):
            for found in NAME.finditer(text):
                path = found.group()
                if PATTERN not in path and not exists(path, name, files):
                    print(f"{name}:{number}: {path} does not exist")
                    missing += 1
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
