"""Lights, and the defaults of every picture. Directions are those in which light travels. Colours are linear RGB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import _core
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


def _direction(value: Sequence[float]) -> Vector:
    """Check a direction of any length except zero; return it with length 1."""
    direction = np.array(_vector("direction", value))
    largest = np.abs(direction).max()
    if largest == 0:
        raise SceneError("direction: must have a length, got (0, 0, 0)")
    direction /= largest
    return checks.triple(direction / np.linalg.norm(direction))


def _range(value: float | None) -> float | None:
    """Check the range of a light: None, or a positive number that may be infinite."""
    if value is None:
        return None
    try:
        reach = checks.limit("range", value)
    except ArgumentError as error:
        raise SceneError(str(error)) from None
    if not reach > 0:
        raise SceneError(f"range: must be above 0, or None for a light without falloff, got {reach:g}")
    return reach


def _angle(name: str, value: float, most: float) -> float:
    angle = _least(name, value)
    if not angle <= most:
        raise SceneError(f"{name}: must be at most {most:g} degrees, got {angle:g}")
    return angle


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
        Angular diameter of the light, degrees, at most 180. Hard shadows ignore it.

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
        object.__setattr__(self, "direction", _direction(self.direction))
        object.__setattr__(self, "color", _color(self.color))
        object.__setattr__(self, "intensity", _least("intensity", self.intensity))
        object.__setattr__(self, "angle_deg", _angle("angle_deg", self.angle_deg, 180))


@dataclass(frozen=True)
class PointLight:
    """A light at a point, equal in all directions.

    Parameters
    ----------
    position : (3,)
        Position, world units.
    color : (3,), default white
        Linear RGB.
    intensity : float, default 1
        Factor of the colour. Without `range` it is the same at any distance; with `range` it holds at a distance of one
        world unit.
    radius : float, default 0
        Radius of the source, world units. Hard shadows ignore it.
    range : float, optional
        Distance at which the light ends, world units. At the distance ``d`` the intensity is multiplied by
        ``max(0, 1 - (d / range)**4) / d**2``, the falloff of lights in glTF files. ``math.inf`` is the inverse square
        alone. None, the default, is a light without falloff.

    References
    ----------
    Khronos Group, glTF extension KHR_lights_punctual, section "Range Property".

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
    range: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _vector("position", self.position))
        object.__setattr__(self, "color", _color(self.color))
        object.__setattr__(self, "intensity", _least("intensity", self.intensity))
        object.__setattr__(self, "radius", _least("radius", self.radius))
        object.__setattr__(self, "range", _range(self.range))


@dataclass(frozen=True)
class SpotLight:
    """A light at a point that shines into a cone.

    Parameters
    ----------
    position : (3,)
        Position, world units.
    direction : (3,)
        Direction of the axis of the cone, in which the light travels; any length except zero.
    inner_deg : float, default 0
        Angle between the axis and the directions in which the intensity begins to decrease, degrees.
    outer_deg : float, default 45
        Angle between the axis and the edge of the cone, degrees: at least `inner_deg`, above 0 and at most 90. The
        opening of the cone is twice this angle. From the inner to the outer angle the intensity decreases with the
        square of a linear function of the cosine, as in glTF files.
    color : (3,), default white
        Linear RGB.
    intensity : float, default 1
        Factor of the colour inside the inner angle, as for :class:`PointLight`.
    radius : float, default 0
        Radius of the source, world units. Hard shadows ignore it, and so does the cone.
    range : float, optional
        Distance at which the light ends, as for :class:`PointLight`. None is a light without falloff.

    References
    ----------
    Khronos Group, glTF extension KHR_lights_punctual, section "Inner and Outer Cone Angles".

    Examples
    --------
    >>> import fieldbake as fb
    >>> lamp = fb.SpotLight((0, 3, 0), (0, -1, 0), inner_deg=20, outer_deg=30, intensity=9, range=12)
    >>> lamp.direction
    (0.0, -1.0, 0.0)
    """

    position: Sequence[float]
    direction: Sequence[float]
    inner_deg: float = 0.0
    outer_deg: float = 45.0
    color: Sequence[float] = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    radius: float = 0.0
    range: float | None = None

    def __post_init__(self) -> None:
        outer = _angle("outer_deg", self.outer_deg, 90.0)
        if outer == 0:
            raise SceneError("outer_deg: must be above 0, got 0")
        object.__setattr__(self, "position", _vector("position", self.position))
        object.__setattr__(self, "direction", _direction(self.direction))
        object.__setattr__(self, "inner_deg", _angle("inner_deg", self.inner_deg, outer))
        object.__setattr__(self, "outer_deg", outer)
        object.__setattr__(self, "color", _color(self.color))
        object.__setattr__(self, "intensity", _least("intensity", self.intensity))
        object.__setattr__(self, "radius", _least("radius", self.radius))
        object.__setattr__(self, "range", _range(self.range))


Light = DirectionalLight | PointLight | SpotLight

#: The classes of lights.
LIGHTS = (DirectionalLight, PointLight, SpotLight)


def check_lights(lights: Sequence[Light]) -> tuple[Light, ...]:
    """Check a list of lights, or raise SceneError."""
    if isinstance(lights, LIGHTS) or not isinstance(lights, Sequence):
        raise SceneError(f"lights: must be a list of lights, got {checks.describe(lights)}")
    if len(lights) > MAX_LIGHTS:
        raise SceneError(f"lights: at most {MAX_LIGHTS}, got {len(lights)}")
    for number, light in enumerate(lights):
        if not isinstance(light, LIGHTS):
            raise SceneError(
                f"lights[{number}]: must be a PointLight, SpotLight or DirectionalLight, got {checks.describe(light)}"
            )
    return tuple(lights)


def cone_cosines(light: SpotLight) -> tuple[float, float]:
    """Compute the cosines of the inner and the outer angle of a cone."""
    inner, outer = np.cos(np.radians([light.inner_deg, light.outer_deg])).tolist()
    return inner, outer


def row_of(light: Light) -> _core.DirectionalRow | _core.PointRow:
    """Convert a light to its row in the core."""
    red, green, blue = (channel * light.intensity for channel in light.color)
    if isinstance(light, DirectionalLight):
        slope = float(np.tan(np.radians(min(light.angle_deg, 170.0) / 2)))
        return {"direction": light.direction, "slope": slope, "color": (red, green, blue)}
    return {
        "position": light.position,
        "radius": light.radius,
        "color": (red, green, blue),
        "range": light.range,
        "spot": (light.direction, cone_cosines(light)) if isinstance(light, SpotLight) else None,
    }


def key_light(pose: NDArray[np.float64]) -> DirectionalLight:
    """Make the default light of a camera whose pose is `pose`, (4, 4), world from camera."""
    return DirectionalLight(checks.triple(pose[:3, :3] @ np.array(KEY_DIRECTION)), intensity=KEY_INTENSITY)
