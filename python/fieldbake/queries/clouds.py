"""Queries of clouds of points, in the form of the queries of meshes."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import ArgumentError, MeshError
from ..base.progress import Progress, progress_callback
from ..base.report import Report
from ..points.cloud import PointCloud

Array = NDArray[np.float64]

#: Share of uncertain sides from which a warning is issued.
MOST_UNDECIDED = 0.01
#: Largest error of the winding number of a cloud, unless the caller chooses.
WINDING_ERROR = 1e-3


def is_signed(cloud: PointCloud, sign: str, device: str = "auto") -> bool:
    """Check the options of a call with a cloud, and return whether it needs an inside."""
    if device not in ("auto", "cpu"):
        raise ArgumentError(f'device: clouds of points are evaluated on the CPU; use "auto" or "cpu", got {device!r}')
    if sign == "unsigned":
        return False
    if sign not in ("auto", "winding"):
        raise ArgumentError(f'sign: must be "auto", "winding" or "unsigned" for a cloud of points, got {sign!r}')
    require_sides(cloud, ', or use sign="unsigned"')
    return True


def require_sides(cloud: PointCloud, alternative: str = "") -> None:
    """Raise MeshError for a cloud without an inside. The message ends with the alternative to an inside."""
    if not cloud.has_sides:
        lacking, source = ("normals", "cloud.oriented()") if cloud.normals is None else ("areas", "areas=None")
        raise MeshError(f"the cloud has no {lacking}, so no inside; {source} computes them{alternative}")


def report_of(cloud: PointCloud, signed: bool, undecided: int, samples: int, start: float, **facts: Any) -> Report:
    """Make the report of a bake or a query; `undecided` of the samples have an uncertain side."""
    warnings = list(cloud.report.warnings) if signed else []
    if undecided > MOST_UNDECIDED * samples:
        warnings.append(
            f"the side of {undecided:,} of {samples:,} samples is a guess: they lie far from all points, across a hole "
            "of the cloud"
        )
    reason = "dipoles of the points with a proven bound" if signed else "chosen by the caller"
    return Report(
        sign_method="winding" if signed else "unsigned",
        sign_reason=reason,
        vertices=len(cloud),
        device="cpu",
        seconds={"evaluate": perf_counter() - start},
        warnings=tuple(warnings),
        **facts,
    )


def query_cloud(
    cloud: PointCloud, points: Array, signed: bool, progress: Progress
) -> tuple[Array, Array, Array, NDArray[np.int64], Report]:
    """Evaluate distances (n,), gradients (n, 3), nearest points (n, 3) and rows (n,), and make the report."""
    start = perf_counter()
    with progress_callback(progress, "query") as callback:
        distances, nearest, rows, inside, undecided = cloud._core.query(points, signed=signed, progress=callback)
    facts = {"points": len(points), "inside_points": inside, "undecided_points": undecided}
    report = report_of(cloud, signed, undecided, len(points), start, **facts, peak_bytes=cloud._core.nbytes)
    return distances, gradients_of(cloud, points, distances, nearest, rows), nearest, rows, report


def gradients_of(cloud: PointCloud, points: Array, distances: Array, nearest: Array, rows: NDArray[np.int64]) -> Array:
    """Unit gradients of the signed distance: away from the nearest point, turned inside; on a disk its normal."""
    away = (points - nearest) * np.where(distances < 0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(away, axis=1)
    # Nearer than the rounding of positions the difference has no direction.
    near = length <= 1e3 * np.finfo(np.float64).eps * np.abs(nearest).max(axis=1, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Array = away / length[:, None]
    turned = -1.0 if cloud.report.inside_out else 1.0
    found[near] = turned * cloud._normals_of(rows[near])
    if cloud.normals is None:
        found[near] = (1.0, 0.0, 0.0)
    return found
