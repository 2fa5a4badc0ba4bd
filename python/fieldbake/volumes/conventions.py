"""Axes and units of other programs: their right, up and forward directions, and their scale of fields.

fieldbake's space is right-handed with y upwards, as in glTF. Each engine's convention follows its own glTF or
model importer, so that a field lies where the imported mesh lies.

=========  ============  ==  ===========================  ==============================================
engine     handedness    up  file's (x, y, z)             also
=========  ============  ==  ===========================  ==============================================
unity      left          y   (-x, y, z)                   normalised; sheets: ``.meta``, tiles upside down
unreal     left          z   (x, z, y)                    sheets: tile sizes in the JSON
godot      right         y   (x, y, z)                    sheets: ``.import``, one column
blender    right         z   (x, -z, y)
three      right         y   (x, y, z)
=========  ============  ==  ===========================  ==============================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..files.grids.band_blocks import SIDE, BandBlocks

Engine = Literal["unity", "unreal", "godot", "blender", "three"]
Handedness = Literal["right", "left"]
Up = Literal["y", "z"]

_ENGINES: dict[str, tuple[Handedness, Up, bool]] = {
    "unity": ("left", "y", True),
    "unreal": ("left", "z", False),
    "godot": ("right", "y", False),
    "blender": ("right", "z", False),
    "three": ("right", "y", False),
}
ENGINES = tuple(_ENGINES)


@dataclass(frozen=True)
class Convention:
    """Axes and units of a file: axis i of the file is ``signs[i]`` times axis ``order[i]`` of the field."""

    engine: str | None
    handedness: Handedness
    up: Up
    normalize: bool
    order: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def is_identity(self) -> bool:
        """Whether the convention is the field's own."""
        return self.order == (0, 1, 2) and min(self.signs) > 0 and not self.normalize

    def array(self, samples: NDArray[Any]) -> NDArray[Any]:
        """Arrange samples (nx, ny, nz) along the axes of the file, x fastest."""
        turned = samples.transpose(self.order)[tuple(slice(None, None, sign) for sign in self.signs)]
        return np.asfortranarray(turned)

    def blocks(self, blocks: BandBlocks, bounds: NDArray[np.float64]) -> BandBlocks:
        """Transform a level set to the space of the file. Blocks stay aligned, so a block may begin before the grid."""
        if self.is_identity:
            return blocks
        order, scale = self.order, self.scale(bounds)
        counts = [blocks.inside.shape[axis] for axis in order]
        spacing, corner = blocks.spacing[list(order)] * scale, blocks.corners[:, order].copy()
        first = blocks.origin.copy()
        flips = tuple(slice(None, None, sign) for sign in self.signs)
        within = (slice(None), *flips)
        for i, sign in enumerate(self.signs):
            if sign < 0:
                corner[:, i] = SIDE * (counts[i] - 1) - corner[:, i]
                first[order[i]] += (SIDE * counts[i] - 1) * blocks.spacing[order[i]]
        placed = self.transform(bounds)
        values = blocks.values.transpose(0, *(axis + 1 for axis in order))[within]
        sorting = np.lexsort(corner.T[::-1])
        nx, ny, nz = (blocks.shape[axis] for axis in order)
        return BandBlocks(
            (nx, ny, nz),
            placed[:3, :3] @ first + placed[:3, 3],
            spacing,
            float(np.float32(blocks.band * scale)),
            corner[sorting],
            np.ascontiguousarray(values[sorting] * np.float32(scale)),
            blocks.inside.transpose(order)[flips],
        )

    def box(self, bounds: NDArray[np.float64], placed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform a box (2, 3) to the space of the file; `placed` is :meth:`transform` of the outer box."""
        corners = bounds @ placed[:3, :3].T + placed[:3, 3]
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def scale(self, bounds: NDArray[np.float64]) -> float:
        """Length in the file of a world unit; the longest side of a normalised box is 1."""
        return 1 / float((bounds[1] - bounds[0]).max()) if self.normalize else 1.0

    def transform(self, bounds: NDArray[np.float64]) -> NDArray[np.float64]:
        """The matrix file-from-world, (4, 4)."""
        turn = np.zeros((3, 3))
        turn[range(3), self.order] = self.signs
        matrix = np.eye(4)
        matrix[:3, :3] = turn * self.scale(bounds)
        if self.normalize:
            matrix[:3, 3] = -matrix[:3, :3] @ bounds.mean(axis=0)
        return matrix

    def facts(self, bounds: NDArray[np.float64]) -> dict[str, Any]:
        """Metadata of a file about its space; empty if the space is the field's own."""
        if self.is_identity:
            return {}
        told = {"engine": self.engine, "handedness": self.handedness, "up": self.up, "normalized": self.normalize}
        return {"convention": {**told, "file_from_world": self.transform(bounds).tolist()}}


def convention(engine: object, handedness: object, up: object, normalize: object) -> Convention:
    """Make the convention of named options; each option replaces the engine's."""
    hand, upwards, unit = "right", "y", False
    name: str | None = None
    if engine is not None:
        name = checks.choice("engine", engine, ENGINES)
        hand, upwards, unit = _ENGINES[name]
    if handedness is not None:
        hand = checks.choice("handedness", handedness, ("right", "left"))
    if up is not None:
        upwards = checks.choice("up", up, ("y", "z"))
    if normalize is not None:
        unit = checks.flag("normalize", normalize)
    order, signs = ((0, 1, 2), [1, 1, 1]) if upwards == "y" else ((0, 2, 1), [1, -1, 1])
    if hand == "left":
        axis = 0 if upwards == "y" else 1
        signs[axis] = -signs[axis]
    return Convention(name, hand, upwards, unit, order, (signs[0], signs[1], signs[2]))  # type: ignore[arg-type]
