"""Each kind of object drawn by `raymarch` and by `render` as a scene of one object: how far the two pictures agree.

`DIFFERENCES` records the fraction of pixels whose colour differs by more than 1/255, for each kind, and is an upper
bound. Pictures of one object and of scenes have different formulas for light from everywhere, so there is none here.
"""

import numpy as np
import pytest

import fieldbake as fb
from compare import exceeds
from scenes import moved

SIZE = (64, 48)
LIGHT = fb.DirectionalLight((0.4, -0.8, -0.5), intensity=0.7)


def volume() -> fb.Volume:
    return fb.bake(fb.models.torus_knot(), 32)


def nested() -> fb.NestedField:
    ball = fb.bake(fb.sphere(0.4), 16)
    places = [(x, y, z) for x in (-0.6, 0.6) for y in (-0.6, 0.6) for z in (-0.6, 0.6)]
    return fb.merge([fb.Instance(ball, moved(*place)) for place in places], 24, levels=2)


OBJECTS = {
    "volume": volume,
    "float16": lambda: volume().quantize("float16"),
    "snorm8": lambda: volume().quantize("snorm8"),
    "sparse": lambda: volume().to_sparse(),
    "nested": nested,
    "shape": lambda: fb.box((1.6, 1.2, 0.9)) - fb.sphere(0.7),
    # More tokens and leaves than a function for the structure of a shape has.
    "large shape": lambda: fb.sphere(0.15).repeat((0.4, 0.4, 0.4), (4, 4, 4)) & fb.box((1.2, 1.2, 1.2)),
    "quadric": lambda: fb.Quadric.ellipsoid(radii=(0.8, 0.5, 0.6), reflectance=(0.8, 0.8, 0.8)),
}

#: Largest fraction of the pixels that differ. On the silhouette and at the edge of a shadow the last bit of a ray
#: decides.
DIFFERENCES = dict.fromkeys(OBJECTS, 0.005)


def both(name: str, device: str) -> tuple[fb.Frame, fb.Frame]:
    thing = OBJECTS[name]()
    camera = fb.Camera.fit(fb.Scene([thing]).bounds, aspect=SIZE[0] / SIZE[1])
    options = {"size": SIZE, "shadows": "hard", "device": device}
    alone = fb.raymarch(thing, camera, lights=[LIGHT], ambient=0, **options)
    scene = fb.Scene([thing], lights=[LIGHT], ambient=0)
    return alone, fb.render(scene, camera, primary="auto" if name == "quadric" else "raymarch", **options)


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_alone_is_a_scene_of_one_object(name: str, device: str, record_property) -> None:
    alone, scene = both(name, device)
    differs = exceeds(np.abs(alone.color - scene.color).max(axis=2), 1 / 255)
    record_property("differing pixels", float(differs.mean()))
    assert np.isfinite(alone.depth).sum() > 200
    assert differs.mean() <= DIFFERENCES[name]
    hit = np.isfinite(alone.depth) & np.isfinite(scene.depth)
    assert (np.isfinite(alone.depth) == np.isfinite(scene.depth)).mean() > 0.998
    assert np.quantile(np.abs(alone.depth[hit] - scene.depth[hit]), 0.99) < 1e-3
