"""Points on sharp edges: closed forms of a cube, a fold, a strip and a sphere, and the checks of arguments."""

import numpy as np
import pytest
from scipy.stats import chisquare

import fieldbake as fb
import meshes
from fieldbake.queries.edges import sharp_edges

#: Least probability of a chi-square test of uniform points. The seeds are fixed, so a test never fails by chance.
LEAST_P = 1e-3


def distances_to_segments(points, ends):
    """Distances of points (n, 3) to the nearest of some segments (e, 2, 3), and its row, by brute force."""
    a, b = ends[:, 0], ends[:, 1]
    along = np.einsum("nej,ej->ne", points[:, None] - a, b - a) / np.einsum("ej,ej->e", b - a, b - a)
    feet = a + np.clip(along, 0, 1)[..., None] * (b - a)
    found = np.linalg.norm(points[:, None] - feet, axis=2)
    return found.min(axis=1), found.argmin(axis=1)


def cube_edges(size):
    corners = np.array(np.meshgrid(*[(-1, 1)] * 3, indexing="ij")).reshape(3, 8).T
    pairs = [(i, j) for i in range(8) for j in range(i) if np.abs(corners[i] - corners[j]).sum() == 2]
    return corners[np.array(pairs)] * size


def test_a_box_has_twelve_edges_with_points_uniform_by_length():
    vertices, faces = meshes.box((-1, -2, -3), (1, 2, 3))
    ends = cube_edges(np.array([1.0, 2.0, 3.0]))
    assert len(sharp_edges(fb.Mesh(vertices, faces), 30)[2].faces) == len(ends) == 12

    found = fb.sample_edges((vertices, faces), 60_000, seed=1)
    distances, rows = distances_to_segments(found.points, ends)
    # The bound of the acceptance, 1e-12 of the diagonal; rounding gives about 1e-16.
    assert distances.max() <= 1e-12 * np.linalg.norm([2, 4, 6])
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    counts = np.bincount(rows, minlength=12)
    assert chisquare(counts, 60_000 * lengths / lengths.sum()).pvalue > LEAST_P
    along = np.linalg.norm(found.points - ends[rows, 0], axis=1) / lengths[rows]
    assert chisquare(np.histogram(along, 20, (0, 1))[0]).pvalue > LEAST_P

    # The normal of an edge of a box is the mean of two axes, and points away from the centre.
    assert np.abs(np.sort(np.abs(found.normals), axis=1) - [0, np.sqrt(0.5), np.sqrt(0.5)]).max() <= 1e-12
    assert (np.einsum("ij,ij->i", found.normals, found.points) > 0).all()
    corners = vertices[faces[found.faces]]
    assert np.abs(np.einsum("ni,nij->nj", found.barycentric, corners) - found.points).max() <= 1e-12
    assert (found.barycentric >= 0).all()
    assert (found.barycentric.min(axis=1) == 0).all()


@pytest.mark.parametrize("change", [meshes.split_vertices, lambda box: meshes.flip_some(box, 0.5)])
def test_split_vertices_and_flipped_faces_change_no_edge(change):
    *_, edges = sharp_edges(fb.Mesh(*change(meshes.box())), 30)
    assert len(edges.faces) == 12
    assert np.degrees(edges.angles) == pytest.approx(np.full(12, 90))


@pytest.mark.parametrize(("limit", "is_sharp"), [(39, True), (41, False)])
def test_the_limit_is_the_angle_between_the_normals(limit, is_sharp):
    angle = np.radians(40)
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, -np.cos(angle), np.sin(angle))]
    *_, edges = sharp_edges(fb.Mesh(vertices, [(0, 1, 2), (1, 0, 3)]), limit)
    # The four other edges are boundaries, which are always sharp.
    assert np.isinf(edges.angles).sum() == 4
    assert (np.isfinite(edges.angles).sum() == 1) == is_sharp


def test_edges_of_three_faces_are_sharp_and_flat_ones_are_not():
    fan = [(0, 0, 0), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0)]
    *_, edges = sharp_edges(fb.Mesh(fan, [(0, 1, 2), (1, 0, 3), (0, 1, 4)]), 30)
    assert len(edges.faces) == 7
    *_, edges = sharp_edges(fb.Mesh(*meshes.flat_sheet(4)), 30)
    assert len(edges.faces) == 16


def test_a_fold_has_the_normal_of_a_face():
    vertices, faces = meshes.doubled_opposite(meshes.triangle())
    found = fb.sample_edges((vertices, faces), 50)
    assert np.linalg.norm(found.normals, axis=1) == pytest.approx(np.ones(50))


def test_the_same_seed_gives_the_same_points_and_a_longer_sample_starts_alike():
    box = fb.Mesh(*meshes.box())
    first, longer, other = (fb.sample_edges(box, n, seed=s).points for n, s in ((100, 7), (1000, 7), (100, 8)))
    assert first.tobytes() == longer[:100].tobytes()
    assert not np.array_equal(first, other)
    assert fb.sample_edges(box, 0).points.shape == (0, 3)


def test_progress_reaches_1():
    seen = []
    fb.sample_edges(meshes.box(), 5, progress=seen.append)
    assert seen[-1] == 1.0


def test_a_smooth_sphere_has_no_sharp_edge():
    with pytest.raises(fb.MeshError, match="mesh: no edge has a dihedral angle above 30 degrees; lower angle_deg"):
        fb.sample_edges(meshes.icosphere(3), 10)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"n": -1}, "n: must be from 0"),
        ({"n": 1, "seed": -1}, "seed: must be from 0"),
        ({"n": 1, "angle_deg": -1}, "angle_deg: must be a finite number of at least 0"),
        ({"n": 1, "angle_deg": float("nan")}, "angle_deg: must be a finite number"),
        ({"n": 1, "angle_deg": 180}, "angle_deg: must be from 0 to less than 180 degrees"),
    ],
)
def test_wrong_arguments_are_named(options, text):
    with pytest.raises(fb.ArgumentError, match=text):
        fb.sample_edges(meshes.box(), **options)
