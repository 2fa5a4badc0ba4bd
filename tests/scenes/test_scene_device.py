"""Scenes on a graphics device: the picture agrees with the picture of the CPU."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import exceeds
from pictures import assert_same_picture
from scenes import SUN, moved, plane


@pytest.mark.parametrize("light_scale", [1, 2])
@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
def test_a_graphics_device_sees_the_same_light(shadows: str, light_scale: int, gpu: str) -> None:
    knot = fb.models.torus_knot(segments=120, sides=12)
    glass = fb.bake(meshes.icosphere(3), 32, device="cpu")
    jade = fb.Material(color=(0.5, 0.9, 0.6), scattering=0.3)
    scene = fb.Scene(
        [
            fb.Instance(knot, moved(y=1, scale=(1.2, 0.8, 1.0), turn=0.3), resolution=48),
            fb.Instance(glass, moved(x=1.5, z=1, scale=(0.6, 0.6, 0.6)), opacity=0.7),
            fb.Instance(fb.Mesh(*meshes.box((-2, -1, 0.5), (-1, 0.2, 1))), material=jade, resolution=32),
            plane(),
        ],
        lights=[
            fb.DirectionalLight(SUN, intensity=0.6, angle_deg=6),
            fb.PointLight((2, 4, 3), intensity=0.4, radius=0.3),
        ],
    )
    camera = fb.Camera((3, 3.5, 6), (0, 0, 0))
    options = {"size": (80, 60), "shadows": shadows, "ambient_occlusion": shadows == "soft", "area_samples": 9}
    options |= {"light_scale": light_scale, "samples": 4 if shadows == "hard" else 1}
    here, there = (fb.render(scene, camera, **options, device=place) for place in ("cpu", gpu))
    assert there.report["devices"]["light"] != "cpu"
    assert exceeds(np.abs(here.shadow - there.shadow), 1 / 255).mean() <= 0.005
    assert_same_picture(here, there, scene)


VIEWS = {
    "from outside": fb.Camera((0, 0.5, 8), (-0.5, 0, 0), fov_deg=35),
    "from inside": fb.Camera((0, 0.2, 0.1), (-0.5, 0, 0), fov_deg=95),
    "from among them": fb.Camera((-1.2, 0.1, 1.2), (2, 0, -0.3), fov_deg=95),
    "from far away": fb.Camera((100, 350, 600), (-0.5, 0, 0), fov_deg=0.6),
}


@pytest.mark.parametrize("primary", ["auto", "raymarch"])
@pytest.mark.parametrize("view", VIEWS)
def test_a_graphics_device_sees_the_same_surfaces(view: str, primary: str, gpu: str) -> None:
    knot = fb.models.torus_knot(segments=96, sides=10)
    ball = fb.bake(meshes.icosphere(4), 48, device="cpu")
    cut = fb.bake(meshes.icosphere(3), 32, bounds=[(-0.8, -0.8, -0.8), (0.8, 0.8, 0.8)], device="cpu")
    box = fb.Mesh(*meshes.box((-0.6, -0.6, -0.6), (0.6, 0.6, 0.6)))
    scene = fb.Scene(
        [
            fb.Instance(ball),
            fb.Instance(box, moved(x=0.9, turn=0.3), resolution=24),
            fb.Instance(knot, moved(x=2.2, scale=(-0.4, 0.5, 0.4)), resolution=32),
            fb.Instance(cut, moved(x=-2.5, scale=(1, -1, 1.3))),
            fb.Instance(box, moved(y=1.3, turn=0.4), opacity=0.5, resolution=24),
            fb.Instance(ball, moved(x=0.4, z=2.5, scale=(0.4, 0.4, 0.4)), opacity=0.6),
            fb.Instance(box, moved(y=-1, scale=(9, 0.1, 9)), visible=False),
        ]
    )
    options = {"size": (120, 90), "primary": primary, "shadows": "none", "samples": 4 if primary == "auto" else 1}
    here, there = (fb.render(scene, VIEWS[view], **options, device=place) for place in ("cpu", gpu))
    assert len(np.unique(here.object_id)) > 3 or view == "from inside"
    assert_same_picture(here, there, scene)
    # The CPU draws translucent surfaces, and the report names it.
    assert here.report["devices"]["primary"] == "cpu"
    assert there.report["devices"]["primary"] == f"{there.report['device']} and cpu"


@pytest.mark.parametrize("name", ["foliage_cards.glb", "AlphaBlendModeTest.glb", "CesiumMilkTruck.glb"])
def test_a_graphics_device_cuts_masks_and_draws_textures(name: str, model_path, gpu: str) -> None:
    scene = fb.load_scene(model_path(name))
    camera = fb.Camera.fit(scene.bounds)
    here, there = (fb.render(scene, camera, size=(128, 128), shadows="none", device=at) for at in ("cpu", gpu))
    assert np.isfinite(here.depth).mean() > 0.05
    assert_same_picture(here, there, scene)


@pytest.mark.parametrize("name", ["spot/spot.obj", "suzanne.obj", "stanford-bunny.obj"])
def test_a_graphics_device_draws_meshes_whole(name: str, model_path, gpu: str) -> None:
    scene = fb.Scene([fb.load_mesh(model_path(name))])
    camera = fb.Camera.fit(scene.bounds)
    here, there = (fb.render(scene, camera, size=(256, 256), shadows="none", device=at) for at in ("cpu", gpu))
    assert there.report["devices"]["primary"] == there.report["device"]
    assert_same_picture(here, there, scene)


@pytest.mark.parametrize("size", [(24, 18), (160, 120)])
@pytest.mark.parametrize("light", ["sun", "lamp", "both", "lamp and far field"])
def test_neighbours_that_share_a_search_find_all_occluders(light: str, size: tuple[int, int], gpu: str) -> None:
    """Many small objects over a floor. In the small picture neighbouring pixels lie on different objects.

    A translucent occluder that a search visits twice would darken the picture.
    """
    box = fb.Mesh(*meshes.box((-0.07, -0.2, -0.07), (0.07, 0.2, 0.07)))
    random = np.random.default_rng(4)
    boxes = [
        fb.Instance(
            box,
            moved(x=x, y=random.uniform(0, 1), z=z, turn=random.uniform(0, 3)),
            resolution=12,
            opacity=random.choice([0.5, 1, 1]),
        )
        for x in np.linspace(-3, 3, 15)
        for z in np.linspace(-3, 3, 15)
    ]
    floor = fb.Mesh(*meshes.box((-4, -0.7, -4), (4, -0.5, 4)))
    sun = fb.DirectionalLight(SUN, angle_deg=4)
    lamp = fb.PointLight((0.5, 1.6, -0.3), radius=0.2)
    lights = {"sun": [sun], "lamp": [lamp], "both": [lamp, sun], "lamp and far field": [lamp]}[light]
    scene = fb.Scene([*boxes, fb.Instance(floor, resolution=32)], lights=lights)
    far = fb.merge([box for box in boxes if box.opacity == 1], 24, device="cpu") if "far" in light else None
    camera = fb.Camera((1, 4, 7), (0, 0, 0))
    here, there = (fb.render(scene, camera, size=size, far=far, device=place) for place in ("cpu", gpu))
    assert there.report["devices"]["light"] != "cpu"
    assert 0.02 < (here.shadow[np.isfinite(here.depth)] < 0.5).mean() < 0.98
    assert exceeds(np.abs(here.shadow - there.shadow), 1 / 255).mean() <= 0.005


@pytest.mark.parametrize("is_sparse", [False, True])
@pytest.mark.parametrize("scale", [(2.5, 0.4, 1), (0.4, 1.5, 2.5)])
def test_stretched_objects_have_the_same_penumbrae(
    scale: tuple[float, float, float], is_sparse: bool, gpu: str
) -> None:
    """Under a non-uniform scale the gradient of a field converts its distances to the scene."""
    knot = fb.bake(fb.models.torus_knot(segments=96, sides=10), 40, device="cpu")
    field = knot.to_sparse() if is_sparse else knot
    objects = [fb.Instance(field, moved(x=x, y=1.2, scale=scale, turn=0.7)) for x in (-1.5, 1.5)]
    scene = fb.Scene([*objects, plane()], lights=[fb.DirectionalLight(SUN, angle_deg=12)])
    here, there = (fb.render(scene, fb.Camera((3, 5, 6), (0, 0, 0)), size=(96, 72), device=at) for at in ("cpu", gpu))
    assert there.report["devices"]["light"] == there.report["device"]
    assert ((here.shadow > 0.1) & (here.shadow < 0.9)).mean() > 0.05
    assert exceeds(np.abs(here.shadow - there.shadow), 1 / 255).mean() <= 0.005
