"""The camera: its position, its direction, and errors for invalid arguments."""

import copy
import json
import pickle

import numpy as np
import pytest
import trimesh

import fieldbake as fb

BOX = np.array([(-1.0, -2.0, 0.0), (3.0, 1.0, 0.5)])


def corners(bounds):
    return np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]])


def project(camera, points, aspect):
    """Project points: positions in the picture from -1 to 1, and depths."""
    local = (points - camera.eye) @ camera.pose[:3, :3]
    slope = np.tan(np.radians(camera.fov_deg) / 2)
    depth = -local[:, 2]
    return local[:, 0] / (depth * slope * aspect), local[:, 1] / (depth * slope), depth


def test_the_pose_is_a_rotation_that_looks_at_the_target():
    camera = fb.Camera((1, 2, 3), (4, -5, 6))

    rotation = camera.pose[:3, :3]
    ahead = np.array((4, -5, 6)) - (1, 2, 3)
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert -rotation[:, 2] == pytest.approx(ahead / np.linalg.norm(ahead))
    assert camera.eye == pytest.approx((1, 2, 3))
    assert camera.pose[3].tolist() == [0, 0, 0, 1]


def test_up_is_up_in_the_picture():
    camera = fb.Camera((0, 0, 5), (0, 0, 0))

    x, y, _ = project(camera, np.array([[0, 1, 0], [1, 0, 0]]), 1.0)

    assert y[0] > 0
    assert x[1] > 0


def test_up_need_not_be_perpendicular():
    leaning, straight = fb.Camera((0, 0, 5), (0, 0, 0), up=(0, 1, 0.9)), fb.Camera((0, 0, 5), (0, 0, 0))

    assert leaning.pose == pytest.approx(straight.pose)


@pytest.mark.parametrize("aspect", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("fov_deg", [10, 45, 100])
@pytest.mark.parametrize("direction", [(-0.55, -0.4, -1.0), (1, 0, 0), (0.1, -0.9, 0.2)])
def test_fit_shows_the_whole_box_and_fills_the_picture(aspect, fov_deg, direction):
    camera = fb.Camera.fit(BOX, direction=direction, fov_deg=fov_deg, aspect=aspect)

    x, y, depth = project(camera, corners(BOX), aspect)

    assert (depth > 0).all()
    assert max(np.abs(x).max(), np.abs(y).max()) <= 1
    if fov_deg < 90:  # a wider view would have to stand inside the box's sphere
        assert max(np.abs(x).max(), np.abs(y).max()) >= 0.9


def test_fit_of_a_flat_box():
    camera = fb.Camera.fit([(0, 0, 0), (1, 1, 0)])

    assert np.isfinite(camera.pose).all()


def test_from_pose_keeps_the_pose():
    pose = fb.Camera((1, 2, 3), (0, 0, 0)).pose

    assert np.array_equal(fb.Camera.from_pose(pose, 30).pose, pose)
    assert fb.Camera.from_pose(pose, 30).fov_deg == 30


def test_float32_poses_are_taken():
    pose = fb.Camera((1, 2, 3), (0, 0, 0)).pose.astype(np.float32)

    assert fb.Camera.from_pose(pose).pose == pytest.approx(pose)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.Camera((0, 0, 0), (0, 0, 0)), "target"),
        (lambda: fb.Camera((0, 0, np.nan), (0, 0, 0)), "eye"),
        (lambda: fb.Camera((0, 0), (0, 0, 0)), "eye"),
        (lambda: fb.Camera((0, 0, 1), (0, np.inf, 0)), "target"),
        (lambda: fb.Camera((0, 0, 1), (0, 0, 0), up=(0, 0, 0)), "up"),
        (lambda: fb.Camera((0, 5, 0), (0, 0, 0)), "up"),
        (lambda: fb.Camera((0, 0, 1), (0, 0, 0), fov_deg=0), "fov_deg"),
        (lambda: fb.Camera((0, 0, 1), (0, 0, 0), fov_deg=180), "fov_deg"),
        (lambda: fb.Camera((0, 0, 1), (0, 0, 0), fov_deg=np.nan), "fov_deg"),
        (lambda: fb.Camera((0, 0, 1), (0, 0, 0), fov_deg="wide"), "fov_deg"),
        (lambda: fb.Camera.from_pose(np.eye(3)), "pose"),
        (lambda: fb.Camera.from_pose(np.zeros((4, 4))), "pose"),
        (lambda: fb.Camera.from_pose(np.full((4, 4), np.nan)), "pose"),
        (lambda: fb.Camera.from_pose(np.diag([1.0, 1, -1, 1])), "rotation"),
        (lambda: fb.Camera.from_pose(np.diag([2.0, 2, 2, 1])), "rotation"),
        (lambda: fb.Camera.from_pose(np.eye(4) + np.eye(4)[[3, 1, 2, 0]]), "pose"),
        (lambda: fb.Camera.fit([(0, 0, 0), (0, 0, 0)]), "bounds"),
        (lambda: fb.Camera.fit([(1, 1, 1), (0, 0, 0)]), "bounds"),
        (lambda: fb.Camera.fit([(0, 0, 0), (1, 1, np.nan)]), "bounds"),
        (lambda: fb.Camera.fit(BOX, direction=(0, 0, 0)), "direction"),
        (lambda: fb.Camera.fit(BOX, direction=(0, 1, 0)), "up"),
        (lambda: fb.Camera.fit(BOX, aspect=0), "aspect"),
        (lambda: fb.Camera.fit(BOX, border=-1), "border"),
    ],
)
def test_a_camera_that_cannot_see_is_refused(make, message):
    with pytest.raises(fb.SceneError, match=message):
        make()


def test_a_camera_does_not_change():
    camera = fb.Camera((0, 0, 1), (0, 0, 0))

    with pytest.raises(AttributeError):
        camera.fov_deg = 3
    with pytest.raises(ValueError, match="read-only"):
        camera.pose[0, 0] = 3


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))])
def test_copies_are_equal(duplicate):
    camera = fb.Camera((1, 2, 3), (0, 0, 0), fov_deg=30)

    twin = duplicate(camera)

    assert np.array_equal(twin.pose, camera.pose)
    assert twin.fov_deg == camera.fov_deg


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.DirectionalLight((0, 0, 0)), "direction"),
        (lambda: fb.DirectionalLight((0, 0)), "direction"),
        (lambda: fb.DirectionalLight((0, np.nan, 0)), "direction"),
        (lambda: fb.DirectionalLight((0, 1, 0), color=(1, -1, 1)), "color"),
        (lambda: fb.DirectionalLight((0, 1, 0), intensity=-1), "intensity"),
        (lambda: fb.DirectionalLight((0, 1, 0), angle_deg=-1), "angle_deg"),
        (lambda: fb.PointLight((0, 0, np.inf)), "position"),
        (lambda: fb.PointLight((0, 0, 0), radius=-1), "radius"),
    ],
)
def test_a_light_that_makes_no_sense_is_refused(make, message):
    with pytest.raises(fb.SceneError, match=message):
        make()


def test_the_direction_of_a_light_is_unit():
    assert fb.DirectionalLight((0, -3e300, 4e300)).direction == pytest.approx((0, -0.6, 0.8))


def saved_lights(path, lights):
    """Write a glTF file of a box with these lights, each in a node of its own."""
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box()))
    for name, content in files.items():
        (path.parent / name.replace("model.gltf", path.name)).write_bytes(content)
    document = json.loads(path.read_text())
    document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for i in range(len(lights)):
        document["scenes"][0]["nodes"].append(len(document["nodes"]))
        document["nodes"].append({"extensions": {"KHR_lights_punctual": {"light": i}}})
    path.write_text(json.dumps(document))


def test_the_brightest_lights_of_a_file_are_kept_with_a_warning(tmp_path):
    path = tmp_path / "lights.gltf"
    saved_lights(path, [{"type": "directional", "intensity": 1.0 + i} for i in range(20)])

    with pytest.warns(UserWarning, match="not used: 4 lights"):
        scene = fb.load_scene(path)

    assert sorted(light.intensity for light in scene.lights) == pytest.approx([(5.0 + i) / 20 for i in range(16)])


@pytest.mark.parametrize(
    "light",
    [
        {"type": "spot", "spot": {"outerConeAngle": 0}},
        {"type": "point", "range": -1},
        {"type": "point", "range": "far"},
        {"type": "point", "intensity": None},
    ],
)
def test_a_malformed_light_of_a_file_is_left_out_with_a_warning(tmp_path, light):
    path = tmp_path / "lights.gltf"
    saved_lights(path, [light, {"type": "spot", "spot": None}, {"type": "spot", "spot": {"innerConeAngle": -1e-17}}])

    with pytest.warns(UserWarning, match="a light is not used"):
        scene = fb.load_scene(path)

    assert [type(light) for light in scene.lights] == [fb.SpotLight, fb.SpotLight]
