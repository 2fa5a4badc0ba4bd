"""Offsets, shells and joints of shapes are in world units, also where the field is no distance."""

import math

import numpy as np
import pytest

import fieldbake as fb
from fieldbake.shapes import exact_distance

ROD = fb.cylinder(1.4, 10).translate((0.25, 0, 0)).twist(per_unit_deg=180)


def test_the_clearance_of_a_thread_is_what_was_given():
    rod, grown = ROD.to_mesh(96), ROD.offset(0.2).to_mesh(96)
    change = np.abs(grown.vertices[:, :2]).max() - np.abs(rod.vertices[:, :2]).max()
    # A voxel of the bake is 10 / 128; smooth parts are exact to a few hundredths of it.
    assert change == pytest.approx(0.2, abs=0.005)


@pytest.mark.parametrize("per_unit_deg", [5, 30, 90])
def test_offsets_and_shells_of_a_twisted_bar_have_their_size(per_unit_deg):
    bar = fb.box((1, 1, 4)).twist(per_unit_deg=per_unit_deg)
    source = bar.to_mesh(128)
    away = bar.offset(0.1).to_mesh(96).vertices
    away = away[np.abs(away[:, 2]) < 1.7]
    # 0.05 voxels of the bake.
    assert np.median(fb.closest_point(source, away).distances) == pytest.approx(0.1, abs=0.05 * 4 / 128)
    wall = bar.shell(0.2).to_mesh(128)
    samples = fb.sample_surface(wall, 400)
    samples = samples.points[np.abs(samples.points[:, 2]) < 1.5], samples.normals[np.abs(samples.points[:, 2]) < 1.5]
    assert np.median(fb.thickness(wall, *samples)) == pytest.approx(0.2, rel=0.01)


def test_a_sheet_grows_by_the_distance():
    core = fb.gyroid(2, 0.3) & fb.box(4)
    source, grown = core.to_mesh(192), (core.offset(0.1) & fb.box(3.6)).to_mesh(96)
    away = grown.vertices[np.abs(grown.vertices).max(axis=1) < 1.7]
    # 0.05 voxels of the grid of the mesh, which are coarser than the voxels of the bake.
    assert np.abs(fb.closest_point(source, away).distances - 0.1).max() <= 0.05 * 3.6 * 1.1 / 96


KINDS = {
    "sphere": (fb.sphere(1), 0.0),
    "difference": (fb.box(2) - fb.sphere(1.2).translate((0.2, 0, 0)).scale(0.9), 0.0),
    "repeated": (fb.sphere(0.4).repeat((1, 1, 1), (3, 1, 1)), 0.0),
    "elongated": (fb.box(1).elongate((1, 0, 0)), 0.0),
    "elongated asymmetric": (fb.cone(1, 1).elongate((0, 0, 1)), math.inf),
    "smooth": (fb.Shape.union(fb.sphere(1), fb.box(1.5), k=0.2), math.inf),
    "xor": (fb.sphere(1) ^ fb.box(1.5), math.inf),
    "times": (fb.sphere(1).times(2), math.inf),
    "sheet": (fb.gyroid(1, 0.1) & fb.sphere(1), math.inf),
    "twist": (ROD, math.inf),
    "volume": (fb.volume_shape(fb.bake(fb.sphere(), 8)), math.inf),
}


@pytest.mark.parametrize("name", KINDS)
def test_the_error_of_a_field_is_known_or_infinite(name):
    shape, error = KINDS[name]
    assert shape.field_error == error
    assert shape.scale(2).field_error == 2 * error
    # A field that is shifted has the same structure; a baked one is a volume.
    is_baked = "volume" in repr(shape.offset(0.1))
    assert is_baked == (error == math.inf and name != "times")


def test_a_baked_distance_states_its_error():
    grown = ROD.offset(0.2, resolution=40)
    voxel = 10 / 40
    assert 0.86 * voxel < grown.field_error < 1.2 * voxel
    assert repr(grown).startswith("Shape(1 leaf, one of them a volume, field_error=")
    with pytest.raises(fb.ShapeError, match="volume"):
        grown.shader()
    with pytest.raises(fb.ShapeError, match="volume"):
        grown.to_sexpr()


def test_a_baked_offset_is_exact_at_concave_edges(device):
    """Between two balls the nearest ball changes, which linear interpolation between voxels rounds by 0.13 voxels."""
    axis = np.array([2.0, 1.0, 0.4]) / np.linalg.norm([2.0, 1.0, 0.4])
    centers, voxel = np.array([0.3 * axis, -0.3 * axis]), (1.6 + 0.6 * axis[0]) / 64
    balls = [fb.sphere(0.8).translate(center) for center in centers]
    # A chamfer so narrow that it changes nothing, but the field is no distance.
    baked = balls[0].union(balls[1], chamfer=1e-9).offset(0.2, resolution=64)
    around = np.random.default_rng(1).normal(size=(200_000, 3))
    points = centers[0] + around / np.linalg.norm(around, axis=1, keepdims=True)
    points = points[(points @ axis >= 0) & (points @ axis < 2 * voxel)]
    assert len(points) > 2000
    assert np.abs(baked.distance(points, device=device)).max() <= 0.05 * voxel
    anywhere = np.random.default_rng(2).uniform(*baked.bounds, (50_000, 3))
    exact = np.linalg.norm(anywhere[:, None] - centers, axis=2).min(axis=1) - 1
    error = np.abs(baked.distance(anywhere, device=device) - exact)
    assert error[exact >= -0.2].max() <= baked.field_error


def test_a_baked_offset_is_continuous_at_divided_cells():
    """Divided cells, whole ones and their common faces have one field."""
    shape = (fb.sphere(0.6) ^ fb.box(1)).offset(0.1, resolution=24)
    lower, upper = shape.bounds
    random, voxel = np.random.default_rng(3), np.ptp(fb.box(1.2).bounds, axis=0).max() / 24
    axis = random.integers(0, 3, 200_000)
    points = random.uniform(lower, upper, (len(axis), 3))
    # The grid is centred on the shape and has an even number of voxels, so faces of cells lie at odd halves of a voxel.
    rows = np.arange(len(axis))
    points[rows, axis] = (np.floor(points[rows, axis] / voxel) + 0.5) * voxel
    step = np.zeros_like(points)
    step[rows, axis] = 1e-6 * voxel
    below, above = (shape.distance(points + sign * step).astype(float) for sign in (-1, 1))
    assert np.abs(above - below).max() <= 2e-6 * voxel * shape.lipschitz + 4e-7


def test_only_cells_at_the_level_sets_are_divided(monkeypatch):
    """In a lattice the nearest wall changes everywhere, but only cells at a level set have finer samples."""
    divide, found = exact_distance._Distance.divide, []

    def spy(self, distances, levels):
        numbers, samples = divide(self, distances, levels)
        x, y, z = np.unravel_index(numbers.astype(int), np.array(distances.shape) - 1, order="F")
        found.append((np.abs(np.abs(distances[x, y, z]) - levels[1]), samples, max(self._grid.spacing)))
        return numbers, samples

    monkeypatch.setattr(exact_distance._Distance, "divide", spy)
    (fb.gyroid(0.5, 0.1) & fb.box(1)).shell(0.02, resolution=64)
    away, samples, voxel = found[0]
    assert samples.size == 125 * len(away) > 0
    # The level is within a diagonal and a quarter of a voxel of the first corner of each cell.
    assert away.max() <= (np.sqrt(3) + 0.25) * voxel


def test_a_resolution_bakes_any_shape():
    """A shifted intersection keeps its edges, and its baked distance rounds them."""
    body, corner = fb.slab(2, "x") & fb.slab(2, "y") & fb.slab(2, "z"), np.full((1, 3), 1.1)
    assert body.offset(0.2).distance(corner)[0] == pytest.approx(-0.1)
    rounded = body.offset(0.2, resolution=64)
    # The distance of the corner is 0.1 sqrt(3); the error of the bake is below its bound.
    assert rounded.distance(corner)[0] == pytest.approx(0.1 * math.sqrt(3) - 0.2, abs=rounded.field_error)


def test_a_fillet_of_a_scaled_field_has_its_width():
    """Two bars in the form of a cross; one is twisted by nothing, but its field is divided by a stretch."""
    bar = fb.box((3, 1, 1))
    plain = (bar | bar.rotate("z", 90)).smooth(0.4)
    scaled = (bar | bar.rotate("z", 90).times(0.2)).smooth(0.4)
    points = np.random.default_rng(1).uniform(-1, 1, (2000, 3))
    near = np.abs(plain.distance(points)) < 0.1
    # 0.05 voxels beside flat faces, and more beside edges.
    error = np.abs(scaled.distance(points) - plain.distance(points))[near]
    assert np.median(error) <= 0.05 * 3 / 128
    assert error.max() <= 0.87 * 3 / 128


def test_joints_and_offsets_without_bounds_are_refused():
    with pytest.raises(
        fb.ShapeError, match=r"^offset: the field is no distance, and a bake .* bounds because of a gyroid"
    ):
        fb.gyroid(1, 0.1).offset(0.1)
    with pytest.raises(fb.ShapeError, match=r"^union: a smooth or chamfered joint bakes"):
        fb.sphere(1).union(fb.gyroid(1, 0.1), k=0.1)
    # The intersection is bounded, so it needs the field of the sheet in a box only.
    assert fb.sphere(1).intersection(fb.gyroid(1, 0.1), k=0.05, resolution=64).bounds.max() <= 1.2
    with pytest.raises(fb.ShapeError, match="resolution"):
        ROD.offset(0.1, resolution=0)


def test_the_language_warns_of_sizes_in_units_of_a_field():
    with pytest.warns(fb.SurfaceWarning, match="flate, shell or blend is applied to a field that is no distance"):
        fb.csg.parse("(flate 0.1 (twist 30 (box 1 1 1)))")
    assert fb.csg.parse("(flate 0.1 (diff (box 1 1 1) (sphere 1)))").field_error == 0
