"""Files of shapes: s-expressions (.csg, .sexpr), and .3mf files with an implicit function that fieldbake wrote."""

from __future__ import annotations

from pathlib import Path

import fieldbake as fb

from ...files.package_3mf import has_function

#: Endings of text files with one s-expression.
SEXPR = (".csg", ".sexpr")


def shape_in_file(path: Path) -> fb.Shape | None:
    """Read the shape of a file; None for a file that holds something else, such as a .3mf file of triangles."""
    ending = path.suffix.lower()
    if ending in SEXPR:
        return read_sexpr(path)
    if ending != ".3mf" or not has_function(path):
        return None
    shape: fb.Shape = fb.load(path)
    return shape


def geometry_in_file(path: Path) -> fb.Shape | Path:
    """Read the shape of a file, or return the path, which functions of the package read as a mesh."""
    shape = shape_in_file(path)
    return path if shape is None else shape


def read_sexpr(path: Path) -> fb.Shape:
    """Read the s-expression of a text file in UTF-8, with or without a byte order mark."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise fb.FormatError(
            f"{path}: must be text in UTF-8 with one s-expression, got the byte 0x{error.object[error.start]:02x} at "
            f"offset {error.start}; save the text in UTF-8, or `fieldbake info` describes a file of another kind"
        ) from None
    return fb.csg.parse(text)
