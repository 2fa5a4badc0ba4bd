"""MJCF files: checks of all that they name before MuJoCo opens anything, and its errors as ours."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import FormatError
from ..base.optional import optional_module
from ..meshes.mesh import Mesh
from .geometry_files import GeometryFiles
from .xml_files import read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

#: Attributes of `compiler` that name the folder of the files of an element.
_FOLDERS = {"mesh": "meshdir", "skin": "meshdir", "hfield": "meshdir", "texture": "texturedir"}

#: Elements that name another XML file.
_XML = ("include", "model")

#: Most files that one MJCF file may include, also indirectly.
_MOST_FILES = 1000


def read_spec(path: Path, purpose: str) -> Any:
    """Read an MJCF file as `mujoco.MjSpec`.

    Raises FormatError, in one line, for what MuJoCo refuses, and for a file outside the folder of `path` that it would
    open, directly or through an included file.
    """
    mujoco = optional_module("mujoco", purpose, extra="mujoco")
    path.stat()  # a missing file is a FileNotFoundError
    _check_files(path)
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, UnicodeError) as error:
        raise FormatError(f"{path}: {one_line(error)}") from None


def compiled(spec: Any, source: object) -> Any:
    """Compile a specification; `source` names it in errors."""
    try:
        return spec.compile()
    except ValueError as error:
        raise FormatError(f"{source}: {one_line(error)}") from None


def one_line(error: Exception) -> str:
    """The message of MuJoCo as one line."""
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())


def rotation(quaternion: Any) -> NDArray[np.float64]:
    """The rotation (3, 3) of a quaternion (w, x, y, z), which is normalised."""
    array = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = (array / np.linalg.norm(array)).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def mesh_of(model: Any, i: int) -> Mesh:
    """The triangles of mesh `i` in the frame of its octree, which is the frame of its inertia and of its geoms."""
    vertex, face = model.mesh_vertadr[i], model.mesh_faceadr[i]
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[i]]
    return Mesh(vertices, model.mesh_face[face : face + model.mesh_facenum[i]])


def _check_files(path: Path) -> None:
    """Raise FormatError if a file that the MJCF file names lies outside its folder."""
    files = GeometryFiles(path)
    elements = list(_elements(path, files))
    folders: dict[str, list[str]] = {"meshdir": [""], "texturedir": [""]}
    is_stripped = any(e.get("strippath") == "true" for e in elements)
    for element in elements:
        if element.tag == "compiler":
            asset = element.get("assetdir")
            for name, found in folders.items():
                found.extend(folder for folder in (element.get(name), asset) if folder is not None)
    for element in elements:
        kind = _FOLDERS.get(element.tag)
        names = [name for key, name in element.attrib.items() if key.startswith("file")]
        for name in names if kind else ():
            # MuJoCo decides which folder applies, so the path must be valid in each.
            short = os.path.basename(name.replace("\\", "/")) if is_stripped else name  # noqa: PTH119 - not a path here
            files.find(short, f"{element.tag} {element.get('name') or name!r}", folders[kind or ""])


def _elements(path: Path, files: GeometryFiles) -> Iterator[Element]:
    """All elements of an MJCF file and of the files that it includes."""
    waiting, seen = [path], {path.resolve()}
    while waiting:
        file = waiting.pop()
        for element in read_xml(file).iter():
            yield element
            name = element.get("file")
            if element.tag in _XML and name is not None:
                beside = os.path.relpath(file.resolve().parent, files.folder)
                found = files.find(name, f"{element.tag} {name!r}", ("", beside))
                if found not in seen:
                    if len(seen) >= _MOST_FILES:
                        raise FormatError(f"{path}: includes more than {_MOST_FILES} files")
                    seen.add(found)
                    waiting.append(found)
