"""Solids beside other tools: time and accuracy of extraction, offsets and Booleans.

    python benches/solids.py --mesh stanford-bunny.obj [-r 256] [--large]

Runs alternate in one process, and the least processor time of each is shown. scikit-image and manifold3d are measured
if they are installed. `--large` adds the offset at 1024 voxels with its peak memory.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

import fieldbake as fb


def least(call, rounds=3):
    """The least processor time and the result of a call."""
    times = []
    for _ in range(rounds):
        start = time.process_time()
        result = call()
        times.append(time.process_time() - start)
    return min(times), result


def extraction(mesh, resolution):
    volume = fb.bake(mesh, resolution)
    seconds, made = least(volume.to_mesh)
    smooth, _ = least(lambda: volume.to_mesh(sharp=False))
    voxel = volume.spacing.max()
    error = np.abs(fb.closest_point(mesh, made.vertices).distances).mean() / voxel
    print(
        f"to_mesh {resolution}: {seconds:.3f} s, sharp=False {smooth:.3f} s, "
        f"mean distance of vertices {error:.4f} voxels"
    )
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        return
    distances = np.asarray(volume.distances)
    seconds, (vertices, *_) = least(lambda: marching_cubes(distances, 0.0))
    points = volume.origin + vertices * volume.spacing
    error = fb.closest_point(mesh, points).distances.mean() / voxel
    print(f"marching_cubes of scikit-image: {seconds:.3f} s, mean distance of vertices {error:.4f} voxels")


def solids(mesh, resolution):
    size = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    jobs = {
        "solid": lambda: fb.solid(mesh, resolution),
        "solid, outer": lambda: fb.solid(mesh, resolution, fill="outer"),
        "offset": lambda: fb.offset(mesh, 0.02 * size, resolution),
        "shell": lambda: fb.shell(mesh, 0.02 * size, resolution),
    }
    for name, job in jobs.items():
        seconds, made = least(job, 1)
        start = time.process_time()
        to, back = made.report.distance_to_source, made.report.distance_from_source
        measured = time.process_time() - start
        voxel = made.report.voxel_size
        print(
            f"{name} {resolution}: {seconds:.2f} s, {len(made.faces):,} faces, "
            f"{to / voxel:.3f} voxels to the source and {back / voxel:.3f} from it ({measured:.2f} s)"
        )


def booleans(resolution):
    a, b = fb.models.torus_knot(), fb.sphere(1.0).to_mesh(64)
    seconds, made = least(lambda: fb.boolean("difference", a, b, resolution=resolution), 1)
    print(f"boolean {resolution}: {seconds:.2f} s, volume {made.volume:.5f}")
    try:
        import manifold3d
    except ImportError:
        return

    def solid(mesh):
        parts = np.array(mesh.vertices, np.float32, order="C"), np.array(mesh.faces, np.uint32, order="C")
        return manifold3d.Manifold(manifold3d.Mesh(*parts))

    seconds, exact = least(lambda: (solid(a) - solid(b)).volume())
    print(f"manifold3d: {seconds:.3f} s, volume {exact:.5f}")


def large(mesh):
    size = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    start, used = time.perf_counter(), time.process_time()
    made = fb.offset(mesh, 0.02 * size, 1024)
    seconds, used = time.perf_counter() - start, time.process_time() - used
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"offset 1024: {seconds:.1f} s ({used:.1f} s of processors), {len(made.faces):,} faces, peak {peak:.2f} GiB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mesh", required=True)
    parser.add_argument("-r", "--resolution", type=int, default=256)
    parser.add_argument("--large", action="store_true")
    options = parser.parse_args()
    mesh = fb.load_mesh(options.mesh)
    if options.large:
        large(mesh)
        return
    extraction(mesh, 128)
    solids(mesh, options.resolution)
    booleans(options.resolution)


if __name__ == "__main__":
    main()
