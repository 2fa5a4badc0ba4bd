"""Objects that read their own files."""

from __future__ import annotations

import os
from typing import TypeVar

_Kind = TypeVar("_Kind")


class Loadable:
    """Base class of objects that have a file format."""

    __slots__ = ()

    @classmethod
    def load(cls: type[_Kind], path: str | os.PathLike[str]) -> _Kind:
        """Read a file that holds an object of this class.

        Parameters
        ----------
        path : str or path
            A file that ``save`` wrote.

        Returns
        -------
        object of this class
            Equal bit for bit to the saved object.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        FormatError
            If the file holds another kind of object, is damaged, or was written by a newer version.
        """
        from ..loading.readers import load_as

        return load_as(cls, path)
