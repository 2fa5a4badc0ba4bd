"""Materials: colours, textures and reflection of surfaces."""

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
from ..meshes.part import ALPHA_MODES

#: Colour of an object without a colour of its own, linear RGBA.
PLAIN = (0.8, 0.8, 0.8, 1.0)

#: Default strength and sharpness of the highlight (Blinn-Phong).
SPECULAR, SHININESS = 0.25, 32.0


@dataclass(frozen=True, eq=False)
class Material:
    """Colour or texture, and reflection of light (Blinn-Phong).

    Parameters
    ----------
    color : (3,) or (4,), optional
        Linear RGB and opacity; multiplies `texture`. Without both, the object keeps its own colours and textures.
    texture : (h, w, 3 or 4) uint8 or path, optional
        sRGB image, row 0 on top, mapped by the mesh's `uv`. It repeats.
    specular : float, default 0.25
        Strength of the highlight.
    shininess : float, default 32
        Sharpness of the highlight, the exponent of Blinn-Phong.
    alpha_mode : "opaque", "mask" or "blend", optional
        Use of opacity, for the camera and for shadows: ``"opaque"`` ignores it, ``"mask"`` cuts out the surface below
        `alpha_cutoff`, ``"blend"`` transmits light. The default comes from the object, or is ``"blend"`` if `color` is
        not opaque.
    alpha_cutoff : float, optional
        Limit of opacity for ``"mask"``, 0 to 1. The default comes from the object, or is 0.5.
    two_sided : bool, optional
        Whether faces are visible from behind. The default comes from the object. Flat and masked meshes are then
        visible from both sides. An open mesh with two-sided faces is a sheet without an inside.
    emission : (3,), optional
        Linear RGB that the surface emits, added to the picture. It lights other surfaces in pictures with ``bounces``,
        see :func:`render`. The default comes from the object if `color` and `texture` are not given either.
    unlit : bool, optional
        Whether the colour is shown unchanged, without lighting. The default comes from the object.
    scattering : float or (3,), default 0
        Scattering length ``s``, world units, for each of RGB: the fraction ``exp(-l / s)`` of the light remains after a
        length ``l`` inside the object. 0: light does not enter.

    Raises
    ------
    SceneError
        For a value out of range.

    Notes
    -----
    With `scattering`, a visible point that faces away from a light emits ``albedo * light * visibility * exp(-l / s)``.
    ``l`` is the length of the ray from the point to the light inside the object. ``visibility`` is the fraction of the
    light that arrives where the ray enters the object: other instances shade it in the mode of the picture's shadows,
    except with ``shadows="none"``. For a quadric the length is the chord to its next crossing, or to its trim sphere,
    in closed form. For every other object it is measured in the distance field, where intervals inside that are shorter
    than 1/8 of a voxel may be missed. On a lit side at cosine ``c`` to the light the term has the weight ``(1 - c)^2``.
    It therefore joins Lambert's term continuously, and both together never exceed the light that arrives.

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


#: The material of an instance without one.
DEFAULT_MATERIAL = Material()


def scattering_rgb(material: Material) -> tuple[float, float, float]:
    """Scattering length of each colour channel, world units."""
    # The constructor has stored three numbers.
    assert isinstance(material.scattering, tuple)
    red, green, blue = material.scattering
    return red, green, blue
