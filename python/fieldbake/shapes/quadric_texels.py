"""Quadrics as texels of a texture, for shaders.

O. Lawlor, Storing Raytraced Geometry in Textures, CS 481, University of Alaska Fairbanks, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ShapeError
from .quadric import RECORD_TEXELS, Quadric, check_quadrics, rows_of


def pack_quadrics(quadrics: Sequence[Quadric]) -> NDArray[np.float32]:
    """Convert quadrics to rows of RGBA texels for a float texture.

    Parameters
    ----------
    quadrics : sequence of Quadric
        Quadrics in the order of the rows.

    Returns
    -------
    (n, 6, 4) float32
        One row of six texels (96 bytes) for each quadric, as in the struct of the article: texels 0 to 3 are the rows
        of the symmetric matrix, texel 4 is the centre and radius of the trim sphere, texel 5 the reflectance and
        opacity.

    Raises
    ------
    ShapeError
        If an item is not a Quadric, or all entries of a matrix are too small for float32.

    Notes
    -----
    Upload the array as an RGBA32F texture of 6 x n texels, and read it with integer coordinates and no filter. Devices
    allow at most 8192 or 16384 rows; :func:`wrap_quadrics` arranges more quadrics.

    float32 is too coarse for small objects far from the origin: the last entry of the matrix is about
    ``|center|^2`` and has a rounding error of 6e-8 of that. The functions of :meth:`Quadric.shader` read these rows. At
    a distance of 100 radii from the origin their hits are within 0.002 radii, from 300 radii on they miss surfaces.
    Farther away, move the quadrics near the origin by :meth:`Quadric.transformed` before packing, and subtract the same
    vector from the origins of the rays. :func:`raymarch` is not affected, since it uses the float64 quadrics in the
    frames of their trim spheres.

    Examples
    --------
    >>> packed = pack_quadrics([Quadric.sphere(radius=2, reflectance=(1, 0, 0), opacity=0.5)])
    >>> packed[0, 4:].tolist()
    [[0.0, 0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.5]]
    """
    checked = check_quadrics(quadrics)
    packed = rows_of(checked).astype(np.float32).reshape(-1, RECORD_TEXELS, 4)
    for number in range(len(packed)):
        if not packed[number, :4].any() or packed[number, 4, 3] == 0:
            what = "matrix" if packed[number, 4, 3] else "radius"
            raise ShapeError(f"quadrics[{number}]: its {what} is too small for float32; scale it")
    return packed


def unpack_quadrics(packed: ArrayLike) -> list[Quadric]:
    """Convert an array of :func:`pack_quadrics` back to quadrics.

    Parameters
    ----------
    packed : (n, 6, 4)
        Rows of six RGBA texels.

    Raises
    ------
    ShapeError
        For a wrong shape, or a row that is not a valid quadric.

    Examples
    --------
    >>> unpack_quadrics(pack_quadrics([Quadric.cylinder()]))[0].matrix.diagonal().tolist()
    [1.0, 1.0, 0.0, -1.0]
    """
    array = checks.real_array("packed", packed, "(n, 6, 4)", ShapeError)
    if array.ndim != 3 or array.shape[1:] != (RECORD_TEXELS, 4):
        raise ShapeError(f"packed: must have shape (n, 6, 4), got {checks.describe(array)}")
    return [_unpack(number, texels) for number, texels in enumerate(checks.as_float64(array))]


def _unpack(number: int, texels: NDArray[np.float64]) -> Quadric:
    try:
        return Quadric(texels[:4], texels[4, :3], texels[4, 3], texels[5, :3], texels[5, 3])
    except ShapeError as error:
        raise ShapeError(f"packed[{number}]: {error}") from None


def wrap_quadrics(packed: ArrayLike, max_side: int = 8192) -> NDArray[np.float32]:
    """Arrange packed quadrics in a texture within the size limits of a device.

    Parameters
    ----------
    packed : (n, 6, 4)
        Texels made by :func:`pack_quadrics`.
    max_side : int, default 8192
        Most texels along a side. The default is the default limit of WebGPU.

    Returns
    -------
    (height, width, 4) float32
        Quadric ``i`` begins in column ``6 * (i % k)`` of row ``i // k``, with ``k = width / 6``. Up to `max_side`
        quadrics `k` is 1, as in the article; for more it is the largest that fits. Unused texels of the last row are
        zero.

    Raises
    ------
    ShapeError
        For a wrong shape, or too many quadrics for the texture.

    Examples
    --------
    >>> import fieldbake as fb
    >>> packed = fb.pack_quadrics([fb.Quadric.sphere()] * 100)
    >>> packed.shape, fb.wrap_quadrics(packed, max_side=64).shape
    ((100, 6, 4), (10, 60, 4))
    """
    array = checks.real_array("packed", packed, "(n, 6, 4)", ShapeError)
    if array.ndim != 3 or array.shape[1:] != (RECORD_TEXELS, 4):
        raise ShapeError(f"packed: must have shape (n, 6, 4), got {checks.describe(array)}")
    side = checks.integer("max_side", max_side, least=RECORD_TEXELS, most=1 << 20, error=ShapeError)
    count = len(array)
    per_row = 1 if count <= side else side // RECORD_TEXELS
    height = max(1, -(-count // per_row))
    if height > side:
        raise ShapeError(f"packed: {count} quadrics do not fit {side} x {side} texels, at most {per_row * side} do")
    texture = np.zeros((height * per_row, RECORD_TEXELS, 4), np.float32)
    texture[:count] = array
    return texture.reshape(height, per_row * RECORD_TEXELS, 4)
