"""The commands ``query`` and ``check``."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "knot.ply"
    fb.Mesh(*meshes.knot(48, 8)).save(path)
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


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
        trimesh = pytest.importorskip("trimesh")
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


def test_a_bad_output_fails_before_any_work(model, tmp_path):
    np.save(tmp_path / "p.npy", np.zeros((1, 3)))

    assert run("query", model, tmp_path / "p.npy", "-o", tmp_path / "a.xyz").exit_code == 2
    assert run("query", model, tmp_path / "p.npy", "-o", tmp_path / "no" / "a.npy").exit_code == 2
    (tmp_path / "bad.csv").write_text("x,y\n1,2\n")
    assert run("query", model, tmp_path / "bad.csv", "-o", tmp_path / "a.npy").exit_code == 1


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
