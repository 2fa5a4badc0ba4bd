"""The commands mesh, solid, boolean and sweep."""

import warnings

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
import robots
from fieldbake.cli.application import app


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def files(tmp_path):
    fb.Mesh(*meshes.box()).save(tmp_path / "a.ply")
    fb.Mesh(*meshes.box((0, 0, 0), (2, 2, 2))).save(tmp_path / "b.stl")
    fb.bake(meshes.icosphere(2), 24).save(tmp_path / "ball.npz")
    (tmp_path / "part.csg").write_text("(diff (cube 2) (sphere 2.4))")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "volume"),
    [
        (("solid", "a.ply"), 8.0),
        (("solid", "a.ply", "--fill", "outer", "--seal", "2"), 8.0),
        (("boolean", "a.ply", "-", "b.stl"), 7.0),
        (("boolean", "a.ply", "+", "b.stl"), 15.0),
        (("boolean", "a.ply", "&", "b.stl"), 1.0),
        (("mesh", "a.ply", "--offset", "-0.5"), 1.0),
        (("mesh", "a.ply", "--shell", "0.25", "--open", "z", "--measure"), 8 - 1.5 * 1.5 * 1.75),
        (("mesh", "a.ply"), 8.0),
    ],
)
def test_results_are_meshes_in_files(files, arguments, volume):
    known = {"a.ply", "b.stl"}
    result = run(*(files / word if word in known else word for word in arguments), "-r", "24", "-o", files / "out.ply")
    assert result.exit_code == 0, result.output
    made = fb.load_mesh(files / "out.ply")
    assert made.is_closed
    assert made.volume == pytest.approx(volume, rel=5e-3)


def test_fields_and_shapes_have_levels(files):
    assert run("mesh", files / "ball.npz", "-o", files / "ball.stl", "--level", "-0.2").exit_code == 0
    radii = np.linalg.norm(fb.load_mesh(files / "ball.stl").vertices, axis=1)
    assert np.abs(radii - 0.8).max() <= 0.05
    assert run("mesh", files / "part.csg", "-o", files / "part.obj", "-r", "24").exit_code == 0
    assert fb.load_mesh(files / "part.obj").is_closed


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("solid", "a.ply", "-o", "out.step"), 2),
        (("mesh", "a.ply", "-o", "out.stl", "--level", "1"), 2),
        (("mesh", "a.ply", "-o", "out.stl", "--open", "z"), 2),
        (("mesh", "a.ply", "-o", "out.stl", "--offset", "1", "--shell", "1"), 2),
        (("mesh", "ball.npz", "-o", "out.stl", "--offset", "1"), 2),
        (("boolean", "a.ply", "%", "b.stl", "-o", "out.stl"), 1),
        (("mesh", "a.ply", "-o", "out.stl", "--offset", "-3", "-r", "16"), 1),
    ],
)
def test_mistakes_end_before_a_file_is_written(files, arguments, code):
    known = {"a.ply", "b.stl", "ball.npz", "out.step", "out.stl"}
    result = run(*(files / word if word in known else word for word in arguments))
    assert result.exit_code == code, result.output
    assert not list(files.glob("out.*"))


def test_intensities_are_solid_above_the_level(tmp_path):
    ball = fb.bake(fb.sphere(1), 32)
    scan = fb.Volume(-1000 * ball.distances, ball.bounds)
    scan.save(tmp_path / "scan.nrrd")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fb.SurfaceWarning)
        negative = run("mesh", tmp_path / "scan.nrrd", "-o", tmp_path / "negative.stl")
    assert negative.exit_code == 0
    assert 'inside="above"' in " ".join(negative.output.split())
    result = run("mesh", tmp_path / "scan.nrrd", "--level", "100", "--inside", "above", "-o", tmp_path / "ball.stl")
    assert result.exit_code == 0
    assert "warning" not in result.output
    assert fb.load_mesh(tmp_path / "ball.stl").volume == pytest.approx(4 * np.pi / 3 * 0.9**3, rel=0.01)


def test_meshes_and_shapes_have_no_solid_above(files):
    for name in ("a.ply", "part.csg"):
        result = run("mesh", files / name, "--inside", "above", "-o", files / "out.ply")
        assert result.exit_code == 2
        assert "--inside" in result.output


def test_a_sweep_is_written_as_a_mesh_or_a_field(files):
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 1.0
    np.save(files / "poses.npy", poses)

    made = run("sweep", files / "a.ply", files / "poses.npy", "-o", files / "swept.stl", "-r", "40")
    assert made.exit_code == 0, made.output
    assert "1 step," in made.output
    swept = fb.load_mesh(files / "swept.stl")
    assert swept.is_closed
    assert 12.0 < swept.volume < 20.0
    made = run("sweep", files / "a.ply", files / "poses.npy", "-o", files / "swept.npz", "-r", "40", "--no-contain")
    assert made.exit_code == 0, made.output
    assert fb.load(files / "swept.npz").to_mesh(sharp=False).volume == pytest.approx(12.0, rel=0.05)


def test_a_robot_is_swept_by_its_joint_values(files):
    (files / "robot.urdf").write_text(robots.TWO_LINKS)
    np.save(files / "values.npy", np.linspace((0, 0), (1, 1), 4))
    made = run("sweep", files / "robot.urdf", files / "values.npy", "-o", files / "swept.obj", "-r", "32")
    assert made.exit_code == 0, made.output
    assert fb.load_mesh(files / "swept.obj").is_closed


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("a.ply", "none.npy", "swept.stl"), 1, "none.npy"),
        (("a.ply", "bad.npy", "swept.stl"), 1, "is no .npy array of a motion"),
        (("a.ply", "flat.npy", "swept.stl"), 1, "motion: must have shape (t, 4, 4)"),
        (("open.ply", "one.npy", "swept.stl"), 1, "the mesh is open"),
        (("none.urdf", "one.npy", "swept.stl"), 1, "none.urdf"),
        (("bad.urdf", "one.npy", "swept.stl"), 1, "is no XML"),
        (("a.ply", "one.npy", "swept.txt"), 2, "must end in"),
    ],
)
def test_mistakes_of_a_sweep_are_one_line(files, arguments, status, message):
    np.save(files / "one.npy", np.eye(4)[None])
    np.save(files / "flat.npy", np.eye(4))
    (files / "bad.npy").write_bytes(b"hello")
    (files / "bad.urdf").write_text("hello")
    fb.Mesh(*meshes.open_box()).save(files / "open.ply")
    geometry, motion, output = (files / name for name in arguments)
    made = run("sweep", geometry, motion, "-o", output)
    assert made.exit_code == status, made.output
    assert message in " ".join(made.output.split())
    if status == 1:
        assert len(made.output.strip().splitlines()) == 1
    assert not output.exists()
