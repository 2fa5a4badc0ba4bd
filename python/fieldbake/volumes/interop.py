"""Volumes as objects of other libraries: PyVista, xarray and Open3D, each imported at the first use."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError
from ..base.optional import optional_module
from ..meshes.mesh import Mesh
from .grid_box import GridBox

#: Name of the samples in other libraries.
NAME = "distances"
#: Fraction by which the steps between coordinates may differ.
UNEVEN = 1e-4
#: Slices that are checked at once.
SLAB = 16
#: Number of the lower bits of a float32 length that its median leaves out: the median is right to 1 / 4096.
LENGTH_SHIFT = 12


@dataclass(frozen=True)
class FieldCheck:
    """Measurements that show whether samples are signed distances.

    Attributes
    ----------
    gradient : float
        Median length of the gradient between voxels; 1 for distances.
    unit_share : float
        Fraction of the voxels where that length is from 0.9 to 1.1. For distances the others lie on edges of the field.
    steepest : float
        Largest change between neighbours, per unit of length; at most 1 for distances and their lower bounds.
    inside_share : float
        Fraction of the voxels with a negative sample.
    sign : str
        ``"negative inside"``, ``"positive inside"`` if the border of the box is negative, ``"unsigned"`` if no sample
        is negative.
    """

    gradient: float
    unit_share: float
    steepest: float
    inside_share: float
    sign: str

    @property
    def is_distance(self) -> bool:
        """Whether the measurements fit signed distances, negative inside."""
        # Samples are float32, and distances are rounded; a slope of 1 may come out a little steeper.
        return self.sign == "negative inside" and abs(self.gradient - 1) <= 0.05 and self.steepest <= 1.01


class Interop(GridBox):
    """A grid with methods that make objects of other libraries from it."""

    __slots__ = ()

    @abstractmethod
    def to_mesh(self) -> Mesh:
        """Extract the zero surface."""

    def to_pyvista(self) -> Any:
        """Convert the volume to a PyVista ``ImageData``.

        Returns
        -------
        pyvista.ImageData
            Its points are the voxel centres; the point data ``"distances"`` are the samples.

        Raises
        ------
        Error
            If PyVista is not installed.
        """
        pyvista = optional_module("pyvista", "to_pyvista", extra="pyvista")
        grid = pyvista.ImageData(dimensions=self.resolution, spacing=tuple(self.spacing), origin=tuple(self.origin))
        grid.point_data.set_array(np.array(self.distances, order="F").ravel(order="F"), NAME)
        grid.set_active_scalars(NAME, preference="point")
        return grid

    def to_xarray(self) -> Any:
        """Convert the volume to an xarray ``DataArray``.

        Returns
        -------
        xarray.DataArray
            Dimensions x, y and z with the voxel centres as coordinates; `bounds`, `inner_bounds` and the rule of the
            sign are attributes.

        Raises
        ------
        Error
            If xarray is not installed.
        """
        xarray = optional_module("xarray", "to_xarray", extra="xarray")
        attributes = {
            "long_name": "signed distance, negative inside",
            "bounds": self.bounds.tolist(),
            "inner_bounds": self.inner_bounds.tolist(),
        }
        places = dict(zip("xyz", self.coordinates, strict=True))
        return xarray.DataArray(self.distances, coords=places, dims=("x", "y", "z"), name=NAME, attrs=attributes)

    def to_open3d(self) -> Any:
        """Convert the zero surface to an Open3D triangle mesh.

        Returns
        -------
        open3d.t.geometry.TriangleMesh
            The mesh of :meth:`to_mesh`, with float32 positions, as Open3D's ray casting needs them.

        Raises
        ------
        Error
            If Open3D is not installed.
        """
        open3d = optional_module("open3d", "to_open3d")
        mesh = self.to_mesh()
        tensor = open3d.core.Tensor
        vertices = np.ascontiguousarray(mesh.vertices, np.float32)
        return open3d.t.geometry.TriangleMesh(tensor(vertices), tensor(np.ascontiguousarray(mesh.faces, np.int64)))

    def check(self) -> FieldCheck:
        """Measure the gradient and the sign of the samples, which show whether they are signed distances.

        Returns
        -------
        FieldCheck
            The measurements. Its property ``is_distance`` combines them. Samples that a band clamps are left out.

        Examples
        --------
        >>> import fieldbake as fb
        >>> volume = fb.bake(fb.sphere(1), 32)
        >>> volume.check().is_distance
        True
        >>> fb.Volume(-volume.distances, volume.bounds).check().sign
        'positive inside'
        """
        samples, spacing = self.distances, self.spacing
        nz = samples.shape[2]
        # Python notices Ctrl-C between two slabs.
        slabs = [samples[:, :, k : k + SLAB] for k in range(0, nz, SLAB)]
        cut = max(float(np.abs(slab).max()) for slab in slabs) * (1 - 1e-6)
        is_cut = sum(int((np.abs(slab) >= np.float32(cut)).sum()) for slab in slabs) > 0.01 * samples.size
        lengths, near_one = np.zeros(1 << (32 - LENGTH_SHIFT), np.int64), 0
        steepest, negative = 0.0, 0
        for k in range(0, nz, SLAB):
            slab = samples[:, :, max(k - 1, 0) : min(k + SLAB + 1, nz)].astype(np.float64)
            negative += int((samples[:, :, k : k + SLAB] < 0).sum())
            for axis, step in enumerate(spacing):
                if slab.shape[axis] > 1:
                    steepest = max(steepest, float(np.abs(np.diff(slab, axis=axis)).max()) / step)
            if min(slab.shape) >= 3:
                inner = slab[1:-1, 1:-1, 1:-1]
                sides = [
                    (slab[2:, 1:-1, 1:-1] - slab[:-2, 1:-1, 1:-1]) / (2 * spacing[0]),
                    (slab[1:-1, 2:, 1:-1] - slab[1:-1, :-2, 1:-1]) / (2 * spacing[1]),
                    (slab[1:-1, 1:-1, 2:] - slab[1:-1, 1:-1, :-2]) / (2 * spacing[2]),
                ]
                length = np.sqrt(sum(side**2 for side in sides))
                kept = np.abs(inner) < cut - 2 * float(spacing.max()) if is_cut else np.ones(inner.shape, bool)
                found = length[kept].astype(np.float32)
                near_one += int((np.abs(found - 1) <= 0.1).sum())
                lengths += np.bincount(found.view(np.uint32) >> LENGTH_SHIFT, minlength=len(lengths))
        border = np.concatenate([samples[[0, -1]].ravel(), samples[:, [0, -1]].ravel(), samples[:, :, [0, -1]].ravel()])
        sign = "positive inside" if (border < 0).mean() > 0.5 else "negative inside"
        count = int(lengths.sum())
        return FieldCheck(
            gradient=_median(lengths) if count else 0.0,
            unit_share=near_one / count if count else 0.0,
            steepest=float(steepest),
            inside_share=negative / samples.size,
            sign=sign if negative else "unsigned",
        )


def _median(lengths: NDArray[np.int64]) -> float:
    """Find the median of counted lengths: the middle of its range of float32 numbers with equal upper bits."""
    last = int(np.searchsorted(np.cumsum(lengths), (int(lengths.sum()) + 1) // 2))
    return float(np.uint32((last << LENGTH_SHIFT) + (1 << (LENGTH_SHIFT - 1))).view(np.float32))


def grid_of_xarray(array: Any) -> tuple[NDArray[Any], NDArray[np.float64], Any]:
    """Read samples (nx, ny, nz), box and inner box of a DataArray with the dimensions x, y and z in any order."""
    dims = tuple(str(name) for name in getattr(array, "dims", ()))
    if sorted(dims) != ["x", "y", "z"]:
        raise ArgumentError(f"array: must be a DataArray with the dimensions x, y and z, got {dims or type(array)}")
    ordered = array.transpose("x", "y", "z")
    lower, upper = np.empty(3), np.empty(3)
    for axis, name in enumerate("xyz"):
        if name not in ordered.coords or len(ordered[name]) < 2:
            raise ArgumentError(f"array: must have two or more coordinates along {name}")
        places = checks.as_float64(np.asarray(ordered[name]))
        steps = np.diff(places)
        step = float(steps.mean())
        if not (np.abs(steps - step) <= UNEVEN * abs(step)).all() or step == 0:
            raise ArgumentError(f"array: the coordinates along {name} must have equal steps")
        if step < 0:
            ordered = ordered.isel({name: slice(None, None, -1)})
        lower[axis], upper[axis] = places.min() - abs(step) / 2, places.max() + abs(step) / 2
    return np.asarray(ordered), np.stack([lower, upper]), ordered.attrs.get("inner_bounds")
