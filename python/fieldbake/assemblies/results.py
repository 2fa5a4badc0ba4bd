"""Results of queries of assemblies, and the report of an assembly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.report import Report, Rows
from ..meshes.mesh import Mesh
from .joint import Joint

#: A body this many times larger than the distance between its joints likely has other units.
UNITS = 100.0


class AssemblyQuery(NamedTuple):
    """Signed distances to the bodies of an assembly, with gradients, nearest points and bodies.

    Arrays have the shape (b, ...) for b configurations, and (...) for one configuration without an axis of its own.

    Examples
    --------
    >>> import fieldbake as fb
    >>> balls = fb.Assembly({"left": fb.sphere(1).translate((-2, 0, 0)), "right": fb.sphere(1).translate((2, 0, 0))})
    >>> found = balls.query([(3.5, 0, 0)])
    >>> found.distances.tolist(), found.bodies.tolist()
    ([0.5], [1])
    """

    #: Signed distances, float64, world units, negative inside; infinite if no body has geometry.
    distances: NDArray[np.float64]
    #: Unit gradients of the signed distance, (..., 3) float64: they point away from the inside.
    gradients: NDArray[np.float64]
    #: Nearest points of the surfaces, (..., 3) float64, world positions.
    points: NDArray[np.float64]
    #: Rows in `Assembly.body_names` of the nearest bodies, int64; -1 if no body has geometry.
    bodies: NDArray[np.int64]
    #: Number of points and cost of the query.
    report: Report


class Clearance(NamedTuple):
    """Distances of pairs of bodies, negative where they overlap, with the nearest points.

    Arrays have the shape (b, k) for b configurations and k pairs, and (k,) for one configuration without an axis of its
    own.

    Examples
    --------
    >>> import fieldbake as fb
    >>> found = fb.clearance(fb.sphere(1), fb.sphere(1).translate((1.5, 0, 0)))
    >>> found.distances.round(6).tolist(), found.normals.round(6).tolist()
    ([-0.5], [[-1.0, 0.0, 0.0]])
    """

    #: Distance of separate bodies; minus the diameter of the largest ball in the overlap of others. Float64, world
    #: units. Beyond the cutoff it is a lower bound.
    distances: NDArray[np.float64]
    #: The nearest points of the surface of the first body, (..., 3) float64, world positions; NaN beyond the cutoff.
    points_a: NDArray[np.float64]
    #: The nearest points of the surface of the second body, (..., 3) float64; NaN beyond the cutoff.
    points_b: NDArray[np.float64]
    #: Unit vectors from the second body to the first, (..., 3) float64: a motion v_a, v_b of the nearest points changes
    #: the distance by ``normals . (v_a - v_b)``. An overlap that several faces of one body limit changes in this
    #: direction too, but by less. NaN beyond the cutoff.
    normals: NDArray[np.float64]
    #: The true value lies between ``distances - errors`` and ``distances``. Infinite beyond the cutoff, and for
    #: overlaps of open meshes, whose signed distance jumps across the opening. A flat sheet of at most 256 triangles
    #: has no inside: where it touches a solid or lies in it, the distance 0 is exact, and the points are one.
    errors: NDArray[np.float64]
    #: Rows of the pairs in `Assembly.body_names`, (k, 2) int64; -1 for the environment.
    pairs: NDArray[np.int64]
    #: Number of pairs and cost.
    report: Report


@dataclass(frozen=True)
class AssemblyReport(Rows):
    """The geometry of an assembly.

    Attributes
    ----------
    bodies, geometries, closed_forms, faces : int
        Numbers of bodies, of their geometries, of those that are exact shapes, and of faces of all others.
    largest_deviation : float
        Largest distance of the closed mesh of a shape or a volume from its source, world units: the field of the source
        at vertices and centres of faces.
    warnings : tuple of str
        Surfaces that are open, and units that look wrong.
    """

    bodies: int = 0
    geometries: int = 0
    closed_forms: int = 0
    faces: int = 0
    largest_deviation: float = 0.0
    warnings: tuple[str, ...] = ()

    def rows(self) -> list[tuple[str, str]]:
        """List the label and the text of each line of the report."""
        return [
            ("bodies", f"{self.bodies:,}"),
            ("geometry", f"{self.closed_forms:,} closed forms, {self.faces:,} faces"),
            ("deviation", f"{self.largest_deviation:.3g}"),
            *(("warning", warning) for warning in self.warnings),
        ]


def unit_warnings(joints: Iterable[Joint], bodies: Mapping[str, Any]) -> list[str]:
    """Warnings about bodies that are much larger than the distances between joints."""
    lengths = [float(np.linalg.norm(np.asarray(joint.origin)[:3, 3])) for joint in joints]
    reach = max(lengths, default=0.0)
    found = []
    for name, elements in bodies.items():
        for source, _ in elements:
            if isinstance(source, Mesh) and len(source.faces):
                size = float((source.bounds[1] - source.bounds[0]).max())
                if 0 < UNITS * reach < size:
                    found.append(
                        f"{name!r} is {size / reach:.0f} times larger than the distances between joints; is it in "
                        "millimetres? Scale the mesh"
                    )
    return found
