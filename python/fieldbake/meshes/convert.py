"""Conversion of files, trimesh objects, arrays, and lists of these to a Mesh.

Vertices of files are neither merged nor reordered. trimesh reads the files that have more than triangles. Transforms of
scene nodes and of list items are applied in float64. A transform with a reflection also reverses the faces, so that the
outside stays outside.
"""

from __future__ import annotations

import io
import itertools
import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import MeshError
from ..base.former_names import former_names
from ..files.package_3mf import has_function
from .formats.gltf_materials import Document
from .formats.plain_files import read_plain
from .formats.ply_strips import with_strips
from .formats.referenced_files import resolver_beside
from .input_arrays import check_colors, check_faces, check_uv, check_vertices
from .interop import is_cloud, triangles_of
from .mesh import Mesh
from .part import ALPHA_MODES, Part

#: Type of every argument for a mesh: a Mesh, a path, a trimesh.Trimesh or trimesh.Scene, (vertices, faces), or a list
#: of these, each optionally as (object, transform).
MeshLike = Any


#: Reasons for errors of readers that have no text.
_NAMELESS: dict[type, str] = {AssertionError: "its parts contradict each other; is it complete?"}

#: Bytes of a PLY or OFF file that certainly contain its header.
HEAD_BYTES = 1 << 16


@dataclass
class _Piece:
    """Triangles that become a Mesh, with the materials of their faces."""

    vertices: NDArray[Any]
    faces: NDArray[np.uint32 | np.int64]
    uv: NDArray[np.float32] | None = None
    parts: list[Part] = field(default_factory=list)
    chord_error: float = 0.0
    #: Linear RGBA, one row a vertex.
    vertex_colors: NDArray[Any] | None = None
    #: Linear RGBA, one row a face.
    face_colors: NDArray[Any] | None = None

    def transformed(self, transform: NDArray[np.float64]) -> _Piece:
        """The piece under a 4x4 world-from-local transform."""
        if np.array_equal(transform, np.eye(4)):
            return self
        vertices = checks.as_float64(self.vertices) @ transform[:3, :3].T + transform[:3, 3]
        mirrored = np.linalg.det(transform[:3, :3]) < 0
        faces = np.ascontiguousarray(self.faces[:, ::-1]) if mirrored else self.faces
        stretch = float(np.linalg.norm(transform[:3, :3], 2))
        return replace(self, vertices=vertices, faces=faces, chord_error=self.chord_error * stretch)


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file.

    Parameters
    ----------
    path : str or path
        A file of any format that trimesh reads: OBJ, PLY, STL, OFF, GLB, glTF, ... A scene becomes one mesh with the
        transforms of its nodes applied; nodes of scale 0 are hidden. Textures and buffers are read from the folder of
        the file and from folders in it, where symbolic links are followed. Meshes compressed by Draco need the extra
        ``draco``.

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

    Examples
    --------
    >>> import tempfile
    >>> import fieldbake as fb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fb.models.gear().save(f"{folder}/gear.stl")
    ...     mesh = fb.load_mesh(f"{folder}/gear.stl")
    >>> mesh.is_closed
    True
    """
    file = checks.path(path)
    return _mesh(_from_file(file), str(file))


@former_names(thing="geometry")
def as_mesh(geometry: MeshLike) -> Mesh:
    """Convert an object to a Mesh; a Mesh is returned unchanged.

    Parameters
    ----------
    geometry : Mesh, path, trimesh.Trimesh, trimesh.Scene, (vertices, faces), or a list of those
        Other possible objects are PyVista's PolyData, both triangle meshes of Open3D, meshes of meshio, and anything
        with ``tessellate(tolerance)``, such as the solids of build123d and CadQuery: those are tessellated with a chord
        error of 1e-4 of their diagonal, see `Mesh.chord_error`. Arrays may be of any library that offers ``__array__``
        or ``__dlpack__``. Items of a list may be ``(object, transform)`` with a 4x4 world-from-local transform.

    Returns
    -------
    Mesh
        The mesh. A list becomes one mesh, with the parts of all its items.

    Raises
    ------
    FileNotFoundError
        If a path does not exist.
    MeshError
        If the object contains no usable mesh.

    Examples
    --------
    >>> import fieldbake as fb
    >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    >>> fb.as_mesh((corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])).is_closed
    True
    """
    return named_mesh("mesh", geometry)


def named_mesh(name: str, geometry: MeshLike) -> Mesh:
    """Convert the argument with this name to a Mesh, as :func:`as_mesh` does."""
    if isinstance(geometry, Mesh):
        return geometry
    return _mesh(_pieces(geometry, name), os.fspath(geometry) if isinstance(geometry, (str, os.PathLike)) else None)


def _mesh(pieces: Sequence[_Piece], path: str | None) -> Mesh:
    """Join the pieces into one mesh; errors name the file."""
    try:
        piece = _join(pieces)
        mesh = Mesh(
            piece.vertices,
            piece.faces,
            uv=piece.uv,
            parts=piece.parts or None,
            vertex_colors=piece.vertex_colors,
            face_colors=piece.face_colors,
        )
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
        np.concatenate(
            [np.add(piece.faces, start, dtype=np.int64) for piece, start in zip(pieces, first_vertex, strict=False)]
        ),
        uv,
        [
            part.with_faces(range(part.faces.start + start, part.faces.stop + start))
            for piece, start in zip(pieces, first_face, strict=False)
            for part in piece.parts or [Part(faces=range(len(piece.faces)))]
        ],
        max(piece.chord_error for piece in pieces),
        _joined_colors([(piece.vertex_colors, len(piece.vertices)) for piece in pieces]),
        _joined_colors([(piece.face_colors, len(piece.faces)) for piece in pieces]),
    )


def _joined_colors(colors: Sequence[tuple[NDArray[Any] | None, int]]) -> NDArray[np.float64] | None:
    """Join the colours of all pieces, each with its number of rows; None if no piece has any.

    A piece without colours becomes white.
    """
    if all(rows is None for rows, _ in colors):
        return None
    return np.concatenate([np.ones((count, 4)) if rows is None else rows.astype(np.float64) for rows, count in colors])


def _pieces(geometry: MeshLike, name: str) -> list[_Piece]:
    """Split an object into pieces; errors call it by `name`."""
    if isinstance(geometry, (str, os.PathLike)):
        return _from_file(geometry)
    if isinstance(geometry, Mesh):
        properties = (
            geometry.uv,
            list(geometry.parts),
            geometry.chord_error,
            geometry.vertex_colors,
            geometry.face_colors,
        )
        return [_Piece(geometry.vertices, geometry.faces, *properties)]
    if is_cloud(geometry):
        raise MeshError(f"{name}: is a cloud of points, which has no triangles; use fb.solid(cloud) first")
    if hasattr(geometry, "graph") and hasattr(geometry, "geometry"):
        return _from_scene(geometry, name)
    if hasattr(geometry, "vertices") and hasattr(geometry, "faces") and not callable(geometry.vertices):
        return [_from_trimesh(geometry)]
    if isinstance(geometry, (tuple, list)) and is_arrays(geometry):
        return [_Piece(check_vertices(geometry[0]), check_faces(geometry[1]))]
    if isinstance(geometry, tuple) and len(geometry) == 2:
        transform = checks.affine(f"{name}: transform", geometry[1], MeshError)
        return [piece.transformed(transform) for piece in _pieces(geometry[0], name)]
    if isinstance(geometry, list):
        if not geometry:
            raise MeshError(f"{name}: the list is empty; a surface needs at least one mesh")
        return [piece for number, item in enumerate(geometry) for piece in _pieces(item, f"{name}[{number}]")]
    if (found := triangles_of(geometry)) is not None:
        return [_Piece(check_vertices(found.vertices), check_faces(found.faces), chord_error=found.chord_error)]
    if hasattr(geometry, "to_mesh"):
        kind = type(geometry).__name__
        own = "shape" if kind == "Shape" else "volume" if kind.endswith("Volume") else "object"
        raise MeshError(f"{name}: must be a mesh, got a {kind}; {own}.to_mesh() makes a mesh of it")
    raise MeshError(
        f"{name}: cannot make a mesh of {checks.describe(geometry)}; give a path, a trimesh object, "
        "(vertices, faces), an object of PyVista, Open3D, meshio, build123d or CadQuery, (mesh, transform), or a list "
        "of those"
    )


def is_arrays(pair: Sequence[Any]) -> bool:
    """Whether a pair is numeric arrays (vertices, faces), neither two meshes nor a mesh with its transform."""
    if len(pair) != 2:
        return False
    for half in pair:
        # The first innermost item decides: with a path or a mesh there, the pair is a list of objects.
        inner = half
        while isinstance(inner, (tuple, list)) and len(inner) > 0:
            inner = inner[0]
        is_path_or_mesh = isinstance(inner, (str, os.PathLike, Mesh)) or hasattr(inner, "faces")
        if is_path_or_mesh or hasattr(inner, "graph") or is_cloud(inner):
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
    return _read_file(path, lambda scene, document: _from_scene(scene, os.fspath(path), document))


def _read_file(path: str | os.PathLike[str], take: Callable[[Any, Document | None], list[_Piece]]) -> list[_Piece]:
    """List the pieces that `take` finds in the scene of a file, or the triangles of a plain file.

    Every failure of a reader becomes a MeshError.
    """
    file = checks.path(path, "mesh", MeshError)
    if file.is_dir():
        is_store = (file / "zarr.json").exists()
        remedy = "; fieldbake.open_zarr opens this Zarr store in Python" if is_store else ""
        raise MeshError(f"{path}: is a directory, not a mesh file{remedy}")
    checks.finite_file(file, MeshError)
    # Opening the file here keeps FileNotFoundError and PermissionError unchanged.
    ending = file.suffix.lower()
    try:
        with file.open("rb") as stream:
            head = stream.read(None if ending in (".obj", ".stl", ".ply", ".glb", ".gltf") else HEAD_BYTES)
        plain = read_plain(ending, head)
    except MemoryError as error:
        raise checks.too_large(file) from error
    if ending in (".csg", ".sexpr"):
        raise MeshError(
            f"{path}: is an s-expression and no mesh; `fieldbake mesh {path} -o MESH.stl` makes a mesh, and in Python "
            "fb.csg.parse(text).to_mesh()"
        )
    if plain is not None:
        (vertices, faces), name = plain
        return [_Piece(vertices, faces, parts=[Part(name or file.name, range(len(faces)))])]
    if head.startswith(b"DRACO"):
        raise MeshError(
            f"{path}: is a file of Draco, which is not read; decode it with `draco_decoder -i FILE -o MESH.ply`, or in "
            "Python: `decoded = DracoPy.decode(data)`, then fb.Mesh(decoded.points, decoded.faces)"
        )

    import trimesh

    # Without texture coordinates trimesh can keep the vertex order of the file; with them it has to split vertices.
    keeps_order = ending == ".obj" and b"vt " not in head
    options: dict[str, Any] = {"maintain_order": True} if keeps_order else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            document: Document | None = None
            source: Any = str(file)
            # trimesh makes fans of polygons.
            if ending == ".obj" and (divided := _core.divide_obj_polygons(head)) is not None:
                source, options = io.BytesIO(divided), {**options, "file_type": "obj"}
            if ending in (".glb", ".gltf"):
                document = Document(head, ending == ".glb")
                source, options = io.BytesIO(document.content), {"file_type": ending[1:]}
            resolver = resolver_beside(file)
            scene = trimesh.load_scene(source, process=False, resolver=resolver, **options)
            if resolver.refused is not None:
                raise resolver.refused
            if document is not None:
                document.check(scene)
            pieces = take(scene, document)
        _check_is_whole(_announced_faces(ending, head), sum(len(piece.faces) for piece in pieces))
    except MeshError:
        raise
    except MemoryError as error:
        raise checks.too_large(file) from error
    except NotImplementedError as error:
        raise MeshError(
            f"{path}: unknown kind of file '{file.suffix}'; meshes are read from .obj, .ply, .stl, .off, .glb, .gltf, "
            ".3mf, .dae and others that trimesh reads"
        ) from error
    except Exception as error:  # Readers of damaged files raise exceptions of any type.
        if ending == ".3mf" and has_function(file):
            raise MeshError(
                f"{path}: has an implicit function and no triangles; `fieldbake mesh {path} -o MESH.stl` makes a mesh, "
                "and in Python fb.load(path).to_mesh()"
            ) from error
        reason = str(error) or _NAMELESS.get(type(error), type(error).__name__)
        if ending == ".3mf" and isinstance(error, KeyError):
            reason = f"object {reason} has no triangles"
        raise MeshError(f"{path}: cannot be read as a mesh ({file.suffix.lstrip('.').upper()}): {reason}") from error
    if document is not None:
        document.warn(os.fspath(path))
    return pieces


def load_nodes(path: str | os.PathLike[str]) -> list[tuple[Mesh, NDArray[np.float64]]]:
    """List the meshes of a file with their world-from-local transforms; nodes of one geometry share a Mesh."""
    keys: list[str] = []
    transforms: list[NDArray[np.float64]] = []

    def take(scene: Any, document: Document | None) -> list[_Piece]:
        pieces = {}
        for world_from_node, key, geometry in _visible_nodes(scene, str(path), document):
            if hasattr(geometry, "faces") and len(geometry.faces) > 0:
                keys.append(key)
                transforms.append(world_from_node)
                if key not in pieces:
                    pieces[key] = _from_trimesh(geometry, key, document)
        if not pieces:
            raise MeshError(f"{path}: has no triangles")
        names.extend(pieces)
        return list(pieces.values())

    names: list[str] = []
    pieces = _read_file(path, take)
    if not names:
        return [(_mesh(pieces, os.fspath(path)), np.eye(4))]
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
        raise ValueError(f"its header announces {announced} faces, it has {faces}; is it complete?")


def _visible_nodes(scene: Any, name: str, document: Document | None) -> Iterator[tuple[NDArray[np.float64], str, Any]]:
    """Yield the world-from-node transform, the key and the geometry of each node; a node of scale 0 is hidden.

    The nodes of a glTF file, `document`, have the order of the file.
    """
    nodes = list(scene.graph.nodes_geometry)
    for node in nodes if document is None else sorted(nodes, key=document.rank):
        transform, key = scene.graph[node]
        if np.any(np.asarray(transform)[:3, :3]):
            shown = node if document is None else document.node_name(node)
            world_from_node = checks.affine(f"{name}: transform of node '{shown}'", transform, MeshError)
            yield world_from_node, key, with_strips(scene.geometry[key])


def _from_scene(scene: Any, name: str, document: Document | None = None) -> list[_Piece]:
    """List a piece for every node of a trimesh.Scene with triangles."""
    pieces = []
    others = []
    for world_from_node, key, geometry in _visible_nodes(scene, name, document):
        if hasattr(geometry, "faces"):
            pieces.append(_from_trimesh(geometry, key, document).transformed(world_from_node))
        else:
            others.append(type(geometry).__name__)
    if not pieces:
        found = f"found only {', '.join(sorted(set(others)))}" if others else "it is empty, or all nodes have scale 0"
        hint = "; read points by fb.load_points" if "PointCloud" in others else ""
        raise MeshError(f"{name}: has no triangles ({found}){hint}")
    return pieces


def _from_trimesh(mesh: Any, name: str = "", document: Document | None = None) -> _Piece:
    """Convert the geometry and material of a trimesh.Trimesh, or of any object with vertices and faces.

    Colours of trimesh and of PLY files are sRGB for display, colours of glTF files (`document`) are linear.
    """
    vertices = np.asarray(check_vertices(mesh.vertices))
    faces = check_faces(mesh.faces)
    visual = getattr(mesh, "visual", None)
    properties: dict[str, Any] = {} if document is None else document.read(mesh)
    uv = properties.pop("uv", None)
    if uv is None:
        uv = getattr(visual, "uv", None)
    if uv is not None and np.shape(uv)[:1] == (len(vertices),) and np.ndim(uv) == 2:
        # Some exporters write NaN for vertices without coordinates. Values beyond float32 become 0 as well.
        with np.errstate(over="ignore"):
            stored = np.asarray(uv)[:, :2].astype(np.float32)
        uv = check_uv(np.nan_to_num(stored, posinf=0, neginf=0), len(vertices))
    else:
        uv = None
    vertex_colors, face_colors = _colors(visual, len(vertices), len(faces))
    if document is not None:
        vertex_colors = properties.pop("colors")
    part = _part(getattr(visual, "material", None), name, len(faces), properties)
    all_colors = [colors for colors in (vertex_colors, face_colors) if colors is not None]
    if document is None and any((colors[:, 3] < 1).any() for colors in all_colors):
        part.alpha_mode = "blend"
    return _Piece(vertices, faces, uv, [part], vertex_colors=vertex_colors, face_colors=face_colors)


def _colors(visual: Any, vertices: int, faces: int) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
    """Linear colours of vertices and faces of trimesh's visuals."""
    attributes = getattr(visual, "vertex_attributes", None)
    if attributes is not None and "color" in attributes:
        # Beside a texture trimesh keeps the values of a glTF file, which are linear, as they are stored.
        stored = np.asarray(attributes["color"])
        values = stored / np.iinfo(stored.dtype).max if stored.dtype.kind in "iu" else stored
        return check_colors("vertex_colors", values, vertices, "vertex"), None
    kind = getattr(visual, "kind", None)
    if kind == "vertex":
        return check_colors("vertex_colors", visual.vertex_colors, vertices, "vertex"), None
    if kind == "face":
        return None, check_colors("face_colors", visual.face_colors, faces, "face")
    return None, None


def _part(material: Any, name: str, faces: int, properties: dict[str, Any]) -> Part:
    """Convert either kind of trimesh material to a part; `properties` are not read by trimesh."""
    if material is None:
        return Part(name, range(faces))
    own_name = properties.pop("name", None) if "name" in properties else getattr(material, "name", None)
    if not properties:
        emission = getattr(material, "emissiveFactor", None)
        if emission is not None:
            properties["emission"] = tuple(np.asarray(emission, dtype=np.float64).tolist())
            properties["emission_image"] = getattr(material, "emissiveTexture", None)
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        image = getattr(material, "image", None)
    color = getattr(material, "baseColorFactor", None)
    if color is None and image is None:
        color = getattr(material, "diffuse", None)
    mode = str(getattr(material, "alphaMode", None) or "opaque").lower()
    cutoff = getattr(material, "alphaCutoff", None)
    return Part(
        str(own_name or name),
        range(faces),
        color=properties.pop("color", None) or _rgba(color),
        image=image,
        alpha_mode=mode if mode in ALPHA_MODES else "opaque",
        alpha_cutoff=0.5 if cutoff is None else float(cutoff),
        two_sided=bool(getattr(material, "doubleSided", None)),
        **properties,
    )


def _rgba(color: ArrayLike | None) -> tuple[float, float, float, float]:
    """Convert a colour of trimesh, bytes or floats, to four floats from 0 to 1."""
    if color is None:
        return (1.0, 1.0, 1.0, 1.0)
    values = np.asarray(color).ravel()
    floats: Iterable[float] = values.astype(np.float64) / (255 if values.dtype.kind in "iu" else 1)
    r, g, b, a = (*floats, 1.0)[:4] if len(values) >= 3 else (1.0, 1.0, 1.0, 1.0)
    return float(r), float(g), float(b), float(a)
