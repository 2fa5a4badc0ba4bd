"""Shadows of cards and sheets against closed-form areas: flat, masked, blended and crossed ones."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import exceeds
from pictures import assert_same_picture

#: Texels along a card's side, and radius of the disc on it; the card spans -1 to 1.
TEXELS = 256
RADIUS = 0.8

#: Half the side of the floor, and where it lies.
FLOOR, DEPTH = 3.0, -2.0

QUAD = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)]
UV = [(0, 0), (1, 0), (1, 1), (0, 1)]


def image(opacity: np.ndarray) -> np.ndarray:
    """A green texture with the given opacity, 0 to 1."""
    pixels = np.full((*opacity.shape, 4), 255, dtype=np.uint8)
    pixels[..., :3] = 60, 160, 40
    pixels[..., 3] = np.round(255 * opacity)
    return pixels


_v, _u = (np.mgrid[:TEXELS, :TEXELS] + 0.5) / TEXELS * 2 - 1
DISC = image((_u**2 + _v**2 <= RADIUS**2) * 1.0)
HALF = image((_u < 0) * 1.0)
RAMP = image((_u + 1) / 2)


def quad(**looks: Any) -> fb.Mesh:
    return fb.Mesh(*QUAD, uv=UV, **looks)


def tilt(degrees: float) -> np.ndarray:
    """A turn about the diagonal (1, 1, 0), then a shift that no texel or pixel divides."""
    x = y = 0.5**0.5
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [c + x * x * (1 - c), x * y * (1 - c), y * s],
        [x * y * (1 - c), c + y * y * (1 - c), -x * s],
        [-y * s, x * s, c],
    ]
    matrix[:3, 3] = 0.0123, -0.0071, 0
    return matrix


def shifted(matrix: np.ndarray, offset: tuple[float, float, float]) -> np.ndarray:
    moved = np.array(matrix)
    moved[:3, 3] += offset
    return moved


class Card(NamedTuple):
    """A card with its closed-form area and the length of its outline."""

    mesh: fb.Mesh
    material: fb.Material | None
    area: float
    outline: float

    def at(self, transform: np.ndarray, resolution: int = 48, **options: Any) -> fb.Instance:
        return fb.Instance(self.mesh, transform, self.material, resolution=resolution, **options)


CIRCLE = np.pi * RADIUS**2, 2 * np.pi * RADIUS
PART = fb.Part("leaf", range(2), image=DISC, alpha_mode="mask")
CARDS = {
    "square": Card(quad(), None, 4.0, 8.0),
    "two-sided square": Card(quad(), fb.Material(two_sided=True), 4.0, 8.0),
    "mask of a part": Card(quad(parts=[PART]), None, *CIRCLE),
    "mask of a material": Card(quad(), fb.Material(texture=DISC, alpha_mode="mask"), *CIRCLE),
    "cutoff of a material": Card(quad(), fb.Material(texture=RAMP, alpha_mode="mask", alpha_cutoff=0.7), 1.2, 5.2),
    "half-empty blend": Card(quad(), fb.Material(texture=HALF, alpha_mode="blend"), 2.0, 6.0),
    "blended ramp": Card(quad(), fb.Material(texture=RAMP, alpha_mode="blend"), 2.0, 8.0),
    "translucent colour": Card(quad(), fb.Material(color=(1, 1, 1, 0.5)), 2.0, 8.0),
}


def floor_frame(geometries: list[fb.Instance], size: int = 128, light: Any = (0, 0, -1), **options: Any) -> fb.Frame:
    """The floor from far above, with the shadows of instances that the camera does not see."""
    corners = np.array(QUAD[0]) * FLOOR + (0, 0, DEPTH)
    unseen = [
        fb.Instance(
            item.geometry, item.transform, item.material, item.casts_shadow, False, item.opacity, item.resolution
        )
        for item in geometries
    ]
    height = 500.0
    camera = fb.Camera(
        (0, 0, DEPTH + height), (0, 0, DEPTH), up=(0, 1, 0), fov_deg=2 * np.degrees(np.arctan(FLOOR / height))
    )
    sun = light if isinstance(light, fb.DirectionalLight) else fb.DirectionalLight(light)
    options = {"shadows": "hard", "device": "cpu"} | options
    scene = fb.Scene([fb.Instance((corners, QUAD[1])), *unseen], lights=[sun])
    return fb.render(scene, camera, size=(size, size), **options)


def shadow_area(frame: fb.Frame) -> float:
    pixel = 2 * FLOOR / frame.shadow.shape[0]
    assert (frame.object_id == 0).all()
    return float((1 - frame.shadow).sum()) * pixel**2


def area_error(card: Card, size: int = 128) -> float:
    """Bound of the error of an area: half a pixel of the floor and half a texel along the outline."""
    return card.outline * (2 * FLOOR / size + 2 / TEXELS) / 2


@pytest.mark.parametrize("degrees", [0, 20, 45])
@pytest.mark.parametrize("name", CARDS)
def test_a_card_throws_the_shadow_of_what_is_opaque(name: str, degrees: float) -> None:
    card = CARDS[name]

    frame = floor_frame([card.at(tilt(degrees))])

    truth = card.area * np.cos(np.radians(degrees))
    assert abs(shadow_area(frame) - truth) <= min(area_error(card), 0.1 * truth)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [32, 48, 64, 65, 96, 100, 128])
@pytest.mark.parametrize("degrees", [0, 5, 20, 45, 70])
@pytest.mark.parametrize("name", CARDS)
def test_a_card_throws_its_shadow_at_every_resolution(name: str, degrees: float, resolution: int) -> None:
    card = CARDS[name]
    for primary in ("auto", "raymarch"):
        frame = floor_frame([card.at(tilt(degrees), resolution)], size=96, primary=primary)

        truth = card.area * np.cos(np.radians(degrees))
        assert abs(shadow_area(frame) - truth) <= area_error(card, 96)


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
def test_a_device_throws_the_same_shadow(shadows: str, gpu: str) -> None:
    options = {"shadows": shadows, "size": 48, "light": fb.DirectionalLight((0.2, 0.1, -1), angle_deg=5)}
    for card in (CARDS["mask of a part"], CARDS["blended ramp"]):
        here, there = (floor_frame([card.at(tilt(20))], device=place, **options) for place in ("cpu", gpu))

        assert there.report["sheets"] == 2
        assert there.report["devices"]["light"] != "cpu"
        # The device marches no card: what is left is the rounding of its floor.
        assert np.abs(here.shadow - there.shadow).max() <= 1e-6


@pytest.mark.parametrize("shadows", ["soft", "area"])
def test_a_wide_light_loses_as_much_light_to_a_card_as_a_narrow_one(shadows: str) -> None:
    card = CARDS["mask of a part"]
    light = fb.DirectionalLight((0, 0, -1), angle_deg=6)

    frame = floor_frame([card.at(tilt(20))], light=light, shadows=shadows, area_samples=32)

    # Directions within 3 degrees change the projected area by tan(3) tan(20) at most, evenly to both sides.
    truth = card.area * np.cos(np.radians(20))
    assert abs(shadow_area(frame) - truth) <= 0.02 * truth
    assert ((frame.shadow > 0.1) & (frame.shadow < 0.9)).sum() > 50


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
@pytest.mark.parametrize("degrees", [0, 20, 45])
def test_a_masked_card_is_not_in_its_own_shadow(degrees: float, shadows: str, device: str) -> None:
    light = fb.DirectionalLight((0.3, 0.2, -1), angle_deg=4)
    camera = fb.Camera((1, -1, 6), (0, 0, 0), up=(0, 1, 0))
    for primary in ("auto", "raymarch"):
        scene = fb.Scene([CARDS["mask of a part"].at(tilt(degrees))], lights=[light])
        frame = fb.render(scene, camera, size=(64, 64), shadows=shadows, area_samples=9, primary=primary, device=device)
        own = frame.object_id == 0
        lit = own & (frame.normal @ (-np.array(light.direction)) > 0)
        assert lit.sum() > 0.9 * own.sum() > 100
        assert (frame.shadow[lit] >= 0.99).mean() >= 0.98


def test_a_card_alone_is_open_to_all_sides(device: str) -> None:
    scene = fb.Scene([CARDS["mask of a part"].at(tilt(20))])
    camera = fb.Camera((1, -1, 6), (0, 0, 0), up=(0, 1, 0))
    options = {"size": (48, 48), "shadows": "none", "device": device}

    plain, open_ = (fb.render(scene, camera, **options, ambient_occlusion=wanted) for wanted in (False, True))

    assert np.array_equal(plain.color, open_.color)


def test_a_card_darkens_the_corner_behind_it() -> None:
    floor, wall = quad(), fb.Instance(quad(), np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1.0]]))
    camera = fb.Camera((4, 0, 4), (0, 0, 0), up=(0, 0, 1))
    options = {"size": (64, 64), "shadows": "none", "device": "cpu"}

    plain, dark = (fb.render(fb.Scene([floor, wall]), camera, **options, ambient_occlusion=w) for w in (False, 0.5))

    # A wall of infinite size takes half of the cosine-weighed hemisphere at its foot, and nothing half a unit away.
    share = dark.color[..., :3].sum(axis=-1) / plain.color[..., :3].sum(axis=-1)
    assert share[plain.object_id >= 0].min() < 0.9
    assert share[plain.object_id == 0].max() == pytest.approx(1, abs=1e-6)


def test_opacities_of_blended_cards_multiply() -> None:
    half = fb.Material(texture=image(np.full((4, 4), 0.6)), alpha_mode="blend")
    stack = [fb.Instance(quad(), shifted(np.eye(4), (0, 0, 0.1 * k)), half) for k in range(3)]
    for count in (1, 2, 3):
        # A square whose diagonal passes through pixel centres: both triangles there count once.
        frame = floor_frame(stack[:count], size=64)
        passed = (1 - np.round(255 * 0.6) / 255) ** count
        assert np.unique(np.round(frame.shadow, 5)) == pytest.approx([passed, 1], abs=1e-5)
    faint = floor_frame([fb.Instance(quad(), material=half, opacity=0.5)], size=64)
    assert faint.shadow.min() == pytest.approx(1 - 0.5 * 0.6, abs=1e-3)


def test_a_translucent_solid_takes_its_opacity_once(device: str) -> None:
    glass = fb.Material(color=(1, 1, 1, 0.25))
    ball = fb.Mesh(*meshes.icosphere(3))
    for geometry in (ball, fb.bake(ball, 32), fb.sphere(1)):
        frame = floor_frame([fb.Instance(geometry, material=glass)], size=32, device=device)
        assert frame.shadow.min() == pytest.approx(0.75, abs=1e-6)
    # A texture makes it a mesh of triangles: a ray counts where it enters the solid.
    uv = np.full((len(ball.vertices), 2), 0.5)
    painted = fb.Mesh(ball.vertices, ball.faces, uv=uv)
    glass = fb.Material(texture=image(np.full((2, 2), 0.2)), alpha_mode="blend")
    frame = floor_frame([fb.Instance(painted, material=glass)], size=32, device=device)
    assert frame.shadow.min() == pytest.approx(0.8, abs=1e-6)


CROSS = (
    [(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1), (0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)],
    [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)],
)


@pytest.mark.parametrize("looks", ["part", "material", "none"])
@pytest.mark.parametrize("resolution", [48, 65])
def test_crossed_quads_throw_the_shadow_of_both(looks: str, resolution: int) -> None:
    parts = [fb.Part("cross", range(4), two_sided=looks == "part")]
    material = fb.Material(two_sided=True) if looks == "material" else None
    light = np.array([0.8, 0.3, -1.0])

    frame = floor_frame([fb.Instance(fb.Mesh(*CROSS, parts=parts), None, material, resolution=resolution)], light=light)

    # Pixel by pixel: the ray to the light meets the plane x = 0 or y = 0 within the quad.
    size = frame.shadow.shape[0]
    x = (np.arange(size) + 0.5) / size * 2 * FLOOR - FLOOR
    p = np.stack([*np.meshgrid(x, -x), np.full((size, size), DEPTH)], axis=-1)
    dark = np.zeros((size, size), bool)
    for axis in (0, 1):
        t = -p[..., axis] / -light[axis]
        q = p - t[..., None] * light
        dark |= (t > 0) & (np.abs(q[..., 1 - axis]) <= 1) & (np.abs(q[..., 2]) <= 1)
    # The camera's rays are not quite parallel: pixels on an outline may differ.
    assert ((frame.shadow < 0.5) != dark).mean() <= 0.002
    assert shadow_area(frame) == pytest.approx(dark.sum() * (2 * FLOOR / size) ** 2, rel=0.02)


def test_a_card_with_its_back_to_the_light() -> None:
    card = CARDS["mask of a part"]
    turned = tilt(180)

    frame = floor_frame([card.at(turned)])
    below = fb.render(
        fb.Scene([card.at(np.eye(4))], lights=[fb.DirectionalLight((0, 0, -1))]),
        fb.Camera((0.5, 0.2, -6), (0, 0, 0), up=(0, 1, 0)),
        size=(48, 48),
        device="cpu",
    )

    assert abs(shadow_area(frame) - card.area) <= area_error(card)
    assert (below.shadow[below.object_id == 0] == 0).all()


def test_a_card_that_casts_no_shadow_casts_none() -> None:
    for card in CARDS.values():
        assert shadow_area(floor_frame([card.at(tilt(20), casts_shadow=False)], size=32)) == 0


def test_sheets_and_solids_share_a_light_on_every_device(gpu: str) -> None:
    ball = fb.Mesh(*meshes.icosphere(3))
    leaf = CARDS["mask of a material"]
    scene = fb.Scene(
        [
            fb.Instance((np.array(QUAD[0]) * 4.0 + (0, 0, -1.5), QUAD[1])),
            fb.Instance(ball, np.diag([0.6, 0.6, 0.6, 1]), resolution=32),
            leaf.at(shifted(tilt(30), (0.5, -0.3, 0.7))),
        ],
        lights=[fb.DirectionalLight((0.5, 0.4, -1), angle_deg=8), fb.PointLight((2, -2, 3), radius=0.4)],
    )
    camera = fb.Camera((3, -4, 4), (0, 0, -0.8), up=(0, 0, 1))
    options = {"size": (56, 42), "ambient_occlusion": 0.8}

    here, there = (fb.render(scene, camera, **options, device=place) for place in ("cpu", gpu))
    exact = fb.render(scene, camera, size=(56, 42), shadows="area", area_samples=100, device="cpu")

    assert exceeds(np.abs(here.shadow - there.shadow), 1 / 255).mean() <= 0.005
    assert_same_picture(here, there, scene)
    # A ray of 100 is 0.01; the cones of solids are within 0.05 of them in the mean square.
    assert np.sqrt(np.mean((here.shadow - exact.shadow) ** 2)) <= 0.03


@pytest.mark.slow
def test_cards_of_a_file_are_lit(model_path: Any) -> None:
    scene = fb.load_scene(model_path("AlphaBlendModeTest.glb"))
    unshadowed = fb.render(scene, size=(160, 120), device="cpu", shadows="none")
    for options in ({}, {"shadows": "hard"}, {"ambient_occlusion": True}):
        frame = fb.render(scene, size=(160, 120), device="cpu", **options)

        # The three cards with a cutoff.
        for number in (3, 4, 5):
            own = frame.object_id == number
            light = frame.color[..., :3].sum(axis=-1)[own] / unshadowed.color[..., :3].sum(axis=-1)[own]
            assert own.sum() > 100
            assert (light >= 0.5).mean() >= 0.98


@pytest.mark.parametrize("reversed_bodies", [(True,), (False, True), (True, False), (True, True)])
def test_a_body_wound_inside_out_looks_like_its_solid(reversed_bodies, device):
    ball = fb.sphere(0.5).to_mesh(12)

    def bodies(is_reversed):
        parts = [
            (ball.vertices + np.array([1.2 * i, 0, 0]), ball.faces[:, ::-1] if turned else ball.faces)
            for i, turned in enumerate(is_reversed)
        ]
        return fb.as_mesh(parts)

    camera = fb.Camera((1, 1.5, 3), (0.4, 0, 0))
    frames = [
        fb.render(
            fb.Scene([fb.Instance(bodies(turned), resolution=24)]), camera, size=(48, 36), shadows="hard", device=device
        )
        for turned in ((False,) * len(reversed_bodies), reversed_bodies)
    ]
    solid = np.isfinite(frames[0].depth)
    assert solid.sum() > 100
    np.testing.assert_array_equal(np.isfinite(frames[1].depth), solid)
    # Turned triangles round their plane once more in float32.
    assert np.abs(frames[1].depth[solid] - frames[0].depth[solid]).max() <= 1e-5
    assert np.abs(frames[1].normal[solid] - frames[0].normal[solid]).max() <= 1e-5
    assert (np.abs(frames[1].color - frames[0].color).max(axis=-1) <= 1e-4).mean() >= 0.99
