"""Quadric surfaces, and the texture that holds them.

O. Lawlor, Storing Raytraced Geometry in Textures, CS 481, University of Alaska Fairbanks, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, ShapeError

#: Texels of a record: the matrix, centre and radius of the trim sphere, reflectance and opacity.
RECORD_TEXELS = 6

#: Light grey, as everything that has no colour of its own.
GREY = (0.8, 0.8, 0.8)


class Quadric:
    """The points ``x = (p, 1)`` with ``x.T @ A @ x == 0`` that lie in a trim sphere. Immutable.

    A sheet without an inside: both of its sides are seen. For the common kinds see the class methods; they stand about
    the origin or a given centre with z as their axis, and :meth:`transformed` puts them anywhere.

    Parameters
    ----------
    matrix : (4, 4)
        A, of any scale. Only its symmetric part matters, and that is what is kept.
    center : (3,), default origin
        Of the trim sphere, world units.
    radius : float, default 1
        Of the trim sphere: what lies outside is cut away.
    reflectance : (3,), default light grey
        Linear RGB.
    opacity : float, default 1
        Share of the light that does not pass, 0 to 1: several quadrics multiply. It shapes shadows; the camera sees the
        nearest sheet whatever its opacity.

    Notes
    -----
    Values are kept in float64. Two quadrics are equal if their float32 records of :func:`pack_quadrics` are equal, so
    ``unpack_quadrics(pack_quadrics(quadrics)) == quadrics``.

    Raises
    ------
    ShapeError
        For a matrix that is zero or not finite, a radius that is not positive, or any value out of range.

    Examples
    --------
    >>> saddle = Quadric(np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]]), radius=2)
    >>> ball = Quadric.sphere((0, 0, 3), radius=0.5, reflectance=(1, 0.5, 0.2))
    >>> pack_quadrics([saddle, ball]).shape
    (2, 6, 4)
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
            raise ShapeError(f"matrix: must not be zero, its symmetric part is; got {np.asarray(matrix).tolist()}")
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
        """A sphere.

        Parameters
        ----------
        center : (3,), default origin
            World units.
        radius : float, default 1
            World units.
        **surface
            ``reflectance`` and ``opacity``, as for every kind.
        """
        return cls.ellipsoid(center, (_number("radius", radius, above=0),) * 3, **surface)

    @classmethod
    def ellipsoid(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radii: ArrayLike = (1.0, 1.0, 1.0), **surface: Any
    ) -> Quadric:
        """``(x/a)^2 + (y/b)^2 + (z/c)^2 = 1``.

        Parameters
        ----------
        center : (3,), default origin
            World units.
        radii : (3,), default (1, 1, 1)
            a, b and c.
        """
        a, b, c = _lengths("radii", radii, 3)
        r = max(a, b, c)
        return cls._make(center, [(r / a) ** 2, (r / b) ** 2, (r / c) ** 2, -r * r], r, surface)

    @classmethod
    def cylinder(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radius: float = 1.0, height: float = 2.0, **surface: Any
    ) -> Quadric:
        """An open cylinder along z.

        Parameters
        ----------
        center : (3,), default origin
            Its middle, world units.
        radius : float, default 1
            World units.
        height : float, default 2
            From rim to rim; the trim sphere goes through both rims.
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
        """An open cone along z, wide upwards.

        Parameters
        ----------
        center : (3,), default origin
            Its tip, world units.
        radius : float, default 1
            Of the rim.
        height : float, default 1
            Of the rim above the tip.
        sheets : 1 or 2, default 1
            2 adds its mirror image below. The trim sphere of one sheet goes through the tip and the rim; that of two is
            centred at the tip.
        """
        r, h = _number("radius", radius, above=0), _number("height", height, above=0)
        trim = (0.0, np.hypot(r, h)) if _sheets(sheets) == 2 else ((r * r + h * h) / (2 * h),) * 2
        return cls._make(center, [1, 1, -((r / h) ** 2), 0], trim[1], surface, trim_z=trim[0])

    @classmethod
    def paraboloid(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), radius: float = 1.0, height: float = 1.0, **surface: Any
    ) -> Quadric:
        """A bowl, ``x^2 + y^2 = radius^2 z / height``.

        Parameters
        ----------
        center : (3,), default origin
            Its lowest point, world units.
        radius : float, default 1
            Of the rim.
        height : float, default 1
            Of the rim above the lowest point.
        """
        r, h = _number("radius", radius, above=0), _number("height", height, above=0)
        # The smallest sphere through the rim that holds the lowest point.
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
        """``(x/a)^2 + (y/b)^2 - (z/c)^2`` is 1 (one sheet) or -1 (two).

        Parameters
        ----------
        center : (3,), default origin
            World units.
        radii : (3,), default (1, 1, 1)
            a, b and c: one sheet has its waist of radii a and b at z = 0, two have their tips at z = -c and c.
        height : float, default 4
            From the lowest to the highest point; more than 2 c with two sheets. Where a and b differ, that is where the
            wider axis ends.
        sheets : 1 or 2, default 1
            Which of the two.
        """
        a, b, c = _lengths("radii", radii, 3)
        half = _number("height", height, above=0) / 2
        sign = 1 if _sheets(sheets) == 1 else -1
        if sign < 0 and half <= c:
            raise ShapeError(f"height: two sheets begin at a height of {2 * c:g}, got {2 * half:g}")
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
        """A saddle, ``z = (x/a)^2 - (y/b)^2``.

        Parameters
        ----------
        center : (3,), default origin
            Its middle, and that of the trim sphere, world units.
        radii : (2,), default (1, 1)
            a and b.
        radius : float, default 1
            Of the trim sphere.
        """
        a, b = _lengths("radii", radii, 2)
        return cls._make(center, [a**-2, -(b**-2), 0, 0], _number("radius", radius, above=0), surface, linear_z=-1)

    @classmethod
    def plane_pair(
        cls, center: ArrayLike = (0.0, 0.0, 0.0), separation: float = 1.0, radius: float = 1.0, **surface: Any
    ) -> Quadric:
        """Two parallel discs across z.

        Parameters
        ----------
        center : (3,), default origin
            Midway between them, world units.
        separation : float, default 1
            From one to the other.
        radius : float, default 1
            Of the discs; the trim sphere goes through both rims.
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
        """Of ``diag(diagonal)`` plus ``linear_z * z``, moved to `center`; the trim sphere `trim_z` above it."""
        unknown = set(surface) - {"reflectance", "opacity"}
        if unknown:
            raise TypeError(f"unknown argument '{min(unknown)}'; a surface has reflectance and opacity")
        place = _place("center", center)
        form = np.diag(np.asarray(diagonal, np.float64))
        form[2, 3] = form[3, 2] = linear_z / 2
        back = np.eye(4)
        back[:3, 3] = -place
        return cls(back.T @ form @ back, place + np.array([0, 0, trim_z]), float(radius), **surface)

    # --- what it is

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
        """Linear RGB, (3,)."""
        return self._reflectance

    @property
    def opacity(self) -> float:
        """Share of the light that does not pass."""
        return self._opacity

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box of the trim sphere, (2, 3), world units."""
        return np.stack([self._center - self._radius, self._center + self._radius])

    def transformed(self, transform: ArrayLike) -> Quadric:
        """The quadric moved, turned, scaled or sheared.

        Parameters
        ----------
        transform : (4, 4)
            World from the quadric's own coordinates, column vectors; affine.

        Returns
        -------
        Quadric
            With matrix ``inv(M).T @ A @ inv(M)``. The trim sphere grows by the largest stretch of `transform`, so
            that it still holds the trimmed surface: under uneven scale it may show more than before.

        Raises
        ------
        ShapeError
            If `transform` is not affine or cannot be undone.

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
        # The scale of the matrix is free: near 1 it stays in range, however often it is transformed.
        if not 1e-30 < np.abs(form).max() < 1e30:
            form /= np.abs(form).max()
        return Quadric(form, center, self._radius * stretch, self._reflectance, self._opacity)

    def _row(self) -> NDArray[np.float64]:
        """As the core takes it."""
        tail = (*self._center, self._radius, *self._reflectance, self._opacity)
        return np.concatenate([self._matrix.ravel(), tail])

    def _packed(self) -> NDArray[np.float32]:
        """Its record in :func:`pack_quadrics`, (24,)."""
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


def pack_quadrics(quadrics: Sequence[Quadric]) -> NDArray[np.float32]:
    """Quadrics as rows of RGBA texels, ready for a float texture.

    Parameters
    ----------
    quadrics : sequence of Quadric
        In the order of the rows.

    Returns
    -------
    (n, 6, 4) float32
        Texels 0 to 3: the matrix, a row (or column, it is symmetric) each. Texel 4: centre and radius of the trim
        sphere. Texel 5: reflectance and opacity. 96 bytes a quadric, as in the article's struct.

    Raises
    ------
    ShapeError
        If something is no Quadric, or a matrix has nothing that float32 can hold.

    Notes
    -----
    Upload it as an RGBA32F texture of 6 x n texels and read it with integer coordinates, without a filter. A texture
    has at most 8192 or 16384 rows: for more quadrics see :func:`wrap_quadrics`.

    float32 holds the matrix of a small object far from the origin badly: its last entry is about ``|center|^2`` and is
    rounded by 6e-8 of that. The pictures of this package do not suffer: :func:`raymarch` works on the quadrics
    themselves, in the frames of their trim spheres.

    Examples
    --------
    >>> packed = pack_quadrics([Quadric.sphere(radius=2, reflectance=(1, 0, 0), opacity=0.5)])
    >>> packed[0, 4:].tolist()
    [[0.0, 0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.5]]
    """
    checked = check_quadrics(quadrics)
    packed = np.empty((len(checked), RECORD_TEXELS, 4), np.float32)
    for number, quadric in enumerate(checked):
        packed[number] = quadric._row().reshape(RECORD_TEXELS, 4)
        if not packed[number, :4].any() or packed[number, 4, 3] == 0:
            what = "matrix" if packed[number, 4, 3] else "radius"
            raise ShapeError(f"quadrics[{number}]: its {what} is too small for float32; scale it")
    return packed


def unpack_quadrics(packed: ArrayLike) -> list[Quadric]:
    """The quadrics in an array made by :func:`pack_quadrics`.

    Parameters
    ----------
    packed : (n, 6, 4)
        Rows of texels.

    Raises
    ------
    ShapeError
        For a wrong shape, or a row that is no quadric.

    Examples
    --------
    >>> unpack_quadrics(pack_quadrics([Quadric.cylinder()]))[0].matrix.diagonal().tolist()
    [1.0, 1.0, 0.0, -1.0]
    """
    array = checks.real_array("packed", packed, "(n, 6, 4)", ShapeError)
    if array.ndim != 3 or array.shape[1:] != (RECORD_TEXELS, 4):
        raise ShapeError(f"packed: must have shape (n, 6, 4), got {checks.describe(array)}")
    return [_unpack(number, texels) for number, texels in enumerate(checks.as_float64(array))]


def _unpack(number: int, texels: NDArray[np.float64]) -> Quadric:
    try:
        return Quadric(texels[:4], texels[4, :3], texels[4, 3], texels[5, :3], texels[5, 3])
    except ShapeError as error:
        raise ShapeError(f"packed[{number}]: {error}") from None


def wrap_quadrics(packed: ArrayLike, max_side: int = 8192) -> NDArray[np.float32]:
    """Lay packed quadrics out in a texture that a device can hold.

    Parameters
    ----------
    packed : (n, 6, 4)
        From :func:`pack_quadrics`.
    max_side : int, default 8192
        Texels along a side at most: WebGPU's default limit.

    Returns
    -------
    (height, width, 4) float32
        Quadric ``i`` begins in column ``6 * (i % k)`` of row ``i // k``, with ``k = width / 6``. Up to `max_side`
        quadrics `k` is 1, as in the article; beyond, it is the largest that fits. The rest of the last row is zero.

    Raises
    ------
    ShapeError
        For a wrong shape, or more quadrics than fit.
    """
    array = checks.real_array("packed", packed, "(n, 6, 4)", ShapeError)
    if array.ndim != 3 or array.shape[1:] != (RECORD_TEXELS, 4):
        raise ShapeError(f"packed: must have shape (n, 6, 4), got {checks.describe(array)}")
    side = checks.integer("max_side", max_side, least=RECORD_TEXELS, most=1 << 20, error=ShapeError)
    count = len(array)
    per_row = 1 if count <= side else side // RECORD_TEXELS
    height = max(1, -(-count // per_row))
    if height > side:
        raise ShapeError(f"packed: {count} quadrics do not fit {side} x {side} texels, {per_row * side} do")
    texture = np.zeros((height * per_row, RECORD_TEXELS, 4), np.float32)
    texture[:count] = array
    return texture.reshape(height, per_row * RECORD_TEXELS, 4)


def check_quadrics(quadrics: Any) -> Sequence[Quadric]:
    """A sequence of quadrics, or ShapeError."""
    if isinstance(quadrics, Quadric):
        return [quadrics]
    if isinstance(quadrics, (str, bytes)) or not isinstance(quadrics, Sequence):
        raise ShapeError(f"quadrics: must be a list of Quadric, got {checks.describe(quadrics)}")
    for number, quadric in enumerate(quadrics):
        if not isinstance(quadric, Quadric):
            raise ShapeError(f"quadrics[{number}]: must be a Quadric, got {checks.describe(quadric)}")
    return quadrics


def is_quadrics(thing: Any) -> bool:
    """Whether something is a quadric, or a sequence of quadrics."""
    return isinstance(thing, Quadric) or (
        isinstance(thing, Sequence) and len(thing) > 0 and all(isinstance(item, Quadric) for item in thing)
    )


def core_of(quadrics: Sequence[Quadric]) -> _core.Quadrics:
    """Made ready for rays."""
    return _core.Quadrics(rows_of(quadrics))


def rows_of(quadrics: Sequence[Quadric]) -> NDArray[np.float64]:
    """As the core takes them, (n, 24)."""
    return np.array([quadric._row() for quadric in quadrics], np.float64).reshape(-1, 4 * RECORD_TEXELS)


def bounds_of(quadrics: Sequence[Quadric]) -> NDArray[np.float64]:
    """Box around all trim spheres, (2, 3)."""
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
