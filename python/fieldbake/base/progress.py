"""Progress of long work: no output, a bar on stderr, or a callable that the user supplies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import Any

from .. import _core
from . import checks
from .errors import ArgumentError

Progress = bool | Callable[[float], object] | None

#: Duration after which work on a terminal shows a bar without request, seconds.
DELAY = 3.0

#: Shortest time between two updates of the bar in a notebook, seconds.
NOTEBOOK_STEP = 0.2


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


class _Whole:
    """Progress of work that consists of several jobs of the core. The fraction never decreases."""

    def __init__(self, callback: Callable[[float], object]) -> None:
        self._callback = callback
        self._reached = 0.0
        #: Fractions of the whole at the start and at the end of the current part.
        self.range = (0.0, 1.0)

    def __call__(self, fraction: float) -> None:
        first, last = self.range
        self._reached = max(self._reached, first + (last - first) * fraction)
        self._callback(self._reached)


_whole: ContextVar[_Whole | None] = ContextVar("whole", default=None)


@contextmanager
def watched(progress: Progress, label: str) -> Iterator[None]:
    """Report the progress of all jobs of the core in the block as one; `part` divides it.

    Parameters
    ----------
    progress, label
        As for `progress_callback`.
    """
    with progress_callback(progress, label) as callback:
        if callback is None:
            yield
            return
        whole = _Whole(callback)
        token = _whole.set(whole)
        watcher = _core.watch(whole)
        try:
            yield
        finally:
            _core.watch(watcher)
            _whole.reset(token)
        callback(1.0)


@contextmanager
def part(first: float, last: float) -> Iterator[None]:
    """Run a part of the work in a `watched` block: jobs advance it from one fraction of the outer part to another."""
    whole = _whole.get()
    if whole is None:
        yield
        return
    outer = low, high = whole.range
    whole.range = (low + (high - low) * first, low + (high - low) * last)
    try:
        yield
    finally:
        whole.range = outer


def _bar(stack: ExitStack, label: str, delay: float) -> Callable[[float], object]:
    """Make a callable that draws a bar once `delay` seconds have passed; `stack` removes it."""
    if _is_notebook():
        return _notebook_bar(stack, label, delay)
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


def _is_notebook() -> bool:
    """Whether the process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


def _notebook_bar(stack: ExitStack, label: str, delay: float) -> Callable[[float], object]:
    """A bar of HTML in the output of a cell, removed at the end. The bars of rich leave an empty widget there."""
    from html import escape

    from IPython import display

    make: Callable[[str], Any] = display.HTML
    show: Callable[..., Any] = display.display
    shown: list[Any] = []
    start = time.monotonic()
    next_time = start + delay

    def update(share: float) -> None:
        nonlocal next_time
        now = time.monotonic()
        if now < next_time:
            return
        next_time = now + NOTEBOOK_STEP
        left = f" {_duration((now - start) * (1 - share) / share)} left" if share > 0 else ""
        bar = make(f'{escape(label)} <progress max="1" value="{share:.3f}"></progress>{left}')
        if shown:
            shown[0].update(bar)
        else:
            shown.append(show(bar, display_id=True))
            stack.callback(lambda: shown[0].update(make("")))

    return update


def _duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, second = divmod(round(seconds), 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour}:{minute:02}:{second:02}"


def part_of(callback: Callable[[float], object] | None, number: int, count: int) -> Callable[[float], object] | None:
    """Map the fraction of job `number`, one of `count` equal jobs, to the fraction of all of them."""
    return None if callback is None else lambda share: callback((number + share) / count)
