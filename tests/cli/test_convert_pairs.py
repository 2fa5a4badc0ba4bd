"""Every pair of formats that `fieldbake convert` offers: a file passes through both and comes back."""

from itertools import product

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
from fieldbake.cli.application import app
from fieldbake.cli.commands import MESHES
from fieldbake.files.registry import ENDINGS

pytestmark = pytest.mark.slow

FIELDS = ENDINGS["volume"]
LEVEL_SETS = (".vdb", ".nvdb")


def convert(*arguments):
    result = CliRunner().invoke(app, ["convert", "-q", *map(str, arguments)], prog_name="fieldbake")
    assert result.exit_code == 0, result.stderr


@pytest.fixture(scope="module")
def volume():
    """A field without symmetry, with oblong sides and a box far from the origin."""
    shape = fb.box((2, 1, 0.5)).rotate("z", 20) | fb.sphere(0.3).translate((0.9, 0.4, 0.3))
    return fb.bake(shape.translate((5, -3, 2)), (14, 11, 9))


@pytest.fixture(scope="module")
def folder(volume, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    volume.save(folder / "v.npz")
    for ending in FIELDS:
        convert(folder / "v.npz", folder / f"first{ending}")
    return folder


@pytest.mark.parametrize("first", FIELDS)
def test_fields_pass_through_every_pair(first, volume, folder, tmp_path):
    for second in FIELDS:
        convert(folder / f"first{first}", tmp_path / f"second{second}")
        convert(tmp_path / f"second{second}", tmp_path / "back.npz")
        back = fb.load(tmp_path / "back.npz")
        assert back.resolution == volume.resolution
        assert np.abs(back.bounds - volume.bounds).max() <= 1e-6
        band = 3 * np.float32(volume.spacing.max()) if {first, second} & set(LEVEL_SETS) else np.float32(np.inf)
        wanted = np.clip(volume.distances, -band, band)
        # Level sets in OpenVDB's float32 have the band rounded once.
        assert np.abs(back.distances - wanted).max() <= (1e-6 if np.isfinite(band) else 0), (first, second)


@pytest.mark.parametrize("encoding", ["float16", "snorm16", "snorm8", "unorm8"])
def test_encodings_of_textures_are_kept(encoding, volume, folder, tmp_path):
    convert(folder / "v.npz", tmp_path / "a.ktx2", "--encoding", encoding)
    convert(tmp_path / "a.ktx2", tmp_path / "b.dds")
    first, second = (fb.load(tmp_path / name) for name in ("a.ktx2", "b.dds"))
    assert np.array_equal(first.distances, second.distances)
    if encoding != "unorm8":
        assert first.encoding == second.encoding == encoding
    near = np.abs(volume.distances) < 3.9 * volume.spacing.max()
    # Half a step of bytes about the middle, or one step rounded toward zero.
    bound = {"float16": 2e-3, "snorm16": 4 / 32767, "snorm8": 4 / 127, "unorm8": 2 / 127.5}[encoding]
    scale = volume.spacing.max() * (4 if encoding == "float16" else 1)
    assert np.abs(first.distances - volume.distances)[near].max() <= bound * scale * 1.001


def test_half_floats_of_sheets_are_kept(volume, folder, tmp_path):
    convert(folder / "v.npz", tmp_path / "a.exr", "--encoding", "float16")
    convert(tmp_path / "a.exr", tmp_path / "b.exr")
    first, second = (fb.load(tmp_path / name) for name in ("a.exr", "b.exr"))
    assert first.encoding == second.encoding == "float16"
    assert np.array_equal(first.distances, second.distances)
    assert (tmp_path / "a.exr").stat().st_size == (tmp_path / "b.exr").stat().st_size


def test_sparse_fields_become_every_format(volume, tmp_path):
    volume.to_sparse(band=3).save(tmp_path / "s.npz")
    for ending in FIELDS:
        convert(tmp_path / "s.npz", tmp_path / f"t{ending}")
        found = fb.load(tmp_path / f"t{ending}")
        near = np.abs(volume.distances) < 2 * volume.spacing.max()
        found = found.to_volume() if isinstance(found, fb.SparseVolume) else found
        assert np.array_equal(found.distances[near], volume.distances[near]), ending


def test_fields_become_meshes_and_meshes_pass_through_every_pair(volume, folder, tmp_path):
    for first, ending in product(FIELDS, MESHES):
        convert(folder / f"first{first}", tmp_path / f"m{ending}")
    # The last of them came from the last format; a loaded field has no exact source for its edges.
    exact = fb.load(folder / f"first{FIELDS[-1]}").to_mesh()
    for first, second in product(MESHES, MESHES):
        convert(tmp_path / f"m{first}", tmp_path / f"n{second}")
        found = fb.load_mesh(tmp_path / f"n{second}")
        # STL and GLB are float32, 3MF and OBJ decimal.
        assert found.volume == pytest.approx(exact.volume, rel=1e-4)
        assert np.abs(found.bounds - exact.bounds).max() <= 1e-5


@pytest.mark.parametrize("encoding", ["float32", "snorm16"])
def test_atlases_pass_through_every_pair(encoding, volume, tmp_path):
    atlas = fb.pack([volume, volume], page_size="fit", encoding=encoding)
    for first, second in product(ENDINGS["atlas"], ENDINGS["atlas"]):
        atlas.save(tmp_path / f"a{first}")
        convert(tmp_path / f"a{first}", tmp_path / f"b{second}")
        found = fb.load(tmp_path / f"b{second}")
        # A PNG has 16 bits for the largest distance.
        step = np.abs(volume.distances).max() / 32767 if ".png" in (first, second) else 0
        for i in range(2):
            assert np.abs(found.unpack(i).distances - atlas.unpack(i).distances).max() <= 1.01 * step, (first, second)
