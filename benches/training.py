"""Recipes of `fieldbake.training` beside plain scripts with the libraries of the projects: seconds, failures, signs.

    python benches/training.py [--meshes 100] [--shells 3]

The first table has 100 meshes: 65 closed ones, 25 open ones and 10 broken ones, made in code and from real models. The
plain scripts follow the rules of the projects with trimesh, libigl, pysdf and fpsample in a few lines. DeepSDF's
program needs a window, so its plain script takes libigl for the labels, and Dora's takes trimesh in place of Blender.
Numbers are smaller than the numbers of the projects, and equal on both sides. The second table has the full numbers of
Hunyuan3D 2.1 on the same shells: libigl's calls of the project beside ours. Signs are compared with libigl's exact
winding number, where that is farther than 0.05 from 1/2. Seconds are summed over all processors.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import defaultdict
from pathlib import Path

import fpsample
import igl
import numpy as np
import pysdf
import trimesh
from scipy.stats import truncnorm

import fieldbake as fb
from fieldbake.scaling import rules

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests" / "support"))

#: Numbers of both sides in the first table.
NUMBERS = {
    "deepsdf": {"n": 20_000},
    "onet": {"n": 5_000, "surface_n": 5_000},
    "vecset": {"n": 5_000, "near_n": 5_000, "surface_n": 5_000},
    "hunyuan": {"n": 6_000, "shell_resolution": 64},
    "dora": {"n": 4_096, "surface_n": 10_000, "uniform_n": 10_000},
}

#: Points of each result whose sign is compared.
COMPARED = 1_000

FAST = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER


def made_meshes():
    """The geometries of the tests, under an own import, since the benchmarks have a module of the same name."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("test_meshes", ROOT / "tests" / "support" / "meshes.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["test_meshes"] = module
    spec.loader.exec_module(module)
    return module


def models():
    """Real models: vertices and faces by name."""
    from meshes import FOLDERS, load

    folder = next(path for path in FOLDERS)
    names = ("fandisk", "rocker-arm", "suzanne", "teapot", "woody", "spot/spot", "stanford-bunny", "armadillo")
    return {name: load(folder / f"{name}.obj")[1:] for name in names if (folder / f"{name}.obj").exists()}


def library(count):
    """Closed, open and broken meshes, 65 : 25 : 10, as (kind, name, vertices, faces)."""
    t = made_meshes()
    random = np.random.default_rng(0)
    closed = {
        "box": t.box(), "slab": t.box((-1, -1, -0.02), (1, 1, 0.02)), "bar": t.box((-3, -0.1, -0.1), (3, 0.1, 0.1)),
        "tetrahedron": t.tetrahedron(), "ball": t.icosphere(4), "coarse ball": t.icosphere(1), "capsule": t.capsule(),
        "torus": t.torus(), "thin torus": t.torus(1.0, 0.03), "knot": t.knot(), "hollow ball": t.hollow_sphere(),
        "gear": (fb.models.gear().vertices, fb.models.gear().faces), "uv ball": t.uv_sphere(),
    }  # fmt: skip
    opened = {"open box": t.open_box(), "sheet": t.flat_sheet(), "triangle": t.triangle()}
    for name, (vertices, faces) in models().items():
        kind = closed if fb.Mesh(vertices, faces).is_closed else opened
        kind[name] = (vertices, faces)
    whole = list(closed.items())
    while len(opened) < 25:
        name, (vertices, faces) = whole[len(opened) % len(whole)]
        kept = random.random(len(faces)) > 0.05 + 0.3 * random.random()
        opened[f"{name} with holes {len(opened)}"] = (vertices, np.asarray(faces)[kept])
    while len(closed) < 65:
        name, (vertices, faces) = whole[len(closed) % len(whole)]
        stretched = np.asarray(vertices, float) * random.uniform(0.3, 1, 3) @ t.rotation(len(closed))[:3, :3]
        closed[f"{name} stretched {len(closed)}"] = (stretched * 10 ** random.uniform(-3, 3), faces)
    ball = t.icosphere(3)
    broken = {
        "soup": t.soup(), "half flipped": t.flip_some(ball, 0.5), "inside out": t.flip(ball),
        "doubled": t.doubled(ball),
        "doubled opposite": t.doubled_opposite(ball), "cracked": t.cracked(ball), "overlapping": t.overlapping_boxes(),
        "needles": t.needle_fan(), "degenerate": t.Geometry(ball[0], np.concatenate([ball[1], [(0, 0, 1), (2, 2, 2)]])),
        "no faces": t.Geometry(ball[0], np.zeros((0, 3), int)),
    }  # fmt: skip
    parts = (("closed", closed, 0.65), ("open", opened, 0.25), ("broken", broken, 0.1))
    for kind, some, share in parts:
        for name, (vertices, faces) in list(some.items())[: round(count * share)]:
            yield kind, name, np.array(vertices, float), np.array(faces, np.int64)


class Skipped(Exception):
    """The project writes no file for such a mesh."""


# The plain scripts return the mesh of the labels, and (points, labels) with the sign of distances, negative inside.


def plain_deepsdf(vertices, faces, n):
    used = vertices[np.unique(faces)]
    center = (used.min(axis=0) + used.max(axis=0)) / 2
    vertices = (vertices - center) / np.linalg.norm(used - center, axis=1).max() / 1.03
    near = int(47 * n / 50)
    surface = trimesh.Trimesh(vertices, faces, process=False).sample(near // 2)
    random = np.random.default_rng(0)
    offsets = [surface + random.normal(scale=variance**0.5, size=surface.shape) for variance in (0.005, 0.0005)]
    points = np.concatenate([*offsets, random.uniform(-1, 1, (n - near, 3))])
    return (vertices, faces), [(points, igl.signed_distance(points, vertices, faces, FAST)[0])]


def plain_onet(vertices, faces, n, surface_n):
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    lower, upper = mesh.bounds
    mesh.apply_translation(-(lower + upper) / 2)
    mesh.apply_scale(1 / (upper - lower).max())
    mesh.sample(surface_n)
    if not mesh.is_watertight:
        raise Skipped
    points = 1.1 * (np.random.default_rng(0).random((n, 3)) - 0.5)
    return (np.array(mesh.vertices), np.array(mesh.faces)), [(points, np.where(mesh.contains(points), -1.0, 1.0))]


def plain_hunyuan(vertices, faces, n, shell_resolution):
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - lower) / ((upper - lower).max() * 1.01)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    lower, upper = lower - 0.05 * (upper - lower), upper + 0.05 * (upper - lower)
    axes = [np.linspace(a, b, shell_resolution) for a, b in zip(lower, upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = igl.signed_distance(grid, vertices, faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    # libigl's grids have x fastest.
    order = np.arange(len(grid)).reshape((shell_resolution,) * 3).transpose(2, 1, 0).ravel()
    field = 2 / 256 - np.abs(distances)
    shell, cells, _ = igl.marching_cubes(field[order], grid[order], *(shell_resolution,) * 3, 0.0)
    mesh = trimesh.Trimesh(shell, cells)
    surface, sharp = mesh.sample(n), sharp_points(mesh, n)
    groups = [(points, -label) for points, label in libigl_labels(mesh, surface, sharp)]
    return (np.array(mesh.vertices), np.array(mesh.faces)), groups


def sharp_points(mesh, n):
    """Points on edges whose vertices have a steep face, uniform by length."""
    cosines = np.einsum("fci,fi->fc", mesh.vertex_normals[mesh.faces], mesh.face_normals)
    least = np.ones(len(mesh.vertices))
    np.minimum.at(least, mesh.faces, cosines)
    edges = mesh.edges[(least[mesh.edges] < 0.985).all(axis=1)]
    ends = mesh.vertices[edges]
    weights = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    random = np.random.default_rng(0)
    rows = np.searchsorted((weights / weights.sum()).cumsum(), random.random(n))
    along = random.random((n, 1))
    return along * ends[rows, 0] + (1 - along) * ends[rows, 1]


def libigl_labels(mesh, surface, sharp):
    """The three groups of points of the project, and their labels by libigl with the fast winding number."""
    random = np.random.default_rng(1)
    volume = (random.random((2 * len(sharp), 3)) - 0.5) * 2.1
    near = [
        surface + truncnorm.rvs(-0.25 / s, 0.25 / s, scale=s, size=surface.shape, random_state=random)
        for s in (0.005, 0.05)
    ]
    deviations = np.repeat((0.001, 0.003, 0.06, 0.01, 0.02, 0.04), len(sharp) // 6)
    deviations = np.concatenate([deviations, np.full(len(sharp) - len(deviations), 0.04)])
    edges = sharp + deviations[:, None] * random.normal(size=sharp.shape)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    groups = [volume, np.concatenate(near), edges]
    return [(points, -igl.signed_distance(points, vertices, faces, FAST)[0]) for points in groups]


def plain_dora(vertices, faces, n, surface_n, uniform_n):
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices = (vertices - center) * 2 / np.ptp(vertices, axis=0).max()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    edges = mesh.face_adjacency_edges[mesh.face_adjacency_angles > np.radians(15)]
    if not len(edges):
        raise Skipped
    ends, known = mesh.vertices[edges], mesh.vertices[np.unique(edges)]
    steps = max(0, n // 2 - len(known)) // len(edges)
    along = (np.arange(1, steps + 1) / (steps + 1))[:, None, None]
    sharp = np.concatenate([((1 - along) * ends[:, 0] + along * ends[:, 1]).reshape(-1, 3), known])
    random = np.random.default_rng(0)
    points = [sharp + random.normal(scale=s, size=sharp.shape) for s in (0.001, 0.005, 0.007, 0.01)]
    surface = mesh.sample(surface_n)
    points += [surface + random.normal(scale=s, size=surface.shape) for s in (0.001, 0.005)]
    points = np.concatenate([*points, random.uniform(-1.05, 1.05, (uniform_n, 3))])
    labels = -pysdf.SDF(mesh.vertices, mesh.faces)(points)
    fpsample.bucket_fps_kdline_sampling(mesh.sample(surface_n), n // 2, h=5)
    return (np.array(mesh.vertices), np.array(mesh.faces)), [(points, labels)]


PLAIN = {"deepsdf": plain_deepsdf, "onet": plain_onet, "hunyuan": plain_hunyuan, "dora": plain_dora}


def checked(recipe, found, vertices, faces):
    """Check our arrays; return the mesh of the labels, and (points, labels) with the sign of distances."""
    from project_loaders import label_groups

    if not all(np.isfinite(array.astype(float)).all() for array in found.values()):
        raise ValueError("an array is not finite")
    matrix = fb.training.recipes()[recipe].transform((vertices, faces))
    moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if recipe == "hunyuan":
        shell = rules._shell(fb.Mesh(moved, faces), 2 / 256, NUMBERS[recipe]["shell_resolution"])
        moved, faces = shell.vertices, shell.faces.astype(np.int64)
    return (moved, faces), label_groups(recipe, found)


def signs(mesh, groups, recipe):
    """Number of compared signs and of wrong ones, against the exact winding number."""
    points, labels = (
        np.concatenate([np.asarray(part, float) for part in parts]) for parts in zip(*groups, strict=True)
    )
    rows = np.random.default_rng(0).permutation(len(points))[:COMPARED]
    winding = igl.winding_number(
        np.ascontiguousarray(mesh[0], float), np.ascontiguousarray(mesh[1], np.int64), points[rows]
    )
    if recipe == "hunyuan":
        # libigl's marching cubes turn the shell inside out, and its signs take the magnitude.
        winding = np.abs(winding)
    decided = np.abs(winding - 0.5) > 0.05
    return int(decided.sum()), int(((labels[rows] < 0) != (winding > 0.5))[decided].sum())


def timed(job):
    """The processor seconds of a call and its result, or its error."""
    start = time.process_time()
    try:
        result = job()
    except Exception as error:
        result = error
    return time.process_time() - start, result


def census(count):
    """Print the table of all recipes."""
    items = list(library(count))
    print(f"{len(items)} meshes, {sum(len(faces) for *_, faces in items):,} faces\n", file=sys.stderr)
    rows = defaultdict(lambda: {"s": 0.0, "failed": [], "skipped": 0, "compared": 0, "wrong": 0, "broken": 0})
    for kind, name, vertices, faces in items:
        for recipe, numbers in NUMBERS.items():
            jobs = {"ours": lambda r=recipe, v=vertices, f=faces, n=numbers: fb.training.sample((v, f), r, **n)}
            if recipe in PLAIN:
                jobs["plain"] = lambda r=recipe, v=vertices, f=faces, n=numbers: PLAIN[r](v, f, **n)
            for side, job in jobs.items():
                row = rows[recipe, side]
                seconds, result = timed(job)
                if isinstance(result, dict):
                    result = checked(recipe, result, vertices, faces)
                if isinstance(result, Skipped):
                    row["skipped"] += 1
                elif isinstance(result, Exception):
                    row["failed"].append(f"{kind} {name}: {type(result).__name__}: {str(result)[:60]}")
                else:
                    row["s"] += seconds
                    compared, wrong = signs(*result, recipe)
                    if kind == "broken":
                        row["broken"] += wrong
                    else:
                        row["compared"] += compared
                        row["wrong"] += wrong
        print(f"{kind} {name}: {len(faces):,} faces", file=sys.stderr, flush=True)
    print("| recipe | side | results | skipped | failed | processor s | wrong signs, closed and open | broken |")
    print("|---|---|---|---|---|---|---|---|")
    for (recipe, side), row in rows.items():
        results = len(items) - row["skipped"] - len(row["failed"])
        wrong = f"{row['wrong']:,} of {row['compared']:,}"
        cells = (recipe, side, results, row["skipped"], len(row["failed"]), f"{row['s']:.1f}", wrong, row["broken"])
        print(f"| {' | '.join(map(str, cells))} |")
    print()
    for (recipe, side), row in rows.items():
        for text in row["failed"]:
            print(f"- {recipe}, {side}: {text}")


def shells(count):
    """Print the table of libigl's labels beside ours on the shells of Hunyuan3D 2.1 with the numbers of the project."""
    print("\n| model | faces of the shell | libigl s | ours s | libigl wrong | ours wrong | largest difference |")
    print("|---|---|---|---|---|---|---|")
    for name, (vertices, faces) in list(models().items())[:count]:
        matrix = fb.training.recipes()["hunyuan"].transform((vertices, faces))
        moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        shell = rules._shell(fb.Mesh(moved, faces), 2 / 256, 256)
        parts = np.array(shell.vertices), shell.faces.astype(np.int64)
        mesh = trimesh.Trimesh(*parts, process=False)
        n = 124_928
        surface = fb.sample_surface(shell, n).points
        sharp = fb.sample_surface(shell, n, seed=1).points
        their_s, groups = timed(lambda m=mesh, a=surface, b=sharp: libigl_labels(m, a, b))
        points = np.concatenate([part for part, _ in groups])
        # A new mesh, so that the time has the search tree, as libigl's time has.
        our_s, found = timed(lambda p=parts, q=points: fb.query(fb.Mesh(*p), q).distances)
        labels = -np.concatenate([label for _, label in groups])
        (compared, theirs), (_, own) = (
            signs(parts, [(points, labels)], "hunyuan"),
            signs(parts, [(points, found)], "hunyuan"),
        )
        largest = np.abs(np.abs(labels) - np.abs(found)).max()
        row = (
            name,
            f"{len(parts[1]):,}",
            f"{their_s:.1f}",
            f"{our_s:.1f}",
            f"{theirs} of {compared:,}",
            f"{own}",
            f"{largest:.1e}",
        )
        print(f"| {' | '.join(row)} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=int, default=100)
    parser.add_argument("--shells", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    census(options.meshes)
    shells(options.shells)


if __name__ == "__main__":
    main()
