"""Images of textures are decoded once."""

from __future__ import annotations

import io

import numpy as np
import trimesh
from PIL import Image

import fieldbake as fb

CORNERS = [(-1.0, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
FACES = [(0, 1, 2), (0, 2, 3)]


def test_equal_images_are_decoded_once(tmp_path):
    random = np.random.default_rng(1)
    pixels = random.integers(0, 255, (16, 16, 3), dtype=np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    scene = trimesh.Scene()
    for i in range(4):
        part = trimesh.creation.box()
        part.apply_translation((2 * i, 0, 0))
        material = trimesh.visual.material.PBRMaterial(
            name=f"m{i}", baseColorTexture=Image.open(io.BytesIO(stream.getvalue()))
        )
        part.visual = trimesh.visual.TextureVisuals(uv=part.vertices[:, :2], material=material)
        scene.add_geometry(part)
    scene.export(tmp_path / "shared.glb")
    textures = [
        mesh.parts[0].texture for mesh in (i.geometry for i in fb.load_scene(tmp_path / "shared.glb").instances)
    ]
    assert all(texture is textures[0] for texture in textures)
    assert np.array_equal(textures[0][..., :3], pixels)
    # Arrays that change between two meshes are not confused.
    first = fb.Mesh(CORNERS, FACES, texture=pixels).texture
    pixels[0, 0] = 255 - pixels[0, 0]
    assert not np.array_equal(first, fb.Mesh(CORNERS, FACES, texture=pixels).texture)
