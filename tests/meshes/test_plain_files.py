"""Files of triangles alone: read without trimesh, as the same triangles that trimesh finds."""

import io
import json
import struct
import subprocess
import sys
import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
from damage import damaged
from fieldbake.meshes.formats.plain_files import read_plain

CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
QUADS = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
#: Endings and contents of plain files.
PLAIN = {
    "quads": (".obj", CUBE + QUADS),
    "lines of Windows": (".obj", (CUBE + QUADS).replace("\n", "\r\n")),
    "an object": (".obj", "# made by hand\no cube one\n" + CUBE + "s off\n" + QUADS),
    "two objects": (".obj", "o a\n" + CUBE + QUADS[:10] + "o b\n" + QUADS[10:]),
    "normals": (".obj", CUBE + "vn 0 0 1\n" + "f 1//1 2//1 4//1\n"),
    "indices from the end": (".obj", CUBE + "f -8 -7 -5\n"),
    "a pentagon and a triangle": (".obj", CUBE + "v .5 2 .5\nf 1 2 4 9 3\nf 5 7 8\n"),
    "weights": (".obj", CUBE.replace("\n", " 1.0\n") + QUADS),
}


def solid():
    return trimesh.creation.icosphere(subdivisions=2)


def exported(kind, **options):
    stream = io.BytesIO()
    solid().export(stream, file_type=kind, **options)
    return stream.getvalue()


def triangles(vertices, faces):
    """The triangles of a mesh, sorted, each turned so that its least corner comes first."""
    corners = np.asarray(vertices)[np.asarray(faces)]
    least = [min(range(3), key=lambda k, face=face: tuple(face[k])) for face in corners.tolist()]
    turned = [np.roll(face, -turn, axis=0).ravel() for face, turn in zip(corners, least, strict=True)]
    return np.array(sorted(map(tuple, turned)))


@pytest.mark.parametrize("name", PLAIN)
def test_plain_obj_files_have_the_triangles_that_trimesh_finds(name, tmp_path):
    ending, text = PLAIN[name]
    path = tmp_path / f"a{ending}"
    path.write_bytes(text.encode())
    assert read_plain(ending, path.read_bytes()) is not None

    mesh = fb.load_mesh(path)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # trimesh computes medians of no normals
        scene = trimesh.load_scene(path, process=False, maintain_order=True)
    (other,) = scene.geometry.values()
    assert len(mesh.faces) == len(other.faces)
    assert np.array_equal(triangles(mesh.vertices, mesh.faces), triangles(other.vertices, other.faces))
    assert mesh.parts[0].name == next(iter(scene.geometry))


def with_json(content, edit):
    """A .glb whose JSON is changed by a function."""
    stop = 20 + struct.unpack("<I", content[12:16])[0]
    tree = json.loads(content[20:stop])
    edit(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(content) - stop, len(text), b"JSON")
    return header + text + content[stop:]


def edited_glb(edit):
    return with_json(exported("glb"), edit)


def narrow_glb(kind, number):
    """A .glb whose indices are stored as a narrower type, which has a number in glTF."""
    content = exported("glb")
    at = len(content) - solid().faces.size * 4 - solid().vertices.size * 4
    indices = np.frombuffer(content, "<u4", solid().faces.size, at)
    narrow = indices.astype(kind).tobytes().ljust(indices.nbytes, b"\0")
    narrowed = content[:at] + narrow + content[at + indices.nbytes :]
    return with_json(narrowed, lambda tree: tree["accessors"][0].update(componentType=number))


OUTLINE = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
#: Patterns of the corners of faces, with and without coordinates and normals.
CORNERS = {"positions": "{0}", "normals": "{0}//1", "coordinates": "{0}/{0}", "all": "{0}/{0}/1"}


def prism(corner, turn):
    """An L-shaped prism of height 1, whose ends are polygons from corner `turn` of the L on."""
    outline = np.roll(OUTLINE, -turn, axis=0)
    lines = [
        f"v {x} {y} {z}\nvt {x} {y}\n" if "/{0}" in corner else f"v {x} {y} {z}\n" for z in (0, 1) for x, y in outline
    ]
    sides = [(i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7) for i in range(6)]
    polygons = [range(7, 13), range(6, 0, -1), *sides]
    lines += ["vn 0 0 1\n"] + [f"f {' '.join(corner.format(i) for i in polygon)}\n" for polygon in polygons]
    return "".join(lines)


@pytest.mark.parametrize("turn", range(6))
@pytest.mark.parametrize("name", CORNERS)
def test_concave_polygons_keep_their_outline(name, turn, tmp_path):
    path = tmp_path / "prism.obj"
    path.write_text(prism(CORNERS[name], turn))

    mesh = fb.load_mesh(path)

    assert mesh.is_closed
    assert (mesh.area, mesh.volume) == pytest.approx((14, 3))
    truth = fb.polygon(OUTLINE).extrude(1).translate((0, 0, 0.5))
    points = np.random.default_rng(turn).uniform((-0.5, -0.5, -0.5), (2.5, 2.5, 1.5), (2000, 3))
    assert (
        np.abs(fb.signed_distance(mesh, points, dtype="float64") - truth.distance(points, dtype="float64")).max()
        <= 1e-12
    )
    if "vt" in path.read_text():
        assert np.array_equal(mesh.uv, mesh.vertices[:, :2].astype(np.float32))


@pytest.mark.parametrize("kind", ["stl", "ply", "glb"])
def test_binary_files_have_the_arrays_that_trimesh_finds(kind, tmp_path):
    path = tmp_path / f"a.{kind}"
    path.write_bytes(exported(kind))
    assert read_plain(f".{kind}", path.read_bytes()) is not None

    mesh = fb.load_mesh(path)

    ((name, other),) = trimesh.load_scene(path, process=False).geometry.items()
    assert np.array_equal(mesh.vertices, other.vertices)
    assert np.array_equal(mesh.faces, other.faces)
    assert mesh.parts[0].name == (name if kind == "glb" else path.name)


GLB = {
    "no name": edited_glb(lambda tree: tree["meshes"][0].pop("name")),
    "a node above": edited_glb(lambda tree: tree.update(nodes=[{"children": [1]}, {"mesh": 0}])),
    "bytes as indices": narrow_glb("u1", 5121),
    "shorts as indices": narrow_glb("<u2", 5123),
}


@pytest.mark.parametrize("name", GLB)
def test_plain_glb_files_are_read_as_by_trimesh(name, tmp_path, monkeypatch):
    path = tmp_path / "a.glb"
    path.write_bytes(GLB[name])
    assert read_plain(".glb", path.read_bytes()) is not None

    mesh = fb.load_mesh(path)
    scene = fb.load_scene(path)

    monkeypatch.setattr("fieldbake.meshes.convert.read_plain", lambda *_: None)
    for read in (mesh, scene.instances[0].geometry):
        other = fb.load_mesh(path)
        assert np.array_equal(read.vertices, other.vertices)
        assert np.array_equal(read.faces, other.faces)
        assert [(part.name, part.faces) for part in read.parts] == [(part.name, part.faces) for part in other.parts]
    assert np.array_equal(scene.instances[0].transform, np.eye(4))


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb"])
def test_own_files_come_back_without_trimesh(suffix, tmp_path):
    made = fb.models.gear()
    made.save(tmp_path / f"gear{suffix}")
    code = (
        "import sys, fieldbake as fb\n"
        "mesh = fb.load_mesh(sys.argv[1])\n"
        "assert 'trimesh' not in sys.modules\n"
        "print(len(mesh.faces), mesh.is_closed)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / f"gear{suffix}")]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert found == [str(len(made.faces)), "True"]


OTHER = {
    "colours of vertices": (".obj", (CUBE.replace("\n", " 1 0 0\n") + QUADS).encode()),
    "texture coordinates": (".obj", (CUBE + "vt 0 0\nf 1/1 2/1 4/1\n").encode()),
    "a material": (".obj", (CUBE + "usemtl paint\n" + QUADS).encode()),
    "a joined line": (".obj", (CUBE + "f 1 2 \\\n4\n").encode()),
    "no faces": (".obj", CUBE.encode()),
    "text of stl": (".stl", exported("stl_ascii")),
    "text of ply": (".ply", exported("ply", encoding="ascii")),
    "a cut stl": (".stl", exported("stl")[:-1]),
    "a cut ply": (".ply", exported("ply")[:-1]),
    "a long ply": (".ply", exported("ply") + b"0"),
    "a cut glb": (".glb", exported("glb")[:-1]),
    "a moved node": (".glb", edited_glb(lambda tree: tree["nodes"][0].update(translation=[1, 0, 0]))),
    "a mesh shown twice": (
        ".glb",
        edited_glb(lambda tree: tree.update(nodes=[{"children": [1], "mesh": 0}, {"mesh": 0}])),
    ),
    "a hidden node": (".glb", edited_glb(lambda tree: tree["scenes"][0].update(nodes=[]))),
    "a scene of glb without a mesh": (".glb", edited_glb(lambda tree: tree.update(nodes=[{}]))),
    "an extension": (".glb", edited_glb(lambda tree: tree.update(extensionsUsed=["EXT_a"]))),
    "a material of glb": (
        ".glb",
        edited_glb(lambda tree: (tree.update(materials=[{}]), tree["meshes"][0]["primitives"][0].update(material=0))),
    ),
    "strips": (".glb", edited_glb(lambda tree: tree["meshes"][0]["primitives"][0].update(mode=5))),
    "rows with gaps": (".glb", edited_glb(lambda tree: tree["bufferViews"][1].update(byteStride=12))),
    "a buffer beside the file": (".glb", edited_glb(lambda tree: tree["buffers"][0].update(uri="a.bin"))),
    "sparse positions": (".glb", edited_glb(lambda tree: tree["accessors"][1].update(sparse={}))),
}


@pytest.mark.parametrize("name", OTHER)
def test_other_files_are_left_to_trimesh(name):
    assert read_plain(*OTHER[name]) is None


def test_colours_of_a_ply_are_left_to_trimesh(tmp_path):
    mesh = solid()
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 4), (255, 0, 0, 255), np.uint8)
    mesh.export(tmp_path / "a.ply")
    assert read_plain(".ply", (tmp_path / "a.ply").read_bytes()) is None
    assert fb.load_mesh(tmp_path / "a.ply").vertex_colors is not None


@given(data=st.data(), kind=st.sampled_from(["obj", "stl", "ply", "glb"]))
def test_damage_is_an_error_or_another_mesh(tmp_path_factory, data, kind):
    path = tmp_path_factory.getbasetemp() / f"damaged.{kind}"
    content = (CUBE + QUADS).encode() if kind == "obj" else exported(kind)
    path.write_bytes(damaged(data, content))
    try:
        mesh = fb.load_mesh(path)
    except fb.MeshError:
        return
    assert np.isfinite(mesh.vertices[mesh.faces]).all()
