"""Fields that become a `Volume` by ``to_volume``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .volume import Volume


class Convertible:
    """Base class of fields that are not a `Volume`, but convert to one by ``to_volume``."""

    __slots__ = ()

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            kind = type(self).__name__
            if not name.startswith("_") and hasattr(Volume, name):
                raise AttributeError(f"a {kind} has no {name}; a Volume has: call to_volume().{name}")
            raise AttributeError(f"'{kind}' object has no attribute '{name}'")

        def __array__(self, *_: Any, **__: Any) -> Any:
            raise TypeError(
                f"a {type(self).__name__} is not an array; to_volume() makes a Volume, which converts to one"
            )
