"""The pairs of bodies that may collide."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .kinematics import Tree


def default_pairs(tree: Tree, has_geometry: list[bool], ignored: Iterable[tuple[int, int]]) -> NDArray[np.int64]:
    """List the pairs of bodies with geometry that may collide, (k, 2), the lower row first.

    Bodies that are joined by fixed joints only are left out, and so are bodies that are joined by moving joints through
    bodies without geometry: those usually touch at their joint.
    """
    count = len(tree.parents)
    edges: list[list[int]] = [[] for _ in range(count)]
    rigid: list[list[int]] = [[] for _ in range(count)]
    for child, parent in enumerate(tree.parents.tolist()):
        if parent >= 0:
            edges[child].append(parent)
            edges[parent].append(child)
            if not any(tree.joints[j].moves for j in tree.chains[child]):
                rigid[child].append(parent)
                rigid[parent].append(child)
    left_out = {(min(a, b), max(a, b)) for a, b in ignored}
    bodies = [i for i in range(count) if has_geometry[i]]
    for body in bodies:
        for start, through_geometry in ((edges, False), (rigid, True)):
            reached, waiting = {body}, [body]
            while waiting:
                at = waiting.pop()
                if at != body and has_geometry[at] and not through_geometry:
                    continue
                new = [other for other in start[at] if other not in reached]
                reached.update(new)
                waiting.extend(new)
            left_out.update((min(body, other), max(body, other)) for other in reached if has_geometry[other])
    pairs = [(a, b) for k, a in enumerate(bodies) for b in bodies[k + 1 :] if (a, b) not in left_out]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
