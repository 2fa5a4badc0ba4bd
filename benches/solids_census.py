"""Count the meshes that are not closed two-manifolds or cross themselves, and check printable parts and offsets.

    python benches/solids_census.py --models FOLDER [--noise 1000] [--shapes 300] [--resolutions 32 64 128 200]
    python benches/solids_census.py --noise 0 --shapes 0 --soups 0 --parts 500 [--first 0]
    python benches/solids_census.py --noise 0 --shapes 0 --soups 0 --offsets 200 [--first 0]

Every mesh must use each directed edge once each way, have one fan of faces at each vertex and no face without an area,
be accepted by manifold3d and be watertight for trimesh. No two faces may cross, by exact orientations and, if it is
installed, by Open3D. A model without an inside may end in a `MeshError`.

Parts are lattices, Booleans, shells and random trees at 40 to 200 voxels; their volume is compared with random points.
Offsets are compared with float64 distances from the surface of their operand, where the nearest surface point lies
on no edge. The case `i` depends on `i` alone, so `--first` continues a run.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from fractions import Fraction
from pathlib import Path

import manifold3d
import numpy as np
import trimesh

import fieldbake as fb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from manifold import faults

try:
    import open3d
except ImportError:
    open3d = None

#: Open3D compares all pairs of faces, so larger meshes are left to the exact test.
OPEN3D_FACES = 12_000

#: Random points of a volume, and the largest relative errors of a volume with walls of 3 voxels and with thinner ones.
POINTS = 4_000_000
VOLUME_ERRORS = (0.005, 0.02)

#: Largest error of an offset: a fraction of a voxel, or of the distance if that is larger.
OFFSET_VOXELS, OFFSET_SHARE = 0.05, 0.01

ENDINGS = (".obj", ".glb", ".stl", ".ply", ".off")


def problems(mesh):
    """All faults of a mesh, as short texts."""
    found = faults(mesh.vertices, mesh.faces)
    parts = np.array(mesh.vertices, np.float32, order="C"), np.array(mesh.faces, np.uint32, order="C")
    status = manifold3d.Manifold(manifold3d.Mesh(*parts)).status()
    if status != manifold3d.Error.NoError:
        found.append(f"manifold3d: {status.name}")
    if not trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight:
        found.append("trimesh: not watertight")
    crossings = mesh._core.self_intersections()
    if crossings:
        found.append(f"{crossings} pairs of faces cross")
    if open3d is not None and len(mesh.faces) <= OPEN3D_FACES:
        shown = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(mesh.vertices.copy()),
            open3d.utility.Vector3iVector(mesh.faces.astype(np.int32)),
        )
        pairs = np.asarray(shown.get_self_intersecting_triangles()).reshape(-1, 2)
        # Open3D also lists pairs that only nearly touch; exact fractions prove those apart.
        crossings = sum(not are_apart(*mesh.vertices[mesh.faces[pair]].tolist()) for pair in pairs)
        if crossings:
            found.append(f"Open3D: {crossings} pairs of faces cross")
    return found


def are_apart(first, second):
    """Whether two triangles have no common point, by exact fractions: a direction separates them.

    The directions are the normals and the cross products of the sides (Gottschalk, Lin and Manocha, "OBBTree", 1996).
    """

    def cross(u, v):
        return [u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)]

    def sides(triangle):
        return [[a - b for a, b in zip(triangle[i], triangle[i - 1], strict=True)] for i in range(3)]

    first, second = ([[Fraction(x) for x in corner] for corner in triangle] for triangle in (first, second))
    edges, others = sides(first), sides(second)
    axes = [cross(*edges[:2]), cross(*others[:2]), *(cross(u, v) for u in edges for v in others)]
    for axis in axes:
        ranges = [[sum(a * x for a, x in zip(axis, corner, strict=True)) for corner in t] for t in (first, second)]
        if max(ranges[0]) < min(ranges[1]) or max(ranges[1]) < min(ranges[0]):
            return True
    return False


class Census:
    """Number of meshes by kind and outcome."""

    def __init__(self):
        self.outcomes = {}

    def add(self, kind, name, make):
        """Check the mesh that `make` returns; None counts as empty."""
        try:
            mesh = make()
        except fb.MeshError as error:
            self.count(kind, name, "MeshError", str(error))
            return
        if not len(mesh.faces):
            self.count(kind, name, "empty")
            return
        found = problems(mesh)
        self.count(kind, name, "faulty" if found else "good", "; ".join(found))

    def count(self, kind, name, outcome, text=""):
        """Count an outcome, and print its text."""
        self.outcomes.setdefault(kind, Counter())[outcome] += 1
        if text:
            print(f"{kind} {name}: {text}", flush=True)

    def report(self):
        """Print the counts, and return the number of faulty meshes."""
        for kind, counts in self.outcomes.items():
            print(f"{kind:<16} " + ", ".join(f"{count:,} {outcome}" for outcome, count in sorted(counts.items())))
        return sum(counts["faulty"] for counts in self.outcomes.values())


def noise(seed):
    """White noise on a small grid: every way in which a surface can pass through a cell."""
    random = np.random.default_rng(seed)
    return fb.Volume(random.uniform(-1, 1, random.integers(3, 9, 3)), [(0, 0, 0), (2, 3, 4)])


def shape(random, depth=3):
    """A random tree of Booleans of turned primitives."""
    if depth == 0 or random.random() < 0.2:
        size = random.uniform(0.3, 1, 3)
        leaves = (fb.sphere(size[0]), fb.box(size), fb.cylinder(size[0], size[1]), fb.torus(size[0], 0.3 * size[0]))
        leaf = leaves[random.choice(4)].rotate(random.normal(size=3).tolist(), random.uniform(0, 360))
        return leaf.translate(random.uniform(-0.7, 0.7, 3))
    op = random.choice(["union", "intersection", "difference"], p=[0.5, 0.2, 0.3])
    pair = shape(random, depth - 1), shape(random, depth - 1)
    return getattr(pair[0], op)(pair[1], k=float(random.choice([0, 0.1])))


SHEETS = {"gyroid": fb.gyroid, "schwarz_p": fb.schwarz_p, "diamond": fb.diamond, "iwp": fb.iwp}


def part(seed):
    """A printable part: its kind, a function that makes its mesh, its solid, and the voxels of its thinnest wall."""
    random = np.random.default_rng([41, seed])
    kind = ("lattice", "boolean", "shell", "tree")[seed % 4]
    resolution = int(random.integers(40, 201))
    if kind == "lattice":
        body = [fb.sphere(1), fb.box((2, 1.4, 1)), fb.cylinder(0.8, 2), fb.torus(1, 0.45)][random.integers(4)]
        body = body.rotate(random.normal(size=3).tolist(), random.uniform(0, 360))
        voxel = float(np.ptp(body.bounds, axis=0).max()) * 1.1 / resolution
        wall = float(random.choice([1.2, 1.5, 2, 3, 4]))
        cell = voxel * wall * random.uniform(4, 9)
        name = random.choice(list(SHEETS))
        made = body & SHEETS[name](cell, wall * voxel)
        return f"{kind} {name} {wall}", lambda sharp: made.to_mesh(resolution, sharp=sharp), made, wall
    if kind == "tree":
        made = shape(random)
        return kind, lambda sharp: made.to_mesh(resolution, sharp=sharp), made, 0.0
    base = shape(random, 2)
    mesh = base.to_mesh(48, bounds=[(-2, -2, -2), (2, 2, 2)])
    if kind == "shell":
        voxel = float(np.ptp(mesh.bounds, axis=0).max()) / resolution if len(mesh.faces) else 1.0
        wall = float(random.choice([0.5, 1, 1.5, 3]))
        side = random.choice(["inward", "outward", "both"])
        return f"{kind} {wall} {side}", lambda _: fb.shell(mesh, wall * voxel, resolution, side), None, wall
    other = shape(random, 2).to_mesh(48, bounds=[(-2, -2, -2), (2, 2, 2)])
    op = random.choice(["union", "intersection", "difference"])
    return f"{kind} {op}", lambda _: fb.boolean(op, mesh, other, resolution=resolution), None, 0.0


def check_part(census, seed):
    """Check the mesh of a part with sharp edges, and every other time without."""
    kind, make, solid, wall = part(seed)
    sharp = seed // 4 % 2 == 0 or solid is None
    try:
        mesh = make(sharp)
    except fb.Error as error:
        census.count(kind.split()[0], f"{seed} {kind}", type(error).__name__, str(error))
        return
    if not len(mesh.faces):
        census.count(kind.split()[0], f"{seed} {kind}", "empty")
        return
    found = problems(mesh)
    if solid is not None and sharp:
        expected, deviation = volume_of(solid)
        bound = VOLUME_ERRORS[0] if wall >= 3 else VOLUME_ERRORS[1]
        error = abs(mesh.volume - expected) / expected
        # A warning names walls and gaps thinner than a voxel, which this resolution does not represent.
        if not (error <= bound + 4 * deviation or mesh.report.warnings):
            found.append(f"volume {mesh.volume:.5g}, expected {expected:.5g}: {100 * error:.2f} %")
        beyond = max((solid.bounds[0] - mesh.bounds[0]).max(), (mesh.bounds[1] - solid.bounds[1]).max())
        if not beyond <= 1e-9:
            found.append(f"{beyond:.3g} outside the box of the shape")
    census.count(kind.split()[0], f"{seed} {kind} sharp={sharp}", "faulty" if found else "good", "; ".join(found))


def volume_of(solid):
    """The volume of a shape by random points, and the relative standard deviation."""
    lower, upper = solid.bounds
    random = np.random.default_rng(1)
    inside, total = 0, 0
    for _ in range(4):
        points = random.uniform(lower, upper, (POINTS // 4, 3))
        inside += int((solid.distance(points) < 0).sum())
        total += len(points)
    share = max(inside, 1) / total
    return share * float(np.prod(upper - lower)), np.sqrt((1 - share) / (share * total))


def operand(seed):
    """A bounded random shape of all operators, warps and sheets."""
    random = np.random.default_rng([200, seed])
    made = shape(random, 2)
    kind = seed % 10
    if kind == 0:
        made = made.twist(per_unit_deg=float(random.uniform(-90, 90)))
    elif kind == 1:
        made = made.bend(per_unit_deg=float(random.uniform(-60, 60)))
    elif kind == 2:
        made = made.elongate(random.uniform(0, 0.6, 3))
    elif kind == 3:
        made = made.repeat(random.uniform(0.8, 2, 3), random.integers(1, 3, 3))
    elif kind == 4:
        sheet = SHEETS[random.choice(list(SHEETS))]
        made = fb.sphere(1) & sheet(float(random.uniform(0.8, 1.4)), float(random.uniform(0.1, 0.2)))
    elif kind == 5:
        made = made.times(float(random.uniform(0.3, 3)))
    elif kind == 6:
        made = made ^ shape(random, 1)
    elif kind == 7:
        made = made.union(shape(random, 1), k=float(random.uniform(0.1, 0.4)))
    elif kind == 8:
        made = made.difference(shape(random, 1), chamfer=float(random.uniform(0.05, 0.2)))
    return made


def check_offset(census, seed):
    """Compare the mesh of an offset with the distance from the surface of its operand."""
    random = np.random.default_rng([201, seed])
    kind = ("twist", "bend", "elongate", "repeat", "sheet", "times", "xor", "smooth", "chamfer", "sharp")[seed % 10]
    made, distance = operand(seed), float(random.choice([-0.05, 0.04, 0.1, 0.2]))
    try:
        grown = made.offset(distance)
        mesh = grown.to_mesh(128)
    except fb.ShapeError as error:
        census.count(kind, str(seed), "refused", str(error))
        return
    if not len(mesh.faces):
        census.count(kind, str(seed), "empty")
        return
    # The mesh has an error of its own, so the level set itself is compared.
    points = on_surface(grown, fb.sample_surface(mesh, 4000, seed=seed).points)
    voxel = float(np.ptp(made.bounds, axis=0).max()) / 128
    found, is_smooth = distances_from(made, points, voxel)
    bound = max(OFFSET_VOXELS * voxel, OFFSET_SHARE * abs(distance))
    if made._core.field_kind == "distance":
        is_smooth &= ~is_past_an_edge(made, points, distance, bound)
    error = np.abs(found - abs(distance))[is_smooth]
    if not len(error):
        census.count(kind, str(seed), "only edges")
        return
    wrong = ~(error <= bound)
    text = f"{100 * wrong.mean():.2f} % of {len(error)} points beyond {bound:.3g}, largest error {error.max():.3g}"
    census.count(kind, str(seed), "faulty" if wrong.any() else "good", text if wrong.any() else "")


def is_past_an_edge(solid, points, distance, bound):
    """Whether a moved face goes on beyond the edge at which the face of an operand ends.

    A field that is not baked is shifted, so a face also moves where another operand has removed it. At such a point the
    slope is 1, and the foot of the perpendicular to the face lies off the surface.
    """
    slopes = solid.gradient(points).astype(np.float64)
    is_straight = np.abs(np.linalg.norm(slopes, axis=1) - 1) < 1e-3
    return is_straight & (values(solid, points - distance * slopes) * np.sign(distance) > bound)


def distances_from(solid, points, voxel):
    """Distances of points from the surface of a shape, and whether the nearest point lies on no edge and is unique.

    The nearest point of a fine mesh is moved along the surface until the line to the point is normal to it.
    """
    fine = solid.to_mesh(256)
    nearest = fb.closest_point(fine, points)
    start, rough = nearest.points, nearest.distances
    feet = start
    for _ in range(8):
        feet = on_surface(solid, feet)
        normals = unit(solid.gradient(feet).astype(np.float64))
        away = points - feet
        # A share of the way, since curvature may carry a full step too far.
        feet = feet + 0.5 * (away - np.einsum("ij,ij->i", away, normals)[:, None] * normals)
    feet = on_surface(solid, feet)
    # The search may end at a point that is normal but not nearest; the first foot bounds the distance from above.
    first = on_surface(solid, start)
    is_lost = np.linalg.norm(points - feet, axis=1) > np.linalg.norm(points - first, axis=1)
    feet = np.where(is_lost[:, None], first, feet)
    away = points - feet
    found = np.linalg.norm(away, axis=1)
    # The search stays on the part of the surface that the mesh has found.
    is_kept = np.abs(found - rough) <= 0.5 * voxel
    normals = unit(solid.gradient(feet).astype(np.float64))
    is_smooth = np.abs(np.einsum("ij,ij->i", unit(away), normals)) > 0.999
    for step in np.concatenate([np.eye(3), -np.eye(3)]) * 1.5 * voxel:
        other = unit(solid.gradient(on_surface(solid, feet + step)).astype(np.float64))
        is_smooth &= np.einsum("ij,ij->i", normals, other) > np.cos(np.radians(25))
        # Beside the medial surface, neighbours of the point have nearest points on another part.
        moved = points + step
        towards = unit(moved - fb.closest_point(fine, moved).points)
        is_smooth &= np.einsum("ij,ij->i", unit(points - start), towards) > np.cos(np.radians(40))
    return np.where(is_kept, found, rough), is_smooth & is_kept


def on_surface(solid, points):
    """Points moved to the surface by Newton's method."""
    for _ in range(6):
        slopes = solid.gradient(points).astype(np.float64)
        square = np.maximum(np.einsum("ij,ij->i", slopes, slopes), 1e-6)
        points = points - slopes * (values(solid, points) / square)[:, None]
    return points


def values(solid, points):
    """The field in float64; volumes have float32 samples."""
    try:
        return solid.distance(points, dtype="float64")
    except fb.ShapeError:
        return solid.distance(points).astype(np.float64)


def unit(vectors):
    """Vectors of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def soup(seed):
    """Sixty triangles of any place and winding."""
    random = np.random.default_rng(seed)
    corners = random.normal(size=(60, 1, 3)) + 0.6 * random.normal(size=(60, 3, 3))
    return corners.reshape(-1, 3), np.arange(180).reshape(-1, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=Path)
    parser.add_argument("--noise", type=int, default=1000)
    parser.add_argument("--shapes", type=int, default=300)
    parser.add_argument("--soups", type=int, default=5)
    parser.add_argument("--parts", type=int, default=0)
    parser.add_argument("--offsets", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--resolutions", type=int, nargs="+", default=[32, 64, 128, 200])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    start, census = time.process_time(), Census()
    for seed in range(options.noise):
        census.add("noise", seed, lambda seed=seed: noise(seed).to_mesh())
    random = np.random.default_rng(7)
    for i in range(options.shapes):
        made = shape(random)
        census.add("shapes", i, lambda made=made: made.to_mesh(24, bounds=[(-2, -2, -2), (2, 2, 2)]))
    for seed in range(options.soups):
        for choice in ({}, {"fill": "outer"}, {"fill": "outer", "seal": 3}):
            census.add("soups", f"{seed} {choice}", lambda seed=seed, choice=choice: fb.solid(soup(seed), 24, **choice))
    for seed in range(options.first, options.first + options.parts):
        check_part(census, seed)
    for seed in range(options.first, options.first + options.offsets):
        check_offset(census, seed)
    paths = sorted(path for path in options.models.rglob("*") if path.suffix in ENDINGS) if options.models else []
    for path in paths:
        for resolution in options.resolutions:
            name = f"{path.name} {resolution}"
            census.add("solid", name, lambda path=path, n=resolution: fb.solid(path, n))
            census.add("dense", name, lambda path=path, n=resolution: fb.bake(path, n).to_mesh())
            census.add("sparse", name, lambda path=path, n=resolution: fb.bake_sparse(path, n).to_mesh())
    faulty = census.report()
    print(f"{faulty:,} faulty meshes, {time.process_time() - start:.0f} s of processors")
    sys.exit(faulty > 0)


if __name__ == "__main__":
    main()
