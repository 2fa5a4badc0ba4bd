"""Valid input of meshes, errors for invalid input, and the precision at any scale and offset."""

import struct

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

CUBE = meshes.box()
NAN = float("nan")


# --- refused


REFUSED = {
    "vertices in the plane": (np.zeros((4, 2)), CUBE.faces, r"vertices.*\(n, 3\).*\(4, 2\)"),
    "vertices in a row": (np.zeros(12), CUBE.faces, r"vertices.*\(n, 3\)"),
    "vertices in a stack": (np.zeros((2, 4, 3)), CUBE.faces, r"vertices.*\(n, 3\)"),
    "complex vertices": (CUBE.vertices + 0j, CUBE.faces, r"vertices.*complex"),
    "words for vertices": (np.full((8, 3), "a"), CUBE.faces, r"vertices"),
    "ragged vertices": ([[0, 0, 0], [1, 0]], [[0, 1, 0]], r"vertices"),
    "quads": (CUBE.vertices, CUBE.faces[:, [0, 1, 2, 2]], r"faces.*\(m, 3\).*\(12, 4\)"),
    "faces in a row": (CUBE.vertices, CUBE.faces.ravel(), r"faces.*\(m, 3\)"),
    "faces of floats": (CUBE.vertices, CUBE.faces.astype(float), r"faces.*whole numbers.*float64"),
    "faces of truths": (CUBE.vertices, CUBE.faces > 3, r"faces.*whole numbers.*bool"),
    "ragged faces": (CUBE.vertices, [[0, 1, 2], [0, 1]], r"faces"),
    "index past the end": (CUBE.vertices, [[0, 1, 2], [0, 8, 1]], r"faces\[1\].*vertex 8.*8 vertices"),
    "index far past the end": (CUBE.vertices, [[0, 1, 2**40]], rf"faces\[0\].*{2**40}"),
    "index past int64": (CUBE.vertices, np.array([[0, 1, 2**63]], np.uint64), rf"{2**63}"),
    "negative index": (CUBE.vertices, [[0, 1, 2], [3, 4, 5], [0, -1, 2]], r"faces\[2\].*-1"),
    "not a number, used": ([[0, 0, 0], [1, 0, 0], [0, NAN, 0]], [[0, 1, 2]], r"vertices\[2\].*(?i:nan).*faces\[0\]"),
    "infinity, used": ([[0, 0, 0], [1, 0, 0], [0, -np.inf, 0]], [[0, 1, 2]], r"vertices\[2\].*inf"),
    "no vertices": (np.zeros((0, 3)), np.zeros((0, 3), int), r"empty.*0 vertices and 0 faces"),
    "no faces": (CUBE.vertices, np.zeros((0, 3), int), r"empty.*8 vertices and 0 faces"),
    "empty lists": ([], [], r"empty"),
    "all faces degenerate": ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2], [0, 0, 1]], r"all 2 faces are degenerate"),
    "too small for float32": (CUBE.vertices * 1e-35, CUBE.faces, r"spans.*scale it"),
    "too large for float32": (CUBE.vertices * 1e36, CUBE.faces, r"spans.*scale it"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_mesh_is_refused_by_name(name):
    vertices, faces, message = REFUSED[name]

    with pytest.raises(fb.MeshError, match=message):
        fb.bake((vertices, faces), resolution=8)


@pytest.mark.parametrize("name", REFUSED)
def test_every_entrance_refuses_the_same(name):
    vertices, faces, _ = REFUSED[name]
    entrances = [
        lambda: fb.Mesh(vertices, faces),
        lambda: fb.signed_distance((vertices, faces), [[0, 0, 0]]),
        lambda: fb.closest_point((vertices, faces), [[0, 0, 0]]),
        lambda: fb.arrays.bake(vertices, faces, (-2, -2, -2), (2, 2, 2), (4, 4, 4)),
    ]

    for entrance in entrances:
        with pytest.raises(fb.MeshError):
            entrance()


@pytest.mark.parametrize("geometry", [None, 3, {}, [], (), "", b"mesh", object(), (1, 2, 3), [None], ("a", "b", "c")])
def test_objects_that_are_no_mesh(geometry):
    with pytest.raises((fb.MeshError, FileNotFoundError)):
        fb.bake(geometry, resolution=8)


def test_a_bad_part_of_a_list_is_named():
    broken = (CUBE.vertices, [[0, 1, 9]])

    with pytest.raises(fb.MeshError, match=r"mesh\[1\].*faces\[0\].*vertex 9"):
        fb.bake([CUBE, broken], resolution=8)


@pytest.mark.parametrize(
    "transform",
    [
        np.zeros((4, 4)),
        np.eye(3),
        np.eye(4) * NAN,
        np.diag([1, 1, 0, 1]),
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 0, 0, 1]],
    ],
    ids=["zero", "3x3", "nan", "flat", "transposed"],
)
def test_a_transform_that_cannot_be_undone(transform):
    with pytest.raises(fb.MeshError, match="transform"):
        fb.bake([(CUBE, transform)], resolution=8)


# --- repaired and counted


def test_an_unused_vertex_that_is_not_finite_is_dropped_and_counted():
    vertices = np.concatenate([CUBE.vertices[:3], [[NAN, 0, 0], [0, np.inf, 0]], CUBE.vertices[3:]])
    faces = np.where(CUBE.faces >= 3, CUBE.faces + 2, CUBE.faces)

    volume = fb.bake((vertices, faces), resolution=12)

    assert volume.report.dropped_vertices == 2
    assert np.array_equal(volume.distances, fb.bake(CUBE, resolution=12).distances)


def test_a_finite_unused_vertex_changes_neither_box_nor_distances():
    stray = meshes.Geometry(np.concatenate([CUBE.vertices, [[1e9, 0, 0]]]), CUBE.faces)

    volume = fb.bake(stray, resolution=12)

    assert np.array_equal(volume.distances, fb.bake(CUBE, resolution=12).distances)


def test_degenerate_faces_are_dropped_and_counted():
    useless = [[0, 0, 1], [2, 2, 2], [0, 8, 1]]  # two equal corners, three, no area
    vertices = np.concatenate([CUBE.vertices, [CUBE.vertices[[0, 1]].mean(axis=0)]])

    volume = fb.bake((vertices, np.concatenate([useless, CUBE.faces])), resolution=12)

    assert volume.report.degenerate_faces == 3
    assert volume.report.faces == 12
    assert np.array_equal(volume.distances, fb.bake(CUBE, resolution=12).distances)


def test_a_thin_triangle_is_not_degenerate(random):
    sliver = meshes.Geometry(np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-5, 0]]), np.array([[0, 1, 2]]))
    points = meshes.points_around(sliver, 200)

    mesh = fb.Mesh(*sliver)

    assert mesh.topology()["degenerate_faces"] == 0
    truths = truth.closest_point(*sliver, points).distances
    assert np.abs(fb.closest_point(mesh, points).distances - truths).max() <= truth.tolerance(*sliver, truths).min()


# --- ways to come in


@pytest.mark.parametrize(
    "dtype",
    [np.int8, np.uint8, np.int16, np.int32, np.uint32, np.int64, np.uint64, ">i4"],
    ids=lambda d: np.dtype(d).str,
)
def test_any_whole_number_type_does_for_faces(dtype):
    expected = fb.bake(CUBE, resolution=8).distances

    assert np.array_equal(fb.bake((CUBE.vertices, CUBE.faces.astype(dtype)), resolution=8).distances, expected)


@pytest.mark.parametrize(
    "dtype", [np.int8, np.float16, np.float32, ">f4", np.float64, np.longdouble], ids=lambda d: np.dtype(d).str
)
def test_any_real_type_does_for_vertices(dtype):
    expected = fb.bake(CUBE, resolution=8).distances

    assert np.array_equal(fb.bake((CUBE.vertices.astype(dtype), CUBE.faces), resolution=8).distances, expected)


def test_lists_slices_and_read_only_arrays_do(random):
    expected = fb.bake(CUBE, resolution=8).distances
    padded = np.zeros((16, 6))
    padded[::2, ::2] = CUBE.vertices
    frozen = CUBE.vertices.copy()
    frozen.flags.writeable = False

    for vertices in (CUBE.vertices.tolist(), np.asfortranarray(CUBE.vertices), padded[::2, ::2], frozen):
        assert np.array_equal(fb.bake((vertices, CUBE.faces.tolist()), resolution=8).distances, expected)


def test_the_input_is_not_changed():
    vertices, faces = CUBE.vertices.copy(), CUBE.faces.copy()

    fb.bake((vertices, faces), resolution=8)

    assert np.array_equal(vertices, CUBE.vertices)
    assert np.array_equal(faces, CUBE.faces)


def test_changing_the_input_later_does_not_change_the_mesh():
    vertices = CUBE.vertices.copy()
    mesh = fb.Mesh(vertices, CUBE.faces)
    vertices[:] = 7

    assert fb.signed_distance(mesh, [[0, 0, 0]]) == -1


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
@pytest.mark.parametrize("kind", [str, lambda path: path], ids=["str", "Path"])
def test_files_are_read_by_path(tmp_path, suffix, kind):
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / f"cube.{suffix}"
    trimesh.Trimesh(*CUBE, process=False).export(path)

    volume = fb.bake(kind(path), resolution=12)

    assert np.array_equal(volume.distances, fb.bake(CUBE, resolution=12).distances)
    assert volume.report.closed


def test_load_mesh_keeps_the_order_of_the_file(tmp_path):
    path = tmp_path / "tetrahedron.obj"
    vertices, faces = meshes.tetrahedron()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines))

    mesh = fb.load_mesh(path)

    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.uint32
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.faces, faces)


def test_trimesh_objects_are_taken():
    trimesh = pytest.importorskip("trimesh")
    body = trimesh.Trimesh(*CUBE, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(body, transform=trimesh.transformations.translation_matrix((5, 0, 0)))
    expected = fb.bake(CUBE, resolution=12)

    alone, placed = fb.bake(body, resolution=12), fb.bake(scene, resolution=12)

    assert np.array_equal(alone.distances, expected.distances)
    assert np.array_equal(placed.distances, expected.distances)
    assert placed.origin - expected.origin == pytest.approx((5, 0, 0))


def test_a_list_is_one_surface():
    left, right = meshes.box((-1.5, -1, -1), (0.5, 1, 1)), meshes.box((-0.5, -1, -1), (1.5, 1, 1))

    listed = fb.bake([left, right], resolution=16)

    assert np.array_equal(listed.distances, fb.bake(meshes.overlapping_boxes(), resolution=16).distances)


def test_a_transform_places_each_item_of_a_list():
    away = np.array([[0, -1, 0, 3], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)

    placed = fb.bake([CUBE, (CUBE, away)], resolution=16)

    assert np.array_equal(
        placed.distances, fb.bake(meshes.join(CUBE, meshes.move(CUBE, away)), resolution=16).distances
    )


def test_a_mirroring_transform_keeps_outside_outside():
    mirror = np.diag([-1.0, 1, 1, 1])
    wedge = meshes.tetrahedron()

    volume = fb.bake([(wedge, mirror)], resolution=16)

    assert volume.report.warnings == ()
    assert truth.volume(*meshes.flip(meshes.move(wedge, mirror))) > 0
    assert volume.sample([[0, 0, 0]])[0] < 0


def test_a_mesh_is_made_once_and_asked_often(random):
    mesh = fb.Mesh(*meshes.icosphere(2))
    points = random.uniform(-1, 1, size=(50, 3))

    assert np.array_equal(fb.signed_distance(mesh, points), fb.signed_distance(meshes.icosphere(2), points))
    assert "320 faces" in repr(mesh)


# --- bad files


def test_a_missing_file_stays_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        fb.load_mesh(tmp_path / "nowhere.obj")


def test_a_folder_is_no_mesh(tmp_path):
    with pytest.raises(fb.MeshError, match="directory"):
        fb.load_mesh(tmp_path)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "gltf"])
@pytest.mark.parametrize(
    "content", [b"", b"\x00" * 200, b"hello\nworld\n", bytes(range(256)) * 8], ids=["empty", "zeros", "text", "bytes"]
)
def test_a_file_of_something_else(tmp_path, suffix, content):
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)

    with pytest.raises(fb.MeshError, match=path.name):
        fb.load_mesh(path)


def test_an_unknown_ending(tmp_path):
    path = tmp_path / "cube.xyzzy"
    path.write_bytes(b"solid")

    with pytest.raises(fb.MeshError, match="xyzzy"):
        fb.load_mesh(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.7, 0.99])
@pytest.mark.parametrize("kind", ["ply", "ply_ascii", "stl", "stl_ascii", "glb", "off"])
def test_a_truncated_file(tmp_path, kind, share):
    trimesh = pytest.importorskip("trimesh")
    body = trimesh.Trimesh(*meshes.icosphere(2), process=False)
    whole = body.export(file_type="ply", encoding="ascii") if kind == "ply_ascii" else body.export(file_type=kind)
    content = whole.encode() if isinstance(whole, str) else whole
    cut = tmp_path / f"cut.{kind.partition('_')[0]}"
    cut.write_bytes(content[: int(len(content) * share)])

    with pytest.raises(fb.MeshError, match=cut.name):
        fb.load_mesh(cut)


def test_an_obj_file_that_ends_before_its_faces(tmp_path):
    path = tmp_path / "cut.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0")

    with pytest.raises(fb.MeshError, match=r"cut\.obj"):
        fb.load_mesh(path)


@pytest.mark.parametrize("face", ["f 1 2 9", "f 1 2 -9", "f 0 1 2", "f a b c"])
def test_an_obj_file_with_an_impossible_face(tmp_path, face):
    path = tmp_path / "bad.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")

    with pytest.raises(fb.MeshError, match=r"bad\.obj"):
        fb.load_mesh(path)


def test_an_stl_file_that_claims_too_many_triangles(tmp_path):
    path = tmp_path / "greedy.stl"
    path.write_bytes(b"\x00" * 80 + struct.pack("<I", 2**32 - 1) + b"\x00" * 100)

    with pytest.raises(fb.MeshError, match=r"greedy\.stl"):
        fb.load_mesh(path)


def test_a_file_of_points_has_no_triangles(tmp_path):
    path = tmp_path / "points.ply"
    axes = "\n".join(f"property float {axis}" for axis in "xyz")
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{axes}\nend_header\n0 0 0\n")

    with pytest.raises(fb.MeshError, match=r"points\.ply"):
        fb.load_mesh(path)


# --- scale and offset


@pytest.mark.parametrize("scale", [1e-20, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e15])
def test_any_scale_is_exact_relative_to_its_size(scale):
    geometry = meshes.scale_and_shift(meshes.knot(64, 8), scale)
    points = meshes.points_around(geometry, 300)

    found = fb.signed_distance(geometry, points)

    expected = truth.signed_distance(*geometry, points)
    assert (np.abs(found - expected) <= truth.tolerance(*geometry, expected)).all()


@pytest.mark.parametrize("shift", [(1e4, 0, 0), (0, -1e6, 0), (1e6, 1e6, 1e6)])
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_any_offset_is_exact_relative_to_the_box(shift, scale):
    geometry = meshes.scale_and_shift(meshes.knot(64, 8), scale, shift)
    points = meshes.points_around(geometry, 300)

    found = fb.signed_distance(geometry, points)

    expected = truth.signed_distance(*geometry, points)
    assert (np.abs(found - expected) <= truth.tolerance(*geometry, expected)).all()


def test_a_tiny_mesh_far_away_is_baked_as_well_as_one_at_home():
    here = meshes.torus(segments=24, sides=12)
    there = meshes.scale_and_shift(
        here, 1.0, (2.0**20, -(2.0**20), 2.0**20)
    )  # float64 holds the moved vertices to 1e-10

    near, far = fb.bake(here, resolution=24), fb.bake(there, resolution=24)

    assert np.abs(near.distances - far.distances).max() <= 2 * truth.EXACT * truth.diagonal(*here)
    assert far.origin - near.origin == pytest.approx((2.0**20, -(2.0**20), 2.0**20), abs=1e-9)


# --- materials that are refused

WRONG_LOOKS = {
    "a number for parts": ({"parts": 3}, "parts: must be a list of Part"),
    "text for parts": ({"parts": "leaf"}, "parts: must be a list of Part"),
    "an item that is no part": ({"parts": [fb.Part(), None]}, r"parts\[1\]: must be a Part"),
    "a part past the faces": ({"parts": [fb.Part("a", range(13))]}, r"parts\[0\]: range\(0, 13\).*12 faces"),
    "uv that are not numbers": ({"uv": [[0, NAN]] * 8}, r"uv\[0\]: must be finite.*nan"),
    "uv past float32": ({"uv": [[0, 0]] * 7 + [[1e300, 0]]}, r"uv\[7\]: must be finite"),
}


@pytest.mark.parametrize("name", WRONG_LOOKS)
def test_wrong_materials_of_a_mesh_are_refused(name):
    options, message = WRONG_LOOKS[name]

    with pytest.raises(fb.MeshError, match=message):
        fb.Mesh(CUBE.vertices, CUBE.faces, **options)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"faces": 3}, "faces"),
        ({"faces": None}, "faces"),
        ({"faces": range(0, 12, 2)}, "faces"),
        ({"faces": range(-1, 3)}, "faces"),
        ({"color": (1, 0)}, "color"),
        ({"color": "red"}, "color"),
        ({"color": (1, 0, 0, NAN)}, "color"),
        ({"emission": None}, "emission"),
        ({"alpha_mode": "glass"}, "alpha_mode"),
        ({"alpha_cutoff": NAN}, "alpha_cutoff"),
    ],
)
def test_a_wrong_argument_of_a_part_is_refused(options, name):
    with pytest.raises(fb.Error, match=f"^{name}: must"):
        fb.Part("leaf", **options)


def test_vertices_of_a_file_without_coordinates_get_zero(tmp_path):
    """Some exporters write NaN there."""
    file = tmp_path / "sheet.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt nan nan\nvt 1 1\nf 1/1 2/2 3/3\n")

    assert fb.load_mesh(file).uv.tolist() == [[0, 1], [0, 0], [1, 1]]
