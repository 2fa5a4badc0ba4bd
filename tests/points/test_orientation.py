"""Normals without sides: viewpoints are exact, and the iteration flips few."""

import numpy as np
import pytest

import fieldbake as fb
import meshes

PARTS = {"ball": meshes.icosphere, "cube": meshes.box, "capsule": lambda: meshes.capsule(rings=6, segments=16)}


def flipped(cloud, normals):
    return float((np.einsum("ij,ij->i", cloud.normals, normals) < 0).mean())


@pytest.mark.parametrize("name", PARTS)
def test_viewpoints_flip_no_normal_of_a_convex_body(name):
    samples = fb.sample_surface(PARTS[name](), 3_000)
    cloud = fb.PointCloud(samples.points)

    viewed = cloud.oriented(viewpoints=samples.points + 5 * samples.normals)

    assert viewed.report.normals == "viewpoints"
    assert flipped(viewed, samples.normals) == 0
    # A scanner in the middle sees the inner side of all points.
    inner = cloud.oriented(viewpoints=(0.01, 0.02, 0.03))
    assert flipped(inner, -samples.normals) == 0
    assert inner.report.inside_out


@pytest.mark.parametrize("name", ["icosphere", "torus", "knot", "cube"])
def test_few_normals_of_clean_clouds_are_flipped(name):
    samples = fb.sample_surface(meshes.CLOSED[name](), 3_000)

    oriented = fb.PointCloud(samples.points).oriented()

    assert oriented.report.normals in ("tree", "winding")
    assert flipped(oriented, samples.normals) <= 0.02
    assert np.abs(np.linalg.norm(oriented.normals, axis=1) - 1).max() <= 1e-12
    assert np.array_equal(oriented.points, samples.points)


def test_the_result_depends_on_no_thread_and_not_on_copies():
    samples = fb.sample_surface(meshes.torus(), 1_500)
    cloud = fb.PointCloud(np.concatenate([samples.points, samples.points[:200]]))
    results = []
    for threads in (1, 3):
        fb.set_threads(threads)
        results.append(cloud.oriented().normals)
    fb.set_threads(2)
    assert np.array_equal(*results)
    assert np.array_equal(results[0][:200], results[0][1_500:])


def test_given_normals_are_kept_by_the_cloud():
    samples = fb.sample_surface(meshes.icosphere(), 500)
    cloud = fb.PointCloud(samples.points, -samples.normals)
    assert flipped(cloud.oriented(), samples.normals) == 0
    assert flipped(cloud, samples.normals) == 1


@pytest.mark.parametrize(
    ("error", "message", "options"),
    [
        (fb.ArgumentError, r"viewpoints: must have shape \(3,\) or \(100, 3\)", {"viewpoints": np.zeros((5, 3))}),
        (fb.ArgumentError, "viewpoints", {"viewpoints": (1, 2)}),
        (fb.ArgumentError, "neighbours: must be from 4 to 64", {"neighbours": 3}),
    ],
)
def test_wrong_options_are_named(error, message, options):
    cloud = fb.PointCloud(np.random.default_rng(0).normal(size=(100, 3)))
    with pytest.raises(error, match=message):
        cloud.oriented(**options)


def test_few_points_cannot_be_oriented():
    with pytest.raises(fb.MeshError, match="10 distinct points are too few"):
        fb.PointCloud(np.random.default_rng(0).normal(size=(10, 3))).oriented()
