"""The field of a shape: its values, and the meshes, sections, files and shaders that are made of it."""

from __future__ import annotations

import os
from typing import Any, Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.checks import DistanceType
from ..base.errors import MeshError, ShapeError
from ..base.grid import Resolution, check_count, make_grid
from ..base.languages import Language
from ..base.progress import Progress, part, watched
from ..base.viewable import Viewable
from ..files.container import check_target
from ..meshes.convert import MeshLike
from ..meshes.formats.export import mesh_kind
from ..meshes.isosurface import ShapeSource, extract, with_thin_features
from ..meshes.mesh import Mesh
from ..meshes.section import Section, Sectioned, field_sections, frames
from .implicit_function import check_unused, save_function
from .shader_function import FUNCTION, shader_function

#: Voxels along the longest side of the grid of a mesh, unless the caller chooses.
MESH_RESOLUTION = 128


class Field(Viewable, Sectioned):
    """Base class of :class:`Shape`, which adds the operators."""

    __slots__ = ()

    _core: _core.Shape

    @overload
    def distance(
        self, points: ArrayLike, *, dtype: Literal["float32"] = "float32", device: str = "auto"
    ) -> NDArray[np.float32]: ...

    @overload
    def distance(
        self, points: ArrayLike, *, dtype: Literal["float64"], device: str = "auto"
    ) -> NDArray[np.float64]: ...

    def distance(
        self, points: ArrayLike, *, dtype: DistanceType = "float32", device: str = "auto"
    ) -> NDArray[np.float32] | NDArray[np.float64]:
        """Evaluate the signed distance at points, negative inside.

        Parameters
        ----------
        points : (n, 3) real
            World positions of any leading shape.
        dtype : "float32" or "float64", default "float32"
            Type of the result. ``"float64"`` evaluates the closed forms in float64, on the CPU.
        device : str, default "auto"
            ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`fieldbake.devices`.

        Returns
        -------
        (n,) float32 or float64
            The Euclidean distance if :attr:`exact` is true. Otherwise a value with the same sign whose magnitude never
            exceeds :attr:`lipschitz` times the distance.

        Raises
        ------
        ArgumentError
            For a wrong shape, a point that is not finite, or an unknown `dtype`.
        ShapeError
            With ``dtype="float64"`` for a shape with a :func:`fieldbake.volume_shape`, whose samples are float32.
        """
        flat, shape = checks.points(points)
        if checks.choice("dtype", dtype, get_args(DistanceType)) == "float64":
            return self._core.distance_float64(flat, checks.text("device", device)).reshape(shape)
        return self._core.distance(flat, checks.text("device", device)).reshape(shape)

    def gradient(self, points: ArrayLike) -> NDArray[np.float32]:
        """Evaluate the gradient of the field at points (n, 3); on the surface it points outwards.

        Central differences in float64 give the mean of both sides on a crease. The result has the shape (n, 3).
        """
        flat, shape = checks.points(points)
        return self._core.gradient(flat).reshape(*shape, 3)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """A box around the solid, (2, 3), world units; ShapeError if a part has no bounds. It may not be tight."""
        return checks.frozen(np.array(self._core.bounds()))

    @property
    def exact(self) -> bool:
        """Whether :meth:`distance` is the Euclidean distance everywhere, including the inside."""
        return self._core.is_exact

    @property
    def field_error(self) -> float:
        """Bound of the difference between the field and the distance near the surface, world units.

        It holds at points whose nearest surface point lies on no edge, for features of at least two voxels. It is 0 for
        exact shapes and their sharp unions, intersections and differences. For a baked distance, as in :meth:`offset`,
        it is the error of the contour and the largest error of linear interpolation, 0.87 voxels together with it; the
        error on smooth parts is a few hundredths of a voxel. It is infinite where no bound is proven.
        """
        return self._core.field_error

    @property
    def lipschitz(self) -> float:
        """Bound on the slope of the field: 1, except for chamfers, volumes and :meth:`times`."""
        return self._core.lipschitz

    def to_sexpr(self) -> str:
        """Write the shape in the language of :func:`fieldbake.csg.parse`."""
        return self._core.to_sexpr()

    def to_mesh(
        self,
        resolution: Resolution = MESH_RESOLUTION,
        *,
        voxel_size: float | None = None,
        bounds: ArrayLike | None = None,
        margin: float = 0.1,
        sharp: bool = True,
        capped: bool = True,
        progress: Progress = None,
    ) -> Mesh:
        """Extract the surface of the solid as a closed triangle mesh.

        Parameters
        ----------
        resolution : int or three ints, default 128
            Voxels along the longest side of the box, or along x, y and z.
        voxel_size, bounds, margin
            As for :func:`fieldbake.bake`.
        sharp, capped
            As for :meth:`fieldbake.Volume.to_mesh`. Tangent planes come from the shape itself.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        Mesh
            As for :meth:`fieldbake.Volume.to_mesh`.

        Raises
        ------
        ShapeError
            If a part is unbounded and `bounds` is not given.
        ArgumentError
            If an option is out of range.

        Warns
        -----
        SurfaceWarning
            If more than 5 % of the surface bounds walls or gaps thinner than a voxel, also of walls that the mesh
            lacks and gaps that it closes.

        Notes
        -----
        The bound :attr:`lipschitz` excludes blocks that cannot contain a part of the surface. The field is evaluated in
        the other blocks only. Samples on the common face of touching shapes would divide the solid there; the grid has
        one to three voxels more then along the axis across the face.

        Examples
        --------
        >>> import fieldbake as fb
        >>> (fb.box(2) - fb.sphere(1.2)).to_mesh(32).topology()["closed"]
        True
        """
        inner = self.bounds if bounds is None else checks.box("bounds", bounds)
        grid = make_grid(
            inner, resolution, voxel_size=voxel_size, bounds=bounds, margin=margin, default=MESH_RESOLUTION
        )
        check_count(grid)
        with watched(progress, "mesh"):
            with part(0.0, 0.4):
                surface, missed = _core.Surface.of_shape(self._core, grid.lower, grid.upper, grid.shape, 0.0)
            with part(0.4, 1.0):
                mesh = extract(surface, 0.0, ShapeSource(self._core), sharp=sharp, capped=capped)
        return with_thin_features(mesh, self._core, max(grid.spacing), missed)

    def section(
        self,
        origin: ArrayLike,
        normal: ArrayLike | str,
        *,
        resolution: int = MESH_RESOLUTION,
        bounds: ArrayLike | None = None,
    ) -> Section:
        """Cut the solid by a plane; see :meth:`fieldbake.Mesh.section`.

        Parameters
        ----------
        origin, normal
            As for :meth:`fieldbake.Mesh.section`.
        resolution : int, default 128
            Cells of the plane along the longest side of the box.
        bounds : (2, 3) array, optional
            Box that cuts the solid, world units; the default is :attr:`bounds`. Unbounded shapes need it.

        Returns
        -------
        Section
            Polygons of the inside, in the coordinates of the plane.

        Raises
        ------
        ShapeError
            If a part is unbounded and `bounds` is not given.
        ArgumentError
            For a plane, a box or a resolution that cannot be used.

        Examples
        --------
        >>> import fieldbake as fb
        >>> ring = fb.torus(2, 0.5).section((0, 0, 0), "z")
        >>> len(ring.polygons), f"{ring.area:.2f}"  # 4 pi is 12.57
        (2, '12.57')
        """
        point = checks.vector("origin", origin, 3)[None]
        return self.sections(point, normal, resolution=resolution, bounds=bounds)[0]

    def sections(
        self,
        origins: ArrayLike,
        normal: ArrayLike | str,
        *,
        resolution: int = MESH_RESOLUTION,
        bounds: ArrayLike | None = None,
    ) -> list[Section]:
        """Cut the solid by parallel planes through `origins` (n, 3); all else is as for :meth:`section`."""
        planes = frames(origins, normal)
        box = self.bounds if bounds is None else checks.box("bounds", bounds)
        cells = checks.integer("resolution", resolution, least=1, most=1 << 20)
        return field_sections(
            lambda points: self._core.distance(points, "cpu"),
            box,
            float((box[1] - box[0]).max()) / cells,
            planes,
            slope=self.lipschitz,
            clipped=bounds is not None,
        )

    def save(
        self,
        path: str | os.PathLike[str],
        resolution: Resolution | None = None,
        *,
        implicit: bool = False,
        within: MeshLike | None = None,
        unit: str = "millimeter",
        min_feature: float | None = None,
        **options: Any,
    ) -> None:
        """Write the surface of the solid to a mesh file, or its field to a .3mf file.

        Parameters
        ----------
        path : str or path
            The ending chooses the format: ``.stl``, ``.obj``, ``.ply``, ``.glb`` or ``.3mf``.
        resolution : int or three ints, optional
            Voxels along the longest side of the box, or along x, y and z; 128 by default.
        implicit : bool, default False
            Whether a ``.3mf`` file has the field as an implicit function in place of triangles (3MF extensions
            *Volumetric* 2022/01 and *Implicit* 2023/12): the shape without a resolution. :func:`load` reads it, unless
            it contains a baked volume, which the file has as pictures of 16 bits.
        within : Mesh, or anything :func:`bake` takes, optional
            Mesh that clips the implicit solid. By default the solid is the whole shape, in the box :attr:`bounds`.
        unit : str, default "millimeter"
            Unit of the coordinates in the implicit file: ``"micron"``, ``"millimeter"``, ``"centimeter"``, ``"inch"``,
            ``"foot"`` or ``"meter"``.
        min_feature : float, optional
            Size of the smallest detail of the implicit solid, for slicers that sample it, world units.
        **options
            Further options of :meth:`to_mesh`.

        Raises
        ------
        MeshError
            For another ending, before any work, or if the shape has no surface in the box.
        ShapeError
            If a part has no bounds; give `bounds` then, or `within` for an implicit file. Also for `within` without
            `implicit`, and for an implicit shape of more than 20,000 operations.
        ArgumentError
            For a `unit` or `min_feature` that is not valid or has no use, and for a resolution of an implicit file.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import fieldbake as fb
        >>> (fb.box(2) - fb.sphere(1.2)).save("part.stl", 64)  # doctest: +SKIP
        """
        mesh_kind(path)
        check_target(checks.path(path))
        if implicit:
            grid = {"resolution": resolution} if resolution is not None else {}
            save_function(self._core, path, within, unit=unit, min_feature=min_feature, unused=[*grid, *options])
            return
        check_unused(within, unit, min_feature)
        mesh = self.to_mesh(MESH_RESOLUTION if resolution is None else resolution, **options)
        if not len(mesh.faces):
            raise MeshError(f"{path}: the shape has no surface in the box")
        mesh.save(path)

    def shader(
        self,
        language: Language = "wgsl",
        *,
        form: Literal["kernel", "function"] = "kernel",
        name: str | None = None,
    ) -> str:
        """Write the field as shader text: a compute shader, or a function to paste into a shader.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            The language. WGSL is indented and commented for readers; naga translates it to the other languages.
        form : "kernel" or "function", default "kernel"
            ``"kernel"`` is a compute shader that is ready to compile: ``distance_to_shape`` and an entry point that
            calls it for a buffer of positions; GLSL is version 4.30. Parameters are read from a buffer with the content
            of :meth:`shader_numbers`, so shapes of the same structure share one text and one pipeline.
            ``"function"`` has the functions that the shape needs, without buffers and without an entry point, as the
            texts of other fields; GLSL is written for WebGL 2 (ES 3.00). Parameters are constants of the text.
        name : str, optional
            Name of the function, only for ``form="function"``; the default is ``"distance_to_shape"``. Another name is
            also put before the names of all other definitions, so that the texts of several shapes fit into one shader.
            GLSL begins with ``#version``, which a shader has once: leave it out of the further texts.

        Returns
        -------
        str
            ``name(p)`` of the text is the signed distance at the world position ``p``, world units, negative inside.

        Raises
        ------
        ShapeError
            For an unknown language or form, a name that is no identifier, a name with ``form="kernel"``, or a shape
            that contains a baked volume, which would need a texture.

        Examples
        --------
        >>> import fieldbake as fb
        >>> text = fb.sphere().shader("glsl", form="function", name="ball")
        >>> text.splitlines()[0], "float ball(" in text, "buffer" in text
        ('#version 300 es', True, False)
        """
        text = self._core.shader(checks.text("language", language))[0]
        if checks.choice("form", form, ("kernel", "function"), ShapeError) == "kernel":
            if name is not None:
                raise ShapeError(f'name: is for form="function"; a kernel has {FUNCTION}, got {checks.describe(name)}')
            return text
        return shader_function(text, self.shader_numbers(), language, FUNCTION if name is None else name)

    def shader_numbers(self) -> NDArray[np.float32]:
        """List the contents of the buffer ``numbers`` of the shader, in order."""
        return self._core.shader("wgsl")[1]
