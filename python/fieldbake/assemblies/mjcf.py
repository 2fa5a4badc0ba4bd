"""Assemblies from models of MuJoCo: the compiled model has the result of defaults, includes, frames and options."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, Error, FormatError
from ..base.optional import optional_module
from ..meshes.mesh import Mesh
from ..shapes import primitives
from ..shapes.shape import Shape
from .joint import Joint, Kind
from .mjcf_files import compiled, mesh_of, read_spec, rotation

#: Groups of geoms that the viewer of MuJoCo shows by default.
VISIBLE_GROUPS = 3


def read_mjcf(source: Any, elements: str) -> tuple[Any, ...]:
    """Read the parts of an assembly: bodies, joints, ignored pairs, largest deviation, default poses of roots."""
    checks.choice("elements", elements, ("collision", "visual"))
    mujoco = optional_module("mujoco", "Assembly.from_mjcf", extra="mujoco")
    if isinstance(source, mujoco.MjModel):
        model, name = source, "model"
    elif isinstance(source, mujoco.MjSpec):
        model, name = compiled(source, "MjSpec"), "MjSpec"
    elif isinstance(source, (str, os.PathLike)):
        path = checks.path(source)
        model, name = compiled(read_spec(path, "Assembly.from_mjcf"), path), str(path)
    else:
        raise ArgumentError(f"source: must be a path, an MjSpec or an MjModel, got {checks.describe(source)}")
    names = _body_names(model, name)
    _check_numbers(model, name)
    meshes: dict[int, Mesh] = {}
    bodies: dict[str, list[tuple[Mesh | Shape, NDArray[np.float64]]]] = {body: [] for body in names}
    for i in range(model.ngeom):
        collides = bool(model.geom_contype[i]) or bool(model.geom_conaffinity[i])
        if collides if elements == "collision" else model.geom_group[i] < VISIBLE_GROUPS:
            place = _transform(model.geom_pos[i], model.geom_quat[i])
            try:
                geometry = _geometry(mujoco, model, i, name, meshes)
            except FormatError:
                raise
            except Error as error:
                raise FormatError(f"{name}: geom {model.geom(i).name or f'number {i}'!r}: {error}") from None
            bodies[names[model.geom_bodyid[i]]].append((geometry, place))
    joints: list[Joint] = []
    roots: dict[str, NDArray[np.float64]] = {}
    for body in range(1, model.nbody):
        found, root = _joints(mujoco, model, body, names, name)
        joints += found
        if root is not None:
            roots[names[body]] = root
    excluded = [(names[int(signature) >> 16], names[int(signature) & 0xFFFF]) for signature in model.exclude_signature]
    return {body: tuple(parts) for body, parts in bodies.items()}, joints, excluded, 0.0, roots


def _body_names(model: Any, source: str) -> list[str]:
    """Names of the bodies; a body without a name has its row."""
    names = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
    if len(set(names)) < len(names):
        raise FormatError(f"{source}: two bodies have one name; name all bodies")
    return names


def _check_numbers(model: Any, source: str) -> None:
    """Raise FormatError for a place or a limit that is not finite, which MuJoCo accepts."""
    for kind, count, attributes in (
        ("body", model.nbody, ("pos", "quat")),
        ("geom", model.ngeom, ("pos", "quat")),
        ("jnt", model.njnt, ("pos", "axis", "range")),
    ):
        for attribute in attributes:
            rows = getattr(model, f"{kind}_{attribute}")
            bad = [i for i in range(count) if not (np.abs(rows[i]) <= checks.FAR).all()]
            if bad:
                i = bad[0]
                element = "joint" if kind == "jnt" else kind
                label = getattr(model, element)(i).name or f"number {i}"
                raise FormatError(
                    f"{source}: {element} {label!r}: {attribute} must be finite numbers, got {rows[i].tolist()}"
                )
    if not (np.abs(model.qpos0) <= checks.FAR).all():
        i = int(np.flatnonzero(~(np.abs(model.qpos0) <= checks.FAR))[0])
        joint = int(np.flatnonzero(model.jnt_qposadr <= i)[-1])
        label = model.joint(joint).name or f"number {joint}"
        raise FormatError(f"{source}: joint {label!r}: ref must be a finite number, got {model.qpos0[i]:g}")


def _transform(position: Any, quaternion: Any) -> NDArray[np.float64]:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation(quaternion), position
    return transform


def _geometry(mujoco: Any, model: Any, i: int, source: str, meshes: dict[int, Mesh]) -> Mesh | Shape:
    """The geometry of a geom in its own frame."""
    kinds = mujoco.mjtGeom
    kind, size = kinds(model.geom_type[i]), model.geom_size[i].tolist()
    if kind == kinds.mjGEOM_SPHERE:
        return primitives.sphere(size[0])
    if kind == kinds.mjGEOM_CAPSULE:
        return primitives.capsule(size[0], 2 * size[1])
    if kind == kinds.mjGEOM_CYLINDER:
        return primitives.cylinder(size[0], 2 * size[1])
    if kind == kinds.mjGEOM_BOX:
        return primitives.box(2 * np.array(size))
    if kind == kinds.mjGEOM_ELLIPSOID:
        return primitives.ellipsoid(size)
    if kind == kinds.mjGEOM_PLANE:
        return primitives.plane("z", 0.0)
    mesh = int(model.geom_dataid[i])
    if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF) and mesh >= 0:
        if mesh not in meshes:
            meshes[mesh] = mesh_of(model, mesh)
        return meshes[mesh]
    label = model.geom(i).name or f"number {i}"
    raise FormatError(f"{source}: geom {label!r}: the type {kind.name[7:].lower()} has no closed form and no mesh")


def _joints(
    mujoco: Any, model: Any, body: int, names: list[str], source: str
) -> tuple[list[Joint], NDArray[np.float64] | None]:
    """The joints of a body to its parent, and its pose if a free joint makes it a root.

    A joint of MuJoCo turns about an anchor in the frame of its body. The origin of each of our joints leads to the
    anchor, and a fixed joint leads back to the body after the last one.
    """
    place = _transform(model.body_pos[body], model.body_quat[body])
    child, parent = names[body], names[model.body_parentid[body]]
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joints: list[Joint] = []
    kinds = mujoco.mjtJoint
    for i in range(first, first + count):
        kind = kinds(model.jnt_type[i])
        name = model.joint(i).name or f"joint {i}"
        if kind == kinds.mjJNT_FREE and model.body_parentid[body] == 0:
            start = model.qpos0[model.jnt_qposadr[i] :][:7]
            return [], _transform(start[:3], start[3:])
        if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            raise FormatError(
                f"{source}: joint {name!r}: a {kind.name[6:].lower()} joint between two bodies has more than one value;"
                " pass the poses of the simulator to queries instead"
            )
        anchor, axis = np.array(model.jnt_pos[i]), np.array(model.jnt_axis[i])
        reference = float(model.qpos0[model.jnt_qposadr[i]])
        is_hinge = kind == kinds.mjJNT_HINGE
        origin = place.copy()
        origin[:3, 3] += place[:3, :3] @ anchor
        # The value at which the body has its pose of the file is `ref`, not 0.
        if is_hinge:
            half = 0.5 * -reference
            turned = np.eye(4)
            turned[:3, :3] = rotation((np.cos(half), *(np.sin(half) * axis)))
            origin = origin @ turned
        else:
            origin[:3, 3] -= origin[:3, :3] @ axis * reference
        limits = tuple(model.jnt_range[i].tolist()) if model.jnt_limited[i] else (-np.inf, np.inf)
        kind_name: Kind = "revolute" if is_hinge else "prismatic"
        joints.append(Joint(name, kind_name, parent, child, origin=origin, axis=axis, limits=limits))
        place = np.eye(4)
        place[:3, 3] = -anchor
    if not joints or place[:3, 3].any():
        joints.append(Joint(f"{child} in {parent}", "fixed", parent, child, origin=place))
    return joints, None
