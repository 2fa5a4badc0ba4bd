"""Distances in 50 digits: triangles, polyhedra and solids of revolution."""

from __future__ import annotations

import mpmath
from mpmath import mp

mp.dps = 50


def vector(values):
    """Three floats as exact numbers."""
    return [mp.mpf(float(value)) for value in values]


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def length(*values):
    return mp.sqrt(sum(value * value for value in values))


def segment(p, a, b):
    """Distance to a segment in any dimension."""
    along, to = minus(b, a), minus(p, a)
    share = max(mp.mpf(0), min(mp.mpf(1), dot(to, along) / dot(along, along)))
    return length(*minus(to, [share * x for x in along]))


def triangle(p, corners):
    """Distance to a triangle: to its plane if the projection lies within all edges, else to the nearest edge."""
    a, b, c = corners
    normal = cross(minus(b, a), minus(c, a))
    edges = ((a, b), (b, c), (c, a))
    if all(dot(cross(normal, minus(to, start)), minus(p, start)) >= 0 for start, to in edges):
        return abs(dot(minus(p, a), normal)) / length(*normal)
    return min(segment(p, *edge) for edge in edges)


def polygon(x, y, corners):
    """Signed distance to a convex polygon, counter-clockwise."""
    edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    inside = all((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0 for a, b in edges)
    distance = min(segment([x, y], a, b) for a, b in edges)
    return -distance if inside else distance


def hull(p, faces):
    """Signed distance to a convex polyhedron of triangles, counter-clockwise from outside."""
    inside = all(dot(cross(minus(b, a), minus(c, a)), minus(p, a)) < 0 for a, b, c in faces)
    distance = min(triangle(p, face) for face in faces)
    return -distance if inside else distance


def turned(corners):
    """Field of the solid of revolution about z of a convex polygon (r, z) that is mirrored at the axis."""
    return lambda x, y, z: polygon(length(x, y), z, corners)


def box(x, y, z, half):
    q = [abs(c) - h for c, h in zip((x, y, z), half, strict=True)]
    return length(*(max(c, mp.mpf(0)) for c in q)) + min(max(q), mp.mpf(0))


def ellipsoid(x, y, z, radii):
    """The nearest point is r^2 y / (r^2 + t) for the largest root t (Eberly)."""
    at, squares = [abs(x), abs(y), abs(z)], [r * r for r in radii]

    def excess(t):
        return sum((r * c / (s + t)) ** 2 for r, c, s in zip(radii, at, squares, strict=True)) - 1

    low = -min(squares) + max(r * c for r, c, s in zip(radii, at, squares, strict=True) if s == min(squares))
    high = length(*(r * c for r, c in zip(radii, at, strict=True))) - min(squares)
    t = mpmath.findroot(excess, (low, high), solver="anderson", tol=mp.mpf(10) ** -80, maxsteps=400)
    nearest = [s * c / (s + t) for c, s in zip(at, squares, strict=True)]
    distance = length(*minus(at, nearest))
    return -distance if excess(0) < 0 else distance


def quads(*faces):
    """Two triangles for each face of four corners."""
    return [triple for a, b, c, d in faces for triple in ((a, b, c), (a, c, d))]


def exact(rows):
    return [tuple(mp.mpf(value) for value in row) for row in rows]
