"""Atlas files: loaded atlases have the same bits, and damaged or hostile files raise FormatError."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldbake as fb
from damage import damaged
from fields import cubes


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("encoding", ["float32", "float16", "snorm16", "snorm8"])
def test_save_and_load_give_the_same_bits(layout, encoding, tmp_path):
    atlas = fb.pack(cubes(3, 5), layout=layout, page_size=32, encoding=encoding, gutter=2, band=3)
    atlas.remove(1)
    atlas.save(tmp_path / "a.npz")

    loaded = fb.load(tmp_path / "a.npz")

    assert np.array_equal(loaded.pages, atlas.pages)
    assert loaded.pages.dtype == atlas.pages.dtype
    assert loaded.entries.tobytes() == atlas.entries.tobytes()
    assert repr(loaded) == repr(atlas)
    assert (loaded.gutter, loaded.band) == (atlas.gutter, atlas.band)
    assert np.array_equal(loaded.unpack(2).distances, atlas.unpack(2).distances)


@pytest.mark.parametrize("ending", [".npz", ".exr", ".png"])
def test_files_keep_the_names(ending, tmp_path):
    small = fb.sphere(1).to_mesh(8)
    small.save(tmp_path / "Stuhl für zwei.stl")
    atlas = fb.pack(
        [tmp_path / "Stuhl für zwei.stl", small, (str(tmp_path / "Stuhl für zwei.stl"), np.eye(4))], resolution=6
    )
    assert atlas.names == ("Stuhl für zwei", "", "Stuhl für zwei")
    assert atlas.add(cubes(1, 5)[0], name="cube") == 3
    atlas.remove(0)
    atlas.save(tmp_path / f"a{ending}")

    loaded = fb.load(tmp_path / f"a{ending}")

    assert loaded.names == atlas.names == ("", "", "Stuhl für zwei", "cube")
    assert [entry.name for entry in loaded] == ["", "Stuhl für zwei", "cube"]
    assert "3 'cube' of" in repr(loaded[3])
    assert atlas.entries.dtype.itemsize == 240
    assert loaded.add(cubes(1, 5)[0], name="first") == 0
    assert loaded[0].name == "first"


def test_names_belong_to_the_volumes_one_for_one():
    assert fb.pack(cubes(2, 4), page_size=24, names=["a", "b"]).names == ("a", "b")
    for names, text in (
        (["a"], "names: must have a name for each of 2 volumes, got 1"),
        ("ab", "names: must be a list"),
        ([1, "b"], r"names\[0\]"),
        (3, "names: must be an iterable"),
    ):
        with pytest.raises(fb.ArgumentError, match=text):
            fb.pack(cubes(2, 4), page_size=24, names=names)


@pytest.mark.parametrize(
    "names", [np.array(["a"]), np.zeros(3), np.array("a"), np.full(3, 0x7FFFFFFF, np.uint32).view("<U1")]
)
def test_wrong_names_in_a_file_are_refused(good_file, names, tmp_path):
    (tmp_path / "a.npz").write_bytes(rewrite(good_file, names=names))
    with pytest.raises(fb.FormatError):
        fb.load(tmp_path / "a.npz")


def test_files_without_names_are_read(good_file, tmp_path):
    with zipfile.ZipFile(io.BytesIO(good_file)) as old, zipfile.ZipFile(tmp_path / "a.npz", "w") as new:
        for info in old.infolist():
            if info.filename != "names.npy":
                new.writestr(info, old.read(info))
    assert fb.load(tmp_path / "a.npz").names == ("", "", "")


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(fb.FormatError, match="ending"):
        fb.pack([], page_size=8).save(tmp_path / "atlas.tiff")


@pytest.fixture(scope="module")
def good_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("atlas") / "good.npz"
    fb.pack(cubes(3, 4), page_size=24).save(path)
    return path.read_bytes()


def rewrite(content, change_header=None, **arrays):
    """Write the archive again with entries of the header, or arrays, replaced."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    header = json.loads(str(np.load(io.BytesIO(members["header.npy"]))))
    arrays["header"] = np.array(json.dumps({**header, **(change_header or {})}))
    for name, array in arrays.items():
        stream = io.BytesIO()
        np.lib.format.write_array(stream, np.asarray(array))
        members[f"{name}.npy"] = stream.getvalue()
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return result.getvalue()


def array_of(content, name):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return np.load(io.BytesIO(archive.read(f"{name}.npy")))


HOSTILE = {
    "newer version": {"change_header": {"version": 99}},
    "layout": {"change_header": {"layout": "spiral"}},
    "another layout": {"change_header": {"layout": "strips"}},
    "encoding": {"change_header": {"encoding": "float16"}},
    "page size": {"change_header": {"page_size": 48}},
    "huge page size": {"change_header": {"page_size": 2**40}},
    "gutter": {"change_header": {"gutter": "one"}},
    "band": {"change_header": {"band": -1}},
    "pages of nan": {"pages": np.full((1, 24, 24), np.nan, np.float32)},
    "pages in the plane": {"pages": np.zeros((24, 24), np.float32)},
    "pages too few": {"pages": np.zeros((0, 24, 24), np.float32)},
    "pages by columns": {"pages": np.zeros((1, 24, 24), np.float32, order="F")},
    "blocks too short": {"blocks": np.zeros((3, 9), np.uint32)},
    "blocks of zeros": {"blocks": np.zeros((3, 10), np.uint32)},
    "blocks too many": {"blocks": np.zeros((4, 10), np.uint32)},
    "blocks without rows": {"blocks": np.uint32(3)},
    "boxes upside down": {"boxes": np.ones((3, 4, 3))},
    "boxes of nan": {"boxes": np.full((3, 4, 3), np.nan)},
    "boxes far away": {"boxes": np.full((3, 4, 3), 1e300)},
    "models singular": {"models": np.zeros((3, 4, 4))},
    "scales zero": {"scales": np.zeros(3, np.float32)},
    "reports of something else": {"reports": np.frombuffer(b"[1, 2, 3]", np.uint8)},
    "reports too few": {"reports": np.frombuffer(b"[]", np.uint8)},
    "reports of no text": {"reports": np.zeros(9)},
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_is_wrong_inside(good_file, tmp_path, name):
    path = tmp_path / "hostile.npz"
    path.write_bytes(rewrite(good_file, **HOSTILE[name]))

    with pytest.raises(fb.FormatError, match=r"hostile\.npz"):
        fb.load(path)


@pytest.mark.parametrize("column", range(10))
@pytest.mark.parametrize("value", [0, 23, 25, 2**31, 2**32 - 2])
def test_bad_offsets_never_leave_the_pages(good_file, tmp_path, column, value):
    blocks = array_of(good_file, "blocks")
    blocks[1, column] = value
    path = tmp_path / "offset.npz"
    path.write_bytes(rewrite(good_file, blocks=blocks))

    try:
        atlas = fb.load(path)
    except fb.FormatError:
        return
    # Some other place on the pages: harmless.
    assert atlas.unpack(1).distances.shape == tuple(blocks[1, 7:])


@given(data=st.data())
@settings(max_examples=150)
def test_a_damaged_file_is_a_format_error(good_file, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    path.write_bytes(damaged(data, good_file))

    try:
        atlas = fb.load(path)
    except fb.FormatError:
        return
    # Bytes that no reader uses may be damaged; checksums cover the rest.
    assert [atlas.unpack(i).resolution for i in atlas.indices] == [(4, 4, 4)] * 3


@pytest.mark.parametrize(("field", "value"), [("corner", 3), ("corner", [0, 0, 0]), ("page", [0]), ("shape", [4, 4])])
def test_a_block_in_the_json_of_an_image_has_the_shape_of_its_dtype(tmp_path, field, value):
    path = tmp_path / "atlas.png"
    fb.pack(cubes(1, 5), page_size=32, encoding="snorm8").save(path)
    beside = tmp_path / "atlas.png.json"
    facts = json.loads(beside.read_text(encoding="utf-8"))
    assert {"page", "corner", "tile", "columns", "gutter", "shape"} <= facts["volumes"][0].keys()
    facts["volumes"][0][field] = value
    beside.write_text(json.dumps(facts), encoding="utf-8")

    with pytest.raises(fb.FormatError):
        fb.load(path)
