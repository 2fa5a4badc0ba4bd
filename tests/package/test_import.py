"""`import fieldbake` is quick: the modules behind a public name are imported at its first use."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import fieldbake as fb

#: Modules that take long to import, and their purpose.
HEAVY = {
    "numpy": "every array",
    "logging": "warnings of bakes",
    "trimesh": "reading mesh files",
    "scipy": "nothing of ours; trimesh uses it",
    "PIL": "writing pictures",
    "rich": "progress bars and the command line",
    "typer": "the command line",
    "unittest": "tests",
}


@pytest.fixture(scope="module")
def imported():
    script = "import fieldbake, sys; print(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    return {name.partition(".")[0] for name in result.stdout.split()}


@pytest.mark.parametrize("name", HEAVY)
def test_heavy_modules_wait_until_they_are_needed(imported, name):
    assert name not in imported


def test_the_import_was_one(imported):
    assert "fieldbake" in imported


def test_the_import_loads_no_other_module_of_the_package():
    script = "import fieldbake, sys; print(*sorted(name for name in sys.modules if name.startswith('fieldbake')))"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)

    assert result.stdout.split() == ["fieldbake"]


def public_names():
    """The public names of the stub with their modules."""
    tree = ast.parse(Path(fb.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    for statement in tree.body:
        assert isinstance(statement, ast.ImportFrom)
        for alias in statement.names:
            assert alias.asname == alias.name  # type checkers treat only such imports as public
            yield statement.module or "", alias.name


def test_type_checkers_and_the_run_time_see_the_same_names_of_the_same_modules():
    listed = list(public_names())

    assert sorted(name for _, name in listed) == fb.__all__
    for module, name in listed:
        if module:
            assert getattr(fb, name) is getattr(importlib.import_module(f"fieldbake.{module}"), name)


@pytest.mark.parametrize("module", ["shapes.primitives", "shapes.profiles"])
def test_every_primitive_is_public(module):
    primitives = importlib.import_module(f"fieldbake.{module}")

    assert {name for owner, name in public_names() if owner == module} == set(primitives.__all__)


def test_names_are_found_once_and_unknown_names_are_attribute_errors():
    script = """
import fieldbake
assert "bake" not in vars(fieldbake)
bake = fieldbake.bake
assert vars(fieldbake)["bake"] is bake
try:
    fieldbake.bakes
except AttributeError as error:
    assert str(error) == "'fieldbake' has no attribute 'bakes'"
else:
    raise AssertionError
from fieldbake import csg, Mesh
assert csg.__name__ == "fieldbake.csg" and Mesh.__name__ == "Mesh"
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_import_prints_nothing_and_starts_no_thread():
    script = "import fieldbake, threading; assert threading.active_count() == 1"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False, timeout=60
    )

    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
