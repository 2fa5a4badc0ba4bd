"""The geometry of a body in a form that the core searches: triangles, or a closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, Error
from ..meshes.convert import as_mesh
from ..meshes.mesh import Mesh
from ..shapes.shape import Shape
from ..volumes.grid_field import GridField

#: A geometry, or a sequence of geometries with their transforms to the body.
BodyLike = Any

#: Largest deviation of a rigid transform from an orthonormal matrix, and from determinant 1.
RIGID = 1e-6


def searchable(geometry: Any, resolution: int) -> tuple[Mesh | Shape, float]:
    """Convert any geometry to a mesh or an exact shape.

    Parameters
    ----------
    geometry : Mesh, Shape, volume, or anything that `as_mesh` takes
        An exact shape stays a closed form. Another shape, and a volume, becomes its closed mesh.
    resolution : int
        Voxels along the longest side of the closed mesh of a shape.

    Returns
    -------
    (Mesh or Shape, float)
        The geometry, and the largest value of the source's field on the closed mesh, at vertices and centres of faces;
        0 for geometry that is not converted.
    """
    if isinstance(geometry, Shape):
        if geometry.exact:
            return geometry, 0.0
        mesh = geometry.to_mesh(resolution, progress=False)
        deviation = _deviation(mesh, geometry.distance)
        mesh._source = geometry, deviation
        return mesh, deviation
    if isinstance(geometry, GridField):
        mesh = geometry.to_mesh(progress=False)
        return mesh, _deviation(mesh, geometry.sample)
    if hasattr(geometry, "body_names"):
        raise ArgumentError(
            f"must be one solid, got {checks.describe(geometry)}; its method clearance(poses, environment=solid) "
            "compares its bodies with a solid"
        )
    return as_mesh(geometry), 0.0


def _deviation(mesh: Mesh, field: Any) -> float:
    if not len(mesh.faces):
        raise ArgumentError("the geometry has no surface at this resolution; raise shape_resolution")
    points = np.concatenate([mesh.vertices, mesh.vertices[mesh.faces].mean(axis=1)])
    return float(np.abs(field(points)).max())


#: The arguments of an element of `_core.Bodies`.
CoreElement = tuple[int, _core.Mesh | _core.Shape, list[list[float]], float, tuple[_core.Shape, float] | None]


def core_element(
    body: int,
    geometry: Mesh | Shape,
    transform: NDArray[np.float64],
    scale: float = 1.0,
    *,
    with_source: bool = False,
) -> CoreElement:
    """Make an element of `_core.Bodies`; `transform` is body-from-geometry.

    With `with_source` it has the shape whose triangles the geometry is, which a clearance needs.
    """
    source = geometry._source if with_source and isinstance(geometry, Mesh) else None
    return body, geometry._core, transform.tolist(), scale, source and (source[0]._core, source[1])


def rigid(name: str, value: Any, error: type[Error] = ArgumentError) -> NDArray[np.float64]:
    """Check one rigid transform (4, 4)."""
    transform = checks.matrix(name, value, (4, 4), error)
    check_rigid(name, transform, error)
    return transform


def check_rigid(name: str, transforms: NDArray[np.float64], error: type[Error] = ArgumentError) -> None:
    """Raise an error that names the first transform of (..., 4, 4) that is not rigid. NaN is not rigid."""
    turn = transforms[..., :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        deviation = np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max(axis=(-1, -2), initial=0)
        handed = np.abs(np.linalg.det(turn) - 1) <= RIGID
    last = np.abs(transforms[..., 3, :] - (0, 0, 0, 1)).max(axis=-1, initial=0)
    finite = np.isfinite(transforms).all(axis=(-1, -2))
    good = (deviation <= RIGID) & handed & (last <= RIGID) & finite
    if not good.all():
        row = tuple(np.argwhere(~good)[0].tolist())
        place = f"{name}[{', '.join(map(str, row))}]" if row else name
        raise error(f"{place}: must be a rotation and a translation, got {transforms[row].tolist()}")


def elements_of(
    where: str, body: BodyLike, resolution: int
) -> tuple[tuple[tuple[Mesh | Shape, NDArray[np.float64]], ...], float]:
    """The geometries of a body with their transforms, and the largest deviation of converted ones."""
    made, worst = [], 0.0
    for i, (geometry, transform) in enumerate(_listed(body)):
        item = f"{where}[{i}]"
        place = checks.frozen(np.eye(4) if transform is None else rigid(item, transform))
        try:
            source, deviation = searchable(geometry, resolution)
        except Error as error:
            raise type(error)(f"{item}: {error}") from error
        made.append((source, place))
        worst = max(worst, deviation)
    return tuple(made), worst


def _listed(body: BodyLike) -> list[tuple[Any, Any]]:
    """A body as pairs of a geometry and a transform, which may be None."""

    def is_placed(item: Any) -> bool:
        return isinstance(item, tuple) and len(item) == 2 and np.shape(item[1]) == (4, 4)

    if is_placed(body):
        return [body]
    is_arrays = isinstance(body, tuple) and len(body) == 2 and np.ndim(body[0]) == 2  # (vertices, faces)
    if isinstance(body, (tuple, list)) and not is_arrays:
        return [item if is_placed(item) else (item, None) for item in body]
    return [(body, None)]
