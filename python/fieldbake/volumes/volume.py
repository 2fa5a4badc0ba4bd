"""The volume: a signed distance field on a regular grid."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base import checks
from ..base.encodings import Encoding, QuantizedEncoding
from ..base.errors import ArgumentError
from ..base.loadable import Loadable
from ..base.progress import Progress
from ..base.report import Report, bytes_text
from ..files import container, registry
from ..files.formats import head
from ..files.grids.band_blocks import BandBlocks, blocks_of_grid
from ..meshes.convert import MeshLike
from ..meshes.isosurface import Source
from ..meshes.mesh import Mesh
from . import writers
from .conventions import Engine, Handedness, Up
from .interop import grid_of_xarray
from .shaded import Shaded
from .shader import ShaderBuffers, volume_buffers, volume_text
from .stored_samples import StoredSamples, check_distances
from .writers import SaveOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .quantized import QuantizedVolume
    from .sparse import SparseVolume


class Recipe(NamedTuple):
    """The mesh and the options of the bake that made a volume."""

    mesh: Mesh
    sign: str
    #: Half width of the band, voxels.
    band: float | None
    #: Thickness of a two-sided sheet, world units.
    thickness: float | None
    device: str


class Volume(StoredSamples, Loadable, Shaded):
    """Signed distances on a regular grid: negative inside, in the mesh's own units. Immutable.

    Made by :func:`fieldbake.bake`, by :func:`fieldbake.load`, or from an array.

    Parameters
    ----------
    distances : (nx, ny, nz) real
        Samples at the voxel centres. Stored as float32 with x fastest in memory.
    bounds : (2, 3) array
        Lower and upper corner of the box, world units.
    inner_bounds : (2, 3) array, optional
        Box that contains the whole surface; the default is `bounds`. The lower bound outside the box uses it.
    report : Report, optional
        Origin and cost of the distances.

    Raises
    ------
    ArgumentError
        For a wrong shape, a distance that is not finite or more than 1e37 from 0, or an empty box.

    Examples
    --------
    >>> x = np.linspace(-0.75, 0.75, 4)
    >>> half_space = Volume(np.broadcast_to(x[:, None, None], (4, 4, 4)), [(-1, -1, -1), (1, 1, 1)])
    >>> half_space.sample([(0.25, 0.0, 0.0)]).tolist()
    [0.25]
    >>> half_space.gradient([(0.25, 0.0, 0.0)]).tolist()
    [[1.0, 0.0, 0.0]]
    """

    __slots__ = ("_recipe",)

    #: How the volume was baked from a mesh; None for other volumes.
    _recipe: Recipe | None

    def __init__(
        self,
        distances: ArrayLike,
        bounds: ArrayLike,
        *,
        inner_bounds: ArrayLike | None = None,
        report: Report | None = None,
    ) -> None:
        if report is not None and not isinstance(report, Report):
            raise ArgumentError(f"report: must be a Report, got {checks.describe(report)}")
        box = checks.box("bounds", bounds)
        inner = box.copy() if inner_bounds is None else checks.box("inner_bounds", inner_bounds, flat=True)
        self._set(np.array(check_distances(distances), order="F"), box, inner, report or Report())

    def _set(
        self,
        distances: NDArray[np.float32] | _core.DeviceField,
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
        geometry: Source | None = None,
        recipe: Recipe | None = None,
    ) -> None:
        self._recipe = recipe
        if isinstance(distances, _core.DeviceField):
            self._field, self._samples = distances, None
        else:
            self._field, self._samples = None, checks.frozen(distances)
        self._geometry = geometry
        self._set_box(distances.shape, bounds, inner_bounds, report)

    @classmethod
    def _wrap(
        cls,
        distances: NDArray[np.float32] | _core.DeviceField,
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
        geometry: Source | None = None,
        recipe: Recipe | None = None,
    ) -> Volume:
        """Make a volume of checked arrays without a copy."""
        volume = cls.__new__(cls)
        volume._set(distances, bounds, inner_bounds, report, geometry, recipe)
        return volume

    @classmethod
    def from_xarray(cls, array: Any) -> Volume:
        """Make a volume from an xarray ``DataArray``.

        Parameters
        ----------
        array : xarray.DataArray
            Signed distances with the dimensions x, y and z, in any order. Coordinates have equal steps; they are the
            voxel centres. The attribute ``inner_bounds`` is used if it is there.

        Raises
        ------
        ArgumentError
            For other dimensions, missing or uneven coordinates, and samples that are not finite.
        """
        samples, bounds, inner = grid_of_xarray(array)
        return Volume(samples, bounds, inner_bounds=inner)

    def downsample(self, factor: int = 2) -> Volume:
        """Make a coarser volume over the same box.

        Parameters
        ----------
        factor : int, default 2
            Factor by which the number of voxels along each side is divided; the result is rounded up.

        Returns
        -------
        Volume
            Trilinear values at the new voxel centres. They are not lower bounds on the distance.

        Raises
        ------
        ArgumentError
            If `factor` is not a whole number of at least 1.
        """
        factor = checks.integer("factor", factor, least=1, most=2**31)
        nx, ny, nz = ((side + factor - 1) // factor for side in self.resolution)
        distances = _core.resample(self._texels, *self._corners(), (nx, ny, nz), scale=self._scale)
        return Volume._wrap(distances, self._bounds, self._inner_bounds, self._report, self._geometry)

    def plot_slices(self, at: ArrayLike | None = None) -> Figure:
        """Plot the slices through a point along the three axes, coloured by distance, with iso-lines.

        Parameters
        ----------
        at : (3,) array, optional
            World position. The default is the centre of the box.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks display it. ``.savefig("slices.png")`` saves it.

        Raises
        ------
        Error
            If matplotlib is not installed.
        ArgumentError
            If `at` is not a position.
        """
        from ..drawing.plot import plot_slices

        return plot_slices(self, at)

    def quantize(self, encoding: QuantizedEncoding, *, band: float = 4) -> QuantizedVolume:
        """Store the volume in 16 or 8 bits per sample.

        Parameters
        ----------
        encoding : "float16", "snorm16" or "snorm8"
            ``"float16"``: half floats of the distances in voxels. ``"snorm16"`` and ``"snorm8"``: integers in equal
            steps from minus the band to the band. For float16 the voxel is rounded down to a power of two, world units.
        band : float, default 4
            Half width of the band that the integers represent, in voxels by the longest side of a voxel. Magnitudes
            beyond the band are stored as the band. float16 has no band: it represents at least 65504 voxels.

        Returns
        -------
        QuantizedVolume
            A volume with the same methods. Values are rounded toward zero: no stored magnitude exceeds the true one.
            Within the band the error is at most band / 127 voxels (snorm8) or band / 32767 voxels (snorm16). For
            float16 it is at most 2^-10 of the distance or 2^-24 voxels, whichever is larger. These bounds hold for a
            mesh of any size.

        Raises
        ------
        ArgumentError
            For an unknown encoding or a band that is not positive.

        Examples
        --------
        >>> half_space = Volume(np.linspace(-1, 1, 8).repeat(64).reshape(8, 8, 8), [(-1, -1, -1), (1, 1, 1)])
        >>> half_space.quantize("snorm8").nbytes
        512
        """
        from .quantized import quantize

        return quantize(self, encoding, band)

    def to_sparse(
        self,
        *,
        tolerance: float | None = 0.05,
        band: float = 4,
        encoding: Encoding = "float32",
        progress: Progress = None,
    ) -> SparseVolume:
        """Convert the field to bricks around the surface; see :class:`SparseVolume`.

        Parameters
        ----------
        tolerance : float or None, default 0.05
            Largest difference, in voxels, by which a coarser brick may differ from the samples in the band that it
            replaces. None never uses coarser bricks, so every stored sample equals the sample of the volume. With
            ``"snorm16"`` and ``"snorm8"`` it holds within half the band; beyond it a brick may have lower bounds.
        band : float, default 4
            Distance from the surface within which a sample makes its brick stored, voxels; at least 2.
        encoding : str, default "float32"
            ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``, rounded toward zero. The band is the scale of
            the integers.
        progress : bool or callable, optional
            True draws a bar on stderr. A callable receives the finished fraction from 0 to 1.

        Returns
        -------
        SparseVolume
            In empty bricks its values are lower bounds on the distance, provided that the samples of the volume are
            distances.

        Raises
        ------
        ArgumentError
            If an option is out of range.
        """
        from .sparse import to_sparse

        return to_sparse(self, tolerance, band, encoding, progress)

    def update(self, mesh: MeshLike) -> Volume:
        """Bake another state of the mesh into the same box, with the same resolution and options.

        Parameters
        ----------
        mesh : Mesh, or anything that :func:`fieldbake.bake` accepts as a mesh
            Usually ``volume``'s mesh after :meth:`Mesh.moved`.

        Returns
        -------
        Volume
            Equal, bit for bit, to ``bake(mesh, volume.resolution, bounds=volume.bounds, ...)`` with the options of the
            first bake. The box stays even if the mesh leaves it. This volume stays as it is.

        Raises
        ------
        MeshError
            If the mesh cannot be read or used.
        ArgumentError
            If the box is too far from the mesh.

        Notes
        -----
        If the mesh has the faces of the previous mesh, only the blocks of samples near moved triangles are computed
        again. The whole grid is baked if most faces moved, if the box of the mesh moved by about an eighth of its size
        or its longest side passed a power of two (then all positions are rounded differently), with a `band`, with
        ``sign="pseudonormal"`` or ``"normal"``, and on graphics devices. A volume from a file or an array has no
        previous mesh; its whole grid is baked, with the options that its report states.

        Examples
        --------
        An instance is drawn with the field of the current positions:

        >>> import fieldbake as fb
        >>> knot = fb.models.torus_knot()
        >>> volume = fb.bake(knot, 32)
        >>> bent = knot.moved(knot.vertices + [[0, 0.1, 0]] * np.sin(knot.vertices[:, :1]))
        >>> volume = volume.update(bent)
        >>> scene = fb.Scene([fb.Instance(volume, material=fb.Material(color=(0.9, 0.6, 0.2)))])
        """
        from ..baking.update import update

        return update(self, mesh)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        encoding: str | None = None,
        band: float | None = None,
        compression: Literal["zip", "none"] | None = None,
        mipmaps: bool = False,
        columns: int | None = None,
        engine: Engine | None = None,
        handedness: Handedness | None = None,
        up: Up | None = None,
        normalize: bool | None = None,
    ) -> None:
        """Write a file. An existing file is replaced only after the new file is complete.

        Parameters
        ----------
        path : str or path
            The ending chooses the format:

            - ``.npz``: fieldbake's own, and NumPy's; bit for bit.
            - ``.vdb``: OpenVDB level set, for Blender, Houdini and Unreal. ``.nvdb``: NanoVDB, for warp and Omniverse.
            - ``.vti``: VTK and ParaView. ``.nrrd``: 3D Slicer and ParaView.
            - ``.dds``, ``.ktx2``: 3D textures. ``.exr``: the slices as tiles of one image, for engines that cut an
              image into a 3D texture. ``.vf``: Unity's Visual Effect Graph.

            Read any of them with :func:`fieldbake.load`. ``.dds``, ``.exr``, ``.vf`` and ``.nvdb`` files have a
            JSON beside them.
        encoding : str, optional
            Textures: ``"float32"`` (default), ``"float16"``, ``"snorm16"``, ``"snorm8"`` as for
            :func:`fieldbake.pack`, or ``"unorm8"``, unsigned bytes with distance 0 at 127.5. ``.vdb`` and ``.exr``:
            ``"float32"`` or ``"float16"``.
        band : float, optional
            Textures: half width of the band that a normalised encoding keeps, voxels; 4 by default. ``.vdb`` and
            ``.nvdb``: half width of the narrow band, voxels of the longest side; 3 by default. Within the band
            distances are exact, beyond it they are plus or minus the band.
        compression : "zip" or "none", optional
            For ``.vdb``, ``.vti`` and ``.nrrd``; zip by default.
        mipmaps : bool, default False
            For ``.dds`` and ``.ktx2``: add coarser levels, each with half the sides of the one before.
        columns : int, optional
            For ``.exr``: tiles side by side. By default the sheet is as square as it can be without empty tiles.
        engine : "unity", "unreal", "godot", "blender" or "three", optional
            Sets the next three options, and the settings beside an ``.exr``, as the engine has them.
        handedness : "right" or "left", default "right"
            Axes of the file. Left-handed files have x negated, or y if z points upwards.
        up : "y" or "z", default "y"
            Axis of the file that points upwards. The field's own y axis becomes that axis.
        normalize : bool, default False
            Move the box to the origin and scale it, and the distances, to a longest side of 1.

        Raises
        ------
        FormatError
            For another ending.
        ArgumentError
            For an option that the format does not have.
        OSError
            If the file cannot be written.
        """
        options = SaveOptions(encoding, band, compression, mipmaps, columns, engine, handedness, up, normalize)
        self._save(checks.path(path), options)

    def _save(self, target: Path, options: SaveOptions) -> None:
        if target.suffix.lower() in registry.ENDINGS["volume"][1:]:
            writers.write(target, self, self._blocks, options)
            return
        registry.check_ending(target, "volume")
        options.check(".npz")
        placed = writers.Placed(self, self._blocks, options.convention())
        container.write(target, {**head("volume"), **placed.facts}, {"distances": placed.distances})

    def _blocks(self, placed: writers.Placed, band: float) -> BandBlocks:
        return blocks_of_grid(placed.distances, placed.origin, placed.spacing, band)

    def _shader_text(self, language: object) -> str:
        return volume_text(self, language)

    def _shader_textures(self) -> ShaderBuffers:
        return volume_buffers(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (self._distances, self._bounds, self._inner_bounds, self._report)

    def __repr__(self) -> str:
        shape = " x ".join(str(side) for side in self.resolution)
        spacing = self.spacing
        same = np.allclose(spacing, spacing[0], rtol=1e-6)
        voxel = f"{spacing[0]:.4g}" if same else " x ".join(f"{side:.4g}" for side in spacing)
        made = f", sign {self._report.sign_method} on {self._report.device}" if self._report.sign_method else ""
        return f"{type(self).__name__}({shape} voxels of {voxel} units, {bytes_text(self.nbytes)}{made})"


def _restore(distances: Any, bounds: Any, inner_bounds: Any, report: Report) -> Volume:
    return Volume(distances, bounds, inner_bounds=inner_bounds, report=report)


class HasVolume:
    """Base class of objects that have a volume and its public attributes and methods, such as merged fields."""

    __slots__ = ("volume",)

    #: The samples and their box.
    volume: Volume

    def __getattr__(self, name: str) -> Any:
        if name in OF_VOLUME:
            return getattr(self.volume, name)
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *OF_VOLUME})

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return self.volume.__array__(dtype, copy)

    def __dlpack__(self, **options: Any) -> object:
        return self.volume.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.volume.__dlpack_device__()


#: Public attributes and methods of a volume that an object with a volume has. Class methods, encodings and the update
#: belong to the volume alone, and views to the object.
OF_VOLUME = frozenset(
    name
    for name in dir(Volume)
    if not name.startswith("_") and name not in ("from_xarray", "load", "quantize", "update", "show", "to_html")
)


def plain_field(field: Any) -> Any:
    """Return the volume of an object that has one, and any other object unchanged."""
    return field.volume if isinstance(field, HasVolume) else field
