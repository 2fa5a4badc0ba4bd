"""Input of the shader of a view: a record of 32 numbers for each instance, and the samples of all as 32-bit words.

`shaders/viewer/table.wgsl` draws the layout of a record, which is its texels 14 to 21.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import encodings
from ..base.errors import SceneError
from ..meshes.mesh import Mesh
from ..shapes.quadric import Quadric
from ..shapes.shape import Shape
from ..volumes.quantized import QuantizedVolume
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume

#: Numbers of a record, and the places of some of them.
RECORD = 32
KIND, ENCODING, SCALE, FIRST, VOXELS, EMPTY, BLOCKS, MASKS = 0, 1, 2, 3, 4, 7, 8, 11
LOWER, FLAGS, UPPER, OBJECT, UNIT, BIAS, STRUCTURE, INVERSE_LIPSCHITZ = 12, 15, 16, 19, 20, 21, 22, 23
INDEX, NODES, FLOOR, LONGEST_STEP, NODE_STEP, ERRORS = 24, 25, 26, 27, 28, 31

#: Most words of a view: their indices are float32.
MOST_WORDS = 1 << 24

#: Most faces of a mesh whose triangles a view has beside its field: about 250 kB of a page.
MOST_FACES = 20_000

#: Kinds of fields.
DENSE, SPARSE, SHAPE, QUADRIC = range(4)

#: Flags of an instance.
VISIBLE, CASTS, UNLIT = 1, 2, 4

#: Encodings as the shader numbers them.
ENCODINGS = encodings.NAMES

#: Cells along the side of a block of a dense grid, and of a brick.
BLOCK_CELLS, BRICK_CELLS = 4, 7

#: Steps of the errors of samples, which divide 255.
ERROR_STEPS = 5

#: Start of a shadow ray above the surface, field units: half a voxel, the step of pictures of one shape, and half of
#: 1/1024 for quadrics and for shapes in scenes.
VOXEL_BIAS, SHAPE_BIAS, SCENE_BIAS = 0.5, 1e-3, 0.5 / 1024

#: A shape is drawn in its box grown by this share of its frame, so that rays start outside.
SHAPE_MARGIN = 1e-3


@dataclass
class Record:
    """One field: the numbers of its record by their places, its data, and its place in the world."""

    #: Field space from the object's own space, (4, 4).
    field_from_object: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    numbers: dict[int, float]
    #: Arrays of words by the place of the record that gets their index.
    arrays: dict[int, NDArray[np.uint32]] = field(default_factory=dict)
    #: Least and largest level of the data, world units of the object.
    levels: tuple[float, float] = (-np.inf, np.inf)
    #: Linear RGB of the object itself.
    color: Sequence[float] | None = None
    #: Difference between neighbouring samples of a dense grid that 1 % of the pairs exceed, units of the samples.
    slope: float = 0.0
    #: Largest difference of the stored samples from the exact ones, world units of the object; None if it is not known.
    error: float | None = None
    #: Numbers of vertices and faces of the mesh whose field this is, where the view has them.
    mesh: tuple[int, int] | None = None


def of_volume(volume: Volume, encoding: str) -> Record:
    """The record of a dense grid. A quantised volume stays as it is; others are stored in `encoding`."""
    exact = None
    if encoding_of(volume) == "float32" and encoding != "float32":
        exact = volume.distances
        volume = volume.quantize(encoding)  # type: ignore[arg-type]
    shape = volume.resolution
    blocks = [(n + 1 + BLOCK_CELLS - 1) // BLOCK_CELLS for n in shape]
    texels = volume._texels
    scale = volume._scale
    values = np.asarray(texels)
    normalised = encoding_of(volume) in encodings.STEPS
    steps = encodings.STEPS[encoding_of(volume)] if normalised else 1
    # Beyond the largest integer nothing is known.
    least, largest = float(values.min()) / steps * scale, float(values.max()) / steps * scale
    keep = scale * (1 - 1 / steps) if normalised else np.inf
    arrays = {
        FIRST: _words(np.asarray(texels).ravel(order="F")),
        EMPTY: _reserved(1, blocks),
        MASKS: _reserved(8, blocks),
    }
    stored = volume.distances
    error = None
    if exact is not None:
        arrays[ERRORS], error = _errors(exact, stored, volume.spacing)
    return Record(
        field_from_object=_grid_from_world(volume),
        lower=np.full(3, -0.5),
        upper=np.array(shape) - 0.5,
        numbers={
            KIND: DENSE,
            ENCODING: ENCODINGS.index(encoding_of(volume)),
            SCALE: scale,
            UNIT: 1.0,
            BIAS: VOXEL_BIAS,
            **_three(VOXELS, shape),
            **_three(BLOCKS, blocks),
        },
        arrays=arrays,
        levels=(max(least, -keep), min(largest, keep)),
        slope=_slope(stored),
        error=error,
    )


def add_mesh(record: Record, mesh: Mesh) -> None:
    """Store the vertices of a mesh, field space, and its faces beside the dense grid of its field."""
    if record.mesh is not None or len(mesh.faces) > MOST_FACES:
        return
    matrix = record.field_from_object
    vertices = (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    record.mesh = len(vertices), len(mesh.faces)
    record.arrays[INDEX] = np.concatenate([_words(vertices), _words(mesh.faces.astype(np.uint32))])


def of_sparse(volume: SparseVolume, encoding: str) -> Record:
    """The record of bricks; they are stored in `encoding` if that has fewer bits than their own."""
    arrays = volume._core_field.arrays()
    # The samples of each brick with x fastest, as one tall grid.
    bricks = np.ascontiguousarray(arrays["bricks"].transpose(0, 3, 2, 1)).reshape(-1, 8, 8).transpose()
    stored, scale = volume.encoding, volume._core_field.scale
    spacing = volume.spacing
    counts = arrays["index"].shape
    maps: dict[int, NDArray[np.uint32]] = {}
    error = None
    if ENCODINGS.index(encoding) > ENCODINGS.index(stored):
        values = bricks if stored == "float32" else _core.decode(bricks, scale)
        scale = encodings.scale_of(encoding, spacing, volume.band / float(spacing.max()))
        bricks = _core.encode(values, encoding, scale)
        if stored == "float32":
            maps[ERRORS], error = _errors(values, _core.decode(bricks, scale), spacing)
        stored = encoding
    step = spacing * BRICK_CELLS
    longest = float(step.max())
    nodes = (arrays["nodes"].ravel(order="F").astype(np.float64) / longest).astype(np.float32)
    floor = max(volume.band - 0.5 * float(np.linalg.norm(spacing)), 0.0)
    return Record(
        field_from_object=_grid_from_world(volume),
        lower=np.full(3, -0.5),
        upper=np.array(volume.resolution) - 0.5,
        numbers={
            KIND: SPARSE,
            ENCODING: ENCODINGS.index(stored),
            SCALE: scale,
            UNIT: 1.0,
            BIAS: VOXEL_BIAS,
            FLOOR: floor,
            LONGEST_STEP: longest,
            **_three(VOXELS, volume.resolution),
            **_three(BLOCKS, counts),
            **_three(NODE_STEP, step / longest),
        },
        arrays={
            FIRST: _words(np.asarray(bricks).ravel(order="F")),
            EMPTY: _reserved(1, counts),
            INDEX: _words(arrays["index"].ravel(order="F")),
            NODES: _words(nodes),
            **maps,
        },
        levels=(-volume.band, 0.99 * floor),
        error=error,
    )


def of_shape(
    shape: Shape,
    function: tuple[int, NDArray[np.float32], Any, float, float],
    bias: float,
    *,
    bounds: NDArray[np.float64] | None = None,
) -> Record:
    """The record of a shape that has a function in the shader; `bounds` replaces the box of the shape."""
    structure, numbers, center, scale, inverse_lipschitz = function
    local = np.eye(4)
    local[:3, :3] /= scale
    local[:3, 3] = -np.asarray(center) / scale
    lower, upper = ((np.asarray(corner) - center) / scale for corner in (shape.bounds if bounds is None else bounds))
    return Record(
        field_from_object=local,
        lower=lower - SHAPE_MARGIN,
        upper=upper + SHAPE_MARGIN,
        numbers={
            KIND: SHAPE,
            SCALE: 1.0,
            STRUCTURE: structure,
            INVERSE_LIPSCHITZ: inverse_lipschitz,
            UNIT: scale,
            BIAS: bias,
        },
        arrays={FIRST: _words(numbers)},
        levels=(-0.25 * scale, SHAPE_MARGIN * scale),
    )


def of_quadric(quadric: Quadric) -> Record:
    """The record of a quadric: its form in the frame of its trim sphere, where the largest entry is 1."""
    slack = min(1e-5 + 2.0**-23 * float(np.sum(quadric.center**2)) / quadric.radius**2, 1e-2)
    radius = quadric.radius * (1 + slack)
    world_from_local = np.diag([radius, radius, radius, 1.0])
    world_from_local[:3, 3] = quadric.center
    matrix = quadric.matrix / np.abs(quadric.matrix).max()
    form = world_from_local.T @ matrix @ world_from_local
    form = 0.5 * (form + form.T) / np.abs(form).max()
    return Record(
        field_from_object=np.linalg.inv(world_from_local),
        lower=np.full(3, -1.0),
        upper=np.full(3, 1.0),
        numbers={KIND: QUADRIC, SCALE: 1.0, UNIT: radius, BIAS: SCENE_BIAS},
        arrays={FIRST: _words(form.T.astype(np.float32).ravel())},
        color=quadric.reflectance.tolist(),
    )


def joined(
    records: Sequence[Record], flags: Sequence[int], objects: Sequence[int]
) -> tuple[list[list[float]], NDArray[np.uint32]]:
    """The numbers of all records, and all arrays; an array of several records is stored once.

    Raises
    ------
    SceneError
        If the view has more than 2^24 words of samples.
    """
    rows: list[list[float]] = []
    pieces: list[NDArray[np.uint32]] = []
    at = 0
    known: dict[int, int] = {}
    for record, flag, number in zip(records, flags, objects, strict=True):
        numbers = {**record.numbers, FLAGS: flag, OBJECT: number}
        numbers.update({**_three(LOWER, record.lower), **_three(UPPER, record.upper)})
        for place, array in record.arrays.items():
            if id(array) not in known:
                known[id(array)] = at
                pieces.append(array)
                at += len(array)
            numbers[place] = known[id(array)]
        rows.append([float(numbers.get(place, 0.0)) for place in range(RECORD)])
    if at > MOST_WORDS:
        advice = "a smaller encoding, a coarser volume, or Volume.to_sparse()"
        raise SceneError(
            f"a view holds at most 64 MiB of samples, and these have {4 * at / 2**20:.0f} MiB; use {advice}"
        )
    return rows, np.concatenate(pieces)


def _slope(values: NDArray[Any]) -> float:
    """The difference between neighbouring samples that 1 % of the pairs along an axis exceed; more do at no axis.

    Fields of open meshes jump at their openings, so that the largest difference says little about the others.
    """
    steps = [np.abs(np.diff(values, axis=axis)) for axis in range(3)]
    return max(float(np.percentile(step, 99)) if step.size else 0.0 for step in steps)


def _errors(exact: NDArray[Any], stored: NDArray[Any], spacing: NDArray[Any]) -> tuple[NDArray[np.uint32], float]:
    """Errors of the samples near the surface as bytes, 255 for the largest, and the largest; 0 for other samples.

    The sample that is nearest to a point of the surface is at most half the diagonal of a voxel away. Errors have
    :data:`ERROR_STEPS` steps, because noise of more steps compresses badly.
    """
    near = 0.5 * float(np.linalg.norm(spacing))
    errors = np.where(np.abs(exact) <= near, np.abs(exact - stored), 0)
    largest = float(errors.max(initial=0.0))
    shares = np.rint(ERROR_STEPS / (largest or 1.0) * errors) * (255 // ERROR_STEPS)
    return _words(shares.astype(np.uint8).ravel(order="F")), largest


def encoding_of(volume: Volume) -> str:
    """The encoding of a dense volume."""
    return volume.encoding if isinstance(volume, QuantizedVolume) else "float32"


def _grid_from_world(volume: Volume | SparseVolume) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(1 / volume.spacing)
    matrix[:3, 3] = -volume.bounds[0] / volume.spacing - 0.5
    return matrix


def _three(place: int, values: Any) -> dict[int, Any]:
    return {place + i: values[i] for i in range(3)}


def _reserved(size: int, blocks: Sequence[int]) -> NDArray[np.uint32]:
    """Room for `size` bytes of each block, which the viewer fills."""
    return np.zeros((size * int(np.prod(blocks)) + 3) // 4, dtype=np.uint32)


def _words(values: NDArray[Any]) -> NDArray[np.uint32]:
    """The bytes of an array as words, padded with zeros."""
    data = values.tobytes()
    return np.frombuffer(data + bytes(-len(data) % 4), dtype="<u4")
