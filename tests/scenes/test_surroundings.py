"""Ambient light from colours and images against closed forms and integrals over the sphere, in float64."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes
from scenes import moved, plane

ALBEDO = np.array([0.9, 0.6, 0.3])
SIZE = (48, 40)
CAMERA = fb.Camera((2.0, 1.5, 3.0), (0, 0, 0), fov_deg=40)


def ball(ambient, primary, device, **options):
    """A picture of a sphere under ambient light alone, and its normals and colours."""
    mesh = fb.Mesh(*meshes.icosphere(3))
    instance = fb.Instance(mesh, material=fb.Material(color=ALBEDO), resolution=24)
    scene = fb.Scene([instance], [], ambient=ambient)
    frame = fb.render(scene, CAMERA, size=SIZE, primary=primary, device=device, **options)
    seen = frame.object_id == 0
    assert seen.sum() > 300
    return frame.normal[seen].astype(float), frame.color[seen][:, :3].astype(float)


def reflected(image, normals, steps=64):
    """Diffuse reflection of a white surface, by the midpoint rule with this many directions per pixel side."""
    rows, columns = image.shape[:2]
    fine = np.kron(image, np.ones((steps, steps, 1)))
    latitude = (0.5 - (np.arange(rows * steps) + 0.5) / (rows * steps)) * np.pi
    longitude = ((np.arange(columns * steps) + 0.5) / (columns * steps) - 0.5) * 2 * np.pi
    c, s = np.cos(latitude)[:, None], np.sin(latitude)[:, None]
    ways = np.stack(np.broadcast_arrays(c * np.sin(longitude), s, -c * np.cos(longitude)), axis=-1).reshape(-1, 3)
    area = np.broadcast_to(c, fine.shape[:2]).reshape(-1) * np.pi / (rows * steps) * 2 * np.pi / (columns * steps)
    cosines = np.maximum(normals @ ways.T, 0)
    return (cosines * area) @ fine.reshape(-1, 3) / np.pi


@pytest.mark.parametrize("primary", ["raster", "raymarch"])
def test_a_colour_and_an_even_image_are_the_same_light(primary, device):
    color = np.array((0.5, 0.25, 0.125))

    for ambient in (color, np.broadcast_to(color, (4, 8, 3)), np.broadcast_to(color, (1, 3, 3))):
        _, found = ball(ambient, primary, device)
        assert np.abs(found - color * ALBEDO).max() <= 1e-6

    _, even = ball((0.25, 0.25, 0.25), primary, device)
    _, number = ball(0.25, primary, device)
    assert np.abs(even - number).max() <= 1e-6


HALVES = {
    # The axis that points to the brighter half, and the image.
    "sky": ((0, 1, 0), [[[1.0, 0.9, 0.8]], [[0.1, 0.2, 0.3]]]),
    "right": ((1, 0, 0), [[[0.1, 0.2, 0.3], [1.0, 0.9, 0.8]]]),
    "ahead": ((0, 0, -1), [[[0.1, 0.2, 0.3], [1.0, 0.9, 0.8], [1.0, 0.9, 0.8], [0.1, 0.2, 0.3]]]),
}


@pytest.mark.parametrize("name", HALVES)
def test_two_halves_are_a_gradient(name, device):
    axis, image = HALVES[name]

    normals, found = ball(image, "raster", device)

    # A hemisphere lights a surface by (1 + cosine) / 2, which spherical harmonics of degree 1 contain.
    share = (1 + normals @ np.array(axis, float))[:, None] / 2
    expected = (share * (1.0, 0.9, 0.8) + (1 - share) * (0.1, 0.2, 0.3)) * ALBEDO
    assert np.abs(found - expected).max() <= 2e-6


@pytest.mark.parametrize("shape", [(4, 8), (5, 3), (2, 2)])
def test_images_light_surfaces_from_all_sides(shape):
    image = np.random.default_rng(8).random((*shape, 3))

    normals, found = ball(image, "raster", "cpu")

    expected = reflected(image, normals[::7]) * ALBEDO
    # The kernels of degree 2 and of the cosine differ by 0.123 in the mean, with mean 0, and the range of L is below 1.
    assert np.abs(found[::7] - expected).max() <= 0.5 * 0.123 * ALBEDO.max()
    assert expected.max() - expected.min() > 0.1


def test_smooth_images_are_exact():
    # L = 1/2 + w.v / 2 for a unit vector v: the reflection is 1/2 + n.v / 3.
    v = np.array((2.0, -1.0, 2.0)) / 3
    rows, columns = 128, 256
    latitude = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    longitude = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * np.pi
    c, s = np.cos(latitude)[:, None], np.sin(latitude)[:, None]
    ways = np.stack(np.broadcast_arrays(c * np.sin(longitude), s, -c * np.cos(longitude)), axis=-1)
    image = np.repeat((0.5 + ways @ v / 2)[..., None], 3, axis=2)

    normals, found = ball(image, "raster", "cpu")

    expected = (0.5 + normals @ v / 3)[:, None] * ALBEDO
    # Pixels are constant: the error is of the order of the square of their side, 1/40.
    assert np.abs(found - expected).max() <= 2e-4


def test_occlusion_reduces_it(device):
    # A floor under a large ball: the contact is dark, and the open floor is as without occlusion.
    objects = [fb.Instance(fb.sphere(1.0)), fb.Instance(plane(), moved(scale=(4, 1, 4)))]
    scene = fb.Scene(objects, [], ambient=[[[1.0, 0.5, 0.25]], [[0, 0, 0]]])
    options = {"size": (24, 18), "shadows": "none", "device": device}
    camera = fb.Camera((2.0, 2.0, 3.0), (0, -1, 0), fov_deg=50)

    closed = fb.render(scene, camera, ambient_occlusion=1.0, **options)
    free = fb.render(scene, camera, **options)

    floor = free.object_id == 1
    share = closed.color[floor][:, :3] / free.color[floor][:, :3]
    assert np.abs(share - share[:, :1]).max() <= 1e-5
    assert share.min() < 0.7
    assert share.max() > 0.95


def test_a_frame_of_the_renderer_and_a_copy_have_it():
    image = np.array(HALVES["right"][1])
    scene = fb.Scene([fb.Instance(fb.Mesh(*meshes.icosphere(2)))], [], ambient=image)

    frames = [
        fb.Renderer(found, size=SIZE, device="cpu").frame(CAMERA)
        for found in (scene, copy.deepcopy(scene), pickle.loads(pickle.dumps(scene)))
    ]

    assert np.array_equal(scene.ambient, image)
    assert not scene.ambient.flags.writeable
    for frame in frames[1:]:
        assert np.array_equal(frame.color, frames[0].color)


def test_views_draw_the_mean_with_a_warning():
    scene = fb.Scene([fb.sphere()], [], ambient=HALVES["sky"][1])

    with pytest.warns(UserWarning, match="draws the mean"):
        scene.to_html(size=(32, 32))


@pytest.mark.parametrize(
    "ambient",
    [
        -0.1,
        np.nan,
        "bright",
        None,
        (1, 2),
        [[1, 2], [3]],
        (1, -1, 1),
        (1, np.nan, 1),
        np.ones((4, 8)),
        np.ones((4, 8, 4)),
        np.ones((0, 8, 3)),
        np.full((2, 2, 3), np.inf),
        np.ones((2, 2, 3), complex),
    ],
)
def test_ambient_light_that_is_no_light_is_refused(ambient):
    with pytest.raises(fb.SceneError, match="ambient"):
        fb.Scene([fb.sphere()], ambient=ambient)
