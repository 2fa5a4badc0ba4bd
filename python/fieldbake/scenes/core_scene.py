"""Conversion of a scene for the core: a row per instance, a table of materials, and each shared object once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..meshes.mesh import ALPHA_MODES, Mesh, Part
from . import field_cache
from .instance import Instance
from .materials import PLAIN, Material, scattering_rgb
from .sheets import NO_SHEET, Look, Sheet, sheet_of


class MaterialTable:
    """Materials and textures of a scene while they are collected."""

    def __init__(self) -> None:
        self.materials: list[list[float]] = []
        self.textures: list[_core.Texture] = []
        self._known: dict[int, int] = {}
        self._owners: list[object] = []

    def texture(self, pixels: NDArray[np.uint8]) -> int:
        """Index of an image; all users of the image share it."""
        if id(pixels) not in self._known:
            self._known[id(pixels)] = len(self.textures)
            self._owners.append(pixels)
            self.textures.append(_core.Texture(pixels))
        return self._known[id(pixels)]

    def add(self, material: Material | None, look: Look, is_two_sided: bool) -> None:
        """Add one row; `is_two_sided` applies if the material does not decide it."""
        material = material or Material()
        self.materials.append(
            [
                *look.color,
                material.specular,
                material.shininess,
                float(ALPHA_MODES.index(look.alpha_mode)),
                look.alpha_cutoff,
                float(look.two_sided or (is_two_sided and material.two_sided is None)),
                *scattering_rgb(material),
                -1.0 if look.texture is None else float(self.texture(look.texture)),
                *look.emission,
                -1.0 if look.emission_texture is None else float(self.texture(look.emission_texture)),
                float(look.unlit),
            ]
        )


class Rows:
    """Instances of the core's scene while they are collected. A list of quadrics becomes one instance per quadric."""

    def __init__(self) -> None:
        self.table = MaterialTable()
        self.columns: dict[str, list[Any]] = {}

    def add(
        self,
        number: int,
        instance: Instance,
        mesh: _core.SceneMesh | None,
        field: _core.SceneField | None,
        looks: Sequence[Look],
        sheet: Sheet = NO_SHEET,
    ) -> None:
        """Add one instance, with a row of the material table for the look of each part."""
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
            "sheet": sheet.is_traced,
        }
        for name, value in row.items():
            self.columns.setdefault(name, []).append(value)
        for look in looks:
            self.table.add(instance.material, look, sheet.is_two_sided)

    def build(self) -> _core.Scene:
        """Make the scene of the core."""
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
            columns["sheet"],
            np.array(self.table.materials, dtype=np.float32),
            self.table.textures,
        )


class Fields(NamedTuple):
    """The meshes of a scene that need distance fields."""

    #: Light evaluates the fields of solids.
    of_solids: bool
    #: The camera, or the ray march of an article, evaluates the fields of sheets.
    of_sheets: bool


def build_scene(instances: Sequence[Instance], fields: Fields, device: str) -> _core.Scene:
    """Make the scene of the core. An object that several instances share is converted once."""
    rows = Rows()
    meshes: dict[tuple[int, bool], _core.SceneMesh] = {}
    # Looks by mesh and material.
    looks_of: dict[tuple[int, int], tuple[list[Look], Sheet]] = {}
    quadrics: dict[int, list[_core.SceneField]] = {}
    for number, instance in enumerate(instances):
        thing = instance.thing
        if isinstance(thing, tuple):
            if id(thing) not in quadrics:
                quadrics[id(thing)] = field_cache.of_quadrics(thing)
            for quadric, field in zip(thing, quadrics[id(thing)], strict=True):
                red, green, blue = quadric.reflectance.tolist()
                part = Part("quadric", color=(red, green, blue, 1.0))
                rows.add(number, instance, None, field, [Look.of(instance.material, part)])
        elif isinstance(thing, Mesh):
            # A material with a colour or a texture replaces those of the mesh.
            material = instance.material
            keeps_colors = material is None or (material.color is None and material.texture is None)
            vertex_colors, face_colors = (thing.vertex_colors, thing.face_colors) if keeps_colors else (None, None)
            is_colored = vertex_colors is not None or face_colors is not None
            made = id(thing), is_colored
            if made not in meshes:
                meshes[made] = _core.SceneMesh(thing._core, thing.uv, _materials_of(thing), vertex_colors, face_colors)
            key = id(thing), id(material)
            if key not in looks_of:
                looks = [Look.of(material, part, is_colored) for part in thing.parts]
                looks_of[key] = looks, sheet_of(thing, looks)
            looks, sheet = looks_of[key]
            is_baked = fields.of_sheets if sheet.is_traced else fields.of_solids
            baked = field_cache.of_mesh(thing, instance.resolution, device, looks) if is_baked else None
            rows.add(number, instance, meshes[made], baked, looks, sheet)
        else:
            looks = [Look.of(instance.material, Part(color=PLAIN))]
            rows.add(number, instance, None, field_cache.of_thing(thing), looks)
    return rows.build()


def _materials_of(mesh: Mesh) -> NDArray[np.uint32]:
    """Index of the part of each face."""
    owner = np.zeros(len(mesh.faces), dtype=np.uint32)
    for number, part in enumerate(mesh.parts):
        owner[part.faces.start : part.faces.stop] = number
    return owner
