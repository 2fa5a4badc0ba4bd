"""Formats, streams and options of the command line that all commands share."""

import io
import json
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
from fieldbake.cli.application import app

DONE, BAD_INPUT, BAD_USAGE = 0, 1, 2
ENDINGS = (".npz", ".vdb", ".nvdb", ".vti", ".nrrd", ".dds", ".ktx2", ".vf", ".exr")


def fieldbake(*arguments, input=None):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="fieldbake", input=input)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    mesh = fb.bake(fb.box((2, 1, 0.5)).translate((1, 2, 3)), 24).to_mesh()
    mesh.save(folder / "body.obj")
    fb.bake(folder / "body.obj", 16).save(folder / "v.npz")
    return folder


@pytest.mark.parametrize("ending", ENDINGS)
def test_bake_writes_every_format(folder, ending, tmp_path):
    result = fieldbake("bake", folder / "body.obj", "-r", 16, "-o", tmp_path / f"v{ending}")
    assert result.exit_code == DONE, result.stderr
    found = fb.load(tmp_path / f"v{ending}")
    exact = fb.load(folder / "v.npz")
    near = np.abs(exact.distances) < 2.9 * exact.spacing.max()
    assert np.array_equal(found.distances[near], exact.distances[near])
    assert np.array_equal(found.bounds, exact.bounds)


def test_convert_goes_through_all_formats_and_back(folder, tmp_path):
    before = folder / "v.npz"
    for i, ending in enumerate((".vti", ".nrrd", ".dds", ".ktx2", ".vf", ".exr", ".npz", ".vdb", ".nvdb", ".npz")):
        after = tmp_path / f"{i}{ending}"
        result = fieldbake("convert", before, after)
        assert result.exit_code == DONE, result.stderr
        before = after
    exact, found = fb.load(folder / "v.npz"), fb.load(before)
    band = np.float32(3 * exact.spacing.max())
    assert np.array_equal(found.distances, np.clip(exact.distances, -band, band))


def test_convert_writes_meshes(folder, tmp_path):
    for source, target in (("v.npz", "a.stl"), ("body.obj", "b.glb"), ("v.npz", "c.ply")):
        result = fieldbake("convert", folder / source, tmp_path / target)
        assert result.exit_code == DONE, result.stderr
        assert fb.load_mesh(tmp_path / target).volume == pytest.approx(1, rel=0.03)


def test_engines_and_bounds(folder, tmp_path):
    bounds = "0,1.5,2.5,2,2.5,3.5"
    result = fieldbake(
        "bake", folder / "body.obj", "-o", tmp_path / "v.vdb", "-r", 20, "--bounds", bounds, "--engine", "blender"
    )
    assert result.exit_code == DONE, result.stderr
    assert np.allclose(fb.load(tmp_path / "v.vdb").bounds, [(0, -3.5, 1.5), (2, -2.5, 2.5)])
    result = fieldbake("convert", folder / "v.npz", tmp_path / "v.exr", "--engine", "unity")
    assert result.exit_code == DONE, result.stderr
    assert (tmp_path / "v.exr.meta").exists()
    result = fieldbake("bake", folder / "body.obj", "-o", tmp_path / "w.vdb", "--bounds", "1,2,3")
    assert result.exit_code == BAD_USAGE
    assert "six numbers" in result.stderr


def test_info_of_several_files_as_json(folder):
    result = fieldbake("info", folder / "v.npz", folder / "body.obj", "--json")
    assert result.exit_code == DONE, result.stderr
    field, mesh = (json.loads(line) for line in result.stdout.splitlines())
    exact = fb.load(folder / "v.npz")
    assert field["kind"] == "Volume"
    assert field["resolution"] == list(exact.resolution)
    assert field["bounds"] == exact.bounds.tolist()
    assert mesh["kind"] == "Mesh"
    assert mesh["closed"] is True
    result = fieldbake("info", folder / "v.npz", folder / "body.obj")
    assert "16 x" in result.stdout
    assert "vertices" in result.stdout


def test_info_of_an_unknown_file_names_few_endings(tmp_path):
    (tmp_path / "x.zzz").write_text("?")
    result = fieldbake("info", tmp_path / "x.zzz")
    assert result.exit_code == BAD_INPUT
    assert ".obj" in result.stderr
    assert result.stderr.count(".") < 20


@pytest.mark.parametrize("place", ["before", "after"])
def test_quiet_runs_print_nothing(folder, tmp_path, place):
    command = ["bake", folder / "body.obj", "-r", 8, "-o", tmp_path / "v.npz"]
    result = fieldbake(*(["-q", *command] if place == "before" else [*command, "-q"]))
    assert (result.exit_code, result.stdout, result.stderr) == (DONE, "", "")
    result = fieldbake("info", tmp_path / "v.npz")
    assert result.stdout != ""


def test_no_clobber_keeps_files_that_exist(folder, tmp_path):
    target = tmp_path / "v.npz"
    for arguments in (
        ["bake", folder / "body.obj", "-o", target],
        ["convert", folder / "v.npz", target],
        ["pack", folder / "v.npz", "-o", target],
    ):
        target.write_bytes(b"kept")
        result = fieldbake(*arguments, "--no-clobber")
        assert result.exit_code == BAD_INPUT
        assert "exists" in result.stderr
        assert target.read_bytes() == b"kept"
        assert fieldbake(*arguments, "-q").exit_code == DONE


def test_standard_streams(folder):
    def run(arguments, given):
        command = [sys.executable, "-m", "fieldbake", *map(str, arguments)]
        return subprocess.run(command, input=given, capture_output=True, timeout=60, check=False)

    baked = run(["bake", "-", "--from", "obj", "-r", "16", "-o", "-"], (folder / "body.obj").read_bytes())
    assert baked.returncode == DONE, baked.stderr
    with np.load(io.BytesIO(baked.stdout)) as archive:
        assert np.array_equal(archive["distances"], fb.load(folder / "v.npz").distances)
    converted = run(["convert", "-", "-", "--to", "vdb"], baked.stdout)
    assert converted.returncode == DONE, converted.stderr
    assert converted.stdout[:4] == b" BDV"
    unknown = fieldbake("info", "-", input=b"?")
    assert unknown.exit_code == BAD_INPUT
    assert "--from" in unknown.stderr


def test_outputs_are_checked_before_work(folder, tmp_path):
    for arguments, word in (
        (["bake", folder / "missing.obj", "-o", tmp_path / "v.xyz"], "must end in"),
        (["render", folder / "missing.obj", "-o", tmp_path / "a.xyz"], "cannot write a picture"),
        (["csg", folder / "missing.txt", "-o", tmp_path / "a.xyz"], "cannot write a picture"),
        (["convert", folder / "missing.npz", tmp_path / "v.dds", "--encoding", "bc4"], "bc4"),
        (["convert", folder / "missing.npz", tmp_path / "v.vf", "--encoding", "snorm8"], "float32"),
        (["bake", folder / "missing.obj", "-o", "-", "--to", "png"], "--to"),
    ):
        result = fieldbake(*arguments)
        assert result.exit_code != DONE
        assert word in " ".join(result.stderr.replace("│", " ").split())
        assert "missing" not in result.stderr


def test_csg_writes_meshes_and_fields(tmp_path):
    (tmp_path / "s.txt").write_text("(sphere 2)")
    for name in ("s.glb", "s.ktx2", "s.vdb"):
        result = fieldbake("csg", tmp_path / "s.txt", "-o", tmp_path / name, "-r", 16)
        assert result.exit_code == DONE, result.stderr
        assert (tmp_path / name).exists()


def test_shells_get_completion():
    for shell in ("bash", "zsh", "fish"):
        result = CliRunner().invoke(app, [], prog_name="fieldbake", env={"_FIELDBAKE_COMPLETE": f"source_{shell}"})
        assert "fieldbake" in result.stdout
    assert "--install-completion" in fieldbake("--help").stdout
