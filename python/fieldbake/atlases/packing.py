"""Packing of volumes into a new atlas."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

from numpy.typing import ArrayLike

from ..base import checks, encodings
from ..base.encodings import DEFAULT_BAND, Encoding
from ..base.errors import ArgumentError
from ..base.grid import DEFAULT_RESOLUTION, Resolution
from ..base.progress import Progress
from ..meshes.convert import MeshLike
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import HasVolume, Volume
from .atlas import Atlas
from .pages import MAX_GUTTER, MAX_PAGE_SIZE, Layout, checked_item, checked_name, fitting_page, name_of


def pack(
    volumes: Iterable[Volume | SparseVolume | Shape | MeshLike | tuple[Any, ArrayLike]],
    *,
    resolution: Resolution = DEFAULT_RESOLUTION,
    layout: Layout = "shelves",
    page_size: int | Literal["fit"] = 4096,
    gutter: int = 1,
    encoding: Encoding = "float32",
    band: float = DEFAULT_BAND,
    device: str = "auto",
    progress: Progress = None,
    names: Sequence[str] | None = None,
) -> Atlas:
    """Pack volumes into the pages of an atlas.

    Parameters
    ----------
    volumes : list of Volume, SparseVolume, Shape or mesh
        Shapes and meshes, as :func:`fieldbake.bake` takes them, are baked first. Items may be ``(volume, transform)``.
        The (4, 4) transform becomes the model matrix of the entry. A sparse volume is packed as its whole grid:
        ``.to_volume()``.
    resolution : int or three ints, default 64
        Resolution of the meshes and shapes, as for :func:`fieldbake.bake`. With ``layout="strips"`` a single number
        gives cubes.
    layout : "shelves" or "strips", default "shelves"
        Shelves: any mix of resolutions; slices are wrapped over rows and placed where a page has free area. Strips:
        equal cubes, exactly as in the article: texel (x + z N, y + row N), 64 fields of 64^3 on a page of 4096 x 4096.
    page_size : int or "fit", default 4096
        Width and height of a page, texels. As many pages are opened as are needed. ``"fit"`` chooses the smallest power
        of two that holds all volumes on one page, at most 16384.
    gutter : int, default 1
        Width of the repeated border around each slice, texels. It prevents that the rounded weights of a hardware
        sampler mix in a neighbouring slice. Strips have none.
    encoding : str, default "float32"
        ``"float32"`` (exact), ``"float16"`` (11 significant bits), or the normalised ``"snorm16"`` and ``"snorm8"``,
        which divide a band around the surface into 32767 or 127 steps per half width and clamp distances beyond it.
        All round toward zero: a stored magnitude never exceeds the true one. All but float32 are stored as fractions
        of ``entries["scale"]``, which is proportional to the voxel: the error has the same bound in voxels for a mesh
        of any size. See :meth:`Volume.quantize`.
    band : float, default 4
        Half width of the band of a normalised encoding, voxels.
    device : str, default "auto"
        Volumes that were baked on a graphics device are packed there, with the same bytes. The pages are copied to the
        host at their first use. ``"auto"`` packs on the hardware GPU if all volumes are there.
    progress : bool or callable, optional
        As for :func:`fieldbake.bake`.
    names : sequence of str, optional
        One name for each volume, see :attr:`Atlas.names`. By default files have their stem, and other volumes no name.

    Returns
    -------
    Atlas
        Volume i of the list has index i.

    Raises
    ------
    AtlasError
        If a volume cannot fit on a page (the message states the page size that would suffice), or if strips receive
        volumes other than equal cubes.
    ArgumentError
        If an option is out of range.
    ShapeError
        If a shape is unbounded.
    CapacityError
        If the pages do not fit in memory.
    DeviceError
        If the device does not exist, or a page is too large for it.

    References
    ----------
    "Packing 3D SDF to a 2D Texture" defines the layout of strips. Shelves are packed by maximal rectangles: J. Jylänki,
    A Thousand Ways to Pack the Bin (2010).

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
    layout = checks.choice("layout", layout, ("shelves", "strips"))
    gutter = checks.integer("gutter", gutter, least=0, most=MAX_GUTTER)
    encoding = checks.choice("encoding", encoding, encodings.NAMES)
    band = checks.number("band", band, above=0)
    fits = isinstance(page_size, str) and page_size == "fit"
    side = 0 if fits else checks.integer('page_size (or "fit")', page_size, least=1, most=MAX_PAGE_SIZE)
    if isinstance(volumes, (Volume, HasVolume, SparseVolume)):
        raise ArgumentError(f"volumes: must be a list of volumes, got a {type(volumes).__name__}; put it in a list")
    try:
        listed = list(volumes)
    except TypeError:
        raise ArgumentError(f"volumes: must be a list of volumes, got {checks.describe(volumes)}") from None
    # The article's strips hold cubes.
    is_one = isinstance(resolution, int) and layout == "strips"
    sides = (resolution,) * 3 if is_one else resolution
    items = [checked_item(i, item, sides) for i, item in enumerate(listed)]  # type: ignore[arg-type]
    if fits:
        side = fitting_page([volume.resolution for volume, _ in items], layout, gutter, encoding)
    names = [name_of(item) for item in listed] if names is None else _checked_names(names, len(items))
    atlas = Atlas(layout=layout, page_size=side, gutter=gutter, encoding=encoding, band=band)
    atlas._place(items, names, progress, checks.text("device", device))
    return atlas


def _checked_names(names: Sequence[str], count: int) -> list[str]:
    if isinstance(names, str):
        raise ArgumentError(f"names: must be a list with a name for each volume, got the text {names!r}")
    checked = [checked_name(f"names[{i}]", name) for i, name in enumerate(checks.items("names", names, "texts"))]
    if len(checked) != count:
        raise ArgumentError(f"names: must have a name for each of {count} volumes, got {len(checked)}")
    return checked
