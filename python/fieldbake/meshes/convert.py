"""Conversion of files, trimesh objects, arrays, and lists of these to a Mesh.

trimesh reads files without merging or reordering vertices. Transforms of scene nodes and of list items are applied in
float64. A transform with a reflection also reverses the faces, so that the outside stays outside.
"""

from __future__ import annotations

import io
import itertools
import os
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import MeshError
from .mesh import ALPHA_MODES, Mesh, Part, check_faces, check_uv, check_vertices
from .neighbours import triangles_of

#: Every argument that accepts a mesh accepts a Mesh, a path, a trimesh.Trimesh or trimesh.Scene, (vertices, faces), or
#: a list of these, each optionally as (object, transform).
MeshLike = Any


#: Bytes of a PLY or OFF file that certainly contain its header.
HEAD_BYTES = 1 << 16


@dataclass
class _Piece:
    """Triangles that become a Mesh, with the materials of their faces."""

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    uv: NDArray[np.float32] | None = None
    parts: list[Part] = field(default_factory=list)
    chord_error: float = 0.0

    def transformed(self, transform: NDArray[np.float64]) -> _Piece:
        """The piece under a 4x4 world-from-local transform."""
        if np.array_equal(transform, np.eye(4)):
            return self
        vertices = checks.as_float64(self.vertices) @ transform[:3, :3].T + transform[:3, 3]
        mirrored = np.linalg.det(transform[:3, :3]) < 0
        faces = np.ascontiguousarray(self.faces[:, ::-1]) if mirrored else self.faces
        stretch = float(np.linalg.norm(transform[:3, :3], 2))
        return _Piece(vertices, faces, self.uv, self.parts, self.chord_error * stretch)


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file.

    Parameters
    ----------
    path : str or path
        A file of any format that trimesh reads: OBJ, PLY, STL, OFF, GLB, glTF, ... A scene becomes one mesh with the
        transforms of its nodes applied. Textures are read from the folder of the file.

    Returns
    -------
    Mesh
        A mesh with the vertices of the file, neither merged nor reordered.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    MeshError
        If the file cannot be read, has an unknown format, or contains no triangles.
    """
    return _mesh(_from_file(path), os.fspath(path))


def as_mesh(thing: MeshLike) -> Mesh:
    """Convert an object to a Mesh; a Mesh is returned unchanged.

    Parameters
    ----------
    thing : Mesh, path, trimesh.Trimesh, trimesh.Scene, (vertices, faces), or a list of those
        Also PyVista's PolyData, both triangle meshes of Open3D, and anything with ``tessellate(tolerance)``, such as
        the solids of build123d and CadQuery: those are tessellated with a chord error of 1e-4 of their diagonal, see
        `Mesh.chord_error`. Arrays may be of any library that offers ``__array__`` or ``__dlpack__``. Items of a list
        may be ``(object, transform)`` with a 4x4 world-from-local transform.

    Raises
    ------
    FileNotFoundError
        If a path does not exist.
    MeshError
        If the object contains no usable mesh.
    """
    if isinstance(thing, Mesh):
        return thing
    return _mesh(_pieces(thing, "mesh"), os.fspath(thing) if isinstance(thing, (str, os.PathLike)) else None)


def _mesh(pieces: Sequence[_Piece], path: str | None) -> Mesh:
    """Join the pieces; errors name the file of the pieces."""
    try:
        piece = _join(pieces)
        mesh = Mesh(piece.vertices, piece.faces, uv=piece.uv, parts=piece.parts or None)
        mesh._chord_error = piece.chord_error
        return mesh
    except MeshError as error:
        if path is None:
            raise
        raise MeshError(f"{path}: {error}") from None


def _join(pieces: Sequence[_Piece]) -> _Piece:
    if len(pieces) == 1:
        return pieces[0]
    # An index beyond its own piece would refer to a vertex of the next piece without an error.
    for number, piece in enumerate(pieces):
        wrong = (piece.faces < 0) | (piece.faces >= len(piece.vertices))
        if wrong.any():
            face, corner = np.argwhere(wrong)[0].tolist()
            raise MeshError(
                f"mesh[{number}]: faces[{face}] refers to vertex {piece.faces[face, corner]}, "
                f"the mesh has {len(piece.vertices)} vertices (valid: 0 to {len(piece.vertices) - 1})"
            )
    first_vertex = np.cumsum([0] + [len(piece.vertices) for piece in pieces]).tolist()
    first_face = np.cumsum([0] + [len(piece.faces) for piece in pieces]).tolist()
    uv = None
    if any(piece.uv is not None for piece in pieces):
        uv = np.zeros((first_vertex[-1], 2), dtype=np.float32)
        for piece, start in zip(pieces, first_vertex, strict=False):
            if piece.uv is not None:
                uv[start : start + len(piece.vertices)] = piece.uv
    return _Piece(
        np.concatenate([checks.as_float64(piece.vertices) for piece in pieces]),
        np.concatenate([piece.faces + start for piece, start in zip(pieces, first_vertex, strict=False)]),
        uv,
        [
            part.with_faces(range(part.faces.start + start, part.faces.stop + start))
            for piece, start in zip(pieces, first_face, strict=False)
            for part in piece.parts or [Part(faces=range(len(piece.faces)))]
        ],
        max(piece.chord_error for piece in pieces),
    )


def _pieces(thing: MeshLike, name: str) -> list[_Piece]:
    """Split an object into pieces; errors call it by `name`."""
    if isinstance(thing, (str, os.PathLike)):
        return _from_file(thing)
    if isinstance(thing, Mesh):
        faces = thing.faces.astype(np.int64)
        return [_Piece(thing.vertices, faces, thing.uv, list(thing.parts), thing.chord_error)]
    if hasattr(thing, "graph") and hasattr(thing, "geometry"):
        return _from_scene(thing, name)
    if hasattr(thing, "vertices") and hasattr(thing, "faces") and not callable(thing.vertices):
        return [_from_trimesh(thing)]
    if isinstance(thing, (tuple, list)) and is_arrays(thing):
        return [_Piece(check_vertices(thing[0]), check_faces(thing[1]))]
    if isinstance(thing, tuple) and len(thing) == 2:
        transform = checks.affine(f"{name}: transform", thing[1], MeshError)
        return [piece.transformed(transform) for piece in _pieces(thing[0], name)]
    if isinstance(thing, list):
        if not thing:
            raise MeshError(f"{name}: the list is empty; a surface needs at least one mesh")
        return [piece for number, item in enumerate(thing) for piece in _pieces(item, f"{name}[{number}]")]
    if (found := triangles_of(thing)) is not None:
        return [_Piece(check_vertices(found.vertices), check_faces(found.faces), chord_error=found.chord_error)]
    raise MeshError(
        f"{name}: cannot make a mesh of {checks.describe(thing)}; give a path, a trimesh object, "
        "(vertices, faces), an object of PyVista, Open3D, build123d or CadQuery, (thing, transform), or a list of those"
    )


def is_arrays(pair: Sequence[Any]) -> bool:
    """Whether a pair is (vertices, faces) in numbers, and neither two meshes nor a mesh with its transform."""
    if len(pair) != 2:
        return False
    for half in pair:
        # The first innermost item decides: with a path or a mesh there, the pair is a list of objects.
        inner = half
        while isinstance(inner, (tuple, list)) and len(inner) > 0:
            inner = inner[0]
        if isinstance(inner, (str, os.PathLike, Mesh)) or hasattr(inner, "faces") or hasattr(inner, "graph"):
            return False
    # If the first half is a pair of tables, it is a mesh itself, beside a transform or another mesh.
    first = pair[0]
    return not (isinstance(first, (tuple, list)) and len(first) == 2 and _is_table(first[0]))


def _is_table(value: Any) -> bool:
    """Whether a value has rows and columns."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2
    return isinstance(value, (tuple, list)) and len(value) > 0 and isinstance(value[0], (tuple, list, np.ndarray))


def _from_file(path: str | os.PathLike[str]) -> list[_Piece]:
    return _read_file(path, lambda scene: _from_scene(scene, os.fspath(path)))


def _read_file(path: str | os.PathLike[str], take: Callable[[Any], list[_Piece]]) -> list[_Piece]:
    """List the pieces that `take` finds in the scene of a file; every failure of a reader becomes a MeshError."""
    file = Path(path)
    if file.is_dir():
        raise MeshError(f"{path}: is a directory, not a mesh file")
    # Opening the file here keeps FileNotFoundError and PermissionError unchanged.
    with file.open("rb") as stream:
        head = stream.read(None if file.suffix.lower() == ".obj" else HEAD_BYTES)

    import trimesh

    # Without texture coordinates trimesh can keep the vertex order of the file; with them it has to split vertices.
    keeps_order = file.suffix.lower() == ".obj" and b"vt " not in head
    options: dict[str, Any] = {"maintain_order": True} if keeps_order else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = trimesh.load_scene(str(file), process=False, resolver=_resolver(file), **options)
            pieces = take(scene)
        _check_is_whole(_announced_faces(file.suffix.lower(), head), sum(len(piece.faces) for piece in pieces))
        return pieces
    except MeshError:
        raise
    except NotImplementedError as error:
        known = ", ".join(sorted(trimesh.available_formats()))
        raise MeshError(f"{path}: unknown kind of file '{file.suffix}'; readable here: {known}") from error
    except Exception as error:  # Readers of damaged files raise exceptions of any type.
        reason = str(error) or type(error).__name__
        raise MeshError(f"{path}: cannot be read as a mesh ({file.suffix.lstrip('.').upper()}): {reason}") from error


def load_nodes(path: str | os.PathLike[str]) -> list[tuple[Mesh, NDArray[np.float64]]]:
    """List the meshes of a file with their world-from-local transforms; nodes of one geometry share a Mesh."""
    keys: list[str] = []
    transforms: list[NDArray[np.float64]] = []

    def take(scene: Any) -> list[_Piece]:
        pieces = {}
        for node in scene.graph.nodes_geometry:
            transform, key = scene.graph[node]
            geometry = scene.geometry[key]
            if hasattr(geometry, "faces") and len(geometry.faces) > 0:
                keys.append(key)
                transforms.append(checks.affine(f"{path}: transform of node '{node}'", transform, MeshError))
                if key not in pieces:
                    pieces[key] = _from_trimesh(geometry, key)
        if not pieces:
            raise MeshError(f"{path}: has no triangles")
        names.extend(pieces)
        return list(pieces.values())

    names: list[str] = []
    pieces = _read_file(path, take)
    meshes = {name: _mesh([piece], os.fspath(path)) for name, piece in zip(names, pieces, strict=True)}
    return [(meshes[key], transform) for key, transform in zip(keys, transforms, strict=True)]


def _announced_faces(kind: str, content: bytes) -> int:
    """Read the number of faces in the header of an OFF or PLY file, since their readers do not compare it."""
    if kind == ".off":
        lines = (line.split(b"#")[0].split() for line in io.BytesIO(content))
        words = list(itertools.islice(itertools.chain.from_iterable(lines), 4))
        counts = words[1:] if words and words[0].upper().endswith(b"OFF") else words
        return int(counts[1]) if len(counts) >= 2 and counts[1].isdigit() else 0
    if kind == ".ply":
        announced = re.search(rb"^element\s+face\s+(\d+)", content.split(b"end_header")[0], re.MULTILINE)
        return int(announced[1]) if announced else 0
    return 0


def _check_is_whole(announced: int, faces: int) -> None:
    """Check that a file is complete; triangulated polygons can only raise the number of faces."""
    if faces < announced:
        raise ValueError(f"it says {announced} faces and has {faces}; is it complete?")


def _resolver(file: Path) -> Any:
    """Make a resolver that finds textures beside the file, also under names with Windows separators."""
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):
        def get(self, name: str) -> bytes:
            found: bytes = super().get(name.strip().replace("\\", "/"))
            return found

    return Resolver(str(file))


def _from_scene(scene: Any, name: str) -> list[_Piece]:
    """List a piece for every node of a trimesh.Scene with triangles."""
    pieces = []
    others = []
    for node in scene.graph.nodes_geometry:
        transform, key = scene.graph[node]
        geometry = scene.geometry[key]
        if hasattr(geometry, "faces"):
            world_from_node = checks.affine(f"{name}: transform of node '{node}'", transform, MeshError)
            pieces.append(_from_trimesh(geometry, key).transformed(world_from_node))
        else:
            others.append(type(geometry).__name__)
    if not pieces:
        found = f"found only {', '.join(sorted(set(others)))}" if others else "it is empty"
        raise MeshError(f"{name}: has no triangles ({found})")
    return pieces


def _from_trimesh(mesh: Any, name: str = "") -> _Piece:
    """Convert the geometry and material of a trimesh.Trimesh, or of any object with vertices and faces."""
    vertices = np.asarray(check_vertices(mesh.vertices))
    faces = check_faces(mesh.faces)
    visual = getattr(mesh, "visual", None)
    uv = getattr(visual, "uv", None)
    if uv is not None and np.shape(uv)[:1] == (len(vertices),) and np.ndim(uv) == 2:
        uv = check_uv(np.asarray(uv)[:, :2], len(vertices))
    else:
        uv = None
    return _Piece(vertices, faces, uv, [_part(getattr(visual, "material", None), name, len(faces))])


def _part(material: Any, name: str, faces: int) -> Part:
    """Convert either kind of trimesh material to a part."""
    if material is None:
        return Part(name, range(faces))
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        image = getattr(material, "image", None)
    color = getattr(material, "baseColorFactor", None)
    if color is None and image is None:
        color = getattr(material, "diffuse", None)
    mode = str(getattr(material, "alphaMode", None) or "opaque").lower()
    cutoff = getattr(material, "alphaCutoff", None)
    return Part(
        str(getattr(material, "name", None) or name),
        range(faces),
        color=_rgba(color),
        image=image,
        alpha_mode=mode if mode in ALPHA_MODES else "opaque",
        alpha_cutoff=0.5 if cutoff is None else float(cutoff),
        two_sided=bool(getattr(material, "doubleSided", None)),
    )


def _rgba(color: ArrayLike | None) -> tuple[float, float, float, float]:
    """Convert a colour of trimesh, bytes or floats, to four floats from 0 to 1."""
    if color is None:
        return (1.0, 1.0, 1.0, 1.0)
    values = np.asarray(color).ravel()
    floats: Iterable[float] = values.astype(np.float64) / (255 if values.dtype.kind in "iu" else 1)
    r, g, b, a = (*floats, 1.0)[:4] if len(values) >= 3 else (1.0, 1.0, 1.0, 1.0)
    return float(r), float(g), float(b), float(a)
