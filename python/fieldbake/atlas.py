"""The atlas: many volumes in the layers of one 2D texture, for engines and web pages."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _checks, _core
from .errors import ArgumentError, AtlasError
from .progress import Progress, progress_callback
from .report import Report, bytes_text, count_text
from .volume import Volume

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Layout = Literal["shelves", "strips"]
Encoding = Literal["float32", "float16", "snorm16", "snorm8"]
AtlasFilter = Literal["linear", "nearest", "slice"]
Language = Literal["wgsl", "glsl", "hlsl", "msl"]

#: Texels of each encoding. Normalised integers stand for a share of the entry's scale.
TEXELS: dict[str, np.dtype[Any]] = {
    "float32": np.dtype(np.float32),
    "float16": np.dtype(np.float16),
    "snorm16": np.dtype(np.int16),
    "snorm8": np.dtype(np.int8),
}

#: Largest side of a page, and the widest gutter.
MAX_PAGE_SIZE = 1 << 15
MAX_GUTTER = 64

#: In place of the page in the row of an index without a volume.
VACANT = np.uint32(0xFFFFFFFF)

#: Numbers of a block: page, corner (2), tile (2), columns, gutter, shape (3).
BLOCK_NUMBERS = 10

#: Voxels around the surface that keep their distance in a normalised encoding.
DEFAULT_BAND = 4.0

# The article's struct PackedSdfOffsetDetail in std430, field by field.
_ARTICLE_FIELDS: list[tuple[str, Any]] = [
    ("model", ("<f4", (4, 4))),
    ("inverse_model", ("<f4", (4, 4))),
    ("inner_min", ("<f4", 4)),
    ("inner_max", ("<f4", 4)),
    ("outer_min", ("<f4", 4)),
    ("outer_max", ("<f4", 4)),
    ("atlas_index", "<i4"),
    ("atlas_offset", "<i4"),
]
_STRIP_BYTES = 208
_SHELF_FIELDS: list[tuple[str, Any]] = [
    *_ARTICLE_FIELDS,
    ("scale", "<f4"),
    ("columns", "<u4"),
    ("shape", ("<u4", 3)),
    ("gutter", "<u4"),
    ("corner", ("<u4", 2)),
    ("tile", ("<u4", 2)),
]


def entry_dtype(layout: Layout, encoding: Encoding) -> np.dtype[Any]:
    """The record of a volume, laid out as a shader reads it from a std430 buffer.

    Strips have the 208 bytes of the article; a normalised encoding keeps its scale in what is padding there.
    """
    if layout == "shelves":
        return np.dtype(_SHELF_FIELDS)
    fields = _ARTICLE_FIELDS if encoding.startswith("float") else [*_ARTICLE_FIELDS, ("scale", "<f4")]
    packed = np.dtype(fields)
    assert packed.fields is not None
    return np.dtype(
        {
            "names": [name for name, _ in fields],
            "formats": [kind for _, kind in fields],
            "offsets": [packed.fields[name][1] for name, _ in fields],
            "itemsize": _STRIP_BYTES,
        }
    )


class Atlas:
    """Many volumes in the pages of one texture array. Made by :func:`fieldbake.pack` or :func:`fieldbake.load`.

    A volume's slices along z are tiles, side by side on a page. Each volume has an index, which it keeps; :meth:`add`
    and :meth:`remove` never move the texels of another.

    Notes
    -----
    Points are in the space that the volume was baked in. An entry also has a model matrix, for engines: the identity,
    or the transform that was packed with the volume.

    Examples
    --------
    >>> import fieldbake as fb
    >>> volumes = [fb.bake(fb.models.torus_knot(), 24), fb.bake(fb.models.gear(), 16)]
    >>> atlas = fb.pack(volumes, page_size=256)
    >>> atlas.pages.shape
    (1, 256, 256)
    >>> bool((atlas.unpack(1).distances == volumes[1].distances).all())
    True
    >>> bool((atlas.sample(0, [(0.3, 0.2, 0.1)]) == volumes[0].sample([(0.3, 0.2, 0.1)])).all())
    True
    """

    def __init__(
        self, *, layout: Layout, page_size: int, gutter: int, encoding: Encoding, band: float = DEFAULT_BAND
    ) -> None:
        self._layout: Layout = layout
        self._page_size = page_size
        self._gutter = 0 if layout == "strips" else gutter
        self._encoding: Encoding = encoding
        self._band = band
        # On the host, and on a graphics device: either may be missing, not both.
        self._host: NDArray[Any] | None = np.zeros((0, page_size, page_size), TEXELS[encoding])
        self._device: _core.DevicePages | None = None
        # One row for each index.
        self._blocks = np.zeros((0, BLOCK_NUMBERS), np.uint32)
        self._boxes = np.zeros((0, 4, 3))  # inner lower and upper, outer lower and upper corner
        self._models = np.zeros((0, 4, 4))
        self._scales = np.zeros(0, np.float32)
        self._reports: list[Report] = []
        self._entries: NDArray[Any] | None = None
        # Volumes come and go while other threads sample.
        self._lock = threading.RLock()

    @property
    def _pages(self) -> NDArray[Any]:
        """The texels, read back from the device at the first use."""
        with self._lock:
            if self._host is None:
                assert self._device is not None
                size = self._page_size
                self._host = self._device.read().view(TEXELS[self._encoding]).reshape(-1, size, size)
            return self._host

    @_pages.setter
    def _pages(self, pages: NDArray[Any]) -> None:
        self._host, self._device = pages, None

    @property
    def _page_count(self) -> int:
        if self._host is not None:
            return len(self._host)
        assert self._device is not None
        return len(self._device)

    @property
    def pages(self) -> NDArray[Any]:
        """The texels, (pages, height, width), row 0 first; a read-only view.

        float32 or float16: distances, world units. int16 or int8: normalised, a share of ``entries["scale"]``.
        Texels that no volume has are zero.
        """
        view = self._pages[...]
        view.flags.writeable = False
        return view

    @property
    def entries(self) -> NDArray[Any]:
        """One record for each index, read-only: the bytes of a std430 buffer for a shader.

        ``layout="strips"``: the article's 208 bytes: ``model``, ``inverse_model`` (4, 4), ``inner_min``,
        ``inner_max``, ``outer_min``, ``outer_max`` (4,), ``atlas_index`` (the page), ``atlas_offset`` (the row of
        strips). ``layout="shelves"``: the same fields, ``atlas_offset`` being the block's first texel counted row by
        row, then ``scale``, ``columns``, ``shape`` (3,), ``gutter``, ``corner`` (2,), ``tile`` (2,): 240 bytes.

        The matrices are stored by columns, as shaders read them: ``entries["model"][i].T`` is the matrix that acts on
        column vectors. An index without a volume has the page -1.
        """
        with self._lock:
            if self._entries is None:
                rows = len(self._blocks)
                records = _core.atlas_entries(
                    self._blocks,
                    self._boxes.reshape(rows, 12).tolist(),
                    self._models.reshape(rows, 16).tolist(),
                    self._scales.tolist(),
                    self._layout,
                    self._page_size,
                    self._encoding,
                )
                self._entries = np.frombuffer(records, entry_dtype(self._layout, self._encoding))
            return self._entries

    @property
    def layout(self) -> Layout:
        """``"shelves"`` or ``"strips"``."""
        return self._layout

    @property
    def page_size(self) -> int:
        """Width and height of a page, texels."""
        return self._page_size

    @property
    def gutter(self) -> int:
        """Copies of its border around each slice, texels."""
        return self._gutter

    @property
    def encoding(self) -> Encoding:
        """How a distance is stored."""
        return self._encoding

    @property
    def band(self) -> float:
        """Voxels around the surface that keep their distance in a normalised encoding."""
        return self._band

    @property
    def indices(self) -> tuple[int, ...]:
        """The indices that hold a volume."""
        return tuple(np.flatnonzero(self._blocks[:, 0] != VACANT).tolist())

    @property
    def fill(self) -> float:
        """Share of the pages' texels that belong to a slice or its gutter."""
        blocks = self._blocks[self._blocks[:, 0] != VACANT].astype(np.float64)
        used = float((blocks[:, 3] * blocks[:, 4] * blocks[:, 9]).sum())
        return used / (self._page_count * self._page_size**2) if self._page_count else 0.0

    @property
    def nbytes(self) -> int:
        """Memory of the pages."""
        return self._page_count * self._page_size**2 * TEXELS[self._encoding].itemsize

    def add(self, volume: Volume, transform: ArrayLike | None = None) -> int:
        """Put one more volume in, without moving the others.

        Parameters
        ----------
        volume : Volume
            For strips a cube of the same size as the others.
        transform : (4, 4) array, optional
            The entry's model matrix.

        Returns
        -------
        int
            Its index: the first one that is free. Where no page has room a new one is opened.

        Raises
        ------
        AtlasError
            If it cannot fit; the message says how large a page would do.
        CapacityError
            If a new page does not fit in memory.
        """
        return self._place([_checked_item(0, volume if transform is None else (volume, transform))], None)[0]

    def remove(self, i: int) -> None:
        """Take a volume out; its texels become zero and its index and room are free for the next.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        """
        with self._lock:
            i = self._index(i)
            _core.atlas_clear(self._writable(), self._blocks[i : i + 1], self._encoding)
            self._blocks[i] = 0
            self._blocks[i, 0] = VACANT
            self._boxes[i], self._models[i], self._scales[i] = 0, np.eye(4), 1
            self._reports[i] = Report()
            self._entries = None

    def resolution(self, i: int) -> tuple[int, int, int]:
        """Voxels of the volume with index `i` along x, y and z."""
        nx, ny, nz = self._blocks[self._index(i), 7:].tolist()
        return nx, ny, nz

    def unpack(self, i: int) -> Volume:
        """The volume with index `i`: bit for bit what was packed, or what its encoding kept of it.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        """
        with self._lock:
            i = self._index(i)
            distances = _core.atlas_read(self._bytes(), self._blocks[i : i + 1], self._encoding, float(self._scales[i]))
            inner, outer = self._boxes[i, :2].copy(), self._boxes[i, 2:].copy()
            return Volume._wrap(distances, outer, inner, self._reports[i])

    def sample(self, i: int, points: ArrayLike, *, filter: AtlasFilter = "linear") -> NDArray[np.float32]:
        """The field of one volume, read from the pages.

        Parameters
        ----------
        i : int
            Index of the volume.
        points : (n, 3) real
            Positions in the volume's space; any leading shape will do.
        filter : "linear", "nearest" or "slice", default "linear"
            Two bilinear taps and a step along z, which is the trilinear function of :meth:`Volume.sample`; the nearest
            texel; or the article's single bilinear tap in the slice that holds the point, which is blocky along z.

        Returns
        -------
        (n,) float32
            World units; outside the box a proven lower bound, as for :meth:`Volume.sample`.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        ArgumentError
            For a wrong shape, a point that is not finite, or an unknown filter.
        """
        flat, shape = _checks.points(points)
        with self._lock:
            i = self._index(i)
            inner_lower, inner_upper, lower, upper = (_checks.triple(corner) for corner in self._boxes[i])
            values = _core.atlas_sample(
                self._bytes(),
                self._blocks[i : i + 1],
                self._encoding,
                float(self._scales[i]),
                lower,
                upper,
                inner_lower,
                inner_upper,
                flat,
                filter=_checks.text("filter", filter),
            )
        return values.reshape(shape)

    def texture_coordinates(self, i: int, points: ArrayLike) -> NDArray[np.float64]:
        """Where points fall on their page: the article's ``ConvertWorldToTexture``.

        Parameters
        ----------
        i : int
            Index of the volume; its page is ``entries["atlas_index"][i]``.
        points : (n, 3) real
            Positions in the volume's space; any leading shape will do. Outside the box its nearest point is taken.

        Returns
        -------
        (n, 2) float64
            0 to 1 along the width and the height of the page, in the slice that holds the point.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        ArgumentError
            For a wrong shape or a point that is not finite.
        """
        flat, shape = _checks.points(points)
        i = self._index(i)
        lower, upper = _checks.triple(self._boxes[i, 2]), _checks.triple(self._boxes[i, 3])
        found = _core.atlas_texture_coordinates(self._blocks[i : i + 1], self._page_size, lower, upper, flat)
        return found.reshape(*shape, 2)

    def shader(self, language: Language = "wgsl") -> str:
        """Functions that sample the pages in a shader, as commented text.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            GLSL is that of WebGL 2 (ES 3.00); newer versions take it with another first line.

        Returns
        -------
        str
            The struct ``AtlasEntry``, whose bytes are those of :attr:`entries`; ``atlas_sample(entry, p)``, the exact
            trilinear field; ``atlas_sample_filtered``, the same by two taps of the hardware's filter;
            ``atlas_sample_nearest``; ``atlas_texture_coordinates``. With an entry point it is a whole shader. It stays
            valid while volumes come and go.

        Raises
        ------
        ArgumentError
            For another language.
        AtlasError
            For strips without a volume, whose size is not known.
        """
        blocks = self._blocks[self._blocks[:, 0] != VACANT]
        if self._layout == "strips" and not len(blocks):
            raise AtlasError(
                "shader: the strips are empty, so the size of their cubes is not known; add a volume first"
            )
        side = int(blocks[0, 9]) if len(blocks) else 0
        name = _checks.text("language", language)
        return _core.atlas_shader(name, self._layout, self._page_size, self._gutter, self._encoding, side)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file; one of that name is replaced only once the new one is complete.

        Parameters
        ----------
        path : str or path
            ``.npz``: ours, and NumPy's. ``.exr``: one channel, the pages below each other, exact. ``.png``: 16 bits
            around the middle (8 for snorm8); floats become snorm16, scaled to each volume's largest distance, with an
            8-bit preview for people beside it. Images have a JSON beside them that says where each volume lies. Read
            any with :func:`fieldbake.load`.

        Raises
        ------
        FormatError
            For an ending that is not known, or an image of an empty atlas.
        OSError
            If the file cannot be written.
        """
        from . import exchange
        from .io import save_atlas

        with self._lock:
            if os.path.splitext(path)[1].lower() in exchange.ATLAS_ENDINGS:  # noqa: PTH122 - bytes and paths alike
                exchange.save_atlas_as(self, path)
            else:
                save_atlas(self, path)

    def plot(self, page: int = 0) -> Figure:
        """One page with the surfaces as lines, a frame around each volume and its index.

        Parameters
        ----------
        page : int, default 0
            Which.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it; ``.savefig("atlas.png")`` saves it.

        Raises
        ------
        Error
            If matplotlib is not installed, or the atlas is empty.
        ArgumentError
            If there is no such page.
        """
        from .plot import plot_atlas

        with self._lock:
            return plot_atlas(self, page)

    def _place(
        self, items: list[tuple[Volume, NDArray[np.float64]]], progress: Progress, device: str = "cpu"
    ) -> list[int]:
        """Plan room for volumes, open pages and fill in their texels; the indices."""
        shapes = np.array([volume.resolution for volume, _ in items], np.uint32).reshape(-1, 3)
        with self._lock:
            blocks = _core.atlas_plan(
                shapes,
                self._blocks,
                layout=self._layout,
                page_size=self._page_size,
                gutter=self._gutter,
                encoding=self._encoding,
            )
            scales = [scale_of(volume, self._band) for volume, _ in items]
            count = max(int(blocks[:, 0].max(initial=0)) + 1 if len(blocks) else 0, self._page_count)
            with progress_callback(progress, "pack") as callback:
                # A device fills pages that are new.
                packed = None
                if count and not self._page_count and _is_worth_it([volume for volume, _ in items], device):
                    packed = _core.atlas_pack_device(
                        blocks,
                        [volume._source(device) for volume, _ in items],
                        scales,
                        page_size=self._page_size,
                        pages=count,
                        encoding=self._encoding,
                        device=device,
                        progress=callback,
                    )
                if packed is not None:
                    self._host, self._device = None, packed
                else:
                    self._open_pages(count)
                    _core.atlas_write(
                        self._writable(),
                        blocks,
                        [volume.distances for volume, _ in items],
                        scales,
                        encoding=self._encoding,
                        progress=callback,
                    )

            # Only now, so that an interrupted call leaves no entry behind.
            free = [i for i in range(len(self._blocks)) if self._blocks[i, 0] == VACANT]
            free += range(len(self._blocks), len(self._blocks) + len(items))
            indices = free[: len(items)]
            self._make_rows(max(indices, default=-1) + 1)
            for i, block, scale, (volume, model) in zip(indices, blocks, scales, items, strict=True):
                self._blocks[i], self._models[i], self._scales[i] = block, model, scale
                self._boxes[i] = [*volume.inner_bounds, *volume.bounds]
                self._reports[i] = volume.report
            self._entries = None
            return indices

    def _open_pages(self, count: int) -> None:
        if count > self._page_count:
            size = self._page_size
            _core.require_memory(
                f"an atlas of {count} pages of {size} x {size} texels",
                count * size * size * TEXELS[self._encoding].itemsize,
                "use a smaller page_size, or an encoding of fewer bits",
            )
            pages = np.zeros((count, size, size), self._pages.dtype)
            pages[: len(self._pages)] = self._pages
            self._pages = pages

    def _make_rows(self, count: int) -> None:
        more = count - len(self._blocks)
        if more > 0:
            self._blocks = np.concatenate([self._blocks, np.zeros((more, BLOCK_NUMBERS), np.uint32)])
            self._boxes = np.concatenate([self._boxes, np.zeros((more, 4, 3))])
            self._models = np.concatenate([self._models, np.tile(np.eye(4), (more, 1, 1))])
            self._scales = np.concatenate([self._scales, np.ones(more, np.float32)])
            self._reports += [Report()] * more

    def _bytes(self) -> NDArray[np.uint8]:
        """The pages as the core takes them."""
        return self._pages.view(np.uint8)

    def _writable(self) -> NDArray[np.uint8]:
        """The pages as bytes, to be changed: what is on a device is given up."""
        self._pages = self._pages
        return self._bytes()

    def _index(self, i: object) -> int:
        """The index of a volume that is there; negative ones count from the end."""
        count = len(self._blocks)
        if count == 0:
            raise AtlasError(f"i: the atlas is empty, it has no volume {i}")
        index = _checks.integer("i", i, least=-count, most=count - 1, error=AtlasError) % count
        if self._blocks[index, 0] == VACANT:
            raise AtlasError(f"i: there is no volume {index}, it was removed")
        return index

    def __len__(self) -> int:
        """How many volumes there are."""
        return len(self.indices)

    def __getstate__(self) -> dict[str, Any]:
        state = {**self.__dict__, "_host": self._pages, "_device": None}
        del state["_lock"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        held, pages = count_text(len(self), "volume"), count_text(self._page_count, "page")
        size = f"{self._page_size} x {self._page_size}"
        return (
            f"Atlas({held} on {pages} of {size} {self._encoding}, {self._layout}, {self.fill:.0%} full, "
            f"{bytes_text(self.nbytes)})"
        )


def pack(
    volumes: Iterable[Volume | tuple[Volume, ArrayLike]],
    *,
    layout: Layout = "shelves",
    page_size: int = 4096,
    gutter: int = 1,
    encoding: Encoding = "float32",
    band: float = DEFAULT_BAND,
    device: str = "auto",
    progress: Progress = None,
) -> Atlas:
    """Pack volumes into the pages of an atlas.

    Parameters
    ----------
    volumes : list of Volume
        Items may be ``(volume, transform)``; the (4, 4) transform becomes the entry's model matrix.
    layout : "shelves" or "strips", default "shelves"
        Shelves: any mix of resolutions, slices wrapped over rows and placed where there is room. Strips: equal cubes,
        exactly as in the article: texel (x + z N, y + row N), 64 fields of 64^3 on a page of 4096 x 4096.
    page_size : int, default 4096
        Width and height of a page, texels. As many pages are opened as are needed.
    gutter : int, default 1
        Copies of its border around each slice, so that the rounded weights of a hardware sampler read no neighbour.
        Strips have none.
    encoding : str, default "float32"
        ``"float32"`` (exact), ``"float16"`` (11 significant bits), or the normalised ``"snorm16"`` and ``"snorm8"``,
        which keep the distances of a band around the surface in 1/32767 and 1/127 of its width, and its end beyond.
        All round toward the surface: a stored magnitude never exceeds the true one.
    band : float, default 4
        Half the width of that band, voxels.
    device : str, default "auto"
        Volumes that were baked on a graphics device are packed there, with the same bytes, and the pages stay there
        until somebody asks for them. ``"auto"`` does so if all of them are on the hardware GPU.
    progress : bool or callable, optional
        As for :func:`fieldbake.bake`.

    Returns
    -------
    Atlas
        Volume i of the list has the index i.

    Raises
    ------
    AtlasError
        If a volume cannot fit on a page (the message says how large a page would do), or strips are to hold anything
        but equal cubes.
    ArgumentError
        If an option makes no sense.
    CapacityError
        If the pages do not fit in memory.
    DeviceError
        If the device is not there, or a page is too large for it.

    References
    ----------
    "Packing 3D SDF to a 2D Texture", of which strips are the layout. Shelves are packed by maximal rectangles: J.
    Jylänki, A Thousand Ways to Pack the Bin (2010).

    Examples
    --------
    >>> import fieldbake as fb
    >>> knot = fb.bake(fb.models.torus_knot(), (16, 16, 16))
    >>> atlas = pack([knot, knot], layout="strips", page_size=256)
    >>> bool((atlas.pages[0, 16:32, 3 * 16 : 4 * 16] == knot.distances[:, :, 3].T).all())
    True
    >>> atlas.entries["atlas_offset"].tolist()
    [0, 1]
    """
    atlas = Atlas(
        layout=choice("layout", layout, ("shelves", "strips")),
        page_size=_checks.integer("page_size", page_size, least=1, most=MAX_PAGE_SIZE),
        gutter=_checks.integer("gutter", gutter, least=0, most=MAX_GUTTER),
        encoding=choice("encoding", encoding, tuple(TEXELS)),
        band=_checks.number("band", band, above=0),
    )
    if isinstance(volumes, Volume):
        raise ArgumentError("volumes: must be a list of volumes, got a Volume; put it in a list")
    try:
        listed = list(volumes)
    except TypeError:
        raise ArgumentError(f"volumes: must be a list of volumes, got {_checks.describe(volumes)}") from None
    items = [_checked_item(i, item) for i, item in enumerate(listed)]
    atlas._place(items, progress, _checks.text("device", device))
    return atlas


def _is_worth_it(volumes: list[Volume], device: str) -> bool:
    """Whether to pack on this device: where the user says so, or where all volumes are already."""
    if device == "cpu":
        return False
    return device != "auto" or all(isinstance(volume._source(device), _core.DeviceField) for volume in volumes)


def choice(name: str, value: object, wanted: tuple[str, ...]) -> Any:
    """One of a few words."""
    if value not in wanted:
        words = ", ".join(f'"{word}"' for word in wanted)
        raise ArgumentError(f"{name}: must be one of {words}, got {_checks.describe(value)}")
    return value


def _checked_item(i: int, item: object) -> tuple[Volume, NDArray[np.float64]]:
    """A volume and its model matrix."""
    volume, model = item if isinstance(item, tuple) and len(item) == 2 else (item, None)
    if not isinstance(volume, Volume):
        raise ArgumentError(f"volumes[{i}]: must be a Volume or (Volume, transform), got {_checks.describe(volume)}")
    return volume, np.eye(4) if model is None else _checks.affine(f"volumes[{i}] transform", model, ArgumentError)


def scale_of(volume: Volume, band: float) -> float:
    """World width of `band` voxels, as float32 holds it."""
    return _positive(band * float(volume.spacing.max()))


def _positive(scale: float) -> float:
    return float(np.clip(np.float32(min(scale, _checks.FAR)), np.finfo(np.float32).tiny, None))


def normalised_copy(atlas: Atlas, encoding: Encoding) -> Atlas:
    """The same atlas in a normalised encoding, each volume scaled to its largest distance."""
    copy = Atlas(
        layout=atlas.layout, page_size=atlas.page_size, gutter=atlas.gutter, encoding=encoding, band=atlas.band
    )
    copy._blocks, copy._boxes, copy._models = atlas._blocks.copy(), atlas._boxes.copy(), atlas._models.copy()
    copy._scales, copy._reports = atlas._scales.copy(), list(atlas._reports)
    copy._pages = np.zeros(atlas._pages.shape, TEXELS[encoding])
    for i in atlas.indices:
        distances = atlas.unpack(i).distances
        copy._scales[i] = _positive(float(np.abs(distances).max()))
        _core.atlas_write(
            copy._bytes(), copy._blocks[i : i + 1], [distances], [float(copy._scales[i])], encoding=encoding
        )
    return copy
