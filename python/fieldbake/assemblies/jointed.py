"""Bodies with joints: their names and rows, and their poses by joint values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError
from ..meshes.mesh import Mesh
from ..shapes.shape import Shape
from .geometry import check_rigid
from .joint import Joint
from .kinematics import forward, jacobian, tree_of
from .pairs import default_pairs


class JointedBodies:
    """The base class of `Assembly`: bodies in rows, joints that form trees, and forward kinematics. Immutable."""

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
            Poses of bodies without a parent. The default is the identity, or the pose in the file. The leading shapes
            of the values and the poses are broadcast: one row of values serves several poses.

        Returns
        -------
        (..., n, 4, 4) float64
            World-from-body poses.

        Raises
        ------
        ArgumentError
            For a wrong number of values, an unknown joint or root, a pose that is not rigid, or leading shapes that do
            not agree.

        Examples
        --------
        >>> import fieldbake as fb
        >>> slide = fb.Joint("lift", "prismatic", "rail", "cart", axis=(0, 0, 1))
        >>> fb.Assembly({"rail": (), "cart": ()}, [slide]).poses({"lift": 2.0})[1, :3, 3].tolist()
        [0.0, 0.0, 2.0]
        """
        array = self._checked_values(values)
        places, lead = self._root_poses(roots, array.shape[:-1])
        array = np.broadcast_to(array, (*lead, array.shape[-1]))
        return np.ascontiguousarray(forward(self._tree, array, places, np)[0])

    def _forward(self, values: Any, xp: Any) -> Any:
        """Poses of all bodies by values of another array library."""
        count = len(self._tree.free)
        if values.ndim == 0 or values.shape[-1] != count:
            raise ArgumentError(f"values: must have shape (..., {count}), got {tuple(values.shape)}")
        return forward(self._tree, values, self._root_poses(None, ())[0], xp)[0]

    def _chains(self, values: ArrayLike) -> list[tuple[Any, list[tuple[Any, str, Any, list[float]]]]]:
        """The pose of the root of each body, and the joints from there: origin, kind, axis, and a value per row."""
        array = self._checked_values(values)
        tree = self._tree
        all_values = array @ tree.rates.T + tree.offsets
        roots, _ = self._root_poses(None, ())
        chains: list[tuple[Any, list[tuple[Any, str, Any, list[float]]]]] = [([], [])] * len(tree.parents)
        for i in tree.order:
            if tree.parents[i] < 0:
                chains[i] = np.asarray(roots[i]).tolist(), []
                continue
            root, above = chains[tree.parents[i]]
            own = [(tree.joints[j], all_values[:, j].tolist()) for j in tree.chains[i]]
            steps = [(np.asarray(k.origin).tolist(), k.kind, np.asarray(k.axis).tolist(), row) for k, row in own]
            chains[i] = root, [*above, *steps]
        return chains

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
            Poses of bodies without a parent, as for :meth:`poses`.

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
            raise ArgumentError(f"bodies: must have shape {shape}, as the points have, got {rows.shape}") from None
        lead = array.shape[:-1]
        places, common = self._root_poses(roots, lead)
        if common != lead:
            raise ArgumentError(f"roots: have {common[0]} poses; give as many rows of values and points, "
                                f"got values of shape {array.shape}")  # fmt: skip
        frames = forward(self._tree, array, places, np)[1]
        result = jacobian(self._tree, frames, rows.reshape(*lead, -1), flat.reshape(*lead, -1, 3))
        return result.reshape(*shape, 3, len(self._tree.free))

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

    def _root_poses(
        self, roots: Mapping[str, ArrayLike] | None, lead: tuple[int, ...]
    ) -> tuple[list[Any], tuple[int, ...]]:
        """Poses of the roots, and the leading shape of them and the values, which have the leading shape `lead`.

        There is one entry for each body, None for bodies with a parent.
        """
        rows = lead
        given = dict({} if roots is None else roots)
        result: list[Any] = [None] * len(self._bodies)
        for name, i in self._rows.items():
            if self._tree.parents[i] < 0:
                result[i] = self._roots.get(name, np.eye(4))
        for name, pose in given.items():
            if name not in self._rows or self._tree.parents[self._rows[name]] >= 0:
                names = [other for other, i in self._rows.items() if self._tree.parents[i] < 0]
                raise ArgumentError(f"roots: {name!r} is no body without a parent; these are {names}")
            array = checks.as_float64(checks.real_array(f"roots[{name!r}]", pose, "(..., 4, 4)"))
            try:
                if array.shape[-2:] != (4, 4):
                    raise ValueError
                lead = np.broadcast_shapes(lead, array.shape[:-2])
            except ValueError:
                expected = f"one pose (4, 4), or poses (..., 4, 4) for the leading shape {rows} of the values"
                raise ArgumentError(f"roots[{name!r}]: must be {expected}, got the shape {array.shape}") from None
            check_rigid(f"roots[{name!r}]", array)
            result[self._rows[name]] = array
        return result, lead

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

    def _chosen_pairs(self, pairs: Any) -> list[tuple[int, int]]:
        """Rows of pairs that are given by names or rows; None means the default pairs."""
        if pairs is None:
            return [(int(i), int(j)) for i, j in self._pairs]
        listed = checks.items("pairs", pairs, "two bodies")
        return [self._pair(f"pairs[{i}]", pair) for i, pair in enumerate(listed)]
