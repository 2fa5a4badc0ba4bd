"""Geometry made in code, clean and dirty: every function returns vertices (n, 3) float64 and faces (m, 3) int64.

Faces run counter-clockwise seen from outside unless the name says otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Geometry(NamedTuple):
    """A pair that goes straight into the package as ``(vertices, faces)``."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


# --- closed


def box(lower: ArrayLike = (-1, -1, -1), upper: ArrayLike = (1, 1, 1)) -> Geometry:
    """Twelve triangles; with whole-number corners every face lies on grid planes."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (upper - lower) + lower
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Geometry(vertices, _split(quads))


def tetrahedron() -> Geometry:
    """Regular, corners on alternate corners of the cube of side 2."""
    vertices = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
    return Geometry(vertices, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))


def icosphere(subdivisions: int = 3, radius: float = 1.0, center: ArrayLike = (0, 0, 0)) -> Geometry:
    """A sphere of 20 * 4^n nearly equal triangles, vertices on the sphere."""
    phi = (1 + np.sqrt(5)) / 2
    vertices = np.array([[0, s, t * phi] for s in (-1, 1) for t in (-1, 1)], np.float64)
    vertices = np.concatenate([vertices, np.roll(vertices, 1, axis=1), np.roll(vertices, 2, axis=1)])
    # The faces are the triples of corners at the shortest distance, 2, from each other.
    near = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=-1), 2)
    faces = np.array(
        [
            t
            for t in np.ndindex(12, 12, 12)
            if t[0] < t[1] < t[2] and near[t[0], t[1]] & near[t[1], t[2]] & near[t[0], t[2]]
        ]
    )
    faces = _face_outwards(vertices, faces)
    for _ in range(subdivisions):
        vertices, faces = _subdivide(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return Geometry(
        vertices / np.linalg.norm(vertices, axis=1, keepdims=True) * radius + np.asarray(center, np.float64), faces
    )


def uv_sphere(rings: int = 16, segments: int = 32, radius: float = 1.0) -> Geometry:
    """A sphere of latitudes and longitudes: needle triangles around both poles."""
    polar = np.linspace(0, np.pi, rings + 1)
    return _lathe(np.stack([np.sin(polar), np.cos(polar)], axis=1) * radius, segments)


def capsule(half_height: float = 1.0, radius: float = 0.5, rings: int = 24, segments: int = 64) -> Geometry:
    """A capsule along z."""
    polar = np.linspace(0, np.pi / 2, rings + 1)
    cap = np.stack([np.sin(polar), np.cos(polar)], axis=1) * radius
    barrel = np.stack([np.full(8, radius), np.linspace(half_height, -half_height, 10)[1:-1]], axis=1)
    top, bottom = cap - (0, -half_height), cap[::-1] * (1, -1) - (0, half_height)
    return _lathe(np.concatenate([top, barrel, bottom]), segments)


def torus(major: float = 1.0, minor: float = 0.25, segments: int = 96, sides: int = 32) -> Geometry:
    """A torus around the z axis."""
    u, v = _angles(segments), _angles(sides)
    u, v = u[:, None], v[None, :]
    ring = major + minor * np.cos(v)
    vertices = np.stack(
        [ring * np.cos(u), ring * np.sin(u), np.broadcast_to(minor * np.sin(v), ring.shape[:1] + v.shape[1:]) + 0 * u],
        axis=-1,
    )
    return Geometry(vertices.reshape(-1, 3), _wrapped_quads(segments, sides))


def knot(segments: int = 200, sides: int = 24, radius: float = 0.35) -> Geometry:
    """A tube along a trefoil: one closed body whose strands pass close to each other."""
    t = _angles(segments)
    center = np.stack([(2 + np.cos(3 * t)) * np.cos(2 * t), (2 + np.cos(3 * t)) * np.sin(2 * t), np.sin(3 * t)], axis=1)
    tangent = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    # The curve is never parallel to z, so z gives a frame that closes after one turn.
    across = _unit(np.cross(tangent, (0, 0, 1)))
    above = _unit(np.cross(across, tangent))
    v = _angles(sides)[None, :, None]
    vertices = center[:, None] + radius * (np.cos(v) * across[:, None] + np.sin(v) * above[:, None])
    return Geometry(vertices.reshape(-1, 3), _wrapped_quads(segments, sides))


def sliver_fin() -> Geometry:
    """A closed fin: 1 long, 1 high, a ten-thousandth thick at the root and sharp at the tip."""
    vertices = np.array([[0, -5e-5, 0], [0, 5e-5, 0], [1, 5e-5, 0], [1, -5e-5, 0], [0, 0, 1], [1, 0, 1]])
    quads = [(0, 1, 2, 3), (1, 4, 5, 2), (0, 3, 5, 4)]
    return Geometry(vertices, np.concatenate([_split(quads), [[0, 4, 1], [3, 2, 5]]]))


def hollow_sphere(outer: float = 1.0, inner: float = 0.6) -> Geometry:
    """A ball with a cavity: the inner shell faces inwards."""
    return join(icosphere(3, outer), flip(icosphere(3, inner)))


def nested_shells(outer: float = 1.0, inner: float = 0.6) -> Geometry:
    """A shell in a shell, both facing outwards: the winding number is 2 in the middle, which is inside."""
    return join(icosphere(3, outer), icosphere(3, inner))


def overlapping_boxes() -> Geometry:
    """Two boxes of one mesh that share a cube of side 1: winding number 2 there, which is inside."""
    return join(box((-1.5, -1, -1), (0.5, 1, 1)), box((-0.5, -1, -1), (1.5, 1, 1)))


def size_ratio() -> Geometry:
    """A ball a million times smaller than the one beside it."""
    return join(icosphere(3, 1.0), icosphere(2, 1e-6, center=(1.5, 0, 0)))


# --- open


def open_box() -> Geometry:
    """The box of side 2 without its lid at z = 1."""
    vertices, faces = box()
    return Geometry(vertices, faces[~(vertices[faces][:, :, 2] == 1).all(axis=1)])


def triangle() -> Geometry:
    """One triangle in the plane z = 0."""
    return Geometry(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64), np.array([[0, 1, 2]]))


def flat_sheet(cells: int = 8) -> Geometry:
    """The square from -1 to 1 in the plane z = 0: its box has no thickness."""
    x, y = np.meshgrid(np.linspace(-1, 1, cells + 1), np.linspace(-1, 1, cells + 1), indexing="ij")
    i = np.arange((cells + 1) * (cells + 1)).reshape(cells + 1, cells + 1)
    quads = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 4)
    return Geometry(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), _split(quads))


def needle_fan(count: int = 64) -> Geometry:
    """Triangles a thousand times longer than wide around one corner."""
    angle = _angles(count)
    left, right = (
        np.stack([np.cos(a), np.sin(a), 0.2 * np.sin(5 * angle)], axis=1) for a in (angle - 5e-4, angle + 5e-4)
    )
    vertices = np.concatenate([[[0, 0, 0]], left, right])
    i = np.arange(count) + 1
    return Geometry(vertices, np.stack([0 * i, i, i + count], axis=1))


def soup(count: int = 200, seed: int = 1) -> Geometry:
    """Unrelated triangles in the unit cube."""
    random = np.random.default_rng(seed)
    center = random.uniform(size=(count, 1, 3))
    corners = center + 0.1 * random.standard_normal((count, 3, 3))
    return Geometry(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def stacked_sheets() -> Geometry:
    """Twelve squares above each other, all facing up, and four far triangles that widen the box.

    The winding number exceeds 1/2 far above and below the squares, up to the box.
    """
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    squares = [np.c_[corners, np.full(4, z)] for z in np.linspace(-0.05, 0.05, 12)]
    quads = [(np.array([(0, 1, 2), (0, 2, 3)]) + 4 * i) for i in range(12)]
    ends = np.array([(1, 1, 0.9), (-1, 1, -0.9), (-1, -1, 0.9), (1, -1, -0.9)])
    small = [end * (1 - 0.02 * np.eye(3)) for end in ends]
    triangles = [np.array([(0, 1, 2)]) + 48 + 3 * i for i in range(4)]
    return Geometry(np.concatenate(squares + small), np.concatenate(quads + triangles))


# --- damage


def flip(geometry: Geometry) -> Geometry:
    """The same surface inside out."""
    return Geometry(geometry.vertices, geometry.faces[:, ::-1])


def flip_some(geometry: Geometry, share: float, seed: int = 2) -> Geometry:
    """Turn a random share of the faces around."""
    turned = np.random.default_rng(seed).uniform(size=len(geometry.faces)) < share
    return Geometry(geometry.vertices, np.where(turned[:, None], geometry.faces[:, ::-1], geometry.faces))


def doubled(geometry: Geometry) -> Geometry:
    """Every face twice, the same way round."""
    return Geometry(geometry.vertices, np.concatenate([geometry.faces, geometry.faces]))


def doubled_opposite(geometry: Geometry) -> Geometry:
    """Every face twice, once each way round: the winding number is 0 everywhere."""
    return Geometry(geometry.vertices, np.concatenate([geometry.faces, geometry.faces[:, ::-1]]))


def cracked(geometry: Geometry, gap: float = 1e-5, seed: int = 3) -> Geometry:
    """Every triangle gets corners of its own, each moved by up to `gap`."""
    vertices = geometry.vertices[geometry.faces].reshape(-1, 3)
    moved = vertices + np.random.default_rng(seed).uniform(-gap, gap, size=vertices.shape) / np.sqrt(3)
    return Geometry(moved, np.arange(len(moved)).reshape(-1, 3))


def split_vertices(geometry: Geometry) -> Geometry:
    """Every triangle gets corners of its own at the same places, as in an STL file."""
    vertices = geometry.vertices[geometry.faces].reshape(-1, 3)
    return Geometry(vertices, np.arange(len(vertices)).reshape(-1, 3))


def join(*parts: Geometry) -> Geometry:
    """Several meshes as one."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Geometry(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
    )


def move(geometry: Geometry, matrix: ArrayLike) -> Geometry:
    """Apply a 4x4 transform, column vectors."""
    matrix = np.asarray(matrix, np.float64)
    return Geometry(geometry.vertices @ matrix[:3, :3].T + matrix[:3, 3], geometry.faces)


def scale_and_shift(geometry: Geometry, scale: float = 1.0, shift: ArrayLike = (0, 0, 0)) -> Geometry:
    """Scale about the origin, then move."""
    return Geometry(geometry.vertices * scale + np.asarray(shift, np.float64), geometry.faces)


def rotation(seed: int) -> NDArray[np.float64]:
    """A random rotation, (3, 3)."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def points_around(geometry: Geometry, count: int, seed: int = 4, spread: float = 1.5) -> NDArray[np.float64]:
    """Random points in the mesh's box scaled by `spread` about its centre."""
    used = geometry.vertices[geometry.faces].reshape(-1, 3)
    lower, upper = used.min(axis=0), used.max(axis=0)
    half = np.maximum((upper - lower) / 2, (upper - lower).max() / 20) * spread
    return (lower + upper) / 2 + half * np.random.default_rng(seed).uniform(-1, 1, size=(count, 3))


CLOSED = {
    "cube": box,
    "tetrahedron": tetrahedron,
    "icosphere": icosphere,
    "uv_sphere": uv_sphere,
    "capsule": lambda: capsule(rings=6, segments=16),
    "torus": lambda: torus(segments=32, sides=12),
    "knot": lambda: knot(96, 10),
    "sliver_fin": sliver_fin,
    "hollow_sphere": hollow_sphere,
    "nested_shells": nested_shells,
    "overlapping_boxes": overlapping_boxes,
    "size_ratio": size_ratio,
}
"""Closed and outward (or properly hollow) meshes: inside is where the winding number is not 0."""

OPEN = {
    "open_box": open_box,
    "triangle": triangle,
    "flat_sheet": flat_sheet,
    "needle_fan": needle_fan,
    "soup": soup,
    "cracked": lambda: cracked(icosphere()),
    "flipped_faces": lambda: flip_some(icosphere(), 0.02),
}
"""Open and dirty ones: distance stays exact, inside is what the winding number says."""


# --- helpers


def _angles(count: int) -> NDArray[np.float64]:
    return np.arange(count) * (2 * np.pi / count)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _split(quads: ArrayLike) -> NDArray[np.int64]:
    """Two triangles for each quad."""
    quads = np.asarray(quads, np.int64)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _wrapped_quads(rows: int, columns: int) -> NDArray[np.int64]:
    i = np.arange(rows * columns).reshape(rows, columns)
    right, below = np.roll(i, -1, axis=1), np.roll(i, -1, axis=0)
    return _split(np.stack([i, below, np.roll(right, -1, axis=0), right], axis=-1).reshape(-1, 4))


def _lathe(profile: NDArray[np.float64], segments: int) -> Geometry:
    """Turn a profile of (radius, z), from the top pole to the bottom pole, around z."""
    angle = _angles(segments)
    radius, z = profile[1:-1, 0, None], profile[1:-1, 1, None]
    body = np.stack([radius * np.cos(angle), radius * np.sin(angle), z + 0 * angle], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([body, [[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]]])
    i = np.arange(len(body)).reshape(-1, segments)
    right = np.roll(i, -1, axis=1)
    quads = np.stack([i[:-1], i[1:], right[1:], right[:-1]], axis=-1).reshape(-1, 4)
    top = np.stack([i[0], right[0], np.full(segments, len(body))], axis=1)
    bottom = np.stack([right[-1], i[-1], np.full(segments, len(body) + 1)], axis=1)
    return Geometry(vertices, np.concatenate([_split(quads), top, bottom]))


def _subdivide(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cut every triangle into four at the middles of its edges."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = (len(vertices) + inverse.reshape(-1, 3)).T
    a, b, c = faces.T
    cut = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([vertices, vertices[unique].mean(axis=1)]), np.concatenate([np.stack(t, axis=1) for t in cut])


def _face_outwards(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Orient the faces of a star-shaped mesh around the origin."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0
    return np.where(inwards[:, None], faces[:, ::-1], faces)
