"""Volumes whose distances are stored in 16 or 8 bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks, encodings
from ..base.errors import ArgumentError
from ..base.report import Report, bytes_text
from ..files import container, registry
from ..files.formats import head
from ..meshes.isosurface import Source
from . import writers
from .volume import Volume
from .writers import SaveOptions


class QuantizedVolume(Volume):
    """A :class:`Volume` that stores its distances in 16 or 8 bits. Made by :meth:`Volume.quantize`.

    A stored magnitude never exceeds the true one, so rays do not pass through surfaces. ``.distances`` decodes all
    samples to float32 at each use. Sampling and ray marching on the CPU read the stored samples; a graphics
    device receives float32.

    Examples
    --------
    >>> import fieldbake as fb
    >>> volume = fb.bake(fb.sphere(), 32)
    >>> small = volume.quantize("snorm8")
    >>> small.encoding, small.nbytes, volume.nbytes
    ('snorm8', 32768, 131072)
    >>> bool((abs(small.distances) <= abs(volume.distances)).all())
    True
    """

    __slots__ = ("_encoded", "_encoding", "_unit")

    _encoded: NDArray[Any]
    _encoding: str
    _unit: float

    @classmethod
    def _of(
        cls,
        encoded: NDArray[Any],
        encoding: str,
        scale: float,
        bounds: NDArray[np.float64],
        inner_bounds: NDArray[np.float64],
        report: Report,
        geometry: Source | None = None,
    ) -> QuantizedVolume:
        """Make a volume of a checked array with x fastest in memory."""
        volume = cls.__new__(cls)
        volume._encoded, volume._encoding, volume._unit = checks.frozen(encoded), encoding, scale
        volume._field, volume._samples, volume._geometry = None, None, geometry
        volume._recipe = None
        volume._set_box(encoded.shape, bounds, inner_bounds, report)
        return volume

    @property
    def encoding(self) -> str:
        """Name of the encoding: ``"float16"``, ``"snorm16"`` or ``"snorm8"``."""
        return self._encoding

    @property
    def encoded(self) -> NDArray[Any]:
        """Stored samples, (nx, ny, nz), x fastest, as fractions of :attr:`scale`: integers or half floats."""
        return self._encoded[...]

    @property
    def scale(self) -> float:
        """Distance that a stored value of 1 represents, world units.

        The largest integer of a normalised encoding represents this distance; larger distances are clamped to it. For
        float16 the scale is the largest power of two that does not exceed the longest side of a voxel, and distances
        are clamped to 65504 times the scale.
        """
        return self._unit

    def error_bound(self, distance: float) -> float:
        """Compute a bound on the error of a stored distance.

        Parameters
        ----------
        distance : float
            True distance, world units. The bound holds for magnitudes up to ``scale`` with a normalised encoding, and
            up to ``65504 * scale`` with float16.

        Returns
        -------
        float
            Largest difference between the true and the stored distance, world units.
        """
        if self._encoding == "float16":
            return max(abs(distance) * 2.0**-10, 2.0**-24 * self._unit)
        # One step, plus two float32 roundings of the decoding: relative ones, or half a subnormal step.
        return self._unit / encodings.STEPS[self._encoding] + 2 * 2.0**-23 * self._unit + 2.0**-149

    @property
    def nbytes(self) -> int:
        """Memory of the samples, bytes."""
        return self._encoded.nbytes

    @property
    def _distances(self) -> NDArray[np.float32]:
        return checks.frozen(_core.decode(self._encoded, self._unit))

    @property
    def __array_interface__(self) -> dict[str, Any]:
        # Decoded samples are temporary and this protocol cannot keep them alive. Readers use __array__ instead.
        raise AttributeError("__array_interface__")

    @property
    def _texels(self) -> NDArray[Any]:
        return self._encoded

    @property
    def _scale(self) -> float:
        return self._unit

    def _kept_distance(self) -> float | None:
        kept = super()._kept_distance()
        if self._encoding == "float16":
            return kept
        return self._unit if kept is None else min(kept, self._unit)

    def _source(self, device: str) -> NDArray[Any]:
        checks.text("device", device)
        return self._encoded

    def _save(self, target: Path, options: SaveOptions) -> None:
        """See :meth:`Volume.save`. An .npz keeps the stored numbers; a texture does so unless `encoding` is given."""
        ending = target.suffix.lower()
        way = options.convention()
        if options.encoding is None and ending in writers.MIPMAPPED:
            band = self._unit / float(self.spacing.max())
            super()._save(target, replace(options, encoding=self._encoding, band=band))
        elif options.encoding is None and ending == ".exr" and self._encoding == "float16":
            super()._save(target, replace(options, encoding="float16"))
        elif ending in registry.ENDINGS["volume"][1:] or not way.is_identity:
            super()._save(target, options)
        else:
            registry.check_ending(target, "quantized")
            if options.encoding not in (None, self._encoding):
                got = checks.describe(options.encoding)
                raise ArgumentError(f"encoding: .npz files keep the volume's {self._encoding}, got {got}")
            replace(options, encoding=None).check(ending)
            header = {**head("quantized", self._encoding), **self._facts()}
            header |= {"encoding": self._encoding, "scale": self._unit}
            container.write(target, header, {"distances": self._encoded})

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self._encoded, self._encoding, self._unit, self._bounds, self._inner_bounds, self._report)
        return _restore, parts

    def __repr__(self) -> str:
        shape = " x ".join(str(side) for side in self.resolution)
        return f"QuantizedVolume({shape} voxels as {self._encoding}, {bytes_text(self.nbytes)})"


def _restore(encoded: Any, encoding: str, scale: float, bounds: Any, inner_bounds: Any, report: Report) -> Volume:
    return QuantizedVolume._of(np.asfortranarray(encoded), encoding, scale, bounds, inner_bounds, report)


def quantize(volume: Volume, encoding: str, band: float) -> QuantizedVolume:
    """See :meth:`Volume.quantize`."""
    checks.choice("encoding", encoding, encodings.QUANTIZED)
    scale = encodings.scale_of(encoding, volume.spacing, checks.number("band", band, above=0))
    encoded = _core.encode(volume._distances, encoding, scale)
    inner = volume.inner_bounds
    return QuantizedVolume._of(encoded, encoding, scale, volume.bounds, inner, volume.report, volume._geometry)
