"""The octree of one mesh in MuJoCo's `mjModel`: its corners, its hanging corners, and values for them.

Each node is a box with eight values, one at each corner. MuJoCo reads the leaves only and interpolates trilinearly in
them, so the field is continuous if neighbouring leaves agree on their common face. Leaves that share a face differ by
at most one level. A corner is *hanging* if it lies inside an edge or a face of a leaf: the interpolant of that leaf has
the mean of 2 or 4 corners there, and the corner must have the same value.

    corner j of a node: x = j & 1, y = j >> 1 & 1, z = j >> 2        0 is the lower side, 1 the upper side

Corners are whole numbers on a lattice of 2^16 steps along each side of the root box, so equal corners of different
nodes have equal keys. Rounding cannot separate them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..base.errors import Error

#: Steps of the lattice along a side of the root box. Leaves of depth 15 still have a corner in the middle of an edge.
STEPS = 1 << 16

#: Bits of a coordinate in a key; a coordinate is from 0 to `STEPS`.
BITS = 17

#: The corners of a box as steps of its side, (8, 3), in MuJoCo's order.
CORNERS = np.array([(j & 1, j >> 1 & 1, j >> 2) for j in range(8)], dtype=np.int64)


def _midpoints() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The middles of the 12 edges and 6 faces of a box.

    Returns the middles in half sides, (18, 3), and for each the corners whose mean is the value there, (18, 4). The two
    corners of an edge are listed twice.
    """
    middles = [m for m in product((0, 1, 2), repeat=3) if m.count(1) in (1, 2)]
    rows = []
    for middle in middles:
        around = [j for j in range(8) if all(m == 1 or m == 2 * c for m, c in zip(middle, CORNERS[j], strict=True))]
        rows.append(around * (4 // len(around)))
    return np.array(middles, dtype=np.int64), np.array(rows, dtype=np.int64)


MIDDLES, MEANS = _midpoints()


@dataclass(frozen=True, eq=False)
class Octree:
    """The distinct corners of an octree and their places in its nodes.

    Attributes
    ----------
    lower, step : (3,) float64
        The lower corner of the root box, and the length of a step of the lattice.
    lattice : (k, 3) int64
        Distinct corners of all nodes, in steps of the lattice.
    rows : (n, 8) int64
        Row of `lattice` for each corner of each node.
    leaves : (n,) bool
        Whether a node has no children.
    hanging : list of (rows (h,), mean_rows (h, 4))
        Hanging corners and the corners of which they have the mean, coarse leaves first.
    """

    lower: NDArray[np.float64]
    step: NDArray[np.float64]
    lattice: NDArray[np.int64]
    rows: NDArray[np.int64]
    leaves: NDArray[np.bool_]
    hanging: list[tuple[NDArray[np.int64], NDArray[np.int64]]]

    @classmethod
    def of_arrays(cls, boxes: NDArray[np.float64], children: NDArray[np.int32]) -> Octree:
        """Make an octree from the arrays of its nodes, the root first.

        Parameters
        ----------
        boxes : (n, 6) float64
            Centre and half sides of each node: rows of `mjModel.oct_aabb`.
        children : (n, 8) int32
            Rows of the children, all -1 for a leaf: rows of `mjModel.oct_child`.
        """
        centers, halves = boxes[:, :3], boxes[:, 3:]
        lower, step = centers[0] - halves[0], 2 * halves[0] / STEPS
        exact = np.stack([centers - halves - lower, 2 * halves], axis=1) / step
        rounded = np.rint(exact)
        lows, sides = rounded[:, 0], rounded[:, 1]
        # A quarter of a step is far above the rounding of boxes, and below the offset of any other division of them.
        if not (np.abs(exact - rounded).max() <= 0.25 and (sides == sides[:, :1]).all() and sides.min() >= 2):
            raise Error("mujoco: the octree of the model has another layout than in MuJoCo 4; its boxes do not "
                        "halve the root box, or it is deeper than 15 levels")  # fmt: skip
        lows, sides = lows.astype(np.int64), sides.astype(np.int64)
        keys = _keys(lows[:, None] + CORNERS * sides[:, None])
        distinct, rows = np.unique(keys, return_inverse=True)
        leaves: NDArray[np.bool_] = np.all(children < 0, axis=1)
        return cls(lower, step, _places(distinct), rows.reshape(-1, 8), leaves,
                   _hanging(distinct, lows[leaves], sides[leaves, 0]))  # fmt: skip

    def fill(self, field: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Evaluate a field at the corners of all nodes.

        Parameters
        ----------
        field : callable
            Maps positions (k, 3) in the frame of the boxes to values (k,).

        Returns
        -------
        (n, 8) float64
            Values for `mjModel.oct_coeff`. Hanging corners have means, so the trilinear field is continuous.
        """
        values = np.zeros(len(self.lattice))
        free = np.ones(len(self.lattice), dtype=bool)
        for rows, _ in self.hanging:
            free[rows] = False
        values[free] = field(self.lower + self.lattice[free] * self.step)
        for rows, mean_rows in self.hanging:
            values[rows] = values[mean_rows].mean(axis=1)
        return values[self.rows]


def _keys(lattice: NDArray[np.int64]) -> NDArray[np.int64]:
    """One whole number for each corner (..., 3)."""
    keys: NDArray[np.int64] = (lattice[..., 2] << 2 * BITS) | (lattice[..., 1] << BITS) | lattice[..., 0]
    return keys


def _places(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The corners (k, 3) of keys (k,)."""
    mask = (1 << BITS) - 1
    return np.stack([keys & mask, keys >> BITS & mask, keys >> 2 * BITS], axis=-1)


def _hanging(
    keys: NDArray[np.int64], lows: NDArray[np.int64], sides: NDArray[np.int64]
) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Find the corners in the middles of edges and faces of leaves: one entry for each size of leaf, large ones first.

    Parameters
    ----------
    keys : (k,) int64
        Sorted keys of all corners.
    lows : (l, 3) int64
        Lower corners of the leaves.
    sides : (l,) int64
        Sides of the leaves, in steps.
    """
    found = []
    for side in np.unique(sides)[::-1]:
        low = lows[sides == side]
        middles = _keys(low[:, None] + MIDDLES * (side // 2)).ravel()
        places = np.minimum(np.searchsorted(keys, middles), len(keys) - 1)
        # Leaves around an edge or a face find the same corner, whose mean they share.
        rows, first = np.unique(np.where(keys[places] == middles, places, -1), return_index=True)
        rows, first = rows[rows >= 0], first[rows >= 0]
        leaf, kind = np.divmod(first, len(MIDDLES))
        around = low[leaf][:, None] + CORNERS[MEANS[kind]] * side
        found.append((rows, np.searchsorted(keys, _keys(around))))
    return found
