"""OpenVDB files, version 224: the writer of level sets.

The tree is OpenVDB's standard one for floats: leaves of 8^3 voxels, lower nodes of 16^3 leaves, upper nodes of 32^3
lower nodes, and a root that lists upper nodes. A file has these parts, little-endian, without padding:

====================  ==================================================================================================
part                  contents
====================  ==================================================================================================
header                magic, version, library version, 1 (offsets follow), UUID, metadata, number of grids
descriptor            name, type, name of the parent (empty), offsets of the grid, of its voxels and of its end
grid                  compression, metadata, name of the map, translation, scale and its derived vectors
topology              1, background, tiles and children of the root; for each node: child mask, value mask, values,
                      children; for each leaf: value mask
voxels                for each leaf, in the same order: value mask, values
====================  ==================================================================================================

Source: ``Archive.cc``, ``RootNode.h``, ``InternalNode.h``, ``LeafNode.h`` and ``Compression.h`` of OpenVDB 10.
"""

from __future__ import annotations

import hashlib
import struct
import uuid
import zlib
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .band_blocks import SIDE, BandBlocks

MAGIC = b" BDV\0\0\0\0"
VERSION = 224
#: Version of the library that writes equal files.
LIBRARY = (10, 0)

#: Bits of the compression of a grid.
ZIP, ACTIVE_MASK, BLOSC = 1, 2, 4
#: How a node stores values: all of them; or the active ones and a mask that selects +band (1) or -band (0) elsewhere.
ALL_VALUES, ACTIVE_AND_SIGNS = 6, 3

#: Children along the side of an upper and of a lower node, and the voxels that each covers.
UPPER, LOWER = 32, 16
LOWER_VOXELS = LOWER * SIDE
UPPER_VOXELS = UPPER * LOWER_VOXELS

TREE = "Tree_float_5_4_3"
HALF_SUFFIX = "_HalfFloat"


def write(
    stream: IO[bytes], blocks: BandBlocks, metadata: Mapping[str, str], *, name: str, zipped: bool, half: bool
) -> None:
    """Write one level set to a seekable stream; `metadata` is stored as strings of the grid."""
    band = _halved(blocks.band) if half else blocks.band
    writer = _Writer(stream, blocks, np.float32(band), zipped, half)
    content = hashlib.blake2b(blocks.values.tobytes(), digest_size=16, key=str(blocks.corners.shape).encode()).digest()
    writer.put("<8sIIIB", MAGIC, VERSION, *LIBRARY, 1)
    stream.write(str(uuid.UUID(bytes=content)).encode())
    writer.metadata({"creator": metadata.get("creator", "fieldbake")})
    writer.put("<I", 1)
    for text in (name, TREE + (HALF_SUFFIX if half else ""), ""):
        writer.text(text)
    offsets_at = stream.tell()
    writer.put("<3q", 0, 0, 0)
    grid_at = stream.tell()
    writer.put("<I", writer.compression)
    active = blocks.active
    facts: dict[str, Any] = {"class": "level set", "is_saved_as_half_float": half, "name": name, **metadata}
    if active.any():
        block, *voxel = np.nonzero(active)
        index = blocks.corners[block] + np.column_stack(voxel)
        facts |= {"file_bbox_min": index.min(axis=0).tolist(), "file_bbox_max": index.max(axis=0).tolist()}
    facts["file_voxel_count"] = int(active.sum())
    writer.metadata(facts)
    writer.transform()
    voxels_at = writer.tree(active)
    end = stream.tell()
    stream.seek(offsets_at)
    writer.put("<3q", grid_at, voxels_at, end)
    stream.seek(end)


def _halved(value: float) -> float:
    return float(np.float16(value))


def mask_bytes(mask: NDArray[np.bool_]) -> bytes:
    """Pack a node mask: bit n of the bytes is entry n, the lowest bit first."""
    return np.packbits(mask.reshape(-1), bitorder="little").tobytes()


class _Writer:
    """Writes the parts of a file to a stream."""

    def __init__(self, stream: IO[bytes], blocks: BandBlocks, band: Any, zipped: bool, half: bool) -> None:
        self.stream, self.blocks, self.band, self.half = stream, blocks, band, half
        self.zipped = zipped
        self.compression = ZIP | ACTIVE_MASK if zipped else 0

    def put(self, layout: str, *values: Any) -> None:
        self.stream.write(struct.pack(layout, *values))

    def text(self, text: str) -> None:
        content = text.encode()
        self.put("<I", len(content))
        self.stream.write(content)

    def metadata(self, facts: Mapping[str, Any]) -> None:
        """Write names, types and values; each value follows its size."""
        self.put("<I", len(facts))
        for name, value in facts.items():
            self.text(name)
            if isinstance(value, bool):
                kind, content = "bool", struct.pack("<?", value)
            elif isinstance(value, int):
                kind, content = "int64", struct.pack("<q", value)
            elif isinstance(value, list):
                kind, content = "vec3i", struct.pack("<3i", *value)
            else:
                kind, content = "string", str(value).encode()
            self.text(kind)
            self.put("<I", len(content))
            self.stream.write(content)

    def transform(self) -> None:
        """Write the map from index to world, in which the index of a voxel is at its centre."""
        scale = self.blocks.spacing
        if np.allclose(scale, scale[0], rtol=1e-9):
            self.text("UniformScaleTranslateMap")
        else:
            self.text("ScaleTranslateMap")
        for vector in (self.blocks.origin, scale, scale, 1 / scale, 1 / scale**2, 0.5 / scale):
            self.put("<3d", *vector)

    def values(self, values: NDArray[np.float32], active: NDArray[np.bool_]) -> None:
        """Write the values of a node, flat. A value that is not active is +band, -band or, for a child, 0."""
        if self.compression & ACTIVE_MASK:
            self.stream.write(bytes([ACTIVE_AND_SIGNS]) + mask_bytes(~active & (values > 0)))
            values = values[active]
            # OpenVDB writes no size for an empty array of halves.
            if self.half and not len(values):
                return
        else:
            self.stream.write(bytes([ALL_VALUES]))
        content = values.astype("<f2" if self.half else "<f4").tobytes()
        if not self.zipped:
            self.stream.write(content)
            return
        packed = zlib.compress(content, 6)
        # A negative size marks bytes that are stored as they are, since they do not get shorter.
        if content and len(packed) >= len(content):
            self.put("<q", -len(content))
            self.stream.write(content)
        else:
            self.put("<q", len(packed) if content else 0)
            self.stream.write(packed if content else b"")

    def tree(self, active: NDArray[np.bool_]) -> int:
        """Write topology and voxels, and return the offset of the voxels."""
        lowers = _lower_nodes(self.blocks)
        uppers: dict[tuple[int, int, int], dict[int, _LowerNode]] = {}
        for place, node in lowers.items():
            origin = (place[0] // UPPER, place[1] // UPPER, place[2] // UPPER)
            x, y, z = (side % UPPER for side in place)
            uppers.setdefault(origin, {})[(x * UPPER + y) * UPPER + z] = node
        self.put("<IfII", 1, self.band, 0, len(uppers))
        order: list[int] = []
        masks = np.packbits(active.reshape(len(active), -1), axis=1, bitorder="little")
        for origin in sorted(uppers):
            self.put("<3i", *(side * UPPER_VOXELS for side in origin))
            nodes = uppers[origin]
            values = np.full(UPPER**3, self.band, np.float32)
            children = np.zeros(UPPER**3, np.bool_)
            for slot, node in nodes.items():
                children[slot] = not node.all_inside
                values[slot] = -self.band if node.all_inside else 0
            self.node(children, values)
            for slot in sorted(slot for slot, node in nodes.items() if not node.all_inside):
                node = nodes[slot]
                values = np.where(node.inside, -self.band, self.band).astype(np.float32)
                children = np.zeros(LOWER**3, np.bool_)
                children[node.slots] = True
                values[children] = 0
                self.node(children, values)
                self.stream.write(masks[node.leaves].tobytes())
                order += node.leaves
        voxels_at = self.stream.tell()
        for leaf in order:
            self.stream.write(masks[leaf].tobytes())
            values = np.clip(self.blocks.values[leaf].reshape(-1), -self.band, self.band)
            self.values(values, active[leaf].reshape(-1))
        return voxels_at

    def node(self, children: NDArray[np.bool_], values: NDArray[np.float32]) -> None:
        """Write the masks and the values of an internal node, in which no tile is active."""
        nothing = np.zeros(len(children), np.bool_)
        self.stream.write(mask_bytes(children) + mask_bytes(nothing))
        self.values(values, nothing)


class _LowerNode:
    """The blocks below a lower node: the stored blocks in the order of their slots, and which blocks lie inside."""

    __slots__ = ("all_inside", "inside", "leaves", "slots")

    def __init__(self, inside: NDArray[np.bool_]) -> None:
        self.inside = inside
        self.all_inside = bool(inside.all())
        self.slots: list[int] = []
        self.leaves: list[int] = []


def _lower_nodes(blocks: BandBlocks) -> dict[tuple[int, int, int], _LowerNode]:
    """Make the lower nodes with a block that is stored or inside. The key is the position in units of the node size."""
    counts = [-(-side // LOWER) for side in blocks.inside.shape]
    padded = np.zeros([count * LOWER for count in counts], np.bool_)
    padded[tuple(slice(side) for side in blocks.inside.shape)] = blocks.inside
    by_node = padded.reshape(counts[0], LOWER, counts[1], LOWER, counts[2], LOWER).transpose(0, 2, 4, 1, 3, 5)
    nodes: dict[tuple[int, int, int], _LowerNode] = {}
    for x, y, z in np.argwhere(by_node.any(axis=(3, 4, 5))).tolist():
        nodes[x, y, z] = _LowerNode(by_node[x, y, z].reshape(-1))
    places = (blocks.corners // LOWER_VOXELS).tolist()
    inner = blocks.corners // SIDE % LOWER
    slots = ((inner[:, 0] * LOWER + inner[:, 1]) * LOWER + inner[:, 2]).tolist()
    outside = np.zeros(LOWER**3, np.bool_)
    for leaf, ((x, y, z), slot) in enumerate(zip(places, slots, strict=True)):
        node = nodes.setdefault((x, y, z), _LowerNode(outside))
        node.slots.append(slot)
        node.leaves.append(leaf)
    for node in nodes.values():
        order = np.argsort(node.slots)
        node.slots, node.leaves = [node.slots[i] for i in order], [node.leaves[i] for i in order]
    return nodes
