"""The packages import each other in one direction, and only public names are visible from outside."""

from __future__ import annotations

import ast
import functools
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import fieldbake as fb

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "python" / "fieldbake"

PUBLIC_MODULES = ("arrays", "cache", "csg", "jax", "models", "mujoco", "newton", "torch", "training")

#: Largest number of modules in a folder.
LARGEST_FOLDER = 16

#: Most exceptions from the order of the packages.
MOST_EXCEPTIONS = 11


class Import(NamedTuple):
    """One imported name."""

    importer: str
    imported: str
    name: str
    deferred: bool

    @property
    def edge(self) -> tuple[str, str]:
        return self.importer, self.imported


def modules() -> dict[str, Path]:
    """Every module of the package with its file."""
    found = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports_of(module: str, file: Path, known: dict[str, Path]) -> Iterator[Import]:
    """Every import of a module of this package, inside functions and under TYPE_CHECKING too."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    top_level = set(tree.body)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            pairs = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            pairs = [(source, alias.name) for alias in node.names]
        else:
            continue
        for source, name in pairs:
            if (source, name) == ("fieldbake", "_core"):
                continue  # the compiled core imports nothing of the package
            target = f"{source}.{name}" if f"{source}.{name}" in known else source
            if target in known:
                yield Import(module, target, "" if target != source else name, node not in top_level)


@functools.cache
def all_imports() -> list[Import]:
    known = modules()
    return [found for module, file in known.items() for found in imports_of(module, file, known)]


def exceptions() -> set[tuple[str, str]]:
    """The imports that pyproject.toml exempts from the order, by name."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = text.split("ignore_imports = [")[1].split("\n]")[0]
    lines = [line.strip().partition('",')[0].lstrip('"') for line in listed.splitlines() if "->" in line]
    pairs = [tuple(line.split(" -> ")) for line in lines if "*" not in line]
    return {(first, second) for first, second in pairs}


def circles(edges: set[tuple[str, str]]) -> list[list[str]]:
    """The strongly connected components of more than one module, by Tarjan's algorithm."""
    following: dict[str, list[str]] = {}
    for first, second in edges:
        following.setdefault(first, []).append(second)
    index: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        index[node] = lowest[node] = len(index)
        stack.append(node)
        for other in following.get(node, []):
            if other not in index:
                visit(other)
                lowest[node] = min(lowest[node], lowest[other])
            elif other in stack:
                lowest[node] = min(lowest[node], index[other])
        if lowest[node] == index[node]:
            component = [stack.pop()]
            while component[-1] != node:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for node in list(following):
        if node not in index:
            visit(node)
    return found


def test_the_walker_sees_every_kind_of_import():
    known = modules()
    edges = {found.edge for found in all_imports()}

    assert len(known) > 50
    assert ("fieldbake", "fieldbake.base.former_names") in edges  # from .package.module import name
    assert ("fieldbake.scenes.scene", "fieldbake.scenes.lights") in edges  # from .module import name
    assert ("fieldbake.volumes.volume", "fieldbake.base.checks") in edges  # from ..package import module
    assert ("fieldbake.volumes.volume", "fieldbake.drawing.plot") in edges  # in a function
    assert ("fieldbake.cli.application", "fieldbake") in edges  # import package
    assert circles({("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")}) == [["a", "b", "c"]]


def test_no_folder_is_too_large_to_read():
    folders = [folder for folder in (PACKAGE, *PACKAGE.rglob("*")) if folder.is_dir()]
    sizes = {folder.relative_to(PACKAGE): len(list(folder.glob("*.py"))) for folder in folders}
    assert max(sizes.values()) > 10
    assert {folder: size for folder, size in sizes.items() if size > LARGEST_FOLDER} == {}


def test_no_modules_import_each_other_in_a_circle():
    edges = {found.edge for found in all_imports()} - exceptions()

    assert circles(edges) == []


def test_only_named_exceptions_are_imported_late():
    # `import fieldbake` imports every module at the first use of its names.
    late = {found.edge for found in all_imports() if found.deferred and found.importer != "fieldbake"}

    assert late <= exceptions()


def test_the_exceptions_are_few_and_in_use():
    assert exceptions() <= {found.edge for found in all_imports()}
    assert len(exceptions()) <= MOST_EXCEPTIONS


def test_only_the_command_line_imports_the_public_interface():
    importers = {found.importer for found in all_imports() if found.imported == "fieldbake"}

    assert all(importer.startswith("fieldbake.cli.") for importer in importers)


def test_private_names_stay_in_their_file():
    crossing = {found for found in all_imports() if found.name.startswith("_")}

    assert crossing == set()


def test_no_module_has_the_name_of_a_public_function():
    functions = {name for name in fb.__all__ if inspect.isfunction(getattr(fb, name))}

    assert functions
    assert functions & {part for module in modules() for part in module.split(".")} == set()


def test_dir_shows_the_public_names_only():
    assert dir(fb) == sorted(fb.__all__)
    assert set(PUBLIC_MODULES) <= set(fb.__all__)


@pytest.mark.parametrize("name", PUBLIC_MODULES)
def test_dir_of_a_public_module_shows_its_public_names_only(name):
    module = getattr(fb, name)

    assert dir(module) == sorted(module.__all__)
    assert all(hasattr(module, public) for public in module.__all__)
