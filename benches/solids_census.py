"""Count the meshes that are not closed two-manifolds: noise, random shapes, models, damaged files and soups.

    python benches/solids_census.py --models FOLDER [--noise 1000] [--shapes 300] [--resolutions 32 64 128 200]

Every mesh must use each directed edge once each way, have one fan of faces at each vertex and no face without an area,
be accepted by manifold3d and be watertight for trimesh. A model without an inside may end in a `MeshError`.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import manifold3d
import numpy as np
import trimesh

import fieldbake as fb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from manifold import faults

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
    return found


class Census:
    """Number of meshes by kind and outcome."""

    def __init__(self):
        self.outcomes = {}

    def add(self, kind, name, make):
        """Check the mesh that `make` returns; None counts as empty."""
        counts = self.outcomes.setdefault(kind, Counter())
        try:
            mesh = make()
        except fb.MeshError as error:
            counts["MeshError"] += 1
            print(f"{kind} {name}: {error}")
            return
        if not len(mesh.faces):
            counts["empty"] += 1
            return
        found = problems(mesh)
        counts["faulty" if found else "good"] += 1
        if found:
            print(f"{kind} {name}: {'; '.join(found)}")

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
    for seed in range(5):
        for choice in ({}, {"fill": "outer"}, {"fill": "outer", "seal": 3}):
            census.add("soups", f"{seed} {choice}", lambda seed=seed, choice=choice: fb.solid(soup(seed), 24, **choice))
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
