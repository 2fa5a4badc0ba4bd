"""Robot files of unknown origin: one error of one line, and nothing is opened outside their folders."""

import os
import re
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import robots
from fieldbake.assemblies import xml_files
from fieldbake.cli.application import app

LINK = '<link name="a"><collision><geometry>{}</geometry></collision></link>'
BALL = LINK.format('<sphere radius="1"/>')
JOINT = (
    '<link name="a"/><link name="b"/>'
    '<joint name="j" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{rest}</joint>'
)


def joint(kind="revolute", parent="a", child="b", rest="", more=""):
    return JOINT.format(kind=kind, parent=parent, child=child, rest=rest) + more


BAD = {
    "no XML": ("hello", "is no XML (syntax error"),
    "cut off": ("<robot><link name='a'>", "is no XML"),
    "a doctype": ("<!DOCTYPE robot [<!ENTITY a 'b'>]><robot/>", "has a DOCTYPE"),
    "nested": ("<robot>" * 1002, "elements are nested more than 1000 deep"),
    "another root": ("<mujoco/>", "is no URDF: its root element is <mujoco>"),
    "empty": ("<robot/>", "has no links"),
    "no name": ("<robot><link/></robot>", "a <link> has no name"),
    "a doubled link": (f"<robot>{BALL}{BALL}</robot>", "two links have the name 'a'"),
    "no geometry": ("<robot><link name='a'><collision/></link></robot>", "link 'a': <collision> has no <geometry>"),
    "an unknown geometry": (LINK.format("<cone/>"), "link 'a': <cone> is no geometry of URDF"),
    "two geometries": (LINK.format("<sphere radius='1'/><box size='1 1 1'/>"), "must have one element, got 2"),
    "a radius of 0": (LINK.format("<sphere radius='0'/>"), "radius of <sphere> must be above 0, got 0"),
    "a negative radius": (LINK.format("<cylinder radius='-1' length='1'/>"), "radius of <cylinder> must be above 0"),
    "no radius": (LINK.format("<sphere/>"), "radius of <sphere> is missing"),
    "NaN": (LINK.format("<sphere radius='nan'/>"), "radius of <sphere> must be a finite number, got 'nan'"),
    "an infinite size": (LINK.format("<box size='1 inf 1'/>"), "size of <box> must be 3 finite numbers"),
    "a word": (LINK.format("<box size='1 x 1'/>"), "size of <box> must be 3 finite numbers, got '1 x 1'"),
    "a flat box": (LINK.format("<box size='1 0 1'/>"), "size of <box> must be above 0"),
    "no file": (LINK.format("<mesh/>"), "filename of <mesh> is missing"),
    "a missing mesh": (LINK.format("<mesh filename='no.stl'/>"), "link 'a': mesh: there is no file 'no.stl'; tried"),
    "a missing package": (LINK.format("<mesh filename='package://p/no.stl'/>"), "there is no file 'package://p/no.stl'"),
    "a scale of 0": (LINK.format("<mesh filename='ball.stl' scale='1 0 1'/>"), "scale of <mesh> must not be 0"),
    "a bad mesh": (LINK.format("<mesh filename='bad.stl'/>"), "link 'a': <mesh>:"),
    "above": (LINK.format("<mesh filename='../out.stl'/>"), "the mesh path leaves the folder of the file"),
    "absolute": (LINK.format("<mesh filename='/etc/passwd'/>"), "the mesh path leaves the folder of the file"),
    "a link": (LINK.format("<mesh filename='link.stl'/>"), "the mesh path leaves the folder of the file"),
    "in a package": (LINK.format("<mesh filename='package://p/../../out.stl'/>"), "the mesh path leaves the folder"),
    "http": (LINK.format("<mesh filename='http://example.org/a.stl'/>"), "the mesh path leaves the folder"),
    "file": (LINK.format("<mesh filename='file:///etc/passwd'/>"), "the mesh path leaves the folder"),
    "an unknown joint": (joint("screw"), "joint 'j': the type 'screw' is no type of URDF"),
    "a planar joint": (joint("planar"), "joint 'j': the type 'planar' has more than one value; pass the poses"),
    "a floating joint": (joint("floating"), "joint 'j': the type 'floating' has more than one value; pass the poses"),
    "a missing link": (joint(child="c"), "joint 'j': the child 'c' is no body"),
    "no child": (joint(child=""), "joint 'j'"),
    "a zero axis": (joint(rest="<axis xyz='0 0 0'/>"), ".urdf: joint 'j': axis: must not be zero"),
    "limits": (joint(rest="<limit lower='1' upper='0'/>"), "limits: the lower limit must not exceed"),
    "a short origin": (joint(rest="<origin xyz='0 0'/>"), "joint 'j': xyz of <origin> must be 3 finite numbers"),
    "two parents": (
        joint(more='<link name="c"/><joint name="k" type="fixed"><parent link="c"/><child link="b"/></joint>'),
        "joint 'k': 'b' has two parents",
    ),
    "two joints of a pair": (
        joint(more='<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint>'),
        "joints 'j' and 'k': both have the child 'b'",
    ),
    "a cycle": (
        joint(more='<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'),
        "are in a cycle of joints",
    ),
    "a mimic of itself": (joint(rest="<mimic joint='j'/>"), "joint 'j': mimics itself"),
    "a mimic of nothing": (joint(rest="<mimic joint='k'/>"), "mimics 'k', which is no joint with a value"),
    "doubled joints": (joint() + joint().partition('<link name="b"/>')[2], "two joints have the name"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "robot"
    folder.mkdir()
    fb.models.gear(teeth=5).save(folder / "ball.stl")
    fb.models.gear(teeth=5).save(tmp_path / "out.stl")
    (folder / "bad.stl").write_bytes(b"solid nothing")
    (folder / "link.stl").symlink_to(tmp_path / "out.stl")
    return folder


@pytest.fixture
def opened():
    """The files that are opened for reading during the test."""
    files = []
    watching = [True]

    def hook(event, arguments):
        if event == "open" and watching and isinstance(arguments[0], (str, bytes)):
            files.append(os.path.realpath(os.fsdecode(arguments[0])))

    sys.addaudithook(hook)
    yield files
    watching.clear()


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_one_error_of_one_line(name, folder, opened):
    text, message = BAD[name]
    text = text if text.startswith(("<robot", "<!", "<mujoco", "hello")) else f"<robot>{text}</robot>"
    (folder / "robot.urdf").write_text(text)

    with pytest.raises(fb.FormatError) as caught:
        fb.Assembly.from_urdf(folder / "robot.urdf")

    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{folder / 'robot.urdf'}: ")
    assert "\n" not in str(caught.value)
    outside = [file for file in opened if file.startswith(str(folder.parent)) and not file.startswith(str(folder))]
    assert outside == []
    assert not any("passwd" in file for file in opened)


def test_a_package_of_the_caller_is_a_folder_for_meshes(folder, tmp_path):
    (tmp_path / "parts").mkdir()
    fb.models.gear(teeth=7).save(tmp_path / "parts" / "gear.stl")
    text = LINK.format('<mesh filename="package://shop/gear.stl"/>')
    (folder / "robot.urdf").write_text(f"<robot>{text}</robot>")

    robot = fb.Assembly.from_urdf(folder / "robot.urdf", packages={"shop": tmp_path / "parts"})

    assert len(robot.bodies["a"][0][0].faces) == len(fb.models.gear(teeth=7).faces)
    with pytest.raises(fb.FormatError, match="there is no file"):
        fb.Assembly.from_urdf(folder / "robot.urdf")


def test_a_mirrored_mesh_faces_outwards(tmp_path):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["gripper"])

    left, right = (robot.bodies[name][0][0] for name in ("left", "right"))

    assert left.volume == pytest.approx(right.volume)
    assert right.volume > 0
    assert right.vertices[:, 0] == pytest.approx(-left.vertices[:, 0])
    assert robot.bodies["left"][0][1][2, 3] == 0.05


def test_a_large_file_is_refused_before_it_is_read(folder, monkeypatch):
    monkeypatch.setattr(xml_files, "MAX_BYTES", 100)
    (folder / "robot.urdf").write_text(robots.TWO_LINKS)
    with pytest.raises(fb.FormatError, match="bytes; robot files have at most 100"):
        fb.Assembly.from_urdf(folder / "robot.urdf")


def test_a_missing_file_and_wrong_arguments(folder):
    with pytest.raises(FileNotFoundError):
        fb.Assembly.from_urdf(folder / "none.urdf")
    with pytest.raises(fb.FormatError, match="is a folder, not a robot file") as caught:
        fb.Assembly.from_urdf(folder)
    assert "\n" not in str(caught.value)
    (folder / "robot.urdf").write_text(robots.TWO_LINKS)
    with pytest.raises(fb.ArgumentError, match='elements: must be one of "collision", "visual"'):
        fb.Assembly.from_urdf(folder / "robot.urdf", elements="both")
    with pytest.raises(fb.ArgumentError, match=r"packages: must be a mapping of name to folder, got \['shop'\]"):
        fb.Assembly.from_urdf(folder / "robot.urdf", packages=["shop"])


MJCF = "<mujoco><worldbody>{}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "is no XML"),
        ("<!DOCTYPE mujoco><mujoco/>", "has a DOCTYPE"),
        (MJCF.format("<geom type='ballon'/>"), "XML Error: invalid keyword"),
        (MJCF.format("<geom size='-1'/>"), "size"),
        (MJCF.format("<body><body pos='1 0 0'><freejoint/><geom size='1'/></body></body>"), "free joint"),
        (MJCF.format("<body name='b'><joint name='j' type='ball'/><geom size='1'/></body>"),
         "joint 'j': a ball joint between two bodies has more than one value; pass the poses"),
        ("<mujoco><asset><mesh file='../out.stl'/></asset></mujoco>", "the mesh path leaves the folder"),
        ("<mujoco><asset><mesh file='link.stl'/></asset></mujoco>", "the mesh path leaves the folder"),
        ("<mujoco><include file='/etc/passwd'/></mujoco>", "the mesh path leaves the folder"),
        ("<mujoco><asset><hfield name='h' nrow='2' ncol='2' size='1 1 1 1' elevation='0 1 2 3'/></asset><worldbody>"
         "<geom name='g' type='hfield' hfield='h'/></worldbody></mujoco>",
         "geom 'g': the type hfield has no closed form"),
        (MJCF.format("<body name='b' pos='nan 0 0'><geom size='1'/></body>"), "body 'b': pos must be finite numbers"),
        (MJCF.format("<body name='b' pos='inf 0 0'><freejoint/><geom size='1'/></body>"), "body 'b': pos must be"),
        (MJCF.format("<body name='b' pos='1e300 0 0'><geom size='1'/></body>"), "body 'b': pos must be finite"),
        (MJCF.format("<geom name='g' size='1' pos='nan 0 0'/>"), "geom 'g': pos must be finite numbers"),
        (MJCF.format("<body><joint name='j' pos='nan 0 0'/><geom size='1'/></body>"), "joint 'j': pos must be"),
        (MJCF.format("<body><joint name='j' ref='nan'/><geom size='1'/></body>"), "joint 'j': ref must be a finite"),
        (MJCF.format("<body><joint name='j' limited='true' range='nan 1'/><geom size='1'/></body>"),
         "joint 'j': range must be finite numbers"),
        (MJCF.format("<geom name='g' size='1e40'/>"), "geom 'g': radius: must be a finite number"),
    ],
)  # fmt: skip
def test_a_bad_mjcf_file_is_one_error_of_one_line(folder, opened, text, message, monkeypatch):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    monkeypatch.chdir(folder)  # MuJoCo logs NaN to a file in the current folder
    (folder / "robot.xml").write_text(text)

    with pytest.raises(fb.FormatError, match=re.escape(message)) as caught:
        fb.Assembly.from_mjcf(folder / "robot.xml")

    assert "\n" not in str(caught.value)
    assert not any("passwd" in file or file.endswith("out.stl") for file in opened)
    done = CliRunner().invoke(app, ["cook", str(folder / "robot.xml"), "-o", str(folder / "robot.mjb")])
    assert done.exit_code == 1
    assert len(done.output.splitlines()) == 1


def test_other_sources_of_mjcf_are_errors(folder):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    with pytest.raises(fb.FormatError, match="is a folder, not a robot file"):
        fb.Assembly.from_mjcf(folder)
    with pytest.raises(fb.ArgumentError, match="source: must be a path, an MjSpec or an MjModel, got 3"):
        fb.Assembly.from_mjcf(3)


def mutated(text, random):
    """A file with a few random changes of bytes, of numbers, or of lines."""
    data = bytearray(text.encode())
    for _ in range(random.integers(1, 4)):
        place = int(random.integers(0, len(data)))
        kind = random.integers(0, 5)
        if kind == 0:
            data[place] = random.integers(0, 256)
        elif kind == 1:
            del data[place : place + int(random.integers(1, 30))]
        elif kind == 2:
            data[place:place] = data[: int(random.integers(1, 200))]
        elif kind == 3:
            numbers = list(re.finditer(rb"-?\d+(\.\d+)?", bytes(data)))
            chosen = numbers[int(random.integers(0, len(numbers)))]
            new = random.choice([b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-320", b"1e30", b"", b"x"])
            data[chosen.start() : chosen.end()] = new
        else:
            lines = bytes(data).split(b"\n")
            i, j = random.integers(0, len(lines), 2)
            lines[i], lines[j] = lines[j], lines[i]
            data = bytearray(b"\n".join(lines))
        if not data:
            break
    return bytes(data)


def check_mutations(folder, count, random):
    paths = robots.write(folder)
    texts = [path.read_text() for path in paths.values()]
    read, lines = 0, []
    for i in range(count):
        (folder / "robot.urdf").write_bytes(mutated(texts[i % 3], random))
        try:
            robot = fb.Assembly.from_urdf(folder / "robot.urdf")
        except fb.Error as error:
            lines.append(len(str(error).splitlines()))
            continue
        assert np.isfinite(robot.home).all()
        read += 1
    assert set(lines) == {1}
    return read


def test_random_mutations_raise_errors_of_ours_only(folder, random):
    # Most changes of a number still give a robot.
    assert 10 < check_mutations(folder, 300, random) < 290


@pytest.mark.slow
def test_many_random_mutations_raise_errors_of_ours_only(folder, random):
    assert 300 < check_mutations(folder, 10_000, random) < 9_700


def test_a_file_without_the_chosen_geometry_is_a_warning(tmp_path):
    (tmp_path / "robot.urdf").write_text(f"<robot>{BALL.replace('collision', 'visual')}</robot>")
    with pytest.warns(UserWarning, match=r"elements: no body has collision geometry.*elements='visual'"):
        robot = fb.Assembly.from_urdf(tmp_path / "robot.urdf")

    assert robot.distance([(3, 0, 0)]) == np.inf
    assert fb.Assembly.from_urdf(tmp_path / "robot.urdf", elements="visual").distance([(3, 0, 0)]) == pytest.approx(2)


def test_a_model_without_geoms_that_collide_is_a_warning(tmp_path):
    pytest.importorskip("mujoco")
    geom = '<geom type="sphere" size="1" contype="0" conaffinity="0"/>'
    (tmp_path / "robot.xml").write_text(MJCF.format(f"<body>{geom}</body>"))
    with pytest.warns(UserWarning, match=r"elements: no body has collision geometry"):
        robot = fb.Assembly.from_mjcf(tmp_path / "robot.xml")

    assert robot.distance([(3, 0, 0)]) == np.inf
