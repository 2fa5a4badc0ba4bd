"""Scenes from files: an instance per node, with the cameras and lights of glTF.

trimesh reads meshes, materials and textures, and shares the geometry that several nodes refer to. It keeps one camera
and no lights, so cameras and lights are read from the JSON of the file.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import checks
from ..base.errors import SceneError
from ..base.notices import warn
from ..base.report import count_text
from ..meshes.convert import load_nodes
from ..meshes.formats.gltf_tree import GLB_HEADER_BYTES, glb_json_end, visible_nodes
from .camera import Camera
from .instance import INSTANCE_RESOLUTION, Instance
from .lights import AMBIENT, MAX_LIGHTS, DirectionalLight, Light, PointLight, SpotLight
from .scene import Scene


def load_scene(
    path: str | os.PathLike[str], *, resolution: int = INSTANCE_RESOLUTION, ambient: ArrayLike = AMBIENT
) -> Scene:
    """Read a file as a scene.

    Parameters
    ----------
    path : str or path
        A file of any format that :func:`load_mesh` reads. Nodes that share a mesh share its field. Cameras and lights
        (``KHR_lights_punctual``) come from glTF files. Point and spot lights fall off with distance, also without a
        range in the file.
    resolution : int, default 64
        Voxels along the longest side of the field of each mesh.
    ambient : float, (3,) or (height, width, 3), default 0.2
        Light from everywhere, as for :class:`Scene`.

    Returns
    -------
    Scene
        The scene. All intensities have a common factor, because the units of files differ: the brightest light reaches
        the centre of the scene with intensity 1. A lamp nearer to the centre than a quarter of the scene's diagonal
        counts as that far away; ranges and cones are ignored for the factor. A file without lights gets the default
        light of :class:`Scene`. At most 16 lights are kept, the brightest at the centre; a warning counts the others.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    MeshError
        If the file cannot be read or contains no triangles.

    Examples
    --------
    >>> import tempfile
    >>> import fieldbake as fb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fb.models.gear().save(f"{folder}/gear.glb")
    ...     scene = fb.load_scene(f"{folder}/gear.glb")
    >>> len(scene.instances)
    1
    """
    file = checks.path(path)
    nodes = load_nodes(file)
    instances = [Instance(mesh, transform, resolution=resolution) for mesh, transform in nodes]
    document = _document(file)
    cameras, lights = [], []
    for node, world_from_node in _nodes(document):
        camera = _camera(document, node, world_from_node)
        if camera is not None:
            cameras.append(camera)
        try:
            light = _light(document, node, world_from_node)
        except (SceneError, TypeError, ValueError, AttributeError, LookupError) as error:
            warn(f"{file}: a light is not used: {error}", UserWarning)
            continue
        if light is not None:
            lights.append(light)
    return Scene(instances, _balanced(file, lights, Scene(instances).bounds), ambient=ambient, cameras=cameras)


def _document(file: Path) -> dict[str, Any]:
    """Read the JSON of a glTF file; empty for other formats."""
    suffix = file.suffix.lower()
    if suffix not in (".gltf", ".glb"):
        return {}
    with file.open("rb") as stream:
        if suffix == ".glb":
            end = glb_json_end(stream.read(GLB_HEADER_BYTES))
            if end is None:
                return {}
            content = stream.read(end - GLB_HEADER_BYTES)
        else:
            content = stream.read()
    try:
        document = json.loads(content)
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}


def _nodes(document: dict[str, Any]) -> Iterator[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Iterate over the visible nodes of the scene with their world-from-node transforms, in the order of the file."""
    transforms: dict[int | None, NDArray[np.float64]] = {None: np.eye(4)}
    for index, parent in visible_nodes(document):
        node = document["nodes"][index]
        transforms[index] = transforms[parent] @ _transform(node)
        yield node, transforms[index]


def _transform(node: dict[str, Any]) -> NDArray[np.float64]:
    """Parent from node: a matrix by columns, or scale, then rotation (quaternion x, y, z, w), then translation."""
    if "matrix" in node:
        return np.transpose(np.array(node["matrix"], dtype=np.float64).reshape(4, 4))
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ) * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _camera(document: dict[str, Any], node: dict[str, Any], world_from_node: NDArray[np.float64]) -> Camera | None:
    """Make a camera; the scale of its node is ignored, but a scale of 0 hides the camera."""
    if "camera" not in node:
        return None
    camera = document["cameras"][node["camera"]]
    pose = world_from_node.copy()
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    if not lengths.all():
        return None
    pose[:3, :3] /= lengths
    try:
        if "orthographic" in camera:
            return Camera.from_pose(pose, height=2 * float(camera["orthographic"]["ymag"]))
        return Camera.from_pose(pose, float(np.degrees(camera["perspective"]["yfov"])))
    except (SceneError, KeyError):
        return None


def _light(document: dict[str, Any], node: dict[str, Any], world_from_node: NDArray[np.float64]) -> Light | None:
    reference = node.get("extensions", {}).get("KHR_lights_punctual")
    if reference is None:
        return None
    light = document["extensions"]["KHR_lights_punctual"]["lights"][reference["light"]]
    color, intensity = light.get("color", (1.0, 1.0, 1.0)), float(light.get("intensity", 1.0))
    axis, position = (-world_from_node[:3, 2]).tolist(), world_from_node[:3, 3].tolist()
    if light.get("type") == "directional":
        return DirectionalLight(axis, color, intensity)
    # Without a range the falloff is the inverse square alone.
    reach = float(light.get("range") or math.inf)
    if light.get("type") != "spot":
        return PointLight(position, color, intensity, range=reach)
    cone = light.get("spot") or {}
    outer = min(math.degrees(cone.get("outerConeAngle", math.pi / 4)), 90.0)
    inner = min(max(math.degrees(cone.get("innerConeAngle", 0.0)), 0.0), outer)
    return SpotLight(position, axis, inner, outer, color, intensity, range=reach)


def _balanced(file: Path, lights: list[Light], bounds: NDArray[np.float64]) -> list[Light] | None:
    """Multiply the intensities of lights by a common factor, and keep the brightest lights."""
    if not lights:
        return None
    center, diagonal = bounds.mean(axis=0), float(np.linalg.norm(bounds[1] - bounds[0]))

    def arriving_from(light: Light) -> float:
        if isinstance(light, DirectionalLight):
            return light.intensity
        distance = max(float(np.linalg.norm(np.array(light.position) - center)), diagonal / 4)
        return light.intensity / distance**2

    arriving = [arriving_from(light) for light in lights]
    # Lights that are all dark stay dark.
    brightest = max(arriving) or 1.0
    balanced: list[Light] = [replace(light, intensity=light.intensity / brightest) for light in lights]
    if len(balanced) <= MAX_LIGHTS:
        return balanced
    unused = len(balanced) - MAX_LIGHTS
    warn(f"{file}: not used: {count_text(unused, 'light')}; a Scene has at most {MAX_LIGHTS}", UserWarning)
    strongest = np.sort(np.argsort(-np.array(arriving), kind="stable")[:MAX_LIGHTS])
    return [balanced[i] for i in strongest]
