"""The atlas: many volumes in the layers of one 2D texture, for engines and web pages."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks, encodings
from ..base.encodings import Encoding
from ..base.errors import AtlasError, FormatError
from ..base.languages import Language
from ..base.loadable import Loadable
from ..base.report import Report, bytes_text, count_text
from ..base.viewable import Viewable
from ..files import container, registry
from ..files.formats import PagesFile, head
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume
from .pages import (
    ARRAYS,
    BLOCK,
    VACANT,
    PageStore,
    Texels,
    checked_item,
    checked_name,
    entry_dtype,
    rows_of,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AtlasFilter = Literal["linear", "nearest"]


class AtlasEntry:
    """One volume of an atlas, as an object for scenes. Made by ``atlas[i]``.

    Examples
    --------
    >>> import fieldbake as fb
    >>> atlas = fb.pack([fb.bake(fb.sphere(), 16)])
    >>> atlas[0].resolution
    (16, 16, 16)
    >>> scene = fb.Scene([fb.Instance(atlas[0])])
    """

    __slots__ = ("_atlas", "_index")

    def __init__(self, atlas: Atlas, index: int) -> None:
        self._atlas = atlas
        self._index = index

    @property
    def atlas(self) -> Atlas:
        """The atlas that holds the volume."""
        return self._atlas

    @property
    def index(self) -> int:
        """Index of the volume in the atlas."""
        return self._index

    @property
    def name(self) -> str:
        """Name of the volume, see :attr:`Atlas.names`."""
        return self._atlas._names[self._atlas._index(self._index)]

    @property
    def resolution(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""
        return self._atlas.resolution(self._index)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box, (2, 3), in the volume's space."""
        return np.array(self._atlas._boxes[self._atlas._index(self._index), 2:])

    @property
    def inner_bounds(self) -> NDArray[np.float64]:
        """Box that contains the whole surface, (2, 3), in the volume's space."""
        return np.array(self._atlas._boxes[self._atlas._index(self._index), :2])

    @property
    def transform(self) -> NDArray[np.float64]:
        """Model matrix of the entry, (4, 4): the identity, or the transform that was packed with the volume."""
        return np.array(self._atlas._models[self._atlas._index(self._index)])

    def to_volume(self) -> Volume:
        """Copy the volume out of the atlas, as :meth:`Atlas.unpack` does."""
        return self._atlas.unpack(self._index)

    @property
    def _key(self) -> tuple[object, ...]:
        """Key for caches. It changes when the atlas changes."""
        return "atlas", id(self._atlas), self._index, self._atlas._changes

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        return f"AtlasEntry({self._index}{name} of {self._atlas!r})"


class Atlas(PageStore, Viewable, Loadable):
    """Many volumes in the pages of one texture array. Made by :func:`fieldbake.pack` or :func:`fieldbake.load`.

    The slices of a volume along z are tiles, side by side on a page. Each volume keeps its index. :meth:`add` and
    :meth:`remove` never move the texels of other volumes.

    Notes
    -----
    Points are given in the space in which the volume was baked. An entry also has a model matrix, for engines: the
    identity, or the transform that was packed with the volume.

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

    @property
    def pages(self) -> NDArray[Any]:
        """The texels, (pages, height, width), row 0 first; a read-only view.

        float32: distances, world units. float16: distances divided by ``entries["scale"]``. int16 or int8: fractions of
        ``entries["scale"]`` in 32767 or 127 steps. Unused texels are zero.
        """
        view = self._pages[...]
        view.flags.writeable = False
        return view

    @property
    def entries(self) -> NDArray[Any]:
        """One record per index, read-only: the bytes of a std430 buffer for a shader.

        ``layout="strips"``: the 208 bytes of the article's struct: ``model``, ``inverse_model`` (4, 4), ``inner_min``,
        ``inner_max``, ``outer_min``, ``outer_max`` (4,), ``atlas_index`` (the page), ``atlas_offset`` (the row of
        strips). ``layout="shelves"``: 240 bytes. The same fields come first, where ``atlas_offset`` is the first texel
        of the block, counted row by row; then ``scale``, ``columns``, ``shape`` (3,), ``gutter``, ``corner`` (2,),
        ``tile`` (2,).

        The matrices are stored by columns, as shaders read them: ``entries["model"][i].T`` is the matrix that
        multiplies column vectors. An index without a volume has the page -1.
        """
        with self._lock:
            if self._entries is None:
                rows = len(self._blocks)
                records = _core.atlas_entries(
                    rows_of(self._blocks),
                    self._boxes.reshape(rows, 12).tolist(),
                    self._models.reshape(rows, 16).tolist(),
                    self._scales.tolist(),
                    self._layout,
                    self._page_size,
                    self._encoding,
                )
                self._entries = np.frombuffer(records, entry_dtype(self._layout, self._encoding))
            return self._entries

    def entry_bytes(self, *, header: bool = False) -> bytes:
        """Return the bytes of :attr:`entries`, little-endian, for a storage buffer.

        Parameters
        ----------
        header : bool, default False
            Put the number of entries before the entries, as in the buffer of the article::

                layout (std430, binding = 0) buffer PackedSdfOffsetDetailBuffer {
                    int offsetSize;                   // bytes 0 to 3; 12 bytes of padding follow
                    PackedSdfOffsetDetail offsets[];  // from byte 16
                };

        Returns
        -------
        bytes
            208 or 240 bytes for each entry, after the 16 bytes of the header.

        Raises
        ------
        ArgumentError
            If `header` is not a bool.
        """
        entries = self.entries
        count = struct.pack("<i12x", len(entries)) if checks.flag("header", header) else b""
        return count + entries.tobytes()

    def add(self, volume: Volume | SparseVolume, transform: ArrayLike | None = None, *, name: str = "") -> int:
        """Add a volume without moving the others.

        Parameters
        ----------
        volume : Volume or SparseVolume
            For strips: a cube of the same size as the others. A sparse volume is packed as its whole grid.
        transform : (4, 4) array, optional
            Model matrix of the entry.
        name : str, optional
            Name of the volume.

        Returns
        -------
        int
            Index of the volume: the first free one. A new page is opened if no page has enough free area.

        Raises
        ------
        AtlasError
            If the volume cannot fit. The message states the page size that would suffice.
        CapacityError
            If a new page does not fit in memory.
        """
        item = checked_item(0, volume if transform is None else (volume, transform))
        return self._place([item], [checked_name("name", name)], None)[0]

    def remove(self, i: int) -> None:
        """Remove a volume. Its texels become zero, and its index and area become free.

        Parameters
        ----------
        i : int
            Index of the volume; negative indices count from the end.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        """
        with self._lock:
            i = self._index(i)
            _core.atlas_clear(self._writable(), self._row(i), self._encoding)
            self._blocks[i] = np.zeros((), BLOCK)
            self._blocks["page"][i] = VACANT
            self._boxes[i], self._models[i], self._scales[i] = 0, np.eye(4), 1
            self._reports[i] = Report()
            self._names[i] = ""
            self._entries = None
            self._changes += 1

    def resolution(self, i: int) -> tuple[int, int, int]:
        """Return the number of voxels of volume `i` along x, y and z; AtlasError if there is no such volume."""
        nx, ny, nz = self._blocks["shape"][self._index(i)].tolist()
        return nx, ny, nz

    def unpack(self, i: int) -> Volume:
        """Copy a volume out of the atlas.

        Parameters
        ----------
        i : int
            Index of the volume; negative indices count from the end.

        Returns
        -------
        Volume
            The decoded samples, float32. They equal the samples of the packed volume if the encoding is float32.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        """
        with self._lock:
            i = self._index(i)
            distances = _core.atlas_read(self._bytes(), self._row(i), self._encoding, float(self._scales[i]))
            inner, outer = self._boxes[i, :2].copy(), self._boxes[i, 2:].copy()
            return Volume._wrap(distances, outer, inner, self._reports[i])

    def sample(self, i: int, points: ArrayLike, *, filter: AtlasFilter = "linear") -> NDArray[np.float32]:
        """Evaluate the field of one volume, read from the pages.

        Parameters
        ----------
        i : int
            Index of the volume.
        points : (n, 3) real
            Positions in the volume's space, of any leading shape.
        filter : "linear" or "nearest", default "linear"
            ``"linear"``: two bilinear taps and an interpolation along z, equal to :meth:`Volume.sample`. ``"nearest"``:
            the nearest texel.

        Returns
        -------
        (n,) float32
            World units. Outside the box: a proven lower bound on the distance, as for :meth:`Volume.sample`.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        ArgumentError
            For a wrong shape, a point that is not finite, or an unknown filter.
        """
        flat, shape = checks.points(points)
        with self._lock:
            i = self._index(i)
            inner_lower, inner_upper, lower, upper = (checks.triple(corner) for corner in self._boxes[i])
            values = _core.atlas_sample(
                self._bytes(),
                self._row(i),
                self._encoding,
                float(self._scales[i]),
                lower,
                upper,
                inner_lower,
                inner_upper,
                flat,
                filter=checks.choice("filter", filter, get_args(AtlasFilter)),
            )
        return values.reshape(shape)

    def texture_coordinates(self, i: int, points: ArrayLike) -> NDArray[np.float64]:
        """Compute the texture coordinates of points on their page: ``ConvertWorldToTexture`` of the article.

        Parameters
        ----------
        i : int
            Index of the volume; its page is ``entries["atlas_index"][i]``.
        points : (n, 3) real
            Positions in the volume's space, of any leading shape. A point outside the box is replaced by the nearest
            point of the box.

        Returns
        -------
        (n, 2) float64
            Coordinates from 0 to 1 along the width and the height of the page, in the slice that contains the point.

        Raises
        ------
        AtlasError
            If there is no volume `i`.
        ArgumentError
            For a wrong shape or a point that is not finite.
        """
        flat, shape = checks.points(points)
        i = self._index(i)
        lower, upper = checks.triple(self._boxes[i, 2]), checks.triple(self._boxes[i, 3])
        found = _core.atlas_texture_coordinates(self._row(i), self._page_size, lower, upper, flat)
        return found.reshape(*shape, 2)

    def shader(self, language: Language = "wgsl", *, texels: Texels | None = None) -> str:
        """Generate functions that sample the pages in a shader, as commented source text.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            GLSL is written for WebGL 2 (ES 3.00). Newer versions accept it with another first line.
        texels : "pages", "png" or "integers", optional
            Texels that are bound as the texture. ``"pages"``: the texels of :attr:`pages`, in the format R32_FLOAT,
            R16_FLOAT, R16_SNORM or R8_SNORM. ``"png"``: the unsigned integers of the .png that :meth:`save` writes, as
            R16_UNORM (R8_UNORM for snorm8); the text converts them to distances with the scales in the JSON beside the
            .png. ``"integers"``: the texels of :attr:`pages` of snorm16 or snorm8, as R16_SINT or R8_SINT. The default
            is ``"png"`` for an atlas that was loaded from a .png, otherwise ``"pages"``.

        Returns
        -------
        str
            The struct ``AtlasEntry``, whose bytes are stored in :attr:`entries`, and functions: ``atlas_sample(entry,
            p)``, the exact trilinear field; ``atlas_sample_filtered``, the same field by two taps of the hardware
            filter; ``atlas_sample_nearest``; ``atlas_texture_coordinates``. An entry point completes the shader. The
            text stays valid when volumes are added and removed.

        Raises
        ------
        ArgumentError
            For another language, unknown texels, or ``"integers"`` of float pages.
        AtlasError
            For strips without a volume, whose size is unknown.

        Notes
        -----
        R16_SNORM and R16_UNORM are not in the core of WebGPU and WebGL 2. They need the feature
        ``TEXTURE_FORMAT_16BIT_NORM`` of wgpu, ``"texture-formats-tier1"`` of WebGPU or ``EXT_texture_norm16`` of
        WebGL 2. R16_SINT needs no feature. No device filters integers, so the text for ``"integers"`` lacks
        ``atlas_sample_filtered``.
        """
        blocks = self._blocks[self._blocks["page"] != VACANT]
        if self._layout == "strips" and not len(blocks):
            raise AtlasError(
                "shader: the strips are empty, so the size of their cubes is not known; add a volume first"
            )
        side = int(blocks["shape"][0, 0]) if len(blocks) else 0
        name = checks.text("language", language)
        chosen = checks.choice("texels", self._texels if texels is None else texels, ("pages", "png", "integers"))
        return _core.atlas_shader(name, self._layout, self._page_size, self._gutter, self._encoding, side, chosen)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file. An existing file is replaced only after the new file is complete.

        Parameters
        ----------
        path : str or path
            The ending selects the format. ``.npz``: the container of fieldbake, readable by NumPy. ``.exr``: one
            channel with the pages below each other, exact. ``.png``: unsigned 16-bit integers (8-bit for snorm8), where
            32768 (128) is distance 0; floats become snorm16, scaled to the largest distance of each volume. An 8-bit
            preview is written beside a .png. A JSON file beside each image states the position and the scale of each
            volume, and how texels are decoded. :func:`fieldbake.load` reads all of them.

        Raises
        ------
        FormatError
            For an unknown ending, or an image of an empty atlas.
        OSError
            If the file cannot be written.
        """
        target = checks.path(path)
        ending = target.suffix.lower()
        with self._lock:
            form = registry.format_of(ending, "atlas")
            if form is None or form.write is None:
                registry.check_ending(target, "atlas")
                reports = json.dumps([report.to_dict() for report in self._reports]).encode()
                arrays = {name: getattr(self, f"_{name}") for name in ("pages", *ARRAYS)}
                arrays["blocks"] = rows_of(self._blocks)
                arrays["reports"] = np.frombuffer(reports, np.uint8)
                arrays["names"] = np.array(self._names, np.str_)
                container.write(target, {**head("atlas", self._encoding), **self._facts()}, arrays)
                return
            if not self._page_count:
                raise FormatError(f"{target}: the atlas is empty, and an image needs at least one page")
            saved = as_written(self, ending)
            volumes = [saved._volume_facts(i) for i in range(len(saved._blocks))]
            facts = {**saved._facts(), "pages": saved._page_count, "volumes": volumes}
            form.write(PagesFile(target, saved._pages, facts))

    def _facts(self) -> dict[str, Any]:
        """Metadata of the whole atlas that a file stores."""
        return {
            "layout": self._layout,
            "page_size": self._page_size,
            "gutter": self._gutter,
            "encoding": self._encoding,
            "band": self._band,
        }

    def _volume_facts(self, i: int) -> dict[str, Any]:
        """Metadata of the volume in row `i` that the JSON beside an image stores."""
        inner_lower, inner_upper, lower, upper = self._boxes[i].tolist()
        return {
            "name": self._names[i],
            **{name: self._blocks[name][i].tolist() for name in BLOCK.names or ()},
            "bounds": [lower, upper],
            "inner_bounds": [inner_lower, inner_upper],
            "model": self._models[i].tolist(),
            "scale": float(self._scales[i]),
            "report": self._reports[i].to_dict(),
        }

    def plot(self, page: int = 0) -> Figure:
        """Plot one page: the surfaces as lines, and the frame and the index of each volume.

        Parameters
        ----------
        page : int, default 0
            Index of the page.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks display it. ``.savefig("atlas.png")`` saves it.

        Raises
        ------
        Error
            If matplotlib is not installed, or the atlas is empty.
        ArgumentError
            If there is no such page.
        """
        from ..drawing.plot import plot_atlas

        with self._lock:
            return plot_atlas(self, page)

    def __getitem__(self, i: int) -> AtlasEntry:
        """The volume with index `i` as an object for scenes."""
        return AtlasEntry(self, self._index(i))

    def __iter__(self) -> Iterator[AtlasEntry]:
        """Iterate over the volumes of the atlas."""
        return iter([self[i] for i in self.indices])

    def __repr__(self) -> str:
        held, pages = count_text(len(self), "volume"), count_text(self._page_count, "page")
        size = f"{self._page_size} x {self._page_size}"
        return (
            f"Atlas({held} on {pages} of {size} {self._encoding}, {self._layout}, {self.fill:.0%} full, "
            f"{bytes_text(self.nbytes)})"
        )


def as_written(atlas: Atlas, ending: str) -> Atlas:
    """Convert an atlas for a file with this ending: a .png holds integers, so floats become snorm16."""
    if ending == ".png" and atlas.encoding.startswith("float"):
        return _normalised_copy(atlas, "snorm16")
    return atlas


def _normalised_copy(atlas: Atlas, encoding: Encoding) -> Atlas:
    """Convert an atlas to a normalised encoding, each volume scaled to its largest distance."""
    copy = Atlas(
        layout=atlas.layout, page_size=atlas.page_size, gutter=atlas.gutter, encoding=encoding, band=atlas.band
    )
    copy._blocks, copy._boxes, copy._models = atlas._blocks.copy(), atlas._boxes.copy(), atlas._models.copy()
    copy._scales, copy._reports = atlas._scales.copy(), list(atlas._reports)
    copy._names = list(atlas._names)
    copy._pages = np.zeros(atlas._pages.shape, encodings.DTYPES[encoding])
    for i in atlas.indices:
        distances = atlas.unpack(i).distances
        copy._scales[i] = encodings.largest_scale(distances)
        _core.atlas_write(copy._bytes(), copy._row(i), [distances], [float(copy._scales[i])], encoding=encoding)
    return copy
