"""Outlines of SVG pictures and paths as polygons, by svgelements."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...base import checks
from ...base.errors import ShapeError
from ...base.notices import warn_surface
from ...base.optional import optional_module
from ...base.report import count_text
from .curves import TOLERANCE, Array, bezier_points
from .svg_documents import svg_document

#: Cubic curves in a full turn of an arc; each is within 1e-8 of the radius.
ARC_PIECES = 32

#: Text that can only be the data of a path: a move to a point, and then commands of paths, numbers and separators.
_PATH_DATA = re.compile(r"\s*[Mm][\s,]*[-+]?\.?\d[MmZzLlHhVvCcSsQqTtAaeE\d\s,.+-]*")


def svg_loops(source: str | os.PathLike[str], tolerance: float | None) -> list[tuple[list[Array], str]]:
    """Polygons (m, 2) of each filled element with its fill rule. The y axis of the picture is reversed."""
    library = optional_module("svgelements", "Profile.from_svg", extra="svg")
    if tolerance is not None and not tolerance > 0:
        raise ShapeError(f"tolerance: must be above 0, got {tolerance:g}")
    if isinstance(source, str) and _is_path_data(source):
        try:
            paths = [(library.Path(source), "nonzero")]
        except (ValueError, IndexError, TypeError) as error:
            raise ShapeError(f"source: {source[:60]!r} is no path of SVG: {error}") from error
    else:
        paths = _of_file(library, checks.path(source, "source", ShapeError))
    if tolerance is None:
        boxes = [box for box in (path.bbox() for path, _ in paths) if box is not None]
        sides = [max(box[2] for box in boxes) - min(box[0] for box in boxes)] if boxes else [1.0]
        sides += [max(box[3] for box in boxes) - min(box[1] for box in boxes)] if boxes else []
        tolerance = TOLERANCE * max(sides)
    found = [(_flattened(library, path, tolerance), rule) for path, rule in paths]
    return [(loops, rule) for loops, rule in found if loops]


def _is_path_data(source: str) -> bool:
    """Whether a text is the data of a path; a name that ends in .svg or of an existing file is a file."""
    if source.lower().endswith(".svg") or not _PATH_DATA.fullmatch(source):
        return False
    return not os.path.isfile(source)  # noqa: PTH113 - a long path of SVG is no valid name, which Path.is_file refuses


def _of_file(library: Any, path: Path) -> list[tuple[Any, str]]:
    from xml.etree.ElementTree import ParseError

    try:
        picture = library.SVG.parse(svg_document(path), ppi=96)
    except (ParseError, ValueError) as error:
        if isinstance(error, ShapeError):
            raise
        raise ShapeError(f"source: {path} is no SVG picture: {error}") from error
    paths = []
    clipped = 0
    elements = [picture]
    while elements:
        element = elements.pop()
        values, own = element.values, element.values.get("attributes", {})
        # A group that is transparent hides all of its content, which may have opacities of its own.
        if _is_zero(own.get("opacity")):
            continue
        clipped += any(own.get(name, "none") != "none" for name in ("clip-path", "mask"))
        if isinstance(element, (library.Group, library.Use)):
            elements.extend(reversed(element))
        elif isinstance(element, library.Shape) and not (
            _is_unfilled(element) or _is_zero(values.get("fill-opacity")) or values.get("visibility") == "hidden"
        ):
            rule = "even-odd" if values.get("fill-rule") == "evenodd" else "nonzero"
            paths.append((library.Path(element).reify(), rule))
    if clipped:
        count = count_text(clipped, "element")
        warn_surface([f"source: {path}: clip-path or mask of {count} is ignored; apply it in a drawing program"])
    return paths


def _is_zero(opacity: str | None) -> bool:
    """Whether an opacity such as ``"0"`` or ``"0 %"`` is fully transparent."""
    try:
        return opacity is not None and float(opacity.strip().removesuffix("%")) <= 0
    except ValueError:
        return False


def _is_unfilled(element: Any) -> bool:
    """Whether the fill of an element is none or a colour that is fully transparent. Gradients are filled."""
    color = element.fill
    return str(element.values.get("fill")) == "none" or (
        color is not None and color.value is not None and not color.alpha
    )


def _flattened(library: Any, path: Any, tolerance: float) -> list[Array]:
    """The subpaths as polygons of three corners at least."""
    loops: list[list[Array]] = []
    for segment in path:
        if isinstance(segment, library.Move):
            loops.append([_point(segment.end)[None]])
        elif isinstance(segment, library.Close) or segment.end is None:
            # A subpath may go on behind its start without another move.
            if loops:
                loops.append([loops[-1][0]])
        elif isinstance(segment, library.Arc):
            count = max(1, math.ceil(ARC_PIECES * abs(segment.sweep) / math.tau))
            loops[-1] += [_curve(piece, tolerance) for piece in segment.as_cubic_curves(count)]
        elif isinstance(segment, (library.CubicBezier, library.QuadraticBezier)):
            loops[-1].append(_curve(segment, tolerance))
        else:
            loops[-1].append(_point(segment.end)[None])
    joined = [np.concatenate(pieces) for pieces in loops]
    return [loop for loop in joined if len(np.unique(loop, axis=0)) >= 3]


def _curve(segment: Any, tolerance: float) -> Array:
    names = ("start", "control", "control1", "control2", "end")
    return bezier_points([_point(getattr(segment, name)) for name in names if hasattr(segment, name)], tolerance)


def _point(point: Any) -> Array:
    return np.array([float(point.x), -float(point.y)])
