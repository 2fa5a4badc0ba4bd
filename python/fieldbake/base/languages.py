"""Shading languages of the texts that fields write."""

from typing import Literal, get_args

Language = Literal["wgsl", "glsl", "hlsl", "msl"]
LANGUAGES: tuple[str, ...] = get_args(Language)
