"""Hashes of contents and options, by which finished work is recognised."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..meshes.convert import as_mesh
from ..meshes.mesh import Mesh
from ..shapes.shape import Shape, all_shapes

#: Bytes read at once.
_BLOCK = 1 << 20


def of_file(path: str | os.PathLike[str]) -> str:
    """Hash of a file; of a glTF file also of the files that it refers to."""
    digest = hashlib.sha256()
    _add_file(digest, Path(path))
    if Path(path).suffix.lower() == ".gltf":
        for uri in _referred(Path(path)):
            part = Path(path).parent / unquote(uri)
            if part.is_file():
                _add_file(digest, part)
    return digest.hexdigest()


def _add_file(digest: Any, path: Path) -> None:
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)


def _referred(path: Path) -> list[str]:
    try:
        document = json.loads(path.read_bytes())
        entries = [*document.get("buffers", ()), *document.get("images", ())]
        return [entry["uri"] for entry in entries if "uri" in entry and not entry["uri"].startswith("data:")]
    except (ValueError, AttributeError, TypeError):
        return []  # the reader of the file reports it


def of_mesh(mesh: Mesh) -> str:
    """Hash of the vertices and faces of a mesh."""
    return of_arrays(mesh.vertices, mesh.faces)


def of_arrays(*arrays: NDArray[Any]) -> str:
    """Hash of types, shapes and elements."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def of_item(item: Any) -> str:
    """Hash of anything that can be baked."""
    if isinstance(item, Shape) or all_shapes(item):
        shapes = [item] if isinstance(item, Shape) else item
        return hashlib.sha256("\n".join(shape.to_sexpr() for shape in shapes).encode()).hexdigest()
    return of_file(item) if isinstance(item, (str, os.PathLike)) else of_mesh(as_mesh(item))


def of_options(options: Mapping[str, Any]) -> str:
    """Hash of options and of the version of the package."""
    text = json.dumps({**options, "version": _core.__version__}, sort_keys=True, default=plain)
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Any:
    """Convert a value to the types of JSON: arrays to lists, NumPy numbers to Python numbers."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return np.asarray(value).tolist()
