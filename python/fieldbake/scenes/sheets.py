"""Detection of sheets: meshes whose soft shadows come from their triangles instead of a distance field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.grid import make_grid
from ..meshes.mesh import Mesh
from ..meshes.part import Part
from ..queries.rays import cast_rays
from ..queries.sampling import sample_surface
from .materials import DEFAULT_MATERIAL, PLAIN, Material

#: A mesh is flat if it deviates from a plane by less than this fraction of its extent.
FLAT = 1e-6

#: An open mesh is a sheet if the sum of the area vectors of its faces is longer than this fraction of its area. The sum
#: is zero for a closed surface, the area of the hole for a surface with a flat hole, and the whole area for a flat
#: sheet.
SHEET_SHARE = 0.1

#: A wall is thin if the path through it has fewer voxels. Samples may miss a wall of one voxel at some angles.
THIN_VOXELS = 1.5

#: Number of samples of a surface that measure its walls, and the largest cosine between the normals of both sides of a
#: wall.
WALL_SAMPLES = 1000
FACING = -0.5

#: Fraction of a surface that may be thin before its field loses parts: the tips and edges of an ordinary solid. An open
#: surface has no certain inside, so more of it may seem thin.
THIN_SHARE = 0.003
THIN_SHARE_OPEN = 0.02


class Appearance(NamedTuple):
    """The appearance of a part of a mesh under the material of its instance."""

    color: Sequence[float]
    texture: NDArray[np.uint8] | None
    alpha_mode: str
    alpha_cutoff: float
    two_sided: bool
    emission: Sequence[float]
    emission_texture: NDArray[np.uint8] | None
    unlit: bool

    @classmethod
    def of(cls, material: Material | None, part: Part, is_colored: bool = False) -> Appearance:
        """Combine a material with a part. `is_colored` states that the mesh has colours of its vertices or faces."""
        material = material or DEFAULT_MATERIAL
        color: Sequence[float] = part.color
        texture, mode = part.texture, part.alpha_mode
        emission: Sequence[float] = part.emission
        emission_texture = part.emission_texture
        if texture is None and part.color == (1.0, 1.0, 1.0, 1.0) and not (part.name or is_colored):
            color = PLAIN
        if material.color is not None or material.texture is not None:
            color = material.color or (1.0, 1.0, 1.0, 1.0)
            texture, mode = material.texture, "opaque" if color[3] >= 1 else "blend"
            emission, emission_texture = (0.0, 0.0, 0.0), None
        if material.emission is not None:
            emission, emission_texture = material.emission, None
        return cls(
            color,
            texture,
            material.alpha_mode or mode,
            part.alpha_cutoff if material.alpha_cutoff is None else material.alpha_cutoff,
            part.two_sided if material.two_sided is None else material.two_sided,
            emission,
            emission_texture,
            part.unlit if material.unlit is None else material.unlit,
        )

    @property
    def opacity(self) -> NDArray[np.float32]:
        """Opacity of the texture times the opacity of the colour, (h, w) from 0 to 1."""
        stored = np.full((1, 1), 255, dtype=np.uint8) if self.texture is None else self.texture[..., 3]
        opacity: NDArray[np.float32] = stored.astype(np.float32) / np.float32(255) * np.float32(self.color[3])
        return opacity

    @property
    def mask(self) -> NDArray[np.bool_] | None:
        """Texels that an alpha mask keeps, (h, w); None if nothing is cut out."""
        if self.alpha_mode != "mask":
            return None
        kept = self.opacity >= self.alpha_cutoff
        return None if kept.all() else kept


class Sheet(NamedTuple):
    """Treatment of a mesh by light and by the camera."""

    #: Cones of light intersect the triangles, because a field would be too thick or has no opacity.
    is_traced: bool
    #: Both sides of the faces are visible to the camera, unless the material says otherwise.
    is_two_sided: bool
    #: The mesh blocks its fraction of the light once, however many faces a ray crosses.
    is_solid: bool = False


#: A solid, or an object without triangles.
NO_SHEET = Sheet(is_traced=False, is_two_sided=False, is_solid=True)


def sheet_of(mesh: Mesh, appearances: Sequence[Appearance]) -> Sheet:
    """Decide whether a mesh whose parts have these appearances is a sheet."""
    is_flat = _is_flat(mesh)
    is_masked = any(appearance.mask is not None for appearance in appearances)
    is_open = not is_flat and not mesh.topology()["closed"]
    is_two_sided = any(appearance.two_sided for appearance in appearances)
    if is_flat or is_masked or (is_open and is_two_sided):
        return Sheet(True, True)
    translucent = [
        appearance for appearance in appearances if appearance.alpha_mode == "blend" and appearance.opacity.min() < 1
    ]
    # A single opacity of a whole solid is the opacity of its field.
    is_uniform = (
        len(translucent) == len(appearances)
        and len({appearance.color[3] for appearance in appearances}) == 1
        and all(appearance.texture is None for appearance in appearances)
    )
    is_translucent = bool(translucent) and (is_open or is_two_sided or not is_uniform)
    is_traced = is_translucent or (is_open and _net_area_share(mesh) > SHEET_SHARE)
    is_reversed = not is_open and not translucent and mesh._core.has_reversed_body()
    # A closed body that is wound inside out is the same solid. Its faces are visible from behind. The wall of a cavity
    # counts as such a body too; this differs only for a camera inside the wall.
    return Sheet(is_traced, is_reversed, is_solid=not is_traced)


def needed_resolution(mesh: Mesh, resolution: int) -> int | None:
    """Return the resolution of a field that has the thin walls of a mesh; None if `resolution` has them.

    Rays from samples of the surface through the inside measure the walls. The samples depend on the faces and not on
    their orientation in space. The result has at least nine of ten thin walls.
    """
    voxel = max(make_grid(mesh.bounds, resolution).spacing)
    samples = sample_surface(mesh, WALL_SAMPLES)
    start, end = 1e-9 * resolution * voxel, THIN_VOXELS * voxel
    walls = np.full(WALL_SAMPLES, np.inf)
    # The inside of a body that is wound inside out is where its normals point.
    for sign in (-1.0, 1.0) if mesh._core.has_reversed_body() else (-1.0,):
        hits = cast_rays(mesh, samples.points, sign * samples.normals, t_min=start, t_max=end, device="cpu")
        is_wall = hits.hit & (np.einsum("ij,ij->i", hits.normals, samples.normals) < FACING)
        walls[is_wall] = np.minimum(walls, hits.t)[is_wall]
    thin = walls[np.isfinite(walls)]
    share = THIN_SHARE if mesh.topology()["closed"] else THIN_SHARE_OPEN
    return math.ceil(resolution * end / float(np.quantile(thin, 0.1))) if len(thin) > share * WALL_SAMPLES else None


def _is_flat(mesh: Mesh) -> bool:
    """Whether a mesh lies in a plane, at any angle."""
    offsets = mesh.vertices.astype(np.float64) - mesh.bounds.mean(axis=0)
    offsets -= offsets.mean(axis=0)
    least, _, most = np.linalg.eigvalsh(offsets.T @ offsets)
    return bool(max(least, 0.0) <= FLAT**2 * most)


def _net_area_share(mesh: Mesh) -> float:
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(vectors, axis=1).sum())
    return float(np.linalg.norm(vectors.sum(axis=0))) / area if area > 0 else 0.0
