"""Shader text of a shape as one function, to paste into a fragment shader.

The text of a compute shader has the functions of all leaves, buffers and an entry point. This module turns the
parameters into an array of constants, and keeps only the definitions that the function of the shape needs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ShapeError

#: The function that evaluates the shape.
FUNCTION = "distance_to_shape"

#: First lines of each language.
_HEADS = {
    "wgsl": "",
    "glsl": "#version 300 es\nprecision highp float;\nprecision highp int;\n\n",
    "hlsl": "",
    "msl": "#include <metal_stdlib>\n#include <simd/simd.h>\n\nusing metal::uint;\n\n",
}
#: The array of parameters; WGSL allows a variable index into variables only.
_ARRAYS = {
    "wgsl": "var<private> numbers: array<f32, {count}> = array<f32, {count}>({values});\n\n",
    "glsl": "const float numbers[{count}] = float[{count}]({values});\n\n",
    "hlsl": "static const float numbers[{count}] = {{{values}}};\n\n",
    "msl": "constant float numbers[{count}] = {{{values}}};\n\n",
}
#: Replacements of the accesses to the buffer of parameters; HLSL counts its bytes.
_ACCESSES: dict[str, tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...]] = {
    "wgsl": (),
    "glsl": ((r"\b_group_0_binding_0_cs\[", "numbers["),),
    "hlsl": (
        (r"\basfloat\(numbers\.Load\((.+?)\*4\)\)", r"numbers[\1]"),
        (r"\basfloat\(numbers\.Load\((\d+)\)\)", lambda found: f"numbers[{int(found[1]) // 4}]"),
    ),
    "msl": (
        (r",?\s*device type_\w+ const& numbers\b", ""),
        (r",?\s*constant _mslBufferSizes& _buffer_sizes\b", ""),
        (r", numbers, _buffer_sizes\)", ")"),
    ),
}
#: The name that a definition gives: a structure, a type, a constant, or a function.
_NAMES = (
    r"(?:^|\n)struct (\w+)",
    r"(?:^|\n)typedef [^\n(]*?(\w+)(?:\[\w+\])?;",
    r"(?:^|\n)(?:static |constant |const )+(?:\w+ )?(\w+)(?:\[\w+\])?(?:: \w+)? =",
    r"(?:^|\n)(?:fn |[\w:\[\]]+ )(\w+)\s*\(",
)


def shader_function(text: str, numbers: NDArray[np.float32], language: str, name: str) -> str:
    """Convert the compute shader of a shape to the text of one function.

    Parameters
    ----------
    text : str
        Text of a compute shader that evaluates the shape.
    numbers : (n,) float32
        Parameters of the shape, the contents of the buffer of the shader.
    language : str
        Language of the text: "wgsl", "glsl", "hlsl" or "msl".
    name : str
        Name of the function. A name other than ``distance_to_shape`` is also put before the names of all other
        definitions, so that the texts of several shapes can be pasted into one shader.

    Raises
    ------
    ShapeError
        For a name that is no identifier.
    """
    if not re.fullmatch(r"[a-z]\w*", checks.text("name", name), re.ASCII | re.IGNORECASE):
        raise ShapeError(f"name: must be a name of letters, digits and underscores, got {checks.describe(name)}")
    for pattern, access in _ACCESSES[language]:
        text = re.sub(pattern, access, text)
    chunks = {found: chunk for chunk in _definitions(text) if (found := _name(chunk)) is not None}
    words = {defined: set(re.findall(r"\w+", chunk)) for defined, chunk in chunks.items()}
    needed, pending = {FUNCTION}, [FUNCTION]
    while pending:
        following = (words[pending.pop()] & chunks.keys()) - needed
        needed |= following
        pending += following
    body = "\n".join(chunk for defined, chunk in chunks.items() if defined in needed)
    values = ", ".join(_literal(float(number)) for number in numbers) or "0.0"
    array = _ARRAYS[language].format(count=max(len(numbers), 1), values=values)
    if name != FUNCTION:
        others = "|".join(needed - {FUNCTION} | {"numbers"})
        # Members of structures and words of comments keep their form.
        body, array = (
            re.sub(rf"(//.*)|(?<!\.)\b({others})\b", lambda found: found[1] or f"{name}_{found[2]}", part)
            for part in (body, array)
        )
        body = re.sub(rf"\b{FUNCTION}\b", name, body)
    comment = f"// The signed distance to a shape: {name}(p) at the world position p, negative inside.\n\n"
    return _HEADS[language] + comment + array + body


def _definitions(text: str) -> Iterator[str]:
    """Split a text into its definitions, each with the comment directly before it."""
    chunk: list[str] = []
    depth = 0
    for line in text.splitlines():
        if not line and depth == 0:
            chunk = []
            continue
        chunk.append(line)
        depth += sum(line.count(mark) for mark in "{(") - sum(line.count(mark) for mark in "})")
        if depth == 0 and not line.startswith(("//", "@", "[")) and line.rstrip().endswith((";", "}")):
            yield "\n".join(chunk) + "\n"
            chunk = []


def _name(chunk: str) -> str | None:
    found = (re.search(pattern, chunk) for pattern in _NAMES)
    return next((match[1] for match in found if match is not None), None)


def _literal(number: float) -> str:
    """Write a number for every language: the shortest decimal that rounds to this float32, with a point."""
    text = np.format_float_scientific(np.float32(number), unique=True, trim="0")
    short = np.format_float_positional(np.float32(number), unique=True, trim="0")
    return short if len(short) <= len(text) else text
