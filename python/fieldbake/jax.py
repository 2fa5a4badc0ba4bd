"""Signed distances and samples that JAX can differentiate and compile. Needs the extra ``fieldbake[jax]``.

>>> import fieldbake as fb
>>> from fieldbake.jax import signed_distance
>>> knot = fb.models.torus_knot(segments=64, sides=8)
>>> jax = __import__("pytest").importorskip("jax")
>>> total = lambda points: signed_distance(knot.vertices, knot.faces, points, knot).sum()
>>> jax.grad(total)(jax.numpy.array([[0.0, 0.0, 2.0]])).shape
(1, 3)
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np

from .base.optional import optional_module
from .meshes.mesh import Mesh
from .queries.derivatives import interpolate, linearize, vertex_changes

__all__ = ["sample", "signed_distance"]


def signed_distance(vertices: Any, faces: Any, points: Any, mesh: Mesh | None = None) -> Any:
    """Evaluate the signed distance of a mesh, differentiable in vertices and points by reverse mode.

    Parameters
    ----------
    vertices : (n, 3) array of floats
        Positions, world units.
    faces : (m, 3) array of integers
        Rows of `vertices`.
    points : (..., 3) array of floats
        World positions.
    mesh : Mesh, optional
        A mesh of the same vertices and faces, whose search tree is used. Without it a tree is built at every call.

    Returns
    -------
    (...) array
        Signed distances in the dtype of `points`, world units, negative inside.

    Raises
    ------
    Error
        If JAX is not installed.
    MeshError, ArgumentError
        As for :func:`fieldbake.query`.

    Notes
    -----
    The derivatives are those of :func:`fieldbake.torch.signed_distance`: exact wherever the closest point is unique,
    and one-sided on the medial axis. The distance is evaluated on the host by `jax.pure_callback`, so this
    function can be compiled by `jax.jit` and mapped by `jax.vmap`. float64 needs ``jax_enable_x64``.

    Examples
    --------
    >>> import jax
    >>> import fieldbake as fb
    >>> from fieldbake.jax import signed_distance
    >>> mesh = fb.models.gear()
    >>> point = jax.numpy.array([0.7, 0.0, 1.0])
    >>> jax.grad(lambda p: signed_distance(mesh.vertices, mesh.faces, p))(point).tolist()
    [0.0, 0.0, 1.0]
    """
    jax = optional_module("jax", "fieldbake.jax", extra="jax")
    numbers = jax.numpy
    return _distance_function()(mesh, numbers.asarray(vertices), numbers.asarray(faces), numbers.asarray(points))


def sample(distances: Any, bounds: Any, points: Any) -> Any:
    """Sample a grid of distances trilinearly, differentiable in distances, bounds and points.

    Parameters
    ----------
    distances : (nx, ny, nz) array of floats
        Samples at voxel centres, as `Volume.distances`.
    bounds : (2, 3) array of floats
        Lower and upper corner of the box, world units, as `Volume.bounds`.
    points : (..., 3) array of floats
        World positions. A position outside the box of the outermost samples is replaced by the nearest one in it.

    Returns
    -------
    (...) array
        Trilinear values; equal to `Volume.sample` between the samples.

    Raises
    ------
    Error
        If JAX is not installed.

    Examples
    --------
    >>> import jax
    >>> import fieldbake as fb
    >>> from fieldbake.jax import sample
    >>> volume = fb.bake(fb.sphere(), 32)
    >>> point = jax.numpy.array([1.0, 0.0, 0.0])
    >>> jax.grad(lambda p: sample(volume.distances, volume.bounds, p))(point).round(1).tolist()
    [1.0, 0.0, 0.0]
    """
    jax = optional_module("jax", "fieldbake.jax", extra="jax")
    numbers = jax.numpy
    distances, bounds, points = (numbers.asarray(value) for value in (distances, bounds, points))
    shape = np.array(distances.shape)
    grid = (points - bounds[0]) / (bounds[1] - bounds[0]) * shape - 0.5
    grid = numbers.clip(grid, 0, shape - 1)
    low = numbers.minimum(numbers.floor(jax.lax.stop_gradient(grid)).astype(int), np.maximum(shape - 2, 0))
    high = numbers.minimum(low + 1, shape - 1)
    return interpolate(distances, grid, low, high)


@cache
def _distance_function() -> Any:
    """The function of :func:`signed_distance` with its reverse-mode derivative."""
    jax = optional_module("jax", "fieldbake.jax", extra="jax")
    numbers = jax.numpy

    def evaluate(mesh: Mesh | None, vertices: Any, faces: Any, points: Any) -> Any:
        kind = points.dtype
        result = (
            jax.ShapeDtypeStruct(points.shape[:-1], kind),
            jax.ShapeDtypeStruct(points.shape, kind),
            jax.ShapeDtypeStruct(points.shape, numbers.int32),
            jax.ShapeDtypeStruct(points.shape, kind),
        )

        def on_host(vertices: Any, faces: Any, points: Any) -> Any:
            found = linearize(np.asarray(vertices), np.asarray(faces), np.asarray(points), mesh)
            return found.distances, found.gradients, found.corners.astype(np.int32), found.weights

        return jax.pure_callback(on_host, result, vertices, faces, points, vmap_method="sequential")

    @partial(jax.custom_vjp, nondiff_argnums=(0,))
    def distance(mesh: Mesh | None, vertices: Any, faces: Any, points: Any) -> Any:
        return evaluate(mesh, vertices, faces, points)[0]

    def forward(mesh: Mesh | None, vertices: Any, faces: Any, points: Any) -> Any:
        distances, gradients, corners, weights = evaluate(mesh, vertices, faces, points)
        return distances, (gradients, corners, weights, vertices)

    def backward(_: Mesh | None, kept: Any, change: Any) -> Any:
        gradients, corners, weights, vertices = kept
        per_point = change[..., None] * gradients
        of_corners = vertex_changes(weights, per_point).astype(vertices.dtype)
        of_vertices = numbers.zeros_like(vertices).at[corners].add(of_corners)
        return of_vertices, None, per_point

    distance.defvjp(forward, backward)
    return distance


def __dir__() -> list[str]:
    return sorted(__all__)
