"""Data sets and libraries: the same bytes in any process, epochs, folders, caches, ledgers and damaged files."""

import hashlib
import json
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import assets
import fieldbake as fb
import meshes
from digests import digest, digest_of, digest_of_batch

SMALL = {"n": 400, "near_n": 300, "surface_n": 200}

#: How worker processes start.
STARTS = ["spawn", "fork"]


def library():
    return {"box": meshes.box(), "ball": meshes.icosphere(2), "small": assets.box(0.5), "open": meshes.open_box()}


@pytest.fixture
def data():
    return fb.training.Dataset(library(), "vecset", seed=5, **SMALL)


@pytest.fixture
def expected(data):
    return [digest(arrays) for arrays in data]


def test_items_are_the_samples_of_their_seeds(data):
    assert len(data) == 4
    assert data.stems == ["box", "ball", "small", "open"]
    seed = int.from_bytes(hashlib.sha256(b"5/ball/0").digest()[:8], "little")
    direct = fb.training.sample(meshes.icosphere(2), "vecset", seed=seed, **SMALL)
    assert digest(data[1]) == digest(direct) == digest(data[-3])
    assert [digest(one) for one in data.__getitems__([3, 1])] == [digest(data[3]), digest(data[1])]
    with pytest.raises(IndexError):
        data[4]


@pytest.mark.parametrize("start", STARTS)
def test_workers_draw_the_same_bytes(data, expected, start):
    order = [2, 0, 3, 1]
    # Unlike a pool of multiprocessing, this one raises an error if a worker ends.
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(start)) as pool:
        found = list(pool.map(digest_of, [data] * len(order), order))
    assert found == [expected[index] for index in order]


def test_a_sample_depends_on_no_other_item(expected):
    few = fb.training.Dataset({"ball": meshes.icosphere(2)}, "vecset", seed=5, **SMALL)
    assert digest(few[0]) == expected[1]


def test_another_epoch_and_another_seed_differ(data, expected):
    later = data.with_epoch(1)
    assert [digest(one) for one in data] == expected
    found = [digest(one) for one in later]
    assert not set(found) & set(expected)
    assert found == [digest(one) for one in fb.training.Dataset(library(), "vecset", seed=5, epoch=1, **SMALL)]
    assert digest(fb.training.Dataset(library(), "vecset", seed=6, **SMALL)[0]) != expected[0]


def test_pickles(data, expected):
    again = pickle.loads(pickle.dumps(data))
    assert digest(again[1]) == expected[1]
    assert repr(again) == "Dataset(4 items, recipe='vecset', seed=5, epoch=0)"


@pytest.mark.parametrize("out", ["samples", "samples.zarr"])
@pytest.mark.parametrize("recipe", ["deepsdf", "onet", "vecset"])
def test_a_folder_of_samples_is_a_data_set(tmp_path, out, recipe):
    if out.endswith(".zarr"):
        pytest.importorskip("zarr")
    numbers = {"n": 300} if recipe == "deepsdf" else {"n": 300, "surface_n": 100}
    rows = fb.training.sample_many(library(), tmp_path / out, recipe, seed=5, workers=1, **numbers)
    assert [row["error"] for row in rows] == [None] * 4
    drawn = fb.training.Dataset(library(), recipe, seed=5, **numbers)
    found = fb.training.Dataset(tmp_path / out, recipe)
    assert found.stems == sorted(drawn.stems)
    for stem, arrays in zip(found.stems, found, strict=True):
        assert digest(arrays) == digest(drawn[drawn.stems.index(stem)])


def test_hunyuan_and_dora_have_their_own_folders(tmp_path):
    box = {"box": meshes.box()}
    small = {"hunyuan": {"n": 60, "shell_resolution": 32}, "dora": {"n": 200, "surface_n": 300, "uniform_n": 20}}
    for recipe, numbers in small.items():
        (row,) = fb.training.sample_many(box, tmp_path / recipe, recipe, workers=1, **numbers)
        assert row["status"] == "done"
        assert digest(fb.training.Dataset(tmp_path / recipe, recipe)[0]) == digest(
            fb.training.Dataset(box, recipe, **numbers)[0]
        )
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.npz")}
    assert files == {"hunyuan/box/geo_data/box_surface.npz", "hunyuan/box/geo_data/box_sdf.npz", "dora/box.npz"}
    assert row["path"].endswith("box.npz")


def test_a_second_run_skips_and_changes_are_drawn_again(tmp_path):
    def run(items, **options):
        options = {"n": 200, "surface_n": 50, "workers": 1, **options}
        return [row["status"] for row in fb.training.sample_many(items, tmp_path, "onet", **options)]

    items = library()
    assert run(items) == ["done"] * 4
    assert run(items) == ["skipped"] * 4
    items["ball"] = meshes.icosphere(1)
    (tmp_path / "small" / "pointcloud.npz").unlink()
    (tmp_path / "open" / "points.npz").write_bytes(b"half")
    assert run(items) == ["skipped", "done", "done", "done"]
    assert run(items, n=201) == ["done"] * 4
    assert run(items, n=201, seed=1) == ["done"] * 4
    assert run(items, n=201, seed=1, resume=False) == ["done"] * 4
    rows = [json.loads(line) for line in (tmp_path / "ledger.jsonl").read_text().splitlines()]
    assert {row["kind"] for row in rows} == {"onet"}
    assert rows[-1]["report"]["boundary_edges"] == 4
    with pytest.raises(fb.ArgumentError, match=r"box in .* is a result of 'onet', which 'hunyuan' would overwrite"):
        fb.training.sample_many(items, tmp_path, "hunyuan")


def test_broken_items_fail_alone_and_wrong_numbers_before_any_work(tmp_path):
    (tmp_path / "broken.obj").write_text("v 0 0 0\nf 1 1 1\n")
    rows = fb.training.sample_many(
        [tmp_path / "broken.obj", meshes.box()], tmp_path / "out", "deepsdf", n=50, workers=1
    )
    assert [row["status"] for row in rows] == ["failed", "done"]
    assert rows[0]["error"].startswith("MeshError")
    with pytest.raises(fb.ArgumentError, match="points: is no number of the recipe"):
        fb.training.sample_many(library(), tmp_path / "no", "deepsdf", points=5)
    with pytest.raises(fb.ArgumentError, match="n: must be from 1"):
        fb.training.sample_many(library(), tmp_path / "no", "deepsdf", n=0)
    with pytest.raises(fb.ArgumentError, match="format, encoding: do not apply"):
        fb.training.sample_many(library(), tmp_path / "no", "deepsdf", format="vdb")
    assert not (tmp_path / "no").exists()


def test_a_pool_draws_the_same(tmp_path):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        fb.training.sample_many(library(), tmp_path, "deepsdf", seed=5, executor=pool, n=300)
    found = fb.training.Dataset(tmp_path, "deepsdf")
    drawn = fb.training.Dataset(library(), "deepsdf", seed=5, n=300)
    assert digest(found[found.stems.index("ball")]) == digest(drawn[1])


def test_the_cache_keeps_what_was_drawn(tmp_path, expected, monkeypatch):
    from fieldbake.scaling import recipes

    def cached(**options):
        return fb.training.Dataset(library(), "vecset", **{"seed": 5, "cache": tmp_path / "kept", **SMALL, **options})

    assert [digest(one) for one in cached()] == expected
    assert len(list((tmp_path / "kept").iterdir())) == 4
    drawn = []
    draw = recipes.draw
    monkeypatch.setattr(recipes, "draw", lambda *args, **options: drawn.append(1) or draw(*args, **options))
    assert [digest(one) for one in cached()] == expected
    assert not drawn
    for options in ({"epoch": 1}, {"seed": 6}, {"n": 401}):
        cached(**options)[0]
    assert len(drawn) == 3
    kept = next((tmp_path / "kept").glob("box-*"))
    kept.write_bytes(kept.read_bytes()[:100])
    with pytest.raises(fb.FormatError, match="cannot be read as arrays"):
        [cached(**options)[0] for options in ({}, {"epoch": 1}, {"seed": 6}, {"n": 401})]


def test_items_are_files_shapes_as_meshes_and_callables(tmp_path):
    path = assets.write_box(tmp_path / "file.obj", 0.5)
    data = fb.training.Dataset([path, assets.small_box, fb.sphere(1).to_mesh(16)], "deepsdf", n=100)
    assert data.stems == ["file", "small_box", "item-00002"]
    assert all(len(one["pos"]) + len(one["neg"]) == 100 for one in data)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"epoch": -1}, "epoch: must be from 0"),
        ({"seed": 2**64}, "seed: must be from 0"),
        ({"points": 3}, "points: is no number of the recipe 'deepsdf'"),
        ({"cache": 7}, "cache: must be text or a path"),
    ],
)
def test_wrong_arguments_are_named(options, text):
    with pytest.raises(fb.ArgumentError, match=text):
        fb.training.Dataset(library(), "deepsdf", **options)


def test_wrong_items_are_named(tmp_path):
    with pytest.raises(fb.ArgumentError, match="items: keys must be stems"):
        fb.training.Dataset({"a/b": meshes.box()}, "deepsdf")
    with pytest.raises(fb.ArgumentError, match="would both be written"):
        fb.training.Dataset({"a": meshes.box(), "A": meshes.box()}, "deepsdf")
    with pytest.raises(fb.ArgumentError, match="items: must be an iterable"):
        fb.training.Dataset(5, "deepsdf")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        fb.training.Dataset(tmp_path / "none", "deepsdf")
    with pytest.raises(fb.FormatError, match="has no results of the recipe 'deepsdf'"):
        fb.training.Dataset(tmp_path, "deepsdf")


def test_a_folder_has_finished_samples(tmp_path):
    fb.training.sample_many({"box": meshes.box()}, tmp_path, "deepsdf", n=50, workers=1)
    for options in ({"seed": 1}, {"epoch": 1}, {"cache": "kept"}, {"n": 5}):
        with pytest.raises(fb.ArgumentError, match=f"{next(iter(options))}: does not apply to the finished samples"):
            fb.training.Dataset(tmp_path, "deepsdf", **options)
    data = fb.training.Dataset(tmp_path, "deepsdf")
    with pytest.raises(fb.ArgumentError, match="epoch: does not apply to the finished samples"):
        data.with_epoch(1)
    np.savez(tmp_path / "box.npz", pos=np.zeros((2, 4), np.float32))
    with pytest.raises(fb.FormatError, match="the result 'box' has no array 'neg'"):
        data[0]
    (tmp_path / "box.npz").write_bytes(b"PK nothing")
    with pytest.raises(fb.FormatError, match="cannot be read as arrays"):
        data[0]


@pytest.fixture
def torch():
    return pytest.importorskip("torch")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:This DataLoader will create 4 worker processes")  # more than cores, on purpose
@pytest.mark.parametrize(("workers", "start"), [(0, None), (1, "spawn"), (4, "spawn"), (1, "fork"), (4, "fork")])
@pytest.mark.parametrize("shuffle", [False, True])
def test_torch_loads_the_same_bytes(torch, data, expected, workers, start, shuffle):
    loader = torch.utils.data.DataLoader(
        data,
        batch_size=1,
        shuffle=shuffle,
        num_workers=workers,
        multiprocessing_context=start,
        collate_fn=digest_of_batch,
        generator=torch.Generator().manual_seed(0),
    )
    found = list(loader)
    assert sorted(found) == sorted(expected)
    if not shuffle:
        assert found == expected


@pytest.mark.slow
def test_torch_trains_a_network_for_an_epoch(torch, data):
    """A small network on two batches of two meshes; the loss after the epoch is lower than before."""
    loader = torch.utils.data.DataLoader(data, batch_size=2)
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(3, 32), torch.nn.ReLU(), torch.nn.Linear(32, 1))
    optimizer = torch.optim.Adam(network.parameters(), 0.02)

    def loss_of(batch):
        points, labels = batch["points/vol_points"], batch["points/vol_label"]
        return torch.nn.functional.binary_cross_entropy_with_logits(network(points)[..., 0], labels.float())

    losses = []
    for batch in loader:
        assert batch["points/vol_points"].shape == (2, 400, 3)
        for _ in range(20):
            optimizer.zero_grad()
            loss = loss_of(batch)
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
    assert losses[-1] < losses[0]
