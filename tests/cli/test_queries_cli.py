"""The commands ``query`` and ``check``."""

import io
import json
import warnings

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "knot.ply"
    fb.Mesh(*meshes.knot(48, 8)).save(path)
    return path


def run(*arguments, input=None):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=input)


@pytest.mark.parametrize("kind", ["npy", "csv", "xyz", "ply"])
@pytest.mark.parametrize("ending", ["npy", "csv"])
def test_points_of_every_format_are_answered(kind, ending, model, tmp_path, random):
    points = random.uniform(-3, 3, (20, 3))
    source, target = tmp_path / f"points.{kind}", tmp_path / f"out.{ending}"
    if kind == "npy":
        np.save(source, points)
    elif kind == "csv":
        np.savetxt(source, points, delimiter=",", header="x,y,z", comments="", fmt="%.17g")
    elif kind == "xyz":
        np.savetxt(source, points, fmt="%.17g")
    else:
        trimesh.PointCloud(points).export(source)

    result = run("query", model, source, "-o", target)

    assert result.exit_code == 0, result.output
    table = np.load(target) if ending == "npy" else np.loadtxt(target, delimiter=",", skiprows=1)
    expected = fb.query(model, points)
    room = 1e-5 if kind == "ply" else 0  # its writer stores float32
    assert np.abs(table[:, 0] - expected.distances).max() <= room
    assert table.shape == (20, 11)
    if not room:
        assert np.array_equal(table[:, 7], expected.faces)


@pytest.mark.parametrize("kind", ["npy", "csv", "xyz", "ply"])
def test_points_and_results_pass_through_streams(kind, model, tmp_path, random):
    points = random.uniform(-3, 3, (20, 3)).astype(np.float32).astype(np.float64)
    stream = io.BytesIO()
    if kind == "npy":
        np.save(stream, points)
    elif kind == "ply":
        stream.write(trimesh.PointCloud(points).export(file_type="ply"))
    else:
        text = {"delimiter": ",", "header": "x,y,z", "comments": ""} if kind == "csv" else {}
        np.savetxt(stream, points, fmt="%.17g", **text)

    found = run("query", model, "-", "-o", "-", input=stream.getvalue())
    binary = run("query", model, "-", "-o", "-", "--from", kind, "--to", "npy", input=stream.getvalue())

    assert (found.exit_code, binary.exit_code) == (0, 0), found.output
    table = np.loadtxt(io.StringIO(found.stdout), delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 0], fb.query(model, points).distances)
    assert np.array_equal(np.load(io.BytesIO(binary.stdout_bytes)), table)


def test_streams_of_points_have_errors_and_warnings_on_stderr(model, tmp_path):
    for given in (b"", b"hello", b"\xff\xfe\x00", b"1,2\n"):
        result = run("query", model, "-", "-o", "-", input=given)
        assert (result.exit_code, result.stdout) == (1, "")
        assert "error: " in result.stderr
    fb.Mesh(*meshes.open_box()).save(tmp_path / "open.obj")
    result = run("query", tmp_path / "open.obj", "-", "-o", "-", input=b"0,0,0\n")
    assert result.stderr.startswith("warning: the surface is open")
    assert len(result.stdout.splitlines()) == 2
    assert run("query", "-q", tmp_path / "open.obj", "-", "-o", "-", input=b"0,0,0\n").stderr == ""


def test_a_bad_output_fails_before_any_work(model, tmp_path):
    np.save(tmp_path / "p.npy", np.zeros((1, 3)))

    assert run("query", model, tmp_path / "p.npy", "-o", tmp_path / "a.xyz").exit_code == 2
    # As all commands: the folder is missing, or the file exists.
    assert run("query", model, tmp_path / "p.npy", "-o", tmp_path / "no" / "a.npy").exit_code == 1
    assert run("query", "--no-clobber", model, tmp_path / "p.npy", "-o", tmp_path / "p.npy").exit_code == 1
    (tmp_path / "bad.csv").write_text("x,y\n1,2\n")
    assert run("query", model, tmp_path / "bad.csv", "-o", tmp_path / "a.npy").exit_code == 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.xyz", "", "has no points"),
        ("header.csv", "x,y,z\n", "has no points"),
        ("commas.xyz", "1,2,3\n", "line 1 must be numbers separated by spaces, got '1,2,3'"),
        ("words.csv", "x,y,z\n1,2,3\n1,2,c\n", "line 3 must be numbers separated by commas, got '1,2,c'"),
    ],
)
def test_damaged_tables_of_points_are_one_error(model, tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = run("query", model, tmp_path / name, "-o", "-")
    assert result.exit_code == 1
    assert message in " ".join(result.stderr.split())
    assert result.stderr.count("error: ") == 1


def test_check_knows_what_is_wrong(model, tmp_path):
    cube = meshes.box()
    fb.Mesh(*meshes.open_box()).save(tmp_path / "open.obj")
    moved = meshes.scale_and_shift(cube, 1, (1.1, 0.3, 0.2))
    fb.Mesh(*meshes.join(cube, moved)).save(tmp_path / "crossing.obj")
    fb.Mesh(*meshes.box((0, 0, 0), (1, 2, 0.25))).save(tmp_path / "slab.obj")

    result = run("check", model, tmp_path / "open.obj", tmp_path / "crossing.obj", tmp_path / "slab.obj", "--json")

    assert result.exit_code == 0, result.output
    knot, opened, crossing, slab = (json.loads(line) for line in result.output.splitlines())
    assert (knot["closed"], knot["boundary_edges"], knot["self_intersections"]) == (True, 0, 0)
    assert (opened["closed"], opened["boundary_edges"], opened["volume"]) == (False, 4, None)
    assert crossing["self_intersections"] > 0
    assert crossing["components"] == 2
    assert slab["thinnest_part"] == pytest.approx(0.25)
    assert slab["volume"] == pytest.approx(0.5)
    assert slab["area"] == pytest.approx(2 * (2 + 0.25 + 0.5))
    assert "thinnest part" in run("check", model).output
