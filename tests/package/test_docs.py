"""The documentation: every public name has an entry and an example, and the built site needs no network."""

import ast
import importlib
import importlib.util
import inspect
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import fieldbake as fb
from browser import missing, visit

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MODULES = ("arrays", "cache", "csg", "jax", "models", "mujoco", "newton", "torch", "training")


def public_names() -> set[str]:
    """Full names of all public names except modules and the version."""
    names = {f"fieldbake.{name}" for name in fb.__all__ if name not in MODULES and name != "__version__"}
    for module in MODULES:
        names |= {f"fieldbake.{module}.{name}" for name in importlib.import_module(f"fieldbake.{module}").__all__}
    return names


def test_the_reference_has_every_public_name_once():
    listed, modules = [], []
    for page in sorted((DOCS / "reference").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        listed += re.findall(r"^\.\. auto(?:class|function|exception):: (\S+)", text, re.M)
        modules += re.findall(r"^\.\. py:module:: fieldbake\.(\S+)", text, re.M)

    assert sorted(modules) == sorted(MODULES), "each module has one entry in the index of the site"
    assert len(listed) == len(set(listed))
    assert public_names() - set(listed) == set(), "add these names to a page of docs/reference/"
    assert set(listed) - public_names() == set(), "these names are no longer public"


def test_every_public_name_has_an_example():
    without = []
    for name in sorted(public_names()):
        module, _, attribute = name.rpartition(".")
        if ">>> " not in (inspect.getdoc(getattr(importlib.import_module(module), attribute)) or ""):
            without.append(name)

    assert without == [], "add an Examples section to their docstrings"


def test_every_page_is_reached_from_another_one():
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")}
    pages = {page for page in pages if not page.startswith(("build/", "generated/", "notes/"))}
    listed = {"index"}
    for page in pages:
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.M | re.S):
            for line in tree.splitlines():
                if line and not line.startswith(":"):
                    listed.add((DOCS / page).parent.joinpath(line).resolve().relative_to(DOCS).as_posix())

    assert pages - listed == set(), "add these pages to a toctree"


def test_code_of_pages_that_are_not_executed_is_python():
    for page in sorted(DOCS.rglob("*.md")):
        for fence in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S):
            ast.parse(fence)


def test_every_source_file_has_a_sentence_for_the_table_of_files():
    table = runpy.run_path(str(DOCS / "extensions" / "file_table.py"))
    for root, ending in table["SOURCES"].items():
        found = sorted((ROOT / root).rglob(f"*{ending}"))
        without = [path.relative_to(ROOT) for path in found if not table["first_sentence"](path).endswith(".")]
        assert len(found) > 5
        assert [path for path in without if path.name != "tests.rs"] == []


def test_notebooks_are_those_of_the_pages():
    """The notebooks need no run of their own: the fixture `site` executes the same cells in their pages."""
    import nbformat

    made = runpy.run_path(str(ROOT / "scripts" / "make_notebooks.py"))
    for name, page in made["PAGES"].items():
        text = (made["NOTEBOOKS"] / f"{name}.ipynb").read_text(encoding="utf-8")
        assert text == made["notebook"](DOCS / f"{page}.md"), "run scripts/make_notebooks.py"
        notebook = nbformat.reads(text, as_version=4)
        nbformat.validate(notebook)
        assert sum(cell.cell_type == "code" for cell in notebook.cells) >= 3


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The built site."""
    if importlib.util.find_spec("sphinx") is None or importlib.util.find_spec("myst_nb") is None:
        missing("Sphinx or myst-nb is missing: pip install --group docs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "--quiet", str(DOCS), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert "WARNING" not in done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_built_pages_show_their_pictures_without_a_network(site: Path):
    pages = [page for page in sorted(site.rglob("*.html")) if "_static" not in page.parts]
    # Names of pictures without pixels. Pictures further down are loaded first.
    expression = """(async () => {
      const pictures = [...document.querySelectorAll("article img")];
      await Promise.all(pictures.map((picture) => picture.decode().catch(() => null)));
      return pictures.filter((picture) => !picture.naturalWidth).map((picture) => picture.src);
    })()"""
    results = visit([{"url": page.as_uri(), "expression": expression} for page in pages], timeout=900)

    for page, result in zip(pages, results, strict=True):
        assert result.errors == [], page
        assert result.requests == [], page
        assert result.value == [], page
    assert len(pages) > 20


@pytest.mark.slow
def test_descriptions_of_properties_are_whole(site: Path):
    """The description of a property keeps the words before its first colon."""
    for page, words in (
        ("meshes", "signed by the winding: negative for a mesh that is inside out"),
        ("queries", "(..., 3) float64: they point away from the inside"),
    ):
        text = re.sub(r"<[^>]+>", "", (site / "reference" / f"{page}.html").read_text(encoding="utf-8"))
        assert words in " ".join(text.split())


@pytest.mark.slow
def test_code_stays_within_narrow_pages(site: Path):
    # Returns the names of code beyond the right border, except in tables, and the least width of long names in tables,
    # pixels.
    expression = """(() => {
      const names = [...document.querySelectorAll("article code")].filter((name) => !name.closest("table, pre"));
      const box = (name) => name.getBoundingClientRect();
      const wide = names.filter((name) => box(name).right > innerWidth).map((name) => name.textContent);
      const calls = [...document.querySelectorAll("article td code")].filter((name) => name.textContent.length > 10);
      return { names: names.length, wide, least: Math.min(...calls.map((name) => box(name).width)) };
    })()"""
    jobs = [
        {"url": (site / page).as_uri(), "expression": expression, "width": 390}
        for page in ("howto/engines.html", "migration.html")
    ]
    engines, migration = visit(jobs)
    for result in (engines, migration):
        assert result.value is not None, result.errors
        assert result.value["names"] > 0
        assert result.value["wide"] == []
    # A character has about 8 pixels.
    assert migration.value["least"] >= 75


@pytest.mark.slow
def test_the_search_works_without_a_network(site: Path):
    # The page lists the results one after another.
    script = """
      const link = '#search-results .search li a[href*="concepts/sign.html"]';
      await page.waitForSelector(link, { timeout: 60_000 });
      return page.$$eval(link, (links) => links.length);
    """
    [result] = visit([{"url": (site / "search.html").as_uri() + "?q=winding", "script": script}])

    assert result.errors == []
    assert result.requests == []
    assert result.value >= 1
