"""Clouds of points against the meshes they were drawn from, beside libigl and Open3D.

    .venv/bin/python benches/points.py sides | speed | orientation | solids | holes [--count 10000]

`sides`: the share of wrong sides and the error of distances for clean and damaged clouds; the truth is libigl's exact
winding number of the mesh. `speed`: winding numbers beside `igl.fast_winding_number`, processor time of all threads.
`orientation`: the share of flipped normals beside Open3D's spanning tree. `solids`: the distance of solids from the
mesh beside Open3D's Poisson reconstruction. `holes`: the voxels whose side is a guess where a fifth of the surface was
not scanned. Meshes come from ``FIELDBAKE_MESHES``.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

import fieldbake as fb
from measuring import peak_mib

Array = NDArray[np.float64]

MESHES = Path(os.environ.get("FIELDBAKE_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))
NAMES = ("armadillo", "fandisk", "rocker-arm", "stanford-bunny", "spot/spot")
#: Most points whose octree of libigl is kept: it is a list of Python lists, which takes 2 GB for 100,000 points.
MOST_REUSED = 400_000
#: A closed scan, a mechanical part, an open head of several parts, a thin-walled pot.
ORIENTED = ("armadillo", "fandisk", "suzanne", "teapot")

#: The cloud with a hole.
MISSING = "a fifth missing"


def load(name: str) -> trimesh.Trimesh:
    """The mesh of a file, with welded vertices."""
    return trimesh.load(MESHES / f"{name}.obj", force="mesh")


def drawn(mesh: trimesh.Trimesh, count: int, seed: int = 0) -> tuple[Array, Array]:
    """Points on a mesh, uniform by area, and their normals."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.asarray(points), np.asarray(mesh.face_normals[faces])


def damaged(mesh: trimesh.Trimesh, kind: str, count: int) -> tuple[Array, Array]:
    """A cloud with one fault; distances of noise are in spacings."""
    random = np.random.default_rng(1)
    points, normals = drawn(mesh, count)
    spacing = np.sqrt(mesh.area / count)
    if kind.startswith("noise"):
        points = points + random.normal(size=points.shape) * float(kind.split()[1]) * spacing
    elif kind == "density 20:1":
        # The chance to stay falls from 1 to 1/20 along the longest axis of the mesh.
        points, normals = drawn(mesh, 4 * count)
        axis = int(np.ptp(points, axis=0).argmax())
        along = (points[:, axis] - points[:, axis].min()) / np.ptp(points[:, axis])
        kept = np.flatnonzero(random.uniform(size=len(points)) < 20.0**-along)[:count]
        points, normals = points[kept], normals[kept]
    elif kind == MISSING:
        center = points[random.integers(count)]
        near = np.argsort(np.linalg.norm(points - center, axis=1))[: count // 5]
        points, normals = np.delete(points, near, axis=0), np.delete(normals, near, axis=0)
    elif kind == "5 % flipped":
        normals = np.where(random.uniform(size=(count, 1)) < 0.05, -normals, normals)
    elif kind == "a third repeated":
        points, normals = (np.concatenate([array, array[: count // 3]]) for array in (points, normals))
    elif kind.startswith("2 % outliers"):
        extra = random.uniform(*mesh.bounds, (count // 50, 3))
        turned = random.normal(size=extra.shape)
        points, normals = np.concatenate([points, extra]), np.concatenate([normals, turned])
        if kind.endswith("removed"):
            # Points with far neighbours are left out, as on the page *From a scan to a solid*.
            areas = fb.PointCloud(points).areas
            kept = areas < 4 * np.median(areas)
            points, normals = points[kept], normals[kept]
    return points, normals


KINDS = (
    "clean", "noise 0.25", "noise 0.5", "density 20:1", MISSING, "5 % flipped", "a third repeated", "2 % outliers",
    "2 % outliers, removed",
)  # fmt: skip


def sides(count: int) -> None:
    """Wrong sides by distance from the mesh, in spacings, and the error of distances."""
    import igl

    print("cloud: mean of five meshes, and the largest in brackets; distances in spacings of the cloud")
    bands = f"{'h/2..h':>17} {'beyond h':>17} {'beyond 2h':>17}"
    print(f"{'fault':21} {bands} {'undecided':>9} {'error < h/4':>11} {'> 4h':>7}")
    truths = {}
    for name in NAMES:
        mesh, random = load(name), np.random.default_rng(2)
        spacing = np.sqrt(mesh.area / count)
        surface, normals = drawn(mesh, 6000, seed=3)
        near = surface + normals * (random.uniform(-3, 3, (6000, 1)) * spacing)
        queries = np.concatenate([near, random.uniform(*mesh.bounds, (2000, 3))])
        inside = np.abs(igl.winding_number(mesh.vertices, mesh.faces, queries)) > 0.5
        # Distances are measured in local spacings where the density varies.
        squared, _, nearest = igl.point_mesh_squared_distance(queries, mesh.vertices, mesh.faces)
        truths[name] = mesh, spacing, queries, inside, np.sqrt(squared), nearest
    for kind in (*KINDS, f"{MISSING}, seen"):
        rows = []
        for mesh, spacing, queries, inside, distance, nearest in truths.values():
            points, normals = damaged(mesh, kind.removesuffix(", seen"), count)
            cloud = fb.PointCloud(points, normals)
            if kind.endswith("seen"):
                # Queries whose nearest point of the mesh was scanned.
                seen = fb.closest_point(cloud, nearest).distances < 2 * spacing
                queries, inside, distance = queries[seen], inside[seen], distance[seen]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = fb.query(cloud, queries)
            unit = spacing
            if kind.startswith("density"):
                unit = np.sqrt(cloud.areas[found.faces])
            wrong, at = (found.distances < 0) != inside, distance / unit
            bands = [wrong[(at > low) & (at <= high)] for low, high in ((0.5, 1), (1, np.inf), (2, np.inf))]
            error = np.abs(np.abs(found.distances) - distance) / unit
            errors = [float(error[at < 0.25].mean()), float(error[at > 4].mean())]
            rows.append(
                [*(float(band.mean()) for band in bands), found.report.undecided_points / len(queries), *errors]
            )
        mean, most = np.mean(rows, axis=0), np.max(rows, axis=0)
        shares = " ".join(f"{mean[i]:8.4f} ({most[i]:.4f})" for i in range(3))
        print(f"{kind:21} {shares} {mean[3]:9.4f} {mean[4]:11.3f} {mean[5]:7.3f}", flush=True)


def speed(count: int, queries: int) -> None:
    """Winding numbers of many points beside libigl, with equal accuracy."""
    import igl

    mesh = load("armadillo")
    points, normals = drawn(mesh, count)
    areas = fb.PointCloud(points, normals).areas
    random = np.random.default_rng(4)
    at = random.uniform(*mesh.bounds, (queries, 3))
    exact = np.array([exact_winding(points, normals, areas, q) for q in at[:1000]])

    found_seconds, found = timed(lambda: np.asarray(igl.fast_winding_number(points, normals, areas, at)))
    reference = np.abs(found[:1000] - exact)
    print(f"libigl: {found_seconds:.2f} s, error at most {reference.max():.2e}, mean {reference.mean():.2e}")
    reuse_seconds = np.nan
    if count <= MOST_REUSED:
        tree_seconds, tree = timed(lambda: octree_of(points, normals, areas))
        reuse_seconds, _ = timed(lambda: igl.fast_winding_number(points, normals, areas, *tree, at))
        memory = f"{peak_mib() / 1024:.1f} GiB at the peak"
        print(f"libigl precomputed: {tree_seconds:.2f} s tree, {reuse_seconds:.2f} s queries, {memory}")
    for error in (0.5, 0.35, 0.2, 0.1, 0.03, 0.01, 3e-3, 1e-3):
        cloud_seconds, cloud = timed(lambda: fb.PointCloud(points, normals, areas))
        ours_seconds, ours = timed(lambda cloud=cloud, error=error: fb.winding_number(cloud, at, error=error))
        off = np.abs(ours[:1000] - exact)
        whole, alone = found_seconds / (cloud_seconds + ours_seconds), reuse_seconds / ours_seconds
        print(
            f"error={error:g}: {cloud_seconds:.2f} s tree, {ours_seconds:.2f} s queries, {whole:.1f} times as fast "
            f"with the tree, {alone:.1f} times without it, error at most {off.max():.2e}, mean {off.mean():.2e}"
        )
        if off.max() <= reference.max() and off.mean() <= reference.mean():
            break
    print(f"memory of the core: {cloud._core.nbytes / count:.0f} bytes a point")


def exact_winding(points: Array, normals: Array, areas: Array, q: Array) -> float:
    """The dipole sum over all points, in float64."""
    away = points - q
    cubed = np.einsum("nk,nk->n", away, away) ** 1.5
    return float((areas * np.einsum("nk,nk->n", away, normals) / cubed).sum() / (4 * np.pi))


def octree_of(points: Array, normals: Array, areas: Array) -> tuple[Any, ...]:
    """The octree of libigl and its expansion, which several sets of queries can use."""
    import igl

    indices, children, *_ = igl.octree(points)
    return indices, children, *igl.fast_winding_number_precompute(points, normals, areas, indices, children)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time of all threads, and the result."""
    start = time.process_time()
    found = work()
    return time.process_time() - start, found


def orientation(count: int) -> None:
    """Flipped normals beside Open3D."""
    import open3d

    print(f"{'cloud':16} {'fieldbake':>10} {'by':>8} {'agreement':>9} {'Open3D':>8} {'s':>6} {'s':>6} closed")
    for name in (*ORIENTED, "armadillo noisy"):
        mesh = load(name.split()[0])
        points, normals = damaged(mesh, "noise 0.5" if name.endswith("noisy") else "clean", count)
        seconds, cloud = timed(lambda points=points: fb.PointCloud(points).oriented())

        def theirs(points: Array = points) -> Array:
            other = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
            other.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(12))
            other.orient_normals_consistent_tangent_plane(12)
            return np.asarray(other.normals)

        other_seconds, found = timed(theirs)
        # Open3D's result as a whole may point inwards; it is turned outward by its enclosed volume.
        if np.einsum("ij,ij->i", found, points - points.mean(axis=0)).sum() < 0:
            found = -found
        shares = [float((np.einsum("ij,ij->i", other, normals) < 0).mean()) for other in (cloud.normals, found)]
        origin = cloud.report.normals
        facts = f"{shares[0]:10.5f} {origin:>8} {cloud.report.agreement:9.4f} {shares[1]:8.5f}"
        print(f"{name:16} {facts} {seconds:6.1f} {other_seconds:6.1f} {is_closed(quiet_solid(cloud))}")


def solids(count: int) -> None:
    """Distances of solids from the mesh beside Poisson reconstruction."""
    import open3d

    print("distances from the mesh in spacings: mean, 99th percentile")
    for kind in KINDS:
        for name in NAMES:
            mesh = load(name)
            points, normals = damaged(mesh, kind, count)
            spacing = np.sqrt(mesh.area / count)
            made = quiet_solid(fb.PointCloud(points, normals))
            other = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
            other.normals = open3d.utility.Vector3dVector(normals)
            poisson, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(other, depth=7)
            row = []
            for result in (made, (np.asarray(poisson.vertices), np.asarray(poisson.triangles))):
                on_result = fb.sample_surface(result, 10_000).points
                off = fb.closest_point((mesh.vertices, mesh.faces), on_result).distances / spacing
                row += [off.mean(), np.quantile(off, 0.99)]
            print(
                f"{kind:18} {name:15} closed: {is_closed(made)}  " + " ".join(f"{value:6.3f}" for value in row),
                flush=True,
            )


def holes(count: int) -> None:
    """Voxels whose side is a guess, beside the part of the surface that was not scanned."""
    print("undecided voxels of 64 along the longest side; their largest distance from the removed part, in its radii")
    for name in NAMES:
        mesh = load(name)
        points, normals = drawn(mesh, count)
        whole = fb.bake(fb.PointCloud(points, normals), 64)
        for seed in range(4):
            center = points[np.random.default_rng(seed).integers(count)]
            away = np.linalg.norm(points - center, axis=1)
            radius = np.sort(away)[count // 5]
            cloud = fb.PointCloud(points[away >= radius], normals[away >= radius])
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                volume = fb.bake(cloud, 64)
            grid = np.stack(np.meshgrid(*volume.coordinates, indexing="ij"), axis=-1).reshape(-1, 3)
            turned = -1.0 if cloud.report.inside_out else 1.0
            winding = turned * fb.winding_number(cloud, grid, error=1e-6)
            far = fb.closest_point(cloud, grid).distances > 2 * cloud.spacing
            undecided = (np.abs(winding - 0.5) < 0.15) & far
            # The removed part is the faces of the mesh with a corner in the ball.
            removed = mesh.faces[(np.linalg.norm(mesh.vertices - center, axis=1)[mesh.faces] < radius).any(axis=1)]
            reach = fb.closest_point((mesh.vertices, removed), grid[undecided]).distances / radius
            named = sum("is a guess" in str(warning.message) for warning in caught)
            share = volume.report.undecided_voxels / len(grid)
            print(
                f"{name:15} {volume.report.undecided_voxels:6} ({share:.4f}, {undecided.sum()} counted), farthest "
                f"{reach.max(initial=0):.3f}, beyond the radius {(reach > 1).sum()}, warnings {named}; "
                f"whole cloud of a mesh with {len(mesh.outline().entities)} openings {whole.report.undecided_voxels}",
                flush=True,
            )


def quiet_solid(cloud: fb.PointCloud) -> fb.Mesh:
    """The solid of a cloud that may be damaged."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fb.solid(cloud, 128)


def is_closed(mesh: fb.Mesh) -> bool:
    """Whether a mesh is closed and two-manifold."""
    return bool(mesh.is_closed and mesh.topology()["nonmanifold_edges"] == 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("table", choices=("sides", "speed", "orientation", "solids", "holes"))
    parser.add_argument("--count", type=int, help="points of each cloud")
    parser.add_argument("--queries", type=int, default=100_000)
    options = parser.parse_args()
    if options.table == "speed":
        speed(options.count or 1_000_000, options.queries)
    elif options.table == "orientation":
        orientation(options.count or 20_000)
    else:
        {"sides": sides, "solids": solids, "holes": holes}[options.table](options.count or 10_000)


if __name__ == "__main__":
    main()
