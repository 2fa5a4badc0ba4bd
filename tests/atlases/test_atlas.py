"""The atlas: positions of texels, unpacked volumes, and samples that equal the samples of the volumes."""

import copy
import pickle
import re
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
import truth
from fields import cubes, noise

#: Weights in [0, 1] of values up to 1: eight products and seven sums in float32, and the float32 of a weight.
FLOAT32_SAMPLE = 16 * 2.0**-24

#: The article's struct in std430: name, offset, bytes.
ARTICLE_STRUCT = [
    ("model", 0, 64),
    ("inverse_model", 64, 64),
    ("inner_min", 128, 16),
    ("inner_max", 144, 16),
    ("outer_min", 160, 16),
    ("outer_max", 176, 16),
    ("atlas_index", 192, 4),
    ("atlas_offset", 196, 4),
]

#: Largest error of each encoding for a distance of at most 1 in a band of 1 unit.
ENCODING_ERROR = {"float32": 0.0, "float16": 2.0**-10, "snorm16": 1 / 32767, "snorm8": 1 / 127}


@pytest.fixture(scope="module")
def mixed():
    """Volumes of many shapes."""
    sides = np.random.default_rng(3).integers(1, 20, (12, 3))
    return [noise(tuple(shape), seed) for seed, shape in enumerate(sides.tolist())]


# --- strips: the article to the byte


def test_strips_are_the_articles_formula():
    side, page_size, count = 6, 40, 8
    volumes = cubes(count, side)

    atlas = fb.pack(volumes, layout="strips", page_size=page_size)

    rows = page_size // side
    expected = np.zeros((2, page_size, page_size), np.float32)
    for i, volume in enumerate(volumes):
        for x, y, z in np.ndindex(volume.resolution):
            expected[i // rows, y + (i % rows) * side, x + z * side] = volume.distances[x, y, z]
    assert np.array_equal(atlas.pages, expected)
    assert atlas.entries["atlas_index"].tolist() == [i // rows for i in range(count)]
    assert atlas.entries["atlas_offset"].tolist() == [i % rows for i in range(count)]


def test_64_fields_of_64_fill_a_page_and_the_65th_opens_another():
    box = [(0, 0, 0), (1, 1, 1)]
    fields = [fb.Volume(np.full((64, 64, 64), value, np.float32), box) for value in range(1, 66)]

    full, over = (fb.pack(fields[:count], layout="strips") for count in (64, 65))

    assert full.pages.shape == (1, 4096, 4096)
    assert np.array_equal(full.pages[0], np.repeat(np.arange(1, 65, dtype=np.float32), 64)[:, None] * np.ones(4096))
    assert over.pages.shape == (2, 4096, 4096)
    assert over.entries[["atlas_index", "atlas_offset"]][64].tolist() == (1, 0)
    assert np.all(over.pages[1, :64] == 65)
    assert not over.pages[1, 64:].any()


def test_a_strip_entry_has_the_bytes_of_the_articles_struct():
    model = np.array([[0, -2, 0, 5], [2, 0, 0, 6], [0, 0, 2, 7], [0, 0, 0, 1]], float)
    volume = noise((4, 4, 4))

    atlas = fb.pack([volume, (volume, model)], layout="strips", page_size=16)

    entries = atlas.entries
    assert entries.dtype.itemsize == 208
    assert [
        (name, offset, kind.itemsize) for name, (kind, offset, *_) in entries.dtype.fields.items()
    ] == ARTICLE_STRUCT
    record = np.frombuffer(entries.tobytes(), np.float32).reshape(2, 52)[1]
    assert np.array_equal(record[:16], model.T.ravel())  # column by column
    assert np.allclose(record[16:32].reshape(4, 4).T @ model, np.eye(4), atol=1e-6)
    assert np.array_equal(entries["model"][1].T, model)
    boxes = np.concatenate([volume.inner_bounds, volume.bounds])
    assert np.allclose(record[32:48].reshape(4, 4), np.column_stack([boxes, np.ones(4)]), rtol=1e-7)
    assert record[48:].view(np.int32).tolist() == [0, 1, 0, 0]


def test_texture_coordinates_are_convert_world_to_texture(random):
    side, page_size = 8, 100
    atlas = fb.pack(cubes(5, side), layout="strips", page_size=page_size)
    lower, upper = atlas.unpack(3).bounds
    points = random.uniform(lower, upper, (200, 3))

    found = atlas.texture_coordinates(3, points)

    inside = (points - lower) / ((upper - lower) / side)
    u = inside[:, 0] / page_size + np.floor(inside[:, 2]) * side / page_size
    v = inside[:, 1] / page_size + 3 * side / page_size
    assert np.allclose(found, np.column_stack([u, v]), atol=1e-12)


def test_texture_coordinates_of_voxel_centres_are_those_of_their_texels(mixed):
    atlas = fb.pack(mixed, page_size=128)

    for i, volume in enumerate(mixed):
        centres = truth.grid_points(*volume.bounds, volume.resolution)
        texels = atlas.texture_coordinates(i, centres) * 128
        assert np.allclose(texels % 1, 0.5, atol=1e-6)
        column, row = np.moveaxis(texels.astype(int), -1, 0)
        assert np.array_equal(atlas.pages[atlas.entries["atlas_index"][i], row, column], volume.distances)


@pytest.mark.parametrize("points", [[(5, 5, 5)], [(1, 0.75, 1.5)], [(-9, 0, 1.5)]])
def test_texture_coordinates_stay_in_the_strip(points):
    atlas = fb.pack(cubes(2, 4), layout="strips", page_size=16)

    u, v = atlas.texture_coordinates(1, points)[0]

    assert 0 <= u <= 1
    assert 0.25 <= v <= 0.5


# --- shelves


def test_200_volumes_of_random_sizes_come_back_bit_for_bit(record_property):
    sides = np.random.default_rng(11).integers(4, 49, (200, 3))
    volumes = [noise(tuple(shape), seed) for seed, shape in enumerate(sides.tolist())]

    atlas = fb.pack(volumes, page_size=512)

    owners = np.zeros(atlas.pages.shape, np.int32)
    for i, (volume, entry) in enumerate(zip(volumes, atlas.entries, strict=True)):
        unpacked = atlas.unpack(i)
        assert np.array_equal(unpacked.distances, volume.distances)
        assert np.array_equal(unpacked.bounds, volume.bounds)
        assert np.array_equal(unpacked.inner_bounds, volume.inner_bounds)
        (x, y), (width, height) = entry["corner"], entry["tile"]
        assert entry["atlas_offset"] == y * 512 + x
        for z in range(volume.resolution[2]):
            column, row = x + z % entry["columns"] * width, y + z // entry["columns"] * height
            tile = np.s_[entry["atlas_index"], row : row + height, column : column + width]
            assert owners[tile].shape == (height, width)
            assert not owners[tile].any(), "two slices share a texel"
            owners[tile] = i + 1
    assert atlas.fill == pytest.approx(np.count_nonzero(owners) / owners.size)
    assert not atlas.pages[owners == 0].any()
    print(f"fill of {len(atlas.pages)} pages: {atlas.fill:.3f}")
    assert atlas.fill > 0.85


@pytest.mark.parametrize("gutter", [0, 1, 3])
def test_the_gutter_repeats_the_border(gutter):
    volume = noise((5, 4, 3))

    atlas = fb.pack([volume], page_size=64, gutter=gutter)

    x, y = atlas.entries["corner"][0]
    width, height = atlas.entries["tile"][0]
    padded = np.pad(volume.distances[:, :, 0].T, gutter, mode="edge")
    assert padded.shape == (height, width)
    assert np.array_equal(atlas.pages[0, y : y + height, x : x + width], padded)


def test_an_atlas_grows_without_moving_what_is_there(mixed):
    atlas = fb.pack(mixed, page_size=128)
    before, entries = atlas.pages.copy(), atlas.entries.copy()
    large = noise((40, 10, 20), 99)

    index = atlas.add(large)

    assert index == len(mixed)
    assert np.array_equal(atlas.entries[:index], entries)
    changed = atlas.pages[: len(before)] != before
    assert not before[changed].any(), "a texel of another volume changed"
    assert np.array_equal(atlas.unpack(index).distances, large.distances)


def test_removing_frees_the_index_and_the_room(mixed):
    atlas = fb.pack(mixed, page_size=128)
    pages, rest = len(atlas.pages), [i for i in range(len(mixed)) if i != 4]

    atlas.remove(4)

    assert len(atlas) == len(mixed) - 1
    assert atlas.indices == tuple(rest)
    assert atlas.entries["atlas_index"][4] == -1
    with pytest.raises(fb.AtlasError, match="removed"):
        atlas.unpack(4)
    for i in rest:
        assert np.array_equal(atlas.unpack(i).distances, mixed[i].distances)
    assert atlas.add(mixed[4]) == 4
    assert len(atlas.pages) == pages
    for i, volume in enumerate(mixed):
        assert np.array_equal(atlas.unpack(i).distances, volume.distances)


def test_removed_texels_are_zero():
    atlas = fb.pack(cubes(3, 4), layout="strips", page_size=16)
    for i in range(3):
        atlas.remove(i)

    assert not atlas.pages.any()
    assert atlas.fill == 0
    assert atlas.add(noise((4, 4, 4))) == 0


def test_an_atlas_that_was_loaded_grows_like_the_one_that_was_saved(mixed, tmp_path):
    atlas = fb.pack(mixed, page_size=128)
    atlas.remove(2)
    atlas.save(tmp_path / "a.npz")
    loaded = fb.load(tmp_path / "a.npz")

    for one in (atlas, loaded):
        one.add(noise((9, 9, 9), 50))
        one.add(noise((3, 20, 6), 51))

    assert np.array_equal(atlas.pages, loaded.pages)
    assert np.array_equal(atlas.entries, loaded.entries)


# --- sampling


def points_of_interest(volume, random, count=300):
    """Inside, outside, on every face, edge and corner of the box, at centres, and within half a voxel of the border."""
    lower, upper = volume.bounds
    inside = random.uniform(lower, upper, (count, 3))
    snapped = np.where(random.random((count, 3)) < 0.4, np.where(random.random((count, 3)) < 0.5, lower, upper), inside)
    border = lower + volume.spacing * random.uniform(0, 0.5, (count, 3))
    outside = random.uniform(lower - 1, upper + 1, (count, 3))
    centres = truth.grid_points(lower, upper, volume.resolution).reshape(-1, 3)[:count]
    return np.concatenate([inside, snapped, border, outside, centres])


@pytest.mark.parametrize("layout", ["shelves", "strips"])
def test_sampling_the_atlas_is_sampling_the_volume(layout, random):
    shapes = [(7, 7, 7)] * 3 if layout == "strips" else [(7, 5, 9), (1, 1, 1), (2, 1, 6)]
    volumes = [noise(shape, seed) for seed, shape in enumerate(shapes)]
    atlas = fb.pack(volumes, layout=layout, page_size=64)

    for i, volume in enumerate(volumes):
        points = points_of_interest(volume, random)
        for filter in ("linear", "nearest"):
            assert np.array_equal(atlas.sample(i, points, filter=filter), volume.sample(points, filter=filter))
        inside = points[((points >= volume.bounds[0]) & (points <= volume.bounds[1])).all(axis=1)]
        expected = truth.trilinear(volume.distances, *volume.bounds, inside)
        assert np.abs(atlas.sample(i, inside) - expected).max() < FLOAT32_SAMPLE


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("encoding", ["float16", "snorm16", "snorm8"])
def test_small_encodings_stay_within_their_bounds_and_never_exceed_the_truth(layout, encoding, random):
    volume = noise((8, 8, 8), bounds=[(0, 0, 0), (2, 2, 2)])  # a band of 4 voxels is 1 unit

    atlas = fb.pack([volume, volume], layout=layout, page_size=64, encoding=encoding)

    stored = atlas.unpack(1).distances
    assert np.all(np.abs(stored) <= np.abs(volume.distances))
    # Two float32 roundings on the way back.
    error = ENCODING_ERROR[encoding] + 2 * 2.0**-23
    assert np.abs(stored - volume.distances).max() <= error
    points = random.uniform(*volume.bounds, (500, 3))
    assert np.abs(atlas.sample(1, points) - volume.sample(points)).max() <= error + FLOAT32_SAMPLE
    assert np.array_equal(atlas.sample(1, points), atlas.unpack(1).sample(points))


@pytest.mark.parametrize("encoding", ["snorm16", "snorm8"])
def test_texels_are_shares_of_the_scale_of_the_entry(encoding):
    volume = noise((8, 8, 8), bounds=[(0, 0, 0), (2, 2, 2)])

    atlas = fb.pack([volume], page_size=64, encoding=encoding, band=2)

    assert atlas.entries["scale"].tolist() == [0.5]
    x, y = atlas.entries["corner"][0] + 1
    texels = atlas.pages[0, y : y + 8, x : x + 8].astype(np.float64) / np.iinfo(atlas.pages.dtype).max
    expected = np.clip(volume.distances[:, :, 0].T / 0.5, -1, 1)
    assert np.abs(texels - expected).max() <= 1 / np.iinfo(atlas.pages.dtype).max


def test_two_taps_follow_a_ramp_along_z():
    # A ramp along z, as the side of a box has it.
    box = np.array([(-1.0, -1, -1), (1, 1, 1)])
    centres = truth.grid_points(*box, (8, 8, 8))
    atlas = fb.pack([fb.Volume(centres[..., 2], box)], layout="strips", page_size=64)
    points = np.zeros((400, 3))
    points[:, 2] = np.linspace(-0.8, 0.8, 400)

    assert np.abs(atlas.sample(0, points) - points[:, 2]).max() < FLOAT32_SAMPLE


@given(
    shape=st.tuples(*[st.integers(1, 6)] * 3),
    gutter=st.integers(0, 2),
    encoding=st.sampled_from(["float32", "float16", "snorm16", "snorm8"]),
    seed=st.integers(0, 1000),
)
def test_any_volume_is_sampled_as_what_was_kept_of_it(shape, gutter, encoding, seed):
    volume = noise(shape, seed)
    atlas = fb.pack([volume, volume], page_size=64, gutter=gutter, encoding=encoding)
    points = np.random.default_rng(seed).uniform(-2.5, 2.5, (50, 3))

    assert np.array_equal(atlas.sample(1, points), atlas.unpack(1).sample(points))


def test_points_of_any_shape(mixed):
    atlas = fb.pack(mixed, page_size=128)

    assert atlas.sample(0, np.zeros((2, 5, 3))).shape == (2, 5)
    assert atlas.sample(0, (0, 0, 0)).shape == ()
    assert atlas.texture_coordinates(0, np.zeros((2, 5, 3))).shape == (2, 5, 2)


# --- bare arrays


def test_bare_arrays_are_packed_like_volumes():
    fields = [np.random.default_rng(seed).standard_normal((5, 5, 5)) for seed in range(3)]

    pages, entries = fb.arrays.pack(fields, layout="strips", page_size=32)

    assert pages.shape == (1, 32, 32)
    assert np.array_equal(pages[0, 5:10, 10:15], fields[1][:, :, 2].T.astype(np.float32))
    assert entries["outer_max"].tolist() == [[5, 5, 5, 1]] * 3
    assert fields[0].flags.writeable


# --- the object


def test_an_empty_atlas_can_be_filled(tmp_path):
    atlas = fb.pack([], page_size=32)
    assert atlas.pages.shape == (0, 32, 32)
    assert len(atlas) == len(atlas.entries) == 0
    atlas.save(tmp_path / "empty.npz")

    assert fb.load(tmp_path / "empty.npz").add(noise((4, 4, 4))) == 0


def test_pages_and_entries_are_read_only(mixed):
    atlas = fb.pack(mixed, page_size=128)

    with pytest.raises(ValueError, match="read-only"):
        atlas.pages[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        atlas.entries["columns"] = 1
    assert atlas.entries is atlas.entries


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda atlas: pickle.loads(pickle.dumps(atlas))])
def test_copies_are_equal_and_apart(mixed, duplicate):
    atlas = fb.pack(mixed, page_size=128)

    other = duplicate(atlas)
    other.remove(0)

    assert len(atlas) == len(mixed)
    assert np.array_equal(other.unpack(1).distances, atlas.unpack(1).distances)


def test_the_report_of_a_bake_survives(tmp_path):
    volume = fb.bake(fb.models.gear(), 16)
    atlas = fb.pack([volume], page_size=128)
    atlas.save(tmp_path / "a.npz")

    assert fb.load(tmp_path / "a.npz").unpack(0).report.sign_method == volume.report.sign_method != ""


def test_threads_sample_while_volumes_come_and_go(mixed):
    atlas = fb.pack(mixed, page_size=256)
    points = np.random.default_rng(1).uniform(-1, 1, (2000, 3))
    expected, wrong = mixed[0].sample(points), []

    def look():
        wrong.extend(not np.array_equal(atlas.sample(0, points), expected) for _ in range(20))

    threads = [threading.Thread(target=look) for _ in range(3)]
    for thread in threads:
        thread.start()
    for _ in range(10):
        atlas.remove(atlas.add(noise((5, 5, 5))))
    for thread in threads:
        thread.join()
    assert not any(wrong)


def test_progress_is_told():
    told = []
    fb.pack(cubes(2, 4), page_size=64, progress=told.append)

    assert told[-1] == 1.0


def test_repr_says_what_there_is(mixed):
    assert repr(fb.pack(mixed[:1], page_size=128)).startswith("Atlas(1 volume on 1 page of 128 x 128 float32, shelves")


# --- packing on a device


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("encoding", ["float32", "float16", "snorm16", "snorm8"])
def test_a_device_packs_the_same_bytes(layout, encoding, gpu):
    volumes = [fb.bake(fb.models.gear(), (13, 13, 13)), noise((13, 13, 13))]
    options = {"layout": layout, "page_size": 200, "encoding": encoding}

    here, there = fb.pack(volumes, **options), fb.pack(volumes, **options, device=gpu)

    assert repr(there) == repr(here)
    assert there.entries.tobytes() == here.entries.tobytes()
    assert np.array_equal(there.pages, here.pages)
    assert there.add(volumes[0]) == 2
    there.remove(0)
    assert np.array_equal(there.unpack(2).distances, fb.pack(volumes, **options).unpack(0).distances)


def test_what_is_on_the_device_is_packed_without_a_round_trip(gpu):
    volumes = [fb.bake(fb.models.gear(), 12, device=gpu) for _ in range(2)]
    field = volumes[0]._field
    before = field._transfers()

    atlas = fb.pack(volumes, page_size=128, device=gpu)

    after = field._transfers()
    assert after["readbacks"] == before["readbacks"]
    # For each volume the value of a whole texel, one number, and the 64 bytes of the kernel's parameters.
    assert after["uploaded_bytes"] - before["uploaded_bytes"] <= 2 * (4 + 64)
    assert np.array_equal(atlas.unpack(1).distances, volumes[1].distances)


@pytest.mark.parametrize("size", [1e-30, 1e-6, 1e6, 1e30])
@pytest.mark.parametrize("encoding", ["float16", "snorm16", "snorm8"])
def test_a_device_packs_the_same_bytes_for_a_mesh_of_any_size(size, encoding, gpu, random):
    # Zeros, distances far beyond the range, and some that are no normal float32 numbers.
    share = random.choice([0, 1e-7, 1e-3, 1, 1e6], (9, 9, 9))
    distances = (random.uniform(-3, 3, (9, 9, 9)) * share * size).astype(np.float32)
    volume = fb.Volume(distances, np.array([(0, 0, 0), (9, 9, 9)]) * size)

    here, there = (fb.pack([volume], page_size=64, encoding=encoding, device=device) for device in ("cpu", gpu))

    assert np.array_equal(here.pages, there.pages)
    assert there.entries.tobytes() == here.entries.tobytes()


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("count", [0, 1, 5, 40])
def test_a_page_that_fits_is_the_smallest_power_of_two(layout, count):
    volumes = cubes(count, 6)
    atlas = fb.pack(volumes, layout=layout, page_size="fit")

    assert len(atlas) == count
    assert len(atlas.pages) == min(count, 1)
    size = atlas.page_size
    assert size & (size - 1) == 0
    if count:
        assert np.array_equal(atlas.unpack(count - 1).distances, volumes[-1].distances)
        try:
            half = fb.pack(volumes, layout=layout, page_size=size // 2)
        except fb.AtlasError:
            return
        assert len(half.pages) > 1


def test_a_page_size_that_is_no_number_is_refused():
    with pytest.raises(fb.ArgumentError, match="page_size"):
        fb.pack(cubes(1, 4), page_size="large")
    with pytest.raises(fb.AtlasError):
        fb.pack([*cubes(1, 4), *cubes(1, 5)], layout="strips", page_size="fit")


def test_an_unknown_device_is_refused():
    with pytest.raises(fb.DeviceError, match="abacus"):
        fb.pack(cubes(1, 4), page_size=64, device="abacus")


# --- shader text


@pytest.mark.parametrize("language", ["wgsl", "glsl", "hlsl", "msl"])
@pytest.mark.parametrize("layout", ["shelves", "strips"])
def test_the_shader_text_has_the_functions_with_comments(language, layout):
    text = fb.pack(cubes(1, 4), layout=layout, page_size=64).shader(language)

    for function in ("atlas_sample", "atlas_sample_filtered", "atlas_sample_nearest", "atlas_texture_coordinates"):
        definition = re.search(rf"(//.*\n)+.*\b{function}\(", text)
        assert definition is not None, f"{function} is not there, or not explained"
    assert "AtlasEntry" in text


def test_the_shader_text_is_wgsl_by_default_and_depends_on_the_atlas():
    first, second = (fb.pack(cubes(1, 4), page_size=size) for size in (64, 128))

    assert first.shader() == first.shader("wgsl") != second.shader()
    assert "texture_2d_array<f32>" in first.shader()


def test_shaders_that_cannot_be():
    atlas = fb.pack(cubes(1, 4), layout="strips", page_size=64)
    with pytest.raises(fb.ArgumentError, match="language"):
        atlas.shader("cg")
    atlas.remove(0)
    with pytest.raises(fb.AtlasError, match="add a volume"):
        atlas.shader()
