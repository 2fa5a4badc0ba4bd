# The public names and their modules: type checkers and editors read these imports, and `__init__.py` loads a module at
# the first use of one of its names.
# isort: off
from . import (
    arrays as arrays,
    cache as cache,
    csg as csg,
    jax as jax,
    models as models,
    mujoco as mujoco,
    newton as newton,
    torch as torch,
    training as training,
)
from ._core import __version__ as __version__
from .assemblies.assembly import Assembly as Assembly
from .assemblies.clearances import clearance as clearance
from .assemblies.joint import Joint as Joint
from .assemblies.results import AssemblyQuery as AssemblyQuery, Clearance as Clearance
from .atlases.atlas import Atlas as Atlas, AtlasEntry as AtlasEntry
from .atlases.packing import pack as pack
from .baking.dense import bake as bake
from .baking.sequence import bake_sequence as bake_sequence
from .baking.sparse import bake_sparse as bake_sparse
from .baking.swept import sweep as sweep
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
from .merging.build import merge as merge
from .merging.merged import MergedField as MergedField
from .merging.nested import NestedField as NestedField
from .meshes.convert import as_mesh as as_mesh, load_mesh as load_mesh
from .meshes.mesh import Mesh as Mesh
from .meshes.normalization import Normalized as Normalized, normalize as normalize
from .meshes.part import Part as Part
from .meshes.section import Section as Section
from .points.cloud import PointCloud as PointCloud, PointReport as PointReport
from .points.files import load_points as load_points
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
from .scaling.library import bake_many as bake_many
from .scaling.stores.zarr_bake import bake_to_zarr as bake_to_zarr
from .scaling.stores.zarr_volume import ZarrVolume as ZarrVolume, open_zarr as open_zarr
from .scenes.camera import Camera as Camera
from .scenes.gltf import load_scene as load_scene
from .scenes.instance import Instance as Instance
from .scenes.lights import DirectionalLight as DirectionalLight, PointLight as PointLight, SpotLight as SpotLight
from .scenes.materials import Material as Material
from .scenes.scene import Scene as Scene
from .shapes.outlines.lettering import text as text
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
from .shapes.screws import thread as thread
from .shapes.shape import Shape as Shape
from .shapes.sweeping import helix as helix
from .slicing.layers import Slices as Slices, slices as slices
from .surfaces.report import SolidReport as SolidReport
from .surfaces.solids import boolean as boolean, offset as offset, shell as shell, solid as solid
from .volumes.quantized import QuantizedVolume as QuantizedVolume
from .volumes.sparse import SparseVolume as SparseVolume
from .volumes.volume import Volume as Volume
# isort: on
