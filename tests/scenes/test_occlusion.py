"""Ambient occlusion: its cost, and walls that wide cones must not pass."""

from __future__ import annotations

import io
import sys
import time

import numpy as np
import pytest
import trimesh

import fieldbake as fb
import meshes
from scenes import moved, plane, positions

CAMERA = fb.Camera((6, 5, 9), (0, -0.6, 0), fov_deg=40)


def crowd(count: int) -> fb.Scene:
    """Knots and balls at random positions over a floor, with the same density for any count."""
    random = np.random.default_rng(4)
    geometries = [fb.models.torus_knot(segments=64, sides=10), fb.Mesh(*meshes.icosphere(3))]
    side = 0.8 * np.sqrt(count)
    places = [moved(scale=(0.3, 0.3, 0.3)) for _ in range(count)]
    for place in places:
        place[:3, 3] = random.uniform(-side, side), -0.7, random.uniform(-side, side)
    instances = [fb.Instance(geometries[i % 2], place, resolution=32) for i, place in enumerate(places)]
    return fb.Scene([*instances, plane(2 * side)], lights=[fb.DirectionalLight((-1, -2, -0.6), angle_deg=1.5)])


# Cones of occlusion that walk the tree one by one at every pixel take 36 steps per pixel at 10 instances, and 310 at
# 60. Half of that is the limit. Soft shadows that trace every axis take 1.7 and 7.7 steps.
@pytest.mark.parametrize(("count", "open_limit", "soft_limit"), [(10, 18, 1.2), (60, 155, 6)])
def test_occlusion_and_soft_shadows_take_few_steps(count: int, open_limit: float, soft_limit: float) -> None:
    scene = crowd(count)
    steps = {}
    for name, options in {
        "none": {"shadows": "none"},
        "soft": {"shadows": "soft"},
        "open": {"shadows": "none", "ambient_occlusion": True},
    }.items():
        steps[name] = fb.render(scene, CAMERA, size=(120, 90), device="cpu", **options).steps.mean()
    # The steps of the light pass alone: the steps of the first pass are subtracted.
    assert steps["open"] - steps["none"] <= open_limit
    assert steps["soft"] - steps["none"] <= soft_limit


@pytest.mark.parametrize("thickness", [0.3, 0.05])
def test_a_closed_room_is_dark_from_within(thickness: float, device: str) -> None:
    inner = np.array([2.0, 2.0, 2.0])
    walls = [(-inner - thickness, np.where(np.arange(3) == axis, -inner, inner + thickness)) for axis in range(3)] + [
        (np.where(np.arange(3) == axis, inner, -inner - thickness), inner + thickness) for axis in range(3)
    ]
    room = [fb.Instance(fb.Mesh(*meshes.box(low, high)), resolution=48) for low, high in walls]
    ball = fb.Mesh(*meshes.icosphere(3))
    scene = fb.Scene([*room, fb.Instance(ball, moved(scale=(0.4,) * 3))], lights=[], ambient=1, background=(0, 0, 0))
    camera = fb.Camera((0, 0, 1.8), (0, 0, 0), fov_deg=60)
    frame = fb.render(scene, camera, size=(40, 40), ambient_occlusion=20.0, device=device)
    # Every cone ends at a wall; an edge of the room is one as dark as its cone's rim, 2 % of a disc.
    assert np.all(frame.color[..., :3] <= 0.05)


def true_openness(points, centers, radii, reach, count=1500):
    """Open fraction above points of a floor past balls, by rays whose density is the cosine (Malley's method)."""
    spread = (np.arange(count) + 0.5) / count
    angle, radius = np.arange(count) * np.pi * (3 - np.sqrt(5)), np.sqrt(spread)
    rays = np.stack([radius * np.cos(angle), np.sqrt(1 - spread), radius * np.sin(angle)], axis=1)
    open_rays = np.ones((len(points), count), bool)
    for center, size in zip(centers, radii, strict=True):
        way = center - points
        along = way @ rays.T
        chord = along**2 - ((way**2).sum(axis=1) - size**2)[:, None]
        enters = along - np.sqrt(np.maximum(chord, 0))
        open_rays &= ~((chord > 0) & (enters > 0) & (enters < reach))
    return open_rays.mean(axis=1)


@pytest.mark.parametrize("kind", ["dense", "sparse", "shape"])
def test_occlusion_past_balls_is_close_to_rays(kind: str, device: str) -> None:
    random = np.random.default_rng(3)
    centers = np.array([(x, random.uniform(-0.6, 0.2), z) for x in (-2, -0.7, 0.6, 1.9) for z in (-2, -0.7, 0.6, 1.9)])
    radii = random.uniform(0.2, 0.4, len(centers))
    field = fb.bake(fb.Mesh(*meshes.icosphere(4)), 32, device="cpu")
    ball = {"dense": field, "sparse": field.to_sparse(), "shape": fb.sphere(1)}[kind]
    places = [moved(*center, scale=(radius,) * 3) for center, radius in zip(centers, radii, strict=True)]
    instances = [fb.Instance(ball, place) for place in places]
    scene = fb.Scene([*instances, plane(8)], lights=[], ambient=1, background=(0, 0, 0))
    camera, options = fb.Camera((2, 3, 5), (0, -0.5, 0), fov_deg=50), {"size": (80, 60), "shadows": "none"}
    plain = fb.render(scene, camera, **options, device=device).color[..., 0]
    frame = fb.render(scene, camera, **options, device=device, ambient_occlusion=2.0)
    floor = np.asarray(frame.object_id) == len(centers)
    open_share = (frame.color[..., 0][floor] / plain[floor])[::7]
    truth = true_openness(positions(frame, camera)[floor][::7], centers, radii, 2.0)
    assert len(truth) > 300
    assert (truth < 0.8).sum() > 40
    error = open_share - truth
    assert abs(error.mean()) <= 0.004
    assert np.sqrt((error**2).mean()) <= 0.015
    assert (np.abs(error) <= 0.06).mean() >= 0.99


BALLS = {
    "mesh": lambda: fb.Mesh(*meshes.icosphere(5)),
    "shape": lambda: fb.sphere(1),
    "quadric": lambda: fb.Quadric.sphere(),
    "dense": lambda: fb.bake(fb.sphere(1), 64, device="cpu"),
    "sparse": lambda: fb.bake(fb.sphere(1), 64, device="cpu").to_sparse(),
}


@pytest.mark.parametrize("kind", BALLS)
def test_occlusion_by_a_ball_is_the_closed_form(kind: str, device: str) -> None:
    # The fraction of light that a ball above the horizon blocks is cos(a) (r / c)^2, at the angle a and the distance c.
    ball, center, radius = BALLS[kind](), np.array([0.0, 0.7, 0.0]), 0.6
    scene = fb.Scene([fb.Instance(ball, moved(*center, scale=(radius,) * 3)), plane(6, y=0)], lights=[], ambient=1)
    camera, options = fb.Camera((0, 4, 5), (0, 0, 0), fov_deg=50), {"size": (80, 60), "shadows": "none"}
    plain = fb.render(scene, camera, **options, device=device)
    frame = fb.render(scene, camera, **options, device=device, ambient_occlusion=100.0)
    floor = plain.object_id == 1
    to_center = center - positions(plain, camera)[floor]
    distance = np.linalg.norm(to_center, axis=1)
    truth = 1 - to_center[:, 1] / distance * (radius / distance) ** 2
    error = (frame.color[..., 0] / plain.color[..., 0])[floor] - truth
    assert (truth < 0.7).sum() > 20
    # A surface has 128 rays, whose strata let the error of a fraction be about a hundredth.
    assert abs(error.mean()) <= 0.002
    assert np.sqrt((error**2).mean()) <= 0.01
    assert np.abs(error).max() <= 0.06


@pytest.mark.parametrize("kind", ["shape", "mesh", "volume"])
def test_occlusion_beside_a_long_wall_is_the_closed_form(kind: str, device: str) -> None:
    # A wall of the height h blocks (1 - d / sqrt(d^2 + h^2)) / 2 of the light at the distance d.
    height, wall = 2.0, fb.box((60, 2, 0.8)).translate((0, 1, -0.4))
    body = {"shape": lambda: wall, "mesh": lambda: wall.to_mesh(60), "volume": lambda: fb.bake(wall, (192, 48, 24))}[
        kind
    ]()
    scene = fb.Scene([fb.Instance(body), plane(40, y=0)], lights=[], ambient=1)
    camera, options = fb.Camera((0, 8, 3), (0, 0, 3), up=(0, 0, -1)), {"size": (60, 50), "shadows": "none"}
    plain = fb.render(scene, camera, **options, device=device)
    frame = fb.render(scene, camera, **options, device=device, ambient_occlusion=60.0)
    place = positions(plain, camera)
    floor = (plain.object_id == 1) & (np.abs(place[..., 0]) <= 5) & (place[..., 2] >= 0.05)
    distance = place[..., 2][floor]
    assert (distance < 1).sum() > 100
    truth = (1 + distance / np.hypot(distance, height)) / 2
    error = (frame.color[..., 0] / plain.color[..., 0])[floor] - truth
    assert abs(error.mean()) <= 0.005
    assert np.sqrt((error**2).mean()) <= 0.015
    assert np.abs(error).max() <= 0.06


@pytest.mark.parametrize("count", [1, 2])
def test_occlusion_grows_with_opacity(count: int, device: str) -> None:
    camera = fb.Camera((0, 4, 5), (0, 0, 0), fov_deg=50)
    passed = {}
    for opacity in (0.0, 0.5, 0.999, 1.0):
        places = [moved(x, 0.7, 0) for x in (-0.7, 0.6)[:count]]
        balls = [fb.Instance(fb.sphere(0.4), place, opacity=opacity, visible=False) for place in places]
        scene = fb.Scene([*balls, plane(6, y=0)], lights=[], ambient=1)
        frame = fb.render(scene, camera, size=(40, 30), ambient_occlusion=4.0, device=device)
        passed[opacity] = frame.color[..., 0][frame.object_id == count]
    blocked, half, nearly = (1 - passed[opacity] / passed[0.0] for opacity in (1.0, 0.5, 0.999))
    assert blocked.max() > 0.15
    if count == 1:
        assert np.abs(half - 0.5 * blocked).max() <= 1e-5
        assert np.abs(nearly - 0.999 * blocked).max() <= 1e-5
    else:
        # Opaque balls, which other balls may hide, block between the product and the sum of what each blocks. The
        # difference is the product of both fractions in a ring cone of the weight 1/8, at most 0.4 x 0.4 / 8, and a
        # quarter of that at half the opacity.
        assert (half >= 0.5 * blocked - 0.005).all()
        assert np.abs(nearly - blocked).max() <= 0.02


@pytest.mark.parametrize("reach", [0.5, 5.0, 100.0])
def test_occlusion_beside_a_knot_is_close_to_rays(reach: float, device: str) -> None:
    knot, place = fb.models.torus_knot(), moved(0, 0.7, 0, scale=(0.5,) * 3)
    scene = fb.Scene([fb.Instance(knot, place), plane(8, y=0)], lights=[], ambient=1)
    camera, options = fb.Camera((0, 4, 5), (0, 0, 0), fov_deg=50), {"size": (60, 45), "shadows": "none"}
    plain = fb.render(scene, camera, **options, device=device)
    frame = fb.render(scene, camera, **options, device=device, ambient_occlusion=reach)
    floor = plain.object_id == 1
    points = positions(plain, camera)[floor]
    random, count = np.random.default_rng(5), 1600
    moved_knot = fb.Mesh(np.asarray(knot.vertices) @ place[:3, :3].T + place[:3, 3], knot.faces)
    truth = np.zeros(len(points))
    for i in range(count):
        spread = (i + random.random(len(points))) / count
        angle = 2 * np.pi * random.random(len(points))
        rays = np.stack([spread**0.5 * np.cos(angle), (1 - spread) ** 0.5, spread**0.5 * np.sin(angle)], axis=1)
        truth += ~(fb.cast_rays(moved_knot, points, rays).t <= reach) / count
    error = (frame.color[..., 0] / plain.color[..., 0])[floor] - truth
    assert (truth < 0.9).sum() > 20
    # A surface has 128 rays. The true fraction of 1,600 rays has a standard error of up to 0.012.
    assert abs(error.mean()) <= 0.002
    assert np.sqrt((error**2).mean()) <= 0.012
    assert np.abs(error).max() <= 0.06


SIDE = fb.Camera((0, 0, 9), (0, 0, 0))
#: Convex bodies, on which no part occludes another one.
CONVEX = {
    "box": fb.box((4, 4, 4)),
    "turned box": fb.box((4, 4, 4)).rotate((1, 2, 3), 25),
    "ball": fb.sphere(2),
    "slab": fb.box((40, 40, 1)),
}


@pytest.mark.parametrize("kind", ["shape", "mesh", "volume"])
@pytest.mark.parametrize("name", CONVEX)
def test_a_convex_body_does_not_occlude_itself(name: str, kind: str, device: str) -> None:
    shape = CONVEX[name]
    body = {"shape": lambda: shape, "mesh": lambda: shape.to_mesh(32), "volume": lambda: fb.bake(shape, 64)}[kind]()
    scene = fb.Scene([fb.Instance(body, material=fb.Material(color=(1, 1, 1)))], lights=[], ambient=1)
    frame = fb.render(scene, SIDE, size=(25, 25), ambient_occlusion=5.0, device=device)
    assert frame.color[frame.object_id == 0][:, :3].min() >= 0.995


@pytest.mark.parametrize("reach", [1.2, 2.0, 3.0])
def test_occlusion_under_a_long_tube_depends_on_the_distance_from_it_alone(reach: float, device: str) -> None:
    cylinder = trimesh.creation.cylinder(0.35, 12, sections=48)
    tube = fb.bake(fb.Mesh(cylinder.vertices, cylinder.faces), 96, device="cpu")
    scene = fb.Scene([fb.Instance(tube, moved(0, 1.2, 0)), plane(8, y=0)], lights=[], ambient=1, background=(0, 0, 0))
    camera = fb.Camera((5, 4, 0.3), (0, 0.4, 0), fov_deg=50)
    options = {"size": (400, 300), "shadows": "none", "device": device}
    plain, frame = (fb.render(scene, camera, **options, ambient_occlusion=wanted) for wanted in (False, reach))
    place = positions(plain, camera)
    # The ends of the tube are out of reach.
    near = (np.asarray(plain.object_id) == 1) & (np.abs(place[..., 2]) <= 2.5)
    share = frame.color[..., 0][near] / plain.color[..., 0][near]
    column = np.floor(place[..., 0][near] / 0.02).astype(int)
    columns = [share[column == i] for i in np.unique(column) if np.sum(column == i) >= 5]
    assert len(columns) > 300
    error = np.concatenate([values - values.mean() for values in columns])
    # A surface has 128 rays, whose strata let the error of a fraction be about a hundredth.
    assert np.sqrt((error**2).mean()) <= 0.01
    assert np.abs(error).max() <= 0.06


def test_interpolated_occlusion_is_that_of_a_finer_picture() -> None:
    ball = fb.Mesh(*meshes.icosphere(3))
    places = [moved(x, 0.35, z, scale=(0.35,) * 3) for x in (-1.5, -0.5, 0.5, 1.5) for z in (-1.5, -0.5, 0.5, 1.5)]
    instances = [fb.Instance(ball, place, resolution=32) for place in places]
    scene = fb.Scene([*instances, plane(4, y=0)], lights=[], ambient=1, background=(0, 0, 0))
    camera = fb.Camera((0, 4, 5), (0, 0, 0), fov_deg=45)
    shares = []
    for scale in (1, 3):
        options = {"size": (scale * 120, scale * 90), "shadows": "none", "device": "cpu"}
        plain = fb.render(scene, camera, **options)
        frame = fb.render(scene, camera, **options, ambient_occlusion=1.5)
        # The centre of a pixel of the first picture is the centre of every third pixel of the second.
        same = np.s_[scale // 2 :: scale, scale // 2 :: scale]
        seen = np.isfinite(plain.depth)
        share = frame.color[..., 0] / np.where(seen, plain.color[..., 0], 1)
        shares.append(share[same][seen[same]])
    error = np.abs(shares[0] - shares[1])
    # One pixel of 64 is on the lattice. The other evaluated pixels lie at contacts and edges.
    assert (frame.steps > plain.steps)[seen].mean() <= 0.15
    # Values two pixels apart that differ by up to 1/4 are averaged, which is off by at most half of it for values that
    # only rise or fall. Errors that are spread evenly up to 1/16, a change as a square, have the mean 1/32.
    assert (error <= 1 / 8).mean() >= 0.97
    assert error.mean() <= 1 / 32


def test_a_bar_appears_on_a_terminal_in_long_work(monkeypatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    from fieldbake.base import progress

    for delay, draws in ((0.0, True), (60.0, False)):
        screen = Terminal()
        monkeypatch.setattr(sys, "stderr", screen)
        monkeypatch.setattr(progress, "DELAY", delay)
        fb.render(fb.Scene([plane()]), size=(16, 16), device="cpu")
        assert ("render" in screen.getvalue()) == draws
        fb.render(fb.Scene([plane()]), size=(16, 16), device="cpu", progress=False)
        assert draws or not screen.getvalue()


def test_progress_is_reported_within_the_light_pass() -> None:
    options = {"shadows": "none", "ambient_occlusion": 4.0, "device": "cpu"}
    # The picture grows until it takes long enough for ten reports, which are 50 ms apart.
    for height in (360, 720, 1440, 2880):
        fractions: list[float] = []
        start = time.monotonic()
        fb.render(crowd(20), CAMERA, size=(height * 4 // 3, height), progress=fractions.append, **options)
        if time.monotonic() - start >= 0.5:
            break
    # The search for visible surfaces is a 25th of the progress. The light pass, which takes longer, reports too.
    assert np.all(np.diff(fractions) >= 0)
    assert sum(0.1 <= fraction <= 0.95 for fraction in fractions) >= 2
