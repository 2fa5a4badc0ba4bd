"""Clearances of robots: their derivatives beside central differences, and their pairs in contact beside coal.

    .venv/bin/python benches/clearances_robots.py gradients | folded [--count 1000]

`gradients`: derivatives of distances and of clearances by joint values. `folded`: the rest pose of an arm beside the
distances of coal, and the pairs of random poses in contact beside its collisions.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fieldbake as fb
from measuring import run_table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import meshes
import robots

Array = NDArray[np.float64]


def pose(translation: Sequence[float], rotation: Array) -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, translation
    return made


def robots_of(folder: Path) -> dict[str, fb.Assembly]:
    """The arm of primitives, and an arm of three meshes."""
    place = pose((0.4, 0.1, 0.9), meshes.rotation(2))
    joints = [
        fb.Joint(f"j{i}", "revolute", f"link{i}", f"link{i + 1}", origin=place, axis=(1, i, 0.5)) for i in range(4)
    ]
    parts = [fb.models.gear(teeth=6), fb.Mesh(*meshes.knot(60, 8)), fb.Mesh(*meshes.torus(0.5, 0.15)),
             fb.Mesh(*meshes.icosphere(3, 0.4)), fb.Mesh(*meshes.box((-0.3, -0.2, 0), (0.3, 0.2, 0.8)))]  # fmt: skip
    return {
        "primitives": fb.Assembly.from_urdf(robots.write(folder)["arm"]),
        "meshes": fb.Assembly({f"link{i}": part for i, part in enumerate(parts)}, joints),
    }


def gradients(count: int) -> None:
    """Derivatives by joint values beside central differences."""
    step = 1e-6
    random = np.random.default_rng(3)
    with tempfile.TemporaryDirectory() as folder:
        made = robots_of(Path(folder))
    for name, robot in made.items():
        columns = len(robot.joint_names)
        rows: dict[str, list[Array]] = {"distance": [], "clearance": []}
        for _ in range(count):
            values = random.uniform(-1.2, 1.2, columns)
            ends = values + step * np.concatenate([np.eye(columns), -np.eye(columns)])
            points = random.uniform(-1.5, 1.5, (20, 3))
            q, moved = robot.query(points, robot.poses(values)), robot.query(points, robot.poses(ends))
            slopes = -np.einsum("...i,...im->...m", q.gradients, robot.jacobian(values, q.bodies, q.points))
            rows["distance"].append(compared(slopes, moved.distances, [(moved.points, q.points)], step, q.distances))
            c, moved_c = robot.clearance(robot.poses(values)), robot.clearance(robot.poses(ends))
            first, second = (
                robot.jacobian(values, c.pairs[:, side], points) for side, points in ((0, c.points_a), (1, c.points_b))
            )
            slopes = np.einsum("ki,kim->km", c.normals, first - second)
            witnesses = [(moved_c.points_a, c.points_a), (moved_c.points_b, c.points_b)]
            rows["clearance"].append(compared(slopes, moved_c.distances, witnesses, step, c.distances))
        for kind, errors in rows.items():
            all_errors = np.concatenate(errors)
            used = np.isfinite(all_errors)
            known = all_errors[used]
            print(
                f"{name:10} {kind:9}: {count} configurations, {len(all_errors)} values, {used.sum()} apart and "
                f"smooth; relative error largest {known.max():.1e}, 99.9th percentile "
                f"{np.quantile(known, 0.999):.1e}, above 1e-6: {(known > 1e-6).sum()}",
                flush=True,
            )


def compared(slopes: Array, values: Array, witnesses: Any, step: float, center: Array) -> Array:
    """Relative errors of the rows of slopes; NaN where the solids overlap or a nearest point moves by 1e-4.

    The error of a row is relative to the length of its gradient, at least a hundredth of a unit.
    """
    half = len(values) // 2
    expected = (values[:half] - values[half:]).T / (2 * step)
    moves = np.max([np.linalg.norm(ends - middle, axis=-1).max(axis=0) for ends, middle in witnesses], axis=0)
    errors = np.linalg.norm(slopes - expected, axis=-1) / np.maximum(np.linalg.norm(expected, axis=-1), 1e-2)
    return np.where((moves < 1e-4) & (center > 0), errors, np.nan)


def folded(count: int) -> None:
    """The rest pose of the arm beside the optimiser, and its folded poses beside the collisions of coal."""
    import coal

    random = np.random.default_rng(4)
    with tempfile.TemporaryDirectory() as folder:
        arm = robots_of(Path(folder))["primitives"]
    rest = np.array(robots.REST)
    found = arm.clearance(arm.poses(rest))
    models: dict[str, list[tuple[Any, Array]]] = {}
    for link, parts in arm.bodies.items():
        kinds = [kind for kind, *_ in robots.ARM_PARTS[link]]
        models[link] = [
            (coal_primitive(coal, kind, sizes), place)
            for (_, place), kind, (_, sizes, *_) in zip(parts, kinds, robots.ARM_PARTS[link], strict=True)
        ]
    names = arm.body_names
    expected = np.array(
        [pair_distance(coal, models[names[i]], models[names[j]], arm.poses(rest)[[i, j]]) for i, j in arm.pairs]
    )
    print(
        f"rest pose: {len(arm.pairs)} default pairs, smallest clearance {found.distances.min():.4f}, largest "
        f"difference from coal {np.abs(found.distances - expected).max():.1e}"
    )
    wrong, contacts = 0, 0
    for values in random.uniform(arm.limits[:, 0], arm.limits[:, 1], (count, 8)):
        poses = arm.poses(values)
        ours = arm.clearance(poses).distances < 0
        theirs = np.array([collides(coal, models[names[i]], models[names[j]], poses[[i, j]]) for i, j in arm.pairs])
        wrong += int((ours != theirs).sum())
        contacts += int(theirs.sum())
    print(f"{count} folded poses: {contacts} pairs in contact by coal, {wrong} pairs differ")


def coal_primitive(coal: Any, kind: str, sizes: Sequence[float]) -> Any:
    return {"box": coal.Box, "sphere": coal.Sphere, "capsule": coal.Capsule, "cylinder": coal.Cylinder}[kind](*sizes)


def placed(coal: Any, parts: Any, at: Array) -> list[tuple[Any, Any]]:
    return [(model, coal.Transform3s((at @ own)[:3, :3], (at @ own)[:3, 3])) for model, own in parts]


def pair_distance(coal: Any, first: Any, second: Any, poses: Array) -> float:
    request = coal.DistanceRequest()
    request.gjk_tolerance, request.gjk_max_iterations = 1e-9, 2000
    return min(
        coal.distance(a, at, b, other, request, coal.DistanceResult())
        for a, at in placed(coal, first, poses[0])
        for b, other in placed(coal, second, poses[1])
    )


def collides(coal: Any, first: Any, second: Any, poses: Array) -> bool:
    return any(
        coal.collide(a, at, b, other, coal.CollisionRequest(), coal.CollisionResult())
        for a, at in placed(coal, first, poses[0])
        for b, other in placed(coal, second, poses[1])
    )


TABLES = {"gradients": (gradients, 1000), "folded": (folded, 200)}


if __name__ == "__main__":
    run_table(TABLES, __doc__)
