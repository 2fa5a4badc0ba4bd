"""Colours of vertices, textures, emission and unlit surfaces against values in closed form."""

from __future__ import annotations

import io
import json
import struct
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image

import fieldbake as fb

#: A square of side 2 in the plane z = 0, seen from straight ahead; it fills the picture.
CORNERS = np.array([(-1.0, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
FACES = np.array([(0, 1, 2), (0, 2, 3)])
CAMERA = fb.Camera((0, 0, 2), (0, 0, 0), fov_deg=53.0)
SIZE = (32, 32)


def points() -> np.ndarray:
    """Position of the centre of each pixel on the square, (h, w, 2)."""
    half = 2 * np.tan(np.radians(53.0) / 2)
    x = ((np.arange(32) + 0.5) / 16 - 1) * half
    return np.stack(np.broadcast_arrays(x[None, :], -x[:, None]), axis=-1)


def shown(geometry, device="cpu", **scene):
    """Linear RGB of the picture under ambient light alone, which is the base colour."""
    options = {"lights": [], "ambient": 1.0, **scene}
    return fb.render(fb.Scene([geometry], **options), CAMERA, size=SIZE, shadows="none", device=device).color[..., :3]


def glb(path, material, *, color=None, uv=None, image=None, extensions=()):
    """Write the square as a binary glTF file."""
    chunks, views, accessors = [], [], []

    def add(array, kind, component, **extra):
        content = array.tobytes()
        start = sum(map(len, chunks))
        chunks.append(content + b"\0" * (-len(content) % 4))
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(content)})
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind, **extra}
        )
        return len(accessors) - 1

    attributes = {
        "POSITION": add(CORNERS.astype("<f4"), "VEC3", 5126, min=[-1, -1, 0], max=[1, 1, 0]),
    }
    if color is not None:
        attributes["COLOR_0"] = add(
            color, f"VEC{color.shape[1]}", {"u1": 5121, "u2": 5123, "f4": 5126}[color.dtype.str[1:]]
        )
    if uv is not None:
        attributes["TEXCOORD_0"] = add(np.asarray(uv, "<f4"), "VEC2", 5126)
    indices = add(FACES.astype("<u2").ravel(), "SCALAR", 5123)
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{"doubleSided": True, **material}],
        "extensionsUsed": list(extensions),
    }
    if image is not None:
        stream = io.BytesIO()
        Image.fromarray(image).save(stream, "PNG")
        add(np.frombuffer(stream.getvalue(), dtype=np.uint8), "SCALAR", 5121)
        accessors.pop()
        tree |= {"images": [{"bufferView": len(views) - 1, "mimeType": "image/png"}], "textures": [{"source": 0}]}
    tree |= {"bufferViews": views, "accessors": accessors, "buffers": [{"byteLength": sum(map(len, chunks))}]}
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(chunks)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    path.write_bytes(
        header + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    )
    return path


def bilinear_of_corners(values: np.ndarray) -> np.ndarray:
    """Values of the corners, interpolated linearly over the two triangles, at each pixel."""
    x, y = np.moveaxis((points() + 1) / 2, -1, 0)
    lower = np.stack([1 - x, x - y, y, 0 * x], axis=-1)
    upper = np.stack([1 - y, 0 * x, x, y - x], axis=-1)
    return np.where((x >= y)[..., None], lower, upper) @ values


COLORS = np.array([(1.0, 0, 0), (0, 0.5, 0), (0, 0, 0.25), (0.5, 0.5, 0.5)])


def test_linear_colors_of_vertices_are_interpolated(device):
    # Float32 weights of a corner are within 1e-6; a ray is 2 units long.
    image = shown(fb.Mesh(CORNERS, FACES, vertex_colors=COLORS), device)
    np.testing.assert_allclose(image, bilinear_of_corners(COLORS), atol=1e-5, equal_nan=False)


def test_bytes_are_srgb_and_faces_have_colors_too():
    half = shown(fb.Mesh(CORNERS, FACES, vertex_colors=np.full((4, 3), 188, np.uint8)))
    np.testing.assert_allclose(half, ((188 / 255 + 0.055) / 1.055) ** 2.4, atol=1e-6, equal_nan=False)
    image = shown(fb.Mesh(CORNERS, FACES, face_colors=[(0.5, 0.0, 0.0), (0.0, 0.0, 1.0)]))
    x, y = np.moveaxis(points(), -1, 0)
    expected = np.where((x >= y)[..., None], (0.5, 0.0, 0.0), (0.0, 0.0, 1.0))
    off_diagonal = np.abs(x - y) > 1e-6
    np.testing.assert_allclose(image[off_diagonal], expected[off_diagonal], atol=1e-6, equal_nan=False)


def test_trimesh_and_ply_keep_their_colors(tmp_path):
    mesh = trimesh.Trimesh(CORNERS, FACES, process=False)
    mesh.visual.vertex_colors = np.tile(np.array([[188, 0, 255, 255]], np.uint8), (4, 1))
    mesh.export(tmp_path / "scan.ply")
    expected = (((188 / 255 + 0.055) / 1.055) ** 2.4, 0.0, 1.0)
    for geometry in (mesh, fb.load_mesh(tmp_path / "scan.ply"), fb.as_mesh([mesh, (mesh, np.eye(4))])):
        np.testing.assert_allclose(shown(geometry), np.broadcast_to(expected, (32, 32, 3)), atol=1e-6, equal_nan=False)
    faces = trimesh.Trimesh(CORNERS, FACES, process=False)
    faces.visual.face_colors = [[255, 0, 0, 255], [255, 0, 0, 255]]
    assert np.array_equal(shown(faces), np.broadcast_to(np.float32((1, 0, 0)), (32, 32, 3)))
    # A material with a colour of its own replaces them.
    green = fb.Instance(faces, material=fb.Material(color=(0, 1, 0)))
    assert np.array_equal(shown(green), np.broadcast_to(np.float32((0, 1, 0)), (32, 32, 3)))


@pytest.mark.parametrize("stored", ["float", "bytes"])
def test_gltf_multiplies_factor_texture_and_linear_vertex_colors(tmp_path, device, stored):
    image = np.zeros((2, 2, 3), np.uint8) + np.uint8(188)
    color = (
        COLORS.astype("<f4")
        if stored == "float"
        else np.pad(np.round(COLORS * 255), ((0, 0), (0, 1)), constant_values=255).astype("u1")
    )
    material = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 0.25, 1], "baseColorTexture": {"index": 0}}}
    uv = [(0, 1), (1, 1), (1, 0), (0, 0)]
    path = glb(tmp_path / "a.glb", material, color=color, uv=uv, image=image)
    texel = ((188 / 255 + 0.055) / 1.055) ** 2.4
    rows = color[:, :3].astype(float) / (1 if stored == "float" else 255)
    expected = bilinear_of_corners(rows) * texel * (0.5, 1, 0.25)
    np.testing.assert_allclose(shown(fb.load_mesh(path), device), expected, atol=1e-5, equal_nan=False)


def test_a_texture_in_column_order_looks_the_same():
    image = np.full((4, 6, 4), 255, np.uint8)
    image[..., :3] = np.arange(72, dtype=np.uint8).reshape(4, 6, 3) * 3
    mesh = fb.Mesh(CORNERS, FACES, uv=[(0, 0), (1, 0), (1, 1), (0, 1)])
    rows, columns = (
        shown(fb.Instance(mesh, material=fb.Material(texture=pixels)))
        for pixels in (np.ascontiguousarray(image), np.asfortranarray(image))
    )
    assert rows.min() < 0.1 < 0.5 < rows.max()
    assert np.array_equal(rows, columns)


def test_texture_transforms_move_the_coordinates(tmp_path):
    quarters = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 0)]], np.uint8)
    uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)
    turn, scale, offset = 0.7, np.array((0.6, 1.4)), np.array((0.3, -0.2))
    transform = {"rotation": turn, "scale": scale.tolist(), "offset": offset.tolist()}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    pbr = {"pbrMetallicRoughness": {"baseColorTexture": texture}}
    path = glb(tmp_path / "a.glb", pbr, uv=uv, image=quarters, extensions=["KHR_texture_transform"])
    c, s = np.cos(turn), np.sin(turn)
    by_hand = (uv * scale) @ np.array([(c, s), (-s, c)]).T + offset
    other = glb(
        tmp_path / "b.glb", {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}, uv=by_hand, image=quarters
    )
    # Coordinates of the second file are float32.
    np.testing.assert_allclose(shown(fb.load_mesh(path)), shown(fb.load_mesh(other)), atol=1e-5, equal_nan=False)
    # A turn by a positive quarter puts the image's lower left texel to the left of the upper edge's start.
    mesh = fb.load_mesh(path)
    np.testing.assert_allclose(mesh.uv, by_hand * (1, -1) + (0, 1), atol=1e-6, equal_nan=False)


def test_emission_is_added_and_unlit_needs_no_light(tmp_path):
    base = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1]}}
    strong = {"KHR_materials_emissive_strength": {"emissiveStrength": 3.0}}
    glows = {**base, "emissiveFactor": [0.1, 0.2, 0.3], "extensions": strong}
    path = glb(tmp_path / "a.glb", glows, extensions=list(strong))
    expected = 0.5 * np.array((0.5, 0.25, 0.125)) + 3 * np.array((0.1, 0.2, 0.3))
    np.testing.assert_allclose(
        shown(fb.load_mesh(path), ambient=0.5), np.broadcast_to(expected, (32, 32, 3)), atol=1e-6, equal_nan=False
    )

    unlit = {**base, "emissiveFactor": [1, 1, 1], "extensions": {"KHR_materials_unlit": {}}}
    path = glb(tmp_path / "b.glb", unlit, extensions=["KHR_materials_unlit"])
    for lights in ([], [fb.DirectionalLight((0, 0, -1))]):
        image = shown(fb.load_mesh(path), lights=lights, ambient=0.0)
        np.testing.assert_allclose(image, np.broadcast_to((0.5, 0.25, 0.125), (32, 32, 3)), atol=1e-6, equal_nan=False)

    image = np.zeros((1, 1, 3), np.uint8) + np.uint8(188)
    textured = {"emissiveFactor": [1, 0.5, 0], "emissiveTexture": {"index": 0}}
    path = glb(tmp_path / "c.glb", textured, uv=[(0, 0)] * 4, image=image)
    expected = ((188 / 255 + 0.055) / 1.055) ** 2.4 * np.array((1, 0.5, 0))
    np.testing.assert_allclose(
        shown(fb.load_mesh(path), ambient=0.0), np.broadcast_to(expected, (32, 32, 3)), atol=1e-6, equal_nan=False
    )

    glow = fb.Material(color=(0.5, 0.5, 0.5), emission=(0, 1, 0))
    assert np.array_equal(
        shown(fb.Instance(fb.Mesh(CORNERS, FACES), material=glow)),
        np.broadcast_to(np.float32((0.5, 1.5, 0.5)), (32, 32, 3)),
    )


def test_what_is_not_used_is_named_once(tmp_path):
    image = np.zeros((1, 1, 3), np.uint8)
    material = {
        "normalTexture": {"index": 0},
        "occlusionTexture": {"index": 0},
        "extensions": {"KHR_materials_sheen": {}},
    }
    path = glb(tmp_path / "a.glb", material, uv=[(0, 0)] * 4, image=image, extensions=["KHR_materials_sheen"])
    with pytest.warns(UserWarning, match="normal textures.*KHR_materials_sheen") as caught:
        fb.load_mesh(path)
    assert len(caught) == 1
    assert "occlusion textures" in str(caught[0].message)


@pytest.mark.parametrize(
    ("colors", "problem"),
    [
        (np.ones((3, 3)), "vertex_colors: must have shape"),
        (np.full((4, 3), -1.0), "vertex_colors: must be finite and not negative"),
        (np.full((4, 3), np.nan), "vertex_colors: must be finite and not negative"),
        (np.ones((4, 3), int), "vertex_colors: must be uint8"),
    ],
)
def test_wrong_colors_are_refused(colors, problem):
    with pytest.raises(fb.MeshError, match=problem), warnings.catch_warnings():
        fb.Mesh(CORNERS, FACES, vertex_colors=colors)
