"""Pictures of orthographic cameras against closed forms: depth, normal, coverage and shadow."""

from __future__ import annotations

import copy
import json
import math
import pickle

import numpy as np
import pytest
import trimesh

import fieldbake as fb
import meshes
from compare import exceeds
from scenes import SUN, miss_distance, moved, plane

CENTER, RADIUS = np.array([0.3, -0.2, 0.1]), 1.0
SIZE = (40, 32)
CAMERA = fb.Camera.orthographic((3.1, -2.4, 2.2), CENTER, up=(0, 0, 1), height=2.6)
RESOLUTION = 48


def starts(camera, size):
    """World position at which the ray through each pixel's centre starts, (h, w, 3)."""
    width, height = size
    x = (np.arange(width) + 0.5 - width / 2) * camera.height / height
    y = (height / 2 - np.arange(height) - 0.5) * camera.height / height
    return camera.eye + x[None, :, None] * camera.pose[:3, 0] + y[:, None, None] * camera.pose[:3, 1]


def positions(frame, camera):
    """World points of the pixels, float64; nan where nothing is hit."""
    depth = np.where(np.isfinite(frame.depth), frame.depth, np.nan)[..., None]
    return starts(camera, frame.size) - depth * camera.pose[:3, 2]


def sphere_hits(camera=CAMERA, size=SIZE):
    """Depth (inf: no hit), unit normal, and the cosine between ray and normal of each pixel."""
    from_center = starts(camera, size) - CENTER
    ahead = -camera.pose[:3, 2]
    b = from_center @ ahead
    inside = b**2 - (from_center**2).sum(axis=-1) + RADIUS**2
    depth = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), np.inf)
    normal = (from_center + np.where(inside > 0, depth, 0)[..., None] * ahead) / RADIUS
    return depth, normal, np.sqrt(np.maximum(inside, 0)) / RADIUS


@pytest.fixture(scope="module")
def volume():
    vertices, faces = meshes.icosphere(4)
    return fb.bake(fb.Mesh(RADIUS * vertices + CENTER, faces), RESOLUTION, device="cpu")


FIELDS = {
    "volume": lambda volume: volume,
    "sparse": lambda volume: volume.to_sparse(),
    "snorm16": lambda volume: volume.quantize("snorm16"),
    "nested": lambda volume: fb.merge([volume], RESOLUTION, levels=2, center=tuple(CENTER), device="cpu"),
    "quadric": lambda _: fb.Quadric.sphere(tuple(CENTER)),
    "shape": lambda _: fb.sphere(RADIUS).translate(tuple(CENTER)),
    "marched shape": lambda _: fb.sphere(0.5 * RADIUS).offset(0.5 * RADIUS).translate(tuple(CENTER)),
}


def check_sphere(frame, error):
    """Depth and normal of a sphere whose surface is known to `error`."""
    depth, normal, cosine = sphere_hits()
    # A distance between surfaces of `error` along the normal is `error / cosine` along the ray.
    clear = cosine > 0.3
    assert clear.sum() > 400
    assert np.abs(frame.depth[clear] - depth[clear]).max() <= error / 0.3
    assert np.isfinite(frame.depth[~np.isfinite(depth)]).mean() <= 0.05
    assert (frame.normal * normal).sum(axis=-1)[clear].min() > 0.99


@pytest.mark.parametrize("name", FIELDS)
def test_depth_and_normal_of_fields_are_the_closed_form(name, volume, device):
    frame = fb.raymarch(FIELDS[name](volume), CAMERA, size=SIZE, device=device)

    # Samples of a mesh that lies 2e-3 inside the sphere, and trilinear cells of 2.2 / 48.
    sampled = 2e-3 + 2 * (2.2 / RESOLUTION) ** 2 / 8 * 2
    check_sphere(
        frame, {"quadric": 1e-6, "shape": 3e-6, "marched shape": 3e-6, "nested": 4 * sampled}.get(name, sampled)
    )


@pytest.mark.parametrize("primary", ["raster", "raymarch"])
def test_depth_and_normal_of_scenes_are_the_closed_form(primary, device):
    vertices, faces = meshes.icosphere(4)
    mesh = fb.Mesh(RADIUS * vertices, faces)
    scene = fb.Scene(
        [fb.Instance(mesh, moved(*CENTER), resolution=RESOLUTION), fb.Instance(fb.torus(0.1, 0.01), moved(9))]
    )
    if primary == "raster":
        scene = fb.Scene(scene.instances[:1])

    frame = fb.render(scene, CAMERA, size=SIZE, primary=primary, device=device)

    check_sphere(frame, 2e-3 + 2 * (2.2 / RESOLUTION) ** 2 / 8 * 2)
    if device == "gpu":
        assert frame.report["devices"]["primary"] != "cpu"


@pytest.mark.parametrize("distance", [1.5, 3.0, 1e4])
@pytest.mark.parametrize("draw", ["raymarch", "render"])
def test_a_box_has_its_size_at_any_distance(draw, distance, device):
    # 4 units are 40 pixels, so a box of 2 x 1.2 units covers 20 x 12 pixels.
    camera = fb.Camera.orthographic((0.5, 0.3, distance), (0.5, 0.3, 0), height=4)
    box = fb.box((2, 1.2, 1)).translate((0.5, 0.3, 0))

    frame = getattr(fb, draw)(box, camera, size=(60, 40), device=device)

    expected = np.zeros((40, 60), bool)
    expected[14:26, 20:40] = True
    assert np.array_equal(np.isfinite(frame.depth), expected)
    # A depth is float32.
    assert np.abs(frame.depth[expected] - (distance - 0.5)).max() <= 1e-6 + distance * 2**-23
    assert np.abs(frame.normal[expected] - (0, 0, 1)).max() <= 1e-5


def test_surfaces_behind_the_eye_are_invisible(device):
    camera = fb.Camera.orthographic((0, 0, 0), (0, 0, -1), height=4)
    shapes = [fb.sphere(0.5).translate((-1, 0, -2)), fb.sphere(0.5).translate((1, 0, 2))]

    for frame in (
        fb.raymarch(shapes[0] | shapes[1], camera, size=SIZE, device=device),
        fb.render(fb.Scene(shapes), camera, size=SIZE, device=device),
        fb.raymarch(
            [fb.Quadric.sphere((-1, 0, -2), 0.5), fb.Quadric.sphere((1, 0, 2), 0.5)], camera, size=SIZE, device=device
        ),
    ):
        seen = np.isfinite(frame.depth)
        assert seen[:, :20].sum() > 20
        assert not seen[:, 20:].any()


def test_samples_cover_parts_of_pixels():
    # The right edge of the box is a quarter of a pixel into column 30.
    material = fb.Material(color=(1, 1, 1), specular=0)
    box = fb.Instance(fb.box((1.025, 9, 1)).translate((0.5125, 0, 0)), material=material)
    scene = fb.Scene([box], [], ambient=1.0, background=(0, 0, 0, 0))
    camera = fb.Camera.orthographic((0, 0, 3), (0, 0, 0), height=4)

    frame = fb.render(scene, camera, size=(40, 40), samples=16, device="cpu")

    assert frame.color[20, 29:32, 3] == pytest.approx((1, 0.25, 0), abs=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_hard_shadow_of_a_sphere_is_the_closed_form(scale, device):
    ball = fb.Mesh(*meshes.icosphere(4))
    zoom = np.diag([scale, scale, scale, 1.0])
    scene = fb.Scene(
        [fb.Instance(ball, zoom @ moved(y=0.6)), fb.Instance(plane(), zoom)], lights=[fb.DirectionalLight(SUN)]
    )
    eye, target = np.array([2.5, 7.0, 5.0]) * scale, np.array([0.6, -1.0, 0.2]) * scale
    camera = fb.Camera.orthographic(eye, target, height=6 * scale)

    frame = fb.render(scene, camera, size=(60, 40), shadows="hard", ambient_occlusion=True, device=device)

    on_plane = frame.object_id == 1
    points = positions(frame, camera) / scale
    assert np.abs(points[on_plane][:, 1] + 1).max() <= 1e-5
    passing = miss_distance(points, np.array([0, 0.6, 0]), -np.array(SUN) / np.linalg.norm(SUN))
    clear = on_plane & (np.abs(passing - 1) > 0.05)
    assert (passing[clear] < 1).sum() > 30
    assert (frame.shadow[clear] == (passing > 1)[clear]).all()


def test_a_textured_mesh_and_translucent_layers_are_drawn(device):
    square = fb.Mesh([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    glass = fb.Instance(square, moved(z=1), fb.Material(color=(1, 0, 0, 0.25), specular=0))
    wall = fb.Instance(square, moved(), fb.Material(color=(0, 1, 0), specular=0))
    scene = fb.Scene([glass, wall], [], ambient=1.0, background=(0, 0, 0, 1))
    camera = fb.Camera.orthographic((0, 0, 5), (0, 0, 0), height=4)

    frame = fb.render(scene, camera, size=(16, 16), device=device)

    assert frame.color[8, 8] == pytest.approx((0.25, 0.75, 0, 1), abs=1e-6)
    assert frame.depth[8, 8] == 5
    assert (frame.object_id >= 0).sum() == 64


@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
def test_fit_shows_the_whole_box_and_fills_the_picture(aspect):
    box = np.array([(-1.0, -2.0, 0.0), (3.0, 1.0, 0.5)])

    camera = fb.Camera.fit(box, aspect=aspect, orthographic=True, border=0.1)

    corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    local = (corners - camera.eye) @ camera.pose[:3, :3]
    x, y = np.abs(local[:, 0]).max() / (camera.height * aspect / 2), np.abs(local[:, 1]).max() / (camera.height / 2)
    assert (local[:, 2] < 0).all()
    assert max(x, y) == pytest.approx(1 / 1.1)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))])
def test_copies_are_equal(duplicate):
    twin = duplicate(CAMERA)

    assert np.array_equal(twin.pose, CAMERA.pose)
    assert (twin.height, twin.fov_deg) == (CAMERA.height, 0)
    assert repr(twin) == repr(CAMERA)
    assert "orthographic" in repr(twin)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.Camera.orthographic((0, 0, 1), (0, 0, 0), height=0), "height"),
        (lambda: fb.Camera.orthographic((0, 0, 1), (0, 0, 0), height=-1), "height"),
        (lambda: fb.Camera.orthographic((0, 0, 1), (0, 0, 0), height=math.nan), "height"),
        (lambda: fb.Camera.orthographic((0, 0, 1), (0, 0, 0), height=None), "height"),
        (lambda: fb.Camera.orthographic((0, 0, 1), (0, 0, 1), height=1), "target"),
        (lambda: fb.Camera.from_pose(np.eye(4), height="tall"), "height"),
        (lambda: fb.sphere().to_html(camera=CAMERA), "perspective"),
        (lambda: fb.Camera.fit([(0, 0, 0), (1, 1, 1)], orthographic=1), "orthographic"),
    ],
)
def test_a_camera_that_cannot_be_used_is_refused(make, message):
    with pytest.raises(fb.SceneError, match=message):
        make()


def test_cameras_of_files_are_read_and_pages_use_a_perspective_one(tmp_path):
    path = tmp_path / "cameras.gltf"
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box()))
    for name, content in files.items():
        (tmp_path / name.replace("model.gltf", path.name)).write_bytes(content)
    document = json.loads(path.read_text())
    lens = {"xmag": 3, "ymag": 1.25, "znear": 0.1, "zfar": 10}
    document["cameras"] = [{"type": "orthographic", "orthographic": lens}]
    document["scenes"][0]["nodes"].append(len(document["nodes"]))
    document["nodes"].append({"translation": [0, 0, 3], "camera": 0})
    path.write_text(json.dumps(document))

    scene = fb.load_scene(path)

    (camera,) = scene.cameras
    assert camera.height == 2.5
    assert camera.eye == pytest.approx((0, 0, 3))
    frame = fb.render(scene, size=(24, 24), device="cpu")
    assert np.isfinite(frame.depth).sum() == 100
    assert not exceeds(np.abs(frame.depth[np.isfinite(frame.depth)] - 2.5), 1e-6).any()
    with pytest.warns(UserWarning, match="perspective"):
        assert "<script" in scene.to_html(size=(32, 32))


@pytest.mark.parametrize("shape", [fb.sphere(1), fb.sphere(0.5).offset(0.5)], ids=["closed form", "marched"])
def test_rays_that_start_inside_a_shape_hit_a_surface_that_faces_the_camera(shape, device):
    camera = fb.Camera.orthographic((0.1, 0.05, 0), (0.1, 0.05, -1), height=0.5)

    frame = fb.raymarch(shape, camera, size=(8, 8), device=device)

    assert (frame.depth == 0).all()
    assert np.abs(frame.normal - camera.pose[:3, 2]).max() <= 1e-6
