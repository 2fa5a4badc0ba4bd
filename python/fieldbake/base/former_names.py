"""Former names of options, attributes and functions: each is an error that states the new name.

The next version drops this module and its uses.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from .errors import ArgumentError

_Callable = TypeVar("_Callable", bound=Callable[..., Any])


class FormerNameError(ArgumentError, AttributeError):
    """A name that an earlier version had. The message states what to use now."""


def former_names(keywords: str = "", /, **names: str) -> Callable[[_Callable], _Callable]:
    """Make a function or a class refuse former names of its options.

    Parameters
    ----------
    keywords : str, optional
        For a method whose options must be given by name: the text that the error for a positional value recommends.
    **names
        For each former name, what to use in its place. A class refuses the attributes with these names too.
    """

    def decorate(target: _Callable) -> _Callable:
        if isinstance(target, type):
            init = "__init__"
            setattr(target, init, _checked(getattr(target, init), target.__name__, keywords, names))

            def missing(self: object, name: str) -> Any:
                raise refusal(name, type(self).__name__, names)

            # `__getattr__` is called for names that the object does not have.
            target.__getattr__ = missing  # type: ignore[attr-defined]
            return target
        owner = target.__qualname__.rpartition("<locals>.")[2].removesuffix(".__init__")
        checked: _Callable = _checked(target, owner, keywords, names)
        return checked

    return decorate


def refusal(name: str, owner: str, names: Mapping[str, str]) -> AttributeError:
    """Make the error for an attribute that `owner` does not have; `names` has the former ones."""
    if name in names:
        return FormerNameError(f"{name}: {owner} no longer has this name; use {names[name]}")
    return AttributeError(f"{owner!r} has no attribute {name!r}")


def _checked(function: Any, owner: str, keywords: str, names: Mapping[str, str]) -> Any:
    @functools.wraps(function)
    def checked(*args: Any, **options: Any) -> Any:
        for name in names.keys() & options.keys():
            raise FormerNameError(f"{name}: {owner}() no longer has this option; use {names[name]}")
        if keywords and len(args) > 1:
            raise FormerNameError(f"{owner}: takes no value without a name, got {args[1]!r}; use {keywords}")
        return function(*args, **options)

    return checked
