"""Several samples for a pixel: edges as smooth as in a reduced picture, at a small part of its cost."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb

SIZE = 96


def premultiplied(color: np.ndarray) -> np.ndarray:
    return np.concatenate([color[..., :3] * color[..., 3:], color[..., 3:]], axis=-1)


def reduced(scene: fb.Scene, camera: fb.Camera, sides: int, **options) -> np.ndarray:
    """The means of `sides` times `sides` pixels of a large picture: the samples of `fb.render`, all of them."""
    large = premultiplied(fb.render(scene, camera, size=(sides * SIZE, sides * SIZE), **options).color)
    return large.reshape(SIZE, sides, SIZE, sides, 4).mean(axis=(1, 3))


def displayed(color: np.ndarray) -> np.ndarray:
    """Colours as `fb.render` compares them: square roots, which are near sRGB."""
    return np.sqrt(np.clip(color, 0, 1))


def knot() -> fb.Mesh:
    return fb.models.torus_knot(segments=120, sides=12)


def wires() -> fb.Scene:
    """Twelve white bars, half a pixel wide and of different slopes."""
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * (0.01, 2.2, 0.01)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    bar = fb.Mesh(corners, [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    white = fb.Material(color=(1, 1, 1), unlit=True)
    instances = []
    for x, slope in zip(np.linspace(-0.9, 0.9, 12), np.deg2rad(np.linspace(-8, 8, 12)), strict=True):
        transform = np.eye(4)
        transform[:2, :2] = [(np.cos(slope), -np.sin(slope)), (np.sin(slope), np.cos(slope))]
        transform[0, 3] = x
        instances.append(fb.Instance(bar, transform, white))
    return fb.Scene(instances, background=(0, 0, 0))


@pytest.mark.parametrize("sides", [2, 3])
@pytest.mark.parametrize(
    ("make", "options"),
    [
        (knot, {"shadows": "hard"}),
        (lambda: fb.bake(knot(), 48), {"shadows": "hard", "primary": "raymarch"}),
        (lambda: fb.box(1.2) - fb.sphere(0.8), {"shadows": "none"}),
    ],
)
def test_pixels_have_the_mean_of_their_samples(make, options, sides) -> None:
    scene = fb.Scene([make()], background=(0.1, 0.2, 0.3, 0.5))
    camera = fb.Camera.fit(scene.bounds)

    found = fb.render(scene, camera, size=(SIZE, SIZE), samples=sides**2, device="cpu", **options)

    truth = reduced(scene, camera, sides, device="cpu", **options)
    error = np.abs(displayed(premultiplied(found.color)) - displayed(truth)).max(axis=-1)
    # An edge between colours that differ evenly, by 1/32, changes the mean of a pixel by half of that. The rest are
    # details that lie between the centres of even pixels.
    assert (error <= 1 / 64).mean() >= 0.999
    single = fb.render(scene, camera, size=(SIZE, SIZE), device="cpu", **options).color
    assert (np.abs(displayed(premultiplied(single)) - displayed(truth)).max(axis=-1) > 1 / 64).mean() >= 0.02


def test_lines_thinner_than_a_pixel_have_no_gaps() -> None:
    scene = wires()
    camera = fb.Camera.orthographic((0, 0, 4), (0, 0, 0), height=2.0)

    found = fb.render(scene, camera, size=(SIZE, SIZE), samples=16, device="cpu").color[..., 0]

    truth = reduced(scene, camera, 4, device="cpu")[..., 0]
    assert (truth > 0).mean() > 0.1
    assert np.array_equal(found > 0, truth > 0)


def test_devices_agree(device) -> None:
    scene = fb.Scene([knot()])
    pictures = [fb.render(scene, size=(48, 48), samples=4, shadows="hard", device=on).color for on in ("cpu", device)]
    # The share of equal pixels that all pictures of devices have.
    assert (np.abs(displayed(pictures[0]) - displayed(pictures[1])).max(axis=-1) <= 1 / 255).mean() >= 0.995


def test_raymarch_takes_samples() -> None:
    volume = fb.bake(fb.sphere(1), 24)
    single = fb.raymarch(volume, size=(64, 64), device="cpu")
    smooth = fb.raymarch(volume, size=(64, 64), samples=16, device="cpu")
    # The search of a scene has its own rounding of float32 positions.
    assert np.array_equal(np.isfinite(single.depth), np.isfinite(smooth.depth))
    hit = np.isfinite(single.depth)
    assert np.abs(single.depth[hit] - smooth.depth[hit]).max() <= 1e-5
    # The rim is between the colours of the ball and of the background.
    assert len(np.unique(smooth.color[..., 0])) > len(np.unique(single.color[..., 0]))
    with pytest.raises(fb.SceneError, match=r"^samples: must be a square number from 1 to 64, got 5"):
        fb.raymarch(volume, samples=5, device="cpu")
    with pytest.raises(fb.SceneError, match=r"^samples: must be from 1 to 64, got 0"):
        fb.raymarch(volume, samples=0)
    with pytest.raises(fb.ArgumentError, match=r"one sample per pixel"):
        fb.raymarch(volume, filter="nearest", samples=4)
