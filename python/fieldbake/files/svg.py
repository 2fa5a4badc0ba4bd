"""Filled outlines as .svg text. One unit of the picture is one world unit, and y points upwards in the loops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def svg_path(loops: Sequence[Array]) -> str:
    """Describe loops (m, 2) as one path with the even-odd rule. Coordinates have ten digits."""
    parts = []
    for loop in loops:
        # Adding 0 turns -0 into 0.
        points = (loop * (1, -1) + 0.0).tolist()
        parts.append("M" + "L".join(f"{x:.10g},{y:.10g}" for x, y in points) + "Z")
    return f'<path fill-rule="evenodd" d="{"".join(parts)}"/>'


def svg_text(lower: Array, upper: Array, elements: Iterable[str], *, pixels: int | None = None) -> str:
    """Write a document of the box from `lower` to `upper`, (2,) world units, with y upwards.

    A world unit is a millimetre on paper, as in .3mf files. With `pixels`, that is the longest side on a screen.
    """
    extent = upper - lower
    scale, unit = (1.0, "mm") if pixels is None else (pixels / max(float(extent.max()), 1e-300), "")
    width, height = (f"{side:.10g}" for side in extent)
    size = " ".join(
        f'{name}="{side * scale:.10g}{unit}"' for name, side in zip(("width", "height"), extent, strict=True)
    )
    box = f"{lower[0] + 0.0:.10g} {-upper[1] + 0.0:.10g} {width} {height}"
    body = "\n".join(elements)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="{box}" fill="#3a5a80">\n{body}\n</svg>\n'
