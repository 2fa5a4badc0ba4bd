"""The default light and background: the same in all pictures, without clipped highlights, with visible outlines."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
from fieldbake.drawing.frame import srgb_from_linear

CAMERA = fb.Camera((0.6, 0.8, 3.4), (0, 0, 0))


def ball(color):
    return fb.Scene([fb.Instance(fb.sphere(1.0), material=fb.Material(color=color))])


@pytest.mark.parametrize("color", [(1, 1, 1), (0.2, 0.5, 0.1)])
def test_a_ball_follows_the_documented_formula(color):
    """Colour from the sphere's own normals: ambient 0.2, key light of 0.64 from (0.45, 0.7, 0.55) in camera space."""
    frame = fb.render(ball(color), CAMERA, size=(48, 48), shadows="none", device="cpu")
    hit = frame.object_id >= 0
    slope = np.tan(np.radians(CAMERA.fov_deg) / 2)
    x = ((np.arange(48) + 0.5) / 24 - 1) * slope
    rays = np.stack(np.broadcast_arrays(x[None, :], -x[:, None], -1.0), axis=-1) @ CAMERA.pose[:3, :3].T
    normal = CAMERA.eye + frame.depth[hit][:, None].astype(float) * rays[hit]
    to_light = CAMERA.pose[:3, :3] @ np.array([0.45, 0.7, 0.55])
    to_light /= np.linalg.norm(to_light)
    to_eye = -rays[hit] / np.linalg.norm(rays[hit], axis=1, keepdims=True)
    half = to_light + to_eye
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosine = normal @ to_light
    highlight = np.where(cosine > 0, 0.25 * np.maximum((normal * half).sum(1), 0) ** 32, 0)
    expected = 0.2 * np.array(color) + 0.64 * (np.maximum(cosine, 0)[:, None] * np.array(color) + highlight[:, None])
    # Depth is float32: 2e-7 of a depth of 4 over the radius, times the highlight's slope of 32.
    np.testing.assert_allclose(frame.color[hit][:, :3], expected, equal_nan=False, atol=5e-5)


def test_scenes_and_fields_have_one_light():
    volume = fb.bake(fb.sphere(1.0), 32, device="cpu")
    marched = fb.raymarch(volume, CAMERA, size=(24, 24), device="cpu")
    assert np.array_equal(
        fb.arrays.raymarch(volume.distances, *volume.bounds, CAMERA.pose, size=(24, 24), device="cpu")[0], marched.color
    )
    rendered = fb.render(volume, CAMERA, size=(24, 24), shadows="hard", device="cpu")
    hit = marched.object_id >= 0
    # Normals of both are float32 and differ in their last bits; a highlight multiplies that by 32.
    close = np.abs(rendered.color[hit][:, :3] - marched.color[hit][:, :3]) <= 1e-4
    assert close.all(axis=1).mean() >= 0.95
    assert np.array_equal(rendered.color[~hit], marched.color[~hit])


@pytest.mark.parametrize("direction", [(-0.5, -0.4, -1), (0.6, 0.3, -1), (0.2, -1, 0.4)])
@pytest.mark.parametrize("shade", [0.0, 1.0])
@pytest.mark.parametrize("draw", ["render", "raymarch"])
def test_white_keeps_its_shading_and_outlines_are_visible(draw, shade, direction):
    mesh = fb.models.torus_knot(segments=96, sides=12)
    camera = fb.Camera.fit(mesh.bounds, direction=direction)
    material = fb.Material(color=(shade,) * 3)
    if draw == "render":
        frame = fb.render(fb.Scene([fb.Instance(mesh, material=material)]), camera, size=(96, 96), device="cpu")
    else:
        frame = fb.raymarch(fb.bake(mesh, 48, device="cpu"), camera, size=(96, 96), color=(shade,) * 3, device="cpu")
    hit = frame.object_id >= 0
    image = frame.image[..., :3].astype(int)
    assert (image[hit].max(axis=-1) < 254).mean() >= 0.99

    # Pairs of neighbours across the outline. An albedo of 0 leaves the highlight, which may cross the background's
    # own shade at a few places of its edge.
    behind = np.round(255 * srgb_from_linear(np.float32((0.025, 0.03, 0.04)))).astype(int)
    assert (image[~hit] == behind).all()
    outline = hit & ~(np.roll(hit, 1, 0) & np.roll(hit, -1, 0) & np.roll(hit, 1, 1) & np.roll(hit, -1, 1))
    contrast = np.abs(image[outline] - behind).max(axis=-1)
    assert (contrast >= 30).mean() >= 0.98
