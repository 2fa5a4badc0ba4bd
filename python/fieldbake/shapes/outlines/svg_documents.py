"""SVG documents in the form that svgelements reads exactly: lengths in millimetres, and one scale of the picture.

svgelements converts millimetres by constants of six digits, draws the contents of symbols, masks and markers, and moves
the corner of the viewBox to the origin. The functions below change the document before svgelements reads it.
"""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, parse

from ...base.errors import ShapeError

#: Millimetres in the units of physical lengths. The other units are pixels, or relative to them.
MILLIMETRES = {"mm": 1.0, "cm": 10.0, "in": 25.4, "q": 0.25}

#: Pixels in the units of the width and the height of a picture.
PIXELS = {"": 1.0, "px": 1.0, "pt": 4 / 3, "pc": 16.0}

#: Relative units of the width and the height of a picture: per cent of its viewBox.
RELATIVE = ("%", "vw", "vh")

#: Attributes that hold a length.
_LENGTHS = ("x", "y", "width", "height", "r", "rx", "ry", "cx", "cy", "x1", "y1", "x2", "y2")

#: Elements that other elements refer to, and that are never drawn themselves.
_DEFINITIONS = ("symbol", "mask", "marker")

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_LENGTH = re.compile(rf"\s*({_NUMBER})\s*(%|[a-z]*)\s*", re.IGNORECASE)
_STYLE_LENGTH = re.compile(rf"(:\s*)({_NUMBER})(mm|cm|in|q)(?=\s*(?:;|$))", re.IGNORECASE)


def svg_document(path: Path) -> tuple[io.BytesIO, tuple[float, float] | None]:
    """Read a picture; return the document for svgelements and the size of its viewBox, None without a viewBox.

    In the document, physical lengths are numbers of millimetres, the unit of the picture is the user space of the
    outermost element times the scale of its viewBox, and definitions are in ``<defs>``. A picture of size 0 is empty.

    Raises
    ------
    ParseError
        If the file is no XML.
    ShapeError
        If the width or the height has an unknown unit.
    """
    with path.open("rb") as stream:
        document = parse(stream)
    root = document.getroot()
    _hide_definitions(root, inside=False)
    for element in root.iter():
        for name in _LENGTHS:
            if (text := element.get(name)) is not None:
                element.set(name, _in_millimetres(text))
        if (style := element.get("style")) is not None:
            element.set("style", _STYLE_LENGTH.sub(_style_in_millimetres, style))
    box = [float(number) for number in re.findall(_NUMBER, root.get("viewBox", ""), re.IGNORECASE)]
    if _name(root) != "svg" or len(box) != 4:
        return _written(document), None
    width, height = box[2:]
    scale = _scale(root, path, (width, height))
    if scale is None:
        for child in list(root):
            root.remove(child)
        scale = (1.0, 1.0)
    for name in ("viewBox", "preserveAspectRatio", "width", "height", "x", "y"):
        root.attrib.pop(name, None)
    kept = [entry for entry in root.get("style", "").split(";") if entry.partition(":")[0].strip() not in _LENGTHS]
    root.set("style", ";".join(kept))
    root.set("transform", f"{root.get('transform', '')} scale({scale[0]!r},{scale[1]!r})")
    return _written(document), (width, height)


def _written(document: ElementTree[Element]) -> io.BytesIO:
    buffer = io.BytesIO()
    document.write(buffer, encoding="utf-8", xml_declaration=True)
    buffer.seek(0)
    return buffer


def _name(element: Element) -> str:
    """The name of an element without its namespace; empty for an element of another namespace."""
    space, _, name = element.tag.rpartition("}")
    return name if space in ("", "{http://www.w3.org/2000/svg") else ""


def _hide_definitions(element: Element, *, inside: bool) -> None:
    """Put each definition below an element into ``<defs>``; svgelements draws it where it is used, and nowhere else."""
    for index, child in enumerate(list(element)):
        name = _name(child)
        _hide_definitions(child, inside=inside or name == "defs")
        if name in _DEFINITIONS and not inside:
            hidden = Element(child.tag.replace(name, "defs"))
            hidden.append(child)
            element[index] = hidden


def _in_millimetres(text: str) -> str:
    """Convert a physical length to a number of millimetres; other lengths stay."""
    found = _LENGTH.fullmatch(text)
    if found is None or found[2].lower() not in MILLIMETRES:
        return text
    return repr(float(found[1]) * MILLIMETRES[found[2].lower()])


def _style_in_millimetres(found: re.Match[str]) -> str:
    return found[1] + repr(float(found[2]) * MILLIMETRES[found[3].lower()])


def _scale(root: Element, path: Path, viewbox: tuple[float, float]) -> tuple[float, float] | None:
    """World units per user unit along x and y; None for a picture of size 0, which shows nothing."""
    style = {
        name.strip(): text for name, _, text in (entry.partition(":") for entry in root.get("style", "").split(";"))
    }
    if min(viewbox) <= 0:
        return None
    scales = []
    for name, side in zip(("width", "height"), viewbox, strict=True):
        text = style.get(name, root.get(name, "auto"))
        found = _LENGTH.fullmatch(text)
        if found is None:
            scales.append(math.nan)  # The scale follows from the other side.
            continue
        amount, unit = float(found[1]), found[2].lower()
        if unit in RELATIVE:
            amount *= side / 100
        elif unit in PIXELS:
            amount *= PIXELS[unit]
        else:
            raise ShapeError(
                f"source: {path}: the {name} {text.strip()!r} has no absolute unit; write mm, cm, in or px"
            )
        if amount <= 0:
            return None
        scales.append(amount / side)
    x, y = scales
    if math.isnan(x) or math.isnan(y):
        only = 1.0 if math.isnan(x) and math.isnan(y) else y if math.isnan(x) else x
        return only, only
    align = root.get("preserveAspectRatio", "xMidYMid").split()
    if align[:1] == ["none"]:
        return x, y
    only = max(x, y) if align[1:] == ["slice"] else min(x, y)
    return only, only
