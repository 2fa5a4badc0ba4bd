"""The number of worker threads."""

from __future__ import annotations

from .. import _core
from . import checks


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
    _core.set_threads(checks.integer("n", n, least=1, most=2**16))
