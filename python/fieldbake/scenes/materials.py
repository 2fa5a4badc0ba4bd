"""Materials: what surfaces look like."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..meshes.images import decoded
from ..meshes.mesh import ALPHA_MODES

#: Colour of an object that has none of its own, linear RGBA.
PLAIN = (0.8, 0.8, 0.8, 1.0)

#: Default strength and sharpness of the highlight (Blinn-Phong).
SPECULAR, SHININESS = 0.25, 32.0


@dataclass(frozen=True, eq=False)
class Material:
    """Colour or texture, and how it answers light (Blinn-Phong).

    Parameters
    ----------
    color : (3,) or (4,), optional
        Linear RGB and opacity. Multiplies `texture`. If neither is given, the thing's own colours and textures stay.
    texture : (h, w, 3 or 4) uint8 or path, optional
        sRGB image, row 0 on top, laid on by the mesh's `uv`; repeats.
    specular : float, default 0.25
        Strength of the highlight.
    shininess : float, default 32
        Sharpness of the highlight, the exponent of Blinn-Phong.
    alpha_mode : "opaque", "mask" or "blend", optional
        What opacity means, for the camera and for shadows: nothing, cut out below `alpha_cutoff`, or let through. The
        object's own if not given, or ``"blend"`` where `color` is not opaque.
    alpha_cutoff : float, optional
        From 0 to 1, for ``"mask"``; the thing's own, or 0.5.
    two_sided : bool, optional
        Whether faces are seen from behind; the object's own if not given. Flat and masked meshes are then seen from
        both sides. An open mesh with two-sided faces is a sheet without an inside.
    emission : (3,), optional
        Linear RGB that the surface sends out by itself, added to the picture; it lights nothing else. If not given, the
        object's own where `color` and `texture` are not given either.
    unlit : bool, optional
        Whether the colour is shown as it is, without light; the object's own if not given.
    scattering : float or (3,), default 0
        Scattering length ``s``, world units, for each of RGB: light keeps the share ``exp(-l / s)`` over a length ``l``
        inside the object. 0: light does not enter.

    Raises
    ------
    SceneError
        For a value out of range.

    Notes
    -----
    With `scattering`, a visible point that is turned away from a light sends out ``albedo * light * visibility *
    exp(-l / s)``. ``l`` is the length of the ray from the point to the light inside the object, and ``visibility`` is
    the share of the light that arrives where the ray enters the object: other instances shade it in the mode of the
    picture's shadows, and none does with ``shadows="none"``. A quadric has the chord to its next crossing, or to its
    trim sphere, in closed form. Every other object is measured in its field, where stretches inside that are shorter
    than 1/8 of a voxel may be missed. On a lit side at cosine ``c`` to the light the term has the weight
    ``(1 - c)^2``. So it joins Lambert's term without a step, and both together never exceed the light that arrives.

    Examples
    --------
    >>> Material(color=(1, 0, 0)).color
    (1.0, 0.0, 0.0, 1.0)
    """

    color: Sequence[float] | None = None
    texture: Any = None
    specular: float = SPECULAR
    shininess: float = SHININESS
    alpha_mode: str | None = None
    alpha_cutoff: float | None = None
    two_sided: bool | None = None
    scattering: float | Sequence[float] = 0.0
    emission: Sequence[float] | None = None
    unlit: bool | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        try:
            if self.color is not None:
                put("color", _color(self.color))
            if self.texture is not None:
                put("texture", _texture(self.texture))
            put("specular", checks.number("specular", self.specular, least=0))
            put("shininess", checks.number("shininess", self.shininess, above=0))
            if self.alpha_mode is not None:
                checks.choice("alpha_mode", self.alpha_mode, ALPHA_MODES, SceneError)
            if self.alpha_cutoff is not None:
                cutoff = checks.number("alpha_cutoff", self.alpha_cutoff, least=0)
                if cutoff > 1:
                    raise SceneError(f"alpha_cutoff: must be from 0 to 1, got {cutoff:g}")
                put("alpha_cutoff", cutoff)
            if self.two_sided is not None:
                put("two_sided", checks.flag("two_sided", self.two_sided))
            if self.emission is not None:
                emission = checks.vector("emission", self.emission, 3, SceneError)
                if emission.min() < 0:
                    raise SceneError(f"emission: must not be negative, got {emission.tolist()}")
                put("emission", checks.triple(emission))
            if self.unlit is not None:
                put("unlit", checks.flag("unlit", self.unlit))
            scattering = np.asarray(self.scattering, dtype=np.float64) if np.ndim(self.scattering) else None
            lengths = np.full(3, self.scattering) if scattering is None else scattering
            lengths = checks.vector("scattering", lengths, 3, SceneError)
            if lengths.min() < 0:
                raise SceneError(f"scattering: must not be negative, got {lengths.tolist()}")
            put("scattering", checks.triple(lengths))
        except (ArgumentError, TypeError, ValueError) as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError(str(error)) from None


def _color(value: Sequence[float]) -> tuple[float, ...]:
    length = 4 if np.shape(value) == (4,) else 3
    color = checks.vector("color", value, length, SceneError)
    if color.min() < 0 or (length == 4 and color[3] > 1):
        raise SceneError(f"color: must not be negative, opacity at most 1, got {color.tolist()}")
    return (*color.tolist(), 1.0)[:4]


def _texture(value: Any) -> NDArray[np.uint8]:
    if isinstance(value, (str, os.PathLike)):
        from PIL import Image

        try:
            with Image.open(value) as image:
                value = np.asarray(image.convert("RGBA"))
        except (SyntaxError, ValueError) as error:
            raise SceneError(f"texture: {value} cannot be read as a picture: {error}") from error
    pixels = np.asarray(value)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.dtype != np.uint8 or pixels.size == 0:
        raise SceneError(f"texture: must be uint8 of shape (h, w, 3) or (h, w, 4), got {checks.describe(pixels)}")
    return decoded(pixels)


def scattering_rgb(material: Material) -> tuple[float, float, float]:
    """How far each colour of light goes inside, world units."""
    r, g, b = np.broadcast_to(np.asarray(material.scattering, dtype=np.float64), 3).tolist()
    return r, g, b
