"""The Rust core. Private: use :mod:`fieldbake` or :mod:`fieldbake.arrays`.

The Python layer passes C-contiguous arrays and checks their dtype and shape; values are checked here. Every function
releases the GIL, stops on Ctrl-C and raises the exceptions of :mod:`fieldbake.base.errors`.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypedDict, final, type_check_only

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Bodies",
    "DeviceField",
    "DevicePages",
    "Mesh",
    "OuterSides",
    "PointCloud",
    "Renderer",
    "Scene",
    "SceneField",
    "SceneMesh",
    "Shape",
    "SparseField",
    "Surface",
    "SurfaceBlocks",
    "Sweep",
    "Texture",
    "__version__",
    "all_intersections",
    "atlas_clear",
    "atlas_entries",
    "atlas_pack_device",
    "atlas_plan",
    "atlas_read",
    "atlas_sample",
    "atlas_shader",
    "atlas_sound",
    "atlas_texture_coordinates",
    "atlas_write",
    "bake",
    "bake_blocks",
    "bake_brute",
    "bake_cloud_sparse",
    "bake_sparse",
    "bake_update",
    "bake_window",
    "cast_rays",
    "check_scales",
    "closest_point",
    "combined_polygons",
    "contains",
    "count_intersections",
    "decode",
    "devices",
    "divide_obj_polygons",
    "encode",
    "encoding_scale",
    "exr_read",
    "gradient",
    "merge",
    "occluded",
    "offset_polygons",
    "orient",
    "query",
    "raymarch",
    "read_obj",
    "refined",
    "require_memory",
    "resample",
    "resolved_polygons",
    "sample",
    "sample_surface",
    "set_threads",
    "shader_library",
    "sides_of_balls",
    "signed_distance",
    "signed_distance_float64",
    "thickness",
    "to_sparse",
    "viewer_shader",
    "viewer_triangles",
    "watch",
    "winding_number",
]

__version__: str

@final
class Mesh:
    """Checked triangles; the search tree is built at the first query and kept."""

    def __new__(cls, vertices: NDArray[np.float64], faces: NDArray[np.uint32 | np.int64]) -> Mesh:
        """``vertices`` (n, 3), ``faces`` (m, 3). Raises MeshError naming the array, index and value."""
    @property
    def vertices(self) -> NDArray[np.float64]:
        """World positions of the kept vertices, equal to the input, (n, 3), a read-only view."""
    @property
    def faces(self) -> NDArray[np.uint32]:
        """Kept triangles, (m, 3), indices into ``vertices``."""
    @property
    def source_vertices(self) -> NDArray[np.int64] | None:
        """Input row of each kept vertex, (n,); None if all were kept."""
    @property
    def source_faces(self) -> NDArray[np.int64] | None:
        """Input row of each kept face, (m,); None if all were kept."""
    @property
    def center(self) -> NDArray[np.float64]:
        """Origin of local coordinates, near the centre of the box; the core stores float32 offsets from it, (3,)."""
    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner, (2, 3)."""
    @property
    def nbytes(self) -> int:
        """Memory of vertices, faces and the tree once it is built, bytes."""
    def state(self) -> tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.uint32] | None]:
        """The data that restores this mesh: kept vertices (n, 3); all faces (m, 3) as rows of those; and, if vertices
        were dropped, the input row of each kept one, followed by the number of input vertices.
        """
    def moved(self, vertices: NDArray[np.float64]) -> Mesh:
        """Copy the mesh with its kept vertices at other positions (n, 3). Tables that stay valid are shared."""
    def stl_records(self, first: int, count: int) -> NDArray[np.uint8]:
        """Records of a binary STL file, 50 bytes for each of at most ``count`` faces from face ``first`` on, (k,)."""
    def self_intersections(self) -> int:
        """Number of pairs of faces without a common vertex that intersect."""
    def deviation(self, other: Mesh) -> tuple[float, float]:
        """Lower and upper bound on the largest distance from this surface to another one, world units."""
    def sign_warnings(self, sign: str) -> list[str]:
        """Warnings about the sign of this surface by a method."""
    def has_reversed_body(self) -> bool:
        """Whether a connected part of this closed mesh is wound inside out."""
    def topology(self) -> dict[str, Any]:
        """Properties of the surface, int unless stated otherwise: ``boundary_edges``, ``nonmanifold_edges``,
        ``flipped_faces``, ``duplicate_faces``, ``degenerate_faces`` (dropped), ``dropped_vertices`` (not finite,
        unused), ``components``, ``closed`` (bool).
        """

@final
class Bodies:
    """The geometry of rigid bodies."""

    def __new__(
        cls,
        count: int,
        elements: list[tuple[int, Mesh | Shape, list[list[float]], float, tuple[Shape, float] | None]],
    ) -> Bodies:
        """``elements``: the body, the geometry, its transform (4, 4) to the body, the scale of the transform, and the
        shape whose triangles the geometry is with their largest deviation, or None."""
    @property
    def count(self) -> int:
        """Number of geometries."""
    def distance(
        self,
        poses: NDArray[np.float64],
        points: NDArray[np.float64],
        *,
        paired: bool,
        searched: list[bool],
        progress: Callable[[float], object] | None = None,
    ) -> NDArray[np.float64]:
        """Signed distances (k,) of points (m, 3); ``poses`` are world-from-body (configurations * bodies, 4, 4).

        k is the number of configurations times the number of points. With ``paired`` the first points belong to the
        first configuration, and k is the number of points.
        """
    def clearance(
        self,
        poses: NDArray[np.float64],
        pairs: list[tuple[int, int]],
        *,
        cutoff: float,
        relative_tolerance: float,
        progress: Callable[[float], object] | None = None,
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """Distances (n,), errors (n,), points of both bodies (n, 3) and normals (n, 3) of pairs of bodies.

        n is the product of the numbers of configurations and pairs.
        """
    def query(
        self,
        poses: NDArray[np.float64],
        points: NDArray[np.float64],
        *,
        paired: bool,
        searched: list[bool],
        progress: Callable[[float], object] | None = None,
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.float64],
    ]:
        """Signed distances (k,), gradients (k, 3), nearest points (k, 3), elements (k,), faces (k,), weights (k, 3)."""

def bake(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    sign: str = "auto",
    band: float | None = None,
    thickness: float | None = None,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float32] | DeviceField, dict[str, Any]]:
    """Distances (nx, ny, nz), x fastest in memory, and the report. ``band`` is in voxels. ``thickness``, world units,
    makes the field two-sided: the unsigned distance minus half the thickness. ``progress`` receives fractions from 0 to
    1 about ten times a second.

    The report: ``sign_method`` ("winding", "parity", "pseudonormal", "normal", "unsigned"), ``sign_reason`` (one
    sentence), the entries of :meth:`Mesh.topology`, ``undecided_voxels``, ``inside_voxels``, ``device``, ``seconds``
    (dict: stage to float), ``peak_bytes``, ``warnings`` (list of sentences).
    """

def bake_update(
    mesh: Mesh,
    before: Mesh,
    distances: NDArray[np.float32],
    undecided: int,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    *,
    sign: str = "auto",
    band: float | None = None,
    thickness: float | None = None,
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float32], dict[str, Any]]:
    """The result of :func:`bake` on the CPU for a mesh whose vertices moved. ``before`` and ``distances`` are the mesh
    and the samples (nx, ny, nz), x fastest in memory, of a bake on the CPU with the same grid and options, and
    ``undecided`` is its number of undecided voxels."""

def bake_window(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    low: tuple[int, int, int],
    size: tuple[int, int, int],
    *,
    sign: str = "auto",
    band: float | None = None,
) -> NDArray[np.float32]:
    """Bake the samples ``low`` to ``low + size - 1`` of a grid on the CPU, (sx, sy, sz), with the bits of the whole
    bake. Distances beyond ``band`` voxels are clamped to it."""

def bake_blocks(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    origins: NDArray[np.int32],
    side: int,
    *,
    unsigned: bool = False,
) -> NDArray[np.float32]:
    """Bake the samples of blocks of a grid on the CPU, (k, (side + 1)^3), x fastest. The first sample of a block is a
    row of ``origins`` (k, 3). Samples outside the grid repeat the nearest one of the grid. Distances are negative
    inside by the winding number, or without a sign if ``unsigned``."""

def sides_of_balls(
    mesh: Mesh, centers: NDArray[np.float64], radii: NDArray[np.float64], *, sign: str = "auto"
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Distances of the centres (n, 3) of balls from the surface, (n,), world units, and the side of each ball, (n,): 1
    if all its points are outside, -1 if all are inside, 0 if it contains a part of the surface or if the sign method
    has to classify each point."""

def bake_brute(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    sign: str,
    device: str,
) -> NDArray[np.float32]:
    """The bake of the articles on a graphics device: every sample visits every triangle. A reference for tests.
    ``sign`` is "normal", "parity" or "unsigned".
    """

@final
class DeviceField:
    """Distances in the memory of a graphics device. Made by :func:`bake`."""

    @property
    def shape(self) -> tuple[int, int, int]: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def device(self) -> str: ...
    @staticmethod
    def upload(distances: NDArray[np.float32], device: str) -> DeviceField:
        """Copy samples (nx, ny, nz) with x fastest to a device, which must not be the CPU."""
    def read(self) -> NDArray[np.float32]:
        """The samples, (nx, ny, nz) with x fastest in memory; each call makes a new copy."""
    def serves(self, device: str) -> bool:
        """Whether a call with this ``device`` runs on the device of the field."""
    def _transfers(self) -> dict[str, int]:
        """Number of uploads and read-backs on this device so far, and their bytes; for tests."""
    def _destroy_device(self) -> None:
        """Destroy the device, as if the driver had removed it; for tests."""

@final
class Shape:
    """A CSG tree, compiled at the first evaluation. ``numbers`` are the parameters in :mod:`fieldbake.shapes`."""

    @staticmethod
    def primitive(name: str, numbers: list[float]) -> Shape: ...
    @staticmethod
    def extrude(
        kind: str,
        numbers: list[float],
        counts: list[int],
        height: float,
        taper_deg: float,
        chamfer: tuple[float, float],
    ) -> Shape: ...
    @staticmethod
    def revolve(kind: str, numbers: list[float], counts: list[int], offset: float) -> Shape: ...
    @staticmethod
    def volume(
        distances: NDArray[np.float32],
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        error: float | None = None,
        divided: tuple[NDArray[np.uint64], NDArray[np.float32]] | None = None,
    ) -> Shape:
        """A baked field. ``error`` bounds its difference from the distance, world units; None if that is unknown.

        ``divided``: indices (n,) of cells between the centres of voxels, x fastest, and their samples (125 n,), world
        units, at quarters of the sides of each cell, x fastest."""
    @staticmethod
    def combine(op: str, shapes: list[Shape], k: float, chamfer: float) -> Shape: ...
    @staticmethod
    def parse(text: str) -> Shape: ...
    def changed(self, name: str, numbers: list[float]) -> Shape: ...
    def stencil(self, mask: Shape, color: tuple[float, float, float], outside: bool) -> Shape: ...
    def reblended(self, k: float, chamfer: float) -> Shape: ...
    def aligned(self, anchor: tuple[float, float, float]) -> Shape: ...
    def to_sexpr(self) -> str: ...
    def graph(
        self,
    ) -> tuple[list[str], list[tuple[int, int, int, int]], list[float], int, list[NDArray[np.float32]]] | None:
        """Names, inputs and values of the nodes of the field, the node of the distance, and the samples of volumes."""
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]: ...
    @property
    def is_exact(self) -> bool: ...
    @property
    def field_kind(self) -> str:
        """ "distance", "joint" (as a distance but for fillets, chamfers and samples) or "scaled"."""
    @property
    def field_error(self) -> float: ...
    @property
    def is_misused(self) -> bool:
        """Whether a size in the tree is in units of a field that is no distance."""
    def without_factor(self) -> tuple[float, Shape] | None:
        """The factor and the operand, if the root multiplies a field."""
    def operands(self) -> tuple[str, list[Shape]] | None:
        """The operator and the operands of the root, if it combines several."""
    @property
    def lipschitz(self) -> float: ...
    @property
    def evaluated_leaves(self) -> int: ...
    @property
    def leaf_count(self) -> int: ...
    def distance(self, points: NDArray[np.float64], device: str) -> NDArray[np.float32]: ...
    def distance_float64(self, points: NDArray[np.float64], device: str) -> NDArray[np.float64]: ...
    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float32]: ...
    def color(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Linear RGB; nan where the shape is not painted."""
    def bake(
        self,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        *,
        device: str = "auto",
        progress: Callable[[float], object] | None = None,
    ) -> tuple[NDArray[np.float32], str]:
        """Distances (nx, ny, nz), x fastest in memory, and the device."""
    def shader(self, language: str) -> tuple[str, NDArray[np.float32]]:
        """The text, and the parameters that it reads from its buffer."""
    def decompose(self, method: str) -> tuple[NDArray[np.float64], list[int]]:
        """Boxes of all parts (n, 2, 3), and the index of the first box of each part, followed by n."""
    def structures(self, method: str) -> int: ...
    def part(self, method: str, index: int) -> Shape: ...
    def draw(
        self,
        method: str,
        picture: dict[str, Any],
        device: str,
        progress: Callable[[float], object] | None = None,
    ) -> dict[str, Any]:
        """A picture; the keys of :func:`raymarch`, and ``parts``, ``boxes``, ``leaf_evaluations``."""

@final
class PointCloud:
    """Points with normals and areas, and the tree over their disks."""

    def __new__(
        cls,
        points: NDArray[np.float64],
        normals: NDArray[np.float64] | None = None,
        areas: NDArray[np.float64] | None = None,
        *,
        progress: Callable[[float], object] | None = None,
    ) -> PointCloud: ...
    @property
    def areas(self) -> NDArray[np.float64]: ...
    def facts(self) -> tuple[int, int, float, float, bool]:
        """Number of repeated points and of capped areas, the median and the 95th percentile of the spacing, and whether
        the normals point inwards."""

    @property
    def nbytes(self) -> int: ...
    def query(
        self,
        points: NDArray[np.float64],
        *,
        signed: bool,
        progress: Callable[[float], object] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], int, int]:
        """Distances (n,), nearest points of the disks (n, 3), rows (n,), and the numbers of points inside and
        undecided."""

    def contains(
        self, points: NDArray[np.float64], *, progress: Callable[[float], object] | None = None
    ) -> NDArray[np.bool_]: ...
    def winding_number(
        self,
        points: NDArray[np.float64],
        *,
        error: float,
        progress: Callable[[float], object] | None = None,
    ) -> NDArray[np.float64]:
        """With an absolute error of at most ``error``."""

    def bake(
        self,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        *,
        signed: bool,
        progress: Callable[[float], object] | None = None,
    ) -> tuple[NDArray[np.float32], int, int]:
        """Distances of a grid, and the numbers of samples inside and undecided."""

def orient(
    points: NDArray[np.float64],
    lines: NDArray[np.float64] | None = None,
    viewpoints: NDArray[np.float64] | None = None,
    *,
    neighbours: int,
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float64], Literal["viewpoints", "tree", "winding"]]:
    """Unit normals (n, 3), and the method that chose their sides. Zeros stand for the line of the neighbours."""

def bake_cloud_sparse(
    cloud: PointCloud,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    signed: bool,
    band: float,
    tolerance: float | None = None,
    encoding: str = "float32",
    progress: Callable[[float], object] | None = None,
) -> tuple[SparseField, int, int]:
    """The bricks of a cloud near its disks, and the numbers of samples inside and undecided."""

def signed_distance(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    sign: str = "auto",
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.float32]:
    """Signed distance at ``points`` (n, 3), shape (n,)."""

def signed_distance_float64(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    sign: str = "auto",
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.float64]:
    """:func:`signed_distance` in float64."""

def refined(
    mesh: Mesh,
    distances: NDArray[np.float32],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
) -> NDArray[np.float64]:
    """Float64 distances of the samples of a grid, with the signs of their float32 ``distances`` (nx, ny, nz)."""

def closest_point(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Closest points (n, 3), unsigned distances (n,), faces (n,) as rows of ``mesh.faces``, barycentric coordinates
    (n, 3) and unit face normals (n, 3)."""

def query(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    sign: str = "auto",
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int64],
    NDArray[np.float64],
    dict[str, Any],
]:
    """Signed distances (n,), gradients (n, 3), closest points (n, 3), faces (n,), barycentric coordinates (n, 3) and
    the report."""

def contains(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    sign: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.bool_]:
    """Whether each point is inside, (n,)."""

def winding_number(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    error: float = 1e-6,
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.float64]:
    """Signed winding numbers of the faces as they are wound, (n,)."""

def thickness(
    mesh: Mesh,
    points: NDArray[np.float64],
    normals: NDArray[np.float64] | None = None,
    *,
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.float64]:
    """Diameters of the largest inscribed balls that touch the points, (n,)."""

def sample_surface(
    mesh: Mesh,
    count: int,
    *,
    seed: int = 0,
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Points uniform by area: positions (n, 3), face normals (n, 3), faces (n,), barycentric coordinates (n, 3)."""

def set_threads(count: int) -> None:
    """Number of worker threads of later jobs; 0 for one per core."""

def watch(callback: Callable[[float], object] | None) -> Callable[[float], object] | None:
    """Pass the finished fraction of later jobs of this thread to a callable, and return the one before.

    A job that has a callable of its own is left out, and so are jobs that the callable starts.
    """

def cast_rays(
    mesh: Mesh,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    *,
    t_min: float = 0.0,
    t_max: float = ...,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """First hits: t (n,), faces (n,), barycentric coordinates (n, 3), unit face normals (n, 3)."""

def occluded(
    mesh: Mesh,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    *,
    t_min: float = 0.0,
    t_max: float = ...,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.bool_]:
    """Whether each ray hits anything, (n,)."""

def count_intersections(
    mesh: Mesh,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    *,
    t_min: float = 0.0,
    t_max: float = ...,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.int64]:
    """Number of intersections of each ray, (n,)."""

def all_intersections(
    mesh: Mesh,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    *,
    t_min: float = 0.0,
    t_max: float = ...,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """All intersections by ray and t: rays (k,), t (k,), faces (k,), barycentric coordinates (k, 3)."""

def sample(
    distances: NDArray[Any] | DeviceField,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    inner_lower: tuple[float, float, float],
    inner_upper: tuple[float, float, float],
    points: NDArray[np.float64],
    *,
    filter: str = "linear",
    scale: float = 1.0,
) -> NDArray[np.float32]:
    """Field at world ``points`` (n, 3). ``distances`` is (nx, ny, nz) with x fastest. Outside the box: a proven
    lower bound, for a surface that lies in the inner box."""

def gradient(
    distances: NDArray[Any] | DeviceField,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    points: NDArray[np.float64],
    *,
    scale: float = 1.0,
) -> NDArray[np.float32]:
    """Gradient of the trilinear field, (n, 3), distance per world unit. A point outside the box is replaced by its
    nearest point.
    """

def resample(
    distances: NDArray[Any],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    scale: float = 1.0,
) -> NDArray[np.float32]:
    """The trilinear field at the voxel centres of another grid over the same box."""

@final
class Surface:
    """The crossed cells of a level set and the tangent planes at their crossed edges."""

    @staticmethod
    def of_field(
        distances: NDArray[Any],
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        level: float,
        *,
        scale: float = 1.0,
    ) -> Surface:
        """The level set of samples (nx, ny, nz) in any encoding."""
    @staticmethod
    def of_sparse(field: SparseField, level: float) -> Surface:
        """The level set of a sparse field."""
    @staticmethod
    def of_shape(
        shape: Shape,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        voxels: tuple[int, int, int],
        level: float,
    ) -> tuple[Surface, int]:
        """The level set of a shape on a grid, and the number of parallel edges that cross walls without a sample."""
    def use_shape(self, shape: Shape, level: float, *, sharp: bool = True) -> None:
        """Use the tangent planes of the level set of a shape, and add those around all vertices."""
    def edges(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Both ends of each crossed edge, (m, 3) each, and the fraction of the edge before the crossing, (m,)."""
    def use_mesh(self, mesh: Mesh, offset: float, *, unsigned: bool = False) -> None:
        """Use the tangent planes of the surface at a distance from a mesh."""
    def use_planes(self, points: NDArray[np.float64], normals: NDArray[np.float64]) -> None:
        """Use the tangent planes through `points` with `normals`, (m, 3) each; a row that is not finite keeps its
        plane.
        """
    def join_mesh(self, mesh: Mesh, inward: bool) -> None:
        """Add the tangent planes of the faces of a mesh around the sharp vertices. The faces must be oriented alike;
        `inward` tells that their normals point to the inside.
        """
    def join_offset(self, mesh: Mesh, offset: float, unsigned: bool) -> bool:
        """Add the tangent planes of the surface at a distance from a mesh around all vertices. Return False, and add
        none, if the distance is too small for that.
        """
    def probes(self, *, sharp_only: bool = False) -> NDArray[np.float64]:
        """Points (k, 3) around the vertices at which the source has to be evaluated; with ``sharp_only`` only those
        around sharp vertices.
        """
    def join_planes(self, points: NDArray[np.float64], normals: NDArray[np.float64]) -> None:
        """Add the tangent planes through `points` with `normals`, (k, 3) each, one row for each of the last probes."""
    def mesh(self, *, sharp: bool = True, capped: bool = True) -> tuple[NDArray[np.float64], NDArray[np.uint32], int]:
        """Vertices (n, 3), faces (m, 3) and the number of vertices that were clamped to their cell. It is the last
        call, since it frees the surface.
        """

@final
class SurfaceBlocks:
    """Blocks of samples, from which the surface is made."""

    def __new__(
        cls,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        level: float,
    ) -> SurfaceBlocks: ...
    def add(self, origins: NDArray[np.int32], values: NDArray[np.float32]) -> None:
        """Add blocks of samples (k, n, n, n), z slowest, whose first cells are `origins` (k, 3)."""
    def surface(self) -> Surface:
        """The level set in all blocks, which are freed."""

@final
class OuterSides:
    """The samples of a grid that a flood from the box reaches without crossing a triangle."""

    def __new__(
        cls,
        mesh: Mesh,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        radius: float,
    ) -> OuterSides:
        """Openings up to twice `radius` wide, world units, are closed."""
    def is_outside(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the samples nearest to points (n, 3) lie outside, (n,)."""

@final
class SparseField:
    """Bricks of samples near a surface, in one of the encodings. Made by :func:`bake_sparse` and :func:`to_sparse`."""

    def __new__(
        cls,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        band: float,
        scale: float,
        index: NDArray[np.uint32],
        nodes: NDArray[np.float32],
        bricks: NDArray[Any],
    ) -> SparseField:
        """Check that arrays are consistent: ``index`` and ``nodes`` with x fastest, ``bricks`` flat."""
    @property
    def shape(self) -> tuple[int, int, int]: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def encoding(self) -> str: ...
    @property
    def band(self) -> float: ...
    @property
    def scale(self) -> float: ...
    @property
    def levels(self) -> list[int]:
        """Number of stored bricks with cells of 1, 2 and 4 voxels."""
    def arrays(self) -> dict[str, NDArray[Any]]:
        """``index`` (bx, by, bz), ``nodes`` (bx + 1, by + 1, bz + 1), ``bricks`` (n, 8, 8, 8); copies."""
    def sample(
        self,
        inner_lower: tuple[float, float, float],
        inner_upper: tuple[float, float, float],
        points: NDArray[np.float64],
        *,
        filter: str = "linear",
    ) -> NDArray[np.float32]: ...
    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float32]: ...
    def dense(self) -> NDArray[np.float32]:
        """The field on the whole grid, (nx, ny, nz)."""

def bake_sparse(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    sign: str = "auto",
    thickness: float | None = None,
    band: float,
    tolerance: float | None = None,
    encoding: str = "float32",
    progress: Callable[[float], object] | None = None,
) -> tuple[SparseField, dict[str, Any]]:
    """Bricks and the report, as for :func:`bake`. ``band`` and ``tolerance`` are in voxels."""

@final
class Sweep:
    """Bodies and their motion."""

    @staticmethod
    def of_poses(bodies: Bodies, poses: NDArray[np.float64], closed: bool, unsigned: bool) -> Sweep:
        """A motion through world-from-body poses (rows * bodies, 4, 4)."""
    @staticmethod
    def of_joints(
        bodies: Bodies,
        chains: list[tuple[list[list[float]], list[tuple[list[list[float]], str, list[float], list[float]]]]],
        rows: int,
        closed: bool,
        unsigned: bool,
    ) -> Sweep:
        """A motion through joint values: for each body the pose of its root and the joints from there to the body."""
    @property
    def steps(self) -> int:
        """Number of steps of the motion."""
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        """A box around the swept solid; none if a geometry is unbounded or there is none."""
    def bake(
        self,
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        shape: tuple[int, int, int],
        *,
        offset: float,
        tolerance: float,
        band: float,
        encoding: str = "float32",
        progress: Callable[[float], object] | None = None,
    ) -> tuple[SparseField, int, int]:
        """The field, the number of its evaluated samples, and the number of evaluated distances.

        ``offset``, ``tolerance`` and ``band`` are in world units.
        """

def to_sparse(
    distances: NDArray[Any],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    inner_lower: tuple[float, float, float],
    inner_upper: tuple[float, float, float],
    *,
    band: float,
    tolerance: float | None = None,
    encoding: str = "float32",
    scale: float = 1.0,
    progress: Callable[[float], object] | None = None,
) -> SparseField:
    """Convert a dense field to bricks. ``band`` and ``tolerance`` are in voxels."""

def encoding_scale(encoding: str, voxel: float, band: float) -> float:
    """Compute the scale for voxels of this longest side and a band of this half width, both in world units."""

def check_scales(encoding: str, scales: list[float]) -> None:
    """Raise ArgumentError unless the scales are valid for the encoding."""

def encode(distances: NDArray[np.float32], encoding: str, scale: float) -> NDArray[Any]:
    """Distances (nx, ny, nz) in another encoding, rounded toward zero."""

def decode(texels: NDArray[Any], scale: float) -> NDArray[np.float32]:
    """Decode the result of :func:`encode`."""

def resolved_polygons(polygons: list[NDArray[np.float64]], rule: str) -> list[NDArray[np.float64]]:
    """The loops of the region that polygons (m, 2) bound under a rule: outer counter-clockwise, holes clockwise."""

def combined_polygons(
    op: str, first: list[NDArray[np.float64]], second: list[NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """A Boolean of two regions, each given by its loops."""

def offset_polygons(polygons: list[NDArray[np.float64]], distance: float) -> list[NDArray[np.float64]]:
    """The points within a distance of a region."""

def raymarch(
    distances: NDArray[Any] | SparseField,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    picture: dict[str, Any],
    *,
    filter: str = "linear",
    scale: float = 1.0,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> dict[str, Any] | None:
    """Draw the zero level set on the CPU. None if ``device`` is a graphics device and ``filter`` is "linear".

    ``picture`` must have all of these keys: ``pose`` (4, 4) world from camera, with the viewing axis -Z; ``fov_deg``;
    ``height`` of the picture in world units for parallel rays, or None; ``size`` (width, height); ``lights``, at
    most 16 rows of directional lights; ``ambient``; ``color``; ``specular``; ``shininess``; ``background``;
    ``shadows``.

    The result has these keys: ``color`` (h, w, 4) linear RGBA; ``depth`` (h, w) along the viewing axis, inf without a
    hit; ``normal`` (h, w, 3); ``object_id`` (h, w) int32, -1 without a hit; ``shadow`` (h, w) or (h, w, k); ``steps``
    (h, w) uint32; ``device``; ``seconds``.
    """

@final
class SceneField:
    """Distances prepared for the rays of a scene: a copy, divided by `divisor`; None means its own divisor."""

    def __new__(
        cls,
        distances: NDArray[np.float32],
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        inner_lower: tuple[float, float, float],
        inner_upper: tuple[float, float, float],
        divisor: float | None,
    ) -> SceneField: ...
    @property
    def divisor(self) -> float:
        """The slope of the samples if it is far above the slope of a distance, else 1."""
    @staticmethod
    def nested(levels: list[SceneField]) -> SceneField:
        """Nested fields as one field, finest first."""
    @staticmethod
    def sparse(
        field: SparseField, inner_lower: tuple[float, float, float], inner_upper: tuple[float, float, float]
    ) -> SceneField:
        """The bricks of a sparse field, decoded."""
    @staticmethod
    def quadrics(rows: NDArray[np.float64]) -> list[SceneField]:
        """A field for each row (n, 24): matrix (16), centre (3), radius, reflectance (3), opacity."""
    @staticmethod
    def shape(shape: Shape) -> SceneField:
        """A shape, with the parts that rays are traced through."""

@final
class SceneMesh:
    """Triangles with smooth normals, texture coordinates (n, 2), the material of each face (m,), and linear RGBA of
    each vertex (n, 4) and face (m, 4)."""

    def __new__(
        cls,
        mesh: Mesh,
        uv: NDArray[np.float32] | None,
        material: NDArray[np.uint32],
        vertex_colors: NDArray[np.float32] | None,
        face_colors: NDArray[np.float32] | None,
    ) -> SceneMesh: ...
    @property
    def nbytes(self) -> int: ...

@final
class Texture:
    """An image (h, w, 4), sRGB and opacity, and its smaller copies."""

    def __new__(cls, pixels: NDArray[np.uint8]) -> Texture: ...
    @property
    def nbytes(self) -> int: ...

@type_check_only
class InstanceRow(TypedDict):
    """The instances of an object: one, or one for each of its fields.

    They have the materials from ``first_material`` on, one for each material of the mesh.
    """

    mesh: SceneMesh | None
    fields: Sequence[SceneField]
    #: Whether the identifiers of the fields count from ``object``.
    numbered: bool
    #: World from local, (4, 4).
    transform: NDArray[np.float64]
    first_material: int
    opacity: float
    casts_shadow: bool
    visible: bool
    #: Whether the object's colours replace the material's.
    own_colors: bool
    #: Identifier in the picture.
    object: int
    #: Whether light intersects the triangles instead of the field.
    is_sheet: bool
    is_solid: bool

@type_check_only
class MaterialRow(TypedDict):
    """A material of a scene. Textures are indices of the textures of the scene."""

    #: Linear RGBA.
    color: Sequence[float]
    specular: float
    shininess: float
    #: "opaque", "mask" or "blend".
    alpha_mode: str
    alpha_cutoff: float
    two_sided: bool
    #: Length for each of RGB, world units.
    scattering: tuple[float, float, float]
    texture: int | None
    #: Linear RGB.
    emission: Sequence[float]
    emission_texture: int | None
    unlit: bool

@type_check_only
class DirectionalRow(TypedDict):
    """A light at infinite distance. ``slope`` is the tangent of half its angle."""

    direction: Sequence[float]
    slope: float
    #: Linear RGB.
    color: tuple[float, float, float]

@type_check_only
class PointRow(TypedDict):
    """A light at a position."""

    position: Sequence[float]
    radius: float
    #: Linear RGB.
    color: tuple[float, float, float]
    #: Distance at which the light ends; None without falloff.
    range: float | None
    #: Unit axis of the cone of a spot light, and the cosines of its inner and outer angle; None for all directions.
    spot: tuple[Sequence[float], tuple[float, float]] | None

@final
class Scene:
    """Instances, materials and textures, prepared for drawing."""

    def __new__(cls, instances: list[InstanceRow], materials: list[MaterialRow], textures: list[Texture]) -> Scene: ...
    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner around all instances, (2, 3), world units."""

    def moved(self, transforms: NDArray[np.float64]) -> Scene:
        """The same instances with other transforms, (n, 4, 4). All objects are shared."""

@final
class Renderer:
    """Draws frames, and keeps the data that frames share in device memory."""

    def __new__(cls, device: str | None = None, keeps_pictures: bool = False) -> Renderer:
        """Raises DeviceError if ``device`` is given and not available.

        With ``keeps_pictures`` a frame reuses the stages of the frame before that have the same input.
        """
    @property
    def counters(self) -> dict[str, int]:
        """``uploads``, ``upload_bytes``, ``submits`` and ``readbacks`` of all frames."""
    def frame(
        self,
        scene: Scene,
        pose: NDArray[np.float64],
        *,
        fov_deg: float,
        height: float | None,
        lights: list[DirectionalRow | PointRow],
        ambient: float | list[list[list[float]]],
        background: tuple[float, float, float, float],
        options: dict[str, Any],
        device: str,
        progress: Callable[[float], object] | None = None,
    ) -> dict[str, Any]:
        """Draw a scene. ``ambient`` is a number, or a quadratic form of the normal and 1 for each channel, (3, 4, 4).

        ``options`` are the options of :func:`fieldbake.render` by name; ``ambient_occlusion`` is a range or None, and
        ``far`` a list of fields.

        The result has the keys of :func:`raymarch`, with ``seconds`` as a dict of passes, and further
        keys: ``rays`` (h, w) uint32, the number of rays and cones for light of each pixel; ``ray_count``, their number
        in the whole picture; ``far_rays``, the number of rays that entered the far field; ``primary_on`` and
        ``light_on``, the devices of the two passes; ``sheets``, the number of instances whose triangles the CPU traced.
        """

def merge(
    volumes: list[tuple[Any, ...]],
    instances: list[int],
    transforms: NDArray[np.float64],
    quadrics: NDArray[np.float64],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    previous: tuple[NDArray[np.float32], NDArray[np.uint32], list[int]] | None = None,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.uint32] | None, dict[str, Any]]:
    """One field (nx, ny, nz), the owner of each sample (n,), and counters: ``device``, ``evaluations``.

    ``volumes``: (distances, lower, upper, inner_lower, inner_upper) each. ``instances``: the volume of each instance.
    ``transforms`` (k, 4, 4): world from local. ``quadrics`` (m, 24): as for :meth:`SceneField.quadrics`, counted after
    the instances. ``previous``: distances and owners of an earlier merge, and the indices of the changed instances.
    """

def devices() -> list[dict[str, Any]]:
    """The available devices: ``name``, ``backend``, ``type`` ("cpu", "discrete", "integrated", "software", ...),
    ``hardware`` (bool) and ``limits`` (dict). The first is always the CPU.
    """

def require_memory(what: str, needed: int, advice: str) -> None:
    """Raise CapacityError if the machine does not have `needed` bytes free."""

def atlas_plan(
    shapes: NDArray[np.uint32],
    taken: NDArray[np.uint32],
    *,
    layout: str,
    page_size: int,
    gutter: int,
    encoding: str,
) -> NDArray[np.uint32]:
    """Plan blocks for fields of ``shapes`` (n, 3) beside the blocks ``taken`` (k, 10). A block is a row of ten numbers:
    page, corner (2), tile (2), columns, gutter, shape (3). The page of an index without a field is 2**32 - 1.
    """

def atlas_sound(blocks: NDArray[np.uint32], page_size: int, pages: int) -> list[bool]:
    """Whether each block (n, 10) lies on the pages and is safe to read."""

def atlas_write(
    pages: NDArray[np.uint8],
    blocks: NDArray[np.uint32],
    volumes: list[NDArray[np.float32]],
    scales: list[float],
    *,
    encoding: str,
    progress: Callable[[float], object] | None = None,
) -> None:
    """Fill the blocks (n, 10) of ``volumes`` (nx, ny, nz), x fastest. ``pages`` (pages, size, size * bytes), a view of
    the texels as bytes."""

def atlas_clear(pages: NDArray[np.uint8], block: NDArray[np.uint32], encoding: str) -> None:
    """Set the texels of a block (1, 10) to zero."""

def atlas_read(pages: NDArray[np.uint8], block: NDArray[np.uint32], encoding: str, scale: float) -> NDArray[np.float32]:
    """The field of a block (1, 10), (nx, ny, nz) with x fastest."""

def atlas_sample(
    pages: NDArray[np.uint8],
    block: NDArray[np.uint32],
    encoding: str,
    scale: float,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    inner_lower: tuple[float, float, float],
    inner_upper: tuple[float, float, float],
    points: NDArray[np.float64],
    *,
    filter: str = "linear",
) -> NDArray[np.float32]:
    """The field of a block (1, 10) at ``points`` (n, 3); ``filter`` is "linear" or "nearest"."""

def atlas_texture_coordinates(
    block: NDArray[np.uint32],
    page_size: int,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Texture coordinates (n, 2), 0 to 1, of ``points`` (n, 3) on the page of a block (1, 10)."""

def atlas_entries(
    blocks: NDArray[np.uint32],
    boxes: list[list[float]],
    models: list[list[float]],
    scales: list[float],
    layout: str,
    page_size: int,
    encoding: str,
) -> bytes:
    """The std430 records of ``blocks`` (n, 10). ``boxes``: twelve numbers each, lower and upper inner corner, lower and
    upper outer corner; ``models``: sixteen numbers each, row by row.
    """

def atlas_shader(language: str, layout: str, page_size: int, gutter: int, encoding: str, side: int, texels: str) -> str:
    """Sampling functions as text in "wgsl", "glsl", "hlsl" or "msl".

    ``side`` is the number of voxels along a side of the cubes in strips. ``texels`` is "pages", "png" or "integers".
    """

def viewer_shader(
    language: str,
    kinds: tuple[bool, bool, bool, bool],
    encoding: str | None,
    shapes: list[Shape],
    frame: tuple[tuple[float, float, float], float] | None = None,
) -> tuple[list[str], list[tuple[int, NDArray[np.float32], list[float], float, float] | None]]:
    """The shaders of a view; ``kinds`` states whether it has dense fields, sparse fields, quadrics and meshes.

    The first text is the fragment shader of rays. With meshes, their vertex and their fragment shader follow; in "wgsl"
    each text has all entry points of its kernel.

    ``frame`` is the centre and the scale of the local frame of all shapes; by default each has its own.

    ``encoding`` is the encoding of all sampled fields, or None if they differ. For each shape the result has the index
    of its function, the parameters that it reads, the centre and the scale of its local frame, and the inverse of its
    Lipschitz constant; None for a shape without a function.
    """

def viewer_triangles(language: str) -> list[str]:
    """The vertex and the fragment shader for triangles of level sets, in "wgsl" or "glsl"."""

def shader_library(library: str, head: str, language: str) -> str:
    """The functions of "volume", "sparse", "nested" or "quadrics" in a language; ``head`` is WGSL with a comment and
    the constants that they read.
    """

def divide_obj_polygons(content: bytes) -> bytes | None:
    """A Wavefront OBJ file with its polygons divided where a fan would leave their outline; None without such ones."""

def read_obj(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """The vertices and faces of a Wavefront OBJ file; None if it has materials, texture coordinates or damage."""

def exr_read(bytes: bytes, width: int, height: int, encoding: str) -> bytes:
    """The texels of an OpenEXR file of one channel, if it has this size; float32 for normalised encodings."""

@final
class DevicePages:
    """Pages of an atlas in the memory of a graphics device. Made by :func:`atlas_pack_device`."""

    def __len__(self) -> int: ...
    @property
    def device(self) -> str: ...
    def read(self) -> NDArray[np.uint8]:
        """The texels of all pages as bytes; each call makes a new copy."""

def atlas_pack_device(
    blocks: NDArray[np.uint32],
    volumes: list[NDArray[np.float32] | DeviceField],
    scales: list[float],
    *,
    page_size: int,
    pages: int,
    encoding: str,
    device: str,
    progress: Callable[[float], object] | None = None,
) -> DevicePages | None:
    """Fill new pages on a device. Fields in host memory are uploaded. None if ``device`` is the CPU."""
