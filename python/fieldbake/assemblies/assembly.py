"""`Assembly`: rigid bodies with joints, and the distances of points from them in any configuration."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError
from ..base.notices import warn, warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import MIXED_SIGN_REASON, Report
from ..meshes.mesh import Mesh
from ..shapes.field import MESH_RESOLUTION
from ..shapes.shape import Shape
from .clearances import of_pairs, with_environment
from .geometry import BodyLike, check_rigid, core_element, elements_of
from .joint import Joint
from .jointed import JointedBodies
from .mjcf import read_mjcf
from .results import AssemblyQuery, AssemblyReport, Clearance, unit_warnings
from .urdf import read_urdf

Elements = Literal["collision", "visual"]


class Assembly(JointedBodies):
    """Rigid bodies, joined by joints. Immutable; each body keeps its search tree, and only its pose changes.

    Parameters
    ----------
    bodies : mapping of str to geometry
        The geometry of each body by name: a `Mesh`, a `Shape`, a volume, anything that :func:`fieldbake.bake` takes, or
        a list of (geometry, (4, 4) rigid transform to the body). ``()`` is a body without geometry. The order is the
        order of rows. Exact shapes are evaluated in closed form; other shapes and volumes become their closed meshes.
    joints : sequence of Joint
        Joints between the bodies; they form trees.
    ignored_pairs : sequence of (body, body)
        Pairs, by name or row, that `pairs` leaves out.
    shape_resolution : int, default 128
        Voxels along the longest side of the closed mesh of a shape.

    Raises
    ------
    ArgumentError
        For an unknown body, two joints of one name, a body with two parents, a cycle, or a transform that is not rigid.
    MeshError, ShapeError
        If a geometry cannot be used.

    Examples
    --------
    >>> import fieldbake as fb
    >>> arm = fb.Assembly(
    ...     {"base": fb.box((1, 1, 0.2)), "arm": fb.capsule(0.1, 1).translate((0, 0, 0.5))},
    ...     [fb.Joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0))],
    ... )
    >>> poses = arm.poses([[0.0], [np.pi / 2]])
    >>> arm.distance([(0, 0, 2)], poses).round(3).tolist()
    [[0.9], [1.9]]
    """

    def __init__(
        self,
        bodies: Mapping[str, BodyLike],
        joints: Iterable[Joint] = (),
        *,
        ignored_pairs: Iterable[tuple[str | int, str | int]] = (),
        shape_resolution: int = MESH_RESOLUTION,
    ) -> None:
        if not isinstance(bodies, Mapping):
            raise ArgumentError(f"bodies: must be a mapping of name to geometry, got {checks.describe(bodies)}")
        resolution = checks.integer("shape_resolution", shape_resolution, least=4, most=4096)
        made, deviation = {}, 0.0
        for name, body in bodies.items():
            elements, worst = elements_of(f"bodies[{checks.text('bodies', name)!r}]", body, resolution)
            made[name] = elements
            deviation = max(deviation, worst)
        self._set_up(made, joints, ignored_pairs, deviation, {})

    @classmethod
    def _made(cls, *state: Any) -> Assembly:
        """Make an assembly from the checked parts that :meth:`_set_up` takes."""
        assembly = cls.__new__(cls)
        assembly._set_up(*state)
        return assembly

    @classmethod
    def from_urdf(
        cls,
        path: str | os.PathLike[str],
        *,
        elements: Elements = "collision",
        packages: Mapping[str, str | os.PathLike[str]] | None = None,
        progress: Progress = None,
    ) -> Assembly:
        """Read a URDF file.

        Parameters
        ----------
        path : str or path
            The file. Boxes, cylinders, spheres and capsules become exact shapes.
        elements : "collision" or "visual", default "collision"
            The elements of links that are read. Many files have visual elements alone.
        packages : mapping of str to path, optional
            Folders of packages by name, for ``package://NAME/...``.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        Assembly
            One body for each link, and one joint for each joint, in the order of the file.

        Warns
        -----
        UserWarning
            If no link has such elements, so that all distances are infinite.

        Raises
        ------
        Error
            FormatError, with the file and the element, for a file that is no URDF, for planar and floating joints, and
            for a mesh that is missing or outside the folders of the file and of `packages`. FileNotFoundError for a
            missing file.

        Examples
        --------
        >>> import fieldbake as fb
        >>> robot = fb.Assembly.from_urdf("robot.urdf")  # doctest: +SKIP
        """
        return cls._read(elements, read_urdf(path, elements, packages, progress))

    @classmethod
    def from_mjcf(cls, source: Any, *, elements: Elements = "collision") -> Assembly:
        """Read a model of MuJoCo. Needs the extra ``mujoco``.

        Parameters
        ----------
        source : path, mujoco.MjSpec or mujoco.MjModel
            MuJoCo itself reads the file. Values of joints are the values of `qpos`, `ref` included.
        elements : "collision" or "visual", default "collision"
            ``"collision"``: geoms that can collide, whose contype or conaffinity is not 0. ``"visual"``: geoms of the
            groups 0 to 2, which MuJoCo's viewer shows.

        Returns
        -------
        Assembly
            One body for each body of the model. The first one is named ``world`` and has the geometry of the world. A
            free joint at the top makes its body a root.

        Warns
        -----
        UserWarning
            If no body has such geoms, so that all distances are infinite.

        Raises
        ------
        Error
            FormatError for a file that MuJoCo refuses, for ball joints, for free joints that are not at the top, and
            for geoms without a closed form that are no meshes. Error if MuJoCo is not installed.

        Examples
        --------
        >>> import fieldbake as fb
        >>> robot = fb.Assembly.from_mjcf("robot.xml")  # doctest: +SKIP
        """
        return cls._read(elements, read_mjcf(source, elements))

    @classmethod
    def _read(cls, elements: Elements, parts: tuple[Any, ...]) -> Assembly:
        """Make an assembly of the parts of a file, with a warning if there is no geometry."""
        if not any(parts[0].values()):
            other = "visual" if elements == "collision" else "collision"
            warn(
                f"elements: no body has {elements} geometry, so all distances are infinite; elements={other!r} reads "
                f"the {other} geometry",
                UserWarning,
            )
        return cls._made(*parts)

    @cached_property
    def report(self) -> AssemblyReport:
        """Numbers of geometries and faces, the largest deviation of converted shapes, and warnings."""
        sources = [source for elements in self._bodies.values() for source, _ in elements]
        meshes = list({id(source): source for source in sources if isinstance(source, Mesh)}.values())
        surfaces = [
            text
            for mesh in meshes
            for text in (*mesh._core.sign_warnings("auto"), *(mesh.report.warnings if mesh.report else ()))
        ]
        return AssemblyReport(
            bodies=len(self._bodies),
            geometries=len(sources),
            closed_forms=sum(isinstance(source, Shape) for source in sources),
            faces=sum(len(source.faces) for source in sources if isinstance(source, Mesh)),
            largest_deviation=self._deviation,
            warnings=(*dict.fromkeys(surfaces), *unit_warnings(self._joints, self._bodies)),
        )

    def query(
        self,
        points: ArrayLike,
        poses: ArrayLike | None = None,
        *,
        bodies: Any = None,
        paired: bool = False,
        progress: Progress = None,
    ) -> AssemblyQuery:
        """Find the nearest body of each point, with its signed distance and gradient.

        Parameters
        ----------
        points : (..., 3) real
            World positions, the same for each configuration. With `paired` (b, ..., 3).
        poses : (n, 4, 4) or (b, n, 4, 4), optional
            Rigid world-from-body poses, from :meth:`poses` or a simulator. The default is `home`.
        bodies : sequence of str or int, optional
            The bodies that are searched, by name or row. The default is all of them.
        paired : bool, default False
            Whether each configuration has its own points.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        AssemblyQuery
            Arrays of shape (b, ...), or (...) for poses of shape (n, 4, 4).

        Raises
        ------
        ArgumentError
            For a point that is not finite, a pose that is not rigid, an unknown body, or another number of
            configurations than of rows of paired points.

        Warns
        -----
        SurfaceWarning
            Once per call if the surface of a body is open, inside out, or has flipped or one-sided parts.

        Notes
        -----
        The distance is the smallest one over the bodies. Outside all bodies it is exact; where bodies overlap it is the
        depth in one of them. Distances are float64 and computed on the CPU. A batch has the same bits as its
        configurations one by one.

        Examples
        --------
        >>> import fieldbake as fb
        >>> balls = fb.Assembly({"a": fb.sphere(1), "b": fb.sphere(1).translate((4, 0, 0))})
        >>> balls.query([(1.5, 0, 0), (3.5, 0, 0)]).distances.tolist()
        [0.5, -0.5]
        """
        start = time.perf_counter()
        flat, shape, array, searched = self._request(points, poses, bodies, paired)
        with progress_callback(progress, "query") as callback:
            distances, gradients, nearest, elements, _, _ = self._core_bodies.query(
                array, flat, paired=paired, searched=searched, progress=callback
            )
        warnings = self._surface_warnings(searched)
        report = Report(
            sign_method="winding",
            sign_reason=MIXED_SIGN_REASON,
            points=len(distances),
            inside_points=int((distances < 0).sum()),
            device="cpu",
            seconds={"query": time.perf_counter() - start},
            warnings=warnings,
        )
        rows = np.append(self._element_rows, -1)[elements]
        return AssemblyQuery(
            distances.reshape(shape), gradients.reshape(*shape, 3), nearest.reshape(*shape, 3), rows.reshape(shape),
            report,
        )  # fmt: skip

    def distance(
        self,
        points: ArrayLike,
        poses: ArrayLike | None = None,
        *,
        bodies: Any = None,
        paired: bool = False,
        progress: Progress = None,
    ) -> NDArray[np.float64]:
        """Evaluate the smallest signed distance over the bodies, as :meth:`query` does, without the other results.

        Parameters
        ----------
        points, poses, bodies, paired, progress
            As for :meth:`query`.

        Returns
        -------
        (b, ...) or (...) float64
            World units, negative inside.

        Raises
        ------
        ArgumentError
            As for :meth:`query`.

        Examples
        --------
        >>> import fieldbake as fb
        >>> fb.Assembly({"ball": fb.sphere(1)}).distance((0, 0, 3)).tolist()
        2.0
        """
        flat, shape, array, searched = self._request(points, poses, bodies, paired)
        with progress_callback(progress, "distance") as callback:
            distances = self._core_bodies.distance(array, flat, paired=paired, searched=searched, progress=callback)
        self._surface_warnings(searched)
        return distances.reshape(shape)

    def clearance(
        self,
        poses: ArrayLike | None = None,
        *,
        pairs: Any = None,
        environment: BodyLike | None = None,
        cutoff: float = np.inf,
        relative_tolerance: float = 1e-3,
        progress: Progress = None,
    ) -> Clearance:
        """Compute the distances of pairs of bodies, negative where they overlap.

        Parameters
        ----------
        poses : (n, 4, 4) or (b, n, 4, 4), optional
            Rigid world-from-body poses. The default is `home`.
        pairs : (k, 2) of int or str, optional
            The pairs, by rows or names. The default is `pairs`.
        environment : geometry, or sequence of (geometry, (4, 4) transform), optional
            Geometry in world space. It adds one pair (i, -1) for each body with geometry.
        cutoff, relative_tolerance
            As for :func:`fieldbake.clearance`.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        Clearance
            Arrays of shape (b, k), or (k,) for poses of shape (n, 4, 4).

        Raises
        ------
        ArgumentError
            For a pose that is not rigid, an unknown body, or an option out of range.

        Warns
        -----
        SurfaceWarning
            As for :meth:`query`.

        Notes
        -----
        A negative value is a proven bound of the penetration depth, which saturates where one body contains another;
        see :func:`fieldbake.clearance`. Bodies of several geometries have the smallest clearance over their geometries.

        Examples
        --------
        >>> import fieldbake as fb
        >>> balls = fb.Assembly({"a": fb.sphere(1), "b": fb.sphere(1).translate((4, 0, 0))})
        >>> balls.clearance().distances.tolist()
        [2.0]
        >>> balls.clearance(environment=fb.plane((0, 0, 1), -1.5)).distances.tolist()
        [2.0, 0.5, 0.5]
        """
        array = self._checked_poses(poses)
        bodies: list[Any] = list(self._bodies.values())
        chosen = self._chosen_pairs(pairs)
        if environment is not None:
            array = with_environment(bodies, array, chosen, environment, MESH_RESOLUTION)
        found = of_pairs(bodies, array, chosen, cutoff, relative_tolerance, progress)
        return found._replace(pairs=np.where(found.pairs == len(self._bodies), -1, found.pairs))

    def _request(
        self, points: ArrayLike, poses: ArrayLike | None, bodies: Any, paired: bool
    ) -> tuple[NDArray[np.float64], tuple[int, ...], NDArray[np.float64], list[bool]]:
        """Check a query: its points (k, 3), the shape of results, poses (b * n, 4, 4), and the searched elements."""
        flat, shape = checks.points(points)
        array = self._checked_poses(poses)
        lead = array.shape[:-3]
        if checks.flag("paired", paired):
            if shape[:1] != lead:
                raise ArgumentError(
                    f"paired: needs points of shape (b, ..., 3) and poses of shape (b, n, 4, 4) with one b, got "
                    f"{(*shape, 3)} and {array.shape}"
                )
        else:
            shape = (*lead, *shape)
        requested = range(len(self._bodies)) if bodies is None else self._body_rows("bodies", bodies).ravel().tolist()
        searched = np.isin(self._element_rows, np.fromiter(requested, np.int64)).tolist()
        return flat, shape, np.ascontiguousarray(array.reshape(-1, 4, 4)), searched

    def _checked_poses(self, poses: ArrayLike | None) -> NDArray[np.float64]:
        if poses is None:
            return self.home
        count = len(self._bodies)
        array = checks.real_array("poses", poses, f"({count}, 4, 4) or (b, {count}, 4, 4)")
        if array.ndim not in (3, 4) or array.shape[-3:] != (count, 4, 4):
            raise ArgumentError(
                f"poses: must have shape ({count}, 4, 4) or (b, {count}, 4, 4) for {count} bodies, "
                f"got {checks.describe(array)}"
            )
        result = checks.as_float64(array)
        check_rigid("poses", result)
        return result

    @cached_property
    def _element_rows(self) -> NDArray[np.int64]:
        """The body of each geometry."""
        counts = [len(elements) for elements in self._bodies.values()]
        return np.repeat(np.arange(len(counts)), counts).astype(np.int64)

    @cached_property
    def _core_bodies(self) -> _core.Bodies:
        """The bodies in the core, with their search trees."""
        bodies = enumerate(self._bodies.values())
        return _core.Bodies(len(self._bodies), [core_element(i, *element) for i, body in bodies for element in body])

    def _surface_warnings(self, searched: list[bool]) -> tuple[str, ...]:
        """Issue one warning about the surfaces of all searched meshes, and return its messages."""
        sources = [source for body in self._bodies.values() for source, _ in body]
        meshes = {id(s): s for s, use in zip(sources, searched, strict=True) if use and isinstance(s, Mesh)}
        messages = dict.fromkeys(text for mesh in meshes.values() for text in mesh._core.sign_warnings("auto"))
        warn_surface(tuple(messages))
        return tuple(messages)

    def __reduce__(self) -> tuple[Any, ...]:
        state = (dict(self._bodies), self._joints, self._ignored, self._deviation, self._roots)
        return Assembly._made, state

    def __repr__(self) -> str:
        return f"Assembly({len(self._bodies)} bodies, {len(self._joints)} joints, {len(self._tree.free)} values)"
