"""Pictures of the nearest samples against a brute-force search of all voxels, in float64."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
from pictures import directions

SIZE = (40, 32)
#: A generic direction in which light travels.
LIGHT = fb.DirectionalLight((-0.41, -0.83, -0.37))


def grid(shape, seed, share):
    """A volume of oblong voxels with samples of -1 or 1, a `share` of them -1."""
    random = np.random.default_rng(seed)
    samples = np.where(random.random(shape) < share, -1, 1).astype(np.float32)
    upper = np.array(shape) * (0.2, 0.25, 0.3)
    return fb.Volume(samples, np.stack([-upper / 2, upper / 2]))


def first_voxel(volume, origins, rays):
    """Parameter of each ray where it enters a voxel whose sample is not positive, and the axis of that face.

    The parameter is inf without a hit, and 0 with axis -1 where the ray starts inside.
    """
    solid = np.argwhere(volume.distances <= 0)
    lower = volume.bounds[0] + solid * volume.spacing
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (lower[:, None] - origins) / rays
        b = (lower[:, None] + volume.spacing - origins) / rays
    near, far = np.fmin(a, b), np.fmax(a, b)
    enter, leave = near.max(axis=-1), far.min(axis=-1)
    t = np.where((enter < leave) & (leave > 0), np.maximum(enter, 0), np.inf)
    first = t.argmin(axis=0)
    which = np.arange(len(rays))
    axis = np.where(t[first, which] > 0, near[first, which].argmax(axis=-1), -1)
    return t[first, which], axis


def pixel_rays(camera, size, shift):
    """Origin and direction of each pixel's ray, (h w, 3) each; the direction advances by 1 along the viewing axis."""
    right, up, back = camera.pose[:3, :3].T
    width, height = size
    if camera.height is None:
        side = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
        rays = directions(camera, size) + side * (shift[0] * right + shift[1] * up)
        return np.broadcast_to(camera.eye, rays.shape).reshape(-1, 3), rays.reshape(-1, 3)
    side = camera.height / height
    x = (np.arange(width) + 0.5 - width / 2 + shift[0]) * side
    y = (height / 2 - np.arange(height) - 0.5 + shift[1]) * side
    starts = camera.eye + x[None, :, None] * right + y[:, None, None] * up
    return starts.reshape(-1, 3), np.broadcast_to(-back, starts.shape).reshape(-1, 3)


def truth(volume, camera, shift=(0.0, 0.0)):
    """Depth, axis of the face, normal and share of the light of each pixel."""
    origins, rays = pixel_rays(camera, SIZE, shift)
    depth, axis = first_voxel(volume, origins, rays)
    hit = np.isfinite(depth)
    normal = np.where(np.arange(3) == axis[:, None], -np.sign(rays), 0.0)
    to_light = -np.array(LIGHT.direction)
    points = origins + np.where(hit, depth, 0)[:, None] * rays + 1e-7 * normal
    shaded, _ = first_voxel(volume, points, np.broadcast_to(to_light, points.shape))
    lit = (normal @ to_light > 0) & ~np.isfinite(shaded)
    return depth, axis, normal, np.where(hit, lit, 1.0)


CAMERAS = {
    "perspective": fb.Camera((1.3, 1.1, 2.3), (0.05, 0, 0.1), fov_deg=40),
    "orthographic": fb.Camera.orthographic((1.3, 1.1, 2.3), (0.05, 0, 0.1), height=1.6),
    "from below": fb.Camera((-1.9, -1.2, -0.8), (0, 0.05, 0), fov_deg=45),
}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize(("shape", "share"), [((6, 5, 4), 0.4), ((5, 6, 3), 1.0), ((9, 7, 8), 0.04), ((1, 1, 1), 1.0)])
def test_voxels_are_those_of_a_search_of_all(shape, share, camera, device):
    volume, view = grid(shape, 7, share), CAMERAS[camera]

    frame = fb.raymarch(volume, view, size=SIZE, filter="nearest", lights=[LIGHT], device=device)
    assert frame.report["device"] == "cpu"

    depth, axis, normal, light = truth(volume, view)
    # A pixel is compared where rays a hundredth of a pixel beside it have the same face and the same light.
    clear = np.ones(len(depth), bool)
    for shift in ((0.01, 0), (-0.01, 0), (0, 0.01), (0, -0.01)):
        near_depth, near_axis, _, near_light = truth(volume, view, shift)
        clear &= (near_axis == axis) & (near_light == light) & (np.isfinite(near_depth) == np.isfinite(depth))
        both = np.isfinite(near_depth) & np.isfinite(depth)
        clear[both] &= np.abs(near_depth[both] - depth[both]) <= 0.05
    assert clear.mean() > 0.9
    hit = clear & np.isfinite(depth)
    assert hit.sum() > 5
    # A position in the grid is float32, of less than 16 voxels of 0.3.
    assert np.abs(frame.depth.ravel()[hit] - depth[hit]).max() <= 20 * 16 * 0.3 * 2**-24
    assert np.abs(frame.normal.reshape(-1, 3)[hit] - normal[hit]).max() <= 1e-6
    assert (frame.shadow.ravel()[clear] == light[clear]).all()
    assert (frame.object_id.ravel()[clear] == np.where(hit, 0, -1)[clear]).all()


def test_an_eye_inside_a_voxel_sees_it_at_depth_0(device):
    volume = grid((4, 4, 4), 1, 1.0)

    frame = fb.raymarch(volume, fb.Camera((0.01, 0.02, 0.03), (1, 0, 0)), size=(4, 4), filter="nearest", device=device)

    assert (frame.depth == 0).all()


def test_the_picture_is_the_sign_of_the_nearest_samples(device):
    # An orthographic section: the first layer of voxels hides all others, so the picture is that layer.
    volume = fb.Volume(np.random.default_rng(3).normal(size=(8, 6, 5)).astype(np.float32), [(0, 0, 0), (8, 6, 5)])
    camera = fb.Camera.orthographic((4, 3, 7), (4, 3, 0), height=6)

    frame = fb.raymarch(volume, camera, size=(24, 18), filter="nearest", device=device)

    x, y = (np.arange(24) + 0.5) / 3, 6 - (np.arange(18) + 0.5) / 3
    points = np.stack([*np.broadcast_arrays(x[None], y[:, None]), np.full((18, 24), 4.5)], axis=-1)
    inside = volume.sample(points, filter="nearest") <= 0
    assert np.array_equal(inside, frame.depth < 2.5)


@pytest.mark.parametrize("kind", ["snorm8", "float16", "sparse"])
def test_stored_forms_are_drawn_like_their_samples(kind, device):
    volume = fb.bake(fb.models.torus_knot(), 24, device="cpu")
    stored = volume.to_sparse() if kind == "sparse" else volume.quantize(kind)
    samples = stored.to_volume().distances if kind == "sparse" else stored.distances
    camera = fb.Camera.fit(volume.bounds)

    found, expected = (
        fb.raymarch(field, camera, size=SIZE, filter="nearest", device=device)
        for field in (stored, fb.Volume(samples, volume.bounds))
    )

    assert np.isfinite(expected.depth).sum() > 100
    for name in ("depth", "normal", "shadow", "color"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@pytest.mark.parametrize(
    ("geometry", "options"),
    [
        (fb.sphere(), {}),
        (fb.Quadric.sphere((0, 0, 0)), {}),
        (grid((3, 3, 3), 1, 0.5), {"lights": [fb.DirectionalLight((0, -1, 0), angle_deg=2)]}),
        (grid((3, 3, 3), 1, 0.5), {"lights": [fb.PointLight((0, 1, 0))]}),
        (grid((3, 3, 3), 1, 0.5), {"filter": "cubic"}),
    ],
)
def test_objects_without_voxels_and_other_shadows_are_refused(geometry, options):
    with pytest.raises(fb.ArgumentError, match="filter"):
        fb.raymarch(geometry, size=(8, 8), **{"filter": "nearest", **options})
