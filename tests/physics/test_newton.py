"""Files of Newton's cache: its own loader accepts them, and their samples are the signed distances."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
import meshes
import truth
from fieldbake.cli.application import app
from fieldbake.newton import _cache, is_watertight
from octrees import distance_to_boxes, overlapping_boxes

pytestmark = pytest.mark.skipif(importlib.util.find_spec("newton") is None, reason="Newton is not installed")


def loaded(path):
    """The content of a file by Newton's own loader."""
    name = path.name.removesuffix(".sdf.npz")
    data = _cache().try_load_sparse_data(path.parent, name)
    assert data is not None
    return data


def fine_samples(data):
    """Positions and values of the samples of all blocks, (cells, 9^3)."""
    offsets = np.stack(np.meshgrid(*[np.arange(9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    slots = data["subgrid_start_slots"]
    cells = np.argwhere(slots < 0xFFFFFFFE)
    blocks = (slots[tuple(cells.T)][:, None] >> np.array([0, 10, 20])) & 0x3FF
    x, y, z = np.moveaxis(blocks[:, None] * 9 + offsets, -1, 0)
    stored = data["subgrid_data"][z, y, x]
    if stored.dtype.kind == "u":
        stored = stored / np.iinfo(stored.dtype).max
    values = data["subgrids_min_sdf_value"] + stored * data["subgrids_sdf_value_range"]
    return data["min_extents"] + (cells[:, None] * 8 + offsets) * data["cell_size"], values


def code(data):
    """The step of one code."""
    most = {1: 255, 2: 65535, 4: np.inf}[data["quantization_mode"]]
    return data["subgrids_sdf_value_range"] / most + 1e-6


@pytest.mark.parametrize("texture_format", ["uint16", "uint8", "float32"])
def test_samples_are_distances_to_one_code(tmp_path, texture_format, random):
    mesh = fb.models.gear(teeth=9)
    data = loaded(fb.newton.cook(mesh, tmp_path, max_resolution=48, texture_format=texture_format))

    points, values = fine_samples(data)
    assert len(points) == data["num_subgrids"] > 50
    chosen = random.choice(points.size // 3, 3000, replace=False)
    places, found = points.reshape(-1, 3)[chosen], values.ravel()[chosen]
    # Newton rounds vertices to float32.
    expected = truth.signed_distance(mesh.vertices.astype(np.float32).astype(np.float64), mesh.faces, places)
    half = 0.5 * data["subgrids_sdf_value_range"]
    reach = np.inf if texture_format == "float32" else half
    assert np.abs(found - np.clip(expected, -reach, reach)).max() <= code(data)

    corners = np.stack(np.meshgrid(*(np.arange(n + 1) for n in data["coarse_dims"]), indexing="ij"), -1)
    at = (data["min_extents"] + corners * 8 * data["cell_size"]).reshape(-1, 3)
    coarse = data["coarse_sdf"].transpose(2, 1, 0).ravel()
    some = random.choice(len(at), 100, replace=False)
    assert np.abs(coarse[some] - truth.signed_distance(mesh.vertices, mesh.faces, at[some])).max() <= 1e-6


def test_the_band_has_fine_samples_or_is_linear(tmp_path):
    data = loaded(fb.newton.cook(fb.Mesh(*meshes.box()), tmp_path, narrow_band_range=(-0.2, 0.05)))

    slots = data["subgrid_start_slots"]
    cells = np.stack(np.meshgrid(*map(np.arange, slots.shape), indexing="ij"), -1)
    center = data["min_extents"] + (cells + 0.5) * 8 * data["cell_size"]
    distance = truth.box(center.reshape(-1, 3)).reshape(slots.shape)
    reach = 0.2 + 4 * np.linalg.norm(data["cell_size"])
    assert np.array_equal(slots != 0xFFFFFFFF, np.abs(distance) < reach)
    # In front of the sides of a box the distance is linear.
    is_linear = slots == 0xFFFFFFFE
    assert 0 < is_linear.sum() < (slots != 0xFFFFFFFF).sum()
    coarse = data["coarse_sdf"].transpose(2, 1, 0)
    for cell in np.argwhere(is_linear)[::5]:
        middle = np.mean([coarse[tuple(cell + corner)] for corner in np.ndindex(2, 2, 2)])
        assert middle == pytest.approx(distance[tuple(cell)], abs=1e-5)


def test_no_sign_is_wrong_on_overlapping_and_open_meshes(tmp_path):
    data = loaded(fb.newton.cook(overlapping_boxes(), tmp_path))
    points, values = fine_samples(data)
    expected = distance_to_boxes(points.reshape(-1, 3))
    known = np.abs(expected) > code(data)
    assert known.sum() > 20_000
    assert ((values.ravel() < 0) != (expected < 0))[known].sum() == 0

    bowl = fb.Mesh(*meshes.open_box())
    with pytest.warns(fb.SurfaceWarning, match="open"):
        data = loaded(fb.newton.cook(bowl, tmp_path))
    points, values = fine_samples(data)
    places, found = points.reshape(-1, 3)[::7], values.ravel()[::7]
    winding = truth.winding_number(bowl.vertices, bowl.faces, places)
    distance = truth.closest_point(bowl.vertices, bowl.faces, places).distances
    known = (distance > code(data)) & (np.abs(winding - 0.5) > 1e-6)
    assert ((found < 0) != (winding > 0.5))[known].sum() == 0
    assert known.sum() > 3000


def test_scaled_and_mirrored_meshes_are_scaled_before(tmp_path):
    mesh = fb.models.gear(teeth=7)
    scale = (-0.5, 2.0, 1.0)
    data = loaded(fb.newton.cook(mesh, tmp_path, scale=scale, target_voxel_size=0.1))
    points, values = fine_samples(data)
    moved = (mesh.vertices.astype(np.float32) * np.array(scale, np.float32)).astype(np.float64)
    expected = truth.signed_distance(moved, mesh.faces[:, ::-1], points.reshape(-1, 3)[::301])
    reach = 0.5 * data["subgrids_sdf_value_range"]
    assert np.abs(values.ravel()[::301] - np.clip(expected, -reach, reach)).max() <= code(data)
    assert data["cell_size"].max() <= 0.1


LOOKUP = """
import sys
import numpy as np
import warp as wp
import newton
import fieldbake as fb
import meshes
from fieldbake.newton import is_watertight
from newton._src.geometry import sdf_texture

class Found(Exception):
    pass

def found(data, *_):
    raise Found(data["num_subgrids"])

sdf_texture.create_sparse_sdf_textures = found
wp.is_cuda_available = lambda: True
gear = fb.models.gear(teeth=6)
for mesh in (gear, fb.Mesh(*meshes.open_box())):
    for options in (
        {}, {"max_resolution": 32}, {"target_voxel_size": 0.1, "margin": 0.1}, {"texture_format": "uint8"},
        {"scale": (1.0, 2.0, -0.5), "narrow_band_range": (-0.2, 0.1)},
    ):
        fb.newton.cook(mesh, sys.argv[1], **options)
        theirs = newton.Mesh(mesh.vertices, mesh.faces.ravel(), compute_inertia=False)
        assert theirs.is_watertight == is_watertight(mesh.vertices.astype(np.float32), mesh.faces)
        try:
            theirs.build_sdf(cache_dir=sys.argv[1], **options)
        except Found as error:
            assert error.args[0] > 0
        else:
            raise AssertionError(options)
"""


@pytest.mark.slow
def test_newton_finds_the_files_by_its_own_hash(tmp_path):
    # Newton needs a CUDA device to use a file; the test ends where it would upload what it has loaded.
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", LOOKUP, str(tmp_path)], capture_output=True, text=True,
                          timeout=300, check=False, cwd=meshes.__file__.rpartition("/")[0])  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_meshes_are_watertight_by_the_rule_of_newton():
    box = meshes.box()
    assert is_watertight(box.vertices.astype(np.float32), box.faces)
    assert is_watertight(meshes.split_vertices(box).vertices.astype(np.float32), meshes.split_vertices(box).faces)
    open_box = meshes.open_box()
    assert not is_watertight(open_box.vertices.astype(np.float32), open_box.faces)
    assert not is_watertight(box.vertices.astype(np.float32), meshes.doubled(box).faces)


def test_mistakes_name_the_argument(tmp_path, monkeypatch):
    mesh = fb.Mesh(*meshes.box())
    cases = [
        ({"max_resolution": 20}, "max_resolution: must be a multiple of 8, got 20"),
        ({"max_resolution": 0}, "max_resolution: must be"),
        ({"target_voxel_size": 0}, "target_voxel_size: must be a finite number above 0"),
        ({"target_voxel_size": 1e-5}, "target_voxel_size: 1e-05 makes [0-9]+ voxels"),
        ({"margin": -1}, "margin: must be"),
        ({"margin": np.nan}, "margin: must be"),
        ({"narrow_band_range": (0.1, 0.2)}, "narrow_band_range: must have 0 between its numbers, got 0.1 and 0.2"),
        ({"narrow_band_range": 3}, r"narrow_band_range: must have shape \(2,\)"),
        ({"texture_format": "uint32"}, "texture_format: must be one of"),
        ({"scale": (1, 0, 1)}, "scale: must not have the factor 0"),
        ({"scale": 2.0}, r"scale: must have shape \(3,\)"),
    ]
    for options, message in cases:
        with pytest.raises(fb.ArgumentError, match=message):
            fb.newton.cook(mesh, tmp_path, **options)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("fieldbake.newton.LAYOUT", 1)
    with pytest.raises(fb.Error, match=r"newton: its cache has the layout 2, and fieldbake\.newton writes 1"):
        fb.newton.cook(mesh, tmp_path)


def test_a_damaged_file_is_no_file_for_newton(tmp_path, random):
    path = fb.newton.cook(fb.Mesh(*meshes.icosphere(1)), tmp_path, max_resolution=16)
    loaded(path)
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: len(content) // 2])
    assert _cache().try_load_sparse_data(tmp_path, path.name.removesuffix(".sdf.npz")) is None


def test_the_command_writes_one_file_for_each_mesh(tmp_path):
    for name, teeth in (("a.obj", 6), ("b.stl", 8)):
        fb.models.gear(teeth=teeth).save(tmp_path / name)
    folder = tmp_path / "cache"

    def run(*arguments):
        return CliRunner().invoke(app, ["cook", *map(str, arguments)])

    done = run(tmp_path / "a.obj", tmp_path / "b.stl", "-o", folder, "--for", "newton", "-r", "32", "--json")

    assert done.exit_code == 0, done.output
    rows = [json.loads(line) for line in done.output.splitlines()]
    assert [row["mesh"] for row in rows] == [str(tmp_path / "a.obj"), str(tmp_path / "b.stl")]
    expected = fb.newton.cook(fb.load_mesh(tmp_path / "a.obj"), tmp_path / "other", max_resolution=32)
    assert folder / expected.name == Path(rows[0]["file"])
    assert all(max(loaded(Path(row["file"]))["coarse_dims"]) == 4 for row in rows)
    assert "bytes" in run(tmp_path / "a.obj", "-o", folder, "--for", "newton").output
    for wrong in (("--solid",), ("--depth", 4), ("-r", "32x16x16")):
        assert run(tmp_path / "a.obj", "-o", folder, "--for", "newton", *wrong).exit_code == 2
    assert run(tmp_path / "a.obj", tmp_path / "b.stl", "-o", tmp_path / "c.mjb").exit_code == 2
    missing = run(tmp_path / "no.obj", "-o", folder, "--for", "newton")
    assert (missing.exit_code, len(missing.output.splitlines())) == (1, 1)


def test_the_progress_reaches_one(tmp_path):
    seen = []
    fb.newton.cook(fb.Mesh(*meshes.icosphere(2)), tmp_path, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1)
