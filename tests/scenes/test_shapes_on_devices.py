"""Shapes of scenes on a device: functions for their structures, and rays through their parts for all other shapes."""

import numpy as np
import pytest

import fieldbake as fb
from compare import exceeds
from scenes import SUN, moved, plane

CAMERA = fb.Camera((2.5, 7.0, 5.0), (0.6, -1.0, 0.2), fov_deg=40)


def knot() -> fb.Shape:
    """A shape with a baked volume as a leaf."""
    return (fb.box((3, 3, 3)) & fb.bake(fb.models.torus_knot(), 24)) - fb.sphere(0.4)


SHAPES = {
    # More tokens than a function has, and few enough leaves that distances are evaluated.
    "many tokens": lambda: fb.box_frame((2, 2, 2), 0.1).repeat((0.5, 0.5, 0.5), (3, 3, 4)).scale(0.6) & fb.sphere(0.9),
    # So many leaves that cones are tested by thin rays.
    "many leaves": lambda: fb.sphere(0.15).repeat((0.4, 0.4, 0.4), (4, 4, 4)) & fb.box((1.2, 1.2, 1.2)),
    "blended": lambda: (
        fb.rounded_box((1.4, 1.4, 1.4), 0.1) - fb.cylinder(0.3, 0.6).repeat((0.4, 0.4, 0.4), (4, 3, 3))
    ).smooth(0.05),
    "with a volume": knot,
}


def on_both(scene: fb.Scene, gpu: str, **options: object) -> tuple[fb.Frame, fb.Frame]:
    """The pictures of the CPU and of the device, which draws and lights the scene itself."""
    here, there = (fb.render(scene, CAMERA, size=(48, 36), device=device, **options) for device in ("cpu", gpu))
    names = set(there.report["devices"].values())
    assert len(names) == 1
    assert "cpu" not in names
    return here, there


def assert_same(here: fb.Frame, there: fb.Frame) -> None:
    assert exceeds(np.abs(here.color - there.color).max(axis=2), 1 / 255).mean() <= 0.005
    assert (here.object_id == there.object_id).mean() > 0.995


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_without_a_function_are_drawn_through_their_parts(name: str, gpu: str) -> None:
    instance = fb.Instance(SHAPES[name](), moved(y=0.6, scale=(1.2, 0.8, 1.0), turn=0.5))
    scene = fb.Scene([instance, plane()], lights=[fb.DirectionalLight(SUN, angle_deg=6)])
    assert_same(*on_both(scene, gpu, shadows="hard"))


def test_cones_past_many_leaves_are_thin_rays(gpu: str) -> None:
    instance = fb.Instance(SHAPES["many leaves"](), moved(y=0.6, scale=(1.2, 0.8, 1.0), turn=0.5))
    scene = fb.Scene([instance, plane()], lights=[fb.DirectionalLight(SUN, angle_deg=6)])
    assert_same(*on_both(scene, gpu, shadows="none", ambient_occlusion=True))


def test_the_cpu_evaluates_cones_past_distances_of_shapes_without_a_function(gpu: str) -> None:
    scene = fb.Scene([SHAPES["blended"]()], lights=[fb.DirectionalLight(SUN, angle_deg=6)])
    here, there = (fb.render(scene, CAMERA, size=(48, 36), shadows="soft", device=device) for device in ("cpu", gpu))
    assert there.report["devices"]["light"] == "cpu"
    assert_same(here, there)


def test_a_scene_may_have_more_structures_than_functions(gpu: str) -> None:
    bodies = [fb.box((0.5, 0.5, 0.5)), fb.sphere(0.3), fb.cylinder(0.3, 0.5), fb.cone(0.3, 0.6), fb.torus(0.25, 0.1)]
    hole = fb.cylinder(0.1, 2)
    shapes = [*bodies, *(body - hole for body in bodies)]
    places = [moved(x=-1.5 + 0.8 * (i % 5), y=0.3, z=-0.8 + 1.2 * (i // 5)) for i in range(len(shapes))]
    items = [fb.Instance(shape, place) for shape, place in zip(shapes, places, strict=True)]
    assert_same(*on_both(fb.Scene([*items, plane()], lights=[fb.DirectionalLight(SUN)]), gpu, shadows="hard"))


def test_light_passes_through_a_shape_of_many_leaves(gpu: str) -> None:
    wax = fb.Material(scattering=2.0)
    ball = fb.Instance(SHAPES["many leaves"](), moved(y=0.6), material=wax)
    scene = fb.Scene([ball, plane()], lights=[fb.DirectionalLight(SUN)])
    assert_same(*on_both(scene, gpu, shadows="hard"))
