"""The regular grid of a volume: its box and its number of voxels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks
from .errors import ArgumentError

Resolution = int | Sequence[int]

DEFAULT_RESOLUTION = 64

#: Largest number of voxels along one side. Beyond it even a slab of one voxel exceeds any memory.
MAX_SIDE = 2**31 - 1

#: Largest number of voxels of a volume. It is the limit of the core.
MAX_VOXELS = 2**40

#: Tolerance, in voxels, within which a side counts as a whole number of voxels. It covers the rounding of a division.
WHOLE = 1e-6


@dataclass(frozen=True)
class Grid:
    """A box divided into voxels. Samples lie at voxel centres: ``lower + (index + 0.5) * spacing``."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    shape: tuple[int, int, int]

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Size of a voxel, world units."""
        x, y, z = ((u - l) / n for l, u, n in zip(self.lower, self.upper, self.shape, strict=True))
        return x, y, z


def make_grid(
    inner: NDArray[np.float64],
    resolution: Resolution = DEFAULT_RESOLUTION,
    *,
    voxel_size: float | None = None,
    bounds: ArrayLike | None = None,
    margin: float = 0.1,
    border: ArrayLike = 1.0,
    default: int = DEFAULT_RESOLUTION,
) -> Grid:
    """Choose the grid for a surface in the box `inner`.

    Parameters
    ----------
    inner : (2, 3) array
        Box of the surface, world units. Sides may be zero.
    resolution : int or three ints, default 64
        One number: voxels along the longest side of the box. The voxels are cubic, and the box is enlarged about its
        centre to whole voxels along the other sides. Three numbers: voxels along x, y and z, which may be oblong.
    voxel_size : float, optional
        Side of a cubic voxel, world units. It replaces `resolution`, which must then have its default value.
    bounds : (2, 3) array, optional
        Box to sample. It replaces the box of the surface and its margin.
    margin : float, default 0.1
        The box of the surface is scaled by ``1 + margin`` about its centre, then enlarged to leave at least `border`
        voxels on each side, as far as the number of voxels allows.
    border : float or (3,), default 1
        Number of voxels left free on each side, along x, y and z.
    default : int, default 64
        Default value of `resolution` in the calling function.

    Raises
    ------
    ArgumentError
        For an option out of range, or both `resolution` and `voxel_size`.

    Examples
    --------
    >>> grid = make_grid(np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 0.0]]), 22)
    >>> grid.shape, round(grid.spacing[0], 6)
    ((22, 12, 2), 0.1)
    """
    margin = checks.number("margin", margin, least=0)
    if voxel_size is not None:
        voxel_size = checks.number("voxel_size", voxel_size, above=0)
        if not isinstance(resolution, (int, np.integer)) or resolution != default:
            raise ArgumentError(f"voxel_size: give either voxel_size ({voxel_size:g}) or resolution ({resolution})")

    # The smallest box of the grid, and the part of it that must keep the border on both sides.
    outer = None if bounds is None else checks.box("bounds", bounds)
    box = inner if outer is None else outer
    center = (box[0] + box[1]) / 2
    extent = box[1] - box[0]
    if not (extent > 0).any():
        if outer is None:
            raise ArgumentError(f"shape: is empty, with the box {box.tolist()}; its parts do not overlap")
        raise ArgumentError(f"bounds: the box is the point {box[0].tolist()}, which has no voxels")
    covered = extent * (1 + margin) if outer is None else extent
    border_voxels = (2.0 if outer is None else 0.0) * np.broadcast_to(np.asarray(border, dtype=np.float64), 3)

    if voxel_size is not None:
        return _cubic(center, extent, covered, border_voxels, voxel_size, "voxel_size")
    try:
        sides = list(resolution)  # type: ignore[arg-type]
    except TypeError:
        return _cubic_from_count(center, extent, covered, border_voxels, resolution)
    if len(sides) != 3:
        raise ArgumentError(f"resolution: must be one whole number or three, got {checks.describe(resolution)}")
    shape = [checks.integer("resolution", n, least=1, most=MAX_SIDE) for n in sides]
    if outer is not None and not _flat(extent).any():
        # The corners stay as given, to the bit, so that the box of a volume makes the grid of that volume.
        return _grid(outer[0], outer[1], shape)
    return _oblong(center, extent, covered, border_voxels, shape)


def check_count(grid: Grid) -> Grid:
    """Return the grid of a volume, or raise an error with the largest grid in the same box."""
    count = math.prod(grid.shape)
    if count > MAX_VOXELS:
        share = (MAX_VOXELS / count) ** (1 / 3)
        most = math.floor(max(grid.shape) * share)
        x, y, z = grid.shape
        raise ArgumentError(
            f"resolution: {x} x {y} x {z} are {count:.2g} voxels, and a field has at most {MAX_VOXELS:.2g}; use at "
            f"most {most} along the longest side, or a smaller box (bounds)"
        )
    return grid


def _cubic_from_count(
    center: NDArray[np.float64],
    extent: NDArray[np.float64],
    covered: NDArray[np.float64],
    border_voxels: NDArray[np.float64],
    resolution: object,
) -> Grid:
    count = checks.integer("resolution", resolution, least=1, most=MAX_SIDE)
    spacing = float(covered.max()) / count
    if count > border_voxels.max():
        spacing = max(spacing, float((extent / (count - border_voxels)).max()))
    else:
        border_voxels = np.zeros(3)
    return _cubic(center, extent, covered, border_voxels, spacing, "resolution")


def _cubic(
    center: NDArray[np.float64],
    extent: NDArray[np.float64],
    covered: NDArray[np.float64],
    border_voxels: NDArray[np.float64],
    spacing: float,
    argument: str,
) -> Grid:
    """Make a grid of whole cubic voxels that covers ``covered``, and ``extent`` with its border."""
    counts = np.maximum(covered, extent + border_voxels * spacing) / spacing
    if not (counts < MAX_SIDE).all():
        raise ArgumentError(
            f"{argument}: with voxels of {spacing:g} the longest side has {counts.max():.3g} of them, at most "
            f"{MAX_SIDE} are possible"
        )
    shape = [max(1, math.ceil(count - WHOLE)) for count in counts.tolist()]
    half = np.array(shape) * (spacing / 2)
    return _grid(center - half, center + half, shape)


def _oblong(
    center: NDArray[np.float64],
    extent: NDArray[np.float64],
    covered: NDArray[np.float64],
    border_voxels: NDArray[np.float64],
    shape: list[int],
) -> Grid:
    """Make a grid with the given numbers of voxels; each side is just long enough."""
    counts = np.array(shape, dtype=np.float64)
    inside = np.where(counts > border_voxels, counts - border_voxels, counts)
    spacing = np.maximum(covered / counts, extent / inside)
    # A side without extent takes the voxel size of the others.
    spacing[_flat(extent)] = spacing.max()
    half = spacing * counts / 2
    return _grid(center - half, center + half, shape)


def _flat(extent: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark the sides of a box that have no extent compared with the longest side, (3,)."""
    flat: NDArray[np.bool_] = extent <= WHOLE * extent.max()
    return flat


def _grid(lower: NDArray[np.float64], upper: NDArray[np.float64], shape: Sequence[int]) -> Grid:
    x, y, z = shape
    return Grid(checks.triple(lower), checks.triple(upper), (x, y, z))
