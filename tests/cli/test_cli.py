"""The command line: files, printed text and exit codes."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app

DONE, BAD_INPUT, BAD_USAGE = 0, 1, 2


def fieldbake(*arguments, cwd=None):
    """Run the command in this process; an exception that would be a traceback fails the test."""
    before = Path.cwd()
    os.chdir(cwd or before)
    try:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="fieldbake")
    finally:
        os.chdir(before)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def cube(tmp_path):
    """A mesh file."""
    path = tmp_path / "cube.obj"
    vertices, faces = meshes.box()
    path.write_text("\n".join([f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]))
    return path


def assert_one_clear_line(result, *words):
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, result.stderr
    assert all(word in lines[0] for word in words)


def test_bake_writes_what_the_library_bakes(cube, tmp_path):
    result = fieldbake("bake", cube, "-r", 24, "-o", tmp_path / "cube.npz")

    assert result.exit_code == DONE, result.stderr
    assert np.array_equal(fb.load(tmp_path / "cube.npz").distances, fb.bake(cube, resolution=24).distances)
    assert "24 x 24 x 24" in result.stdout
    assert "closed" in result.stdout


def test_bake_takes_three_numbers_and_options(cube, tmp_path):
    output = tmp_path / "cube.npz"

    result = fieldbake(
        "bake", cube, "-r", "8x9x10", "--margin", "0.5", "--sign", "pseudonormal", "--band", "2", "-o", output
    )

    assert result.exit_code == DONE, result.stderr
    expected = fb.bake(cube, resolution=(8, 9, 10), margin=0.5, sign="pseudonormal", band=2)
    assert np.array_equal(fb.load(output).distances, expected.distances)


def test_several_meshes_become_one_field(cube, tmp_path):
    result = fieldbake("bake", cube, cube, "-r", 8, "-o", tmp_path / "both.npz")

    assert result.exit_code == DONE, result.stderr
    assert fb.load(tmp_path / "both.npz").report.faces == 24


def test_info_of_a_volume_and_of_a_mesh(cube, tmp_path):
    fb.bake(cube, resolution=8).save(tmp_path / "cube.npz")

    volume, mesh = fieldbake("info", tmp_path / "cube.npz"), fieldbake("info", cube)

    assert volume.exit_code == mesh.exit_code == DONE
    assert "8 x 8 x 8" in volume.stdout
    assert "12" in mesh.stdout


@pytest.mark.parametrize("source", ["mesh", "volume"])
def test_render_writes_a_picture(cube, tmp_path, source):
    image = pytest.importorskip("PIL.Image")
    fb.bake(cube, resolution=16).save(tmp_path / "cube.npz")
    file = cube if source == "mesh" else tmp_path / "cube.npz"

    result = fieldbake("render", file, "-r", 16, "--size", "64x48", "-o", tmp_path / "cube.png")

    assert result.exit_code == DONE, result.stderr
    with image.open(tmp_path / "cube.png") as picture:
        assert picture.size == (64, 48)
        assert np.asarray(picture)[..., :3].std() > 0


def test_render_looks_from_where_it_is_told(cube, tmp_path):
    image = pytest.importorskip("PIL.Image")

    result = fieldbake(
        "render",
        cube,
        "-r",
        16,
        "--size",
        "32x32",
        "--eye",
        "0,0,5",
        "--target",
        "0,0,50",
        "-o",
        tmp_path / "nothing.png",
    )

    assert result.exit_code == DONE, result.stderr
    with image.open(tmp_path / "nothing.png") as picture:
        assert np.ptp(np.asarray(picture)[..., :3], axis=(0, 1)).max() == 0


def test_devices_lists_the_cpu():
    result = fieldbake("devices")

    assert result.exit_code == DONE
    assert "cpu" in result.stdout


def test_demo_writes_pictures(cube, tmp_path):
    result = fieldbake("demo", cube, "-r", 16, "-o", tmp_path / "out")

    assert result.exit_code == DONE, result.stderr
    assert list((tmp_path / "out").glob("*.png"))
    assert list((tmp_path / "out").glob("*.npz"))


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["bake", "--help"]])
def test_help_and_version(arguments):
    result = fieldbake(*arguments)

    assert result.exit_code == DONE
    assert "fieldbake" in result.stdout
    if arguments == ["--version"]:
        assert fb.__version__ in result.stdout


@pytest.mark.parametrize("command", [["bake", "-o", "x.npz"], ["info"], ["render", "-o", "x.png"]], ids=lambda c: c[0])
def test_a_missing_file_is_one_clear_line(command, tmp_path):
    name, *rest = command

    result = fieldbake(name, "nowhere.obj", *rest, cwd=tmp_path)

    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "nowhere.obj")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["bad.obj"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", ["bad.obj"]),
        (b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", ["bad.obj", "vertices[2]"]),
        (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ["bad.obj", "degenerate"]),
    ],
    ids=["empty", "index", "nan", "no area"],
)
def test_a_bad_mesh_is_one_clear_line(tmp_path, content, words):
    (tmp_path / "bad.obj").write_bytes(content)

    result = fieldbake("bake", "bad.obj", "-o", "out.npz", cwd=tmp_path)

    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, *words)
    assert not (tmp_path / "out.npz").exists()


def test_a_bad_volume_is_one_clear_line(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"PK")

    result = fieldbake("info", "bad.npz", cwd=tmp_path)

    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "bad.npz")


@pytest.mark.parametrize(
    "options",
    [
        ["-r", 0],
        ["--voxel-size", -1],
        ["--band", 0],
        ["--thickness", 1],
        ["-r", "8000x8000x8000"],
        ["--device", "abacus"],
    ],
    ids=str,
)
def test_an_option_that_makes_no_sense_is_one_clear_line(cube, tmp_path, options):
    result = fieldbake("bake", cube, "-o", tmp_path / "out.npz", *options)

    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result)


def test_a_folder_that_is_not_there_is_one_clear_line(cube, tmp_path):
    result = fieldbake("bake", cube, "-r", 8, "-o", tmp_path / "nowhere" / "out.npz")

    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "nowhere")


def test_merge_writes_one_field_of_a_scene(cube, tmp_path):
    import trimesh

    box = trimesh.creation.box()
    scene = trimesh.Scene([box])
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix((3, 0, 0)))
    scene.export(tmp_path / "two.glb")

    result = fieldbake("merge", tmp_path / "two.glb", "-r", 32, "-o", tmp_path / "two.npz")

    assert result.exit_code == DONE, result.stderr
    field = fb.load(tmp_path / "two.npz")
    assert field.resolution[0] == 32
    assert (field.sample([(0, 0, 0), (3, 0, 0)]) < 0).all()
    assert 0 < field.sample([(1.5, 0, 0)])[0] <= 1
    # A lone mesh will do.
    assert fieldbake("merge", cube, "-r", 16, "-o", tmp_path / "one.npz").exit_code == DONE


@pytest.mark.parametrize(
    "arguments",
    [
        ["paint"],
        ["bake"],
        ["bake", "cube.obj"],
        ["bake", "cube.obj", "-o", "out.npz", "-r", "many"],
        ["bake", "cube.obj", "-o", "out.npz", "-r", "1x2"],
        ["bake", "cube.obj", "-o", "out.npz", "--sign", "guess"],
        ["bake", "cube.obj", "-o", "out.txt"],
        ["merge", "cube.obj", "-o", "out.glb"],
        ["render", "cube.obj", "-o", "out.png", "--size", "big"],
        ["render", "cube.obj", "-o", "out.png", "--eye", "1,2"],
        ["info", "--loud", "cube.obj"],
    ],
    ids=" ".join,
)
def test_wrong_usage(cube, arguments):
    result = fieldbake(*arguments, cwd=cube.parent)

    assert result.exit_code == BAD_USAGE
    assert not (cube.parent / "out.npz").exists()


def test_no_arguments_show_the_help():
    result = fieldbake()

    assert "bake" in result.stdout + result.stderr
    assert result.exit_code in (DONE, BAD_USAGE)


def test_the_module_is_the_command(cube, tmp_path):
    command = [sys.executable, "-m", "fieldbake", "bake", str(cube), "-r", "8", "-o", str(tmp_path / "cube.npz")]

    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    assert result.returncode == DONE, result.stderr
    assert fb.load(tmp_path / "cube.npz").resolution == (8, 8, 8)


def test_an_error_of_the_process_is_one_line_and_code_1(tmp_path):
    command = [sys.executable, "-m", "fieldbake", "info", str(tmp_path / "nowhere.npz")]

    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    assert result.returncode == BAD_INPUT
    assert result.stdout == ""
    assert_one_clear_line(result, "nowhere.npz")


@pytest.mark.parametrize("ending", [".npz", ".exr", ".png"])
def test_pack_makes_an_atlas_of_fields_and_meshes(cube, tmp_path, ending):
    fb.bake(cube, resolution=(12, 12, 12)).save(tmp_path / "cube.npz")
    output, shader = tmp_path / f"atlas{ending}", tmp_path / "atlas.glsl"
    options = ["--layout", "strips", "-r", 12, "--page-size", 144, "--encoding", "snorm16", "--shader", shader]

    result = fieldbake("pack", tmp_path / "cube.npz", cube, "-o", output, *options)

    assert result.exit_code == DONE, result.stderr
    atlas = fb.load(output)
    volume = fb.bake(cube, resolution=(12, 12, 12))
    expected = fb.pack([volume, volume], layout="strips", page_size=144, encoding="snorm16")
    assert np.array_equal(atlas.pages, expected.pages)
    assert shader.read_text() == atlas.shader("glsl")
    assert "12 x 12 x 12 voxels, page 0, offset 1" in result.stdout
    assert fieldbake("info", output).stdout.splitlines()[1:] == result.stdout.splitlines()[1:]


def test_pack_says_what_cannot_be_packed(cube, tmp_path):
    small = fieldbake("pack", cube, "-o", tmp_path / "a.npz", "-r", 24, "--page-size", 64)
    assert small.exit_code == BAD_INPUT
    assert_one_clear_line(small, "volumes[0]", "page_size must be at least")

    fieldbake("pack", cube, "-o", tmp_path / "a.npz", "-r", 8, "--page-size", 64)
    nested = fieldbake("pack", tmp_path / "a.npz", "-o", tmp_path / "b.npz")
    assert nested.exit_code == BAD_INPUT
    assert_one_clear_line(nested, "must hold a volume", "Atlas")

    for arguments in (["-o", "a.tiff"], ["-o", "a.npz", "--shader", "a.txt"], ["-o", "a.npz", "--layout", "spiral"]):
        assert fieldbake("pack", cube, *arguments, cwd=tmp_path).exit_code == BAD_USAGE


@pytest.mark.parametrize("ending", [".dds", ".ktx2"])
def test_info_shows_textures(cube, tmp_path, ending):
    fb.bake(cube, resolution=8).save(tmp_path / f"cube{ending}")

    assert "8 x 8 x 8" in fieldbake("info", tmp_path / f"cube{ending}").stdout


def test_pack_prints_the_encoding_that_a_png_has_and_writes_its_shader(cube, tmp_path):
    output, shader = tmp_path / "a.png", tmp_path / "a.glsl"

    result = fieldbake("pack", cube, "-r", 8, "--page-size", 64, "-o", output, "--shader", shader)

    assert result.exit_code == DONE, result.stderr
    assert "snorm16" in result.stdout
    assert "float32" not in result.stdout
    assert "(u16 - 32768) / 32767 * scale" in result.stdout
    text = shader.read_text()
    assert "format r16unorm" in text
    assert "32768.0" in text
    # An atlas that is loaded from the image has the same text, and one for its pages.
    atlas = fb.load(output)
    assert atlas.shader("glsl") == text == atlas.shader("glsl", texels="png")
    assert "format r16snorm" in atlas.shader("glsl", texels="pages")


@pytest.mark.parametrize("ending", [".npz", ".dds", ".ktx2", ".nrrd"])
@pytest.mark.parametrize("encoding", ["float32", "float16"])
def test_bake_writes_every_ending_of_a_volume(cube, ending, encoding, tmp_path):
    output = tmp_path / f"cube{ending}"

    result = fieldbake("bake", cube, "-r", 8, "--encoding", encoding, "-o", output)

    if (ending, encoding) == (".nrrd", "float16"):
        assert result.exit_code == BAD_USAGE
        assert "--encoding" in result.stderr
        assert not output.exists()
        return
    assert result.exit_code == DONE, result.stderr
    volume = fb.bake(cube, 8)
    expected = volume if encoding == "float32" else volume.quantize("float16")
    assert np.array_equal(fb.load(output).distances, expected.distances)


@pytest.mark.parametrize("command", ["bake", "merge", "pack"])
def test_an_output_that_cannot_be_written_fails_before_any_work(command, tmp_path):
    # The mesh is missing too, and would be named if it were read first.
    result = fieldbake(command, tmp_path / "none.obj", "-o", tmp_path / "no folder" / "x.npz")
    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "folder does not exist", "x.npz")
    result = fieldbake(command, tmp_path / "none.obj", "-o", tmp_path / "x.xyz")
    assert result.exit_code == BAD_USAGE
    assert ".npz" in result.stderr


def test_convert_keeps_the_field_in_every_format(cube, tmp_path):
    volume = fb.bake(cube, 8)
    volume.save(tmp_path / "a.npz")
    names = ["a.npz", "b.ktx2", "c.dds", "d.nrrd", "e.npz"]
    for before, after in itertools.pairwise(names):
        result = fieldbake("convert", tmp_path / before, tmp_path / after)
        assert result.exit_code == DONE, result.stderr
        assert "8 x 8 x 8" in result.stdout
        assert np.array_equal(fb.load(tmp_path / after).distances, volume.distances)
    result = fieldbake("convert", tmp_path / "a.npz", tmp_path / "q.npz", "--encoding", "snorm8", "--band", 2)
    assert result.exit_code == DONE, result.stderr
    assert np.array_equal(fb.load(tmp_path / "q.npz").encoded, volume.quantize("snorm8", band=2).encoded)
    volume.to_sparse(tolerance=None).save(tmp_path / "s.npz")
    assert fieldbake("convert", tmp_path / "s.npz", tmp_path / "s.dds").exit_code == DONE
    fb.pack([volume], page_size=64).save(tmp_path / "p.npz")
    result = fieldbake("convert", tmp_path / "p.npz", tmp_path / "p.png")
    assert result.exit_code == DONE, result.stderr
    assert "snorm16" in result.stdout
    assert len(fb.load(tmp_path / "p.png")) == 1


def test_convert_names_what_cannot_be_written(cube, tmp_path):
    volume = fb.bake(cube, 8)
    volume.save(tmp_path / "v.npz")
    fb.pack([volume], page_size=64).save(tmp_path / "p.npz")
    result = fieldbake("convert", tmp_path / "v.npz", tmp_path / "v.png")
    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "only an atlas is written as .png", f"fieldbake render {tmp_path / 'v.npz'}")
    result = fieldbake("convert", cube, tmp_path / "v.png")
    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, f"fieldbake render {cube}")
    result = fieldbake("convert", tmp_path / "v.npz", tmp_path / "v.html")
    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, f"fieldbake view {tmp_path / 'v.npz'} -o {tmp_path / 'v.html'}")
    result = fieldbake("convert", tmp_path / "p.npz", tmp_path / "q.npz", "--encoding", "snorm8")
    assert result.exit_code == BAD_USAGE
    result = fieldbake("convert", cube, tmp_path / "q.npz")
    assert result.exit_code == BAD_INPUT
    assert_one_clear_line(result, "not a fieldbake file")


def test_pack_fits_the_page_to_its_volumes(cube, tmp_path):
    result = fieldbake("pack", cube, "-r", 8, "--page-size", "fit", "-o", tmp_path / "a.npz")
    assert result.exit_code == DONE, result.stderr
    assert "cube: 8 x 8 x 8 voxels" in result.stdout
    # Eight slices of 10 x 10 texels with their gutters.
    assert fb.load(tmp_path / "a.npz").page_size == 32
    assert fieldbake("pack", cube, "--page-size", "large", "-o", tmp_path / "b.npz").exit_code == BAD_USAGE
