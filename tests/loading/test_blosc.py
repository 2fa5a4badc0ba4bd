"""Buffers of Blosc in OpenVDB files: their codecs, damaged headers and content, and the package that unpacks them."""

from __future__ import annotations

import struct
import sys

import numpy as np
import pytest

import fieldbake as fb
from fieldbake.files.grids.openvdb_reader import unpack_blosc

blosc = pytest.importorskip("numcodecs.blosc")

#: Samples of a node, of which some are equal.
SAMPLES = np.where(np.arange(512) % 5 < 2, 0.0, np.random.default_rng(1).normal(size=512)).astype(np.float32)


def packed(codec: bytes = b"lz4", shuffle: int = 1) -> bytes:
    """The samples as OpenVDB packs them: level 9, shuffled bytes, blocks of 256 bytes."""
    return bytes(blosc.compress(SAMPLES, codec, 9, shuffle, 256))


@pytest.mark.parametrize("codec", [b"lz4", b"zlib", b"zstd"])
@pytest.mark.parametrize("shuffle", [0, 1, 2])
def test_every_codec_is_unpacked(codec, shuffle):
    assert unpack_blosc(memoryview(packed(codec, shuffle)), SAMPLES.nbytes) == SAMPLES.tobytes()


@pytest.mark.parametrize("at", [4, 12])
def test_sizes_are_compared_before_anything_is_unpacked(at):
    content = bytearray(packed())
    struct.pack_into("<I", content, at, 2**31)
    with pytest.raises(fb.FormatError, match="damaged header"):
        unpack_blosc(memoryview(content), SAMPLES.nbytes)


def test_random_damage_is_an_error_or_other_samples():
    random, whole = np.random.default_rng(2), packed()
    for _ in range(2000):
        content = bytearray(whole)
        for place in random.integers(0, len(content), 3):
            content[place] = random.integers(256)
        try:
            assert len(unpack_blosc(memoryview(content), SAMPLES.nbytes)) <= SAMPLES.nbytes
        except fb.FormatError as error:
            assert "Blosc" in str(error)  # noqa: PT017 - other samples are no error


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numcodecs.blosc", None)
    with pytest.raises(fb.FormatError, match=r"pip install 'fieldbake\[blosc\]', or save the file again with zip"):
        unpack_blosc(memoryview(packed()), SAMPLES.nbytes)
