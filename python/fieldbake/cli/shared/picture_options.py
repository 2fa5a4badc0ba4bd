"""The options of pictures on the command line, with the names, defaults and order of :func:`fieldbake.render`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from ...drawing.rendering import Options
from ..commands import parse_size

_Function = TypeVar("_Function", bound=Callable[..., Any])

Size = Annotated[Any, typer.Option(parser=parse_size, metavar="WxH", help="Size of the picture, pixels.")]


def with_picture_options(function: _Function) -> _Function:
    """Give a command that takes them as ``**picture`` the options of a picture that have a help text."""
    # Typer finds its own metadata in annotations that are not text.
    signature, types = inspect.signature(function, eval_str=True), get_type_hints(Options)
    own = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
    added = []
    for option in fields(Options):
        if not (text := option.metadata["help"]):
            continue
        default, kind = option.default, Annotated[types[option.name], typer.Option(help=text)]
        if option.name == "size":
            width, height = Options().size
            default, kind = f"{width}x{height}", Size
        elif isinstance(default, bool):
            kind = Annotated[bool, typer.Option("--" + option.name.replace("_", "-"), help=text)]
        added.append(inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    function.__signature__ = signature.replace(parameters=own + added)  # type: ignore[attr-defined]
    notes = {one.name: one.annotation for one in own + added}
    function.__annotations__ = {**notes, "return": signature.return_annotation}
    return function
