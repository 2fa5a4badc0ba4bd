"""Sparse volumes: samples near the surface, and bounds on the distance elsewhere."""

from __future__ import annotations

import os
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.encodings import QuantizedEncoding
from ..base.errors import ArgumentError
from ..base.loadable import Loadable
from ..base.progress import Progress, progress_callback
from ..base.report import Report, bytes_text
from ..files import container, registry
from ..files.formats import head
from ..files.grids.band_blocks import BandBlocks
from ..meshes.isosurface import Source
from . import writers
from .brick_blocks import blocks_of_bricks, decoded
from .conventions import Engine, Handedness, Up
from .convertible import Convertible
from .grid_field import GridField
from .shaded import Shaded
from .shader import ShaderBuffers, sparse_buffers, sparse_text
from .volume import Volume
from .writers import SaveOptions


class SparseVolume(GridField, Loadable, Shaded, Convertible):
    """Signed distances as bricks of 8^3 samples near the surface, and bounds everywhere else. Immutable.

    Made by :func:`fieldbake.bake_sparse` or :meth:`Volume.to_sparse`. It is sampled and drawn like a `Volume`.

    Notes
    -----
    The grid is divided into bricks of 7^3 cells. Neighbouring bricks share the samples on their faces. A brick with a
    sample in the band is stored. One brick with cells of 2 or 4 voxels replaces the bricks that it covers if its
    samples agree with theirs to the tolerance. All other bricks store only their sign and the distances at their
    corners. Between those corners the magnitude of the field is a proven lower bound on the distance from the surface,
    so rays may leap over empty bricks.

    Examples
    --------
    >>> import fieldbake as fb
    >>> sparse = fb.bake_sparse(fb.models.gear(), resolution=64)
    >>> sparse.sample([(0, 0, 0)]) > 0  # in the hole of the gear
    array([ True])
    """

    __slots__ = ("_core_field",)

    _core_field: _core.SparseField

    def __init__(self) -> None:
        raise TypeError("a SparseVolume is made by bake_sparse or Volume.to_sparse")

    @classmethod
    def _wrap(
        cls,
        field: _core.SparseField,
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
        geometry: Source | None = None,
    ) -> SparseVolume:
        volume = cls.__new__(cls)
        volume._core_field, volume._geometry = field, geometry
        volume._set_box(field.shape, bounds, inner_bounds, report)
        return volume

    @property
    def encoding(self) -> str:
        """Encoding of the samples: ``"float32"``, ``"float16"``, ``"snorm16"`` or ``"snorm8"``."""
        return self._core_field.encoding

    @property
    def band(self) -> float:
        """Distance up to which bricks are stored, world units."""
        return self._core_field.band

    @property
    def brick_counts(self) -> MappingProxyType[int, int]:
        """Number of stored bricks by the side of their cells: 1, 2 or 4 voxels."""
        return MappingProxyType({1 << level: count for level, count in enumerate(self._core_field.levels)})

    @property
    def nbytes(self) -> int:
        """Memory of the samples, the index and the corner distances, bytes."""
        return self._core_field.nbytes

    @property
    def distances(self) -> NDArray[np.float32]:
        """The field on the whole grid, (nx, ny, nz) float32, world units; a new dense array at each use."""
        return checks.frozen(self._core_field.dense())

    def to_volume(self) -> Volume:
        """Make the dense volume of the same grid: stored samples, and bounds in empty bricks."""
        dense = self._core_field.dense()
        return Volume._wrap(dense, self._bounds, self._inner_bounds, self._report, self._geometry)

    def quantize(self, encoding: QuantizedEncoding) -> SparseVolume:
        """Store the samples of the bricks in 16 or 8 bits; magnitudes are rounded toward zero.

        Parameters
        ----------
        encoding : "float16", "snorm16" or "snorm8"
            As for :meth:`Volume.quantize`. The largest integer of a normalised encoding represents the band.

        Returns
        -------
        SparseVolume
            The same bricks.

        Raises
        ------
        ArgumentError
            For another encoding.

        Examples
        --------
        >>> import fieldbake as fb
        >>> sparse = fb.bake(fb.sphere(1), 32).to_sparse()
        >>> sparse.quantize("snorm8").encoding
        'snorm8'
        """
        checks.choice("encoding", encoding, encodings.QUANTIZED)
        field, arrays = self._core_field, self._core_field.arrays()
        scale = encodings.scale_of(encoding, self.spacing, field.band / float(self.spacing.max()))
        bricks = decoded(arrays["bricks"], field)
        flat = np.asfortranarray(bricks.reshape(-1, 1, 1))
        arrays["bricks"] = _core.encode(flat, encoding, scale).reshape(bricks.shape)
        made = restore_field(self._corners(), self.resolution, field.band, scale, arrays)
        return SparseVolume._wrap(made, self._bounds, self._inner_bounds, self._report, self._geometry)

    def _sample(self, points: NDArray[np.float64], filter: str) -> NDArray[np.float32]:
        return self._core_field.sample(*self._inner_corners(), points, filter=filter)

    def _gradient(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        return self._core_field.gradient(points)

    def _surface(self, level: float) -> _core.Surface:
        return _core.Surface.of_sparse(self._core_field, level)

    def _kept_distance(self) -> float | None:
        # Every point lies within half the diagonal of a voxel of a sample.
        return self.band - 0.5 * float(np.linalg.norm(self.spacing))

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        encoding: str | None = None,
        band: float | None = None,
        compression: Literal["zip", "none"] | None = None,
        engine: Engine | None = None,
        handedness: Handedness | None = None,
        up: Up | None = None,
        normalize: bool | None = None,
    ) -> None:
        """Write a file without making the dense grid; an existing file is replaced after the new one is complete.

        Parameters
        ----------
        path : str or path
            ``.npz``, bit for bit, or ``.vdb`` and ``.nvdb``, whose leaves are filled from the bricks. For the other
            endings of :meth:`Volume.save` call :meth:`to_volume` first.
        encoding, band, compression, engine, handedness, up, normalize : optional
            As for :meth:`Volume.save`; ``.npz`` files keep the encoding and the axes of the volume.

        Raises
        ------
        FormatError, ArgumentError, OSError
            As for :meth:`Volume.save`.
        """
        target = checks.path(path)
        options = SaveOptions(encoding, band, compression, False, None, engine, handedness, up, normalize)
        if target.suffix.lower() in registry.ENDINGS["sparse"][1:]:
            writers.write(target, self, self._blocks, options)
            return
        registry.check_ending(target, "sparse")
        if options != SaveOptions():
            raise ArgumentError("path: a sparse .npz has no options; call to_volume() to change axes or encoding")
        field = self._core_field
        facts = {"encoding": field.encoding, "scale": field.scale, "band": field.band}
        container.write(target, {**head("sparse", field.encoding), **self._facts(), **facts}, field.arrays())

    def _blocks(self, placed: writers.Placed, band: float) -> BandBlocks:
        own = blocks_of_bricks(self._core_field, self.sample, self.origin, self.spacing, band / placed.scale)
        return placed.way.blocks(own, self._bounds)

    def _shader_text(self, language: object) -> str:
        return sparse_text(self, language)

    def _shader_textures(self) -> ShaderBuffers:
        return sparse_buffers(self)

    @property
    def _scale(self) -> float:
        return 1.0

    def __reduce__(self) -> tuple[Any, ...]:
        field = self._core_field
        arrays = field.arrays()
        parts = (field.shape, field.band, field.scale, arrays, self._bounds, self._inner_bounds, self._report)
        return _restore, parts

    def __repr__(self) -> str:
        shape = " x ".join(str(side) for side in self.resolution)
        bricks = sum(self.brick_counts.values())
        return f"SparseVolume({shape} voxels, {bricks:,} bricks as {self.encoding}, {bytes_text(self.nbytes)})"


def _restore(
    shape: tuple[int, int, int], band: float, scale: float, arrays: Any, bounds: Any, inner_bounds: Any, report: Report
) -> SparseVolume:
    corners = checks.triple(bounds[0]), checks.triple(bounds[1])
    return SparseVolume._wrap(restore_field(corners, shape, band, scale, arrays), bounds, inner_bounds, report)


def restore_field(
    corners: tuple[tuple[float, float, float], tuple[float, float, float]],
    shape: tuple[int, int, int],
    band: float,
    scale: float,
    arrays: Any,
) -> _core.SparseField:
    """Make a field of the core from the arrays of :meth:`_core.SparseField.arrays`, in any memory order."""
    bricks = np.ascontiguousarray(arrays["bricks"].transpose(0, 3, 2, 1)).reshape(-1)
    index, nodes = np.asfortranarray(arrays["index"]), np.asfortranarray(arrays["nodes"])
    return _core.SparseField(*corners, shape, band, scale, index, nodes, bricks)


def sparse_options(band: float, tolerance: float | None, encoding: str) -> dict[str, Any]:
    """Check the options of a sparse field, for the core."""
    return {
        "band": checks.number("band", band, least=2),
        "tolerance": None if tolerance is None else checks.number("tolerance", tolerance, least=0),
        "encoding": checks.text("encoding", encoding),
    }


def to_sparse(
    volume: Volume, tolerance: float | None, band: float, encoding: str, progress: Progress = None
) -> SparseVolume:
    """See :meth:`Volume.to_sparse`."""
    options = sparse_options(band, tolerance, encoding)
    inner_lower, inner_upper = volume._inner_corners()
    with progress_callback(progress, "bricks") as callback:
        field = _core.to_sparse(
            volume._texels,
            *volume._corners(),
            inner_lower,
            inner_upper,
            scale=volume._scale,
            progress=callback,
            **options,
        )
    return SparseVolume._wrap(field, volume.bounds, volume.inner_bounds, volume.report, volume._geometry)
