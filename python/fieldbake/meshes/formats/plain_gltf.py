"""Triangles of a .glb file with one mesh that has no material, no colours and no transform, without trimesh."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf_accessors import check_accessors
from .gltf_tree import GLB_HEADER_BYTES, glb_json_end, visible_nodes

#: Bytes of the length and kind of a chunk.
CHUNK_BYTES = 8

FLOAT32, INDICES = 5126, {5121: "u1", 5123: "<u2", 5125: "<u4"}
TRIANGLES = 4

#: Properties of a file, of its mesh, of its triangles and of a node that has no transform.
PLAIN = {"asset", "scene", "scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers", "extras"}
PLAIN_MESH = {"name", "primitives", "extras"}
PLAIN_PRIMITIVE = {"attributes", "indices", "mode", "extras"}
PLAIN_ATTRIBUTES = {"POSITION", "NORMAL"}
PLAIN_NODE = {"name", "children", "mesh", "extras"}

#: Name of a mesh in trimesh if the file states none.
NAMELESS = "GLTF"


def read_plain_glb(content: bytes) -> tuple[tuple[NDArray[np.float32], NDArray[Any]] | None, str]:
    """Read vertices (n, 3) and faces (m, 3), and the name of the mesh; None and "" if trimesh must read the file."""
    start = glb_json_end(content)
    if start is None or content[4:8] != b"\2\0\0\0" or content[start + 4 : start + 8] != b"BIN\0":
        return None, ""
    length = int.from_bytes(content[start : start + 4], "little")
    data = memoryview(content)[start + CHUNK_BYTES :][:length]
    try:
        tree = json.loads(content[GLB_HEADER_BYTES:start])
        check_accessors(tree)
        if _is_plain(tree, len(data)):
            return _triangles(tree, data), tree["meshes"][0].get("name", NAMELESS)
    except Exception:  # Damaged files raise exceptions of any type. The reader that follows names the damage.
        pass
    return None, ""


def _is_plain(tree: dict[str, Any], length: int) -> bool:
    """Whether a file has one mesh of triangles in one visible node, and a buffer within `length` bytes."""
    (mesh,), (buffer,), nodes = tree["meshes"], tree["buffers"], tree["nodes"]
    (primitive,) = mesh["primitives"]
    name = mesh.get("name", NAMELESS)
    return (
        tree.keys() <= PLAIN
        and mesh.keys() <= PLAIN_MESH
        and isinstance(name, str)
        and name != ""
        and primitive.keys() <= PLAIN_PRIMITIVE
        and primitive["attributes"].keys() <= PLAIN_ATTRIBUTES
        and primitive.get("mode", TRIANGLES) == TRIANGLES
        and all(node.keys() <= PLAIN_NODE for node in nodes)
        and sum("mesh" in node for node in nodes) == 1
        and len(list(visible_nodes(tree))) == len(nodes)
        and "uri" not in buffer
        and buffer["byteLength"] <= length
    )


def _triangles(tree: dict[str, Any], data: memoryview) -> tuple[NDArray[np.float32], NDArray[Any]] | None:
    """Read the arrays of the only primitive; None unless each is dense in its buffer view."""
    primitive = tree["meshes"][0]["primitives"][0]
    positions = tree["accessors"][primitive["attributes"]["POSITION"]]
    indices = tree["accessors"][primitive["indices"]]
    views = [tree["bufferViews"][accessor["bufferView"]] for accessor in (positions, indices)]
    if (positions["type"], positions["componentType"], indices["type"]) != ("VEC3", FLOAT32, "SCALAR"):
        return None
    if any("byteStride" in view for view in views):
        return None
    starts = [
        view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        for view, accessor in zip(views, (positions, indices), strict=True)
    ]
    vertices = np.frombuffer(data, "<f4", 3 * positions["count"], starts[0])
    corners = np.frombuffer(data, INDICES[indices["componentType"]], indices["count"], starts[1])
    return vertices.reshape(-1, 3), corners.reshape(-1, 3)
