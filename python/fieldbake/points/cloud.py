"""`PointCloud`: points with normals and areas, as scanners and reconstructions give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, MeshError
from ..base.progress import Progress, progress_callback
from ..base.report import Rows, count_text, seconds_text

Array = NDArray[np.float64]
Normals = Literal["given", "viewpoints", "winding", "tree", "none"]

#: Smallest box of a cloud that is not a single position, world units; float32 distances need it.
LEAST_EXTENT = 1e-30
#: Number of points whose normals are compared with the winding number.
AGREEMENT_SAMPLES = 10_000
#: Distance of the places in front of a point and behind it where the winding numbers are compared, spacings.
AGREEMENT_REACH = 1.5
#: Largest error of these winding numbers. They differ by about 0.8, and a smaller error needs more of the points.
AGREEMENT_ERROR = 0.05
#: Least share of agreeing normals without a warning.
LEAST_AGREEMENT = 0.95


@dataclass(frozen=True)
class PointReport(Rows):
    """Properties of a cloud of points. `print` shows all of them as text.

    Attributes
    ----------
    points, duplicates : int
        Number of points, and of those that repeat an earlier position.
    spacing, spacing_95 : float
        Median and 95th percentile of the distance between neighbouring points, the square root of an area.
    normals : str
        Origin of the normals: ``"given"``, ``"viewpoints"``, ``"winding"``, ``"tree"`` or ``"none"``.
    inside_out : bool
        Whether the normals point to the inside of the enclosed volume, as in a scan of a room from inside. Its air is
        the inside then.
    area : float
        Sum of the areas, square world units.
    outliers : int
        Number of points so far from all others that their areas were capped.
    low_opacity : int
        Number of splats that were dropped for their opacity.
    round_splats : int
        Number of splats without a smallest axis. Their lines come from their neighbours.
    seconds : mapping of str to float
        Duration of each stage, seconds.

    Examples
    --------
    >>> import fieldbake as fb
    >>> samples = fb.sample_surface(fb.models.gear(), 2_000)
    >>> cloud = fb.PointCloud(samples.points, samples.normals)
    >>> cloud.report.normals, cloud.report.agreement > 0.95
    ('given', True)
    """

    points: int = 0
    duplicates: int = 0
    spacing: float = 0.0
    spacing_95: float = 0.0
    normals: Normals = "none"
    inside_out: bool = False
    area: float = 0.0
    outliers: int = 0
    low_opacity: int = 0
    round_splats: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    _cloud: PointCloud | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", MappingProxyType(dict(self.seconds)))

    @cached_property
    def agreement(self) -> float:
        """Share of up to 10,000 points whose normal agrees with the descent of the winding number; nan without normals.

        The winding number of all other points is compared 1.5 spacings behind each point and in front of it.
        """
        cloud = self._cloud
        if cloud is None or not cloud.has_sides:
            return float("nan")
        rows = np.arange(len(cloud))
        if len(rows) > AGREEMENT_SAMPLES:
            rows = np.random.default_rng(0).choice(len(cloud), AGREEMENT_SAMPLES, replace=False)
        points, normals, areas = cloud.points[rows], cloud._normals_of(rows), cloud.areas[rows]
        reach = AGREEMENT_REACH * np.sqrt(np.maximum(areas, 1e-3 * self.spacing**2))
        step = normals * reach[:, None]
        behind, front = (
            cloud._core.winding_number(np.ascontiguousarray(place), error=AGREEMENT_ERROR)
            for place in (points - step, points + step)
        )
        # The point itself adds a / (4 pi reach^2) behind, and subtracts as much in front.
        own = areas / (2 * np.pi * reach**2)
        return float((behind - front - own > 0).mean())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons why a side may be wrong."""
        found = []
        if self.outliers:
            found.append(
                f"{count_text(self.outliers, 'point')} of the cloud lie far from all others; their areas were capped"
            )
        if self.agreement < LEAST_AGREEMENT:
            found.append(
                f"{1 - self.agreement:.1%} of the normals contradict the other points; give viewpoints to "
                "PointCloud.oriented, or repair the normals"
            )
        return tuple(found)

    def rows(self) -> list[tuple[str, str]]:
        """List the label and the text of each line of the report."""
        points = count_text(self.points, "point")
        parts = [(self.duplicates, "duplicate"), (self.outliers, "outlier"), (self.low_opacity, "transparent splat")]
        parts.append((self.round_splats, "round splat"))
        points += "".join(f", {count_text(count, name)}" for count, name in parts if count)
        rows = [("cloud", points), ("spacing", f"{self.spacing:.4g}, 95 % below {self.spacing_95:.4g}")]
        normals: str = self.normals
        if self.agreement == self.agreement:
            normals += f", {self.agreement:.1%} agree with the winding number"
        if self.inside_out:
            normals += ", to the inside of the enclosed volume"
        rows += [("normals", normals), ("area", f"{self.area:.6g}")]
        rows.append(("time", ", ".join(f"{stage} {seconds_text(seconds)}" for stage, seconds in self.seconds.items())))
        rows.extend(("warning", warning) for warning in self.warnings)
        return rows


class PointCloud:
    """Points with normals and areas: each is a flat disk of the surface.

    Clouds are accepted by `closest_point`, `winding_number`, `contains`, `signed_distance`, `query`, `bake`,
    `bake_sparse` and `solid`.

    Parameters
    ----------
    points : (n, 3) real
        Positions, world units.
    normals : (n, 3) real, optional
        Outward normals of any length but zero. They are normalised and never turned.
    areas : (n,) real, number or None
        Area of each point, square world units. None estimates them from the eight nearest neighbours. With 0 the disks
        are points.

    Raises
    ------
    MeshError
        If there are no points, or fewer than nine distinct ones and no areas.
    ArgumentError
        For a wrong shape, a number that is not finite, a zero normal, or a negative area. The message has the row.

    Notes
    -----
    The distance is that to the union of the disks. The inside follows from the sum of all dipoles,
    ``sum a n.(p - q) / (4 pi |p - q|^3)``: a point is inside if the sum exceeds 1/2. Positions stay float64, so
    geo-referenced coordinates lose nothing.

    References
    ----------
    Barill, Dickson, Schmidt, Levin, Jacobson, *Fast winding numbers for soups and clouds*, 2018.

    Examples
    --------
    >>> import fieldbake as fb
    >>> samples = fb.sample_surface(fb.sphere().to_mesh(48), 3_000)
    >>> cloud = fb.PointCloud(samples.points, samples.normals)
    >>> fb.contains(cloud, [(0, 0, 0), (0, 0, 1.5)]).tolist()
    [True, False]
    """

    def __init__(
        self, points: ArrayLike, normals: ArrayLike | None = None, areas: ArrayLike | float | None = None
    ) -> None:
        positions, shape = checks.points(points)
        if len(shape) != 1:
            raise ArgumentError(f"points: must have shape (n, 3), got {checks.describe(np.asarray(points))}")
        count = len(positions)
        if count == 0:
            raise MeshError("points: the cloud is empty; a surface needs at least one point")
        extent = float(np.ptp(positions, axis=0).max())
        if 0 < extent < LEAST_EXTENT:
            raise MeshError(f"points: span {extent:g}, less than {LEAST_EXTENT:g}; scale them")
        units = None if normals is None else _unit("normals", normals, count)
        given = None if areas is None else _checked_areas(areas, count)
        self._set(np.array(positions), units, given, "none" if units is None else "given")

    def _set(
        self,
        points: Array,
        normals: Array | None,
        areas: Array | None,
        origin: Normals,
        lines: Array | None = None,
        **facts: Any,
    ) -> None:
        start = perf_counter()
        self._core = _core.PointCloud(points, normals, areas)
        duplicates, outliers, spacing, spacing_95, inside_out = self._core.facts()
        self._points, self._normals = checks.frozen(points), normals if normals is None else checks.frozen(normals)
        self._areas = checks.frozen(self._core.areas)
        #: Unit axes of splats, whose sides are not known, (n, 3).
        self._lines = lines
        measured = {
            "points": len(points),
            "duplicates": duplicates,
            "spacing": spacing,
            "spacing_95": spacing_95,
            "normals": origin,
            "inside_out": inside_out,
            "area": float(self._areas.sum()),
            "outliers": outliers,
            "seconds": {"cloud": perf_counter() - start},
        }
        self._report = PointReport(**{**measured, **facts}, _cloud=self)

    @classmethod
    def _wrap(cls, *arguments: Any, **facts: Any) -> PointCloud:
        """Make a cloud of the checked arrays that `_set` takes."""
        cloud = cls.__new__(cls)
        cloud._set(*arguments, **facts)
        return cloud

    @property
    def points(self) -> Array:
        """Positions, (n, 3) float64, read-only."""
        return self._points

    @property
    def normals(self) -> Array | None:
        """Unit normals, (n, 3) float64, read-only; None without them."""
        return self._normals

    @property
    def areas(self) -> Array:
        """Areas, (n,) float64, square world units, read-only."""
        return self._areas

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the box of the points, (2, 3)."""
        return checks.frozen(np.array([self._points.min(axis=0), self._points.max(axis=0)]))

    @property
    def spacing(self) -> float:
        """Median distance between neighbouring points, world units."""
        return self._report.spacing

    @property
    def report(self) -> PointReport:
        """Properties of the points, their normals and areas."""
        return self._report

    @property
    def has_sides(self) -> bool:
        """Whether the points have normals and areas, so that an inside is defined."""
        return self._normals is not None and bool(self._areas.any())

    def oriented(
        self, *, viewpoints: ArrayLike | None = None, neighbours: int = 12, progress: Progress = None
    ) -> PointCloud:
        """Find the normals of the points, or the sides of the lines of splats. Normals of this cloud are not used.

        Parameters
        ----------
        viewpoints : (3,) or (n, 3) real, optional
            Position of the scanner, or of the camera that saw each point. The normal points to it. Viewpoints of
            a scan make the sides exact.
        neighbours : int, default 12
            Number of nearest neighbours that determine the line of a normal, from 4 to 64.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        PointCloud
            The same points and areas with normals. `report.normals` is ``"viewpoints"``, or ``"winding"`` or
            ``"tree"`` for the method that chose the sides.

        Raises
        ------
        ArgumentError
            If `viewpoints` has another shape or `neighbours` is out of range.
        MeshError
            If there are fewer distinct points than neighbours.

        Notes
        -----
        Without viewpoints there are three candidates: a spanning tree over the neighbours, and two runs of an iteration
        towards a consistent winding number. The one across whose points the winding number falls most nearly by 1 is
        kept. At most 50,000 points iterate; the others follow them. Some normals may stay flipped, mostly in thin parts
        and near holes: `report.agreement` shows contradictions.

        References
        ----------
        Hoppe et al., *Surface reconstruction from unorganized points*, 1992. Lin, Shi, Liu, *Fast and globally
        consistent normal orientation based on the winding number normal consistency*, 2024.

        Examples
        --------
        >>> import fieldbake as fb
        >>> samples = fb.sample_surface(fb.sphere().to_mesh(32), 500)
        >>> cloud = fb.PointCloud(samples.points).oriented()
        >>> bool((cloud.normals * samples.normals).sum(axis=1).min() > 0)
        True
        """
        count = checks.integer("neighbours", neighbours, least=4, most=64)
        origins = None
        if viewpoints is not None:
            origins, shape = checks.points(viewpoints, "viewpoints")
            if shape not in ((), (len(self),)):
                got = checks.describe(np.asarray(viewpoints))
                raise ArgumentError(f"viewpoints: must have shape (3,) or ({len(self)}, 3), got {got}")
            origins = np.ascontiguousarray(np.broadcast_to(origins, (len(self), 3)))
        start = perf_counter()
        with progress_callback(progress, "orient") as callback:
            normals, origin = _core.orient(self._points, self._lines, origins, neighbours=count, progress=callback)
        report = self._report
        seconds = {**report.seconds, "orientation": perf_counter() - start}
        facts = {name: getattr(report, name) for name in ("outliers", "low_opacity", "round_splats")}
        return PointCloud._wrap(
            np.array(self._points), normals, np.array(self._areas), origin, self._lines, seconds=seconds, **facts
        )

    def _normals_of(self, rows: NDArray[np.int64]) -> Array:
        """Normals of some rows; zeros without normals."""
        if self._normals is None:
            return np.zeros((len(rows), 3))
        found: Array = self._normals[rows]
        return found

    def __len__(self) -> int:
        return len(self._points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self._points, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        report = self._report
        return f"PointCloud({len(self):,} points, normals: {report.normals}, spacing {report.spacing:.4g})"

    def __reduce__(self) -> tuple[Any, ...]:
        report = self._report
        kept = ("outliers", "low_opacity", "round_splats", "seconds")
        facts = {name: getattr(report, name) for name in kept} | {"seconds": dict(report.seconds)}
        return _rebuilt, (self._points, self._normals, self._areas, report.normals, self._lines, facts)


def _rebuilt(
    points: Array, normals: Array | None, areas: Array, origin: Normals, lines: Array | None, facts: dict[str, Any]
) -> PointCloud:
    """Make the cloud of a pickle."""
    return PointCloud._wrap(points, normals, areas, origin, lines, **facts)


def _unit(name: str, vectors: ArrayLike, count: int) -> Array:
    """Check and normalise (n, 3) vectors."""
    array, shape = checks.points(vectors, name)
    if shape != (count,):
        raise ArgumentError(f"{name}: must have shape ({count}, 3), one row for each point, got {(*shape, 3)}")
    # The division by the largest component keeps the squares in range.
    largest = np.abs(array).max(axis=1, keepdims=True)
    zero = np.flatnonzero(largest[:, 0] == 0)
    if len(zero):
        raise ArgumentError(f"{name}[{zero[0]}]: must not be zero; leave out {name} if the points have none")
    scaled = array / largest
    units: Array = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    return units


def _checked_areas(areas: ArrayLike | float, count: int) -> Array:
    array = checks.real_array("areas", areas, f"({count},)")
    if array.shape not in ((), (count,)):
        raise ArgumentError(f"areas: must be a number or have shape ({count},), got {checks.describe(array)}")
    values = np.array(np.broadcast_to(checks.as_float64(array.reshape(-1)) if array.ndim else float(array), (count,)))
    wrong = np.flatnonzero(~((values >= 0) & (values <= checks.FAR)))
    if len(wrong):
        raise ArgumentError(f"areas[{wrong[0]}]: must be finite and not negative, got {values[wrong[0]]}")
    return values
