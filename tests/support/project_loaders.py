"""Loaders of learning projects, written anew: which files they open, which keys, and what they expect of the arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def deepsdf(file: Path, subsample: int, random: np.random.Generator) -> Array:
    """Rows (subsample, 4): half with a positive distance, half with a negative one. Rows with NaN are dropped."""
    with np.load(file) as npz:
        groups = [npz[key] for key in ("pos", "neg")]
    kept = [rows[~np.isnan(rows[:, 3])] for rows in groups]
    return np.concatenate([rows[random.integers(len(rows), size=subsample // 2)] for rows in kept])


def onet(folder: Path) -> dict[str, Array]:
    """Points with occupancies, which are packed bits, and a cloud with normals; all float32."""
    with np.load(folder / "points.npz") as npz:
        points = npz["points"].astype(np.float32)
        occupancies = np.unpackbits(npz["occupancies"])[: len(points)].astype(np.float32)
        place = [npz[key].astype(np.float32) for key in ("loc", "scale")]
    with np.load(folder / "pointcloud.npz") as npz:
        cloud = [npz[key].astype(np.float32) for key in ("points", "normals", "loc", "scale")]
    names = ("points", "occ", "loc", "scale", "cloud", "normals")
    return dict(zip(names, (points, occupancies, *place, *cloud[:2]), strict=True))


def vecset(root: Path, category: str, model: str, random: np.random.Generator, few: int) -> tuple[Array, Array, Array]:
    """Points (2 few, 3), labels (2 few,) and points of the surface in the scale of the points."""
    file = root / "ShapeNetV2_point" / category / f"{model}.npz"
    with np.load(file) as npz:
        groups = [(npz[f"{name}_points"], npz[f"{name}_label"]) for name in ("vol", "near")]
    scale = np.load(file.with_suffix(".npy")).item()
    with np.load(root / "ShapeNetV2_watertight" / category / "4_pointcloud" / f"{model}.npz") as npz:
        surface = npz["points"].astype(np.float32) * scale
    rows = [random.choice(len(points), few, replace=False) for points, _ in groups]
    points = np.concatenate([points[row] for (points, _), row in zip(groups, rows, strict=True)])
    labels = np.concatenate([labels[row] for (_, labels), row in zip(groups, rows, strict=True)])
    return points, labels.astype(np.float32), surface


def hunyuan(folder: Path, few: int, random: np.random.Generator) -> tuple[Array, dict[str, Array]]:
    """Rows (2 few, 7) of a model, whose folder has its name, and the arrays of its labels.

    A row has a position, a unit normal, and whether the point is on a crease. No row is drawn twice.
    """
    files = {kind: folder / "geo_data" / f"{folder.name}_{kind}.npz" for kind in ("surface", "sdf")}
    groups = []
    with np.load(files["surface"]) as npz:
        for on_crease, key in enumerate(("random_surface", "sharp_surface")):
            rows = npz[key][random.choice(len(npz[key]), few, replace=False)].astype(np.float32)
            normals = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
            groups.append(np.column_stack([rows[:, :3], normals, np.full(few, on_crease)]))
    with np.load(files["sdf"]) as npz:
        return np.concatenate(groups), dict(npz)


def dora(file: Path, near: int = 400_000) -> dict[str, Array]:
    """Surfaces (m, 6), and the points and distances near sharp edges, near the surface and in the cube."""
    with np.load(file) as npz:
        sharp, rows = npz["sharp_near_surface"], npz["rand_points"]
        surfaces = {key: npz[f"fps_{key}_surface"][:, 0, :] for key in ("coarse", "sharp")}
    return {**surfaces, "near edges": sharp, "near": rows[:near], "cube": rows[near:]}


def label_groups(name: str, found: dict[str, Array]) -> list[tuple[Array, Array]]:
    """Points with labels that are negative inside, from the arrays of a recipe; occupancies become -1 and 1."""
    if name == "deepsdf":
        return [(rows[:, :3], rows[:, 3]) for rows in (found["pos"], found["neg"])]
    if name == "onet":
        bits = np.unpackbits(found["points/occupancies"])[: len(found["points/points"])]
        return [(found["points/points"], 1.0 - 2 * bits)]
    if name == "vecset":
        return [(found[f"points/{one}_points"], 1.0 - 2 * found[f"points/{one}_label"]) for one in ("vol", "near")]
    if name == "dora":
        return [(rows[:, :3], -rows[:, 3]) for rows in (found["sharp_near_surface"], found["rand_points"])]
    names = ("vol", "random_near", "sharp_near")
    return [(found[f"sdf/{one}_points"], -found[f"sdf/{one}_label"].astype(np.float64)) for one in names]
