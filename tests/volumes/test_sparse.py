"""Sparse volumes: samples of bricks equal the samples of the dense field, and bounds never exceed the distance."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

#: Rounding of a trilinear value and of the two grids' positions, in voxels: values of up to 16 voxels, ten roundings.
ROUNDING_VOXELS = 16 * 10 * 2.0**-24

TOLERANCE = 0.05


@pytest.fixture(scope="module")
def knot() -> fb.Mesh:
    return fb.Mesh(*meshes.knot())


@pytest.fixture(scope="module")
def dense(knot: fb.Mesh) -> fb.Volume:
    return fb.bake(knot, 72, device="cpu")


def points_in(volume: fb.Volume | fb.SparseVolume, count: int = 20000) -> np.ndarray:
    return np.random.default_rng(7).uniform(volume.bounds[0], volume.bounds[1], (count, 3))


def in_band(volume: fb.Volume, points: np.ndarray, voxels: float) -> np.ndarray:
    """Points whose whole cell lies in the band: its corners are within a diagonal of them."""
    return np.abs(volume.sample(points)) < (voxels - 2) * volume.spacing.max()


@pytest.mark.parametrize("encoding", ["float16", "snorm16", "snorm8"])
def test_quantized_bricks_are_those_that_the_volume_gives(encoding):
    radius, volume = 1.0, fb.bake(fb.sphere(1), 40)
    found = volume.to_sparse().quantize(encoding)

    assert found.encoding == encoding
    same = volume.to_sparse(encoding=encoding)
    for name, array in same._core_field.arrays().items():
        assert np.array_equal(found._core_field.arrays()[name], array)
    points = np.stack(np.meshgrid(*volume.coordinates, indexing="ij"), axis=-1).reshape(-1, 3)
    exact = np.linalg.norm(points, axis=1) - radius
    near = np.abs(exact) <= 0.9 * found.band
    # One step of the encoding, rounded toward zero, and float32 roundings of distances below 4.
    bound = volume.quantize(encoding).error_bound(found.band) + 8 * 2.0**-23
    assert near.sum() > 1000
    assert np.abs(found.sample(points[near]) - exact[near]).max() <= bound
    with pytest.raises(fb.ArgumentError, match="encoding"):
        found.quantize("snorm4")


def test_a_volume_has_what_other_fields_lack():
    sparse = fb.bake(fb.sphere(1), 16).to_sparse()
    with pytest.raises(AttributeError, match=r"SparseVolume has no downsample; .* to_volume\(\).downsample"):
        sparse.downsample()
    with pytest.raises(AttributeError, match="object has no attribute 'depth'"):
        _ = sparse.depth
    nested = fb.merge([sparse], 16, levels=2, center=(0, 0, 0))
    with pytest.raises(AttributeError, match=r"NestedField has no quantize; .* to_volume\(\).quantize"):
        nested.quantize("snorm8")
    for function in (fb.volume_shape, lambda field: fb.pack([field]), lambda field: fb.merge([field], 8)):
        with pytest.raises(fb.Error, match=r"NestedField; its to_volume\(\) is a Volume"):
            function(nested)


def test_a_sparse_bake_stores_what_the_dense_bake_stores(knot: fb.Mesh, dense: fb.Volume) -> None:
    baked, converted = fb.bake_sparse(knot, 72, tolerance=None), dense.to_sparse(tolerance=None)
    ours, theirs = baked._core_field.arrays(), converted._core_field.arrays()
    assert np.array_equal(ours["index"], theirs["index"])
    np.testing.assert_allclose(ours["bricks"], theirs["bricks"], equal_nan=False, atol=2.0**-20 * dense.spacing[0])
    assert baked.report.inside_voxels == dense.report.inside_voxels
    assert baked.resolution == dense.resolution
    assert baked.nbytes < dense.nbytes * 2


def test_near_the_surface_it_is_the_dense_field(dense: fb.Volume) -> None:
    sparse = dense.to_sparse(tolerance=None)
    points = points_in(dense)
    near = in_band(dense, points, 4)
    assert near.sum() > 1000
    voxel = dense.spacing[0]
    error = np.abs(sparse.sample(points[near]) - dense.sample(points[near])).max()
    assert error <= ROUNDING_VOXELS * voxel
    slopes = np.abs(sparse.gradient(points[near]) - dense.gradient(points[near]))
    # The same cells, and the same corners of them.
    assert slopes.max() <= 16 * ROUNDING_VOXELS
    nearest = sparse.sample(points[near], filter="nearest")
    np.testing.assert_allclose(
        nearest, dense.sample(points[near], filter="nearest"), equal_nan=False, atol=ROUNDING_VOXELS * voxel
    )


@pytest.mark.parametrize("encoding", ["float32", "float16", "snorm16", "snorm8"])
@pytest.mark.parametrize("tolerance", [0.01, 0.2])
def test_coarser_bricks_keep_the_tolerance(tolerance: float, encoding: str) -> None:
    dense = fb.bake(meshes.icosphere(5), 128, device="cpu")
    fine, coarse = dense.to_sparse(tolerance=None), dense.to_sparse(tolerance=tolerance, encoding=encoding)
    voxel = dense.spacing[0]
    counts = coarse.brick_counts
    # A sphere of 58 voxels: cells of two voxels are off by (2h)^2 / 8 times 2 / R, 0.017 voxels.
    if tolerance == 0.2:
        assert counts[2] + counts[4] > 100
        assert sum(counts.values()) < sum(fine.brick_counts.values()) / 2
    points = points_in(dense)
    near = in_band(dense, points, 4)
    # A truncated sample is off by a step of the encoding: a share of up to 24 voxels, or of the band.
    step = {"float32": 0.0, "float16": 24 * 2.0**-10, "snorm16": 4 / 32767, "snorm8": 4 / 127}[encoding]
    error = np.abs(coarse.sample(points[near]) - dense.sample(points[near])).max() / voxel
    assert error <= tolerance + step + ROUNDING_VOXELS
    assert coarse.nbytes <= fine.nbytes


@pytest.mark.parametrize("encoding", ["snorm16", "snorm8"])
def test_quantised_coarse_bricks_keep_the_tolerance_within_half_the_band(encoding: str) -> None:
    dense = fb.bake(meshes.icosphere(5), 96, device="cpu")
    sparse = dense.to_sparse(tolerance=0.05, encoding=encoding)
    voxel, truth = dense.spacing[0], dense.distances
    errors = (np.abs(truth) - np.abs(sparse.distances)) / voxel
    # The codes are rounded toward zero, by up to a step.
    step = 4 / {"snorm16": 32767, "snorm8": 127}[encoding]
    half = np.abs(truth) < 2 * voxel
    assert np.abs(errors[half]).max() <= 0.05 + step + ROUNDING_VOXELS
    # Farther away a sample may be a lower bound, but never exceeds the distance by more.
    band = np.abs(truth) < 4 * voxel
    assert errors[band].max() > 0.1
    assert errors[band].min() >= -0.05 - ROUNDING_VOXELS
    assert (sparse.distances * truth)[~half].min() > 0


@pytest.mark.parametrize("geometry", [meshes.knot(), meshes.hollow_sphere(), meshes.open_box(), meshes.soup(40)])
def test_elsewhere_it_is_a_bound_with_the_right_sign(geometry: meshes.Geometry) -> None:
    mesh = fb.Mesh(*geometry)
    sparse = fb.bake_sparse(mesh, 64, tolerance=None)
    corners = sparse.bounds + np.array([[-1.0], [1.0]]) * (sparse.bounds[1] - sparse.bounds[0])
    points = np.random.default_rng(3).uniform(corners[0], corners[1], (6000, 3))
    points = np.concatenate([points, points_in(sparse, 6000)])
    exact = np.abs(fb.signed_distance(mesh, points, sign="unsigned", device="cpu"))
    values = sparse.sample(points)
    is_outside = ~((points >= sparse.bounds[0]) & (points <= sparse.bounds[1])).all(axis=1)
    index = sparse._core_field.arrays()["index"]
    cells = np.floor((points - sparse.bounds[0]) / sparse.spacing - 0.5).astype(int)
    bricks = np.clip((cells + 1) // 7, 0, np.array(index.shape) - 1)
    far = is_outside | (index[tuple(bricks.T)] >> 30 == 3)
    assert far.sum() > 3000
    slack = 1e-6 * np.linalg.norm(sparse.bounds[1] - sparse.bounds[0])
    assert (np.abs(values[far]) <= exact[far] + slack).all()
    # The bound is of use: more than half of the distance for most points.
    assert np.median(np.abs(values[far]) / exact[far]) > 0.5
    if mesh.topology()["closed"]:
        signed = fb.signed_distance(mesh, points, device="cpu")
        assert ((values < 0) == (signed < 0))[far].all()


def test_pictures_are_those_of_the_dense_field(dense: fb.Volume, device: str) -> None:
    sparse = dense.to_sparse(tolerance=TOLERANCE)
    camera = fb.Camera.fit(dense.inner_bounds)
    ours, theirs = (fb.raymarch(field, camera, size=(96, 72), device=device) for field in (sparse, dense))
    assert (ours.object_id != theirs.object_id).mean() < 0.003
    both = (ours.object_id == 0) & (theirs.object_id == 0)
    assert both.mean() > 0.1
    # A field that is off by the tolerance moves a hit by that over the cosine; few pixels look along the surface.
    off = np.abs(ours.depth[both] - theirs.depth[both]) / dense.spacing[0]
    assert np.quantile(off, 0.9) < 4 * TOLERANCE
    assert off.max() < 3


def test_a_coarse_picture_has_the_depth_of_the_sphere() -> None:
    sparse = fb.bake_sparse(meshes.icosphere(5), 128, tolerance=0.1)
    assert sparse.brick_counts[2] + sparse.brick_counts[4] > 0
    camera = fb.Camera((0, 0, 4), (0, 0, 0))
    frame = fb.raymarch(sparse, camera, size=(65, 65), device="cpu")
    # The ray of the middle pixel meets the sphere at depth 3; facets, tolerance and interpolation.
    assert frame.depth[32, 32] == pytest.approx(3, abs=0.002 + 0.2 * sparse.spacing[0])
    steps = fb.raymarch(sparse.to_volume(), camera, size=(65, 65), device="cpu").steps
    assert frame.steps.sum() < 1.5 * steps.sum()


def test_an_eye_inside_the_solid_sees_it_at_once(device: str) -> None:
    sparse = fb.bake_sparse(meshes.box(), 96)
    frame = fb.raymarch(sparse, fb.Camera((0, 0, 0), (0, 0, -1)), size=(8, 8), device=device)
    assert (frame.depth == 0).all()


@pytest.mark.parametrize("resolution", [(1, 1, 1), (2, 30, 1), (6, 7, 8), (28, 29, 27)])
def test_any_shape_will_do(resolution: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(1)
    volume = fb.Volume(rng.uniform(-0.1, 0.1, resolution), [(0, 0, 0), (1, 1, 1)])
    sparse = volume.to_sparse(tolerance=0)
    points = rng.uniform(0, 1, (2000, 3))
    np.testing.assert_allclose(sparse.sample(points), volume.sample(points), equal_nan=False, atol=1e-6)
    assert np.array_equal(sparse.distances, volume.distances)
    first, second = (fb.raymarch(field, size=(16, 16), device="cpu") for field in (sparse, volume))
    np.testing.assert_allclose(first.depth, second.depth, equal_nan=False, rtol=1e-5)


def test_a_two_sided_sheet() -> None:
    sheet = meshes.flat_sheet()
    options = {"two_sided": True, "thickness": 0.1}
    sparse, dense = fb.bake_sparse(sheet, 64, tolerance=None, **options), fb.bake(sheet, 64, device="cpu", **options)
    points = points_in(dense)
    near = in_band(dense, points, 4)
    np.testing.assert_allclose(sparse.sample(points[near]), dense.sample(points[near]), equal_nan=False, atol=1e-6)


@pytest.mark.parametrize("encoding", ["float32", "float16", "snorm16", "snorm8"])
def test_files_and_pickles_bring_it_back(dense: fb.Volume, encoding: str, tmp_path: Path) -> None:
    sparse = dense.to_sparse(encoding=encoding, tolerance=0.2)
    sparse.save(tmp_path / "sparse.npz")
    points = points_in(dense, 3000) * 1.2
    for other in (fb.load(tmp_path / "sparse.npz"), pickle.loads(pickle.dumps(sparse))):
        assert isinstance(other, fb.SparseVolume)
        assert (other.encoding, other.band, other.nbytes) == (sparse.encoding, sparse.band, sparse.nbytes)
        assert np.array_equal(other.sample(points), sparse.sample(points))
        assert np.array_equal(other.inner_bounds, sparse.inner_bounds)
    assert (tmp_path / "sparse.npz").stat().st_size < sparse.nbytes + 8192


def test_a_file_whose_index_points_nowhere_is_refused(dense: fb.Volume, tmp_path: Path) -> None:
    sparse = dense.to_sparse()
    path = tmp_path / "sparse.npz"
    sparse.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    for name, change in {
        "index": np.full_like(arrays["index"], 10**6),
        "bricks": arrays["bricks"][:1],
        "nodes": -arrays["nodes"],
        "index ": arrays["index"][:-1],
    }.items():
        np.savez(path, **{**arrays, name.strip(): change})
        with pytest.raises(fb.FormatError, match=r"sparse\.npz"):
            fb.load(path)


def test_mistakes_are_named(dense: fb.Volume, knot: fb.Mesh) -> None:
    with pytest.raises(fb.ArgumentError, match="band: must be a finite number of at least 2"):
        dense.to_sparse(band=1)
    with pytest.raises(fb.ArgumentError, match="tolerance"):
        fb.bake_sparse(knot, 32, tolerance=-1)
    with pytest.raises(fb.ArgumentError, match="encoding"):
        fb.bake_sparse(knot, 32, encoding="int4")  # type: ignore[arg-type]
    with pytest.raises(AttributeError, match="cannot be changed"):
        dense.to_sparse()._report = None  # type: ignore[assignment]
    assert repr(dense.to_sparse()).startswith("SparseVolume(")


def test_it_holds_far_from_the_origin() -> None:
    shift = np.array([1e5, -2e5, 3e5])
    vertices, faces = meshes.icosphere(3)
    here, there = fb.bake_sparse((vertices, faces), 64), fb.bake_sparse((vertices + shift, faces), 64)
    points = points_in(here)
    # Vertices are kept to 1e-7 of their offset from the mesh's centre.
    np.testing.assert_allclose(there.sample(points + shift), here.sample(points), equal_nan=False, atol=1e-6)


def test_signs_against_brute_force(knot: fb.Mesh) -> None:
    sparse = fb.bake_sparse(knot, 48, tolerance=None)
    points = points_in(sparse, 300)
    exact = truth.signed_distance(np.asarray(knot.vertices, dtype=np.float64), np.asarray(knot.faces), points)
    clear = np.abs(exact) > 0.5 * sparse.spacing[0]
    assert ((sparse.sample(points) < 0) == (exact < 0))[clear].all()


def test_a_sparse_volume_is_packed_and_merged_as_its_whole_grid(dense: fb.Volume) -> None:
    sparse = dense.to_sparse()
    whole = sparse.to_volume().distances
    atlas = fb.pack([sparse, (sparse, np.eye(4))], page_size=1024)
    assert np.array_equal(atlas.unpack(0).distances, whole)
    assert np.array_equal(atlas.unpack(atlas.add(sparse)).distances, whole)
    merged, expected = (fb.merge(geometry, 24, device="cpu") for geometry in ([sparse], [sparse.to_volume()]))
    assert np.array_equal(merged.distances, expected.distances)


def test_a_sparse_volume_is_no_list(dense: fb.Volume) -> None:
    sparse = dense.to_sparse()
    with pytest.raises(fb.ArgumentError, match=r"volumes: .*put it in a list"):
        fb.pack(sparse)


@pytest.mark.parametrize("value", [100.0, -100.0])
@pytest.mark.parametrize("encoding", ["float32", "snorm8"])
def test_a_field_without_bricks_is_nothing_or_its_box(value: float, encoding: str, device: str) -> None:
    volume = fb.Volume(np.full((20, 21, 22), value), [(-1, -1, -1), (1, 1, 1)])
    sparse = volume.to_sparse(encoding=encoding)
    assert not sum(sparse.brick_counts.values())
    frame = fb.raymarch(sparse, fb.Camera((0, 0, 4), (0, 0, 0)), size=(17, 17), device=device)
    assert (frame.object_id[8, 8] == 0) == (value < 0)
    # The face of the box, three units away.
    assert frame.depth[8, 8] == (pytest.approx(3, abs=1e-5) if value < 0 else np.inf)


@pytest.mark.parametrize("encoding", ["float32", "float16", "snorm16", "snorm8"])
def test_noise_is_drawn_alike_on_the_device(encoding: str, gpu: str, random: np.random.Generator) -> None:
    noise = fb.Volume(random.uniform(-0.3, 1.7, (23, 17, 30)), [(-1, -1, -1), (1, 1, 1)])
    sparse = noise.to_sparse(tolerance=None, encoding=encoding)
    camera = fb.Camera((1, 2, 4), (0, 0, 0))
    ours, theirs = (fb.raymarch(sparse, camera, size=(96, 96), device=where) for where in (gpu, "cpu"))
    hit = (ours.object_id == 0) & (theirs.object_id == 0)
    assert hit.sum() > 1000
    # A ray that grazes a bump may miss it by a rounding.
    assert (ours.object_id != theirs.object_id).sum() <= 2
    assert np.quantile(np.abs(ours.depth[hit] - theirs.depth[hit]), 0.995) <= 1e-5


def test_a_sparse_volume_is_a_leaf_of_a_shape_and_no_array():
    volume = fb.bake(fb.box((2, 1, 0.5)), 16)
    sparse = volume.to_sparse()
    points = np.random.default_rng(3).uniform(-1.5, 1.5, (64, 3))
    assert np.array_equal(
        fb.volume_shape(sparse).distance(points), fb.volume_shape(sparse.to_volume()).distance(points)
    )
    with pytest.raises(TypeError, match="to_volume"):
        np.asarray(sparse)
    with pytest.raises(fb.FormatError, match=r"to_volume\(\)\.save"):
        sparse.save("v.dds")
    merged = fb.merge([volume], 8)
    assert repr(merged).startswith("MergedField(")


def test_a_shape_is_baked_to_bricks():
    shape = fb.sphere(1.0) | fb.box(0.8).translate((1, 0, 0))
    sparse, dense = fb.bake_sparse(shape, 64, tolerance=None), fb.bake(shape, 64, device="cpu")
    near = np.abs(dense.distances) < 4 * dense.spacing.max()
    points = np.stack(np.meshgrid(*dense.coordinates, indexing="ij"), axis=-1)[near]
    # The same samples, read at the voxel centres, whose positions round to 1e-7 of the box.
    assert np.abs(sparse.sample(points) - dense.distances[near]).max() <= 1e-6 * np.ptp(dense.bounds)
    assert fb.bake_sparse([fb.sphere(1.0), fb.box(0.8).translate((1, 0, 0))], 64).resolution == dense.resolution
    with pytest.raises(fb.ArgumentError, match="sign"):
        fb.bake_sparse(shape, 32, sign="parity")
