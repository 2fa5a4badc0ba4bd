"""Collision fields for Newton: exact distances in the files of its cache. Needs the package ``newton``.

Newton computes the distance field of a mesh on a CUDA device and keeps it in a folder. :func:`cook` writes such a file
from the distances of :func:`fieldbake.query`, without a device; `newton.Mesh.build_sdf` then reads it.

>>> import fieldbake as fb
>>> gear = fb.models.gear()
>>> path = fb.newton.cook(gear, "cache", max_resolution=128)  # doctest: +SKIP
>>> import newton  # doctest: +SKIP
>>> mesh = newton.Mesh(gear.vertices, gear.faces.ravel())  # doctest: +SKIP
>>> field = mesh.build_sdf(cache_dir="cache", max_resolution=128)  # doctest: +SKIP
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .base import checks
from .base.errors import ArgumentError, Error, MeshError
from .base.progress import Progress, watched
from .meshes.convert import MeshLike, as_mesh
from .meshes.mesh import Mesh
from .physics.newton_cells import CELL, sparse_grid
from .queries.nearest import query

__all__ = ["cook"]

#: The layout of the file that this module writes.
LAYOUT = 2

#: Voxels along the longest side if neither a resolution nor a voxel size is given, as in Newton.
RESOLUTION = 64

#: Vertices that round to one multiple of this are one vertex for Newton, lengths of the mesh.
WELD = 1e-7

TextureFormat = Literal["uint16", "float32", "uint8"]


def cook(
    mesh: MeshLike,
    cache_dir: str | os.PathLike[str],
    *,
    max_resolution: int | None = None,
    target_voxel_size: float | None = None,
    margin: float = 0.05,
    narrow_band_range: tuple[float, float] = (-0.1, 0.1),
    texture_format: TextureFormat = "uint16",
    scale: ArrayLike | None = None,
    progress: Progress = None,
) -> Path:
    """Write the distance field of a mesh where `newton.Mesh.build_sdf` finds it.

    Parameters
    ----------
    mesh : Mesh, path, arrays or object of another library
        The mesh, with the vertices and faces of the `newton.Mesh`.
    cache_dir : path
        The folder of the cache, which is made if it is missing. Pass it to `build_sdf` as `cache_dir`.
    max_resolution : int, optional
        Voxels along the longest side, a multiple of 8. The default is 64 without `target_voxel_size`.
    target_voxel_size : float, optional
        Side of a voxel, lengths of the mesh; the number of voxels is rounded up to a multiple of 8. It replaces
        `max_resolution`.
    margin : float, default 0.05
        Distance of the grid from the box of the mesh, lengths of the mesh.
    narrow_band_range : (float, float), default (-0.1, 0.1)
        Distances between which Newton reads fine samples.
    texture_format : "uint16", "float32" or "uint8", default "uint16"
        Type of the fine samples.
    scale : (float, float, float), optional
        Factors of the vertices that are applied before.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    pathlib.Path
        The file. Its name depends on the mesh and on all options, so `build_sdf` needs the same ones.

    Raises
    ------
    Error
        If Newton is not installed, or its cache has another layout than version 2.
    MeshError
        If the mesh has no faces.
    ArgumentError
        For an option out of range.
    CapacityError
        If the grid does not fit in memory.

    Warns
    -----
    SurfaceWarning
        If the surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    The winding number decides between inside and outside, for closed meshes too. Newton's own values of closed meshes
    have parity, which is wrong inside overlapping parts. Vertices are rounded to float32, as in Newton.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.newton.cook(fb.models.gear(), "cache").name  # doctest: +SKIP
    'a22c8f68d6f5bb4e0a5d71bbd1f0c5b4.sdf.npz'
    """
    cache = _cache()
    source = as_mesh(mesh)
    if not len(source.faces):
        raise MeshError("mesh: has no faces, so it has no distance field")
    options = _checked(max_resolution, target_voxel_size, margin, narrow_band_range, texture_format)
    factors = None if scale is None else _factors(scale)
    vertices = source.vertices.astype(np.float32)
    scaled = vertices if factors is None else vertices * np.array(factors, dtype=np.float32)
    # The text of the options is a part of the name of the file, as Newton writes it.
    name = cache.hash_inputs(
        vertices=scaled,
        indices=source.faces.astype(np.int32).ravel(),
        is_solid=True,
        sign_method_resolved="parity" if is_watertight(vertices, source.faces) else "winding",
        winding_threshold=0.5,
        scale=factors,
        **options,
    )
    moved = scaled.astype(np.float64)
    corners = np.array([moved.min(axis=0) - options["margin"], moved.max(axis=0) + options["margin"]])
    voxels = _voxels(float((corners[1] - corners[0]).max()), options)
    is_mirrored = factors is not None and np.prod(factors) < 0
    surface = Mesh(moved, source.faces[:, ::-1] if is_mirrored else source.faces)

    def field(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return query(surface, points, progress=False).distances

    with watched(progress, "cook"):
        band = max(abs(end) for end in options["narrow_band_range"])
        grid = sparse_grid(field, corners, voxels, band, texture_format)
    version = importlib.metadata.version("newton")
    path: Path = cache.save_sparse_data(cache_dir, name, grid, newton_version=version)
    return path


def _checked(
    max_resolution: Any, target_voxel_size: Any, margin: Any, narrow_band_range: Any, texture_format: Any
) -> dict[str, Any]:
    """The options in the form that Newton hashes."""
    if max_resolution is not None:
        max_resolution = checks.integer("max_resolution", max_resolution, least=CELL, most=4096)
        if max_resolution % CELL:
            raise ArgumentError(f"max_resolution: must be a multiple of {CELL}, got {max_resolution}")
    elif target_voxel_size is None:
        max_resolution = RESOLUTION
    if target_voxel_size is not None:
        target_voxel_size = checks.number("target_voxel_size", target_voxel_size, above=0)
    lower, upper = checks.vector("narrow_band_range", narrow_band_range, 2).tolist()
    if not lower <= 0 <= upper:
        raise ArgumentError(f"narrow_band_range: must have 0 between its numbers, got {lower:g} and {upper:g}")
    return {
        "max_resolution": max_resolution,
        "target_voxel_size": target_voxel_size,
        "margin": checks.number("margin", margin, least=0),
        "narrow_band_range": (lower, upper),
        "texture_format": checks.choice("texture_format", texture_format, get_args(TextureFormat)),
    }


def _factors(scale: ArrayLike) -> tuple[float, float, float]:
    x, y, z = checks.vector("scale", scale, 3).tolist()
    if not (x and y and z):
        raise ArgumentError(f"scale: must not have the factor 0, got {(x, y, z)}")
    return x, y, z


def _voxels(longest: float, options: dict[str, Any]) -> int:
    """Voxels along the longest side."""
    size = options["target_voxel_size"]
    if size is None:
        return int(options["max_resolution"])
    count = int(np.ceil(longest / size / CELL)) * CELL
    if count > 4096:
        raise ArgumentError(f"target_voxel_size: {size:g} makes {count} voxels along the longest side; at most 4096")
    return count


def is_watertight(vertices: NDArray[np.float32], faces: NDArray[Any]) -> bool:
    """Whether each edge has two faces after vertices were rounded to 1e-7, by the rule of `newton.Mesh`."""
    buckets = np.round(vertices * (1 / WELD)).astype(np.int64)
    welded = np.unique(buckets, axis=0, return_inverse=True)[1].ravel()[np.asarray(faces)]
    edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [0, 2]]]), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())


def _cache() -> Any:
    """Newton's own module of the cache, without Newton itself, which starts its device."""
    package = importlib.util.find_spec("newton")
    folders = [] if package is None else list(package.submodule_search_locations or [])
    files = [Path(folder) / "_src" / "geometry" / "_sdf_cache.py" for folder in folders]
    file = next((file for file in files if file.is_file()), None)
    if package is None:
        raise Error("fieldbake.newton needs the package newton; install it with: pip install newton")
    found = None if file is None else importlib.util.spec_from_file_location("_fieldbake_newton_cache", file)
    if found is None or found.loader is None:
        raise Error("newton: the installed version has no cache of distance fields; fieldbake.newton needs 1.8")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    version = getattr(module, "CACHE_FORMAT_VERSION", None)
    if version != LAYOUT:
        raise Error(f"newton: its cache has the layout {version}, and fieldbake.newton writes {LAYOUT}")
    return module


def __dir__() -> list[str]:
    return sorted(__all__)
