"""Write examples/notebooks/ from executed pages of the documentation: the same text and code, without outputs.

.venv/bin/python scripts/make_notebooks.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "examples" / "notebooks"

#: Notebooks, and the pages of docs/ that they come from.
PAGES = {
    "article_mesh_distance_field": "articles/mesh_distance_field",
    "article_packing": "articles/packing",
    "article_fields_in_unity": "articles/fields_in_unity",
    "article_decomposition": "articles/decomposition",
    "article_quadrics": "articles/quadrics",
    "training_data": "howto/training_data",
    "csg_to_print": "howto/print_a_part",
    "engine_export": "howto/engines",
    "differentiable_fit": "howto/fit",
    "cluster": "howto/cluster",
}

CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```\n", re.M | re.S)


def text_of(markdown: str) -> str:
    """Markdown that a notebook shows: without parts and pictures of other files, and with links to the web only."""
    markdown = re.sub(r"^```\{include\}.*?^```\n", "", markdown, flags=re.M | re.S)
    markdown = re.sub(r"^!\[[^\]]*\]\([^)]*\)\n", "", markdown, flags=re.M)
    return re.sub(r"\[([^\]]+)\]\((?!https?:)[^)]+\)", r"\1", markdown).strip()


def notebook(page: Path) -> str:
    """The notebook of a page, as JSON."""
    body = page.read_text(encoding="utf-8").split("---\n", 2)[2]
    cells = []
    for number, piece in enumerate(CELL.split(body)):
        code = number % 2 == 1
        content = piece.rstrip("\n") if code else text_of(piece)
        if not content:
            continue
        cell = {"cell_type": "code" if code else "markdown", "id": f"cell-{len(cells)}", "metadata": {}}
        if code:
            cell |= {"execution_count": None, "outputs": []}
        cells.append(cell | {"source": content.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    document = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write all notebooks."""
    for name, page in PAGES.items():
        (NOTEBOOKS / f"{name}.ipynb").write_text(notebook(ROOT / "docs" / f"{page}.md"), encoding="utf-8")


if __name__ == "__main__":
    main()
