"""Quadric surfaces in trim spheres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError, ShapeError
from ..base.viewable import Viewable
from ..volumes.shader import quadric_text

#: RGBA texels of a record: four for the matrix, one for the trim sphere, one for reflectance and opacity.
RECORD_TEXELS = 6

#: The default reflectance, light grey.
GREY = (0.8, 0.8, 0.8)


class Quadric(Viewable):
    """The points ``x = (p, 1)`` with ``x.T @ A @ x == 0`` that lie in a trim sphere. Immutable.

    A quadric is a sheet without an inside, and both of its sides are visible. The class methods make the common kinds
    around a centre with z as the axis; :meth:`transformed` moves them anywhere.

    Parameters
    ----------
    matrix : (4, 4)
        The matrix A, of any scale. Only its symmetric part defines the surface, and only that part is kept.
    center : (3,), default origin
        Centre of the trim sphere, world units.
    radius : float, default 1
        Radius of the trim sphere, world units. The surface outside the sphere is cut away.
    reflectance : (3,), default light grey
        Colour, linear RGB.
    opacity : float, default 1
        Fraction of the light that is blocked, 0 to 1. The transmitted fractions of several quadrics multiply. Opacity
        affects shadows only; the camera shows the nearest sheet at any opacity.

    Notes
    -----
    Values are kept in float64. Two quadrics are equal if their float32 records of :func:`pack_quadrics` are equal, so
    ``unpack_quadrics(pack_quadrics(quadrics)) == quadrics``.

    Raises
    ------
    ShapeError
        For a matrix that is zero or not finite, a radius that is not positive, or another value out of range.

    Examples
    --------
    >>> saddle = Quadric(np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]]), radius=2)
    >>> ball = Quadric.sphere((0, 0, 3), radius=0.5, reflectance=(1, 0.5, 0.2))
    >>> saddle.bounds.tolist(), ball.radius
    ([[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]], 0.5)
    """

    __slots__ = ("_center", "_matrix", "_opacity", "_radius", "_reflectance")

    _matrix: NDArray[np.float64]
    _center: NDArray[np.float64]
    _radius: float
    _reflectance: NDArray[np.float64]
    _opacity: float

    def __init__(
        self,
        matrix: ArrayLike,
        center: ArrayLike = (0.0, 0.0, 0.0),
        radius: float = 1.0,
        reflectance: ArrayLike = GREY,
        opacity: float = 1.0,
    ) -> None:
        form = checks.matrix("matrix", matrix, (4, 4), ShapeError)
        if not np.abs(form).max() <= checks.FAR:
            raise ShapeError(f"matrix: entries must be at most {checks.FAR:g}, got {form.tolist()}")
        form = (form + form.T) / 2
        if not form.any():
            raise ShapeError(f"matrix: must not be zero in its symmetric part, got {np.asarray(matrix).tolist()}")
        color = checks.vector("reflectance", reflectance, 3, ShapeError)
        if color.min() < 0 or color.max() > checks.FAR:
            raise ShapeError(f"reflectance: must be from 0 to {checks.FAR:g}, got {color.tolist()}")
        share = _number("opacity", opacity, least=0)
        if share > 1:
            raise ShapeError(f"opacity: must be from 0 to 1, got {share:g}")
        self._matrix = checks.frozen(form)
        self._center = checks.frozen(_place("center", center))
        self._radius = _number("radius", radius, above=0)
        self._reflectance = checks.frozen(color)
        self._opacity = share

    # --- kinds

    @classmethod
    def sphere(cls, center: ArrayLike = (0.0, 0.0, 0.0), radius: float = 1.0, **surface: Any) -> Quadric:
        """Make a sphere.

        Parameters
        ----------
        center : (3,), default origin
            Centre, world units.
        radius : float, default 1
            Radius, world units.
        **surface
            ``reflectance`` and ``opacity``, as for every kind.
        """
        return cls.ellipsoid(center, (_number("radius", radius, above=0),) * 3, **surface)

    @classmethod
    def ellipsoid(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radii: ArrayLike = (1.0, 1.0, 1.0), **surface: Any
    ) -> Quadric:
        """Make an ellipsoid, ``(x/a)^2 + (y/b)^2 + (z/c)^2 = 1``.

        Parameters
        ----------
        center : (3,), default origin
            Centre, world units.
        radii : (3,), default (1, 1, 1)
            Half axes a, b and c, world units.
        """
        a, b, c = _lengths("radii", radii, 3)
        r = max(a, b, c)
        return cls._make(center, [(r / a) ** 2, (r / b) ** 2, (r / c) ** 2, -r * r], r, surface)

    @classmethod
    def cylinder(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radius: float = 1.0, height: float = 2.0, **surface: Any
    ) -> Quadric:
        """Make an open cylinder along z.

        Parameters
        ----------
        center : (3,), default origin
            Centre, world units.
        radius : float, default 1
            Radius, world units.
        height : float, default 2
            Distance between the rims, world units. The trim sphere passes through both rims.
        """
        r, half = _number("radius", radius, above=0), _number("height", height, above=0) / 2
        return cls._make(center, [1, 1, 0, -r * r], np.hypot(r, half), surface)

    @classmethod
    def cone(
        cls,
        center: ArrayLike = (0.0, 0.0, 0.0),
        radius: float = 1.0,
        height: float = 1.0,
        *,
        sheets: int = 1,
        **surface: Any,
    ) -> Quadric:
        """Make an open cone along z that widens upwards.

        Parameters
        ----------
        center : (3,), default origin
            Tip, world units.
        radius : float, default 1
            Radius of the rim, world units.
        height : float, default 1
            Height of the rim above the tip, world units.
        sheets : 1 or 2, default 1
            2 adds the mirror image below the tip. The trim sphere of one sheet passes through the tip and the rim; the
            trim sphere of two sheets is centred at the tip.
        """
        r, h = _number("radius", radius, above=0), _number("height", height, above=0)
        trim = (0.0, np.hypot(r, h)) if _sheets(sheets) == 2 else ((r * r + h * h) / (2 * h),) * 2
        return cls._make(center, [1, 1, -((r / h) ** 2), 0], trim[1], surface, trim_z=trim[0])

    @classmethod
    def paraboloid(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radius: float = 1.0, height: float = 1.0, **surface: Any
    ) -> Quadric:
        """Make a bowl, ``x^2 + y^2 = radius^2 z / height``.

        Parameters
        ----------
        center : (3,), default origin
            Lowest point, world units.
        radius : float, default 1
            Radius of the rim, world units.
        height : float, default 1
            Height of the rim above the lowest point, world units.
        """
        r, h = _number("radius", radius, above=0), _number("height", height, above=0)
        # The smallest sphere that passes through the rim and contains the lowest point.
        z = min(h, (r * r + h * h) / (2 * h))
        return cls._make(center, [1, 1, 0, 0], np.hypot(r, h - z), surface, trim_z=z, linear_z=-r * r / h)

    @classmethod
    def hyperboloid(
        cls,
        center: ArrayLike = (0.0, 0.0, 0.0),
        radii: ArrayLike = (1.0, 1.0, 1.0),
        height: float = 4.0,
        *,
        sheets: int = 1,
        **surface: Any,
    ) -> Quadric:
        """Make a hyperboloid: ``(x/a)^2 + (y/b)^2 - (z/c)^2`` is 1 for one sheet and -1 for two.

        Parameters
        ----------
        center : (3,), default origin
            Centre, world units.
        radii : (3,), default (1, 1, 1)
            a, b and c, world units. One sheet has a waist with the half axes a and b at z = 0; two sheets have their
            tips at z = -c and z = c.
        height : float, default 4
            Distance from the lowest to the highest point, world units; more than 2 c for two sheets. If a and b differ,
            the wider axis reaches that height.
        sheets : 1 or 2, default 1
            Number of sheets.
        """
        a, b, c = _lengths("radii", radii, 3)
        half = _number("height", height, above=0) / 2
        sign = 1 if _sheets(sheets) == 1 else -1
        if sign < 0 and half <= c:
            raise ShapeError(f"height: must be above {2 * c:g} for two sheets, got {2 * half:g}")
        rim = max(a, b) * np.sqrt((half / c) ** 2 + sign)
        diagonal = [(c / a) ** 2, (c / b) ** 2, -1, -sign * c * c]
        return cls._make(center, diagonal, np.hypot(rim, half), surface)

    @classmethod
    def hyperbolic_paraboloid(
        cls,
        center: ArrayLike = (0.0, 0.0, 0.0),
        radii: ArrayLike = (1.0, 1.0),
        radius: float = 1.0,
        **surface: Any,
    ) -> Quadric:
        """Make a saddle, ``z = (x/a)^2 - (y/b)^2``.

        Parameters
        ----------
        center : (3,), default origin
            Centre of the saddle and of the trim sphere, world units.
        radii : (2,), default (1, 1)
            a and b.
        radius : float, default 1
            Radius of the trim sphere, world units.
        """
        a, b = _lengths("radii", radii, 2)
        return cls._make(center, [a**-2, -(b**-2), 0, 0], _number("radius", radius, above=0), surface, linear_z=-1)

    @classmethod
    def plane_pair(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), separation: float = 1.0, radius: float = 1.0, **surface: Any
    ) -> Quadric:
        """Make two parallel discs perpendicular to z.

        Parameters
        ----------
        center : (3,), default origin
            Point midway between the discs, world units.
        separation : float, default 1
            Distance between the discs, world units.
        radius : float, default 1
            Radius of the discs, world units. The trim sphere passes through both rims.
        """
        half = _number("separation", separation, above=0) / 2
        r = _number("radius", radius, above=0)
        return cls._make(center, [0, 0, 1, -half * half], np.hypot(r, half), surface)

    @classmethod
    def _make(
        cls,
        center: ArrayLike,
        diagonal: Sequence[float],
        radius: float,
        surface: dict[str, Any],
        *,
        trim_z: float = 0.0,
        linear_z: float = 0.0,
    ) -> Quadric:
        """Make the form ``diag(diagonal)`` plus ``linear_z * z`` about `center`; the trim sphere is `trim_z` above."""
        unknown = set(surface) - {"reflectance", "opacity"}
        if unknown:
            raise TypeError(f"unknown argument '{min(unknown)}'; a surface has reflectance and opacity")
        place = _place("center", center)
        form = np.diag(np.asarray(diagonal, np.float64))
        form[2, 3] = form[3, 2] = linear_z / 2
        back = np.eye(4)
        back[:3, 3] = -place
        return cls(back.T @ form @ back, place + np.array([0, 0, trim_z]), float(radius), **surface)

    # --- properties

    @property
    def matrix(self) -> NDArray[np.float64]:
        """A, (4, 4), symmetric, read-only."""
        return self._matrix

    @property
    def center(self) -> NDArray[np.float64]:
        """Centre of the trim sphere, (3,), world units."""
        return self._center

    @property
    def radius(self) -> float:
        """Radius of the trim sphere, world units."""
        return self._radius

    @property
    def reflectance(self) -> NDArray[np.float64]:
        """Colour, linear RGB, (3,)."""
        return self._reflectance

    @property
    def opacity(self) -> float:
        """Fraction of the light that is blocked."""
        return self._opacity

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the trim sphere, (2, 3), world units."""
        return np.stack([self._center - self._radius, self._center + self._radius])

    @staticmethod
    def shader(language: str = "wgsl") -> str:
        """Write the functions that read and intersect quadrics in a shader.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            As for :meth:`Volume.shader`.

        Returns
        -------
        str
            ``load_quadric(i)`` reads row i of the texture ``quadric_texels``, the array of :func:`pack_quadrics` as
            RGBA32F; ``intersect_quadric(quadric, origin, direction, t_min)`` is the nearest hit or -1;
            ``quadric_normal(quadric, p, direction)`` is the normal on the side of the ray. Hits are within 0.002
            radii of the surface up to 100 radii from the origin; :func:`pack_quadrics` states the limit and the remedy.

        Raises
        ------
        ArgumentError
            For another language.
        """
        return quadric_text(language)

    def transformed(self, transform: ArrayLike) -> Quadric:
        """Move, rotate, scale or shear the quadric.

        Parameters
        ----------
        transform : (4, 4)
            Affine map from the coordinates of the quadric to the world, column vectors.

        Returns
        -------
        Quadric
            A quadric with the matrix ``inv(M).T @ A @ inv(M)``. The radius of the trim sphere grows by the largest
            stretch of `transform`, so that the sphere still contains the trimmed surface. Under uneven scale it may
            show more of the surface than before.

        Raises
        ------
        ShapeError
            If `transform` is not affine or has no inverse.

        Examples
        --------
        >>> tube = Quadric.cylinder(radius=0.5, height=4).transformed([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0],
        ...                                                            [0, 0, 0, 1]])
        >>> tube.matrix.diagonal().tolist()
        [0.0, 1.0, 1.0, -0.25]
        """
        world = checks.affine("transform", transform, ShapeError)
        local = np.linalg.inv(world)
        stretch = float(np.linalg.norm(world[:3, :3], ord=2))
        center = world[:3, :3] @ self._center + world[:3, 3]
        form = local.T @ self._matrix @ local
        # The scale of the matrix is arbitrary. Keeping it near 1 avoids overflow after many transforms.
        if not 1e-30 < np.abs(form).max() < 1e30:
            form /= np.abs(form).max()
        return Quadric(form, center, self._radius * stretch, self._reflectance, self._opacity)

    def _row(self) -> NDArray[np.float64]:
        """Convert the quadric to a row of the core, (24,)."""
        tail = (*self._center, self._radius, *self._reflectance, self._opacity)
        return np.concatenate([self._matrix.ravel(), tail])

    def _packed(self) -> NDArray[np.float32]:
        """Convert the quadric to its record in :func:`pack_quadrics`, (24,)."""
        # Adding zero turns -0.0 into 0.0.
        record: NDArray[np.float32] = self._row().astype(np.float32) + np.float32(0)
        return record

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Quadric) and bool(np.array_equal(self._packed(), other._packed()))

    def __hash__(self) -> int:
        return hash(self._packed().tobytes())

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name):
            raise AttributeError(f"a Quadric cannot be changed ({name}); make a new one")
        super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        values = np.array(self._matrix), np.array(self._center), self._radius, np.array(self._reflectance)
        return Quadric, (*values, self._opacity)

    def __repr__(self) -> str:
        x, y, z = self._center
        return f"Quadric(center=({x:.4g}, {y:.4g}, {z:.4g}), radius={self._radius:.4g}, opacity={self._opacity:.4g})"


def check_quadrics(quadrics: Any) -> Sequence[Quadric]:
    """Check a quadric or a sequence of them; the result is a sequence."""
    if isinstance(quadrics, Quadric):
        return [quadrics]
    if isinstance(quadrics, (str, bytes)) or not isinstance(quadrics, Sequence):
        raise ShapeError(f"quadrics: must be a list of Quadric, got {checks.describe(quadrics)}")
    for number, quadric in enumerate(quadrics):
        if not isinstance(quadric, Quadric):
            raise ShapeError(f"quadrics[{number}]: must be a Quadric, got {checks.describe(quadric)}")
    return quadrics


def is_quadrics(geometry: Any) -> bool:
    """Whether the value is a quadric or a non-empty sequence of quadrics."""
    return isinstance(geometry, Quadric) or (
        isinstance(geometry, Sequence) and len(geometry) > 0 and all(isinstance(item, Quadric) for item in geometry)
    )


def rows_of(quadrics: Sequence[Quadric]) -> NDArray[np.float64]:
    """Convert quadrics to rows of the core, (n, 24) float64."""
    return np.array([quadric._row() for quadric in quadrics], np.float64).reshape(-1, 4 * RECORD_TEXELS)


def bounds_of(quadrics: Sequence[Quadric]) -> NDArray[np.float64]:
    """Box around all trim spheres, (2, 3), world units."""
    centers = np.array([quadric.center for quadric in quadrics])
    radii = np.array([quadric.radius for quadric in quadrics])[:, None]
    return np.stack([(centers - radii).min(axis=0), (centers + radii).max(axis=0)])


def _number(name: str, value: object, *, above: float | None = None, least: float | None = None) -> float:
    try:
        return checks.number(name, value, above=above, least=least)
    except ArgumentError as error:
        raise ShapeError(str(error)) from None


def _place(name: str, value: ArrayLike) -> NDArray[np.float64]:
    place = checks.vector(name, value, 3, ShapeError)
    if not np.abs(place).max() <= checks.FAR:
        raise ShapeError(f"{name}: must be at most {checks.FAR:g} from 0, got {place.tolist()}")
    return place


def _lengths(name: str, value: ArrayLike, count: int) -> list[float]:
    lengths = checks.vector(name, value, count, ShapeError)
    if not lengths.min() > 0:
        raise ShapeError(f"{name}: must be above 0, got {lengths.tolist()}")
    result: list[float] = lengths.tolist()
    return result


def _sheets(value: object) -> int:
    return checks.integer("sheets", value, least=1, most=2, error=ShapeError)
