"""Places, a floor and a sun for tests of scenes."""

from __future__ import annotations

import numpy as np

import fieldbake as fb

SUN = (-1.0, -2.0, -0.6)


def plane(side: float = 6.0, y: float = -1.0) -> fb.Mesh:
    corners = [(-side, y, -side), (side, y, -side), (side, y, side), (-side, y, side)]
    return fb.Mesh(corners, [(0, 2, 1), (0, 3, 2)])


def moved(x=0.0, y=0.0, z=0.0, scale=(1.0, 1.0, 1.0), turn=0.0) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.diag(scale)
    matrix[:3, 3] = x, y, z
    return matrix


def positions(frame: fb.Frame, camera: fb.Camera) -> np.ndarray:
    """World points of the pixels, float64; nan where nothing is hit."""
    width, height = frame.size
    side = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * side
    y = (height / 2 - np.arange(height) - 0.5) * side
    rays = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), axis=-1) @ camera.pose[:3, :3].T
    depth = np.where(np.isfinite(frame.depth), frame.depth, np.nan)[..., None]
    return camera.eye + depth * rays
