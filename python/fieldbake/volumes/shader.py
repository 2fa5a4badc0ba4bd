"""Shader text for stored fields, and the buffers that it reads."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.languages import LANGUAGES

#: Texels in a row of the texture of a sparse volume's samples.
SPARSE_ROW = 4096
#: Formats of textures by the type of their texels. All are in the core of WebGPU and of WebGL 2. r16snorm is not, so
#: the texts read 16-bit integers as integers.
_FORMATS = {"float32": "r32float", "float16": "r16float", "int16": "r16sint", "int8": "r8snorm", "uint32": "r32uint"}
#: Distance of the texel value 1, in units of the scale of the encoding.
_UNITS = {"int16": 1 / 32767}


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
    """A constant of a text, and the comment before it; `kind` is "bool", "f32", "i32", "vec3f" or "vec3i"."""

    name: str
    kind: str
    value: Any
    comment: str

    def __str__(self) -> str:
        return f"// {self.comment}\nconst {self.name}: {self.kind} = {_literal(self.kind, self.value)};\n"


def _literal(kind: str, value: Any) -> str:
    """Write a value in WGSL."""
    if kind == "bool":
        return "true" if value else "false"
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


def _outside(prefix: str, volume: Any, first: Any, step: Any, count: Any) -> list[Constant]:
    """Make the constants of the bound outside the box, from samples with the first one at `first`."""
    inner_lower, inner_upper = volume.inner_bounds
    last = np.asarray(count) - 1
    surrounds = bool((inner_lower >= first).all() and (inner_upper <= first + step * last).all())
    return [
        Constant(f"{prefix}_INNER_LOWER", "vec3f", inner_lower, "Lower corner of the box of the surface, world units."),
        Constant(f"{prefix}_INNER_UPPER", "vec3f", inner_upper, "Upper corner of the box of the surface, world units."),
        Constant(f"{prefix}_SURROUNDS_SURFACE", "bool", surrounds, "Whether the samples surround that box."),
        Constant(f"{prefix}_BOUND_FIRST", "vec3f", first, "Position of the first sample of the bound, world units."),
        Constant(f"{prefix}_BOUND_STEP", "vec3f", step, "Steps between the samples of the bound, world units."),
        Constant(f"{prefix}_BOUND_LAST", "vec3i", last, "Index of the last sample of the bound."),
    ]


def _samples(name: str, binding: int, kind: str, texels: NDArray[Any], comment: str) -> str:
    """Declare the texture of samples: floats, or the integers of 16 bits."""
    number = "i32" if texels.dtype == np.int16 else "f32"
    return f"// {comment}\n@group(0) @binding({binding}) var {name}: {kind}<{number}>;\n"


def _scale(scale: float, texels: NDArray[Any]) -> float:
    """Distance of the texel value 1."""
    return scale * _UNITS.get(str(texels.dtype), 1.0)


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
    texels = volume._texels
    constants.append(Constant("FIELD_SCALE", "f32", _scale(volume._scale, texels), "Distance of a texel of value 1."))
    first = volume.bounds[0] + volume.spacing / 2
    constants += _outside("FIELD", volume, first, volume.spacing, volume.resolution)
    about = "The samples as a 3D texture, x along its width, as .ktx2 and .dds files hold them, read without a filter."
    declared = _samples("field_texels", 0, "texture_3d", texels, about)
    return _text("volume", _header(_FORMATS[str(texels.dtype)], "field_distance"), [*constants, declared], language)


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
    texels = arrays["bricks"]
    step = 7 * volume.spacing
    floor = max(field.band - 0.5 * float(np.linalg.norm(volume.spacing)), 0.0)
    constants = _place("SPARSE", volume.resolution, volume.bounds[0], volume.spacing)
    constants += [
        Constant("SPARSE_COUNTS", "vec3i", arrays["index"].shape, "Bricks along x, y and z."),
        Constant("SPARSE_LONGEST_STEP", "f32", step.max(), "The longest step between nodes, world units."),
        Constant("SPARSE_FLOOR", "f32", floor, "Smallest distance in an empty brick, world units."),
        Constant("SPARSE_SCALE", "f32", _scale(field.scale, texels), "Distance of a texel of value 1."),
        Constant("SPARSE_ROW", "i32", SPARSE_ROW, "Texels in a row of sparse_bricks."),
    ]
    # Node 0 lies at voxel -1.
    constants += _outside("SPARSE", volume, volume.bounds[0] - volume.spacing / 2, step, arrays["nodes"].shape)
    about = "The samples: 512 texels per brick, x fastest, in rows of SPARSE_ROW texels."
    declared = _samples("sparse_bricks", 2, "texture_2d", texels, about)
    return _text("sparse", _header(_FORMATS[str(texels.dtype)], "sparse_distance"), [*constants, declared], language)


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
        *_outside("NESTED", levels[-1], lowers[-1] + spacings[-1] / 2, spacings[-1], levels[-1].resolution),
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
