"""`Joint`: the motion of one body relative to another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError
from .geometry import rigid

Kind = Literal["fixed", "revolute", "prismatic"]

#: The kinds of joints.
KINDS = ("fixed", "revolute", "prismatic")


@dataclass(frozen=True, eq=False)
class Joint:
    """The motion of a body, the child, relative to another body, its parent. Immutable.

    Parameters
    ----------
    name : str
        The name of the joint value.
    kind : "fixed", "revolute" or "prismatic"
        A revolute joint turns about the axis, radians. A prismatic joint slides along it, world units.
    parent, child : str
        Names of the two bodies. Several joints may share both: they act in order, each in the frame of the one before.
    origin : (4, 4), optional
        Rigid transform to the parent from the joint at the value 0. The default is the identity.
    axis : (3,), default (1, 0, 0)
        Axis through the origin of the joint, in its frame. It is normalised.
    limits : (lower, upper), default (-inf, inf)
        Range of the value, for the caller. :meth:`Assembly.poses` does not enforce it.
    mimic : (name, multiplier, offset), optional
        The value of the joint is ``multiplier * value(name) + offset``. The joint has no value of its own then.

    Raises
    ------
    ArgumentError
        For an unknown kind, a transform that is not rigid, an axis of length zero, or limits in the wrong order.

    Examples
    --------
    >>> import fieldbake as fb
    >>> elbow = fb.Joint("elbow", "revolute", "upper arm", "forearm", axis=(0, 0, 2))
    >>> elbow.axis.tolist()
    [0.0, 0.0, 1.0]
    """

    name: str
    kind: Kind
    parent: str
    child: str
    origin: ArrayLike | None = None
    axis: ArrayLike = (1.0, 0.0, 0.0)
    limits: tuple[float, float] = (-math.inf, math.inf)
    mimic: tuple[str, float, float] | None = None

    def __init__(
        self,
        name: str,
        kind: Kind,
        parent: str,
        child: str,
        *,
        origin: ArrayLike | None = None,
        axis: ArrayLike = (1.0, 0.0, 0.0),
        limits: tuple[float, float] = (-math.inf, math.inf),
        mimic: tuple[str, float, float] | None = None,
    ) -> None:
        def put(field: str, value: object) -> None:
            object.__setattr__(self, field, value)

        put("name", checks.text("name", name))
        where = f"joint {name!r}: "
        put("kind", checks.choice(f"{where}kind", kind, KINDS))
        put("parent", checks.text(f"{where}parent", parent))
        put("child", checks.text(f"{where}child", child))
        put("origin", checks.frozen(np.eye(4) if origin is None else rigid(f"{where}origin", origin)))
        put("axis", checks.frozen(_unit(f"{where}axis", axis)))
        put("limits", _limits(f"{where}limits", limits))
        put("mimic", None if mimic is None else _mimic(f"{where}mimic", mimic))

    @property
    def moves(self) -> bool:
        """Whether the joint has a value."""
        return self.kind != "fixed"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (
            self.name, self.kind, self.parent, self.child, self.origin, self.axis, self.limits, self.mimic,
        )  # fmt: skip

    def __repr__(self) -> str:
        return f"Joint({self.name!r}, {self.kind}, {self.parent!r} to {self.child!r})"


def _restored(
    name: str,
    kind: Kind,
    parent: str,
    child: str,
    origin: ArrayLike,
    axis: ArrayLike,
    limits: tuple[float, float],
    mimic: tuple[str, float, float] | None,
) -> Joint:
    return Joint(name, kind, parent, child, origin=origin, axis=axis, limits=limits, mimic=mimic)


def _unit(name: str, axis: ArrayLike) -> NDArray[np.float64]:
    vector = checks.vector(name, axis, 3)
    largest = float(np.abs(vector).max())
    if largest == 0:
        raise ArgumentError(f"{name}: must not be zero")
    # The division first, so that the squares neither overflow nor vanish.
    vector = vector / largest
    unit: NDArray[np.float64] = vector / np.linalg.norm(vector)
    return unit


def _limits(name: str, limits: Any) -> tuple[float, float]:
    pair = tuple(checks.items(name, limits, "two numbers"))
    if len(pair) != 2:
        raise ArgumentError(f"{name}: must be (lower, upper), got {checks.describe(limits)}")
    lower, upper = (checks.limit(name, value) for value in pair)
    if not lower <= upper:
        raise ArgumentError(f"{name}: the lower limit must not exceed the upper one, got {pair}")
    return lower, upper


def _mimic(name: str, mimic: Any) -> tuple[str, float, float]:
    parts = tuple(checks.items(name, mimic, "a name and two numbers"))
    if len(parts) != 3:
        raise ArgumentError(f"{name}: must be (name, multiplier, offset), got {checks.describe(mimic)}")
    return checks.text(name, parts[0]), checks.number(name, parts[1]), checks.number(name, parts[2])
