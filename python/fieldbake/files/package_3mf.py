"""Packages of 3MF: a zip archive with one model, an XML file."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import FormatError

#: Namespace of the core specification.
CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"

#: Name of the model in a package.
_MODEL = "3D/3dmodel.model"

#: Rows that are written at once, between which Ctrl-C ends the work.
_ROW_BATCH = 1 << 16

#: Largest part of a model that is read at once, bytes of XML. The functions of a model come before its meshes.
MOST_READ = 1 << 26

#: Largest ratio of the sizes of a larger model and of its compressed bytes. Meshes have about 10.
_MOST_COMPRESSED = 100

_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
)
_PNG_TYPE = '<Default Extension="png" ContentType="image/png"/>'


def write(stream: IO[bytes], model: Iterable[str], pictures: Mapping[str, bytes] | None = None) -> None:
    """Write a package with a model, given as parts of its XML text, and .png files by their paths."""
    pictures = pictures or {}
    members: list[tuple[str, Iterable[bytes]]] = [
        ("[Content_Types].xml", [(_TYPES + _PNG_TYPE * bool(pictures) + "</Types>").encode()]),
        ("_rels/.rels", [_relations("3dmodel", [_MODEL])]),
        (_MODEL, (text.encode() for text in model)),
    ]
    if pictures:
        members.append(("3D/_rels/3dmodel.model.rels", [_relations("3dtexture", pictures)]))
    members += [(path, [picture]) for path, picture in pictures.items()]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, parts in members:
            # A fixed date, so that equal models make equal files.
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_STORED if name.endswith(".png") else zipfile.ZIP_DEFLATED
            with archive.open(info, "w") as member:
                for part in parts:
                    member.write(part)
    stream.write(buffer.getvalue())


def _relations(kind: str, paths: Iterable[str]) -> bytes:
    """The relations from a part of a package to others of one kind."""
    rows = (
        f'<Relationship Target="/{path}" Id="rel{i}" '
        f'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/{kind}"/>'
        for i, path in enumerate(paths)
    )
    head = '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    return ('<?xml version="1.0" encoding="UTF-8"?>\n' + head + "".join(rows) + "</Relationships>").encode()


def mesh_texts(vertices: NDArray[np.float64], faces: NDArray[Any]) -> Iterator[str]:
    """The element of a mesh with vertices (n, 3) and faces (m, 3), with the digits that restore each float64."""
    yield "<mesh><vertices>"
    for rows in _batches(vertices):
        yield "".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in rows.tolist())
    yield "</vertices><triangles>"
    for rows in _batches(faces):
        yield "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in rows.tolist())
    yield "</triangles></mesh>"


def _batches(rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
    return (rows[first : first + _ROW_BATCH] for first in range(0, len(rows), _ROW_BATCH))


def has_function(path: Path) -> bool:
    """Whether a file is a package whose model has an implicit function. A package that is not safe to read has none."""
    with path.open("rb") as stream:
        try:
            return b"implicitfunction" in read_model(stream)
        except FormatError:
            return False


def read_model(stream: IO[bytes]) -> bytes:
    """Read the beginning of the model of a package, at most 64 MiB of XML."""
    return next(model_parts(stream))


def model_parts(stream: IO[bytes]) -> Iterator[bytes]:
    """Read the model of a package in parts of 64 MiB of XML; the last one may be empty."""
    try:
        with zipfile.ZipFile(stream) as archive, archive.open(_MODEL) as member:
            facts = archive.getinfo(_MODEL)
            if facts.file_size > max(MOST_READ, _MOST_COMPRESSED * facts.compress_size):
                raise FormatError(f"{_MODEL} is compressed {_MOST_COMPRESSED}-fold or more, which is not safe to read")
            part = member.read(MOST_READ)
            yield part
            while part:
                part = member.read(MOST_READ)
                yield part
    except KeyError:
        raise FormatError(f"the package has no {_MODEL}") from None
    except (zipfile.BadZipFile, zlib.error) as error:
        raise FormatError(f"is damaged or not a 3MF package ({error})") from None
