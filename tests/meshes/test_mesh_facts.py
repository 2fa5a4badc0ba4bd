"""Area, volume and normals of a mesh, its transfer to other processes, and its files."""

import copy
import multiprocessing
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

import fieldbake as fb
import meshes


def test_area_volume_and_normals_of_a_box():
    mesh = fb.Mesh(*meshes.box((0, 0, 0), (1, 2, 3)))

    assert mesh.area == pytest.approx(22, rel=1e-14)
    assert mesh.volume == pytest.approx(6, rel=1e-14)
    assert mesh.is_closed
    assert np.abs(mesh.face_normals).sum(axis=1) == pytest.approx(np.ones(12))
    assert np.abs(mesh.vertex_normals) == pytest.approx(np.full((8, 3), 1 / np.sqrt(3)))
    assert fb.Mesh(*meshes.flip(meshes.box())).volume == pytest.approx(-8)
    assert not fb.Mesh(*meshes.open_box()).is_closed
    with pytest.raises(ValueError, match="read-only"):
        mesh.face_normals[0, 0] = 1


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-3, 1e3), (1e3, 1e7)])
def test_facts_keep_their_accuracy_far_away(scale, shift):
    mesh = fb.Mesh(*meshes.scale_and_shift(meshes.icosphere(3), scale, (shift, -shift, shift)))
    here = fb.Mesh(*meshes.icosphere(3))

    # The positions are rounded to 1e-16 of the shift, edges are a tenth of the size.
    room = 1e-12 + 1e-14 * shift / scale
    assert mesh.area == pytest.approx(here.area * scale**2, rel=room)
    assert mesh.volume == pytest.approx(here.volume * scale**3, rel=room)
    assert mesh.vertex_normals == pytest.approx(here.vertex_normals, abs=10 * room)


def dirty_mesh():
    """A mesh with everything that must travel: dropped vertices, degenerate faces, texture, opacity, parts."""
    vertices, faces = meshes.icosphere(2)
    vertices = np.concatenate([[[np.nan, 0, 0]], vertices, [[0, np.inf, 0]]])
    faces = np.concatenate([[[1, 1, 2]], faces[:100] + 1, [[3, 4, 3]], faces[100:] + 1, [[5, 5, 5]]])
    uv = np.random.default_rng(1).uniform(size=(len(vertices), 2))
    image = np.random.default_rng(2).integers(0, 255, (8, 8, 4)).astype(np.uint8)
    parts = [
        fb.Part("one", range(90), image=image, alpha_mode="mask"),
        fb.Part("two", range(90, len(faces)), color=(0.1, 0.2, 0.3, 1)),
    ]
    return fb.Mesh(vertices, faces, uv=uv, parts=parts)


def assert_same(one, two):
    assert np.array_equal(one.vertices, two.vertices)
    assert np.array_equal(one.faces, two.faces)
    assert one.topology() == two.topology()
    assert np.array_equal(one.uv, two.uv)
    assert np.array_equal(one.texture, two.texture)
    assert np.array_equal(one.alpha, two.alpha)
    assert [vars(p) | {"_image": None, "texture": None, "alpha": None} for p in one.parts] == [
        vars(p) | {"_image": None, "texture": None, "alpha": None} for p in two.parts
    ]
    assert np.array_equal(one._core.source_faces, two._core.source_faces)
    assert np.array_equal(one._core.source_vertices, two._core.source_vertices)
    points = meshes.points_around(meshes.Geometry(one.vertices, one.faces), 50)
    assert np.array_equal(fb.query(one, points).distances, fb.query(two, points).distances)


@pytest.mark.parametrize("protocol", [2, pickle.HIGHEST_PROTOCOL])
def test_pickles_bring_everything(protocol):
    mesh = dirty_mesh()
    mesh.texture, mesh.alpha  # noqa: B018 - decoded pixels must not travel twice

    assert_same(pickle.loads(pickle.dumps(mesh, protocol)), mesh)


def test_deep_copies_are_equal():
    mesh = dirty_mesh()

    assert_same(copy.deepcopy(mesh), mesh)
    assert_same(copy.copy(mesh), mesh)


def test_a_pickle_is_as_large_as_its_arrays():
    mesh = fb.Mesh(*meshes.icosphere(5))
    fb.signed_distance(mesh, [(0, 0, 0)])

    assert len(pickle.dumps(mesh)) <= 1.1 * (mesh.vertices.nbytes + mesh.faces.nbytes)


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_meshes_cross_to_worker_processes(method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    mesh, points = fb.Mesh(*meshes.icosphere(3)), [(0.1, 0.2, 0.3)]
    expected = fb.signed_distance(mesh, points)  # the parent's threads are running when the child is forked

    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply_async(fb.signed_distance, (mesh, points)).get(timeout=60) == expected


def repeated_faces():
    vertices, faces = meshes.icosphere(3)
    return fb.Mesh(vertices, np.repeat(faces, 10, axis=0))


def slivers():
    angles = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles), 0.01 * np.sin(5 * angles)], axis=1)
    corners = np.stack([0 * rim, rim, 1.001 * np.roll(rim, -1, axis=0)], axis=1)
    return fb.Mesh(corners.reshape(-1, 3), np.arange(3 * len(rim)).reshape(-1, 3))


@pytest.mark.parametrize("make", [repeated_faces, slivers])
@pytest.mark.parametrize("count", [1, 5000])
def test_a_forked_process_derives_the_tables_of_its_first_query(make, count):
    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("no fork here")
    points = np.random.default_rng(4).uniform(-1, 1, (count, 3))
    expected = fb.signed_distance(make(), points)
    mesh = make()
    fb.cast_rays(mesh, [(0, 0, 3)], [(0, 0, -1)])  # builds the tree, but not the tables of distances
    context = multiprocessing.get_context("fork")
    results = context.SimpleQueue()
    child = context.Process(target=lambda: results.put(fb.signed_distance(mesh, points)))

    child.start()
    child.join(60)

    child.kill()
    assert child.exitcode == 0
    assert np.array_equal(results.get(), expected)


def test_scenes_travel():
    camera = fb.Camera((3, 2, 4), (0, 0, 0))
    light = fb.DirectionalLight((0, -1, 0))
    scene = fb.Scene(
        [fb.Instance(fb.Mesh(*meshes.box()))], [light], ambient=0.3, background=(1, 0, 0), cameras=[camera]
    )
    drawn = fb.render(scene, camera, size=(24, 16), device="cpu")

    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert np.array_equal(fb.render(again, camera, size=(24, 16), device="cpu").color, drawn.color)
        assert again.cameras[0].fov_deg == camera.fov_deg


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb", "3mf", "STL"])
def test_files_keep_the_geometry(kind, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    mesh = fb.Mesh(*meshes.scale_and_shift(meshes.knot(48, 6), 0.1, (1 / 3, 0, 0)))
    path = tmp_path / f"knot.{kind}"

    mesh.save(path)

    if kind == "3mf":
        pytest.importorskip("lxml")
        pytest.importorskip("networkx")
    again = fb.load_mesh(path)
    assert again.is_closed
    # STL and GLB have float32 positions.
    room = 1e-7 if kind.lower() in ("stl", "glb") else 0
    assert np.abs(again.vertices[again.faces] - mesh.vertices[mesh.faces]).max() <= room
    assert trimesh.load_mesh(str(path)).volume == pytest.approx(mesh.volume, rel=1e-5)


def test_3mf_is_a_package_with_the_triangles(tmp_path):
    import xml.etree.ElementTree as ET
    import zipfile

    fb.Mesh(*meshes.box()).save(tmp_path / "a.3mf")

    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        assert {"[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"} == set(archive.namelist())
        model = ET.fromstring(archive.read("3D/3dmodel.model"))
    names = [element.tag.rpartition("}")[2] for element in model.iter()]
    assert (names.count("vertex"), names.count("triangle"), names.count("item")) == (8, 12, 1)


def test_a_failed_save_leaves_the_file(tmp_path, monkeypatch):
    path = tmp_path / "a.obj"
    path.write_text("before")
    mesh = fb.Mesh(*meshes.box())
    monkeypatch.setattr("fieldbake.meshes.formats.export._write_obj", lambda *_: (_ for _ in ()).throw(OSError("full")))

    with pytest.raises(OSError, match="full"):
        mesh.save(path)

    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_endings_are_named(tmp_path):
    with pytest.raises(fb.MeshError, match=r"\.stl.*got the ending '\.xyz'"):
        fb.Mesh(*meshes.box()).save(tmp_path / "a.xyz")


def test_the_unit_sphere_is_about_the_centre_of_the_box():
    """The formula of mesh_to_sdf: subtract the centre of the box, divide by the largest distance from there."""
    corners, faces = meshes.tetrahedron()
    corners = corners * (1, 2, 5) + (30, 0, -7)
    centered = corners - (corners.min(axis=0) + corners.max(axis=0)) / 2
    expected = centered / np.linalg.norm(centered, axis=1).max()

    unit, _ = fb.normalize((corners, faces), "unit sphere")

    assert np.abs(unit.vertices - expected).max() <= 1e-14


@pytest.mark.parametrize("target", ["unit cube", "unit sphere"])
def test_normalised_meshes_fit(target):
    geometry = meshes.scale_and_shift(meshes.knot(48, 6), 70, (1e4, -3, 5))

    mesh, transform = fb.normalize(geometry, target)

    moved = geometry.vertices @ transform[:3, :3].T + transform[:3, 3]
    assert np.abs(moved - mesh.vertices).max() <= 1e-12
    assert np.abs(mesh.bounds.mean(axis=0)).max() <= 1e-12
    size = np.ptp(mesh.bounds, axis=0).max() if target == "unit cube" else np.linalg.norm(mesh.vertices, axis=1).max()
    assert size == pytest.approx(1, rel=1e-12)


def test_normalising_keeps_what_belongs_to_the_mesh():
    mesh = dirty_mesh()

    normal = fb.normalize(mesh, "unit cube").mesh

    assert np.array_equal(normal.uv, mesh.uv)
    assert normal.topology() == mesh.topology()
    assert [part.faces for part in normal.parts] == [part.faces for part in mesh.parts]
    with pytest.raises(fb.ArgumentError, match="unit cube"):
        fb.normalize(mesh, "box")


# --- objects of other libraries, by the attributes that they have


class Vector:
    def __init__(self, *xyz):
        self.X, self.Y, self.Z = xyz


class Solid:
    """A solid as build123d and CadQuery show it."""

    def vertices(self):
        raise AssertionError("a method, not an array")

    faces = vertices

    def BoundingBox(self):
        return SimpleNamespace(DiagonalLength=np.sqrt(12))

    def tessellate(self, tolerance):
        self.tolerance = tolerance
        vertices, faces = meshes.box()
        return [Vector(*v) for v in vertices], [tuple(f) for f in faces.tolist()]


def test_solids_are_tessellated_and_the_report_says_how_closely():
    solid = Solid()

    mesh = fb.as_mesh(solid)

    assert mesh.volume == pytest.approx(8)
    assert mesh.chord_error == solid.tolerance == pytest.approx(1e-4 * np.sqrt(12))
    assert fb.bake(solid, 8).report.chord_error == mesh.chord_error
    assert fb.query(solid, [(0, 0, 0)]).report.chord_error == mesh.chord_error


def test_polydata_and_open3d_meshes_are_taken():
    vertices, faces = meshes.box()
    polydata = SimpleNamespace(triangulate=None, is_all_triangles=True, points=vertices, regular_faces=faces)
    legacy = SimpleNamespace(vertices=vertices, triangles=faces)
    tensor = SimpleNamespace(vertex=SimpleNamespace(positions=vertices), triangle=SimpleNamespace(indices=faces))

    for geometry in (polydata, legacy, tensor):
        assert fb.as_mesh(geometry).volume == pytest.approx(8)


class OnlyDlpack:
    """An array of another library that offers the DLPack protocol alone."""

    def __init__(self, array):
        self._array = np.ascontiguousarray(array)

    def __dlpack__(self, **options):
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self._array.__dlpack_device__()


def test_dlpack_arrays_are_taken():
    vertices, faces = meshes.box()

    mesh = fb.as_mesh((OnlyDlpack(vertices), OnlyDlpack(faces)))

    assert mesh.volume == pytest.approx(8)
    assert fb.signed_distance(mesh, OnlyDlpack(np.zeros((4, 3), np.float32))).tolist() == [-1] * 4


def test_a_manifold_is_the_same_solid():
    manifold3d = pytest.importorskip("manifold3d")
    gear = fb.models.gear()
    solid = gear.to_manifold()
    assert isinstance(solid, manifold3d.Manifold)
    assert solid.volume() == pytest.approx(gear.volume, rel=1e-12)
    # Each face has vertices of its own, as in an STL file.
    split = fb.Mesh(gear.vertices[gear.faces].reshape(-1, 3), np.arange(3 * len(gear.faces)).reshape(-1, 3))
    assert split.to_manifold().volume() == pytest.approx(gear.volume, rel=1e-12)
    with pytest.raises(fb.MeshError, match=r"to_manifold: .*solid makes a closed one"):
        fb.Mesh(gear.vertices, gear.faces[1:]).to_manifold()
