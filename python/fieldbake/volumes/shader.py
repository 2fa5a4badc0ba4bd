"""Shader text for stored fields, and the buffers that it reads."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from . import shader_sources as sources

Language = Literal["wgsl", "glsl", "hlsl", "msl"]

#: Texels in a row of the texture of a sparse volume's samples.
SPARSE_ROW = 4096
#: Formats of textures by the type of their texels.
_FORMATS = {"float32": "r32float", "float16": "r16float", "int16": "r16snorm", "int8": "r8snorm", "uint32": "r32uint"}


class ShaderBuffer(NamedTuple):
    """A texture that a shader text reads.

    Attributes
    ----------
    name : str
        Name of the variable in the text.
    binding : int
        Its binding in group 0.
    format : str
        Format of the texels, in the words of WebGPU.
    size : tuple of int
        Width and height, or width, height and depth.
    array : array
        The texels, x along the width; row by row, slice by slice in memory.
    """

    name: str
    binding: int
    format: str
    size: tuple[int, ...]
    array: NDArray[Any]

    def to_bytes(self) -> bytes:
        """The texels in the order of an upload: little-endian, rows without padding."""
        return np.ascontiguousarray(self.array, self.array.dtype.newbyteorder("<")).tobytes()


class ShaderBuffers(tuple[ShaderBuffer, ...]):
    """All textures of a shader text, in the order of their bindings; ``print`` shows them as a table."""

    __slots__ = ()

    def __str__(self) -> str:
        rows = [("binding", "name", "format", "size", "bytes")]
        rows += [
            (str(one.binding), one.name, one.format, " x ".join(map(str, one.size)), f"{one.array.nbytes:,}")
            for one in self
        ]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        return "\n".join("  ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)) for row in rows)


class TextureSlot(NamedTuple):
    """A texture that a text declares: its name, binding, dimensions and kind of texels (float, float4 or uint)."""

    name: str
    binding: int
    dimensions: int
    texel: str


class Constant(NamedTuple):
    """A constant of a text; `kind` is "float", "int", "vec3" or "ivec3"."""

    name: str
    kind: str
    value: Any
    comment: str = ""


#: Names of the dialect's types and functions in HLSL and MSL.
_RENAMED = {
    "hlsl": {"mix": "lerp", "ivec": "int", "vec": "float"},
    "msl": {"ivec": "int", "vec": "float"},
}
_WGSL_TYPES = {"float": "f32", "int": "i32", "vec3": "vec3f", "ivec3": "vec3i"}


def dialect_text(
    name: str,
    wgsl: str,
    dialect: str,
    constants: Iterable[Constant],
    slots: Iterable[TextureSlot],
    language: object,
    header: str,
) -> str:
    """A text in some language, from its WGSL or its dialect; in MSL the functions are members of the struct `name`."""
    chosen: str = checks.choice("language", language, ("wgsl", "glsl", "hlsl", "msl"))
    comment = "".join(f"// {line}\n" for line in header.splitlines())
    if chosen == "wgsl":
        lines = [_wgsl_constant(one) for one in constants]
        return comment + "\n" + "\n".join(lines) + wgsl
    lines = [_constant(one, chosen) for one in constants]
    body = "\n".join(lines) + "\n" + dialect
    if chosen == "glsl":
        kinds = {"float": "sampler", "float4": "sampler", "uint": "usampler"}
        declared = [f"uniform highp {kinds[slot.texel]}{slot.dimensions}D {slot.name};" for slot in slots]
        precision = ["precision highp float;", "precision highp int;"]
        return "\n".join(["#version 300 es", *precision, "", comment + "\n".join(declared), body])
    for old, new in _RENAMED[chosen].items():
        body = re.sub(rf"\b{old}(?=[234(])", new, body)
    if chosen == "hlsl":
        declared = [
            f"Texture{slot.dimensions}D<{slot.texel}> {slot.name} : register(t{slot.binding});" for slot in slots
        ]
        for slot in slots:
            load = rf"{slot.name}.Load(int{slot.dimensions + 1}(\1, 0))"
            body = re.sub(rf"texelFetch\({slot.name}, (\w+), 0\)", load, body)
        return comment + "\n".join(declared) + "\n" + body
    # Metal has no textures outside of functions, so they are members of a struct.
    outside, inside = _split_types(body)
    for slot in slots:
        load = rf"{slot.name}.read(uint{slot.dimensions}(\1), 0)"
        inside = re.sub(rf"texelFetch\({slot.name}, (\w+), 0\)", load, inside)
    scalars = {"float": "float", "float4": "float", "uint": "uint"}
    members = [f"texture{slot.dimensions}d<{scalars[slot.texel]}> {slot.name};" for slot in slots]
    inside = "\n".join(members) + "\n" + re.sub(r"^(\w+ \w+\([^)]*\)) \{", r"\1 const {", inside, flags=re.M)
    indented = "\n".join(f"    {line}" if line else "" for line in inside.strip().splitlines())
    start = "#include <metal_stdlib>\nusing namespace metal;\n\n"
    usage = f"// Fill the textures of the struct {name}; its members are the functions.\n"
    return f"{start}{comment}{usage}{outside}\nstruct {name} {{\n{indented}\n}};\n"


def _split_types(body: str) -> tuple[str, str]:
    """Constants and structs, which stay outside of a struct in MSL, and functions."""
    first = re.search(r"^(//[^\n]*\n)*(\w+) \w+\([^)]*\) \{", body, flags=re.M)
    at = len(body) if first is None else first.start()
    return body[:at], body[at:]


def _numbers(one: Constant) -> list[str]:
    values = one.value if one.kind.endswith("3") else [one.value]
    if one.kind in ("int", "ivec3"):
        return [str(int(value)) for value in values]
    return [repr(float(np.float32(value))) for value in values]


def _wgsl_constant(one: Constant) -> str:
    kind = _WGSL_TYPES[one.kind]
    value = f"{kind}({', '.join(_numbers(one))})" if one.kind.endswith("3") else _numbers(one)[0]
    return _commented(one, f"const {one.name}: {kind} = {value};")


def _constant(one: Constant, language: str) -> str:
    value = f"{one.kind}({', '.join(_numbers(one))})" if one.kind.endswith("3") else _numbers(one)[0]
    qualifier = {"glsl": "const", "hlsl": "static const", "msl": "constant"}[language]
    return _commented(one, f"{qualifier} {one.kind} {one.name} = {value};")


def _commented(one: Constant, line: str) -> str:
    return f"// {one.comment}\n{line}" if one.comment else line


def _place(prefix: str, shape: Any, lower: Any, spacing: Any) -> list[Constant]:
    """The grid of a field as constants."""
    return [
        Constant(f"{prefix}_SHAPE", "ivec3", shape, "Voxels along x, y and z."),
        Constant(f"{prefix}_LOWER", "vec3", lower, "Lower corner of the box, world units."),
        Constant(f"{prefix}_SPACING", "vec3", spacing, "Size of a voxel, world units."),
    ]


def texture(name: str, binding: int, texels: NDArray[Any]) -> ShaderBuffer:
    """A texture of texels [x, y, z] or [x, y]."""
    return ShaderBuffer(name, binding, _FORMATS[str(texels.dtype)], texels.shape, texels.T)


def volume_text(volume: Any, language: object) -> str:
    """See :meth:`Volume.shader`."""
    constants = _place("FIELD", volume.resolution, volume.bounds[0], volume.spacing)
    constants.append(Constant("FIELD_SCALE", "float", volume._scale, "Distance of a texel of value 1."))
    slots = [TextureSlot("field_texels", 0, 3, "float")]
    header = _header(_FORMATS[str(volume._texels.dtype)], "field_distance")
    return dialect_text("Field", sources.VOLUME_WGSL, sources.VOLUME_C, constants, slots, language, header)


def volume_buffers(volume: Any) -> ShaderBuffers:
    """See :meth:`Volume.shader_buffers`."""
    return ShaderBuffers([texture("field_texels", 0, volume._texels)])


def _header(form: str, name: str) -> str:
    return (
        f"A fieldbake field as a texture of the format {form}: {name}(p) is the signed distance at the world\n"
        "position p, negative inside."
    )


def sparse_text(volume: Any, language: object) -> str:
    """See :meth:`SparseVolume.shader`."""
    field = volume._core_field
    arrays = field.arrays()
    step = 7 * volume.spacing
    floor = max(field.band - 0.5 * float(np.linalg.norm(volume.spacing)), 0.0)
    constants = _place("SPARSE", volume.resolution, volume.bounds[0], volume.spacing)
    constants += [
        Constant("SPARSE_COUNTS", "ivec3", arrays["index"].shape, "Bricks along x, y and z."),
        Constant("SPARSE_NODE_STEP", "vec3", step / step.max(), "Steps between nodes, in units of the longest."),
        Constant("SPARSE_LONGEST_STEP", "float", step.max(), "The longest step, world units."),
        Constant("SPARSE_FLOOR", "float", floor, "Smallest distance in an empty brick, world units."),
        Constant("SPARSE_SCALE", "float", field.scale, "Distance of a texel of value 1."),
        Constant("SPARSE_ROW", "int", SPARSE_ROW),
    ]
    slots = [
        TextureSlot("sparse_index", 0, 3, "uint"),
        TextureSlot("sparse_nodes", 1, 3, "float"),
        TextureSlot("sparse_bricks", 2, 2, "float"),
    ]
    header = _header(_FORMATS[str(arrays["bricks"].dtype)], "sparse_distance")
    return dialect_text("SparseField", sources.SPARSE_WGSL, sources.SPARSE_C, constants, slots, language, header)


def sparse_buffers(volume: Any) -> ShaderBuffers:
    """See :meth:`SparseVolume.shader_buffers`."""
    arrays = volume._core_field.arrays()
    longest = 7 * float(volume.spacing.max())
    samples = np.ascontiguousarray(arrays["bricks"].transpose(0, 3, 2, 1)).reshape(-1)
    rows = max(-(-len(samples) // SPARSE_ROW), 1)
    padded = np.zeros(rows * SPARSE_ROW, samples.dtype)
    padded[: len(samples)] = samples
    nodes = (arrays["nodes"].astype(np.float64) / longest).astype(np.float32)
    return ShaderBuffers(
        [
            texture("sparse_index", 0, arrays["index"]),
            texture("sparse_nodes", 1, nodes),
            texture("sparse_bricks", 2, padded.reshape(rows, SPARSE_ROW).T),
        ]
    )


def nested_text(levels: Any, language: object) -> str:
    """See :meth:`NestedField.shader`; `levels` are joined, finest first."""
    constants = [
        Constant("NESTED_LEVELS", "int", len(levels)),
        Constant("NESTED_SHAPE", "ivec3", levels[0].resolution, "Voxels of each level along x, y and z."),
    ]
    lowers, spacings = [level.bounds[0] for level in levels], [level.spacing for level in levels]
    about = "Lower corner of the box of a level, world units.", "Size of a voxel of a level, world units."
    wgsl, dialect = "\n", "\n"
    for name, comment, vectors in zip(("nested_lower", "nested_spacing"), about, (lowers, spacings), strict=True):
        words = [", ".join(_numbers(Constant("", "vec3", value))) for value in vectors]
        wgsl += f"// {comment}\nfn {name}(level: i32) -> vec3f {{\n"
        dialect += f"// {comment}\nvec3 {name}(int level) {{\n"
        for i, word in enumerate(words[:-1]):
            wgsl += f"    if level == {i} {{\n        return vec3f({word});\n    }}\n"
            dialect += f"    if (level == {i}) {{\n        return vec3({word});\n    }}\n"
        wgsl += f"    return vec3f({words[-1]});\n}}\n\n"
        dialect += f"    return vec3({words[-1]});\n}}\n\n"
    slots = [TextureSlot("nested_texels", 0, 3, "float")]
    texts = wgsl + sources.NESTED_WGSL, dialect + sources.NESTED_C
    return dialect_text("NestedField", *texts, constants, slots, language, _header("r32float", "nested_distance"))


def nested_buffers(levels: Any) -> ShaderBuffers:
    """See :meth:`NestedField.shader_buffers`."""
    joined = np.concatenate([level.distances for level in levels], axis=2)
    return ShaderBuffers([texture("nested_texels", 0, joined)])
