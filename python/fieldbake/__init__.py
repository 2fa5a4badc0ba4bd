"""Exact signed distance fields from triangle meshes.

>>> import fieldbake as fb
>>> knot = fb.models.torus_knot()
>>> volume = fb.bake(knot, resolution=32)
>>> frame = fb.raymarch(volume, size=(64, 64))
>>> frame.image.shape
(64, 64, 4)

Distances are negative inside and in the mesh's own units. ``distances[x, y, z]`` is the sample at ``bounds[0] + (index
+ 0.5) * spacing``. Space is right-handed, and triangles are counter-clockwise as seen from outside.
"""

import importlib as _importlib
import logging as _logging
from typing import Any as _Any

from . import arrays, cache, csg, models
from ._core import __version__
from .atlases.atlas import Atlas, AtlasEntry
from .atlases.packing import pack
from .baking.dense import bake
from .baking.sparse import bake_sparse
from .base.adapters import Device, devices
from .base.errors import (
    ArgumentError,
    AtlasError,
    CapacityError,
    DeviceError,
    Error,
    FormatError,
    MeshError,
    PerformanceWarning,
    SceneError,
    ShapeError,
    SurfaceWarning,
)
from .base.report import Report
from .base.threads import set_threads
from .drawing.frame import Frame
from .drawing.raymarching import raymarch
from .drawing.rendering import render
from .loading.readers import load
from .merging.build import merge, sphere_intersection
from .merging.merged import MergedField
from .merging.nested import NestedField
from .meshes.convert import as_mesh, load_mesh
from .meshes.mesh import Mesh, Part
from .meshes.normalization import Normalized, normalize
from .queries.nearest import (
    ClosestPoints,
    Query,
    closest_point,
    contains,
    query,
    signed_distance,
    winding_number,
)
from .queries.rays import Intersections, RayHits, all_intersections, cast_rays, count_intersections, occluded
from .queries.sampling import (
    SurfaceSamples,
    TrainingSamples,
    sample_surface,
    sample_training,
    thickness,
)
from .scaling.many import bake_many
from .scaling.zarr_bake import bake_to_zarr
from .scaling.zarr_volume import ZarrVolume, open_zarr
from .scenes.camera import Camera
from .scenes.gltf import load_scene
from .scenes.instance import Instance
from .scenes.lights import DirectionalLight, PointLight
from .scenes.materials import Material
from .scenes.scene import Scene
from .shapes import primitives as _primitives
from .shapes import profiles as _profiles
from .shapes.primitives import *
from .shapes.profiles import *
from .shapes.quadric import Quadric
from .shapes.quadric_texels import pack_quadrics, unpack_quadrics, wrap_quadrics
from .shapes.shape import Shape
from .surfaces.report import SolidReport
from .surfaces.solids import boolean, offset, shell, solid
from .volumes.quantized import QuantizedVolume
from .volumes.sparse import SparseVolume
from .volumes.volume import Volume

__all__ = [
    "ArgumentError",
    "Atlas",
    "AtlasEntry",
    "AtlasError",
    "Camera",
    "CapacityError",
    "ClosestPoints",
    "Device",
    "DeviceError",
    "DirectionalLight",
    "Error",
    "FormatError",
    "Frame",
    "Instance",
    "Intersections",
    "Material",
    "MergedField",
    "Mesh",
    "MeshError",
    "NestedField",
    "Normalized",
    "Part",
    "PerformanceWarning",
    "PointLight",
    "Quadric",
    "QuantizedVolume",
    "Query",
    "RayHits",
    "Report",
    "Scene",
    "SceneError",
    "Shape",
    "ShapeError",
    "SolidReport",
    "SparseVolume",
    "SurfaceSamples",
    "SurfaceWarning",
    "TrainingSamples",
    "Volume",
    "ZarrVolume",
    "__version__",
    "all_intersections",
    "arrays",
    "as_mesh",
    "bake",
    "bake_many",
    "bake_sparse",
    "bake_to_zarr",
    "boolean",
    "cache",
    "cast_rays",
    "closest_point",
    "contains",
    "count_intersections",
    "csg",
    "devices",
    "jax",
    "load",
    "load_mesh",
    "load_scene",
    "merge",
    "models",
    "normalize",
    "occluded",
    "offset",
    "open_zarr",
    "pack",
    "pack_quadrics",
    "query",
    "raymarch",
    "render",
    "sample_surface",
    "sample_training",
    "set_threads",
    "shell",
    "signed_distance",
    "solid",
    "sphere_intersection",
    "thickness",
    "torch",
    "unpack_quadrics",
    "winding_number",
    "wrap_quadrics",
]

__all__ += _primitives.__all__ + _profiles.__all__

# Silent unless the program that imports the package configures logging.
_logging.getLogger("fieldbake").addHandler(_logging.NullHandler())


def __getattr__(name: str) -> _Any:
    # PyTorch and JAX are optional and take seconds to import, so their modules are imported at the first use.
    if name in ("jax", "torch"):
        return _importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
