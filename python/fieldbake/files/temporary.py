"""Temporary files that replace a file once they are complete, and locks between processes.

A temporary file is named ``.fieldbake-HOST-RANDOM.tmp``, in the folder of its target: it fits wherever the name of the
target fits. Its process holds a lock on it, and the system releases the lock when the process ends. A temporary file
without a lock is therefore abandoned, and the next save into the folder removes it. Locks of another host may be
invisible, and Windows has none, so other files are abandoned once they have not changed for a day.
"""

from __future__ import annotations

import os
import platform
import secrets
import stat
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

if sys.platform != "win32":
    import fcntl

_PREFIX, _SUFFIX = ".fieldbake-", ".tmp"
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"
#: Age after which an unchanged temporary file is abandoned in any case, seconds.
_LONGEST_PAUSE = 86_400.0
#: Longest wait for the lock of a folder, and pause between two attempts, seconds.
_LOCK_WAIT, _LOCK_PAUSE = 5.0, 0.002
#: Share of the time of a process that may pass with the search for abandoned files in large folders.
_SWEEP_SHARE = 0.02
#: Earliest time of the next search in each folder, by `time.monotonic`.
_next_sweeps: dict[str, float] = {}


def create(folder: Path, mode: int) -> IO[bytes]:
    """Create a temporary file with these permissions less the umask, and remove abandoned ones from its folder."""
    _sweep(folder)
    while True:
        path = folder / f"{_PREFIX}{_HOST}-{secrets.token_hex(8)}{_SUFFIX}"
        stream = open(path, "x+b", opener=lambda name, flags: os.open(name, flags, mode))  # noqa: SIM115 - closed by its user
        _try_lock(stream.fileno())
        # Another process may have taken the lock first, and removed the file as abandoned.
        if os.fstat(stream.fileno()).st_nlink:
            return stream
        stream.close()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. Where it is not available in `_LOCK_WAIT` seconds, continue without it."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows does not open folders.
        yield
        return
    try:
        last = time.monotonic() + _LOCK_WAIT
        while _try_lock(descriptor) is False and time.monotonic() < last:
            time.sleep(_LOCK_PAUSE)
        yield
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool | None:
    """Take the lock of a file; False if another process has it, None if there are no locks."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _sweep(folder: Path) -> None:
    """Remove the abandoned temporary files of a folder."""
    start = time.monotonic()
    place = os.path.abspath(folder)  # noqa: PTH100 - resolves no links
    if start < _next_sweeps.get(place, 0.0):
        return
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(_PREFIX) and entry.name.endswith(_SUFFIX):
                with suppress(OSError):  # Another process may have removed it.
                    _remove_if_abandoned(Path(entry.path))
    end = time.monotonic()
    _next_sweeps[place] = end + (end - start) / _SWEEP_SHARE


def _remove_if_abandoned(path: Path) -> None:
    state = path.lstat()
    if not stat.S_ISREG(state.st_mode):
        return
    if time.time() - state.st_mtime > _LONGEST_PAUSE:
        path.unlink()
    elif path.name.startswith(_PREFIX + _HOST):
        with path.open("rb") as stream:
            if _try_lock(stream.fileno()):
                path.unlink()
