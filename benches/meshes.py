"""The meshes of the benchmarks."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

#: Folders with real models, in addition to the models of Python packages.
FOLDERS = [Path(os.environ.get("FIELDBAKE_MESHES", Path(__file__).resolve().parents[2] / "shared" / "meshes"))]
NAMES = ["stanford-bunny", "armadillo", "spot/spot", "dragon"]


def find(names: list[str] | None = None) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, float32 vertices and faces of each mesh that is found; pymeshlab's bunny if there is none."""
    found = False
    for name in names or NAMES:
        for path in (folder / f"{name}{ending}" for folder in FOLDERS for ending in (".obj", ".ply")):
            if path.exists():
                found = True
                yield load(path)
    if not found and not names:
        import pymeshlab

        yield load(next(Path(pymeshlab.__file__).parent.rglob("bunny*.*")))


def load(path: Path) -> tuple[str, np.ndarray, np.ndarray]:
    """Load one file, with vertices rounded to float32 so that every tool gets the same mesh."""
    import trimesh

    mesh = trimesh.load(path, process=False, force="mesh")
    return path.stem, np.ascontiguousarray(mesh.vertices, np.float32), np.ascontiguousarray(mesh.faces, np.uint32)


def knot(faces: int) -> tuple[str, np.ndarray, np.ndarray]:
    """A trefoil with about this many faces."""
    import fieldbake as fb

    sides = max(3, round((faces / 20) ** 0.5))
    mesh = fb.models.torus_knot(segments=max(3, round(faces / 2 / sides)), sides=sides)
    return f"knot {len(mesh.faces):,}", mesh.vertices, mesh.faces
