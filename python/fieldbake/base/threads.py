"""The number of worker threads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from .. import _core
from . import checks

#: The number that `set_threads` has set; 0 is one thread per core.
_limit = 0


def set_threads(n: int) -> None:
    """Limit the worker threads of this process.

    Parameters
    ----------
    n : int
        Number of threads, at least 1, for later calls. A call in progress keeps its threads.

    Raises
    ------
    ArgumentError
        If `n` is not a whole number of at least 1.

    Notes
    -----
    Results do not depend on the number of threads: the same input gives the same bytes. Without this call there is one
    thread per core, or ``RAYON_NUM_THREADS`` threads if that variable is set. Programs that start one process per core
    should call ``set_threads(1)`` in each: 64 processes of 64 threads each are 4096 threads.

    Examples
    --------
    >>> set_threads(2)
    """
    global _limit
    _limit = checks.integer("n", n, least=1, most=2**16)
    _core.set_threads(_limit)


def thread_count() -> int:
    """The number of threads for work of Python: the limit of `set_threads`, RAYON_NUM_THREADS, or one per core."""
    variable = os.environ.get("RAYON_NUM_THREADS", "")
    return _limit or int(variable if variable.isdecimal() else 0) or os.cpu_count() or 1


@contextmanager
def limited_threads(n: int | None) -> Iterator[None]:
    """Limit the worker threads of this process for the duration of a block; None changes nothing."""
    if n is None:
        yield
        return
    global _limit
    before, _limit = _limit, n
    _core.set_threads(n)
    try:
        yield
    finally:
        _limit = before
        _core.set_threads(before)
