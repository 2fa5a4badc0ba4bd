"""Fields that a shader can evaluate."""

from __future__ import annotations

from abc import ABC, abstractmethod

from ..base.languages import Language
from .shader import ShaderBuffers


class Shaded(ABC):
    """Base class of stored fields with shader text."""

    __slots__ = ()

    def shader(self, language: Language = "wgsl") -> str:
        """Write functions that evaluate the field in a shader.

        Parameters
        ----------
        language : "wgsl", "glsl", "hlsl" or "msl", default "wgsl"
            GLSL is written for WebGL 2 (ES 3.00). Newer versions accept it with another first line.

        Returns
        -------
        str
            The distance at a world position ``p`` is ``field_distance(p)`` for a `Volume`, ``sparse_distance(p)`` for a
            `SparseVolume` and ``nested_distance(p)`` for a `NestedField`; ``field_gradient(p)`` is the gradient of a
            `Volume`. The distance equals the result of ``sample``, inside the box and outside, up to the rounding of
            float32. Box and encoding are constants of the text; :meth:`shader_buffers` lists the textures. Add an entry
            point to complete the shader.

        Raises
        ------
        ArgumentError
            For another language.
        """
        return self._shader_text(language)

    def shader_buffers(self) -> ShaderBuffers:
        """List the textures that the shader reads, with their formats; ``to_bytes()`` gives the bytes to upload.

        All formats are in the core of WebGPU and WebGL 2. snorm16 samples are integers of the format ``r16sint``, since
        ``r16snorm`` needs the feature ``TEXTURE_FORMAT_16BIT_NORM``.
        """
        return self._shader_textures()

    @abstractmethod
    def _shader_text(self, language: object) -> str:
        """Text of the functions; the language is checked here."""

    @abstractmethod
    def _shader_textures(self) -> ShaderBuffers:
        """Textures of the text, in the order of their bindings."""
