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

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from .assemblies.assembly import Assembly
from .assemblies.derivatives import linearize_assembly, linearize_clearance
from .base import checks
from .base.errors import ArgumentError, Error, MeshError
from .base.optional import optional_module
from .meshes.mesh import Mesh
from .queries.derivatives import check_shape, interpolate, linearize, vertex_changes

__all__ = ["assembly_clearance", "assembly_distance", "assembly_poses", "sample", "signed_distance"]

#: Pairs of rows of bodies, which JAX can hash.
RowPairs = tuple[tuple[int, int], ...]


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
        A mesh of the same vertices and faces, whose search tree is used. Without it a tree is built at every call. Its
        vertices are compared after rounding to the dtype of `vertices`.

    Returns
    -------
    (...) array
        Signed distances in the dtype of `points`, world units, negative inside. They are float32 for bfloat16 points,
        and in JAX's default type of floats for integers.

    Raises
    ------
    Error
        If JAX is not installed.
    MeshError, ArgumentError
        As for :func:`fieldbake.query`; ArgumentError also for a `mesh` of other vertices or faces. In functions that
        `jax.jit` or `jax.vmap` trace, errors in values appear in the text of a `jax.errors.JaxRuntimeError`.

    Notes
    -----
    The derivatives are the same as in :func:`fieldbake.torch.signed_distance`: exact wherever the closest point is
    unique, and one-sided on the medial axis. The distance is evaluated on the host by `jax.pure_callback`, so this
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
    vertices, rows = _floats("vertices", vertices, "(n, 3)", MeshError), _array("faces", faces, "(m, 3)", MeshError)
    if rows.dtype.kind not in "iu":
        raise MeshError(f"faces: must be whole numbers, got dtype {rows.dtype}; convert with faces.astype(int)")
    return _distance_function()(mesh, vertices, rows, _floats("points", points, "(..., 3)"))


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
    ArgumentError
        For an array of a wrong shape or type.

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
    distances, bounds = _floats("distances", distances, "(nx, ny, nz)"), _floats("bounds", bounds, "(2, 3)")
    points = _floats("points", points, "(..., 3)")
    shape = np.array(distances.shape)
    grid = (points - bounds[0]) / (bounds[1] - bounds[0]) * shape - 0.5
    grid = numbers.clip(grid, 0, shape - 1)
    low = numbers.minimum(numbers.floor(jax.lax.stop_gradient(grid)).astype(int), np.maximum(shape - 2, 0))
    high = numbers.minimum(low + 1, shape - 1)
    return interpolate(distances, grid, low, high)


def assembly_poses(assembly: Assembly, values: Any) -> Any:
    """Compute the poses of all bodies of an assembly, differentiable in the joint values.

    Parameters
    ----------
    assembly : Assembly
        Bodies and joints.
    values : (..., m) array of floats
        Joint values in the order of `Assembly.joint_names`.

    Returns
    -------
    (..., n, 4, 4) array
        World-from-body poses in the dtype of `values`, as :meth:`fieldbake.Assembly.poses`.

    Raises
    ------
    Error
        If JAX is not installed.
    ArgumentError
        For a wrong number of values.

    Examples
    --------
    >>> import jax
    >>> import fieldbake as fb
    >>> from fieldbake.jax import assembly_poses
    >>> arm = fb.Assembly({"a": (), "b": ()}, [fb.Joint("slide", "prismatic", "a", "b", axis=(0, 0, 1))])
    >>> jax.grad(lambda values: assembly_poses(arm, values)[1, 2, 3])(jax.numpy.array([0.5])).tolist()
    [1.0]
    """
    jax = optional_module("jax", "fieldbake.jax", extra="jax")
    return assembly._forward(_floats("values", values, "(..., m)"), jax.numpy)


def assembly_distance(assembly: Assembly, poses: Any, points: Any) -> Any:
    """Evaluate the smallest signed distance over the bodies, differentiable in poses and points.

    Parameters
    ----------
    assembly : Assembly
        Bodies with their geometry.
    poses : (n, 4, 4) or (b, n, 4, 4) array of floats
        Rigid world-from-body poses, orthonormal to 1e-6.
    points : (..., 3) array of floats
        World positions, the same for each configuration.

    Returns
    -------
    (...) or (b, ...) array
        Signed distances in the dtype of `points`, world units, negative inside.

    Raises
    ------
    Error
        If JAX is not installed.
    ArgumentError
        As for :meth:`fieldbake.Assembly.query`.

    Notes
    -----
    The derivatives are the same as in :func:`fieldbake.torch.assembly_distance`. Only reverse mode is provided.

    Examples
    --------
    >>> import jax
    >>> import fieldbake as fb
    >>> from fieldbake.jax import assembly_distance
    >>> ball = fb.Assembly({"ball": fb.sphere(1)})
    >>> poses = jax.numpy.eye(4)[None]
    >>> jax.grad(lambda p: assembly_distance(ball, poses, p))(jax.numpy.array([0.0, 0.0, 3.0])).tolist()
    [0.0, 0.0, 1.0]
    """
    return _assembly_function()(
        assembly, _floats("poses", poses, "(..., n, 4, 4)"), _floats("points", points, "(..., 3)")
    )


def assembly_clearance(assembly: Assembly, poses: Any, pairs: Any = None) -> Any:
    """Evaluate the clearances of pairs of bodies, differentiable in poses by reverse mode.

    Parameters
    ----------
    assembly : Assembly
        Bodies with their geometry.
    poses : (n, 4, 4) or (b, n, 4, 4) array of floats
        Rigid world-from-body poses, in float64 or orthonormal to 1e-6.
    pairs : (k, 2) of int or str, optional
        The pairs, by rows or names. The default is `Assembly.pairs`.

    Returns
    -------
    (k,) or (b, k) array
        Distances of the pairs in the dtype of `poses`, world units, negative where bodies overlap.

    Raises
    ------
    Error
        If JAX is not installed.
    ArgumentError
        As for :meth:`fieldbake.Assembly.clearance`.

    Notes
    -----
    The derivatives are the same as in :func:`fieldbake.torch.assembly_clearance`. Only reverse mode is provided.

    Examples
    --------
    >>> import jax
    >>> import fieldbake as fb
    >>> from fieldbake.jax import assembly_clearance, assembly_poses
    >>> slide = fb.Joint("slide", "prismatic", "a", "b", axis=(0, 0, 1))
    >>> pair = fb.Assembly({"a": fb.sphere(1), "b": fb.sphere(1)}, [slide])
    >>> gap = lambda values: assembly_clearance(pair, assembly_poses(pair, values), [("a", "b")])[0]
    >>> jax.grad(gap)(jax.numpy.array([3.0])).tolist()
    [1.0]
    """
    return _clearance_function()(
        assembly, tuple(assembly._chosen_pairs(pairs)), _floats("poses", poses, "(..., n, 4, 4)")
    )


def _array(name: str, value: Any, shape: str, error: type[Error] = ArgumentError) -> Any:
    """Convert to an array of JAX, and check its shape, which JAX has also while it traces a function."""
    numbers = optional_module("jax", "fieldbake.jax", extra="jax").numpy
    try:
        array = numbers.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{name}: must be an array of shape {shape}, got {checks.describe(value)}") from None
    check_shape(name, array, shape, error)
    return array


def _floats(name: str, value: Any, shape: str, error: type[Error] = ArgumentError) -> Any:
    """Convert to an array of floats that NumPy has: float32 for bfloat16, and the default type for integers."""
    numbers = optional_module("jax", "fieldbake.jax", extra="jax").numpy
    array = _array(name, value, shape, error)
    is_float = numbers.issubdtype(array.dtype, numbers.floating)
    if not is_float and not numbers.issubdtype(array.dtype, numbers.integer):
        raise error(f"{name}: must hold real numbers, got dtype {array.dtype}")
    return array if array.dtype.kind == "f" else array.astype(numbers.float32 if is_float else float)


def _on_host(function: Callable[..., Any], result: tuple[Any, ...], *arrays: Any) -> Any:
    """Evaluate a function of NumPy arrays: by a callback while JAX traces, otherwise now, so its errors are plain."""
    jax = optional_module("jax", "fieldbake.jax", extra="jax")

    def evaluate(*arrays: Any) -> Any:
        return function(*map(np.asarray, arrays))

    if any(isinstance(array, jax.core.Tracer) for array in arrays):
        return jax.pure_callback(evaluate, result, *arrays, vmap_method="sequential")
    return tuple(map(jax.numpy.asarray, evaluate(*arrays)))


@cache
def _clearance_function() -> Any:
    """The function of :func:`assembly_clearance` with its reverse-mode derivative."""
    jax = optional_module("jax", "fieldbake.jax", extra="jax")

    def evaluate(assembly: Assembly, pairs: RowPairs, poses: Any) -> Any:
        shape = (*poses.shape[:-3], len(pairs))
        result = tuple(jax.ShapeDtypeStruct((*shape, *rest), poses.dtype) for rest in ((), (2, 3, 4)))

        def on_host(poses: Any) -> Any:
            return linearize_clearance(assembly, poses, pairs)

        return _on_host(on_host, result, poses)

    @partial(jax.custom_vjp, nondiff_argnums=(0, 1))
    def distance(assembly: Assembly, pairs: RowPairs, poses: Any) -> Any:
        return evaluate(assembly, pairs, poses)[0]

    def forward(assembly: Assembly, pairs: RowPairs, poses: Any) -> Any:
        distances, slopes = evaluate(assembly, pairs, poses)
        return distances, (slopes, poses)

    def backward(_: Assembly, pairs: RowPairs, kept: Any, change: Any) -> Any:
        slopes, poses = kept
        of_rows = (change[..., None, None, None] * slopes).reshape(*poses.shape[:-3], 2 * len(pairs), 3, 4)
        rows = np.array(pairs, dtype=np.int64).ravel()
        return (jax.numpy.zeros_like(poses).at[..., rows, :3, :].add(of_rows),)

    distance.defvjp(forward, backward)
    return distance


@cache
def _assembly_function() -> Any:
    """The function of :func:`assembly_distance` with its reverse-mode derivative."""
    jax = optional_module("jax", "fieldbake.jax", extra="jax")

    def evaluate(assembly: Assembly, poses: Any, points: Any) -> Any:
        shape, kind = (*poses.shape[:-3], *points.shape[:-1]), points.dtype
        result = (
            jax.ShapeDtypeStruct(shape, kind),
            jax.ShapeDtypeStruct((*shape, 3), kind),
            jax.ShapeDtypeStruct(shape, jax.numpy.int32),
            jax.ShapeDtypeStruct((*shape, 4), poses.dtype),
        )

        def on_host(poses: Any, points: Any) -> Any:
            found = linearize_assembly(assembly, poses, points)
            return (
                found.distances,
                found.gradients,
                found.bodies.astype(np.int32),
                found.local.astype(poses.dtype),
            )

        return _on_host(on_host, result, poses, points)

    @partial(jax.custom_vjp, nondiff_argnums=(0,))
    def distance(assembly: Assembly, poses: Any, points: Any) -> Any:
        return evaluate(assembly, poses, points)[0]

    def forward(assembly: Assembly, poses: Any, points: Any) -> Any:
        distances, *rest = evaluate(assembly, poses, points)
        return distances, (*rest, poses, points)

    def backward(_: Assembly, kept: Any, change: Any) -> Any:
        gradients, bodies, local, poses, points = kept
        along = change[..., None] * gradients
        lead = poses.shape[:-3]
        of_rows = (-along[..., :, None] * local[..., None, :]).astype(poses.dtype).reshape(*lead, -1, 3, 4)
        rows = bodies.reshape(*lead, -1)
        of_poses = jax.numpy.zeros_like(poses)
        if lead:
            numbers = jax.numpy.arange(lead[0])[:, None]
            of_poses = of_poses.at[numbers, rows, :3].add(of_rows)
            along = along.sum(axis=0)
        else:
            of_poses = of_poses.at[rows, :3].add(of_rows)
        return of_poses, along.reshape(points.shape).astype(points.dtype)

    distance.defvjp(forward, backward)
    return distance


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
            found = linearize(vertices, faces, points, mesh)
            return found.distances, found.gradients, found.corners.astype(np.int32), found.weights

        return _on_host(on_host, result, vertices, faces, points)

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
