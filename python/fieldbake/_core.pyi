"""The Rust core. Private: use :mod:`fieldbake` or :mod:`fieldbake.arrays`.

Arrays come in C-contiguous and checked for dtype and shape by the Python layer; values are checked here.
Every function releases the GIL, stops on Ctrl-C and raises the exception classes of :mod:`fieldbake.errors`.
"""

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DeviceField",
    "Mesh",
    "Scene",
    "SceneField",
    "SceneMesh",
    "SparseField",
    "Texture",
    "__version__",
    "bake",
    "bake_brute",
    "bake_sparse",
    "closest_point",
    "decode",
    "devices",
    "encode",
    "gradient",
    "raymarch",
    "render",
    "resample",
    "sample",
    "signed_distance",
    "surface_nets",
    "to_sparse",
]

__version__: str

@final
class Mesh:
    """Checked triangles; the search tree is built at the first query and kept."""

    def __new__(cls, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Mesh:
        """``vertices`` (n, 3), ``faces`` (m, 3). Raises MeshError naming the array, index and value."""
    @property
    def vertices(self) -> NDArray[np.float32]:
        """World positions of the kept vertices, (n, 3)."""
    @property
    def faces(self) -> NDArray[np.uint32]:
        """Kept triangles, (m, 3), indices into ``vertices``."""
    @property
    def source_vertices(self) -> NDArray[np.int64]:
        """Row of the input that each kept vertex came from, (n,)."""
    @property
    def source_faces(self) -> NDArray[np.int64]:
        """Row of the input that each kept face came from, (m,)."""
    @property
    def center(self) -> NDArray[np.float64]:
        """Centre of the box; the core stores float32 offsets from it, (3,)."""
    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner, (2, 3)."""
    @property
    def nbytes(self) -> int:
        """Memory of vertices, faces and, once built, the tree."""
    def topology(self) -> dict[str, Any]:
        """Facts of the surface, each an int unless said otherwise: ``boundary_edges``, ``nonmanifold_edges``,
        ``flipped_faces``, ``duplicate_faces``, ``degenerate_faces`` (dropped), ``dropped_vertices`` (not finite,
        unused), ``components``, ``closed`` (bool)."""

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
    """Distances (nx, ny, nz), x fastest in memory, and the report. ``band`` in voxels; ``thickness`` in world units
    makes the field two-sided: unsigned minus half the thickness. ``progress`` gets 0 to 1 about ten times a second.

    The report: ``sign_method`` ("winding", "parity", "pseudonormal", "normal", "unsigned"), ``sign_reason``
    (one sentence), the facts of :meth:`Mesh.topology`, ``undecided_voxels``, ``inside_voxels``, ``device``,
    ``seconds`` (dict: stage to float), ``peak_bytes``, ``warnings`` (list of sentences)."""

def bake_brute(
    mesh: Mesh,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    sign: str,
    device: str,
) -> NDArray[np.float32]:
    """The articles' own bake on a graphics device, every sample against every triangle; a reference for tests. ``sign``
    is "normal", "parity" or "unsigned"."""

@final
class DeviceField:
    """Distances in the memory of a graphics device. Made by :func:`bake`."""

    @property
    def shape(self) -> tuple[int, int, int]: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def device(self) -> str: ...
    def read(self) -> NDArray[np.float32]:
        """The samples, (nx, ny, nz) with x fastest in memory; each call copies them anew."""
    def serves(self, device: str) -> bool:
        """Whether a call with this ``device`` runs where the field is."""
    def _transfers(self) -> dict[str, int]:
        """Uploads, read-backs and their bytes on this device so far; for tests."""
    def _destroy_device(self) -> None:
        """Give the device up as if the driver had taken it away; for tests."""

def signed_distance(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    sign: str = "auto",
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> NDArray[np.float32]:
    """Signed distance at ``points`` (n, 3), shape (n,)."""

def closest_point(
    mesh: Mesh,
    points: NDArray[np.float64],
    *,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.uint32]]:
    """Closest points (n, 3), unsigned distances (n,), faces (n,) as rows of ``mesh.faces``."""

def sample(
    distances: NDArray[Any],
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
    distances: NDArray[Any],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    points: NDArray[np.float64],
    *,
    scale: float = 1.0,
) -> NDArray[np.float32]:
    """Gradient of the trilinear field, (n, 3), distance per world unit; outside the box, of its nearest point."""

def resample(
    distances: NDArray[Any],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    shape: tuple[int, int, int],
    *,
    scale: float = 1.0,
) -> NDArray[np.float32]:
    """The trilinear field at the voxel centres of another grid over the same box."""

def surface_nets(
    distances: NDArray[np.float32],
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    level: float,
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Vertices (n, 3), world, and faces (m, 3) of the level set, counter-clockwise seen from outside."""

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
        """Check arrays that belong together: ``index`` and ``nodes`` with x fastest, ``bricks`` flat."""
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
        """Stored bricks with cells of 1, 2 and 4 voxels."""
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
    """Bricks and the report, as for :func:`bake`. ``band`` and ``tolerance`` in voxels."""

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
    """The bricks of a dense field."""

def encode(distances: NDArray[np.float32], encoding: str, scale: float) -> NDArray[Any]:
    """Distances (nx, ny, nz) in another encoding, rounded toward zero."""

def decode(texels: NDArray[Any], scale: float) -> NDArray[np.float32]:
    """What :func:`encode` was given, as far as it is stored."""

def raymarch(
    distances: NDArray[Any] | DeviceField | SparseField,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    pose: NDArray[np.float64],
    *,
    fov_deg: float = 45.0,
    size: tuple[int, int],
    light_directions: NDArray[np.float32] | None = None,
    light_colors: NDArray[np.float32] | None = None,
    ambient: float = 0.2,
    color: tuple[float, float, float] | None = None,
    specular: float = 0.25,
    shininess: float = 32.0,
    background: tuple[float, float, float, float] | None = None,
    shadows: str = "hard",
    filter: str = "linear",
    scale: float = 1.0,
    device: str = "auto",
    progress: Callable[[float], object] | None = None,
) -> dict[str, Any]:
    """Draw the zero level set. ``pose`` (4, 4) world from camera, looking along -Z; ``size`` is (width, height).
    ``light_directions`` (k, 3), the way the light travels; None: a key light over the camera's shoulder.

    Keys: ``color`` (h, w, 4) linear RGBA, ``depth`` (h, w) along the view axis, inf where nothing is hit, ``normal``
    (h, w, 3), ``object_id`` (h, w) int32, -1 for nothing, ``shadow`` (h, w) or (h, w, k), ``steps`` (h, w) uint32,
    ``device``, ``seconds``."""

@final
class SceneField:
    """Distances made ready for the rays of a scene; a copy."""

    def __new__(
        cls,
        distances: NDArray[np.float32],
        lower: tuple[float, float, float],
        upper: tuple[float, float, float],
        inner_lower: tuple[float, float, float],
        inner_upper: tuple[float, float, float],
    ) -> SceneField: ...

@final
class SceneMesh:
    """Triangles with smooth normals, texture coordinates (n, 2) and the material of each face (m,)."""

    def __new__(cls, mesh: Mesh, uv: NDArray[np.float32] | None, material: NDArray[np.uint32]) -> SceneMesh: ...
    @property
    def nbytes(self) -> int: ...

@final
class Texture:
    """An image (h, w, 4), sRGB and opacity, and its smaller copies."""

    def __new__(cls, pixels: NDArray[np.uint8]) -> Texture: ...
    @property
    def nbytes(self) -> int: ...

@final
class Scene:
    """Instances, materials and textures, ready to be drawn."""

    def __new__(
        cls,
        meshes: list[SceneMesh | None],
        fields: list[SceneField | None],
        transforms: NDArray[np.float64],
        first_materials: list[int],
        opacities: list[float],
        casts_shadow: list[bool],
        visible: list[bool],
        materials: NDArray[np.float32],
        textures: list[Texture],
    ) -> Scene:
        """One item an instance; ``transforms`` (n, 4, 4) world from local. ``materials`` (k, 13): RGBA, specular,
        shininess, alpha mode (0 opaque, 1 mask, 2 blend), cutoff, two sided, scattering RGB, texture or -1; an
        instance has those from its first on, as many as its mesh names."""
    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of everything, (2, 3), world units."""

def render(
    scene: Scene,
    pose: NDArray[np.float64],
    *,
    fov_deg: float,
    size: tuple[int, int],
    lights: NDArray[np.float64],
    primary: str,
    shadows: str,
    area_samples: int,
    ambient: float,
    occlusion: float | None,
    background: tuple[float, float, float, float],
    exposure: float,
    samples: int,
    device: str,
    progress: Callable[[float], object] | None = None,
) -> dict[str, Any]:
    """Draw a scene. ``lights`` has three rows a light: kind (0 directional, 1 point), tangent of half its angle,
    radius; direction or position; colour. Keys as for :func:`raymarch`, ``seconds`` a dict of passes."""

def devices() -> list[dict[str, Any]]:
    """What can compute: ``name``, ``backend``, ``type`` ("cpu", "discrete", "integrated", "software", ...),
    ``hardware`` (bool) and ``limits`` (dict). The first is always the CPU."""
