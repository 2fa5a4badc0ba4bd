"""Readers of clouds: points in .ply, .xyz, .npy, .npz, .las and .laz files, and Gaussian splats in .ply files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, Error, FormatError
from ..base.optional import optional_module
from .cloud import PointCloud

Array = NDArray[np.float64]

#: Properties of a splat in a .ply file of the original project.
SPLAT = ("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
#: A splat is round if its smallest scale exceeds this share of the middle one.
ROUND = 0.5
#: Columns of a table that may be normals: after the position, or after the position and a colour.
NORMAL_COLUMNS = (slice(3, 6), slice(6, 9))
#: They are normals if their lengths differ from 1 by at most this.
UNIT_TOLERANCE = 0.01


def load_points(path: str | os.PathLike[str], *, opacity: float = 0.5) -> PointCloud:
    """Read a cloud of points, or of Gaussian splats.

    Parameters
    ----------
    path : str or path
        ``.ply``: points with ``nx ny nz`` if it has them, or splats in the layout of the original project.
        ``.xyz``, ``.npy``: rows of x, y, z. Columns 4 to 6, or else 7 to 9, are normals if they are unit vectors; other
        columns are ignored. ``.npz``: ``points`` and, if present, ``normals`` and ``areas``. ``.las``, ``.laz``: points
        (extra ``points``).
    opacity : float, default 0.5
        Splats with a lower opacity, from 0 to 1, are dropped.

    Returns
    -------
    PointCloud
        A cloud with the positions of the file in float64. The normals of splats have no side: use
        :meth:`PointCloud.oriented`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FormatError
        If the file is damaged, empty or a mesh, or its ending is unknown.
    ArgumentError
        If `opacity` is not from 0 to 1.
    Error
        If a ``.las`` file needs the extra ``points``.

    Notes
    -----
    The opacity of a splat is ``1 / (1 + exp(-x))``, its scales are ``exp(x)``, and its rotation is a quaternion with w
    first. The axis of the smallest scale is the line of its normal. Areas come from neighbours, not from scales,
    because splats overlap. Colours and harmonics are not read.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import fieldbake as fb
    >>> samples = fb.sample_surface(fb.models.gear(), 1_000)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/gear.npz", points=samples.points, normals=samples.normals)
    ...     cloud = fb.load_points(f"{folder}/gear.npz")
    >>> len(cloud), cloud.report.normals
    (1000, 'given')
    """
    least = checks.number("opacity", opacity, least=0)
    if least > 1:
        raise ArgumentError(f"opacity: must be from 0 to 1, got {opacity}")
    file = checks.path(path)
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise FormatError(f"{file}: points are read from {', '.join(READERS)}, got '{file.suffix}'")
    if file.is_dir():
        raise FormatError(f"{file}: is a directory, not a file of points")
    checks.finite_file(file, FormatError)
    # Opening the file here keeps FileNotFoundError and PermissionError unchanged.
    with file.open("rb"):
        pass
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            columns = reader(file)
        if not len(columns["points"]):
            raise FormatError(f"{file}: has no points")
        if all(name in columns for name in SPLAT):
            return _splats(columns, least)
        return PointCloud(columns["points"], columns.get("normals"), columns.get("areas"))
    except FormatError:
        raise
    except MemoryError as error:
        raise checks.too_large(file) from error
    except Error as error:
        if type(error) is Error:  # A package is missing.
            raise
        raise type(error)(f"{file}: {error}") from None
    except Exception as error:  # Readers of damaged files raise exceptions of any type.
        raise FormatError(f"{file}: cannot be read as points: {str(error) or type(error).__name__}") from error


def _splats(columns: Mapping[str, Array], opacity: float) -> PointCloud:
    """The cloud of the splats that are opaque enough, with the lines of their normals."""
    # The logistic function without overflow.
    share = 0.5 * (1 + np.tanh(0.5 * columns["opacity"]))
    kept = share >= opacity
    if not kept.any():
        raise FormatError(f"has no splat with an opacity of at least {opacity:g}; lower opacity=")
    scales = np.stack([columns[f"scale_{axis}"][kept] for axis in range(3)], axis=1)
    w, x, y, z = (columns[f"rot_{i}"][kept] for i in range(4))
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    if not (norm > 0).all():
        raise FormatError("has a splat whose rotation is zero or not finite")
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    # The columns of the rotation matrix are the axes of the splat.
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    smallest = scales.argmin(axis=1)
    lines = axes.transpose(2, 0, 1)[np.arange(len(smallest)), smallest]
    # Scales are logarithms, so a difference is a ratio.
    ordered = np.sort(scales, axis=1)
    is_round = ordered[:, 0] - ordered[:, 1] > np.log(ROUND)
    # A line of zeros stands for the line of the neighbours.
    lines[is_round] = 0.0
    facts = {"low_opacity": int(np.count_nonzero(~kept)), "round_splats": int(np.count_nonzero(is_round))}
    points, _ = checks.points(columns["points"][kept])
    return PointCloud._wrap(np.array(points), None, None, "none", lines, **facts)


def _from_ply(file: Path) -> dict[str, Any]:
    """Read the columns of the vertices."""
    import trimesh

    cloud: Any = trimesh.load(str(file), process=False)
    elements = cloud.metadata["_ply_raw"]
    if "face" in elements and elements["face"]["length"] > 0:
        raise FormatError(f"{file}: is a mesh: use fb.load_mesh, or fb.sample_surface for points on it")
    data = elements["vertex"]["data"]
    columns: dict[str, Any] = {name: np.asarray(data[name], np.float64).reshape(-1) for name in _names(data)}
    announced = int(elements["vertex"]["length"])
    if len(columns["x"]) != announced:
        raise FormatError(f"{file}: its header announces {announced} points, it has {len(columns['x'])}")
    columns["points"] = np.stack([columns[axis] for axis in "xyz"], axis=1)
    if all(name in columns for name in ("nx", "ny", "nz")):
        normals = np.stack([columns[name] for name in ("nx", "ny", "nz")], axis=1)
        # The original project writes zeros.
        if normals.any():
            columns["normals"] = normals
    return columns


def _names(data: Any) -> list[str]:
    """The names of the properties of a PLY element, as a structured array or a mapping of columns."""
    return list(data.dtype.names if isinstance(data, np.ndarray) else data)


def read_table(file: Path, separator: str | None = None, skipped: int = 0) -> Array:
    """Read rows of numbers from a text file, after some skipped lines. None separates the numbers by white space.

    A ValueError names the first line that cannot be read. FormatError is raised for a file without numbers.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy warns of a file without numbers.
            table = np.loadtxt(file, delimiter=separator, skiprows=skipped, ndmin=2)
    except ValueError as error:
        raise ValueError(_fault_of_table(file, separator, skipped) or error) from None
    if not table.size:
        raise FormatError(f"{file}: has no points")
    return table


def _fault_of_table(file: Path, separator: str | None, skipped: int) -> str:
    """Describe the first line of a table that is not numbers, or has another number of them; empty without one."""
    count = 0
    with file.open(encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            text = line.partition("#")[0].strip()
            if number <= skipped or not text:
                continue
            words = text.split(separator)
            try:
                _ = [float(word) for word in words]
            except ValueError:
                between = "commas" if separator else "spaces"
                return f"line {number} must be numbers separated by {between}, got {text[:60]!r}"
            if len(words) != (count := count or len(words)):
                return f"line {number} has {len(words)} numbers, the lines above have {count}"
    return ""


def _from_table(table: NDArray[Any]) -> dict[str, Any]:
    if table.ndim != 2 or table.shape[1] < 3:
        raise ValueError(f"must hold rows of three numbers, got an array of shape {table.shape}")
    columns = {"points": table[:, :3]}
    for place in NORMAL_COLUMNS:
        normals = np.asarray(table[:, place], np.float64)
        is_unit = np.abs(np.linalg.norm(normals, axis=1) - 1) <= UNIT_TOLERANCE
        if normals.shape[1] == 3 and is_unit.all():
            return {**columns, "normals": normals}
    return columns


def _from_npz(file: Path) -> dict[str, Any]:
    with np.load(file, allow_pickle=False) as archive:
        if "points" not in archive:
            raise ValueError(f"has no array 'points', only {', '.join(archive) or 'none'}")
        return {name: archive[name] for name in ("points", "normals", "areas") if name in archive}


def _from_las(file: Path) -> dict[str, Any]:
    laspy = optional_module("laspy", f"reading {file.suffix} files", extra="points")
    return {"points": np.asarray(laspy.read(file).xyz)}


#: Reader of each ending; it returns the columns.
READERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".ply": _from_ply,
    ".xyz": lambda file: _from_table(read_table(file)),
    ".npy": lambda file: _from_table(np.load(file, allow_pickle=False)),
    ".npz": _from_npz,
    ".las": _from_las,
    ".laz": _from_las,
}
