"""Formats, streams and options of the command line that all commands share."""

import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
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


@pytest.mark.parametrize("command", ["info", "render", "mesh", "convert", "view", "pack", "slice"])
def test_an_error_about_a_zarr_store_names_its_reader(command, tmp_path):
    store = tmp_path / "g.zarr"
    store.mkdir()
    (store / "zarr.json").write_text("{}")
    outputs = {"render": "-o a.png", "mesh": "-o a.stl", "convert": "a.npz", "pack": "-o a.npz", "slice": "-o a.zip"}
    options = {"slice": ["--layer", "0.1", "--pixel", "0.1"]}.get(command, [])
    words = [word if word == "-o" else str(tmp_path / word) for word in outputs.get(command, "").split()]
    result = fieldbake(command, store, *words, *options)
    assert result.exit_code != DONE
    assert "fieldbake.open_zarr opens this Zarr store in Python" in " ".join(result.stderr.split())


def test_convert_writes_meshes(folder, tmp_path):
    for source, target in (("v.npz", "a.stl"), ("body.obj", "b.glb"), ("v.npz", "c.ply")):
        result = fieldbake("convert", folder / source, tmp_path / target)
        assert result.exit_code == DONE, result.stderr
        assert fb.load_mesh(tmp_path / target).volume == pytest.approx(1, rel=0.03)
        assert "faces" in result.stdout
        assert "voxels" not in result.stdout


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


@pytest.fixture
def textured(tmp_path):
    """A .glb file with a texture that no picture shows."""
    from PIL import Image

    cube = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(metallicRoughnessTexture=Image.new("RGB", (2, 2)))
    cube.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(cube.vertices), 2)), material=material)
    cube.export(tmp_path / "cube.glb")
    return tmp_path / "cube.glb"


@pytest.mark.parametrize(
    ("command", "warns"),
    [
        (("bake", "cube.glb", "-r", "8", "-o", "v.npz"), False),
        (("pack", "cube.glb", "-r", "8", "-o", "a.npz"), False),
        (("sample", "cube.glb", "-n", "10", "-o", "s"), False),
        (("convert", "cube.glb", "cube.obj"), True),
        (("convert", "-q", "cube.glb", "cube.obj"), False),
    ],
    ids=["bake", "pack", "sample", "convert", "quiet"],
)
def test_warnings_about_materials_are_one_line_where_materials_count(textured, command, warns):
    """In a process of its own, since warnings of this one are errors."""
    done = subprocess.run(
        [sys.executable, "-m", "fieldbake", *command],
        cwd=textured.parent,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stderr == ("warning: cube.glb: not used: metallic-roughness textures\n" if warns else "")


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


@pytest.mark.parametrize(
    "head", [b"", b"# exported\n\n# by a program\n", b"\nmtllib a.mtl\no body\n"], ids=["bare", "comment", "material"]
)
def test_standard_input_is_recognised_by_its_first_bytes(folder, head):
    result = fieldbake("info", "-", "--json", input=head + (folder / "body.obj").read_bytes())
    assert result.exit_code == DONE, result.stderr
    assert json.loads(result.stdout)["faces"] == len(fb.load_mesh(folder / "body.obj").faces)


@pytest.mark.parametrize("ending", [".vdb", ".ktx2", ".nrrd", ".npz", ".vti", ".dds", ".exr"])
def test_fields_pass_through_streams(folder, ending, tmp_path):
    written = fieldbake("convert", folder / "v.npz", "/dev/stdout", "--to", ending)
    assert written.exit_code == DONE, written.stderr
    read = fieldbake("convert", "/dev/stdin", tmp_path / "v.npz", input=written.stdout_bytes)
    exact = fb.load(folder / "v.npz")
    if ending == ".dds":
        # The box lies in the file beside it, which a stream does not have.
        assert read.exit_code == BAD_INPUT
        assert ".json" in read.stderr
        return
    assert read.exit_code == DONE, read.stderr
    near = np.abs(exact.distances) < 2.9 * exact.spacing.max()
    assert np.array_equal(fb.load(tmp_path / "v.npz").distances[near], exact.distances[near])


def test_tables_show_what_a_file_stores(folder, tmp_path):
    """A narrow band limits the stored distances, so the table has other extremes than the source."""
    exact = fb.load(folder / "v.npz")
    for name, band in (("a.ktx2", 4), ("b.vdb", 3)):
        options = ["--encoding", "snorm16"] if name == "a.ktx2" else []
        result = fieldbake("convert", folder / "v.npz", tmp_path / name, *options)
        highest = min(band * float(exact.spacing.max()), float(exact.distances.max()))
        stored = float(fb.load(tmp_path / name).distances.max())
        # A step of snorm16, whose range is the band. Distances are rounded toward zero, so they stay lower bounds.
        assert 0 <= highest - stored <= band * float(exact.spacing.max()) / 32767
        assert f"to {stored:.5g}" in result.stdout
        assert ("snorm16" in result.stdout) == (name == "a.ktx2")


@pytest.mark.parametrize("sparse", [[], ["--sparse"]], ids=["dense", "sparse"])
def test_the_band_of_a_bake_is_that_of_the_level_set(folder, tmp_path, sparse):
    box = "-1,0,1,3,4,5"
    result = fieldbake(
        "bake", folder / "body.obj", "-r", 32, "-o", tmp_path / "w.vdb", "--band", 4, "--bounds", box, *sparse
    )
    assert result.exit_code == DONE, result.stderr
    exact = fb.bake(folder / "body.obj", 32, bounds=[(-1, 0, 1), (3, 4, 5)])
    found = fb.load(tmp_path / "w.vdb")
    voxel = exact.spacing.max()
    assert found.distances.max() == pytest.approx(4 * voxel, rel=1e-6)
    near = np.abs(exact.distances) < 3.9 * voxel
    # Coarser bricks of a sparse volume are off by up to 0.05 voxels.
    assert np.abs(found.distances - exact.distances)[near].max() <= (0.05 * voxel if sparse else 0)


def test_several_files_are_drawn_in_one_picture(folder, tmp_path):
    ball = fb.bake(fb.sphere(0.5).translate((4, 2, 3)), 16)
    ball.save(tmp_path / "ball.vdb")
    result = fieldbake("render", folder / "v.npz", tmp_path / "ball.vdb", folder / "body.obj", "--size", "48x32",
                       "--shadows", "none", "-o", tmp_path / "a.png")  # fmt: skip
    assert result.exit_code == DONE, result.stderr
    # The box (0 to 2) is on the left, the ball (3.5 to 4.5) on the right, and background between them.
    from PIL import Image

    drawn = np.asarray(Image.open(tmp_path / "a.png").convert("L")).astype(int)
    covered = (np.abs(drawn - drawn[0, 0]) > 8).any(axis=0)
    assert np.count_nonzero(np.diff(covered.astype(int)) == 1) == 2


def test_a_resolution_out_of_range_names_the_largest(folder):
    result = fieldbake("bake", folder / "body.obj", "-r", 99999, "-o", folder / "x.npz")
    assert result.exit_code == BAD_INPUT
    words = result.stderr.split()
    most = int(words[words.index("most", words.index("at", words.index("use"))) + 1])
    # The box of a 2 x 1 x 0.5 body.
    assert 10_000 < most < 99_999
    assert "1.1e+12" in result.stderr
    with pytest.raises(fb.ArgumentError, match="at most"):
        fb.bake(fb.sphere(1), 20_000)


def test_help_names_arguments_plainly():
    text = fieldbake("bake", "--help").stdout
    assert "MESH..." in text
    assert "{" not in text
    assert "list[" not in text


def test_a_closed_pipe_is_no_error(folder):
    command = f"{sys.executable} -m fieldbake info {folder / 'v.npz'} --json | true; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert result.stderr == ""


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


def test_an_empty_standard_input_is_named():
    result = CliRunner().invoke(app, ["info", "-"], prog_name="fieldbake", input=b"")

    assert result.exit_code == 1
    assert result.stderr == "error: -: standard input is empty, or has been read before\n"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_fields_are_not_written_to_a_terminal(tmp_path):
    import pty

    fb.bake(fb.sphere(1), 8).save(tmp_path / "v.npz")
    terminal, screen = pty.openpty()
    command = [sys.executable, "-m", "fieldbake", "convert", str(tmp_path / "v.npz"), "-"]
    done = subprocess.run(command, stdout=screen, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(screen)
    os.close(terminal)

    assert done.returncode == 2
    assert "standard output is a terminal" in done.stderr


@pytest.mark.parametrize(("name", "engine"), [("a.dds", None), ("a.exr", "unity"), ("a.exr", "godot"), ("a.png", None)])
def test_info_describes_a_field_once_with_the_files_beside_it(folder, name, engine, tmp_path):
    volume = fb.load(folder / "v.npz")
    if name == "a.png":
        fb.pack([volume], page_size="fit").save(tmp_path / name)
    else:
        volume.save(tmp_path / name, engine=engine)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2 + (engine is not None or name == "a.png")
    for given in (files, files[::-1], [files[-1]]):
        result = fieldbake("info", *given, "--json")
        assert result.exit_code == DONE, result.stderr
        (line,) = result.stdout.splitlines()
        assert json.loads(line)["file"] == str(tmp_path / name)

    other = tmp_path / "notes.json"
    other.write_text("{}")
    result = fieldbake("info", other)
    assert result.exit_code == BAD_INPUT
    assert "'.json'" in result.stderr
