"""The program behind `fieldbake demo` and `make demo`: it bakes meshes and draws pictures of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..baking.dense import bake
from ..base.log import logger
from ..base.progress import Progress
from ..base.report import bytes_text
from ..drawing.frame import bytes_from_unit, save_image
from ..drawing.raymarching import PICTURE_SAMPLES, raymarch
from ..loading.readers import load
from ..meshes.convert import load_mesh
from ..meshes.mesh import Mesh
from ..models import gear, torus_knot
from ..scenes.camera import Camera
from ..volumes.volume import Volume

SIZE = (640, 480)

#: Linear RGB and viewing direction for each model made in code.
CLAY = (0.80, 0.36, 0.18)
STEEL = (0.42, 0.52, 0.62)
PLAIN = (0.62, 0.56, 0.44)


def run(
    folder: str | os.PathLike[str],
    meshes: list[str] | None = None,
    *,
    resolution: int = 128,
    progress: Progress = None,
    tell: Callable[[str], object] | None = None,
) -> list[Path]:
    """Bake, save, load and draw meshes and draw slices of their fields; return the paths of the files.

    Parameters
    ----------
    folder : str or path
        Folder for the files; it is created if missing.
    meshes : list of paths, optional
        Mesh files. The default is the models made in code.
    resolution : int, default 128
        Voxels along the longest side.
    progress : bool or callable, optional
        As for :func:`fieldbake.bake`.
    tell : callable, optional
        Receives a line of text for each finished step.
    """
    tell = tell or logger.info
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for name, mesh, color, direction in _subjects(meshes):
        tell(f"{name}: {mesh!r}")
        volume = bake(mesh, resolution, progress=progress)
        tell(f"  baked {volume!r}")
        for line in str(volume.report).splitlines():
            tell(f"    {line}")

        # The volume is saved and loaded again, so that the pictures test the file too.
        archive = out / f"{name}.npz"
        volume.save(archive)
        loaded = load(archive)
        assert isinstance(loaded, Volume)
        volume = loaded
        tell(f"  saved and loaded {archive} ({bytes_text(archive.stat().st_size)})")

        camera = Camera.fit(volume.inner_bounds, direction=direction, aspect=SIZE[0] / SIZE[1])
        frame = raymarch(volume, camera, size=SIZE, samples=PICTURE_SAMPLES, color=color)
        picture, steps, cut = (out / f"{name}{part}.png" for part in ("", "-steps", "-slice"))
        frame.save(picture)
        save_image(frame.heatmap("steps"), steps)
        save_image(slice_image(volume), cut)
        tell(f"  drew {frame!r}")
        tell(f"  wrote {picture}, {steps} (work of each ray), {cut} (the field on its middle plane)")
        written += [archive, picture, steps, cut]
    return written


def _subjects(meshes: list[str] | None) -> Iterator[tuple[str, Mesh, tuple[float, float, float], NDArray[np.float64]]]:
    """Iterate over name, mesh, colour and viewing direction of the objects to draw."""
    for path in meshes or []:
        yield Path(path).stem, load_mesh(path), PLAIN, np.array([-0.55, -0.4, -1.0])
    if not meshes:
        yield "knot", torus_knot(), CLAY, np.array([-0.35, -0.45, -1.0])
        yield "gear", gear(), STEEL, np.array([0.55, -0.5, -1.0])


def slice_image(volume: Volume, *, height_px: int = 480) -> NDArray[np.uint8]:
    """Draw the middle slice along the shortest axis: blue inside, orange outside, a line every few voxels.

    Returns
    -------
    (h, w, 3) uint8
        sRGB.
    """
    axis = int(np.argmin(volume.resolution))
    across, upward = (other for other in range(3) if other != axis)
    lower, upper = volume.bounds
    extent = upper - lower
    height = height_px
    width = max(1, round(height * extent[across] / extent[upward]))

    # World position of the centre of each pixel, row 0 on top.
    positions = np.empty((height, width, 3))
    positions[..., axis] = (lower[axis] + upper[axis]) / 2
    positions[..., across] = lower[across] + (np.arange(width) + 0.5) / width * extent[across]
    positions[..., upward] = (upper[upward] - (np.arange(height) + 0.5) / height * extent[upward])[:, None]
    distances = volume.sample(positions).astype(np.float64)

    # Colour fades with the distance. Lines are 1.5 pixels wide where the gradient of the field has the length 1.
    pixel = extent[upward] / height
    interval = 6 * float(volume.spacing.max())
    fade = np.exp(-np.abs(distances) / (8 * interval))[..., None]
    inside, outside = np.array([0.18, 0.42, 0.72]), np.array([0.93, 0.60, 0.28])
    rgb = np.where((distances < 0)[..., None], inside, outside) * (0.45 + 0.55 * fade)
    to_line = np.abs(distances - np.round(distances / interval) * interval)
    rgb *= np.clip(to_line / (1.5 * pixel), 0.72, 1.0)[..., None]
    surface = np.clip(np.abs(distances) / (2 * pixel), 0, 1)[..., None]
    rgb = rgb * surface + (1 - surface)
    return bytes_from_unit(rgb)
