"""Self-tests of a device: small jobs whose results have closed forms. `doctor` calls them in a child process."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

import fieldbake as fb

_Result = TypeVar("_Result")

#: The mesh is a cube with this half side, world units.
HALF = 0.5

#: The self-tests, each a function `check_NAME` of this module.
PATHS = ("bake", "query", "draw", "render")

#: Number of voxels along a side; software adapters need seconds for 48.
RESOLUTION = 16

#: Largest error of a distance: the library guarantees 1e-6 of the diagonal of the box.
DISTANCE_TOLERANCE = 1e-6 * 2 * HALF * 1.1 * 3**0.5

#: Distance of the camera from the front face of the cube, world units.
EYE = 3.5

#: The camera looks at the front face of the cube.
CAMERA = fb.Camera((0, 0, EYE + HALF), (0, 0, 0), fov_deg=45)
SIZE = (64, 64)

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
    """Bake a cube and compare all samples with the distance in closed form."""
    cube = _cube()

    def error(volume: fb.Volume) -> float:
        grid = np.stack(np.meshgrid(*volume.coordinates, indexing="ij"), axis=-1)
        return float(np.abs(volume.distances - _distance(grid)).max())

    return _checked(lambda: fb.bake(cube, RESOLUTION, device=device), error, DISTANCE_TOLERANCE)


def check_query(device: str) -> dict[str, float]:
    """Compute signed distances to a cube at points of a lattice and compare them with the closed form."""
    cube = _cube()
    points = np.stack(np.meshgrid(*[np.linspace(-1.09 * HALF, 1.09 * HALF, 10)] * 3), axis=-1).reshape(-1, 3)

    def error(distances: np.ndarray) -> float:
        return float(np.abs(distances - _distance(points)).max())

    return _checked(lambda: fb.signed_distance(cube, points, device=device), error, DISTANCE_TOLERANCE)


def check_draw(device: str) -> dict[str, float]:
    """Draw the field of a cube and compare the depth of its front face with the distance of the camera."""
    volume = fb.bake(_cube(), RESOLUTION, device="cpu")
    return _checked(lambda: fb.raymarch(volume, CAMERA, size=SIZE, device=device), _depth_error, DEPTH_TOLERANCE)


def check_render(device: str) -> dict[str, float]:
    """Draw two cubes with a light. Compare the depth of one, and the shadow of the other on its upper half."""
    cube = _cube()
    # The light falls towards -x and -z. Its rays to the upper half of the front face pass the second cube.
    beside = np.eye(4)
    beside[:3, 3] = (4 * HALF, HALF, 5 * HALF)
    instances = [fb.Instance(cube, resolution=RESOLUTION), fb.Instance(cube, beside, resolution=RESOLUTION)]
    scene = fb.Scene(instances, lights=[fb.DirectionalLight((-1, 0, -1))])

    def error(frame: fb.Frame) -> float:
        # The edge of the shadow is at row 32. A voxel of the field, which rounds edges, is 3 pixels wide or less.
        dark, lit = frame.shadow[24:28, 24:40], frame.shadow[36:40, 24:40]
        return float(np.max([_depth_error(frame), np.abs(dark).max(), np.abs(lit - 1).max()]))

    def draw() -> fb.Frame:
        return fb.render(scene, CAMERA, size=SIZE, shadows="hard", device=device)

    return _checked(draw, error, DEPTH_TOLERANCE)


def _checked(job: Callable[[], _Result], error_of: Callable[[_Result], float], most: float) -> dict[str, float]:
    """Run a job twice, and return the times of both calls and the largest error. The first call compiles kernels."""
    times, errors = [], []
    for _ in range(2):
        start = time.perf_counter()
        result = job()
        times.append(time.perf_counter() - start)
        errors.append(error_of(result))
    error = float(np.max(errors))  # NaN stays NaN
    if not error <= most:
        raise fb.Error(f"the largest error is {error:.3g}, above {most:.3g}")
    return {"first_seconds": times[0], "seconds": times[1], "error": error}


def _depth_error(frame: fb.Frame) -> float:
    # The face covers the middle 22 pixels: 64 * HALF / (EYE * tan(22.5 degrees)).
    return float(np.abs(frame.depth[24:40, 24:40] - EYE).max())


def _distance(points: np.ndarray) -> np.ndarray:
    """Signed distances from points (..., 3) to the cube, in closed form."""
    outside = np.abs(points) - HALF
    distances: np.ndarray = np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(axis=-1), 0)
    return distances


def _cube() -> fb.Mesh:
    corners = [(x, y, z) for x in (-HALF, HALF) for y in (-HALF, HALF) for z in (-HALF, HALF)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return fb.Mesh(corners, [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
