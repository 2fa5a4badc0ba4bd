"""Stores that hold other data, and stores of which a part is lost: nothing foreign is deleted, every loss is found."""

import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb

zarr = pytest.importorskip("zarr")


@pytest.fixture(scope="module")
def mesh():
    return fb.models.torus_knot(segments=48, sides=6)


@pytest.fixture(scope="module")
def finished(mesh, tmp_path_factory):
    path = tmp_path_factory.mktemp("stores") / "knot.zarr"
    bake(path, mesh)
    return path


@pytest.fixture
def store(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "knot.zarr"))


def bake(store, mesh, **options):
    return fb.bake_to_zarr(mesh, store, 40, **{"shard": 16, "chunk": 8, **options})


def contents(folder):
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def plain_folder(path):
    (path / "sub").mkdir(parents=True)
    (path / "thesis.txt").write_text("years of work")
    (path / "sub" / "b").write_text("more work")


def group_of_version_2(path):
    zarr.open_group(path, mode="w", zarr_format=2).create_array("a", data=np.arange(3))


def single_scale_image(path):
    zarr.open_group(path, mode="w").create_array("0", data=np.arange(8).reshape(2, 2, 2))


def group_with_attributes(path):
    zarr.open_group(path, mode="w", attributes={"author": "someone"})


def array(path):
    zarr.create_array(path, data=np.arange(4))


@pytest.mark.parametrize("resume", [True, False])
@pytest.mark.parametrize("make", [plain_folder, group_of_version_2, single_scale_image, group_with_attributes, array])
def test_other_contents_are_an_error_and_stay(mesh, tmp_path, make, resume):
    make(tmp_path / "s.zarr")
    before = contents(tmp_path)
    with pytest.raises(fb.FormatError, match="other contents"):
        bake(tmp_path / "s.zarr", mesh, resume=resume)
    assert contents(tmp_path) == before


def test_a_file_and_a_file_above_the_path_are_errors(mesh, tmp_path):
    (tmp_path / "notes.txt").write_text("notes")
    for path in ("notes.txt", "notes.txt/s.zarr"):
        with pytest.raises(fb.FormatError, match="other contents"):
            bake(tmp_path / path, mesh)
    assert contents(tmp_path) == {"notes.txt": b"notes"}


@pytest.mark.parametrize("options", [{}, {"resume": False}])
def test_empty_folders_and_empty_groups_are_used(mesh, tmp_path, options):
    (tmp_path / "folder.zarr").mkdir()
    zarr.open_group(tmp_path / "group.zarr", mode="w")
    for name in ("folder.zarr", "group.zarr"):
        bake(tmp_path / name, mesh, **options)
        assert "fieldbake_unfinished" not in zarr.open_group(tmp_path / name, mode="r").attrs
        assert fb.open_zarr(tmp_path / name).resolution[1] == 40


#: A bake that is killed when it creates its array number n.
KILLED = """
import os, sys, zarr, fieldbake as fb
create, left = zarr.Group.create_array, int(sys.argv[2])
def create_array(self, *arguments, **options):
    global left
    left -= 1
    if left < 0:
        data = options.pop("data", None)
        if data is not None:
            options.update(shape=data.shape, dtype=data.dtype)
        create(self, *arguments, **options)
        os._exit(9)
    return create(self, *arguments, **options)
zarr.Group.create_array = create_array
knot = fb.models.torus_knot(segments=48, sides=6)
fb.bake_to_zarr(knot, sys.argv[1], 40, shard=16, chunk=8)
"""


@pytest.mark.parametrize("arrays", [0, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 4))])
def test_a_bake_that_was_killed_while_it_planned_is_completed(mesh, finished, tmp_path, arrays):
    command = [sys.executable, "-c", KILLED, os.fspath(tmp_path / "knot.zarr"), str(arrays)]
    assert subprocess.run(command, check=False).returncode == 9
    with pytest.raises(fb.FormatError, match=r"missing|not complete|not written"):
        fb.open_zarr(tmp_path / "knot.zarr").distances  # noqa: B018
    bake(tmp_path / "knot.zarr", mesh)
    assert contents(tmp_path / "knot.zarr") == contents(finished)


def chunks(store, path):
    return [file for file in (store / path).rglob("*") if file.is_file() and "c" in file.relative_to(store).parts]


def read_all(store):
    volume = fb.open_zarr(store)
    return volume.mesh, volume.distances


@pytest.mark.parametrize("loss", ["deleted", "damaged"])
@pytest.mark.parametrize("path", ["far/states/0", "far/distances", "mesh/vertices", "mesh/faces"])
def test_lost_chunks_are_errors_and_are_written_again(mesh, finished, store, path, loss):
    for file in chunks(store, path):
        if loss == "deleted":
            file.unlink()
        else:
            file.write_bytes(b"noise")
    with pytest.raises(fb.FormatError, match=r"missing|not complete|damaged"):
        read_all(store)
    bake(store, mesh)
    assert contents(store) == contents(finished)


def test_shards_that_turned_out_to_be_outside_are_not_computed_again(mesh, tmp_path):
    shares = []
    options = {"sign": "parity", "bounds": [(-9,) * 3, (9,) * 3], "shard": 8}
    bake(tmp_path / "k.zarr", mesh, progress=shares.append, **options)
    assert len(shares) > 1
    before = contents(tmp_path / "k.zarr")
    states = zarr.open_group(tmp_path / "k.zarr", mode="r")["far/states/0"][...]
    assert 0 < states.sum() < states.size
    shares.clear()
    bake(tmp_path / "k.zarr", mesh, progress=shares.append, executor=NoExecutor(), **options)
    assert contents(tmp_path / "k.zarr") == before


#: A bake that waits after its first shards, so that a signal arrives before its end.
SLOW = """
import signal, sys, time, fieldbake as fb
signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell ignore the signal
knot = fb.models.torus_knot(segments=48, sides=6)
def report(share):
    print(share, flush=True)
    time.sleep(1)
fb.bake_to_zarr(knot, sys.argv[1], 40, shard=8, chunk=8, threads=1, progress=report)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs SIGINT")
def test_an_interrupted_bake_leaves_a_store_that_resumes(mesh, tmp_path):
    target = tmp_path / "knot.zarr"
    command = [sys.executable, "-c", SLOW, os.fspath(target)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in errors
    shards = {key for key in contents(target) if key.startswith("0/c/")}
    assert shards
    times = {key: (target / key).stat().st_mtime_ns for key in shards}
    bake(target, mesh, shard=8)
    bake(tmp_path / "whole" / "knot.zarr", mesh, shard=8)
    assert contents(target) == contents(tmp_path / "whole" / "knot.zarr")
    assert len(contents(target)) > len(times)
    assert {key: (target / key).stat().st_mtime_ns for key in shards} == times


class NoExecutor:
    """An executor that accepts no task."""

    def submit(self, *_):
        raise AssertionError("there is nothing to do")


def memory_stores():
    url = "memory://unshared-"
    yield zarr.storage.LoggingStore(zarr.storage.MemoryStore())
    yield zarr.storage.FsspecStore.from_url(url + "fsspec")
    yield f"simplecache::{url}chained"
    yield url + "plain"


def test_memory_in_any_form_is_not_shared_with_processes(mesh):
    with ProcessPoolExecutor(1) as executor:
        for memory in memory_stores():
            with pytest.raises(fb.ArgumentError, match="executor: its processes cannot see"):
                bake(memory, mesh, executor=executor)


def test_stores_around_native_objects_are_used(mesh, tmp_path):
    local = zarr.storage.LocalStore(tmp_path / "native.zarr")
    # Some stores keep an object without attributes, such as one of Rust.
    local._store = object()
    assert bake(local, mesh).resolution is not None


def test_urls_of_local_files_are_paths(mesh, tmp_path):
    for scheme in ("file", "local"):
        path = tmp_path / f"{scheme}.zarr"
        bake(f"{scheme}://{path}", mesh)
        assert fb.open_zarr(path).resolution == fb.open_zarr(f"{scheme}://{path}").resolution


def test_stores_that_cannot_be_opened_are_errors_of_the_argument(mesh, tmp_path):
    for store in ("foo://x", "simplecache::foo://x"):
        with pytest.raises(fb.ArgumentError, match=f"store: {store} cannot be opened"):
            bake(store, mesh)
    with pytest.raises(fb.ArgumentError, match="storage_options: apply to URLs"):
        bake(tmp_path / "s.zarr", mesh, storage_options={"key": "test"})
    with pytest.raises(fb.ArgumentError, match=r"store: .*z\.zip"):
        bake(zarr.storage.ZipStore(tmp_path / "z.zip", mode="w"), mesh)


def test_shards_that_are_lost_after_the_first_read_are_errors(store):
    volume = fb.open_zarr(store)
    assert np.asarray(volume).shape == volume.resolution
    key = "0/c/0/0/0"
    (store / key).unlink()
    with pytest.raises(fb.FormatError, match=f"shard {key} of .* is missing"):
        volume[0:8, 0:8, 0:8]


def test_missing_shards_are_no_fill_values_in_xarray(store):
    pytest.importorskip("xarray")
    (store / "0/c/0/1/1").unlink()
    with pytest.raises(fb.FormatError, match=r"shard 0/c/0/1/1 of .* is missing"):
        fb.open_zarr(store).to_xarray()


def test_another_version_bakes_no_shards_of_a_store(mesh, store):
    group = zarr.open_group(store, mode="r+")
    group.attrs.update({"fieldbake": {**group.attrs["fieldbake"], "version": "0.0.1"}})
    assert bake(store, mesh).resolution == fb.open_zarr(store).resolution
    (store / "0/c/0/0/0").unlink()
    with pytest.raises(fb.ArgumentError, match=r"begun by fieldbake 0\.0\.1.*resume=False"):
        bake(store, mesh)


def test_progress_reaches_1_when_nothing_is_left(mesh, store):
    shares = []
    bake(store, mesh, progress=shares.append)
    assert shares == [1.0]


@pytest.mark.parametrize(("encoding", "band"), [("float16", 8.5001), ("snorm8", 8.51)])
def test_near_shards_are_written_though_their_samples_round_to_the_fill_value(tmp_path, encoding, band):
    box = fb.box((1, 1, 1)).to_mesh(8)
    bounds = [(-1,) * 3, (1,) * 3]
    volume = fb.bake_to_zarr(
        box, tmp_path / "b.zarr", 64, band=band, shard=8, chunk=8, bounds=bounds, encoding=encoding
    )
    distances = fb.bake(volume.mesh, 64, bounds=bounds).distances
    near = (np.abs(distances).reshape((8, 8) * 3) < np.float32(volume.band)).any(axis=(1, 3, 5))
    found = {key for key in contents(tmp_path / "b.zarr") if key.startswith("0/c/")}
    assert found >= {f"0/c/{z}/{y}/{x}" for x, y, z in np.argwhere(near).tolist()}
    assert np.abs(volume.distances - distances.clip(-volume.band, volume.band)).max() <= 0.01 * volume.band


def test_pictures_keep_their_bricks(store, monkeypatch):
    volume = fb.open_zarr(store)
    first = volume.picture_field()
    assert volume.picture_field() is first
    page = volume.to_html(size=(64, 48))
    assert "<canvas" in page or "<script" in page
