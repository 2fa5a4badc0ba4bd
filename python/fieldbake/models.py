"""Closed meshes made in code, for examples and tests without a file."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .base import checks
from .base.errors import ArgumentError
from .meshes.mesh import Mesh

__all__ = ["gear", "torus_knot"]


def __dir__() -> list[str]:
    return sorted(__all__)


def torus_knot(
    p: int = 2,
    q: int = 3,
    *,
    radius: float = 1.0,
    depth: float = 0.45,
    thickness: float = 0.24,
    segments: int = 480,
    sides: int = 48,
) -> Mesh:
    """Make a tube along a torus knot; p = 2 and q = 3 give the trefoil.

    Parameters
    ----------
    p, q : int, default 2 and 3
        Number of turns around the axis of the torus and around its ring. They must have no common divisor.
    radius, depth : float, default 1 and 0.45
        Radius of the ring of the torus, and radius of the tube whose surface holds the knot, world units.
    thickness : float, default 0.24
        Radius of the tube along the knot, world units.
    segments, sides : int, default 480 and 48
        Number of steps along the knot and around its tube. The mesh has 2 * segments * sides faces.

    Returns
    -------
    Mesh
        A closed mesh around the origin. The axis of the torus is z.

    Raises
    ------
    ArgumentError
        If `p` and `q` have a common divisor or a size is out of range.

    Examples
    --------
    >>> torus_knot(segments=64, sides=8)
    Mesh(512 vertices, 1024 faces, 3.078 x 3.204 x 1.38 units)
    """
    p = checks.integer("p", p, least=1, most=64)
    q = checks.integer("q", q, least=1, most=64)
    if math.gcd(p, q) != 1:
        raise ArgumentError(f"p, q: must have no common divisor, got {p} and {q}")
    radius = checks.number("radius", radius, above=0)
    depth = checks.number("depth", depth, above=0)
    thickness = checks.number("thickness", thickness, above=0)
    segments = checks.integer("segments", segments, least=3, most=1 << 20)
    sides = checks.integer("sides", sides, least=3, most=1 << 12)

    t = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    ring = np.stack([np.cos(p * t), np.sin(p * t), np.zeros_like(t)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    outward = np.cos(q * t)[:, None] * ring + np.sin(q * t)[:, None] * up
    curve = radius * ring + depth * outward

    # A periodic frame: the tangent, and the normal of the torus made perpendicular to it.
    around = np.stack([-np.sin(p * t), np.cos(p * t), np.zeros_like(t)], axis=1)
    turning = -np.sin(q * t)[:, None] * ring + np.cos(q * t)[:, None] * up
    tangent = p * (radius + depth * np.cos(q * t))[:, None] * around + q * depth * turning
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = outward - np.sum(outward * tangent, axis=1, keepdims=True) * tangent
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    binormal = np.cross(tangent, normal)

    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rim = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * binormal[:, None]
    vertices = (curve[:, None] + thickness * rim).reshape(-1, 3)
    rows = np.arange(segments * sides).reshape(segments, sides)
    return Mesh(vertices, _quads(rows, np.roll(rows, -1, axis=0)))


def gear(
    teeth: int = 18,
    *,
    radius: float = 1.0,
    tooth: float = 0.16,
    hole: float = 0.4,
    thickness: float = 0.35,
) -> Mesh:
    """Make a gear wheel with a round hole; it has flat faces and sharp edges.

    Parameters
    ----------
    teeth : int, default 18
        Number of teeth.
    radius, tooth, hole : float, default 1, 0.16 and 0.4
        Outer radius, height of a tooth and radius of the hole, world units.
    thickness : float, default 0.35
        Extent along z, world units.

    Returns
    -------
    Mesh
        A closed mesh around the origin. The axis of the wheel is z.

    Raises
    ------
    ArgumentError
        If a size is out of range, or the hole and the teeth together exceed the radius.

    Examples
    --------
    >>> gear(teeth=6).topology()["closed"]
    True
    """
    teeth = checks.integer("teeth", teeth, least=3, most=1 << 12)
    radius = checks.number("radius", radius, above=0)
    tooth = checks.number("tooth", tooth, above=0)
    hole = checks.number("hole", hole, above=0)
    thickness = checks.number("thickness", thickness, above=0)
    if hole + tooth >= radius:
        raise ArgumentError(f"hole: hole ({hole:g}) plus tooth ({tooth:g}) must be less than radius ({radius:g})")

    # Each tooth has eight steps: five at the foot and three at the tip, with flanks between them.
    per_tooth = np.array([0.0, 0.125, 0.25, 0.375, 0.5, 0.6, 0.75, 0.9])
    raised = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    angle = ((np.arange(teeth)[:, None] + per_tooth) * (2 * np.pi / teeth)).ravel()
    outline = radius - tooth + tooth * np.tile(raised, teeth)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    # The rings follow the cross-section of the wheel: outer top, inner top, inner bottom, outer bottom.
    half = thickness / 2
    rings = [(outline, half), (np.full_like(angle, hole), half), (np.full_like(angle, hole), -half), (outline, -half)]
    vertices = np.concatenate(
        [np.column_stack([distance[:, None] * circle, np.full_like(angle, z)]) for distance, z in rings]
    )
    rows = np.arange(len(vertices)).reshape(len(rings), -1).T
    return Mesh(vertices, _quads(np.roll(rows, -1, axis=0), rows))


def _quads(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Make two triangles for each cell between two tables of vertices, whose rows are rings."""
    a, b = before, after
    c, d = np.roll(after, -1, axis=1), np.roll(before, -1, axis=1)
    return np.stack([a, c, b, a, d, c], axis=-1).reshape(-1, 3).astype(np.int64)
