"""Files that a mesh file names: its buffers, materials and textures."""

from __future__ import annotations

import posixpath
from pathlib import Path
from typing import Any

from ...base import checks
from ...base.errors import MeshError


def resolver_beside(file: Path) -> Any:
    """Make a resolver that reads the files that a mesh file names, in its folder and below alone."""
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):
        #: The last file that is not read. trimesh drops the errors of textures and materials.
        refused: MeshError | None = None

        def get(self, name: str) -> bytes:
            found = _beside(file, name)
            try:
                checks.finite_file(found, MeshError)
            except MeshError as error:
                self.refused = error
                raise
            return found.read_bytes()

    return Resolver(str(file))


def _beside(file: Path, name: str) -> Path:
    """Find a file by the name that a mesh file has for it.

    The separators of Windows are allowed. Exporters write absolute names and names of folders that are not there, so
    the last part of a name is looked for beside the mesh file too. The name decides what lies in the folder: a symbolic
    link there is followed.
    """
    path = posixpath.normpath(name.strip().replace("\\", "/"))
    outside = path.startswith(("/", "../")) or path == ".." or ":" in path
    tried = [] if outside else [path]
    for candidate in [*tried, posixpath.basename(path)]:
        found = file.parent / candidate
        if found.exists() and not found.is_dir():
            return found
    if outside:
        raise ValueError(f"it refers to {name!r}, which is outside of its folder; only files beside it are read")
    raise FileNotFoundError(f"it refers to {name!r}, which is not beside it")
