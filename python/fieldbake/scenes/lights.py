"""Lights, and the defaults of every picture. Directions are those in which light travels. Colours are linear RGB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError

Vector = tuple[float, float, float]

#: Largest number of lights of a scene.
MAX_LIGHTS = 16

#: Direction of the default key light, camera space: it comes from above, over the viewer's right shoulder, 56 degrees
#: off the viewing axis, so that both form and shadow are visible.
KEY_DIRECTION = (-0.45, -0.7, -0.55)

#: Intensity of the default key light. A white surface returns at most
#: ``AMBIENT + KEY_INTENSITY * (max(0, n.l) + SPECULAR * max(0, n.h)^SHININESS)``. In a square picture with a field of
#: view of 45 degrees the angle between the light and the eye is at least 25 degrees, so the bracket is at most 1.23 and
#: the sum at most 0.986. The 8-bit value 254 begins at 0.987, so a white surface keeps its shading everywhere.
KEY_INTENSITY = 0.64

#: Default ambient light, as a fraction of the surface's colour.
AMBIENT = 0.2

#: Default background, linear RGBA: a dark slate, 44, 48 and 56 of 255 in sRGB. A black surface without a highlight is
#: darker. A white surface is lighter everywhere: ambient light alone gives it 80 of 255 or more.
BACKGROUND = (0.025, 0.03, 0.04, 1.0)


def _vector(name: str, value: Sequence[float]) -> Vector:
    return checks.triple(checks.vector(name, value, 3, SceneError))


def _least(name: str, value: float) -> float:
    try:
        return checks.number(name, value, least=0)
    except ArgumentError as error:
        raise SceneError(str(error)) from None


def _color(value: Sequence[float]) -> Vector:
    color = _vector("color", value)
    if min(color) < 0:
        raise SceneError(f"color: must not be negative, got {color}")
    return color


@dataclass(frozen=True)
class DirectionalLight:
    """A light at infinite distance, such as the sun.

    Parameters
    ----------
    direction : (3,)
        Direction in which the light travels; any length except zero.
    color : (3,), default white
        Linear RGB.
    intensity : float, default 1
        Factor of the colour.
    angle_deg : float, default 0
        Angular diameter of the light, degrees. Hard shadows ignore it.

    Examples
    --------
    >>> import fieldbake as fb
    >>> sun = fb.DirectionalLight((-1, -2, -1), angle_deg=0.5)
    >>> sun.intensity
    1.0
    """

    direction: Sequence[float]
    color: Sequence[float] = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        direction = np.array(_vector("direction", self.direction))
        largest = np.abs(direction).max()
        if largest == 0:
            raise SceneError("direction: must have a length, got (0, 0, 0)")
        direction /= largest
        object.__setattr__(self, "direction", checks.triple(direction / np.linalg.norm(direction)))
        object.__setattr__(self, "color", _color(self.color))
        object.__setattr__(self, "intensity", _least("intensity", self.intensity))
        object.__setattr__(self, "angle_deg", _least("angle_deg", self.angle_deg))


@dataclass(frozen=True)
class PointLight:
    """A light at a point.

    Parameters
    ----------
    position : (3,)
        Position, world units.
    color : (3,), default white
        Linear RGB.
    intensity : float, default 1
        Factor of the colour.
    radius : float, default 0
        Radius of the source, world units. Hard shadows ignore it.

    Examples
    --------
    >>> import fieldbake as fb
    >>> lamp = fb.PointLight((1, 3, 1), radius=0.4)
    >>> lamp.position
    (1.0, 3.0, 1.0)
    """

    position: Sequence[float]
    color: Sequence[float] = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    radius: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _vector("position", self.position))
        object.__setattr__(self, "color", _color(self.color))
        object.__setattr__(self, "intensity", _least("intensity", self.intensity))
        object.__setattr__(self, "radius", _least("radius", self.radius))


Light = DirectionalLight | PointLight


def check_lights(lights: Sequence[Light]) -> tuple[Light, ...]:
    """Check a list of lights, or raise SceneError."""
    if isinstance(lights, (PointLight, DirectionalLight)) or not isinstance(lights, Sequence):
        raise SceneError(f"lights: must be a list of lights, got {checks.describe(lights)}")
    if len(lights) > MAX_LIGHTS:
        raise SceneError(f"lights: at most {MAX_LIGHTS}, got {len(lights)}")
    for number, light in enumerate(lights):
        if not isinstance(light, (PointLight, DirectionalLight)):
            raise SceneError(
                f"lights[{number}]: must be a PointLight or DirectionalLight, got {checks.describe(light)}"
            )
    return tuple(lights)


def key_light(pose: NDArray[np.float64]) -> DirectionalLight:
    """Make the default light of a camera whose pose is `pose`, (4, 4), world from camera."""
    return DirectionalLight(checks.triple(pose[:3, :3] @ np.array(KEY_DIRECTION)), intensity=KEY_INTENSITY)
