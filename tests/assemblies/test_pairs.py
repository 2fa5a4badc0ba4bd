"""The default pairs of bodies that may collide."""

import numpy as np
import pytest

import fieldbake as fb
import robots


def named(robot):
    return {frozenset(robot.body_names[i] for i in pair) for pair in robot.pairs.tolist()}


def pair(a, b):
    return frozenset((a, b))


def test_joined_bodies_are_left_out():
    ball = fb.sphere(0.1)
    joint = fb.Joint
    robot = fb.Assembly(
        {"a": ball, "b": ball, "empty": (), "c": ball, "on empty": ball, "d": ball, "welded": ball},
        [
            joint("1", "revolute", "a", "b"),
            joint("2", "revolute", "b", "empty"),
            joint("3", "prismatic", "empty", "c"),
            joint("4", "fixed", "empty", "on empty"),
            joint("5", "revolute", "c", "d"),
            joint("6", "fixed", "d", "welded"),
        ],
        ignored_pairs=[("a", "d"), (0, 6)],
    )

    found = named(robot)

    # One moving joint, also through a body without geometry, even where another body is fixed to that one.
    for left_out in (("a", "b"), ("b", "c"), ("b", "on empty"), ("c", "on empty"), ("c", "d"), ("d", "welded"),
                     ("a", "d"), ("a", "welded")):  # fmt: skip
        assert pair(*left_out) not in found
    assert found == {
        pair("a", "c"), pair("a", "on empty"), pair("b", "d"), pair("b", "welded"), pair("on empty", "d"),
        pair("on empty", "welded"), pair("c", "welded"),
    }  # fmt: skip
    assert robot.pairs.dtype == np.int64
    assert (robot.pairs[:, 0] < robot.pairs[:, 1]).all()


def test_pairs_of_the_arm(tmp_path):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["arm"])

    found = named(robot)

    assert pair("link0", "link1") not in found
    assert pair("link7", "hand") not in found  # fixed, through the flange
    assert pair("link6", "hand") in found
    assert pair("link0", "link2") in found
    assert not any("flange" in names for names in found)


def test_excludes_of_mjcf_are_left_out(tmp_path):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    text = """<mujoco><worldbody><geom size="0.1"/>
      <body name="a" pos="1 0 0"><joint/><geom size="0.1"/></body>
      <body name="b" pos="2 0 0"><joint/><geom size="0.1"/></body>
      <body name="c" pos="3 0 0"><joint/><geom size="0.1" contype="0" conaffinity="0"/></body></worldbody>
      <contact>{}</contact></mujoco>"""
    (tmp_path / "robot.xml").write_text(text.format(""))
    assert named(fb.Assembly.from_mjcf(tmp_path / "robot.xml")) == {pair("a", "b")}
    assert pair("a", "c") in named(fb.Assembly.from_mjcf(tmp_path / "robot.xml", elements="visual"))
    (tmp_path / "robot.xml").write_text(text.format('<exclude body1="a" body2="b"/>'))
    assert named(fb.Assembly.from_mjcf(tmp_path / "robot.xml")) == set()
