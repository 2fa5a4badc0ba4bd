"""NanoVDB files, ABI 32: the writer of level sets for warp, Omniverse and fVDB.

A file has a header, the metadata of the grid, its name and the grid itself. The grid is one block of memory, as a
program maps it: grid, tree and root records, then all upper nodes, all lower nodes and all leaves. An internal node
refers to a child by the offset in bytes from itself.

Source: ``NanoVDB.h`` of OpenVDB, whose comments give the offset of every member.
"""

from __future__ import annotations

import struct
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .band_blocks import SIDE, BandBlocks
from .openvdb import LOWER, LOWER_VOXELS, UPPER, UPPER_VOXELS

MAGIC = 0x304244566F6E614E  # "NanoVDB0"
VERSION = 32 << 21 | 4 << 10 | 2
#: Grid type float, grid class level set.
FLOAT, LEVEL_SET = 1, 1
#: Nodes have boxes and extremes of their active values; the nodes of a level lie together.
FLAGS = 1 << 1 | 1 << 2 | 1 << 5
NO_CHECKSUM = 2**64 - 1
GRID_BYTES, TREE_BYTES, ROOT_BYTES, TILE_BYTES = 672, 64, 64, 32
NAME_BYTES = 256


def _internal(children: int) -> np.dtype[Any]:
    """An internal node with `children` along each side."""
    count = children**3
    return np.dtype(
        {
            "names": ["lowest", "highest", "flags", "value_mask", "child_mask", "extremes", "table"],
            "formats": ["3<i4", "3<i4", "<u8", f"{count // 8}u1", f"{count // 8}u1", "4<f4", f"{count}<i8"],
            "offsets": [0, 12, 24, 32, 32 + count // 8, 32 + count // 4, 64 + count // 4],
            "itemsize": 64 + count // 4 + 8 * count,
        }
    )


UPPER_NODE, LOWER_NODE = _internal(UPPER), _internal(LOWER)
LEAF = np.dtype(
    {
        "names": ["lowest", "extent", "flags", "mask", "extremes", "values"],
        "formats": ["3<i4", "3u1", "u1", "64u1", "4<f4", "512<f4"],
        "offsets": [0, 12, 15, 16, 80, 96],
        "itemsize": 96 + 4 * SIDE**3,
    }
)


def write(stream: IO[bytes], blocks: BandBlocks, *, name: str) -> None:
    """Write one level set."""
    title = name.encode()[: NAME_BYTES - 1]
    tree = _Tree(blocks)
    size = GRID_BYTES + tree.nbytes
    lowest, highest = tree.box
    world = [blocks.origin + lowest * blocks.spacing, blocks.origin + (highest + 1) * blocks.spacing]
    counts = [len(tree.leaves), len(tree.lowers), len(tree.uppers)]
    stream.write(struct.pack("<QIHH", MAGIC, VERSION, 1, 0))
    stream.write(struct.pack("<4Q2I", size, size, 0, tree.active_count, FLOAT, LEVEL_SET))
    stream.write(struct.pack("<6d6i3d", *world[0], *world[1], *lowest, *highest, *blocks.spacing))
    stream.write(struct.pack("<I4I3I2HI", len(title) + 1, *counts, 1, 0, 0, 0, 0, 0, VERSION))
    stream.write(title + b"\0")
    stream.write(struct.pack("<2Q4IQ", MAGIC, NO_CHECKSUM, VERSION, FLAGS, 0, 1, size))
    stream.write(title.ljust(NAME_BYTES, b"\0"))
    scale, inverse = np.diag(blocks.spacing).reshape(-1), np.diag(1 / blocks.spacing).reshape(-1)
    for number in ("f", "d"):
        stream.write(struct.pack(f"<22{number}", *scale, *inverse, *blocks.origin, 1.0))
    stream.write(struct.pack("<6d3d2I", *world[0], *world[1], *blocks.spacing, LEVEL_SET, FLOAT))
    stream.write(struct.pack("<q2I2Q", 0, 0, 0, 0, 0))
    tree.write(stream)


class _Tree:
    """The nodes of each level as records, in the order of the file."""

    def __init__(self, blocks: BandBlocks) -> None:
        self.band = np.float32(blocks.band)
        self._make_leaves(blocks)
        self._make_lowers(blocks)
        self._make_uppers()
        self.nbytes = TREE_BYTES + ROOT_BYTES + TILE_BYTES * len(self.uppers)
        self.nbytes += self.uppers.nbytes + self.lowers.nbytes + self.leaves.nbytes

    def _make_leaves(self, blocks: BandBlocks) -> None:
        corners = blocks.corners
        # Leaves are sorted by upper node, then by lower node, then by slot: the order of a traversal of the tree.
        keys = (corners // UPPER_VOXELS, corners // LOWER_VOXELS, corners // SIDE)
        order = np.lexsort([key[:, axis] for key in keys[::-1] for axis in (2, 1, 0)])
        self.corners, active = corners[order], blocks.active[order]
        values = blocks.values[order].reshape(-1, SIDE**3)
        self.leaves = leaves = np.zeros(len(order), LEAF)
        low, high = np.empty((len(order), 3), np.int64), np.empty((len(order), 3), np.int64)
        for axis in range(3):
            held = np.asarray(active.any(axis=tuple(other + 1 for other in range(3) if other != axis)))
            low[:, axis] = held.argmax(axis=1)
            high[:, axis] = SIDE - 1 - held[:, ::-1].argmax(axis=1)
        is_active = active.any(axis=(1, 2, 3))
        low[~is_active], high[~is_active] = 0, 0
        leaves["lowest"] = self.corners + low
        leaves["extent"] = high - low
        leaves["flags"] = np.where(is_active, 2, 0)
        flat = active.reshape(-1, SIDE**3)
        leaves["mask"] = np.packbits(flat, axis=1, bitorder="little")
        leaves["extremes"][:, 0] = np.where(is_active, np.where(flat, values, np.inf).min(axis=1), self.band)
        leaves["extremes"][:, 1] = np.where(is_active, np.where(flat, values, -np.inf).max(axis=1), self.band)
        leaves["values"] = values
        self.active_count = int(flat.sum())

    def _make_lowers(self, blocks: BandBlocks) -> None:
        counts = [-(-side // LOWER) for side in blocks.inside.shape]
        padded = np.zeros([count * LOWER for count in counts], np.bool_)
        padded[tuple(slice(side) for side in blocks.inside.shape)] = blocks.inside
        by_node = padded.reshape(counts[0], LOWER, counts[1], LOWER, counts[2], LOWER).transpose(0, 2, 4, 1, 3, 5)
        places = np.concatenate([self.corners // LOWER_VOXELS, np.argwhere(by_node.any(axis=(3, 4, 5)))])
        places = np.unique(places, axis=0)
        order = np.lexsort([key[:, axis] for key in (places, places // UPPER) for axis in (2, 1, 0)])
        self.lower_places = places[order]
        self.lowers, parent = self._nodes(LOWER_NODE, self.lower_places, self.corners // LOWER_VOXELS, LOWER_VOXELS)
        inside = by_node[tuple(self.lower_places.T)].reshape(len(places), -1)
        bits = np.where(inside, -self.band, self.band).astype("<f4").view("<u4")
        self.lowers["table"] = bits
        slots = _slots(self.corners // SIDE % LOWER, LOWER)
        start = self.lowers.nbytes - parent * LOWER_NODE.itemsize
        self._link(self.lowers, parent, slots, start + np.arange(len(self.leaves)) * LEAF.itemsize, self.leaves)

    def _make_uppers(self) -> None:
        places = np.unique(self.lower_places // UPPER, axis=0)
        self.upper_places = places
        self.uppers, parent = self._nodes(UPPER_NODE, places, self.lower_places // UPPER, UPPER_VOXELS)
        self.uppers["table"] = np.array(self.band, "<f4").view("<u4")
        slots = _slots(self.lower_places % UPPER, UPPER)
        start = self.uppers.nbytes - parent * UPPER_NODE.itemsize
        self._link(self.uppers, parent, slots, start + np.arange(len(self.lowers)) * LOWER_NODE.itemsize, self.lowers)

    def _nodes(
        self, kind: np.dtype[Any], places: NDArray[np.int64], children: NDArray[np.int64], voxels: int
    ) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Empty nodes at `places`, and the index of the parent of each child."""
        nodes = np.zeros(len(places), kind)
        nodes["lowest"] = places * voxels
        nodes["highest"] = places * voxels
        nodes["extremes"][:, :2] = self.band
        index = {tuple(place): i for i, place in enumerate(places.tolist())}
        return nodes, np.array([index[tuple(child)] for child in children.tolist()], np.int64)

    def _link(
        self,
        nodes: NDArray[Any],
        parent: NDArray[np.int64],
        slots: NDArray[np.int64],
        offsets: NDArray[np.int64],
        children: NDArray[Any],
    ) -> None:
        """Enter children into the tables of their parents, and join their boxes and extremes."""
        nodes["table"][parent, slots] = offsets
        masks = np.zeros((len(nodes), nodes["table"].shape[1]), np.bool_)
        masks[parent, slots] = True
        nodes["child_mask"] = np.packbits(masks, axis=1, bitorder="little")
        first = np.full((len(nodes), 3), np.iinfo(np.int32).max)
        last = np.full((len(nodes), 3), np.iinfo(np.int32).min)
        np.minimum.at(first, parent, children["lowest"])
        extent = children["lowest"] + children["extent"] if children.dtype == LEAF else children["highest"]
        np.maximum.at(last, parent, extent)
        held = np.zeros(len(nodes), np.bool_)
        held[parent] = True
        nodes["lowest"][held], nodes["highest"][held] = first[held], last[held]
        extremes = np.tile(np.array([np.inf, -np.inf], np.float32), (len(nodes), 1))
        np.minimum.at(extremes[:, 0], parent, children["extremes"][:, 0])
        np.maximum.at(extremes[:, 1], parent, children["extremes"][:, 1])
        nodes["extremes"][held, :2] = extremes[held]

    @property
    def box(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last index of the active voxels, (3,) each; both are zero if there are none."""
        if not len(self.uppers):
            return np.zeros(3, np.int64), np.zeros(3, np.int64)
        return self.uppers["lowest"].min(axis=0).astype(np.int64), self.uppers["highest"].max(axis=0).astype(np.int64)

    def write(self, stream: IO[bytes]) -> None:
        """Write the records of the tree and the root, and the nodes of each level."""
        uppers_at = TREE_BYTES + ROOT_BYTES + TILE_BYTES * len(self.uppers)
        lowers_at = uppers_at + self.uppers.nbytes
        offsets = (lowers_at + self.lowers.nbytes, lowers_at, uppers_at, TREE_BYTES)
        counts = (len(self.leaves), len(self.lowers), len(self.uppers))
        stream.write(struct.pack("<4q3I3IQ", *offsets, *counts, 0, 0, 0, self.active_count))
        lowest, highest = self.box
        extremes = (self.band, self.band)
        if len(self.uppers):
            extremes = self.uppers["extremes"][:, 0].min(), self.uppers["extremes"][:, 1].max()
        root = struct.pack("<6iI5f", *lowest, *highest, len(self.uppers), self.band, *extremes, 0, 0)
        stream.write(root.ljust(ROOT_BYTES, b"\0"))
        for i, place in enumerate(self.upper_places.tolist()):
            x, y, z = (side & 0x1FFFFF for side in place)
            child = uppers_at + i * UPPER_NODE.itemsize - TREE_BYTES
            tile = struct.pack("<QqIf", z | y << 21 | x << 42, child, 0, 0)
            stream.write(tile.ljust(TILE_BYTES, b"\0"))
        for nodes in (self.uppers, self.lowers, self.leaves):
            stream.write(nodes.tobytes())


def _slots(places: NDArray[np.int64], side: int) -> NDArray[np.int64]:
    return (places[:, 0] * side + places[:, 1]) * side + places[:, 2]
