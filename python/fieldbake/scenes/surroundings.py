"""Ambient light: the same from all directions, or an image of the surroundings.

A white surface with the unit normal n, without occlusion, reflects the fraction

    1 / (4 pi) * integral over directions w of  L(w) * 4 max(0, n.w)

of the light L. Ramamoorthi and Hanrahan (An efficient representation for irradiance environment maps, SIGGRAPH 2001)
replace the kernel by its spherical harmonics up to degree 2, ``4 max(0, t)  ~  1 + 2 t + 5/8 (3 t^2 - 1)``. The result
is a quadratic form of n. The two kernels differ by 0.123 in the mean over the sphere, and their difference has the mean
0, so the error is at most 0.062 times the range of L.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError

#: Ambient light as a scene keeps it: a number, or an image (height, width, 3).
Ambient = float | NDArray[np.float64]


def checked_ambient(value: ArrayLike) -> Ambient:
    """Check ambient light: a number, a colour (3,), or an image (height, width, 3)."""
    array = checks.real_array("ambient", value, "(3,) or (height, width, 3)", SceneError)
    if array.ndim == 0:
        try:
            return checks.number("ambient", value, least=0)
        except ArgumentError as error:
            raise SceneError(str(error)) from None
    if array.shape == (3,):
        array = array[None, None]
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise SceneError(
            f"ambient: must be a number, a colour (3,) or an image (height, width, 3), got {checks.describe(array)}"
        )
    image = np.array(checks.as_float64(array))
    if not (image.min() >= 0 and image.max() <= checks.FAR):
        raise SceneError(f"ambient: must be from 0 to {checks.FAR:g}, got {image.min():g} to {image.max():g}")
    return checks.frozen(image)


def mean_of(ambient: Ambient) -> float:
    """Compute the mean of the light over all directions and channels."""
    return ambient if isinstance(ambient, float) else float(_moments(ambient)[0].mean())


def form_of(ambient: Ambient) -> float | list[list[list[float]]]:
    """Convert ambient light for the core: a number, or a quadratic form of (n, 1) for each channel, (3, 4, 4)."""
    if isinstance(ambient, float):
        return ambient
    mean, first, second = _moments(ambient)
    form = np.empty((3, 4, 4))
    form[:, :3, :3] = 15 / 8 * second
    form[:, :3, 3] = form[:, 3, :3] = first
    form[:, 3, 3] = 3 / 8 * mean
    forms: list[list[list[float]]] = form.tolist()
    return forms


def _moments(image: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Integrate L, L w and L w w^T over the sphere, divided by 4 pi: shapes (3,), (3, 3) and (3, 3, 3).

    The light is constant in each pixel. A direction is (c sin a, s, -c cos a) with the sine s and the cosine c of the
    latitude and the longitude a, and the integrals over ds and da have closed forms.
    """
    rows, columns = image.shape[:2]
    latitude = np.linspace(np.pi / 2, -np.pi / 2, rows + 1)
    angle = np.linspace(-np.pi, np.pi, columns + 1)
    s, c = np.sin(latitude), np.cos(latitude)

    def over_rows(antiderivative: NDArray[np.float64]) -> NDArray[np.float64]:
        return -np.diff(antiderivative)

    one, s1, s2 = over_rows(s), over_rows(s**2 / 2), over_rows(s**3 / 3)
    c1, cs, c2 = over_rows((s * c + latitude) / 2), over_rows(-(c**3) / 3), over_rows(s - s**3 / 3)
    full, x, z = np.diff(angle), np.diff(-np.cos(angle)), np.diff(-np.sin(angle))
    xx, zz = np.diff(angle / 2 - np.sin(2 * angle) / 4), np.diff(angle / 2 + np.sin(2 * angle) / 4)
    xz = np.diff(np.cos(angle) ** 2 / 2)

    def integral(row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.float64]:
        channels: NDArray[np.float64] = np.einsum("hwc,h,w->c", image, row, column) / (4 * np.pi)
        return channels

    first = np.stack([integral(c1, x), integral(s1, full), integral(c1, z)], axis=-1)
    xy, yz, zx = integral(cs, x), integral(cs, z), integral(c2, xz)
    rows_of_second = [
        [integral(c2, xx), xy, zx],
        [xy, integral(s2, full), yz],
        [zx, yz, integral(c2, zz)],
    ]
    second = np.stack([np.stack(row, axis=-1) for row in rows_of_second], axis=-2)
    return integral(one, full), first, second
