"""Each kind of object drawn by `raymarch` and by `render` as a scene of one instance.

Both draw the same field with the same light, camera, colours and hard shadows, so their pictures agree except where
the last bits of a ray decide: at the silhouette and at the edge of a shadow. Of 6912 pixels, at most 6 (0.09 %) differ
by more than 1/255. On the CPU these are 6 of the mesh and 1 of the large shape. On lavapipe they are 6 of the mesh, 3
of the large shape and 1 of the small shape. All hits are the same. Their depths differ by at most 8e-6 world units on
the CPU, and by 3e-5 on lavapipe.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fieldbake as fb
from compare import exceeds
from pictures import DEPTH_TOLERANCE
from scenes import moved

SIZE = (96, 72)
LIGHT = fb.DirectionalLight((0.4, -0.8, -0.5), intensity=0.7)
COLOR = (0.7, 0.5, 0.3)

#: Largest fraction of the pixels whose colours differ by more than 1/255: twice the largest observed one.
DIFFERING = 0.002

GEAR = fb.models.gear(teeth=6)


def volume() -> fb.Volume:
    return fb.bake(fb.models.torus_knot(), 32)


def nested() -> fb.NestedField:
    ball = fb.bake(fb.sphere(0.4), 16)
    places = [(x, y, z) for x in (-0.6, 0.6) for y in (-0.6, 0.6) for z in (-0.6, 0.6)]
    field = fb.merge([fb.Instance(ball, moved(*place)) for place in places], 24, levels=2)
    assert isinstance(field, fb.NestedField)
    return field


def balls() -> fb.Shape:
    steps = (-0.6, -0.2, 0.2, 0.6)
    return fb.Shape.union(*(fb.sphere(0.15).translate((x, y, z)) for x in steps for y in steps for z in steps))


OBJECTS: dict[str, Callable[[], Any]] = {
    "float32": volume,
    "float16": lambda: volume().quantize("float16"),
    "snorm8": lambda: volume().quantize("snorm8"),
    "sparse": lambda: volume().to_sparse(),
    "nested": nested,
    "shape": lambda: fb.box((1.6, 1.2, 0.9)) - fb.sphere(0.7),
    "shape of 65 leaves": lambda: balls() & fb.box((1.2, 1.2, 1.2)),
    "quadric": lambda: fb.Quadric.ellipsoid(radii=(0.8, 0.5, 0.6), reflectance=COLOR),
    # A flat mesh has a small grid: `raymarch` bakes meshes with 128 voxels along the longest side.
    "mesh": lambda: fb.Mesh(GEAR.vertices * (1, 0.5, 0.6), GEAR.faces),
}


#: Objects whose fields have samples.
SAMPLED = {"float32", "float16", "snorm8", "sparse", "nested", "mesh"}


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_alone_is_a_scene_of_one_instance(name: str, device: str) -> None:
    geometry = OBJECTS[name]()
    own_color = {} if name == "quadric" else {"color": COLOR}
    camera = fb.Camera.fit(fb.Scene([geometry]).bounds, direction=(-0.4, -0.5, -0.7), aspect=SIZE[0] / SIZE[1])
    options: dict[str, Any] = {"size": SIZE, "shadows": "hard", "device": device}
    # Devices draw these as a scene of one instance, so the picture of the CPU is compared.
    alone_on = "cpu" if name in SAMPLED else device
    alone = fb.raymarch(geometry, camera, lights=[LIGHT], **own_color, **{**options, "device": alone_on})
    instance = fb.Instance(geometry, material=fb.Material(**own_color), resolution=128)
    scene = fb.Scene([instance], lights=[LIGHT])
    drawn = fb.render(scene, camera, primary="auto" if name == "quadric" else "raymarch", **options)

    # The values of `object_id` are -1 in pixels without a hit.
    assert np.array_equal(alone.object_id, drawn.object_id)
    is_hit = np.isfinite(alone.depth)
    assert is_hit.mean() > 0.1
    assert (alone.shadow[is_hit] == 0).mean() > 0.05
    differs = exceeds(np.abs(alone.color - drawn.color).max(axis=2), 1 / 255)
    assert differs.mean() <= DIFFERING
    assert not exceeds(np.abs(alone.depth[is_hit] - drawn.depth[is_hit]), DEPTH_TOLERANCE).any()
