"""Collision fields for MuJoCo: exact distances in the octrees of its SDF geoms. Needs the extra ``fieldbake[mujoco]``.

MuJoCo makes an octree for each mesh that a geom of type SDF names. It takes the side of a point from the normal of the
nearest face, which is wrong inside overlapping parts and beside openings. :func:`add` adds a mesh for which this rule
is right; :func:`refine` overwrites the values of a compiled model by signed distances.

>>> import mujoco  # doctest: +SKIP
>>> import fieldbake as fb
>>> spec = mujoco.MjSpec()  # doctest: +SKIP
>>> bowl = (fb.sphere(0.8) & fb.plane("z", 0)) - fb.sphere(0.7)
>>> geom = fb.mujoco.add(spec, bowl, name="bowl")  # doctest: +SKIP
>>> model = spec.compile()  # doctest: +SKIP
>>> fields = fb.mujoco.refine(model)  # doctest: +SKIP
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .assemblies.geometry import rigid
from .assemblies.mjcf_files import mesh_of
from .base import checks
from .base.errors import ArgumentError, Error
from .base.optional import optional_module
from .base.progress import Progress, part, watched
from .meshes.convert import as_mesh
from .physics.closing import closed_mesh
from .physics.models import MAX_DEPTH, frame_in_file
from .physics.octree import Octree
from .queries.nearest import query
from .shapes.shape import Shape

__all__ = ["MeshField", "add", "refine"]

#: Largest magnitude of a distance whose sign is not compared, in diagonals of the root box. MuJoCo keeps vertices in
#: float32.
UNCERTAIN = 1e-6

#: Voxels along the longest side of the closed mesh of a shape that is not exact.
SHAPE_RESOLUTION = 128


class MeshField(NamedTuple):
    """The change of one octree by :func:`refine`.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.mujoco.MeshField("nut", 585, 4096, 0, 2e-9, 0.01).nodes
    585
    """

    #: Name of the mesh in the model.
    name: str
    #: Number of nodes of the octree.
    nodes: int
    #: Number of corners of its leaves, 8 for each leaf.
    corners: int
    #: Number of these corners where the sign changed and the distance exceeds 1e-6 of the diagonal of the root box.
    wrong_signs: int
    #: Largest change of a value, in lengths of the model.
    largest_change: float
    #: Duration, seconds.
    seconds: float


def add(
    spec: Any,
    geometry: Any,
    *,
    name: str,
    body: Any = None,
    transform: ArrayLike | None = None,
    resolution: int = 128,
    depth: int = 6,
    **geom: Any,
) -> Any:
    """Add a mesh, and a geom of type SDF that uses it, to an `MjSpec`.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The specification that is changed.
    geometry : Shape, Mesh or anything that `as_mesh` takes
        A shape becomes its closed mesh. A mesh with openings, overlapping parts or faces that are inside out becomes
        :func:`fieldbake.solid` of it. Any other mesh keeps its triangles.
    name : str
        Name of the mesh and of the geom.
    body : str or mujoco.MjsBody, optional
        The body that gets the geom. The default is the world.
    transform : (4, 4), optional
        Rigid transform to the body from the coordinates of `geometry`. The default is the identity.
    resolution : int, default 128
        Voxels along the longest side of the box of a shape or of an open mesh.
    depth : int, default 6
        Largest depth of the octree, from 1 to 12: its smallest leaves are ``2**-depth`` of the box.
    **geom
        Further attributes of the geom, such as ``friction`` and ``rgba``.

    Returns
    -------
    mujoco.MjsGeom
        The new geom.

    Raises
    ------
    Error
        If MuJoCo is not installed.
    ArgumentError
        For an unknown body or attribute, a name that is in use, a transform that is not rigid, or a depth out of range.
    MeshError, ShapeError
        If the geometry has no surface.

    Notes
    -----
    The values of MuJoCo are right for such a mesh except at single corners, so :func:`refine` is not necessary. Mass
    and inertia describe the solid.

    Examples
    --------
    >>> import mujoco  # doctest: +SKIP
    >>> import fieldbake as fb
    >>> spec = mujoco.MjSpec()  # doctest: +SKIP
    >>> fb.mujoco.add(spec, fb.box(1) - fb.sphere(0.6), name="frame").type.name  # doctest: +SKIP
    'mjGEOM_SDF'
    """
    package = _package()
    if not isinstance(spec, package.MjSpec):
        raise ArgumentError(f"spec: must be a mujoco.MjSpec, got {checks.describe(spec)}")
    name = checks.text("name", name)
    owner = _body(package, spec, body)
    if spec.mesh(name) is not None or spec.geom(name) is not None:
        raise ArgumentError(f"name: the specification has a mesh or geom {name!r} already; choose another name")
    depth = checks.integer("depth", depth, least=1, most=MAX_DEPTH)
    resolution = checks.integer("resolution", resolution, least=4, most=4096)
    place = np.eye(4) if transform is None else rigid("transform", transform)
    fixed = {"name", "type", "meshname", "pos", "quat", "alt", "fromto"} & geom.keys()
    if fixed:
        raise ArgumentError(f"{min(fixed)}: is set by name=, geometry and transform=; leave it out")
    for key in geom:
        if not hasattr(package.MjsGeom, key):
            raise ArgumentError(f"{key}: is no attribute of a geom of MuJoCo")
    mesh = closed_mesh(geometry, resolution)
    quat = np.empty(4)
    package.mju_mat2Quat(quat, place[:3, :3].ravel())
    asset = spec.add_mesh(name=name, uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel().astype(np.int32))
    asset.octree_maxdepth = depth
    asset.inertia = package.mjtMeshInertia.mjMESH_INERTIA_EXACT
    kind = package.mjtGeom.mjGEOM_SDF
    try:
        return owner.add_geom(name=name, type=kind, meshname=name, pos=place[:3, 3], quat=quat, **geom)
    except (TypeError, ValueError) as error:
        spec.delete(asset)
        raise ArgumentError(f"geom: MuJoCo refuses the attributes {sorted(geom)}: {error}") from None


def refine(model: Any, fields: Mapping[str, Any] | None = None, *, progress: Progress = None) -> tuple[MeshField, ...]:
    """Overwrite the octrees of a compiled model by signed distances, in place.

    Parameters
    ----------
    model : mujoco.MjModel
        The model. `model.oct_coeff` is changed; nothing else is.
    fields : mapping of str to Shape, Mesh or anything that `as_mesh` takes, optional
        Geometry for meshes by name, in the coordinates of the mesh file after its reference pose and its scale. An
        exact shape is evaluated itself, any other shape through its closed mesh. Meshes without an entry use the
        triangles of the model.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    tuple of MeshField
        One entry for each mesh with an octree, in the order of the model.

    Raises
    ------
    Error
        If MuJoCo is not installed, or the octree has another layout.
    ArgumentError
        If `model` is not a model, or `fields` names a mesh without an octree.

    Warns
    -----
    SurfaceWarning
        If a surface is open, inside out, or has flipped or one-sided parts.

    Notes
    -----
    Each corner of a leaf gets the distance of :func:`fieldbake.query`. A corner in the middle of an edge or a face of a
    larger leaf gets the mean of the 2 or 4 corners around it, as in MuJoCo, so that the field is continuous. The
    compiler of MuJoCo has computed its own values before: `refine` adds its time to the time of compilation.

    Examples
    --------
    >>> import mujoco  # doctest: +SKIP
    >>> import fieldbake as fb
    >>> model = mujoco.MjModel.from_xml_path("robot.xml")  # doctest: +SKIP
    >>> [field.wrong_signs for field in fb.mujoco.refine(model)]  # doctest: +SKIP
    [51028]
    """
    package = _package()
    if not isinstance(model, package.MjModel):
        raise ArgumentError(f"model: must be a mujoco.MjModel, got {checks.describe(model)}")
    names = {model.mesh(i).name: i for i in range(model.nmesh) if model.mesh_octadr[i] >= 0}
    sources = dict({} if fields is None else fields)
    for name in sources:
        if name not in names:
            raise ArgumentError(
                f"fields: {name!r} is no mesh with an octree; these are {sorted(names)}. A mesh gets one if a geom "
                "with type='sdf' names it"
            )
    found = []
    with watched(progress, "refine"):
        for number, (name, i) in enumerate(names.items()):
            with part(number / len(names), (number + 1) / len(names)):
                found.append(_refined(model, name, i, sources.get(name)))
    return tuple(found)


def _refined(model: Any, name: str, i: int, source: Any) -> MeshField:
    """Overwrite the octree of mesh `i`."""
    start = time.perf_counter()
    nodes = slice(model.mesh_octadr[i], model.mesh_octadr[i] + model.mesh_octnum[i])
    tree = Octree.of_arrays(model.oct_aabb[nodes], model.oct_child[nodes])
    before = model.oct_coeff[nodes][tree.leaves]
    model.oct_coeff[nodes] = tree.fill(_field(model, i, source))
    after = model.oct_coeff[nodes][tree.leaves]
    least = UNCERTAIN * 2 * float(np.linalg.norm(model.oct_aabb[nodes.start, 3:]))
    wrong = ((before < 0) != (after < 0)) & (np.abs(after) > least)
    change = float(np.abs(after - before).max())
    return MeshField(name, len(tree.leaves), after.size, int(wrong.sum()), change, time.perf_counter() - start)


def _field(model: Any, i: int, source: Any) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """The signed distance of mesh `i` in the frame of its octree, from the model or a source in file coordinates."""
    if source is None:
        mesh = mesh_of(model, i)
        return lambda points: query(mesh, points, progress=False).distances
    turn, offset = frame_in_file(model, i)
    if isinstance(source, Shape) and source.exact:
        shape = source
        return lambda points: shape.distance(points @ turn.T + offset).astype(np.float64)
    surface = closed_mesh(source, SHAPE_RESOLUTION) if isinstance(source, Shape) else as_mesh(source)
    return lambda points: query(surface, points @ turn.T + offset, progress=False).distances


def _body(package: Any, spec: Any, body: Any) -> Any:
    """The body of a specification by its name."""
    if body is None:
        return spec.worldbody
    if isinstance(body, package.MjsBody):
        return body
    found = spec.body(checks.text("body", body))
    if found is None:
        names = [other.name for other in spec.bodies]
        raise ArgumentError(f"body: the specification has no body {body!r}; it has {names}")
    return found


def _package() -> Any:
    """MuJoCo itself, which has the name of this module."""
    package = optional_module("mujoco", "fieldbake.mujoco", extra="mujoco")
    if int(package.__version__.partition(".")[0]) < 4:
        raise Error(f"fieldbake.mujoco needs MuJoCo 4, found {package.__version__}; install it with: "
                    "pip install 'fieldbake[mujoco]'")  # fmt: skip
    return package


def __dir__() -> list[str]:
    return sorted(__all__)
