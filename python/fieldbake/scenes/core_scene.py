"""Conversion of a scene for the core: a row per instance, a table of materials, and each shared object once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.errors import SurfaceWarning
from ..base.notices import warn
from ..meshes.mesh import Mesh
from ..meshes.part import Part
from . import field_cache
from .instance import Instance
from .materials import DEFAULT_MATERIAL, PLAIN, Material, scattering_rgb
from .sheets import NO_SHEET, THIN_VOXELS, Appearance, Sheet, needed_resolution, sheet_of

#: Converted images by the id of their pixels, with the pixels, so that no id is reused.
Textures = dict[int, tuple[NDArray[np.uint8], _core.Texture]]


#: The part of an object without materials of its own.
_PLAIN_PART = Part(color=PLAIN)


class MaterialTable:
    """Materials and textures of a scene while they are collected."""

    def __init__(self, converted: Textures) -> None:
        self.materials: list[_core.MaterialRow] = []
        self.textures: list[_core.Texture] = []
        #: Textures of this table. Those in `converted` are not converted again.
        self.used: Textures = {}
        self._converted = converted
        self._known: dict[int, int] = {}

    def texture(self, pixels: NDArray[np.uint8]) -> int:
        """Return the index of an image; all users of the image share it."""
        key = id(pixels)
        if key not in self._known:
            self._known[key] = len(self.textures)
            self.used[key] = self._converted.get(key) or (pixels, _core.Texture(pixels))
            self.textures.append(self.used[key][1])
        return self._known[key]

    def add(self, material: Material | None, appearance: Appearance, is_two_sided: bool) -> None:
        """Add one row. `is_two_sided` is used if the material leaves this open."""
        material = material or DEFAULT_MATERIAL
        self.materials.append(
            {
                "color": appearance.color,
                "specular": material.specular,
                "shininess": material.shininess,
                "alpha_mode": appearance.alpha_mode,
                "alpha_cutoff": appearance.alpha_cutoff,
                "two_sided": appearance.two_sided or (is_two_sided and material.two_sided is None),
                "scattering": scattering_rgb(material),
                "texture": None if appearance.texture is None else self.texture(appearance.texture),
                "emission": appearance.emission,
                "emission_texture": None
                if appearance.emission_texture is None
                else self.texture(appearance.emission_texture),
                "unlit": appearance.unlit,
            }
        )


class Rows:
    """Instances of the core's scene while they are collected: one row for each object."""

    def __init__(self, converted: Textures) -> None:
        self.table = MaterialTable(converted)
        self.instances: list[_core.InstanceRow] = []

    def add(
        self,
        number: int,
        instance: Instance,
        mesh: _core.SceneMesh | None,
        fields: Sequence[_core.SceneField],
        appearances: Sequence[Appearance],
        sheet: Sheet = NO_SHEET,
        *,
        numbered: bool = False,
    ) -> None:
        """Add an object, with a row of the material table for the appearance of each part.

        The core makes an instance of each of several fields. The identifiers of numbered fields count from `number`.
        """
        own_colors = instance.material is None or instance.material.color is None
        self.instances.append(
            {
                "mesh": mesh,
                "fields": fields,
                "numbered": numbered,
                "transform": np.asarray(instance.transform, dtype=np.float64),
                "first_material": len(self.table.materials),
                "opacity": instance.opacity,
                "casts_shadow": instance.casts_shadow,
                "visible": instance.visible,
                "own_colors": own_colors,
                "object": number,
                "is_sheet": sheet.is_traced,
                "is_solid": sheet.is_solid,
            }
        )
        for appearance in appearances:
            self.table.add(instance.material, appearance, sheet.is_two_sided)

    def build(self) -> _core.Scene:
        """Make the scene of the core."""
        return _core.Scene(self.instances, self.table.materials, self.table.textures)


class Fields(NamedTuple):
    """The meshes of a scene that need distance fields."""

    #: Light evaluates the fields of solids.
    of_solids: bool
    #: The primary pass marches the fields of sheets.
    of_sheets: bool


class SceneBuilder:
    """Makes scenes of the core from instances of the same objects, and keeps the converted objects."""

    def __init__(self) -> None:
        # The keys have the id of the object, which the instances keep alive.
        self._meshes: dict[tuple[int, bool], _core.SceneMesh] = {}
        self._fields: dict[object, _core.SceneField] = {}
        self._quadrics: dict[int, list[_core.SceneField]] = {}
        self._sheets: dict[object, Sheet] = {}
        self._needed: dict[tuple[int, int], int | None] = {}
        # Textures of the first scene and of the last scene: materials may differ from scene to scene.
        self._first: Textures | None = None
        self._textures: Textures = {}

    def build(
        self, instances: Sequence[Instance], fields: Fields, device: str, *, numbered: bool = False
    ) -> _core.Scene:
        """Make a scene. An object that several instances or scenes share is converted once.

        With `numbered`, each quadric of a list is an object of its own in the picture.
        """
        rows = Rows(self._textures)
        # Appearances of the parts of a mesh, by the ids of the mesh and the material.
        appearances_of: dict[tuple[int, int], tuple[list[Appearance], Sheet]] = {}
        for number, instance in enumerate(instances):
            geometry = instance.geometry
            if isinstance(geometry, tuple):
                if id(geometry) not in self._quadrics:
                    self._quadrics[id(geometry)] = field_cache.of_quadrics(geometry)
                appearances = [Appearance.of(instance.material, _PLAIN_PART)]
                rows.add(number, instance, None, self._quadrics[id(geometry)], appearances, numbered=numbered)
            elif isinstance(geometry, Mesh):
                # A material with a colour or a texture replaces the colours and the texture of the mesh.
                material = instance.material
                keeps_colors = material is None or (material.color is None and material.texture is None)
                is_colored = keeps_colors and (geometry.vertex_colors is not None or geometry.face_colors is not None)
                key = id(geometry), id(material)
                if key not in appearances_of:
                    appearances = [Appearance.of(material, part, is_colored) for part in geometry.parts]
                    appearances_of[key] = appearances, self._sheet(geometry, appearances)
                appearances, sheet = appearances_of[key]
                if fields.of_solids and not sheet.is_traced:
                    sheet = self._with_thin_walls(number, instance, sheet, fields)
                is_baked = fields.of_sheets if sheet.is_traced and not _scatters(material) else fields.of_solids
                baked = self._baked(geometry, instance.resolution, device, appearances, sheet) if is_baked else None
                baked_fields = [] if baked is None else [baked]
                rows.add(number, instance, self._mesh(geometry, is_colored), baked_fields, appearances, sheet)
            else:
                appearances = [Appearance.of(instance.material, _PLAIN_PART)]
                if id(geometry) not in self._fields:
                    self._fields[id(geometry)] = field_cache.of_geometry(geometry)
                rows.add(number, instance, None, [self._fields[id(geometry)]], appearances)
        if self._first is None:
            self._first = rows.table.used
        self._textures = self._first | rows.table.used
        return rows.build()

    def _mesh(self, mesh: Mesh, is_colored: bool) -> _core.SceneMesh:
        key = id(mesh), is_colored
        if key not in self._meshes:
            colors = (mesh.vertex_colors, mesh.face_colors) if is_colored else (None, None)
            self._meshes[key] = _core.SceneMesh(mesh._core, mesh.uv, _materials_of(mesh), *colors)
        return self._meshes[key]

    def _sheet(self, mesh: Mesh, appearances: Sequence[Appearance]) -> Sheet:
        if any(appearance.texture is not None and appearance.alpha_mode != "opaque" for appearance in appearances):
            return sheet_of(mesh, appearances)
        key = (
            id(mesh),
            tuple(
                (appearance.alpha_mode, appearance.alpha_cutoff, appearance.two_sided, appearance.color[3])
                for appearance in appearances
            ),
        )
        if key not in self._sheets:
            self._sheets[key] = sheet_of(mesh, appearances)
        return self._sheets[key]

    def _with_thin_walls(self, number: int, instance: Instance, sheet: Sheet, fields: Fields) -> Sheet:
        """Make a mesh a sheet for light if its field would lose thin walls; warn where the field is needed."""
        mesh, resolution = instance.geometry, instance.resolution
        assert isinstance(mesh, Mesh)
        key = id(mesh), resolution
        is_new = key not in self._needed
        if is_new:
            self._needed[key] = needed_resolution(mesh, resolution)
        needed = self._needed[key]
        if needed is None:
            return sheet
        if is_new and (fields.of_sheets or _scatters(instance.material)):
            warn(
                f"instances[{number}]: parts of the mesh are thinner than {THIN_VOXELS} voxels of its field, which may "
                f"lose them; use Instance(resolution={needed}) instead of {resolution}",
                SurfaceWarning,
            )
        return sheet._replace(is_traced=True)

    def _baked(
        self, mesh: Mesh, resolution: int, device: str, appearances: Sequence[Appearance], sheet: Sheet
    ) -> _core.SceneField:
        if any(appearance.alpha_mode == "mask" for appearance in appearances):
            return field_cache.of_mesh(mesh, resolution, device, appearances)
        # Without masks the field covers the whole mesh.
        key = id(mesh), resolution, sheet.is_traced
        if key not in self._fields:
            self._fields[key] = field_cache.of_mesh(mesh, resolution, device, appearances)
        return self._fields[key]


def _scatters(material: Material | None) -> bool:
    """Whether light passes through an object, which needs the length of the path inside its field."""
    return material is not None and any(scattering_rgb(material))


def _materials_of(mesh: Mesh) -> NDArray[np.uint32]:
    """Index of the part of each face."""
    owner = np.zeros(len(mesh.faces), dtype=np.uint32)
    for number, part in enumerate(mesh.parts):
        owner[part.faces.start : part.faces.stop] = number
    return owner
