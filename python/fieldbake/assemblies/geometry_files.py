"""Files that a robot file names: they must lie in its folder, or in the folder of a package that the caller names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..base.errors import FormatError


class GeometryFiles:
    """The folders in which the files of one robot file may lie.

    Parameters
    ----------
    source : Path
        The robot file, which errors name.
    packages : mapping of str to Path, optional
        Folders of ROS packages by name, for ``package://name/...``.
    """

    def __init__(self, source: Path, packages: Mapping[str, Path] | None = None) -> None:
        self.source = source
        self.folder = source.resolve().parent
        self.packages = {name: folder.resolve() for name, folder in (packages or {}).items()}

    def find(self, name: str, owner: str, folders: Sequence[str] = ("",)) -> Path:
        """Find a file by the name that an element gives, without opening it.

        Parameters
        ----------
        name : str
            A path relative to one of `folders`, or ``package://NAME/path``.
        owner : str
            The element, for messages.
        folders : sequence of str
            Folders relative to the folder of the robot file, in the order in which they are tried.

        Raises
        ------
        FormatError
            If the path leaves all folders that the caller named, after symbolic links and ``..`` are resolved, or if
            there is no such file.
        """
        scheme = re.match(r"([A-Za-z][A-Za-z0-9+.-]+):", name)
        if scheme is None:
            tried = [self._inside(Path(self.folder, folder, name), name, owner) for folder in folders]
        elif scheme[1].lower() == "package":
            tried = self._in_packages(name, owner)
        else:
            raise self._outside(name, owner)
        for file in tried:
            if file.is_file():
                return file
        places = ", ".join(dict.fromkeys(map(str, tried)))
        raise FormatError(f"{self.source}: {owner}: there is no file {name!r}; tried {places}")

    def _in_packages(self, name: str, owner: str) -> list[Path]:
        """The places of ``package://NAME/path``: a named package, else the robot file's folder and the folders above.

        Packages have a folder of their own name. A robot file usually lies in one of its folders, which may be the
        package itself or be named after it.
        """
        package, _, rest = name.split(":", 1)[1].lstrip("/").partition("/")
        if package in self.packages:
            return [self._inside(self.packages[package] / rest, name, owner)]
        return [self._inside(self.folder / package / rest, name, owner), self._inside(self.folder / rest, name, owner)]

    def _inside(self, file: Path, name: str, owner: str) -> Path:
        """Resolve a path, which must lie in a folder that the caller named."""
        try:
            real = file.resolve()
        except (OSError, ValueError, RuntimeError) as error:  # too long, a null byte, a loop of links
            raise FormatError(f"{self.source}: {owner}: {name[:80]!r} is no path ({error})") from None
        if not any(real.is_relative_to(folder) for folder in (self.folder, *self.packages.values())):
            raise self._outside(name, owner)
        return real

    def _outside(self, name: str, owner: str) -> FormatError:
        return FormatError(
            f"{self.source}: {owner}: the mesh path leaves the folder of the file: {name!r}; "
            "put the file there, or name its package in packages="
        )
