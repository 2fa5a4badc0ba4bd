"""A file and the JSON beside it belong together, whenever a save ends and whoever saves at the same time."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb

#: Files whose metadata lie only in the JSON, and all files that have a JSON.
WITHOUT_FACTS = ("v.dds", "v.vf", "v.nvdb", "a.png")
NAMES = (*WITHOUT_FACTS, "v.exr", "a.exr")


@functools.cache
def objects():
    """Two fields and two atlases whose files differ in the samples and in the boxes only."""
    one, two = fb.bake(fb.sphere(1), 12), fb.bake(fb.box((4, 4, 4)), 12)
    atlases = [fb.pack(pair, page_size=64, encoding="snorm16") for pair in ((one, two), (two, one))]
    return {"v": (one, two), "a": tuple(atlases)}


def content(found):
    """All that a file states: boxes and samples."""
    volumes = [found.unpack(i) for i in found.indices] if isinstance(found, fb.Atlas) else [found]
    return [array for volume in volumes for array in (volume.bounds, volume.distances)]


def equal(found, expected):
    pairs = zip(content(found), content(expected), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


class Killed(BaseException):
    """The end of the process in a test."""


def saved_until(one, path, step, monkeypatch):
    """Save, and end before the renaming with this number; return whether the save was finished."""
    left = iter(range(step))
    rename = os.replace

    def ending(source, target):
        if next(left, None) is None:
            raise Killed
        rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", ending)
        try:
            one.save(path)
        except Killed:
            return False
    return True


@pytest.mark.filterwarnings(r"ignore:v\.vf. \.vf files state no place")
@pytest.mark.parametrize("earlier", ["checksum", "no checksum", "no json", "killed"])
@pytest.mark.parametrize("name", NAMES)
def test_an_ended_save_leaves_the_old_field_or_the_new_one(name, earlier, tmp_path, monkeypatch):
    old, new = objects()[name[0]]
    path, beside = tmp_path / name, tmp_path / f"{name}.json"
    references = []
    for one in (new, old):
        one.save(path)
        references.append(fb.load(path))
    is_new = []
    for step in range(9):
        for left in tmp_path.iterdir():
            left.unlink()
        old.save(path)
        if earlier == "killed":
            assert not saved_until(new, path, 2 if name == "a.png" else 1, monkeypatch)
            assert "previous" in json.loads(beside.read_text())
        elif earlier == "no checksum":
            facts = json.loads(beside.read_text())
            del facts["checksum"]
            beside.write_text(json.dumps(facts))
        elif earlier == "no json":
            beside.unlink()
            if name in ("v.dds", "a.png"):
                return
            references[1] = fb.load(path)
        is_done = saved_until(new, path, step, monkeypatch)
        found = fb.load(path)
        is_new.append(equal(found, references[0]))
        assert is_new[-1] or equal(found, references[1])
        if is_done:
            break

    assert is_done
    assert is_new == sorted(is_new)
    assert is_new[-2:] == [True, True]
    assert not is_new[0]
    assert "previous" not in json.loads(beside.read_text())
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("name", ["v.exr", "a.exr"])
def test_files_with_an_attribute_need_no_json(name, tmp_path):
    old, new = objects()[name[0]]
    path, beside = tmp_path / name, tmp_path / f"{name}.json"
    old.save(path)
    facts = beside.read_text()
    expected = fb.load(path)
    new.save(path)
    beside.write_text(facts)
    assert not equal(fb.load(path), expected)
    old.save(path)
    beside.unlink()
    assert equal(fb.load(path), expected)


def test_an_image_of_an_earlier_version_has_its_facts_in_the_json(tmp_path):
    path = tmp_path / "v.exr"
    volume = objects()["v"][0]
    volume.save(path)
    # Version 0.2 wrote no attribute, and no checksum.
    path.write_bytes(path.read_bytes().replace(b"\0fieldbake\0string", b"\0elsewhere\0string"))
    facts = json.loads((tmp_path / "v.exr.json").read_text())
    del facts["checksum"]
    (tmp_path / "v.exr.json").write_text(json.dumps(facts))
    assert equal(fb.load(path), volume)


@pytest.mark.parametrize("name", WITHOUT_FACTS)
def test_facts_of_another_file_are_refused(name, tmp_path):
    old, new = objects()[name[0]]
    path, beside = tmp_path / name, tmp_path / f"{name}.json"
    old.save(path)
    facts = beside.read_text()
    new.save(path)
    beside.write_text(facts)
    with pytest.raises(fb.FormatError, match=rf"{name}: {name}\.json does not have the checksum"):
        fb.load(path)
    # A file that an earlier version wrote has no checksum.
    beside.write_text(json.dumps({key: value for key, value in json.loads(facts).items() if key != "checksum"}))
    assert content(fb.load(path))


@pytest.mark.parametrize("previous", [None, 3, [3], {"checksum": "crc32 0"}])
def test_damaged_lists_of_facts_are_format_errors(previous, tmp_path):
    path, beside = tmp_path / "v.dds", tmp_path / "v.dds.json"
    objects()["v"][0].save(path)
    facts = json.loads(beside.read_text())
    beside.write_text(json.dumps({**facts, "previous": previous}))
    with pytest.raises(fb.FormatError, match=r"v\.dds"):
        fb.load(path)
    objects()["v"][1].save(path)
    assert np.array_equal(fb.load(path).bounds, objects()["v"][1].bounds)


def test_json_beside_a_link_describes_it(tmp_path):
    """Stores of data sets keep each file under a hash, with a link of its own."""
    volume = objects()["v"][0]
    volume.save(tmp_path / "v.dds")
    (tmp_path / "1f3a").mkdir()
    for name in ("v.dds", "v.dds.json"):
        (tmp_path / name).rename(tmp_path / "1f3a" / f"{len(name)}.bin")
        (tmp_path / name).symlink_to(f"1f3a/{len(name)}.bin")
    assert equal(fb.load(tmp_path / "v.dds"), volume)
    objects()["v"][1].save(tmp_path / "v.dds")
    assert equal(fb.load(tmp_path / "v.dds"), objects()["v"][1])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other links")
@pytest.mark.parametrize("name", ["v.dds", "v.vf"])
def test_the_json_of_a_link_is_beside_its_file(name, tmp_path):
    link, real = tmp_path / name, tmp_path / "store" / name
    real.parent.mkdir()
    link.symlink_to(f"store/{name}")
    for volume in objects()["v"]:
        volume.save(link)
        assert equal(fb.load(link), volume)
        assert equal(fb.load(real), volume)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([name, "store"])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other limits")
def test_names_leave_room_for_the_files_beside_them(tmp_path):
    volume = objects()["v"][0]
    longest = tmp_path / ("n" * 246 + ".dds")
    volume.save(longest)
    assert equal(fb.load(longest), volume)
    with pytest.raises(OSError, match=r"too long.*\.dds\.json"):
        volume.save(tmp_path / ("n" * 247 + ".dds"))
    with pytest.raises(OSError, match="too long"):
        objects()["a"][0].save(tmp_path / ("n" * 244 + ".png"))
    assert sorted(tmp_path.iterdir()) == [longest, tmp_path / f"{longest.name}.json"]
    # A grid of another program has no JSON.
    volume.save(tmp_path / "v.vf")
    foreign = (tmp_path / "v.vf").rename(tmp_path / ("n" * 252 + ".vf"))
    with pytest.warns(UserWarning, match="is missing"):
        assert np.array_equal(fb.load(foreign).distances, volume.distances)


SEVERAL_PROCESSES = """
import collections, itertools, os, random, signal, sys, time
import fieldbake as fb
sys.path.insert(0, sys.argv[1])
from test_facts_of_files import equal, objects

def child(stored):
    pid = os.fork()
    if not pid:
        for one in itertools.cycle(stored):
            one.save(path)
    return pid

def end(pid):
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)

def look():
    found = fb.load(path)
    return next((i for i in (0, 1) if equal(found, references[i])), "mixed")

path, kills, loads = sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
stored = objects()[os.path.basename(path)[0]]
references = []
for one in stored:
    one.save(path)
    references.append(fb.load(path))
random.seed(1)
seen = collections.Counter()
for kill in range(kills):
    pid = child(stored[:: 1 if kill % 2 else -1])
    time.sleep(random.uniform(0.002, 0.06))
    end(pid)
    seen[look()] += 1
writers = [child([one]) for one in stored]
try:
    for _ in range(loads):
        try:
            seen[look()] += 1
        except fb.FormatError:
            seen["refused"] += 1
finally:
    for pid in writers:
        end(pid)
assert seen[0] + seen[1] + seen["refused"] == kills + loads, seen
assert kills < 100 or min(seen[0], seen[1]) > 0, seen
assert look() in (0, 1)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="forks")
@pytest.mark.parametrize(
    ("kills", "loads"), [(3, 20), pytest.param(200, 2000, marks=pytest.mark.slow)], ids=["few", "many"]
)
@pytest.mark.parametrize("name", NAMES)
def test_killed_and_simultaneous_saves_mix_no_fields(name, kills, loads, tmp_path):
    command = [sys.executable, "-c", SEVERAL_PROCESSES, Path(__file__).parent, tmp_path / name, kills, loads]
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stderr
