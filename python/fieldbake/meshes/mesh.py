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
from ..base.optional import optional_module
from ..base.report import SurfaceReport
from ..base.viewable import Viewable
from . import measures
from .formats.export import save_mesh
from .input_arrays import check_colors, check_faces, check_uv, check_vertices
from .part import Part, check_parts, material_of
from .section import Section, Sectioned, mesh_sections

if TYPE_CHECKING:
    import trimesh


class Mesh(Viewable, Sectioned):
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
    # The shape whose triangles this mesh is, and their largest deviation from it.
    _source: tuple[Any, float] | None = None

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
            self._uv = checks.frozen(_kept(check_uv(uv, len(positions)), self._core.source_vertices))
        self._vertex_colors = None
        if vertex_colors is not None:
            colors = check_colors("vertex_colors", vertex_colors, len(positions), "vertex")
            self._vertex_colors = checks.frozen(_kept(colors, self._core.source_vertices))
        self._input_face_colors = None
        if face_colors is not None:
            self._input_face_colors = checks.frozen(check_colors("face_colors", face_colors, len(triangles), "face"))
        self._face_colors = self._colors_of_faces()
        if parts is None:
            material = material_of(texture, alpha)
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
        """Select the colours of the kept faces from the colours of the faces of the input."""
        colors = self._input_face_colors
        return None if colors is None else checks.frozen(_kept(colors, self._core.source_faces))

    def _placed(self, parts: Sequence[Part]) -> tuple[Part, ...]:
        """Copy parts for the kept faces. `_part_rows` has the rows of their faces in the input."""
        kept = self._core.source_faces
        if kept is None:
            return tuple(part.with_faces(rows) for part, rows in zip(parts, self._part_rows, strict=True))
        return tuple(
            part.with_faces(range(*np.searchsorted(kept, (rows.start, rows.stop)).tolist()))
            for part, rows in zip(parts, self._part_rows, strict=True)
        )

    @classmethod
    def _extracted(cls, vertices: NDArray[np.float64], faces: NDArray[Any], report: SurfaceReport) -> Mesh:
        """Make the mesh of a level set, the only kind of mesh that may have no faces."""
        if len(faces):
            mesh = cls(vertices, faces)
        else:
            mesh = cls.__new__(cls)
            mesh._uv = mesh._vertex_colors = mesh._face_colors = None
            mesh._parts, mesh._chord_error = (), 0.0
            mesh.__dict__.update(
                vertices=checks.frozen(vertices), faces=checks.frozen(faces.astype(np.uint32, copy=False))
            )
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
        return measures.area(self.vertices, self.faces)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume, cubic world units, signed by the winding: negative for a mesh that is inside out.

        For an open mesh: the sum of the signed volumes between its faces and the centre of its box.
        """
        center = self.bounds.mean(axis=0) if len(self.faces) else np.zeros(3)
        return measures.signed_volume(self.vertices, self.faces, center)

    @cached_property
    def is_closed(self) -> bool:
        """Whether the surface has no opening, after the repairs that `topology` counts."""
        return not len(self.faces) or bool(self.topology()["closed"])

    @cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """Unit normals of the faces by their own winding, (m, 3) float64, read-only."""
        return checks.frozen(measures.face_normals(self.vertices, self.faces))

    @cached_property
    def vertex_normals(self) -> NDArray[np.float64]:
        """Unit normals of the vertices, weighted by the angles of their faces, (n, 3) float64, read-only.

        Zero for vertices without a face.
        """
        return checks.frozen(measures.vertex_normals(self.vertices, self.faces))

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
        save_mesh(self.vertices, self.faces, lambda *rows: self._core.stl_records(*rows), path)

    def moved(self, vertices: ArrayLike) -> Mesh:
        """Move the vertices and keep the faces. This mesh stays as it is.

        Parameters
        ----------
        vertices : (n, 3) real
            New positions, one row for each row of `vertices`, world units.

        Returns
        -------
        Mesh
            A mesh whose results are equal, bit for bit, to the results of a new `Mesh` of these positions and the faces
            of the input. Only the choice between equally near faces may differ. Texture coordinates, colours and parts
            are taken from this mesh.

        Raises
        ------
        MeshError
            For a wrong shape, a position that is not finite, and positions that leave no triangle of positive area.

        Notes
        -----
        The search tree, if it has been built, is refitted to the new positions in linear time. It is built again once
        its cost by the surface area heuristic is 1.5 times the cost of its build, or if other faces are degenerate. The
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
        before, after = self._core.source_faces, mesh._core.source_faces
        if before is after or (before is not None and after is not None and np.array_equal(before, after)):
            mesh._parts, mesh._face_colors = self._parts, self._face_colors
        else:
            mesh._parts, mesh._face_colors = mesh._placed(self._parts), mesh._colors_of_faces()
        return mesh

    def __reduce__(self) -> tuple[Any, ...]:
        if not len(self.faces):
            return Mesh._extracted, (self.vertices, self.faces, self._report)
        visuals = (self._uv, self._vertex_colors, self._input_face_colors)
        return restore, (*self._core.state(), *visuals, self._parts, self._part_rows, self._chord_error, self._source)

    def _sections(self, planes: list[NDArray[np.float64]]) -> list[Section]:
        return mesh_sections(self.vertices, self.faces, planes)

    def topology(self) -> dict[str, Any]:
        """Return the properties of the surface after equal positions were welded.

        The keys are named as in :class:`Report`: ``boundary_edges``, ``nonmanifold_edges``, ``flipped_faces``,
        ``duplicate_faces``, ``degenerate_faces``, ``dropped_vertices`` and ``components`` are numbers, and ``closed``
        is a bool.
        """
        return self._core.topology()

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert the geometry to a `trimesh.Trimesh`, without merging or reordering vertices."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces.astype(np.int64), process=False)

    def to_manifold(self) -> Any:
        """Convert the geometry to a `manifold3d.Manifold`, in float64.

        Returns
        -------
        manifold3d.Manifold
            The solid, with vertices at equal positions joined.

        Raises
        ------
        MeshError
            If the mesh is not closed, or faces beside each other are oriented differently.
        Error
            If manifold3d (extra ``simplify``) is not installed.

        Notes
        -----
        Arrays of a mesh are read-only. Some libraries, among them all that use nanobind with plain arrays, refuse
        them; ``np.array(mesh.vertices)`` is a writable copy.

        Examples
        --------
        >>> import fieldbake as fb
        >>> solid = fb.models.gear().to_manifold()  # doctest: +SKIP
        """
        package: Any = optional_module("manifold3d", "to_manifold", extra="simplify")
        mesh = package.Mesh64(np.array(self.vertices), np.array(self.faces, np.uint64))
        mesh.merge()
        solid = package.Manifold(mesh)
        if solid.status() != package.Error.NoError:
            raise MeshError(
                f"to_manifold: manifold3d cannot read the mesh of {len(self.faces):,} faces: {solid.status().name}; "
                "fieldbake.solid makes a closed one"
            )
        return solid

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
    source: tuple[Any, float] | None = None,
) -> Mesh:
    """Restore the mesh that `Mesh.__reduce__` pickled.

    `rows` are the rows of the input vertices that were kept. `face_colors` and `part_rows` belong to all faces of the
    input.
    """
    mesh = Mesh.__new__(Mesh)
    if rows is not None:
        # Dropped vertices were not finite. Their rows stay, so that the indices of the input remain valid.
        places = np.full((int(rows[-1]), 3), np.nan)
        places[rows[:-1]] = vertices
        vertices = places
        faces = rows[faces]
    mesh._core = _core.Mesh(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    mesh._uv, mesh._vertex_colors, mesh._input_face_colors = (
        None if array is None else checks.frozen(array) for array in (uv, vertex_colors, face_colors)
    )
    mesh._face_colors = mesh._colors_of_faces()
    mesh._parts, mesh._part_rows = parts, part_rows
    mesh._chord_error, mesh._source = chord_error, source
    return mesh


def _kept(rows: NDArray[Any], kept: NDArray[np.int64] | None) -> NDArray[Any]:
    """Select the rows that the core kept; None is all of them."""
    return rows if kept is None else rows[kept]
