"""The code of pages that the site only shows runs as pasted: each fence as a program, on small data."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
import robots
from fences import fences

DOCS = Path(__file__).parents[2] / "docs"

pytestmark = pytest.mark.slow

#: Sizes of the pages, and the sizes of the test.
SMALL = {
    r"\b4096\b": "96, shard=32, chunk=16",
    r"1000:1256": "16:32",
    r"resolution=128": "resolution=16",
    r"ProcessPoolExecutor\(8": "ProcessPoolExecutor(2",
    r"n_workers=8": "n_workers=2, dashboard_address=None, silence_logs=50",
    # Stores in memory in place of those on S3, which tests/scaling/test_s3.py uses.
    r"s3://bucket": "memory://bucket",
    r', storage_options=\{"profile": "lab"\}': "",
}


@pytest.fixture
def folder(tmp_path):
    """A folder with the files that the pages name."""
    (tmp_path / "assets").mkdir()
    volume = fb.bake(fb.sphere(0.5), 12)
    volume.save(tmp_path / "scan.nrrd")
    ball = volume.to_mesh()
    for name in ("bunny.obj", "a.glb", "b.glb", "assets/chair.glb", "assets/table.glb", "model.glb", "scene.glb",
                 "scan.ply", "knot.obj", "gear.obj", "part.stl"):  # fmt: skip
        ball.save(tmp_path / name)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 1.0
    np.save(tmp_path / "poses.npy", poses)
    np.save(tmp_path / "values.npy", [[0.0, 0.0], [0.5, -0.5]])
    (tmp_path / "arm.urdf").write_text(robots.TWO_LINKS, encoding="utf-8")
    return tmp_path


def programs(name):
    """The Python fences of a page with small sizes; each begins with the imports of those before it."""
    imports = "import fieldbake as fb\n"
    for fence in fences(DOCS / name):
        if fence.language == "python":
            text = fence.text
            for pattern, small in SMALL.items():
                text = re.sub(pattern, small, text)
            yield pytest.param(imports + text, id=f"{Path(name).stem}-{fence.line}")


@pytest.mark.parametrize("program", [*programs("scale.md"), *programs("threads.md")])
def test_fences_run_as_programs(program, folder):
    for package in ("zarr", "torch", "distributed"):
        if re.search(rf"^(import|from) {package}\b", program, re.M) and importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    (folder / "program.py").write_text(program, encoding="utf-8")
    environment = {**os.environ, "FIELDBAKE_DEVICE": "cpu"}
    command = [sys.executable, "-W", "error::SyntaxWarning", "program.py"]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-3000:]


def commands():
    """The command lines in the text of all pages, those with names of files in capitals excepted."""
    for page in sorted(DOCS.rglob("*.md")):
        if page.relative_to(DOCS).parts[0] not in ("build", "generated"):
            text = page.read_text(encoding="utf-8")
            for command in re.findall(r"(?:^    |`)fieldbake ([a-z]+(?: [^`\n]*)?)", text, re.M):
                if not re.search(r"\b[A-Z]{2,}\b", command):
                    yield pytest.param(command, id=f"{page.stem}-{command.split()[0]}")


@pytest.mark.parametrize("command", [*commands()])
def test_the_commands_of_the_pages_run(command, folder):
    for pattern, small in (
        (r"-r \d+", "-r 16"),
        (r"--resolution \d+", "--resolution 24"),
        (r"-n \d+", "-n 500"),
        (r"--jobs \d+", "--jobs 1"),
    ):
        command = re.sub(pattern, small, command)
    done = subprocess.run(
        ["bash", "-c", f'"$PYTHON" -m fieldbake {command}'], cwd=folder, capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHON": sys.executable, "FIELDBAKE_DEVICE": "cpu"}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_the_pages_have_commands():
    assert len(list(commands())) >= 9
