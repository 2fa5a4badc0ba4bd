"""Distances of points from a posed robot, beside loops of single queries over its bodies and configurations.

    .venv/bin/python benches/robots.py [--links 11] [--configurations 100] [--points 10000]

100 configurations of 11 bodies with 2,000 to 70,000 faces, and 10,000 points: one `Assembly.distance`, a loop of
`fieldbake.query` over bodies and poses, the same loop with Open3D's `RaycastingScene`, and pytorch_volumetric with
exact meshes and with its cached voxels. The jobs run in turns. The errors are differences from float64 brute force at
some of the points. The bits of the batch are compared with calls of one configuration, on 1 and 2 threads.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fieldbake as fb
from measuring import absent, interleaved, record

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import truth

#: Faces of the 11 bodies are twice the segments times the sides.
SEGMENTS = (50, 70, 100, 140, 200, 280, 400, 500, 600, 700, 1000)
SIDES = (20, 20, 25, 25, 30, 30, 30, 32, 32, 34, 35)
#: Distance between the joints of the arm.
STEP = 0.35


def robot(links: int) -> fb.Assembly:
    """An arm of torus knots, each as large as its link."""
    bodies, joints = {}, []
    chosen = np.linspace(0, len(SEGMENTS) - 1, links).round().astype(int)
    for i, (segments, sides) in enumerate((SEGMENTS[k], SIDES[k]) for k in chosen):
        knot = fb.models.torus_knot(segments=segments, sides=sides)
        size = (knot.bounds[1] - knot.bounds[0]).max()
        bodies[f"link{i}"] = fb.Mesh(knot.vertices * (0.9 * STEP / size) + np.array((0, 0, STEP / 2)), knot.faces)
        if i:
            origin = np.eye(4)
            origin[2, 3] = STEP
            axis = ((1, 0, 0), (0, 1, 0), (0, 0, 1))[i % 3]
            joints.append(fb.Joint(f"joint{i}", "revolute", f"link{i - 1}", f"link{i}", origin=origin, axis=axis))
    return fb.Assembly(bodies, joints)


def volumetric(meshes: list[fb.Mesh], poses: np.ndarray, points: np.ndarray) -> dict[str, Callable[[], np.ndarray]]:
    """Jobs of pytorch_volumetric; empty without it."""
    try:
        torch, kinematics = importlib.import_module("torch"), importlib.import_module("pytorch_kinematics")
        package = importlib.import_module("pytorch_volumetric")
    except ImportError as error:
        absent("pytorch_volumetric", error)
        return {}
    torch.set_num_threads(os.cpu_count() or 1)
    folder = Path(tempfile.mkdtemp())
    exact, cached = [], []
    for i, mesh in enumerate(meshes):
        mesh.save(folder / f"{i}.obj")
        exact.append(package.MeshSDF(package.MeshObjectFactory(str(folder / f"{i}.obj"))))
        # The resolution of its documentation; outside the voxels it takes the distance from their box.
        box = exact[-1].surface_bounding_box(padding=0.1).tolist()
        cached.append(package.CachedSDF(str(i), 0.02, box, exact[-1], cache_path=str(folder / "cache.pkl")))
    matrices = torch.from_numpy(np.linalg.inv(poses).transpose(1, 0, 2, 3).reshape(-1, 4, 4).astype(np.float32))
    at = torch.from_numpy(points.astype(np.float32))

    def job(fields: list[Any]) -> Callable[[], np.ndarray]:
        composed = package.ComposedSDF(fields, None)
        composed.set_transforms(kinematics.Transform3d(matrix=matrices), batch_dim=(len(poses),))
        return lambda: composed(at)[0].numpy()

    return {"pytorch_volumetric": job(exact), "the same, cached": job(cached)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--links", type=int, default=11)
    parser.add_argument("-b", "--configurations", type=int, default=100)
    parser.add_argument("-n", "--points", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    arm = robot(options.links)
    random = np.random.default_rng(0)
    poses = arm.poses(random.uniform(-0.8, 0.8, (options.configurations, options.links - 1)))
    points = random.uniform((-2, -2, -0.5), (2, 2, 3.5), (options.points, 3))
    meshes = [parts[0][0] for parts in arm.bodies.values()]
    print([len(mesh.faces) for mesh in meshes], "faces")

    def local(pose: np.ndarray) -> np.ndarray:
        return (points - pose[:3, 3]) @ pose[:3, :3]

    def loop() -> np.ndarray:
        return np.array([
            np.min([fb.query(mesh, local(pose)).distances for mesh, pose in zip(meshes, row, strict=True)], axis=0)
            for row in poses
        ])  # fmt: skip

    jobs = {"Assembly.distance": lambda: arm.distance(points, poses), "loop of query": loop}
    try:
        open3d = importlib.import_module("open3d")
    except ImportError as error:
        absent("Open3D", error)
    else:
        scenes = []
        for mesh in meshes:
            scene = open3d.t.geometry.RaycastingScene()
            scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces)
            scenes.append(scene)

        def peer() -> np.ndarray:
            return np.array([
                np.min([scene.compute_signed_distance(local(pose).astype(np.float32)).numpy()
                        for scene, pose in zip(scenes, row, strict=True)], axis=0)
                for row in poses
            ])  # fmt: skip

        jobs["loop of Open3D"] = peer
    jobs |= volumetric(meshes, poses, points)
    arm.distance(points[:1], poses[:1])
    times = interleaved(jobs, options.rounds)
    chosen = random.choice(len(points), min(20, len(points)), replace=False)
    expected = np.min([
        truth.signed_distance(mesh.vertices @ pose[:3, :3].T + pose[:3, 3], mesh.faces.astype(np.int64), points[chosen])
        for mesh, pose in zip(meshes, poses[0], strict=True)
    ], axis=0)  # fmt: skip
    ours = times["Assembly.distance"]
    print(f"{'job':<20} {'seconds':>9} {'cpu':>9} {'ratio':>7} {'cpu ratio':>9} {'error':>9}")
    for name, time in times.items():
        error = np.abs(time.result[0][chosen] - expected).max()
        ratio, of_cpu = time.median / ours.median, time.least_cpu / ours.least_cpu
        print(f"{name:<20} {time.median:9.3f} {time.least_cpu:9.3f} {ratio:7.2f} {of_cpu:9.2f} {error:9.1e}")
        if name != "Assembly.distance":
            record("points around a robot", name, ours.median, time.median)
    alone = np.array([arm.distance(points, pose) for pose in poses])
    fb.set_threads(1)
    one = arm.distance(points, poses)
    both = times["Assembly.distance"].result
    print(f"bits that differ from single calls: {(both != alone).sum()}, on one thread: {(both != one).sum()}")


if __name__ == "__main__":
    main()
