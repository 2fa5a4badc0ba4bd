"""The commands of the pages for engines run as written, and make files with the distances of the mesh."""

import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
from fieldbake.cli.application import app

ENGINES = Path(__file__).parents[2] / "examples" / "engines"
PAGES = [*sorted(ENGINES.glob("*/README.md")), ENGINES.parent / "web" / "README.md"]


def commands(page):
    return re.findall(r"^ +(fieldbake [^\n]+)$", page.read_text(encoding="utf-8"), re.M)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A folder with a model without any symmetry."""
    folder = tmp_path_factory.mktemp("engines")
    shape = fb.box((2, 1, 0.5)) | fb.sphere(0.4).translate((0.8, 0.5, 0.3))
    fb.bake(shape, 32).to_mesh().save(folder / "model.glb")
    for name in ("Assets", "project"):
        (folder / name).mkdir()
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_every_command_of_a_page_makes_its_file(page, model, monkeypatch):
    monkeypatch.chdir(model)
    mesh = fb.load_mesh("model.glb")
    assert commands(page)
    for command in commands(page):
        words = shlex.split(re.sub(r"-r \d+", "-r 32", command))[1:]
        target = Path(words[words.index("-o") + 1])
        result = CliRunner().invoke(app, words, prog_name="fieldbake")
        assert result.exit_code == 0, result.stderr
        found = fb.load(target)
        # Another engine has other axes; the file says which.
        exact = fb.bake(mesh, 32)
        assert sorted(found.resolution) == sorted(exact.resolution)
        # The same samples in another order, voxels within the band; unorm8 has steps of 4 voxels / 127.5.
        stored, wanted = (np.sort(np.clip(v.distances / v.spacing.max(), -2.9, 2.9), axis=None) for v in (found, exact))
        assert np.abs(stored - wanted).max() <= (4 / 127.5 if "unorm8" in words else 1e-6)


def test_the_pictures_of_the_pages_exist():
    for page in PAGES:
        for picture in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / picture).is_file()


@pytest.mark.slow
def test_blender_makes_the_mesh_of_the_level_set(model, tmp_path):
    if find_spec("bpy") is None:
        pytest.skip("bpy is not installed; it has 370 MB and wheels for one version of Python")
    fb.bake(model / "model.glb", 48).save(tmp_path / "field.vdb", engine="blender")
    program = ENGINES / "blender" / "open_field.py"
    command = [sys.executable, str(program), "field.vdb", "field.png", "vertices.npy"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=600, env=dict(os.environ))
    x, y, z = np.load(tmp_path / "vertices.npy").astype(np.float64).T
    # Blender's z points upwards: its (x, y, z) is (x, z, -y) here.
    distances = fb.signed_distance(model / "model.glb", np.stack([x, z, -y], axis=1))
    voxel = fb.load(tmp_path / "field.vdb").spacing.max()
    assert len(distances) > 1000
    # Grid to Mesh cuts sharp edges by up to half a voxel.
    assert np.abs(distances).max() <= voxel
    assert np.abs(distances).mean() <= 0.05 * voxel
    assert (tmp_path / "field.png").stat().st_size > 10_000
