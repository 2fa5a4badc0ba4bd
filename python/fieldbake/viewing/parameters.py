"""Numbers of a shape as the parameters of a view: a function that makes the shape again from other numbers."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from ..base.errors import ArgumentError, ShapeError
from ..shapes import primitives, profiles, screws
from ..shapes.representation import python_text
from ..shapes.shape import Shape

#: Puts another number in the place of one.
Change = Callable[[ast.expr], None]

#: Functions in the text of a shape.
FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(module, name) for module in (primitives, profiles, screws) for name in module.__all__
}


def model_of(shape: Shape, names: Sequence[str]) -> tuple[Callable[..., Shape], dict[str, float]]:
    """A function of the named numbers of a shape that makes the shape again, and their present values.

    A name is the name of an argument, such as ``"radius"``, or has the name of the primitive or method before it, such
    as ``"cylinder.radius"``. A name may belong to several arguments of equal value, which then change together.

    Raises
    ------
    ArgumentError
        For a name that no argument or arguments of several values have, and for a shape with a baked volume.
    """
    try:
        tree = ast.parse(python_text(shape.to_sexpr()), mode="eval")
    except ShapeError as error:
        raise ArgumentError(f"parameters: {error}; pass model=, a function of the parameters") from None
    known = list(_numbers(tree))
    changes: dict[str, list[Change]] = {}
    values: dict[str, float] = {}
    for name in names:
        found = [(change, value) for whole, change, value in known if name in (whole, whole.split(".")[1])]
        if not found:
            have = ", ".join(dict.fromkeys(whole for whole, *_ in known)) or "none"
            raise ArgumentError(
                f"parameters: the shape has no number {name!r}; it has {have}; or pass model=, a function of them"
            )
        if len({value for _, value in found}) > 1:
            listed = ", ".join(f"{value:g}" for _, value in found)
            raise ArgumentError(
                f"parameters: {name!r} names arguments with the values {listed}; pass model=, a function of them"
            )
        changes[name] = [change for change, _ in found]
        values[name] = found[0][1]

    def model(**numbers: float) -> Shape:
        for name, number in numbers.items():
            for change in changes[name]:
                change(ast.Constant(float(number)))
        code = compile(ast.fix_missing_locations(tree), "<shape>", "eval")
        made = eval(code, {"__builtins__": {}, **FUNCTIONS})
        assert isinstance(made, Shape)
        return made

    return model, values


def _numbers(tree: ast.AST) -> Iterator[tuple[str, Change, float]]:
    """The numbers among the arguments of all calls: "call.argument", what replaces the number, its value."""
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call):
            continue
        if isinstance(call.func, ast.Attribute):
            name = call.func.attr
            names = list(inspect.signature(getattr(Shape, name)).parameters)[1:]
        else:
            assert isinstance(call.func, ast.Name)
            name = call.func.id
            names = list(inspect.signature(FUNCTIONS[name]).parameters)
        # Operands of a union come as one parameter of any number, which zip leaves out after the first.
        named = [
            (partial(call.args.__setitem__, i), *pair) for i, pair in enumerate(zip(names, call.args, strict=False))
        ]
        named += [(partial(setattr, word, "value"), str(word.arg), word.value) for word in call.keywords]
        for change, argument, node in named:
            try:
                value = ast.literal_eval(node)
            except ValueError:
                continue
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                yield f"{name}.{argument}", change, float(value)
