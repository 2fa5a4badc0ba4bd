"""Renderers: frames of one scene, and the data that is kept between them."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fieldbake as fb
import meshes
from fieldbake.drawing.frame import ARRAYS
from scenes import SUN, moved, plane

#: Memory of this process, in pages.
STATM = Path("/proc/self/statm")

CAMERA = fb.Camera((3, 2.5, 5), (0, 0, 0))
SIZE = (48, 36)


def assert_equal(one: fb.Frame, other: fb.Frame) -> None:
    for name in ARRAYS:
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@pytest.fixture(scope="module")
def instances() -> list[fb.Instance]:
    knot = fb.models.torus_knot(segments=60, sides=8)
    ball = fb.bake(meshes.icosphere(2), 16, device="cpu")
    quadrics = [fb.Quadric.sphere((0, 0, 0), 0.4), fb.Quadric.sphere((0.5, 0, 0), 0.3)]
    return [
        fb.Instance(knot, moved(y=0.4, turn=0.3), resolution=24),
        fb.Instance(ball, moved(x=-1.5, scale=(0.5, 0.5, 0.5))),
        fb.Instance(quadrics, moved(x=1.6, y=-0.4)),
        fb.Instance(plane()),
    ]


@pytest.fixture(scope="module")
def scene(instances: list[fb.Instance]) -> fb.Scene:
    return fb.Scene(instances, lights=[fb.DirectionalLight(SUN, angle_deg=4)])


@pytest.mark.parametrize("options", [{}, {"shadows": "hard", "ambient_occlusion": True, "samples": 4}])
def test_frames_are_the_pictures_of_render(scene, instances, options, device) -> None:
    renderer = fb.Renderer(scene, size=SIZE, device=device, **options)
    options = {"size": SIZE, "device": device, **options}
    first = renderer.frame(CAMERA)
    assert_equal(first, fb.render(scene, CAMERA, **options))

    transforms = np.stack([instance.transform for instance in instances])
    transforms[0] = moved(x=0.3, y=1.1, turn=1.0, scale=(1.2, 0.9, 1.0))
    transforms[2] = moved(x=1.1, z=0.8)
    there = [fb.Instance(i.geometry, t, resolution=24) for i, t in zip(instances, transforms, strict=True)]
    expected = fb.render(fb.Scene(there, scene.lights), CAMERA, **options)
    assert_equal(renderer.frame(CAMERA, transforms=transforms), expected)
    a_list = [transforms[0], None, transforms[2].tolist(), None]
    assert_equal(renderer.frame(CAMERA, transforms=a_list), expected)

    # A translucent floor is a sheet, and a translucent knot is found by the CPU.
    glass = fb.Material(color=(0.2, 0.5, 0.9, 0.5))
    materials = [glass, None, fb.Material(color=(1, 0, 0)), glass]
    lights = [fb.PointLight((2, 4, 2), radius=0.2), fb.DirectionalLight((1, -1, 0), intensity=0.3)]
    seen = [fb.Instance(i.geometry, i.transform, m, resolution=24) for i, m in zip(instances, materials, strict=True)]
    both = [
        fb.Instance(i.geometry, t, m, resolution=24) for i, t, m in zip(instances, transforms, materials, strict=True)
    ]
    assert_equal(renderer.frame(CAMERA, lights, None, materials), fb.render(fb.Scene(seen, lights), CAMERA, **options))
    frame = renderer.frame(CAMERA, lights, transforms, materials)
    assert_equal(frame, fb.render(fb.Scene(both, lights), CAMERA, **options))
    assert not np.array_equal(frame.color, first.color)

    # The arguments of a frame are valid for that frame only.
    assert_equal(renderer.frame(CAMERA), first)


@pytest.mark.parametrize(
    "options",
    [{}, {"shadows": "hard", "ambient_occlusion": True}, {"bounces": 1}, {"light_scale": 2}, {"far_distance": 0.5}],
)
def test_stages_without_changes_are_reused(instances, options, device) -> None:
    scene = fb.Scene(instances)
    if "far_distance" in options:
        options = {**options, "far": fb.merge(instances[:2], 24)}
    renderer = fb.Renderer(scene, size=SIZE, device=device, **options)
    sun = fb.DirectionalLight(SUN, angle_deg=4)
    lamp = fb.SpotLight((2, 4, 2), (-1, -2, -1), radius=0.2, outer_deg=60)
    glow = fb.Material(color=(0.9, 0.7, 0.5), scattering=0.3)
    unchanged, moves = [None] * 4, [None, moved(x=-1.4), None, None]
    surfaces, both = ["primary"], ["primary", "light"]
    # Each frame changes the frame before in one way.
    arguments: dict[str, Any] = {"camera": CAMERA, "lights": [sun, lamp]}
    for change, reused in [
        ({}, []),
        ({}, both),
        ({"materials": unchanged}, both),
        ({"transforms": unchanged}, both),
        ({"lights": [replace(sun, color=(1, 0, 0)), lamp]}, both),
        ({"lights": [sun, replace(lamp, intensity=3, range=20, direction=(-1, -2, -0.5))]}, both),
        ({"lights": [sun, lamp]}, both),
        ({"lights": [replace(sun, angle_deg=20), lamp]}, surfaces),
        ({"lights": [replace(sun, angle_deg=20, direction=(0.3, -1, 0.2)), lamp]}, surfaces),
        ({"lights": [sun, lamp]}, surfaces),
        ({"lights": [sun, replace(lamp, position=(2, 3, 2))]}, surfaces),
        ({"lights": [sun, replace(lamp, position=(2, 3, 2), radius=0.6)]}, surfaces),
        ({"lights": [sun]}, surfaces),
        ({"lights": []}, surfaces),
        ({"lights": [sun]}, surfaces),
        ({"materials": [glow, None, None, None]}, []),
        ({}, both),
        ({"transforms": moves}, []),
        ({}, both),
        ({"transforms": unchanged}, []),
        ({"camera": fb.Camera((1, 2, 5), (0, 0, 0))}, []),
    ]:
        arguments.update(change)
        frame = renderer.frame(**arguments)
        assert frame.report["reused"] == reused, change
        expected = fb.Renderer(scene, size=SIZE, device=device, **options).frame(**arguments)
        assert_equal(frame, expected)
        for name in ("rays", "far_rays", "devices"):
            assert frame.report[name] == expected.report[name]


def test_large_frames_are_not_kept(instances) -> None:
    # One surface and 16 lights have 348 bytes for each pixel.
    lights = [fb.DirectionalLight((0.1 * i, -1, 0)) for i in range(16)]
    top = fb.Camera.orthographic((0, 3, 0), (0, 0, 0), (0, 0, 1), height=1.0)
    for size, reused in [((700, 700), ["primary", "light"]), ((1000, 900), [])]:
        renderer = fb.Renderer(instances[3], size=size, device="cpu", shadows="none")
        assert np.isfinite(renderer.frame(top, lights).depth).all()
        assert renderer.frame(top, lights).report["reused"] == reused


def test_render_keeps_no_picture(scene) -> None:
    assert [fb.render(scene, CAMERA, size=SIZE, device="cpu").report["reused"] for _ in range(2)] == [[], []]


def test_frames_with_several_samples_for_a_pixel_reuse_its_centre(scene) -> None:
    renderer = fb.Renderer(scene, size=SIZE, device="cpu", samples=4)
    first = renderer.frame(CAMERA)
    second = renderer.frame(CAMERA)
    assert second.report["reused"] == ["primary", "light"]
    assert second.report["rays"] == first.report["rays"]
    assert_equal(first, second)


@pytest.mark.parametrize("samples", [4, 16])
def test_other_lights_on_frames_with_several_samples_are_new_light(scene, device, samples) -> None:
    """The passes of the samples overwrite the surfaces of the centres on a device."""
    lights = [fb.PointLight((2, 3, 1), radius=0.2)]
    renderer = fb.Renderer(scene, size=SIZE, device=device, samples=samples)
    renderer.frame(CAMERA)
    frame = renderer.frame(CAMERA, lights)
    assert frame.report["reused"] == (["primary"] if device == "cpu" else [])
    assert_equal(frame, fb.Renderer(scene, size=SIZE, device=device, samples=samples).frame(CAMERA, lights))


def test_defaults_are_those_of_the_scene(instances) -> None:
    plain, other = fb.Scene(instances), fb.Camera((0, 6, 1), (0, 0, 0))
    renderer = fb.Renderer(plain, size=SIZE, device="cpu", ambient_occlusion=True)
    options = {"size": SIZE, "device": "cpu", "ambient_occlusion": True}
    assert_equal(renderer.frame(), fb.render(plain, **options))
    # The default light belongs to the camera.
    assert_equal(renderer.frame(other), fb.render(plain, other, **options))
    # The default camera and the range of occlusion follow the bounds of the frame.
    transforms = [moved(y=3), None, None, None]
    there = [fb.Instance(instances[0].geometry, moved(y=3), resolution=24), *instances[1:]]
    assert_equal(renderer.frame(transforms=transforms), fb.render(fb.Scene(there), **options))
    with_camera = fb.Scene(instances, cameras=[other])
    assert_equal(fb.Renderer(with_camera, size=SIZE, device="cpu").frame(), fb.render(plain, other, size=SIZE))
    assert fb.Renderer(instances[0], device="cpu").size == (512, 512)
    assert fb.Renderer([plane(), instances[1]], size=(8, 8)).frame().size == (8, 8)


def test_the_cpu_transfers_nothing(scene) -> None:
    renderer = fb.Renderer(scene, size=(8, 6), device="cpu")
    renderer.frame()
    assert renderer.counters == {"uploads": 0, "upload_bytes": 0, "submits": 0, "readbacks": 0}


def test_a_report_has_the_time_of_each_stage(scene, device) -> None:
    frame = fb.Renderer(scene, size=(8, 6), device=device).frame()
    stages = frame.report["milliseconds"]
    assert set(stages) == {"primary", "light"} | ({"upload"} if device == "gpu" else set())
    assert min(stages.values()) > 0
    assert frame.report["seconds"] == pytest.approx(sum(stages.values()) / 1e3)


def test_a_report_has_the_times_on_the_device(scene, device) -> None:
    frame = fb.Renderer(scene, size=(64, 48), device=device).frame()
    stages = frame.report["device_milliseconds"]
    if device == "cpu":
        assert stages == {}
        return
    if not stages and "llvmpipe" not in frame.report["device"]:
        pytest.skip("the device has no timestamps")
    assert {"primary", "cones"} <= set(stages) <= {"primary", "beams", "rays", "cones", "parts", "edges", "thicknesses"}
    assert all(time >= 0 for time in stages.values())
    passes = frame.report["milliseconds"]
    assert 0 < stages["cones"] <= sum(stages.values()) <= passes["primary"] + passes["light"]


def turntable(count: int):
    for i in range(count):
        angle = 2 * np.pi * i / count
        yield fb.Camera((5 * np.sin(angle), 2, 5 * np.cos(angle)), (0, 0, 0))


def memory() -> int:
    """Resident memory of this process, bytes."""
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not STATM.exists(), reason="needs /proc")
def test_a_turntable_keeps_its_memory(scene, device) -> None:
    count = 100 if device == "cpu" else 30
    renderer = fb.Renderer(scene, size=(64, 48), device=device)
    frames = renderer.frames(turntable(count))
    first = next(frames)
    copies = {name: getattr(first, name).copy() for name in ARRAYS}
    for frame in itertools.islice(frames, count // 5):
        assert not np.shares_memory(frame.color, first.color)
    before = memory()
    assert sum(1 for _ in frames) == count - 1 - count // 5
    # The arrays of one frame have 64 * 48 * 44 bytes, 0.14 MB: 24 leaked frames would exceed the bound.
    assert memory() - before <= 3 << 20
    assert all(np.array_equal(getattr(first, name), copies[name]) for name in ARRAYS)


def test_frames_are_drawn_when_the_iterator_is_advanced(scene) -> None:
    taken = []
    cameras = (taken.append(i) or fb.Camera((i + 3, 2, 4), (0, 0, 0)) for i in itertools.count())
    frames = fb.Renderer(scene, size=(8, 6), device="cpu", shadows="none").frames(cameras)
    assert taken == []
    one, two = next(frames), next(frames)
    assert taken == [0, 1]
    assert not np.array_equal(one.depth, two.depth)
    assert list(fb.Renderer(scene, size=(8, 6), device="cpu").frames([])) == []


def test_an_interrupted_frame_leaves_the_renderer_usable(scene, device) -> None:
    class InterruptedFrameError(Exception):
        pass

    is_interrupted = [True]

    def progress(fraction: float) -> None:
        if is_interrupted[0]:
            raise InterruptedFrameError

    renderer = fb.Renderer(scene, size=SIZE, device=device, progress=progress)
    with pytest.raises(InterruptedFrameError):
        renderer.frame(CAMERA)
    is_interrupted[0] = False
    assert_equal(renderer.frame(CAMERA), fb.render(scene, CAMERA, size=SIZE, device=device))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"camera": "front"}, "camera: must be a Camera"),
        ({"lights": [1]}, r"lights\[0\]: must be a PointLight"),
        ({"lights": fb.PointLight((0, 1, 0))}, "lights: must be a list"),
        ({"lights": [fb.PointLight((0, 1, 0))] * 17}, "lights: at most 16, got 17"),
        ({"transforms": np.eye(4)}, r"transforms: must have shape \(4, 4, 4\)"),
        ({"transforms": [np.eye(4)] * 3}, "transforms: must have 4 items, one for each instance of the scene, got 3"),
        ({"transforms": np.stack([np.eye(4)] * 5)}, r"transforms: must have shape \(4, 4, 4\)"),
        ({"transforms": [np.eye(4), np.eye(3), None, None]}, r"transforms\[1\]: must have shape \(4, 4\)"),
        ({"transforms": [np.eye(4), np.zeros((4, 4)), None, None]}, r"transforms\[1\]: the last row"),
        ({"transforms": [None, None, np.diag([1, 1, 0, 1.0]), None]}, r"transforms\[2\]: cannot be undone"),
        ({"transforms": np.full((4, 4, 4), np.nan)}, r"transforms\[0\]: must be finite"),
        (
            {"transforms": np.stack([np.eye(4), np.eye(4), np.zeros((4, 4)), np.ones((4, 4))])},
            r"transforms\[2\]: the last row",
        ),
        (
            {"transforms": np.stack([np.eye(4), np.eye(4), np.eye(4), np.diag([1, 0, 1, 1.0])])},
            r"transforms\[3\]: cannot",
        ),
        ({"transforms": "none"}, "transforms: must"),
        ({"transforms": 1j * np.stack([np.eye(4)] * 4)}, "transforms: must"),
        ({"materials": [None] * 3}, "materials: must have 4 items, one for each instance of the scene, got 3"),
        ({"materials": [fb.Material()] * 5}, "materials: must have 4 items"),
        ({"materials": [None, "red", None, None]}, r"materials\[1\]: must be a Material"),
        ({"materials": fb.Material()}, "materials: must be a list"),
        ({"materials": "none"}, "materials: must be a list"),
    ],
)
def test_mistakes_in_a_frame_name_the_argument(scene, arguments, message) -> None:
    renderer = fb.Renderer(scene, size=(8, 6), device="cpu")
    with pytest.raises(fb.SceneError, match=message):
        renderer.frame(**arguments)


def test_mistakes_in_options_are_found_when_the_renderer_is_made(scene) -> None:
    for options, message in [
        ({"size": 5}, "size: must be"),
        ({"size": (0, 4)}, "size: must be"),
        ({"shadows": "dark"}, "shadows: must be one of"),
        ({"samples": 0}, "samples: must be"),
        ({"ambient_occlusion": -1}, "ambient_occlusion: must be"),
        ({"far_distance": 3}, "far_distance: needs far"),
    ]:
        with pytest.raises(fb.SceneError, match=message):
            fb.Renderer(scene, **options)
    with pytest.raises(fb.DeviceError, match="no such device"):
        fb.Renderer(scene, device="no such device")
    with pytest.raises(fb.SceneError):
        fb.Renderer([])
    with pytest.raises(TypeError):
        fb.Renderer(scene, (8, 8))
    renderer = fb.Renderer(scene, size=(8, 6), device="cpu")
    with pytest.raises(fb.SceneError, match="cameras: must be an iterable"):
        renderer.frames(CAMERA)
    with pytest.raises(fb.SceneError, match=r"cameras\[1\]: must be a Camera"):
        list(renderer.frames([CAMERA, None]))


@pytest.mark.parametrize("shadows", ["none", "soft"])
def test_a_second_frame_uploads_the_camera_only(instances, shadows, gpu) -> None:
    scene = fb.Scene([instances[0], instances[0], instances[3]], lights=[fb.DirectionalLight(SUN, angle_deg=4)])
    renderer = fb.Renderer(scene, size=SIZE, device=gpu, shadows=shadows)
    assert renderer.counters["uploads"] == 0
    renderer.frame(CAMERA)
    assert renderer.counters["upload_bytes"] > 30_000

    def cost(**arguments) -> dict[str, int]:
        before = renderer.counters
        renderer.frame(**arguments)
        return {name: count - before[name] for name, count in renderer.counters.items()}

    # A row of 160 bytes for each instance that the pass draws. With shadows also the view of 608 bytes, and 16 for each
    # submission of the light pass. It makes more than one only if a picture takes half a second.
    found = cost(camera=fb.Camera((1, 2, 5), (0, 0, 0)))
    passes = 1 if shadows == "none" else 2
    assert passes <= found["submits"] <= 5
    assert found["readbacks"] == passes
    view = 3 * 160 + (0 if shadows == "none" else 608 + 16 * 4)
    assert found["upload_bytes"] <= view
    # One instance moves inside the bounds of the scene: a row of 272 bytes, and nodes of the tree of 32 bytes.
    transforms = [None, moved(x=-1.4, y=0.2, scale=(0.5, 0.5, 0.5)), None]
    assert cost(transforms=transforms)["upload_bytes"] <= view + 272 + 5 * 32 + 3 * 4
    assert cost(transforms=transforms)["upload_bytes"] <= view
