"""Draw docs/csg.png: the article's tree, and each pixel in the colour of the part that is seen there."""

import numpy as np

import fieldbake as fb
from fieldbake.drawing.frame import save_image, srgb_from_linear

MODEL = "(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))"
SIZE = (420, 360)
COLORS = np.array([(0.95, 0.75, 0.2), (0.25, 0.55, 0.85), (0.85, 0.35, 0.25)])


def hit_points(frame: fb.Frame, camera: fb.Camera) -> np.ndarray:
    """World positions of all pixels, (h, w, 3); nothing hit gives inf."""
    width, height = frame.size
    slope = np.tan(np.radians(camera.fov_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)
    return camera.eye + frame.depth[..., None].astype(float) * (local @ camera.pose[:3, :3].T)


def main() -> None:
    shape = fb.csg.parse(MODEL)
    direction, up = (0.55, 0.75, -0.6), (0, 0, 1)
    camera = fb.Camera.fit(shape.bounds, direction=direction, up=up, aspect=SIZE[0] / SIZE[1])
    plain = fb.raymarch(shape, camera, size=SIZE, color=(0.7, 0.7, 0.72), device="cpu")
    white = fb.raymarch(shape, camera, size=SIZE, color=(1, 1, 1), specular=0, device="cpu")

    # The last part whose box holds the point and whose surface passes through it; a face belongs to both boxes.
    points = hit_points(plain, camera)
    seen = np.isfinite(plain.depth)
    tint = np.ones((*plain.depth.shape, 3))
    for part, color in zip(fb.csg.decompose(shape, method="aabb"), COLORS, strict=True):
        on_it = np.zeros(seen.shape, dtype=bool)
        on_it[seen] = np.abs(part.shape.distance(points[seen])) < 1e-3
        inside = np.zeros(seen.shape, dtype=bool)
        for lower, upper in part.boxes:
            inside |= ((points >= lower - 1e-3) & (points <= upper + 1e-3)).all(axis=-1)
        tint[on_it & inside] = color
    shaded = srgb_from_linear((white.color[..., :3] * np.where(seen[..., None], tint, 1)).astype(np.float32))
    parts = np.round(np.clip(shaded, 0, 1) * 255).astype(np.uint8)
    save_image(np.concatenate([plain.image[..., :3], parts], axis=1), "docs/csg.png")


if __name__ == "__main__":
    main()
