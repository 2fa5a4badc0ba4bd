"""NRRD files beside pynrrd, and NRRD files of other programs: types, axes, ranges, ends of lines, errors."""

import numpy as np
import pytest

import fieldbake as fb

#: A header without its last, empty line.
NRRD_HEAD = "NRRD0005\ntype: float\ndimension: 3\nsizes: 2 2 2\nendian: little\nencoding: raw\n"


def test_pynrrd_reads_a_nrrd_file(solid, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    for compression in ("zip", "none"):
        solid.save(tmp_path / "v.nrrd", compression=compression)
        samples, header = nrrd.read(str(tmp_path / "v.nrrd"), index_order="F")
        assert np.array_equal(samples, solid.distances)
        assert np.array_equal(header["space origin"], solid.origin)
        assert np.array_equal(np.diag(header["space directions"]), solid.spacing)


@pytest.mark.parametrize("kind", ["<f8", ">f4", "<i2"])
def test_a_nrrd_file_of_another_program_is_read(kind, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    samples = np.arange(60, dtype=kind).reshape(3, 4, 5)
    header = {"spacings": [1.0, 2.0, 0.5], "axis mins": [1, 2, 3], "centerings": ["node"] * 3, "encoding": "gzip"}
    nrrd.write(str(tmp_path / "v.nrrd"), samples, header)
    found = fb.Volume.load(tmp_path / "v.nrrd")
    assert np.array_equal(found.distances, samples)
    assert np.array_equal(found.origin, [1, 2, 3])
    assert np.array_equal(found.spacing, [1, 2, 0.5])


@pytest.mark.parametrize("kind", ["float <f4", "longlong <i8", "uint64 <u8"])
@pytest.mark.parametrize("line", ["\n", "\r\n"])
def test_lines_of_windows_and_64_bit_integers_in_a_nrrd_file(line, kind, tmp_path):
    name, dtype = kind.split()
    # The first bytes of the samples are ends of lines too.
    samples = np.array([0x0A0A0D, 1, 2, 3, 4, 5, 6, 7], dtype).reshape(2, 2, 2)
    head = (NRRD_HEAD.replace("float", name) + "\n").replace("\n", line).encode()
    (tmp_path / "v.nrrd").write_bytes(head + samples.tobytes())
    assert np.array_equal(fb.load(tmp_path / "v.nrrd").distances, samples.T.astype(np.float32))


@pytest.mark.parametrize("end", ["", "\n", "\n\n"])
@pytest.mark.parametrize(
    ("head", "message"),
    [
        (NRRD_HEAD + "data file: d.raw", "must be in the file itself"),
        (NRRD_HEAD.replace("float", "block").rstrip(), "got the type 'block' and the dimension '3'"),
    ],
)
def test_other_samples_of_a_nrrd_file_are_errors_that_name_them(head, message, end, tmp_path):
    (tmp_path / "v.nrrd").write_text(head + end)
    with pytest.raises(fb.FormatError, match=message):
        fb.load(tmp_path / "v.nrrd")


@pytest.mark.parametrize(("centers", "spacing", "first"), [("cell", 2.0, 1.0), ("node", 4.0, 0.0)])
@pytest.mark.parametrize("names", [("axis mins", "axis maxs", "centers"), ("axismins", "axismaxs", "centerings")])
def test_nrrd_files_may_state_the_range_of_each_axis(names, centers, spacing, first, tmp_path):
    values = " ".join([centers] * 3)
    header = f"NRRD0004\ntype: float\ndimension: 3\nsizes: 2 3 4\nendian: little\nencoding: raw\n{names[0]}: 0 0 0\n"
    maxs = "4 6 8" if centers == "cell" else "4 8 12"
    header += f"{names[1]}: {maxs}\n{names[2]}: {values}\n\n"
    (tmp_path / "a.nrrd").write_bytes(header.encode() + np.arange(24, dtype="<f4").tobytes())

    volume = fb.load(tmp_path / "a.nrrd")

    assert volume.spacing.tolist() == [spacing] * 3
    assert volume.origin.tolist() == [first] * 3


@pytest.mark.parametrize(
    "directions",
    [
        np.diag([0.7, -0.7, 1.5]),
        np.diag([-0.7, -0.6, -1.5]),
        np.array([[0, 0, 1.5], [-0.7, 0, 0], [0, 0.6, 0]]),
    ],
)
def test_axes_of_a_nrrd_file_that_point_backwards_or_are_exchanged_are_turned(directions, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    samples = np.random.default_rng(1).normal(size=(3, 4, 5)).astype(np.float32)
    origin = np.array([10.0, 20.0, 30.0])
    header = {"space": "left-posterior-superior", "space directions": directions, "space origin": origin}
    nrrd.write(str(tmp_path / "ct.nrrd"), samples, header)
    volume = fb.load(tmp_path / "ct.nrrd")
    assert np.allclose(volume.spacing, np.abs(directions).max(axis=0), rtol=1e-12)
    # Each sample lies where the header of the file puts it.
    index = np.argwhere(np.ones(samples.shape, bool))
    found = volume.sample(origin + index @ directions, filter="nearest")
    assert np.array_equal(found, samples.reshape(-1))


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        ("(0.7,0.1,0) (0,0.7,0) (0,0,1.5)", "rotated or sheared; resample it"),
        ("(0.7,0,0) (0,0,0) (0,0,1.5)", "sizes other than 0"),
        ("(0.7,0,0) (0,0.7,0)", "three space directions"),
        ("none (0.7,0,0) (0,0.7,0) (0,0,1)", "numbers|dimensions"),
    ],
)
def test_other_axes_of_a_nrrd_file_are_errors(directions, message, tmp_path):
    sizes = "2 2 2" if directions[0] == "(" else "1 2 2 2"
    head = f"NRRD0004\ntype: uchar\ndimension: {len(sizes.split())}\nspace: right-anterior-superior\nsizes: {sizes}\n"
    head += f"space directions: {directions}\nencoding: raw\nspace origin: (0,0,0)\n\n"
    (tmp_path / "ct.nrrd").write_bytes(head.encode() + bytes(8))
    with pytest.raises(fb.FormatError, match=message):
        fb.load(tmp_path / "ct.nrrd")
