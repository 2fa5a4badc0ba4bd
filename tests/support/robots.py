"""Robots as URDF text, written by tests: no file of others is part of the repository."""

from pathlib import Path

import numpy as np

import fieldbake as fb

#: Two links: a box and a cylinder, with axes that are not unit vectors.
TWO_LINKS = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"><collision><origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/>
    <geometry><box size="0.4 0.3 0.2"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0 0 0.25"/>
    <geometry><cylinder radius="0.06" length="0.5"/></geometry></collision></link>
  <link name="lower"><collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>
    <geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>
    <collision><origin xyz="0.4 0 0"/><geometry><sphere radius="0.09"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0.02 0.2" rpy="0.3 -0.2 0.5"/><axis xyz="1 2 -0.5"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.5" rpy="0 0.4 -1"/><axis xyz="0 3 0"/></joint>
</robot>
"""

#: A base, seven links, a flange, a hand and a probe, like an arm for research.
_JOINTS = [
    ((0, 0, 0.333), (0, 0, 0)),
    ((0, 0, 0), (-np.pi / 2, 0, 0)),
    ((0, -0.316, 0), (np.pi / 2, 0, 0)),
    ((0.0825, 0, 0), (np.pi / 2, 0, 0)),
    ((-0.0825, 0.384, 0), (-np.pi / 2, 0, 0)),
    ((0, 0, 0), (np.pi / 2, 0, 0)),
    ((0.088, 0, 0), (np.pi / 2, 0, 0)),
]

#: The primitives of each link: the kind, its sizes, its position and its roll, pitch and yaw.
ARM_PARTS = {
    "link0": [("box", (0.22, 0.19, 0.12), (-0.04, 0, 0.06), (0, 0, 0))],
    "link1": [("cylinder", (0.06, 0.28), (0, 0, -0.19), (0, 0, 0)), ("sphere", (0.065,), (0, 0, 0), (0, 0, 0))],
    "link2": [("capsule", (0.06, 0.12), (0, 0, 0), (0, 0, 0))],
    "link3": [("cylinder", (0.055, 0.15), (0, 0, -0.14), (0, 0, 0))],
    "link4": [("capsule", (0.055, 0.12), (0, 0, 0), (0, 0, 0))],
    "link5": [("box", (0.09, 0.1, 0.24), (0, 0.02, -0.22), (0.1, 0, 0)), ("sphere", (0.05,), (0, 0, 0), (0, 0, 0))],
    "link6": [("capsule", (0.05, 0.08), (0.04, 0, 0), (0, 0, 0.2))],
    "link7": [("cylinder", (0.035, 0.1), (0, 0, 0.05), (0, 0, 0))],
    "flange": [],
    "hand": [("box", (0.04, 0.2, 0.06), (0, 0, 0.03), (0, 0, 0))],
    "probe": [("capsule", (0.01, 0.12), (0, 0, 0.1), (0, 0, 0))],
}

#: Joint values of the arm where no default pair of bodies touches.
REST = (0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4, 0.02)


def _element(kind, sizes):
    if kind == "box":
        return f'<box size="{" ".join(map(str, sizes))}"/>'
    if kind == "sphere":
        return f'<sphere radius="{sizes[0]}"/>'
    return f'<{kind} radius="{sizes[0]}" length="{sizes[1]}"/>'


def _numbers(values):
    return " ".join(repr(float(value)) for value in values)


def arm():
    """The arm of 11 bodies as URDF text."""
    lines = ['<robot name="arm">']
    for link, parts in ARM_PARTS.items():
        shapes = "".join(
            f'<collision><origin xyz="{_numbers(place)}" rpy="{_numbers(turn)}"/>'
            f"<geometry>{_element(kind, sizes)}</geometry></collision>"
            for kind, sizes, place, turn in parts
        )
        lines.append(f'<link name="{link}">{shapes}</link>')
    for i, (place, turn) in enumerate(_JOINTS, 1):
        lines.append(
            f'<joint name="joint{i}" type="revolute"><parent link="link{i - 1}"/><child link="link{i}"/>'
            f'<origin xyz="{_numbers(place)}" rpy="{_numbers(turn)}"/><axis xyz="0 0 1"/>'
            '<limit lower="-2.9" upper="2.9" effort="1" velocity="1"/></joint>'
        )
    for parent, child, place in (("link7", "flange", (0, 0, 0.107)), ("flange", "hand", (0, 0, 0))):
        lines.append(
            f'<joint name="{child}_joint" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{_numbers(place)}" rpy="0 0 -0.785"/></joint>'
        )
    lines.append(
        '<joint name="slide" type="prismatic"><parent link="hand"/><child link="probe"/>'
        '<origin xyz="0 0 0.05"/><axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>'
    )
    return "\n".join([*lines, "</robot>"])


#: A gripper with a mimic joint, a mimic of a mimic, and a mesh that is scaled and mirrored.
GRIPPER = """<robot name="gripper">
  <link name="palm"><collision><geometry><box size="0.2 0.06 0.04"/></geometry></collision></link>
  <link name="left"><collision><origin xyz="0 0 0.05"/>
    <geometry><mesh filename="meshes/finger.stl" scale="0.05 0.04 0.1"/></geometry></collision></link>
  <link name="right"><collision><origin xyz="0 0 0.05"/>
    <geometry><mesh filename="package://gripper/meshes/finger.stl" scale="-0.05 0.04 0.1"/></geometry>
    </collision></link>
  <link name="tip"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="open" type="prismatic"><parent link="palm"/><child link="left"/>
    <origin xyz="0.02 0 0.02"/><axis xyz="2 0 0"/><limit lower="0" upper="0.06" effort="1" velocity="1"/></joint>
  <joint name="open_right" type="prismatic"><parent link="palm"/><child link="right"/>
    <origin xyz="-0.02 0 0.02"/><axis xyz="-1 0 0"/><mimic joint="open" multiplier="1.5" offset="0.001"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <joint name="curl" type="revolute"><parent link="right"/><child link="tip"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><mimic joint="open_right" multiplier="-8"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
</robot>
"""


def write(folder: Path) -> dict[str, Path]:
    """Write the robots and the mesh of the finger; return their paths by name."""
    (folder / "meshes").mkdir()
    finger = fb.models.gear(teeth=5)
    fb.Mesh(finger.vertices + np.array((0.3, 0, 0)), finger.faces).save(folder / "meshes" / "finger.stl")
    paths = {}
    for name, text in (("two", TWO_LINKS), ("arm", arm()), ("gripper", GRIPPER)):
        paths[name] = folder / f"{name}.urdf"
        paths[name].write_text(text, encoding="utf-8")
    return paths
