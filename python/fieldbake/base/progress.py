"""Progress of long work: no output, a bar on stderr, or a callable that the user supplies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from . import checks
from .errors import ArgumentError

Progress = bool | Callable[[float], object] | None


@contextmanager
def progress_callback(progress: Progress, label: str) -> Iterator[Callable[[float], object] | None]:
    """Yield the callable that the core calls with the finished share from 0 to 1, or None.

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
    """Map the share of job `number`, one of `count` equal jobs, to the share of all of them."""
    return None if callback is None else lambda share: callback((number + share) / count)
