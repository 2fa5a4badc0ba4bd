"""Grey .png files: other readers decode them to the same pixels, and threads do not change their bytes."""

import io
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

import fieldbake as fb
from fieldbake.files import png
from fieldbake.files.png import write_grey

SHAPES = [(1, 1), (1, 700), (700, 1), (37, 53), (300, 401)]


@pytest.fixture(params=[np.uint8, np.uint16])
def pixels_of(request, random):
    def make(shape):
        pixels = random.integers(0, np.iinfo(request.param).max + 1, shape).astype(request.param)
        pixels[:, : shape[1] // 2] = 7  # runs of equal bytes beside noise
        return pixels

    return make


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("block", [1, 1000, png.BLOCK_BYTES])
def test_pillow_reads_the_pixels(pixels_of, shape, block, monkeypatch):
    monkeypatch.setattr(png, "BLOCK_BYTES", block)
    pixels = pixels_of(shape)

    read = np.asarray(Image.open(io.BytesIO(write_grey(pixels))))

    assert read.shape == shape
    assert np.array_equal(read, pixels)


def test_checksums_and_sizes_are_those_of_the_specification(pixels_of):
    content = write_grey(pixels_of((300, 401)))
    stream, place = b"", 8
    kinds = []
    while place < len(content):
        (length,) = struct.unpack_from(">I", content, place)
        body = content[place + 4 : place + 8 + length]
        assert struct.unpack_from(">I", content, place + 8 + length) == (zlib.crc32(body),)
        kinds.append(body[:4])
        stream += body[4:] if body[:4] == b"IDAT" else b""
        place += 12 + length

    assert kinds[0] == b"IHDR"
    assert kinds[-1] == b"IEND"
    # `decompress` compares the checksum of the stream, and there is nothing behind its end.
    decoder = zlib.decompressobj()
    assert len(decoder.decompress(stream)) % 300 == 0
    assert decoder.eof
    assert decoder.unused_data == b""


def test_bytes_do_not_depend_on_the_threads(pixels_of, monkeypatch):
    monkeypatch.setattr(png, "BLOCK_BYTES", 1000)
    pixels = pixels_of((300, 401))
    contents = set()
    for threads in (1, 3):
        monkeypatch.setattr(os, "cpu_count", lambda threads=threads: threads)
        contents.add(write_grey(pixels))

    assert len(contents) == 1


@pytest.mark.parametrize("encoding", ["snorm16", "snorm8"])
def test_the_preview_of_an_atlas_has_the_surface_in_mid_grey(tmp_path, encoding):
    atlas = fb.pack([fb.bake(fb.models.gear(), 16)], page_size="fit", encoding=encoding)
    atlas.save(tmp_path / "a.png")

    preview = np.asarray(Image.open(tmp_path / "a.preview.png"))
    texels = np.asarray(atlas.pages, np.float64).reshape(preview.shape)
    expected = 127.5 + 127.5 * texels / texels.dtype.type(np.iinfo(atlas.pages.dtype).max)

    # Rounding to whole greys; the shares are float32, so a tie may fall on either side.
    assert np.abs(preview - expected).max() <= 0.5 + 1e-4
    assert np.array_equal(fb.load(tmp_path / "a.png").pages, atlas.pages)
