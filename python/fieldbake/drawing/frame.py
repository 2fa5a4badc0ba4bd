"""The frame: the result of a picture as arrays and as an image."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, FormatError
from ..files.container import atomic_write, check_target

Quantity = Literal["steps", "rays", "depth", "shadow"]

#: Names of the arrays of a frame.
ARRAYS = ("color", "depth", "normal", "object_id", "shadow", "steps", "rays")

#: Evenly spaced stops of the heat map from dark to light, (5, 3), sRGB from 0 to 1.
HEAT = np.array(
    [[0.03, 0.03, 0.12], [0.25, 0.12, 0.45], [0.70, 0.20, 0.42], [0.96, 0.50, 0.25], [1.00, 0.92, 0.60]],
    dtype=np.float64,
)

#: Colour of pixels without a hit in a heat map of depth, sRGB.
NOTHING = np.array([0.55, 0.55, 0.55])

#: Endings of image formats without opacity.
WITHOUT_ALPHA = (".jpg", ".jpeg", ".bmp", ".ppm")


class Frame:
    """The result of a picture: read-only arrays of shape (height, width, ...), row 0 on top.

    Attributes
    ----------
    color : (h, w, 4) float32
        Linear RGB and opacity. The colour is not multiplied by the opacity.
    depth : (h, w) float32
        Distance along the viewing axis, world units; inf for pixels without a hit.
    normal : (h, w, 3) float32
        Unit normal of the surface, world space; zero for pixels without a hit. The normal of a volume is the direction
        of central differences over a voxel.
    object_id : (h, w) int32
        Index of the visible object; -1 for pixels without a hit. `depth`, `normal`, `object_id` and `shadow` belong to
        the first surface that hides at least half of what is behind it.
    shadow : (h, w) or (h, w, lights) float32
        Fraction of the light that arrives: 1 is lit, 0 is in shadow.
    steps : (h, w) uint32
        Number of steps of all rays and cones of the pixel. Nodes of trees count on the CPU only.
    rays : (h, w) uint32 or None
        Number of rays and cones to lights and surroundings that were evaluated for the centre of the pixel: 0 where
        its light is interpolated. None where :func:`raymarch` draws an object by a pass of its own.
    report : mapping
        ``device``, ``seconds`` and other properties of the work.

    Examples
    --------
    >>> import fieldbake as fb
    >>> frame = fb.raymarch(fb.sphere(), size=(64, 48))
    >>> frame.depth.shape, frame.image.dtype.name, bool(frame.object_id[24, 32] == 0)
    ((48, 64), 'uint8', True)
    """

    def __init__(self, arrays: Mapping[str, NDArray[Any]], report: Mapping[str, Any]) -> None:
        self.color: NDArray[np.float32] = checks.frozen(arrays["color"])
        self.depth: NDArray[np.float32] = checks.frozen(arrays["depth"])
        self.normal: NDArray[np.float32] = checks.frozen(arrays["normal"])
        self.object_id: NDArray[np.int32] = checks.frozen(arrays["object_id"])
        self.shadow: NDArray[np.float32] = checks.frozen(arrays["shadow"])
        self.steps: NDArray[np.uint32] = checks.frozen(arrays["steps"])
        rays = arrays.get("rays")
        self.rays: NDArray[np.uint32] | None = None if rays is None else checks.frozen(rays)
        self.report: Mapping[str, Any] = MappingProxyType(dict(report))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.color.shape[1], self.color.shape[0]

    @cached_property
    def image(self) -> NDArray[np.uint8]:
        """The image, (h, w, 4) uint8: sRGB and opacity."""
        rgb = srgb_from_linear(self.color[..., :3])
        return checks.frozen(bytes_from_unit(np.concatenate([rgb, self.color[..., 3:]], axis=-1)))

    def heatmap(self, quantity: Quantity = "steps", *, tile: int = 1) -> NDArray[np.uint8]:
        """Convert one of the arrays to an image, dark for small and light for large values.

        Parameters
        ----------
        quantity : "steps", "rays", "depth" or "shadow", default "steps"
            The array. For several lights, the mean of their shadows.
        tile : int, default 1
            Side of square tiles in pixels, from the upper left corner. Each tile shows the mean of its values. Devices
            compute the pixels of a tile of 8 together, so ``tile=8`` shows where their work is.

        Returns
        -------
        (h, w, 3) uint8
            sRGB. The colours span the range from the smallest to the largest value of the image; pixels and tiles
            without a value are grey.

        Raises
        ------
        ArgumentError
            For an unknown quantity, for ``"rays"`` in a picture without them, and for a tile below 1.
        """
        checks.choice("quantity", quantity, get_args(Quantity))
        tile = checks.integer("tile", tile, least=1, most=2**31)
        if getattr(self, quantity) is None:
            raise ArgumentError(f"quantity: this picture has no {quantity}; pictures of render() have them")
        values = np.asarray(getattr(self, quantity), dtype=np.float64)
        if values.ndim == 3:
            values = values.mean(axis=-1)
        seen = np.isfinite(values)
        if tile > 1:
            values = _tile_sums(np.where(seen, values, 0.0), tile) / np.maximum(_tile_sums(seen, tile), 1)
            seen = _tile_sums(seen, tile) > 0
        low, high = (values[seen].min(), values[seen].max()) if seen.any() else (0.0, 1.0)
        share = np.where(seen, values - low, 0.0) / (high - low if high > low else 1.0)
        stops = np.linspace(0, 1, len(HEAT))
        rgb = np.stack([np.interp(share, stops, HEAT[:, channel]) for channel in range(3)], axis=-1)
        rgb[~seen] = NOTHING
        return bytes_from_unit(rgb)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the 8-bit image as .png, .jpg, .webp, .tiff or .bmp, or another format of Pillow.

        The floats of `color`, `depth` and `normal` are arrays: ``numpy.savez(path, depth=frame.depth)`` keeps them.
        A format without opacity, such as .jpg, has the picture over the colour of its most transparent pixel.

        Raises
        ------
        FormatError
            For another ending.
        OSError
            If the file cannot be written.
        """
        pixels = self.image
        if checks.path(path).suffix.lower() in WITHOUT_ALPHA:
            rgb, opacity = self.color[..., :3], self.color[..., 3:]
            behind = rgb.reshape(-1, 3)[opacity.argmin()]
            pixels = bytes_from_unit(srgb_from_linear(rgb * opacity + behind * (1 - opacity)))
        save_image(pixels, path)

    def _repr_png_(self) -> bytes:
        """The image as PNG, for notebooks."""
        from io import BytesIO

        from PIL import Image

        buffer = BytesIO()
        Image.fromarray(self.image).save(buffer, format="PNG")
        return buffer.getvalue()

    def __reduce__(self) -> tuple[Any, ...]:
        arrays = {name: np.array(value) for name in ARRAYS if (value := getattr(self, name)) is not None}
        return Frame, (arrays, dict(self.report))

    def __repr__(self) -> str:
        hit = np.count_nonzero(self.object_id >= 0) / self.object_id.size
        return f"Frame({self.size[0]} x {self.size[1]} pixels, {hit:.0%} hit, on {self.report.get('device', '?')})"


def _tile_sums(values: NDArray[Any], tile: int) -> NDArray[np.float64]:
    """The sum over the tile of each pixel, (h, w). The last tiles of a row or a column may be smaller."""
    height, width = values.shape
    sums = np.add.reduceat(values, np.arange(0, height, tile), axis=0, dtype=np.float64)
    sums = np.add.reduceat(sums, np.arange(0, width, tile), axis=1)
    return sums.repeat(tile, axis=0)[:height].repeat(tile, axis=1)[:, :width]


def srgb_from_linear(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert linear RGB to sRGB (IEC 61966-2-1), clamped to 0 to 1."""
    cut = np.clip(linear, 0, 1)
    return np.where(cut <= 0.0031308, 12.92 * cut, 1.055 * np.power(cut, 1 / 2.4) - 0.055).astype(np.float32)


def check_picture(target: Path) -> str:
    """Return the image format of the ending of a file; raise an error if it or the folder cannot be written."""
    from PIL import Image

    kind = Image.registered_extensions().get(target.suffix.lower())
    if kind is None or kind not in Image.SAVE:
        raise FormatError(
            f"{target}: cannot write a picture ending in '{target.suffix}'; use .png, .jpg, .webp, .tiff or .bmp"
        )
    check_target(target)
    return kind


def save_image(pixels: NDArray[np.uint8], path: str | os.PathLike[str]) -> None:
    """Write sRGB bytes (h, w, 3 or 4). The file appears only when it is complete."""
    from PIL import Image

    target = checks.path(path)
    suffix = target.suffix.lower()
    kind = check_picture(target)
    image = Image.fromarray(pixels)
    if suffix in WITHOUT_ALPHA:
        image = image.convert("RGB")
    with atomic_write(target) as stream:
        image.save(stream, format=kind)


def bytes_from_unit(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert values from 0 to 1 to bytes, rounded."""
    pixels: NDArray[np.uint8] = np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return pixels
