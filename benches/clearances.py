"""Clearances of pairs of solids beside coal, python-fcl, an optimiser and brute force on grids.

    .venv/bin/python benches/clearances.py pairs | primitives | depth [--count 500]

`pairs`: distances of separate meshes of 2 to 50,000 faces beside coal and python-fcl, the positions of the nearest
points, and values beyond a cutoff. `primitives`: convex shapes beside coal and the optimiser SLSQP. `depth`: overlaps
of convex solids beside the penetration depth of coal (EPA), overlaps of others beside grids, and the path of a solid
through contact.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

import fieldbake as fb
from measuring import run_table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import meshes
import truth

Array = NDArray[np.float64]
Generator = np.random.Generator

#: A pair is apart if its distance exceeds this share of its size.
APART = 1e-4


def pose(translation: Sequence[float] | Array, rotation: Array) -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, translation
    return made


def turn(random: Generator) -> Array:
    return meshes.rotation(int(random.integers(2**31)))


def solid_of(random: Generator) -> fb.Mesh:
    """A torus, knot, L, open bowl, gear or sheet with 2 to 50,000 faces."""
    kind = random.choice(["torus", "knot", "L", "bowl", "gear", "sheet"])
    if kind in ("torus", "knot"):
        sides = int(np.exp(random.uniform(np.log(3), np.log(100))))
        made = getattr(meshes, kind)(segments=max(8 * (kind == "knot") + 3, int(2.5 * sides)), sides=sides)
    elif kind == "L":
        made = meshes.join(meshes.box((-1, -1, -0.3), (1, -0.4, 0.3)), meshes.box((-1, -0.4, -0.3), (-0.4, 1, 0.3)))
    elif kind == "bowl":
        ball = meshes.icosphere(int(random.integers(2, 6)))
        made = ball._replace(faces=ball.faces[ball.vertices[ball.faces][:, :, 2].max(axis=1) < 0.3])
    elif kind == "gear":
        return fb.models.gear(teeth=int(random.integers(4, 20)))
    else:
        made = meshes.flat_sheet(int(random.integers(1, 12)))
    return fb.Mesh(made.vertices, made.faces)


def of_coal(coal: Any, mesh: fb.Mesh) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(mesh.vertices)
    model.addTriangles(mesh.faces)
    model.endModel()
    return model


def coal_distance(coal: Any, a: Any, b: Any, place: Array) -> float:
    """The distance, or the negative depth of convex shapes by EPA."""
    request = coal.DistanceRequest()
    request.gjk_tolerance, request.epa_tolerance = 1e-9, 1e-9
    request.gjk_max_iterations = request.epa_max_iterations = 2000
    transform = coal.Transform3s(place[:3, :3], place[:3, 3])
    return float(coal.distance(a, coal.Transform3s(), b, transform, request, coal.DistanceResult()))


def fcl_distance(a: fb.Mesh, b: fb.Mesh, place: Array) -> float:
    import fcl

    objects = []
    for mesh, at in ((a, np.eye(4)), (b, place)):
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
        objects.append(fcl.CollisionObject(model, fcl.Transform(at[:3, :3], at[:3, 3])))
    return float(fcl.distance(*objects, fcl.DistanceRequest(), fcl.DistanceResult()))


def contains_part(a: fb.Mesh, b: fb.Mesh, place: Array) -> bool:
    """Whether a vertex of one mesh is inside the other by libigl's winding number."""
    import igl

    there, back = b.vertices @ place[:3, :3].T + place[:3, 3], (a.vertices - place[:3, 3]) @ place[:3, :3]
    sides = [igl.winding_number(a.vertices, a.faces, there[::7]), igl.winding_number(b.vertices, b.faces, back[::7])]
    return any((np.abs(side) > 0.5).any() for side in sides)


def pairs(count: int) -> None:
    """Separate meshes beside coal and python-fcl."""
    import coal

    random = np.random.default_rng(0)
    errors: dict[str, list[float]] = {}
    faces, nested, beyond, wrong, tried = [], 0, 0, 0, 0
    while len(errors.get("coal", [])) < count:
        tried += 1
        a, b = solid_of(random), solid_of(random)
        size = max(np.linalg.norm(np.ptp(mesh.bounds, axis=0)) for mesh in (a, b))
        direction = random.normal(size=3)
        place = pose(direction / np.linalg.norm(direction) * random.uniform(0, 0.9) * size, turn(random))
        expected = coal_distance(coal, of_coal(coal, a), of_coal(coal, b), place)
        found = fb.clearance(a, b, pose_b=place)
        value, p, q = found.distances[0], found.points_a[0], found.points_b[0]
        if expected <= APART * size:
            wrong += not value <= APART * size * (1 + 1e-9)
            continue
        if value <= APART * size:
            # Surfaces that are apart, and a part inside the other solid. A sheet inside has the clearance 0.
            nested += 1
            wrong += not contains_part(a, b, place)
            continue
        faces += [len(a.faces), len(b.faces)]
        local = place[:3, :3].T @ (q - place[:3, 3])
        off = [
            np.linalg.norm(truth.closest_point(mesh.vertices, mesh.faces, at[None]).points[0] - at) / size
            for mesh, at in ((a, p), (b, local))
        ]
        row = {
            "coal": abs(value / expected - 1),
            "python-fcl": abs(value / fcl_distance(a, b, place) - 1),
            "point off its surface": max(off),
            "distance of the points": abs(np.linalg.norm(p - q) / value - 1),
            "normal": np.linalg.norm((p - q) / value - found.normals[0]),
            "stated error": found.errors[0],
        }
        for name, error in row.items():
            errors.setdefault(name, []).append(float(error))
        cutoff = random.uniform(0.2, 1) * value
        bound = fb.clearance(a, b, pose_b=place, cutoff=cutoff)
        beyond += not (cutoff <= bound.distances[0] <= expected * (1 + 1e-9) and np.isnan(bound.points_a).all())
    print(
        f"{count} separate pairs of {tried}, {min(faces)} to {max(faces)} faces; {nested} nested pairs; {wrong} wrong"
    )
    for name, row in errors.items():
        print(f"  {name:24} largest {max(row):.2e}, above 1e-9: {sum(not error <= 1e-9 for error in row)}")
    print(f"  values beyond a cutoff that are no bound: {beyond}")


#: Convex shapes: fieldbake's, coal's, and the inequalities f(x) >= 0 of the inside.
def shape_of(coal: Any, random: Generator, kinds: Sequence[str]) -> tuple[fb.Shape, Any, Callable[[Array], Array]]:
    r, h = random.uniform(0.2, 0.8), random.uniform(0.4, 2)
    sizes = random.uniform(0.3, 1, 3)
    kind = random.choice(list(kinds))

    def cone(x: Array) -> Array:
        slope = r * (0.5 - x[2] / h)
        return np.array([slope - np.hypot(x[0], x[1]), 0.5 * h - x[2], x[2] + 0.5 * h])

    def capsule(x: Array) -> Array:
        return np.array([r**2 - x[0] ** 2 - x[1] ** 2 - max(abs(x[2]) - 0.5 * h, 0) ** 2])

    def cylinder(x: Array) -> Array:
        return np.array([r**2 - x[0] ** 2 - x[1] ** 2, 0.5 * h - x[2], x[2] + 0.5 * h])

    return {
        "sphere": (fb.sphere(r), coal.Sphere(r), lambda x: np.array([r**2 - x @ x])),
        "box": (fb.box(sizes), coal.Box(*sizes), lambda x: np.concatenate([sizes / 2 - x, sizes / 2 + x])),
        "capsule": (fb.capsule(r, h), coal.Capsule(r, h), capsule),
        "cylinder": (fb.cylinder(r, h), coal.Cylinder(r, h), cylinder),
        "cone": (fb.cone(r, h), coal.Cone(r, h), cone),
        "ellipsoid": (fb.ellipsoid(sizes), coal.Ellipsoid(*sizes), lambda x: np.array([1 - ((x / sizes) ** 2).sum()])),
    }[kind]


def by_optimiser(first: Callable[[Array], Array], second: Callable[[Array], Array], place: Array, near: Array) -> float:
    """The distance of two convex solids by SLSQP, from the centres and from places beside `near`; NaN if all fail."""
    random = np.random.default_rng(0)
    best = np.nan
    starts = [np.concatenate([np.zeros(3), place[:3, 3]]), *(near + random.normal(0, 0.05, (4, 6)))]
    for start in starts:
        found = minimize(
            lambda x: ((x[:3] - x[3:]) ** 2).sum(), start,
            jac=lambda x: 2 * np.concatenate([x[:3] - x[3:], x[3:] - x[:3]]), method="SLSQP",
            constraints=[{"type": "ineq", "fun": lambda x: first(x[:3])},
                         {"type": "ineq", "fun": lambda x: second(place[:3, :3].T @ (x[3:] - place[:3, 3]))}],
            options={"ftol": 1e-16, "maxiter": 500},
        )  # fmt: skip
        values = np.concatenate([first(found.x[:3]), second(place[:3, :3].T @ (found.x[3:] - place[:3, 3]))])
        if values.min() >= -1e-10:
            best = np.fmin(best, np.sqrt(found.fun))
    return float(best)


def primitives(count: int) -> None:
    """Convex shapes that are apart."""
    import coal

    random = np.random.default_rng(1)
    kinds = ("sphere", "box", "capsule", "cylinder", "cone", "ellipsoid")
    rows = []
    while len(rows) < count:
        (a, model_a, inside_a), (b, model_b, inside_b) = (
            shape_of(coal, random, kinds[3:]), shape_of(coal, random, kinds)
        )  # fmt: skip
        direction = random.normal(size=3)
        place = pose(direction / np.linalg.norm(direction) * random.uniform(0.5, 3), turn(random))
        expected = coal_distance(coal, model_a, model_b, place)
        if expected < 1e-3:
            continue
        found = fb.clearance(a, b, pose_b=place)
        optimum = by_optimiser(inside_a, inside_b, place, np.concatenate([found.points_a[0], found.points_b[0]]))
        rows.append((abs(found.distances[0] - expected), found.distances[0] - optimum, found.errors[0]))
    of_coal, of_optimiser, stated = np.array(rows).T
    print(f"{count} pairs of a cylinder, cone or ellipsoid and any primitive, sizes 0.4 to 2")
    print(f"  coal: largest difference {of_coal.max():.1e}, above 1e-6: {(~(of_coal <= 1e-6)).sum()}")
    known = np.isfinite(of_optimiser)
    off = of_optimiser[known]
    print(
        f"  SLSQP: converged {known.sum()}; fieldbake is larger by at most {off.max():.1e}, smaller by at most "
        f"{-off.min():.1e}; apart by more than 1e-8: {(np.abs(off) > 1e-8).sum()}"
    )
    print(f"  largest stated error {stated.max():.1e}")


def hull_of(coal: Any, random: Generator) -> tuple[fb.Mesh, Any]:
    """The convex hull of random points, as a mesh and as a convex shape of coal."""
    points = random.normal(size=(int(random.integers(8, 60)), 3)) * random.uniform(0.3, 0.8, 3)
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    flipped = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
                        hull.equations[:, :3]) < 0  # fmt: skip
    faces = np.where(flipped[:, None], hull.simplices[:, ::-1], hull.simplices)
    mesh = fb.Mesh(points, faces.astype(np.int64))
    model = of_coal(coal, mesh)
    model.buildConvexHull(True, "Qt")
    return mesh, model.convex


def depth(count: int) -> None:
    """Overlaps: convex pairs beside EPA, others beside grids, and the way through contact."""
    import coal

    random = np.random.default_rng(2)
    kinds = ("sphere", "box", "capsule", "cylinder", "cone", "ellipsoid")
    above, ratios, errors = 0, [], []
    while len(ratios) < count:
        if len(ratios) % 2:
            (a, model_a), (b, model_b) = hull_of(coal, random), hull_of(coal, random)
        else:
            (a, model_a, _), (b, model_b, _) = (shape_of(coal, random, kinds) for _ in range(2))
        place = pose(random.uniform(-0.6, 0.6, 3), turn(random))
        expected = -coal_distance(coal, model_a, model_b, place)
        if expected <= 1e-6:
            continue
        found = fb.clearance(a, b, pose_b=place)
        value = -found.distances[0]
        ratios.append(value / expected)
        errors.append(found.errors[0] / value)
        above += not 0 < value <= expected + 1e-6
    print(
        f"{count} overlapping convex pairs: {above} outside (0, depth of EPA + 1e-6]; depth / EPA {min(ratios):.3f} "
        f"to {max(ratios):.6f}; largest stated error {max(errors):.1e} of the depth"
    )
    other_overlaps(random, max(10, count // 5))
    through_contact()


def other_overlaps(random: Generator, count: int) -> None:
    """Non-convex overlaps beside the smallest value of max(a, b) on a refined grid."""
    solids: list[Any] = [fb.torus(1, 0.4), fb.Mesh(*meshes.torus(minor=0.4, segments=32, sides=12)), fb.models.gear(9),
                         fb.Mesh(*meshes.knot(60, 8)), fb.box((1, 2, 1.5)), fb.ellipsoid((1, 0.5, 0.7))]  # fmt: skip
    outside, nested, stated = 0, 0, []

    def field(solid: Any, points: Array) -> Array:
        return solid.distance(points, dtype="float64") if isinstance(solid, fb.Shape) else fb.query(solid, points)[0]

    done = 0
    while done < count:
        a, b = solids[int(random.integers(4))], solids[int(random.integers(6))]
        place = pose(random.uniform(-0.8, 0.8, 3), turn(random))
        found = fb.clearance(a, b, pose_b=place)
        value, error = found.distances[0], found.errors[0]
        if value >= 0:
            continue
        done += 1
        stated.append(error / -value)
        lower, upper = np.array(a.bounds, dtype=np.float64)
        for _ in range(4):
            axes = np.linspace(lower, upper, 40)
            grid = np.stack(np.meshgrid(*axes.T, indexing="ij"), -1).reshape(-1, 3)
            larger = np.maximum(field(a, grid), field(b, (grid - place[:3, 3]) @ place[:3, :3]))
            step = (upper - lower) / 39
            lower, upper = grid[larger.argmin()] - 3 * step, grid[larger.argmin()] + 3 * step
        # A smaller value may lie between the samples of the first grid only: value <= least, and never below the bound.
        least = 2 * larger.min()
        outside += not value - error - 1e-9 <= least
        nested += not value <= least + 1e-3 * abs(value) + 1e-9
    inside = fb.clearance(fb.torus(1, 0.4), fb.sphere(0.1), pose_b=pose((1, 0, 0), np.eye(3))).distances[0]
    print(
        f"{count} other overlaps: {outside} below the proven bound, {nested} above the grid's value; "
        f"largest stated error {max(stated):.1e} of the depth; a ball of diameter 0.2 in a tube: {inside:.6f}"
    )


def through_contact() -> None:
    """A box through a gear in 400 steps."""
    gear, box = fb.models.gear(teeth=9), fb.box((0.5, 0.4, 0.3))
    shifts = np.linspace(0.2, 1.8, 401)
    found = [fb.clearance(gear, box, pose_b=pose((x, 0.1, 0.05), meshes.rotation(3))) for x in shifts]
    values, errors = (np.array([getattr(one, name)[0] for one in found]) for name in ("distances", "errors"))
    jumps = np.abs(np.diff(values)) - np.diff(shifts) - errors[1:] - errors[:-1]
    print(
        f"a box through a gear in 400 steps: from {values.min():.3f} to {values.max():.3f}, largest change beyond "
        f"the step and the errors {jumps.max():.1e}"
    )


TABLES = {"pairs": (pairs, 500), "primitives": (primitives, 300), "depth": (depth, 200)}


if __name__ == "__main__":
    run_table(TABLES, __doc__)
