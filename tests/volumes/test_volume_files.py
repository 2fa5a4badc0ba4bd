"""The .npz file of a volume: bits, errors for damaged and hostile files, no unpickling."""

import io
import json
import os
import pickle
import struct
import zipfile

import numpy as np
import pytest

import fieldbake as fb
import meshes

SHAPE = (9, 7, 5)


def test_save_and_load_give_the_same_bits(tmp_path):
    volume = fb.bake(meshes.open_box(), resolution=(9, 10, 11), bounds=[(-1 / 3, -2, -3), (1, 2, 1e6)])
    volume.save(tmp_path / "box.npz")

    loaded = fb.load(tmp_path / "box.npz")

    assert loaded.distances.tobytes() == volume.distances.tobytes()
    assert np.array_equal(loaded.bounds, volume.bounds)
    assert np.array_equal(loaded.inner_bounds, volume.inner_bounds)
    assert loaded.report == volume.report
    assert loaded.distances.strides == volume.distances.strides


def test_plain_numpy_reads_the_file(sphere, tmp_path):
    sphere.save(tmp_path / "sphere.npz")

    with np.load(tmp_path / "sphere.npz", allow_pickle=False) as archive:
        assert np.array_equal(archive["distances"], sphere.distances)


@pytest.mark.parametrize("kind", [str, lambda path: path], ids=["str", "Path"])
def test_paths_of_any_kind(sphere, tmp_path, kind):
    sphere.save(kind(tmp_path / "sphere.npz"))

    assert fb.load(kind(tmp_path / "sphere.npz")).resolution == sphere.resolution


def test_another_ending_is_refused(sphere, tmp_path):
    with pytest.raises(fb.FormatError, match=r"\.npz"):
        sphere.save(tmp_path / "sphere.png")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_file_or_folder_stays_missing(sphere, tmp_path):
    with pytest.raises(FileNotFoundError):
        fb.load(tmp_path / "nowhere.npz")
    with pytest.raises(FileNotFoundError):
        sphere.save(tmp_path / "nowhere" / "sphere.npz")


@pytest.mark.parametrize("broken", ["fsync", "replace"])
def test_a_failed_save_leaves_the_old_file_and_no_litter(sphere, tmp_path, monkeypatch, broken):
    path = tmp_path / "sphere.npz"
    sphere.save(path)
    before = path.read_bytes()

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, broken, fail)
    with pytest.raises(OSError, match="No space left"):
        fb.Volume(np.zeros((3, 3, 3)), [(0, 0, 0), (1, 1, 1)]).save(path)

    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_saving_over_a_file_replaces_it(sphere, noise, tmp_path):
    sphere.save(tmp_path / "v.npz")
    noise.save(tmp_path / "v.npz")

    assert fb.load(tmp_path / "v.npz").resolution == SHAPE


def members_of(path):
    with zipfile.ZipFile(path) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def write_archive(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def npy(array, **options):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), **options)
    return stream.getvalue()


def with_header(members, **changes):
    """The members with facts of their header replaced, or removed where None."""
    header = json.loads(str(np.load(io.BytesIO(members["header.npy"]))))
    header.update(changes)
    header = {name: value for name, value in header.items() if value is not None}
    return {**members, "header.npy": npy(json.dumps(header))}


class Trap:
    """Pickled into a file, this would leave a mark when read."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (str(self.mark),)


HOSTILE = {
    "no header": lambda m: {"distances.npy": m["distances.npy"]},
    "no distances": lambda m: {"header.npy": m["header.npy"]},
    "header is a number": lambda m: {**m, "header.npy": npy(3.0)},
    "header is a list": lambda m: {**m, "header.npy": npy(json.dumps([1]))},
    "header is no JSON": lambda m: {**m, "header.npy": npy("{")},
    "header nested a million deep": lambda m: {**m, "header.npy": npy("[" * 1_000_000)},
    "header of another program": lambda m: with_header(m, format="other"),
    "no format": lambda m: with_header(m, format=None),
    "no version": lambda m: with_header(m, version=None),
    "version is text": lambda m: with_header(m, version="1"),
    "version 0": lambda m: with_header(m, version=0),
    "another kind": lambda m: with_header(m, kind="mystery"),
    "no bounds": lambda m: with_header(m, bounds=None),
    "bounds upside down": lambda m: with_header(m, bounds=[[1, 1, 1], [0, 0, 0]]),
    "bounds of text": lambda m: with_header(m, bounds="far"),
    "bounds not finite": lambda m: with_header(m, bounds=[[0, 0, 0], [1, 1, float("inf")]]),
    "bounds of three corners": lambda m: with_header(m, bounds=[[0, 0, 0]] * 3),
    "resolution does not fit": lambda m: with_header(m, resolution=[1, 2, 3]),
    "report of a wrong kind": lambda m: with_header(m, report=[1, 2]),
    "fact of a wrong kind": lambda m: with_header(m, report={"closed": "yes"}),
    "distances in double": lambda m: {**m, "distances.npy": npy(np.zeros((9, 7, 5)))},
    "distances in the plane": lambda m: {**m, "distances.npy": npy(np.zeros((9, 35), np.float32))},
    "distances of another shape": lambda m: {**m, "distances.npy": npy(np.zeros((5, 7, 9), np.float32))},
    "distances not finite": lambda m: {**m, "distances.npy": npy(np.full(SHAPE, np.nan, np.float32, order="F"))},
    "a distance beyond the range": lambda m: {**m, "distances.npy": npy(np.full(SHAPE, 3e38, np.float32, order="F"))},
    "more bytes than the shape says": lambda m: {**m, "distances.npy": m["distances.npy"] + b"\0" * 400},
    "fewer bytes than the shape says": lambda m: {**m, "distances.npy": m["distances.npy"][:-400]},
    "no array at all": lambda m: {**m, "distances.npy": b"hello"},
    "a shape that overflows": lambda m: {
        **m,
        "distances.npy": m["distances.npy"].replace(b"(9, 7, 5)", b"(%d,%d,4)" % (2**31, 2**31)),
    },
}


@pytest.fixture
def good_members(noise, tmp_path):
    noise.save(tmp_path / "good.npz")
    return members_of(tmp_path / "good.npz")


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_is_wrong_inside(good_members, tmp_path, name):
    path = tmp_path / "hostile.npz"
    write_archive(path, HOSTILE[name](good_members))

    with pytest.raises(fb.FormatError, match=r"hostile\.npz"):
        fb.load(path)


def test_the_rewritten_file_is_good_otherwise(good_members, tmp_path, noise):
    write_archive(tmp_path / "same.npz", with_header(good_members))

    assert np.array_equal(fb.load(tmp_path / "same.npz").distances, noise.distances)


def test_a_newer_version_says_so(good_members, tmp_path):
    write_archive(tmp_path / "new.npz", with_header(good_members, version=1_000))

    with pytest.raises(fb.FormatError, match=r"version 1000.*newer"):
        fb.load(tmp_path / "new.npz")


@pytest.mark.parametrize("member", ["header.npy", "distances.npy", "extra.npy"])
def test_nothing_is_ever_unpickled(good_members, tmp_path, member):
    mark = tmp_path / "mark"
    trapped = np.empty(1, object)
    trapped[0] = Trap(mark)
    write_archive(tmp_path / "trap.npz", {**good_members, member: npy(trapped, allow_pickle=True)})

    try:
        fb.load(tmp_path / "trap.npz")
    except fb.FormatError:
        pass
    else:
        assert member == "extra.npy"  # not read, so harmless
    assert not mark.exists()


def test_a_pickle_instead_of_an_archive(tmp_path):
    mark = tmp_path / "mark"
    (tmp_path / "trap.npz").write_bytes(pickle.dumps(Trap(mark)))

    with pytest.raises(fb.FormatError):
        fb.load(tmp_path / "trap.npz")
    assert not mark.exists()


def test_a_zip_bomb_is_not_unfolded(good_members, tmp_path):
    path = tmp_path / "bomb.npz"
    huge = npy(np.zeros((512, 512, 128), np.float32))  # 128 MiB, 130 KiB when packed
    write_archive(
        path, {**with_header(good_members, resolution=[512, 512, 128]), "distances.npy": huge}, zipfile.ZIP_DEFLATED
    )

    with pytest.raises(fb.FormatError, match="compressed"):
        fb.load(path)


def test_a_directory_that_lies_about_sizes(good_members, tmp_path):
    path = tmp_path / "liar.npz"
    write_archive(path, good_members)
    content = bytearray(path.read_bytes())
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 20 : entry + 28] = struct.pack("<II", 2**31, 2**31)
    path.write_bytes(content)

    with pytest.raises(fb.FormatError):
        fb.load(path)


@pytest.mark.parametrize("length", [0, 1, 30, 100, 1_000, -1, -20, -200])
def test_a_truncated_file(good_members, tmp_path, length):
    path = tmp_path / "cut.npz"
    write_archive(path, good_members)
    path.write_bytes(path.read_bytes()[:length])

    with pytest.raises(fb.FormatError, match=r"cut\.npz"):
        fb.load(path)


def test_a_flipped_bit_among_the_samples(good_members, tmp_path):
    path = tmp_path / "flipped.npz"
    write_archive(path, good_members)
    content = bytearray(path.read_bytes())
    content[content.index(b"(9, 7, 5)") + 300] ^= 1
    path.write_bytes(content)

    with pytest.raises(fb.FormatError, match=r"flipped\.npz"):
        fb.load(path)


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"v 0 0 0\n", b"PK\x05\x06" + b"\x00" * 18])
@pytest.mark.parametrize("name", ["other.npz", "other.obj", "other"])
def test_a_file_of_something_else(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)

    with pytest.raises(fb.FormatError, match=name):
        fb.load(tmp_path / name)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(fb.FormatError, match="directory"):
        fb.load(tmp_path)


def test_quantized_and_sparse_samples_beyond_the_range_are_refused(sphere, tmp_path):
    sphere.quantize("float16").save(tmp_path / "half.npz")
    half = members_of(tmp_path / "half.npz")
    write_archive(tmp_path / "half.npz", with_header(half, scale=1e37))
    with pytest.raises(fb.FormatError, match=r"half\.npz"):
        fb.load(tmp_path / "half.npz")

    sphere.to_sparse().save(tmp_path / "sparse.npz")
    sparse = members_of(tmp_path / "sparse.npz")
    bricks = np.load(io.BytesIO(sparse["bricks.npy"])).astype(np.float32)
    bricks[0, 0, 0, 0] = 3e38
    write_archive(tmp_path / "sparse.npz", {**sparse, "bricks.npy": npy(bricks)})
    with pytest.raises(fb.FormatError, match=r"the bricks must be finite and at most 1e\+37 from 0, got .* to 3e\+38"):
        fb.load(tmp_path / "sparse.npz")
