"""The command `cook`: files that MuJoCo loads, and one-line errors."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app
from octrees import overlapping_boxes

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

ROBOT = """
<mujoco>
  <compiler meshdir="meshes"/>
  <default><default class="field"><geom type="sdf"/></default></default>
  <asset>
    <mesh name="gear" file="gear.stl" scale="0.5 0.5 0.5"/>
    <mesh name="boxes" file="boxes.obj" refpos="0.5 0 0"/>
    <mesh name="ball" file="ball.ply"/>
    <mesh name="plain" file="ball.ply"/>
  </asset>
  <worldbody>
    <geom class="field" mesh="boxes"/>
    <body pos="0 0 2"><freejoint/><geom class="field" mesh="gear"/></body>
    <body pos="0.3 0.2 4"><freejoint/><geom class="field" mesh="ball"/></body>
    <geom type="mesh" mesh="plain" pos="9 0 0"/>
  </worldbody>
</mujoco>
"""


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "meshes").mkdir()
    fb.models.gear(teeth=8).save(tmp_path / "meshes" / "gear.stl")
    overlapping_boxes().save(tmp_path / "meshes" / "boxes.obj")
    fb.Mesh(*meshes.icosphere(2, 0.3)).save(tmp_path / "meshes" / "ball.obj")
    text = ROBOT.replace("ball.ply", "ball.obj")
    (tmp_path / "robot.xml").write_text(text, encoding="utf-8")
    return tmp_path


def test_the_file_has_the_values_of_the_model_in_memory(folder):
    spec = mujoco.MjSpec.from_file(str(folder / "robot.xml"))
    for mesh in spec.meshes:
        mesh.octree_maxdepth = 4
    model = spec.compile()
    fb.mujoco.refine(model)

    done = run("cook", folder / "robot.xml", "-o", folder / "robot.mjb", "--depth", "4")

    assert done.exit_code == 0, done.output
    loaded = mujoco.MjModel.from_binary_path(str(folder / "robot.mjb"))
    assert np.array_equal(loaded.oct_coeff, model.oct_coeff)
    states = []
    for each in (model, loaded):
        data = mujoco.MjData(each)
        for _ in range(100):
            mujoco.mj_step(each, data)
        states.append(np.concatenate([data.qpos, data.qvel]).tobytes())
    assert states[0] == states[1]
    assert mujoco.__version__ in done.output


def test_json_has_one_row_for_each_mesh(folder):
    done = run("cook", folder / "robot.xml", "-o", folder / "robot.mjb", "--depth", "3", "--json")

    rows = [json.loads(line) for line in done.output.splitlines()]
    assert [row["name"] for row in rows] == ["gear", "boxes", "ball"]
    assert [row["wrong_signs"] > 100 for row in rows] == [False, True, False]
    assert {row["mujoco"] for row in rows} == {mujoco.__version__}


def test_solid_writes_closed_meshes_in_the_same_place(folder):
    output = folder / "new" / "closed.xml"
    output.parent.mkdir()

    done = run("cook", folder / "robot.xml", "-o", output, "--solid", "-r", "48", "--depth", "4")

    assert done.exit_code == 0, done.output
    assert [path.name for path in output.parent.glob("*.obj")] == ["closed_0.obj"]
    assert fb.load_mesh(output.parent / "closed_0.obj").is_closed
    boxes = []
    for file in (folder / "robot.xml", output):
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        places = {}
        for i in range(model.ngeom):
            mesh = model.geom_dataid[i]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            world = model.mesh_vert[first : first + count] @ data.geom_xmat[i].reshape(3, 3).T + data.geom_xpos[i]
            places[model.mesh(mesh).name] = [world.min(axis=0), world.max(axis=0)]
        boxes.append(places)
    for name, place in boxes[0].items():
        assert np.allclose(place, boxes[1][name], atol=1e-4), name
    refined = mujoco.MjModel.from_xml_path(str(output))
    assert max(field.wrong_signs / field.corners for field in fb.mujoco.refine(refined)) <= 1e-4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not xml", "robot.xml: is no XML (syntax error"),
        ("<!DOCTYPE mujoco><mujoco/>", "robot.xml: has a DOCTYPE"),
        ("<mujoco><worldbody><geom type='ballon'/></worldbody></mujoco>", "XML Error: invalid keyword: 'ballon'"),
        ("<mujoco><worldbody/></mujoco>", "no geom with type='sdf' names a mesh"),
        ("<mujoco><asset><mesh file='no.stl'/></asset></mujoco>", "mesh 'no.stl': there is no file 'no.stl'; tried"),
        ("<mujoco><asset><mesh file='../no.stl'/></asset></mujoco>", "the mesh path leaves the folder of the file"),
        ("<mujoco><asset><mesh file='/etc/passwd'/></asset></mujoco>", "the mesh path leaves the folder of the file"),
        ("<mujoco><asset><mesh file='file:x.stl'/></asset></mujoco>", "the mesh path leaves the folder of the file"),
        ("<mujoco><asset><mesh file='package:/../x.stl'/></asset></mujoco>", "the mesh path leaves the folder"),
        ("<mujoco><compiler meshdir='..'/><asset><mesh file='x.stl'/></asset></mujoco>", "the mesh path leaves"),
        ("<mujoco><include file='../other.xml'/></mujoco>", "include '../other.xml': the mesh path leaves the folder"),
    ],
)
def test_bad_files_are_errors_of_one_line(tmp_path, text, message):
    (tmp_path / "robot.xml").write_text(text, encoding="utf-8")

    done = run("cook", tmp_path / "robot.xml", "-o", tmp_path / "robot.mjb")

    assert done.exit_code == 1
    assert message in done.output
    assert done.output.startswith("error: ")
    assert len(done.output.splitlines()) == 1
    assert not (tmp_path / "robot.mjb").exists()


def test_wrong_usage_is_found_before_any_work(folder):
    assert run("cook", folder / "no.xml", "-o", folder / "robot.mjb").exit_code == 1
    assert run("cook", folder / "robot.xml", "-o", folder / "robot.xml").exit_code == 2
    assert run("cook", folder / "robot.xml", "--solid", "-o", folder / "robot.mjb").exit_code == 2
    assert run("cook", folder / "robot.xml", "-o", folder / "robot.mjb", "--depth", "13").exit_code == 2
    (folder / "robot.mjb").touch()
    assert run("cook", folder / "robot.xml", "-o", folder / "robot.mjb", "--no-clobber").exit_code == 1
