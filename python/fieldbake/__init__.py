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

from . import arrays, fields, models
from ._core import __version__
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
from .mesh import Mesh, Part
from .quantized import QuantizedVolume
from .render import raymarch
from .report import Report
from .scene import Instance, Scene, render
from .sparse import SparseVolume, bake_sparse
from .volume import Volume

__all__ = [
    "ArgumentError",
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
    "Mesh",
    "MeshError",
    "Part",
    "PointLight",
    "QuantizedVolume",
    "Report",
    "Scene",
    "SceneError",
    "ShapeError",
    "SparseVolume",
    "Volume",
    "__version__",
    "arrays",
    "as_mesh",
    "bake",
    "bake_sparse",
    "closest_point",
    "devices",
    "fields",
    "load",
    "load_mesh",
    "load_scene",
    "models",
    "raymarch",
    "render",
    "signed_distance",
]

# Quiet unless the program that uses us configures logging.
_logging.getLogger("fieldbake").addHandler(_logging.NullHandler())
