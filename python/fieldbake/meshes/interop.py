"""Triangles of objects of PyVista, Open3D, meshio, build123d and CadQuery, which are recognised by their attributes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import MeshError

#: Chord error of a tessellated solid, as a fraction of the diagonal of its box.
CHORD_SHARE = 1e-4
#: Chord error of a solid without a box, in its own units.
CHORD_WITHOUT_BOX = 1e-2


class Triangles(NamedTuple):
    """Arrays of an object of another library."""

    vertices: Any
    faces: Any
    #: Largest distance between the triangles and the tessellated solid; 0 for meshes.
    chord_error: float = 0.0


def is_cloud(geometry: Any) -> bool:
    """Whether an object is a cloud of points of Open3D, trimesh or PyVista, or of this package."""
    if hasattr(geometry, "point_data") and hasattr(geometry, "n_strips") and hasattr(geometry, "points"):
        return len(geometry.faces) == 0 and bool(geometry.n_strips == 0)
    if hasattr(geometry, "point") and hasattr(geometry.point, "positions"):
        # Open3D's tensor cloud; its meshes have `vertex` and `triangle`.
        return not hasattr(geometry, "triangle") and not hasattr(geometry, "line")
    if hasattr(geometry, "has_normals") and hasattr(geometry, "points"):
        return not hasattr(geometry, "triangles") and not hasattr(geometry, "lines")
    is_trimesh = hasattr(geometry, "kdtree") and hasattr(geometry, "vertices") and not hasattr(geometry, "faces")
    return is_trimesh or (hasattr(geometry, "has_sides") and hasattr(geometry, "areas"))


def triangles_of(geometry: Any) -> Triangles | None:
    """Read the triangles of an object of one of the libraries; None for any other object."""
    if hasattr(geometry, "triangulate") and hasattr(geometry, "points") and hasattr(geometry, "regular_faces"):
        return _of_pyvista(geometry)
    if hasattr(geometry, "vertex") and hasattr(geometry, "triangle") and hasattr(geometry.vertex, "positions"):
        # Open3D's tensor mesh.
        return Triangles(host(geometry.vertex.positions), host(geometry.triangle.indices))
    if hasattr(geometry, "vertices") and hasattr(geometry, "triangles") and not callable(geometry.vertices):
        # Open3D's legacy mesh.
        return Triangles(np.asarray(geometry.vertices), np.asarray(geometry.triangles))
    if hasattr(geometry, "cells_dict") and hasattr(geometry, "points"):
        return _of_meshio(geometry)
    if hasattr(geometry, "tessellate"):
        return _of_solid(geometry)
    if hasattr(geometry, "val") and hasattr(geometry, "vals") and callable(geometry.vals):
        # A CadQuery workplane: all solids on its stack.
        return _joined([_of_solid(solid) for solid in geometry.vals() if hasattr(solid, "tessellate")])
    return None


def _of_pyvista(geometry: Any) -> Triangles:
    """Read PolyData; PyVista triangulates polygons."""
    surface = geometry if geometry.is_all_triangles else geometry.triangulate()
    return Triangles(np.asarray(surface.points), np.asarray(surface.regular_faces).reshape(-1, 3))


def _of_meshio(geometry: Any) -> Triangles:
    """A mesh of meshio; its cells are triangles, quadrilaterals and polygons."""
    faces = []
    for kind, cells in geometry.cells_dict.items():
        corners = np.asarray(cells)
        if kind in ("triangle", "quad", "polygon") or kind.startswith("polygon"):
            # A fan around the first corner.
            faces += [corners[:, [0, i, i + 1]] for i in range(1, corners.shape[1] - 1)]
        elif kind not in ("vertex", "line"):
            raise MeshError(f"mesh: has cells of the kind {kind!r}; give its surface, as triangles, quads or polygons")
    points = np.asarray(geometry.points)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return Triangles(points, np.concatenate(faces) if faces else np.empty((0, 3), np.int64))


def _of_solid(geometry: Any) -> Triangles:
    """Read any object with ``tessellate(tolerance)``, which returns vertices and triples of their rows."""
    tolerance = _diagonal(geometry) * CHORD_SHARE or CHORD_WITHOUT_BOX
    vertices, faces = geometry.tessellate(tolerance)
    rows = np.array([_coordinates(vertex) for vertex in vertices], np.float64).reshape(-1, 3)
    return Triangles(rows, np.asarray(faces, np.int64).reshape(-1, 3), tolerance)


def _joined(parts: list[Triangles]) -> Triangles | None:
    if not parts:
        return None
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        max(part.chord_error for part in parts),
    )


def _diagonal(geometry: Any) -> float:
    """Diagonal of the box of a solid; 0 if it has no box."""
    for name in ("bounding_box", "BoundingBox"):
        if callable(method := getattr(geometry, name, None)):
            diagonal = getattr(method(), "diagonal", getattr(method(), "DiagonalLength", 0.0))
            return float(diagonal)
    return 0.0


def _coordinates(vertex: Any) -> Any:
    """Return the three coordinates of a vector of any of the libraries."""
    for name in ("to_tuple", "toTuple"):
        if callable(method := getattr(vertex, name, None)):
            return method()
    if hasattr(vertex, "X"):
        return vertex.X, vertex.Y, vertex.Z
    if hasattr(vertex, "x"):
        return vertex.x, vertex.y, vertex.z
    values = tuple(vertex)
    if len(values) != 3:
        raise MeshError(f"mesh: tessellate() returned a vertex with {len(values)} coordinates, expected 3")
    return values


def host(tensor: Any) -> NDArray[Any]:
    """Convert a tensor of Open3D to an array."""
    return np.asarray(tensor.cpu().numpy() if hasattr(tensor, "cpu") else tensor)
