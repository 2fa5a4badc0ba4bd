"""Grids for other programs: OpenVDB, NanoVDB, VTK, textures, flipbooks and .vf, by independent readers."""

import json
import struct
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
import vdb_bytes
from damage import damaged, drop_checksum
from system_python import openvdb_python

ENDINGS = (".vdb", ".nvdb", ".vti", ".nrrd", ".dds", ".ktx2", ".vf", ".exr")


def clipped(volume, voxels=3):
    band = np.float32(voxels * volume.spacing.max())
    return np.clip(volume.distances, -band, band), band


# --- OpenVDB


@pytest.mark.parametrize("compression", ["zip", "none"])
@pytest.mark.parametrize("encoding", ["float32", "float16"])
@pytest.mark.parametrize("engine", [None, "blender", "unreal"])
def test_a_vdb_file_is_a_narrow_band_level_set(solid, compression, encoding, engine, tmp_path):
    solid.save(tmp_path / "v.vdb", compression=compression, encoding=encoding, engine=engine)

    found = vdb_bytes.read((tmp_path / "v.vdb").read_bytes())

    expected, band = clipped(solid)
    order, signs = {None: ((0, 1, 2), (1, 1, 1)), "blender": ((0, 2, 1), (1, -1, 1)), "unreal": ((0, 2, 1), (1, 1, 1))}[
        engine
    ]
    expected = expected.transpose(order)[tuple(slice(None, None, sign) for sign in signs)]
    values, active = vdb_bytes.dense(found, expected.shape)
    assert found["metadata"]["class"] == "level set"
    assert found["tree"] == "Tree_float_5_4_3" + ("_HalfFloat" if encoding == "float16" else "")
    kind, origin, scale = found["map"]
    assert kind == "UniformScaleTranslateMap"
    assert np.allclose(scale, solid.spacing[0], rtol=1e-12)
    centers = [solid.origin, solid.origin + (np.array(solid.resolution) - 1) * solid.spacing]
    assert np.allclose(origin, [centers[sign < 0][axis] * sign for axis, sign in zip(order, signs, strict=True)])
    if encoding == "float32":
        assert found["background"] == band
        assert np.array_equal(values, expected)
        assert np.array_equal(active, np.abs(expected) < band)
    else:
        # Half floats have 11 significant bits, so they are off by 2^-11 of a magnitude; the band is one of them.
        assert found["background"] == np.float32(np.float16(band))
        assert np.abs(values - expected).max() <= band * 2.0**-11
    low, high = np.argwhere(active).min(axis=0), np.argwhere(active).max(axis=0)
    assert found["metadata"]["file_bbox_min"] == tuple(low)
    assert found["metadata"]["file_bbox_max"] == tuple(high)
    assert found["metadata"]["file_voxel_count"] == (active.sum(),)


def test_the_interior_of_a_vdb_file_has_tiles_of_minus_the_band(tmp_path):
    volume = fb.bake(fb.box(2), 150)
    volume.save(tmp_path / "v.vdb")
    found = vdb_bytes.read((tmp_path / "v.vdb").read_bytes())
    expected, band = clipped(volume)
    assert found["tiles"]
    assert {value for _, value in found["tiles"].values()} == {-band}
    assert np.array_equal(vdb_bytes.dense(found, expected.shape)[0], expected)


def test_band_and_oblong_voxels_of_a_vdb_file(tmp_path):
    volume = fb.bake(fb.sphere(1), (20, 30, 40))
    volume.save(tmp_path / "v.vdb", band=5)
    found = vdb_bytes.read((tmp_path / "v.vdb").read_bytes())
    expected, band = clipped(volume, 5)
    assert found["background"] == band
    assert found["map"][0] == "ScaleTranslateMap"
    assert np.array_equal(found["map"][2], volume.spacing)
    assert np.array_equal(vdb_bytes.dense(found, volume.resolution)[0], expected)


@pytest.mark.parametrize("radius", [1e-7, 1e-6, 4e-4, 1e-3, 1e5, 3e5, 1e7])
def test_half_floats_of_a_vdb_file_keep_the_surface_or_are_refused(radius, tmp_path):
    for field in (fb.bake(fb.sphere(radius), 20), fb.bake_sparse(fb.sphere(radius), 20)):
        if 1e-3 <= radius <= 1e5:
            field.save(tmp_path / "v.vdb", encoding="float16")
            found = fb.load(tmp_path / "v.vdb")
            expected, band = clipped(field)
            # Half a step is 2^-11 of a magnitude, which is at most the band, or half a step of the smallest numbers.
            bound = max(band * 2.0**-11, 2.0**-25)
            assert np.abs(found.distances - expected).max() <= bound
            assert bound <= field.spacing[0] / 600
        else:
            message = r'^encoding: float16 stores voxels from 6\.1e-05 to 2\.18e\+04 .* use encoding="float32"$'
            with pytest.raises(fb.ArgumentError, match=message):
                field.save(tmp_path / "v.vdb", encoding="float16")


@pytest.mark.parametrize("encoding", ["float32", "snorm16"])
@pytest.mark.parametrize("tolerance", [None, 0.05])
def test_a_sparse_volume_fills_the_leaves_from_its_bricks(encoding, tolerance, tmp_path):
    sparse = fb.bake_sparse(fb.models.gear(), 60, encoding=encoding, tolerance=tolerance)
    for name, options in (("a.vdb", {}), ("b.vdb", {"engine": "unreal"}), ("c.nvdb", {})):
        sparse.save(tmp_path / name, **options)
        expected, band = clipped(sparse)
        expected = expected.transpose((0, 2, 1)) if options else expected
        found = fb.load(tmp_path / name)
        assert found.resolution == expected.shape
        # Coarse bricks are interpolated in float32: the two ways round differently, by a few units of the last place.
        assert np.abs(found.distances - expected).max() <= 8 * 2.0**-24 * band
        if name == "a.vdb":
            values, active = vdb_bytes.dense(vdb_bytes.read((tmp_path / name).read_bytes()), expected.shape)
            assert np.array_equal(values, found.distances)
            assert np.array_equal(active, np.abs(values) < band)


def test_a_volume_that_keeps_less_than_the_band_has_a_narrower_one(solid, tmp_path):
    narrow = solid.quantize("snorm16", band=2)
    narrow.save(tmp_path / "v.vdb")
    assert fb.load(tmp_path / "v.vdb").report.band == np.float32(narrow.scale)
    with pytest.raises(fb.ArgumentError, match="band: the volume keeps distances up to 2 voxels, got 3"):
        narrow.save(tmp_path / "v.vdb", band=3)


OPENVDB = """
import json, sys
import numpy as np
try:
    import pyopenvdb as vdb
except ImportError:
    import openvdb as vdb
path, answer, shape = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
(grid,), _ = vdb.readAll(path)
values = np.empty(shape, np.float32)
grid.copyToArray(values)
np.savez(answer, values=values, background=grid.background, kind=str(grid.gridClass),
    place=[grid.transform.indexToWorld((0, 0, 0)), grid.transform.indexToWorld((1, 2, 3))],
    active=grid.activeVoxelCount(), half=grid.saveFloatAsHalf)
sphere = vdb.createLevelSetSphere(radius=3.0, center=(1, 2, 3), voxelSize=0.25)
sphere.name = "sphere"
fog = vdb.FloatGrid(0.0)
fog.gridClass = vdb.GridClass.FOG_VOLUME
fog.fill((0, 0, 0), (9, 9, 9), 1.0)
fog.name = "fog"
vdb.write(answer + ".vdb", [fog, sphere])
"""


@pytest.fixture(scope="module")
def openvdb(tmp_path_factory):
    """A function that reads a file by libopenvdb, and a file that libopenvdb wrote."""
    python = openvdb_python()
    folder = tmp_path_factory.mktemp("openvdb")

    def read(path, shape):
        answer = folder / "answer.npz"
        command = [python, "-c", OPENVDB, path, answer, json.dumps(shape)]
        subprocess.run(command, check=True, timeout=60, capture_output=True)
        return dict(np.load(answer)), Path(f"{answer}.vdb")

    return read


@pytest.mark.parametrize("encoding", ["float32", "float16"])
def test_libopenvdb_finds_the_same_voxels(solid, openvdb, encoding, tmp_path):
    expected, band = clipped(solid)
    for compression in ("zip", "none"):
        solid.save(tmp_path / "v.vdb", compression=compression, encoding=encoding)
        found, _ = openvdb(tmp_path / "v.vdb", solid.resolution)
        assert "LevelSet" in str(found["kind"]) or "level set" in str(found["kind"])
        bound = 0 if encoding == "float32" else band * 2.0**-11
        assert abs(found["background"] - band) <= bound
        assert np.abs(found["values"] - expected).max() <= bound
        assert found["active"] == (np.abs(expected) < band).sum()
        assert np.allclose(found["place"], [solid.origin, solid.origin + solid.spacing * (1, 2, 3)], rtol=1e-12)


def test_a_level_set_of_libopenvdb_is_read(solid, openvdb, tmp_path):
    solid.save(tmp_path / "v.vdb")
    _, theirs = openvdb(tmp_path / "v.vdb", solid.resolution)

    found = fb.Volume.load(theirs)

    # Debian's library packs with Blosc. The level set comes second in the file, after a fog volume.
    x, y, z = np.meshgrid(*[found.origin[i] + np.arange(found.resolution[i]) * 0.25 for i in range(3)], indexing="ij")
    exact = np.sqrt((x - 1) ** 2 + (y - 2) ** 2 + (z - 3) ** 2) - 3
    assert np.abs(found.distances - np.clip(exact, -0.75, 0.75)).max() <= 1e-6
    assert found.report.band == 0.75


# --- NanoVDB


def test_a_nvdb_file_is_a_tree_of_32_byte_records(solid, tmp_path):
    """The tree is walked by the offsets that ``NanoVDB.h`` states, for 1,000 voxels."""
    solid.save(tmp_path / "v.nvdb")
    content = (tmp_path / "v.nvdb").read_bytes()
    expected, band = clipped(solid)
    name_size = struct.unpack_from("<I", content, 16 + 136)[0]
    grid = 16 + 176 + name_size
    assert content[:8] == b"NanoVDB0"
    assert struct.unpack_from("<Q", content, 16)[0] == len(content) - grid
    assert struct.unpack_from("<2I", content, grid + 632) == (1, 1)
    scale = np.array(struct.unpack_from("<9d", content, grid + 296 + 88)).reshape(3, 3)
    assert np.array_equal(scale, np.diag(solid.spacing))
    assert np.array_equal(struct.unpack_from("<3d", content, grid + 296 + 88 + 144), solid.origin)
    tree = grid + 672
    root = tree + struct.unpack_from("<4q", content, tree)[3]
    tiles, background = struct.unpack_from("<If", content, root + 24)
    assert (tiles, background) == (1, band)
    upper = root + struct.unpack_from("<q", content, root + 64 + 8)[0]
    voxels = np.random.default_rng(3).integers(0, solid.resolution, (1000, 3))
    near = np.argwhere(np.abs(expected) < band)
    voxels[:500] = near[np.random.default_rng(4).integers(0, len(near), 500)]

    def bit(at, n):
        return content[at + n // 8] >> n % 8 & 1

    for x, y, z in voxels.tolist():
        slot = ((x >> 7) * 32 + (y >> 7)) * 32 + (z >> 7)
        table = upper + 32 + 2 * 4096 + 32 + 8 * slot
        if not bit(upper + 32 + 4096, slot):
            value = struct.unpack_from("<f", content, table)[0]
        else:
            lower = upper + struct.unpack_from("<q", content, table)[0]
            slot = ((x >> 3 & 15) * 16 + (y >> 3 & 15)) * 16 + (z >> 3 & 15)
            table = lower + 32 + 2 * 512 + 32 + 8 * slot
            if not bit(lower + 32 + 512, slot):
                value = struct.unpack_from("<f", content, table)[0]
            else:
                leaf = lower + struct.unpack_from("<q", content, table)[0]
                slot = ((x & 7) * 8 + (y & 7)) * 8 + (z & 7)
                value = struct.unpack_from("<f", content, leaf + 96 + 4 * slot)[0]
                assert bit(leaf + 16, slot) == (abs(value) < band)
        assert np.float32(value) == expected[x, y, z]


# --- VTK


@pytest.mark.parametrize("compression", ["zip", "none"])
def test_pyvista_reads_a_vti_file(solid, compression, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    solid.save(tmp_path / "v.vti", compression=compression)

    grid = pyvista.read(tmp_path / "v.vti")

    assert grid.dimensions == solid.resolution
    assert np.allclose(grid.origin, solid.origin, rtol=1e-12)
    assert np.allclose(grid.spacing, solid.spacing, rtol=1e-12)
    assert np.array_equal(grid.point_data["distances"].reshape(solid.resolution, order="F"), solid.distances)
    points = np.random.default_rng(1).uniform(solid.origin + 1e-6, solid.bounds[1] - solid.spacing * 0.5001, (1000, 3))
    probed = pyvista.PolyData(points).sample(grid)["distances"]
    assert np.abs(probed - solid.sample(points)).max() <= 1e-5


@pytest.mark.parametrize("form", ["ascii", "binary", "appended"])
def test_a_vti_file_of_vtk_is_read(solid, form, tmp_path):
    vtk = pytest.importorskip("vtk")
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.ImageData(dimensions=solid.resolution, spacing=solid.spacing, origin=solid.origin)
    grid.point_data["other"] = np.arange(grid.n_points, dtype=np.float32).repeat(3).reshape(-1, 3)
    grid.point_data["field"] = solid.distances.ravel(order="F")
    writer = vtk.vtkXMLImageDataWriter()
    writer.SetFileName(str(tmp_path / "v.vti"))
    writer.SetInputData(grid)
    getattr(
        writer, {"ascii": "SetDataModeToAscii", "binary": "SetDataModeToBinary"}.get(form, "SetDataModeToAppended")
    )()
    writer.Write()

    found = fb.Volume.load(tmp_path / "v.vti")

    assert np.allclose(found.bounds, solid.bounds, rtol=1e-12)
    # Text has six significant digits.
    assert np.allclose(found.distances, solid.distances, rtol=1e-5 if form == "ascii" else 0)


def test_a_vti_file_has_its_samples_as_raw_bytes(solid, tmp_path):
    solid.save(tmp_path / "v.vti", compression="none")
    head, _, rest = (tmp_path / "v.vti").read_bytes().partition(b'<AppendedData encoding="raw">\n_')
    image = ElementTree.fromstring(head + b"</VTKFile>").find("ImageData")
    assert [float(word) for word in image.get("Origin").split()] == solid.origin.tolist()
    assert [float(word) for word in image.get("Spacing").split()] == solid.spacing.tolist()
    assert image.get("WholeExtent") == " ".join(f"0 {side - 1}" for side in solid.resolution)
    (size,) = struct.unpack_from("<Q", rest)
    assert size == solid.distances.nbytes
    assert np.array_equal(np.frombuffer(rest, "<f4", size // 4, 8), solid.distances.ravel(order="F"))


# --- textures, sheets and .vf


@pytest.mark.parametrize("ending", [".dds", ".ktx2"])
def test_unsigned_bytes_have_distance_0_at_their_middle(solid, ending, tmp_path):
    solid.save(tmp_path / f"v{ending}", encoding="unorm8", band=2)
    content = (tmp_path / f"v{ending}").read_bytes()
    nx, ny, nz = solid.resolution
    texels = np.frombuffer(content[-nx * ny * nz :], np.uint8).reshape(nz, ny, nx).T
    if ending == ".dds":
        assert struct.unpack_from("<I", content, 128)[0] == 61  # DXGI_FORMAT_R8_UNORM
    else:
        assert struct.unpack_from("<I", content, 12)[0] == 9  # VK_FORMAT_R8_UNORM
    scale = 2 * solid.spacing.max()
    decoded = (texels / 127.5 - 1) * scale
    # Half a step, and one rounding of the scale to float32.
    assert np.abs(decoded - np.clip(solid.distances, -scale, scale)).max() <= scale / 255 * (1 + 1e-5)
    assert np.array_equal(texels < 128, solid.distances < 0)
    assert np.abs(fb.load(tmp_path / f"v{ending}").distances - decoded).max() <= 1e-6


@pytest.mark.parametrize("ending", [".dds", ".ktx2"])
def test_mipmaps_halve_the_sides_over_the_same_box(ending, tmp_path):
    volume = fb.bake(fb.models.gear(), (20, 12, 9))
    volume.save(tmp_path / f"v{ending}", mipmaps=True)
    content = (tmp_path / f"v{ending}").read_bytes()
    shapes = [(20, 12, 9), (10, 6, 4), (5, 3, 2), (2, 1, 1), (1, 1, 1)]
    if ending == ".dds":
        assert struct.unpack_from("<I", content, 28)[0] == len(shapes)
        at, starts = 148, []
        for shape in shapes:
            starts.append(at)
            at += 4 * int(np.prod(shape))
        assert at == len(content)
    else:
        assert struct.unpack_from("<I", content, 40)[0] == len(shapes)
        index = [struct.unpack_from("<3Q", content, 80 + 24 * i) for i in range(len(shapes))]
        starts = [start for start, *_ in index]
        assert [length for _, length, _ in index] == [4 * int(np.prod(shape)) for shape in shapes]
        assert starts == sorted(starts, reverse=True)
    levels = [
        np.frombuffer(content, "<f4", int(np.prod(shape)), start).reshape(shape, order="F")
        for shape, start in zip(shapes, starts, strict=True)
    ]
    assert np.array_equal(levels[0], volume.distances)
    # 20 and 12 halve to whole voxels, so a coarse sample is the mean of the fine ones along x and y.
    fine = levels[1].astype(float)
    assert np.abs(levels[2][:, :, 0] - fine.reshape(5, 2, 3, 2, 2, 2).mean(axis=(1, 3, 5))[:, :, 0]).max() <= 1e-6
    assert np.array_equal(fb.load(tmp_path / f"v{ending}").distances, volume.distances)


@pytest.mark.parametrize("encoding", ["float32", "float16"])
@pytest.mark.parametrize("engine", [None, "unity", "godot", "unreal"])
def test_a_sheet_has_the_slices_as_tiles(encoding, engine, tmp_path):
    exr = pytest.importorskip("OpenEXR")
    volume = fb.bake(fb.models.gear(), (12, 10, 15))
    volume.save(tmp_path / "v.exr", encoding=encoding, engine=engine)

    with exr.File(str(tmp_path / "v.exr")) as file:
        pixels = file.channels()["Y"].pixels.astype(float)
    facts = json.loads((tmp_path / "v.exr.json").read_text())

    expected = volume.distances.astype(float)
    if engine == "unity":
        expected = expected[::-1] / (volume.bounds[1] - volume.bounds[0]).max()
    elif engine == "unreal":
        expected = expected.transpose(0, 2, 1)
    nx, ny, nz = expected.shape
    columns = facts["sheet"]["columns"]
    assert columns == (1 if engine == "godot" else columns)
    assert pixels.shape == (nz // columns * ny, columns * nx)
    for z in range(nz):
        row, column = divmod(z, columns)
        tile = pixels[row * ny : (row + 1) * ny, column * nx : (column + 1) * nx] * facts["scale"]
        tile = tile[::-1] if engine == "unity" else tile
        bound = 1e-6 if encoding == "float32" else np.abs(expected).max() * 2.0**-10
        assert np.abs(tile.T - expected[:, :, z]).max() <= bound
    if engine == "unity":
        text = (tmp_path / "v.exr.meta").read_text()
        for line in (f"flipbookColumns: {columns}", "textureShape: 8", "sRGBTexture: 0", "textureCompression: 0"):
            assert line in text
        volume.save(tmp_path / "v.exr", engine="unity")
        assert (tmp_path / "v.exr.meta").read_text().splitlines()[1] == text.splitlines()[1]
    if engine == "godot":
        text = (tmp_path / "v.exr.import").read_text()
        for line in ('importer="3d_texture"', "slices/horizontal=1", f"slices/vertical={nz}", "compress/mode=3"):
            assert line in text


def test_a_sheet_of_a_prime_number_of_slices_has_empty_tiles(tmp_path):
    volume = fb.Volume(np.random.default_rng(1).normal(size=(3000, 2, 7)), [(0, 0, 0), (3000, 2, 7)])
    volume.save(tmp_path / "v.exr")
    sheet = json.loads((tmp_path / "v.exr.json").read_text())["sheet"]
    assert sheet["columns"] == 1
    tall = fb.Volume(np.random.default_rng(1).normal(size=(300, 1500, 11)), [(0, 0, 0), (3, 15, 1)])
    tall.save(tmp_path / "w.exr", columns=4)
    assert np.array_equal(fb.load(tmp_path / "w.exr").distances, tall.distances)
    tall.save(tmp_path / "w.exr")
    sheet = json.loads((tmp_path / "w.exr.json").read_text())["sheet"]
    assert (sheet["columns"] - 1) * sheet["rows"] < 11 <= sheet["columns"] * sheet["rows"]
    assert max(sheet["columns"] * 300, sheet["rows"] * 1500) <= 16384
    assert np.array_equal(fb.load(tmp_path / "w.exr").distances, tall.distances)


def test_a_vf_file_has_the_samples_after_ten_bytes(solid, tmp_path):
    solid.save(tmp_path / "v.vf")
    content = (tmp_path / "v.vf").read_bytes()
    assert struct.unpack_from("<4s3H", content) == (b"VF_F", *solid.resolution)
    assert np.array_equal(np.frombuffer(content, "<f4", offset=10), solid.distances.ravel(order="F"))
    (tmp_path / "v.vf.json").unlink()
    message = r"^v\.vf: .* v\.vf\.json is missing or has none; the longest side of the box is 1, "
    with pytest.warns(UserWarning, match=message) as caught:
        found = fb.Volume.load(tmp_path / "v.vf")
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert np.array_equal(found.distances, solid.distances)
    assert np.allclose(found.bounds.mean(axis=0), 0)
    assert (found.bounds[1] - found.bounds[0]).max() == pytest.approx(1)


# --- all of them

IN_FILE = {
    "unity": lambda p, bounds: (p - bounds.mean(axis=0)) * (-1, 1, 1) / (bounds[1] - bounds[0]).max(),
    "unreal": lambda p, _: p[:, [0, 2, 1]],
    "godot": lambda p, _: p,
    "blender": lambda p, _: np.column_stack([p[:, 0], -p[:, 2], p[:, 1]]),
    "three": lambda p, _: p,
}


@pytest.mark.parametrize("ending", [".npz", *ENDINGS])
@pytest.mark.parametrize("engine", IN_FILE)
def test_engines_find_a_point_where_their_axes_put_it(solid, ending, engine, tmp_path):
    solid.save(tmp_path / f"v{ending}", engine=engine)

    found = fb.load(tmp_path / f"v{ending}")

    points = np.random.default_rng(7).uniform(*solid.bounds, (1000, 3))
    scale = 1 / (solid.bounds[1] - solid.bounds[0]).max() if engine == "unity" else 1
    near = clipped(solid)[0] if ending.endswith("vdb") else solid.distances
    expected = fb.Volume(near, solid.bounds, inner_bounds=solid.inner_bounds).sample(points) * scale
    moved = found.sample(IN_FILE[engine](points, solid.bounds))
    # A thousandth of a voxel.
    assert np.abs(moved - expected).max() <= 1e-3 * solid.spacing.max() * scale


def test_left_handed_axes_are_named_in_ktx2(solid, tmp_path):
    for engine, orientation in (("unity", b"rui\0"), (None, b"ruo\0")):
        solid.save(tmp_path / "v.ktx2", engine=engine)
        assert b"KTXorientation\0" + orientation in (tmp_path / "v.ktx2").read_bytes()[:400]


@pytest.mark.parametrize("first", [".npz", *ENDINGS])
def test_every_pair_of_formats_keeps_the_field(solid, first, tmp_path):
    solid.save(tmp_path / f"a{first}")
    once = fb.load(tmp_path / f"a{first}")
    for second in ENDINGS:
        once.save(tmp_path / f"b{second}")
        twice = fb.load(tmp_path / f"b{second}")
        narrow = first.endswith("vdb") or second.endswith("vdb")
        expected = clipped(solid)[0] if narrow else solid.distances
        assert np.array_equal(twice.bounds, solid.bounds)
        assert np.array_equal(twice.inner_bounds, solid.inner_bounds)
        assert np.array_equal(twice.distances, expected)


def test_options_that_a_format_does_not_have(solid, tmp_path):
    for name, option in {
        "v.vf": {"encoding": "float16"},
        "v.vti": {"mipmaps": True},
        "v.dds": {"compression": "zip"},
        "v.ktx2": {"columns": 3},
        "v.vdb": {"band": -1},
        "v.npz": {"engine": "cryengine"},
        "v.nrrd": {"up": "x"},
        "v.nvdb": {"handedness": "both"},
        "v.exr": {"normalize": 1},
    }.items():
        with pytest.raises(fb.ArgumentError, match=next(iter(option))):
            solid.save(tmp_path / name, **option)
    assert list(tmp_path.iterdir()) == []


@given(data=st.data(), ending=st.sampled_from(ENDINGS))
def test_a_damaged_grid_is_a_format_error_or_other_samples(solid, tmp_path_factory, data, ending):
    small = fb.Volume(solid.distances[:9, :9, :9], [(0, 0, 0), (1, 1, 1)])
    path = tmp_path_factory.getbasetemp() / f"damaged{ending}"
    small.save(path)
    drop_checksum(path)
    path.write_bytes(damaged(data, path.read_bytes()))
    try:
        found = fb.load(path)
    except (fb.FormatError, fb.CapacityError):
        return
    assert np.isfinite(found.distances).all()
