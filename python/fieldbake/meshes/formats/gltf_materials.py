"""Material properties of glTF files that trimesh does not read: vertex colours, texture transforms, emission, unlit.

The JSON of the file is edited before trimesh reads it. Each material and each node is named by its index. Attributes
are copied to names that begin with an underscore, which trimesh returns as they are stored.
"""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import MaterialWarning
from ...base.notices import warn
from ...base.optional import optional_module
from .gltf_accessors import DRACO, check_accessors, uses_draco
from .gltf_tree import GLB_HEADER_BYTES, glb_json_end, visible_nodes

#: Names under which trimesh returns colours and sets of texture coordinates.
COLOR, COORDINATES = "_FIELDBAKE_COLOR", "_FIELDBAKE_UV"

#: Extensions that are read here, by trimesh or by `load_scene`.
KNOWN = {
    "EXT_texture_webp",
    DRACO,
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}

#: Textures that the Blinn-Phong model cannot use.
UNUSED_TEXTURES = {
    "normalTexture": "normal",
    "occlusionTexture": "occlusion",
    "metallicRoughnessTexture": "metallic-roughness",
}

REPEAT = 10497


class Document:
    """The JSON of a glTF file, with the properties that are read after trimesh."""

    def __init__(self, content: bytes, is_binary: bool) -> None:
        start, stop = 0, len(content)
        if is_binary:
            end = glb_json_end(content)
            if end is None:
                raise ValueError("not a binary glTF file")
            start, stop = GLB_HEADER_BYTES, end
        self.tree: dict[str, Any] = json.loads(content[start:stop])
        self._unused: set[str] = set()

        tagged = copy.deepcopy(self.tree)
        check_accessors(tagged)
        self._uses_draco = uses_draco(tagged)
        if self._uses_draco:
            optional_module("DracoPy", "a mesh compressed by Draco", extra="draco")
        for number, material in enumerate(tagged.get("materials", [])):
            material["name"] = str(number)
        for number, node in enumerate(tagged.get("nodes", [])):
            node["name"] = str(number)
        self._ranks = {node: rank for rank, (node, _) in enumerate(visible_nodes(tagged))}
        for mesh in tagged.get("meshes", []):
            for primitive in mesh["primitives"]:
                attributes = primitive["attributes"]
                for name in list(attributes):
                    if name.startswith("TEXCOORD_"):
                        attributes[COORDINATES + name[9:]] = attributes[name]
                if "COLOR_0" in attributes:
                    attributes[COLOR] = attributes.pop("COLOR_0")
        text = json.dumps(tagged).encode()
        if is_binary:
            text += b" " * (-len(text) % 4)
            # The other chunks, which are long, are copied once.
            rest = memoryview(content)[stop:]
            header = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
            text = b"".join((header, text, rest))
        #: The edited file for trimesh.
        self.content: bytes = text

    def check(self, scene: Any) -> None:
        """Raise ValueError if trimesh has left compressed arrays as they are; it then only logs the failure."""
        if self._uses_draco and any(not len(getattr(found, "vertices", [0])) for found in scene.geometry.values()):
            raise ValueError(
                "the data compressed by Draco cannot be decoded; they are damaged, or trimesh is older than 5.0: "
                "pip install 'fieldbake[draco]'"
            )

    def rank(self, node: str) -> int:
        """The place of a node of trimesh in the order of the file: parents first, and children as they are listed."""
        # trimesh adds a text to the names of the primitives of one node.
        return self._ranks.get(int(node.partition("_")[0]), len(self._ranks))

    def node_name(self, node: str) -> str:
        """The name of a node of trimesh in the file."""
        number = node.partition("_")[0]
        return str(self.tree["nodes"][int(number)].get("name", number))

    def read(self, mesh: Any) -> dict[str, Any]:
        """Read the colours, coordinates and material of a mesh that trimesh made of the file.

        Returns
        -------
        dict
            ``colors`` (n, 4) linear RGBA or None; ``uv`` (n, 2), v upwards, or None; ``emission`` (3,);
            ``emission_image``; ``unlit``; ``name`` and ``color`` (RGBA) of the material.
        """
        attributes = mesh.vertex_attributes
        found: dict[str, Any] = {"colors": None, "uv": None}
        if COLOR in attributes:
            rows = _unit(np.asarray(attributes[COLOR]))
            found["colors"] = np.ones((len(rows), 4))
            found["colors"][:, : rows.shape[1]] = rows
        material = getattr(mesh.visual, "material", None)
        name = str(getattr(material, "name", ""))
        materials = self.tree.get("materials", [])
        if material is None or not (name.isdigit() and int(name) < len(materials)):
            return found
        stored = materials[int(name)]
        found["name"] = stored.get("name")
        self._note(stored)

        pbr = stored.get("pbrMetallicRoughness", {})
        base = pbr.get("baseColorTexture")
        emissive = stored.get("emissiveTexture")
        extensions = stored.get("extensions", {})
        gloss = extensions.get("KHR_materials_pbrSpecularGlossiness", {}).get("diffuseTexture")
        if "KHR_materials_pbrSpecularGlossiness" not in extensions:
            # trimesh rounds the factor to bytes.
            found["color"] = _floats(pbr.get("baseColorFactor", (1, 1, 1, 1)))
        shown = base or gloss or emissive
        if shown is not None:
            found["uv"] = self._coordinates(attributes, shown)
        if "KHR_materials_unlit" in extensions:
            found["unlit"] = True
            return found
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        factor = np.array(stored.get("emissiveFactor", (0.0, 0.0, 0.0)), dtype=np.float64) * strength
        found["emission"] = tuple(factor.tolist())
        if emissive is not None and factor.any():
            if _placement(emissive) == _placement(shown):
                found["emission_image"] = getattr(material, "emissiveTexture", None)
            else:
                self._unused.add("emissive textures whose coordinates differ from the base colour's")
                found["emission"] = (0.0, 0.0, 0.0)
        return found

    def _coordinates(self, attributes: Any, texture: dict[str, Any]) -> NDArray[np.float64] | None:
        """Apply the transform of a texture to texture coordinates; v points upwards."""
        set_number, offset, rotation, scale = _placement(texture)
        stored = attributes.get(f"{COORDINATES}{set_number}")
        if stored is None:
            return None
        u, v = (_unit(np.asarray(stored))[:, :2] * scale).T
        # The rotation is counter-clockwise in a picture whose v points downwards, as in Three.js and Bevy.
        cosine, sine = np.cos(rotation), np.sin(rotation)
        uv = np.stack([cosine * u + sine * v, -sine * u + cosine * v], axis=1) + offset
        sampler = self.tree.get("textures", [{}])[texture.get("index", 0)].get("sampler")
        wraps = {} if sampler is None else self.tree["samplers"][sampler]
        clamps = any(wraps.get(side, REPEAT) != REPEAT for side in ("wrapS", "wrapT"))
        if clamps and ((uv < 0) | (uv > 1)).any():
            self._unused.add("clamped and mirrored textures (they repeat)")
        uv[:, 1] = 1 - uv[:, 1]
        return uv

    def _note(self, material: dict[str, Any]) -> None:
        pbr = material.get("pbrMetallicRoughness", {})
        for slot, word in UNUSED_TEXTURES.items():
            if slot in material or slot in pbr:
                self._unused.add(f"{word} textures")

    def warn(self, path: str) -> None:
        """Warn once about all properties of the file that pictures do not show."""
        unknown = set(self.tree.get("extensionsUsed", [])) - KNOWN
        unused = [*sorted(self._unused), *(f"extension {name}" for name in sorted(unknown))]
        if unused:
            warn(f"{path}: not used: {', '.join(unused)}", MaterialWarning)


def _placement(texture: dict[str, Any]) -> tuple[int, tuple[float, ...], float, tuple[float, ...]]:
    """Set of coordinates, offset, rotation (radians) and scale of a texture."""
    transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
    return (
        int(transform.get("texCoord", texture.get("texCoord", 0))),
        _floats(transform.get("offset", (0, 0))),
        float(transform.get("rotation", 0.0)),
        _floats(transform.get("scale", (1, 1))),
    )


def _floats(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _unit(values: NDArray[Any]) -> NDArray[np.float64]:
    """Convert stored values to real numbers; integers are fractions of the largest value of their type."""
    rows = values.astype(np.float64)
    return rows / np.iinfo(values.dtype).max if values.dtype.kind in "iu" else rows
