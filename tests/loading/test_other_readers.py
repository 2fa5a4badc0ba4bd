"""Files of a body without symmetry, sampled at world points by readers of other projects."""

import json
import subprocess

import numpy as np
import pytest
import scipy.ndimage

import fieldbake as fb
from browser import WEB, node_tool

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

#: Positions in the file, from world positions.
IN_FILE = {
    None: lambda p: p,
    "unreal": lambda p: p[:, [0, 2, 1]],
    "blender": lambda p: np.column_stack([p[:, 0], -p[:, 2], p[:, 1]]),
}


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
    assert np.abs(found - values).max() <= rounding(volume) + 3 * 2.0**-21


@pytest.mark.parametrize("engine", IN_FILE)
def test_vtk_samples_a_vti_file(body, engine, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs pyvista: pip install --group long")
    volume, points, values = body
    volume.save(tmp_path / "v.vti", engine=engine)
    grid = pyvista.read(tmp_path / "v.vti")
    found = pyvista.PolyData(IN_FILE[engine](points)).sample(grid)["distances"]
    assert np.abs(np.asarray(found) - values).max() <= rounding(volume)


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
    # Texture coordinates run from 0 to 1 over the box, and texel centres lie half a texel inside.
    share = (points - volume.bounds[0]) / (volume.bounds[1] - volume.bounds[0])
    places = share * volume.resolution - 0.5
    found = scipy.ndimage.map_coordinates(distances, places.T[::-1], order=1)
    step = 0 if encoding == "float32" else scale / 127.5
    assert np.abs(found - values).max() <= rounding(volume) + step
