"""Volumes as objects of PyVista, xarray, Open3D and DLPack, and meshes of meshio."""

import numpy as np
import pytest

import fieldbake as fb


@pytest.fixture(scope="module")
def volume():
    return fb.bake(fb.box((2, 1, 0.5)).rotate("z", 20).translate((4, -3, 2)), (20, 18, 9))


def test_coordinates_are_the_voxel_centres(volume):
    x, y, z = volume.coordinates
    assert (len(x), len(y), len(z)) == volume.resolution
    for axis, places in enumerate(volume.coordinates):
        steps = volume.bounds[0, axis] + (np.arange(len(places)) + 0.5) * volume.spacing[axis]
        assert np.allclose(places, steps, rtol=1e-14)
    assert volume.sample([(x[3], y[4], z[5])])[0] == pytest.approx(volume.distances[3, 4, 5], abs=1e-6)


@pytest.mark.parametrize("kind", ["dense", "quantized", "sparse"])
def test_pyvista_has_the_samples_at_their_places(volume, kind):
    pytest.importorskip("pyvista")
    field = {"dense": volume, "quantized": volume.quantize("snorm16"), "sparse": volume.to_sparse()}[kind]
    grid = field.to_pyvista()
    points = np.asarray(grid.points)
    assert np.abs(grid["distances"] - field.sample(points)).max() <= 1e-5
    assert grid.active_scalars_name == "distances"
    # VTK keeps positions in float32.
    assert np.allclose(points[0], volume.origin, rtol=1e-6)


def test_xarray_interpolates_like_sample(volume):
    xarray = pytest.importorskip("xarray")
    array = volume.to_xarray()
    points = np.random.default_rng(2).uniform(volume.origin, volume.bounds[1] - volume.spacing / 2, (1000, 3))
    places = {name: xarray.DataArray(points[:, axis], dims="p") for axis, name in enumerate("xyz")}
    assert np.abs(array.interp(places).values - volume.sample(points)).max() <= 1e-5
    assert array.attrs["bounds"] == volume.bounds.tolist()
    for other in (array, array.transpose("z", "y", "x"), array.isel(y=slice(None, None, -1))):
        back = fb.Volume.from_xarray(other)
        assert np.array_equal(back.distances, volume.distances)
        assert np.allclose(back.bounds, volume.bounds, rtol=1e-12)
        assert np.array_equal(back.inner_bounds, volume.inner_bounds)


def test_arrays_of_xarray_that_are_no_grid():
    xarray = pytest.importorskip("xarray")
    samples = np.zeros((3, 3, 3))
    for bad in (
        samples,
        xarray.DataArray(samples, dims=("a", "b", "c")),
        xarray.DataArray(samples, dims=("x", "y", "z")),
        xarray.DataArray(samples, dims=("x", "y", "z"), coords={"x": [0, 1, 3], "y": [0, 1, 2], "z": [0, 1, 2]}),
    ):
        with pytest.raises(fb.ArgumentError, match="array"):
            fb.Volume.from_xarray(bad)


def test_open3d_has_the_zero_surface(volume):
    open3d = pytest.importorskip("open3d")
    mesh = volume.to_open3d()
    assert isinstance(mesh, open3d.t.geometry.TriangleMesh)
    expected = volume.to_mesh()
    assert np.allclose(mesh.vertex.positions.numpy(), expected.vertices, rtol=1e-6)
    assert np.array_equal(mesh.triangle.indices.numpy(), expected.faces)


def test_dlpack_of_old_and_new_readers(volume):
    new = np.from_dlpack(volume)
    assert np.array_equal(new, volume.distances)
    capsule = volume.__dlpack__()
    assert type(capsule).__name__ == "PyCapsule"
    for field in (volume, volume.quantize("snorm8")):
        assert field.__dlpack_device__()[0] == 1


def test_check_tells_distances_from_other_fields(volume):
    field = fb.bake(fb.sphere(1), 40)
    found = field.check()
    assert found.is_distance
    assert found.gradient == pytest.approx(1, abs=1e-3)
    assert found.steepest <= 1 + 1e-4
    # The share of a ball of radius 1 in its box of 2.2, to within the voxels of its surface.
    assert found.inside_share == pytest.approx(4 / 3 * np.pi / 2.2**3, rel=0.02)
    assert volume.check().is_distance
    changed = {
        "positive inside": -field.distances,
        "unsigned": np.abs(field.distances),
    }
    for sign, samples in changed.items():
        told = fb.Volume(samples, field.bounds).check()
        assert told.sign == sign
        assert not told.is_distance
    for samples in (2 * field.distances, field.distances**3, np.sign(field.distances)):
        assert not fb.Volume(samples, field.bounds).check().is_distance
    # A narrow band cuts distances off; within it they are distances.
    narrow = fb.Volume(np.clip(field.distances, -0.3, 0.3), field.bounds).check()
    assert narrow.is_distance
    assert fb.Volume(np.ones((1, 1, 1)), [(0, 0, 0), (1, 1, 1)]).check().sign == "unsigned"


def test_meshes_of_meshio():
    meshio = pytest.importorskip("meshio")
    cube = fb.bake(fb.box(2), 8).to_mesh()
    triangles = meshio.Mesh(cube.vertices, [("triangle", cube.faces)])
    assert fb.as_mesh(triangles).volume == pytest.approx(cube.volume)
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T.astype(float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    assert fb.as_mesh(meshio.Mesh(corners, [("quad", quads)])).volume == pytest.approx(1)
    with pytest.raises(fb.MeshError, match="tetra"):
        fb.as_mesh(meshio.Mesh(corners, [("tetra", [(0, 1, 2, 4)])]))


def test_a_missing_package_is_named(volume, monkeypatch):
    import sys

    for name, install in (
        ("pyvista", r"'fieldbake\[pyvista\]'"),
        ("xarray", r"'fieldbake\[xarray\]'"),
        ("open3d", "open3d"),
    ):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(fb.Error, match=f"to_{name} needs the package {name}; .* pip install {install}$"):
            getattr(volume, f"to_{name}")()
