"""Falloff with distance and cones of lights against their closed forms; lights of glTF files."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import trimesh

import fieldbake as fb
from scenes import moved, plane, positions

ALBEDO = np.array([0.9, 0.6, 0.3])
COLOR = np.array([1.0, 0.5, 0.25])
AMBIENT = 0.125
SIZE = (48, 36)


def falloff(distance, reach):
    """Share of the intensity at a distance, by the formula of KHR_lights_punctual."""
    if reach is None:
        return np.ones_like(distance)
    return np.clip(1 - (distance / reach) ** 4, 0, 1) / distance**2


def cone(light, way):
    """Share of the intensity in the unit directions `way`, by the formula of KHR_lights_punctual."""
    cosine = way @ np.array(light.direction)
    inner, outer = (math.cos(math.radians(angle)) for angle in (light.inner_deg, light.outer_deg))
    if inner == outer:
        return (cosine >= outer).astype(float)
    return np.clip((cosine - outer) / (inner - outer), 0, 1) ** 2


def light_on_floor(frame, camera, lights):
    """The colours of a floor at y = -1 without highlights, in float64, and the points of the pixels."""
    points = positions(frame, camera)
    expected = np.broadcast_to(AMBIENT * ALBEDO, (*points.shape[:2], 3)).copy()
    for light in lights:
        way = points - np.array(light.position)
        distance = np.linalg.norm(way, axis=-1)
        share = falloff(distance, light.range)
        if isinstance(light, fb.SpotLight):
            share = share * cone(light, way / distance[..., None])
        cosine = -way[..., 1] / distance
        expected += (light.intensity * share * cosine)[..., None] * np.array(light.color) * ALBEDO
    return expected, points


def floor(lights, scale=1.0):
    material = fb.Material(color=ALBEDO, specular=0)
    instance = fb.Instance(plane(), np.diag([scale, scale, scale, 1.0]), material)
    return fb.Scene([instance], lights, ambient=AMBIENT)


CAMERA = fb.Camera((1.5, 5.0, 3.0), (0.2, -1.0, 0.1), fov_deg=50)

LIGHTS = {
    "constant": fb.PointLight((0.3, 0.7, -0.4), COLOR, 0.8),
    "range": fb.PointLight((0.3, 0.7, -0.4), COLOR, 3.0, range=2.5),
    "inverse square": fb.PointLight((0.3, 0.7, -0.4), COLOR, 3.0, range=math.inf),
    "spot": fb.SpotLight((0.3, 1.7, -0.4), (0.3, -1, 0.2), 12, 35, COLOR, 0.8),
    "spot with range": fb.SpotLight((0.3, 1.7, -0.4), (0.3, -1, 0.2), 0, 45, COLOR, 5.0, range=4),
    "sharp spot": fb.SpotLight((0.3, 1.7, -0.4), (0.3, -1, 0.2), 30, 30, COLOR, 0.8),
    "half space": fb.SpotLight((0.3, -0.5, -0.4), (1, 0, 0), 90, 90, COLOR, 0.8),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_light_on_a_floor_is_the_closed_form(name, device):
    light = LIGHTS[name]

    frame = fb.render(floor([light]), CAMERA, size=SIZE, shadows="none", device=device)

    expected, _ = light_on_floor(frame, CAMERA, [light])
    seen = frame.object_id == 0
    assert seen.sum() > 1000
    # Positions are float64 and colours float32; at the edge of a cone the ramp has a slope of 1 / 0.16 per unit of the
    # cosine. A sharp edge may fall on the other side of a pixel.
    wrong = ~(np.abs(frame.color[..., :3] - expected)[seen].max(axis=-1) <= 1e-5)
    assert wrong.sum() <= (1 if "sharp" in name or "half" in name else 0)
    lit = (expected[seen] - AMBIENT * ALBEDO).max(axis=-1)
    assert lit.max() > 0.2
    if name not in ("constant", "inverse square"):
        # Outside the cone or beyond the range no light arrives at all.
        dark = frame.color[seen][lit == 0, :3]
        assert len(dark) > 50
        assert (dark == np.float32(AMBIENT) * ALBEDO.astype(np.float32)).all()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_falloff_is_in_world_units(scale):
    light = fb.PointLight(np.array((0.3, 0.7, -0.4)) * scale, COLOR, 3.0 * scale**2, range=2.5 * scale)
    camera = fb.Camera(CAMERA.eye * scale, np.array((0.2, -1.0, 0.1)) * scale, fov_deg=50)

    frame = fb.render(floor([light], scale), camera, size=SIZE, shadows="none", device="cpu")

    expected, _ = light_on_floor(frame, camera, [light])
    seen = frame.object_id == 0
    assert seen.sum() > 1000
    assert np.abs(frame.color[..., :3] - expected)[seen].max() <= 1e-5


def test_raymarch_and_the_renderer_draw_the_same_lights(device):
    lights = [LIGHTS["range"], LIGHTS["spot with range"]]
    solid = fb.box((12, 1, 12)).translate((0, -1.5, 0))
    options = {"size": SIZE, "shadows": "hard", "device": device}

    marched = fb.raymarch(solid, CAMERA, lights=lights, ambient=AMBIENT, color=ALBEDO, specular=0, **options)
    dark = fb.Scene([fb.Instance(solid, material=fb.Material(color=ALBEDO, specular=0))], [], ambient=AMBIENT)
    drawn = fb.Renderer(dark, **options).frame(CAMERA, lights=lights)

    for frame in (marched, drawn):
        expected, _ = light_on_floor(frame, CAMERA, lights)
        top = (frame.object_id == 0) & (frame.normal[..., 1] > 0.99)
        assert top.sum() > 1000
        # Depths of shapes are float32, so positions differ by 1e-6 and the light near the lamp by a few times that.
        assert np.abs(frame.color[..., :3] - expected)[top].max() <= 1e-4


def test_the_shadow_of_a_frame_has_neither_falloff_nor_cone(device):
    ball = fb.Instance(fb.sphere(0.3), moved(0.3, 0.2, -0.4))
    lights = [LIGHTS["range"], LIGHTS["spot"]]
    scene = fb.Scene([*floor(lights).instances, ball], lights)

    frame = fb.render(scene, CAMERA, size=SIZE, shadows="hard", device=device)

    points = positions(frame, CAMERA)
    on_floor = frame.object_id == 0
    for number, light in enumerate(lights):
        way = points - np.array(light.position)
        unit = way / np.linalg.norm(way, axis=-1)[..., None]
        to_ball = np.array((0.3, 0.2, -0.4)) - np.array(light.position)
        passing = np.linalg.norm(np.cross(unit, to_ball), axis=-1)
        # The outline of the shadow is left out.
        clear = on_floor & (np.abs(passing - 0.3) > 0.02)
        assert (frame.shadow[..., number][clear] == (passing > 0.3)[clear]).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.DirectionalLight((0, -1, 0), angle_deg=400), "angle_deg: must be at most 180 degrees, got 400"),
        (lambda: fb.DirectionalLight((0, -1, 0), angle_deg=math.nan), "angle_deg"),
        (lambda: fb.PointLight((0, 0, 0), range=0), "range"),
        (lambda: fb.PointLight((0, 0, 0), range=-1), "range"),
        (lambda: fb.PointLight((0, 0, 0), range=math.nan), "range"),
        (lambda: fb.PointLight((0, 0, 0), range="far"), "range"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 0)), "direction"),
        (lambda: fb.SpotLight((0, 0, math.nan), (0, 0, 1)), "position"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), outer_deg=0), "outer_deg"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), outer_deg=91), "outer_deg"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), 31, 30), "inner_deg"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), -1, 30), "inner_deg"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), intensity=-1), "intensity"),
        (lambda: fb.SpotLight((0, 0, 0), (0, 0, 1), range=-2), "range"),
        (lambda: fb.Scene([fb.sphere()], [fb.sphere()]), "SpotLight"),
    ],
)
def test_a_light_that_is_no_light_is_refused(make, message):
    with pytest.raises(fb.SceneError, match=message):
        make()


def test_lights_of_files_keep_their_cones_ranges_and_ratios(tmp_path):
    path = tmp_path / "lights.gltf"
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box((2, 2, 2))))
    for name, content in files.items():
        (tmp_path / name.replace("model.gltf", path.name)).write_bytes(content)
    document = json.loads(path.read_text())
    lights = [
        {"type": "point", "intensity": 40.0, "range": 9.0},
        {"type": "point", "intensity": 20.0, "color": [1, 0, 0]},
        {"type": "spot", "intensity": 10.0, "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}, "range": 7.0},
        {"type": "spot", "intensity": 5.0},
    ]
    places = [[0, 4, 0], [0, 0, 0], [5, 0, 0], [0, 0, 6]]
    document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for number, place in enumerate(places):
        document["scenes"][0]["nodes"].append(len(document["nodes"]))
        # A quarter turn about x: the axis -z becomes -y or +y.
        turn = [-math.sqrt(0.5), 0, 0, math.sqrt(0.5)]
        document["nodes"].append(
            {"translation": place, "rotation": turn, "extensions": {"KHR_lights_punctual": {"light": number}}}
        )
    path.write_text(json.dumps(document))

    found = {light.position: light for light in fb.load_scene(path).lights}

    # The second lamp is in the centre and counts as a quarter of the diagonal away, at which it is the brightest.
    factor = (math.sqrt(12) / 4) ** 2 / 20
    first, second, third, fourth = (found[tuple(float(x) for x in place)] for place in places)
    assert [light.intensity for light in (first, second, third, fourth)] == pytest.approx(
        [40 * factor, 20 * factor, 10 * factor, 5 * factor]
    )
    assert [type(light) for light in (first, second, third, fourth)] == [fb.PointLight] * 2 + [fb.SpotLight] * 2
    assert [light.range for light in (first, second, third, fourth)] == [9, math.inf, 7, math.inf]
    assert third.direction == pytest.approx((0, -1, 0))
    assert (third.inner_deg, third.outer_deg) == pytest.approx((math.degrees(0.25), math.degrees(0.5)))
    assert (fourth.inner_deg, fourth.outer_deg) == pytest.approx((0, 45))
    assert second.color == (1, 0, 0)


def test_a_lamp_on_a_surface_draws_finite_colours():
    lamp = fb.PointLight((0, -1, 0), intensity=1e30, range=np.inf)
    assert np.isfinite(fb.render(floor([lamp]), CAMERA, size=SIZE, shadows="none", device="cpu").color).all()


@pytest.mark.parametrize("draw", [fb.render, fb.raymarch])
def test_soft_is_the_default_and_a_light_without_a_size_has_hard_shadows(draw):
    cut = fb.bake(fb.sphere() - fb.box((1, 4, 1)), 32, device="cpu")
    camera = fb.Camera((2, 3, 4), (0, 0, 0))
    for point, sized in (
        (fb.DirectionalLight((-1, -0.4, -0.2)), fb.DirectionalLight((-1, -0.4, -0.2), angle_deg=20)),
        (fb.PointLight((4, 1.6, 0.8)), fb.PointLight((4, 1.6, 0.8), radius=0.8)),
    ):
        shadows = {}
        for name, light, options in (
            ("usual", point, {}),
            ("hard", point, {"shadows": "hard"}),
            ("usual with a size", sized, {}),
            ("soft with a size", sized, {"shadows": "soft"}),
        ):
            given = (fb.Scene([cut], [light]), {}) if draw is fb.render else (cut, {"lights": [light]})
            shadows[name] = draw(given[0], camera, size=(48, 48), device="cpu", **given[1], **options).shadow
        assert np.array_equal(shadows["usual"], shadows["hard"])
        assert set(np.unique(shadows["usual"])) == {0, 1}
        assert np.array_equal(shadows["usual with a size"], shadows["soft with a size"])
        assert (np.abs(shadows["usual with a size"] - 0.5) < 0.4).any()
