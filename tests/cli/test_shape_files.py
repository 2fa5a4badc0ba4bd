"""Files of shapes on the command line: s-expressions, and .3mf files with an implicit function."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app
from fieldbake.drawing.raymarching import raymarch

SLICE = ("-o", "out.zip", "--layer", "0.25", "--pixel", "0.1")


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shape = fb.box((2, 1, 1))
    shape.save("part.3mf", implicit=True)
    (tmp_path / "part.csg").write_text(shape.to_sexpr())
    (tmp_path / "marked.sexpr").write_bytes(b"\xef\xbb\xbf" + shape.to_sexpr().encode())
    (tmp_path / "latin.csg").write_bytes("; größe\n(box 2 1 1)".encode("latin-1"))
    fb.Mesh(*meshes.box()).save("cube.3mf")
    np.save("still.npy", np.eye(4)[None].repeat(2, axis=0))
    np.save("points.npy", np.zeros((1, 3)))
    return tmp_path


@pytest.mark.parametrize("name", ["part.3mf", "part.csg", "marked.sexpr"])
@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("mesh", ("-o", "out.stl", "-r", "32")),
        ("slice", SLICE),
        ("bake", ("-o", "out.npz", "-r", "16")),
        ("bake", ("-o", "out.npz", "-r", "16", "--sparse")),
        ("bake", ("-o", "baked", "-r", "16")),
        ("merge", ("-o", "out.npz", "-r", "16")),
        ("pack", ("-o", "out.npz", "-r", "16", "--page-size", "fit")),
        ("render", ("-o", "out.png", "--size", "32x24", "--device", "cpu")),
        ("csg", ("-o", "out.png", "--size", "32x24", "--device", "cpu")),
        ("csg", ("-o", "out.stl", "-r", "16")),
        ("view", ("-o", "out.html", "--no-open")),
        ("sweep", ("still.npy", "-o", "out.npz", "-r", "16")),
        ("info", ()),
    ],
)
def test_commands_take_shapes_of_every_kind_of_file(folder, name, command, options):
    done = run(command, name, *options)
    assert done.exit_code == 0, done.output
    made = next(iter(sorted(folder.glob("out.*")) + sorted(folder.glob("baked/*.npz"))), None)
    assert command == "info" or made.stat().st_size > 0
    if made is not None and made.suffix == ".stl":
        assert fb.load_mesh(made).volume == pytest.approx(2, rel=1e-3)
    if command == "bake":
        # Half of the shortest side is the distance in the middle.
        assert fb.load(made).sample([(0, 0, 0)]) == pytest.approx(-0.5, abs=1e-3)


def test_the_command_draws_by_its_method(folder, monkeypatch):
    """The command once drew every picture as a scene, without its method."""
    frames = []
    monkeypatch.setattr(
        fb, "raymarch", lambda *given, **options: frames.append(raymarch(*given, **options)) or frames[-1]
    )
    (folder / "hollow.csg").write_text((fb.sphere() - fb.box(0.9)).to_sexpr())
    for method in ("auto", "whole", "octree"):
        options = ("-o", f"{method}.png", "--size", "32x32", "--device", "cpu", "--method", method)
        assert run("csg", "hollow.csg", *options).exit_code == 0
    auto, whole, octree = frames
    # A march evaluates the leaves in every step, and an octree finds roots in closed form.
    assert whole.report["leaf_evaluations"] > octree.report["leaf_evaluations"]
    assert (whole.object_id == octree.object_id).mean() > 0.99
    # Four samples mix the colours of the shape and of the background.
    assert len(np.unique(auto.image)) > len(np.unique(octree.image))


def test_info_describes_shapes(folder):
    rows = run("info", "part.3mf", "--json").output
    facts = json.loads(rows)
    assert facts["kind"] == "Shape"
    assert facts["bounds"] == [[-1, -0.5, -0.5], [1, 0.5, 0.5]]
    assert fb.csg.parse(facts["expression"]).distance([(2, 0, 0)]) == pytest.approx(1)
    fb.csg.parse("(plane 0 0 1 0)").save("half.3mf", implicit=True, within=meshes.box())
    assert json.loads(run("info", "half.3mf", "--json").output)["bounds"] is None
    assert "unbounded" in run("info", "half.3mf").output


def test_a_3mf_of_triangles_stays_a_mesh(folder):
    assert json.loads(run("info", "cube.3mf", "--json").output)["faces"] == 12
    assert run("mesh", "cube.3mf", "-o", "out.stl", "--offset", "0.5", "-r", "24").exit_code == 0
    assert run("check", "cube.3mf").exit_code == 0


def test_shapes_of_equal_stems_are_baked_into_files_of_their_own(folder):
    done = run("bake", "part.3mf", "part.csg", "cube.3mf", "-o", "baked", "-r", "16")
    assert done.exit_code == 0, done.output
    assert sorted(file.name for file in folder.glob("baked/*.npz")) == ["cube.npz", "part.3mf.npz", "part.csg.npz"]


@pytest.mark.parametrize("name", ["part.3mf", "part.csg"])
@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("check",), ()),
        (("query",), ("points.npy", "-o", "out.csv")),
        (("solid",), ("-o", "out.stl")),
        (("boolean",), ("-", "cube.3mf", "-o", "out.stl")),
        (("boolean", "cube.3mf", "-"), ("-o", "out.stl")),
        (("cook",), ("--for", "newton", "-o", "cache")),
        (("sample",), ("-n", "10", "-o", "samples")),
    ],
)
def test_where_a_mesh_is_needed_the_error_names_the_command_that_makes_one(name, before, after):
    done = run(*before, name, *after)
    assert done.exit_code == 1
    assert f"`fieldbake mesh {name} -o MESH.stl` makes a mesh" in done.output


@pytest.mark.parametrize(("output", "words"), [("out.stl", "fieldbake mesh"), ("out.npz", "fieldbake bake")])
def test_convert_names_the_command_that_has_a_resolution(output, words):
    done = run("convert", "part.3mf", output)
    assert done.exit_code == 1
    assert f"`{words} part.3mf -o {output}`" in done.output


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("csg", ("-o", "out.stl")),
        ("mesh", ("-o", "out.stl")),
        ("slice", SLICE),
        ("view", ("-o", "out.html", "--no-open")),
        ("bake", ("-o", "out.npz")),
        ("info", ()),
    ],
)
def test_a_text_of_another_encoding_is_one_clear_line(command, options):
    done = run(command, "latin.csg", *options)
    assert done.exit_code == 1
    assert "error: latin.csg: must be text in UTF-8 with one s-expression, got the byte 0xf6" in done.output
    assert isinstance(done.exception, SystemExit)


@pytest.mark.parametrize("name", ["ball.npz", "cube.3mf"])
def test_csg_names_a_file_that_is_no_text(folder, name):
    fb.bake(fb.sphere(), 16).save("ball.npz")
    done = run("csg", name, "-o", "out.stl")
    assert done.exit_code == 1
    assert f"error: {name}: must be text in UTF-8 with one s-expression" in done.output
