"""Clouds of other libraries, which are recognised by their attributes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..meshes.interop import host, is_cloud
from .cloud import PointCloud


def as_cloud(geometry: Any) -> PointCloud | None:
    """Convert a cloud of Open3D, trimesh or PyVista; a PointCloud stays, and anything else is None."""
    if isinstance(geometry, PointCloud):
        return geometry
    if not is_cloud(geometry):
        return None
    if hasattr(geometry, "point"):
        # Open3D's tensor cloud.
        normals = host(geometry.point.normals) if "normals" in geometry.point else None
        return PointCloud(host(geometry.point.positions), normals)
    if hasattr(geometry, "point_data"):
        # PyVista's PolyData.
        normals = geometry.point_data.get("Normals")
        return PointCloud(np.asarray(geometry.points), normals)
    if hasattr(geometry, "vertices"):
        # A cloud of trimesh has no normals of its own.
        return PointCloud(np.asarray(geometry.vertices))
    # Open3D's legacy cloud.
    return PointCloud(np.asarray(geometry.points), np.asarray(geometry.normals) if geometry.has_normals() else None)
