"""Swept volumes beside random places of the body, brute-force unions and libigl.

    .venv/bin/python benches/sweeps.py contain | robot | shells | cost [--count N]

`contain`: points of a box, gear, torus and scan at random times of random screws, which must be inside the field, and
inside the mesh by fieldbake and by libigl's winding number. `robot`: an arm over 50 rows of joint values, its points at
random times, and the topology of its sweep beside the union of 4,000 configurations. `shells`: the cube of libigl's
issue 2562, beside libigl's own result. `cost`: distances a sample beside uniform steps with the same proof, and the
time of 1,000 poses beside 50 poses of one path.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, logm

import fieldbake as fb
from measuring import interleaved, run_table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import meshes
import robots

Array = NDArray[np.float64]


def pose(translation: Any, rotation: Array) -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, translation
    return made


def random_pose(random: np.random.Generator, size: float) -> Array:
    """A rotation by up to 2.5 radians about a random axis, and a translation by up to the size of the body."""
    x, y, z = random.normal(size=3)
    axis = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / np.sqrt(x * x + y * y + z * z)
    return pose(random.uniform(-size, size, 3), expm(random.uniform(0, 2.5) * axis))


def screw(first: Array, second: Array, shares: Array) -> Array:
    """Poses on the screw motion from one pose to another, by matrix functions, (k, 4, 4)."""
    change = np.real(logm(second @ np.linalg.inv(first)))
    return np.array([expm(share * change) @ first for share in shares])


def scan() -> fb.Mesh:
    """The bunny of pymeshlab, closed by `solid`."""
    import pymeshlab

    source = fb.load_mesh(next(Path(pymeshlab.__file__).parent.rglob("bunny*.*")))
    return fb.solid(source, 128, progress=False)


def inside_of(mesh: fb.Mesh, count: int, random: np.random.Generator) -> Array:
    """Random points of a solid, and points of its surface."""
    points = random.uniform(*mesh.bounds, (40 * count, 3))
    within = points[fb.contains(mesh, points)][: 3 * count // 4]
    on_surface = fb.sample_surface(mesh, count - len(within), seed=int(random.integers(2**31))).points
    return np.concatenate([within, on_surface])


def facts(mesh: fb.Mesh) -> tuple[int, int]:
    """The number of components and the Euler number of a closed mesh."""
    return mesh.topology()["components"], len(mesh.vertices) - len(mesh.faces) // 2


def contain(count: int) -> None:
    """Points of bodies at random times of five screws each."""
    import igl

    random = np.random.default_rng(0)
    bodies = {"box": fb.Mesh(*meshes.box((-1, -0.6, -0.4), (1, 0.6, 0.4))), "gear": fb.models.gear(teeth=9),
              "torus": fb.Mesh(*meshes.torus()), "scan": scan()}  # fmt: skip
    print(
        "points: random points of the body at random times of a screw; outside: positive in the field, outside the "
        "mesh by fieldbake, by libigl"
    )
    for name, mesh in bodies.items():
        wrong, total = np.zeros(3, dtype=int), 0
        size = float(np.ptp(mesh.bounds, axis=0).max())
        for _ in range(5):
            motion = random_pose(random, size), random_pose(random, size)
            volume = fb.sweep(mesh, motion, 96)
            swept = volume.to_mesh(sharp=False)
            for place in screw(*motion, random.uniform(0, 1, 100)):
                body = inside_of(mesh, count // 500, random)
                points = body @ place[:3, :3].T + place[:3, 3]
                total += len(points)
                by_igl = igl.fast_winding_number(swept.vertices, swept.faces.astype(np.int64), points)
                wrong += [
                    (volume.sample(points) >= 0).sum(),
                    (~fb.contains(swept, points)).sum(),
                    (by_igl <= 0.5).sum(),
                ]
        print(f"{name:6} {len(mesh.faces):7} faces: {total} points, outside {wrong.tolist()}", flush=True)


def robot(count: int) -> None:
    """An arm over 50 rows of joint values."""
    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        arm = fb.Assembly.from_urdf(robots.write(Path(folder))["arm"])
    values = np.array(robots.REST) + np.cumsum(random.uniform(-0.06, 0.06, (50, 8)), axis=0)
    values[:, 7] = random.uniform(0, 0.1, 50)
    volume = fb.sweep(arm, values, 128)
    swept = volume.to_mesh(sharp=False)
    outside, total = np.zeros(2, dtype=int), 0
    while total < count:
        row, share = int(random.integers(49)), random.uniform()
        poses = arm.poses(values[row] * (1 - share) + values[row + 1] * share)
        for place, elements in zip(poses, arm.bodies.values(), strict=True):
            for shape, own in elements:
                local = random.uniform(*np.array(shape.bounds, dtype=np.float64), (100, 3))
                local = local[shape.distance(local) <= 0]
                at = place @ own
                points = local @ at[:3, :3].T + at[:3, 3]
                outside += [(volume.sample(points) >= 0).sum(), (~fb.contains(swept, points)).sum()]
                total += len(points)
    print(f"arm of 11 bodies, 50 rows: {total} points, outside the field and the mesh {outside.tolist()}")

    exact = fb.sweep(arm, values, 48, contain=False, tolerance=1e-3)
    dense = exact.to_volume()
    rows = np.linspace(0, 49, 4000)
    at = np.stack([np.interp(rows, np.arange(50), column) for column in values.T], axis=1)
    grid = np.stack(np.meshgrid(*dense.coordinates, indexing="ij"), -1)
    least = np.full(grid.shape[:3], np.inf)
    for configuration in arm.poses(at):
        np.minimum(least, arm.distance(grid, configuration), out=least)
    differ = (dense.distances < 0) != (least < 0)
    union = fb.Volume(least.astype(np.float32), dense.bounds).to_mesh(sharp=False)
    print(
        f"components and Euler number: sweep {facts(exact.to_mesh(sharp=False))}, union of 4,000 times {facts(union)}, "
        f"at {' x '.join(map(str, dense.resolution))}; signs that differ {differ.sum()}"
    )


def shells(_: int) -> None:
    """A unit cube through eight poses with steps of a quarter, as in libigl's issue 2562."""
    import igl

    cube = meshes.box((0, 0, 0), (1, 1, 1))
    motion = [pose((0.25 * i, 0, 0), np.eye(3)) for i in range(8)]
    swept = fb.sweep(fb.Mesh(*cube), motion, 48).to_mesh(sharp=False)
    print(f"fieldbake: components and Euler number {facts(swept)}")
    vertices, faces = igl.swept_volume(cube.vertices, cube.faces.astype(np.int64), motion, grid_res=48, isolevel=0.05)
    other = fb.Mesh(vertices, faces)
    print(f"libigl, swept_volume at the level 0.05: components and Euler number {facts(other)}")
    corners = np.array([-0.3, -0.3, -0.3]), np.array([2.05, 1.3, 1.3])
    grid, sides = igl.voxel_grid(*corners, s=48, pad_count=0)
    step = float(np.ptp(grid[:, 0]) / (sides[0] - 1))
    for level in (0.0, np.inf):
        values = igl.swept_volume_signed_distance(
            cube.vertices, cube.faces.astype(np.int64), motion, GV=grid, res=sides, h=step, isolevel=level
        )
        inside = ((grid > (0.1, 0.1, 0.1)) & (grid < (2.65, 0.9, 0.9))).all(axis=1)
        print(f"libigl, signed distances with isolevel={level}: {(values[inside] > 0).sum()} of {inside.sum()} samples "
              "deep inside are positive")  # fmt: skip


def cost(_: int) -> None:
    """The gear of `contain`, and a path with 50 and 1,000 poses."""
    random = np.random.default_rng(0)
    mesh = fb.models.gear(teeth=9)
    size = float(np.ptp(mesh.bounds, axis=0).max())
    totals = np.zeros(2)
    for _ in range(5):
        motion = random_pose(random, size), random_pose(random, size)
        volume = fb.sweep(mesh, motion, 96)
        points = random.uniform(*volume.bounds, (20_000, 3))
        points = points[np.abs(volume.sample(points)) < volume.band][:300]
        # A distance at one time proves the tolerance while the point moves by that much before and after, in the frame
        # of the body.
        inverse = np.linalg.inv(screw(*motion, np.linspace(0, 1, 200)))
        paths = np.einsum("tij,nj->tni", inverse[:, :3, :3], points) + inverse[:, None, :3, 3]
        length = np.linalg.norm(np.diff(paths, axis=0), axis=2).sum(axis=0).mean()
        uniform = length / (2 * 0.25 * volume.report.voxel_size)
        totals += volume.report.evaluations, uniform
        ratio = volume.report.evaluations / uniform
        print(f"distances a sample: {volume.report.evaluations:.1f}, uniform steps {uniform:.0f}, ratio {ratio:.3f}")
    print(f"all five screws: ratio {totals[0] / totals[1]:.3f}")

    def path(count: int) -> list[Array]:
        turn = np.array([[0, -1, 0.5], [1, 0, -0.2], [-0.5, 0.2, 0]]) / np.sqrt(1.29)
        return [pose((s, 0.3 * s * s, 0), expm(2 * s * turn)) for s in np.linspace(0, 1, count)]

    jobs = {f"{n} poses": lambda n=n: fb.sweep(mesh, path(n), 64).report.evaluations for n in (50, 1000)}
    times = interleaved(jobs, 3)
    few, many = times["50 poses"], times["1000 poses"]
    print(f"1,000 poses: {many.least_cpu / few.least_cpu:.2f} times the processor time of 50 poses; distances a sample "
          f"{many.result:.1f} and {few.result:.1f}")  # fmt: skip


TABLES = {"contain": (contain, 1_000_000), "robot": (robot, 100_000), "shells": (shells, 0), "cost": (cost, 0)}


if __name__ == "__main__":
    run_table(TABLES, __doc__)
