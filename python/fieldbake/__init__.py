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
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

if _TYPE_CHECKING:
    # Type checkers and editors read these imports. At run time `_NAMES` takes their place; a test compares both.
    # isort: off
    from . import (
        arrays as arrays,
        cache as cache,
        csg as csg,
        jax as jax,
        models as models,
        mujoco as mujoco,
        torch as torch,
        training as training,
    )
    from ._core import __version__ as __version__
    from .atlases.atlas import Atlas as Atlas, AtlasEntry as AtlasEntry
    from .atlases.packing import pack as pack
    from .baking.dense import bake as bake
    from .baking.sequence import bake_sequence as bake_sequence
    from .baking.sparse import bake_sparse as bake_sparse
    from .base.adapters import Device as Device, devices as devices
    from .base.errors import (
        ArgumentError as ArgumentError,
        AtlasError as AtlasError,
        CapacityError as CapacityError,
        DeviceError as DeviceError,
        Error as Error,
        FormatError as FormatError,
        MeshError as MeshError,
        PerformanceWarning as PerformanceWarning,
        SceneError as SceneError,
        ShapeError as ShapeError,
        SurfaceWarning as SurfaceWarning,
    )
    from .base.report import Report as Report
    from .base.threads import set_threads as set_threads
    from .drawing.frame import Frame as Frame
    from .drawing.raymarching import raymarch as raymarch
    from .drawing.renderer import Renderer as Renderer
    from .drawing.rendering import render as render
    from .loading.readers import load as load
    from .merging.build import merge as merge, sphere_intersection as sphere_intersection
    from .merging.merged import MergedField as MergedField
    from .merging.nested import NestedField as NestedField
    from .meshes.convert import as_mesh as as_mesh, load_mesh as load_mesh
    from .meshes.mesh import Mesh as Mesh
    from .meshes.normalization import Normalized as Normalized, normalize as normalize
    from .meshes.part import Part as Part
    from .meshes.section import Section as Section
    from .queries.edges import sample_edges as sample_edges
    from .queries.nearest import (
        ClosestPoints as ClosestPoints,
        Query as Query,
        closest_point as closest_point,
        contains as contains,
        query as query,
        signed_distance as signed_distance,
        winding_number as winding_number,
    )
    from .queries.rays import (
        Intersections as Intersections,
        RayHits as RayHits,
        all_intersections as all_intersections,
        cast_rays as cast_rays,
        count_intersections as count_intersections,
        occluded as occluded,
    )
    from .queries.sampling import (
        SurfaceSamples as SurfaceSamples,
        TrainingSamples as TrainingSamples,
        sample_surface as sample_surface,
        sample_training as sample_training,
        thickness as thickness,
    )
    from .scaling.many import bake_many as bake_many
    from .scaling.zarr_bake import bake_to_zarr as bake_to_zarr
    from .scaling.zarr_volume import ZarrVolume as ZarrVolume, open_zarr as open_zarr
    from .scenes.camera import Camera as Camera
    from .scenes.gltf import load_scene as load_scene
    from .scenes.instance import Instance as Instance
    from .scenes.lights import DirectionalLight as DirectionalLight, PointLight as PointLight, SpotLight as SpotLight
    from .scenes.materials import Material as Material
    from .scenes.scene import Scene as Scene
    from .shapes.primitives import (
        box as box,
        box_frame as box_frame,
        capped_torus as capped_torus,
        capsule as capsule,
        cone as cone,
        cylinder as cylinder,
        diamond as diamond,
        ellipsoid as ellipsoid,
        gyroid as gyroid,
        hex_prism as hex_prism,
        iwp as iwp,
        octahedron as octahedron,
        plane as plane,
        pyramid as pyramid,
        rounded_box as rounded_box,
        rounded_cone as rounded_cone,
        rounded_cylinder as rounded_cylinder,
        schwarz_p as schwarz_p,
        slab as slab,
        sphere as sphere,
        torus as torus,
        truncated_cone as truncated_cone,
        volume_shape as volume_shape,
    )
    from .shapes.profiles import (
        Profile as Profile,
        circle as circle,
        extrude as extrude,
        polygon as polygon,
        rectangle as rectangle,
        revolve as revolve,
    )
    from .shapes.quadric import Quadric as Quadric
    from .shapes.quadric_texels import (
        pack_quadrics as pack_quadrics,
        unpack_quadrics as unpack_quadrics,
        wrap_quadrics as wrap_quadrics,
    )
    from .shapes.shape import Shape as Shape
    from .slicing.layers import Slices as Slices, slices as slices
    from .surfaces.report import SolidReport as SolidReport
    from .surfaces.solids import boolean as boolean, offset as offset, shell as shell, solid as solid
    from .volumes.quantized import QuantizedVolume as QuantizedVolume
    from .volumes.sparse import SparseVolume as SparseVolume
    from .volumes.volume import Volume as Volume
    # isort: on

#: The public names of each module. The module is imported at the first use of one of them, so `import fieldbake` loads
#: neither NumPy nor the compiled core, and a program loads only the parts that it uses.
_NAMES = {
    "_core": ("__version__",),
    "atlases.atlas": (
        "Atlas",
        "AtlasEntry",
    ),
    "atlases.packing": ("pack",),
    "baking.dense": ("bake",),
    "baking.sequence": ("bake_sequence",),
    "baking.sparse": ("bake_sparse",),
    "base.adapters": (
        "Device",
        "devices",
    ),
    "base.errors": (
        "ArgumentError",
        "AtlasError",
        "CapacityError",
        "DeviceError",
        "Error",
        "FormatError",
        "MeshError",
        "PerformanceWarning",
        "SceneError",
        "ShapeError",
        "SurfaceWarning",
    ),
    "base.report": ("Report",),
    "base.threads": ("set_threads",),
    "drawing.frame": ("Frame",),
    "drawing.raymarching": ("raymarch",),
    "drawing.renderer": ("Renderer",),
    "drawing.rendering": ("render",),
    "loading.readers": ("load",),
    "merging.build": (
        "merge",
        "sphere_intersection",
    ),
    "merging.merged": ("MergedField",),
    "merging.nested": ("NestedField",),
    "meshes.convert": (
        "as_mesh",
        "load_mesh",
    ),
    "meshes.mesh": ("Mesh",),
    "meshes.normalization": (
        "Normalized",
        "normalize",
    ),
    "meshes.part": ("Part",),
    "meshes.section": ("Section",),
    "queries.edges": ("sample_edges",),
    "queries.nearest": (
        "ClosestPoints",
        "Query",
        "closest_point",
        "contains",
        "query",
        "signed_distance",
        "winding_number",
    ),
    "queries.rays": (
        "Intersections",
        "RayHits",
        "all_intersections",
        "cast_rays",
        "count_intersections",
        "occluded",
    ),
    "queries.sampling": (
        "SurfaceSamples",
        "TrainingSamples",
        "sample_surface",
        "sample_training",
        "thickness",
    ),
    "scaling.many": ("bake_many",),
    "scaling.zarr_bake": ("bake_to_zarr",),
    "scaling.zarr_volume": (
        "ZarrVolume",
        "open_zarr",
    ),
    "scenes.camera": ("Camera",),
    "scenes.gltf": ("load_scene",),
    "scenes.instance": ("Instance",),
    "scenes.lights": (
        "DirectionalLight",
        "PointLight",
        "SpotLight",
    ),
    "scenes.materials": ("Material",),
    "scenes.scene": ("Scene",),
    "shapes.primitives": (
        "box",
        "box_frame",
        "capped_torus",
        "capsule",
        "cone",
        "cylinder",
        "diamond",
        "ellipsoid",
        "gyroid",
        "hex_prism",
        "iwp",
        "octahedron",
        "plane",
        "pyramid",
        "rounded_box",
        "rounded_cone",
        "rounded_cylinder",
        "schwarz_p",
        "slab",
        "sphere",
        "torus",
        "truncated_cone",
        "volume_shape",
    ),
    "shapes.profiles": (
        "Profile",
        "circle",
        "extrude",
        "polygon",
        "rectangle",
        "revolve",
    ),
    "shapes.quadric": ("Quadric",),
    "shapes.quadric_texels": (
        "pack_quadrics",
        "unpack_quadrics",
        "wrap_quadrics",
    ),
    "shapes.shape": ("Shape",),
    "slicing.layers": (
        "Slices",
        "slices",
    ),
    "surfaces.report": ("SolidReport",),
    "surfaces.solids": (
        "boolean",
        "offset",
        "shell",
        "solid",
    ),
    "volumes.quantized": ("QuantizedVolume",),
    "volumes.sparse": ("SparseVolume",),
    "volumes.volume": ("Volume",),
}

#: The public modules. MuJoCo, PyTorch and JAX are optional and take seconds to import.
_MODULES = ("arrays", "cache", "csg", "jax", "models", "mujoco", "torch", "training")

_SOURCES = {name: module for module, names in _NAMES.items() for name in names} | {name: name for name in _MODULES}

__all__ = sorted(_SOURCES)


def __getattr__(name: str) -> _Any:
    if name not in _SOURCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _importlib.import_module(f"{__name__}.{_SOURCES[name]}")
    found = module if name in _MODULES else getattr(module, name)
    # The next access finds the name in the module and does not come here.
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
