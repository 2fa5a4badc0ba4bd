"""Check comments, docstrings and documents for openings and words that make a sentence hard to understand.

A paragraph of documentation starts with its subject or its verb, not with a fragment that depends on the line before.
Data are not people, so verbs of speech have no place in it. A sentence names its noun: a pronoun in place of it, as in
"its value is that of the nearest sample", is counted in all text files, and the count must not grow. Comments of Rust
and WGSL, which no formatter wraps, have the width of the code.
"""

from __future__ import annotations

import re
import sys
from itertools import groupby

from check_paths import ROOT, texts, tracked

#: Openings of a paragraph that has no subject. "What " is one too, except in the headings of documents.
OPENINGS = ("Of ", "That ", "In place of ", "Who ", "What of ")

#: Words that have a better term in every case.
WORDS = re.compile(
    r"\b(asked|asks|told|whom|nobody|whatever|matters|dear|as it stands|fight over|holds back|takes part|who is)\b",
    re.IGNORECASE,
)

#: A pronoun in place of a noun, also across the lines of a comment.
ELLIPSIS = re.compile(r"\b(?:that|those)(?:\s|//[/!]?|#:?)+of\b", re.IGNORECASE)

#: Largest number of matches of `ELLIPSIS` in `SEARCHED`. It may only become smaller.
MOST_ELLIPSES = 2

#: Starts of the paths of files whose ellipses are counted, in addition to all Markdown files.
SEARCHED = ("src/", "shaders/", "python/", "tests/", "docs/", "benches/", "examples/", "web/src/")

#: Records of measurements, which are not rewritten.
RECORDS = "benches/results/"

#: Largest number of columns of a comment, as in rustfmt.toml.
COLUMNS = 120

#: Marks of comments, bullets and docstrings in front of the first word.
MARKS = re.compile(r'^[\s/!#:*>-]*(?:r?""")?')


def paragraphs(name: str) -> list[tuple[int, list[str]]]:
    """The paragraphs of a file's text, each with the number of its first line."""
    lines = sorted(dict(texts(name)).items())
    numbered = [(number, MARKS.sub("", line).strip()) for number, line in lines]
    filled = [(number, line) for number, line in numbered if line]
    runs = groupby(enumerate(filled), lambda item: item[1][0] - item[0])
    blocks = [[entry for _, entry in run] for _, run in runs]
    return [(block[0][0], [line for _, line in block]) for block in blocks]


def wide_comments(name: str) -> list[int]:
    """The numbers of the lines of a file that are comments with more than `COLUMNS` columns."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    return [i for i, line in enumerate(lines, 1) if line.lstrip().startswith("//") and len(line) > COLUMNS]


def ellipses(name: str) -> list[int]:
    """The numbers of the lines of a file on which an ellipsis of a noun starts; none for a binary file."""
    if name.startswith(RECORDS) or (not name.startswith(SEARCHED) and not name.endswith(".md")):
        return []
    content = (ROOT / name).read_bytes()
    text = "" if b"\0" in content else content.decode("utf-8", errors="replace")
    return [text.count("\n", 0, found.start()) + 1 for found in ELLIPSIS.finditer(text)]


def main() -> int:
    """Print each fault; the exit status is 1 if there is one."""
    faults = 0
    places = []
    for name in tracked():
        places += [f"{name}:{number}" for number in ellipses(name)]
        if not name.endswith((".md", ".rs", ".wgsl", ".py")) or name.startswith(RECORDS):
            continue
        for number in wide_comments(name) if name.endswith((".rs", ".wgsl")) else ():
            print(f"{name}:{number}: a comment has at most {COLUMNS} columns")
            faults += 1
        for first, lines in paragraphs(name):
            is_riddle = lines[0].startswith(OPENINGS) or (lines[0].startswith("What ") and not name.endswith(".md"))
            if is_riddle:
                print(f"{name}:{first}: a paragraph starts with its subject, got {lines[0][:60]!r}")
                faults += 1
            for line in lines:
                for word in WORDS.findall(line):
                    print(f"{name}:{first}: use a term for {word!r} in {line[:80]!r}")
                    faults += 1
    if len(places) > MOST_ELLIPSES:
        print(
            f"{', '.join(places)}: a sentence names its noun, without an ellipsis of nouns (that of, those of); "
            f"at most {MOST_ELLIPSES} are left in the tree, got {len(places)}"
        )
        faults += 1
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
