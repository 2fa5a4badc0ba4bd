"""Kernels of warp that measure a mesh. warp reads their source, so they lie in a module of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp


@wp.kernel  # type: ignore[untyped-decorator]
def _measure(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    ways: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    distances: wp.array(dtype=float),  # type: ignore[valid-type]
    feet: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    t: wp.array(dtype=float),  # type: ignore[valid-type]
) -> None:
    i = wp.tid()
    q = wp.mesh_query_point_sign_winding_number(mesh, points[i], 1.0e6)
    foot = wp.mesh_eval_position(mesh, q.face, q.u, q.v)
    distances[i] = q.sign * wp.length(points[i] - foot)
    feet[i] = foot
    hit = wp.mesh_query_ray(mesh, points[i], wp.normalize(ways[i]), 1.0e6)
    t[i] = wp.inf
    if hit.result:
        t[i] = hit.t


def measure(mesh: Any, points: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distances, closest points and first hits of rays, float32, computed on the CPU."""
    count = len(points)
    given = [wp.array(array, dtype=wp.vec3, device="cpu") for array in (points, ways)]
    made = [wp.zeros(count, dtype=kind, device="cpu") for kind in (float, wp.vec3, float)]
    wp.launch(_measure, count, [mesh.id, *given, *made], device="cpu")
    distances, feet, t = (one.numpy() for one in made)
    return distances, feet, t


@wp.kernel  # type: ignore[untyped-decorator]
def _sample(
    volume: wp.uint64,
    points: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    values: wp.array(dtype=float),  # type: ignore[valid-type]
) -> None:
    i = wp.tid()
    values[i] = wp.volume_sample_f(volume, wp.volume_world_to_index(volume, points[i]), wp.Volume.LINEAR)


def sample(volume: Any, points: np.ndarray) -> np.ndarray:
    """Trilinear samples of a volume at world positions (n, 3), float32, computed on the CPU."""
    values = wp.zeros(len(points), dtype=float, device="cpu")
    wp.launch(_sample, len(points), [volume.id, wp.array(points, dtype=wp.vec3, device="cpu"), values], device="cpu")
    return values.numpy()
