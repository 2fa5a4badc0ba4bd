"""Fields in Zarr stores: the bits of the whole bake, resumption, damaged stores, and all methods of ZarrVolume."""

import contextlib
import errno
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import assets
import fieldbake as fb
import manifold
import truth

zarr = pytest.importorskip("zarr")

SHARD, CHUNK = 32, 8


def knot():
    return fb.models.torus_knot(segments=96, sides=12)


def opened_knot():
    mesh = knot()
    return fb.Mesh(mesh.vertices, mesh.faces[:-40])


@pytest.fixture(scope="module")
def mesh():
    return knot()


@pytest.fixture(scope="module")
def store(mesh, tmp_path_factory):
    path = tmp_path_factory.mktemp("zarr") / "knot.zarr"
    fb.bake_to_zarr(mesh, path, 100, shard=SHARD, chunk=CHUNK)
    return path


@pytest.fixture(scope="module")
def volume(store):
    return fb.open_zarr(store)


def bake_knot(store, mesh, **options):
    return fb.bake_to_zarr(mesh, store, 100, **{"shard": SHARD, "chunk": CHUNK, **options})


def shard_files(store):
    """Bytes of all shards by their keys."""
    keys = [path for path in Path(store).rglob("*") if path.is_file() and "/c/" in path.as_posix()]
    return {
        path.relative_to(store).as_posix(): path.read_bytes() for path in keys if not {"far", "mesh"} & set(path.parts)
    }


def whole(mesh, volume, encoding="snorm16", band=3):
    dense = fb.bake(mesh, volume.resolution, bounds=volume.bounds, band=band)
    assert np.array_equal(dense.bounds, volume.bounds)
    return dense if encoding == "float32" else dense.quantize(encoding, band=band)


def test_open_meshes_warn_as_in_a_bake(tmp_path):
    mesh = opened_knot()
    with pytest.warns(fb.SurfaceWarning) as of_bake:
        fb.bake(mesh, 32)
    for _ in range(2):  # the second call finds all shards
        with pytest.warns(fb.SurfaceWarning) as of_store:
            fb.bake_to_zarr(mesh, tmp_path / "knot.zarr", 32, shard=SHARD, chunk=CHUNK)
        assert [str(found.message) for found in of_store] == [str(found.message) for found in of_bake]
        assert of_store[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error", fb.SurfaceWarning)
        fb.bake_to_zarr(mesh, tmp_path / "unsigned.zarr", 32, shard=SHARD, chunk=CHUNK, sign="unsigned")


@pytest.mark.parametrize("make", [knot, opened_knot], ids=["closed", "open"])
@pytest.mark.parametrize("encoding", ["snorm16", "snorm8", "float16", "float32"])
def test_shards_equal_the_whole_bake_bit_for_bit(make, encoding):
    mesh = make()
    name = f"memory://{make.__name__}-{encoding}"
    volume = fb.bake_to_zarr(mesh, name, (70, 51, 33), shard=32, chunk=16, encoding=encoding)
    group = zarr.open_group(name, mode="r")
    dense = whole(mesh, volume, encoding)

    codes = group["0"][...].transpose(2, 1, 0)
    if encoding in ("float32", "float16"):
        width = np.float32(volume.band)
        expected = np.clip(dense.distances, -width, width)
        expected = expected if encoding == "float32" else fb.Volume(expected, volume.bounds).quantize(encoding).encoded
    else:
        expected = dense.encoded
    assert codes.dtype == expected.dtype
    assert codes.tobytes() == np.ascontiguousarray(expected).tobytes()
    assert group["0"].fill_value == codes.max()


@pytest.mark.parametrize("level", [1])
def test_coarser_levels_are_baked_anew_with_the_same_scale(volume, mesh, level):
    group = zarr.open_group(volume.store, mode="r")
    shape = volume.levels[level]
    spacing = volume.spacing * 2**level
    bounds = np.array([volume.bounds[0], volume.bounds[0] + spacing * shape])
    exact = fb.bake(mesh, shape, bounds=bounds)
    found = group[f"levels/{level}"][...].transpose(2, 1, 0) / 32767 * group.attrs["scale"]
    assert np.abs(found - np.clip(exact.distances, -volume.band, volume.band)).max() <= 1.01 * volume.scale / 32767


def test_layout_is_that_of_ome_zarr(volume, mesh):
    group = zarr.open_group(volume.store, mode="r")
    assert group.metadata.zarr_format == 3
    assert [name for name, _ in group.arrays()] == ["0"]
    array = group["0"]
    nx, ny, nz = volume.resolution
    assert array.shape == (nz, ny, nx)
    assert array.metadata.dimension_names == ("z", "y", "x")
    assert (array.dtype, array.fill_value) == (np.int16, 32767)
    assert (array.shards, array.chunks) == ((SHARD,) * 3, (CHUNK,) * 3)
    assert group.attrs["scale"] == volume.scale == pytest.approx(3 * volume.spacing[0], rel=1e-6)
    assert np.array_equal(group.attrs["bounds"], volume.bounds)

    ome = group.attrs["ome"]
    assert ome["version"] == "0.5"
    (multiscale,) = ome["multiscales"]
    assert [axis["name"] for axis in multiscale["axes"]] == ["z", "y", "x"]
    assert [dataset["path"] for dataset in multiscale["datasets"]] == ["0", "levels/1"]
    for level, dataset in enumerate(multiscale["datasets"]):
        scale, translation = (entry[entry["type"]] for entry in dataset["coordinateTransformations"])
        spacing = volume.spacing * 2**level
        assert np.allclose(scale[::-1], spacing)
        assert np.allclose(translation[::-1], volume.bounds[0] + spacing / 2)
        assert group[dataset["path"]].shape == volume.levels[level][::-1]

    far = group["far/distances"]
    counts = [-(-n // SHARD) + 1 for n in array.shape]
    assert far.shape == tuple(counts)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1)[..., ::-1]
    corners = volume.bounds[0] + index * SHARD * volume.spacing
    assert np.abs(far[...] - fb.signed_distance(mesh, corners)).max() <= 1e-6


def test_near_shards_are_stored_and_far_ones_are_not(tmp_path):
    solid = fb.sphere(1).to_mesh(48)
    volume = fb.bake_to_zarr(solid, tmp_path / "s.zarr", 128, shard=8, chunk=8, bounds=[(-2, -2, -2), (2, 2, 2)])
    codes = zarr.open_group(tmp_path / "s.zarr", mode="r")["0"][...]
    blocks = codes.reshape(16, 8, 16, 8, 16, 8)
    low, high = blocks.min(axis=(1, 3, 5)), blocks.max(axis=(1, 3, 5))
    stored = {key for key in shard_files(tmp_path / "s.zarr") if key.startswith("0/")}

    expected = {f"0/c/{z}/{y}/{x}" for z, y, x in np.argwhere(low < 32767).tolist()}
    assert stored == expected
    assert ((high == -32767).sum(), (low == 32767).sum()) > (0, 3000)
    inner = [key for key in stored if high[tuple(int(i) for i in key.split("/")[2:])] == -32767]
    assert max((tmp_path / "s.zarr" / key).stat().st_size for key in inner) < 1000
    assert volume.resolution == (128, 128, 128)


@pytest.mark.parametrize("pool", ["threads", pytest.param("fork", marks=pytest.mark.slow), "spawn"])
def test_executors_give_equal_bytes(store, mesh, tmp_path, pool):
    context = {} if pool == "threads" else {"mp_context": get_context(pool)}
    with (ThreadPoolExecutor if pool == "threads" else ProcessPoolExecutor)(2, **context) as executor:
        shares = []
        bake_knot(tmp_path / "k.zarr", mesh, executor=executor, progress=shares.append)
    assert shard_files(tmp_path / "k.zarr") == shard_files(store)
    assert shares == sorted(shares)
    assert shares[-1] == 1


class Recorder:
    """An executor that runs tasks at once, records them and fails after some of them."""

    def __init__(self, limit=10**9):
        self.calls, self.limit = [], limit

    def submit(self, function, *arguments):
        self.calls.append(arguments)
        pool = ThreadPoolExecutor(1)
        future = pool.submit(function if len(self.calls) <= self.limit else assets.no_space, *arguments)
        pool.shutdown()
        return future


def test_any_object_with_submit_runs_one_task_a_shard(mesh, store, tmp_path):
    executor = Recorder()
    bake_knot(tmp_path / "k.zarr", mesh, executor=executor)
    keys = [f"{'0' if level == 0 else f'levels/{level}'}/c/{z}/{y}/{x}" for _, _, level, (x, y, z), _ in executor.calls]
    assert sorted(keys) == sorted(shard_files(store))


def test_a_run_resumes_where_it_stopped(mesh, store, tmp_path):
    target = tmp_path / "k.zarr"
    with pytest.raises(OSError, match=r"no space left for shard 0/c/\d/\d/\d of .*call again to resume") as caught:
        bake_knot(target, mesh, executor=Recorder(limit=5))
    assert caught.value.errno == errno.ENOSPC
    done = shard_files(target)
    assert len(done) == 5
    with pytest.raises(fb.FormatError, match=r"shard 0/c/\d/\d/\d of .* is missing"):
        fb.open_zarr(target)[:, :, :]

    (next(target.rglob("c")) / "x.0123.partial").write_bytes(b"rest of a write that was killed")
    executor = Recorder()
    bake_knot(target, mesh, executor=executor)
    assert shard_files(target) == shard_files(store)
    assert len(executor.calls) == len(shard_files(store)) - 5

    executor = Recorder()
    bake_knot(target, mesh, executor=executor)
    assert executor.calls == []
    with pytest.raises(fb.ArgumentError, match=r"band 3\.0, not 4\.0.*resume=False"):
        bake_knot(target, mesh, band=4)
    with pytest.raises(fb.ArgumentError, match="another mesh"):
        bake_knot(target, opened_knot())
    bake_knot(target, mesh, band=4, resume=False)
    assert fb.open_zarr(target).band == pytest.approx(4 * fb.open_zarr(target).spacing[0])


def test_other_contents_of_a_store_are_left_alone(mesh, tmp_path):
    zarr.open_group(tmp_path / "other.zarr", mode="w").create_array("data", data=np.arange(3))
    with pytest.raises(fb.FormatError, match="other contents"):
        bake_knot(tmp_path / "other.zarr", mesh)
    with pytest.raises(fb.FormatError, match="fieldbake has not written"):
        fb.open_zarr(tmp_path / "other.zarr")
    with pytest.raises(FileNotFoundError):
        fb.open_zarr(tmp_path / "nothing.zarr")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"band": 0}, "band"),
        ({"shard": 0}, "shard"),
        ({"chunk": 5}, "chunk: must divide shard"),
        ({"encoding": "int4"}, "encoding"),
        ({"executor": 3}, "executor"),
        ({"sign": "best"}, "sign"),
        ({"resume": 1}, "resume"),
        ({"threads": 0}, "threads"),
    ],
)
def test_wrong_options_are_errors_before_any_work(mesh, tmp_path, options, message):
    with pytest.raises(fb.ArgumentError, match=message):
        bake_knot(tmp_path / "k.zarr", mesh, **options)
    assert not (tmp_path / "k.zarr").exists()


def test_a_voxel_size_replaces_the_default_resolution(mesh):
    volume = fb.bake_to_zarr(mesh, "memory://voxel_size", voxel_size=0.1)
    assert volume.resolution == fb.bake(mesh, voxel_size=0.1).resolution
    with pytest.raises(fb.ArgumentError, match=r"voxel_size: give either voxel_size \(0.1\) or resolution \(64\)"):
        fb.bake_to_zarr(mesh, "memory://voxel_size", 64, voxel_size=0.1)


def test_processes_cannot_share_memory_stores(mesh):
    with ProcessPoolExecutor(1) as executor, pytest.raises(fb.ArgumentError, match="executor"):
        bake_knot("memory://unshared", mesh, executor=executor)
    with pytest.raises(fb.ArgumentError, match="store"):
        bake_knot(3, mesh)
    memory = zarr.storage.MemoryStore()
    assert bake_knot(memory, mesh).resolution == fb.open_zarr(memory).resolution


def test_damaged_and_missing_shards_are_errors_with_their_keys(mesh, tmp_path):
    target = tmp_path / "k.zarr"
    volume = bake_knot(target, mesh)
    middle = volume.sample(mesh.vertices[:500])
    damaged = next(key for key in sorted(shard_files(target)) if key.startswith("0/"))
    content = (target / damaged).read_bytes()
    for bad in (content[:50], content[:20] + bytes([content[20] ^ 0xFF]) + content[21:], b""):
        (target / damaged).write_bytes(bad)
        with pytest.raises(fb.FormatError, match=f"shard {damaged} of .* is damaged"):
            fb.open_zarr(target)[:, :, :]
    (target / damaged).unlink()
    with pytest.raises(fb.FormatError, match=f"shard {damaged} of .* is missing"):
        fb.open_zarr(target)[:, :, :]
    assert np.array_equal(bake_knot(target, mesh).sample(mesh.vertices[:500]), middle)
    assert (target / damaged).read_bytes() == content


def test_samples_are_those_of_the_bake_in_the_band_and_bounds_beyond(volume, mesh):
    rng = np.random.default_rng(5)
    dense = whole(mesh, volume)
    center, extent = volume.bounds.mean(axis=0), np.ptp(volume.bounds, axis=0)
    points = np.concatenate([center + rng.uniform(-0.8, 0.8, (4000, 3)) * extent, mesh.vertices])
    exact = fb.query(mesh, points).distances

    found = volume.sample(points)
    inside = ((points >= volume.bounds[0]) & (points <= volume.bounds[1])).all(axis=1)
    close = inside & (np.abs(exact) < volume.band - volume.spacing[0])
    assert close.sum() > 1000
    assert np.abs(found[close] - dense.sample(points[close])).max() <= 1e-6
    assert np.array_equal(volume.sample(points, filter="nearest")[close], dense.sample(points[close], filter="nearest"))
    # Beyond the band the magnitude never exceeds the distance, and is at least most of the band.
    far = np.abs(exact) > volume.band + volume.spacing[0]
    assert (np.abs(found[far]) <= np.abs(exact[far])).all()
    assert (np.sign(found[far]) == np.sign(exact[far])).all()
    assert (np.abs(found[far & inside]) >= 0.9 * volume.band).all()
    away = far & ~inside
    assert (found[away] >= 0.9 * volume.band).all()

    near = close & (np.abs(exact) > 1e-3)
    assert np.abs(volume.gradient(points[near]) - dense.gradient(points[near])).max() <= 1e-3
    lengths = np.linalg.norm(volume.gradient(points[far & inside]), axis=1)
    assert (lengths <= 1 + 1e-6).all()
    assert volume.sample(np.zeros((2, 0, 3))).shape == (2, 0)
    assert volume.sample(points.reshape(2, -1, 3)).shape == (2, len(points) // 2)
    with pytest.raises(fb.ArgumentError):
        volume.sample([(0, 0, np.nan)])
    with pytest.raises(fb.ArgumentError, match="filter"):
        volume.sample(points, filter="cubic")


@pytest.mark.parametrize("filter", ["linear", "nearest"])
def test_the_outer_half_voxel_of_a_box_that_cuts_the_solid_is_inside(filter):
    cube = fb.box(2).to_mesh(16)
    box = [(-0.5, -2, -2), (2, 2, 2)]
    store = zarr.storage.MemoryStore()
    volume = fb.bake_to_zarr(cube, store, (25, 40, 40), bounds=box, encoding="float32")
    dense = fb.bake(cube, (25, 40, 40), bounds=box)
    points = np.random.default_rng(6).uniform((-0.5, -1.5, -1.5), (-0.45, 1.5, 1.5), (4000, 3))
    found, expected = volume.sample(points, filter=filter), dense.sample(points, filter=filter)
    # A voxel's diagonal from the band, all samples of a cell are in it.
    close = np.abs(expected) <= volume.band - 0.1 * np.sqrt(3)
    assert close.sum() > 500
    # Both interpolate in float64 or better than 1e-6 of distances below 1.
    assert np.abs(found[close] - expected[close]).max() <= 1e-6
    assert np.array_equal(found < 0, expected < 0)
    assert (np.abs(found[~close]) <= np.abs(fb.query(cube, points[~close]).distances) + 0.1).all()
    on_box = [(-0.5, 0, 0), (-0.475, 0, 0)]
    assert (volume.sample(on_box, filter=filter) < 0).all()


def test_far_samples_use_the_corners_of_shards(tmp_path):
    ball = fb.sphere(1).to_mesh(32)
    volume = fb.bake_to_zarr(ball, tmp_path / "b.zarr", 64, shard=8, chunk=8, bounds=[(-4, -4, -4), (4, 4, 4)])
    points = np.random.default_rng(2).uniform(-4, 4, (2000, 3))
    exact = fb.query(ball, points).distances
    far = exact > volume.band + volume.spacing[0]
    found = volume.sample(points)
    assert (found[far] <= exact[far]).all()
    assert (found[far] / exact[far]).mean() > 0.8
    slopes = volume.gradient(points[exact > 2])
    assert (slopes * points[exact > 2]).sum(axis=1).min() > 0


def test_windows_have_the_stored_bits(volume, mesh):
    dense = whole(mesh, volume)
    part = volume[10:50, 3:40, :20]
    assert isinstance(part, fb.QuantizedVolume)
    assert np.array_equal(part.encoded, dense.encoded[10:50, 3:40, :20])
    assert np.allclose(part.bounds, volume.bounds[0] + np.array([(10, 3, 0), (50, 40, 20)]) * volume.spacing)
    box = [volume.bounds[0] + 5.5 * volume.spacing, volume.bounds[0] + 20.5 * volume.spacing]
    assert np.array_equal(volume.window(box).encoded, dense.encoded[5:21, 5:21, 5:21])
    assert volume.window(volume.bounds, level=1).resolution == volume.levels[1]
    for wrong in ((slice(0, 9, 2),), (3,), (slice(5, 5),)):
        with pytest.raises(fb.ArgumentError, match="window"):
            volume[wrong]
    with pytest.raises(fb.ArgumentError, match="bounds"):
        volume.window([(50, 50, 50), (60, 60, 60)])
    with pytest.raises(fb.ArgumentError, match="level"):
        volume.window(volume.bounds, level=9)


def test_meshes_and_sparse_volumes_are_those_of_the_dense_bake(volume, mesh):
    dense = whole(mesh, volume)
    surface = volume.to_mesh()
    expected = dense.to_mesh(source=mesh)
    assert not manifold.faults(surface.vertices, surface.faces)
    assert surface.faces.shape == expected.faces.shape
    assert np.abs(np.sort(surface.vertices, axis=0) - np.sort(expected.vertices, axis=0)).max() <= 1e-9
    assert volume.to_mesh(sharp=False).topology()["closed"]
    with pytest.raises(fb.ArgumentError, match="level"):
        volume.to_mesh(2 * volume.band)

    sparse = volume.to_sparse()
    rng = np.random.default_rng(1)
    points = volume.bounds[0] + rng.uniform(0, 1, (20000, 3)) * np.ptp(volume.bounds, axis=0)
    exact = fb.query(mesh, points).distances
    close = np.abs(exact) < volume.band - 2 * volume.spacing[0]
    assert np.abs(sparse.sample(points[close]) - dense.sample(points[close])).max() <= 1e-6
    far = np.abs(exact) > volume.band + volume.spacing[0]
    found = sparse.sample(points)
    assert (np.abs(found[far]) <= np.abs(exact[far])).all()
    assert (np.sign(found) == np.sign(dense.sample(points)))[far].all()


def test_pictures_are_those_of_the_dense_bake(volume, mesh):
    dense = whole(mesh, volume)
    frame = fb.raymarch(volume, size=(160, 120), device="cpu")
    expected = fb.raymarch(dense, size=(160, 120), device="cpu")
    assert np.array_equal(np.isfinite(frame.depth), np.isfinite(expected.depth))
    hit = np.isfinite(frame.depth)
    assert np.abs(frame.depth[hit] - expected.depth[hit]).max() <= 1e-4 * np.ptp(volume.bounds, axis=0).max()
    assert (np.abs(frame.image.astype(int) - expected.image.astype(int)).max(axis=2) <= 2).mean() > 0.995
    assert volume.raymarch(size=(32, 32), shadows="soft", device="cpu").color.shape == (32, 32, 4)
    assert volume._repr_png_().startswith(b"\x89PNG")


def test_xarray_has_world_coordinates(volume, mesh):
    pytest.importorskip("xarray")
    array = volume.to_xarray()
    assert array.dims == ("z", "y", "x")
    x, y, z = (float(array[axis][7]) for axis in "xyz")
    assert np.allclose((x, y, z), volume.origin + 7 * volume.spacing)
    part = array[20:40, 30:50, 10:60]
    dense = whole(mesh, volume).distances[10:60, 30:50, 20:40].transpose(2, 1, 0)
    assert np.abs(part.values - dense.clip(-volume.band, volume.band)).max() <= 2 * volume.scale / 32767


def test_plain_xarray_opens_the_store(store):
    xarray = pytest.importorskip("xarray")
    data = xarray.open_zarr(store, consolidated=False, chunks=None)
    assert data["0"].dims == ("z", "y", "x")


def test_a_volume_is_pickled_and_read_by_threads(volume, mesh):
    again = pickle.loads(pickle.dumps(volume))
    points = mesh.vertices[:2000] + 0.01
    expected = again.sample(points)
    results = []
    threads = [threading.Thread(target=lambda: results.append(again.sample(points))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    assert all(np.array_equal(result, expected) for result in results)
    assert repr(volume).startswith("ZarrVolume(97 x 100 x ")
    assert "voxels as snorm16" in repr(volume)
    assert volume.report.closed
    # The report is written before the shards, so it states no number of voxels inside and no times.
    assert [label for label, _ in volume.report.rows()] == ["surface", "sign", "device", "memory"]
    with pytest.raises(AttributeError):
        volume._layout = None


def test_degenerate_faces_do_not_change_the_bits(tmp_path, mesh):
    vertices = np.concatenate([mesh.vertices, [(9.0, 9.0, 9.0), (np.nan, 0, 0)]])
    faces = np.concatenate([[(0, 0, len(vertices) - 2)], mesh.faces])
    odd = fb.Mesh(vertices, faces)
    volume = bake_knot(tmp_path / "k.zarr", odd, threads=1)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        bake_knot(tmp_path / "p.zarr", odd, executor=executor)
    assert shard_files(tmp_path / "k.zarr") == shard_files(tmp_path / "p.zarr")
    assert np.array_equal(volume.mesh.vertices, odd.vertices)


def test_an_empty_plan_and_tiny_grids(tmp_path, mesh):
    far = fb.bake_to_zarr(mesh, tmp_path / "far.zarr", 20, shard=8, chunk=4, bounds=[(50, 50, 50), (60, 60, 60)])
    assert not shard_files(tmp_path / "far.zarr")
    assert len(far.to_mesh().faces) == 0
    assert far._repr_png_() is None
    assert far.sample([(55, 55, 55)])[0] > 50
    tiny = fb.bake_to_zarr(mesh, tmp_path / "tiny.zarr", 1)
    assert tiny.resolution == (1, 1, 1)
    assert len(tiny.levels) == 1
    assert np.isfinite(tiny.sample(mesh.vertices[:5])).all()


def test_without_zarr_there_is_one_clear_error(tmp_path):
    program = (
        "import sys; sys.modules['zarr'] = None\n"
        "import fieldbake as fb\n"
        "try: fb.open_zarr('x')\n"
        "except fb.Error as error: print(error)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "pip install 'fieldbake[zarr]'" in result.stdout


@pytest.mark.slow
def test_dask_gives_equal_bytes(store, mesh, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster,
        distributed.Client(cluster) as client,
    ):
        bake_knot(tmp_path / "k.zarr", mesh, executor=client)
        assert shard_files(tmp_path / "k.zarr") == shard_files(store)
        boxes = {f"box_{i}": assets.box(1 + i) for i in range(3)}
        rows = fb.bake_many({**boxes, "killer": assets.kill_process}, tmp_path / "many", executor=client, resolution=12)
        assert [row["status"] for row in rows] == ["done"] * 3 + ["failed"]


#: The program of the tests that kill it: it bakes the knot by two processes.
CLIENT = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import fieldbake as fb
if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        print(*[executor.submit(__import__("os").getpid).result() for _ in range(4)], flush=True)
        step = lambda share: print(share, flush=True)
        knot = fb.models.torus_knot(segments=96, sides=12)
        fb.bake_to_zarr(knot, sys.argv[1], 200, shard=32, chunk=8, executor=executor, progress=step)
"""


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["worker", "client"])
def test_a_killed_run_is_completed_with_equal_bytes(mesh, tmp_path, victim):
    program = tmp_path / "client.py"
    program.write_text(CLIENT)
    target = tmp_path / "k.zarr"
    fb.bake_to_zarr(mesh, tmp_path / "whole.zarr", 200, shard=32, chunk=8)
    process = subprocess.Popen(
        [sys.executable, program, target], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    workers = [int(word) for word in process.stdout.readline().split()]
    process.stdout.readline()
    os.kill(workers[0] if victim == "worker" else process.pid, 9)
    process.wait()
    process.stdout.close()
    for worker in set(workers):
        # The workers of a dead client wait for tasks for ever.
        with contextlib.suppress(ProcessLookupError):
            os.kill(worker, signal.SIGKILL)
    assert process.returncode != 0
    left = len(shard_files(tmp_path / "whole.zarr")) - len(shard_files(target))
    assert left > 0

    executor = Recorder()
    fb.bake_to_zarr(mesh, target, 200, shard=32, chunk=8, executor=executor)
    assert shard_files(target) == shard_files(tmp_path / "whole.zarr")
    assert len(executor.calls) <= left + 2


def test_metadata_is_plain_json(store):
    metadata = json.loads((store / "zarr.json").read_text())
    assert metadata["attributes"]["fieldbake"]["layout"] == 1
    assert metadata["attributes"]["mesh_hash"]


def test_truth_is_within_a_step_of_the_codes(volume, mesh):
    """Stored values against float64 brute force, not against the package itself."""
    rng = np.random.default_rng(11)
    index = rng.integers(0, volume.resolution, (400, 3))
    points = volume.origin + index * volume.spacing
    exact = np.linalg.norm(truth.closest_point(mesh.vertices, mesh.faces, points).points - points, axis=1)
    codes = zarr.open_group(volume.store, mode="r")["0"]
    found = np.array([codes[z, y, x] for x, y, z in index]) / 32767 * volume.scale
    expected = np.minimum(exact, volume.band)
    assert np.abs(np.abs(found) - expected).max() <= 1.01 * volume.scale / 32767 + 1e-6
