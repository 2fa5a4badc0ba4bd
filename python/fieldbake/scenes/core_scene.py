"""A scene as the core takes it: a row for each instance, a table of materials, things that are made once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..meshes.mesh import ALPHA_MODES, Mesh, Part
from . import field_cache
from .instance import Instance
from .materials import PLAIN, Material, scattering_rgb


class MaterialTable:
    """Materials and textures of a scene as they are collected."""

    def __init__(self) -> None:
        self.materials: list[list[float]] = []
        self.textures: list[_core.Texture] = []
        self._known: dict[int, int] = {}
        self._owners: list[object] = []

    def texture(self, pixels: NDArray[np.uint8]) -> int:
        """Place of an image, shared by all that use it."""
        if id(pixels) not in self._known:
            self._known[id(pixels)] = len(self.textures)
            self._owners.append(pixels)
            self.textures.append(_core.Texture(pixels))
        return self._known[id(pixels)]

    def add(self, material: Material | None, part: Part | None, is_sheet: bool) -> None:
        """One row: a material over the looks of a part."""
        material = material or Material()
        part = part or Part(color=PLAIN)
        color, texture, mode = part.color, part.texture, part.alpha_mode
        if texture is None and color == (1.0, 1.0, 1.0, 1.0) and not part.name:
            color = PLAIN
        if material.color is not None or material.texture is not None:
            r, g, b, a = material.color or (1.0, 1.0, 1.0, 1.0)
            color, texture, mode = (r, g, b, a), material.texture, "opaque" if a >= 1 else "blend"
        mode = material.alpha_mode or mode
        cutoff = part.alpha_cutoff if material.alpha_cutoff is None else material.alpha_cutoff
        two_sided = (part.two_sided or is_sheet) if material.two_sided is None else material.two_sided
        self.materials.append(
            [
                *color,
                material.specular,
                material.shininess,
                float(ALPHA_MODES.index(mode)),
                cutoff,
                float(two_sided),
                *scattering_rgb(material),
                -1.0 if texture is None else float(self.texture(texture)),
            ]
        )


class Rows:
    """Instances of the core's scene as they are collected; a list of quadrics is as many of them."""

    def __init__(self) -> None:
        self.table = MaterialTable()
        self.columns: dict[str, list[Any]] = {}

    def add(
        self,
        number: int,
        instance: Instance,
        mesh: _core.SceneMesh | None,
        field: _core.SceneField | None,
        parts: Sequence[Part | None] = (None,),
        is_sheet: bool = False,
    ) -> None:
        """One instance, with a row of the material table for each part."""
        own_colors = instance.material is None or instance.material.color is None
        row = {
            "mesh": mesh,
            "field": field,
            "transform": instance.transform,
            "first": len(self.table.materials),
            "opacity": instance.opacity,
            "casts": instance.casts_shadow,
            "visible": instance.visible,
            "own": own_colors,
            "object": number,
        }
        for name, value in row.items():
            self.columns.setdefault(name, []).append(value)
        for part in parts:
            self.table.add(instance.material, part, is_sheet)

    def build(self) -> _core.Scene:
        """The core's scene."""
        columns = self.columns
        return _core.Scene(
            columns["mesh"],
            columns["field"],
            np.array(columns["transform"], dtype=np.float64),
            columns["first"],
            columns["opacity"],
            columns["casts"],
            columns["visible"],
            columns["own"],
            columns["object"],
            np.array(self.table.materials, dtype=np.float32),
            self.table.textures,
        )


def build_scene(instances: Sequence[Instance], with_fields: bool, device: str) -> _core.Scene:
    """The core's scene; things that several instances share are made once."""
    rows = Rows()
    meshes: dict[int, tuple[_core.SceneMesh, bool]] = {}
    quadrics: dict[int, list[_core.SceneField]] = {}
    for number, instance in enumerate(instances):
        thing = instance.thing
        if isinstance(thing, tuple):
            if id(thing) not in quadrics:
                quadrics[id(thing)] = field_cache.of_quadrics(thing)
            for quadric, field in zip(thing, quadrics[id(thing)], strict=True):
                red, green, blue = quadric.reflectance.tolist()
                rows.add(number, instance, None, field, [Part("quadric", color=(red, green, blue, 1.0))])
        elif isinstance(thing, Mesh):
            if id(thing) not in meshes:
                made = _core.SceneMesh(thing._core, thing.uv, _materials_of(thing))
                meshes[id(thing)] = made, field_cache.is_sheet(thing)
            mesh, is_sheet = meshes[id(thing)]
            baked = field_cache.of_mesh(thing, instance.resolution, device) if with_fields else None
            rows.add(number, instance, mesh, baked, thing.parts, is_sheet)
        else:
            rows.add(number, instance, None, field_cache.of_thing(thing))
    return rows.build()


def _materials_of(mesh: Mesh) -> NDArray[np.uint32]:
    """The part that each face belongs to."""
    owner = np.zeros(len(mesh.faces), dtype=np.uint32)
    for number, part in enumerate(mesh.parts):
        owner[part.faces.start : part.faces.stop] = number
    return owner
