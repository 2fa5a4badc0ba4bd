"""Things without a dense grid on a graphics device: drawn and lit there, the CPU's picture."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from scenes import SUN, moved, plane
from test_scene_device import assert_same_picture

CAMERA = fb.Camera((2.5, 3, 5), (0, -0.3, 0), fov_deg=40)
PLACE = moved(y=0.2, scale=(1.3, 0.9, 1.0), turn=0.4)


def knot() -> fb.Volume:
    return fb.bake(fb.models.torus_knot(segments=96, sides=10), 48, device="cpu")


def bowl(**surface) -> fb.Quadric:
    return fb.Quadric.paraboloid(radius=0.8, height=0.7, **surface)


def quadrics() -> list[fb.Instance]:
    """Sheets that are open, that meet, and that let half of the light through."""
    half = [bowl(opacity=0.5), fb.Quadric.cylinder((0, 0, 0.9), 0.4, 0.8, opacity=0.5)]
    return [
        fb.Instance(half, PLACE),
        fb.Instance(fb.Quadric.hyperbolic_paraboloid((0.5, 0, 1.2)), moved(x=1.2, z=1, scale=(0.6,) * 3)),
        fb.Instance(fb.Quadric.sphere(), moved(x=-1.4, scale=(0.6, 0.4, 0.6)), opacity=0.6, visible=False),
    ]


def sparse() -> list[fb.Instance]:
    """The same field twice, once mirrored and squeezed."""
    field = knot().to_sparse()
    return [fb.Instance(field, PLACE), fb.Instance(field, moved(x=-1.8, z=1, scale=(-0.5, 0.5, 0.6)))]


#: What a scene holds besides the floor.
KINDS = {
    "quadrics": quadrics,
    "sparse": sparse,
    "sparse and quadrics": lambda: [*sparse(), *quadrics()],
}

LIGHTS = [
    fb.DirectionalLight(SUN, intensity=0.6, angle_deg=6),
    fb.PointLight((2, 4, 3), intensity=0.4, radius=0.3),
]


@pytest.mark.parametrize("shadows", ["hard", "soft"])
@pytest.mark.parametrize("name", KINDS)
def test_a_device_draws_and_lights_every_kind(name: str, shadows: str, gpu: str) -> None:
    scene = fb.Scene([*KINDS[name](), plane()], lights=LIGHTS)
    options = {"size": (80, 60), "shadows": shadows, "ambient_occlusion": shadows == "soft"}
    here, there = (fb.render(scene, CAMERA, **options, device=place) for place in ("cpu", gpu))
    # Nothing is left to the CPU.
    assert set(there.report["devices"].values()) == {there.report["device"]}
    assert (np.abs(here.shadow - there.shadow) > 1 / 255).mean() <= 0.005
    # There is something to agree about.
    assert (here.shadow < 0.8).sum() > 500
    assert_same_picture(here, there, scene)


@pytest.mark.parametrize("eye", [(0.1, 0.15, 0.05), (0, 40, 900)])
def test_a_device_sees_things_from_within_and_from_afar(eye: tuple[float, float, float], gpu: str) -> None:
    scene = fb.Scene([*KINDS["sparse and quadrics"](), plane()])
    camera = fb.Camera(eye, (0.5, 0, 0.4), fov_deg=95 if max(eye) < 1 else 0.4)
    here, there = (fb.render(scene, camera, size=(80, 60), shadows="none", device=at) for at in ("cpu", gpu))
    assert len(np.unique(here.object_id)) > 3
    assert_same_picture(here, there, scene)


def test_bricks_of_every_level_are_met_on_a_device(gpu: str) -> None:
    field = fb.bake_sparse(fb.models.gear(teeth=8), 160, tolerance=0.2)
    assert field.brick_counts[2] > 0
    scene = fb.Scene([fb.Instance(field, moved(y=0.4, turn=0.3)), plane()], lights=LIGHTS)
    here, there = (fb.render(scene, CAMERA, size=(64, 48), shadows="hard", device=place) for place in ("cpu", gpu))
    assert (here.shadow < 0.8).sum() > 100
    assert_same_picture(here, there, scene)


def test_light_goes_through_bricks_and_not_through_sheets(gpu: str) -> None:
    jade = fb.Material(color=(0.5, 0.9, 0.6), scattering=0.3)
    # Deep enough for bricks that are all inside.
    ball = fb.bake_sparse(fb.Mesh(*meshes.icosphere(3)), 96)
    things = [fb.Instance(ball, moved(x=-1.2), material=jade), fb.Instance(fb.Quadric.sphere(), moved(x=1.2), jade)]
    scene = fb.Scene([*things, plane()], lights=LIGHTS)
    here, there = (fb.render(scene, CAMERA, size=(64, 48), device=place) for place in ("cpu", gpu))
    assert_same_picture(here, there, scene)
