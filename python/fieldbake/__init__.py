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

from . import arrays, csg, fields, models
from ._core import __version__
from .atlas import Atlas, AtlasEntry, pack
from .bake import ClosestPoints, bake, closest_point, signed_distance
from .camera import Camera
from .convert import as_mesh, load_mesh
from .devices import Device, devices
from .errors import (
    ArgumentError,
    AtlasError,
    CapacityError,
    DeviceError,
    Error,
    FormatError,
    MeshError,
    SceneError,
    ShapeError,
)
from .frame import Frame
from .gltf import load_scene
from .io import load
from .lights import DirectionalLight, PointLight
from .materials import Material
from .merge import MergedField, merge, sphere_intersection
from .mesh import Mesh, Part
from .nested import NestedField
from .quadric import Quadric, pack_quadrics, unpack_quadrics, wrap_quadrics
from .quantized import QuantizedVolume
from .render import raymarch
from .report import Report
from .scene import Instance, Scene, render
from .shapes import (
    Profile,
    Shape,
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
from .sparse import SparseVolume, bake_sparse
from .volume import Volume

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
    "fields",
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
