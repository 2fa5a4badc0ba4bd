"""The JSON of a glTF file: its place in a .glb, and the visible nodes in the order of the file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

#: Bytes of the header of a .glb together with the length and kind of its first chunk, which is the JSON.
GLB_HEADER_BYTES = 20


def glb_json_end(head: bytes) -> int | None:
    """The offset at which the JSON of a .glb ends, by the first bytes of the file; None if they belong to no .glb."""
    if head[:4] != b"glTF" or head[16:GLB_HEADER_BYTES] != b"JSON":
        return None
    return GLB_HEADER_BYTES + int.from_bytes(head[12:16], "little")


def visible_nodes(tree: dict[str, Any]) -> Iterator[tuple[int, int | None]]:
    """Iterate over the indices of the nodes of the shown scene and of their parents; roots have the parent None.

    A parent comes before its children, and children come as they are listed. Indices without a node are left out, and
    a node that is listed twice counts once.
    """
    nodes, scenes = tree.get("nodes", []), tree.get("scenes", [])
    roots = scenes[tree.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting: list[tuple[int, int | None]] = [(root, None) for root in reversed(roots)]
    visited: set[int] = set()
    while waiting:
        index, parent = waiting.pop()
        if index in visited or not 0 <= index < len(nodes):
            continue
        visited.add(index)
        yield index, parent
        waiting += [(child, index) for child in reversed(nodes[index].get("children", []))]
