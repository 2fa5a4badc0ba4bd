"""Files that a save replaces: links, permissions, names, and what a killed save leaves behind."""

import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from fieldbake.files import temporary
from fieldbake.files.container import atomic_write

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has other links and permissions")


@pytest.fixture(scope="module")
def fields():
    return fb.bake(fb.sphere(1), 8), fb.bake(fb.sphere(2), 8)


@pytest.mark.parametrize("ending", [".npz", ".ktx2"])
def test_a_symbolic_link_stays_and_its_file_is_replaced(fields, ending, tmp_path):
    old, new = fields
    real, link = tmp_path / f"store/real{ending}", tmp_path / f"link{ending}"
    real.parent.mkdir()
    link.symlink_to(f"store/real{ending}")
    old.save(link)  # the file does not exist yet
    assert np.array_equal(fb.load(real).bounds, old.bounds)
    new.save(link)

    assert link.is_symlink()
    for path in (real, link):
        assert np.array_equal(fb.load(path).distances, new.distances)
        assert np.array_equal(fb.load(path).bounds, new.bounds)


def test_links_that_lead_nowhere_are_errors(fields, tmp_path):
    loop, pipe = tmp_path / "loop.npz", tmp_path / "pipe.npz"
    loop.symlink_to("loop.npz")
    os.mkfifo(pipe)
    (tmp_path / "null.npz").symlink_to("/dev/null")
    for path in (loop, pipe, tmp_path / "null.npz"):
        with pytest.raises(OSError, match=path.name):
            fields[0].save(path)
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_other_hard_links_keep_the_old_field(fields, tmp_path):
    old, new = fields
    old.save(tmp_path / "v.npz")
    (tmp_path / "kept.npz").hardlink_to(tmp_path / "v.npz")
    new.save(tmp_path / "v.npz")
    assert np.array_equal(fb.load(tmp_path / "kept.npz").bounds, old.bounds)
    assert np.array_equal(fb.load(tmp_path / "v.npz").bounds, new.bounds)


def test_a_read_only_file_is_not_replaced(fields, tmp_path, monkeypatch):
    old, new = fields
    path = tmp_path / "v.npz"
    old.save(path)
    path.chmod(0o444)
    # The superuser may write every file.
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(PermissionError, match=r"read-only.*v\.npz"):
        new.save(path)
    assert np.array_equal(fb.load(path).bounds, old.bounds)


def test_permissions_follow_the_umask_and_then_the_old_file(fields, tmp_path, monkeypatch):
    path = tmp_path / "v.npz"
    mask = os.umask(0o027)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "umask", None)  # a save must not change the umask of the process
            fields[0].save(path)
            assert [stat.S_IMODE(one.stat().st_mode) for one in tmp_path.iterdir()] == [0o640]
            path.chmod(0o604)
            fields[1].save(path)
            assert stat.S_IMODE(path.stat().st_mode) == 0o604
    finally:
        os.umask(mask)


@pytest.mark.parametrize("length", [241, 242, 250, 255])
def test_names_may_be_as_long_as_the_system_allows(fields, length, tmp_path):
    path = tmp_path / ("n" * (length - 4) + ".npz")
    for field in fields:
        field.save(path)
        assert np.array_equal(fb.load(path).bounds, field.bounds)


KILLED = """
import sys, time
from pathlib import Path
from fieldbake.files.container import atomic_write
with atomic_write(Path(sys.argv[1])) as stream:
    stream.write(b"part")
    stream.flush()
    print("writing", flush=True)
    time.sleep(60)
"""


def test_a_save_removes_what_a_killed_save_left(fields, tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "other.npz")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        fields[0].save(tmp_path / "v.npz")
        assert len(list(tmp_path.glob(".*.tmp"))) == 1  # of a process that runs
        process.send_signal(signal.SIGKILL)
        process.wait()
    temporary._next_sweeps.clear()
    with atomic_write(tmp_path / "w.npz") as stream:
        (own,) = tmp_path.glob(".*.tmp")
        temporary._next_sweeps.clear()
        fields[0].save(tmp_path / "v.npz")
        assert list(tmp_path.glob(".*.tmp")) == [own]
        stream.write(b"done")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["v.npz", "w.npz"]


def test_files_of_another_host_are_removed_after_a_day(fields, tmp_path):
    young, old, foreign = (tmp_path / name for name in (".fieldbake-h-1.tmp", ".fieldbake-h-2.tmp", ".other.tmp"))
    for path in (young, old, foreign):
        path.write_bytes(b"part")
    for path in (old, foreign):
        os.utime(path, (time.time() - 100_000,) * 2)
    fields[0].save(tmp_path / "v.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".fieldbake-h-1.tmp", ".other.tmp", "v.npz"]
