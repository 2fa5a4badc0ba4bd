"""Content of a view: the instances of an object, their light and camera, as the bytes that the viewer reads."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..atlases.atlas import Atlas, AtlasEntry
from ..baking.dense import bake
from ..base import checks
from ..base.errors import SceneError
from ..base.notices import warn
from ..drawing.frame import Frame
from ..drawing.raymarching import PICTURE_RESOLUTION, PICTURE_SAMPLES, raymarch
from ..files.compression import gzip_pieces
from ..meshes.mesh import Mesh
from ..meshes.part import Part
from ..scaling.stores.zarr_volume import ZarrVolume
from ..scenes import field_cache
from ..scenes.camera import Camera
from ..scenes.instance import Instance
from ..scenes.lights import (
    AMBIENT,
    BACKGROUND,
    KEY_DIRECTION,
    KEY_INTENSITY,
    DirectionalLight,
    Light,
    SpotLight,
    cone_cosines,
)
from ..scenes.materials import PLAIN, SHININESS, SPECULAR, Material
from ..scenes.scene import Scene
from ..scenes.sheets import Appearance
from ..scenes.surroundings import mean_of
from ..shapes.quadric import Quadric
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume, plain_field
from . import records
from .atlas_preview import pages_of
from .records import Record

#: Voxels along the longest side of the volume that takes the place of a shape without a function in the shader.
SHAPE_RESOLUTION = 192

#: Memory of the bricks that take the place of a field in a Zarr store, bytes.
PAGE_BYTES = 64 << 20

#: Levels of the slider reach so far, as a share of the diagonal of the box.
LEVEL_SHARE = 0.1

#: Iso-lines of a slice, about so many over the diagonal of the box.
LINES = 28

#: Steps of a ray that are drawn lightest.
MOST_STEPS = 64


@dataclass
class Placed:
    """A field with its place and its appearance."""

    record: Record
    world_from_object: NDArray[np.float64]
    color: Sequence[float]
    name: str
    specular: float = SPECULAR
    shininess: float = SHININESS
    emission: Sequence[float] = (0.0, 0.0, 0.0)
    flags: int = records.VISIBLE | records.CASTS
    number: int = 0

    @property
    def scale(self) -> float:
        """World units of a unit of the object: the mean over the three axes where they differ."""
        return float(np.cbrt(abs(np.linalg.det(self.world_from_object[:3, :3]))))


@dataclass
class Content:
    """Everything that a view shows."""

    title: str
    placed: list[Placed]
    shapes: list[Shape]
    bounds: NDArray[np.float64]
    camera: Camera
    size: tuple[int, int]
    lights: Sequence[Light] | None = None
    ambient: float = AMBIENT
    background: Sequence[float] = BACKGROUND
    #: Differences between the picture and the object, for the line below the picture.
    remarks: list[str] = field(default_factory=list)
    #: Pictures of the pages of an atlas.
    pages: list[dict[str, Any]] = field(default_factory=list)
    #: Sliders of a page: places of the numbers of the first instance, and their changes by each parameter.
    sliders: dict[str, Any] | None = None
    #: Content that raymarch draws for the picture that replaces the view.
    drawn: Any = None
    _frame: Frame | None = field(default=None, repr=False)

    def frame(self, most_px: int) -> Frame:
        """The picture of :func:`raymarch`, its longest side at most `most_px` pixels."""
        width, height = self.size
        share = min(1.0, most_px / max(width, height))
        size = max(1, round(width * share)), max(1, round(height * share))
        if self._frame is None or self._frame.size != size:
            self._frame = raymarch(self.drawn, self.camera, size=size, samples=PICTURE_SAMPLES, device="cpu")
        return self._frame

    def packed(self) -> bytes:
        """The data of the viewer, compressed by gzip; the same content gives the same bytes."""
        rows, words = records.joined(
            [item.record for item in self.placed],
            [item.flags for item in self.placed],
            [item.number for item in self.placed],
        )
        text = json.dumps(self._description(rows), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        data = len(text).to_bytes(4, "little") + text + words.astype("<u4").tobytes()
        return b"".join(gzip_pieces(data, 9))

    def _programs(self) -> dict[str, Any]:
        """The shaders of each program in both languages; None for triangles that the view does not draw.

        Only views of dense grids draw triangles.
        """
        kinds = {item.record.numbers[records.KIND] for item in self.placed}
        sampled = [item.record for item in self.placed if item.record.numbers[records.KIND] < records.SHAPE]
        encodings = {records.ENCODINGS[int(record.numbers[records.ENCODING])] for record in sampled}
        is_dense = kinds == {records.DENSE}
        has_mesh = is_dense and any(item.record.mesh for item in self.placed)
        one = next(iter(encodings)) if len(encodings) == 1 else None
        has = (records.DENSE in kinds, records.SPARSE in kinds, records.QUADRIC in kinds, has_mesh)
        shapes = [shape._core for shape in self.shapes]
        texts = {}
        for language in ("glsl", "wgsl"):
            rays, *mesh = _core.viewer_shader(language, has, one, shapes)[0]
            triangles = _core.viewer_triangles(language) if is_dense else []
            texts[language] = {"rays": [rays], "triangles": triangles, "mesh": mesh}
        # Each text of WGSL has all entry points of its program.
        return {
            name: {"glsl": glsl, "wgsl": texts["wgsl"][name][0]} if glsl else None
            for name, glsl in texts["glsl"].items()
        }

    def _description(self, rows: list[list[float]]) -> dict[str, Any]:
        lower, upper = self.bounds
        diagonal = float(np.linalg.norm(upper - lower))
        reach = LEVEL_SHARE * diagonal
        known = [(item.record, item.scale) for item in self.placed]
        low = max([record.levels[0] * scale for record, scale in known], default=0.0)
        high = min([record.levels[1] * scale for record, scale in known], default=0.0)
        # Lines and colours stay within the band of quantised samples.
        dense = [(record.levels, scale) for record, scale in known if record.numbers[records.KIND] == records.DENSE]
        band = min([reach, *(min(-least, largest) * scale for (least, largest), scale in dense)])
        error = max([record.error * scale for record, scale in known if record.error is not None], default=None)
        spacing = nice_step(min(diagonal / LINES, max(band / 3, reach / 40)))
        eye, forward = self.camera.pose[:3, 3], -self.camera.pose[:3, 2]
        distance = float((0.5 * (lower + upper) - eye) @ forward)
        if not distance > 1e-6 * diagonal:
            distance = max(float(np.linalg.norm(0.5 * (lower + upper) - eye)), diagonal)
        return {
            "title": self.title,
            "size": self.size,
            "programs": self._programs(),
            "instances": [_instance_data(item, row, error) for item, row in zip(self.placed, rows, strict=True)],
            "lights": None if self.lights is None else [_light_data(light) for light in self.lights],
            "key": {"direction": KEY_DIRECTION, "color": [KEY_INTENSITY] * 3},
            "background": list(self.background),
            "ambient": self.ambient,
            "bounds": self.bounds.tolist(),
            "camera": {"pose": self.camera.pose.ravel().tolist(), "fov": self.camera.fov_deg, "distance": distance},
            "levels": [min(max(low, -reach), 0.0), max(min(high, reach), 0.0)],
            "range": max(band, reach / 40),
            "spacing": spacing,
            "most_steps": MOST_STEPS,
            "error": error,
            "pages": self.pages,
            "sliders": self.sliders,
            "note": "; ".join([f"{_size_text(upper - lower)} world units; iso-lines every {spacing:g}", *self.remarks]),
        }


def content_of(geometry: Any, camera: Camera | None, encoding: str, size: tuple[int, int]) -> Content:
    """The content of a view of any object that can be viewed.

    Raises
    ------
    SceneError
        If the object has no view, or for an orthographic camera.
    """
    geometry, aspect = plain_field(geometry), size[0] / size[1]
    if camera is not None:
        check_perspective(camera)
    if isinstance(geometry, Mesh):
        volume = bake(geometry, PICTURE_RESOLUTION)
        content = content_of(volume, camera, encoding, size)
        records.add_mesh(content.placed[0].record, geometry)
        content.title = f"Mesh, {len(geometry.faces):,} faces, {_drawn_by(volume)}"
        content.remarks = _remarks([geometry])
        return content
    if isinstance(geometry, ZarrVolume):
        return content_of(geometry.picture_field(most=PAGE_BYTES), camera, encoding, size)
    if isinstance(geometry, Scene):
        return _of_scene(geometry, camera, encoding, size)
    if isinstance(geometry, Atlas):
        content = _of_scene(_entries_scene(geometry), camera, encoding, size)
        content.title = f"Atlas of {len(content.placed)} volumes"
        content.pages = pages_of(geometry)
        for placed, index in zip(content.placed, geometry.indices, strict=True):
            placed.name = geometry.names[index] or f"volume {index}"
        return content
    if isinstance(geometry, Quadric):
        content = _of_scene(Scene([geometry]), camera, encoding, size)
        content.title, content.drawn = "Quadric", geometry
        return content
    functions = _functions([geometry])
    if isinstance(geometry, Shape):
        drawn: Any = geometry
        bounds, title = geometry.bounds, "Shape"
        if functions[0] is None:
            drawn = bake(geometry, SHAPE_RESOLUTION)
            record = records.of_volume(drawn, encoding)
            title = f"Shape, {geometry._core.leaf_count:,} leaves, {_drawn_by(drawn)}"
        else:
            record = records.of_shape(geometry, functions[0], records.SHAPE_BIAS)
    elif isinstance(geometry, SparseVolume):
        record, bounds, drawn = records.of_sparse(geometry, encoding), geometry.inner_bounds, geometry
        stored = records.ENCODINGS[int(record.numbers[records.ENCODING])]
        title = f"Sparse volume {_shape_text(geometry.resolution)}, {stored}"
    elif isinstance(geometry, Volume):
        record, bounds, drawn = records.of_volume(geometry, encoding), geometry.inner_bounds, geometry
        title = f"Volume {_shape_text(geometry.resolution)}, {records.ENCODINGS[int(record.numbers[records.ENCODING])]}"
    else:
        raise SceneError(f"{checks.describe(geometry)} has no view; bake it, or put it in a Scene")
    placed = Placed(record, np.eye(4), PLAIN[:3], title)
    view = camera or Camera.fit(bounds, aspect=aspect)
    shapes = [geometry] if isinstance(geometry, Shape) else []
    return Content(title, [placed], shapes, np.asarray(bounds, dtype=np.float64), view, size, drawn=drawn)


def check_perspective(camera: Camera) -> Camera:
    """Refuse an orthographic camera, which the viewer does not draw."""
    if camera.height is not None:
        raise SceneError(f"camera: a view needs a perspective camera, got {camera!r}; use Camera(eye, target)")
    return camera


def _of_scene(scene: Scene, camera: Camera | None, encoding: str, size: tuple[int, int]) -> Content:
    geometries = [_field_of(instance) for instance in scene.instances]
    found = iter(_functions([geometry for group in geometries for geometry in group]))
    known: dict[int, Record] = {}
    placed = []
    for number, (instance, group) in enumerate(zip(scene.instances, geometries, strict=True)):
        for geometry in group:
            function = next(found)
            if id(geometry) not in known:
                known[id(geometry)] = _record(geometry, function, encoding)
                if isinstance(instance.geometry, Mesh):
                    records.add_mesh(known[id(geometry)], instance.geometry)
            placed.append(_placed(instance, number, geometry, known[id(geometry)]))
            if isinstance(geometry, Shape) and function is None:
                placed[-1].name = f"Shape, drawn by its field of {SHAPE_RESOLUTION} voxels along the longest side"
    own = next((camera for camera in scene.cameras if camera.height is None), None)
    if own is not None and _is_far(own, scene.bounds, size[0] / size[1]):
        pose = own.pose
        own = Camera.fit(
            scene.bounds, direction=-pose[:3, 2], up=pose[:3, 1], fov_deg=own.fov_deg, aspect=size[0] / size[1]
        )
    if camera is None and scene.cameras and own is None:
        warn("cameras: all are orthographic, and a view needs a perspective one; it fits the scene", UserWarning)
    if not isinstance(scene.ambient, float):
        warn("ambient: a view has ambient light without colour and direction; it draws the mean", UserWarning)
    view = camera or own or Camera.fit(scene.bounds, aspect=size[0] / size[1])
    return Content(
        f"Scene of {len(scene.instances)} instances" if len(scene.instances) > 1 else "Scene",
        placed,
        [geometry for group in geometries for geometry in group if isinstance(geometry, Shape)],
        scene.bounds,
        view,
        size,
        lights=scene.lights,
        ambient=mean_of(scene.ambient),
        background=scene._background,
        remarks=_remarks([instance.geometry for instance in scene.instances if isinstance(instance.geometry, Mesh)]),
        drawn=scene,
    )


def _is_far(camera: Camera, bounds: NDArray[np.float64], aspect: float) -> bool:
    """Whether a box ahead of a camera covers less than half of the width and of the height of the picture."""
    corners = np.stack(np.meshgrid(*bounds.T, indexing="ij"), axis=-1).reshape(-1, 3)
    local = (corners - camera.pose[:3, 3]) @ camera.pose[:3, :3]
    depth = -local[:, 2]
    if not depth.min() > 0:
        return False
    half = math.tan(math.radians(camera.fov_deg) / 2)
    covered = np.ptp(local[:, :2] / depth[:, None], axis=0) / (2 * half * np.array([aspect, 1.0]))
    return bool((covered < 0.5).all())


def _remarks(meshes: Sequence[Mesh]) -> list[str]:
    """Differences between the pictures of meshes and the meshes: textures, and openings."""
    remarks = []
    unique = list({id(mesh): mesh for mesh in meshes}.values())
    if any(part._image is not None for mesh in unique for part in mesh.parts):
        remarks.append("textures are not drawn")
    is_open = [mesh for mesh in unique if not mesh.is_closed]
    if len(unique) == 1 and is_open:
        remarks.append("the mesh is open, and its field closes the openings")
    elif is_open:
        remarks.append(f"{len(is_open)} of {len(unique)} meshes are open, and their fields close the openings")
    return remarks


def _field_of(instance: Instance) -> list[Any]:
    """The fields of an instance; a mesh has the one of its shadows."""
    geometry = instance.geometry
    if isinstance(geometry, Mesh):
        appearances = [Appearance.of(instance.material, part) for part in geometry.parts]
        return [field_cache.bake_for_scene(geometry, instance.resolution, appearances=appearances)]
    if isinstance(geometry, AtlasEntry):
        return [geometry.to_volume()]
    if isinstance(geometry, tuple):
        return list(geometry)
    if not isinstance(geometry, (Volume, SparseVolume, Shape)):
        raise SceneError(f"a view has no {type(geometry).__name__}; put one of its levels into the Scene")
    return [geometry]


def _record(geometry: Any, function: Any, encoding: str) -> Record:
    if isinstance(geometry, Quadric):
        return records.of_quadric(geometry)
    if isinstance(geometry, SparseVolume):
        return records.of_sparse(geometry, encoding)
    if isinstance(geometry, Shape):
        if function is not None:
            return records.of_shape(geometry, function, records.SCENE_BIAS)
        geometry = bake(geometry, SHAPE_RESOLUTION)
    return records.of_volume(geometry, encoding)


def _placed(instance: Instance, number: int, geometry: Any, record: Record) -> Placed:
    material = instance.material or Material()
    if isinstance(instance.geometry, Mesh):
        part = instance.geometry.parts[0]
    else:
        red, green, blue = record.color or PLAIN[:3]
        part = Part("own", color=(red, green, blue, 1.0))
    appearance = Appearance.of(instance.material, part)
    flags = records.VISIBLE * instance.visible | records.UNLIT * appearance.unlit
    # A shadow in the view is whole: half or more of the light is kept.
    flags |= records.CASTS * (instance.casts_shadow and instance.opacity >= 0.5)
    return Placed(
        record,
        np.asarray(instance.transform, dtype=np.float64),
        appearance.color[:3],
        type(geometry).__name__,
        specular=material.specular,
        shininess=material.shininess,
        emission=appearance.emission,
        flags=flags,
        number=number,
    )


def _entries_scene(atlas: Atlas) -> Scene:
    """The volumes of an atlas side by side, in rows along x and y."""
    entries = list(atlas)
    if not entries:
        raise SceneError("the atlas is empty; add a volume")
    columns = math.ceil(math.sqrt(len(entries)))
    step = 1.15 * max(float((entry.inner_bounds[1] - entry.inner_bounds[0]).max()) for entry in entries)
    instances = []
    for number, entry in enumerate(entries):
        place = np.eye(4)
        row, column = divmod(number, columns)
        place[:3, 3] = (column * step, -row * step, 0) - entry.inner_bounds.mean(axis=0)
        instances.append(Instance(entry, place))
    return Scene(instances)


def _functions(geometries: Sequence[Any]) -> list[Any]:
    """One entry for each geometry: the function of a shape; None for a shape without one, and for everything else."""
    shapes = [geometry for geometry in geometries if isinstance(geometry, Shape)]
    _, functions = _core.viewer_shader("wgsl", (True, False, False, False), None, [shape._core for shape in shapes])
    found = iter(functions)
    return [next(found) if isinstance(geometry, Shape) else None for geometry in geometries]


def _instance_data(item: Placed, row: list[float], largest_error: float | None) -> dict[str, Any]:
    field_from_world = item.record.field_from_object @ np.linalg.inv(item.world_from_object)
    return {
        "name": item.name,
        "record": row,
        "fieldFromWorld": field_from_world[:3].ravel().tolist(),
        "color": list(item.color),
        "specular": item.specular,
        "emission": list(item.emission),
        "shininess": item.shininess,
        "slope": item.record.slope,
        "mesh": item.record.mesh,
        "errorShare": (item.record.error or 0.0) * item.scale / (largest_error or 1.0),
    }


def _light_data(light: Light) -> dict[str, Any]:
    color = np.multiply(light.color, light.intensity).tolist()
    if isinstance(light, DirectionalLight):
        return {"kind": 0, "vector": list(light.direction), "color": color, "range": 0, "spot": None}
    spot = [*light.direction, *cone_cosines(light)] if isinstance(light, SpotLight) else None
    # JSON has no infinity.
    reach = 0 if light.range is None else min(light.range, 1e30)
    return {"kind": 1, "vector": list(light.position), "color": color, "range": reach, "spot": spot}


def nice_step(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `value`."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


def _drawn_by(volume: Volume) -> str:
    return f"drawn by its field of {_shape_text(volume.resolution)}"


def _shape_text(shape: Sequence[int]) -> str:
    return " x ".join(str(n) for n in shape)


def _size_text(extent: NDArray[np.float64]) -> str:
    return " x ".join(f"{side:.3g}" for side in extent)
