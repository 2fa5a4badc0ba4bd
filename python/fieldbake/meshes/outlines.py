"""Outlines of the inside of a field in a plane, by marching squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .loops import Array, Rows, cross, cycles, simple, successors
from .roots import roots

#: Sides of the blocks of samples that the bound on the slope excludes, from coarse to fine.
BLOCKS = (16, 4, 1)

#: Points at which a field is evaluated at once.
BATCH = 1 << 20

#: A root within this fraction of an edge of one of its ends is that end.
SNAP = 1e-9

#: Rounding of float32 distances, as a fraction of the longest side of the box: half a unit in the last place is 3e-8.
NOISE = 2e-7

#: Distance from a plane to the points that show its sides, in units of the rounding.
LIFT = 10.0

#: Largest distance of a vertex from the zero level because of the rounding, cells.
STRAY = 5e-4

#: Distance within which a corner counts as a point of a cell, cells.
BESIDE = 1e-6

#: Sine of the angle from which a turn of the outline within one cell is a corner, about 15 degrees.
CORNER_SINE = 0.25


@dataclass(frozen=True)
class PlaneField:
    """A field in a plane.

    Attributes
    ----------
    values : callable
        The field at world points (n, 3), (n,); negative inside.
    frame : (4, 4) float64
        World from plane: the plane is z = 0.
    slope : float
        Bound on the change of the field per world unit; infinite if it is not known.
    noise : float
        Rounding of the values, world units. Smaller magnitudes count as outside, so that a face in the plane takes one
        side of it, except on a common face of two parts: there both sides of the plane are inside.
    sides : callable, optional
        Distances (n,) of the centres (n, 3) of balls with radii (n,) from the surface, world units, and the side of
        each ball: 1 outside, -1 inside, 0 if it may have points on both sides. Without it, the slope decides.
    """

    values: Callable[[Array], NDArray[Any]]
    frame: Array
    slope: float = math.inf
    noise: float = 0.0
    sides: Callable[[Array, Array], tuple[Array, NDArray[np.int8]]] | None = None

    def world(self, x: Array, y: Array) -> Array:
        """World positions (n, 3) of points of the plane."""
        return self.frame[:3, 3] + x[:, None] * self.frame[:3, 0] + y[:, None] * self.frame[:3, 1]

    def at(self, x: Array, y: Array) -> Array:
        """Values at points of the plane, (n,)."""
        found = np.empty(len(x))
        for first in range(0, len(x), BATCH):
            rows = slice(first, first + BATCH)
            found[rows] = self._joined(self.world(x[rows], y[rows]))
        return found

    def _joined(self, points: Array) -> NDArray[Any]:
        """Values at points of the plane (n, 3), without the zeros on common faces of two parts.

        Magnitudes up to the rounding are divided by the slope of the field where that is below 1, so that they are
        distances in a field of any scale.
        """
        found = self.values(points)
        rows = np.flatnonzero(np.abs(found) <= self.noise)
        if self.noise > 0 and len(rows):
            step = LIFT * self.noise
            # Along the normal, both ways. Along the plane, for the slope of a field that is no distance.
            ways = self.frame[:3, [2, 2, 0, 1] if self.sides is None else [2, 2]].T * step
            ways[0] *= -1
            around = self.values((points[rows] + ways[:, None]).reshape(-1, 3)).reshape(len(ways), -1)
            own, beside = found[rows].astype(np.float64), around[:2].max(axis=0)
            slope = np.ones(len(rows))
            if self.sides is None:
                slope = np.clip(np.abs(around - own).max(axis=0) / step, np.finfo(np.float32).tiny, 1.0)
            found = found.astype(np.float64)
            found[rows] = np.where(beside < -self.noise * slope, beside, own) / slope
        return found

    def flat(self, x: Array, y: Array, reach: tuple[float, float], noise: float) -> NDArray[np.bool_]:
        """Whether a face lies in the plane at points where the field is zero but for rounding, (n,).

        Along both axes of the plane, the field is zero also at one of the two points at the distances `reach`.
        Magnitudes up to `noise` times the slope across the plane count as zero.
        """
        here = self.world(x, y)
        across = LIFT * self.noise * self.frame[:3, 2]
        change = self.values(here + across).astype(np.float64) - self.values(here - across)
        largest = noise * np.abs(change) / (2 * LIFT * self.noise)
        found = np.ones(len(x), np.bool_)
        for axis, side in enumerate(reach):
            along = side * self.frame[:3, axis]
            found &= np.minimum(*(np.abs(self.values(here + step)) for step in (along, -along))) <= largest
        return found

    def rounding(self, x: Array, y: Array) -> float:
        """The magnitude below which values at the nodes of a grid count as outside."""
        steps = [float(np.diff(axis).min()) for axis in (x, y) if len(axis) > 1]
        return min([self.noise, *(STRAY * step for step in steps)])

    def samples(self, x: Array, y: Array, reach: float = 0.0) -> NDArray[np.float32]:
        """Values at the nodes of a grid, (len(y), len(x)).

        Nodes that are farther from zero than `reach` may have the value of a node or point beside them, which has the
        same sign and is farther than `reach` too.
        """
        size = np.array([len(y), len(x)])
        found = np.empty(size, np.float32)
        if self.sides is None and not math.isfinite(self.slope):
            step = max(1, BATCH // len(x))
            for first in range(0, len(y), step):
                some = y[first : first + step]
                found[first : first + step] = self.at(np.tile(x, len(some)), np.repeat(some, len(x))).reshape(
                    -1, len(x)
                )
            return found
        starts = np.stack(np.meshgrid(*(np.arange(0, n, BLOCKS[0]) for n in size), indexing="ij"), axis=-1).reshape(
            -1, 2
        )
        for side, finer in zip(BLOCKS, (*BLOCKS[1:], 0), strict=True):
            ends = np.minimum(starts + side, size) - 1
            low, high = (np.stack([x[nodes[:, 1]], y[nodes[:, 0]]]) for nodes in (starts, ends))
            (middle_x, middle_y), radii = 0.5 * (low + high), 0.5 * np.hypot(*(high - low))
            if finer:
                centers, near = self._balls(middle_x, middle_y, radii, reach)
            else:
                centers, near = self.at(middle_x, middle_y), np.zeros(len(radii), np.bool_)
            done = np.flatnonzero(~near)
            rows, columns = (
                np.minimum(starts[done, axis, None] + np.arange(side), ends[done, axis, None]) for axis in (0, 1)
            )
            found[rows[:, :, None], columns[:, None, :]] = centers[done, None, None]
            if finer:
                inner = np.stack(np.meshgrid(*2 * [np.arange(0, side, finer)], indexing="ij"), axis=-1).reshape(-1, 2)
                starts = (starts[near, None] + inner).reshape(-1, 2)
                starts = starts[(starts < size).all(axis=1)]
        return found

    def _balls(self, x: Array, y: Array, radii: Array, reach: float) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Values at the centres of balls, (n,), and whether points of them may have another side or lie in `reach`."""
        points = self.world(x, y)
        if self.sides is not None:
            distances, sides = self.sides(points, radii + reach)
            return distances * sides, sides == 0
        found = self.values(points)
        # The factor covers the rounding of float32.
        return found, np.abs(found) * (1 - 1e-5) <= self.slope * radii + reach

    def outlines(self, x: Array, y: Array) -> list[Array]:
        """Loops of the zero level, (m, 2) each, in the cells of a grid; the border of the grid closes them.

        Marching squares on the nodes: each crossed edge has one vertex, at the root of the field. A cell whose inside
        corners lie across from each other is decided by the value in its middle. Corners of the outline within a cell
        become vertices: L. Kobbelt et al., "Feature Sensitive Surface Extraction from Volume Data" (2001), with the
        directions of the neighbouring segments in place of gradients.
        """
        noise = self.rounding(x, y)
        # A ring of outside nodes at the same positions as the border.
        values = np.pad(self.samples(x, y, noise), 1, constant_values=1.0)
        x, y = np.pad(x, 1, mode="edge"), np.pad(y, 1, mode="edge")
        width = len(x)
        inside = values < -noise
        code = inside[:-1, :-1] + 2 * inside[:-1, 1:] + np.uint8(4) * inside[1:, 1:] + np.uint8(8) * inside[1:, :-1]
        row, column = np.nonzero((code > 0) & (code < 15))
        if not len(row):
            return []
        grid, code = code, code[row, column]
        # Corners counter-clockwise from the lower left; edge e runs from corner e to the next one.
        is_in = (code[:, None] >> np.arange(4, dtype=np.uint8)) & 1 > 0
        saddle = (code == 5) | (code == 10)
        apart = np.zeros(len(code), np.bool_)
        middle = row[saddle], column[saddle]
        apart[saddle] = ~(
            self.at((x[middle[1]] + x[middle[1] + 1]) / 2, (y[middle[0]] + y[middle[0] + 1]) / 2) < -noise
        )
        starts: list[Rows] = []
        ends: list[Rows] = []
        cells: list[Rows] = []
        for edge in range(4):
            here, second, third = (is_in[:, (edge + step) % 4] for step in (0, 2, 3))
            cell = np.flatnonzero(here & ~is_in[:, (edge + 1) % 4])
            # A segment begins where the cell is left, counter-clockwise, and ends where it is entered again.
            steps = np.where(apart, 3, np.where(second, 1, np.where(third, 2, 3)))[cell]
            for keys, edges in ((starts, np.full(len(cell), edge)), (ends, (edge + steps) % 4)):
                node = (row[cell] + (edges == 2)) * width + column[cell] + (edges == 1)
                keys.append(2 * node + edges % 2)
            cells.append(cell)
        start, end, cell = (np.concatenate(lists) for lists in (starts, ends, cells))
        following = successors(start, end)
        assert following is not None  # each crossed edge has one segment on both sides
        points = self._vertices(start, values, x, y, noise)
        places = np.stack([row[cell], column[cell]], axis=1)
        corners = self._corners(points, following, np.where(saddle[cell, None], -1, places), grid, x, y, noise)
        both = np.stack([points, corners], axis=1)
        rings: list[Array] = []
        for loop in cycles(following):
            ring = both[loop].reshape(-1, 2)
            rings.extend(simple(ring[np.isfinite(ring[:, 0])]))
        return rings

    def _vertices(self, keys: Rows, values: NDArray[np.float32], x: Array, y: Array, noise: float) -> Array:
        """Roots of the field on crossed edges, (n, 2)."""
        first = np.stack(np.divmod(keys >> 1, len(x)))
        second = first + np.stack([keys & 1, 1 - (keys & 1)])
        low, high = (values[tuple(nodes)].astype(np.float64) for nodes in (first, second))
        starts, ends = (np.stack([x[nodes[1]], y[nodes[0]]], axis=1) for nodes in (first, second))
        shares = np.clip(low / (low - high), 0.0, 1.0)
        # Edges to the ring of outside nodes have no length.
        rows = np.flatnonzero((starts != ends).any(axis=1))
        exact = self._roots(starts[rows], ends[rows], shares[rows], noise)
        shares[rows] = np.where(np.isfinite(exact), exact, shares[rows])
        shares = np.where(shares < SNAP, 0.0, np.where(shares > 1 - SNAP, 1.0, shares))[:, None]
        found: Array = starts * (1 - shares) + ends * shares
        return found

    def _roots(self, starts: Array, ends: Array, shares: Array, noise: float) -> Array:
        """Fractions of segments of the plane before the zero of the field; nan where the ends have the same side."""
        found, exists = roots(self._joined, self.world(*starts.T), self.world(*ends.T), shares, noise)
        found[~exists] = np.nan
        return found

    def _corners(
        self, points: Array, following: Rows, cells: Rows, code: NDArray[np.uint8], x: Array, y: Array, noise: float
    ) -> Array:
        """Corners of the outline between each point and its follower, (n, 2); nan where the outline is smooth.

        A corner lies in the cell of its segment, a row of `cells` (n, 2), or in a cell beside it that no segment
        crosses; `code` has the inside corners of all cells. Outlines therefore do not cross.
        """
        corners = np.full_like(points, np.nan)
        previous = np.empty_like(following)
        previous[following] = np.arange(len(following))
        end = points[following]
        before, after = points - points[previous], points[following[following]] - end
        turn = cross(before, after)
        lengths = np.hypot(*before.T) * np.hypot(*after.T)
        rows = np.flatnonzero((np.abs(turn) > CORNER_SINE * lengths) & (cells[:, 0] >= 0))
        begin, end, before, after, turn = (each[rows] for each in (points, end, before, after, turn))
        middle = 0.5 * (begin + end)
        ahead = before * (cross(end - begin, after) / turn)[:, None]
        # The field has its zero on the line from the middle of the segment through the intersection of both sides.
        beyond = middle + 1.25 * (begin + ahead - middle)
        near = (np.abs(beyond - middle).max(axis=1) < 2 * max(np.diff(x).max(), np.diff(y).max())) & (
            np.einsum("ij,ij->i", ahead, before) > 0
        )
        rows, middle, beyond = rows[near], middle[near], beyond[near]
        share = self._roots(middle, beyond, np.full(len(rows), 0.8), noise)
        places = middle + np.nan_to_num(share)[:, None] * (beyond - middle)
        # A corner at the border of its cell, up to rounding, belongs to the cell.
        row, column = np.maximum(cells[rows], 0).T
        low, high = (np.stack([x[column + step], y[row + step]], axis=1) for step in (0, 1))
        inner = np.clip(places, low, high)
        beside = (np.abs(places - inner) <= BESIDE * (high - low)).all(axis=1)
        places[beside] = inner[beside]
        found = np.stack([np.searchsorted(y, places[:, 1]), np.searchsorted(x, places[:, 0])], axis=1) - 1
        found = np.clip(found, 0, np.array(code.shape) - 1)
        steps = np.where(beside, 0, np.abs(found - cells[rows]).sum(axis=1))
        _, number, counts = np.unique(found, axis=0, return_inverse=True, return_counts=True)
        alone = (steps == 1) & (code[tuple(found.T)] % 15 == 0) & (counts[number.reshape(-1)] == 1)
        kept = (share > 0.1) & ((steps == 0) | alone)
        corners[rows[kept]] = places[kept]
        return corners


def cut_by_box(values: Callable[[Array], NDArray[Any]], bounds: Array) -> Callable[[Array], Array]:
    """Values of a field whose solid is cut by a box (2, 3)."""

    def within(points: Array) -> Array:
        outside = np.maximum(bounds[0] - points, points - bounds[1]).max(axis=1)
        found: Array = np.maximum(values(np.clip(points, *bounds)), outside)
        return found

    return within
