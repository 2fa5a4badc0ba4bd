"""Progress of long work: nothing, a bar on stderr, or a callable of the user's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from . import checks
from .errors import ArgumentError

Progress = bool | Callable[[float], object] | None


@contextmanager
def progress_callback(progress: Progress, label: str) -> Iterator[Callable[[float], object] | None]:
    """Yield what the core calls with a share of 0 to 1, or None.

    ``True`` draws a bar on stderr that vanishes when the work is done.
    """
    if progress is None or progress is False:
        yield None
    elif progress is True:
        from rich.console import Console
        from rich.progress import Progress as Bar

        with Bar(console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(label, total=1.0)
            yield lambda share: bar.update(task, completed=share)
    elif callable(progress):
        yield progress
    else:
        raise ArgumentError(f"progress: must be True, False, None or a callable, got {checks.describe(progress)}")


def part_of(callback: Callable[[float], object] | None, number: int, count: int) -> Callable[[float], object] | None:
    """What reports job `number` of `count` equal ones as a part of the whole."""
    return None if callback is None else lambda share: callback((number + share) / count)
