"""Solids beside other tools: time and accuracy of extraction, offsets and Booleans.

    python benches/solids.py --mesh stanford-bunny.obj [-r 256] [--large]

Runs alternate in one process, and the least processor time of each is shown. scikit-image and manifold3d are measured
if they are installed. `--large` adds the offset at 1024 voxels with its peak memory.
"""

from __future__ import annotations

import argparse

import numpy as np

import fieldbake as fb
from measuring import absent, peak_mib, record, timed


def least(call, rounds=3):
    """The least processor time and the result of a call."""
    times = timed(call, rounds)
    return times.least_cpu, times.result


def extraction(mesh, resolution):
    volume = fb.bake(mesh, resolution)
    extracted, made = least(volume.to_mesh)
    smooth, _ = least(lambda: volume.to_mesh(sharp=False))
    voxel = volume.spacing.max()
    error = np.abs(fb.closest_point(mesh, made.vertices).distances).mean() / voxel
    print(
        f"to_mesh {resolution}: {extracted:.3f} s, sharp=False {smooth:.3f} s, "
        f"mean distance of vertices {error:.4f} voxels"
    )
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        absent("scikit-image", error)
        return
    distances = np.asarray(volume.distances)
    seconds, (vertices, *_) = least(lambda: marching_cubes(distances, 0.0))
    points = volume.origin + vertices * volume.spacing
    error = fb.closest_point(mesh, points).distances.mean() / voxel
    record(f"mesh of a grid, {resolution}^3", "scikit-image", extracted, seconds)
    record(f"mesh of a grid, {resolution}^3, sharp=False", "scikit-image", smooth, seconds)
    print(f"marching_cubes of scikit-image: {seconds:.3f} s, mean distance of vertices {error:.4f} voxels")


def solids(mesh, resolution):
    size = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))
    jobs = {
        "solid": lambda: fb.solid(mesh, resolution),
        "solid, outer": lambda: fb.solid(mesh, resolution, fill="outer", seal=resolution // 6),
        "offset": lambda: fb.offset(mesh, 0.02 * size, resolution),
        "shell": lambda: fb.shell(mesh, 0.02 * size, resolution),
    }
    for name, job in jobs.items():
        seconds, made = least(job, 1)
        report = made.report
        measured, (to, back) = least(lambda report=report: (report.distance_to_source, report.distance_from_source), 1)
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
    times = timed(lambda: fb.offset(mesh, 0.02 * size, 1024))
    print(
        f"offset 1024: {times.least:.1f} s ({times.least_cpu:.1f} s of processors), {len(times.result.faces):,} faces, "
        f"peak {peak_mib() / 1024:.2f} GiB"
    )


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
