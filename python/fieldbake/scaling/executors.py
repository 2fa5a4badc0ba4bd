"""Tasks on any executor: threads or processes of `concurrent.futures`, a Dask client, or anything with ``submit``."""

from __future__ import annotations

import os
import queue
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any

from ..base import checks
from ..base.errors import ArgumentError
from ..base.optional import optional_module

#: Tasks under way for each worker: one that runs and others that wait beside it.
BACKLOG = 4

#: Time after which the workers are counted again, seconds.
RECOUNT = 1.0

#: Longest wait for a finished task, seconds. Ctrl-C interrupts the program between two waits on every platform.
WAIT = 0.2

#: How often Dask repeats a task whose worker died.
RETRIES = 2


def checked_executor(executor: Any) -> Any:
    """Check that an executor is None, an address or an object with ``submit``."""
    if executor is not None and not isinstance(executor, str) and not callable(getattr(executor, "submit", None)):
        raise ArgumentError(
            "executor: must be None, a pool of concurrent.futures, a dask.distributed.Client, the address of a "
            f"scheduler or another object with submit, got {checks.describe(executor)}"
        )
    return executor


@contextmanager
def opened(executor: Any) -> Iterator[Any]:
    """Yield an executor; for the address of a Dask scheduler a client, which is closed at the end."""
    if not isinstance(executor, str):
        yield executor
        return
    distributed = optional_module("distributed", "the address of a scheduler as executor", extra="dask")
    try:
        client = distributed.Client(executor)
    except (OSError, ValueError) as error:
        raise ArgumentError(f"executor: there is no Dask scheduler at {executor!r}: {error}") from error
    with client:
        yield client


def dask_client(executor: Any) -> Any:
    """Return the client of dask.distributed that an executor is or that its ``get_executor`` has; None for others."""
    if type(executor).__module__.partition(".")[0] != "distributed":
        return None
    client = getattr(executor, "_client", executor)
    return client if hasattr(client, "nthreads") else None


def is_local(executor: Any) -> bool:
    """Whether tasks run in this process: without an executor, or in a pool of threads."""
    return executor is None or isinstance(executor, ThreadPoolExecutor)


def worker_count(executor: Any) -> int:
    """Number of tasks that run at the same time; the number of cores if the executor does not state it."""
    client = dask_client(executor)
    if client is not None:
        return max(1, sum(int(threads) for threads in client.nthreads().values()))
    # Pools of concurrent.futures have the first attribute, pools of mpi4py the second.
    for name in ("_max_workers", "num_workers"):
        count = getattr(executor, name, None)
        if isinstance(count, int) and count > 0:
            return count
    return available_cores()


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def threads_per_worker(executor: Any) -> int | None:
    """Threads for each worker so that all of them together use the cores once; None for workers in this process.

    If the variable ``RAYON_NUM_THREADS`` is set, it decides.
    """
    if is_local(executor) or "RAYON_NUM_THREADS" in os.environ:
        return None
    if dask_client(executor) is not None:
        # A worker of Dask runs one task in each of its threads.
        return 1
    return max(1, available_cores() // worker_count(executor))


def run_tasks(
    executor: Any,
    function: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    on_abandon: Callable[[], object] = lambda: None,
) -> Iterator[tuple[int, Any, BaseException | None]]:
    """Call ``function(*task)`` for each task; yield its index with the result or the exception, as they finish.

    Only a few tasks for each worker are submitted ahead; clusters may grow meanwhile. If the caller stops the
    iteration, tasks that have not started are cancelled, `on_abandon` is called, and the running tasks are waited for.
    Futures need ``result``, ``done``, ``cancel`` and ``add_done_callback``.
    """
    options = {"pure": False, "retries": RETRIES} if dask_client(executor) is executor is not None else {}
    finished: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    running: dict[int, Any] = {}
    room, next_count = 0, 0.0
    following = 0
    try:
        while following < len(tasks) or running:
            if time.monotonic() >= next_count:
                room, next_count = BACKLOG * worker_count(executor), time.monotonic() + RECOUNT
            while following < len(tasks) and len(running) < room:
                index = following
                try:
                    future = executor.submit(function, *tasks[index], **options)
                except Exception as error:  # a broken pool refuses tasks
                    following += 1
                    yield index, None, error
                    continue
                running[index] = future
                following += 1
                future.add_done_callback(lambda done, index=index: finished.put((index, done)))
            try:
                index, future = finished.get(timeout=WAIT)
            except queue.Empty:
                continue
            del running[index]
            result, failure = _outcome(future)
            # A future of Dask keeps its result on the cluster while it lives.
            del future
            yield index, result, failure
    finally:
        for future in running.values():
            future.cancel()
        if running:
            on_abandon()
        while any(not _is_done(future) for future in running.values()):
            with suppress(queue.Empty):
                finished.get(timeout=WAIT)


def _outcome(future: Any) -> tuple[Any, BaseException | None]:
    try:
        return future.result(), None
    except Exception as failure:
        return None, failure


def _is_done(future: Any) -> bool:
    return bool(future.done())
