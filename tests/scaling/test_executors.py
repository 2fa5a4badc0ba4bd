"""Executors of all kinds, their workers and threads, and items whose functions only the main program has."""

import os
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from types import SimpleNamespace

import pytest

import assets
import fieldbake as fb
from fieldbake import _core
from fieldbake.base import threads
from fieldbake.scaling import executors
from fieldbake.scaling.process import Child


@pytest.fixture(scope="module")
def mesh():
    return fb.models.torus_knot(segments=48, sides=6)


def bake(store, mesh, **options):
    pytest.importorskip("zarr")
    return fb.bake_to_zarr(mesh, store, 40, **{"shard": 16, "chunk": 8, **options})


def test_a_time_limit_begins_when_the_process_is_ready():
    child = Child()
    start = time.monotonic()
    child.call(os.getpid)
    seconds = time.monotonic() - start
    child.close()
    # The start takes nearly all of that time; the call itself a few milliseconds.
    assert child.call(os.getpid, limit_s=seconds / 2) > 0
    child.close()


def test_functions_of_the_main_program_have_a_time_limit(tmp_path, monkeypatch):
    pytest.importorskip("cloudpickle")
    items = {
        "sleeper": lambda: time.sleep(600),
        "killer": lambda: os.kill(os.getpid(), 9),
        "box": lambda: assets.box(1),
    }
    rows = fb.bake_many(items, tmp_path / "a", workers=1, limit_s=3, resolution=8)
    assert [row["status"] for row in rows] == ["failed", "failed", "done"]
    assert "limit of 3 s" in rows[0]["error"]
    assert "SIGKILL" in rows[1]["error"]

    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    items = {"sleeper": lambda: time.sleep(600), "box": assets.small_box}
    rows = fb.bake_many(items, tmp_path / "b", workers=1, limit_s=60, resolution=8)
    assert [row["status"] for row in rows] == ["failed", "done"]
    assert "install cloudpickle" in rows[0]["error"]


@pytest.mark.slow
def test_pools_of_processes_bake_functions_of_the_main_program(tmp_path):
    pytest.importorskip("cloudpickle")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        rows = fb.bake_many({"box": lambda: assets.box(1)}, tmp_path, executor=pool, resolution=8)
    assert [row["status"] for row in rows] == ["done"]


class Growing:
    """An executor that gets a second worker after four tasks, and finishes them when eight were submitted."""

    _max_workers = 1

    def __init__(self):
        self.futures = []

    def submit(self, *_):
        self.futures.append(Future())
        if len(self.futures) == 4:
            self._max_workers = 2
        if len(self.futures) == 8:
            self.finish()
        return self.futures[-1]

    def finish(self):
        for future in self.futures:
            if not future.done():
                future.set_result(None)


def test_workers_that_join_a_cluster_get_tasks():
    executor = Growing()
    submitted = []

    def give_up():
        submitted.append(len(executor.futures))
        executor.finish()

    timer = threading.Timer(20, give_up)
    timer.start()
    results = list(executors.run_tasks(executor, print, [()] * 8))
    timer.cancel()
    assert len(results) == 8
    assert not submitted


def test_workers_are_counted():
    assert executors.worker_count(SimpleNamespace(num_workers=3)) == 3
    assert executors.worker_count(SimpleNamespace(_max_workers=5)) == 5
    assert executors.worker_count(SimpleNamespace()) == executors.available_cores()


class Direct:
    """An executor of this process."""

    def submit(self, function, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


@pytest.mark.parametrize("executor", [None, Direct()], ids=["none", "direct"])
def test_the_threads_of_a_bake_are_those_of_the_bake_alone(mesh, tmp_path, monkeypatch, executor):
    counts = []
    monkeypatch.setattr(_core, "set_threads", counts.append)
    monkeypatch.setattr(threads, "_limit", 0)
    bake(tmp_path / "k.zarr", mesh, threads=1, executor=executor)
    assert counts == [1, 0]
    fb.set_threads(2)
    bake(tmp_path / "k.zarr", mesh, threads=1, executor=executor, resume=False)
    assert counts[2:] == [2, 1, 2]


def test_threads_of_python_follow_the_limit(monkeypatch):
    monkeypatch.setattr(_core, "set_threads", lambda _count: None)
    monkeypatch.setattr(threads, "_limit", 0)
    monkeypatch.setenv("RAYON_NUM_THREADS", "not a number")
    assert threads.thread_count() == os.cpu_count()
    monkeypatch.setenv("RAYON_NUM_THREADS", "3")
    assert threads.thread_count() == 3
    fb.set_threads(5)
    with threads.limited_threads(2):
        assert threads.thread_count() == 2
    assert threads.thread_count() == 5


def test_dask_executors_and_addresses(mesh, tmp_path):
    distributed = pytest.importorskip("distributed")
    bake(tmp_path / "here.zarr", mesh)
    with (
        distributed.LocalCluster(
            1, processes=False, threads_per_worker=2, dashboard_address=":0", silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert executors.worker_count(client.get_executor()) == 2
        bake(tmp_path / "a.zarr", mesh, executor=client.get_executor())
        bake(tmp_path / "b.zarr", mesh, executor=cluster.scheduler_address)
    for name in ("a.zarr", "b.zarr"):
        assert (
            fb.open_zarr(tmp_path / name)[:].encoded.tobytes()
            == fb.open_zarr(tmp_path / "here.zarr")[:].encoded.tobytes()
        )
    with pytest.raises(fb.ArgumentError, match="executor: there is no Dask scheduler at 'nonsense://x'"):
        bake(tmp_path / "c.zarr", mesh, executor="nonsense://x")
