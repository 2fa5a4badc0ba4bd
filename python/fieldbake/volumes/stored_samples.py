"""Samples of a grid in the memory of the host, of a graphics device, or of both."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from .grid_field import Filter, GridField


class StoredSamples(GridField):
    """A trilinear field of stored samples, which are an array for other libraries."""

    __slots__ = ("_field", "_samples")

    # Samples on a graphics device, and on the host. At least one of the two is present.
    _field: _core.DeviceField | None
    _samples: NDArray[np.float32] | None

    @property
    def _distances(self) -> NDArray[np.float32]:
        """The samples, read back from the device at the first use."""
        if self._samples is None:
            assert self._field is not None
            object.__setattr__(self, "_samples", checks.frozen(self._field.read()))
        assert self._samples is not None
        return self._samples

    def _source(self, device: str) -> NDArray[Any] | _core.DeviceField:
        """The samples in the memory of the device that a call with this `device` uses, or else in host memory."""
        field = self._field
        return field if field is not None and field.serves(checks.text("device", device)) else self._distances

    @property
    def _texels(self) -> NDArray[Any]:
        """The samples in their stored encoding."""
        return self._distances

    @property
    def _scale(self) -> float:
        """Factor that decodes the stored samples."""
        return 1.0

    @property
    def distances(self) -> NDArray[np.float32]:
        """Samples, (nx, ny, nz) float32, world units, x fastest in memory; a read-only view."""
        return self._distances[...]

    @property
    def nbytes(self) -> int:
        """Memory of the samples, bytes."""
        nx, ny, nz = self._shape
        return 4 * nx * ny * nz

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        requested = np.dtype(np.float32 if dtype is None else dtype)
        if requested == self._distances.dtype and not copy:
            return self._distances[...]
        if copy is False:
            raise ValueError(f"distances are float32: {requested} needs a copy")
        return np.array(self._distances, dtype=requested)

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return self._distances.__array_interface__

    def __dlpack__(
        self,
        *,
        stream: object = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> object:
        """Export the samples by DLPack. Consumers without read-only tensors receive a writable copy."""
        if stream is not None:
            raise BufferError("the samples are in host memory, which has no streams")
        if max_version is None or max_version[0] < 1 or copy or np.lib.NumpyVersion(np.__version__) < "2.1.0":
            return np.array(self._distances, order="K").__dlpack__()
        return self._distances.__dlpack__(max_version=max_version, dl_device=dl_device, copy=copy)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._distances.__dlpack_device__()

    def sample(self, points: ArrayLike, *, filter: Filter = "linear", device: str = "auto") -> NDArray[np.float32]:
        """Evaluate the field at points.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape.
        filter : "linear" or "nearest", default "linear"
            Trilinear interpolation of the eight surrounding samples, or the nearest sample.
        device : str, default "auto"
            ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. ``"auto"`` reads the samples from a
            hardware device if they are only in its memory, else from host memory. The first call for a named device
            uploads the samples, which then stay in its memory.

        Returns
        -------
        (n,) float32
            World units. Outside the box: the proven lower bound sqrt(a^2 + s^2), where `a` is the distance from the box
            of the outermost samples and `s` a lower bound at the nearest point of that box. The bound is about the part
            of the solid in the box: if the box cuts the solid, the bound is positive also where the solid continues.

        Raises
        ------
        ArgumentError
            For a wrong shape, a point that is not finite, or an unknown filter.
        DeviceError
            If the device is not available or has too little memory.

        Notes
        -----
        A device returns the corners of the cells that contain the points, 32 bytes per cell, and the CPU interpolates
        them. The results of all devices are equal to the bit. The other samples stay on the device.

        Examples
        --------
        >>> import fieldbake as fb
        >>> distances = fb.bake(fb.sphere(), 33).sample([(0, 0, 0), (2, 0, 0)], device="cpu")
        >>> [f"{distance:.1f}" for distance in distances]
        ['-1.0', '1.0']
        """
        flat, shape = checks.points(points)
        return self._sample(flat, checks.choice("filter", filter, ("linear", "nearest")), device).reshape(shape)

    def gradient(self, points: ArrayLike, *, device: str = "auto") -> NDArray[np.float32]:
        """Evaluate the gradient of the trilinear field at points. On the surface it points outwards.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape. A point beyond the outermost voxel centres is replaced by the nearest
            point between them.
        device
            As for :meth:`sample`.

        Returns
        -------
        (n, 3) float32
            Distance per world unit. The length is about 1 away from edges of the field.

        Raises
        ------
        ArgumentError, DeviceError
            As for :meth:`sample`.
        """
        flat, shape = checks.points(points)
        return self._gradient(flat, device).reshape(*shape, 3)

    def _sample(self, points: NDArray[np.float64], filter: str, device: str = "auto") -> NDArray[np.float32]:
        texels, scale = self._texels_at(device)
        lower, upper = self._corners()
        return _core.sample(texels, lower, upper, *self._inner_corners(), points, filter=filter, scale=scale)

    def _gradient(self, points: NDArray[np.float64], device: str = "auto") -> NDArray[np.float32]:
        texels, scale = self._texels_at(device)
        return _core.gradient(texels, *self._corners(), points, scale=scale)

    def _texels_at(self, device: str) -> tuple[NDArray[Any] | _core.DeviceField, float]:
        """The samples at the place where a call with this `device` reads them, and the factor that decodes them."""
        where, field = checks.text("device", device), self._field
        if where == "auto":
            on_host = self._samples is not None or field is None or not field.serves(where)
            return (self._texels, self._scale) if on_host or field is None else (field, 1.0)
        if where == "cpu":
            return self._texels, self._scale
        if field is None or not field.serves(where):
            field = _core.DeviceField.upload(self._distances, where)
            object.__setattr__(self, "_field", field)
        return field, 1.0

    def _surface(self, level: float) -> _core.Surface:
        return _core.Surface.of_field(self._texels, *self._corners(), level, scale=self._scale)


def check_distances(value: ArrayLike) -> NDArray[np.float32]:
    """Check samples of shape (nx, ny, nz) and return them as float32 with x fastest, copied only where needed."""
    array = checks.real_array("distances", value, "(nx, ny, nz)")
    if array.ndim != 3 or array.size == 0:
        raise ArgumentError(f"distances: must have shape (nx, ny, nz), got {checks.describe(array)}")
    with np.errstate(over="ignore", invalid="ignore"):
        samples = np.asfortranarray(array, dtype=np.float32)
    # The sum of the squares is finite in float32 only if all samples are below 2e19. Else the slower search runs.
    flat = samples.ravel(order="K")
    with np.errstate(over="ignore", invalid="ignore"):
        suspicious = not np.isfinite(np.dot(flat, flat))
    if suspicious and not (valid := np.abs(samples) <= np.float32(checks.FAR)).all():
        where = tuple(np.argwhere(~valid)[0].tolist())
        limit = f"at most {checks.FAR:g} from 0" if np.isfinite(samples[where]) else "finite"
        raise ArgumentError(f"distances[{', '.join(map(str, where))}]: must be {limit}, got {samples[where]}")
    return samples
