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


def miss_distance(points: np.ndarray, center: np.ndarray, to_light: np.ndarray) -> np.ndarray:
    """How far the ray from each point passes the centre."""
    way = center - points
    along = (way * to_light).sum(-1, keepdims=True)
    return np.linalg.norm(way - along * to_light, axis=-1)


def disc_share(points, center, radius, to_light, slope):
    """Directions of a disc light that pass a sphere, by 400 of them on a sunflower."""
    i = np.arange(400)
    r, a = slope * np.sqrt((i + 0.5) / 400), i * np.pi * (3 - np.sqrt(5))
    right = np.cross(to_light, (0, 0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, to_light)
    share = np.zeros(len(points))
    for x, y in zip(r * np.cos(a), r * np.sin(a), strict=True):
        direction = to_light + x * right + y * up
        share += miss_distance(points, center, direction / np.linalg.norm(direction)) > radius
    return share / 400
