"""Solids beside other tools: time, memory and accuracy of extraction, offsets, repair, shapes and Booleans.

    python benches/solids_peers.py --models FOLDER [-r 256] [--only NAME ...]

`--models` has stanford-bunny.obj, teapot.obj and fandisk.obj. Times are the least processor time of some calls. Other
tools are measured where they are installed: scikit-image, sdf-fork, libigl, point-cloud-utils and manifold3d. The
offset at 1024 voxels runs in a process of its own, so that its peak memory is known.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import fieldbake as fb

#: libigl evaluates every this many slices of the grid; its time is the time of these slices, times this number.
EVERY_SLICE = 32

#: Radius, voxels, of the ball around a corner or a point of an edge in which there may be no other sharp edge.
CLEAR = 1.25


def least(call, rounds=3):
    """The least processor time and the result of a call."""
    times = []
    for _ in range(rounds):
        start = time.process_time()
        result = call()
        times.append(time.process_time() - start)
    return min(times), result


def diagonal(mesh):
    return float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]))


def extraction(options):
    """`to_mesh` beside marching cubes."""
    mesh = fb.load_mesh(options.models / "stanford-bunny.obj")
    volume = fb.bake(mesh, 128)
    seconds, made = least(volume.to_mesh, 7)
    smooth, _ = least(lambda: volume.to_mesh(sharp=False), 7)
    voxel = volume.spacing.max()
    to, back = (made._core.deviation(mesh._core)[0], mesh._core.deviation(made._core)[0])
    error = np.abs(fb.closest_point(mesh, made.vertices).distances).mean() / voxel
    print(f"to_mesh 128: {seconds:.3f} s, sharp=False {smooth:.3f} s")
    print(f"  mean distance of vertices {error:.4f} voxels, largest two-way {to / voxel:.3f} and {back / voxel:.3f}")
    from skimage.measure import marching_cubes

    distances = np.asarray(volume.distances)
    seconds, (vertices, *_) = least(lambda: marching_cubes(distances, 0.0), 7)
    error = fb.closest_point(mesh, volume.origin + vertices * volume.spacing).distances.mean() / voxel
    print(f"  scikit-image, marching cubes: {seconds:.3f} s, mean distance of vertices {error:.4f} voxels")


def large(options):
    """An offset at 1024 voxels in a process of its own."""
    command = [sys.executable, __file__, "--models", str(options.models), "--only", "offset_alone"]
    print(subprocess.run(command, capture_output=True, text=True, check=True).stdout, end="")


def offset_alone(options):
    mesh = fb.load_mesh(options.models / "stanford-bunny.obj")
    start, used = time.perf_counter(), time.process_time()
    made = fb.offset(mesh, 0.02 * diagonal(mesh), 1024)
    seconds, used = time.perf_counter() - start, time.process_time() - used
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    print(f"offset 1024: {seconds:.1f} s, processors {used:.1f} s, {len(made.faces):,} faces, peak {peak:.2f} GB")


def saving(_options):
    """The model of the README of fogleman's sdf at 4 million samples, beside sdf-fork."""
    import sdf

    bore = fb.cylinder(0.5, 4)
    ours = (fb.sphere(1) & fb.box(1.5)) - (bore | bore.rotate((1, 0, 0), 90) | bore.rotate((0, 1, 0), 90))
    other = sdf.sphere(1) & sdf.box(1.5)
    theirs = sdf.cylinder(0.5)
    other -= theirs.orient(sdf.X) | theirs.orient(sdf.Y) | theirs.orient(sdf.Z)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        # 2^22 samples of a cube.
        seconds, _ = least(lambda: ours.save(path, round(2 ** (22 / 3))))
        size = (path.stat().st_size - 84) // 50
        print(f"shape.save: {seconds:.2f} s, {size:,} faces")
        import trimesh

        loaded = trimesh.load(path)
        print(f"  read back by trimesh: watertight {loaded.is_watertight}, volume {loaded.volume:.6f}")
        least(lambda: other.save(str(path), samples=2**22, verbose=False), 1)
        seconds, _ = least(lambda: other.save(str(path), samples=2**22, verbose=False))
        print(f"  sdf-fork: {seconds:.2f} s, {(path.stat().st_size - 84) // 50:,} faces")


def repair(options):
    """`solid` of an open mesh at 512 voxels beside libigl with marching cubes, and the Manifold of J. Huang."""
    mesh = fb.load_mesh(options.models / "teapot.obj")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    seconds, made = least(lambda: fb.solid(fb.Mesh(vertices, faces), 512), 1)
    print(f"solid of the teapot, 512 voxels: {seconds:.1f} s, {len(made.faces):,} faces, closed {made.is_closed}")

    import igl
    from skimage.measure import marching_cubes

    extent = mesh.bounds[1] - mesh.bounds[0]
    voxel = extent.max() / 510
    counts = np.ceil(extent / voxel).astype(int) + 2
    x, y, z = (low - voxel / 2 + voxel * np.arange(n) for low, n in zip(mesh.bounds[0], counts, strict=True))

    def signed_distances(slices):
        points = np.stack(np.meshgrid(x, y, slices, indexing="ij"), axis=-1).reshape(-1, 3)
        kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
        return igl.signed_distance(points, vertices, faces.astype(np.int64), sign_type=kind)[0]

    seconds, _ = least(lambda: [signed_distances(z[i : i + 1]) for i in range(0, len(z), EVERY_SLICE)], 1)
    grid = fb.bake(mesh, voxel_size=voxel)
    extracted, _ = least(lambda: marching_cubes(np.asarray(grid.distances), 0.0), 1)
    share = len(z) / len(range(0, len(z), EVERY_SLICE))
    print(
        f"  libigl, {' x '.join(map(str, counts))} samples: {seconds * share:.0f} s, from every {EVERY_SLICE}th slice; "
        f"marching cubes of scikit-image {extracted:.1f} s"
    )

    import point_cloud_utils

    for resolution in (20_000, 100_000):
        call = lambda count=resolution: point_cloud_utils.make_mesh_watertight(vertices, faces, count)  # noqa: E731
        seconds, (_, closed) = least(call, 1)
        print(f"  Manifold of J. Huang, resolution {resolution:,}: {seconds:.1f} s, {len(closed):,} faces")


def jobs(options):
    """Time and two-way distance of solids, offsets and shells."""
    mesh = fb.load_mesh(options.models / "stanford-bunny.obj")
    thickness, resolution = 0.02 * diagonal(mesh), options.resolution
    calls = {
        "solid": lambda: fb.solid(mesh, resolution),
        "solid, outer": lambda: fb.solid(mesh, resolution, fill="outer"),
        "offset": lambda: fb.offset(mesh, thickness, resolution),
        "shell": lambda: fb.shell(mesh, thickness, resolution),
    }
    for name, call in calls.items():
        seconds, made = least(call, 1)
        start = time.process_time()
        to, back = made.report.distance_to_source, made.report.distance_from_source
        measured = time.process_time() - start
        voxel = made.report.voxel_size
        print(
            f"{name} {resolution}: {seconds:.2f} s, {len(made.faces):,} faces, "
            f"{to / voxel:.3f} voxels to the source and {back / voxel:.3f} from it ({measured:.2f} s)"
        )


def booleans(options):
    """Booleans beside manifold3d, of clean operands and of one with an opening."""
    import manifold3d

    def solid(mesh):
        parts = np.array(mesh.vertices, np.float32, order="C"), np.array(mesh.faces, np.uint32, order="C")
        return manifold3d.Manifold(manifold3d.Mesh(*parts))

    operators = {"union": "__add__", "intersection": "__xor__", "difference": "__sub__"}
    ball, knot = fb.sphere(1.0).to_mesh(64), fb.models.torus_knot()
    opened = fb.Mesh(ball.vertices, ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] < 0.95])
    pairs = {"knot and ball": (knot, ball), "knot and open ball": (knot, opened)}
    for name, (a, b) in pairs.items():
        for op, operator in operators.items():
            call = lambda op=op, a=a, b=b: fb.boolean(op, a, b, resolution=options.resolution)  # noqa: E731
            seconds, made = least(call, 1)
            exact_seconds, exact = least(lambda o=operator, a=a, b=b: getattr(solid(a), o)(solid(b)))
            status = exact.status().name
            volume = exact.volume()
            text = f"volume {volume:.5f}, ours {made.volume / volume - 1:+.3%}" if volume else "no result"
            print(
                f"{op} of {name}, {options.resolution} voxels: {seconds:.2f} s, volume {made.volume:.5f}; "
                f"manifold3d {exact_seconds:.3f} s, {status}, {text}"
            )


def corners(options):
    """Distance of corners and edges of known solids from the extracted surface, voxels."""
    turn = (np.array([1.0, 2.0, 3.0]) / np.sqrt(14)).tolist()
    half = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T.astype(float)
    for name, shape in (("cube", fb.box(2)), ("turned cube", fb.box(2).rotate(turn, 40))):
        matrix = np.eye(3) if name == "cube" else turned(turn, 40)
        made = shape.to_mesh(64)
        voxel = 2.0 / 64
        local = made.vertices @ matrix
        at_corners = max(np.linalg.norm(local - corner, axis=1).min() for corner in half)
        off = np.abs(np.abs(local).max(axis=1) - 1).max()
        print(f"{name}, 64 voxels: corners {at_corners / voxel:.4f}, edges and faces {off / voxel:.4f} voxels")
    # A cylinder cut by an oblique plane: both of its rims are sharp.
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    made = (fb.cylinder(1.0, 3.0) & fb.plane(normal.tolist(), -0.4)).to_mesh(64)
    voxel = 3.0 / 64
    radius, height = np.hypot(made.vertices[:, 0], made.vertices[:, 1]), made.vertices[:, 2]
    cut = made.vertices @ normal
    plane = np.median(cut[(radius < 0.9) & (height > -1.4)])
    field = np.maximum(np.maximum(radius - 1, np.abs(height) - 1.5), cut - plane)
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rim = np.column_stack([circle, (plane - circle @ normal[:2]) / normal[2]])
    to_rim = fb.closest_point(made, rim).distances.max()
    print(f"cut cylinder, 64 voxels: vertices {np.abs(field).max() / voxel:.4f}, rim {to_rim / voxel:.4f} voxels")
    fandisk = fb.load_mesh(options.models / "fandisk.obj")
    for resolution in (32, 64, 128):
        features_of(fandisk, resolution)


def features_of(mesh, resolution):
    """Distance of clear corners and straight edges of a mesh from the extracted surface, voxels.

    A corner is clear if all points of sharp edges (20 degrees or more) within `CLEAR` voxels lie on its own edges.
    A point of an edge is clear if they lie on the line of the edge: the edge is straight there, and no other is near.
    """
    from scipy.spatial import cKDTree

    volume = fb.bake(mesh, resolution)
    made, voxel = volume.to_mesh(), volume.spacing.max()
    vertices, normals = np.array(mesh.vertices), np.array(mesh.face_normals)
    faces = np.array(mesh.faces, dtype=np.int64)
    sides = np.sort(np.concatenate([np.roll(faces, -i, axis=1)[:, :2] for i in range(3)]), axis=1)
    order = np.lexsort(sides.T)
    pairs = np.flatnonzero((np.diff(sides[order], axis=0) == 0).all(axis=1))
    first, second = (order[pairs + i] % len(faces) for i in (0, 1))
    edges = sides[order[pairs[(normals[first] * normals[second]).sum(axis=1) < np.cos(np.radians(20))]]]
    corners = np.flatnonzero(np.bincount(edges.ravel()) >= 3)

    starts, along = vertices[edges[:, 0]], np.diff(vertices[edges], axis=1)[:, 0]
    counts = np.maximum(2, np.ceil(np.linalg.norm(along, axis=1) / (voxel / 8))).astype(int)
    rows = np.repeat(np.arange(len(edges)), counts)
    shares = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
    points, lines = starts[rows] + along[rows] * shares[:, None], along[rows]
    tree = cKDTree(points)

    def clear(at, rays, both_ways):
        """Whether the points of edges around `at` lie on one of some rays, or lines, from there."""
        away = points[tree.query_ball_point(at, CLEAR * voxel)] - at
        rays = rays / np.linalg.norm(rays, axis=1)[:, None]
        reach = away @ rays.T
        off = away[:, None] - (reach if both_ways else np.maximum(reach, 0))[:, :, None] * rays
        return np.linalg.norm(off, axis=2).min(axis=1).max() <= 0.02 * voxel

    own = [vertices[edges[(edges == corner).any(axis=1)].sum(axis=1) - corner] - vertices[corner] for corner in corners]
    is_clear = np.array([clear(vertices[corner], rays, False) for corner, rays in zip(corners, own, strict=True)])
    is_straight = np.array([clear(at, line[None], True) for at, line in zip(points, lines, strict=True)])
    at_corners = np.array([np.linalg.norm(made.vertices - vertices[corner], axis=1).min() for corner in corners])
    at_edges = fb.closest_point(made, points[is_straight]).distances / voxel
    off = np.abs(fb.signed_distance(mesh, made.vertices)) / voxel
    print(
        f"{resolution} voxels: {is_clear.sum()} of {len(corners)} corners clear, off by "
        f"{at_corners[is_clear].max() / voxel:.4f}, all by {at_corners.max() / voxel:.4f}; {is_straight.mean():.0%} of "
        f"the edges clear and straight, off by {at_edges.max():.4f}, {(at_edges > 0.02).mean():.2%} by more than 0.02; "
        f"vertices off by {off.mean():.5f}, {np.mean(off > 0.02):.2%} by more than 0.02"
    )


def turned(axis, degrees):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def gyroid(options):
    """The volume fraction of a graded gyroid in the bunny, beside samples of the field, and its STL file."""
    import trimesh

    mesh = fb.load_mesh(options.models / "stanford-bunny.obj")
    size = mesh.bounds[1] - mesh.bounds[0]
    body = fb.volume_shape(fb.bake(mesh, 64))
    height = fb.plane("z", float(mesh.bounds[0][2]))
    lattice = body & fb.gyroid(size.max() / 6, height.times(0.03, add=0.005 * size.max()))
    made = lattice.to_mesh(200)
    points = np.random.default_rng(0).uniform(*mesh.bounds, (4_000_000, 3))
    within = body.distance(points) < 0
    expected = np.count_nonzero(lattice.distance(points) < 0) / np.count_nonzero(within)
    inside = body.to_mesh(200).volume
    fraction = made.volume / inside
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lattice.stl"
        lattice.save(path, 200)
        loaded = trimesh.load(path)
    print(
        f"graded gyroid in the bunny, 200 voxels: fraction {fraction:.4f}, 4 million samples {expected:.4f} "
        f"({fraction / expected - 1:+.2%}); {len(made.faces):,} faces, STL watertight {loaded.is_watertight}, "
        f"volume of the file {loaded.volume / made.volume - 1:+.1e}"
    )


TABLES = (extraction, jobs, large, saving, repair, booleans, corners, gyroid)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("-r", "--resolution", type=int, default=256)
    parser.add_argument("--only", nargs="+", default=[table.__name__ for table in TABLES])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    tables = {table.__name__: table for table in (*TABLES, offset_alone)}
    for name in options.only:
        try:
            tables[name](options)
        except ImportError as error:
            print(f"{name}: {error.name} is not installed")
        if name != "offset_alone":
            print(f"  load average {os.getloadavg()[0]:.1f}", flush=True)


if __name__ == "__main__":
    main()
