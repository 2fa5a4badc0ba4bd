"""Meshes as files: STL, OBJ, PLY, GLB and 3MF."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...base import checks
from ...base.errors import MeshError
from ...files import package_3mf
from ...files.container import atomic_write

Vertices = NDArray[np.float64]
Faces = NDArray[np.uint32]

#: The STL records of at most some faces, from a first face on.
StlRecords = Callable[[int, int], NDArray[np.uint8]]

KINDS = (".stl", ".obj", ".ply", ".glb", ".3mf")

#: Faces of an STL file that are written at once: 3 MB, which stay in the caches of the processor.
STL_BATCH = 1 << 16

#: Rows of a text file that are written at once.
ROW_BATCH = 1 << 16


def mesh_kind(path: str | os.PathLike[str]) -> str:
    """Return the ending of a mesh file in lower case; raise MeshError for an ending that cannot be written."""
    suffix = checks.path(path).suffix
    if suffix.lower() not in KINDS:
        raise MeshError(f"{path}: a mesh is written as {', '.join(KINDS)}, got the ending '{suffix}'")
    return suffix.lower()


def save_mesh(vertices: Vertices, faces: Faces, stl_records: StlRecords, path: str | os.PathLike[str]) -> None:
    """Write vertices (n, 3) and faces (m, 3) to a file; see `Mesh.save`."""
    target, kind = checks.path(path), mesh_kind(path)
    with atomic_write(target) as stream:
        if kind == ".stl":
            _write_stl(len(faces), stl_records, stream)
        elif kind == ".obj":
            _write_obj(vertices, faces, stream)
        elif kind == ".ply":
            _write_ply(vertices, faces, stream)
        elif kind == ".3mf":
            _write_3mf(vertices, faces, stream)
        else:
            import trimesh

            exported: Any = trimesh.Trimesh(vertices, faces.astype(np.int64), process=False).export(file_type="glb")
            stream.write(exported)


def _batches(rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Divide rows into parts, between which Ctrl-C ends the work."""
    return (rows[first : first + ROW_BATCH] for first in range(0, len(rows), ROW_BATCH))


def _write_stl(count: int, records: StlRecords, stream: IO[bytes]) -> None:
    """Write binary STL: the normal and the corners of every face, float32."""
    stream.write(b"fieldbake".ljust(80))
    stream.write(np.uint32(count).tobytes())
    for first in range(0, count, STL_BATCH):
        stream.write(records(first, STL_BATCH).data)


def _write_obj(vertices: Vertices, faces: Faces, stream: IO[bytes]) -> None:
    """Write text with enough digits to restore every float64 exactly."""
    for rows in _batches(vertices):
        stream.write("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows.tolist()).encode("ascii"))
    for rows in _batches(faces):
        stream.write("".join(f"f {a} {b} {c}\n" for a, b, c in (rows.astype(np.int64) + 1).tolist()).encode("ascii"))


def _write_ply(vertices: Vertices, faces: Faces, stream: IO[bytes]) -> None:
    """Write binary PLY with float64 positions."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    records = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    records["count"] = 3
    records["corners"] = faces
    stream.write(header.encode("ascii"))
    stream.write(vertices.astype("<f8").tobytes())
    stream.write(records.tobytes())


def _write_3mf(vertices: Vertices, faces: Faces, stream: IO[bytes]) -> None:
    """Write a 3MF package with one object; positions count as millimetres."""
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{package_3mf.CORE}">'
        '<resources><object id="1" type="model">'
    )
    tail = '</object></resources><build><item objectid="1"/></build></model>'
    package_3mf.write(stream, itertools.chain([head], package_3mf.mesh_texts(vertices, faces), [tail]))
