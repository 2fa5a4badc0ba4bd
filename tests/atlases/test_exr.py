"""OpenEXR files of one channel: another reader and our own find the same bits, in images of every shape."""

import numpy as np
import pytest

from fieldbake import _core
from fieldbake.files.exr import BLOCK_ROWS, write_channel

SHAPES = [(1, 1), (1, 700), (BLOCK_ROWS - 1, 3), (BLOCK_ROWS, 8), (BLOCK_ROWS + 1, 33), (300, 257)]


@pytest.fixture(params=[np.float16, np.float32])
def values_of(request, random):
    def make(shape):
        values = random.normal(size=shape).astype(request.param)  # noise does not become smaller and is stored as it is
        values[:, : shape[1] // 2] = 0.25
        values.flat[-1] = -0.0
        return values

    return make


@pytest.mark.parametrize("shape", SHAPES)
def test_the_values_come_back_bit_for_bit(values_of, shape):
    values = values_of(shape)
    name = "float16" if values.itemsize == 2 else "float32"

    texels = _core.exr_read(write_channel(values, {}), shape[1], shape[0], name)

    assert bytes(texels) == values.tobytes()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_reader_of_openexr_finds_the_values(values_of, shape, tmp_path):
    exr = pytest.importorskip("OpenEXR")
    values = values_of(shape)
    (tmp_path / "a.exr").write_bytes(write_channel(values, {}))

    with exr.File(str(tmp_path / "a.exr")) as file:
        found = file.channels()["Y"].pixels

    assert found.dtype == values.dtype
    assert found.tobytes() == values.tobytes()


def test_noise_is_stored_and_runs_are_compressed(random):
    noise = np.frombuffer(random.bytes(4 * 64 * 64), np.float32).reshape(64, 64)
    flat = np.zeros((64, 64), np.float32)

    assert noise.nbytes < len(write_channel(noise, {})) < noise.nbytes + 1000
    assert len(write_channel(flat, {})) < flat.nbytes / 10
