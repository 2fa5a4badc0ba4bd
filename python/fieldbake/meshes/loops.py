"""Closed loops in a plane: chains of segments, simple rings, areas and nesting.

Loops (m, 2) have the material on their left: outer loops are counter-clockwise and holes are clockwise. The first point
is not repeated at the end.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

#: Least number of points of a loop at which the loops around it are counted, if it has fewer edges.
PROBES = 32

#: Distance at which a point counts as on an edge, relative to the largest coordinate: some roundings of each.
TOUCH = 16 * 2.0**-53

#: Points that are compared with all edges at once.
BATCH = 1 << 12


def cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (..., 2), (...)."""
    found: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found


def successors(start: Rows, end: Rows) -> Rows | None:
    """Row of the segment that continues each segment, (n,), from the keys of their ends; None if some have none."""
    by_start, by_end = np.argsort(start, kind="stable"), np.argsort(end, kind="stable")
    if not np.array_equal(start[by_start], end[by_end]):
        return None
    following = np.empty(len(start), np.int64)
    following[by_end] = by_start
    return following


def without_copies(start: Rows, end: Rows) -> Rows:
    """Rows of different segments without those that a reversed copy of a face adds, in order.

    A copy makes the number of segments at two keys odd. On the shortest path of opposite segments between these keys,
    the segments that end in excess are left out. Opposite segments of two solids have even keys and stay.
    """
    rows = {ends: row for row, ends in enumerate(zip(start.tolist(), end.tolist(), strict=True))}
    before: dict[int, list[int]] = {}
    for key, following in rows:
        if (following, key) in rows:
            before.setdefault(following, []).append(key)
    excess = Counter(start.tolist())
    excess.subtract(end.tolist())
    odd = {key for key, count in excess.items() if count % 2}
    for first in sorted(odd & before.keys(), key=lambda key: (excess[key], key)):
        path, queue = {first: first}, [first] if first in odd else []
        for here in queue:
            if here in odd and here != first:
                odd -= {first, here}
                while here != first:
                    del rows[here, path[here]]
                    here = path[here]
                break
            for key in before[here]:
                if key not in path and (here, key) in rows and (key, here) in rows:
                    path[key] = here
                    queue.append(key)
    return np.array(sorted(rows.values()))


def cycles(following: Rows) -> list[Rows]:
    """Rows of each cycle of a permutation, in order."""
    steps, seen, found = following.tolist(), bytearray(len(following)), []
    for row in range(len(steps)):
        loop = []
        while not seen[row]:
            seen[row] = 1
            loop.append(row)
            row = steps[row]
        if loop:
            found.append(np.array(loop))
    return found


def chains(start: Rows, end: Rows) -> tuple[list[Rows], list[Rows]]:
    """Closed and open chains of undirected segments, as rows of ``concatenate([start, end])``.

    Ends with equal keys are joined in pairs.
    """
    count = len(start)
    keys = np.concatenate([start, end])
    order = np.argsort(keys, kind="stable")
    sorted_keys = keys[order]
    rank = np.arange(2 * count) - np.searchsorted(sorted_keys, sorted_keys)
    first = np.flatnonzero((rank[:-1] % 2 == 0) & (sorted_keys[:-1] == sorted_keys[1:]))
    partners = np.full(2 * count, -1)
    partners[order[first]], partners[order[first + 1]] = order[first + 1], order[first]
    partner, seen = partners.tolist(), bytearray(count)
    closed: list[Rows] = []
    open: list[Rows] = []
    for own in [*np.flatnonzero(partners < 0).tolist(), *range(count)]:
        chain, here = [], own
        while here >= 0 and not seen[here % count]:
            seen[here % count] = 1
            chain.append(here)
            last = (here + count) % (2 * count)
            here = partner[last]
        if chain:
            (open if here < 0 else closed).append(np.array([*chain, last] if here < 0 else chain))
    return closed, open


def simple(ring: Array) -> list[Array]:
    """Divide a ring at its repeated points into rings without them; rings of one or two points are dropped.

    Points in the middle of segments along an axis of the plane are dropped too.
    """
    ring = ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)]
    before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
    ring = ring[~((ring == before) & (ring == after)).any(axis=1)]
    rings = []
    if len(np.unique(ring, axis=0)) < len(ring):
        kept: list[tuple[float, ...]] = []
        places: dict[tuple[float, ...], int] = {}
        for point in map(tuple, ring.tolist()):
            if point in places:
                place = places[point]
                rings.append(np.array(kept[place:]))
                for dropped in kept[place:]:
                    del places[dropped]
                del kept[place:]
            places[point] = len(kept)
            kept.append(point)
        ring = np.array(kept)
    return [one for one in (*rings, ring) if len(one) > 2]


def area(loop: Array) -> float:
    """Signed area of a loop, positive if it is counter-clockwise."""
    moved = loop - loop[0]
    return 0.5 * float(cross(moved, np.roll(moved, -1, axis=0)).sum())


def length(loop: Array) -> float:
    """Length of a closed loop."""
    return float(np.hypot(*(loop - np.roll(loop, 1, axis=0)).T).sum())


def windings(loops: list[Array], places: Array, owners: Rows) -> tuple[Rows, NDArray[np.bool_]]:
    """Sum of the winding numbers of loops around points (n, 2), (n,), without the loop that owns each point.

    The second result is True for points on an edge of another loop, where the winding number is not defined.
    """
    starts, ends = np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    numbers = np.repeat(np.arange(len(loops)), [len(loop) for loop in loops])
    lower, upper = np.minimum(starts, ends), np.maximum(starts, ends)
    found, touching = np.zeros(len(places), np.int64), np.zeros(len(places), np.bool_)
    reach = (upper - lower).sum(axis=1)
    rounding = TOUCH * max(np.abs(starts).max(), np.abs(places).max())
    order = np.argsort(places[:, 1], kind="stable")
    for first in range(0, len(order), BATCH):
        rows = order[first : first + BATCH]
        # An edge is compared with the points between the heights of its ends, which are neighbours in order.
        heights = places[rows, 1]
        begin, end = np.searchsorted(heights, lower[:, 1]), np.searchsorted(heights, upper[:, 1], side="right")
        counts = end - begin
        edge = np.repeat(np.arange(len(starts)), counts)
        row = rows[np.arange(len(edge)) + np.repeat(begin - np.cumsum(counts) + counts, counts)]
        place, along, others = places[row], (ends - starts)[edge], owners[row] != numbers[edge]
        left = cross(along, place - starts[edge])
        ascends = along[:, 1] > 0
        crossed = np.where(ascends, left > 0, left < 0) & others & (place[:, 1] < upper[edge, 1])
        np.add.at(found, row, np.where(crossed, np.where(ascends, 1, -1), 0))
        near = np.flatnonzero(others & (np.abs(left) <= rounding * reach[edge]))
        row, edge = row[near], edge[near]
        x = places[row, 0]
        touching[row[(x >= lower[edge, 0] - rounding) & (x <= upper[edge, 0] + rounding)]] = True
    return found, touching


def nested(loops: list[Array], *, oriented: bool) -> tuple[list[Array], bool]:
    """Keep the loops between the inside and the outside, with the material on their left.

    A point is inside if the sum of the winding numbers is not 0; if the loops are not `oriented`, if it is odd. The
    second result is False if loops cross or cover each other; all of them are kept then. Loops may touch along edges.
    """
    if not loops:
        return [], True
    probes = []
    for loop in loops:
        # Points inside edges, since vertices of loops may touch.
        edges = np.arange(0, len(loop), max(1, len(loop) // PROBES))
        shares = (np.arange(-(-PROBES // len(edges))) + 0.38) / -(-PROBES // len(edges))
        along = loop[(edges + 1) % len(loop)] - loop[edges]
        probes.append((loop[edges, None] + shares[:, None] * along[:, None]).reshape(-1, 2))
    owners = np.repeat(np.arange(len(loops)), [len(each) for each in probes])
    around, touching = windings(loops, np.concatenate(probes), owners)
    owners, around = owners[~touching], around[~touching]
    if len(np.unique(owners)) < len(loops):
        return loops, False
    kept, first = [], np.searchsorted(owners, np.arange(len(loops)))
    for loop, outer in zip(loops, around[first].tolist(), strict=True):
        sign = 1 if area(loop) > 0 else -1
        outside, inside = (outer != 0, outer + sign != 0) if oriented else (outer % 2 != 0, outer % 2 == 0)
        if inside != outside:
            kept.append(loop if inside == (sign > 0) else loop[::-1])
    return (kept, True) if (around == around[first][owners]).all() else (loops, False)


def cut(loops: list[Array], lower: Array, upper: Array) -> list[Array]:
    """Intersect the inside of loops, which do not cross each other, with a rectangle."""
    for axis, limit, sign in ((0, lower[0], -1), (0, upper[0], 1), (1, lower[1], -1), (1, upper[1], 1)):
        kept: list[Array] = []
        pieces: list[Array] = []
        for whole in loops:
            out = sign * (whole[:, axis] - limit) > 0
            if out.all():
                continue
            if not out.any():
                kept.append(whole)
                continue
            # Each run of points inside becomes a piece, with the crossings at its ends.
            first = int(np.flatnonzero(out)[0])
            loop, out = np.roll(whole, -first, axis=0), np.roll(out, -first)
            along, turns = np.roll(loop, -1, axis=0) - loop, out != np.roll(out, -1)
            share = np.where(turns, limit - loop[:, axis], 0.0) / np.where(turns, along[:, axis], 1.0)
            crossing = loop + along * share[:, None]
            crossing[:, axis] = limit
            enters, leaves = (np.flatnonzero(turns & side) for side in (out, ~out))
            for enter, leave in zip(enters, leaves, strict=True):
                ends = crossing[[enter]], crossing[[leave]]
                pieces.append(np.concatenate([ends[0], loop[enter + 1 : leave + 1], ends[1]]))
        if pieces:
            # Along the border, counter-clockwise, the outline leaves and enters in turn.
            turn = sign if axis == 0 else -sign
            places = turn * np.array([piece[[0, -1], 1 - axis] for piece in pieces])
            following = np.empty(len(pieces), np.int64)
            following[np.argsort(places[:, 1], kind="stable")] = np.argsort(places[:, 0], kind="stable")
            for chain in cycles(following):
                kept.extend(simple(np.concatenate([pieces[number] for number in chain])))
        loops = kept
    return loops
