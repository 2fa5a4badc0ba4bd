"""`Assembly`: rigid bodies with joints, and the distances of points from them in any configuration."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, Error
from ..base.notices import warn_surface
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..meshes.mesh import Mesh
from ..shapes.shape import MESH_RESOLUTION, Shape
from .geometry import check_rigid, rigid, searchable
from .joint import Joint
from .kinematics import forward, jacobian, tree_of
from .mjcf import read_mjcf
from .pairs import default_pairs
from .results import AssemblyQuery, AssemblyReport
from .urdf import read_urdf

Elements = Literal["collision", "visual"]

#: A geometry, or a sequence of geometries with their transforms to the body.
BodyLike = Any

#: A body this many times larger than the distance between its joints likely has other units.
UNITS = 100.0


class Assembly:
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
            elements, worst = _elements(checks.text("bodies", name), body, resolution)
            made[name] = elements
            deviation = max(deviation, worst)
        self._set_up(made, joints, ignored_pairs, deviation, {})

    def _set_up(
        self,
        bodies: Mapping[str, tuple[tuple[Mesh | Shape, NDArray[np.float64]], ...]],
        joints: Iterable[Joint],
        ignored_pairs: Iterable[tuple[str | int, str | int]],
        deviation: float,
        roots: Mapping[str, NDArray[np.float64]],
    ) -> None:
        """Fill in a new assembly. `roots` are the default poses of bodies without a parent."""
        self._bodies = MappingProxyType(dict(bodies))
        listed = tuple(checks.items("joints", joints, "Joint"))
        for joint in listed:
            if not isinstance(joint, Joint):
                raise ArgumentError(f"joints: must hold Joints, got {checks.describe(joint)}")
        self._joints = listed
        self._tree = tree_of(self.body_names, listed)
        self._rows = {name: i for i, name in enumerate(self._bodies)}
        self._roots = {name: checks.frozen(pose) for name, pose in roots.items()}
        self._deviation = deviation
        ignored = tuple(checks.items("ignored_pairs", ignored_pairs, "pairs of bodies"))
        self._ignored = tuple(self._pair(f"ignored_pairs[{i}]", pair) for i, pair in enumerate(ignored))
        has_geometry = [bool(elements) for elements in self._bodies.values()]
        self._pairs = checks.frozen(default_pairs(self._tree, has_geometry, self._ignored))

    @classmethod
    def _made(cls, *state: Any) -> Assembly:
        """Make an assembly from checked parts: those of :meth:`_set_up`."""
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
            The elements of links that are read.
        packages : mapping of str to path, optional
            Folders of packages by name, for ``package://NAME/...``.
        progress : bool or callable, optional
            True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

        Returns
        -------
        Assembly
            One body for each link, and one joint for each joint, in the order of the file.

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
        return cls._made(*read_urdf(path, elements, packages, progress))

    @classmethod
    def from_mjcf(cls, source: Any, *, elements: Elements = "collision") -> Assembly:
        """Read a model of MuJoCo. Needs the extra ``mujoco``.

        Parameters
        ----------
        source : path, mujoco.MjSpec or mujoco.MjModel
            MuJoCo itself reads the file. Values of joints are those of `qpos`, `ref` included.
        elements : "collision" or "visual", default "collision"
            ``"collision"``: geoms that can collide, whose contype or conaffinity is not 0. ``"visual"``: geoms of the
            groups 0 to 2, which MuJoCo's viewer shows.

        Returns
        -------
        Assembly
            One body for each body of the model. The first one is named ``world`` and has the geometry of the world. A
            free joint at the top makes its body a root.

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
        return cls._made(*read_mjcf(source, elements))

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies, in the order of rows."""
        return tuple(self._bodies)

    @property
    def bodies(self) -> Mapping[str, tuple[tuple[Mesh | Shape, NDArray[np.float64]], ...]]:
        """The geometry of each body by name: meshes and exact shapes with their transforms to the body, (4, 4)."""
        return self._bodies

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All joints."""
        return self._joints

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints with values of their own, in the order of columns of values."""
        return tuple(self._joints[j].name for j in self._tree.free)

    @property
    def limits(self) -> NDArray[np.float64]:
        """Lower and upper limits of the joint values, (m, 2), radians or world units."""
        return np.array([self._joints[j].limits for j in self._tree.free], dtype=np.float64).reshape(-1, 2)

    @cached_property
    def home(self) -> NDArray[np.float64]:
        """Poses of all bodies where all joint values are 0, (n, 4, 4)."""
        return checks.frozen(self.poses(np.zeros(len(self._tree.free))))

    @property
    def pairs(self) -> NDArray[np.int64]:
        """Rows of the pairs of bodies that may collide, (k, 2) int64.

        All pairs of bodies with geometry, except those joined by fixed joints only, those joined by one moving joint
        (also through bodies without geometry), and the ignored pairs.
        """
        return self._pairs

    @cached_property
    def report(self) -> AssemblyReport:
        """Numbers of geometries and faces, the largest deviation of converted shapes, and warnings."""
        sources = [source for elements in self._bodies.values() for source, _ in elements]
        meshes = list({id(source): source for source in sources if isinstance(source, Mesh)}.values())
        surfaces = [text for mesh in meshes for text in mesh._core.sign_warnings("auto")]
        return AssemblyReport(
            bodies=len(self._bodies),
            geometries=len(sources),
            closed_forms=sum(isinstance(source, Shape) for source in sources),
            faces=sum(len(source.faces) for source in sources if isinstance(source, Mesh)),
            largest_deviation=self._deviation,
            warnings=(*dict.fromkeys(surfaces), *self._unit_warnings()),
        )

    def poses(
        self, values: ArrayLike | Mapping[str, float], *, roots: Mapping[str, ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Compute the poses of all bodies by forward kinematics.

        Parameters
        ----------
        values : (..., m) or mapping of str to float
            Joint values in the order of `joint_names`, radians or world units. A mapping is one row; joints that it
            does not name are 0. Limits are not enforced.
        roots : mapping of str to (4, 4) or (..., 4, 4), optional
            Poses of bodies without a parent. The default is the identity, or the pose in the file.

        Returns
        -------
        (..., n, 4, 4) float64
            World-from-body poses.

        Raises
        ------
        ArgumentError
            For a wrong number of values, an unknown joint or root, or a pose that is not rigid.

        Examples
        --------
        >>> import fieldbake as fb
        >>> slide = fb.Joint("lift", "prismatic", "rail", "cart", axis=(0, 0, 1))
        >>> fb.Assembly({"rail": (), "cart": ()}, [slide]).poses({"lift": 2.0})[1, :3, 3].tolist()
        [0.0, 0.0, 2.0]
        """
        array = self._checked_values(values)
        return np.ascontiguousarray(forward(self._tree, array, self._root_poses(roots, array.shape[:-1]), np)[0])

    def _forward(self, values: Any, xp: Any) -> Any:
        """Poses of all bodies by values of another array library."""
        count = len(self._tree.free)
        if values.ndim == 0 or values.shape[-1] != count:
            raise ArgumentError(f"values: must have shape (..., {count}), got {tuple(values.shape)}")
        return forward(self._tree, values, self._root_poses(None, ()), xp)[0]

    def jacobian(
        self,
        values: ArrayLike | Mapping[str, float],
        bodies: Any,
        points: ArrayLike,
        *,
        roots: Mapping[str, ArrayLike] | None = None,
    ) -> NDArray[np.float64]:
        """Compute the derivative of world positions of points that are fixed to bodies, by the joint values.

        Parameters
        ----------
        values : (m,) or (b, m), or mapping
            Joint values. One row serves all points.
        bodies : str, int, or (...) or (b, ...) of int
            The body of each point, by name or row; -1 gives 0.
        points : (..., 3) or (b, ..., 3)
            World positions in the configuration of the values, such as `AssemblyQuery.points`.
        roots : mapping of str to (4, 4) or (b, 4, 4), optional
            Poses of bodies without a parent, those of :meth:`poses`.

        Returns
        -------
        (..., 3, m) or (b, ..., 3, m) float64

        Raises
        ------
        ArgumentError
            For shapes that do not agree, or an unknown body.

        Examples
        --------
        The change of a distance by the joint values:

        >>> import fieldbake as fb
        >>> hinge = fb.Joint("hinge", "revolute", "base", "arm", axis=(0, 0, 1))
        >>> arm = fb.Assembly({"base": (), "arm": fb.sphere(0.5).translate((2, 0, 0))}, [hinge])
        >>> q = arm.query([(2, 1, 0)], arm.poses([0.0]))
        >>> change = -np.einsum("...i,...im->...m", q.gradients, arm.jacobian([0.0], q.bodies, q.points))
        >>> change.round(6).tolist()
        [[-2.0]]
        """
        array = self._checked_values(values)
        if array.ndim > 2:
            raise ArgumentError(f"values: must have shape (m,) or (b, m), got {array.shape}")
        place = checks.real_array("points", points, "(..., 3)")
        flat, shape = checks.points(place)
        rows = self._body_rows("bodies", bodies, least=-1)
        if array.ndim == 2 and shape[:1] != array.shape[:1]:
            raise ArgumentError(f"points: must have shape ({len(array)}, ..., 3) for {len(array)} rows of values, "
                                f"got {(*shape, 3)}")  # fmt: skip
        try:
            rows = np.broadcast_to(rows, shape)
        except ValueError:
            raise ArgumentError(f"bodies: must have shape {shape}, that of the points, got {rows.shape}") from None
        lead = array.shape[:-1]
        frames = forward(self._tree, array, self._root_poses(roots, lead), np)[1]
        result = jacobian(self._tree, frames, rows.reshape(*lead, -1), flat.reshape(*lead, -1, 3))
        return result.reshape(*shape, 3, len(self._tree.free))

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
            sign_reason="the winding number of meshes, and the sign of exact shapes",
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
        wanted = range(len(self._bodies)) if bodies is None else self._body_rows("bodies", bodies).ravel().tolist()
        searched = np.isin(self._element_rows, np.fromiter(wanted, np.int64)).tolist()
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

    def _checked_values(self, values: ArrayLike | Mapping[str, float]) -> NDArray[np.float64]:
        names = self.joint_names
        if isinstance(values, Mapping):
            row = dict.fromkeys(names, 0.0)
            for name, value in values.items():
                if name not in row:
                    raise ArgumentError(f"values: {name!r} is no joint with its own value; these are {list(names)}")
                row[name] = checks.number(f"values[{name!r}]", value)
            return np.array(list(row.values()), dtype=np.float64)
        array = checks.real_array("values", values, f"(..., {len(names)})")
        if array.ndim == 0 or array.shape[-1] != len(names):
            raise ArgumentError(
                f"values: must have shape (..., {len(names)}), one for each of the joints {list(names)}, "
                f"got {checks.describe(array)}"
            )
        result = checks.as_float64(array)
        if not np.isfinite(result).all():
            raise ArgumentError(f"values[{', '.join(map(str, np.argwhere(~np.isfinite(result))[0]))}]: must be finite")
        return result

    def _root_poses(self, roots: Mapping[str, ArrayLike] | None, lead: tuple[int, ...]) -> list[Any]:
        """Poses of the roots; one entry for each body, None for bodies with a parent."""
        given = dict({} if roots is None else roots)
        result: list[Any] = [None] * len(self._bodies)
        for name, i in self._rows.items():
            if self._tree.parents[i] < 0:
                result[i] = self._roots.get(name, np.eye(4))
        for name, pose in given.items():
            if name not in self._rows or self._tree.parents[self._rows[name]] >= 0:
                known = [other for other, i in self._rows.items() if self._tree.parents[i] < 0]
                raise ArgumentError(f"roots: {name!r} is no body without a parent; these are {known}")
            array = checks.as_float64(checks.real_array(f"roots[{name!r}]", pose, "(..., 4, 4)"))
            try:
                if array.shape[-2:] != (4, 4):
                    raise ValueError
                np.broadcast_to(array, (*lead, 4, 4))
            except ValueError:
                raise ArgumentError(f"roots[{name!r}]: must have shape (4, 4) or {(*lead, 4, 4)}, "
                                    f"got {array.shape}") from None  # fmt: skip
            check_rigid(f"roots[{name!r}]", array)
            result[self._rows[name]] = array
        return result

    def _body_rows(self, name: str, bodies: Any, least: int = 0) -> NDArray[np.int64]:
        """Rows of bodies that are given by names or rows, which are at least `least`."""
        count = len(self._bodies)
        if isinstance(bodies, str):
            return np.array(self._row(name, bodies), dtype=np.int64)
        if isinstance(bodies, Sequence) and any(isinstance(body, str) for body in bodies):
            return np.array([self._row(name, body) for body in bodies], dtype=np.int64)
        array = checks.as_array(bodies)
        if array.size == 0:
            return array.astype(np.int64)
        if array.dtype.kind not in "iu":
            raise ArgumentError(f"{name}: must be names or rows of bodies, got {checks.describe(bodies)}")
        if not (array.min() >= least and array.max() < count):
            raise ArgumentError(f"{name}: rows must be from 0 to {count - 1}, got {int(array.min())} to "
                                f"{int(array.max())}")  # fmt: skip
        return array.astype(np.int64)

    def _row(self, name: str, body: Any) -> int:
        if isinstance(body, str):
            if body not in self._rows:
                raise ArgumentError(f"{name}: {body!r} is no body; these are {list(self.body_names)}")
            return self._rows[body]
        return checks.integer(name, body, least=0, most=len(self._bodies) - 1)

    def _pair(self, name: str, pair: Any) -> tuple[int, int]:
        both = tuple(checks.items(name, pair, "two bodies"))
        if len(both) != 2:
            raise ArgumentError(f"{name}: must be two bodies, got {checks.describe(pair)}")
        return self._row(name, both[0]), self._row(name, both[1])

    @cached_property
    def _element_rows(self) -> NDArray[np.int64]:
        """The body of each geometry."""
        counts = [len(elements) for elements in self._bodies.values()]
        return np.repeat(np.arange(len(counts)), counts).astype(np.int64)

    @cached_property
    def _core_bodies(self) -> _core.Bodies:
        """The bodies in the core, with their search trees."""
        elements = [
            (i, source._core, place.tolist(), 1.0)
            for i, body in enumerate(self._bodies.values())
            for source, place in body
        ]
        return _core.Bodies(len(self._bodies), elements)

    def _surface_warnings(self, searched: list[bool]) -> tuple[str, ...]:
        """Issue one warning about the surfaces of all searched meshes, and return its messages."""
        sources = [source for body in self._bodies.values() for source, _ in body]
        meshes = {id(s): s for s, use in zip(sources, searched, strict=True) if use and isinstance(s, Mesh)}
        messages = dict.fromkeys(text for mesh in meshes.values() for text in mesh._core.sign_warnings("auto"))
        warn_surface(tuple(messages))
        return tuple(messages)

    def _unit_warnings(self) -> list[str]:
        """Warnings about bodies that are much larger than the distances between joints."""
        lengths = [float(np.linalg.norm(np.asarray(joint.origin)[:3, 3])) for joint in self._joints]
        reach = max(lengths, default=0.0)
        found = []
        for name, elements in self._bodies.items():
            for source, _ in elements:
                if isinstance(source, Mesh) and len(source.faces):
                    size = float((source.bounds[1] - source.bounds[0]).max())
                    if 0 < UNITS * reach < size:
                        found.append(
                            f"{name!r} is {size / reach:.0f} times larger than the distances between joints; is it in "
                            "millimetres? Scale the mesh"
                        )
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        state = (dict(self._bodies), self._joints, self._ignored, self._deviation, self._roots)
        return Assembly._made, state

    def __repr__(self) -> str:
        return f"Assembly({len(self._bodies)} bodies, {len(self._joints)} joints, {len(self._tree.free)} values)"


def _elements(
    name: str, body: BodyLike, resolution: int
) -> tuple[tuple[tuple[Mesh | Shape, NDArray[np.float64]], ...], float]:
    """The geometries of a body with their transforms, and the largest deviation of converted ones."""
    made, worst = [], 0.0
    for i, (geometry, transform) in enumerate(_listed(body)):
        where = f"bodies[{name!r}][{i}]"
        place = checks.frozen(np.eye(4) if transform is None else rigid(where, transform))
        try:
            source, deviation = searchable(geometry, resolution)
        except Error as error:
            raise type(error)(f"{where}: {error}") from error
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
