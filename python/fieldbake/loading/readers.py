""":func:`load`: the object in a file, by the record of its format."""

from __future__ import annotations

import errno
import os
import zipfile
from typing import Any, TypeVar

from .. import _core
from ..base import checks
from ..base.errors import CapacityError, FormatError
from ..files.registry import format_of
from ..shapes.implicit_function import read_function
from ..shapes.shape import Shape
from .foreign import load_format
from .npz import read_archive

_Kind = TypeVar("_Kind")


def load(path: str | os.PathLike[str]) -> Any:
    """Read a file that fieldbake wrote, or a grid of another program.

    Parameters
    ----------
    path : str or path
        A file that :meth:`Volume.save`, :meth:`Atlas.save` or another ``save`` wrote. Files of other programs may be
        ``.vdb`` (the level set, or else the first float grid; read as a dense grid), ``.nvdb`` (one uncompressed float
        grid), ``.vti``, ``.nrrd`` and ``.vf``. A ``.3mf`` file of :meth:`Shape.save` with ``implicit=True`` is a
        shape; other ``.3mf`` files are meshes for :func:`load_mesh`.

    Returns
    -------
    Volume, QuantizedVolume, SparseVolume, NestedField, Atlas or Shape
        Equal bit for bit to the saved object, in the encoding of the file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FormatError
        If the file is of another kind, damaged, unsafe to read, or written by a newer version.
    CapacityError
        If the content does not fit in memory.

    Examples
    --------
    >>> import tempfile
    >>> import fieldbake as fb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fb.bake(fb.sphere(), 16).save(f"{folder}/ball.npz")
    ...     volume = fb.load(f"{folder}/ball.npz")
    >>> volume.resolution
    (16, 16, 16)
    """
    file = checks.path(path)
    if file.is_dir():
        raise FormatError(f"{file}: is a directory, not a fieldbake file; open_zarr opens a Zarr store")
    checks.finite_file(file, FormatError)
    with file.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        try:
            if file.suffix.lower() == ".3mf":
                return Shape._wrap(_core.Shape.parse(read_function(stream)))
            found = format_of(file.suffix.lower())
            if found is not None and found.read is not None:
                return load_format(file, found)
            with zipfile.ZipFile(stream) as archive:
                return read_archive(archive, size)
        except FormatError as error:
            raise FormatError(f"{file}: {error}") from None
        except zipfile.BadZipFile as error:
            if file.suffix.lower() == ".npz":
                raise FormatError(f"{file}: is damaged or not an .npz file ({error})") from None
            raise FormatError(
                f"{file}: is not a fieldbake file; load_mesh reads meshes, and load_points points"
            ) from None
        except (CapacityError, UserWarning):  # A filter may raise the warnings of the package.
            raise
        except MemoryError as error:
            raise checks.too_large(file) from error
        except Exception as error:  # Readers of damaged archives raise exceptions of any type.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            raise FormatError(f"{file}: is damaged ({type(error).__name__}: {error})") from error


def load_as(kind: type[_Kind], path: str | os.PathLike[str]) -> _Kind:
    """Read the object in a file, and check that it is of this kind."""
    found = load(path)
    if not isinstance(found, kind):
        name, expected = (
            f"{'an' if one[0] in 'AEIOU' else 'a'} {one}" for one in (type(found).__name__, kind.__name__)
        )
        raise FormatError(f"{checks.path(path)}: holds {name}, not {expected}; use fieldbake.load")
    return found
