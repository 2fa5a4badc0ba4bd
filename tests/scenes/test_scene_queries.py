"""Distances to posed meshes and shapes of a scene, against float64 brute force over its instances."""

import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth


def placed(seed, scale=1.0, shift=(0, 0, 0), mirrored=False):
    """A similarity with a random rotation."""
    transform = np.eye(4)
    transform[:3, :3] = scale * meshes.rotation(seed) @ np.diag((-1.0 if mirrored else 1.0, 1, 1))
    transform[:3, 3] = shift
    return transform


PLACES = [
    placed(1, 0.5, (2, 0, 0)),
    placed(2, 3.0, (-4, 1, 0)),
    placed(3, 1.0, (0, 0, 2.5), mirrored=True),
    placed(4, 2.0, (0, 3, 0)),
    np.eye(4),
]


@pytest.fixture(scope="module")
def scene():
    gear = fb.models.gear(teeth=6)
    objects = [gear, fb.Mesh(*meshes.torus(segments=24, sides=12)), gear, fb.box((1, 2, 0.5)), fb.sphere(0.3)]
    return fb.Scene([fb.Instance(o, transform=place) for o, place in zip(objects, PLACES, strict=True)])


def distances_of_instances(points):
    """The signed distance to each instance, (instances, n): brute force on moved vertices, and closed forms."""
    gear = fb.models.gear(teeth=6)
    rows = []
    for geometry, place in ((gear, PLACES[0]), (fb.Mesh(*meshes.torus(segments=24, sides=12)), PLACES[1]),
                            (gear, PLACES[2])):  # fmt: skip
        moved = geometry.vertices @ place[:3, :3].T + place[:3, 3]
        faces = geometry.faces[:, ::-1] if np.linalg.det(place) < 0 else geometry.faces
        rows.append(truth.signed_distance(moved, faces.astype(np.int64), points))
    local = (points - PLACES[3][:3, 3]) @ PLACES[3][:3, :3] / 4.0
    rows.append(2.0 * truth.box(local, (-0.5, -1, -0.25), (0.5, 1, 0.25)))
    rows.append(truth.sphere(points, 0.3))
    return np.array(rows)


def test_the_distance_is_the_smallest_one_over_the_instances(scene, random):
    points = random.uniform(-6, 6, (3_000, 3))
    expected = distances_of_instances(points)

    found = fb.query(scene, points)

    # A dozen operations on coordinates up to 12.
    rounding = 64 * 2.0**-53 * 12
    assert np.abs(found.distances - expected.min(axis=0)).max() <= 16 * rounding
    assert (found.distances < 0).sum() > 20
    # The instance attains the minimum, and the closest point lies at that distance along the gradient.
    attained = expected[found.instances, np.arange(len(points))]
    assert np.abs(attained - found.distances).max() <= 16 * rounding
    assert set(found.instances.tolist()) == {0, 1, 2, 3, 4}
    assert np.abs(np.linalg.norm(found.gradients, axis=1) - 1).max() <= 1e-12
    away = found.points + found.distances[:, None] * found.gradients
    assert np.abs(away - points).max() <= 1e-9
    # Rows of faces belong to the mesh of the instance; they are -1 for exact shapes.
    assert ((found.faces < 0) == (found.instances >= 3)).all()
    torus = found.instances == 1
    corners = scene.instances[1].bounds is not None and fb.Mesh(*meshes.torus(segments=24, sides=12))
    local = (found.barycentric[torus][:, :, None] * corners.vertices[corners.faces[found.faces[torus]]]).sum(axis=1)
    assert np.abs(local @ PLACES[1][:3, :3].T + PLACES[1][:3, 3] - found.points[torus]).max() <= 1e-12 * 100


def test_signed_distances_are_those_of_the_query(scene, random):
    points = random.uniform(-6, 6, (4, 5, 3))

    found = fb.signed_distance(scene, points)

    assert found.dtype == np.float32
    assert np.array_equal(found, fb.query(scene, points).distances.astype(np.float32))
    assert found.shape == (4, 5)
    assert fb.query(scene, np.empty((0, 3))).instances.shape == (0,)
    double = fb.signed_distance(scene, points, dtype="float64")
    assert double.dtype == np.float64
    assert np.array_equal(double, fb.query(scene, points).distances)
    with pytest.raises(fb.ArgumentError, match='dtype: must be one of "float32", "float64", got \'bogus\''):
        fb.signed_distance(scene, points, dtype="bogus")


def test_double_distances_of_a_scene_are_those_of_its_mesh(random):
    gear = fb.models.gear(teeth=6)
    points = random.uniform(-2, 2, (500, 3))

    found = fb.signed_distance(fb.Scene([gear]), points, dtype="float64")

    # The scene adds a transform to local coordinates and back: a dozen roundings of values up to 2.
    assert np.abs(found - fb.signed_distance(gear, points, dtype="float64")).max() <= 24 * 2.0**-53 * 2


def test_the_report_and_a_copy(scene, random):
    points = random.uniform(-6, 6, (100, 3))

    found = fb.query(scene, points)
    again = fb.query(pickle.loads(pickle.dumps(scene)), points)

    assert found.report.points == 100
    assert found.report.device == "cpu"
    assert found.report.inside_points == (found.distances < 0).sum()
    assert np.array_equal(found.distances, again.distances)


def test_a_query_of_a_mesh_has_no_instances():
    assert fb.query(meshes.box(), [(0, 0, 2)]).instances is None


def test_a_shape_that_is_not_exact_counts_as_its_mesh(random):
    shape = fb.box((2, 2, 2)) - fb.sphere(1.2)
    points = random.uniform(-2, 2, (500, 3))

    found = fb.query(fb.Scene([shape]), points)

    expected = fb.query(shape.to_mesh(128), points)
    assert np.abs(found.distances - expected.distances).max() <= 1e-12
    assert np.array_equal(found.faces, expected.faces)


def test_an_open_mesh_warns():
    with pytest.warns(fb.SurfaceWarning, match="open"):
        found = fb.query(fb.Scene([meshes.open_box(), meshes.box()]), [(0, 0, 3)])
    assert found.report.warnings


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (np.diag([1.0, 2, 1, 1]), r"instances\[0\].transform: must scale all axes alike"),
        (np.array([[1.0, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "must scale all axes alike"),
    ],
    ids=["stretched", "sheared"],
)
def test_a_transform_that_is_no_similarity_is_an_error(transform, message):
    with pytest.raises(fb.SceneError, match=message):
        fb.query(fb.Scene([fb.Instance(fb.models.gear(), transform=transform)]), [(0, 0, 0)])


def test_mistakes_name_the_argument(scene):
    volume = fb.bake(fb.sphere(1), 8)
    with pytest.raises(fb.SceneError, match=r"instances\[1\]: queries of a scene take meshes and shapes, got .*Volume"):
        fb.query(fb.Scene([fb.sphere(1), volume]), [(0, 0, 0)])
    with pytest.raises(fb.SceneError, match=r"got Quadric\(.*\) \(Quadric\); a quadric is a sheet without an inside"):
        fb.query(fb.Scene([fb.Quadric.sphere((0, 0, 0), radius=1)]), [(0, 0, 0)])
    with pytest.raises(fb.ArgumentError, match='sign: the sign of a scene is "auto" or "winding", got \'parity\''):
        fb.query(scene, [(0, 0, 0)], sign="parity")
    with pytest.raises(fb.ArgumentError, match="device: queries of a scene run on the CPU"):
        fb.signed_distance(scene, [(0, 0, 0)], device="gpu")
    with pytest.raises(fb.ArgumentError, match=r"points\[1\]: must be finite"):
        fb.query(scene, [(0, 0, 0), (np.nan, 0, 0)])
    with pytest.raises(fb.ArgumentError, match=r"points\[0\] is too far"):
        fb.query(fb.Scene([fb.Instance(fb.models.gear(), transform=placed(1, 1e-3))]), [(1e36, 0, 0)])
