"""The mesh: triangles that are checked once, with their materials."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import MeshError
from ..base.report import SurfaceReport
from ..base.viewable import Viewable
from . import facts
from .export import save_mesh
from .images import decoded

if TYPE_CHECKING:
    import trimesh

ALPHA_MODES = ("opaque", "mask", "blend")


def _check_rows(value: object) -> None:
    """Check a run of faces, or raise MeshError."""
    if not isinstance(value, range) or value.step != 1 or not 0 <= value.start <= value.stop:
        raise MeshError(f"faces: must be a range of rows, range(first, end), got {checks.describe(value)}")


class Part:
    """A contiguous range of faces with one material.

    Parameters
    ----------
    image, emission_image : PIL image or (h, w, 3 or 4) uint8, optional
        sRGB images of the base colour and of the emission, row 0 on top. They are decoded at the first use of `texture`
        and `emission_texture`. The other parameters are the attributes below.

    Attributes
    ----------
    name : str
        Name in the file, or empty.
    faces : range
        Rows of `Mesh.faces`.
    color : (4,) tuple
        Base colour, RGBA from 0 to 1; multiplies the texture.
    alpha_mode : str
        ``"opaque"``, ``"mask"`` (cut out where the opacity is below `alpha_cutoff`) or ``"blend"``.
    alpha_cutoff : float
        Opacity from 0 to 1. Used only by ``"mask"``.
    two_sided : bool
        Whether the file marks the faces as visible from behind.
    emission : (3,) tuple
        Linear RGB that the surface emits; multiplies `emission_texture`.
    unlit : bool
        Whether the base colour is shown unchanged, without lighting.

    Examples
    --------
    >>> import fieldbake as fb
    >>> mesh = fb.models.gear()
    >>> part = fb.Part("steel", range(len(mesh.faces)), color=(0.5, 0.5, 0.6, 1.0))
    >>> fb.Mesh(mesh.vertices, mesh.faces, parts=[part]).parts[0].name
    'steel'
    """

    def __init__(
        self,
        name: str = "",
        faces: range = range(0),
        *,
        color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
        image: Any = None,
        alpha_mode: str = "opaque",
        alpha_cutoff: float = 0.5,
        two_sided: bool = False,
        emission: tuple[float, float, float] = (0.0, 0.0, 0.0),
        emission_image: Any = None,
        unlit: bool = False,
    ) -> None:
        _check_rows(faces)
        red, green, blue, opacity = checks.vector("color", color, 4, MeshError).tolist()
        red_emission, green_emission, blue_emission = checks.vector("emission", emission, 3, MeshError).tolist()
        self.name = name
        self.faces = faces
        self.color = (red, green, blue, opacity)
        self.alpha_mode = checks.choice("alpha_mode", alpha_mode, ALPHA_MODES, MeshError)
        self.alpha_cutoff = checks.number("alpha_cutoff", alpha_cutoff)
        self.two_sided = two_sided
        self.emission = (red_emission, green_emission, blue_emission)
        self.unlit = unlit
        self._image = image
        self._emission_image = emission_image

    def with_faces(self, faces: range) -> Part:
        """Copy the material for other faces."""
        return Part(
            self.name,
            faces,
            color=self.color,
            image=self._image,
            alpha_mode=self.alpha_mode,
            alpha_cutoff=self.alpha_cutoff,
            two_sided=self.two_sided,
            emission=self.emission,
            emission_image=self._emission_image,
            unlit=self.unlit,
        )

    @cached_property
    def texture(self) -> NDArray[np.uint8] | None:
        """Image, (h, w, 4) uint8 sRGB with opacity, row 0 on top (v = 1); None without one. Decoded on first use."""
        return self._decoded(self._image)

    @cached_property
    def emission_texture(self) -> NDArray[np.uint8] | None:
        """Image of the emission, (h, w, 4) uint8 sRGB, over the same coordinates as `texture`; None without one."""
        return self._decoded(self._emission_image)

    def _decoded(self, image: Any) -> NDArray[np.uint8] | None:
        if image is None:
            return None
        try:
            return decoded(image)
        except (OSError, SyntaxError, ValueError) as error:
            raise MeshError(f"the texture of part '{self.name}' cannot be read: {error}") from error

    @cached_property
    def alpha(self) -> NDArray[np.float32] | None:
        """Opacity of the texture, (h, w) from 0 to 1, a mask already cut; None if everything is opaque."""
        if self.alpha_mode == "opaque":
            return None
        stored = np.full((1, 1), 255, dtype=np.uint8) if self.texture is None else self.texture[..., 3]
        opacity = stored.astype(np.float32) / np.float32(255) * np.float32(self.color[3])
        if self.alpha_mode == "mask":
            opacity = (opacity >= self.alpha_cutoff).astype(np.float32)
        return checks.frozen(opacity)

    def __getstate__(self) -> dict[str, Any]:
        # Decoded pixels are not pickled, since the image restores them.
        return {name: value for name, value in self.__dict__.items() if name not in ("texture", "alpha")}

    def __repr__(self) -> str:
        looks = "textured" if self._image is not None else "color " + ", ".join(f"{c:.3g}" for c in self.color)
        return f"Part('{self.name}', {len(self.faces)} faces, {looks}, {self.alpha_mode})"


class Mesh(Viewable):
    """Triangles, checked when the mesh is made.

    The search tree is built at the first query and kept. Pass the same `Mesh` to several calls to build it only once.

    Parameters
    ----------
    vertices : (n, 3) real
        Positions, world units. float64 values are kept as they are. Bakes use float32 offsets from the centre of the
        box, so a mesh keeps its shape at any distance from the origin.
    faces : (m, 3) integer
        Rows of `vertices`, counter-clockwise seen from outside.
    uv : (n, 2) real, optional
        Texture coordinates, v upwards.
    texture : (h, w, 3 or 4) uint8, optional
        sRGB image for all faces, row 0 on top.
    alpha : (h, w) real from 0 to 1, optional
        Opacity over the same coordinates. It replaces the opacity of the texture.
    parts : sequence of Part, optional
        Materials with the faces they cover. They replace `texture` and `alpha`.
    vertex_colors : (n, 3 or 4), optional
        Colour of each vertex, interpolated linearly over the faces: uint8 is sRGB with opacity from 0 to 255, as scans
        and trimesh have it; real numbers are linear RGB with opacity from 0 to 1, as glTF has it. Multiplies the colour
        and texture of the part. A mesh without `parts` blends where an opacity is below 1.
    face_colors : (m, 3 or 4), optional
        Colour of each face, in the same forms; multiplies the same way.

    Raises
    ------
    MeshError
        For a wrong shape, faces that are not whole numbers, an index out of range, a position that is not finite but
        used, and a mesh without any triangle of positive area. The message names the array, the index and the value.

    Notes
    -----
    Degenerate faces, and vertices that are not finite and unused, are dropped and counted in `topology`.

    Examples
    --------
    >>> mesh = Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    >>> mesh.bounds.tolist()
    [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]
    >>> Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3)])
    Traceback (most recent call last):
    fieldbake.base.errors.MeshError: faces[0] refers to vertex 3, the mesh has 3 vertices (valid: 0 to 2)
    """

    # Report of the extraction from a field.
    _report: SurfaceReport | None = None
    _chord_error: float = 0.0

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        uv: ArrayLike | None = None,
        texture: ArrayLike | None = None,
        alpha: ArrayLike | None = None,
        parts: Sequence[Part] | None = None,
        vertex_colors: ArrayLike | None = None,
        face_colors: ArrayLike | None = None,
    ) -> None:
        positions = check_vertices(vertices)
        triangles = check_faces(faces)
        self._core = _core.Mesh(checks.as_float64(positions), triangles)
        self._chord_error = 0.0

        # Texture coordinates and colours follow the rows that the core kept.
        self._uv = None
        if uv is not None:
            self._uv = checks.frozen(check_uv(uv, len(positions))[self._core.source_vertices])
        self._vertex_colors = _kept(
            "vertex_colors", vertex_colors, len(positions), "vertex", self._core.source_vertices
        )
        self._input_face_colors = None
        if face_colors is not None:
            self._input_face_colors = checks.frozen(check_colors("face_colors", face_colors, len(triangles), "face"))
        self._face_colors = self._colors_of_faces()
        if parts is None:
            material = _material(texture, alpha)
            if any(
                colors is not None and (colors[:, 3] < 1).any() for colors in (self.vertex_colors, self.face_colors)
            ):
                material["alpha_mode"] = "blend"
            parts = [Part(faces=range(len(triangles)), **material)]
        elif texture is not None or alpha is not None:
            raise MeshError("parts: give either parts, or texture and alpha")
        parts = check_parts(parts, len(triangles))
        self._part_rows = tuple(part.faces for part in parts)
        self._parts = self._placed(parts)

    def _colors_of_faces(self) -> NDArray[np.float32] | None:
        """Select the colours of the kept faces from those of the faces of the input."""
        colors = self._input_face_colors
        return None if colors is None else checks.frozen(colors[self._core.source_faces])

    def _placed(self, parts: Sequence[Part]) -> tuple[Part, ...]:
        """Copy parts for the kept faces. `_part_rows` has the rows of their faces in the input."""
        kept = self._core.source_faces
        return tuple(
            part.with_faces(range(*np.searchsorted(kept, (rows.start, rows.stop)).tolist()))
            for part, rows in zip(parts, self._part_rows, strict=True)
        )

    @classmethod
    def _extracted(cls, vertices: NDArray[np.float64], faces: NDArray[np.uint32], report: SurfaceReport) -> Mesh:
        """Make the mesh of a level set, the only kind of mesh that may have no faces."""
        if len(faces):
            mesh = cls(vertices, faces.astype(np.int64))
        else:
            mesh = cls.__new__(cls)
            mesh._uv = mesh._vertex_colors = mesh._face_colors = None
            mesh._parts, mesh._chord_error = (), 0.0
            mesh.__dict__.update(vertices=checks.frozen(vertices), faces=checks.frozen(faces))
        mesh._report = report
        return mesh

    @cached_property
    def _core(self) -> _core.Mesh:
        raise MeshError("mesh: has no faces; the level set that it was extracted from is empty")

    @property
    def report(self) -> SurfaceReport | None:
        """Report of the extraction from a field; None for other meshes."""
        return self._report

    @cached_property
    def vertices(self) -> NDArray[np.float64]:
        """Positions of the kept vertices, (n, 3) float64, world units, equal to the input's; read-only."""
        return self._core.vertices

    @cached_property
    def faces(self) -> NDArray[np.uint32]:
        """Kept triangles, (m, 3) uint32 rows of `vertices`, read-only."""
        return checks.frozen(self._core.faces)

    @property
    def uv(self) -> NDArray[np.float32] | None:
        """Texture coordinates, (n, 2) float32, v upwards; None without any."""
        return self._uv

    @property
    def vertex_colors(self) -> NDArray[np.float32] | None:
        """Colours of the kept vertices, (n, 4) float32, linear RGB and opacity; None without any."""
        return self._vertex_colors

    @property
    def face_colors(self) -> NDArray[np.float32] | None:
        """Colours of the kept faces, (m, 4) float32, linear RGB and opacity; None without any."""
        return self._face_colors

    @property
    def parts(self) -> tuple[Part, ...]:
        """Contiguous ranges of faces with one material each."""
        return self._parts

    @property
    def texture(self) -> NDArray[np.uint8] | None:
        """Image of the first part that has one, (h, w, 4) uint8 sRGB; None without any. Others: see `parts`."""
        return next((part.texture for part in self._parts if part.texture is not None), None)

    @property
    def alpha(self) -> NDArray[np.float32] | None:
        """Opacity of the first part that is not opaque, (h, w) from 0 to 1; None if all are. Others: see `parts`."""
        return next((part.alpha for part in self._parts if part.alpha is not None), None)

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the faces, (2, 3) float64, world units, read-only."""
        return checks.frozen(self._core.bounds)

    @cached_property
    def center(self) -> NDArray[np.float64]:
        """Origin of the core's local coordinates, near the centre of the box, (3,) float64, world units."""
        return checks.frozen(self._core.center)

    @property
    def nbytes(self) -> int:
        """Bytes of vertices, faces and, once built, the search tree."""
        return self._core.nbytes if len(self.faces) else 0

    @cached_property
    def area(self) -> float:
        """Sum of the areas of all faces, square world units."""
        return facts.area(self.vertices, self.faces)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume, cubic world units, signed by the winding: negative for a mesh that is inside out.

        For an open mesh: the sum of the signed volumes between its faces and the centre of its box.
        """
        center = self.bounds.mean(axis=0) if len(self.faces) else np.zeros(3)
        return facts.signed_volume(self.vertices, self.faces, center)

    @cached_property
    def is_closed(self) -> bool:
        """Whether the surface has no opening, after the repairs that `topology` counts."""
        return not len(self.faces) or bool(self.topology()["closed"])

    @cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """Unit normals of the faces by their own winding, (m, 3) float64, read-only."""
        return checks.frozen(facts.face_normals(self.vertices, self.faces))

    @cached_property
    def vertex_normals(self) -> NDArray[np.float64]:
        """Unit normals of the vertices, weighted by the angles of their faces, (n, 3) float64, read-only.

        Zero for vertices without a face.
        """
        return checks.frozen(facts.vertex_normals(self.vertices, self.faces))

    @property
    def chord_error(self) -> float:
        """Largest distance to the solid that the mesh was tessellated from, world units; 0 for other meshes."""
        return self._chord_error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the geometry to a file.

        Parameters
        ----------
        path : str or path
            The ending chooses the format: ``.stl`` (binary), ``.obj``, ``.ply`` (binary), ``.glb`` or ``.3mf``. OBJ,
            PLY and 3MF keep float64 positions; STL and GLB have float32. 3MF takes world units as millimetres.

        Raises
        ------
        MeshError
            For another ending.
        OSError
            If the file cannot be written. An existing file stays unchanged.

        Notes
        -----
        Only the geometry is written, without texture coordinates and images.
        """
        save_mesh(self.vertices, self.faces, path)

    def moved(self, vertices: ArrayLike) -> Mesh:
        """Move the vertices and keep the faces. This mesh stays as it is.

        Parameters
        ----------
        vertices : (n, 3) real
            New positions, one row for each row of `vertices`, world units.

        Returns
        -------
        Mesh
            A mesh whose results are equal, bit for bit, to those of a new `Mesh` of these positions and the faces of
            the input. Only the choice between equally near faces may differ. Texture coordinates, colours and parts
            are those of this mesh.

        Raises
        ------
        MeshError
            For a wrong shape, a position that is not finite, and positions that leave no triangle of positive area.

        Notes
        -----
        The search tree, if it has been built, is refitted to the new positions in linear time. It is built again once
        its cost by the surface area heuristic is 1.5 times that of its build, or if other faces are degenerate. The
        connectivity is kept as long as the same vertices coincide. All properties that depend on positions are
        computed again.

        Examples
        --------
        >>> mesh = Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
        >>> mesh.moved(mesh.vertices + [0, 0, 2]).bounds.tolist()
        [[0.0, 0.0, 2.0], [1.0, 1.0, 2.0]]
        """
        positions = check_vertices(vertices)
        mesh = Mesh.__new__(Mesh)
        mesh._core = self._core.moved(checks.as_float64(positions))
        mesh._uv, mesh._vertex_colors = self._uv, self._vertex_colors
        mesh._input_face_colors, mesh._part_rows = self._input_face_colors, self._part_rows
        if np.array_equal(mesh._core.source_faces, self._core.source_faces):
            mesh._parts, mesh._face_colors = self._parts, self._face_colors
        else:
            mesh._parts, mesh._face_colors = mesh._placed(self._parts), mesh._colors_of_faces()
        return mesh

    def __reduce__(self) -> tuple[Any, ...]:
        if not len(self.faces):
            return Mesh._extracted, (self.vertices, self.faces, self._report)
        looks = (self._uv, self._vertex_colors, self._input_face_colors)
        return restore, (*self._core.state(), *looks, self._parts, self._part_rows, self._chord_error)

    def topology(self) -> dict[str, Any]:
        """Return the properties of the surface after equal positions were welded.

        The keys are those of :class:`Report`: ``boundary_edges``, ``nonmanifold_edges``, ``flipped_faces``,
        ``duplicate_faces``, ``degenerate_faces``, ``dropped_vertices`` and ``components`` are numbers, and ``closed``
        is a bool.
        """
        return self._core.topology()

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert the geometry to a `trimesh.Trimesh`, without merging or reordering vertices."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces.astype(np.int64), process=False)

    def __repr__(self) -> str:
        if not len(self.faces):
            return "Mesh(0 vertices, 0 faces)"
        extent = " x ".join(f"{side:.4g}" for side in self.bounds[1] - self.bounds[0])
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces, {extent} units)"


def restore(
    vertices: NDArray[np.float64],
    faces: NDArray[np.uint32],
    rows: NDArray[np.uint32] | None,
    uv: NDArray[np.float32] | None = None,
    vertex_colors: NDArray[np.float32] | None = None,
    face_colors: NDArray[np.float32] | None = None,
    parts: tuple[Part, ...] = (),
    part_rows: tuple[range, ...] = (),
    chord_error: float = 0.0,
) -> Mesh:
    """Restore the mesh that `Mesh.__reduce__` pickled.

    `rows` are the rows of the input vertices that were kept. `face_colors` and `part_rows` are those of all faces of
    the input.
    """
    mesh = Mesh.__new__(Mesh)
    if rows is not None:
        # Dropped vertices were not finite. Their rows stay, so that the indices of the input remain valid.
        places = np.full((int(rows[-1]), 3), np.nan)
        places[rows[:-1]] = vertices
        vertices = places
        faces = rows[faces]
    mesh._core = _core.Mesh(np.ascontiguousarray(vertices), faces.astype(np.int64))
    mesh._uv, mesh._vertex_colors, mesh._input_face_colors = (
        None if array is None else checks.frozen(array) for array in (uv, vertex_colors, face_colors)
    )
    mesh._face_colors = mesh._colors_of_faces()
    mesh._parts, mesh._part_rows = parts, part_rows
    mesh._chord_error = chord_error
    return mesh


def check_vertices(value: ArrayLike) -> NDArray[Any]:
    """Check real positions (n, 3), or raise MeshError. The core checks the values of the vertices that are used."""
    array = checks.real_array("vertices", value, "(n, 3)", MeshError)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"vertices: must have shape (n, 3), got {checks.describe(array)}")
    return array


def check_faces(value: ArrayLike) -> NDArray[np.int64]:
    """Check whole numbers (m, 3) and return C-contiguous int64, or raise MeshError. The core checks the range."""
    try:
        array = checks.as_array(value)
    except (ValueError, TypeError, RuntimeError, BufferError) as error:
        raise MeshError(f"faces: must be an array of shape (m, 3), got {checks.describe(value)} ({error})") from None
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 3), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = "; split polygons into triangles first" if array.ndim == 2 and array.shape[1] > 3 else ""
        raise MeshError(f"faces: must have shape (m, 3), got {checks.describe(array)}{hint}")
    if array.dtype.kind not in "iu":
        raise MeshError(
            f"faces: must be whole numbers, got dtype {array.dtype} (faces[0] = {array[0].tolist()}); "
            "convert with faces.astype(int)"
        )
    if array.dtype.kind == "u" and array.max() > np.iinfo(np.int64).max:
        raise MeshError(f"faces: index {array.max()} is out of range")
    return np.ascontiguousarray(array, dtype=np.int64)


def check_uv(value: ArrayLike, vertices: int) -> NDArray[np.float32]:
    """Check texture coordinates, one row per vertex, or raise MeshError."""
    array = checks.real_array("uv", value, "(n, 2)", MeshError)
    if array.shape != (vertices, 2):
        raise MeshError(f"uv: must have shape ({vertices}, 2), one row per vertex, got {checks.describe(array)}")
    with np.errstate(over="ignore"):
        coordinates = checks.as_float64(array).astype(np.float32)
    if not np.isfinite(coordinates).all():
        row = int(np.flatnonzero(~np.isfinite(coordinates).all(axis=1))[0])
        raise MeshError(f"uv[{row}]: must be finite, got {array[row].tolist()}")
    return coordinates


def check_parts(value: Any, faces: int) -> tuple[Part, ...]:
    """Check materials of runs of the faces, or raise MeshError."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise MeshError(f"parts: must be a list of Part, got {checks.describe(value)}")
    for index, part in enumerate(value):
        if not isinstance(part, Part):
            raise MeshError(f"parts[{index}]: must be a Part, got {checks.describe(part)}")
        if part.faces.stop > faces:
            raise MeshError(f"parts[{index}]: {part.faces} is out of range, the mesh has {faces} faces")
    return tuple(value)


def check_colors(name: str, value: ArrayLike, count: int, row: str) -> NDArray[np.float32]:
    """Convert colours to (n, 4) float32, linear RGB and opacity, or raise MeshError. uint8 values are sRGB."""
    array = checks.real_array(name, value, "(n, 3) or (n, 4)", MeshError)
    if array.ndim != 2 or array.shape[0] != count or array.shape[1] not in (3, 4):
        expected = f"({count}, 3) or ({count}, 4), one row per {row}"
        raise MeshError(f"{name}: must have shape {expected}, got {checks.describe(array)}")
    colors = np.ones((count, 4), dtype=np.float32)
    if array.dtype == np.uint8:
        unit = array.astype(np.float64) / 255
        rgb = unit[:, :3]
        colors[:, :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        colors[:, 3 : array.shape[1]] = unit[:, 3:]
        return colors
    if array.dtype.kind != "f":
        raise MeshError(f"{name}: must be uint8 (sRGB) or real numbers (linear), got {checks.describe(array)}")
    if not (array >= 0).all() or not (array[:, 3:] <= 1).all() or not np.isfinite(array).all():
        raise MeshError(f"{name}: must be finite and not negative, opacity at most 1")
    colors[:, : array.shape[1]] = array
    return colors


def _kept(name: str, value: ArrayLike | None, count: int, row: str, source: NDArray[Any]) -> NDArray[np.float32] | None:
    """Check colours and select the rows that the core kept."""
    return None if value is None else checks.frozen(check_colors(name, value, count, row)[source])


def _material(texture: ArrayLike | None, alpha: ArrayLike | None) -> dict[str, Any]:
    """Make the image and the alpha mode of one material from arrays."""
    if texture is None and alpha is None:
        return {}
    image = None
    if texture is not None:
        image = np.asarray(texture)
        if image.ndim != 3 or image.shape[2] not in (3, 4) or image.dtype != np.uint8 or image.size == 0:
            raise MeshError(f"texture: must be uint8 of shape (h, w, 3) or (h, w, 4), got {checks.describe(image)}")
        if image.shape[2] == 3:
            image = np.dstack([image, np.full(image.shape[:2], 255, dtype=np.uint8)])
    if alpha is not None:
        opacity = checks.real_array("alpha", alpha, "(h, w)", MeshError)
        if opacity.ndim != 2 or opacity.size == 0 or not ((opacity >= 0) & (opacity <= 1)).all():
            raise MeshError(f"alpha: must be (h, w) with values from 0 to 1, got {checks.describe(opacity)}")
        if image is None:
            image = np.full((*opacity.shape, 4), 255, dtype=np.uint8)
        if image.shape[:2] != opacity.shape:
            raise MeshError(f"alpha: must have the texture's shape {image.shape[:2]}, got {opacity.shape}")
        image = np.dstack([image[..., :3], np.round(opacity * 255).astype(np.uint8)])
    opaque = image is None or bool((image[..., 3] == 255).all())
    return {"image": image, "alpha_mode": "opaque" if opaque else "blend"}
