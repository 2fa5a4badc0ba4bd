"""Shader text for stored fields, and the buffers that it reads."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks

Language = Literal["wgsl", "glsl", "hlsl", "msl"]
LANGUAGES = ("wgsl", "glsl", "hlsl", "msl")

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


class Constant(NamedTuple):
    """A constant of a text, and the comment before it; `kind` is "f32", "i32", "vec3f" or "vec3i"."""

    name: str
    kind: str
    value: Any
    comment: str

    def __str__(self) -> str:
        return f"// {self.comment}\nconst {self.name}: {self.kind} = {_literal(self.kind, self.value)};\n"


def _literal(kind: str, value: Any) -> str:
    """Write a value in WGSL."""
    number = int if "i" in kind else _float32
    if kind.startswith("vec"):
        return f"{kind}({', '.join(str(number(one)) for one in value)})"
    return str(number(value))


def _float32(value: Any) -> float:
    return float(np.float32(value))


def _place(prefix: str, shape: Any, lower: Any, spacing: Any) -> list[Constant]:
    """Make the constants that describe the grid of a field."""
    return [
        Constant(f"{prefix}_SHAPE", "vec3i", shape, "Voxels along x, y and z."),
        Constant(f"{prefix}_LOWER", "vec3f", lower, "Lower corner of the box, world units."),
        Constant(f"{prefix}_SPACING", "vec3f", spacing, "Size of a voxel, world units."),
    ]


def _text(library: str, header: str, definitions: Iterable[object], language: object) -> str:
    """Write the functions of a library in a language, after a header and the definitions that they read."""
    chosen: str = checks.choice("language", language, LANGUAGES)
    comment = "".join(f"// {line}\n" for line in header.splitlines())
    return _core.shader_library(library, "\n".join([comment, *map(str, definitions)]), chosen)


def texture(name: str, binding: int, texels: NDArray[Any]) -> ShaderBuffer:
    """Make a texture of texels [x, y, z] or [x, y]."""
    return ShaderBuffer(name, binding, _FORMATS[str(texels.dtype)], texels.shape, texels.T)


def volume_text(volume: Any, language: object) -> str:
    """See :meth:`Volume.shader`."""
    constants = _place("FIELD", volume.resolution, volume.bounds[0], volume.spacing)
    constants.append(Constant("FIELD_SCALE", "f32", volume._scale, "Distance of a texel of value 1."))
    header = _header(_FORMATS[str(volume._texels.dtype)], "field_distance")
    return _text("volume", header, constants, language)


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
        Constant("SPARSE_COUNTS", "vec3i", arrays["index"].shape, "Bricks along x, y and z."),
        Constant("SPARSE_NODE_STEP", "vec3f", step / step.max(), "Steps between nodes, in units of the longest."),
        Constant("SPARSE_LONGEST_STEP", "f32", step.max(), "The longest step, world units."),
        Constant("SPARSE_FLOOR", "f32", floor, "Smallest distance in an empty brick, world units."),
        Constant("SPARSE_SCALE", "f32", field.scale, "Distance of a texel of value 1."),
        Constant("SPARSE_ROW", "i32", SPARSE_ROW, "Texels in a row of sparse_bricks."),
    ]
    header = _header(_FORMATS[str(arrays["bricks"].dtype)], "sparse_distance")
    return _text("sparse", header, constants, language)


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
    lowers, spacings = [level.bounds[0] for level in levels], [level.spacing for level in levels]
    definitions: list[object] = [
        Constant("NESTED_LEVELS", "i32", len(levels), "Number of levels."),
        Constant("NESTED_SHAPE", "vec3i", levels[0].resolution, "Voxels of each level along x, y and z."),
        _of_level("nested_lower", "Lower corner of the box of a level, world units.", lowers),
        _of_level("nested_spacing", "Size of a voxel of a level, world units.", spacings),
    ]
    return _text("nested", _header("r32float", "nested_distance"), definitions, language)


def _of_level(name: str, comment: str, vectors: list[Any]) -> str:
    """Write a WGSL function that returns the vector of a level."""
    *first, last = (f"return {_literal('vec3f', vector)};" for vector in vectors)
    cases = "".join(f"    if level == {i} {{\n        {case}\n    }}\n" for i, case in enumerate(first))
    return f"// {comment}\nfn {name}(level: i32) -> vec3f {{\n{cases}    {last}\n}}\n"


def nested_buffers(levels: Any) -> ShaderBuffers:
    """See :meth:`NestedField.shader_buffers`."""
    joined = np.concatenate([level.distances for level in levels], axis=2)
    return ShaderBuffers([texture("nested_texels", 0, joined)])


def quadric_text(language: object) -> str:
    """See :meth:`Quadric.shader`."""
    header = "fieldbake quadrics: load_quadric(i), intersect_quadric(quadric, origin, direction, t_min)."
    return _text("quadrics", header, [], language)
