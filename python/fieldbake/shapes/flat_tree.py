"""Trees of flat profiles: discs, rectangles and polygons with their places, joined by operators."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np

from .. import _core
from .outlines.curves import Array, circle_points
from .shape import Shape, combine

#: Height of a subtracted profile over the height of the extrusion, so that its end faces are far from the solid.
TALLER = 64.0

#: Polygons farther from the origin than this many times their size are stored about their centre.
FAR = 8.0


@dataclass(frozen=True)
class Leaf:
    """A primitive of the core, moved by `offset`.

    The numbers of a polygon are the coordinates of its corners, loop after loop, and `counts` has the number of corners
    of each loop.
    """

    kind: str
    numbers: tuple[float, ...]
    counts: tuple[int, ...] = ()
    offset: tuple[float, float] = (0.0, 0.0)

    def moved(self, offset: tuple[float, float]) -> Leaf:
        """Move the profile by a vector."""
        return Leaf(self.kind, self.numbers, self.counts, (self.offset[0] + offset[0], self.offset[1] + offset[1]))

    def scaled(self, factor: float) -> Leaf:
        """Scale the profile about the origin."""
        x, y = self.offset
        return Leaf(self.kind, tuple(factor * x for x in self.numbers), self.counts, (factor * x, factor * y))

    def rotated(self, degrees: float) -> Leaf:
        """Rotate the profile about the origin, counter-clockwise."""
        sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
        turn = np.array([[cosine, -sine], [sine, cosine]])
        x, y = (turn @ self.offset).tolist()
        if self.kind == "circle":
            return Leaf("circle", self.numbers, (), (x, y))
        return polygon_leaf([loop @ turn.T for loop in self._own_loops()]).moved((x, y))

    def grown(self, distance: float) -> Leaf | None:
        """The points within a distance, where that is a leaf of the same kind; None for all others."""
        if self.kind == "circle" and self.numbers[0] + distance > 0:
            return Leaf("circle", (self.numbers[0] + distance,), (), self.offset)
        if self.kind == "rectangle" and distance <= 0 and min(self.numbers) + 2 * distance > 0:
            return Leaf("rectangle", tuple(side + 2 * distance for side in self.numbers), (), self.offset)
        return None

    def loops(self) -> list[Array]:
        """Polygons (m, 2), outer ones counter-clockwise and holes clockwise."""
        return [loop + self.offset for loop in self._own_loops()]

    def _own_loops(self) -> list[Array]:
        if self.kind == "circle":
            return [circle_points(self.numbers[0])]
        if self.kind == "rectangle":
            w, h = (side / 2 for side in self.numbers)
            return [np.array([(-w, -h), (w, -h), (w, h), (-w, h)])]
        corners = np.array(self.numbers).reshape(-1, 2)
        return np.split(corners, np.cumsum(self.counts)[:-1])

    def extruded(self, height: float, taper_deg: float = 0.0, chamfer: tuple[float, float] = (0.0, 0.0)) -> Shape:
        """Extrude the profile along z, centred at z = 0."""
        core = _core.Shape.extrude(self.kind, list(self.numbers), list(self.counts), height, taper_deg, chamfer)
        x, y = self.offset
        return Shape._wrap(core) if x == 0 and y == 0 else Shape._wrap(core).translate((x, y, 0.0))

    def revolved(self, offset: float) -> Shape:
        """Revolve the profile about z; `offset` is added to its x."""
        x, y = self.offset
        shape = Shape._wrap(_core.Shape.revolve(self.kind, list(self.numbers), list(self.counts), offset + x))
        return shape if y == 0 else shape.translate((0.0, 0.0, y))


@dataclass(frozen=True)
class Combined:
    """Profiles joined by an operator."""

    op: str
    parts: tuple[Tree, ...]

    def moved(self, offset: tuple[float, float]) -> Combined:
        """Move the profile by a vector."""
        return Combined(self.op, tuple(part.moved(offset) for part in self.parts))

    def scaled(self, factor: float) -> Combined:
        """Scale the profile about the origin."""
        return Combined(self.op, tuple(part.scaled(factor) for part in self.parts))

    def rotated(self, degrees: float) -> Combined:
        """Rotate the profile about the origin, counter-clockwise."""
        return Combined(self.op, tuple(part.rotated(degrees) for part in self.parts))

    def grown(self, _distance: float) -> None:
        """No combination is a leaf."""

    def loops(self) -> list[Array]:
        """Polygons (m, 2), outer ones counter-clockwise and holes clockwise."""
        loops = [part.loops() for part in self.parts]
        return reduce(lambda first, second: _core.combined_polygons(self.op, first, second), loops)

    def extruded(self, height: float, taper_deg: float = 0.0, chamfer: tuple[float, float] = (0.0, 0.0)) -> Shape:
        """Extrude the profile along z, centred at z = 0."""
        if taper_deg or any(chamfer):
            # The sides of the parts differ from the sides of the whole.
            return polygon_leaf(self.loops()).extruded(height, taper_deg, chamfer)
        # A subtracted part is taller, since equal end faces would leave a film of distance zero over the hole.
        tall = TALLER * height
        if self.op == "difference":
            first, *others = self.parts
            return combine("difference", [first.extruded(height), *(part.extruded(tall) for part in others)])
        if self.op == "xor":
            either = combine("union", [part.extruded(height) for part in self.parts])
            return combine("difference", [either, combine("intersection", [p.extruded(tall) for p in self.parts])])
        return combine(self.op, [part.extruded(height) for part in self.parts])

    def revolved(self, offset: float) -> Shape:
        """Revolve the profile about z; `offset` is added to its x."""
        return combine(self.op, [part.revolved(offset) for part in self.parts])


Tree = Leaf | Combined


def polygon_leaf(loops: list[Array]) -> Leaf:
    """A leaf of polygons (m, 2), outer ones counter-clockwise and holes clockwise."""
    offset = np.zeros(2)
    if loops:
        lower = np.min([loop.min(axis=0) for loop in loops], axis=0)
        upper = np.max([loop.max(axis=0) for loop in loops], axis=0)
        # Float32 is too coarse for corners far from the origin. Differences from multiples of powers of two are exact.
        size = 2.0 ** math.ceil(math.log2(max(float((upper - lower).max()), 1e-300)))
        if np.abs(lower).max() > FAR * size:
            offset = np.round(0.5 * (lower + upper) / size) * size
    numbers = tuple(np.concatenate([np.zeros((0, 2)), *(loop - offset for loop in loops)]).ravel().tolist())
    return Leaf("polygon", numbers, tuple(len(loop) for loop in loops), (float(offset[0]), float(offset[1])))
