"""Objects without a dense grid on a graphics device: they are drawn and lit there, with the picture of the CPU."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import exceeds
from pictures import assert_same_picture
from scenes import SUN, moved, plane

CAMERA = fb.Camera((2.5, 3, 5), (0, -0.3, 0), fov_deg=40)
PLACE = moved(y=0.2, scale=(1.3, 0.9, 1.0), turn=0.4)


def knot() -> fb.Volume:
    return fb.bake(fb.models.torus_knot(segments=96, sides=10), 48, device="cpu")


def bowl(**surface) -> fb.Quadric:
    return fb.Quadric.paraboloid(radius=0.8, height=0.7, **surface)


def quadrics() -> list[fb.Instance]:
    """Quadrics that are open, that intersect, and that transmit half of the light."""
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


def nested() -> list[fb.Instance]:
    """Two finer levels around one end of the knot, and a mirrored copy."""
    field = fb.merge([knot()], 24, levels=3, center=(0.5, 0.2, 0.2))
    return [fb.Instance(field, PLACE), fb.Instance(field, moved(x=-1.8, z=1, scale=(-0.5, 0.5, 0.6)))]


def shapes() -> list[fb.Instance]:
    """Smooth joints and profiles, whose fields are bounds; an exact one, which lets light through; paint."""
    tube = (fb.cylinder(radius=0.8, height=1.6).shell(0.2) - fb.box((0.7, 3, 0.7))).smooth(0.1)
    star = fb.extrude(fb.polygon([(0, 0), (0.6, 0.1), (0.2, 0.7)]), 1.5).paint((0.8, 0.3, 0.1)) | fb.torus(0.7, 0.15)
    return [
        fb.Instance(tube, PLACE),
        fb.Instance(star, moved(x=1.5, z=1, scale=(0.5,) * 3)),
        fb.Instance(star.scale(0.7), moved(x=-1.6, z=1.2, scale=(0.6,) * 3), opacity=0.5, visible=False),
    ]


#: Objects of a scene besides the floor.
KINDS = {
    "quadrics": quadrics,
    "sparse": sparse,
    "sparse and quadrics": lambda: [*sparse(), *quadrics()],
    "nested": nested,
    "shapes": shapes,
    "all": lambda: [
        *quadrics(),
        fb.Instance(nested()[0].geometry, moved(x=1.8, z=1.8, scale=(0.4,) * 3)),
        *(fb.Instance(item.geometry, item.transform @ moved(x=0.8, z=-1.2)) for item in (*sparse()[:1], *shapes()[:1])),
        fb.Instance(knot(), moved(x=-1.6, z=1.2, scale=(0.5,) * 3)),
    ],
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
    assert exceeds(np.abs(here.shadow - there.shadow), 1 / 255).mean() <= 0.005
    # There is something to agree about.
    assert (here.shadow < 0.8).sum() > 500
    assert_same_picture(here, there, scene)


@pytest.mark.parametrize("eye", [(0.1, 0.15, 0.05), (0, 40, 900)])
def test_a_device_sees_objects_from_within_and_from_afar(eye: tuple[float, float, float], gpu: str) -> None:
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


def test_shapes_are_met_as_the_parts_of_the_cpu(gpu: str) -> None:
    # A hit is a root, whichever way it was found; the colours of the parts are the CPU's.
    die = (fb.rounded_box((2, 2, 2), 0.25) & fb.sphere(1.38)).paint((0.8, 0.7, 0.6)) - fb.cylinder(0.6, 4).paint(
        (0.1, 0.3, 0.3)
    )
    scene = fb.Scene([fb.Instance(die, moved(turn=0.5))])
    for eye in ((2.5, 3, 5), (0.1, 0.2, 0.1), (0.8, 0, 0.1)):
        camera = fb.Camera(eye, (0, 0, 0.01))
        here, there = (fb.render(scene, camera, size=(64, 48), shadows="none", device=at) for at in ("cpu", gpu))
        assert there.report["devices"]["primary"] == there.report["device"]
        assert_same_picture(here, there, scene)


def test_what_no_device_knows_is_left_to_the_cpu(gpu: str) -> None:
    lattice = fb.box_frame((2, 2, 2), 0.1).repeat((0.4, 0.4, 0.4), (4, 4, 4)).scale(0.5) & fb.sphere(1)
    holds_samples = fb.volume_shape(knot()) | fb.sphere(0.5)
    for geometry in (lattice, holds_samples):
        scene = fb.Scene([fb.Instance(geometry), plane()], lights=LIGHTS)
        here, there = (fb.render(scene, CAMERA, size=(40, 30), device=place) for place in ("cpu", gpu))
        device = there.report["device"]
        assert there.report["devices"] == {"primary": f"{device} and cpu", "light": "cpu"}
        assert_same_picture(here, there, scene)


def test_light_goes_through_bricks_and_not_through_sheets(gpu: str) -> None:
    jade = fb.Material(color=(0.5, 0.9, 0.6), scattering=0.3)
    # Deep enough for bricks that are all inside.
    ball = fb.bake_sparse(fb.Mesh(*meshes.icosphere(3)), 96)
    geometries = [fb.Instance(ball, moved(x=-1.2), material=jade), fb.Instance(fb.Quadric.sphere(), moved(x=1.2), jade)]
    scene = fb.Scene([*geometries, plane()], lights=LIGHTS)
    here, there = (fb.render(scene, CAMERA, size=(64, 48), device=place) for place in ("cpu", gpu))
    assert_same_picture(here, there, scene)
