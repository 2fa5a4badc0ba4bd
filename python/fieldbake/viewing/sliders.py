"""Sliders of a page: parameters of a shape on which its numbers in the shader depend linearly.

A page has no Python, so it cannot make the shape again. The shader reads the numbers of a shape from a table, though,
and many parameters change them linearly: sizes, places, widths of blends and colours. For such a parameter the page
stores the change of each number per unit of the parameter. The structure of the shape, which is the text of the shader,
must stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.errors import ArgumentError
from ..shapes.shape import Shape
from . import records
from .content import Content

#: Values of a parameter at which the numbers are compared with the line through the first and the last of them.
VALUES = 5

#: Largest difference from the line, as a share of the largest number, at least of the local unit.
TOLERANCE = 1e-6

#: Joint values of all sliders at which the sum of their changes is compared.
JOINT = 5

#: Largest number of joint values of the ends of all ranges at which the box of the shape is computed.
CORNERS = 256

Model = Callable[..., Any]
Ranges = Mapping[str, tuple[float, float]]


class Frame(NamedTuple):
    """The local units of all variants of a shape: ``(world - center) / scale``."""

    center: tuple[float, float, float]
    scale: float


class _Variant(NamedTuple):
    """The shader and the record of a shape in a frame."""

    text: str
    function: tuple[int, NDArray[np.float32], Any, float, float]

    @property
    def numbers(self) -> NDArray[np.float64]:
        return self.function[1].astype(np.float64)


def add_sliders(content: Content, model: Model, ranges: Ranges, values: Mapping[str, float]) -> None:
    """Add the sliders to the page of ``model(**values)``; a remark names the parameters that need Python."""
    shapes = {name: [model(**{**values, name: at}) for at in _steps(ranges[name])] for name in ranges}
    first = model(**values)
    every = [first, *(shape for group in shapes.values() for shape in group)]
    if not all(isinstance(shape, Shape) for shape in every):
        raise ArgumentError("model: must return a Shape, since a page can only change the numbers of shapes")
    # Boxes mostly grow with each parameter, so the corners of the ranges bound them.
    corners = [model(**dict(zip(ranges, at, strict=True))) for at in islice(product(*ranges.values()), CORNERS)]
    box = _union([*every, *corners])
    frame = _frame(box)
    base = _variant(first, frame)
    if base is None:
        _remark(content, list(ranges))
        return
    slopes: dict[str, NDArray[np.float64]] = {}
    for name, (least, most) in ranges.items():
        found = [_variant(shape, frame) for shape in shapes[name]]
        if any(one is None or one.text != base.text or len(one.numbers) != len(base.numbers) for one in found):
            continue
        rows = np.stack([one.numbers for one in found if one is not None])
        slope = (rows[-1] - rows[0]) / (most - least)
        away = np.array(_steps((least, most))) - values[name]
        if _agrees(rows, base.numbers + away[:, None] * slope) and _is_joint(
            model, values, ranges, frame, base, {**slopes, name: slope}
        ):
            slopes[name] = slope
    _remark(content, [name for name in ranges if name not in slopes])
    if slopes:
        _store(content, first, box, base, slopes, ranges, values)


def _is_joint(
    model: Model,
    values: Mapping[str, float],
    ranges: Ranges,
    frame: Frame,
    base: _Variant,
    slopes: Mapping[str, NDArray[np.float64]],
) -> bool:
    """Whether the changes of several parameters add up, at joint values in their ranges."""
    if len(slopes) == 1:
        return True
    for row in np.random.default_rng(1).uniform(size=(JOINT, len(slopes))).tolist():
        at = {
            name: ranges[name][0] + share * (ranges[name][1] - ranges[name][0])
            for name, share in zip(slopes, row, strict=True)
        }
        found = _variant(model(**{**values, **at}), frame)
        expected = base.numbers + sum((at[name] - values[name]) * slope for name, slope in slopes.items())
        if found is None or found.text != base.text or not _agrees(found.numbers, expected):
            return False
    return True


def _agrees(found: NDArray[np.float64], expected: NDArray[np.float64]) -> bool:
    return bool(
        np.abs(found - expected).max(initial=0.0) <= TOLERANCE * max(1.0, float(np.abs(expected).max(initial=0.0)))
    )


def _steps(limits: tuple[float, float]) -> list[float]:
    steps: list[float] = np.linspace(*limits, VALUES).tolist()
    return steps


def _union(shapes: list[Shape]) -> NDArray[np.float64]:
    boxes = np.stack([shape.bounds for shape in shapes])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _frame(box: NDArray[np.float64]) -> Frame:
    center, size = box.mean(axis=0), float((box[1] - box[0]).max())
    x, y, z = center.tolist()
    return Frame((x, y, z), 2.0 ** math.ceil(math.log2(size)) if size > 0 else 1.0)


def _variant(shape: Any, frame: Frame) -> _Variant | None:
    """The function of a shape in a frame; None for a shape without one."""
    if not isinstance(shape, Shape):
        return None
    kinds = (False, False, False, False)
    texts, functions = _core.viewer_shader("wgsl", kinds, None, [shape._core], (frame.center, frame.scale))
    return None if functions[0] is None else _Variant(texts[0], functions[0])


def _store(
    content: Content,
    shape: Shape,
    box: NDArray[np.float64],
    base: _Variant,
    slopes: Mapping[str, NDArray[np.float64]],
    ranges: Ranges,
    values: Mapping[str, float],
) -> None:
    """Draw the shape in the common frame and box, and describe its sliders."""
    record = records.of_shape(shape, base.function, records.SHAPE_BIAS, bounds=box)
    content.placed[0].record = record
    content.bounds = box
    places = np.flatnonzero(np.any(np.stack(list(slopes.values())) != 0, axis=0))
    content.sliders = {
        # Places count from the first number of the shape, whose index is known when the records are joined.
        "places": places.tolist(),
        "numbers": base.numbers[places].tolist(),
        "parameters": [
            {"name": name, "range": list(ranges[name]), "value": values[name], "slopes": slope[places].tolist()}
            for name, slope in slopes.items()
        ],
    }


def _remark(content: Content, names: list[str]) -> None:
    if names:
        content.remarks.append(f"{', '.join(names)} would need Python: the numbers of the shape are not linear in them")
