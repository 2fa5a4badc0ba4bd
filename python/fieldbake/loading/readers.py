"""The table of readers by file ending, and :func:`load`."""

from __future__ import annotations

import errno
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..atlases import images
from ..atlases.atlas import Atlas
from ..base import checks
from ..base.errors import CapacityError, FormatError
from ..volumes import writers
from ..volumes.volume import Volume
from .foreign import load_image, load_sheet, load_volume
from .npz import read_archive

_Kind = TypeVar("_Kind")

#: Readers of the formats other than .npz, by ending.
_FOREIGN: dict[str, Callable[[Path], Volume | Atlas]] = {
    **dict.fromkeys(writers.ENDINGS, load_volume),
    **dict.fromkeys(images.ENDINGS, load_image),
    ".exr": load_sheet,
}


def load(path: str | os.PathLike[str]) -> Any:
    """Read a file that fieldbake wrote, or a grid of another program.

    Parameters
    ----------
    path : str or path
        A file that :meth:`Volume.save`, :meth:`Atlas.save` or another ``save`` wrote. Files of other programs may be
        ``.vdb`` (the level set, or else the first float grid; read as a dense grid), ``.nvdb`` (one uncompressed float
        grid), ``.vti``, ``.nrrd`` and ``.vf``.

    Returns
    -------
    Volume, QuantizedVolume, SparseVolume, NestedField or Atlas
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
            if (foreign := _FOREIGN.get(file.suffix.lower())) is not None:
                return foreign(file)
            with zipfile.ZipFile(stream) as archive:
                return read_archive(archive, size)
        except FormatError as error:
            raise FormatError(f"{file}: {error}") from None
        except zipfile.BadZipFile as error:
            if file.suffix.lower() == ".npz":
                raise FormatError(f"{file}: is damaged or not an .npz file ({error})") from None
            raise FormatError(f"{file}: is not a fieldbake file; meshes are read by load_mesh or bake") from None
        except CapacityError:
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
        name, wanted = (f"{'an' if one[0] in 'AEIOU' else 'a'} {one}" for one in (type(found).__name__, kind.__name__))
        raise FormatError(f"{checks.path(path)}: holds {name}, not {wanted}; use fieldbake.load")
    return found
