"""Damaged Zarr stores: every method that reads gives finite values or an error of fieldbake."""

import json

import numpy as np
import pytest

import fieldbake as fb
from damage import damage_store

zarr = pytest.importorskip("zarr")

POINTS = np.random.default_rng(3).uniform(-3, 3, (200, 3))


def bake(path, encoding):
    fb.bake_to_zarr(fb.models.torus_knot(segments=48, sides=6), path, 70, shard=32, chunk=16, encoding=encoding)
    return path


@pytest.fixture(scope="module", params=["snorm16", "float32", "float16"])
def store(request, tmp_path_factory):
    return bake(tmp_path_factory.mktemp("damaged") / "knot.zarr", request.param)


@pytest.fixture(scope="module")
def integers(tmp_path_factory):
    """A store of snorm16 samples."""
    return bake(tmp_path_factory.mktemp("damaged") / "knot.zarr", "snorm16")


def read_all(store):
    """Call all methods that read; check that values are finite."""
    volume = fb.open_zarr(store)
    assert repr(volume)
    assert len(volume.mesh.faces)
    for points in (POINTS, volume.mesh.vertices[:200]):
        for filter in ("linear", "nearest"):
            assert np.isfinite(volume.sample(points, filter=filter)).all()
        assert np.isfinite(volume.gradient(points)).all()
    for level in range(len(volume.levels)):
        assert np.isfinite(volume.window(volume.bounds, level=level).distances).all()
    assert np.isfinite(volume.to_sparse(level=1).sample(POINTS)).all()
    assert np.isfinite(volume.to_mesh(sharp=False).vertices).all()
    volume[0:8, 0:8, 0:8].to_mesh()


def assert_only_own_errors(store, seeds):
    refused = 0
    for seed in seeds:
        what, restore = damage_store(store, np.random.default_rng(seed))
        try:
            read_all(store)
        except fb.Error:
            refused += 1
        except BaseException as error:
            error.add_note(f"seed {seed}: {what}")
            raise
        finally:
            restore()
    return refused


def test_an_intact_store_is_read(store):
    read_all(store)


def test_a_store_without_its_root_is_damaged(tmp_path):
    path = bake(tmp_path / "knot.zarr", "float32")
    (path / "zarr.json").unlink()
    with pytest.raises(fb.FormatError, match=r"without zarr\.json"):
        fb.open_zarr(path)


def test_damaged_stores_raise_only_errors_of_fieldbake(store):
    assert assert_only_own_errors(store, range(40)) >= 12


@pytest.mark.slow
def test_two_thousand_damaged_stores_raise_only_errors_of_fieldbake(store):
    assert_only_own_errors(store, range(2000))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda facts: facts["inner"][1].__setitem__(0, float("nan")), "inner: must be finite"),
        (lambda facts: facts["lower"].__setitem__(2, float("inf")), "lower, upper: must be finite"),
        (lambda facts: facts["shape"].__setitem__(0, 0), "shape: must be from 1"),
        (lambda facts: facts.update(shape=[10**18] * 3), "shape: must be from 1"),
        (lambda facts: facts.update(band=float("nan")), "band: must be a finite number"),
        (lambda facts: facts.update(chunk=5), "chunk: must divide shard"),
        (lambda facts: facts.update(encoding="bc4"), "encoding: must be one of"),
        (lambda facts: facts.update(shard=64), r"0 has the shards \(32, 32, 32\), not \(64, 64, 64\)"),
        (lambda facts: facts["shape"].__setitem__(0, 71), r"0 has the shape"),
        (lambda facts: facts["report"].update(band="wide"), "report.band must be float"),
        (lambda facts: facts.pop("upper"), "'upper'"),
    ],
)
def test_damaged_attributes_are_named(integers, change, message):
    content = (integers / "zarr.json").read_text()
    tree = json.loads(content)
    change(tree["attributes"]["fieldbake"])
    (integers / "zarr.json").write_text(json.dumps(tree))
    try:
        with pytest.raises(fb.FormatError, match=message):
            fb.open_zarr(integers)
        with pytest.raises(fb.Error):
            fb.bake_to_zarr(fb.models.torus_knot(segments=48, sides=6), integers, 70, shard=32, chunk=16)
    finally:
        (integers / "zarr.json").write_text(content)


@pytest.mark.parametrize("path", ["0", "levels/1", "far/distances", "far/states/0", "mesh/vertices"])
@pytest.mark.parametrize(
    ("name", "value"), [("shape", [9, 9, 9]), ("data_type", "complex64"), ("fill_value", "x"), ("codecs", [])]
)
def test_damaged_arrays_are_named(integers, path, name, value):
    file = integers / path / "zarr.json"
    content = file.read_text()
    file.write_text(json.dumps(json.loads(content) | {name: value}))
    try:
        with pytest.raises(fb.FormatError, match=r"knot\.zarr"):
            read_all(integers)
    finally:
        file.write_text(content)


def test_samples_that_are_not_finite_are_an_error(tmp_path):
    mesh = fb.models.torus_knot(segments=48, sides=6)
    fb.bake_to_zarr(mesh, tmp_path / "knot.zarr", 40, shard=16, chunk=8, encoding="float32")
    zarr.open_group(tmp_path / "knot.zarr", mode="r+")["0"][:, :, :16] = np.nan
    with pytest.raises(fb.FormatError, match="not finite"):
        fb.open_zarr(tmp_path / "knot.zarr").sample(mesh.vertices)


def test_a_store_whose_kind_is_damaged_is_not_missing(integers):
    content = (integers / "zarr.json").read_text()
    (integers / "zarr.json").write_text(json.dumps(json.loads(content) | {"node_type": 2**31}))
    try:
        with pytest.raises(fb.FormatError, match="its metadata is damaged"):
            fb.open_zarr(integers)
    finally:
        (integers / "zarr.json").write_text(content)
