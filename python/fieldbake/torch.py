"""Signed distances and samples that PyTorch can differentiate. Needs the extra ``fieldbake[torch]``.

The functions run on the CPU. Tensors of other devices are copied to it, and results are copied back.

>>> from fieldbake.torch import signed_distance  # doctest: +SKIP
>>> vertices.requires_grad_()                    # doctest: +SKIP
>>> loss = (signed_distance(vertices, faces, points) - target).square().mean()  # doctest: +SKIP
>>> loss.backward()                              # doctest: +SKIP
"""

from __future__ import annotations

from functools import cache
from typing import Any

from .assemblies.assembly import Assembly
from .assemblies.derivatives import linearize_assembly, linearize_clearance, pose_changes
from .base.optional import optional_module
from .meshes.mesh import Mesh
from .queries.derivatives import check_shape, interpolate, linearize, vertex_changes

__all__ = ["assembly_clearance", "assembly_distance", "assembly_poses", "sample", "signed_distance"]


def signed_distance(vertices: Any, faces: Any, points: Any, mesh: Mesh | None = None) -> Any:
    """Evaluate the signed distance of a mesh, differentiable in vertices and points.

    Parameters
    ----------
    vertices : (n, 3) tensor of floats
        Positions, world units.
    faces : (m, 3) tensor of integers
        Rows of `vertices`.
    points : (..., 3) tensor of floats
        World positions.
    mesh : Mesh, optional
        A mesh of the same vertices and faces, whose search tree is used. Without it a tree is built at every call. Its
        vertices are compared after rounding to the dtype of `vertices`.

    Returns
    -------
    (...) tensor
        Signed distances in the dtype and on the device of `points`, world units, negative inside. They are float64 for
        integers.

    Raises
    ------
    Error
        If PyTorch is not installed.
    MeshError, ArgumentError
        As for :func:`fieldbake.query`; ArgumentError also for a `mesh` of other vertices or faces.

    Notes
    -----
    With the unit gradient g of the distance at a point p, and the weights b of its closest point on the nearest face,
    the derivatives are ``g`` with respect to p and ``-b[k] * g`` with respect to corner k of that face. They are
    the exact first derivatives wherever the closest point is unique. On the medial axis, where several points are
    equally near, the distance has a kink; the derivative of one of its sides is returned. Second derivatives are not
    provided.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import fieldbake as fb
    >>> from fieldbake.torch import signed_distance
    >>> mesh = fb.models.gear()
    >>> point = torch.tensor([[0.7, 0.0, 1.0]], requires_grad=True)  # doctest: +SKIP
    >>> signed_distance(torch.tensor(mesh.vertices), torch.tensor(mesh.faces), point).backward()  # doctest: +SKIP
    """
    return _distance_function().apply(vertices, faces, points, mesh)


def sample(distances: Any, bounds: Any, points: Any) -> Any:
    """Sample a grid of distances trilinearly, differentiable in distances, bounds and points.

    Parameters
    ----------
    distances : (nx, ny, nz) tensor of floats
        Samples at voxel centres, as `Volume.distances`.
    bounds : (2, 3) tensor of floats
        Lower and upper corner of the box, world units, as `Volume.bounds`.
    points : (..., 3) tensor of floats
        World positions. A position outside the box of the outermost samples is replaced by the nearest one in it.

    Returns
    -------
    (...) tensor
        Trilinear values; equal to `Volume.sample` between the samples.

    Raises
    ------
    Error
        If PyTorch is not installed.
    ArgumentError
        For an array of a wrong shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import fieldbake as fb
    >>> from fieldbake.torch import sample
    >>> volume = fb.bake(fb.sphere(), 32)
    >>> distances = torch.tensor(volume.distances, requires_grad=True)  # doctest: +SKIP
    >>> sample(distances, volume.bounds, torch.zeros(1, 3)).sum().backward()  # doctest: +SKIP
    """
    torch = optional_module("torch", "fieldbake.torch", extra="torch")
    distances, bounds, points = (torch.as_tensor(value) for value in (distances, bounds, points))
    check_shape("distances", distances, "(nx, ny, nz)")
    check_shape("bounds", bounds, "(2, 3)")
    check_shape("points", points, "(..., 3)")
    shape = torch.tensor(distances.shape, dtype=points.dtype, device=points.device)
    grid = (points - bounds[0]) / (bounds[1] - bounds[0]) * shape - 0.5
    grid = torch.minimum(torch.clamp(grid, min=0), shape - 1)
    low = torch.minimum(grid.detach().floor().long(), torch.clamp(shape.long() - 2, min=0))
    high = torch.minimum(low + 1, shape.long() - 1)
    return interpolate(distances, grid, low, high)


def assembly_poses(assembly: Assembly, values: Any) -> Any:
    """Compute the poses of all bodies of an assembly, differentiable in the joint values.

    Parameters
    ----------
    assembly : Assembly
        Bodies and joints.
    values : (..., m) tensor of floats
        Joint values in the order of `Assembly.joint_names`.

    Returns
    -------
    (..., n, 4, 4) tensor
        World-from-body poses in the dtype and on the device of `values`, as :meth:`fieldbake.Assembly.poses`.

    Raises
    ------
    Error
        If PyTorch is not installed.
    ArgumentError
        For a wrong number of values.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> from fieldbake.torch import assembly_distance, assembly_poses
    >>> values = torch.zeros(7, dtype=torch.float64, requires_grad=True)  # doctest: +SKIP
    >>> assembly_distance(robot, assembly_poses(robot, values), points).sum().backward()  # doctest: +SKIP
    """
    torch = optional_module("torch", "fieldbake.torch", extra="torch")
    return assembly._forward(torch.as_tensor(values), torch)


def assembly_distance(assembly: Assembly, poses: Any, points: Any) -> Any:
    """Evaluate the smallest signed distance over the bodies, differentiable in poses and points.

    Parameters
    ----------
    assembly : Assembly
        Bodies with their geometry.
    poses : (n, 4, 4) or (b, n, 4, 4) tensor of floats
        Rigid world-from-body poses, in float64 or orthonormal to 1e-6.
    points : (..., 3) tensor of floats
        World positions, the same for each configuration.

    Returns
    -------
    (...) or (b, ...) tensor
        Signed distances in the dtype and on the device of `points`, world units, negative inside.

    Raises
    ------
    Error
        If PyTorch is not installed.
    ArgumentError
        As for :meth:`fieldbake.Assembly.query`.

    Notes
    -----
    With the unit gradient g at a point p, and the closest point y in the frame of its body with the pose T, the
    derivatives are ``g`` with respect to p and ``-outer(g, (y, 1))`` with respect to the upper rows of T. On the medial
    axis the derivative of one of its sides is returned.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import fieldbake as fb
    >>> from fieldbake.torch import assembly_distance
    >>> ball = fb.Assembly({"ball": fb.sphere(1)})
    >>> point = torch.tensor([[0.0, 0.0, 3.0]], requires_grad=True)  # doctest: +SKIP
    >>> assembly_distance(ball, torch.eye(4)[None], point).sum().backward()  # doctest: +SKIP
    """
    return _assembly_function().apply(assembly, poses, points)


def assembly_clearance(assembly: Assembly, poses: Any, pairs: Any = None) -> Any:
    """Evaluate the clearances of pairs of bodies, differentiable in poses.

    Parameters
    ----------
    assembly : Assembly
        Bodies with their geometry.
    poses : (n, 4, 4) or (b, n, 4, 4) tensor of floats
        Rigid world-from-body poses, in float64 or orthonormal to 1e-6.
    pairs : (k, 2) of int or str, optional
        The pairs, by rows or names. The default is `Assembly.pairs`.

    Returns
    -------
    (k,) or (b, k) tensor
        Distances of the pairs in the dtype and on the device of `poses`, world units, negative where bodies overlap.

    Raises
    ------
    Error
        If PyTorch is not installed.
    ArgumentError
        As for :meth:`fieldbake.Assembly.clearance`.

    Notes
    -----
    With the unit normal n from the second body to the first, and the nearest points x and y in the frames of their
    bodies, the derivatives by the upper rows of both poses are ``outer(n, (x, 1))`` and ``-outer(n, (y, 1))``. They are
    exact for separate bodies with one pair of nearest points. For overlapping bodies they are exact where the largest
    ball of the overlap touches each surface at one point, and the value has the error of
    :meth:`fieldbake.Assembly.clearance`.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> from fieldbake.torch import assembly_clearance, assembly_poses
    >>> values = torch.zeros(7, dtype=torch.float64, requires_grad=True)  # doctest: +SKIP
    >>> assembly_clearance(robot, assembly_poses(robot, values)).min().backward()  # doctest: +SKIP
    """
    torch = optional_module("torch", "fieldbake.torch", extra="torch")
    return _clearance_function().apply(assembly, assembly._chosen_pairs(pairs), torch.as_tensor(poses))


@cache
def _clearance_function() -> Any:
    """The autograd function of :func:`assembly_clearance`."""
    torch = optional_module("torch", "fieldbake.torch", extra="torch")

    class AssemblyClearance(torch.autograd.Function):  # type: ignore[misc, name-defined]
        @staticmethod
        def forward(context: Any, assembly: Assembly, pairs: list[tuple[int, int]], poses: Any) -> Any:
            distances, slopes = (
                torch.from_numpy(array).to(poses.device)
                for array in linearize_clearance(assembly, poses.detach().cpu().numpy(), pairs)
            )
            context.save_for_backward(slopes)
            context.rows = [row for pair in pairs for row in pair]
            context.shape = poses.shape
            return distances

        @staticmethod
        def backward(context: Any, change: Any) -> Any:
            (slopes,) = context.saved_tensors
            of_rows = (change[..., None, None, None] * slopes).reshape(*context.shape[:-3], len(context.rows), 3, 4)
            of_poses = torch.zeros(context.shape, dtype=change.dtype, device=change.device)
            rows = torch.tensor(context.rows, dtype=torch.long, device=change.device)
            of_poses[..., :3, :].index_add_(-3, rows, of_rows)
            return None, None, of_poses

    return AssemblyClearance


@cache
def _assembly_function() -> Any:
    """The autograd function of :func:`assembly_distance`."""
    torch = optional_module("torch", "fieldbake.torch", extra="torch")

    class AssemblyDistance(torch.autograd.Function):  # type: ignore[misc, name-defined]
        @staticmethod
        def forward(context: Any, assembly: Assembly, poses: Any, points: Any) -> Any:
            arrays = [torch.as_tensor(value).detach().cpu().numpy() for value in (poses, points)]
            found = linearize_assembly(assembly, *arrays)
            context.found = found
            context.poses = (poses.dtype, poses.device)
            context.points_shape = points.shape
            return torch.from_numpy(found.distances).to(points.device)

        @staticmethod
        def backward(context: Any, change: Any) -> Any:
            of_poses, of_points = pose_changes(context.found, change.detach().cpu().numpy())
            dtype, device = context.poses
            of_points = torch.from_numpy(of_points.reshape(context.points_shape)).to(change.device)
            return None, torch.from_numpy(of_poses).to(dtype=dtype, device=device), of_points

    return AssemblyDistance


@cache
def _distance_function() -> Any:
    """The autograd function of :func:`signed_distance`."""
    torch = optional_module("torch", "fieldbake.torch", extra="torch")

    class SignedDistance(torch.autograd.Function):  # type: ignore[misc, name-defined]
        @staticmethod
        def forward(context: Any, vertices: Any, faces: Any, points: Any, mesh: Mesh | None) -> Any:
            arrays = [torch.as_tensor(value).detach().cpu().numpy() for value in (vertices, faces, points)]
            found = linearize(arrays[0], arrays[1], arrays[2], mesh)
            tensors = (torch.from_numpy(value).to(points.device) for value in found)
            distances, gradients, corners, weights = tensors
            context.save_for_backward(gradients, corners, weights)
            context.vertices = (vertices.shape, vertices.dtype, vertices.device)
            return distances

        @staticmethod
        def backward(context: Any, change: Any) -> Any:
            gradients, corners, weights = context.saved_tensors
            per_point = change[..., None] * gradients
            of_vertices = of_points = None
            if context.needs_input_grad[0]:
                shape, dtype, device = context.vertices
                of_corners = vertex_changes(weights, per_point)
                of_vertices = torch.zeros(shape, dtype=per_point.dtype, device=per_point.device)
                of_vertices.index_add_(0, corners.reshape(-1), of_corners.reshape(-1, 3))
                of_vertices = of_vertices.to(dtype=dtype, device=device)
            if context.needs_input_grad[2]:
                of_points = per_point
            return of_vertices, None, of_points, None

    return SignedDistance


def __dir__() -> list[str]:
    return sorted(__all__)
