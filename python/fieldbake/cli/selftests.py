"""Self-tests of a device: small jobs whose results have closed forms. `doctor` calls them in a child process."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import fieldbake as fb

#: The mesh is a cube with this half side, world units.
HALF = 0.5

#: Number of voxels along a side, about 5 ms of work on a CPU; software adapters need seconds for 48.
RESOLUTION = 16

#: Largest error of a distance: the library guarantees 1e-6 of the diagonal of the box.
DISTANCE_TOLERANCE = 1e-6 * 2 * HALF * 1.1 * 3**0.5

#: Distance of the camera from the front face of the cube, world units.
EYE = 3.5

#: Largest error of the depth. In front of the face the field is linear with slope 1, so a root has the error of the
#: samples; four roundings of float32 values near `EYE` are 1e-6.
DEPTH_TOLERANCE = DISTANCE_TOLERANCE + 1e-6


def list_devices() -> list[dict[str, Any]]:
    """List the devices as plain values."""
    return [
        {
            "name": device.name,
            "backend": device.backend,
            "type": device.type,
            "hardware": device.hardware,
            "limits": dict(device.limits),
        }
        for device in fb.devices()
    ]


def check_bake(device: str) -> dict[str, float]:
    """Bake a cube on a device and compare all samples with the distance in closed form."""
    start = time.perf_counter()
    volume = fb.bake(_cube(), RESOLUTION, device=device)
    samples = volume.distances
    seconds = time.perf_counter() - start
    axes = [volume.origin[axis] + volume.spacing[axis] * np.arange(volume.resolution[axis]) for axis in range(3)]
    outside = np.abs(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)) - HALF
    truth = np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(axis=-1), 0)
    return _checked(seconds, float(np.abs(samples - truth).max()), DISTANCE_TOLERANCE)


def check_draw(device: str) -> dict[str, float]:
    """Draw a cube on a device and compare the depth of its front face with the distance of the camera."""
    volume = fb.bake(_cube(), RESOLUTION, device="cpu")
    camera = fb.Camera((0, 0, EYE + HALF), (0, 0, 0), fov_deg=45)
    start = time.perf_counter()
    depth = fb.raymarch(volume, camera, size=(64, 64), device=device).depth
    seconds = time.perf_counter() - start
    # The face covers the middle 22 pixels: 64 * HALF / (EYE * tan(22.5 degrees)).
    middle = depth[24:40, 24:40]
    return _checked(seconds, float(np.abs(middle - EYE).max()), DEPTH_TOLERANCE)


def _checked(seconds: float, error: float, most: float) -> dict[str, float]:
    if not error <= most:
        raise fb.Error(f"the largest error is {error:.3g}, above {most:.3g}")
    return {"seconds": seconds, "error": error}


def _cube() -> fb.Mesh:
    corners = [(x, y, z) for x in (-HALF, HALF) for y in (-HALF, HALF) for z in (-HALF, HALF)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return fb.Mesh(corners, [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
