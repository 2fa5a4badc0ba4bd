"""An independent reader of OpenVDB files of version 224. Values are a dictionary of voxels."""

import struct
import zlib

import numpy as np


def read(content):
    """Facts of the grid; leaves as {corner: (values, active)} and tiles as {corner: (side, value)}."""
    at = [0]

    def take(layout):
        values = struct.unpack_from("<" + layout, content, at[0])
        at[0] += struct.calcsize("<" + layout)
        return values if len(values) > 1 else values[0]

    def text():
        length = take("I")
        return bytes(take(f"{length}s")).decode()

    def metadata():
        found = {}
        for _ in range(take("I")):
            name, kind = text(), text()
            size = take("I")
            value = bytes(take(f"{size}s"))
            layout = {"bool": "<?", "int64": "<q", "vec3i": "<3i", "float": "<f"}.get(kind)
            found[name] = value.decode() if layout is None else struct.unpack(layout, value)
        return found

    def mask(side):
        bits = np.frombuffer(content, np.uint8, side**3 // 8, at[0])
        at[0] += len(bits)
        return np.unpackbits(bits, bitorder="little").astype(bool)

    assert content[:8] == b" BDV" + bytes(4)
    at[0] = 8
    version, _, _, offsets = take("IIIB")
    assert (version, offsets) == (224, 1)
    at[0] += 36
    metadata()
    assert take("I") == 1
    name, tree, parent = text(), text(), text()
    assert parent == ""
    grid_at, voxels_at, end = take("3q")
    assert grid_at == at[0]
    assert end == len(content)
    compression = take("I")
    facts = metadata()
    kind = text()
    translation, scale = np.array(take("3d")), np.array(take("3d"))
    at[0] += 4 * 24
    assert take("I") == 1
    background = take("f")
    half = tree.endswith("_HalfFloat")

    def values(active):
        rule = take("b")
        selected = None
        if rule == 3:
            selected = mask(round(len(active) ** (1 / 3)))
        else:
            assert rule == 6
        count = int(active.sum()) if selected is not None else len(active)
        dtype = np.dtype("<f2" if half else "<f4")
        if half and selected is not None and not count:
            stored = np.empty(0, np.float32)
        else:
            size = take("q") if compression & 1 else -count * dtype.itemsize
            packed = content[at[0] : at[0] + abs(size)]
            at[0] += abs(size)
            stored = np.frombuffer(zlib.decompress(packed) if size > 0 else packed, dtype).astype(np.float32)
        assert len(stored) == count
        if selected is None:
            return stored
        result = np.where(selected, background, -background).astype(np.float32)
        result[active] = stored
        return result

    leaves, tiles, order = {}, {}, []

    def child(corner, slot, side, step):
        return tuple(c + s * step for c, s in zip(corner, np.unravel_index(slot, (side,) * 3), strict=True))

    def node(corner, side, step):
        children, active = mask(side), mask(side)
        own = values(active)
        assert not active.any()
        for slot in np.flatnonzero(~children & (own != np.float32(background))):
            tiles[child(corner, slot, side, step)] = (step, own[slot])
        for slot in np.flatnonzero(children):
            place = child(corner, slot, side, step)
            if step == 8:
                order.append((place, mask(8)))
            else:
                node(place, 16, 8)

    root_tiles, root_children = take("2I")
    assert root_tiles == 0
    for _ in range(root_children):
        node(take("3i"), 32, 128)
    assert at[0] == voxels_at
    for place, topology in order:
        active = mask(8)
        assert np.array_equal(active, topology)
        leaves[place] = (values(active).reshape(8, 8, 8), active.reshape(8, 8, 8))
    assert at[0] == end
    return {
        "name": name,
        "tree": tree,
        "metadata": facts,
        "map": (kind, translation, scale),
        "background": background,
        "leaves": leaves,
        "tiles": tiles,
    }


def dense(found, shape):
    """Values and active voxels of the indices 0 to shape - 1."""
    result = np.full(shape, found["background"], np.float32)
    active = np.zeros(shape, bool)
    for (x, y, z), (side, value) in found["tiles"].items():
        result[x : x + side, y : y + side, z : z + side] = value
    for (x, y, z), (leaf, is_active) in found["leaves"].items():
        target = result[x : x + 8, y : y + 8, z : z + 8]
        i, j, k = target.shape
        target[...] = leaf[:i, :j, :k]
        active[x : x + 8, y : y + 8, z : z + 8] = is_active[:i, :j, :k]
        outside = is_active.copy()
        outside[:i, :j, :k] = False
        assert not outside.any()
    return result, active
