"""A shape as Python text: the calls of this package that make an equal shape."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence

Numbers = Sequence[float]

#: Depth of operators and modifiers below which the text has three dots.
MOST_DEPTH = 100

#: Symbols of the operators.
OPERATORS = {"union": "|", "inter": "&", "diff": "-", "xor": "^"}

#: Names of the operators as methods, for smooth and chamfered joints.
METHODS = {"union": "union", "inter": "intersection", "diff": "difference", "xor": "xor"}


def _number(x: float) -> str:
    return f"{x:.10g}"


def _vector(numbers: Numbers) -> str:
    return "(" + ", ".join(map(_number, numbers)) + ")"


def _call(name: str, *arguments: str | float) -> str:
    return f"{name}({', '.join(x if isinstance(x, str) else _number(x) for x in arguments)})"


def _torus(name: str, outer: float, tube: float, *rest: float) -> str:
    # The language has outer diameters, Python has the radius of the circle in the middle of the tube.
    return _call(name, (outer - tube) / 2, tube / 2, *rest)


def _axis(numbers: Numbers) -> str:
    for i, letter in enumerate("xyz"):
        if list(numbers) == [float(i == j) for j in range(3)]:
            return f'"{letter}"'
    return _vector(numbers)


def _plane(x: float, y: float, z: float, offset: float = 0.0) -> str:
    return _call("plane", _axis((x, y, z)), *([offset] if offset else []))


def _slab(thickness: float, x: float = 0.0, y: float = 0.0, z: float = 1.0) -> str:
    return _call("slab", thickness, *([_axis((x, y, z))] if (x, y, z) != (0, 0, 1) else []))


def _cone(low: float, high: float, height: float) -> str:
    return _call("truncated_cone", low / 2, high / 2, height)


def _thread(profile: str) -> Callable[..., str]:
    def text(diameter: float, pitch: float, offset: float) -> str:
        options = [] if profile == "iso" else [f'profile="{profile}"']
        if offset:
            options.append(f"clearance={_number(abs(offset))}")
        if offset > 0:
            options.append("internal=True")
        return _call("thread", diameter, pitch, "None", *options)

    return text


#: Python text of each primitive from the numbers of the language.
PRIMITIVES: dict[str, Callable[..., str]] = {
    "sphere": lambda d: _call("sphere", d / 2),
    "ellipsoid": lambda x, y, z: _call("ellipsoid", _vector((x / 2, y / 2, z / 2))),
    "cube": lambda s: _call("box", s),
    "box": lambda x, y, z: _call("box", _vector((x, y, z))),
    "rounded-box": lambda x, y, z, r: _call("rounded_box", _vector((x, y, z)), r),
    "box-frame": lambda x, y, z, t: _call("box_frame", _vector((x, y, z)), t),
    "torus": lambda outer, tube: _torus("torus", outer, tube),
    "capped-torus": lambda outer, tube, degrees: _torus("capped_torus", outer, tube, degrees),
    "cylinder": lambda d, h: _call("cylinder", d / 2, h),
    "rounded-cylinder": lambda d, h, r: _call("rounded_cylinder", d / 2, h, r),
    "capsule": lambda d, h: _call("capsule", d / 2, h),
    "cone": lambda d, h: _call("cone", d / 2, h),
    "coninder": _cone,
    "rounded-cone": lambda low, high, h: _call("rounded_cone", low / 2, high / 2, h),
    "plane": _plane,
    "slab": _slab,
    "pyramid": lambda base, h: _call("pyramid", base, h),
    "octahedron": lambda d: _call("octahedron", d / 2),
    "hex-prism": lambda d, h: _call("hex_prism", d / 2, h),
    "gyroid": lambda cell, t: _call("gyroid", cell, t),
    "schwarz-p": lambda cell, t: _call("schwarz_p", cell, t),
    "diamond": lambda cell, t: _call("diamond", cell, t),
    "iwp": lambda cell, t: _call("iwp", cell, t),
    "iso-thread": _thread("iso"),
    "trapezoidal-thread": _thread("trapezoidal"),
    "circle": lambda d: _call("circle", d / 2),
    "rectangle": lambda w, h: _call("rectangle", _vector((w, h))),
    "polygon": lambda *xy: _call("polygon", "[" + ", ".join(map(_vector, zip(xy[::2], xy[1::2], strict=True))) + "]"),
}


def _rotation(x: float, y: float, z: float, w: float) -> str:
    sine = math.sqrt(x * x + y * y + z * z)
    axis = (x / sine, y / sine, z / sine) if sine > 0 else (0.0, 0.0, 1.0)
    return _call("rotate", _axis(axis), math.degrees(2 * math.atan2(sine, w)))


def _move(axis: int) -> Callable[..., str]:
    return lambda t: _call("translate", _vector([t if i == axis else 0.0 for i in range(3)]))


#: Method call of each modifier from the numbers of the language.
MODIFIERS: dict[str, Callable[..., str]] = {
    "move": lambda *t: _call("translate", _vector(t)),
    "move-x": _move(0),
    "move-y": _move(1),
    "move-z": _move(2),
    "rotate": _rotation,
    "rotate-x": lambda degrees: _call("rotate", '"x"', degrees),
    "rotate-y": lambda degrees: _call("rotate", '"y"', degrees),
    "rotate-z": lambda degrees: _call("rotate", '"z"', degrees),
    "scale": lambda s: _call("scale", s),
    "flate": lambda r: _call("offset", r),
    "shell": lambda t: _call("shell", t),
    "times": lambda factor: _call("times", factor),
    "align": lambda *anchor: _call("align", _vector(anchor)),
    "elongate": lambda *size: _call("elongate", _vector(size)),
    "mirror": lambda *axis: _call("mirror", _axis(axis)),
    "reflect": lambda *axis: _call("reflect", _axis(axis)),
    "repeat": lambda *n: _call("repeat", _vector(n[:3]), _vector(n[3:])),
    "twist": lambda degrees: _call("twist", f"per_unit_deg={_number(degrees)}"),
    "bend": lambda degrees: _call("bend", f"per_unit_deg={_number(degrees)}"),
    "paint": lambda *color: _call("paint", _vector(color)),
    "paint-over": lambda *color: _call("paint", _vector(color), "over=True"),
}


def python_text(expression: str) -> str:
    """Translate an s-expression of :meth:`Shape.to_sexpr` to Python, with ``...`` below `MOST_DEPTH`."""
    words = iter(re.findall(r"[()]|[^\s()]+", expression))
    next(words)
    return _form(words)[0]


def _form(words: Iterator[str], depth: int = 0) -> tuple[str, bool]:
    """Translate the form after its parenthesis: the text, and whether a method call needs parentheses around it."""
    if depth > MOST_DEPTH:
        opened = 1
        while opened:
            opened += {"(": 1, ")": -1}.get(next(words), 0)
        return "...", True
    name = next(words)
    kind = next(words) if name in ("blend", "chamfer") else ""
    numbers: list[float] = []
    parts: list[tuple[str, bool]] = []
    for word in words:
        if word == ")":
            break
        if word == "(":
            parts.append(_form(words, depth + 1))
        else:
            numbers.append(float(word))
    closed = [f"({text})" if loose else text for text, loose in parts]
    if name in PRIMITIVES:
        return PRIMITIVES[name](*numbers), False
    if name == "polygons":
        loops = ", ".join(text.removeprefix("polygon(").removesuffix(")") for text in closed)
        return _call("polygon", f"[{loops}]"), False
    if name == "extrude" and len(numbers) > 1:
        height, taper, low, high = numbers
        return _call(name, closed[0], height, f"taper_deg={_number(taper)}", f"chamfer={_vector((low, high))}"), False
    if name in ("extrude", "revolve"):
        return _call(name, closed[0], *([numbers[0]] if name == "extrude" or numbers[0] else [])), False
    if name in OPERATORS:
        # The first operand of equal operators needs no parentheses.
        return f" {OPERATORS[name]} ".join(closed), len(closed) > 1
    if kind:
        width = f"{'k' if name == 'blend' else 'chamfer'}={_number(numbers[0])}"
        return f"{closed[0]}.{_call(METHODS[kind], *closed[1:], width)}", False
    if name == "not":
        return f"~{closed[0]}", True
    if name in ("stencil", "mask"):
        return f"{closed[0]}.{_call(name, closed[1], _vector(numbers))}", False
    return f"{closed[0]}.{MODIFIERS[name](*numbers)}", False
