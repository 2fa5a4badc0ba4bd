"""The command slice."""

import json
import zipfile

import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app


def run(*arguments):
    return CliRunner().invoke(app, ["slice", *(str(argument) for argument in arguments)])


@pytest.fixture
def files(tmp_path):
    fb.Mesh(*meshes.box()).save(tmp_path / "box.stl")
    fb.bake(meshes.box(), 24).save(tmp_path / "box.npz")
    fb.pack([fb.bake(meshes.box(), 16)]).save(tmp_path / "atlas.npz")
    (tmp_path / "box.csg").write_text("(cube 2)")
    return tmp_path


@pytest.mark.parametrize("name", ["box.stl", "box.npz", "box.csg"])
def test_meshes_fields_and_shapes_become_images(files, name):
    done = run(files / name, "-o", files / "out.zip", "--layer", "0.5", "--pixel", "0.1x0.2")
    assert done.exit_code == 0, done.output
    with zipfile.ZipFile(files / "out.zip") as archive:
        assert json.loads(archive.read("manifest.json"))["pixel"] == [0.1, 0.2]
        assert len(archive.namelist()) == 5
    assert "layers" in done.output


def test_outlines_are_svg_in_a_box(files):
    box = ["--bounds", "-1,-1,0,1,1,1"]
    done = run(files / "box.stl", "-o", files / "out.svg", "--layer", "0.5", "--pixel", "0.1", *box)
    assert done.exit_code == 0, done.output
    assert (files / "out.svg").read_text().count("<path") == 2
    assert "volume" in done.output


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("box.stl", "-o", "out.png", "--layer", "1", "--pixel", "1"), 2, "must end in .zip or .svg"),
        (("box.stl", "-o", "out.zip", "--layer", "1", "--pixel", "1x2x3"), 2, "is not a number such as 0.05"),
        (("box.stl", "-o", "out.zip", "--layer", "0", "--pixel", "1"), 1, "layer: must be"),
        (("atlas.npz", "-o", "out.zip", "--layer", "1", "--pixel", "1"), 1, "holds a Atlas"),
    ],
)
def test_mistakes_end_in_one_line(files, monkeypatch, arguments, code, words):
    monkeypatch.chdir(files)
    done = run(*arguments)
    assert done.exit_code == code
    assert words in " ".join(done.output.replace("│", " ").split())
