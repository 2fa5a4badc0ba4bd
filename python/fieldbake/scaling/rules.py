"""The rules of the recipes: the points that a mesh gives, their labels, and the order of both.

A rule takes a mesh in the space of its recipe and the numbers of the recipe. Only numbers and names are taken from the
projects; ``recipes.py`` has their sources.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.grid import Grid
from ..base.notices import warn_surface
from ..base.optional import optional_module
from ..base.report import Report
from ..meshes import measures
from ..meshes.isosurface import extract
from ..meshes.mesh import Mesh
from ..queries.common import Sign
from ..queries.edges import along_edges, edges_of, sharp_edges
from ..queries.nearest import query
from ..queries.sampling import SurfaceSamples, count_uncertain, sample_surface
from ..surfaces.fields import MeshField, Shifted
from ..volumes.level_set_blocks import level_set

Array = NDArray[Any]
Arrays = dict[str, Array]
Numbers = Mapping[str, Any]

#: Height of the tree of fpsample, the number in the code of Dora. A cloud has at least 2^height points.
TREE_HEIGHT = 5


@dataclass
class Drawing:
    """A mesh in the space of a recipe, and the random numbers of one call."""

    #: The mesh in the space of the recipe: ``(position - origin) / size``.
    mesh: Mesh
    origin: Array
    size: float
    random: np.random.Generator
    sign: Sign
    device: str
    #: The points of the labels, and the report of their query.
    labelled: tuple[Array, Report] | None = None
    warnings: list[str] = field(default_factory=list)

    def surface(self, n: int) -> SurfaceSamples:
        """Draw points of the surface, uniform by area; each call draws others."""
        return sample_surface(self.mesh, n, seed=int(self.random.integers(2**63)), progress=False)

    def near(self, points: Array, deviation: float) -> Array:
        """Add an offset with a standard deviation to each coordinate."""
        return points + deviation * self.random.standard_normal(points.shape)

    def cut(self, points: Array, deviation: float, most: float) -> Array:
        """Add an offset with a standard deviation to each coordinate, at most `most` long; longer ones are redrawn."""
        offsets = deviation * self.random.standard_normal(points.shape)
        while (beyond := np.abs(offsets) > most).any():
            offsets[beyond] = deviation * self.random.standard_normal(int(beyond.sum()))
        return points + offsets

    def cube(self, n: int, half: float) -> Array:
        """Draw points uniform in a cube about the origin."""
        return self.random.uniform(-half, half, (n, 3))

    def shells(self, points: Array, deviations: Sequence[float]) -> Array:
        """Add offsets: equal parts of the points in order have one deviation each; the last part has the rest."""
        step = len(points) // len(deviations)
        starts = [part * step for part in range(len(deviations))]
        parts = zip(deviations, starts, [*starts[1:], len(points)], strict=True)
        return np.concatenate([self.near(points[first:last], one) for one, first, last in parts])

    def distances(self, *stored: Array) -> list[NDArray[np.float64]]:
        """Evaluate signed distances at points as they are stored, negative inside; one array for each of points."""
        points = np.concatenate([np.asarray(part, np.float64) for part in stored])
        found = query(self.mesh, points, sign=self.sign, device=self.device, progress=False)
        warn_surface(self.warnings)
        self.labelled = points, found.report
        return np.split(found.distances, np.cumsum([len(part) for part in stored])[:-1])

    def report(self) -> Report:
        """The report of the labels. The count of uncertain signs takes longer than the labels of an open mesh."""
        assert self.labelled is not None
        points, report = self.labelled
        uncertain = count_uncertain(self.mesh, points, report)
        return replace(report, undecided_voxels=uncertain, warnings=(*report.warnings, *self.warnings))

    def surface_instead(self, n: int) -> Array:
        """Draw points and normals of the surface where sharp edges were requested and none exists, (n, 6)."""
        self.warnings.append("no edge is sharp, so the points for sharp edges are points of the surface")
        return _with_normals(self.surface(n))


def _with_normals(samples: SurfaceSamples) -> Array:
    return np.concatenate([samples.points, samples.normals], axis=1)


def _box(mesh: Mesh) -> tuple[Array, Array]:
    """The centre and the sides of the box of a mesh."""
    lower, upper = mesh.bounds
    return lower + (upper - lower) / 2, upper - lower


# --- DeepSDF ---


def deepsdf_frame(mesh: Mesh) -> tuple[Array, float]:
    """Centre of the box, and the largest radius about it."""
    center, _ = _box(mesh)
    used = mesh.vertices[np.unique(mesh.faces)] - center
    return center, float(np.linalg.norm(used, axis=1).max())


def deepsdf(drawing: Drawing, numbers: Numbers) -> Arrays:
    """Points with two offsets for each point of the surface, then points of the cube, divided by the side."""
    n = numbers["n"]
    variances = numbers["variances"]
    surface = drawing.surface(int(n * numbers["near_share"] + 1e-9) // len(variances)).points
    # The offsets of a surface point are neighbours in the array.
    offsets = [drawing.near(surface, math.sqrt(variance)) for variance in variances]
    near = np.stack(offsets, axis=1).reshape(-1, 3)
    points = np.concatenate([near, drawing.cube(n - len(near), 1.0)])
    points = points.astype(np.float32)
    (distances,) = drawing.distances(points)
    rows = np.concatenate([points, distances[:, None].astype(np.float32)], axis=1)
    outside = rows[:, 3] > 0
    return {"pos": rows[outside], "neg": rows[~outside]}


# --- Occupancy networks ---


def onet_frame(mesh: Mesh) -> tuple[Array, float]:
    """Centre of the box, and its longest side."""
    center, sides = _box(mesh)
    return center, float(sides.max())


def onet(drawing: Drawing, numbers: Numbers) -> Arrays:
    """Occupancies of points in a cube, packed into bits, and points of the surface."""
    uniform = int(numbers["n"] * numbers["uniform_ratio"])
    near = drawing.near(drawing.surface(numbers["n"] - uniform).points, numbers["sigma"])
    points = np.concatenate([drawing.cube(uniform, (1 + numbers["points_padding"]) / 2), near]).astype(np.float16)
    cloud = drawing.surface(numbers["surface_n"])
    (distances,) = drawing.distances(points)
    place = {"loc": drawing.origin, "scale": np.array(drawing.size)}
    return {
        "points/points": points,
        "points/occupancies": np.packbits(distances < 0),
        **{f"points/{name}": value for name, value in place.items()},
        "pointcloud/points": cloud.points.astype(np.float16),
        "pointcloud/normals": cloud.normals.astype(np.float16),
        **{f"pointcloud/{name}": value for name, value in place.items()},
    }


# --- 3DShape2VecSet ---


def vecset_frame(mesh: Mesh) -> tuple[Array, float]:
    """Centre of the box, and half its longest side."""
    center, sides = _box(mesh)
    return center, float(sides.max()) / 2


def vecset(drawing: Drawing, numbers: Numbers) -> Arrays:
    """Occupancies of points in the cube and near the surface, and points of the surface in a box of longest side 1."""
    volume = drawing.cube(numbers["n"], 1.0).astype(np.float32)
    near = drawing.shells(drawing.surface(numbers["near_n"]).points, numbers["sigmas"]).astype(np.float32)
    inside = [distances < 0 for distances in drawing.distances(volume, near)]
    return {
        "points/vol_points": volume,
        "points/vol_label": inside[0],
        "points/near_points": near,
        "points/near_label": inside[1],
        # The loader multiplies the points of the surface by this number.
        "scale": np.array(2.0),
        "pointcloud/points": (drawing.surface(numbers["surface_n"]).points / 2).astype(np.float32),
    }


# --- Hunyuan3D 2.1 ---


def hunyuan_frame(mesh: Mesh) -> tuple[Array, float]:
    """Lower corner of the box, and its longest side."""
    lower, upper = mesh.bounds
    return lower, float((upper - lower).max())


def hunyuan(drawing: Drawing, numbers: Numbers) -> Arrays:
    """Surface, creases and distances of a closed shell around the mesh."""
    n = numbers["n"]
    drawing.mesh = _shell(drawing.mesh, numbers["shell_width"], numbers["shell_resolution"])
    random_surface = _with_normals(drawing.surface(n))
    sharp_surface = _crease_points(drawing, numbers["crease"], n)
    volume = drawing.cube(2 * n, numbers["box"])
    near = np.concatenate([drawing.cut(random_surface[:, :3], one, numbers["cut"]) for one in numbers["sigmas"]])
    sharp_near = drawing.shells(sharp_surface[:, :3], numbers["edge_sigmas"])
    points = [volume, drawing.random.permutation(near), drawing.random.permutation(sharp_near)]
    points = [part.astype(np.float16) for part in points]
    labels = [(-distances).astype(np.float16) for distances in drawing.distances(*points)]
    arrays = {
        "surface/random_surface": random_surface.astype(np.float16),
        "surface/sharp_surface": sharp_surface.astype(np.float16),
    }
    for name, positions, label in zip(("vol", "random_near", "sharp_near"), points, labels, strict=True):
        arrays[f"sdf/{name}_points"], arrays[f"sdf/{name}_label"] = positions, label
    return arrays


def _shell(mesh: Mesh, width: float, resolution: int) -> Mesh:
    """Extract the surface at the unsigned distance `width` of a mesh, from samples on a grid."""
    lower, upper = mesh.bounds
    # The margin is 5 % of each side, but the shell of a flat mesh needs more.
    margin = np.maximum(0.05 * (upper - lower), width + 2 * (upper - lower).max() / resolution)
    lower, upper = lower - margin, upper + margin
    # The first and the last samples lie on the faces of the box.
    half = (upper - lower) / (resolution - 1) / 2
    grid = Grid(checks.triple(lower - half), checks.triple(upper + half), (resolution,) * 3)
    wall = Shifted(MeshField(mesh, unsigned=True), width)
    return extract(level_set(wall.values, grid, 0.0, samples=wall.samples), 0.0, None, sharp=False, capped=True)


def _crease_points(drawing: Drawing, crease: float, n: int) -> Array:
    """Draw points and mean normals (n, 6), uniform by length on edges between two vertices of creases.

    A vertex belongs to a crease if the cosine between its normal and the normal of one of its faces is below `crease`.
    """
    mesh = drawing.mesh
    faces = mesh.faces.astype(np.int64)
    cosines = np.einsum("fci,fi->fc", mesh.vertex_normals[faces], mesh.face_normals)
    least = np.ones(len(mesh.vertices))
    np.minimum.at(least, faces, cosines)
    edges = edges_of(mesh, faces).vertices
    edges = edges[(least[edges] < crease).all(axis=1)]
    if not len(edges):
        return drawing.surface_instead(n)
    ends = np.concatenate([mesh.vertices[edges], mesh.vertex_normals[edges]], axis=2)
    lengths = np.linalg.norm(ends[:, 1, :3] - ends[:, 0, :3], axis=1)
    rows, along = along_edges(lengths, n, drawing.random)
    points: Array = ends[rows, 0] + along[:, None] * (ends[rows, 1] - ends[rows, 0])
    return points


# --- Dora ---


def dora(drawing: Drawing, numbers: Numbers) -> Arrays:
    """Vertices and equal steps of sharp edges, surface points, their farthest-point subsets, and distances."""
    count = numbers["n"] // 2
    farthest = _Farthest(drawing.random)
    sharp = _edge_points(drawing, numbers["angle_deg"], count)
    sharp_near = np.concatenate([drawing.near(sharp[:, :3], one) for one in numbers["edge_sigmas"]])
    surface = drawing.surface(numbers["surface_n"]).points
    near = [drawing.near(surface, one) for one in numbers["sigmas"]]
    points = np.concatenate([*near, drawing.cube(numbers["uniform_n"], numbers["box"])])
    stored = [part.astype(np.float32) for part in (sharp_near, points)]
    rows = [
        np.concatenate([part, -distances[:, None]], axis=1, dtype=np.float32)
        for part, distances in zip(stored, drawing.distances(*stored), strict=True)
    ]
    # The project draws other points of the surface for the subset.
    coarse = _with_normals(drawing.surface(numbers["surface_n"]))
    return {
        "fps_sharp_surface": farthest(sharp, count)[:, None].astype(np.float32),
        "sharp_near_surface": rows[0],
        "fps_coarse_surface": farthest(coarse, count)[:, None].astype(np.float32),
        "rand_points": rows[1],
    }


def _edge_points(drawing: Drawing, angle_deg: float, count: int) -> Array:
    """Place `count` points with normals on sharp edges, (count or more, 6).

    All vertices of sharp edges are points, after equally many equal steps inside each edge. Single points of random
    edges fill the rest. The array has more points if there are more vertices.
    """
    positions, faces, edges = sharp_edges(drawing.mesh, angle_deg)
    if not len(edges.faces):
        return drawing.surface_instead(count)
    normals = measures.vertex_normals(positions, faces.astype(np.uint32))
    corners = np.unique(edges.vertices)
    known = np.concatenate([positions[corners], normals[corners]], axis=1)
    missing = max(0, count - len(corners))
    steps, rest = divmod(missing, len(edges.faces))
    chosen = drawing.random.choice(len(edges.faces), rest, replace=False)
    rows = np.concatenate([np.repeat(np.arange(len(edges.faces)), steps), chosen])
    regular = np.tile(np.arange(1, steps + 1) / (steps + 1), len(edges.faces))
    along = np.concatenate([regular, drawing.random.random(rest)])[:, None]
    first, last = positions[edges.vertices[rows]].transpose(1, 0, 2)
    inner = np.concatenate([(1 - along) * first + along * last, edges.normals[rows]], axis=1)
    return np.concatenate([inner, known])


class _Farthest:
    """Farthest-point subsets by the package fpsample, which the first point of each subset determines."""

    def __init__(self, random: np.random.Generator) -> None:
        self._module = optional_module("fpsample", "the recipe 'dora'", extra="training")
        self._random = random

    def __call__(self, points: Array, count: int) -> Array:
        """Select `count` rows of points (n, 6) by their positions. All rows stay if there are not more."""
        start = int(self._random.integers(len(points)))
        if count >= len(points):
            return points
        height = min(TREE_HEIGHT, int(math.log2(len(points))))
        rows = self._module.bucket_fps_kdline_sampling(points[:, :3], count, h=height, start_idx=start)
        chosen: Array = points[rows.astype(np.int64)]
        return chosen
