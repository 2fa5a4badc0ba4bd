"""Tasks on any executor: threads or processes of `concurrent.futures`, a Dask client, or anything with ``submit``."""

from __future__ import annotations

import os
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ..base import checks
from ..base.errors import ArgumentError

#: Tasks under way for each worker: one that runs and others that wait beside it.
BACKLOG = 4

#: How often Dask repeats a task whose worker died.
RETRIES = 2


def checked_executor(executor: Any) -> Any:
    """Check that an executor is None or an object with ``submit``."""
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise ArgumentError(
            "executor: must be None, a pool of concurrent.futures, a dask.distributed.Client or another object with "
            f"submit, got {checks.describe(executor)}"
        )
    return executor


def is_dask(executor: Any) -> bool:
    """Whether an executor is a client of dask.distributed."""
    return type(executor).__module__.partition(".")[0] == "distributed"


def is_local(executor: Any) -> bool:
    """Whether tasks run in this process: without an executor, or in a pool of threads."""
    return executor is None or isinstance(executor, ThreadPoolExecutor)


def worker_count(executor: Any) -> int:
    """Number of tasks that run at the same time; the number of cores if the executor does not state it."""
    if is_dask(executor):
        return max(1, sum(int(threads) for threads in executor.nthreads().values()))
    count = getattr(executor, "_max_workers", None)
    return count if isinstance(count, int) and count > 0 else available_cores()


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
    if is_dask(executor):
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

    Only a few tasks for each worker are submitted ahead. If the caller stops the iteration, tasks that have not started
    are cancelled, `on_abandon` is called, and the running tasks are waited for.
    """
    options = {"pure": False, "retries": RETRIES} if is_dask(executor) else {}
    finished: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    running: dict[int, Any] = {}
    room = BACKLOG * worker_count(executor)
    following = 0
    try:
        while following < len(tasks) or running:
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
            if not running:
                continue
            index, future = _next(finished)
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
            _next(finished)


def _outcome(future: Any) -> tuple[Any, BaseException | None]:
    try:
        return future.result(), None
    except Exception as failure:
        return None, failure


def _next(finished: queue.SimpleQueue[tuple[int, Any]]) -> tuple[int, Any]:
    """Wait for the next finished task. The wait is divided, so that Ctrl-C interrupts it on every platform."""
    while True:
        try:
            return finished.get(timeout=0.2)
        except queue.Empty:  # noqa: PERF203 - the loop is the wait
            continue


def _is_done(future: Any) -> bool:
    return bool(future.done())
