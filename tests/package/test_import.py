"""`import fieldbake` is quick because it does not bring along what only some calls need."""

import subprocess
import sys

import pytest

#: Modules that take long to import, and their purpose.
HEAVY = {
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
    assert "numpy" in imported


def test_import_prints_nothing_and_starts_no_thread():
    script = "import fieldbake, threading; assert threading.active_count() == 1"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False, timeout=60
    )

    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
