"""Truncated fields in Zarr stores: sampling, windows, meshes and pictures in bounded memory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _core
from ...base import checks, encodings
from ...base.errors import ArgumentError, FormatError
from ...base.optional import optional_module
from ...base.report import bytes_text
from ...files.container import read_report
from ...meshes.isosurface import MeshSource, Source
from ...meshes.mesh import Mesh
from ...volumes.grid_field import GridField
from ...volumes.level_set_blocks import SIDE
from ...volumes.quantized import QuantizedVolume
from ...volumes.sparse import SparseVolume, restore_field
from ...volumes.volume import Volume
from . import store as stores
from .layout import Layout, path_of
from .reader import Reader
from .store import Place
from .zarr_sampling import ROUNDING, Sampler

if TYPE_CHECKING:
    import xarray
    from zarr.abc.store import Store

#: Points that are sampled at once: their bricks and corners take about 100 MB at most.
BATCH = 1 << 18

#: Cells of a brick of a sparse volume, and words of its index for bricks without samples.
BRICK_CELLS = 7
EMPTY, EMPTY_INSIDE = 3 << 30, 3 << 30 | 1

#: Smallest half width of the band, voxels, at the levels that pictures are drawn from. The corners of a cell that the
#: surface crosses are at most its diagonal from the surface, so none of them is clamped.
LEAST_BAND = 3**0.5

#: Memory of the bricks of a picture, bytes.
PICTURE_BYTES = 1 << 30


def open_zarr(store: str | os.PathLike[str] | Store, *, storage_options: Mapping[str, Any] | None = None) -> ZarrVolume:
    """Open a field that :func:`bake_to_zarr` wrote.

    Parameters
    ----------
    store : path, URL or Zarr store
        As for :func:`bake_to_zarr`.
    storage_options : mapping, optional
        Options of the file system of a URL.

    Returns
    -------
    ZarrVolume
        The field. Samples are read when they are needed.

    Raises
    ------
    FileNotFoundError
        If there is no store.
    FormatError
        If its ``zarr.json`` is missing, if fieldbake has not written it, or its plan was not finished.

    Examples
    --------
    >>> import fieldbake
    >>> knot = fieldbake.models.torus_knot(segments=64, sides=8)
    >>> _ = fieldbake.bake_to_zarr(knot, "memory://opened", 64, shard=64)
    >>> fieldbake.open_zarr("memory://opened").resolution
    (62, 64, 28)
    """
    return ZarrVolume._open(Place.of(store, storage_options))


class _StoredMesh:
    """The mesh in a store as the source of exact tangent planes; it is read when it is needed."""

    def __init__(self, volume: ZarrVolume) -> None:
        self._volume = volume

    def apply(self, surface: _core.Surface, level: float) -> None:
        self._source().apply(surface, level)

    def opposite(self) -> Source:
        return self._source().opposite()

    def _source(self) -> MeshSource:
        unsigned = self._volume.report.sign_method == "unsigned"
        return MeshSource(self._volume.mesh, 0.0 if unsigned else None)


class ZarrVolume(GridField):
    """A truncated signed distance field in a Zarr store. Made by :func:`bake_to_zarr` and :func:`open_zarr`.

    Shards are read when they are needed, and memory is bounded by the bricks that are kept. Several threads may use one
    object.

    Notes
    -----
    Within the band around the surface the stored samples are distances. Beyond it they are clamped to the half width of
    the band. Exact distances at the corners of the shards give proven lower bounds there.

    Examples
    --------
    >>> import fieldbake as fb
    >>> volume = fb.bake_to_zarr(fb.models.gear(), "memory://gear.zarr", 64, shard=32)
    >>> volume.resolution
    (64, 64, 13)
    >>> volume[0:16, 0:16, 0:16].distances.shape
    (16, 16, 13)
    """

    __slots__ = ("__dict__", "_layout", "_place", "_reader", "_sampler")

    _place: Place
    _layout: Layout
    _reader: Reader
    _sampler: Sampler

    def __init__(self) -> None:
        raise TypeError("a ZarrVolume is made by bake_to_zarr or open_zarr")

    @classmethod
    def _open(cls, place: Place) -> ZarrVolume:
        group = place.existing("r")
        if group is None:
            if place.has_files():
                raise FormatError(f"{place}: is a folder without zarr.json, so its contents are no Zarr group")
            raise FileNotFoundError(f"there is no Zarr group at {place}")
        volume = cls.__new__(cls)
        with stores.reading(place):
            layout = stores.read_layout(group, place)
            volume._place, volume._layout = place, layout
            try:
                volume._reader = Reader(place, layout, group)
            except KeyError as error:
                raise FormatError(f"{place}: the plan was not finished ({error} is missing); {stores.REPAIR}") from None
            facts: Any = group.attrs["fieldbake"]
            report = read_report(facts)
        volume._sampler, volume._geometry = Sampler(layout, volume._reader), _StoredMesh(volume)
        volume._set_box(layout.shape, np.array([layout.lower, layout.upper]), np.array(layout.inner), report)
        return volume

    @property
    def levels(self) -> tuple[tuple[int, int, int], ...]:
        """Voxels of each level along x, y and z, finest first."""
        return tuple(self._layout.level(level).shape for level in range(self._layout.level_count))

    @property
    def encoding(self) -> str:
        """How samples are stored: ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``."""
        return self._layout.encoding

    @property
    def band(self) -> float:
        """Distance up to which samples are exact, world units."""
        return self._layout.band_width

    @property
    def scale(self) -> float:
        """Distance that a stored fraction of 1 represents, world units; for ``"snorm16"`` this is the code 32767."""
        return self._layout.scale

    @property
    def distances(self) -> NDArray[np.float32]:
        """Samples of level 0, (nx, ny, nz), float32, world units; `CapacityError` if they do not fit in memory."""
        nx, ny, nz = self.resolution
        _core.require_memory("the whole grid", 6 * nx * ny * nz, "Read a window or a coarser level.")
        return self._window(0, [0, 0, 0], [nx, ny, nz]).distances

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The samples of level 0, as :attr:`distances`."""
        if copy is False:
            raise ValueError("the samples are in a store: an array of them is a copy")
        return self.distances.astype(dtype or np.float32, copy=False)

    @property
    def store(self) -> Any:
        """The path, URL or Zarr store."""
        return self._place.store

    @cached_property
    def mesh(self) -> Mesh:
        """The mesh that was baked, read from the store."""
        return stores.read_mesh(self._place.open("r"))

    def _sample(self, points: NDArray[np.float64], filter: str) -> NDArray[np.float32]:
        out = np.empty(len(points), dtype=np.float32)
        for start in range(0, len(points), BATCH):
            out[start : start + BATCH] = self._sampler.sample(points[start : start + BATCH], filter)
        return out

    def _gradient(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        out = np.empty((len(points), 3), dtype=np.float32)
        for start in range(0, len(points), BATCH):
            out[start : start + BATCH] = self._sampler.gradient(points[start : start + BATCH])
        return out

    def __getitem__(self, window: Any) -> Volume:
        """The part ``volume[x0:x1, y0:y1, z0:z1]`` of level 0 as a Volume; see :meth:`window`."""
        parts = window if isinstance(window, tuple) else (window,)
        if len(parts) > 3 or not all(isinstance(part, slice) and part.step in (None, 1) for part in parts):
            raise ArgumentError("window: must be up to three slices without a step, as in volume[0:64, 0:64, 0:64]")
        parts += (slice(None),) * (3 - len(parts))
        ranges = [part.indices(n)[:2] for part, n in zip(parts, self.resolution, strict=True)]
        if any(stop <= start for start, stop in ranges):
            raise ArgumentError(f"window: is empty, the grid has {self.resolution} voxels")
        return self._window(0, [start for start, _ in ranges], [stop for _, stop in ranges])

    def window(self, bounds: ArrayLike, *, level: int = 0) -> Volume:
        """Read the part of the grid in a box as a Volume.

        Parameters
        ----------
        bounds : (2, 3)
            Lower and upper corner, world units. The window has all voxels that overlap the box, within the grid.
        level : int, default 0
            Level of the pyramid.

        Returns
        -------
        Volume
            In the encoding of the store. Its samples equal the samples of the store, bit for bit.

        Raises
        ------
        ArgumentError
            If the box lies outside the grid, or there is no such level.
        FormatError
            If a shard is missing or damaged; the message has its key.
        """
        level = self._checked_level(level)
        box = checks.box("bounds", bounds)
        grid = self._layout.level(level)
        places = (box - np.array(grid.lower)) / np.array(grid.spacing)
        low = np.maximum(np.floor(places[0]), 0).astype(np.int64)
        high = np.minimum(np.ceil(places[1]), grid.shape).astype(np.int64)
        if not (low < high).all():
            raise ArgumentError(f"bounds: must overlap the box {self._bounds.tolist()}, got {box.tolist()}")
        return self._window(level, low.tolist(), high.tolist())

    def _window(self, level: int, low: list[int], high: list[int]) -> Volume:
        grid = self._layout.level(level)
        x, y, z = low
        nx, ny, nz = (b - a for a, b in zip(low, high, strict=True))
        bytes_needed = nx * ny * nz * self._reader.fill.dtype.itemsize
        _core.require_memory("a window", bytes_needed, "Read a smaller window or a coarser level.")
        codes = self._reader.read(level, (x, y, z), (nx, ny, nz)).T
        bounds = np.array(grid.lower) + np.array([low, high]) * np.array(grid.spacing)
        if self.encoding == "float32":
            return Volume._wrap(codes, bounds, self._inner_bounds, self._report, self._geometry)
        return QuantizedVolume._of(
            codes, self.encoding, self.scale, bounds, self._inner_bounds, self._report, self._geometry
        )

    def _checked_level(self, level: object) -> int:
        return checks.integer("level", level, least=0, most=self._layout.level_count - 1)

    def to_sparse(self, *, level: int = 0) -> SparseVolume:
        """Convert a level to a sparse volume, which needs memory in proportion to the surface.

        Parameters
        ----------
        level : int, default 0
            Level of the pyramid.

        Returns
        -------
        SparseVolume
            Bricks of 8^3 samples where samples are in the band, with the stored values, and lower bounds elsewhere.

        Raises
        ------
        ArgumentError
            If there is no such level.
        FormatError
            If a shard is missing or damaged; the message has its key.
        """
        level = self._checked_level(level)
        grid = self._layout.level(level)
        counts = [-(-(n + 1) // BRICK_CELLS) for n in grid.shape]
        index = np.full(counts, EMPTY, dtype=np.uint32, order="F")
        fill, total, kept = self._reader.fill, 0, []
        for first, blocks, low, high in self._reader.blocks(level, BRICK_CELLS):
            words = np.where(high == -fill, np.uint32(EMPTY_INSIDE), np.uint32(EMPTY))
            stored = (low != fill) & (high != -fill)
            chosen = blocks[stored]
            words[stored] = np.arange(total, total + len(chosen))
            total += len(chosen)
            kept.append(chosen.reshape(-1))
            part = tuple(slice(a, a + n) for a, n in zip(first.tolist(), words.shape[::-1], strict=True))
            index[part] = words.T
        bricks = np.concatenate(kept) if kept else np.empty(0, dtype=fill.dtype)
        arrays = {"index": index, "nodes": self._nodes(counts, grid.lower, np.array(grid.spacing))}
        # Stored bricks are (n, x, y, z) there.
        arrays["bricks"] = bricks.reshape(-1, *(BRICK_CELLS + 1,) * 3).transpose(0, 3, 2, 1)
        band = float(np.nextafter(np.float32(self.band * (1 - ROUNDING)), np.float32(0)))
        field = restore_field((grid.lower, grid.upper), grid.shape, band, self.scale, arrays)
        bounds = np.array([grid.lower, grid.upper])
        return SparseVolume._wrap(field, bounds, self._inner_bounds, self._report, self._geometry)

    def _nodes(self, counts: list[int], lower: Any, spacing: NDArray[np.float64]) -> NDArray[np.float32]:
        """Lower bounds of the distance at the corners of bricks, x fastest; node 0 is at sample -1."""
        axes = [
            low + (BRICK_CELLS * np.arange(n + 1) - 0.5) * s for low, n, s in zip(lower, counts, spacing, strict=True)
        ]
        nodes = np.empty([n + 1 for n in counts], dtype=np.float32, order="F")
        x, y = np.meshgrid(axes[0], axes[1], indexing="ij")
        for k, z in enumerate(axes[2]):
            points = np.stack([x.reshape(-1), y.reshape(-1), np.full(x.size, z)], axis=1)
            nodes[:, :, k] = self._sampler.far_bound(points).reshape(x.shape)
        return nodes

    def _surface(self, level: float) -> _core.Surface:
        surface = _core.SurfaceBlocks(self._layout.lower, self._layout.upper, self.resolution, level)
        shape = np.array(self.resolution)
        for first, blocks, least, largest in self._reader.blocks(0, SIDE):
            # Decoding keeps the order of the values.
            low, high = self._sampler.decode(least.reshape(-1)), self._sampler.decode(largest.reshape(-1))
            steps = np.indices(blocks.shape[:3]).reshape(3, -1)[::-1].T
            origins = (first + steps) * SIDE - 1
            at_box = (origins < 0).any(axis=1) | (origins + SIDE >= shape).any(axis=1)
            crossed = (low < level) & (at_box | (high >= level))
            chosen = blocks[crossed.reshape(least.shape)]
            decoded: Any = self._sampler.decode(chosen.reshape(-1)).astype(np.float32)
            surface.add(origins[crossed].astype(np.int32), decoded.reshape(chosen.shape))
        return surface.surface()

    def _kept_distance(self) -> float | None:
        # Any point lies within half a voxel's diagonal of a sample.
        return max(self.band - 0.5 * float(np.linalg.norm(self.spacing)), 0.0)

    def raymarch(self, camera: Any = None, **options: Any) -> Any:
        """Draw the surface; arguments and result as for :func:`fieldbake.raymarch`."""
        from ...drawing.raymarching import raymarch

        return raymarch(self, camera, **options)

    def picture_field(self, pixel: float = 0.0, most: int = PICTURE_BYTES) -> SparseVolume:
        """The field for a picture whose pixels have the side `pixel` at the surface, world units.

        The level is the coarsest one with voxels up to that size at which the band is wide enough for interpolation. A
        coarser one is taken while the bricks would need more than `most` bytes. The volume keeps the bricks of the last
        picture.
        """
        widest = max(0, int(np.log2(max(self._layout.band / LEAST_BAND, 1))))
        fitting = max(0, int(np.log2(max(pixel / self._layout.voxel, 1))))
        level = min(widest, fitting, self._layout.level_count - 1)
        while level + 1 < self._layout.level_count and self._brick_bytes(level) > most:
            level += 1
        kept: tuple[int, SparseVolume] | None = self.__dict__.get("_picture")
        if kept is None or kept[0] != level:
            kept = level, self.to_sparse(level=level)
            self.__dict__["_picture"] = kept
        return kept[1]

    def _brick_bytes(self, level: int) -> float:
        """Estimate the memory of the sparse volume of a level, bytes."""
        grid = self._layout.level(level)
        # A stored shard has about one layer of bricks, twice as thick as the band.
        per_side = min(self._layout.shard, max(grid.shape)) / BRICK_CELLS
        bricks = int(self._reader.states[level].sum()) * per_side**2 * 2
        nodes = float(np.prod([n / BRICK_CELLS for n in grid.shape])) * 8
        return float(bricks * 512 * self._reader.fill.dtype.itemsize + nodes)

    def to_xarray(self, *, level: int = 0) -> xarray.DataArray:
        """Convert a level to an xarray ``DataArray``.

        Parameters
        ----------
        level : int, default 0
            Level of the pyramid.

        Returns
        -------
        xarray.DataArray
            Distances, world units, with the dimensions z, y, x and the voxel centres as coordinates. Samples are read
            when they are needed.

        Raises
        ------
        FormatError
            If a shard is missing; the message has its key.
        Error
            If xarray is not installed.
        """
        level = self._checked_level(level)
        self._reader.require(level)
        package = optional_module("xarray", "to_xarray", extra="xarray")
        name = path_of(level)
        group = self._place.open("r")
        parent = f"{group.store_path.path}/levels".lstrip("/") if level else group.store_path.path or None
        data = package.open_zarr(group.store_path.store, group=parent, consolidated=False, chunks=None, zarr_format=3)
        array: Any = data[name.rpartition("/")[2]]
        grid = self._layout.level(level)
        steps = encodings.STEPS.get(self.encoding, 1)
        array.attrs = {"scale_factor": self.scale / steps}
        array.encoding = {}
        array = package.decode_cf(array.to_dataset(name="distance"))["distance"]
        centers = [
            (axis, l + (np.arange(n) + 0.5) * s)
            for axis, l, n, s in zip("xyz", grid.lower, grid.shape, grid.spacing, strict=True)
        ]
        result: xarray.DataArray = array.assign_coords(dict(centers))
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        return ZarrVolume._open, (self._place,)

    def _repr_png_(self) -> bytes | None:
        """Draw the surface for notebooks; None if there is no surface."""
        if not self._reader.states[0].any():
            return None
        from ...drawing.raymarching import PICTURE_SAMPLES

        picture: bytes | None = self.raymarch(size=(256, 256), samples=PICTURE_SAMPLES, device="cpu")._repr_png_()
        return picture

    def __repr__(self) -> str:
        shape = " x ".join(str(side) for side in self.resolution)
        stored, total = int(self._reader.states[0].sum()), self._reader.states[0].size
        shard = bytes_text(self._layout.shard**3 * self._reader.fill.dtype.itemsize)
        return (
            f"ZarrVolume({shape} voxels as {self.encoding}, {stored:,} of {total:,} shards of {shard} stored, "
            f"{self._layout.level_count} levels, {self._place})"
        )
