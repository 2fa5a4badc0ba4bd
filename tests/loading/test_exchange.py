"""Files for other programs, read by independent readers and by fieldbake."""

import contextlib
import json
import re
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
from damage import damaged, drop_checksum
from fieldbake.files import exr
from fieldbake.files.formats import shares

#: Width of a stored step, as a fraction of the scale.
STEPS = {"snorm16": 32767, "snorm8": 127}
DTYPES = {"float32": np.float32, "float16": np.float16, "snorm16": np.int16, "snorm8": np.int8}
#: DXGI_FORMAT and VkFormat of one channel, from the headers of Direct3D and Vulkan.
DXGI = {"float32": 41, "float16": 54, "snorm16": 58, "snorm8": 63}
VULKAN = {"float32": 100, "float16": 76, "snorm16": 71, "snorm8": 10}


@pytest.fixture(scope="module")
def volume():
    values = np.random.default_rng(5).uniform(-1, 1, (6, 5, 4))
    return fb.Volume(values, [(-1, 0, 2), (2, 2.5, 4)], inner_bounds=[(0, 1, 2.5), (1, 2, 3)])


@pytest.fixture(scope="module")
def baked():
    return [fb.bake(fb.models.gear(), 12), fb.bake(fb.models.torus_knot(), 10)]


def assert_same_place(found, volume):
    assert np.array_equal(found.bounds, volume.bounds)
    assert np.array_equal(found.inner_bounds, volume.inner_bounds)
    assert found.resolution == volume.resolution


def scale_of(volume, encoding, band=4):
    """The scale by its definition: 1, the largest power of two up to a voxel, or the half width of the band."""
    voxel = float(volume.spacing.max())
    if encoding == "float16":
        return 2.0 ** np.floor(np.log2(voxel))
    return float(np.float32(band * voxel)) if encoding in STEPS else 1.0


def stored(volume, encoding, band=4):
    """Texels [z, y, x] by an independent rule: fractions of the scale, rounded toward zero."""
    scale = scale_of(volume, encoding, band)
    values = volume.distances.T.astype(np.float64)
    if encoding == "float32":
        return values.astype(np.float32)
    if encoding == "float16":
        values = values / scale
        nearest = values.astype(np.float16)
        return np.where(np.abs(nearest) > np.abs(values), np.nextafter(nearest, np.float16(0)), nearest)
    return np.trunc(np.clip(values / scale, -1, 1) * STEPS[encoding]).astype(DTYPES[encoding])


# --- volumes as textures


@pytest.mark.parametrize("encoding", DTYPES)
def test_a_dds_file_is_a_3d_texture(volume, encoding, tmp_path):
    volume.save(tmp_path / "v.dds", encoding=encoding)

    content = (tmp_path / "v.dds").read_bytes()
    # Programming Guide for DDS: magic, DDS_HEADER (124 bytes), DDS_HEADER_DXT10 (20 bytes), texels.
    assert content[:4] == b"DDS "
    size, _flags, height, width, _pitch, depth = struct.unpack_from("<6I", content, 4)
    assert (size, width, height, depth) == (124, 6, 5, 4)
    # DDS_PIXELFORMAT: 32 bytes, DDPF_FOURCC alone, and no colour masks: a reader that finds DDPF_RGB shows noise.
    pixel_format = struct.unpack_from("<2I4s5I", content, 76)
    assert pixel_format == (32, 0x4, b"DX10", 0, 0, 0, 0, 0)
    assert struct.unpack_from("<I", content, 112)[0] & 0x200000  # DDSCAPS2_VOLUME
    dxgi_format, dimension, _, array_size, _ = struct.unpack_from("<5I", content, 128)
    assert (dxgi_format, dimension, array_size) == (DXGI[encoding], 4, 1)
    texels = np.frombuffer(content, DTYPES[encoding], offset=148).reshape(4, 5, 6)
    assert np.array_equal(texels, stored(volume, encoding))


@pytest.mark.parametrize("encoding", DTYPES)
def test_a_ktx2_file_is_a_3d_texture(volume, encoding, tmp_path):
    volume.save(tmp_path / "v.ktx2", encoding=encoding)

    content = (tmp_path / "v.ktx2").read_bytes()
    # KTX 2.0, section 3: identifier, header, index, level index.
    assert content[:12] == b"\xabKTX 20\xbb\r\n\x1a\n"
    header = struct.unpack_from("<9I", content, 12)
    itemsize = np.dtype(DTYPES[encoding]).itemsize
    assert header == (VULKAN[encoding], itemsize, 6, 5, 4, 0, 1, 1, 0)
    formats_at, formats_size, pairs_at, pairs_size = struct.unpack_from("<4I", content, 48)
    offset, length, unpacked = struct.unpack_from("<3Q", content, 80)
    assert offset % 4 == 0
    assert length == unpacked == 120 * itemsize == len(content) - offset
    assert struct.unpack_from("<I", content, formats_at)[0] == formats_size
    assert pairs_at + pairs_size <= offset
    pairs = key_values(content[pairs_at : pairs_at + pairs_size])
    # x to the right, y up, z out of the picture: right-handed, as the mesh. Without the key readers take y as down.
    assert pairs["KTXorientation"] == b"ruo\0"
    assert list(pairs) == sorted(pairs)
    facts = json.loads(pairs["fieldbake"])
    assert facts["scale"] == scale_of(volume, encoding)
    texels = np.frombuffer(content, DTYPES[encoding], offset=offset).reshape(4, 5, 6)
    assert np.array_equal(texels, stored(volume, encoding))


def key_values(section):
    """The key/value data of KTX 2.0, section 3.11: length, key, a zero byte, value, padding to four bytes."""
    pairs, at = {}, 0
    while at < len(section):
        (length,) = struct.unpack_from("<I", section, at)
        key, _, value = section[at + 4 : at + 4 + length].partition(b"\0")
        pairs[key.decode()] = value
        padding = -length % 4
        assert not any(section[at + 4 + length : at + 4 + length + padding])
        at += 4 + length + padding
    assert at == len(section)
    return pairs


def decoded(texels, facts, scale):
    """Distances by the formula that a file states for its texels."""
    name, _, formula = facts["decode"].partition(" = ")
    assert name == "distance"
    assert str(texels.dtype) == facts["texel"]
    operand = "texel" if "texel" in formula else facts["texel"].replace("uint", "u")
    return eval(formula, {"__builtins__": {}}, {operand: texels.astype(np.float64), "scale": scale})


@pytest.mark.parametrize("encoding", DTYPES)
@pytest.mark.parametrize("ending", [".dds", ".ktx2"])
def test_a_texture_states_how_it_is_decoded(volume, encoding, ending, tmp_path):
    volume.save(tmp_path / f"v{ending}", encoding=encoding)
    content = (tmp_path / f"v{ending}").read_bytes()
    if ending == ".dds":
        facts, offset = json.loads((tmp_path / "v.dds.json").read_text()), 148
    else:
        pairs_at, pairs_size = struct.unpack_from("<2I", content, 56)
        facts = json.loads(key_values(content[pairs_at : pairs_at + pairs_size])["fieldbake"])
        (offset,) = struct.unpack_from("<Q", content, 80)

    texels = np.frombuffer(content, DTYPES[encoding], offset=offset).reshape(4, 5, 6)
    distances = decoded(texels, facts, facts["scale"]).T

    exact = volume.distances.astype(np.float64)
    bound = {"float32": 0, "float16": 2.0**-10, "snorm16": 2 / 32767, "snorm8": 2 / 127}[encoding]
    assert np.abs(distances - exact).max() <= bound * (1 + 2.0**-22)
    assert (np.abs(distances) <= np.abs(exact) * (1 + 2.0**-22)).all()


@pytest.mark.parametrize("encoding", DTYPES)
@pytest.mark.parametrize("ending", [".dds", ".ktx2"])
def test_textures_come_back(volume, encoding, ending, tmp_path):
    volume.save(tmp_path / f"v{ending}", encoding=encoding, band=2)

    found = fb.load(tmp_path / f"v{ending}")

    assert_same_place(found, volume)
    assert np.all(np.abs(found.distances) <= np.abs(volume.distances))
    texels = stored(volume, encoding, band=2).T.astype(np.float64)
    step = scale_of(volume, encoding, band=2) / STEPS.get(encoding, 1)
    assert np.allclose(found.distances, texels * step, rtol=4 * 2.0**-24, atol=0)


def test_the_report_of_a_bake_survives(baked, tmp_path):
    for ending in (".dds", ".ktx2", ".nrrd"):
        baked[0].save(tmp_path / f"gear{ending}")
        assert fb.load(tmp_path / f"gear{ending}").report == baked[0].report


# --- NRRD


def test_another_reader_finds_the_samples_in_their_place(volume, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    volume.save(tmp_path / "v.nrrd")

    samples, header = nrrd.read(str(tmp_path / "v.nrrd"), index_order="F")

    assert samples.dtype == np.float32
    assert np.array_equal(samples, volume.distances)
    assert np.allclose(header["space origin"], volume.origin)
    assert np.allclose(header["space directions"], np.diag(volume.spacing))


def test_a_nrrd_file_comes_back_bit_for_bit(volume, tmp_path):
    pytest.importorskip("nrrd")
    volume.save(tmp_path / "v.nrrd")

    found = fb.load(tmp_path / "v.nrrd")

    assert_same_place(found, volume)
    assert np.array_equal(found.distances, volume.distances)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"encoding: raw", b"encoding: gzip"),
        (b"encoding: raw", b"encoding: hex"),
        (b"sizes: 6 5 4", b"sizes: 60000 50000 40000"),
        (b"sizes: 6 5 4", b"sizes: -6 -5 4"),
        (b"type: float", b"type: double"),
        (b"type: float", b"type: block"),
        (b"encoding: raw", b"encoding: raw\ndata file: /etc/passwd"),
        (b'"kind": "volume texture"', b'"kind": "atlas image"'),
    ],
)
def test_hostile_nrrd_files(volume, tmp_path, before, after):
    volume.save(tmp_path / "v.nrrd", compression="none")
    content = (tmp_path / "v.nrrd").read_bytes()
    assert before in content
    (tmp_path / "v.nrrd").write_bytes(content.replace(before, after))

    with pytest.raises(fb.FormatError, match=r"v\.nrrd"):
        fb.load(tmp_path / "v.nrrd")


# --- atlases as images


@pytest.mark.parametrize("encoding", DTYPES)
def test_another_reader_finds_the_pages_in_the_exr(baked, encoding, tmp_path):
    openexr = pytest.importorskip("OpenEXR")
    atlas = fb.pack(baked * 5, page_size=64, encoding=encoding)
    assert len(atlas.pages) > 1
    atlas.save(tmp_path / "a.exr")

    with openexr.File(str(tmp_path / "a.exr")) as file:
        pixels = file.channels()["Y"].pixels.copy()

    assert pixels.dtype == (np.float16 if encoding == "float16" else np.float32)
    expected = atlas.pages.reshape(-1, 64)
    if encoding in STEPS:
        expected = (expected / STEPS[encoding]).astype(np.float32)
    assert np.array_equal(pixels, expected)


@pytest.mark.parametrize("encoding", ["snorm16", "snorm8"])
def test_another_reader_finds_the_pages_in_the_png(baked, encoding, tmp_path):
    imageio = pytest.importorskip("imageio.v3")
    atlas = fb.pack(baked, page_size=64, encoding=encoding)
    atlas.save(tmp_path / "a.png")

    pixels = imageio.imread(tmp_path / "a.png").astype(np.int64)

    middle = 32768 if encoding == "snorm16" else 128
    assert np.array_equal(pixels - middle, atlas.pages.reshape(-1, 64))
    preview = imageio.imread(tmp_path / "a.preview.png")
    assert preview.dtype == np.uint8
    assert preview.shape == pixels.shape


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("encoding", DTYPES)
@pytest.mark.parametrize("ending", [".exr", ".png"])
def test_images_of_an_atlas_come_back(layout, encoding, ending, tmp_path):
    values = np.random.default_rng(1).uniform(-1, 1, (3, 6, 6, 6))
    volumes = [fb.Volume(v, [(0, 0, 0), (1, 1, 1)]) for v in values]
    atlas = fb.pack(volumes, layout=layout, page_size=40, encoding=encoding)
    atlas.remove(1)
    atlas.save(tmp_path / f"a{ending}")

    found = fb.load(tmp_path / f"a{ending}")

    if ending == ".exr" or encoding in STEPS:
        assert np.array_equal(found.pages, atlas.pages)
        assert found.entries.tobytes() == atlas.entries.tobytes()
    else:
        # Floats in 16 bits: each volume scaled to its largest distance, and never beyond the truth.
        assert found.encoding == "snorm16"
        for i in (0, 2):
            exact, kept = atlas.unpack(i).distances, found.unpack(i).distances
            assert np.all(np.abs(kept) <= np.abs(exact))
            assert np.abs(kept - exact).max() <= np.abs(exact).max() / 32767 * (1 + 1e-5)
    assert found.add(volumes[1]) == 1


def texels_of(pixels, facts, volume):
    """The texels [x, y, z] of a volume in an image, by its record in the JSON."""
    (nx, ny, nz), (width, height) = volume["shape"], volume["tile"]
    left, top = volume["corner"][0], volume["corner"][1] + volume["page"] * facts["page_size"]
    found = np.empty((nx, ny, nz), pixels.dtype)
    for z in range(nz):
        x = left + z % volume["columns"] * width + volume["gutter"]
        y = top + z // volume["columns"] * height + volume["gutter"]
        found[:, :, z] = pixels[y : y + ny, x : x + nx].T
    return found


@pytest.mark.parametrize("layout", ["shelves", "strips"])
@pytest.mark.parametrize("encoding", DTYPES)
@pytest.mark.parametrize("ending", [".exr", ".png"])
def test_the_json_of_an_image_decodes_its_texels(layout, encoding, ending, tmp_path):
    reader = pytest.importorskip("OpenEXR" if ending == ".exr" else "imageio.v3")
    shape = (12, 12, 12)
    fields = [fb.bake(fb.models.gear(), shape), fb.bake(fb.models.torus_knot(), shape)]
    atlas = fb.pack(fields, layout=layout, page_size=150, encoding=encoding)
    path = tmp_path / f"a{ending}"
    atlas.save(path)

    if ending == ".exr":
        with reader.File(str(path)) as file:
            pixels = file.channels()["Y"].pixels.copy()
    else:
        pixels = reader.imread(path)
    facts = json.loads((tmp_path / f"a{ending}.json").read_text())

    for i, (volume, exact) in enumerate(zip(facts["volumes"], fields, strict=True)):
        # A .png of floats is another encoding, with scales of its own.
        if "scale" in atlas.entries.dtype.names and (ending == ".exr" or encoding in STEPS):
            assert volume["scale"] == atlas.entries["scale"][i]
        distances = decoded(texels_of(pixels, facts, volume), facts, volume["scale"])
        kept = atlas.unpack(i).distances.astype(np.float64)
        # The values of an .exr are rounded to float32; floats in a .png are cut to steps of the largest distance.
        step = np.abs(kept).max() / 32767 if ending == ".png" and encoding not in STEPS else 0
        assert np.abs(distances - kept).max() <= step + 2.0**-22 * np.abs(kept).max()
        assert np.abs(distances).max() <= np.abs(exact.distances).max() * (1 + 2.0**-22)


def test_the_json_says_where_each_volume_lies(baked, tmp_path):
    atlas = fb.pack(baked, page_size=64)
    atlas.save(tmp_path / "a.exr")

    facts = json.loads((tmp_path / "a.exr.json").read_text())

    assert facts["page_size"] == 64
    assert [volume["shape"] for volume in facts["volumes"]] == [list(volume.resolution) for volume in baked]
    assert [volume["corner"] for volume in facts["volumes"]] == atlas.entries["corner"].tolist()
    assert facts["volumes"][0]["bounds"] == baked[0].bounds.tolist()


# --- loading one kind of object


def test_each_class_loads_its_own_files_and_no_others(volume, tmp_path):
    stored = {
        "v.npz": (fb.Volume, volume),
        "v.dds": (fb.Volume, volume),
        "q.npz": (fb.QuantizedVolume, volume.quantize("snorm8")),
        "s.npz": (fb.SparseVolume, volume.to_sparse()),
        "a.npz": (fb.Atlas, fb.pack([volume], page_size=64)),
        "a.exr": (fb.Atlas, fb.pack([volume], page_size=64)),
    }
    for name, (kind, one) in stored.items():
        path = tmp_path / name
        one.save(path)
        assert type(kind.load(path)) is kind
        for other in (fb.Volume, fb.SparseVolume, fb.Atlas):
            if not issubclass(kind, other):
                with pytest.raises(
                    fb.FormatError, match=f"holds an? {kind.__name__}, not an? {other.__name__}"
                ) as told:
                    other.load(path)
                assert "\n" not in str(told.value)
    assert isinstance(fb.Volume.load(tmp_path / "q.npz"), fb.QuantizedVolume)
    with pytest.raises(fb.FormatError, match="holds a Volume, not a QuantizedVolume"):
        fb.QuantizedVolume.load(tmp_path / "v.npz")
    with pytest.raises(FileNotFoundError):
        fb.Volume.load(tmp_path / "nothing.npz")


# --- mistakes and hostile files


def test_endings_that_are_not_known(volume, tmp_path):
    stored = {
        "a volume is written as .npz, .vdb, .nvdb, .vti, .nrrd, .dds, .ktx2, .vf or .exr, got the ending '.x'": volume,
        "a sparse volume is written as .npz, .vdb or .nvdb, got the ending '.exr'": volume.to_sparse(),
        "an atlas is written as .npz, .exr or .png, got the ending '.dds'": fb.pack([volume], page_size=64),
    }
    for message, one in stored.items():
        ending = message.split("'")[1]
        with pytest.raises(fb.FormatError, match=re.escape(message)):
            one.save(tmp_path / f"x{ending}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["volume", "quantized", "sparse", "atlas"])
def test_every_ending_that_a_message_names_is_written(volume, kind, tmp_path):
    one = {
        "volume": volume,
        "quantized": volume.quantize("snorm8"),
        "sparse": volume.to_sparse(),
        "atlas": fb.pack([volume], page_size=64),
    }[kind]
    with pytest.raises(fb.FormatError) as told:
        one.save(tmp_path / "x.unknown")
    endings = re.findall(r"\.\w+", str(told.value).partition("written as")[2].partition("got")[0])
    assert len(endings) >= 1
    for ending in endings:
        one.save(tmp_path / f"x{ending}")
        fb.load(tmp_path / f"x{ending}")


def test_encodings_that_a_file_cannot_have(volume, tmp_path):
    with pytest.raises(fb.ArgumentError, match="encoding"):
        volume.save(tmp_path / "v.npz", encoding="float16")
    with pytest.raises(fb.ArgumentError, match="encoding"):
        volume.save(tmp_path / "v.nrrd", encoding="snorm8")
    with pytest.raises(fb.ArgumentError, match="encoding"):
        volume.save(tmp_path / "v.dds", encoding="bc4")


def test_an_empty_atlas_has_no_image(tmp_path):
    with pytest.raises(fb.FormatError, match="empty"):
        fb.pack([], page_size=16).save(tmp_path / "a.exr")


def test_a_missing_json_is_named(volume, tmp_path):
    for name, one in (("v.dds", volume), ("a.png", fb.pack([volume], page_size=64, encoding="snorm8"))):
        one.save(tmp_path / name)
        (tmp_path / f"{name}.json").unlink()
        with pytest.raises(fb.FormatError, match=rf"{name}\.json is missing"):
            fb.load(tmp_path / name)


HOSTILE = {
    "newer": {"version": 99},
    "another program": {"format": "other"},
    "another kind": {"kind": "volume"},
    "more pages": {"pages": 2},
    "huge": {"page_size": 32768, "pages": 60000},
    "size of text": {"page_size": "large"},
    "another size": {"page_size": 32},
    "another encoding": {"encoding": "float16"},
    "no volumes": {"volumes": None},
    "volumes of text": {"volumes": ["a", "b"]},
    "volumes of nothing": {"volumes": [{}, {}]},
}


def write_facts(path, atlas, facts):
    """Write an image of an atlas with other metadata: in the .exr itself, beside the .png."""
    if path.suffix == ".png":
        path.with_name("a.png.json").write_text(json.dumps(facts))
        return
    texels = atlas.pages.reshape(-1, atlas.page_size)
    path.write_bytes(exr.write_channel(texels if texels.dtype.kind == "f" else shares(texels), facts))


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("ending", [".exr", ".png"])
def test_facts_that_do_not_fit_the_image(baked, name, ending, tmp_path):
    path = tmp_path / f"a{ending}"
    atlas = fb.pack(baked, page_size=64, encoding="snorm8")
    atlas.save(path)
    facts = json.loads(path.with_name(f"a{ending}.json").read_text())
    write_facts(path, atlas, facts)
    assert np.array_equal(fb.load(path).pages, atlas.pages)
    write_facts(path, atlas, {**facts, **HOSTILE[name]})

    with pytest.raises(fb.FormatError, match=rf"a\{ending}"):
        fb.load(path)


@pytest.mark.parametrize("key", ["page", "corner", "tile", "columns", "gutter", "shape", "model", "scale", "bounds"])
@pytest.mark.parametrize("value", [None, -1, 2**200, [1e300, 1e300], "x", [[]]])
def test_bad_facts_of_a_volume(baked, key, value, tmp_path):
    atlas = fb.pack(baked, page_size=64)
    atlas.save(tmp_path / "a.exr")
    facts = json.loads((tmp_path / "a.exr.json").read_text())
    facts["volumes"][1][key] = value
    write_facts(tmp_path / "a.exr", atlas, facts)

    with pytest.raises(fb.FormatError):
        fb.load(tmp_path / "a.exr")


@given(data=st.data(), ending=st.sampled_from([".dds", ".ktx2", ".nrrd", ".exr", ".png"]))
def test_a_damaged_file_is_a_format_error_or_other_texels(volume, tmp_path_factory, data, ending):
    path = tmp_path_factory.getbasetemp() / f"damaged{ending}"
    one = volume if ending in (".dds", ".ktx2", ".nrrd") else fb.pack([volume], page_size=32, encoding="snorm16")
    one.save(path)
    drop_checksum(path)
    path.write_bytes(damaged(data, path.read_bytes()))

    try:
        found = fb.load(path)
    except fb.FormatError:
        return
    assert np.isfinite(found.distances if isinstance(found, fb.Volume) else found.unpack(0).distances).all()


def fuzz(volume, folder, ending, count):
    """Load `count` damaged files, seeded; how many were refused."""
    paths = [folder / f"{encoding}{ending}" for encoding in DTYPES]
    for path, encoding in zip(paths, DTYPES, strict=True):
        volume.save(path, encoding=encoding)
    contents = [path.read_bytes() for path in paths]
    random = np.random.default_rng(20261121)
    refused = 0
    for number in range(count):
        path, content = paths[number % 4], bytearray(contents[number % 4])
        # Most damage goes to the header and the descriptors, whose fields the reader follows.
        reach = len(content) if number % 5 == 0 else 300
        for _ in range(random.integers(1, 5)):
            at = int(random.integers(min(reach, len(content))))
            kind = random.integers(4)
            if kind == 0:
                content[at] ^= 1 << int(random.integers(8))
            elif kind == 1:
                content[at] = int(random.choice([0, 1, 0x7F, 0x80, 0xFF]))
            elif kind == 2:
                content[at : at + 4] = int(random.choice([0, 1, 4, 2**31, 2**32 - 1])).to_bytes(4, "little")
            else:
                del content[at : at + int(random.integers(1, 9))]
        path.write_bytes(content)
        try:
            found = fb.load(path)
        except fb.FormatError:
            refused += 1
            continue
        assert np.isfinite(found.distances).all()
        assert found.distances.shape == volume.resolution
    return refused


@pytest.mark.parametrize("ending", [".ktx2", ".dds"])
def test_damaged_textures_are_refused_without_a_panic(volume, ending, tmp_path, capfd):
    refused = fuzz(volume, tmp_path, ending, 600)
    # A panic of the core writes to stderr although it becomes an exception.
    assert capfd.readouterr().err == ""
    assert 100 < refused < 600


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".ktx2", ".dds"])
def test_many_damaged_textures_are_refused_without_a_panic(volume, ending, tmp_path, capfd):
    refused = fuzz(volume, tmp_path, ending, 20_000)
    assert capfd.readouterr().err == ""
    assert 2000 < refused < 20_000


def test_every_byte_of_a_ktx2_header_may_be_anything(volume, tmp_path, capfd):
    path = tmp_path / "v.ktx2"
    volume.save(path)
    content = path.read_bytes()
    for at in range(200):
        for value in (0, 1, 255):
            path.write_bytes(content[:at] + bytes([value]) + content[at + 1 :])
            with contextlib.suppress(fb.FormatError):
                assert fb.load(path).resolution == volume.resolution
    for end in range(0, len(content), 3):
        path.write_bytes(content[:end])
        with pytest.raises(fb.FormatError):
            fb.load(path)
    assert capfd.readouterr().err == ""
