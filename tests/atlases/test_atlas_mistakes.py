"""Invalid input for an atlas, and the error messages."""

import numpy as np
import pytest

import fieldbake as fb
from fields import cubes, noise


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"page_size": 0}, fb.ArgumentError, "page_size"),
        ({"page_size": 2**20}, fb.ArgumentError, "page_size"),
        ({"page_size": 64.0}, fb.ArgumentError, "page_size"),
        ({"gutter": -1}, fb.ArgumentError, "gutter"),
        ({"gutter": 1000}, fb.ArgumentError, "gutter"),
        ({"layout": "rows"}, fb.ArgumentError, 'layout: must be one of "shelves", "strips"'),
        ({"layout": None}, fb.ArgumentError, "layout"),
        ({"layout": [1]}, fb.ArgumentError, "layout"),
        ({"encoding": "uint8"}, fb.ArgumentError, "encoding"),
        ({"band": 0}, fb.ArgumentError, "band"),
        ({"page_size": 9}, fb.AtlasError, r"volumes\[0\]: 5 x 5 x 5 voxels do not fit .* at least 21"),
        ({"page_size": 24, "layout": "strips"}, fb.AtlasError, r"volumes\[0\]: .* at least 25"),
    ],
)
def test_options_that_make_no_sense(arguments, error, message):
    with pytest.raises(error, match=message):
        fb.pack([noise((5, 5, 5))], **{"page_size": 64, **arguments})


def test_the_page_size_that_is_told_would_do():
    fb.pack([noise((5, 5, 5))], page_size=21)
    fb.pack([noise((5, 5, 5))], page_size=25, layout="strips")


@pytest.mark.parametrize("shape", [(4, 4, 5), (5, 5, 5)])
def test_strips_hold_equal_cubes_only(shape):
    with pytest.raises(fb.AtlasError, match=r"volumes\[1\]: strips hold equal cubes, here of 4.*shelves"):
        fb.pack([noise((4, 4, 4)), noise(shape)], layout="strips")
    atlas = fb.pack([noise((4, 4, 4))], layout="strips", page_size=32)
    with pytest.raises(fb.AtlasError, match="equal cubes"):
        atlas.add(noise(shape))
    assert len(atlas) == 1


@pytest.mark.parametrize(
    "volumes", [None, 3, noise((2, 2, 2)), [None], [np.zeros((4, 4, 4))], [(noise((2, 2, 2)), np.zeros((4, 4)))]]
)
def test_objects_that_are_not_volumes(volumes):
    with pytest.raises(fb.ArgumentError, match="volumes"):
        fb.pack(volumes)


@pytest.mark.parametrize("i", [2, -3, 1.0, "0", None])
def test_an_index_that_is_not_there(i):
    atlas = fb.pack(cubes(2, 4), page_size=64)

    for call in (atlas.unpack, atlas.remove, lambda i: atlas.sample(i, [(0, 0, 0)])):
        with pytest.raises(fb.AtlasError, match=r"^i:"):
            call(i)
    with pytest.raises(fb.AtlasError, match=r"^i:"):
        atlas.texture_coordinates(i, [(0, 0, 0)])


def test_negative_indices_count_from_the_end():
    volumes = cubes(2, 4)
    assert np.array_equal(fb.pack(volumes, page_size=64).unpack(-1).distances, volumes[1].distances)


@pytest.mark.parametrize("points", [np.zeros((3, 2)), [[0, 0, np.nan]]])
def test_bad_points_are_refused(points):
    atlas = fb.pack(cubes(1, 4), page_size=64)
    for call in (atlas.sample, atlas.texture_coordinates):
        with pytest.raises(fb.ArgumentError, match="points"):
            call(0, points)


def test_an_unknown_filter_is_refused():
    with pytest.raises(fb.ArgumentError, match='filter: must be one of "linear", "nearest"'):
        fb.pack(cubes(1, 4), page_size=64).sample(0, [(0, 0, 0)], filter="cubic")


def test_pages_that_cannot_fit_in_memory_are_refused_before_any_work():
    # 181 strips to a page of 4 GiB.
    volumes = [fb.Volume(np.zeros((181,) * 3, np.float32), [(0, 0, 0), (1, 1, 1)])] * (181 * 200)
    with pytest.raises(fb.CapacityError, match=r"an atlas of 200 pages .* use a smaller page_size"):
        fb.pack(volumes, layout="strips", page_size=32768)
