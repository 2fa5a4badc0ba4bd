"""Keep napoleon from reading the words before the first colon of a property's docstring as its type."""

from __future__ import annotations

from sphinx.application import Sphinx

#: Napoleon runs at 500, the default.
BEFORE_NAPOLEON = 400


def keep_first_line(_app: Sphinx, what: str, _name: str, _object: object, _options: object, lines: list[str]) -> None:
    """Put an empty comment in front of the text, where napoleon finds no colon."""
    if what in ("property", "attribute"):
        lines[:0] = ["..", ""]


def setup(app: Sphinx) -> dict[str, bool]:
    """Change docstrings before napoleon reads them."""
    app.connect("autodoc-process-docstring", keep_first_line, priority=BEFORE_NAPOLEON)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
