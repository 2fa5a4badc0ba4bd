"""An instance: an object with its transform, material and visibility in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..atlases.atlas import AtlasEntry
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.former_names import former_names
from ..merging.nested import NestedField
from ..meshes.convert import as_mesh
from ..meshes.mesh import Mesh
from ..scaling.stores.zarr_volume import ZarrVolume
from ..shapes.quadric import Quadric, bounds_of, check_quadrics, is_quadrics
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume, plain_field
from .materials import Material

#: Objects that a scene can hold. Meshes are rasterised; rays find the hits of the others.
Geometry = Mesh | Volume | SparseVolume | NestedField | AtlasEntry | Shape | tuple[Quadric, ...]

#: Voxels along the longest side of a mesh instance's field.
INSTANCE_RESOLUTION = 64


@former_names(thing="geometry")
@dataclass(frozen=True, eq=False)
class Instance:
    """An object in a scene.

    Parameters
    ----------
    geometry : Mesh, Volume, SparseVolume, NestedField, ``atlas[i]``, Shape, Quadric, list of Quadric, or any mesh
        A mesh is rasterised, and rays of light and of occlusion intersect its triangles. Its soft shadow comes from its
        distance field, which is baked when needed and kept. For a flat or thin mesh, an open sheet and a mesh with a
        mask or a translucent texture it comes from its triangles. Rays intersect all other objects directly: a volume
        at the roots of its cells, a shape at the roots of its parts (``fb.bake(shape)`` makes a volume of it), a
        quadric in closed form. The quadrics of a list are one object.
    transform : (4, 4), optional
        World from the object's own coordinates: any affine map that has an inverse. The default is the identity, or the
        model matrix of an atlas entry.
    material : Material, optional
        The default is the object's own material, which also supplies a missing colour: the colours and textures of a
        mesh, the paint of a shape, the reflectance of a quadric. Objects without a colour are light grey.
    casts_shadow : bool, default True
        Whether the instance casts shadows and occludes ambient light.
    visible : bool, default True
        Whether the instance is visible to the camera.
    opacity : float, default 1
        Fraction of the light that the instance blocks, for the camera and for shadows. For a quadric it multiplies
        `Quadric.opacity`, which applies to shadows only.
    resolution : int, default 64
        Voxels along the longest side of the field of a mesh.

    Raises
    ------
    SceneError
        For a transform without an inverse or a value out of range.
    ShapeError
        For a shape without bounds; the message names the leaf.
    MeshError
        If the object contains no usable mesh.

    Examples
    --------
    >>> import fieldbake as fb
    >>> move = np.eye(4)
    >>> move[:3, 3] = 0, 1, 0
    >>> fb.Instance(fb.models.gear(teeth=6), transform=move).bounds.round(3).tolist()
    [[-0.995, 0.005, -0.175], [0.995, 1.995, 0.175]]
    """

    geometry: Any
    transform: ArrayLike | None = None
    material: Material | None = None
    casts_shadow: bool = True
    visible: bool = True
    opacity: float = 1.0
    resolution: int = INSTANCE_RESOLUTION

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        usual = self.geometry.transform if isinstance(self.geometry, AtlasEntry) else np.eye(4)
        matrix = usual if self.transform is None else checks.affine("transform", self.transform, SceneError)
        put("transform", checks.frozen(matrix))
        if self.material is not None and not isinstance(self.material, Material):
            raise SceneError(f"material: must be a Material, got {checks.describe(self.material)}")
        try:
            put("casts_shadow", checks.flag("casts_shadow", self.casts_shadow))
            put("visible", checks.flag("visible", self.visible))
            put("opacity", checks.number("opacity", self.opacity, least=0))
        except ArgumentError as error:
            raise SceneError(str(error)) from None
        if self.opacity > 1:
            raise SceneError(f"opacity: must be from 0 to 1, got {self.opacity:g}")
        put("resolution", checks.integer("resolution", self.resolution, least=4, most=1024, error=SceneError))
        put("geometry", _geometry(self.geometry))

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around the surface, (2, 3), world units."""
        return placed_bounds(box_of(self.geometry)[None], np.asarray(self.transform)[None])

    def __repr__(self) -> str:
        return f"Instance({self.geometry!r})"


def _geometry(geometry: Any) -> Geometry:
    """Convert an object to a form that the core can draw."""
    geometry = plain_field(geometry)
    if isinstance(geometry, Shape):
        # A shape without bounds raises an error that names the leaf.
        _ = geometry.bounds
        return geometry
    if isinstance(geometry, ZarrVolume):
        return geometry.picture_field()
    if isinstance(geometry, (Mesh, Volume, SparseVolume, NestedField, AtlasEntry)):
        return geometry
    return tuple(check_quadrics(geometry)) if is_quadrics(geometry) else as_mesh(geometry)


def box_of(geometry: Geometry) -> NDArray[np.float64]:
    """Box around the surface, (2, 3), in the object's own coordinates."""
    if isinstance(geometry, tuple):
        return bounds_of(geometry)
    return geometry.bounds if isinstance(geometry, (Mesh, Shape)) else geometry.inner_bounds


#: Rows of the corners of a box (lower, upper) in each coordinate.
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def placed_bounds(boxes: NDArray[np.float64], transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Box, (2, 3), around the boxes (n, 2, 3) under the transforms (n, 4, 4), world units."""
    corners = boxes[:, _CORNERS, np.arange(3)]
    placed = corners @ np.swapaxes(transforms[:, :3, :3], 1, 2) + transforms[:, None, :3, 3]
    return np.stack([placed.min(axis=(0, 1)), placed.max(axis=(0, 1))])
