"""Libraries of assets: rows, results, errors of single items, and second runs."""

import json
import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import assets
import fieldbake as fb


@pytest.fixture
def library(tmp_path):
    return assets.write_boxes(tmp_path / "in", 4)


@pytest.fixture
def boxes():
    """Items that need no reader of files, so that child processes start in half the time."""
    return {f"box_{i}": assets.box(1 + 0.1 * i) for i in range(4)}


def bake_many(items, out, **options):
    return fb.bake_many(items, out, **{"resolution": 12, "workers": 1, **options})


def statuses(rows):
    return [row["status"] for row in rows]


def test_each_item_becomes_the_volume_that_bake_makes(library, tmp_path):
    rows = fb.bake_many(library, tmp_path / "out", resolution=16, sign="winding")

    assert [row["item"] for row in rows] == library
    assert statuses(rows) == ["done"] * 4
    for row, path in zip(rows, library, strict=True):
        assert row["path"] == os.fspath(tmp_path / "out" / f"{path.stem}.npz")
        assert set(row) == {"item", "path", "status", "seconds", "error", "report"}
        assert row["error"] is None
        assert row["report"]["closed"]
        assert row["seconds"] > 0
        direct = fb.bake(path, 16, sign="winding")
        assert fb.load(row["path"]).distances.tobytes() == direct.distances.tobytes()


def test_a_second_run_skips_and_changes_are_baked_again(boxes, tmp_path):
    out = tmp_path / "out"
    bake_many(boxes, out)
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}

    again = bake_many(boxes, out)
    assert statuses(again) == ["skipped"] * 4
    assert all(row["report"]["closed"] for row in again)
    assert before == {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}

    boxes["box_1"] = assets.box(0.7)
    (out / "box_2.npz").unlink()
    (out / "box_3.npz").write_bytes(b"half")
    assert statuses(bake_many(boxes, out)) == ["skipped", "done", "done", "done"]
    assert fb.load(out / "box_1.npz").distances.tobytes() == fb.bake(assets.box(0.7), 12).distances.tobytes()

    assert statuses(bake_many(boxes, out, resolution=10)) == ["done"] * 4
    assert fb.load(out / "box_0.npz").resolution[0] == 10
    assert statuses(bake_many(boxes, out, resolution=10, resume=False)) == ["done"] * 4


def test_a_changed_file_is_baked_again(library, tmp_path):
    bake_many(library[:2], tmp_path / "out")
    assets.write_box(library[1], 0.7)
    assert statuses(bake_many(library[:2], tmp_path / "out")) == ["skipped", "done"]


def test_broken_items_fail_alone_and_are_tried_again(library, tmp_path):
    out = tmp_path / "out"
    library[1].write_text("v 0 0 0\n")
    missing = tmp_path / "in" / "missing.obj"
    rows = bake_many([*library, missing], out)

    assert statuses(rows) == ["done", "failed", "done", "done", "failed"]
    assert "MeshError" in rows[1]["error"]
    assert "FileNotFoundError" in rows[4]["error"]
    assert not (out / f"{library[1].stem}.npz").exists()
    lines = [json.loads(line) for line in (out / "ledger.jsonl").read_text().splitlines()]
    assert sorted(line["status"] for line in lines) == ["done"] * 3 + ["failed"] * 2

    assets.write_box(library[1], 1.0)
    assert statuses(bake_many([*library, missing], out)) == ["skipped", "done", *["skipped"] * 2, "failed"]
    with pytest.raises(FileNotFoundError):
        bake_many([missing], out, on_error="raise")
    library[0].write_text("v 0 0 0\n")
    with pytest.raises(fb.MeshError, match=library[0].name):
        bake_many(library, out, on_error="raise")


def test_an_item_that_kills_its_process_or_takes_too_long_fails_alone(boxes, tmp_path):
    items = {
        "killer": assets.kill_process,
        "first": boxes["box_1"],
        "sleeper": assets.sleep,
        "second": assets.small_box,
    }
    start = time.monotonic()
    rows = bake_many(items, tmp_path / "out", limit_s=6)

    assert statuses(rows) == ["failed", "done", "failed", "done"]
    assert "SIGKILL" in rows[0]["error"]
    assert "limit of 6 s" in rows[2]["error"]
    assert time.monotonic() - start < 40
    assert [row["item"] for row in rows] == list(items)
    again = bake_many({"second": assets.small_box}, tmp_path / "out")
    assert statuses(again) == ["skipped"]


def test_equal_stems_and_unknown_options_are_errors_before_any_work(library, tmp_path):
    other = assets.write_boxes(tmp_path / "other", 1)
    out = tmp_path / "out"
    with pytest.raises(fb.ArgumentError) as caught:
        fb.bake_many([*library, *other], out)
    first, second = f"items[0] ({library[0]})", f"items[{len(library)}] ({other[0]})"
    assert str(caught.value).startswith(f"items: {first} and {second} would both be written as 'box_0.obj.npz'")
    with pytest.raises(fb.ArgumentError, match=r"items: items\[0\] and items\[1\] would both be written as 'A.npz'"):
        fb.bake_many({"a": assets.box(1), "A": assets.box(2)}, out)
    with pytest.raises(fb.ArgumentError, match="resolutions: is no option of bake"):
        fb.bake_many(library, out, resolutions=3)
    with pytest.raises(fb.ArgumentError, match="put it in a list"):
        fb.bake_many(os.fspath(library[0]), out)
    with pytest.raises(fb.ArgumentError, match="executor"):
        fb.bake_many(library, out, executor=3)
    with pytest.raises(fb.ArgumentError, match="on_error"):
        fb.bake_many(library, out, on_error="ignore")
    assert not out.exists()


def test_files_with_equal_stems_keep_their_ending(tmp_path):
    names = ["a.obj", "A.ply", "a.obj.stl", "b.obj"]
    for name in names:
        fb.Mesh(*assets.box(1)).save(tmp_path / name)
    rows = bake_many([tmp_path / name for name in names], tmp_path / "out")
    assert [Path(row["path"]).name for row in rows] == ["a.obj.npz", "A.ply.npz", "a.obj.stl.npz", "b.npz"]
    assert statuses(rows) == ["done"] * 4
    assert all(fb.load(row["path"]).resolution for row in rows)
    assert statuses(bake_many([tmp_path / name for name in names], tmp_path / "out")) == ["skipped"] * 4


def test_items_are_files_arrays_meshes_and_callables(library, tmp_path):
    vertices, faces = assets.box(1.3)
    items = [str(library[0]), (vertices, faces), fb.Mesh(vertices, faces), lambda: (vertices, faces), assets.small_box]
    shares = []
    rows = bake_many(items, tmp_path / "out", progress=shares.append)

    assert statuses(rows) == ["done"] * 5
    names = ["box_0", "item-00001", "item-00002", "item-00003", "small_box"]
    assert [Path(row["path"]).name for row in rows] == [f"{name}.npz" for name in names]
    same = [fb.load(row["path"]).distances.tobytes() for row in rows[1:4]]
    assert same[0] == same[1] == same[2]
    assert shares[-1] == 1.0
    assert fb.bake_many([], tmp_path / "none") == []


@pytest.mark.parametrize("pool", ["threads", pytest.param("fork", marks=pytest.mark.slow), "spawn"])
def test_pools_bake_the_same(boxes, tmp_path, pool):
    boxes["box_2"] = ([(0, 0, 0)], [(0, 0, 0)])
    context = {} if pool == "threads" else {"mp_context": get_context(pool)}
    with (ThreadPoolExecutor if pool == "threads" else ProcessPoolExecutor)(1, **context) as executor:
        items = {**boxes, "killer": assets.kill_process}
        rows = fb.bake_many(items, tmp_path / "out", executor=executor, resolution=12)

    assert statuses(rows) == ["done", "done", "failed", "done", "failed"]
    assert "SIGKILL" in rows[4]["error"]
    assert fb.load(rows[1]["path"]).distances.tobytes() == fb.bake(boxes["box_1"], 12).distances.tobytes()


@pytest.mark.slow
def test_a_killed_worker_of_a_pool_loses_no_item(boxes, tmp_path):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        victim = executor.submit(os.getpid).result()
        os.kill(victim, signal.SIGKILL)
        rows = fb.bake_many(boxes, tmp_path / "out", executor=executor, resolution=12)
    assert statuses(rows) == ["done"] * 4


def test_a_ledger_line_that_was_cut_short_is_ignored(boxes, tmp_path):
    out = tmp_path / "out"
    bake_many(boxes, out)
    ledger = out / "ledger.jsonl"
    ledger.write_bytes(ledger.read_bytes()[:-9])
    assert sorted(statuses(bake_many(boxes, out))) == ["done", "skipped", "skipped", "skipped"]
    assert statuses(bake_many(boxes, out)) == ["skipped"] * 4
    assert not list(out.glob(".*"))


def test_training_samples_of_many(boxes, tmp_path):
    from fieldbake.scaling.library import sample_many

    rows = sample_many(boxes, tmp_path / "out", n=500, seed=3, workers=1)
    assert statuses(rows) == ["done"] * 4
    direct = fb.sample_training(boxes["box_1"], 500, seed=3)
    with np.load(rows[1]["path"]) as found:
        assert sorted(found.files) == ["distances", "gradients", "points"]
        assert np.array_equal(found["points"], direct.points)
        for name in ("distances", "gradients"):
            assert np.array_equal(found[name], getattr(direct, name).astype(np.float32))
