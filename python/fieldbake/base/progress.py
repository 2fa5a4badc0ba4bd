"""Progress of long work: no output, a bar on stderr, or a callable that the user supplies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from . import checks
from .errors import ArgumentError

Progress = bool | Callable[[float], object] | None

#: Duration after which work on a terminal shows a bar without request, seconds.
DELAY = 3.0


@contextmanager
def progress_callback(progress: Progress, label: str) -> Iterator[Callable[[float], object] | None]:
    """Yield the callable that the core calls with the finished fraction from 0 to 1, or None.

    ``True`` draws a bar on stderr that vanishes when the work is done. ``None`` draws it after `DELAY` seconds if
    stderr is a terminal.
    """
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    if progress is False or (progress is None and not is_terminal):
        yield None
    elif progress is None or progress is True:
        with ExitStack() as stack:
            yield _bar(stack, label, DELAY if progress is None else 0.0)
    elif callable(progress):
        yield progress
    else:
        raise ArgumentError(f"progress: must be True, False, None or a callable, got {checks.describe(progress)}")


def _bar(stack: ExitStack, label: str, delay: float) -> Callable[[float], object]:
    """Make a callable that draws a bar once `delay` seconds have passed; `stack` removes it."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    start = time.monotonic()
    bar = Bar(console=Console(stderr=True), transient=True)
    task = bar.add_task(label, total=1.0)

    def update(share: float) -> None:
        bar.update(task, completed=share)
        if not bar.live.is_started and time.monotonic() - start >= delay:
            stack.enter_context(bar)

    return update


def part_of(callback: Callable[[float], object] | None, number: int, count: int) -> Callable[[float], object] | None:
    """Map the fraction of job `number`, one of `count` equal jobs, to the fraction of all of them."""
    return None if callback is None else lambda share: callback((number + share) / count)
