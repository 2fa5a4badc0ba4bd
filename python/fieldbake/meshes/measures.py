"""Measures of a triangle mesh in float64: area, volume and normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cross_products(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Cross products of the edges of the faces, (m, 3): normals whose lengths are twice the areas."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    products: NDArray[np.float64] = np.cross(b - a, c - a)
    return products


def area(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> float:
    """Sum of the areas of all faces."""
    return float(np.linalg.norm(cross_products(vertices, faces), axis=1).sum() / 2)


def signed_volume(vertices: NDArray[np.float64], faces: NDArray[np.uint32], center: NDArray[np.float64]) -> float:
    """Sum of the signed volumes between the faces and the centre."""
    return float(np.einsum("ij,ij->", vertices[faces[:, 0]] - center, cross_products(vertices, faces)) / 6)


def face_normals(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Unit normals of the faces by their own winding, (m, 3)."""
    return unit_rows(cross_products(vertices, faces))


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Unit normals of the vertices, weighted by the angles of their faces, (n, 3); zero where no face is."""
    normals = face_normals(vertices, faces)
    sums = np.zeros_like(vertices)
    for corner in range(3):
        here, following, before = (vertices[faces[:, (corner + step) % 3]] for step in range(3))
        along, across = following - here, before - here
        # The arc tangent keeps its accuracy for slivers, where a cosine is near 1.
        sine = np.linalg.norm(np.cross(along, across), axis=1)
        angle = np.arctan2(sine, np.einsum("ij,ij->i", along, across))
        for axis in range(3):
            sums[:, axis] += np.bincount(faces[:, corner], angle * normals[:, axis], len(vertices))
    return unit_rows(sums)


def unit_rows(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise vectors to length 1; zero vectors stay zero."""
    # Dividing by the largest component first keeps the squares in range. Columns are faster than rows of three numbers.
    x, y, z = vectors.T
    largest = np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z))
    largest[largest == 0] = 1.0
    x, y, z = x / largest, y / largest, z / largest
    lengths = np.sqrt(x * x + y * y + z * z)
    lengths[lengths == 0] = 1.0
    return np.stack([x / lengths, y / lengths, z / lengths], axis=1)
