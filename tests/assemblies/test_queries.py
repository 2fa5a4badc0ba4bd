"""Distances to posed bodies against closed forms and float64 brute force; batches against single configurations."""

import pickle
import warnings

import numpy as np
import pytest

import fieldbake as fb
import meshes
import robots
import truth


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return fb.Assembly.from_urdf(robots.write(tmp_path_factory.mktemp("robots"))["arm"])


def primitive(kind, sizes, points):
    """The closed form of a primitive of URDF."""
    if kind == "box":
        return truth.box(points, -0.5 * np.array(sizes), 0.5 * np.array(sizes))
    if kind == "sphere":
        return truth.sphere(points, sizes[0])
    if kind == "capsule":
        return truth.capsule(points, sizes[1] / 2, sizes[0])
    radial, axial = np.hypot(points[:, 0], points[:, 1]) - sizes[0], np.abs(points[:, 2]) - sizes[1] / 2
    return np.hypot(np.clip(radial, 0, None), np.clip(axial, 0, None)) + np.minimum(np.maximum(radial, axial), 0)


def rpy(roll, pitch, yaw):
    (a, b), (c, d), (e, f) = ((np.cos(t), np.sin(t)) for t in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, a, -b], [0, b, a]])
    about_y = np.array([[c, 0, d], [0, 1, 0], [-d, 0, c]])
    about_z = np.array([[e, -f, 0], [f, e, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def closed_forms(poses, points):
    """The smallest distance over the primitives of each link, (links, n)."""
    rows = []
    for pose, parts in zip(poses, robots.ARM_PARTS.values(), strict=True):
        row = np.full(len(points), np.inf)
        for kind, sizes, place, turn in parts:
            local = (points - pose[:3, 3]) @ pose[:3, :3]
            row = np.minimum(row, primitive(kind, sizes, (local - np.array(place)) @ rpy(*turn)))
        rows.append(row)
    return np.array(rows)


def test_distances_to_primitives_are_their_closed_forms(arm, random):
    points = random.uniform((-1, -1, -0.3), (1, 1, 1.5), (10_000, 3))
    values = random.uniform(arm.limits[:, 0], arm.limits[:, 1], (20, 8))
    poses = arm.poses(values)

    found = arm.query(points, poses)

    assert found.distances.shape == (20, 10_000)
    assert found.distances.dtype == np.float64
    for i in range(20):
        expected = closed_forms(poses[i], points)
        assert np.abs(found.distances[i] - expected.min(axis=0)).max() <= 1e-12
        attained = expected[found.bodies[i], np.arange(len(points))]
        assert np.abs(attained - found.distances[i]).max() <= 1e-12
    assert (found.distances < 0).sum() > 500
    assert np.abs(np.linalg.norm(found.gradients, axis=-1) - 1).max() <= 1e-12
    nearest = found.points + found.distances[..., None] * found.gradients
    assert np.abs(nearest - points).max() <= 1e-12
    # A body without geometry is never the nearest one.
    assert not (found.bodies == arm.body_names.index("flange")).any()
    assert np.array_equal(arm.distance(points, poses), found.distances)
    assert found.report.points == 200_000


@pytest.fixture(scope="module")
def mesh_robot():
    """Three links with meshes; the middle one has two."""
    knot, gear = fb.models.torus_knot(segments=80, sides=12), fb.models.gear(teeth=6)
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = meshes.rotation(2), (0.5, 0.2, 1)
    ball = fb.Mesh(*meshes.icosphere(2, 0.4))
    joints = [
        fb.Joint("one", "revolute", "a", "b", origin=place, axis=(1, 1, 0)),
        fb.Joint("two", "prismatic", "b", "c", axis=(0, 1, 1)),
    ]
    return fb.Assembly({"a": gear, "b": [(knot, place), ball], "c": ball}, joints)


def brute_force(robot, poses, points):
    """The signed distance to each body, (bodies, n), on vertices that are moved in float64."""
    rows = []
    for pose, parts in zip(poses, robot.bodies.values(), strict=True):
        row = np.full(len(points), np.inf)
        for mesh, place in parts:
            world = pose @ place
            moved = mesh.vertices @ world[:3, :3].T + world[:3, 3]
            row = np.minimum(row, truth.signed_distance(moved, mesh.faces.astype(np.int64), points))
        rows.append(row)
    return np.array(rows)


def test_distances_to_meshes_are_those_of_brute_force(mesh_robot, random):
    points = random.uniform(-3, 3, (600, 3))
    poses = mesh_robot.poses(random.uniform(-2, 2, (4, 2)))

    found = mesh_robot.query(points, poses)

    for i in range(4):
        expected = brute_force(mesh_robot, poses[i], points)
        assert np.abs(found.distances[i] - expected.min(axis=0)).max() <= 1e-12 * 6
        attained = expected[found.bodies[i], np.arange(len(points))]
        assert np.abs(attained - found.distances[i]).max() <= 1e-12 * 6
    assert (found.distances < 0).any()
    assert set(found.bodies.ravel().tolist()) == {0, 1, 2}


@pytest.mark.parametrize("name", ["arm", "mesh_robot"])
def test_a_batch_has_the_bits_of_its_configurations(name, request, random):
    robot = request.getfixturevalue(name)
    points = random.uniform(-1.5, 1.5, (3_000, 3))
    poses = robot.poses(random.uniform(-2, 2, (7, len(robot.joint_names))))
    try:
        for threads in (2, 1):
            fb.set_threads(threads)
            together = robot.query(points, poses)
            for i in range(7):
                alone = robot.query(points, poses[i])
                assert all(np.array_equal(a, b[i]) for a, b in zip(alone[:4], together[:4], strict=True))
            paired = robot.query(np.broadcast_to(points, (7, 3_000, 3)), poses, paired=True)
            assert all(np.array_equal(a, b) for a, b in zip(paired[:4], together[:4], strict=True))
    finally:
        fb.set_threads(2)


@pytest.mark.parametrize("count", [1, 3, 65, 1025])
def test_paired_points_belong_to_their_configuration(mesh_robot, random, count):
    poses = mesh_robot.poses(random.uniform(-2, 2, (11, 2)))
    points = random.uniform(-3, 3, (11, count, 3))

    found = mesh_robot.distance(points, poses, paired=True)

    expected = [mesh_robot.distance(points[i], poses[i]) for i in range(11)]
    assert np.array_equal(found, expected)
    assert mesh_robot.distance(points[:, 0], poses, paired=True).shape == (11,)


def test_shapes_of_results(arm):
    points = np.zeros((2, 5, 3))
    poses = np.broadcast_to(arm.home, (3, *arm.home.shape))
    assert arm.query(points).distances.shape == (2, 5)
    assert arm.query(points, arm.home).gradients.shape == (2, 5, 3)
    assert arm.query(points, poses).points.shape == (3, 2, 5, 3)
    assert arm.distance((0, 0, 0)).shape == ()
    assert arm.distance(np.empty((0, 3)), poses).shape == (3, 0)
    assert arm.distance(points, poses[:0]).shape == (0, 2, 5)


def test_only_named_bodies_are_searched(arm, random):
    points = random.uniform(-1, 1, (500, 3))
    expected = closed_forms(arm.home, points)

    by_name = arm.query(points, bodies=["link3", "hand"])

    rows = [arm.body_names.index("link3"), arm.body_names.index("hand")]
    assert np.abs(by_name.distances - expected[rows].min(axis=0)).max() <= 1e-12
    assert set(by_name.bodies.tolist()) <= set(rows)
    assert np.array_equal(arm.distance(points, bodies=rows), by_name.distances)
    nothing = arm.query(points, bodies=["flange"])
    assert np.isinf(nothing.distances).all()
    assert (nothing.bodies == -1).all()
    assert (nothing.gradients == 0).all()
    assert np.isinf(arm.distance(points, bodies=[])).all()


def test_joint_gradients_are_those_of_differences(arm, random):
    values = random.uniform(-1, 1, (1_000, 8))
    points = random.uniform((-0.8, -0.8, 0), (0.8, 0.8, 1.2), (1_000, 3))
    q = arm.query(points, arm.poses(values), paired=True)

    change = -np.einsum("...i,...im->...m", q.gradients, arm.jacobian(values, q.bodies, q.points))

    step = 1e-6
    compared = 0
    for j in range(8):
        moved = np.zeros(8)
        moved[j] = step
        low, high = (arm.query(points, arm.poses(values + sign * moved), paired=True) for sign in (-1, 1))
        expected = (high.distances - low.distances) / (2 * step)
        # Across the medial axis another surface point becomes the nearest one.
        smooth = (np.linalg.norm(high.points - low.points, axis=-1) < 1e-4) & (high.bodies == low.bodies)
        error = np.abs(change[:, j] - expected)
        assert error[smooth].max() <= 1e-6 * max(1.0, np.abs(expected).max())
        compared += smooth.sum()
    assert compared > 7_500


@pytest.mark.parametrize(
    ("shape", "point"),
    [
        (fb.torus(0.5, 0.02), (0, 0, 0.1)),
        (fb.torus(0.5, 0.1), (0.5, 0, 0)),
        (fb.cone(0.5, 1), (0, 0, 0.1)),
        (fb.truncated_cone(0.5, 0.2, 1), (0, 0, 0.1)),
        (fb.rounded_cone(0.4, 0.2, 2), (0, 0, 0.1)),
        (fb.ellipsoid((0.5, 0.4, 0.3)), (0.05, 0, 0)),
        (fb.pyramid(1, 1), (0.9, 0.9, 0.2)),
        (fb.sphere(1), (0, 0, 0)),
        (fb.box(1), (0, 0, 0)),
    ],
)
@pytest.mark.parametrize("offset", [0, 1e5])
def test_a_point_with_several_nearest_points_has_one_of_them(shape, point, offset):
    away = np.array([offset, 0, -offset])
    found = fb.Assembly({"body": shape.translate(away)}).query(np.add(point, away))
    distance = abs(shape.distance(point, dtype="float64"))
    scale = 1 + offset
    # The gradient is taken 1e-9 of the size beside the point, and the coordinates have the rounding of the offset.
    assert np.linalg.norm(found.points - away - point) == pytest.approx(distance, abs=1e-9 * scale)
    assert np.abs(shape.distance(found.points - away, dtype="float64")) <= 1e-8 * scale
    assert np.linalg.norm(found.gradients) == pytest.approx(1, abs=1e-12)


def test_shapes_and_volumes_become_closed_meshes():
    hollow = fb.sphere(1) - fb.sphere(0.5)
    robot = fb.Assembly({"shape": hollow, "volume": fb.bake(fb.sphere(0.5), 32)}, shape_resolution=64)

    assert robot.report.closed_forms == 0
    # The vertices lie on the surface, and the centres of faces below it by their sagitta R^2 / 2r: the circumradius R
    # is at most the diagonal of a square of voxels, and r is 1/2.
    assert 0 < robot.report.largest_deviation <= 2 * (2.2 / 64) ** 2
    assert robot.distance((0.75, 0, 0), bodies="shape") == pytest.approx(-0.25, abs=1e-3)
    assert robot.distance((1, 0, 0), bodies=["volume"]) == pytest.approx(0.5, abs=1e-3)
    assert "deviation" in str(robot.report)


def test_the_report_names_walls_that_the_mesh_of_a_shape_lacks():
    part = fb.box(0.2) | fb.box((1, 1, 0.004)).rotate("z", 20).translate((0, 0, 0.0035))
    with pytest.warns(fb.SurfaceWarning, match="thinner than a voxel") as caught:
        robot = fb.Assembly({"part": part})
    assert robot.report.warnings == (str(caught[0].message),)


def test_bodies_take_all_forms_of_geometry():
    place = np.eye(4)
    place[0, 3] = 5
    robot = fb.Assembly(
        {
            "arrays": meshes.box(),
            "placed": (fb.sphere(1), place),
            "list": [fb.sphere(1), (meshes.box(), place)],
            "none": (),
            "plane": fb.plane("z", -7.0),
        }
    )
    assert [len(parts) for parts in robot.bodies.values()] == [1, 1, 2, 0, 1]
    assert robot.distance((8, 0, 0), bodies=["placed"]) == 2.0
    assert robot.query((0, 0, -6.5)).bodies == 4
    assert robot.distance((100, 0, -9)) == -2.0


def test_an_assembly_is_pickled_with_its_distances(mesh_robot, random):
    points = random.uniform(-3, 3, (50, 3))

    copy = pickle.loads(pickle.dumps(mesh_robot))

    assert np.array_equal(copy.distance(points), mesh_robot.distance(points))
    assert copy.joint_names == mesh_robot.joint_names
    assert repr(copy) == "Assembly(3 bodies, 2 joints, 2 values)"
    assert copy.joints[0].axis.tolist() == mesh_robot.joints[0].axis.tolist()


def test_open_bodies_warn_once():
    robot = fb.Assembly({"lidless": meshes.open_box(), "ball": fb.sphere(1)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = robot.query([(0, 0, 3)])
        robot.distance([(0, 0, 3)], bodies=["ball"])
    assert [warning.category for warning in caught] == [fb.SurfaceWarning]
    assert found.report.warnings == robot.report.warnings


def test_bodies_in_millimetres_are_in_the_report():
    big = fb.Mesh(*meshes.box((0, 0, 0), (300, 100, 100)))
    joint = fb.Joint("j", "revolute", "a", "b", origin=[[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])

    robot = fb.Assembly({"a": big, "b": ()}, [joint])

    assert any("'a' is 1000 times larger than the distances between joints" in text for text in robot.report.warnings)


def test_mistakes_name_the_argument(arm):
    poses = np.array(arm.home)
    poses[2, 0, 0] += 1e-3
    cases = [
        (lambda: arm.query([(0, 0)]), r"points: must have shape \(n, 3\)"),
        (lambda: arm.query([(0, 0, np.nan)]), r"points\[0\]: must be finite"),
        (lambda: arm.query([(0, 0, 0)], np.eye(4)), r"poses: must have shape \(11, 4, 4\) or \(b, 11, 4, 4\)"),
        (lambda: arm.query([(0, 0, 0)], poses), r"poses\[2\]: must be a rotation and a translation"),
        (lambda: arm.query([(0, 0, 0)], np.nan * poses), r"poses\[0\]: must be a rotation and a translation"),
        (lambda: arm.query([(0, 0, 0)], arm.home[None], paired=True), None),
        (lambda: arm.query(np.zeros((2, 4, 3)), arm.home[None], paired=True), "paired: needs points of shape"),
        (lambda: arm.query([(0, 0, 0)], arm.home, paired=True), "paired: needs points of shape"),
        (lambda: arm.query([(0, 0, 0)], paired=1), "paired: must be True or False"),
        (lambda: arm.query([(0, 0, 0)], bodies=["foot"]), "bodies: 'foot' is no body"),
        (lambda: arm.query([(0, 0, 0)], bodies=[-1]), "bodies: rows must be from 0 to 10, got -1"),
        (lambda: arm.query([(0, 0, 0)], bodies=[11]), "bodies: rows must be from 0 to 10"),
        (lambda: arm.query([(0, 0, 0)], bodies=[1.5]), "bodies: must be names or rows"),
    ]
    for call, message in cases:
        if message is None:
            call()
            continue
        with pytest.raises(fb.ArgumentError, match=message):
            call()


def test_a_pose_that_is_rigid_to_a_millionth_gives_distances_to_it(random):
    robot = fb.Assembly({"ball": fb.sphere(1).translate((3, 0, 0))})
    pose = np.eye(4)
    pose[:3, :3] = meshes.rotation(1) + random.uniform(-1, 1, (3, 3)) * 2e-7

    found = robot.query([(0, 0, 5)], pose[None])

    assert np.abs(np.linalg.norm(found.points[0] - (0, 0, 5)) - found.distances[0]) <= 1e-12
