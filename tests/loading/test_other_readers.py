"""Files of a body without symmetry, sampled at world points by readers of other projects."""

import json
import subprocess

import numpy as np
import pytest
import scipy.ndimage

import fieldbake as fb
from browser import WEB, node_tool
from system_python import openvdb_python

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

#: Positions in the file, from world positions.
IN_FILE = {
    None: lambda p: p,
    "unreal": lambda p: p[:, [0, 2, 1]],
    "blender": lambda p: np.column_stack([p[:, 0], -p[:, 2], p[:, 1]]),
}

#: Samples a level set at the points of a .npy file by libopenvdb: arguments are the level set, the points, the answer.
OPENVDB = """
import sys
from itertools import product
import numpy as np
try:
    import pyopenvdb as vdb
except ImportError:
    import openvdb as vdb
grid = vdb.readAllGridMetadata(sys.argv[1])[0]
grid = vdb.read(sys.argv[1], grid.name)
accessor = grid.getConstAccessor()
found = []
for p in np.load(sys.argv[2]):
    q = np.array(grid.transform.worldToIndex(tuple(p)))
    first = np.floor(q).astype(int)
    t = q - first
    total = 0.0
    for corner in map(np.array, product((0, 1), repeat=3)):
        total += np.where(corner, t, 1 - t).prod() * accessor.getValue(tuple(int(i) for i in first + corner))
    found.append(total)
np.save(sys.argv[3], np.array(found, np.float64))
"""


def shape():
    part = fb.sphere(0.4).translate((5.2, -2.6, 2.5))
    return (fb.box((2, 1, 0.5)).translate((4, -3, 2)) | part).rotate("z", 20)


@pytest.fixture(scope="module")
def body():
    """The field of the body and 1,000 points within the band, with a mirror image outside it for each axis."""
    volume = fb.bake(shape(), 45)
    # Between the outermost voxel centres, and so near to the surface that the band of 3 voxels has whole cells.
    lower, upper = volume.bounds[0] + volume.spacing, volume.bounds[1] - volume.spacing
    points = np.random.default_rng(3).uniform(lower, upper, (60_000, 3))
    values = volume.sample(points)
    near = np.abs(values) <= 1.2 * volume.spacing.max()
    points, values = points[near][:1000], values[near][:1000]
    assert len(points) == 1000
    # No mirrored or exchanged axes give the same values, so a wrong orientation fails.
    middle = volume.bounds.mean(axis=0)
    for axis in range(3):
        mirrored = points.copy()
        mirrored[:, axis] = 2 * middle[axis] - mirrored[:, axis]
        assert np.abs(volume.sample(mirrored) - values).max() > 3 * volume.spacing.max()
    return volume, points, values


def rounding(volume):
    """Bound on the rounding of positions and weights in float32, world units."""
    # Index coordinates are below 64, so an axis has an error of 2^-18 voxels, and a voxel changes by at most its size.
    return 3 * 2.0**-18 * 2 * float(volume.spacing.max())


def agree(found, values, bound):
    """Require the values of another reader within a bound, and print both figures (pytest -rP shows them)."""
    error = np.abs(np.asarray(found) - values).max()
    print(f"1,000 points: largest error {error:.2g}, bound {bound:.2g}")
    assert error <= bound


def interpolated(samples, box, points):
    """Trilinear values of samples [x, y, z] over a box."""
    share = (points - box[0]) / (box[1] - box[0])
    return scipy.ndimage.map_coordinates(samples.astype(np.float64), (share * samples.shape - 0.5).T, order=1)


@pytest.fixture(scope="module")
def python_with_openvdb():
    return openvdb_python()


@pytest.mark.parametrize("encoding", ["float32", "float16"])
@pytest.mark.parametrize("engine", IN_FILE)
def test_libopenvdb_samples_a_vdb_file(body, python_with_openvdb, engine, encoding, tmp_path):
    volume, points, values = body
    volume.save(tmp_path / "v.vdb", engine=engine, encoding=encoding)
    np.save(tmp_path / "points.npy", IN_FILE[engine](points))
    command = [python_with_openvdb, "-c", OPENVDB, tmp_path / "v.vdb", tmp_path / "points.npy", tmp_path / "answer.npy"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    # Half floats are rounded by 2^-11 of at most the band.
    step = 0 if encoding == "float32" else 3 * float(volume.spacing.max()) * 2.0**-11
    agree(np.load(tmp_path / "answer.npy"), values, rounding(volume) + step)


def test_pynrrd_samples_a_nrrd_file(body, tmp_path):
    nrrd = pytest.importorskip("nrrd")
    volume, points, values = body
    volume.save(tmp_path / "v.nrrd")
    samples, header = nrrd.read(str(tmp_path / "v.nrrd"))
    places = np.linalg.solve(header["space directions"].T, (points - header["space origin"]).T)
    agree(scipy.ndimage.map_coordinates(samples.astype(np.float64), places, order=1), values, rounding(volume))


def test_numpy_samples_a_npz_file(body, tmp_path):
    volume, points, values = body
    volume.save(tmp_path / "v.npz")
    with np.load(tmp_path / "v.npz", allow_pickle=False) as file:
        samples, header = file["distances"], json.loads(str(file["header"]))
    agree(interpolated(samples, np.array(header["bounds"]), points), values, rounding(volume))


@pytest.mark.parametrize("encoding", ["float32", "float16"])
def test_openexr_samples_a_sheet(body, encoding, tmp_path):
    exr = pytest.importorskip("OpenEXR")
    volume, points, values = body
    volume.save(tmp_path / "v.exr", encoding=encoding)
    facts = json.loads((tmp_path / "v.exr.json").read_text())
    with exr.File(str(tmp_path / "v.exr")) as file:
        pixels = file.channels()["Y"].pixels.astype(np.float64) * facts["scale"]
    sheet = facts["sheet"]
    wide, high = sheet["tile"]
    tiles = pixels.reshape(sheet["rows"], high, sheet["columns"], wide).transpose(0, 2, 1, 3)
    samples = tiles.reshape(-1, high, wide)[: sheet["slices"]]
    samples = samples if sheet["y"] == "down" else samples[:, ::-1]
    step = 0 if encoding == "float32" else np.abs(volume.distances).max() * 2.0**-11
    agree(interpolated(samples.transpose(2, 1, 0), np.array(facts["bounds"]), points), values, rounding(volume) + step)


def test_the_description_of_vf_samples_a_vf_file(body, tmp_path):
    volume, points, values = body
    volume.save(tmp_path / "v.vf")
    # The importer of Unity's Visual Effect Graph reads the magic, three unsigned shorts, and floats with x fastest.
    raw = (tmp_path / "v.vf").read_bytes()
    assert raw[:4] == b"VF_F"
    size = np.frombuffer(raw, "<u2", 3, 4)
    samples = np.frombuffer(raw, "<f4", offset=10).reshape(size[::-1]).T
    agree(interpolated(samples, volume.bounds, points), values, rounding(volume))


@pytest.mark.parametrize("engine", IN_FILE)
def test_warp_samples_a_nvdb_file(body, engine, tmp_path):
    warp = pytest.importorskip("warp", reason="needs warp-lang: pip install --group long")

    @warp.kernel
    def sample(field: warp.uint64, places: warp.array(dtype=warp.vec3), out: warp.array(dtype=warp.float32)):
        i = warp.tid()
        out[i] = warp.volume_sample_f(field, warp.volume_world_to_index(field, places[i]), warp.Volume.LINEAR)

    volume, points, values = body
    volume.save(tmp_path / "v.nvdb", engine=engine)
    grid = warp.Volume.load_from_nvdb((tmp_path / "v.nvdb").read_bytes(), device="cpu")
    places = warp.array(IN_FILE[engine](points).astype(np.float32), dtype=warp.vec3, device="cpu")
    out = warp.zeros(len(points), dtype=warp.float32, device="cpu")
    warp.launch(sample, dim=len(points), inputs=[grid.id, places, out], device="cpu")
    found = out.numpy()
    # World positions are float32 in warp: those below 8 are rounded by 2^-22.
    agree(found, values, rounding(volume) + 3 * 2.0**-21)


@pytest.mark.parametrize("engine", IN_FILE)
def test_vtk_samples_a_vti_file(body, engine, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs pyvista: pip install --group long")
    volume, points, values = body
    volume.save(tmp_path / "v.vti", engine=engine)
    grid = pyvista.read(tmp_path / "v.vti")
    found = pyvista.PolyData(IN_FILE[engine](points)).sample(grid)["distances"]
    agree(found, values, rounding(volume))


@pytest.mark.parametrize("encoding", ["float32", "unorm8"])
def test_three_samples_a_ktx2_file(body, encoding, tmp_path):
    node_tool("three")
    volume, points, values = body
    volume.save(tmp_path / "v.ktx2", encoding=encoding, engine="three", band=3)
    command = ["node", str(WEB / "read_ktx2.mjs"), str(tmp_path / "v.ktx2")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    texture = json.loads(done.stdout)
    assert (texture["is3D"], texture["flipY"], texture["size"]) == (True, False, list(volume.resolution))
    texels = np.array(texture["data"], np.float64).reshape(texture["size"][::-1])
    scale = 3 * float(volume.spacing.max())
    distances = texels if encoding == "float32" else (texels / 127.5 - 1) * scale
    found = interpolated(distances.transpose(2, 1, 0), volume.bounds, points)
    step = 0 if encoding == "float32" else scale / 127.5
    agree(found, values, rounding(volume) + step)
