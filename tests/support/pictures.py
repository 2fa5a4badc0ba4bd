"""Comparison of pictures of the same scene or shape."""

from __future__ import annotations

import numpy as np

import fieldbake as fb
from compare import exceeds

#: Most that depths of the same hit differ.
#: Depths are found in float32 in coordinates where the model, up to 8 units large, has size 1: the field rounds at
#: 1e-6 world
#: units, and a ray that meets the surface at an angle of 1 in 100 moves its root by a hundred times as much.
DEPTH_TOLERANCE = 1e-4


def has_volume(shape):
    lower, upper = shape.bounds
    return bool((upper > lower).all())


def directions(camera, size):
    """World direction through each pixel's centre, one unit long along the viewing axis, (h, w, 3)."""
    width, height = size
    slope = np.tan(np.radians(camera.fov_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1) @ camera.pose[:3, :3].T


def differing_pixels(tree, camera, size, method, device):
    """Pixels of the parts' picture that differ from the whole tree's, where what was hit is a solid.

    A ray that dips into a solid by less than float32 rounds may see it or not, and surfaces that coincide leave
    such solids behind; so a hit counts if NumPy's field falls below the rounding on the way behind it.
    """
    whole = fb.raymarch(tree.shape, camera, size=size, method="whole", shadows="none", device="cpu")
    split = fb.raymarch(tree.shape, camera, size=size, method=method, shadows="none", device=device)
    near = np.minimum(whole.depth, split.depth)
    with np.errstate(invalid="ignore"):
        apart = exceeds(np.abs(whole.depth - split.depth), DEPTH_TOLERANCE)
    # Two rays that miss are at inf both, and equal.
    differs = apart & (whole.depth != split.depth)
    rays = directions(camera, size)[differs]
    behind = near[differs][:, None].astype(float) + np.linspace(0, 0.05, 51)
    points = camera.eye + behind[..., None] * rays[:, None]
    deepest = tree.field(points.reshape(-1, 3)).reshape(behind.shape).min(axis=1, initial=np.inf)
    return int(exceeds(-deepest, DEPTH_TOLERANCE / 10).sum()), int(differs.sum())


def assert_same_picture(here: fb.Frame, there: fb.Frame, scene: fb.Scene) -> None:
    """Equal colours, ids and depths, but for silhouettes: the device rounds corners to 1/256 of a pixel."""
    assert exceeds(np.abs(here.color - there.color).max(axis=-1), 1 / 255).mean() <= 0.005
    same = here.object_id == there.object_id
    assert same.mean() > 0.995
    both = np.isfinite(here.depth) & np.isfinite(there.depth) & same
    size = np.ptp(scene.bounds, axis=0).max()
    assert exceeds(np.abs(here.depth[both] - there.depth[both]), 1e-4 * size).mean() <= 0.002
