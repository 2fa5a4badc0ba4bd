"""The distance fields that scenes keep between pictures, in memory and on disk."""

from __future__ import annotations

from .scenes.field_cache import clear, use_disk

__all__ = ["clear", "use_disk"]


def __dir__() -> list[str]:
    return sorted(__all__)
