"""The stored field: sampling, gradients, the bound outside, other resolutions, its surface, and its file."""

import copy
import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

BOX = np.array([(-1.0, -2.0, -3.0), (1.5, 2.0, 1.0)])
SHAPE = (9, 7, 5)


# --- made by hand


def test_a_volume_from_an_array():
    values = np.arange(24).reshape(2, 3, 4)

    volume = fb.Volume(values, [(0, 0, 0), (2, 3, 4)])

    assert np.array_equal(volume.distances, values)
    assert volume.resolution == (2, 3, 4)
    assert np.array_equal(volume.spacing, (1, 1, 1))
    assert np.array_equal(volume.origin, (0.5, 0.5, 0.5))
    assert volume.distances.strides[0] == 4
    assert np.array_equal(volume.inner_bounds, volume.bounds)


@pytest.mark.parametrize(
    ("distances", "bounds", "message"),
    [
        (np.zeros((2, 2)), [(0, 0, 0), (1, 1, 1)], "distances"),
        (np.zeros((0, 2, 2)), [(0, 0, 0), (1, 1, 1)], "distances"),
        (np.full((2, 2, 2), np.nan), [(0, 0, 0), (1, 1, 1)], r"distances\[0, 0, 0\]: must be finite, got nan"),
        (np.full((2, 2, 2), -np.inf), [(0, 0, 0), (1, 1, 1)], r"distances\[0, 0, 0\]: must be finite, got -inf"),
        (np.full((2, 2, 2), 1e300), [(0, 0, 0), (1, 1, 1)], r"distances\[0, 0, 0\]: must be finite"),
        (np.pad([[[3e38]]], 1), [(0, 0, 0), (1, 1, 1)], r"distances\[1, 1, 1\]: must be at most 1e\+37 from 0, got 3"),
        (
            np.pad([[[-1.1e37]]], 1),
            [(0, 0, 0), (1, 1, 1)],
            r"distances\[1, 1, 1\]: must be at most 1e\+37 from 0, got -",
        ),
        (np.full((2, 2, 2), 1e300), [(0, 0, 0), (1, 1, 1)], r"distances\[0, 0, 0\]"),
        (np.full((2, 2, 2), "a"), [(0, 0, 0), (1, 1, 1)], "distances"),
        (np.zeros((2, 2, 2)), [(0, 0, 0), (1, 0, 1)], "bounds"),
        (np.zeros((2, 2, 2)), [(0, 0), (1, 1)], "bounds"),
        (np.zeros((2, 2, 2)), [(0, 0, 0), (1, 1, np.inf)], "bounds"),
    ],
)
def test_a_volume_that_makes_no_sense(distances, bounds, message):
    with pytest.raises(fb.ArgumentError, match=message):
        fb.Volume(distances, bounds)


def test_samples_of_the_largest_magnitude_have_finite_values_between():
    samples = np.full((4, 4, 4), 1e37, np.float32)
    samples[::2] = -1e37
    volume = fb.Volume(samples, [(0, 0, 0), (4, 4, 4)])
    points = np.random.default_rng(3).uniform(-2, 6, (500, 3))
    assert np.isfinite(volume.sample(points)).all()
    assert np.isfinite(volume.gradient(points)).all()
    # The interpolation between -1e37 at x = 0.5 and 1e37 at x = 1.5, within the rounding of float32.
    assert volume.sample([(0.75, 2, 2)]) == pytest.approx(-5e36, rel=1e-6)


def test_a_volume_does_not_change(noise):
    with pytest.raises(ValueError, match="read-only"):
        noise.distances[0, 0, 0] = 1
    with pytest.raises(AttributeError, match="cannot be changed"):
        noise.distances = np.zeros(SHAPE)
    with pytest.raises(ValueError, match="read-only"):
        noise.bounds[0, 0] = 1


def test_a_volume_keeps_a_copy_of_the_array_it_was_made_from():
    values = np.asfortranarray(np.ones((4, 4, 4), np.float32))
    volume = fb.Volume(values, [(0, 0, 0), (1, 1, 1)])
    values[:] = 5

    assert (volume.distances == 1).all()


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda v: pickle.loads(pickle.dumps(v))])
def test_copies_are_equal(sphere, duplicate):
    twin = duplicate(sphere)

    assert np.array_equal(twin.distances, sphere.distances)
    assert np.array_equal(twin.bounds, sphere.bounds)
    assert twin.report == sphere.report


# --- sampling


@pytest.mark.parametrize("filter", ["linear", "nearest"])
def test_samples_at_voxel_centres_are_the_stored_ones(noise, filter):
    centres = truth.grid_points(*noise.bounds, noise.resolution)

    found = noise.sample(centres, filter=filter)

    # Centres are reached in float64 and may miss by an ulp of it, worth less than one float32 rounding of a sample.
    assert found.shape == SHAPE
    assert np.abs(found - noise.distances).max() <= truth.FLOAT32_ROUNDING * np.abs(noise.distances).max()


def test_linear_samples_equal_the_formula(noise, random):
    points = random.uniform(*BOX, size=(5_000, 3))

    found = noise.sample(points)

    # Weights (one rounding each axis) and seven interpolations of two roundings each.
    rounding = 17 * truth.FLOAT32_ROUNDING * np.abs(noise.distances).max()
    assert np.abs(found - truth.trilinear(noise.distances, *BOX, points)).max() <= rounding


def test_nearest_samples_are_those_of_the_voxel(noise, random):
    points = random.uniform(*BOX, size=(5_000, 3))

    found = noise.sample(points, filter="nearest")

    voxel = np.floor((points - BOX[0]) / noise.spacing).astype(int)
    assert np.array_equal(found, noise.distances[tuple(voxel.T)])


def test_the_outer_half_voxel_continues_the_outermost_samples(noise):
    corner = BOX[0] + 1e-3
    middle_of_face = np.array([BOX[0][0] + 1e-3, *noise.origin[1:]])

    assert noise.sample([corner, middle_of_face]) == pytest.approx([noise.distances[0, 0, 0]] * 2)


def test_sampling_keeps_its_accuracy_far_from_the_origin(random):
    values = random.standard_normal(SHAPE)
    shift = np.array([2.0**20, -(2.0**20), 2.0**20])
    points = random.uniform(*BOX, size=(500, 3))

    here, there = fb.Volume(values, BOX).sample(points), fb.Volume(values, BOX + shift).sample(points + shift)

    # The moved points are rounded by 2^-33 of a unit; samples differ by a few units between voxels half a unit apart.
    assert np.abs(here - there).max() <= 1e-6


def test_any_shape_of_points(noise):
    assert noise.sample(np.zeros((2, 5, 3))).shape == (2, 5)
    assert noise.sample(np.zeros(3)).shape == ()
    assert noise.sample(np.zeros((0, 3))).shape == (0,)
    assert noise.gradient(np.zeros((2, 5, 3))).shape == (2, 5, 3)
    assert noise.sample([[0, 0, 0]]).dtype == np.float32


@pytest.mark.parametrize("points", [np.zeros((3, 2)), [[0, 0, np.nan]], [["a", "b", "c"]]])
@pytest.mark.parametrize("method", ["sample", "gradient"])
def test_bad_points_are_refused(noise, method, points):
    with pytest.raises(fb.ArgumentError, match="points"):
        getattr(noise, method)(points)


def test_an_unknown_filter_is_refused(noise):
    with pytest.raises(fb.ArgumentError, match="filter"):
        noise.sample([[0, 0, 0]], filter="cubic")


# --- gradient


def test_the_gradient_is_that_of_the_interpolant(noise, random):
    # Inside one cell the field is linear along each axis, so a difference quotient is exact for any step.
    cell = random.integers(0, np.array(SHAPE) - 1, size=(2_000, 3))
    points = noise.origin + (cell + random.uniform(0.2, 0.8, size=cell.shape)) * noise.spacing

    found = noise.gradient(points)

    step = 0.1 * noise.spacing
    quotients = [
        (truth.trilinear(noise.distances, *BOX, points + e) - truth.trilinear(noise.distances, *BOX, points - e))
        / (2 * e.max())
        for e in np.diag(step)
    ]
    rounding = 17 * truth.FLOAT32_ROUNDING * 2 * np.abs(noise.distances).max() / noise.spacing.min()
    assert np.abs(found - np.stack(quotients, axis=1)).max() <= rounding


def test_the_gradient_of_a_plane_is_its_normal(random):
    normal = np.array([2, -1, 2]) / 3
    points = truth.grid_points(*BOX, SHAPE)
    volume = fb.Volume(truth.plane(points, normal), BOX)

    found = volume.gradient(random.uniform(BOX[0] + volume.spacing, BOX[1] - volume.spacing, size=(500, 3)))

    assert (
        np.abs(found - normal).max()
        <= 17 * truth.FLOAT32_ROUNDING * np.abs(volume.distances).max() * 2 / volume.spacing.min()
    )


def test_beyond_the_outermost_samples_the_gradient_is_the_one_at_them(sphere, random):
    lower, upper = sphere.bounds
    points = random.uniform(3 * lower, 3 * upper, size=(500, 3))
    nearest = np.clip(points, lower + 0.5 * sphere.spacing, upper - 0.5 * sphere.spacing)
    found = sphere.gradient(points)
    # Positions in float64 are rounded by 1e-15, and slopes in float32 by 1e-7 of a sample divided by a voxel.
    assert np.abs(found - sphere.gradient(nearest)).max() <= 1e-5
    # The field at the box is the distance to a sphere, up to the interpolation between samples.
    outwards = nearest / np.linalg.norm(nearest, axis=1, keepdims=True)
    assert np.abs(found - outwards).max() <= 0.1


def test_on_a_sphere_the_gradient_points_outwards(sphere, random):
    direction = random.standard_normal((500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)

    gradient = sphere.gradient(direction)

    # The normal turns by at most a voxel's diagonal over the radius within a cell, and by as much again at facets.
    length = np.linalg.norm(gradient, axis=1)
    assert (truth.dot(gradient, direction) / length).min() >= np.cos(2 * np.linalg.norm(sphere.spacing))
    assert length.max() <= np.sqrt(3)


# --- outside the box


@pytest.mark.parametrize("name", ["knot", "cube", "torus", "open_box", "flat_sheet", "soup"])
def test_outside_the_box_samples_are_a_lower_bound(name, random):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    volume = fb.bake(geometry, resolution=24)
    points = meshes.points_around(geometry, 4_000, spread=4.0)
    points = points[((points < volume.bounds[0]) | (points > volume.bounds[1])).any(axis=1)]

    bound = volume.sample(points)

    exact = truth.Reference(*geometry).distance(points)
    to_box = np.linalg.norm(np.maximum(np.maximum(volume.bounds[0] - points, points - volume.bounds[1]), 0), axis=1)
    assert (bound <= exact + truth.tolerance(*geometry, exact)).all()
    assert (bound >= to_box - truth.tolerance(*geometry, exact)).all()


def test_the_outside_bound_is_tight(random):
    knot = meshes.knot(96, 10)
    volume = fb.bake(knot, resolution=48)
    points = meshes.points_around(knot, 4_000, spread=4.0)
    points = points[((points < volume.bounds[0]) | (points > volume.bounds[1])).any(axis=1)]
    exact = truth.Reference(*knot).distance(points)
    to_box = np.linalg.norm(np.maximum(np.maximum(volume.bounds[0] - points, points - volume.bounds[1]), 0), axis=1)

    bound = volume.sample(points)

    assert (bound / exact).mean() > (to_box / exact).mean()
    assert (bound / exact).mean() > 0.8


def test_at_the_side_of_the_box_the_bound_continues_the_field(sphere):
    side = np.array([sphere.bounds[1][0], 0.1, 0.2])

    inside, outside = sphere.sample([side - (1e-6, 0, 0), side - (-1e-6, 0, 0)])

    # Between the outermost centre and the side of the box neither can be off by more than that half voxel.
    assert abs(outside - inside) <= sphere.spacing[0] / 2


# --- downsample


def test_downsample_halves_each_side_over_the_same_box(noise):
    half = noise.downsample()

    assert half.resolution == (5, 4, 3)
    assert np.array_equal(half.bounds, noise.bounds)


def test_downsample_holds_the_interpolant_at_the_new_centres(noise):
    coarse = noise.downsample(3)

    centres = truth.grid_points(*coarse.bounds, coarse.resolution)
    expected = truth.trilinear(noise.distances, *BOX, centres.reshape(-1, 3))
    rounding = 17 * truth.FLOAT32_ROUNDING * np.abs(noise.distances).max()
    assert np.abs(coarse.distances.ravel() - expected).max() <= rounding


def test_downsample_by_one_is_the_same_field(noise):
    assert np.array_equal(noise.downsample(1).distances, noise.distances)


def test_downsample_to_a_single_voxel(noise):
    assert noise.downsample(100).resolution == (1, 1, 1)


@pytest.mark.parametrize("factor", [0, -1, 2.0, "2", True])
def test_downsample_by_nonsense(noise, factor):
    with pytest.raises(fb.ArgumentError, match="factor"):
        noise.downsample(factor)


# --- pictures, arrays and devices


def test_a_notebook_shows_a_picture(sphere, noise):
    assert sphere._repr_png_().startswith(b"\x89PNG")
    assert fb.Volume(np.ones((3, 3, 3)), [(0, 0, 0), (1, 1, 1)])._repr_png_() is None


def test_dlpack_gives_a_copy_or_a_read_only_view():
    volume = fb.bake(meshes.box(), (6, 5, 4))

    view = np.from_dlpack(volume)
    assert np.array_equal(view, volume.distances)
    assert volume.__dlpack_device__() == (1, 0)

    class Old:
        """A reader of the first protocol: no versions, hence writable."""

        def __dlpack__(self, **_):
            return volume.__dlpack__()

        def __dlpack_device__(self):
            return volume.__dlpack_device__()

    copied = np.from_dlpack(Old())
    assert np.array_equal(copied, volume.distances)
    assert not np.shares_memory(copied, volume.distances)
    assert volume.__dlpack__() is not None


def test_the_array_interface_shares_the_samples():
    volume = fb.bake(meshes.box(), (6, 5, 4))

    class Holder:
        __array_interface__ = volume.__array_interface__

    array = np.asarray(Holder())
    assert np.shares_memory(array, volume.distances)
    assert not array.flags.writeable


@pytest.mark.parametrize("filter", ["linear", "nearest"])
def test_a_device_samples_to_the_bit(noise, gpu, random, filter):
    points = random.uniform(BOX[0] - 1, BOX[1] + 1, (40, 25, 3))

    there = noise.sample(points, filter=filter, device=gpu)

    assert there.shape == (40, 25)
    assert there.tobytes() == noise.sample(points, filter=filter, device="cpu").tobytes()
    assert noise.gradient(points, device=gpu).tobytes() == noise.gradient(points, device="cpu").tobytes()
    assert noise.sample(np.empty((0, 3)), device=gpu).shape == (0,)
    assert noise.gradient((0, 0, 0), device=gpu).shape == (3,)


def test_the_field_stays_on_the_device(gpu, random):
    points = random.uniform(-1.5, 1.5, (100, 3))
    volume = fb.bake(meshes.icosphere(2), resolution=32, device=gpu)
    field = volume._field
    before = field._transfers()

    values = volume.sample(points, device=gpu)

    after = field._transfers()
    # Eight samples of at most two cells for each point.
    assert after["readback_bytes"] - before["readback_bytes"] <= 100 * 2 * 32
    assert volume._samples is None
    assert values.tobytes() == volume.sample(points, device="cpu").tobytes()


def test_an_upload_is_kept(noise, gpu):
    noise.sample((0, 0, 0), device=gpu)
    field = noise._field
    before = field._transfers()["uploaded_bytes"]

    noise.gradient((0, 0, 0), device=gpu)

    assert noise._field is field
    assert field._transfers()["uploaded_bytes"] - before < 4 * np.prod(SHAPE)


def test_stored_encodings_are_sampled_on_devices(noise, gpu, random):
    points = random.uniform(BOX[0], BOX[1], (50, 3))
    for encoding in ("float16", "snorm8"):
        stored = noise.quantize(encoding)
        assert stored.sample(points, device=gpu).tobytes() == stored.sample(points, device="cpu").tobytes()


@pytest.mark.parametrize("device", ["abacus", None, 3])
def test_unknown_devices_are_refused(noise, device):
    for function in (noise.sample, noise.gradient):
        with pytest.raises(fb.Error, match=r"device|abacus"):
            function((0, 0, 0), device=device)


def test_masked_samples_and_points_are_refused():
    samples = np.ma.masked_array(np.ones((2, 2, 2)), mask=np.arange(8).reshape(2, 2, 2) < 3)
    with pytest.raises(fb.ArgumentError, match=r"^distances: must have no masked entries, got 3; fill them first"):
        fb.Volume(samples, [(0, 0, 0), (1, 1, 1)])
    volume = fb.Volume(samples.filled(2.0), [(0, 0, 0), (1, 1, 1)])
    assert np.array_equal(volume.distances, samples.filled(2.0))
    with pytest.raises(fb.ArgumentError, match=r"^points: must have no masked entries, got 1"):
        volume.sample(np.ma.masked_array(np.zeros((1, 3)), mask=[[True, False, False]]))
    # An array without masked entries is an array.
    assert fb.Volume(np.ma.masked_array(np.ones((2, 2, 2))), volume.bounds).resolution == (2, 2, 2)
