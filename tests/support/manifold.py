"""The conditions of a closed two-manifold, checked on arrays."""

import numpy as np
from numpy.typing import NDArray


def faults(vertices: NDArray, faces: NDArray) -> list[str]:
    """Everything that keeps a triangle mesh from being a closed, oriented two-manifold with faces of positive area."""
    faces = np.asarray(faces, dtype=np.int64)
    found = []
    if not np.isfinite(vertices).all():
        return ["a vertex is not finite"]
    used = np.unique(faces)
    if len(used) != len(vertices):
        found.append(f"{len(vertices) - len(used)} vertices have no face")
    start, end = (faces[:, order].T.ravel() for order in ([0, 1, 2], [1, 2, 0]))
    directed = start * (len(vertices) + 1) + end
    if len(np.unique(directed)) != len(directed):
        found.append("a directed edge is used twice")
    if not np.isin(end * (len(vertices) + 1) + start, directed).all():
        found.append("a directed edge has no opposite")
    if not found:
        found += _fans(faces, len(vertices))
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not (areas > 0).all():
        found.append(f"{(~(areas > 0)).sum()} faces have no area")
    return found


def _fans(faces: NDArray, vertices: int) -> list[str]:
    """Vertices whose faces form more than one fan: the corners of faces are joined across shared edges."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(faces)
    corner = np.arange(3 * count)
    at, following, before = faces.ravel(), np.roll(faces, -1, axis=1).ravel(), np.roll(faces, 1, axis=1).ravel()
    # The face across the edge from a vertex to its follower has that follower before the same vertex.
    across = dict(zip(zip(at.tolist(), before.tolist(), strict=True), corner.tolist(), strict=True))
    other = np.array([across[key] for key in zip(at.tolist(), following.tolist(), strict=True)])
    joined = coo_matrix((np.ones(len(corner)), (corner, other)), shape=(len(corner), len(corner)))
    fans, _ = connected_components(joined, directed=False)
    return [] if fans == vertices else [f"{fans} fans at {vertices} vertices"]
