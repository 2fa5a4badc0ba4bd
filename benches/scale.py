"""Grids beyond memory and libraries of assets: plan, shards by workers, peak memory of a worker, assets per minute.

    python benches/scale.py bunny.obj --resolution 1024

A worker is a fresh process. Times of wall need an idle machine.
"""

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import fieldbake as fb
from fieldbake.scaling.stores import shard_plan, shards, store
from fieldbake.scaling.stores.zarr_bake import _checked_layout
from measuring import peak_mib, reset_peak


def measure_plan(resolution):
    """Plan of a sphere: seconds of the processor, peak memory above the start, stored shards."""
    ball = fb.sphere(1).to_mesh(128)
    reset_peak()
    before, start = peak_mib(), time.process_time()
    layout, mesh = _checked_layout(ball, resolution, 3, 256, 32, "snorm16", None, 0.1, "auto")
    stored = [int(shard_plan.stored_shards(mesh, layout, level)[0].sum()) for level in range(layout.level_count)]
    return time.process_time() - start, peak_mib() - before, stored


def ready(place, layout):
    """Open the mesh of a store in this process and build its tree, as the first task of a worker does."""
    shards.mesh_of(place, layout)._core.topology()
    reset_peak()
    return peak_mib()


def work(place, layout, index, threads):
    """Bake one shard in this worker process; seconds of the processor, and peak memory, MiB."""
    start = time.process_time()
    shards.store_shard(place, layout, 0, index, threads)
    return time.process_time() - start, peak_mib()


def prepared(path, resolution, folder):
    """A store without shards, and the near shards of level 0."""
    layout, mesh = _checked_layout(path, resolution, 3, 256, 32, "snorm16", None, 0.1, "auto")
    place = store.Place.of(folder / "k.zarr", None)
    store.create(place, None, layout, mesh, {})
    _, near = shard_plan.stored_shards(mesh, layout, 0)
    return place, layout, mesh, [tuple(row) for row in shard_plan.morton_order(np.argwhere(near)).tolist()]


def timed_workers(place, layout, tasks, processes):
    """Bake shards by processes of one thread, one shard a task.

    Returns seconds of wall, seconds of the processor, and memory of a worker before and at its peak, MiB.
    """
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        # More tasks than processes, so that every process opens the mesh before the clock starts.
        before = list(pool.map(ready, [place] * 4 * processes, [layout] * 4 * processes))
        start = time.perf_counter()
        threads = [shards.Threads(1)] * len(tasks)
        rows = list(pool.map(work, [place] * len(tasks), [layout] * len(tasks), tasks, threads))
        wall = time.perf_counter() - start
    return wall, sum(seconds for seconds, _ in rows), max(before), max(peak for _, peak in rows)


def measure_workers(path, resolution, count, pairs):
    """Near shards by one process of one thread and by two of them, alternately."""
    with tempfile.TemporaryDirectory() as folder:
        place, layout, mesh, near = prepared(path, resolution, Path(folder))
        near = near[: 2 * count]
        runs = [[timed_workers(place, layout, near, processes) for processes in (1, 2)] for _ in range(pairs)]
    shard = 256**3 * 2 / 2**20
    print(f"{len(near)} near shards at {resolution}^3, seconds of wall (of the processor)")
    for one, two in runs:
        ratio = one[0] / two[0]
        print(f"  one process {one[0]:.1f} ({one[1]:.1f}), two {two[0]:.1f} ({two[1]:.1f}): {ratio:.2f} times as fast")
    before, after = (max(run[i] for pair in runs for run in pair) for i in (2, 3))
    print(f"  peak memory {before:.0f} MiB with the mesh ({mesh.nbytes / 2**20:.0f} MiB), {after:.0f} MiB with shards")
    print(f"  that is {after - before - shard:.0f} MiB besides the shard of {shard:.0f} MiB")


def measure_loop(knots, resolution):
    """Assets a minute by a plain loop over trimesh and igl with the same grids and files, None without igl."""
    try:
        import igl
        import trimesh
    except ImportError:
        return None
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        for stem, knot in knots.items():
            mesh = trimesh.Trimesh(knot.vertices, knot.faces, process=False)
            center, side = mesh.bounds.mean(axis=0), mesh.extents.max() * 1.1 / resolution
            counts = np.ceil(mesh.extents * 1.1 / side).astype(int)
            axes = [center[i] + (np.arange(counts[i]) - (counts[i] - 1) / 2) * side for i in range(3)]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
            distances = igl.signed_distance(points, mesh.vertices, mesh.faces)[0]
            np.savez(Path(folder) / f"{stem}.npz", distances=distances.reshape(counts).astype(np.float32))
        return 60 * len(knots) / (time.perf_counter() - start)


def measure_assets(count, resolution):
    """Assets a minute by bake_many, and by a plain loop over trimesh and igl for the first 40 of them."""
    rng = np.random.default_rng(0)
    knots = {f"knot-{i}": fb.models.torus_knot(segments=int(rng.integers(48, 96)), sides=8) for i in range(count)}
    whole = dict(list(knots.items())[:40])
    for i, stem in enumerate(list(knots)[:: max(1, count // 5)][:5]):
        knots[stem] = ([(0, 0, i)], [(0, 0, 0)])
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        rows = fb.bake_many(knots, folder, resolution=resolution)
        first = time.perf_counter() - start
        start = time.perf_counter()
        again = fb.bake_many(knots, folder, resolution=resolution)
        second = time.perf_counter() - start
    done = [sum(row["status"] == status for row in rows) for status in ("done", "failed")]
    computed = sum(row["status"] == "done" for row in again)
    print(f"{count} assets at {resolution}^3: {done[0]} done, {done[1]} failed, {60 * count / first:.0f} a minute")
    print(f"  second run: {computed} computed, {second:.1f} s")
    if (rate := measure_loop(whole, resolution)) is not None:
        print(f"  a plain loop over trimesh and igl: {rate:.0f} a minute")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("--resolution", type=int, default=1024)
    parser.add_argument("--shards", type=int, default=8, help="near shards of each of two workers")
    parser.add_argument("--pairs", type=int, default=3, help="runs of one process beside two")
    parser.add_argument("--assets", type=int, default=2000)
    arguments = parser.parse_args()
    for resolution in (1024, 2048, 4096, 8192):
        seconds, memory, stored = measure_plan(resolution)
        print(f"plan of a sphere, {resolution}^3: {seconds:.2f} s of processor time, {memory:.0f} MiB, stored {stored}")
    measure_workers(arguments.mesh, arguments.resolution, arguments.shards, arguments.pairs)
    if arguments.assets:
        measure_assets(arguments.assets, 32)


if __name__ == "__main__":
    main()
