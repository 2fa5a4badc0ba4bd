"""A moved mesh has the results of a new mesh of the same positions, to the bit."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
import meshes

SIGNS = ["auto", "winding", "parity", "pseudonormal", "normal", "unsigned"]


def soup():
    corners = np.random.default_rng(5).uniform(-1, 1, (120, 1, 3))
    vertices = (corners + np.random.default_rng(6).uniform(-0.2, 0.2, (120, 3, 3))).reshape(-1, 3)
    return meshes.Geometry(vertices, np.arange(360).reshape(-1, 3))


def split_box():
    """A box whose faces share no vertices, so that equal positions close it."""
    vertices, faces = meshes.box()
    return meshes.Geometry(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))


def open_sphere():
    vertices, faces = meshes.icosphere(2)
    return meshes.Geometry(vertices, faces[6:])


def partly_flipped():
    vertices, faces = meshes.icosphere(2)
    faces = faces.copy()
    faces[:40] = faces[:40, ::-1]
    return meshes.Geometry(vertices, faces)


SURFACES = {
    "sphere": lambda: meshes.icosphere(2),
    "open": open_sphere,
    "soup": soup,
    "split box": split_box,
    "partly flipped": partly_flipped,
}


def prepared(geometry):
    """A mesh with its search tree and its connectivity."""
    mesh = fb.Mesh(*geometry)
    fb.query(mesh, [(0.1, 0.2, 0.3)])
    return mesh


def points_around(count=300, reach=1.6):
    return np.random.default_rng(8).uniform(-reach, reach, (count, 3))


def assert_same_results(moved, fresh, device="cpu"):
    points = points_around()
    assert moved.faces.tobytes() == fresh.faces.tobytes()
    assert moved.vertices.tobytes() == fresh.vertices.tobytes()
    assert moved.bounds.tobytes() == fresh.bounds.tobytes()
    assert moved.topology() == fresh.topology()
    for sign in SIGNS:
        ours, theirs = (fb.signed_distance(mesh, points, sign=sign, device=device) for mesh in (moved, fresh))
        assert ours.tobytes() == theirs.tobytes(), sign
    ours, theirs = (fb.query(mesh, points, device=device) for mesh in (moved, fresh))
    assert ours.distances.tobytes() == theirs.distances.tobytes()
    assert ours.gradients.tobytes() == theirs.gradients.tobytes()
    assert ours.points.tobytes() == theirs.points.tobytes()
    if device != "cpu":
        return
    far = points_around(50, 1e5)
    assert fb.signed_distance(moved, far).tobytes() == fb.signed_distance(fresh, far).tobytes()
    assert (fb.contains(moved, points) == fb.contains(fresh, points)).all()
    assert fb.winding_number(moved, points).tobytes() == fb.winding_number(fresh, points).tobytes()
    directions = np.roll(points, 1, axis=0) - points
    ours, theirs = (fb.cast_rays(mesh, points, directions) for mesh in (moved, fresh))
    assert ours.t.tobytes() == theirs.t.tobytes()
    assert (
        fb.count_intersections(moved, points, directions) == fb.count_intersections(fresh, points, directions)
    ).all()
    for sign in ("auto", "normal"):
        ours, theirs = (fb.bake(mesh, (19, 20, 21), sign=sign) for mesh in (moved, fresh))
        assert ours.distances.tobytes() == theirs.distances.tobytes()


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("share", [0.1, 1.0])
def test_results_are_those_of_a_new_mesh(name, share):
    geometry = SURFACES[name]()
    mesh = prepared(geometry)
    random = np.random.default_rng(3)
    before = mesh.vertices.copy()
    for size in (1e-3, 0.1, 0.8):
        chosen = random.random(len(before)) < share
        vertices = mesh.vertices + chosen[:, None] * random.uniform(-size, size, before.shape)
        previous, mesh = mesh, mesh.moved(vertices)
        assert_same_results(mesh, fb.Mesh(vertices, geometry.faces))
        assert mesh is not previous
    assert previous.vertices.tobytes() != mesh.vertices.tobytes()
    assert geometry.vertices.tobytes() == before.tobytes()


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_results_on_a_device_are_those_of_a_new_mesh(device):
    geometry = meshes.icosphere(2)
    vertices = geometry.vertices * (1, 1.2, 1) + 0.05 * np.sin(3 * geometry.vertices[:, [1, 2, 0]])
    assert_same_results(prepared(geometry).moved(vertices), fb.Mesh(vertices, geometry.faces), device)


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_vertices_that_part_and_meet_change_the_connectivity():
    geometry = split_box()
    mesh = prepared(geometry)
    assert mesh.is_closed
    parted = geometry.vertices + np.repeat(np.random.default_rng(1).uniform(0.1, 0.2, (12, 3)), 3, axis=0)
    opened = mesh.moved(parted)
    assert not opened.is_closed
    assert_same_results(opened, fb.Mesh(parted, geometry.faces))
    closed = opened.moved(geometry.vertices)
    assert closed.is_closed
    assert_same_results(closed, fb.Mesh(*geometry))
    # Two spheres whose poles meet.
    one = meshes.icosphere(1)
    pair = np.concatenate([one.vertices, one.vertices + np.array([3, 0, 0])])
    faces = np.concatenate([one.faces, one.faces + len(one.vertices)])
    apart = prepared(meshes.Geometry(pair, faces))
    touching = pair.copy()
    touching[len(one.vertices)] = touching[0]
    assert_same_results(apart.moved(touching), fb.Mesh(touching, faces))


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_faces_may_lose_and_gain_their_area():
    geometry = meshes.icosphere(1)
    mesh = prepared(geometry)
    flat = geometry.vertices.copy()
    a, b = geometry.faces[7, :2]
    flat[a] = flat[b]
    squeezed = mesh.moved(flat)
    assert squeezed.topology()["degenerate_faces"] > 0
    assert_same_results(squeezed, fb.Mesh(flat, geometry.faces))
    assert_same_results(squeezed.moved(geometry.vertices), fb.Mesh(*geometry))


def test_a_mesh_turned_inside_out_is_the_same_solid():
    geometry = meshes.icosphere(2)
    mirrored = geometry.vertices * (-1, 1, 1)
    with pytest.warns(fb.SurfaceWarning, match="inside out"):
        assert_same_results(prepared(geometry).moved(mirrored), fb.Mesh(mirrored, geometry.faces))


@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-6, 0.01, 0.5, 100.0]))
def test_random_motions_keep_every_bit(seed, size):
    geometry = meshes.icosphere(1)
    vertices = geometry.vertices + np.random.default_rng(seed).uniform(-size, size, geometry.vertices.shape)
    moved, fresh = prepared(geometry).moved(vertices), fb.Mesh(vertices, geometry.faces)
    points = points_around(40, 1.5 * max(1, size))
    ours, theirs = (fb.query(mesh, points) for mesh in (moved, fresh))
    assert ours.distances.tobytes() == theirs.distances.tobytes()


def test_uv_colours_and_parts_follow():
    vertices, faces = meshes.box()
    random = np.random.default_rng(2)
    looks = {
        "uv": random.random((len(vertices), 2)),
        "vertex_colors": random.random((len(vertices), 4)),
        "face_colors": random.random((len(faces), 4)),
        "parts": [fb.Part("a", range(5), color=(1, 0, 0, 1)), fb.Part("b", range(5, 12))],
    }
    mesh = fb.Mesh(vertices, faces, **looks)
    flat = vertices.copy()
    flat[faces[2][0]] = flat[faces[2][1]]
    for moved in (mesh.moved(vertices * 2), mesh.moved(flat), mesh.moved(flat).moved(vertices)):
        fresh = fb.Mesh(moved.vertices, faces, **looks)
        for copy in (moved, pickle.loads(pickle.dumps(moved))):
            for name in ("uv", "vertex_colors", "face_colors"):
                assert getattr(copy, name).tobytes() == getattr(fresh, name).tobytes()
            assert [(part.name, part.faces, part.color) for part in copy.parts] == [
                (part.name, part.faces, part.color) for part in fresh.parts
            ]
    assert mesh.moved(vertices * 2).parts is mesh.parts


def test_a_moved_mesh_pickles():
    mesh = prepared(meshes.icosphere(2)).moved(meshes.icosphere(2).vertices * (1, 2, 1))
    copy = pickle.loads(pickle.dumps(mesh))
    assert_same_results(copy, mesh)
    back = copy.moved(meshes.icosphere(2).vertices)
    assert_same_results(back, fb.Mesh(*meshes.icosphere(2)))


def test_unused_vertices_that_were_dropped_stay_dropped():
    vertices, faces = meshes.box()
    mesh = fb.Mesh(np.concatenate([[[np.nan] * 3], vertices]), faces + 1)
    moved = mesh.moved(vertices + 1)
    assert moved.vertices.tobytes() == (vertices + 1).tobytes()
    assert pickle.loads(pickle.dumps(moved)).faces.tobytes() == moved.faces.tobytes()
    assert moved.topology()["dropped_vertices"] == 1


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (np.zeros((7, 3)), r"vertices: must have one row for each of the 8 vertices of the mesh, got 7"),
        (np.zeros((8, 2)), r"vertices: must have shape \(n, 3\)"),
        (np.full((8, 3), np.nan), r"vertices\[0\] = \(NaN, NaN, NaN\) is not finite"),
        (np.full((8, 3), 1j), "vertices"),
        (None, "vertices"),
        (np.zeros((8, 3)), "no surface"),
        ([], "vertices"),
    ],
)
def test_mistakes_name_the_vertices(vertices, message):
    mesh = fb.Mesh(*meshes.box())
    with pytest.raises(fb.MeshError, match=message):
        mesh.moved(vertices)


def test_an_unused_vertex_must_be_finite_too():
    vertices, faces = meshes.box()
    mesh = fb.Mesh(np.concatenate([vertices, [[0, 0, 0]]]), faces)
    positions = mesh.vertices.copy()
    positions[8, 1] = np.inf
    with pytest.raises(fb.MeshError, match=r"vertices\[8\]"):
        mesh.moved(positions)


def test_unmoved_vertices_keep_their_local_coordinates():
    """The origin of local coordinates stays while the box moves a little; distances elsewhere keep their bits."""
    vertices, faces = meshes.icosphere(3)
    vertices = vertices + 0.1
    moved = vertices.copy()
    moved[np.argmax(vertices[:, 0])] += (0.05, 0, 0)
    a, b = fb.Mesh(vertices, faces), fb.Mesh(moved, faces)
    points = points_around()
    points[:, 0] = -np.abs(points[:, 0])
    assert fb.signed_distance(a, points).tobytes() == fb.signed_distance(b, points).tobytes()
