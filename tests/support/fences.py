"""The fenced code of Markdown pages, run in order in an empty folder, as a reader would paste it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

#: Languages that `run_fences` runs. Fences of other languages, such as `text`, are only shown.
RUN = ("python", "bash")

#: A fence opens with three or more backticks or tildes, and a line of at least as many closes it.
OPENING = re.compile(r"^(?P<indent> *)(?P<mark>`{3,}|~{3,})\s*(?P<info>[^`]*)$")


class Fence(NamedTuple):
    """One fenced block: the number of its first line of code, its language in lower case, its text."""

    line: int
    language: str
    text: str


def fences(page: Path) -> list[Fence]:
    """Every fenced block of a page, in order. MyST's `{code-cell} python` counts as `python`."""
    found = []
    lines = page.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        opening = OPENING.match(lines[number])
        number += 1
        if opening is None:
            continue
        first = number
        closing = re.compile(rf"^ *{opening['mark'][0]}{{{len(opening['mark'])},}}\s*$")
        while number < len(lines) and not closing.match(lines[number]):
            number += 1
        if number == len(lines):
            raise ValueError(f"{page}:{first}: the fence is never closed")
        words = opening["info"].replace("{code-cell}", "").split()
        indent = len(opening["indent"])
        text = "".join(line[min(indent, len(line) - len(line.lstrip(" "))) :] + "\n" for line in lines[first:number])
        found.append(Fence(first + 1, words[0].lower() if words else "", text))
        number += 1
    return found


def run_fences(page: Path, folder: Path) -> dict[str, Any]:
    """Run the Python and bash fences of a page in order in a folder, and return the names that Python has then.

    All Python fences share one namespace. An exception has the page and its line in the traceback. A bash fence runs
    with the commands of this Python's environment in front of the path; it fails with its first failing command.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for fence in fences(page):
            if fence.language == "python":
                # Empty lines in front give each line its number on the page.
                exec(compile("\n" * (fence.line - 1) + fence.text, str(page), "exec"), names)
            elif fence.language == "bash":
                _run_bash(page, fence)
    finally:
        os.chdir(before)
    return names


def _run_bash(page: Path, fence: Fence) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    result = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", fence.text],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if result.returncode != 0:
        raise AssertionError(f"{page}:{fence.line}: exit status {result.returncode}\n{result.stdout}{result.stderr}")
