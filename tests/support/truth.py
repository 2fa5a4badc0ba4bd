"""Expected results in float64, by methods that share no code with the package.

Three kinds of truth:

* brute force over all pairs of point and triangle (`closest_point`, `winding_number`): slow, short, readable;
* `Reference`, the same two questions answered by libigl's trees, for real models; `test_truth.py` compares the two;
* closed forms (`sphere`, `box`, `torus`, ...) with `facet_error`, the most that flat triangles can be off a curved
  surface.

Distances are negative inside, as in the package. trimesh has the opposite sign, which only `from_trimesh` converts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Error bound of the package: distances are right to this fraction of the box's diagonal.
EXACT = 1e-6

#: Pairs of point and triangle worked on at a time: some 20 arrays of (pairs, 3) float64 stay near 100 MB.
CHUNK_PAIRS = 200_000

#: Half an ulp of float32, relative: the error of one rounding.
FLOAT32_ROUNDING = 2.0**-24


class ClosestPoints(NamedTuple):
    """The nearest surface points, their distances and the triangles they lie on."""

    points: Array
    distances: Array
    faces: NDArray[np.int64]


# --- one triangle, one point


def dot(a: Array, b: Array) -> Array:
    """Scalar product along the last axis."""
    return np.einsum("...i,...i->...", a, b)


def closest_point_on_triangle(p: Array, a: Array, b: Array, c: Array) -> Array:
    """The nearest point of triangle abc, all arrays broadcast to (..., 3).

    The nearest of four candidates: one on each edge, and the foot on the plane where that lies inside. Deciding by
    Voronoi regions first, as in Ericson's Real-Time Collision Detection (2005), 5.1.5, costs a third and is right for
    well-shaped triangles, but its products cancel on slivers: a triangle 1e-5 wide and 0.5 long is then off by more
    than its width, even in float64.
    """
    candidates = [closest_point_on_segment(p, *edge) for edge in ((a, b), (b, c), (c, a))]
    normal = np.cross(b - a, c - a)
    squared = dot(normal, normal)
    foot = p - (dot(normal, p - a) / np.where(squared == 0, 1.0, squared))[..., None] * normal
    inside = squared > 0
    for u, v in ((a, b), (b, c), (c, a)):
        inside = inside & (dot(np.cross(v - u, p - u), normal) >= 0)

    nearest, least = candidates[0], dot(candidates[0] - p, candidates[0] - p)
    for candidate in candidates[1:]:
        squares = dot(candidate - p, candidate - p)
        nearest = np.where((squares < least)[..., None], candidate, nearest)
        least = np.minimum(least, squares)
    return np.where(inside[..., None], foot, nearest)


def closest_point_on_segment(p: Array, a: Array, b: Array) -> Array:
    """The nearest point of the segment ab; a segment without length is its point."""
    along = dot(b - a, b - a)
    t = dot(p - a, b - a) / np.where(along == 0, 1.0, along)
    return a + np.clip(t, 0.0, 1.0)[..., None] * (b - a)


def distance_to_triangle(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Distance from `p` to the triangle abc."""
    return np.linalg.norm(closest_point_on_triangle(p, a, b, c) - p, axis=-1)


# --- whole meshes


def corners(vertices: ArrayLike, faces: ArrayLike) -> Array:
    """The triangles' corners, (m, 3 corners, 3 coordinates)."""
    return np.asarray(vertices, np.float64)[np.asarray(faces, np.int64)]


def closest_point(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> ClosestPoints:
    """The nearest surface point of each of `points`, by trying every triangle."""
    a, b, c = (corners(vertices, faces)[None, :, i] for i in range(3))
    points = np.asarray(points, np.float64)
    nearest = np.empty(points.shape)
    distances = np.empty(len(points))
    winners = np.empty(len(points), np.int64)
    for rows in _chunks(len(points), a.shape[1]):
        p = points[rows, None]
        candidates = closest_point_on_triangle(p, a, b, c)
        lengths = np.linalg.norm(candidates - p, axis=-1)
        winners[rows] = lengths.argmin(axis=1)
        pick = np.arange(len(lengths)), winners[rows]
        nearest[rows], distances[rows] = candidates[pick], lengths[pick]
    return ClosestPoints(nearest, distances, winners)


def least_on_triangle(function: Callable[[Array], Array], a: Array, b: Array, c: Array) -> Array:
    """Least value of a convex function of a point on each of some triangles, (n,), by nested golden sections.

    `function` maps positions (n, 3) to values (n,). The position has an error of 1e-6 of the triangle.
    """

    def least(along: Callable[[Array], Array]) -> Array:
        low, high, section = np.zeros(len(a)), np.ones(len(a)), (np.sqrt(5) - 1) / 2
        for _ in range(30):
            left, right = high - section * (high - low), low + section * (high - low)
            is_left = along(left) < along(right)
            low, high = np.where(is_left, low, left), np.where(is_left, right, high)
        return along((low + high) / 2)

    def on_chord(u: Array) -> Array:
        return least(lambda v: function(a + u[:, None] * (b - a + v[:, None] * (c - b))))

    return least(on_chord)


def is_ball_bounded(
    vertices: ArrayLike, faces: ArrayLike, point: Array, normal: Array, radius: float, sine: float
) -> bool:
    """Whether a ball that touches a surface at `point` contains surface that bounds it.

    A point bounds the ball if it is seen from `point` at an angle above the tangent plane that has this sine or a
    larger one. Such points of a triangle exist where the least value of a convex function is not positive.
    """
    a, b, c = (corners(vertices, faces)[:, i] for i in range(3))
    center = point - radius * normal
    near = distance_to_triangle(center, a, b, c) <= radius
    # The point lies above its own face by the rounding of its position.
    apex = point - 64 * 2.0**-53 * np.abs(vertices).max() * normal

    def excess(q: Array) -> Array:
        chord = apex - q
        above = sine * np.linalg.norm(chord, axis=-1) - dot(chord, normal)
        return np.maximum(np.linalg.norm(q - center, axis=-1) - radius, above)

    return bool((least_on_triangle(excess, a[near], b[near], c[near]) <= 0).any())


def winding_number(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> Array:
    """Winding number of the surface around each point: the sum of the solid angles of the triangles over 4 pi.

    Van Oosterom and Strackee, The Solid Angle of a Plane Triangle (1983). 1 inside a closed mesh that faces
    outwards, 0 outside, anything in between near a hole (Jacobson et al. 2013).
    """
    triangles = corners(vertices, faces)
    points = np.asarray(points, np.float64)
    result = np.empty(len(points))
    for rows in _chunks(len(points), len(triangles)):
        a, b, c = (triangles[None, :, i] - points[rows, None] for i in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
        volume = dot(a, np.cross(b, c))
        denominator = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        result[rows] = 2 * np.arctan2(volume, denominator).sum(axis=1) / (4 * np.pi)
    return result


def all_intersections(
    vertices: ArrayLike, faces: ArrayLike, origins: ArrayLike, directions: ArrayLike
) -> tuple[Array, Array]:
    """Every crossing of every line with every triangle, by Cramer's rule: (rays, triangles) arrays.

    The first has the parameter of the crossing, inf without one. The second has the least of its three barycentric
    weights: values near zero are too close to an edge for this formula to decide.
    """
    a, b, c = (corners(vertices, faces)[None, :, i] for i in range(3))
    t = np.empty((len(origins), a.shape[1]))
    least = np.empty(t.shape)
    for rows in _chunks(len(origins), a.shape[1]):
        origin, direction = np.asarray(origins, np.float64)[rows, None], np.asarray(directions, np.float64)[rows, None]
        across = np.cross(direction, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / dot(b - a, across)
            u = dot(origin - a, across) * inverse
            beside = np.cross(origin - a, b - a)
            v = dot(direction, beside) * inverse
            t[rows] = dot(c - a, beside) * inverse
            least[rows] = np.minimum(np.minimum(u, v), 1 - u - v)
    t[~(least >= 0)] = np.inf
    return t, least


def signed_distance(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> Array:
    """Distance by brute force, negative where the winding number says inside."""
    distances = closest_point(vertices, faces, points).distances
    return np.where(winding_number(vertices, faces, points) > 0.5, -distances, distances)


def _chunks(points: int, triangles: int) -> list[slice]:
    size = max(1, CHUNK_PAIRS // max(1, triangles))
    return [slice(start, start + size) for start in range(0, points, size)]


class Reference:
    """Distance and winding number for models of real size: libigl's trees, exact, in float64."""

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        import igl

        self._igl = igl
        self._vertices = np.ascontiguousarray(vertices, np.float64)
        self._faces = np.ascontiguousarray(faces, np.int64)
        self._tree = igl.AABB()
        self._tree.init(self._vertices, self._faces)

    def distance(self, points: ArrayLike) -> Array:
        """Unsigned distance."""
        squared, _, _ = self._tree.squared_distance(
            self._vertices, self._faces, np.ascontiguousarray(points, np.float64)
        )
        return np.sqrt(squared)

    def winding_number(self, points: ArrayLike) -> Array:
        """The generalised winding number by exact hierarchical summation (Jacobson et al. 2013), not the fast one."""
        return self._igl.winding_number(self._vertices, self._faces, np.ascontiguousarray(points, np.float64))


def diagonal(vertices: ArrayLike, faces: ArrayLike) -> float:
    """Diagonal of the box of the vertices that faces use."""
    used = corners(vertices, faces).reshape(-1, 3)
    return float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))


def tolerance(vertices: ArrayLike, faces: ArrayLike, distances: ArrayLike = 0.0) -> Array:
    """Largest error of a distance: the package's bound, and the float32 roundings of a large distance.

    Near the mesh the bound of the package is sufficient. A point a thousand diagonals away has a distance whose last
    float32 bit is worth more; position (1), difference (1), sum of squares (3, halved by the root) and root (1) add up
    to less than five roundings.
    """
    return EXACT * diagonal(vertices, faces) + 5 * FLOAT32_ROUNDING * np.abs(np.asarray(distances, np.float64))


def volume(vertices: ArrayLike, faces: ArrayLike) -> float:
    """Signed volume of a closed mesh by the divergence theorem, positive if it faces outwards."""
    a, b, c = (corners(vertices, faces)[:, i] for i in range(3))
    return float(dot(a, np.cross(b, c)).sum() / 6)


def sign_errors(found: ArrayLike, distance: Array, inside: NDArray[np.bool_], tolerance: float) -> int:
    """How many signs are wrong, where the point is farther from the surface than `tolerance`."""
    decided = distance > tolerance
    return int(((np.asarray(found) < 0) != inside)[decided].sum())


def from_trimesh(signed: ArrayLike) -> Array:
    """Negate the signed distance of trimesh, which is positive inside."""
    return -np.asarray(signed, np.float64)


# --- closed forms


def sphere(points: ArrayLike, radius: float = 1.0, center: ArrayLike = (0, 0, 0)) -> Array:
    """Signed distance to a sphere."""
    return np.linalg.norm(np.asarray(points, np.float64) - center, axis=-1) - radius


def box(points: ArrayLike, lower: ArrayLike = (-1, -1, -1), upper: ArrayLike = (1, 1, 1)) -> Array:
    """Signed distance to an axis-aligned box."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    q = np.abs(np.asarray(points, np.float64) - (lower + upper) / 2) - (upper - lower) / 2
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)


def torus(points: ArrayLike, major: float = 1.0, minor: float = 0.25) -> Array:
    """Signed distance to a torus around the z axis."""
    p = np.asarray(points, np.float64)
    return np.hypot(np.hypot(p[..., 0], p[..., 1]) - major, p[..., 2]) - minor


def capsule(points: ArrayLike, half_height: float = 1.0, radius: float = 0.5) -> Array:
    """Signed distance to a capsule along the z axis; `half_height` reaches to the centres of its caps."""
    p = np.array(points, np.float64)
    p[..., 2] -= np.clip(p[..., 2], -half_height, half_height)
    return np.linalg.norm(p, axis=-1) - radius


def plane(points: ArrayLike, normal: ArrayLike, offset: float = 0.0) -> Array:
    """Signed height over the plane ``normal . p = offset``; `normal` is unit."""
    return np.asarray(points, np.float64) @ np.asarray(normal, np.float64) - offset


def facet_error(vertices: ArrayLike, faces: ArrayLike, curvature: float) -> float:
    """The most that a closed mesh with its vertices *on* a surface can be off it, both ways.

    The surface's distance function f vanishes at the corners of a triangle. Linear interpolation errs by at most
    M r^2 / 2, where r is the radius of the smallest circle around the triangle and M bounds the second derivative
    of f (Waldron 1998). For a surface of curvature at most k, M = k / (1 - k e) at distance e from it; the largest
    e with e = M r^2 / 2 is the bound. For a sphere this is the sagitta, R - sqrt(R^2 - r^2), to first order above.
    """
    radius = max_enclosing_radius(vertices, faces)
    slack = 1 - 2 * (curvature * radius) ** 2
    assert slack > 0, "triangles too large for this curvature"
    return (1 - np.sqrt(slack)) / (2 * curvature)


def max_enclosing_radius(vertices: ArrayLike, faces: ArrayLike) -> float:
    """The largest radius of a smallest circle around a triangle: half the longest edge, or the circumradius."""
    a, b, c = (corners(vertices, faces)[:, i] for i in range(3))
    sides = np.sort(np.stack([np.linalg.norm(x, axis=1) for x in (b - a, c - b, a - c)], axis=1), axis=1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    acute = sides[:, 0] ** 2 + sides[:, 1] ** 2 > sides[:, 2] ** 2
    circumradius = sides.prod(axis=1) / np.where(acute, 4 * area, np.inf)
    return float(np.where(acute, circumradius, sides[:, 2] / 2).max())


# --- grids and fields


def grid_points(lower: ArrayLike, upper: ArrayLike, shape: tuple[int, int, int]) -> Array:
    """Voxel centres, (nx, ny, nz, 3): ``lower + (index + 0.5) * spacing``."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    return lower + (index + 0.5) * ((upper - lower) / shape)


def trilinear(distances: ArrayLike, lower: ArrayLike, upper: ArrayLike, points: ArrayLike) -> Array:
    """The linear interpolant of voxel-centre samples, float64, positions clamped to the outermost centres."""
    values = np.asarray(distances, np.float64)
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    shape = np.array(values.shape)
    u = (np.asarray(points, np.float64) - lower) / ((upper - lower) / shape) - 0.5
    u = np.clip(u, 0, shape - 1)
    low = np.minimum(u.astype(np.int64), np.maximum(shape - 2, 0))
    high = np.minimum(low + 1, shape - 1)
    t = u - low
    result = np.zeros(len(u))
    for corner in np.ndindex(2, 2, 2):
        pick = np.where(corner, high, low)
        weight = np.where(corner, t, 1 - t).prod(axis=1)
        result += weight * values[pick[:, 0], pick[:, 1], pick[:, 2]]
    return result


def ray_sphere(origins: Array, directions: Array, radius: float) -> Array:
    """Parameter of the first hit of unit-direction rays with a sphere at the origin, inf for a miss."""
    b = dot(origins, directions)
    discriminant = b * b - (dot(origins, origins) - radius**2)
    with np.errstate(invalid="ignore"):
        t = -b - np.sqrt(discriminant)
    return np.where((discriminant >= 0) & (t > 0), t, np.inf)


def ray_box(origins: Array, directions: Array, lower: ArrayLike, upper: ArrayLike) -> Array:
    """Parameter of the first hit of rays with an axis-aligned box, seen from outside, inf for a miss."""
    with np.errstate(divide="ignore"):
        t0, t1 = (np.asarray(lower) - origins) / directions, (np.asarray(upper) - origins) / directions
    near, far = np.minimum(t0, t1).max(axis=-1), np.maximum(t0, t1).min(axis=-1)
    return np.where((near <= far) & (near > 0), near, np.inf)
