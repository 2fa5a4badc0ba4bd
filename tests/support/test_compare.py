"""The helpers for comparisons fail for NaN and for values beyond the tolerance."""

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from compare import close, exceeds


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1.2])
@pytest.mark.parametrize("swapped", [False, True])
def test_close_fails_on_what_is_not_close(bad, swapped):
    pair = [np.array([0.0, bad, 2.0]), np.array([0.0, 1.0, 2.0])]
    with pytest.raises(AssertionError):
        close(*(pair[::-1] if swapped else pair), 0.1)


def test_close_fails_on_equal_values_that_are_not_finite_and_on_other_shapes():
    for same in ([np.nan], [np.inf]):
        with pytest.raises(AssertionError, match="not finite"):
            close(same, same, 1.0)
    with pytest.raises(AssertionError, match="shape"):
        close([1.0, 1.0], [1.0], 1.0)
    with pytest.raises(AssertionError, match=r"at \(1,\)"):
        close([1.0, 1.5], [1.0, 1.0], 0.25)
    with pytest.raises(AssertionError):
        close([1.0], [1.0], np.nan)


def test_close_holds_up_to_the_tolerance():
    close([1.0, 2.0], [1.25, 2.0], 0.25)
    close([], [], 0.0)


def test_nan_exceeds_every_limit():
    assert exceeds([0.5, 1.0, 1.5, np.nan, np.inf], 1.0).tolist() == [False, False, True, True, True]


def comparisons_that_nan_passes(text: str) -> Iterator[str]:
    """Assertions of a test file that hold where values are NaN."""

    def is_order(node: ast.AST) -> bool:
        return isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.Lt, ast.LtE, ast.Gt, ast.GtE))

    def counts(node: ast.AST) -> bool:
        """Whether a call counts the elements for which a comparison holds."""
        is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        return is_method and node.func.attr in ("mean", "sum", "any") and is_order(node.func.value)

    for node in ast.walk(ast.parse(text)):
        is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if is_method and node.func.attr == "assert_allclose" and "equal_nan" not in [w.arg for w in node.keywords]:
            yield ast.unparse(node)
        for part in ast.walk(node.test) if isinstance(node, ast.Assert) else ():
            is_few = isinstance(part, ast.Compare) and counts(part.left) and isinstance(part.ops[0], (ast.Lt, ast.LtE))
            is_not = isinstance(part, ast.UnaryOp) and isinstance(part.op, ast.Not)
            if is_few or (is_not and (is_order(part.operand) or counts(part.operand))):
                yield ast.unparse(part)


@pytest.mark.parametrize(
    "text",
    [
        "assert (error > 1e-6).mean() <= 0.01",
        "assert not (error > 1e-6).any()",
        "assert not error > 1e-6",
        "np.testing.assert_allclose(a, b)",
    ],
)
def test_a_comparison_that_nan_passes_is_found(text):
    assert len(list(comparisons_that_nan_passes(text))) == 1
    assert not list(comparisons_that_nan_passes("assert exceeds(error, 1e-6).mean() <= 0.01"))


def test_no_test_has_a_comparison_that_nan_passes():
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    found = {file.name: list(comparisons_that_nan_passes(file.read_text(encoding="utf-8"))) for file in files}
    assert len(files) > 100
    assert {name: texts for name, texts in found.items() if texts} == {}
