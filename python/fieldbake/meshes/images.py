"""Images of textures. Each image is decoded once for all parts that share it."""

from __future__ import annotations

import hashlib
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks

#: Decoded images by a digest of their content, as long as a part refers to them.
_by_content: weakref.WeakValueDictionary[bytes, NDArray[np.uint8]] = weakref.WeakValueDictionary()

#: Digests of PIL images by `id`, each with a weak reference that is dead once the image is deleted.
_of_image: dict[int, tuple[weakref.ref[Any], bytes]] = {}


def decoded(image: Any) -> NDArray[np.uint8]:
    """Decode an image to (h, w, 4) uint8, sRGB and opacity, row 0 on top, read-only.

    Equal images give the same array: the same PIL image, PIL images of the same file content, equal arrays.

    Parameters
    ----------
    image : PIL image or (h, w, 3 or 4) uint8

    Raises
    ------
    OSError, SyntaxError, ValueError
        If the content cannot be decoded.
    """
    is_array = not hasattr(image, "convert")
    known = None if is_array else _of_image.get(id(image))
    if known is not None and known[0]() is image:
        digest = known[1]
    else:
        digest = _digest(image)
        if not is_array:
            number = id(image)
            _of_image[number] = weakref.ref(image, lambda _: _of_image.pop(number, None)), digest
    pixels = _by_content.get(digest)
    if pixels is None:
        pixels = np.array(image if is_array else image.convert("RGBA"), dtype=np.uint8)
        if pixels.shape[2] == 3:
            pixels = np.dstack([pixels, np.full(pixels.shape[:2], 255, dtype=np.uint8)])
        _by_content[digest] = checks.frozen(pixels)
    return pixels


def _digest(image: Any) -> bytes:
    """Hash the encoded file of a PIL image that is not decoded yet, else the pixels."""
    stream = getattr(image, "fp", None)
    if stream is not None and not getattr(stream, "closed", False):
        place = stream.tell()
        stream.seek(0)
        content = stream.read()
        stream.seek(place)
        return hashlib.blake2b(content).digest()
    hasher = hashlib.blake2b(repr((image.mode, image.size) if hasattr(image, "mode") else np.shape(image)).encode())
    hasher.update(image.tobytes())
    return hasher.digest()
