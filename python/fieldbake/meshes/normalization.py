"""Meshes moved and scaled to a standard size and position."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError
from .convert import MeshLike, as_mesh
from .mesh import Mesh

Target = Literal["unit cube", "unit sphere"]


class Normalized(NamedTuple):
    """A normalised mesh and its transform.

    Examples
    --------
    >>> import fieldbake as fb
    >>> mesh, transform = fb.normalize(fb.models.gear(), "unit sphere")
    >>> transform.shape
    (4, 4)
    """

    mesh: Mesh
    #: 4x4 matrix from the positions of the original to the positions of `mesh`; column vectors.
    transform: NDArray[np.float64]


def normalize(mesh: MeshLike, target: Target = "unit cube") -> Normalized:
    """Move and scale a mesh to fit a unit cube or a unit sphere about the origin.

    Parameters
    ----------
    mesh : Mesh or anything :func:`bake` takes as a mesh
        Mesh to normalise. Its faces determine the box; vertices without a face are transformed too.
    target : "unit cube" or "unit sphere", default "unit cube"
        The centre of the box moves to the origin. ``"unit cube"``: the longest side of the box becomes 1, so
        coordinates are between -0.5 and 0.5. ``"unit sphere"``: the distance from the origin to the farthest vertex of
        a face becomes 1.

    Returns
    -------
    Normalized
        The mesh, with its texture coordinates and parts, and the 4x4 transform: unpacks as ``mesh, transform``.

    Raises
    ------
    MeshError
        If the mesh cannot be read or used.
    ArgumentError
        For an unknown target.

    Examples
    --------
    >>> import fieldbake
    >>> mesh, transform = normalize(fieldbake.models.gear(teeth=6))
    >>> mesh.bounds.round(6).tolist()
    [[-0.5, -0.5, -0.087982], [0.5, 0.5, 0.087982]]
    """
    word = checks.text("target", target)
    if word not in ("unit cube", "unit sphere"):
        raise ArgumentError(f"target: must be 'unit cube' or 'unit sphere', got {word!r}")
    checked = as_mesh(mesh)
    lower, upper = checked.bounds
    center = lower + (upper - lower) / 2
    if word == "unit cube":
        size = float((upper - lower).max())
    else:
        is_used = np.zeros(len(checked.vertices), bool)
        is_used[checked.faces] = True
        size = float(np.linalg.norm(checked.vertices[is_used] - center, axis=1).max())
    transform = np.eye(4)
    transform[:3, :3] /= size
    transform[:3, 3] = -center / size
    normalized = checked.moved((checked.vertices - center) / size)
    normalized._chord_error = checked.chord_error / size
    return Normalized(normalized, transform)
