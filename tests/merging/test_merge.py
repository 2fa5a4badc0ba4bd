"""Merged fields against the float64 distance to the union of all transformed triangles."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldbake as fb
import meshes
from merged import centers, exactness, placed, random_scene, signed_distance, turn


@pytest.mark.parametrize("seed", range(4))
def test_no_sample_is_above_the_distance_to_the_union(seed):
    random = np.random.default_rng(seed)
    instances, triangles = random_scene(random, 7, spread=2.0 + seed)
    field = fb.merge(instances, 30)

    points = centers(field)
    distance = signed_distance(triangles, points)
    value = field.distances.reshape(-1).astype(np.float64)
    assert len(points) > 10_000
    assert (value - distance).max() <= exactness(instances)


@pytest.mark.parametrize("seed", [27, 28, 29])
def test_no_sample_is_above_the_distance_within_sharp_edges(seed, device):
    # Between eight samples outside a tooth there may be points inside it.
    gear = fb.models.gear(teeth=6)
    transform = np.eye(4)
    transform[:3, :3] = meshes.rotation(seed)

    field = fb.merge([(gear, transform)], 64, device=device)

    distance = fb.signed_distance([(gear, transform)], centers(field), dtype="float64")
    assert (field.distances.reshape(-1) - distance).max() <= 1e-5


def test_a_hundred_thousand_points_between_the_samples(random):
    instances, triangles = random_scene(random, 9)
    field = fb.merge(instances, 64)
    points = random.uniform(field.bounds[0] - 1, field.bounds[1] + 1, (100_000, 3))
    distance = signed_distance(triangles, points)
    excess = field.sample(points) - distance
    # A corner of a cell at c has at most d(c) <= d(p) + |p - c|, and the mean of |p - c| over the cell's weights is
    # at most its root mean square, half a cell's diagonal.
    between = np.linalg.norm(field.spacing) / 2
    assert excess.max() <= between + exactness(instances)
    # Typically it is below, as between samples of any field.
    assert np.median(excess) < 0


def test_rigid_and_disjoint_objects_are_off_by_less_than_a_voxel(random):
    instances = []
    triangles = []
    ball = meshes.icosphere(3)
    volume = fb.bake(ball, 32)
    for i in range(3):
        transform = placed(turn(random), (5.0 * i, 0, 0))  # no box is nearer to another ball
        instances.append((volume, transform))
        triangles.append((ball.vertices @ transform[:3, :3].T + transform[:3, 3], ball.faces))
    field = fb.merge(instances, 64)
    points = centers(field)
    distance = signed_distance(triangles, points)
    local = np.stack([(points - t[:3, 3]) @ t[:3, :3] for _, t in instances])
    in_hull = (np.abs(local) <= volume.bounds[1] - volume.spacing / 2).all(axis=-1).any(axis=0)
    value = field.distances.reshape(-1)
    assert in_hull.sum() > 2_000
    assert np.abs(value - distance)[in_hull].max() <= volume.spacing.max()
    # Outside, sqrt(a^2 + s^2) keeps most of it.
    assert (value[~in_hull] / distance[~in_hull]).mean() > 0.8


def test_on_voxel_centres_a_single_volume_is_itself():
    volume = fb.bake(meshes.torus(segments=32, sides=16), 24)
    field = fb.merge([volume], volume.resolution, bounds=volume.bounds)
    # A centre is met to a few roundings of a position, and the sample is rounded down.
    assert np.abs(field.distances - volume.distances).max() <= 2e-7 * np.abs(volume.distances).max()
    shifted = fb.merge(
        [(volume, placed(np.eye(3), (8, 4, -2)))], volume.resolution, bounds=volume.bounds + np.array([8, 4, -2])
    )
    assert np.allclose(shifted.distances, volume.distances, atol=1e-6)


def brute(instances, field):
    """Every instance merged alone on the same grid, then the least."""
    alone = [fb.merge([item], field.resolution, bounds=field.bounds).distances for item in instances]
    return np.min(alone, axis=0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_culling_changes_no_bit(seed):
    random = np.random.default_rng(seed)
    instances, _ = random_scene(random, 12, rigid=bool(seed % 2))
    instances += [
        fb.Quadric.ellipsoid(random.uniform(-3, 3, 3), (1, 0.5, 0.4)),
        (fb.Quadric.paraboloid(), placed(turn(random), random.uniform(-3, 3, 3))),
    ]
    field = fb.merge(instances, (19, 23, 18))
    assert np.array_equal(field.distances, brute(instances, field))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_an_update_equals_a_full_merge(seed):
    random = np.random.default_rng(seed)
    instances, _ = random_scene(random, 15)
    instances.append((fb.Quadric.sphere(radius=0.7), placed(np.eye(3), (1, 2, 3))))
    bounds = [(-6, -6, -6), (6, 6, 6)]
    field = fb.merge(instances, 26, bounds=bounds)
    for _ in range(3):
        moved = sorted(random.choice(16, size=2, replace=False).tolist())
        changed = [(i, placed(turn(random) * random.uniform(0.3, 1.5), random.uniform(-5, 5, 3))) for i in moved]
        for i, transform in changed:
            instances[i] = (instances[i][0], transform)
        field = field.update(changed)
        whole = fb.merge(instances, 26, bounds=bounds)
        assert np.array_equal(field.distances, whole.distances)
        assert np.array_equal(field.inner_bounds, whole.inner_bounds)


def test_a_scene_is_anything_with_instances(random):
    instances, _ = random_scene(random, 4)
    as_scene = SimpleNamespace(
        instances=[SimpleNamespace(geometry=geometry, transform=transform) for geometry, transform in instances]
    )
    field = fb.merge(as_scene, 24)
    assert np.array_equal(field.distances, fb.merge(instances, 24).distances)
    as_scene.instances[2].transform = placed(np.eye(3), (1, 1, 1))
    moved = field.update([2], scene=as_scene)
    again = [(i.geometry, i.transform) for i in as_scene.instances]
    assert np.array_equal(moved.distances, fb.merge(again, 24, bounds=field.bounds).distances)


def test_meshes_are_baked_once_for_all_their_instances():
    ball = fb.Mesh(*meshes.icosphere(1))
    field = fb.merge([ball, (ball, placed(np.eye(3), (3, 0, 0)))], 24)
    values = field.sample([(0, 0, 0), (3, 0, 0), (1.5, 0, 0)])
    assert values[0] < 0
    assert values[1] < 0
    assert values[2] > 0


def test_a_shape_is_placed_by_the_transform_of_its_pair():
    aside = np.eye(4)
    aside[0, 3] = 4
    field = fb.merge([fb.sphere(1), (fb.sphere(1), aside)], 48)

    assert np.all(field.sample([(0, 0, 0), (4, 0, 0)]) < 0)
    points = np.array([(1.2, 0, 0), (2, 0, 0), (4, 1.2, 0)])
    expected = np.minimum(np.linalg.norm(points, axis=1), np.linalg.norm(points - (4, 0, 0), axis=1)) - 1
    # Outside, the field is a lower bound, and the merge loses less than a voxel.
    lost = expected - field.sample(points)
    assert np.all((lost >= -1e-6) & (lost <= field.spacing.max()))


def test_where_the_box_cuts_the_surface_the_cut_is_a_surface():
    ball = meshes.icosphere(3)
    cut = fb.bake(ball, 24, bounds=[(-1.2, -1.2, -1.2), (0.1, 1.2, 1.2)])
    field = fb.merge([cut], 32, bounds=[(-2, -2, -2), (2, 2, 2)])
    points = centers(field)
    value = field.distances.reshape(-1)
    beyond = points[:, 0] > 0.1
    # To what is left: at most the distance to the cut disc.
    to_disc = np.hypot(points[:, 0] - 0.1, np.maximum(np.hypot(points[:, 1], points[:, 2]) - 0.98, 0))
    assert (value[beyond] <= to_disc[beyond] + 1e-6).all()
    inside = (np.linalg.norm(points, axis=1) < 0.8) & (points[:, 0] < -0.1)
    assert (value[inside] < 0).all()


def test_quadrics_are_sheets(random):
    bowl = fb.Quadric.paraboloid(radius=1, height=1)
    field = fb.merge([bowl], 40)
    points = centers(field)
    # Its distance by dense points.
    u, v = np.meshgrid(np.sqrt(np.linspace(0, 1, 200)), np.linspace(0, 2 * np.pi, 400))
    surface = np.stack([u * np.cos(v), u * np.sin(v), u**2], axis=-1).reshape(-1, 3)
    picked = random.choice(len(points), 400, replace=False)
    distance = np.array([np.linalg.norm(surface - p, axis=1).min() for p in points[picked]])
    value = field.distances.reshape(-1)[picked]
    assert (value >= 0).all()
    assert (value <= distance + 1e-5).all()
    # Points of the surface are up to half a step apart: 0.01.
    assert (value >= 0.3 * distance - 0.01).all()


def test_a_scene_of_the_package_merges():
    ball = fb.Mesh(*meshes.icosphere(2))
    scene = fb.Scene([fb.Instance(ball), fb.Instance(ball, transform=placed(np.eye(3), (4, 0, 0)), resolution=24)])
    field = fb.merge(scene, 32)
    assert (field.sample([(0, 0, 0), (4, 0, 0)]) < 0).all()
    assert 0.5 < field.sample([(2, 0, 0)])[0] <= 1


def test_a_merged_field_is_a_volume_that_can_be_saved(tmp_path):
    field = fb.merge([meshes.icosphere(1)], 16)
    field.save(tmp_path / "scene.npz")
    back = fb.load(tmp_path / "scene.npz")
    assert np.array_equal(back.distances, field.distances)
    assert field.report.device == "cpu"
    assert "merge" in field.report.seconds
    assert fb.raymarch(field, size=(16, 16)).object_id.max() == 0


def test_a_merged_field_has_what_a_volume_has():
    field = fb.merge([meshes.icosphere(1)], 16)
    names = {name for name in dir(fb.Volume) if not name.startswith("_")}
    assert {name for name in names if not hasattr(field, name)} == {"quantize", "from_xarray", "load"}
    assert names - {"quantize", "from_xarray", "load"} <= set(dir(field))
    assert isinstance(field.volume, fb.Volume)
    assert np.shares_memory(np.asarray(field), field.distances)
    assert np.array_equal(np.from_dlpack(field), field.distances)
    with pytest.raises(AttributeError, match="'MergedField' has no attribute 'distance'"):
        _ = field.distance
    back = pickle.loads(pickle.dumps(field))
    assert type(back) is fb.Volume
    assert np.array_equal(back.distances, field.distances)


def test_functions_of_volumes_accept_a_merged_field():
    field, point = fb.merge([meshes.icosphere(1)], 16), [(0.3, 0.2, 0.1)]
    volume = field.volume
    assert fb.Instance(field).geometry is volume
    assert fb.pack([field, (field, np.eye(4))], page_size=128).unpack(0).resolution == volume.resolution
    with pytest.raises(fb.ArgumentError, match="got a MergedField; put it in a list"):
        fb.pack(field)
    assert np.array_equal(fb.merge(field, 16).distances, fb.merge(volume, 16).distances)
    assert np.array_equal(fb.merge([(field, np.eye(4))], 16).distances, fb.merge([volume], 16).distances)
    assert fb.volume_shape(field).distance(point) == fb.volume_shape(volume).distance(point)
    assert (fb.sphere(0.1) | field).distance(point) == (fb.sphere(0.1) | volume).distance(point)
    assert fb.gyroid(1, field).distance(point) == fb.gyroid(1, volume).distance(point)
    assert fb.render([volume], far=field, size=(8, 8), device="cpu").object_id.max() == 0
    assert field.to_html() == volume.to_html()
    assert field._repr_png_() == volume._repr_png_()


def test_a_merged_field_stays_a_bound_outside_its_box(random):
    instances, triangles = random_scene(random, 5)
    field = fb.merge(instances, 24)
    points = random.uniform(-20, 20, (2000, 3))
    points = points[((points < field.bounds[0]) | (points > field.bounds[1])).any(axis=1)]
    distance = signed_distance(triangles, points)
    assert (field.sample(points) <= distance + exactness(instances)).all()


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda _: fb.merge([]), fb.SceneError, "scene: is empty"),
        (lambda _: fb.merge(7), fb.SceneError, "scene: must be a Scene or a list"),
        (lambda v: fb.merge([v, 7]), fb.MeshError, r"instances\[1\]"),
        (lambda v: fb.merge([(v, np.diag([1.0, 0, 1, 1]))]), fb.SceneError, r"instances\[0\]: transform: .*singular"),
        (lambda v: fb.merge([v], 0), fb.ArgumentError, "resolution"),
        (lambda v: fb.merge([v], device="abacus"), fb.DeviceError, "abacus"),
        (lambda v: fb.merge([v], 8).update([(1, np.eye(4))]), fb.SceneError, r"changed\[0\]: must be from 0 to 0"),
        (lambda v: fb.merge([v], 8).update([0]), fb.SceneError, r"changed\[0\]: must be \(index"),
        (lambda v: fb.merge([v], 8).update("0"), fb.SceneError, "changed"),
        (lambda v: fb.merge([v], 8).update([0], scene=[v, v]), fb.SceneError, "has 2 instances"),
        (lambda v: fb.merge([v], 8).update([0], scene=[fb.Quadric.sphere()]), fb.SceneError, "number of quadrics"),
    ],
)
def test_mistakes_are_told(call, error, message):
    volume = fb.bake(meshes.tetrahedron(), 8)
    with pytest.raises(error, match=message):
        call(volume)


def test_the_stated_limits_of_cut_and_sparse_volumes_hold(random):
    # A cube of side 4 in a box that ends at x = -1: the field outside the box is about the part in it.
    cut = fb.bake(fb.box(4), 24, bounds=[(-1, -1, -1), (3, 3, 3)])
    points = np.array([(-1.5, 0, 0), (-1.9, 0.5, 0.5)])
    assert (cut.sample(points) > 0).all()
    assert (fb.box(4).distance(points) < 0).all()
    # The depth in the bricks of a ball is exceeded by the diagonal of a brick at most.
    sparse = fb.bake_sparse(fb.sphere(1), 48)
    points = random.uniform(-0.57, 0.57, (2000, 3))
    depth = 1 - np.linalg.norm(points, axis=1)
    voxel = float(sparse.spacing.max())
    for field, slack in ((sparse, 0.0), (fb.merge([sparse], 48), 3**0.5 * voxel)):
        found = -field.sample(points)
        assert (found >= depth - 7 * 3**0.5 * voxel - slack - 1e-6).all()
        # Between samples, trilinear interpolation of a cell may be too deep by half its diagonal.
        assert (found <= depth + 3**0.5 * voxel).all()
