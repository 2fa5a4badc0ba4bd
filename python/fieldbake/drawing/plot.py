"""Plots of fields and atlases with matplotlib, which is optional."""

from __future__ import annotations

from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..atlases.atlas import Atlas
from ..base import checks
from ..base.errors import Error
from ..base.optional import optional_module
from ..volumes.volume import Volume

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Number of iso-lines on each side of the surface.
LINES = 8

#: Largest height of a figure, inches: a screen of a notebook.
MOST_HEIGHT = 12.0

#: Samples along the longest side of a slice.
SLICE_PX = 200


def _figure(width: float, height: float) -> Figure:
    # pyplot would keep a reference to the figure and may open a window.
    module = optional_module("matplotlib.figure", "a plot", extra="plot")
    figure: Figure = module.Figure(figsize=(width, min(height, MOST_HEIGHT)), layout="constrained")
    # By themselves, notebooks display figures of pyplot only.
    setattr(figure, "_repr_png_", partial(_png, figure))  # noqa: B010
    return figure


def _png(figure: Figure) -> bytes:
    """Encode a figure as PNG, for notebooks."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def plot_slices(volume: Volume, at: Any = None) -> Figure:
    """Plot the three axis-aligned slices of a volume through a point, with iso-lines."""
    lower, upper = volume.bounds
    center = (lower + upper) / 2 if at is None else checks.vector("at", at, 3)
    center = np.clip(center, lower, upper)
    extent = upper - lower
    figure = _figure(12, 4.2)
    axes = figure.subplots(1, 3)
    step = float(np.abs(volume.distances).max()) / LINES
    image = None
    for axis, (across, upward), place in zip((2, 1, 0), ((0, 1), (0, 2), (1, 2)), axes, strict=True):
        columns, rows = (max(2, round(SLICE_PX * extent[side] / extent.max())) for side in (across, upward))
        x = np.linspace(lower[across], upper[across], columns)
        y = np.linspace(lower[upward], upper[upward], rows)
        points = np.empty((rows, columns, 3))
        points[..., axis], points[..., across], points[..., upward] = center[axis], x, y[:, None]
        image = _draw(place, x, y, volume.sample(points), step)
        place.set(xlabel="xyz"[across], ylabel="xyz"[upward], title=f"{'xyz'[axis]} = {center[axis]:.4g}")
    if image is not None:
        figure.colorbar(image, ax=list(axes), label="signed distance", shrink=0.9)
    return figure


def _draw(place: Axes, x: NDArray[Any], y: NDArray[Any], distances: NDArray[Any], step: float) -> Any:
    """Colour distances, white at the surface, with a thick line there and thin iso-lines every `step`."""
    reach = LINES * step or 1.0
    image = place.pcolormesh(x, y, distances, cmap="RdBu", vmin=-reach, vmax=reach, shading="gouraud", rasterized=True)
    lines = [i * step for i in range(-LINES, LINES + 1) if i]
    low, high = float(distances.min()), float(distances.max())
    if step > 0 and (inside := [line for line in lines if low < line < high]):
        place.contour(x, y, distances, inside, colors="black", linewidths=0.4, linestyles="solid", alpha=0.6)
    if low < 0 < high:
        place.contour(x, y, distances, [0], colors="black", linewidths=1.6)
    place.set_aspect("equal")
    return image


def plot_atlas(atlas: Atlas, page: int = 0) -> Figure:
    """Plot the texels of one page with iso-lines at the surface, a frame around each volume, and its index."""
    if not len(atlas.pages):
        raise Error("the atlas is empty; add a volume before you plot it")
    page = checks.integer("page", page, least=0, most=len(atlas.pages) - 1)
    patches = optional_module("matplotlib.patches", "a plot", extra="plot")
    texels = atlas.pages[page].astype(np.float32)
    # Only the rows and columns that contain volumes are shown.
    blocks = {i: atlas._blocks[i] for i in atlas.indices if atlas._blocks["page"][i] == page}
    frames = {i: frame_of(block) for i, block in blocks.items()}
    right = max((x + width for x, _, width, _ in frames.values()), default=atlas.page_size)
    bottom = max((y + height for _, y, _, height in frames.values()), default=atlas.page_size)
    shown = texels[:bottom, :right]
    figure = _figure(8, 0.6 + 8 * bottom / right)
    place = figure.subplots()
    reach = float(np.abs(shown).max()) or 1.0
    place.imshow(shown, cmap="RdBu", vmin=-reach, vmax=reach, interpolation="nearest", extent=(0, right, bottom, 0))
    for i, block in blocks.items():
        x, y, width, height = frames[i]
        (tile_x, tile_y), (nx, ny, nz) = block["tile"].tolist(), block["shape"].tolist()
        gutter, columns = int(block["gutter"]), int(block["columns"])
        for z in range(nz):
            left, top = x + z % columns * tile_x + gutter, y + z // columns * tile_y + gutter
            tile = texels[top : top + ny, left : left + nx]
            if min(nx, ny) > 1 and tile.min() < 0 < tile.max():
                place.contour(
                    left + 0.5 + np.arange(nx), top + 0.5 + np.arange(ny), tile, [0], colors="black", linewidths=0.7
                )
        place.add_patch(patches.Rectangle((x, y), width, height, fill=False, edgecolor="black", linewidth=1.2))
        place.annotate(
            str(i),
            (x, y),
            (3, -3),
            textcoords="offset points",
            va="top",
            fontsize=8,
            fontweight="bold",
            bbox={"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    place.set(title=f"page {page} of {len(atlas.pages)}: {len(blocks)} volumes, {atlas.layout}, {atlas.encoding}")
    return figure


def frame_of(block: Any) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the rectangle of a block, texels."""
    columns, slices = int(block["columns"]), int(block["shape"][2])
    (x, y), (tile_x, tile_y) = block["corner"].tolist(), block["tile"].tolist()
    return x, y, columns * tile_x, -(-slices // columns) * tile_y
