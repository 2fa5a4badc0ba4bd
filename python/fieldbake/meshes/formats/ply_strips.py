"""Triangle strips of PLY files, which trimesh keeps as raw data beside a cloud of points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def with_strips(geometry: Any) -> Any:
    """Make a trimesh.Trimesh of the points and strips of a PLY file; other geometry is returned unchanged."""
    raw = getattr(geometry, "metadata", {}).get("_ply_raw", {}).get("tristrips")
    if raw is None or hasattr(geometry, "faces"):
        return geometry
    import trimesh

    name, data = next(iter(raw["properties"])), raw["data"]
    # Text becomes a dict of arrays. A binary list becomes a pair: its length f0 and its values f1.
    rows = data[name] if isinstance(data, dict) else data[name]["f1"]
    faces = np.concatenate([np.empty((0, 3), np.int64), *(faces_of_strip(np.asarray(row)) for row in rows)])
    colors = geometry.colors if len(geometry.colors) else None
    return trimesh.Trimesh(geometry.vertices, faces, vertex_colors=colors, process=False)


def faces_of_strip(strip: NDArray[Any]) -> NDArray[np.int64]:
    """List the triangles (m, 3) of a strip of vertices. -1 ends a run, and repeated vertices join parts of a run."""
    if len(strip) < 3:
        return np.empty((0, 3), np.int64)
    index = np.arange(len(strip) - 2)
    triangles = np.lib.stride_tricks.sliding_window_view(strip.astype(np.int64), 3)
    start = np.maximum.accumulate(np.where(triangles[:, 0] < 0, index + 1, 0))
    # Every second triangle of a run is wound the other way round.
    turned = (index - start) % 2 == 1
    triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
    a, b, c = triangles.T
    return np.asarray(triangles[(triangles >= 0).all(axis=1) & (a != b) & (b != c) & (c != a)])
