"""Nested fields of scenes on a device: visible surfaces, shadows and occlusion as on the CPU."""

import numpy as np

import fieldbake as fb
from compare import exceeds
from scenes import SUN, moved, plane

CAMERA = fb.Camera((2.5, 7.0, 5.0), (0.6, -1.0, 0.2), fov_deg=40)


def nested() -> fb.NestedField:
    ball = fb.bake(fb.sphere(0.4), 16)
    places = [(x, y, z) for x in (-0.6, 0.6) for y in (-0.6, 0.6) for z in (-0.6, 0.6)]
    return fb.merge([fb.Instance(ball, moved(*place)) for place in places], 24, levels=3)


def test_devices_draw_nested_fields_as_the_cpu_does(gpu: str) -> None:
    place = moved(y=0.6, scale=(1.2, 0.8, 1.0), turn=0.5)
    dense = fb.Instance(fb.bake(fb.models.torus_knot(), 24), moved(x=2.0, y=0.6))
    scene = fb.Scene([fb.Instance(nested(), place), dense, plane()], lights=[fb.DirectionalLight(SUN, angle_deg=6)])
    for options in ({"shadows": "hard"}, {"shadows": "soft", "ambient_occlusion": True}):
        here, there = (fb.render(scene, CAMERA, size=(48, 36), device=device, **options) for device in ("cpu", gpu))
        assert "cpu" not in " ".join(there.report["devices"].values()).split()
        assert (here.object_id == 0).sum() > 50
        assert exceeds(np.abs(here.color - there.color).max(axis=2), 1 / 255).mean() <= 0.005
        assert (here.object_id == there.object_id).mean() > 0.995
