"""Small libraries of assets, and callables that worker processes can import."""

import errno
import os
import signal
import time
from pathlib import Path

import meshes


def box(size):
    vertices, faces = meshes.box()
    return vertices * size, faces


def small_box():
    return box(0.5)


def kill_process():
    os.kill(os.getpid(), signal.SIGKILL)


def kill_on(_device):
    kill_process()


def sleep():
    time.sleep(600)


def write_box(path: Path, size: float) -> Path:
    vertices, faces = box(size)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist())]))
    return path


def write_boxes(folder: Path, count: int) -> list[Path]:
    """Boxes of different sizes as OBJ files box_0.obj, ..."""
    folder.mkdir(parents=True)
    return [write_box(folder / f"box_{i}.obj", 1 + 0.1 * i) for i in range(count)]


def no_space(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
