"""Fields in S3, served by moto on the loopback."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import fieldbake as fb

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

BUCKET = "fields"


@pytest.fixture(scope="module")
def options():
    """Options of the file system: the address of the server, and credentials that it does not check."""
    server = pytest.importorskip("moto.server", reason="needs moto[server]: pip install --group long")
    pytest.importorskip("s3fs", reason="needs s3fs: pip install --group long")
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield {"key": "test", "secret": "test", "client_kwargs": {"endpoint_url": f"http://{host}:{port}"}}
    running.stop()


@pytest.fixture(scope="module")
def files(options):
    import s3fs

    found = s3fs.S3FileSystem(**options, use_listings_cache=False)
    found.mkdir(BUCKET)
    return found


@pytest.fixture(scope="module")
def mesh():
    return fb.models.torus_knot(segments=96, sides=12)


def bake(mesh, store, **options):
    return fb.bake_to_zarr(mesh, store, 64, shard=32, chunk=8, **options)


def shards(files, name):
    """Bytes of the shards by their keys."""
    root = f"{BUCKET}/{name}/"
    return {key[len(root) :]: files.cat_file(key) for key in files.find(root) if "/c/" in key and "/far/" not in key}


def test_a_store_on_s3_has_the_bytes_of_a_folder_and_resumes(files, options, mesh, tmp_path):
    local = bake(mesh, tmp_path / "knot.zarr")
    made = bake(mesh, f"s3://{BUCKET}/knot.zarr", storage_options=options)

    found = shards(files, "knot.zarr")
    assert len(found) > 4
    for key, content in found.items():
        assert (tmp_path / "knot.zarr" / key).read_bytes() == content
    opened = fb.open_zarr(f"s3://{BUCKET}/knot.zarr", storage_options=options)
    points = np.random.default_rng(1).uniform(*made.bounds, (500, 3))
    assert np.array_equal(opened.sample(points), local.sample(points))
    # The surface lies within the rounding of its vertices, and one step of the encoding.
    on_surface = mesh.vertices[:200]
    assert np.abs(opened.sample(on_surface)).max() <= opened.spacing.max()
    assert np.abs(opened.sample(on_surface) - fb.bake(mesh, 64, band=3).sample(on_surface)).max() <= 1e-4

    key = next(key for key in found if key.startswith("0/c/"))
    files.rm_file(f"{BUCKET}/knot.zarr/{key}")
    times = {name: files.info(f"{BUCKET}/knot.zarr/{name}")["LastModified"] for name in found if name != key}
    with pytest.raises(fb.FormatError, match=key):
        fb.open_zarr(f"s3://{BUCKET}/knot.zarr", storage_options=options).distances  # noqa: B018
    bake(mesh, f"s3://{BUCKET}/knot.zarr", storage_options=options)
    assert shards(files, "knot.zarr") == found
    assert all(files.info(f"{BUCKET}/knot.zarr/{name}")["LastModified"] == when for name, when in times.items())


def test_processes_write_to_s3(files, options, mesh):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        bake(mesh, f"s3://{BUCKET}/pool.zarr", storage_options=options, executor=pool)
    bake(mesh, f"s3://{BUCKET}/alone.zarr", storage_options=options)
    found = shards(files, "pool.zarr")
    assert len(found) > 4
    assert found == shards(files, "alone.zarr")
