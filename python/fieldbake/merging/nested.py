"""Merged fields nested around a point, each level twice as fine as the next."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.grid import Grid
from ..base.loadable import Loadable
from ..base.progress import Progress, part_of, progress_callback
from ..base.report import bytes_text
from ..base.viewable import Pictured
from ..files import container, registry
from ..files.formats import head
from ..volumes.convertible import Convertible
from ..volumes.shaded import Shaded
from ..volumes.shader import ShaderBuffers, nested_buffers, nested_text
from ..volumes.volume import Volume, plain_field
from .merged import MergedField

#: Largest number of levels. A voxel of the outermost level is then 2048 times as long as a voxel of the finest.
MAX_LEVELS = 12

#: Fewest voxels of a level along each side, so that the finer level fits inside with a border of one voxel.
LEAST_SIDE = 8


class NestedField(Loadable, Shaded, Convertible, Pictured):
    """The field of a scene on nested grids, fine near a point and coarse far from it. Made by :func:`merge`.

    All levels have the same number of voxels, and each level is twice as large as the one inside it. A loaded field
    has the same values, but cannot be updated.

    Notes
    -----
    A point belongs to the finest level that has samples on all sides of it, and the field is trilinear there. All
    samples of a level lie on the lattice of the next finer level. The outermost samples of a level are replaced by the
    values of the level around it, so the field is continuous between levels.

    *Bound.* Let `d` be the distance to the scene. Each value is a mean, with weights that are not negative, of samples
    `s(q)` at positions `q` around the point `p`. The weighted mean of the positions is `p` itself, because the weights
    come from trilinear interpolation, applied once, or twice at the edge of a level. No sample of a merged field
    exceeds `d(q)`, and ``d(q) <= d(p) + |p - q|``. So the value exceeds `d(p)` by at most the mean of ``|p - q|``,
    which is at most the root of the mean of its square. In a cell of side `h`, at the fraction `f` of the cell, that
    mean square is ``f (1 - f) h^2 <= h^2 / 4`` along each axis. Where interpolation is applied twice, every finer
    sample lies on the coarser lattice or in the middle of its cells. The mean square is then still at most ``H^2 / 4``
    with the coarser side `H`. In total the value exceeds the distance by at most half the diagonal of a voxel: of the
    level that contains the point, or, in the outermost cells of a level, of the level around it.

    References
    ----------
    F. Losasso, H. Hoppe, Geometry clipmaps: terrain rendering using nested regular grids, SIGGRAPH 2004.

    Examples
    --------
    >>> import fieldbake as fb
    >>> gear = fb.bake(fb.models.gear(teeth=6), 24)
    >>> aside = np.eye(4)
    >>> aside[0, 3] = 30
    >>> field = fb.merge([gear, (gear, aside)], 64, levels=4, center=(0, 0, 0))
    >>> round(field.levels[-1].spacing[0] / field.spacing[0])
    8
    >>> bool(field.sample([(15, 0, 0)])[0] <= 14.1)
    True
    """

    __slots__ = ("_joined", "_levels", "_merged")

    _levels: tuple[Volume, ...]
    #: The fields of the levels that `merge` made; none of a loaded field.
    _merged: tuple[MergedField, ...]
    _joined: tuple[Volume, ...] | None

    def __init__(self, levels: Sequence[Volume | MergedField]) -> None:
        volumes = tuple(plain_field(level) for level in levels)
        check_levels(volumes)
        object.__setattr__(self, "_levels", volumes)
        object.__setattr__(self, "_merged", tuple(level for level in levels if isinstance(level, MergedField)))
        object.__setattr__(self, "_joined", None)

    @property
    def levels(self) -> tuple[Volume, ...]:
        """The merged field of each level, finest first, with its outermost samples as merged."""
        return self._levels

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the outermost level, (2, 3), world units."""
        return self._levels[-1].bounds

    @property
    def inner_bounds(self) -> NDArray[np.float64]:
        """Box around the surfaces of the scene, (2, 3), world units."""
        return self._levels[-1].inner_bounds

    @property
    def center(self) -> NDArray[np.float64]:
        """Centre of the finest level, (3,), world units."""
        return np.asarray(self._levels[0].bounds.mean(axis=0))

    @property
    def resolution(self) -> tuple[int, int, int]:
        """Number of voxels of each level along x, y and z."""
        return self._levels[0].resolution

    @property
    def spacing(self) -> NDArray[np.float64]:
        """Size of a voxel of the finest level, (3,), world units."""
        return self._levels[0].spacing

    @property
    def nbytes(self) -> int:
        """Memory of the samples of all levels, bytes."""
        return sum(level.nbytes for level in self._levels)

    def sample(self, points: ArrayLike) -> NDArray[np.float32]:
        """Evaluate the field at points.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape.

        Returns
        -------
        (n,) float32
            World units. Outside the outermost box, as for :meth:`Volume.sample`.

        Raises
        ------
        ArgumentError
            For a wrong shape or a point that is not finite.
        """
        flat, shape = checks.points(points)
        values = np.empty(len(flat), np.float32)
        for level, held in self._holding(flat):
            values[held] = level.sample(flat[held])
        return values.reshape(shape)

    def gradient(self, points: ArrayLike) -> NDArray[np.float32]:
        """Evaluate the gradient of the field at points; it is discontinuous between cells.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape.

        Returns
        -------
        (n, 3) float32
            Distance per world unit.

        Raises
        ------
        ArgumentError
            For a wrong shape or a point that is not finite.
        """
        flat, shape = checks.points(points)
        values = np.empty((len(flat), 3), np.float32)
        for level, held in self._holding(flat):
            values[held] = level.gradient(flat[held])
        return values.reshape(*shape, 3)

    def update(
        self, changed: Sequence[Any], *, scene: Any = None, device: str = "auto", progress: Progress = None
    ) -> NestedField:
        """Update the field after instances have moved; each level evaluates only the affected samples.

        Parameters
        ----------
        changed, scene, device, progress
            As for :meth:`MergedField.update`.

        Returns
        -------
        NestedField
            A field bit for bit equal to a new merge of all instances on these grids.

        Raises
        ------
        SceneError
            As for :meth:`MergedField.update`, and for a loaded field.
        """
        merged = self._merged
        if len(merged) < len(self._levels):
            raise SceneError("changed: a loaded field has no instances to update; merge the scene again")
        levels = []
        with progress_callback(progress, "merge") as callback:
            for number, level in enumerate(merged):
                part = part_of(callback, number, len(merged))
                levels.append(level.update(changed, scene=scene, device=device, progress=part))
        return NestedField(levels)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file. An existing file is replaced only after the new file is complete.

        Parameters
        ----------
        path : str or path
            ``.npz``; read it with :func:`fieldbake.load`.

        Raises
        ------
        FormatError
            For another ending.
        OSError
            If the file cannot be written.
        """
        arrays: dict[str, NDArray[Any]] = {f"level_{i}": level.distances for i, level in enumerate(self._levels)}
        arrays["boxes"] = np.stack([level.bounds for level in self._levels])
        facts = {**self._levels[-1]._facts(), "levels": len(self._levels)}
        registry.check_ending(checks.path(path), "nested")
        container.write(path, {**head("nested"), **facts}, arrays)

    def to_volume(self, level: int = -1) -> Volume:
        """Return one level as a volume.

        Parameters
        ----------
        level : int, default -1
            Index of the level; 0 is the finest, -1 the outermost, which covers the whole scene.

        Returns
        -------
        Volume
            The merged field of the level, whose outermost samples are as merged.

        Raises
        ------
        ArgumentError
            If there is no such level.
        """
        count = len(self._levels)
        index = checks.integer("level", level, least=-count, most=count - 1)
        found = self._levels[index]
        return Volume._wrap(found.distances, found.bounds, found.inner_bounds, found.report)

    def _shader_text(self, language: object) -> str:
        return nested_text(self._joined_levels(), language)

    def _shader_textures(self) -> ShaderBuffers:
        return nested_buffers(self._joined_levels())

    def _joined_levels(self) -> tuple[Volume, ...]:
        """The levels, with their outermost samples taken from the level around them."""
        if self._joined is None:
            joined = [self._levels[-1]]
            for level in self._levels[-2::-1]:
                joined.append(_join(level, joined[-1]))
            object.__setattr__(self, "_joined", tuple(joined[::-1]))
        assert self._joined is not None
        return self._joined

    def _holding(self, points: NDArray[np.float64]) -> list[tuple[Volume, NDArray[np.bool_]]]:
        """List each level with the mask of the points that belong to it."""
        found = []
        remaining = np.ones(len(points), np.bool_)
        for level in self._joined_levels()[:-1]:
            half = level.spacing / 2
            held = remaining & ((points >= level.bounds[0] + half) & (points <= level.bounds[1] - half)).all(axis=1)
            remaining &= ~held
            found.append((level, held))
        return [*found, (self._joined_levels()[-1], remaining)]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a NestedField cannot be changed ({name}); make a new one")

    def __reduce__(self) -> tuple[Any, ...]:
        return NestedField, (self._levels,)

    def __repr__(self) -> str:
        shape = " x ".join(str(side) for side in self.resolution)
        voxels = f"{self.spacing.max():.4g} to {self._levels[-1].spacing.max():.4g}"
        return f"NestedField({len(self._levels)} levels of {shape} voxels of {voxels} units, {bytes_text(self.nbytes)})"


def nested_grids(outer: Grid, levels: int, center: NDArray[np.float64]) -> list[Grid]:
    """Make grids of equal shape, finest first, each half as wide as the next and as close to `center` as possible.

    Every sample of a level lies on the lattice of the next finer level. A finer level leaves a border of at least one
    voxel of the level around it.
    """
    if min(outer.shape) < LEAST_SIDE:
        raise ArgumentError(f"resolution: levels need {LEAST_SIDE} voxels or more along each side, got {outer.shape}")
    grids = [outer]
    shape = np.array(outer.shape)
    for _ in range(levels - 1):
        parent = grids[-1]
        step = np.asarray(parent.spacing)
        first_of_parent = np.array(parent.lower) + step / 2
        # The outermost samples of the finer grid are n - 1 steps of half the length apart.
        exact = (center - (shape - 1) * step / 4 - first_of_parent) / step
        start = np.clip(np.rint(exact), 1, shape - 2 - (shape // 2))
        lower = first_of_parent + start * step - step / 4
        upper = lower + shape * step / 2
        grids.append(Grid(checks.triple(lower), checks.triple(upper), parent.shape))
    return grids[::-1]


def check_levels(levels: Sequence[Volume]) -> None:
    """Check that volumes nest like the grids of :func:`nested_grids`, finest first."""
    if not 1 <= len(levels) <= MAX_LEVELS:
        raise ArgumentError(f"levels: must be 1 to {MAX_LEVELS}, got {len(levels)}")
    for number, (fine, coarse) in enumerate(pairwise(levels)):
        step = coarse.spacing
        start = (fine.bounds[0] + fine.spacing / 2 - coarse.bounds[0] - step / 2) / step
        end = start + (np.array(fine.resolution) - 1) / 2
        fits = (start > 0.5).all() and (end < np.array(coarse.resolution) - 1.5).all()
        # The tolerances allow for rounding of coordinates, far below a voxel.
        aligned = np.allclose(start, np.rint(start), atol=1e-3) and np.allclose(2 * fine.spacing, step, rtol=1e-6)
        if not (fits and aligned and fine.resolution == coarse.resolution):
            raise ArgumentError(f"levels[{number}]: must lie in the next level, on its lattice and twice as fine")


def _join(level: Volume, around: Volume) -> Volume:
    """Replace the outermost samples of a level by the values of the level around it."""
    distances = np.array(level.distances, order="F")
    edge = np.ones(level.resolution, np.bool_)
    edge[1:-1, 1:-1, 1:-1] = False
    points = level.origin + np.argwhere(edge) * level.spacing
    distances[edge] = around.sample(points)
    return Volume._wrap(distances, level.bounds, level.inner_bounds, level.report)
