"""Exact signed distance fields from triangle meshes.

>>> import fieldbake as fb
>>> knot = fb.models.torus_knot()
>>> volume = fb.bake(knot, resolution=32)
>>> frame = fb.raymarch(volume, size=(64, 64))
>>> frame.image.shape
(64, 64, 4)

Distances are negative inside and in the mesh's own units. ``distances[x, y, z]`` lies at
``bounds[0] + (index + 0.5) * spacing``. Space is right-handed, triangles are counter-clockwise seen from outside.
"""

import logging as _logging

from . import arrays, cache, csg, models
from ._core import __version__
from .atlases.atlas import Atlas, AtlasEntry, pack
from .baking.dense import ClosestPoints, bake, closest_point, signed_distance
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
)
from .base.report import Report
from .drawing.frame import Frame
from .drawing.raymarching import raymarch
from .drawing.rendering import render
from .loading.readers import load
from .merging.build import merge, sphere_intersection
from .merging.merged import MergedField
from .merging.nested import NestedField
from .meshes.convert import as_mesh, load_mesh
from .meshes.mesh import Mesh, Part
from .scenes.camera import Camera
from .scenes.gltf import load_scene
from .scenes.instance import Instance
from .scenes.lights import DirectionalLight, PointLight
from .scenes.materials import Material
from .scenes.scene import Scene
from .shapes.primitives import (
    Profile,
    box,
    box_frame,
    capped_torus,
    capsule,
    circle,
    cone,
    cylinder,
    ellipsoid,
    extrude,
    gyroid,
    hex_prism,
    octahedron,
    plane,
    polygon,
    pyramid,
    rectangle,
    revolve,
    rounded_box,
    sphere,
    torus,
    truncated_cone,
    volume_shape,
)
from .shapes.quadric import Quadric
from .shapes.quadric_texels import pack_quadrics, unpack_quadrics, wrap_quadrics
from .shapes.shape import Shape
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
    "Material",
    "MergedField",
    "Mesh",
    "MeshError",
    "NestedField",
    "Part",
    "PerformanceWarning",
    "PointLight",
    "Profile",
    "Quadric",
    "QuantizedVolume",
    "Report",
    "Scene",
    "SceneError",
    "Shape",
    "ShapeError",
    "SparseVolume",
    "Volume",
    "__version__",
    "arrays",
    "as_mesh",
    "bake",
    "bake_sparse",
    "box",
    "box_frame",
    "cache",
    "capped_torus",
    "capsule",
    "circle",
    "closest_point",
    "cone",
    "csg",
    "cylinder",
    "devices",
    "ellipsoid",
    "extrude",
    "gyroid",
    "hex_prism",
    "load",
    "load_mesh",
    "load_scene",
    "merge",
    "models",
    "octahedron",
    "pack",
    "pack_quadrics",
    "plane",
    "polygon",
    "pyramid",
    "raymarch",
    "rectangle",
    "render",
    "revolve",
    "rounded_box",
    "signed_distance",
    "sphere",
    "sphere_intersection",
    "torus",
    "truncated_cone",
    "unpack_quadrics",
    "volume_shape",
    "wrap_quadrics",
]

# Quiet unless the program that uses us configures logging.
_logging.getLogger("fieldbake").addHandler(_logging.NullHandler())


def __dir__() -> list[str]:
    return sorted(__all__)
