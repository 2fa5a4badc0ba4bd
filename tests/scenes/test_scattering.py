"""Light through objects: albedo * light * visibility at the entry * exp(-length inside / scattering length)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import fieldbake as fb
import meshes

CAMERA = fb.Camera((0, 0, 4), (0, 0, 0))
#: Light along +z, toward the camera: every visible point is lit through the object alone.
BEHIND = fb.DirectionalLight((0, 0, 1), angle_deg=2)
SHADOWS = ("hard", "soft", "area")


def jade(length: float | tuple[float, float, float] = 0.2) -> fb.Material:
    return fb.Material(color=(1, 1, 1), scattering=length, specular=0)


def slab(thickness: float, z: float = 0.0, side: float = 1.0) -> fb.Mesh:
    return fb.Mesh(*meshes.box((-side, -side, z - thickness / 2), (side, side, z + thickness / 2)))


def seen(instances: list[fb.Instance], light=BEHIND, size=(33, 33), camera=CAMERA, **options) -> fb.Frame:
    scene = fb.Scene(instances, lights=[light], ambient=0, background=(0, 0, 0))
    return fb.render(scene, camera, size=size, **{"device": "cpu", "area_samples": 16, **options})


def red_in_the_middle(frame: fb.Frame) -> float:
    height, width = frame.color.shape[:2]
    return float(frame.color[height // 2, width // 2, 0])


@pytest.mark.parametrize("thickness", [0.1, 0.2, 0.4, 0.8])
def test_a_slab_passes_the_exponential_of_its_thickness(thickness: float, device: str) -> None:
    frame = seen([fb.Instance(slab(thickness), material=jade((0.2, 0.4, 0.0)))], device=device)
    # Samples of a flat face are exact, so the length inside is right to the rounding of float32: 1e-5 voxels of 1/32.
    truth = [np.exp(-thickness / 0.2), np.exp(-thickness / 0.4), 0]
    np.testing.assert_allclose(frame.color[16, 16, :3], truth, rtol=1e-4, equal_nan=False)


@pytest.mark.parametrize("shadows", SHADOWS)
def test_a_wall_before_the_lamp_keeps_light_out(shadows: str, device: str) -> None:
    instance = fb.Instance(slab(0.2), material=jade())
    wall = fb.Instance(slab(0.2, z=-2, side=3))
    options = {"shadows": shadows, "device": device}
    # A ray of the area lamp is slanted by up to 1 degree: 2e-4 of the exponent.
    np.testing.assert_allclose(red_in_the_middle(seen([instance], **options)), np.exp(-1), rtol=5e-4, equal_nan=False)
    assert red_in_the_middle(seen([instance, wall], **options)) == 0
    # Half-opaque ones keep half.
    veil = fb.Instance(slab(0.2, z=-2, side=3), opacity=0.5)
    np.testing.assert_allclose(
        red_in_the_middle(seen([instance, veil], **options)), np.exp(-1) / 2, rtol=5e-4, equal_nan=False
    )
    # Without shadows nothing is in the way.
    frame = seen([instance, wall], shadows="none", device=device)
    np.testing.assert_allclose(red_in_the_middle(frame), np.exp(-1), rtol=1e-4, equal_nan=False)


BALL = fb.Mesh(*meshes.icosphere(5))
BALLS = {
    "mesh": lambda: BALL,
    "volume": lambda: fb.bake(BALL, 64),
    "sparse": lambda: fb.bake_sparse(BALL, 96),
    "shape": lambda: fb.sphere(1),
    "quadric": fb.Quadric.sphere,
    "entry": lambda: fb.pack([fb.bake(BALL, 64)])[0],
    "nested": lambda: fb.merge([BALL], 32, levels=2),
}


@pytest.mark.parametrize("kind", BALLS)
def test_a_ball_passes_the_exponential_of_its_chord(kind: str) -> None:
    check_ball(kind, "cpu")


@pytest.mark.parametrize("kind", ["mesh", "shape", "quadric"])
def test_a_device_finds_the_same_chords(kind: str, gpu: str) -> None:
    check_ball(kind, gpu)


def check_ball(kind: str, device: str) -> None:
    length = 0.5
    frame = seen([fb.Instance(BALLS[kind](), material=jade(length))], size=(41, 41), device=device)
    x, y = np.meshgrid(*[(np.arange(41) - 20) * 2 * np.tan(np.radians(CAMERA.fov_deg) / 2) / 41] * 2)
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1)
    a, b, c = (rays**2).sum(-1), 4 * rays[..., 2], 15.0
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    hit = CAMERA.eye + ((-b - root) / a)[..., None] * rays
    chord = 2 * hit[..., 2]
    # Grazing light has a chord as uncertain as the height of the surface over it, which a voxel rounds.
    inner = (b * b - a * c > 0) & (chord > 0.8)
    assert inner.sum() > 200
    error = -length * np.log(frame.color[inner, 0]) - chord[inner]
    # The trilinear field of a ball of radius r lies up to h^2 / (4 r) inside it at each end (two curved axes, h^2 / 8 r
    # each), and the ray meets the surface at 0.4 at least; the nested field's voxel is the largest, 2.2 / 32. A sparse
    # field may be off by its tolerance as well, 0.05 voxels at each end, a merged one by 0.6 voxels.
    more = {"sparse": 0.05 * 2.2 / 96, "nested": 0.6 * 0.07}.get(kind, 0)
    bound = 2 * (0.07**2 / 4 + more) / 0.4
    assert np.all(np.abs(error) <= {"shape": 1e-5, "quadric": 1e-5}.get(kind, bound))


def test_the_length_inside_counts_all_of_the_ray_and_ends_at_the_lamp() -> None:
    # A tube of shape: two walls of 0.2 on the ray.
    tube = fb.cylinder(1, 3) - fb.cylinder(0.8, 4)
    frame = seen([fb.Instance(tube.rotate("x", 90), material=jade())])
    np.testing.assert_allclose(red_in_the_middle(frame), np.exp(-2), rtol=1e-3, equal_nan=False)
    # A ball within the tube keeps all light from the wall that is seen.
    core = fb.Instance(fb.sphere(0.3))
    assert red_in_the_middle(seen([fb.Instance(tube.rotate("x", 90), material=jade()), core])) == 0
    lamp = fb.PointLight((0, 0, 0.0))
    np.testing.assert_allclose(
        red_in_the_middle(seen([fb.Instance(slab(0.8), material=jade())], lamp)), np.exp(-2), rtol=1e-3, equal_nan=False
    )


def test_a_wedge_has_no_terraces(device: str) -> None:
    # Thickness from 0.05 to 0.65 over x from -1 to 1, at the 64 voxels of an instance: h = 2 / 60.
    low, high = 0.05, 0.65
    corners = [(x, y, z) for x, top in ((-1, low), (1, high)) for y in (-1, 1) for z in (0, top)]
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
    ]
    wedge = fb.Mesh(np.array(corners, dtype=float), [*faces, (1, 5, 7), (1, 7, 3)])
    frame = seen(
        [fb.Instance(wedge, material=jade())],
        size=(161, 21),
        device=device,
        camera=fb.Camera((0, 0, 9), (0, 0, 0), fov_deg=10),
    )
    row = frame.color[10, :, 0].astype(np.float64)
    side = 2 * np.tan(np.radians(10) / 2) / 21
    x = (np.arange(161) - 80) * side * (9 - 0.35)
    inner = np.abs(x) < 0.85
    thickness = -0.2 * np.log(row[inner])
    # Both faces are flat, so the length inside is right to rounding away from the edges: monotone, no steps.
    slope = (high - low) / 2
    truth = (low + high) / 2 + slope * positions_x(frame, 161, side)[inner]
    assert np.all(np.diff(thickness) > 0)
    voxel = 2 / 60
    assert np.all(np.abs(thickness - truth) <= 0.01 * voxel)
    assert np.all(np.abs(np.diff(thickness, 2)) <= 0.02 * voxel)


def positions_x(frame: fb.Frame, width: int, side: float) -> NDArray[np.float64]:
    """World x of the pixels of the middle row."""
    return (np.arange(width) - width // 2) * side * frame.depth[frame.depth.shape[0] // 2].astype(np.float64)


def test_a_curved_shell_has_no_terraces() -> None:
    # An ear: an ellipsoid 0.3 thick at the default 64 voxels, h = 2 / 60, thinner than 10 voxels everywhere.
    vertices, faces = meshes.icosphere(5)
    ear = fb.Mesh(np.array(vertices) * (1, 1, 0.15), faces)
    camera = fb.Camera((0, 0, 40), (0, 0, 0), fov_deg=3)
    frame = seen([fb.Instance(ear, material=jade(0.1))], size=(129, 33), camera=camera)
    row = frame.color[16, :, 0].astype(np.float64)
    side = 2 * np.tan(np.radians(3) / 2) / 33 * 40
    x = (np.arange(129) - 64) * side
    inner = np.abs(x) < 0.8
    thickness = -0.1 * np.log(row[inner])
    truth = 0.3 * np.sqrt(1 - x[inner] ** 2)
    voxel = 2 / 60
    # A step of the march is half a voxel. The field's surface departs from the true one by h^2 / 8 times the curvature,
    # 0.15 / 0.6^3 at most here, on both faces, and by a facet's sagitta (edge 0.035): a twentieth of a voxel together.
    assert np.all(np.abs(thickness - truth) <= 0.05 * voxel)
    assert np.all(np.abs(np.diff(thickness - truth, 2)) <= 0.05 * voxel)


@pytest.mark.parametrize("shadows", ["area", "soft"])
def test_light_of_an_area_lamp_is_the_monte_carlo_mean(shadows: str, device: str) -> None:
    # A slab from z = -0.2 to 0.2, a wall over x > 0 at z = -2, a disc lamp of 8 degrees from below.
    length, half_angle = 0.3, np.radians(4)
    wall = fb.Mesh(*meshes.box((0, -6, -2.1), (6, 6, -1.9)))
    lamp = fb.DirectionalLight((0, 0, 1), angle_deg=8)
    camera = fb.Camera((0, 0, 30), (0, 0, 0), fov_deg=3)
    objects = [fb.Instance(slab(0.4), material=jade(length)), fb.Instance(wall)]
    frame = seen(objects, lamp, size=(65, 9), camera=camera, shadows=shadows, area_samples=256, device=device)
    x = (np.arange(65) - 32) * 2 * np.tan(np.radians(1.5)) / 9 * (30 - 0.2)
    random = np.random.default_rng(3)
    radius, angle = np.tan(half_angle) * np.sqrt(random.random(20000)), 2 * np.pi * random.random(20000)
    way = np.stack([radius * np.cos(angle), radius * np.sin(angle), -np.ones(20000)], axis=-1)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    inside = 0.4 / -way[:, 2]
    inner = np.abs(x) < 0.75
    # The wall's box meets a ray where its near or far face has x > 0.
    at = [x[inner, None] + way[:, 0] / -way[:, 2] * (0.2 + depth) for depth in (1.9, 2.1)]
    visible = np.maximum(*at) <= 0
    truth = (visible * np.exp(-inside / length)).mean(axis=1)
    found = frame.color[4, inner, 0]
    # 256 spiral points: a straight edge cuts 2 / sqrt(256) of a ring at most, 3 sigma of 20,000 samples are 0.011; soft
    # shadows treat the edge as one at its depth, 0.02.
    assert truth.min() < 0.01 * truth.max()
    np.testing.assert_allclose(found, truth, atol=0.04 * np.exp(-0.4 / length), equal_nan=False)
