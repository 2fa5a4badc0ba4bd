"""Forward kinematics of URDF and MJCF files against yourdfpy and MuJoCo, and the jacobian against differences."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import robots

#: Products of a dozen matrices with entries up to 1.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return robots.write(tmp_path_factory.mktemp("robots"))


@pytest.mark.parametrize(("name", "count"), [("two", 2), ("arm", 8), ("gripper", 1)])
def test_poses_are_those_of_yourdfpy(files, name, count, random):
    yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
    text = files[name].read_text()
    # yourdfpy reads no capsules; the kinematics do not depend on them.
    for size in ("0.06", "0.055", "0.05", "0.01"):
        text = text.replace(f'<capsule radius="{size}"', f'<cylinder radius="{size}"')
    # It slides by the length of the axis, where the specification has a unit vector.
    text = text.replace('axis xyz="2 0 0"', 'axis xyz="1 0 0"')
    peer_file = files[name].with_name(f"{name}_peer.urdf")
    peer_file.write_text(text)
    options = {"load_meshes": False, "build_collision_scene_graph": False, "load_collision_meshes": False}
    peer = yourdfpy.URDF.load(str(peer_file), build_scene_graph=True, **options)
    robot = fb.Assembly.from_urdf(files[name])
    assert len(robot.joint_names) == count
    values = random.uniform(-3, 3, (1_000, count))

    poses = robot.poses(values)

    columns = [peer.actuated_joint_names.index(joint) for joint in robot.joint_names]
    row = np.zeros(len(columns))
    worst = 0.0
    for i in range(1_000):
        row[columns] = values[i]
        peer.update_cfg(row)
        for body, pose in zip(robot.body_names, poses[i], strict=True):
            if body == "tip":
                continue  # yourdfpy supports no mimic of a mimic; MuJoCo is the truth for it
            expected = peer.get_transform(body, peer.base_link)
            worst = max(worst, np.abs(pose - expected).max())
    assert worst <= ROUNDING


def simulated(model, positions, names):
    """Poses of bodies (b, n, 4, 4) at rows of qpos, by MuJoCo."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    data = mujoco.MjData(model)
    poses = np.tile(np.eye(4), (len(positions), len(names), 1, 1))
    for row, pose in zip(positions, poses, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for i, name in enumerate(names):
            pose[i, :3, :3], pose[i, :3, 3] = data.body(name).xmat.reshape(3, 3), data.body(name).xpos
    return poses


@pytest.mark.parametrize("name", ["two", "arm", "gripper"])
def test_poses_of_urdf_files_are_those_of_mujoco(files, name, random):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    text = (
        files[name]
        .read_text()
        .replace(
            "</robot>",
            '<mujoco><compiler fusestatic="false" discardvisual="false" balanceinertia="true" boundmass="1" '
            'boundinertia="1" strippath="false"/></mujoco></robot>',
        )
    )
    spec = mujoco.MjSpec.from_string(text.replace("package://gripper/", ""))
    spec.modelfiledir = str(files[name].parent)
    model = spec.compile()
    robot = fb.Assembly.from_urdf(files[name])
    values = random.uniform(-3, 3, (1_000, len(robot.joint_names)))
    rates, offsets = robot._tree.rates, robot._tree.offsets
    moving = [j for j, joint in enumerate(robot.joints) if joint.moves]
    positions = np.zeros((1_000, model.nq))
    for j in moving:
        positions[:, model.joint(robot.joints[j].name).qposadr[0]] = values @ rates[j] + offsets[j]

    poses = robot.poses(values)

    names = [model.body(i).name for i in range(1, model.nbody)]
    rows = [robot.body_names.index(body) for body in names]
    # MuJoCo leaves the root out or adds it at the identity.
    assert len(rows) >= len(robot.body_names) - 1
    assert np.abs(poses[:, rows] - simulated(model, positions, names)).max() <= ROUNDING


MJCF = """
<mujoco>
  <compiler angle="degree"/>
  <default><geom density="100"/><default class="small"><geom size="0.05"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0.1 0.2 0.3" quat="0.9 0.1 0.3 0.2">
      <geom type="box" size="0.1 0.2 0.3"/>
      <body name="wrist" pos="0 0 0.5" euler="10 20 30">
        <joint name="a" type="hinge" axis="1 2 3" pos="0.1 0.05 -0.1" ref="20" range="-90 90"/>
        <joint name="b" type="slide" axis="0 1 1" pos="0.3 0.1 0" ref="0.1"/>
        <joint name="c" type="hinge" axis="0 0 1" pos="-0.1 0 0.2"/>
        <geom class="small" type="sphere"/>
        <frame pos="0.2 0 0" euler="0 45 0"><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0.1 0.2"/></frame>
        <body name="welded" pos="0 0.4 0" euler="0 0 90"><geom type="ellipsoid" size="0.1 0.2 0.3"/>
          <body name="tip" pos="0.1 0 0"><joint name="d" type="hinge" axis="1 0 0"/>
            <geom type="cylinder" size="0.05 0.1"/></body></body>
      </body>
    </body>
    <body name="free" pos="3 0 1" quat="0.5 0.5 0.5 0.5"><freejoint/><geom type="sphere" size="0.1"/>
      <body name="arm"><joint name="e" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.1"/></body></body>
  </worldbody>
  <contact><exclude body1="base" body2="tip"/></contact>
</mujoco>
"""


def test_poses_of_mjcf_files_are_those_of_mujoco(tmp_path, random):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    (tmp_path / "robot.xml").write_text(MJCF)
    robot = fb.Assembly.from_mjcf(tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert robot.joint_names == ("a", "b", "c", "d", "e")
    assert robot.body_names[0] == "world"
    values = random.uniform(-3, 3, (1_000, 5))
    positions = np.tile(model.qpos0, (1_000, 1))
    positions[:, [model.joint(name).qposadr[0] for name in robot.joint_names]] = values

    poses = robot.poses(values)

    assert np.abs(poses - simulated(model, positions, robot.body_names)).max() <= ROUNDING
    assert robot.limits[0] == pytest.approx((-np.pi / 2, np.pi / 2))
    assert np.isinf(robot.limits[1]).all()
    # The pose of a root replaces the pose of the free joint.
    place = np.eye(4)
    place[:3, 3] = 7, 8, 9
    moved = robot.poses(np.zeros(5), roots={"free": place})
    assert np.array_equal(moved[robot.body_names.index("free")], place)
    # A spec and a model give the same assembly.
    for source in (mujoco.MjSpec.from_file(str(tmp_path / "robot.xml")), model):
        assert np.array_equal(fb.Assembly.from_mjcf(source).poses(values), poses)


def test_geoms_of_mjcf_files_lie_where_mujoco_puts_them(tmp_path, random):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    (tmp_path / "robot.xml").write_text(MJCF)
    robot = fb.Assembly.from_mjcf(tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    values = random.uniform(-3, 3, 5)
    data.qpos[[model.joint(name).qposadr[0] for name in robot.joint_names]] = values
    mujoco.mj_forward(model, data)
    points = random.uniform(-1, 4, (300, 3))

    found = robot.query(points, robot.poses(values), bodies=["wrist", "tip", "free"])

    expected = np.full(len(points), np.inf)
    for i in range(model.ngeom):
        name = model.body(model.geom_bodyid[i]).name
        if name not in ("wrist", "tip", "free"):
            continue
        x, y, z = ((points - data.geom_xpos[i]) @ data.geom_xmat[i].reshape(3, 3)).T
        size, kind = model.geom_size[i], model.geom_type[i]
        if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            distance = np.sqrt(x * x + y * y + z * z) - size[0]
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            over = np.clip(np.abs(z) - size[1], 0, None)
            distance = np.sqrt(x * x + y * y + over * over) - size[0]
        else:
            radial, axial = np.hypot(x, y) - size[0], np.abs(z) - size[1]
            outside = np.hypot(np.clip(radial, 0, None), np.clip(axial, 0, None))
            distance = outside + np.minimum(np.maximum(radial, axial), 0)
        expected = np.minimum(expected, distance)
    assert np.abs(found.distances - expected).max() <= ROUNDING * 10


def test_a_mapping_of_values_is_one_row(files):
    robot = fb.Assembly.from_urdf(files["two"])

    poses = robot.poses({"elbow": 0.5})

    assert poses.shape == (3, 4, 4)
    assert np.array_equal(poses, robot.poses([0.0, 0.5]))
    assert np.array_equal(robot.home, robot.poses([0.0, 0.0]))
    assert robot.poses(np.zeros((2, 5, 2))).shape == (2, 5, 3, 4, 4)
    assert robot.poses(np.zeros((0, 2))).shape == (0, 3, 4, 4)
    assert robot.limits[0].tolist() == [-2, 2]


def test_roots_move_the_whole_tree(files, random):
    robot = fb.Assembly.from_urdf(files["arm"])
    place = np.tile(np.eye(4), (4, 1, 1))
    place[:, :3, :3] = meshes.rotation(5)
    place[:, :3, 3] = random.uniform(-1, 1, (4, 3))
    values = random.uniform(-1, 1, (4, 8))

    moved = robot.poses(values, roots={"link0": place})

    assert np.abs(moved - place[:, None] @ robot.poses(values)).max() <= ROUNDING


def test_one_row_of_values_serves_several_poses_of_the_root(files, random):
    robot = fb.Assembly.from_urdf(files["arm"])
    place = np.tile(np.eye(4), (3, 2, 1, 1))
    place[..., :3, 3] = random.uniform(-1, 1, (3, 2, 3))
    values = random.uniform(-1, 1, 8)

    moved = robot.poses(values, roots={"link0": place})

    assert moved.shape == (3, 2, len(robot.body_names), 4, 4)
    assert np.abs(moved - place[..., None, :, :] @ robot.poses(values)).max() <= ROUNDING
    # Two rows of values, and one pose for each of them in three variants.
    pair = random.uniform(-1, 1, (2, 8))
    both = robot.poses(pair, roots={"link0": place})
    assert np.abs(both - place[..., None, :, :] @ robot.poses(pair)).max() <= ROUNDING


@pytest.mark.parametrize("name", ["two", "arm", "gripper"])
def test_the_jacobian_is_the_derivative_of_points_fixed_to_bodies(files, name, random):
    robot = fb.Assembly.from_urdf(files[name])
    count = len(robot.joint_names)
    values = random.uniform(-1, 1, (6, count))
    bodies = random.integers(0, len(robot.body_names), (6, 4))
    local = np.concatenate([random.uniform(-1, 1, (6, 4, 3)), np.ones((6, 4, 1))], axis=-1)

    def places(values):
        poses = np.take_along_axis(robot.poses(values), bodies[..., None, None], axis=1)
        return np.einsum("...ij,...j->...i", poses, local)[..., :3]

    found = robot.jacobian(values, bodies, places(values))

    step = 1e-6
    for j in range(count):
        change = np.zeros(count)
        change[j] = step
        expected = (places(values + change) - places(values - change)) / (2 * step)
        # Central differences are exact to step^2, and to the rounding of positions divided by the step.
        assert np.abs(found[..., j] - expected).max() <= 1e-8
    assert found.shape == (6, 4, 3, count)
    one = robot.jacobian(values[0], bodies[0], places(values)[0])
    assert np.array_equal(one, found[0])
    assert np.array_equal(robot.jacobian(values[0], -1, np.zeros(3)), np.zeros((3, count)))


def test_the_jacobian_of_moved_roots_is_the_derivative(files, random):
    robot = fb.Assembly.from_urdf(files["arm"])
    place = np.tile(np.eye(4), (3, 1, 1))
    place[:, :3, :3] = meshes.rotation(5)
    place[:, :3, 3] = random.uniform(-1, 1, (3, 3))
    values, row = random.uniform(-1, 1, (3, 8)), robot.body_names.index("hand")

    def places(values):
        return robot.poses(values, roots={"link0": place})[:, row, :3, 3]

    found = robot.jacobian(values, row, places(values), roots={"link0": place})

    step = 1e-6
    for j in range(8):
        change = np.zeros(8)
        change[j] = step
        expected = (places(values + change) - places(values - change)) / (2 * step)
        # Central differences are exact to step^2, and to the rounding of positions divided by the step.
        assert np.abs(found[..., j] - expected).max() <= 1e-8
    one = robot.jacobian(values[0], row, places(values)[0], roots={"link0": place[0]})
    assert np.array_equal(one, found[0])
    assert not np.allclose(robot.jacobian(values, row, places(values)), found, atol=0.1)


def test_mistakes_name_the_argument(files):
    robot = fb.Assembly.from_urdf(files["two"])
    cases = [
        (lambda: robot.poses([1.0]), r"values: must have shape \(..., 2\), one for each of the joints"),
        (lambda: robot.poses([1.0, np.nan]), r"values\[1\]: must be finite"),
        (lambda: robot.poses({"knee": 1.0}), "values: 'knee' is no joint with its own value"),
        (lambda: robot.poses([0, 0], roots={"upper": np.eye(4)}), "roots: 'upper' is no body without a parent"),
        (lambda: robot.poses([0, 0], roots={"base": 2 * np.eye(4)}), r"roots\['base'\]: must be a rotation"),
        (lambda: robot.poses([0, 0], roots={"base": np.ones((3, 4, 4))}), r"roots\['base'\]\[0\]: must be a rotation"),
        (
            lambda: robot.poses(np.zeros((2, 2)), roots={"base": np.stack([np.eye(4)] * 3)}),
            r"roots\['base'\]: must be one pose \(4, 4\), or poses \(..., 4, 4\) for the leading shape \(2,\)",
        ),
        (lambda: robot.poses([0, 0], roots={"base": np.eye(3)}), r"roots\['base'\]: must be one pose \(4, 4\)"),
        (
            lambda: robot.jacobian([0, 0], 0, np.zeros(3), roots={"base": np.stack([np.eye(4)] * 3)}),
            "roots: have 3 poses; give as many rows of values and points",
        ),
        (lambda: robot.jacobian([0, 0], "foot", np.zeros(3)), "bodies: 'foot' is no body"),
        (lambda: robot.jacobian([0, 0], 7, np.zeros(3)), "bodies: rows must be from 0 to 2"),
        (lambda: robot.jacobian([0, 0], [0, 1], np.zeros((3, 3))), r"bodies: must have shape \(3,\)"),
        (lambda: robot.jacobian(np.zeros((2, 2)), 0, np.zeros((3, 3))), r"points: must have shape \(2, ..., 3\)"),
        (lambda: fb.Joint("a", "ball", "x", "y"), "joint 'a': kind: must be one of"),
        (lambda: fb.Joint("a", "revolute", "x", "y", axis=(0, 0, 0)), "joint 'a': axis: must not be zero"),
        (lambda: fb.Joint("a", "revolute", "x", "y", axis=(np.nan, 0, 0)), "joint 'a': axis: must be finite"),
        (lambda: fb.Joint("a", "revolute", "x", "y", limits=(1, 0)), "joint 'a': limits: the lower limit"),
        (lambda: fb.Joint("a", "revolute", "x", "y", origin=np.ones((4, 4))), "joint 'a': origin: must be a rotation"),
        (lambda: fb.Joint("a", "revolute", "x", "y", mimic=("b",)), "joint 'a': mimic: must be"),
        (lambda: fb.Assembly([fb.sphere(1)]), "bodies: must be a mapping"),
        (lambda: fb.Assembly({"a": ()}, [3]), "joints: must hold Joints"),
        (lambda: fb.Assembly({"a": [(fb.sphere(1), np.ones((4, 4)))]}), r"bodies\['a'\]\[0\]: must be a rotation"),
        (lambda: fb.Assembly({"a": ()}, ignored_pairs=[("a", "b")]), r"ignored_pairs\[0\]: 'b' is no body"),
    ]  # fmt: skip
    for call, message in cases:
        with pytest.raises(fb.ArgumentError, match=message):
            call()


def joint(name, parent, child, **options):
    return fb.Joint(name, "revolute", parent, child, **options)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ([joint("j", "a", "b"), joint("j", "b", "c")], "two joints have the name 'j'"),
        ([joint("j", "a", "x")], "joint 'j': the child 'x' is no body"),
        ([joint("j", "x", "a")], "joint 'j': the parent 'x' is no body"),
        ([joint("j", "a", "a")], "joint 'j': 'a' is its own parent"),
        ([joint("j", "a", "c"), joint("k", "b", "c")], "joint 'k': 'c' has two parents, 'a' and 'b'"),
        ([joint("j", "a", "b"), joint("k", "b", "a")], r"the bodies \['a', 'b'\] are in a cycle"),
        ([joint("j", "a", "b", mimic=("j", 1, 0))], "joint 'j': mimics itself"),
        ([joint("j", "a", "b", mimic=("k", 1, 0)), joint("k", "b", "c", mimic=("j", 1, 0))], "mimics itself"),
        ([joint("j", "a", "b", mimic=("z", 1, 0))], "joint 'j': mimics 'z', which is no joint with a value"),
    ],
)
def test_joints_form_trees(joints, message):
    with pytest.raises(fb.ArgumentError, match=message):
        fb.Assembly({"a": (), "b": (), "c": ()}, joints)
