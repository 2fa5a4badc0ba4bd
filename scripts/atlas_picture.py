"""Make docs/atlas.png: one field from an atlas, drawn by three filters.

    .venv/bin/python scripts/atlas_picture.py

Left: the nearest texel. Middle: the single bilinear tap of the article "Packing 3D SDF to a 2D Texture", smooth
within a slice and blocky along z. Right: two taps and a step along z, which is the trilinear field.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import map_coordinates

import fieldbake as fb

WIDTH_PX, HEIGHT_PX = 320, 240
LABELS = {"nearest": "nearest texel", "slice": "the article's filter", "linear": "two taps and a z step"}
COLOR = np.array([0.80, 0.36, 0.18])
#: A marched step is the distance, as long as that is known to half a voxel.
STEPS, BISECTIONS = 160, 24


def march(distance, camera, spacing, bounds):
    """Depth along each ray of the first zero of `distance`, inf where there is none."""
    origins, directions = rays(camera)
    with np.errstate(divide="ignore"):
        enter, leave = (bounds[0] - origins) / directions, (bounds[1] - origins) / directions
    near = np.minimum(enter, leave).max(axis=-1)
    far = np.maximum(enter, leave).min(axis=-1)
    t = np.maximum(near, 0.0) + 1e-6
    before, hit = t.copy(), np.zeros(len(t), bool)
    alive = t < far
    for _ in range(STEPS):
        rows = np.flatnonzero(alive & ~hit)
        if not len(rows):
            break
        d = distance(origins[rows] + t[rows, None] * directions[rows])
        hit[rows] = d <= 0
        rest, d = rows[d > 0], d[d > 0]
        before[rest] = t[rest]
        t[rest] += np.maximum(d - 0.4 * spacing, 0.06 * spacing)
        alive &= t < far
    # Between the last point outside and the first inside.
    for _ in range(BISECTIONS):
        middle = (before + t) / 2
        inside = np.zeros(len(t), bool)
        inside[hit] = distance((origins + middle[:, None] * directions)[hit]) <= 0
        t, before = np.where(inside, middle, t), np.where(inside, before, middle)
    return np.where(hit, t, np.inf), origins, directions


def rays(camera):
    """One ray through each pixel's centre, row 0 on top."""
    half = np.tan(np.radians(camera.fov_deg) / 2)
    x = (2 * (np.arange(WIDTH_PX) + 0.5) / WIDTH_PX - 1) * half * WIDTH_PX / HEIGHT_PX
    y = (1 - 2 * (np.arange(HEIGHT_PX) + 0.5) / HEIGHT_PX) * half
    local = np.stack([*np.meshgrid(x, y), np.full((HEIGHT_PX, WIDTH_PX), -1.0)], axis=-1).reshape(-1, 3)
    directions = local @ camera.pose[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(camera.pose[:3, 3], directions.shape), directions


def picture(atlas, filter, camera):
    """Shaded by the normal of the hit, from differences of the same field."""
    volume = atlas.unpack(0)
    spacing = float(volume.spacing.max())

    def distance(points):
        if filter == "slice":
            columns, rows = (atlas.texture_coordinates(0, points) * atlas.pages[0].shape[::-1] - 0.5).T
            return map_coordinates(atlas.pages[0].astype(np.float64), (rows, columns), order=1)
        return atlas.sample(0, points, filter=filter).astype(np.float64)

    t, origins, directions = march(distance, camera, spacing, volume.bounds)
    hit = np.isfinite(t)
    points = origins[hit] + t[hit, None] * directions[hit]
    offsets = 0.5 * spacing * np.eye(3)
    normals = np.stack([distance(points + offset) - distance(points - offset) for offset in offsets], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    key = camera.pose[:3, :3] @ np.array([-0.45, 0.6, 0.65])
    light = 0.25 + 0.75 * np.clip(normals @ (key / np.linalg.norm(key)), 0, 1)
    pixels = np.ones((HEIGHT_PX * WIDTH_PX, 3))
    pixels[hit] = COLOR * light[:, None]
    srgb = np.where(pixels <= 0.0031308, 12.92 * pixels, 1.055 * pixels ** (1 / 2.4) - 0.055)
    return Image.fromarray(np.round(255 * np.clip(srgb, 0, 1)).astype(np.uint8).reshape(HEIGHT_PX, WIDTH_PX, 3))


volume = fb.bake(fb.models.torus_knot(), (32, 32, 32))
atlas = fb.pack([volume], layout="strips", page_size=1024)
# From the side, where slices are seen edge on.
center = volume.inner_bounds.mean(axis=0)
camera = fb.Camera(center + np.array([1.9, 3.4, 1.7]), center, up=(0, 0, 1), fov_deg=45)
sheet = Image.new("RGB", (WIDTH_PX * len(LABELS), HEIGHT_PX + 20), "white")
for column, (filter, label) in enumerate(LABELS.items()):
    sheet.paste(picture(atlas, filter, camera), (column * WIDTH_PX, 0))
    ImageDraw.Draw(sheet).text((column * WIDTH_PX + WIDTH_PX // 2, HEIGHT_PX + 4), label, "black", anchor="ma")
target = Path("docs/atlas.png")
sheet.quantize(160).save(target, optimize=True)
print(f"{target}: {target.stat().st_size} bytes")
