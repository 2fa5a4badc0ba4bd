"""The growing pages of an atlas: the positions of its volumes, and their texels."""

from __future__ import annotations

import math
import os
import threading
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..baking.dense import bake
from ..base import checks
from ..base.encodings import DEFAULT_BAND, DTYPES, Encoding, scale_of
from ..base.errors import ArgumentError, AtlasError, MeshError
from ..base.grid import DEFAULT_RESOLUTION, Resolution
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.mesh import Mesh
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import HasVolume, Volume, plain_field

Layout = Literal["shelves", "strips"]

#: Texels of a shader: the pages, the unsigned integers of a .png, or the integers of the pages.
Texels = Literal["pages", "png", "integers"]

#: Largest side of a page, and largest gutter, texels.
MAX_PAGE_SIZE = 1 << 15
MAX_GUTTER = 64

#: Largest side of a page that is chosen to fit its volumes, texels: a size that graphics devices commonly support.
MAX_FITTING_PAGE = 1 << 14

#: Page of an index without a volume.
VACANT = np.uint32(0xFFFFFFFF)

#: The block of a volume: its page, first texel (x, y), size of a slice with its gutters, slices in a row, gutter, and
#: voxels along x, y and z. The core and files store it as a row of ten uint32 in this order.
BLOCK = np.dtype(
    [
        ("page", "<u4"),
        ("corner", "<u4", 2),
        ("tile", "<u4", 2),
        ("columns", "<u4"),
        ("gutter", "<u4"),
        ("shape", "<u4", 3),
    ]
)
BLOCK_NUMBERS = BLOCK.itemsize // 4

#: Arrays with one row per index, by their names in files.
ARRAYS = ("blocks", "boxes", "models", "scales")

# Fields of the article's struct PackedSdfOffsetDetail in std430.
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


def rows_of(blocks: NDArray[Any]) -> NDArray[np.uint32]:
    """View blocks (n,) as rows for the core and for files, (n, 10)."""
    return blocks.view(np.uint32).reshape(-1, BLOCK_NUMBERS)


def blocks_of(rows: NDArray[np.uint32]) -> NDArray[Any]:
    """View rows (n, 10) as blocks, (n,)."""
    return rows.view(BLOCK).reshape(-1)


def entry_dtype(layout: Layout, encoding: Encoding) -> np.dtype[Any]:
    """Make the dtype of a volume's record, laid out as a shader reads it from a std430 buffer.

    Strips have the 208 bytes of the article. Encodings other than float32 store their scale in the padding.
    """
    if layout == "shelves":
        return np.dtype(_SHELF_FIELDS)
    fields = _ARTICLE_FIELDS if encoding == "float32" else [*_ARTICLE_FIELDS, ("scale", "<f4")]
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


class PageStore:
    """The pages of an atlas and a row of metadata for each volume on them.

    Texels are on the host or on a graphics device. The core plans free areas from the occupied blocks, so volumes are
    added and removed without moving each other.
    """

    def __init__(
        self, *, layout: Layout, page_size: int, gutter: int, encoding: Encoding, band: float = DEFAULT_BAND
    ) -> None:
        self._layout: Layout = layout
        self._page_size = page_size
        self._gutter = 0 if layout == "strips" else gutter
        self._encoding: Encoding = encoding
        self._band = band
        # Texels on the host, and on a graphics device. At least one of the two is present.
        self._host: NDArray[Any] | None = np.zeros((0, page_size, page_size), DTYPES[encoding])
        self._device: _core.DevicePages | None = None
        # Arrays with one row per index.
        self._blocks = np.zeros(0, BLOCK)
        self._boxes = np.zeros((0, 4, 3))  # inner lower and upper, outer lower and upper corner
        self._models = np.zeros((0, 4, 4))
        self._scales = np.zeros(0, np.float32)
        self._reports: list[Report] = []
        self._names: list[str] = []
        # Default source of texels in the shader text: the .png if the atlas was loaded from one.
        self._texels: Texels = "pages"
        self._entries: NDArray[Any] | None = None
        # Number of changes to the set of volumes.
        self._changes = 0
        # Other threads may sample while volumes are added and removed.
        self._lock = threading.RLock()

    @property
    def _pages(self) -> NDArray[Any]:
        """The texels, read back from the device at the first use."""
        with self._lock:
            if self._host is None:
                assert self._device is not None
                size = self._page_size
                self._host = self._device.read().view(DTYPES[self._encoding]).reshape(-1, size, size)
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
    def layout(self) -> Layout:
        """Name of the layout: ``"shelves"`` or ``"strips"``."""
        return self._layout

    @property
    def page_size(self) -> int:
        """Width and height of a page, texels."""
        return self._page_size

    @property
    def gutter(self) -> int:
        """Number of copies of the border around each slice, texels."""
        return self._gutter

    @property
    def encoding(self) -> Encoding:
        """Encoding of a distance."""
        return self._encoding

    @property
    def band(self) -> float:
        """Half width of the band of a normalised encoding, voxels."""
        return self._band

    @property
    def indices(self) -> tuple[int, ...]:
        """Indices that hold a volume."""
        return tuple(np.flatnonzero(self._blocks["page"] != VACANT).tolist())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the volumes, one for each index: the stems of files, or the names that were packed with them.

        The name is empty for a volume without one, and for an index without a volume.
        """
        return tuple(self._names)

    @property
    def fill(self) -> float:
        """Fraction of the texels of all pages that belong to a slice or its gutter."""
        blocks = self._blocks[self._blocks["page"] != VACANT]
        used = float((blocks["tile"].astype(np.float64).prod(axis=1) * blocks["shape"][:, 2]).sum())
        return used / (self._page_count * self._page_size**2) if self._page_count else 0.0

    @property
    def nbytes(self) -> int:
        """Memory of the pages, bytes."""
        return self._page_count * self._page_size**2 * DTYPES[self._encoding].itemsize

    def _place(
        self, items: list[tuple[Volume, NDArray[np.float64]]], names: list[str], progress: Progress, device: str = "cpu"
    ) -> list[int]:
        """Plan positions for named volumes, open pages and write their texels; return the indices."""
        shapes = np.array([volume.resolution for volume, _ in items], np.uint32).reshape(-1, 3)
        with self._lock:
            rows = _core.atlas_plan(
                shapes,
                rows_of(self._blocks),
                layout=self._layout,
                page_size=self._page_size,
                gutter=self._gutter,
                encoding=self._encoding,
            )
            blocks = blocks_of(rows)
            scales = [scale_of(self._encoding, volume.spacing, self._band) for volume, _ in items]
            count = max(int(blocks["page"].max()) + 1 if len(blocks) else 0, self._page_count)
            with progress_callback(progress, "pack") as callback:
                # A device fills new pages only.
                packed = None
                if count and not self._page_count and _packs_on_device([volume for volume, _ in items], device):
                    packed = _core.atlas_pack_device(
                        rows,
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
                        rows,
                        [volume.distances for volume, _ in items],
                        scales,
                        encoding=self._encoding,
                        progress=callback,
                    )

            # Records are added last, so that an interrupted call leaves none behind.
            free = [i for i in range(len(self._blocks)) if self._blocks["page"][i] == VACANT]
            free += range(len(self._blocks), len(self._blocks) + len(items))
            indices = free[: len(items)]
            self._make_rows(max(indices, default=-1) + 1)
            for i, name, block, scale, (volume, model) in zip(indices, names, blocks, scales, items, strict=True):
                self._names[i] = name
                self._blocks[i], self._models[i], self._scales[i] = block, model, scale
                self._boxes[i] = [*volume.inner_bounds, *volume.bounds]
                self._reports[i] = volume.report
            self._entries = None
            self._changes += 1
            return indices

    def _open_pages(self, count: int) -> None:
        if count > self._page_count:
            size = self._page_size
            _core.require_memory(
                f"an atlas of {count} pages of {size} x {size} texels",
                count * size * size * DTYPES[self._encoding].itemsize,
                "use a smaller page_size, or an encoding of fewer bits",
            )
            pages = np.zeros((count, size, size), self._pages.dtype)
            pages[: len(self._pages)] = self._pages
            self._pages = pages

    def _make_rows(self, count: int) -> None:
        more = count - len(self._blocks)
        if more > 0:
            self._blocks = np.concatenate([self._blocks, np.zeros(more, BLOCK)])
            self._boxes = np.concatenate([self._boxes, np.zeros((more, 4, 3))])
            self._models = np.concatenate([self._models, np.tile(np.eye(4), (more, 1, 1))])
            self._scales = np.concatenate([self._scales, np.ones(more, np.float32)])
            self._reports += [Report()] * more
            self._names += [""] * more

    def _row(self, i: int) -> NDArray[np.uint32]:
        """The block of the volume with index `i` as a row for the core, (1, 10)."""
        return rows_of(self._blocks[i : i + 1])

    def _bytes(self) -> NDArray[np.uint8]:
        """The pages as an array of bytes for the core."""
        return self._pages.view(np.uint8)

    def _writable(self) -> NDArray[np.uint8]:
        """The pages as a writable array of bytes; the copy on a device is dropped."""
        self._pages = self._pages
        return self._bytes()

    def _index(self, i: object) -> int:
        """Check the index of a volume, and return it as a row; negative indices count from the end."""
        count = len(self._blocks)
        if count == 0:
            raise AtlasError(f"i: there is no volume {i}, the atlas is empty")
        index = checks.integer("i", i, least=-count, most=count - 1, error=AtlasError) % count
        if self._blocks["page"][index] == VACANT:
            raise AtlasError(f"i: there is no volume {index}, it was removed")
        return index

    def __len__(self) -> int:
        """Number of volumes."""
        return len(self.indices)

    def __getstate__(self) -> dict[str, Any]:
        state = {**self.__dict__, "_host": self._pages, "_device": None}
        del state["_lock"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.RLock()


def _packs_on_device(volumes: list[Volume], device: str) -> bool:
    """Whether to pack on this device: if the user names it, or if all volumes are in its memory already."""
    if device == "cpu":
        return False
    return device != "auto" or all(isinstance(volume._source(device), _core.DeviceField) for volume in volumes)


#: Complete objects. A pair that begins with one of them is (object, transform), and not (vertices, faces).
_WHOLE = (Volume, HasVolume, SparseVolume, Mesh, Shape, str, os.PathLike)


def checked_item(
    i: int, item: object, resolution: Resolution = DEFAULT_RESOLUTION
) -> tuple[Volume, NDArray[np.float64]]:
    """Check a volume and its model matrix; meshes and shapes are baked at `resolution`."""
    geometry, model = item, None
    # A pair may also be the vertices and faces of a mesh.
    if isinstance(item, tuple) and len(item) == 2 and isinstance(item[0], _WHOLE):
        geometry, model = item
    placed = np.eye(4) if model is None else checks.affine(f"volumes[{i}] transform", model, ArgumentError)
    geometry = plain_field(geometry)
    if isinstance(geometry, SparseVolume):
        return geometry.to_volume(), placed
    if isinstance(geometry, Volume):
        return geometry, placed
    expected = f"volumes[{i}]: must be a volume, a mesh, a shape, or a pair of one of these and a (4, 4) transform"
    if hasattr(geometry, "to_volume"):
        raise ArgumentError(f"{expected}, got {checks.describe(geometry)}")
    try:
        return bake(geometry, resolution), placed
    except MeshError as error:
        raise ArgumentError(f"{expected}, got {checks.describe(geometry)} ({error})") from None


def name_of(item: object) -> str:
    """Return the name of an item to pack: the stem of a file; empty for others."""
    geometry = item[0] if isinstance(item, tuple) and len(item) == 2 else item
    return Path(geometry).stem if isinstance(geometry, (str, os.PathLike)) else ""


def checked_name(argument: str, value: object) -> str:
    """Check the name of a volume, which may be empty."""
    if not isinstance(value, str):
        raise ArgumentError(f"{argument}: must be text, got {checks.describe(value)}")
    return value


def fitting_page(shapes: list[tuple[int, int, int]], layout: Layout, gutter: int, encoding: Encoding) -> int:
    """Choose the side of a page for these shapes: the smallest power of two, at most `MAX_FITTING_PAGE`."""
    sizes = np.array(shapes, np.uint32).reshape(-1, 3)
    taken = rows_of(np.zeros(0, BLOCK))
    options: dict[str, Any] = {"layout": layout, "gutter": gutter, "encoding": encoding}
    # No page is smaller than the number of texels of the volumes.
    area = sum(nx * ny * nz for nx, ny, nz in shapes)
    size = 1 << max(2, (math.isqrt(area) - 1).bit_length())
    while size < MAX_FITTING_PAGE:
        try:
            blocks = blocks_of(_core.atlas_plan(sizes, taken, page_size=size, **options))
        except AtlasError:  # A volume is larger than the page.
            size *= 2
            continue
        if blocks["page"].max(initial=0) == 0:
            return size
        size *= 2
    return MAX_FITTING_PAGE
