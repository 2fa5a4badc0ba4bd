"""Far rays: beyond a distance a merged field replaces the instances for shadows and occlusion."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from merged import CAMERA, floor, grove
from merged import GROVE_SUN as SUN
from scenes import moved, positions


def test_far_shadows_are_the_closed_form_but_for_a_voxel_at_their_edges():
    scene, balls, centers = grove()
    far = fb.merge(balls, 96)
    h = far.spacing.max()
    frame = fb.render(scene, CAMERA, size=(120, 90), shadows="hard", far=far, device="cpu")
    on_floor = frame.object_id == len(balls)
    p = positions(frame, CAMERA)[on_floor]
    to_light = -np.array(SUN) / np.linalg.norm(SUN)
    way = centers - p[:, None]
    along = (way * to_light).sum(-1, keepdims=True)
    clear = np.linalg.norm(way - along * to_light, axis=-1) - 0.5
    # The far part begins where the default says, and decides most of these.
    assert 0.5 < frame.report["far_rays"] / frame.report["rays"] <= 1
    decided = (np.abs(clear) > h).all(axis=1)
    assert decided.mean() > 0.5
    assert np.array_equal(frame.shadow[on_floor][decided], np.where((clear < 0).any(axis=1), 0.0, 1.0)[decided])


def test_beyond_all_of_the_scene_a_far_field_changes_nothing():
    scene, balls, _ = grove(12)
    far = fb.merge(balls, 32)
    options = {"size": (64, 48), "ambient_occlusion": 2.0, "device": "cpu"}
    without = fb.render(scene, CAMERA, **options)
    beyond = fb.render(scene, CAMERA, far=far, far_distance=100, **options)
    assert np.array_equal(without.color, beyond.color)
    assert beyond.report["far_rays"] == 0
    assert without.report["far_rays"] == 0
    assert without.report["rays"] == beyond.report["rays"] > 0


@pytest.mark.parametrize("shadows", ["hard", "soft"])
@pytest.mark.parametrize("distance", [0.0, 1.0, None])
def test_a_room_with_walls_of_two_voxels_stays_dark(shadows, distance, random):
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    turned = np.eye(4)
    turned[:3, :3] = q * np.sign(np.linalg.det(q))
    h = 0.15
    walls = meshes.join(
        meshes.box((-2, -2, -2), (2, 2, 2)),
        meshes.flip(meshes.box(*np.array([[-1], [1]]) * (2 - 2 * h) * np.ones(3))),
    )
    room = fb.Instance(fb.Mesh(*walls), turned, resolution=64)
    corner = np.full(3, 4.05)
    far = fb.merge([room], int(2 * corner[0] / h), bounds=[-corner, corner])
    assert far.spacing.max() == pytest.approx(h)
    lights = [fb.DirectionalLight(SUN, angle_deg=5), fb.PointLight((6, 7, 5), radius=0.5)]
    eye, target = (turned[:3, :3] @ np.array(p) for p in ((1.2, 0.9, 1.4), (-1, -0.8, -1)))
    frame = fb.render(
        fb.Scene([room], lights=lights),
        fb.Camera(eye, target, fov_deg=80),
        size=(64, 48),
        shadows=shadows,
        far=far,
        far_distance=distance,
        device="cpu",
    )
    assert np.isfinite(frame.depth).all()
    assert frame.shadow.max() == 0


def test_what_the_far_field_does_not_hold_still_throws_shadows():
    scene, balls, _ = grove(30)
    # Its box ends in the middle of the grove.
    far = fb.merge(balls, 48, bounds=[(-6.6, 0.0, -6.6), (0.0, 4.1, 6.6)])
    options = {"size": (96, 72), "shadows": "hard", "device": "cpu"}
    without = fb.render(scene, CAMERA, **options)
    half = fb.render(scene, CAMERA, far=far, far_distance=0.5, **options)
    assert half.report["far_rays"] > 0
    # To where x > 0 no light comes through the box: the sun stands at +x.
    aside = positions(without, CAMERA)[..., 0] > 0.0
    assert np.array_equal(without.shadow[aside], half.shadow[aside])
    assert (without.shadow[aside] == 0).sum() > 200
    assert (without.shadow != half.shadow).mean() < 0.05


def test_translucent_objects_keep_their_share():
    ball = fb.bake(fb.Mesh(*meshes.icosphere(3)), 32)
    opaque = fb.Instance(ball, moved(5, 4, 0))
    glass = fb.Instance(ball, moved(-5, 4, 0), opacity=0.25)
    scene = fb.Scene([opaque, glass, floor(12)], lights=[fb.DirectionalLight((0, -1, 0))])
    far = fb.merge([opaque], 32)
    camera = fb.Camera((0, 9, 14), (0, 0, 0), fov_deg=60)
    frame = fb.render(scene, camera, size=(96, 64), shadows="hard", far=far, far_distance=0.5, device="cpu")
    p = positions(frame, camera)
    on_floor = frame.object_id == 2
    assert set(np.unique(frame.shadow[on_floor])) == {0.0, 0.75, 1.0}
    under_glass = on_floor & (np.hypot(p[..., 0] + 5, p[..., 2]) < 0.9)
    assert under_glass.sum() > 8
    assert (frame.shadow[under_glass] == 0.75).all()


@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_devices_agree(shadows, gpu):
    scene, balls, _ = grove(12, angle_deg=3)
    far = fb.merge(balls, 32)
    options = {"size": (48, 32), "shadows": shadows, "ambient_occlusion": 2.0, "far": far, "far_distance": 1.0}
    cpu, device = (fb.render(scene, CAMERA, device=place, **options) for place in ("cpu", gpu))
    assert np.isclose(cpu.shadow, device.shadow, atol=1e-3).mean() > 0.998
    assert np.isclose(cpu.color, device.color, atol=2e-3).mean() > 0.998
    for count in ("rays", "far_rays"):
        assert device.report[count] == pytest.approx(cpu.report[count], rel=0.01)
    # The scene that is there serves pictures without a far field, and another one.
    without = fb.render(scene, CAMERA, size=(48, 32), shadows=shadows, device=gpu)
    assert without.report["far_rays"] == 0
    other = fb.render(scene, CAMERA, device=gpu, **{**options, "far": fb.merge(balls, 16)})
    assert other.report["far_rays"] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"far": 3}, "far: must be a Volume"),
        ({"far_distance": 1.0}, "far_distance: needs far"),
        ({"far": "field", "far_distance": -1}, "far_distance: must be"),
        ({"far": "field", "far_distance": float("nan")}, "far_distance: must be"),
    ],
)
def test_mistakes_are_told(options, message):
    scene, balls, _ = grove(1)
    if options.get("far") == "field":
        options = {**options, "far": fb.merge(balls, 8)}
    with pytest.raises(fb.SceneError, match=message):
        fb.render(scene, size=(8, 8), device="cpu", **options)
