"""Parts of a mesh: runs of its faces, each with one material."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import MeshError
from .images import decoded

ALPHA_MODES = ("opaque", "mask", "blend")

#: Attributes that are computed from the images on first use.
DECODED = ("texture", "emission_texture", "alpha")


def _check_rows(value: object) -> None:
    """Check a run of faces, or raise MeshError."""
    if not isinstance(value, range) or value.step != 1 or not 0 <= value.start <= value.stop:
        raise MeshError(f"faces: must be a range of rows, range(first, end), got {checks.describe(value)}")


class Part:
    """A contiguous range of faces with one material.

    Parameters
    ----------
    image, emission_image : PIL image or (h, w, 3 or 4) uint8, optional
        sRGB images of the base colour and of the emission, row 0 on top. They are decoded at the first use of `texture`
        and `emission_texture`. The other parameters are the attributes below.

    Attributes
    ----------
    name : str
        Name in the file, or empty.
    faces : range
        Rows of `Mesh.faces`.
    color : (4,) tuple
        Base colour, RGBA from 0 to 1; multiplies the texture.
    alpha_mode : str
        ``"opaque"``, ``"mask"`` (cut out where the opacity is below `alpha_cutoff`) or ``"blend"``.
    alpha_cutoff : float
        Opacity from 0 to 1. Used only by ``"mask"``.
    two_sided : bool
        Whether the file marks the faces as visible from behind.
    emission : (3,) tuple
        Linear RGB that the surface emits; multiplies `emission_texture`.
    unlit : bool
        Whether the base colour is shown unchanged, without lighting.

    Examples
    --------
    >>> import fieldbake as fb
    >>> mesh = fb.models.gear()
    >>> part = fb.Part("steel", range(len(mesh.faces)), color=(0.5, 0.5, 0.6, 1.0))
    >>> fb.Mesh(mesh.vertices, mesh.faces, parts=[part]).parts[0].name
    'steel'
    """

    def __init__(
        self,
        name: str = "",
        faces: range = range(0),
        *,
        color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
        image: Any = None,
        alpha_mode: str = "opaque",
        alpha_cutoff: float = 0.5,
        two_sided: bool = False,
        emission: tuple[float, float, float] = (0.0, 0.0, 0.0),
        emission_image: Any = None,
        unlit: bool = False,
    ) -> None:
        _check_rows(faces)
        red, green, blue, opacity = checks.vector("color", color, 4, MeshError).tolist()
        red_emission, green_emission, blue_emission = checks.vector("emission", emission, 3, MeshError).tolist()
        self.name = name
        self.faces = faces
        self.color = (red, green, blue, opacity)
        self.alpha_mode = checks.choice("alpha_mode", alpha_mode, ALPHA_MODES, MeshError)
        self.alpha_cutoff = checks.number("alpha_cutoff", alpha_cutoff)
        self.two_sided = two_sided
        self.emission = (red_emission, green_emission, blue_emission)
        self.unlit = unlit
        self._image = image
        self._emission_image = emission_image

    def with_faces(self, faces: range) -> Part:
        """Copy the material for other faces."""
        return Part(
            self.name,
            faces,
            color=self.color,
            image=self._image,
            alpha_mode=self.alpha_mode,
            alpha_cutoff=self.alpha_cutoff,
            two_sided=self.two_sided,
            emission=self.emission,
            emission_image=self._emission_image,
            unlit=self.unlit,
        )

    @cached_property
    def texture(self) -> NDArray[np.uint8] | None:
        """Image, (h, w, 4) uint8 sRGB with opacity, row 0 on top (v = 1); None without one. Decoded on first use."""
        return self._decoded(self._image)

    @cached_property
    def emission_texture(self) -> NDArray[np.uint8] | None:
        """Image of the emission, (h, w, 4) uint8 sRGB, over the same coordinates as `texture`; None without one."""
        return self._decoded(self._emission_image)

    def _decoded(self, image: Any) -> NDArray[np.uint8] | None:
        if image is None:
            return None
        try:
            return decoded(image)
        except (OSError, SyntaxError, ValueError) as error:
            raise MeshError(f"the texture of part '{self.name}' cannot be read: {error}") from error

    @cached_property
    def alpha(self) -> NDArray[np.float32] | None:
        """Opacity of the texture, (h, w) from 0 to 1, a mask already cut; None if everything is opaque."""
        if self.alpha_mode == "opaque":
            return None
        stored = np.full((1, 1), 255, dtype=np.uint8) if self.texture is None else self.texture[..., 3]
        opacity = stored.astype(np.float32) / np.float32(255) * np.float32(self.color[3])
        if self.alpha_mode == "mask":
            opacity = (opacity >= self.alpha_cutoff).astype(np.float32)
        return checks.frozen(opacity)

    def __getstate__(self) -> dict[str, Any]:
        # Decoded pixels are not pickled, since the images restore them.
        return {name: value for name, value in self.__dict__.items() if name not in DECODED}

    def __repr__(self) -> str:
        colors = "textured" if self._image is not None else "color " + ", ".join(f"{c:.3g}" for c in self.color)
        return f"Part('{self.name}', {len(self.faces)} faces, {colors}, {self.alpha_mode})"


def check_parts(value: Any, faces: int) -> tuple[Part, ...]:
    """Check materials of runs of the faces, or raise MeshError."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise MeshError(f"parts: must be a list of Part, got {checks.describe(value)}")
    for index, part in enumerate(value):
        if not isinstance(part, Part):
            raise MeshError(f"parts[{index}]: must be a Part, got {checks.describe(part)}")
        if part.faces.stop > faces:
            raise MeshError(f"parts[{index}]: {part.faces} is out of range, the mesh has {faces} faces")
    return tuple(value)


def material_of(texture: ArrayLike | None, alpha: ArrayLike | None) -> dict[str, Any]:
    """Make the image and the alpha mode of one material from arrays."""
    if texture is None and alpha is None:
        return {}
    image = None
    if texture is not None:
        image = np.asarray(texture)
        if image.ndim != 3 or image.shape[2] not in (3, 4) or image.dtype != np.uint8 or image.size == 0:
            raise MeshError(f"texture: must be uint8 of shape (h, w, 3) or (h, w, 4), got {checks.describe(image)}")
        if image.shape[2] == 3:
            image = np.dstack([image, np.full(image.shape[:2], 255, dtype=np.uint8)])
    if alpha is not None:
        opacity = checks.real_array("alpha", alpha, "(h, w)", MeshError)
        if opacity.ndim != 2 or opacity.size == 0 or not ((opacity >= 0) & (opacity <= 1)).all():
            raise MeshError(f"alpha: must be (h, w) with values from 0 to 1, got {checks.describe(opacity)}")
        if image is None:
            image = np.full((*opacity.shape, 4), 255, dtype=np.uint8)
        if image.shape[:2] != opacity.shape:
            raise MeshError(f"alpha: must have the texture's shape {image.shape[:2]}, got {opacity.shape}")
        image = np.dstack([image[..., :3], np.round(opacity * 255).astype(np.uint8)])
    opaque = image is None or bool((image[..., 3] == 255).all())
    return {"image": image, "alpha_mode": "opaque" if opaque else "blend"}
