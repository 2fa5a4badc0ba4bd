"""Nested levels: their grids, the bound within and between levels, pictures and updates."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import exceeds
from merged import CAMERA, exactness, grove, placed, random_scene, signed_distance, turn
from scenes import positions


@pytest.fixture(scope="module")
def scene():
    """Nine instances, their triangles, and four levels round a point."""
    instances, triangles = random_scene(np.random.default_rng(3), 9)
    return instances, triangles, fb.merge(instances, 24, levels=4, center=(1.0, 0.5, -1.0))


def on_edges(level, count, random):
    """Points on the faces of the box of a level's samples, and the direction across."""
    lower, upper = level.bounds[0] + level.spacing / 2, level.bounds[1] - level.spacing / 2
    points = random.uniform(lower, upper, (count, 3))
    axis = random.integers(0, 3, count)
    rows = np.arange(count)
    points[rows, axis] = np.where(random.random(count) < 0.5, lower[axis], upper[axis])
    return points, np.eye(3)[axis]


def test_each_level_is_half_as_wide_and_on_the_lattice_of_the_next(scene):
    instances, _, field = scene
    assert len(field.levels) == 4
    whole = fb.merge(instances, 24)
    assert np.array_equal(field.levels[-1].distances, whole.distances)
    assert np.array_equal(field.bounds, whole.bounds)
    assert np.allclose(field.center, (1.0, 0.5, -1.0), atol=field.levels[1].spacing / 2)
    for fine, coarse in zip(field.levels, field.levels[1:], strict=False):
        assert fine.resolution == coarse.resolution
        assert np.allclose(2 * np.diff(fine.bounds, axis=0), np.diff(coarse.bounds, axis=0))
        steps = (fine.origin - coarse.origin) / coarse.spacing
        assert np.allclose(steps, np.rint(steps), atol=1e-9)
        assert (fine.bounds[0] > coarse.bounds[0] + coarse.spacing).all()
        assert (fine.bounds[1] < coarse.bounds[1] - coarse.spacing).all()


def test_levels_near_the_edge_move_inwards():
    field = fb.merge([fb.Quadric.sphere()], 16, levels=3, center=(9, 0, -9))
    for fine, coarse in zip(field.levels, field.levels[1:], strict=False):
        assert (fine.bounds[0] > coarse.bounds[0]).all()
        assert (fine.bounds[1] < coarse.bounds[1]).all()
    assert field.center[0] > 0 > field.center[2]


def test_it_exceeds_the_distance_by_half_a_voxels_diagonal_at_most(scene, random):
    instances, triangles, field = scene
    coarsest = field.levels[-1]
    half_diagonals = [np.linalg.norm(level.spacing) / 2 for level in field.levels]
    points = [random.uniform(coarsest.bounds[0] - 1, coarsest.bounds[1] + 1, (20_000, 3))]
    bounds = [np.full(20_000, half_diagonals[-1])]
    for k, level in enumerate(field.levels[:-1]):
        # Inside, up to the outermost cells: the level's own; in those, the bound of the level around.
        inset = 1.5 * level.spacing
        points.append(random.uniform(level.bounds[0] + inset, level.bounds[1] - inset, (20_000, 3)))
        bounds.append(np.full(20_000, half_diagonals[k]))
        edge, across = on_edges(level, 10_000, random)
        points.append(edge + random.uniform(-1, 1, (10_000, 1)) * level.spacing * across)
        bounds.append(np.full(10_000, half_diagonals[k + 1]))
    points, bounds = np.concatenate(points), np.concatenate(bounds)
    assert len(points) > 100_000
    excess = field.sample(points) - signed_distance(triangles, points)
    assert (excess <= bounds + exactness(instances)).all()


def test_there_is_no_jump_between_levels(scene, random):
    _, _, field = scene
    for level in field.levels[:-1]:
        edge, across = on_edges(level, 2_000, random)
        # A distance changes by no more than the way; the rest is rounding of float32 values below 8.
        jump = np.abs(field.sample(edge + 1e-7 * across) - field.sample(edge - 1e-7 * across))
        assert jump.max() <= 4e-7 + 4 * 2**-21


def test_an_update_is_a_full_merge_of_each_level(scene):
    instances, _, field = scene
    random = np.random.default_rng(8)
    moved = placed(turn(random), (0.5, 0.2, -0.7))
    after = field.update([(4, moved)])
    others = [*instances[:4], (instances[4][0], moved), *instances[5:]]
    for level, new in zip(field.levels, after.levels, strict=True):
        whole = fb.merge(others, level.resolution, bounds=level.bounds)
        assert np.array_equal(new.distances, whole.distances)


def test_it_is_saved_and_loaded(scene, tmp_path, random):
    _, _, field = scene
    field.save(tmp_path / "field.npz")
    back = fb.load(tmp_path / "field.npz")
    assert isinstance(back, fb.NestedField)
    points = random.uniform(-6, 6, (500, 2, 3))
    assert np.array_equal(back.sample(points), field.sample(points))
    assert np.array_equal(back.gradient(points), field.gradient(points))
    assert back.sample(points).shape == (500, 2)
    with pytest.raises(fb.SceneError, match="loaded"):
        back.update([(0, np.eye(4))])
    with pytest.raises(fb.FormatError, match=r"\.npz"):
        field.save(tmp_path / "field.dds")


def test_a_damaged_file_is_refused(scene, tmp_path):
    _, _, field = scene
    field.save(tmp_path / "field.npz")
    members = dict(np.load(tmp_path / "field.npz"))
    for name, value in (("boxes", members["boxes"][::-1].copy()), ("boxes", members["boxes"][:2])):
        np.savez(tmp_path / "wrong.npz", **{**members, name: value})
        with pytest.raises(fb.FormatError):
            fb.load(tmp_path / "wrong.npz")


def test_rays_meet_the_field_that_sample_gives():
    """A ball over the edges of all levels: hits lie on the zero of `sample`, and there is no hole."""
    ball = fb.bake(fb.Mesh(*meshes.icosphere(4)), 64)
    field = fb.merge([ball], 24, bounds=[(-2, -2, -2), (2, 2, 2)], levels=4, center=(0, 0, 1))
    camera = fb.Camera((0.6, 0.8, 5), (0, 0, 0), fov_deg=40)
    frame = fb.raymarch(field, camera, size=(96, 96), device="cpu")
    hit = frame.object_id == 0
    p = positions(frame, camera)[hit]
    # A part of a voxel of 2^-3 * 4 / 24 at the finest, eight times that at the coarsest: f32 along the ray.
    assert np.abs(field.sample(p)).max() < 1e-4
    radius = np.linalg.norm(p, axis=1)
    assert np.abs(radius - 1).max() < np.linalg.norm(field.levels[-1].spacing)
    near = np.linalg.norm(p - (0, 0, 1), axis=1) < 0.2
    assert near.sum() > 50
    assert np.abs(radius - 1)[near].max() < np.linalg.norm(field.spacing)
    # Every ray that passes the centre nearer than the ball, less a coarse voxel, meets it.
    width, height = frame.size
    side = 2 * np.tan(np.radians(20)) / height
    x, y = (np.arange(96) + 0.5 - width / 2) * side, (height / 2 - np.arange(96) - 0.5) * side
    rays = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), axis=-1) @ camera.pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    miss = np.linalg.norm(np.cross(camera.eye, rays), axis=-1)
    inside = miss < 1 - np.linalg.norm(field.levels[-1].spacing) / 2
    assert inside.sum() > 1000
    assert hit[inside].all()


@pytest.mark.parametrize(
    ("levels", "eye", "fov_deg"),
    [
        (1, (0.6, 0.8, 5), 40),
        (4, (0.6, 0.8, 5), 40),
        # Far away, between the levels, and in the solid.
        (4, (60, 20, 500), 0.5),
        (4, (0.3, -0.2, 1.7), 90),
        (4, (0.1, 0.2, 0.9), 60),
        (12, (0.6, 0.8, 5), 40),
    ],
)
def test_a_device_draws_the_same_picture(levels, eye, fov_deg, gpu):
    ball = fb.bake(fb.Mesh(*meshes.icosphere(4)), 64)
    field = fb.merge([ball], 24, bounds=[(-2, -2, -2), (2, 2, 2)], levels=levels, center=(0, 0, 1))
    camera = fb.Camera(eye, (0, 0, 0), fov_deg=fov_deg)
    lights = [fb.DirectionalLight((-1, -0.4, -0.3)), fb.DirectionalLight((0.5, -1, 0), color=(1, 0.6, 0.2))]
    options = {"size": (96, 64), "lights": lights, "ambient": 0.3, "background": (0, 0, 0, 0)}
    cpu, device = (fb.raymarch(field, camera, device=place, **options) for place in ("cpu", gpu))
    assert device.report["device"] != "cpu"
    hit = cpu.object_id == 0
    assert hit.sum() > 500
    # As for one volume; float32 tells no depths apart that differ by an ulp.
    assert np.array_equal(hit, device.object_id == 0)
    diagonal = np.linalg.norm(field.bounds[1] - field.bounds[0])
    allowed = 1e-4 * diagonal + np.finfo(np.float32).eps * np.linalg.norm(eye)
    assert np.abs(cpu.depth[hit] - device.depth[hit]).max() <= allowed
    assert np.mean(cpu.shadow != device.shadow) <= 1e-3
    assert np.mean(exceeds(np.abs(cpu.color - device.color), 1e-3)) <= 1e-3


def test_a_ray_crosses_more_voxels_than_an_invocation_has_steps(device):
    samples = np.where(np.arange(60_000) % 4 == 2, 0.01, 1.0).reshape(-1, 1, 1)
    samples[-20:] = -1
    long = fb.NestedField([fb.Volume(samples, [(0, 0, 0), (60_000, 1, 1)])])
    frame = fb.raymarch(long, fb.Camera((-1, 0.5, 0.5), (1, 0.5, 0.5), fov_deg=1e-3), size=(4, 4), device=device)
    # The sample before the last 20 is 1, so the root is halfway between the centres of two voxels.
    assert frame.depth == pytest.approx(60_001 - 20, abs=0.01)


@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_as_a_far_field_it_throws_shadows_and_devices_agree(shadows, gpu):
    scene, balls, _ = grove(20, angle_deg=3)
    far = fb.merge(balls, 32, levels=3, center=(0, 1, 0))
    options = {"size": (64, 48), "shadows": shadows, "far": far, "ambient_occlusion": 2.0}
    cpu, device = (fb.render(scene, CAMERA, device=place, **options) for place in ("cpu", gpu))
    assert cpu.report["far_rays"] > 100
    assert device.report["far_rays"] == pytest.approx(cpu.report["far_rays"], rel=0.01)
    assert np.isclose(cpu.shadow, device.shadow, atol=1e-3).mean() > 0.998
    assert np.isclose(cpu.color, device.color, atol=2e-3).mean() > 0.998
    without = fb.render(scene, CAMERA, size=(64, 48), shadows=shadows, device="cpu")
    assert exceeds(np.abs(without.shadow - cpu.shadow), 0.5).mean() < 0.02


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"levels": 0}, "levels: must be from 1 to 12"),
        ({"levels": 2.0}, "levels: must be a whole number"),
        ({"center": (0, 0, 0)}, "center: .* give levels too"),
        ({"levels": 2, "center": (0, 0)}, "center: must have shape"),
        ({"levels": 2, "resolution": (16, 4, 16)}, "resolution: levels need 8 voxels"),
    ],
)
def test_mistakes_are_told(options, message):
    with pytest.raises(fb.ArgumentError, match=message):
        fb.merge([fb.Quadric.sphere()], **{"resolution": 8, **options})


def test_flat_scenes_get_a_few_voxels_of_height():
    field = fb.merge([(fb.Quadric.sphere(), placed(np.eye(3), (20.0 * i, 0, 0))) for i in range(4)], 64, levels=3)
    assert min(field.resolution) == 8
    assert field.sample([(0, 0, 0)])[0] >= 0
    assert "3 levels" in repr(field)
    with pytest.raises(AttributeError, match="cannot be changed"):
        field.center = (0, 0, 0)
