"""Commands on many meshes: folders, exit status and the names of failed items."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import assets
import fieldbake as fb
from fieldbake.cli.application import app


def fieldbake(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="fieldbake")


@pytest.fixture
def library(tmp_path):
    return assets.write_boxes(tmp_path / "in", 2)


def test_bake_writes_a_folder_and_names_what_failed(library, tmp_path):
    broken = tmp_path / "in" / "broken.obj"
    broken.write_text("v 0 0 0\n")
    result = fieldbake("bake", *library, broken, "-o", tmp_path / "out", "-r", 12, "--jobs", 1)

    assert result.exit_code == 1
    assert "2 done, 1 failed" in result.stdout
    assert next(line for line in result.stderr.splitlines() if line).startswith(f"failed: {broken}: MeshError")
    direct = fb.bake(library[1], 12).distances
    assert fb.load(tmp_path / "out" / "box_1.npz").distances.tobytes() == direct.tobytes()

    result = fieldbake("bake", *library, "-o", tmp_path / "out", "-r", 12, "--jobs", 1)
    assert (result.exit_code, "2 skipped" in result.stdout) == (0, True)


def test_results_in_a_folder_have_the_format_and_encoding(library, tmp_path):
    options = ["-r", 12, "--jobs", 1, "--to", "dds", "--encoding", "snorm8", "--bounds", "-1,-1,-1,1,1,1"]
    result = fieldbake("bake", library[0], "-o", tmp_path / "out", *options)
    assert result.exit_code == 0, result.stderr
    found = fb.load(tmp_path / "out" / "box_0.dds")
    assert found.encoding == "snorm8"
    assert np.allclose(found.bounds, [(-1, -1, -1), (1, 1, 1)])
    assert fieldbake("bake", *library, "-o", tmp_path / "bad", "--to", "vdb", "--encoding", "snorm8").exit_code == 2
    assert not (tmp_path / "bad").exists()


def test_options_of_folders_need_a_folder(library, tmp_path):
    assert fieldbake("bake", *library, "-o", tmp_path / "one.npz", "--jobs", 2).exit_code == 2
    assert fieldbake("bake", *library, "-o", tmp_path / "many", "--sparse").exit_code == 2
    assert not (tmp_path / "many").exists()


@pytest.mark.parametrize("command", [("bake", "-r", 12), ("sample", "-n", 300)], ids=["bake", "sample"])
def test_the_summary_counts_the_results_in_doubt(library, tmp_path, command):
    opened = tmp_path / "in" / "opened.obj"
    opened.write_text("\n".join(library[0].read_text().splitlines()[:-1]))
    name, *options = command
    for status in ("done", "skipped"):
        result = fieldbake(name, *library, opened, "-o", tmp_path / "out", *options, "--jobs", 1)
        assert result.exit_code == 0, result.stderr
        assert f"3 {status}" in result.stdout
        assert "1 of 3 results have warnings or uncertain signs" in result.stdout
        assert "ledger.jsonl has their reports" in result.stdout
    rows = [json.loads(line) for line in (tmp_path / "out" / "ledger.jsonl").read_text().splitlines()]
    assert [row["path"] for row in rows if row["report"]["boundary_edges"]] == [str(tmp_path / "out" / "opened.npz")]
    assert "warnings" not in fieldbake(name, *library, "-o", tmp_path / "out", *options, "--jobs", 1).stdout
    assert fieldbake("-q", name, *library, opened, "-o", tmp_path / "out", *options, "--jobs", 1).output == ""


@pytest.mark.parametrize("command", [("bake", "-r", 12), ("sample", "-n", 300)], ids=["bake", "sample"])
def test_files_with_equal_stems_keep_their_ending(library, tmp_path, command):
    fb.load_mesh(library[1]).save(tmp_path / "in" / "box_0.ply")
    name, *options = command
    result = fieldbake(name, *library, tmp_path / "in" / "box_0.ply", "-o", tmp_path / "out", *options, "--jobs", 1)
    assert result.exit_code == 0, result.stderr
    assert {path.name for path in (tmp_path / "out").glob("*.npz")} == {"box_0.obj.npz", "box_0.ply.npz", "box_1.npz"}


def test_sample_writes_training_samples(library, tmp_path):
    result = fieldbake("sample", *library, "-o", tmp_path / "samples", "-n", 300, "--jobs", 1)

    assert result.exit_code == 0, result.stderr
    with np.load(tmp_path / "samples" / "box_0.npz") as found:
        assert found["points"].shape == (300, 3)
        assert np.abs(found["distances"] - fb.signed_distance(library[0], found["points"])).max() <= 1e-5


def test_sample_normalizes_meshes(library, tmp_path):
    options = ["-n", 300, "--jobs", 1, "--normalize", "unit sphere", "--dtype", "float32"]
    result = fieldbake("sample", library[1], "-o", tmp_path / "samples", *options)
    assert result.exit_code == 0, result.stderr
    unit, transform = fb.normalize(library[1], "unit sphere")
    with np.load(tmp_path / "samples" / "box_1.npz") as found:
        assert np.array_equal(found["transform"], transform)
        assert found["points"].dtype == np.float32
        assert np.abs(found["distances"] - fb.signed_distance(unit, found["points"])).max() <= 1e-6
    assert fieldbake("sample", *library, "-o", tmp_path / "no", "--normalize", "unit").exit_code == 2


def test_sample_writes_the_files_of_a_recipe(library, tmp_path):
    options = ["-o", tmp_path / "samples", "--recipe", "onet", "--jobs", 1]
    result = fieldbake("sample", *library, *options, "-n", 300, "--seed", 5)
    assert result.exit_code == 0, result.stderr
    expected = fb.training.Dataset(library, "onet", seed=5, n=300)[1]
    with np.load(tmp_path / "samples" / "box_1" / "points.npz") as found:
        assert found["points"].shape == (300, 3)
        assert found["occupancies"].tobytes() == expected["points/occupancies"].tobytes()
    assert "2 skipped" in fieldbake("sample", *library, *options, "-n", 300, "--seed", 5).stdout
    for option in (("--uniform", 0.5), ("--near", 0.1), ("--dtype", "float32"), ("--normalize", "unit cube")):
        result = fieldbake("sample", *library, *options, *option)
        assert result.exit_code == 2
        assert "does not apply to the recipe" in result.stderr
    result = fieldbake("sample", *library, "-o", tmp_path / "no", "--recipe", "deep")
    assert result.exit_code != 0
    assert "recipe: must be one of" in result.stderr
    assert not (tmp_path / "no").exists()
