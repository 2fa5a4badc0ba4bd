"""SVG documents in the form that svgelements reads exactly: lengths in user units, and one scale of the picture.

svgelements converts millimetres by constants of six digits, draws the contents of symbols, masks and markers, moves the
corner of the viewBox to the origin, and passes the position and the size of an element to its children. The functions
below change the document before svgelements reads it.
"""

from __future__ import annotations

import copy
import io
import math
import re
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, parse

from ...base.errors import ShapeError

#: Millimetres in the units of physical lengths. The other units are pixels, or relative to them.
MILLIMETRES = {"mm": 1.0, "cm": 10.0, "in": 25.4, "q": 0.25}

#: User units in a millimetre. A user unit is a pixel of CSS.
PER_MILLIMETRE = 96 / 25.4

#: User units in the units of pixels.
PIXELS = {"": 1.0, "px": 1.0, "pt": 4 / 3, "pc": 16.0}

#: Relative units of the width and the height of a picture: per cent of its viewBox.
RELATIVE = ("%", "vw", "vh")

#: Attributes that hold a length.
_LENGTHS = ("x", "y", "width", "height", "r", "rx", "ry", "cx", "cy", "x1", "y1", "x2", "y2")

#: Attributes whose percentages refer to the width of the viewport.
_ACROSS = ("x", "width", "rx", "cx", "x1", "x2")

#: Sides of the viewport of a picture without a size, user units.
_VIEWPORT = (1000.0, 1000.0)

#: Attributes of an element that shows its content in a viewport.
_FRAME = ("viewBox", "preserveAspectRatio", "width", "height", "x", "y")

#: Share of the free space of a viewport before its content, by the words of preserveAspectRatio.
_SHARES = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}

_XLINK = "{http://www.w3.org/1999/xlink}href"

#: Elements that other elements refer to, and that are never drawn themselves.
_DEFINITIONS = ("symbol", "mask", "marker")

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
_LENGTH = re.compile(rf"\s*({_NUMBER})\s*(%|[a-z]*)\s*", re.IGNORECASE)
_STYLE_LENGTH = re.compile(rf"(:\s*)({_NUMBER})(mm|cm|in|q)(?=\s*(?:[;}}]|$))", re.IGNORECASE)


def svg_document(path: Path) -> io.BytesIO:
    """Read a picture; return the document for svgelements.

    In the document, lengths are numbers of user units, the unit of the picture is the user space of the outermost
    element times its scale, nested pictures and used symbols are groups, and definitions are in ``<defs>``. A picture
    of size 0 is empty.

    Raises
    ------
    ParseError
        If the file is no XML.
    ShapeError
        If the outermost element is not ``<svg>``, or its width or height has an unknown unit.
    """
    with path.open("rb") as stream:
        document = parse(stream)
    root = document.getroot()
    if _name(root) != "svg":
        raise ShapeError(f"source: {path} is no SVG picture: its outermost element is <{root.tag}>, not <svg>")
    _hide_definitions(root, inside=False)
    texts = [_property(root, name) for name in ("width", "height")]
    per_millimetre = PER_MILLIMETRE
    scale: tuple[float, float] | None
    if (box := _viewbox(root)) is not None:
        viewport = box[2:]
        scale = _scale(root, path, viewport)
    else:
        width, height = (
            side if (length := _user_units(text, side, PER_MILLIMETRE)) is None else length
            for text, side in zip(texts, _VIEWPORT, strict=True)
        )
        viewport = (width, height)
        found = [_LENGTH.fullmatch(text) for text in texts]
        is_physical = any(match is not None and match[2].lower() in MILLIMETRES for match in found)
        scale = None if min(viewport) <= 0 else (1 / PER_MILLIMETRE,) * 2 if is_physical else (1.0, 1.0)
        if not any(texts):
            # Nothing relates a pixel to a millimetre, and each is a world unit.
            per_millimetre = 1.0
    if scale is None:
        for child in list(root):
            root.remove(child)
        scale = (1.0, 1.0)
    _without_frame(root, f"scale({scale[0]!r},{scale[1]!r})")
    targets = {element.get("id", ""): element for element in copy.deepcopy(root).iter()}
    for child in root:
        _convert(child, viewport, per_millimetre, targets, frozenset())
    return _written(document)


def _convert(
    element: Element,
    viewport: tuple[float, float],
    per_millimetre: float,
    targets: dict[str, Element],
    used: frozenset[str],
) -> None:
    """Convert the lengths of an element and below it to user units; nested pictures and used symbols become groups.

    `targets` are the unconverted elements by identifier. A symbol in `used` contains the element and is not drawn
    again.
    """

    def in_user_units(found: re.Match[str]) -> str:
        return found[1] + repr(float(found[2]) * MILLIMETRES[found[3].lower()] * per_millimetre)

    name = _name(element)
    for key in _LENGTHS:
        side = math.hypot(*viewport) / math.sqrt(2) if key == "r" else viewport[0 if key in _ACROSS else 1]
        if (length := _user_units(element.get(key, ""), side, per_millimetre)) is not None:
            element.set(key, repr(length))
    if (style := element.get("style")) is not None:
        element.set("style", _STYLE_LENGTH.sub(in_user_units, style))
    if name == "style" and element.text:
        element.text = _STYLE_LENGTH.sub(in_user_units, element.text)
    link = element.get("href", element.get(_XLINK, "")).removeprefix("#")
    if name == "use" and link in targets and _name(targets[link]) in ("symbol", "svg"):
        frame = copy.deepcopy(targets[link])
        frame.tag = frame.tag.replace("symbol", "svg")
        frame.attrib.update({key: element.attrib[key] for key in ("width", "height") if key in element.attrib})
        if link not in used:
            element.append(frame)
        element.tag = element.tag.replace("use", "g")
        _without_frame(element, f"translate({element.get('x', '0')},{element.get('y', '0')})")
        used |= {link}
    elif name == "svg":
        viewport = _as_group(element, viewport, per_millimetre)
    for child in element:
        _convert(child, viewport, per_millimetre, targets, used)


def _as_group(element: Element, viewport: tuple[float, float], per_millimetre: float) -> tuple[float, float]:
    """Make a nested picture a group; return the viewport of its content."""
    names, defaults = ("x", "y", "width", "height"), (0.0, 0.0, *viewport)
    lengths = [_user_units(_property(element, name), viewport[i % 2], per_millimetre) for i, name in enumerate(names)]
    x, y, *sides = [old if length is None else length for old, length in zip(defaults, lengths, strict=True)]
    box = _viewbox(element)
    lower, extent = (box[:2], box[2:]) if box else ((0.0, 0.0), (sides[0], sides[1]))
    if min(*sides, *extent) <= 0:
        for child in list(element):
            element.remove(child)
        extent, sides = (1.0, 1.0), [1.0, 1.0]
    scale = _by_aspect(element, sides[0] / extent[0], sides[1] / extent[1])
    words = (element.get("preserveAspectRatio", "").split() or ["xMidYMid"])[0]
    shares = [_SHARES.get(word, 0.5) for word in (words[1:4], words[5:8])]
    shift = [
        start + share * (side - size * factor) - first * factor
        for start, share, side, size, factor, first in zip((x, y), shares, sides, extent, scale, lower, strict=True)
    ]
    element.tag = element.tag.replace("svg}svg", "svg}g") if "}" in element.tag else "g"
    _without_frame(element, f"translate({shift[0]!r},{shift[1]!r}) scale({scale[0]!r},{scale[1]!r})")
    return extent


def _without_frame(element: Element, transform: str) -> None:
    """Remove the viewport of an element, and append to its transform."""
    for name in _FRAME:
        element.attrib.pop(name, None)
    kept = [entry for entry in element.get("style", "").split(";") if entry.partition(":")[0].strip() not in _LENGTHS]
    element.set("style", ";".join(kept))
    element.set("transform", f"{element.get('transform', '')} {transform}")


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


def _property(element: Element, name: str) -> str:
    """The text of a length in the style or the attributes of an element; empty without one."""
    for entry in element.get("style", "").split(";"):
        key, _, text = entry.partition(":")
        if key.strip() == name:
            return text
    return element.get(name, "")


def _viewbox(element: Element) -> tuple[float, float, float, float] | None:
    numbers = [float(number) for number in re.findall(_NUMBER, element.get("viewBox", ""), re.IGNORECASE)]
    return (numbers[0], numbers[1], numbers[2], numbers[3]) if len(numbers) == 4 else None


def _user_units(text: str, side: float, per_millimetre: float) -> float | None:
    """Convert a length to user units; `side` is 100 %. None without a length, and for units of fonts and windows."""
    found = _LENGTH.fullmatch(text)
    if found is None:
        return None
    units = {"%": side / 100, **PIXELS, **{unit: size * per_millimetre for unit, size in MILLIMETRES.items()}}
    factor = units.get(found[2].lower())
    return None if factor is None else float(found[1]) * factor


def _scale(root: Element, path: Path, viewbox: tuple[float, float]) -> tuple[float, float] | None:
    """World units per user unit along x and y; None for a picture of size 0, which shows nothing."""
    if min(viewbox) <= 0:
        return None
    scales = []
    for name, side in zip(("width", "height"), viewbox, strict=True):
        text = _property(root, name)
        found = _LENGTH.fullmatch(text)
        if found is None:
            scales.append(math.nan)  # The scale follows from the other side.
            continue
        amount, unit = float(found[1]), found[2].lower()
        if unit in RELATIVE:
            amount *= side / 100
        elif unit in PIXELS or unit in MILLIMETRES:
            amount *= {**PIXELS, **MILLIMETRES}[unit]
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
    return _by_aspect(root, x, y)


def _by_aspect(element: Element, x: float, y: float) -> tuple[float, float]:
    """The scales of a viewport along its axes by the attribute preserveAspectRatio."""
    align = element.get("preserveAspectRatio", "xMidYMid").split()
    if align[:1] == ["none"]:
        return x, y
    only = max(x, y) if align[1:] == ["slice"] else min(x, y)
    return only, only
