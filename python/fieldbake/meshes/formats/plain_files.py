"""Triangles of .obj, .glb, binary .stl and binary .ply files that have no materials and no colours, without trimesh.

trimesh takes most of a second to import. Every file that needs more than positions and triangles, and every damaged
file, is left to it.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from .plain_gltf import read_plain_glb

Triangles = tuple[NDArray[Any], NDArray[Any]]

#: Bytes of the header of a binary .stl, and the record of a face.
STL_HEADER_BYTES = 84
STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

PLY_HEADER = re.compile(rb"ply\r?\nformat binary_little_endian 1\.0\r?\n(.*?)end_header\r?\n", re.DOTALL)
PLY_NUMBERS = {
    b"char": "i1", b"uchar": "u1", b"short": "<i2", b"ushort": "<u2", b"int": "<i4", b"uint": "<u4", b"float": "<f4",
    b"double": "<f8", b"int8": "i1", b"uint8": "u1", b"int16": "<i2", b"uint16": "<u2", b"int32": "<i4",
    b"uint32": "<u4", b"float32": "<f4", b"float64": "<f8",
}  # fmt: skip
#: Properties of vertices that do not change the triangles.
PLY_VERTEX = {b"x", b"y", b"z", b"nx", b"ny", b"nz", b"quality", b"confidence", b"intensity"}


def object_name(content: bytes) -> str:
    """Find the name of the object that the first face of an .obj belongs to; empty if it has none."""
    names = re.findall(rb"^o[ \t]+(.*?)[ \t\r]*$", content[: content.find(b"\nf") + 1], re.MULTILINE)
    return str(names[-1], "utf-8", "replace") if names else ""


def read_plain(ending: str, content: bytes) -> tuple[Triangles, str] | None:
    """Read the content of a file; None if trimesh must read it.

    Returns
    -------
    tuple
        Vertices (n, 3) and faces (m, 3), and the name of the mesh; an empty name means that the file states none.
    """
    triangles: Triangles | None = None
    name = ""
    if ending == ".obj":
        triangles, name = _core.read_obj(content), object_name(content)
    elif ending == ".stl":
        triangles = _read_stl(content)
    elif ending == ".ply":
        triangles = _read_ply(content)
    elif ending == ".glb":
        triangles, name = read_plain_glb(content)
    return (triangles, name) if triangles is not None and len(triangles[1]) > 0 else None


def _read_stl(content: bytes) -> Triangles | None:
    if len(content) < STL_HEADER_BYTES:
        return None
    count = int.from_bytes(content[STL_HEADER_BYTES - 4 : STL_HEADER_BYTES], "little")
    if len(content) != STL_HEADER_BYTES + count * STL_FACE.itemsize:
        return None
    corners = np.frombuffer(content, STL_FACE, offset=STL_HEADER_BYTES)["corners"]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def _read_ply(content: bytes) -> Triangles | None:
    """Read a file that has vertices and then triangles, and nothing else."""
    header = PLY_HEADER.match(content)
    if header is None or b"TextureFile" in header[1]:
        return None
    lines = [line.split() for line in header[1].splitlines()]
    lines = [words for words in lines if words and words[0] not in (b"comment", b"obj_info")]
    elements = [words for words in lines if words[0] == b"element" and len(words) == 3 and words[2].isdigit()]
    if [words[1] for words in elements] != [b"vertex", b"face"]:
        return None
    *properties, indices = (words for words in lines if words[0] != b"element")
    if any(len(words) != 3 or words[1] not in PLY_NUMBERS or words[2] not in PLY_VERTEX for words in properties):
        return None
    if (
        lines[0] != elements[0]
        or lines[-2] != elements[1]
        or indices[:2] != [b"property", b"list"]
        or len(indices) != 5
    ):
        return None
    if indices[4] not in (b"vertex_indices", b"vertex_index") or not {*indices[2:4]} <= PLY_NUMBERS.keys():
        return None
    names = [words[2].decode() for words in properties]
    if len(set(names)) < len(names) or not {"x", "y", "z"} <= {*names}:
        return None
    vertex = np.dtype([(name, PLY_NUMBERS[words[1]]) for name, words in zip(names, properties, strict=True)])
    face = np.dtype([("count", PLY_NUMBERS[indices[2]]), ("corners", PLY_NUMBERS[indices[3]], 3)])
    vertices, faces = (int(words[2]) for words in elements)
    if len(content) != header.end() + vertices * vertex.itemsize + faces * face.itemsize:
        return None
    rows = np.frombuffer(content, vertex, vertices, header.end())
    triangles = np.frombuffer(content, face, faces, header.end() + rows.nbytes)
    if face["corners"].base.kind not in "iu" or not (triangles["count"] == 3).all():
        return None
    positions = np.stack([rows[axis] for axis in "xyz"], axis=1)
    return positions, triangles["corners"].astype(np.int64)
