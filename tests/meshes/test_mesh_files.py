"""Mesh files that contradict themselves, name other files, or store triangles in unusual ways."""

import base64
import importlib.util
import json
import os
import struct

import numpy as np
import pytest
from PIL import Image

import fieldbake as fb

TRIANGLE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], "<f4")
POSITIONS = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}


def write_gltf(path, uri="own.bin", **parts):
    """Write a glTF file of one triangle; `parts` replace parts of its JSON."""
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [POSITIONS],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri, "byteLength": 36}],
    }
    path.write_text(json.dumps({name: part for name, part in (tree | parts).items() if part is not None}))
    return path


@pytest.fixture
def folder(tmp_path):
    """A folder for files, with a buffer and a picture in it and others above it."""
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.bin").write_bytes((TRIANGLE + 7).tobytes())
    (inner / "own.bin").write_bytes(TRIANGLE.tobytes())
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "secret.png")
    Image.new("RGB", (2, 2), (0, 255, 0)).save(inner / "own.png")
    (tmp_path / "secret.mtl").write_text("newmtl paint\nKd 0 0 1\n")
    return inner


OUTSIDE = ["../secret{}", "x/../../secret{}", "..\\secret{}", "absolute"]


def outside(name, folder, ending):
    return str(folder.parent / f"secret{ending}") if name == "absolute" else name.format(ending)


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_gltf_file_reads_no_buffer_outside_of_its_folder(folder, name):
    path = write_gltf(folder / "a.gltf", outside(name, folder, ".bin"))
    with pytest.raises(fb.MeshError, match=r"a\.gltf: .*outside of its folder; only files beside it are read"):
        fb.load_mesh(path)


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_texture_is_read_outside_of_the_folder(folder, name):
    texture = outside(name, folder, ".png")
    (folder / "a.mtl").write_text(f"newmtl paint\nmap_Kd {texture}\n")
    (folder / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl paint\nf 1/1 2/1 3/1\n")
    assert fb.load_mesh(folder / "a.obj").texture is None
    parts = {
        "images": [{"uri": texture}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
    }
    assert fb.load_mesh(write_gltf(folder / "a.gltf", **parts)).texture is None


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_material_is_read_outside_of_the_folder(folder, name):
    material = outside(name, folder, ".mtl")
    (folder / "a.obj").write_text(f"mtllib {material}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl paint\nf 1 2 3\n")
    assert fb.load_mesh(folder / "a.obj").parts[0].color == (1, 1, 1, 1)


def test_names_are_found_beside_the_file(folder):
    for name in ("own.bin", "./own.bin", "x/../own.bin", "textures\\own.bin", "C:\\work\\own.bin", "/home/a/own.bin"):
        assert np.array_equal(fb.load_mesh(write_gltf(folder / "a.gltf", name)).vertices, TRIANGLE), name
    (folder / "deep").mkdir()
    (folder / "deep" / "own.bin").write_bytes((TRIANGLE + 1).tobytes())
    assert np.array_equal(fb.load_mesh(write_gltf(folder / "a.gltf", "deep/own.bin")).vertices, TRIANGLE + 1)
    with pytest.raises(fb.MeshError, match=r"'lost\.bin', which is not beside it"):
        fb.load_mesh(write_gltf(folder / "a.gltf", "lost.bin"))


@pytest.mark.skipif(os.name != "posix", reason="symbolic links need rights on Windows")
def test_symbolic_links_in_the_folder_are_followed(folder):
    (folder / "link.bin").symlink_to(folder.parent / "secret.bin")
    assert np.array_equal(fb.load_mesh(write_gltf(folder / "a.gltf", "link.bin")).vertices, TRIANGLE + 7)


@pytest.mark.parametrize(
    ("accessor", "parts", "message"),
    [
        ({"bufferView": None}, {"bufferViews": None}, "positions, 0, has no buffer view"),
        ({"bufferView": None, "count": 10**9}, {}, "positions, 0, has no buffer view"),
        ({"byteOffset": -36}, {}, "accessor 0 has the byteOffset -36"),
        ({"byteOffset": 4}, {}, "accessor 0 needs 40 bytes of buffer view 0, which has 36"),
        ({"count": 4}, {}, "accessor 0 needs 48 bytes"),
        ({"count": -1}, {}, "accessor 0 has the count -1"),
        ({"count": 1e30}, {}, "accessor 0 has the count 1e"),
        ({"bufferView": 1}, {}, "accessor 0 has the bufferView 1"),
        ({"componentType": 5127}, {}, "accessor 0 has the unknown type"),
        ({"sparse": {}}, {}, "positions, 0, is sparse"),
        ({}, {"bufferViews": [{"buffer": 0, "byteOffset": -1, "byteLength": 36}]}, "byteOffset -1"),
        ({}, {"bufferViews": [{"buffer": 0, "byteOffset": 1, "byteLength": 36}]}, "ends at byte 37 of a buffer of 36"),
        ({}, {"bufferViews": [{"buffer": 3, "byteLength": 36}]}, "buffer view 0 has the buffer 3"),
        ({}, {"meshes": [{"primitives": [{"attributes": {}}]}]}, "accessor of its positions is None"),
        ({}, {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 7}]}]}, "its indices is 7"),
    ],
)
def test_accessors_that_contradict_the_file_are_named(folder, accessor, parts, message):
    merged = {name: value for name, value in (POSITIONS | accessor).items() if value is not None}
    path = write_gltf(folder / "a.gltf", accessors=[merged], **parts)
    with pytest.raises(fb.MeshError, match=f"a.gltf: .*{message}"):
        fb.load_mesh(path)


def test_unused_accessors_without_data_need_no_memory(folder):
    accessors = [POSITIONS, {"componentType": 5126, "count": 10**12, "type": "MAT4"}]
    assert np.array_equal(fb.load_mesh(write_gltf(folder / "a.gltf", accessors=accessors)).vertices, TRIANGLE)


def test_a_buffer_shorter_than_the_file_states_is_named(folder):
    uri = "data:application/octet-stream;base64," + base64.b64encode(TRIANGLE.tobytes()[:-4]).decode()
    with pytest.raises(fb.MeshError, match=r"contradict each other; is it complete\?"):
        fb.load_mesh(write_gltf(folder / "a.gltf", uri))


def test_nodes_of_scale_0_are_hidden(folder):
    nodes = [{"children": [1, 2]}, {"mesh": 0, "scale": [0, 0, 0]}, {"mesh": 0, "translation": [5, 0, 0]}]
    path = write_gltf(folder / "a.gltf", nodes=nodes)
    assert np.array_equal(fb.load_mesh(path).vertices, TRIANGLE + np.array([5, 0, 0]))
    assert len(fb.load_scene(path).instances) == 1
    with pytest.raises(fb.MeshError, match=r"no triangles \(it is empty, or all nodes have scale 0\)"):
        fb.load_mesh(write_gltf(folder / "a.gltf", nodes=[{"mesh": 0, "scale": [0, 0, 0]}]))
    with pytest.raises(fb.MeshError, match="singular"):
        fb.load_mesh(write_gltf(folder / "a.gltf", nodes=[{"mesh": 0, "scale": [1, 1, 0]}]))


def test_a_camera_at_a_node_of_scale_0_is_hidden(folder):
    nodes = [{"mesh": 0, "children": [1]}, {"camera": 0, "scale": [0, 0, 0]}]
    cameras = [{"type": "perspective", "perspective": {"yfov": 0.8}}]
    assert fb.load_scene(write_gltf(folder / "a.gltf", nodes=nodes, cameras=cameras)).cameras == ()


# --- Draco


def test_a_mesh_compressed_by_draco_is_read_or_the_remedy_is_named(tmp_path):
    primitive = {
        "attributes": {"POSITION": 1},
        "indices": 0,
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}},
    }
    accessors = [
        {"componentType": 5125, "count": 3, "type": "SCALAR"},
        {"componentType": 5126, "count": 3, "type": "VEC3"},
    ]
    extensions = ["KHR_draco_mesh_compression"]
    (tmp_path / "own.bin").write_bytes(bytes(36))
    path = write_gltf(
        tmp_path / "a.gltf",
        meshes=[{"primitives": [primitive]}],
        accessors=accessors,
        extensionsUsed=extensions,
        extensionsRequired=extensions,
    )
    if importlib.util.find_spec("DracoPy") is None:
        with pytest.raises(fb.MeshError, match=r"needs the package DracoPy.*pip install 'fieldbake\[draco\]'"):
            fb.load_mesh(path)
        return
    with pytest.raises(fb.MeshError, match="Draco cannot be decoded"):
        fb.load_mesh(path)
    import trimesh

    if int(trimesh.__version__.partition(".")[0]) < 5:
        return
    ball = trimesh.creation.icosphere(2)
    content = trimesh.exchange.gltf.export_glb(trimesh.Scene(ball), extension_draco=True)
    (tmp_path / "ball.glb").write_bytes(content)
    mesh = fb.load_mesh(tmp_path / "ball.glb")
    assert len(mesh.faces) == len(ball.faces)
    assert mesh.volume == pytest.approx(ball.volume, rel=1e-4)


@pytest.mark.parametrize("ending", ["ply", "drc", "obj"])
def test_a_file_of_draco_is_refused_with_the_remedy(tmp_path, ending):
    (tmp_path / f"a.{ending}").write_bytes(b"DRACO\x02\x02\x01\x01" + bytes(range(200)))
    with pytest.raises(fb.MeshError, match=r"is a file of Draco.*draco_decoder.*DracoPy.decode"):
        fb.load_mesh(tmp_path / f"a.{ending}")


# --- triangle strips

STRIPS = {
    "one run": [[0, 1, 2, 3, 4, 5]],
    "two runs": [[0, 1, 2, 3, -1, 2, 3, 4, 5]],
    "runs of odd length": [[0, 1, 2, -1, 1, 3, 2, 4, -1, 3, 5, 4]],
    "joined": [[0, 1, 2, 3, 3, 2, 2, 3, 4, 5]],
    "two strips": [[0, 1, 2, 3], [2, 3, 4, 5]],
}
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 2, 0), (1, 2, 0)], float)


@pytest.mark.parametrize("strips", STRIPS.values(), ids=STRIPS)
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_triangle_strips_of_a_ply_file_are_triangles(tmp_path, strips, form):
    head = f"ply\nformat {form} 1.0\nelement vertex 6\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element tristrips {len(strips)}\nproperty list int int vertex_indices\nend_header\n"
    if form == "ascii":
        rows = [" ".join(map(str, row)) for row in [*CORNERS, *([len(strip), *strip] for strip in strips)]]
        content = ("\n".join(rows) + "\n").encode()
    else:
        end = "<" if "little" in form else ">"
        content = CORNERS.astype(f"{end}f4").tobytes()
        content += b"".join(struct.pack(f"{end}{len(strip) + 1}i", len(strip), *strip) for strip in strips)
    (tmp_path / "strips.ply").write_bytes(head.encode() + content)
    mesh = fb.load_mesh(tmp_path / "strips.ply")
    assert mesh.area == pytest.approx(2.0)
    assert len(mesh.faces) == 4
    assert np.array_equal(mesh.face_normals, np.tile([0.0, 0.0, 1.0], (4, 1)))


def test_scenes_have_the_order_of_the_file(folder):
    # The nodes: 4 with the children 1 and 0, then 2, then the cameras, in the order 3, 5.
    moved = [{"mesh": 0, "translation": [i, 0, 0], "name": "same"} for i in range(5)]
    nodes = [*moved[:3], {"camera": 0}, {**moved[4], "children": [1, 0]}, {"camera": 1}]
    cameras = [{"type": "perspective", "perspective": {"yfov": yfov, "znear": 0.1}} for yfov in (0.3, 0.6)]
    path = write_gltf(folder / "a.gltf", nodes=nodes, scenes=[{"nodes": [4, 2, 3, 5]}], cameras=cameras)

    scene = fb.load_scene(path)

    assert [instance.transform[0, 3] for instance in scene.instances] == [4, 5, 4, 2]
    assert [camera.fov_deg for camera in scene.cameras] == pytest.approx(np.degrees([0.3, 0.6]))
    corners = fb.load_mesh(path).vertices[::3, 0]
    assert corners.tolist() == [4, 5, 4, 2]
