"""Volumes in 16 and 8 bits: magnitudes never exceed the true distance, and errors are within the stated bound."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldbake as fb
import meshes
from pictures import DEPTH_TOLERANCE

ENCODINGS = ["float16", "snorm16", "snorm8"]
BYTES = {"float16": 2, "snorm16": 2, "snorm8": 1}


@pytest.fixture(scope="module")
def volume() -> fb.Volume:
    return fb.bake(meshes.torus(), 48, device="cpu")


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("band", [2, 4, 9.5])
def test_magnitudes_never_grow_and_errors_keep_their_bound(volume: fb.Volume, encoding: str, band: float) -> None:
    quantized = volume.quantize(encoding, band=band)  # type: ignore[arg-type]
    exact, stored = volume.distances, quantized.distances
    assert (np.abs(stored) <= np.abs(exact)).all()
    assert ((stored == 0) | (np.sign(stored) == np.sign(exact))).all()
    reach = np.inf if encoding == "float16" else band * volume.spacing.max()
    inside = np.abs(exact) <= reach
    bounds = np.array([quantized.error_bound(float(d)) for d in exact[inside]])
    assert (np.abs(stored - exact)[inside] <= bounds).all()
    # Beyond the band: the band.
    np.testing.assert_allclose(np.abs(stored[~inside]), reach, equal_nan=False, rtol=1e-6)
    assert quantized.nbytes == BYTES[encoding] * exact.size


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_array_of_a_volume_outlives_the_decoding(volume: fb.Volume, encoding: str) -> None:
    quantized = volume.quantize(encoding)  # type: ignore[arg-type]
    array = np.asarray(quantized, dtype=np.float64)
    same_type = np.asarray(quantized)
    assert np.array_equal(array, quantized.distances)
    assert np.array_equal(same_type, quantized.distances)
    # This protocol hands out an address without its owner, and the decoded samples have no other owner.
    assert not hasattr(quantized, "__array_interface__")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_samples_and_slopes_are_those_of_the_decoded_field(volume: fb.Volume, encoding: str) -> None:
    quantized = volume.quantize(encoding)  # type: ignore[arg-type]
    decoded = fb.Volume(quantized.distances, volume.bounds, inner_bounds=volume.inner_bounds)
    points = np.random.default_rng(5).uniform(volume.bounds[0] - 0.5, volume.bounds[1] + 0.5, (5000, 3))
    assert np.array_equal(quantized.sample(points), decoded.sample(points))
    assert np.array_equal(quantized.sample(points, filter="nearest"), decoded.sample(points, filter="nearest"))
    assert np.array_equal(quantized.gradient(points), decoded.gradient(points))
    assert np.array_equal(quantized.downsample().distances, decoded.downsample().distances)
    assert quantized.to_mesh().faces.shape == decoded.to_mesh().faces.shape
    outside = ~((points > volume.bounds[0]) & (points < volume.bounds[1])).all(axis=1)
    exact = fb.signed_distance(meshes.torus(), points[outside], device="cpu")
    assert (quantized.sample(points[outside]) <= exact + 1e-6).all()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pictures_are_those_of_the_decoded_field(volume: fb.Volume, encoding: str, device: str) -> None:
    quantized = volume.quantize(encoding)  # type: ignore[arg-type]
    decoded = fb.Volume(quantized.distances, volume.bounds, inner_bounds=volume.inner_bounds)
    ours, theirs = (fb.raymarch(field, size=(64, 48), device=device) for field in (quantized, decoded))
    assert np.array_equal(ours.depth, theirs.depth)
    assert np.array_equal(ours.color, theirs.color)
    # A device receives decoded samples, so the picture of the CPU, which decodes them itself, is compared too.
    here = fb.raymarch(quantized, size=(64, 48), device="cpu")
    assert (ours.object_id != here.object_id).mean() <= 1e-3
    hit = (ours.object_id == 0) & (here.object_id == 0)
    assert hit.mean() > 0.1
    assert np.abs(ours.depth[hit] - here.depth[hit]).max() <= DEPTH_TOLERANCE
    # Off by a step at most: hits move by a step over the cosine.
    full = fb.raymarch(volume, size=(64, 48), device=device)
    both = (ours.object_id == 0) & (full.object_id == 0)
    step = quantized.error_bound(float(volume.spacing.max()))
    assert np.median(np.abs(ours.depth[both] - full.depth[both])) <= 3 * step
    assert (ours.object_id != full.object_id).mean() < 0.01


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_files_and_pickles_bring_the_bits_back(volume: fb.Volume, encoding: str, tmp_path: Path) -> None:
    quantized = volume.quantize(encoding)  # type: ignore[arg-type]
    quantized.save(tmp_path / "q.npz")
    for other in (fb.load(tmp_path / "q.npz"), pickle.loads(pickle.dumps(quantized))):
        assert isinstance(other, fb.QuantizedVolume)
        assert np.array_equal(other.encoded, quantized.encoded)
        assert (other.encoding, other.scale) == (quantized.encoding, quantized.scale)
        assert np.array_equal(other.distances, quantized.distances)


def test_files_that_lie_are_refused(volume: fb.Volume, tmp_path: Path) -> None:
    path = tmp_path / "q.npz"
    volume.quantize("snorm8").save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    header = str(arrays["header"])
    for find, replace in [('"snorm8"', '"snorm16"'), ('"scale": ', '"scale": -'), ("quantized", "squeezed")]:
        assert find in header
        np.savez(path, header=np.array(header.replace(find, replace)), distances=arrays["distances"])
        with pytest.raises(fb.FormatError, match=r"q\.npz"):
            fb.load(path)


@given(
    values=st.lists(st.floats(-1e3, 1e3, width=32), min_size=8, max_size=8),
    band=st.floats(0.25, 50),
    encoding=st.sampled_from(ENCODINGS),
    scale=st.sampled_from([1e-2, 1.0, 3e1]),
)
@settings(max_examples=100, deadline=None)
def test_any_numbers_round_toward_zero(values: list[float], band: float, encoding: str, scale: float) -> None:
    exact = np.array(values, dtype=np.float32).reshape(2, 2, 2) * np.float32(scale)
    volume = fb.Volume(exact, [(0, 0, 0), (2 * scale, 2 * scale, 2 * scale)])
    quantized = volume.quantize(encoding, band=band)  # type: ignore[arg-type]
    stored = quantized.distances
    assert (np.abs(stored) <= np.abs(exact)).all()
    for before, after in zip(exact.ravel().tolist(), stored.ravel().tolist(), strict=True):
        if encoding == "float16" or abs(before) <= quantized.scale:
            assert abs(before - after) <= quantized.error_bound(before)
        else:
            assert abs(after) == pytest.approx(quantized.scale)


def test_mistakes_are_named(volume: fb.Volume) -> None:
    with pytest.raises(fb.ArgumentError, match='encoding: must be one of "float16", "snorm16", "snorm8"'):
        volume.quantize("uint8")  # type: ignore[arg-type]
    with pytest.raises(fb.ArgumentError, match="band"):
        volume.quantize("snorm8", band=0)
    assert "snorm8" in repr(volume.quantize("snorm8"))


#: Bound of the error of each encoding in voxels, for distances of up to 4 voxels: a step of 11 bits, or of the band.
VOXEL_ERROR = {"float16": 4 * 2.0**-10, "snorm16": 4 / 32767, "snorm8": 4 / 127}


@pytest.mark.parametrize("size", [1e-30, 1e-6, 1e-3, 1.0, 3e3, 1e6, 1e30])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_error_is_the_same_in_voxels_for_a_mesh_of_any_size(size: float, encoding: str, tmp_path: Path) -> None:
    vertices, faces = meshes.torus()
    volume = fb.bake((np.asarray(vertices) * size, faces), 20, device="cpu")
    voxel = float(volume.spacing.max())
    exact = volume.distances.astype(np.float64)
    near = np.abs(exact) <= 4 * voxel
    quantized = volume.quantize(encoding)  # type: ignore[arg-type]
    atlas = fb.pack([volume], page_size=128, encoding=encoding)  # type: ignore[arg-type]
    files = []
    for name in ("q.npz", "q.ktx2", "q.dds"):
        quantized.save(tmp_path / name)
        files.append(fb.load(tmp_path / name).distances)
    for name in ("a.npz", "a.exr"):
        atlas.save(tmp_path / name)
        files.append(fb.load(tmp_path / name).unpack(0).distances)
    fields = [quantized.distances, atlas.unpack(0).distances, *files]
    for distances in fields:
        stored = distances.astype(np.float64)
        assert (np.abs(stored) <= np.abs(exact)).all()
        error = np.abs(stored - exact)
        assert error[near].max() <= VOXEL_ERROR[encoding] * voxel * (1 + 2.0**-20)
        if encoding == "float16":
            # 11 significant bits everywhere that is more than 2^-14 voxels from the surface.
            assert (error <= np.maximum(2.0**-10 * np.abs(exact), 2.0**-24 * voxel)).all()
        assert np.array_equal(distances, fields[0])
    points = np.random.default_rng(1).uniform(*volume.bounds, (200, 3))
    assert np.array_equal(atlas.sample(0, points), quantized.sample(points))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_stored_numbers_do_not_change_with_a_power_of_two(volume: fb.Volume, encoding: str) -> None:
    stored = volume.quantize(encoding).encoded  # type: ignore[arg-type]
    for factor in (2.0**-100, 2.0**-20, 2.0**20, 2.0**100):
        scaled = fb.Volume(volume.distances * np.float32(factor), volume.bounds * factor)
        assert np.array_equal(scaled.quantize(encoding).encoded, stored)  # type: ignore[arg-type]


def test_halves_beyond_their_range_are_a_lower_bound() -> None:
    far = fb.Volume(np.full((2, 2, 2), -1e9, np.float32), [(0, 0, 0), (2, 2, 2)])
    assert (far.quantize("float16").distances == -65504).all()


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_pictures_of_a_quantised_mesh_of_any_size(size: float, device: str) -> None:
    vertices, faces = meshes.torus()
    exact = fb.bake((np.asarray(vertices) * size, faces), 20, device="cpu")
    for field in (exact.quantize("float16"), exact.to_sparse(encoding="float16", tolerance=None)):
        ours, theirs = (fb.raymarch(geometry, size=(32, 24), device=device) for geometry in (field, exact))
        both = (ours.object_id == 0) & (theirs.object_id == 0)
        assert both.sum() > 100
        assert (ours.object_id != theirs.object_id).mean() < 0.01
        # A sample is off by 2^-10 of a voxel or less at the surface, and a hit by that over the cosine.
        assert np.median(np.abs(ours.depth[both] - theirs.depth[both])) <= 3 * 2.0**-10 * exact.spacing.max()


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("ending", [".dds", ".ktx2", ".nrrd"])
def test_textures_keep_the_stored_numbers(volume: fb.Volume, encoding: str, ending: str, tmp_path: Path) -> None:
    quantized = volume.quantize(encoding, band=3)  # type: ignore[arg-type]
    quantized.save(tmp_path / f"torus{ending}")
    assert np.array_equal(fb.load(tmp_path / f"torus{ending}").distances, quantized.distances)


def test_a_texture_in_another_encoding(volume: fb.Volume, tmp_path: Path) -> None:
    quantized = volume.quantize("snorm8")
    quantized.save(tmp_path / "torus.dds", encoding="float32")
    assert np.array_equal(fb.load(tmp_path / "torus.dds").distances, quantized.distances)
    with pytest.raises(fb.ArgumentError, match="snorm8, got 'snorm16'"):
        quantized.save(tmp_path / "torus.npz", encoding="snorm16")


def test_a_scene_takes_volumes_of_every_kind(volume: fb.Volume) -> None:
    camera = fb.Camera.fit(volume.bounds)
    pictures = [
        fb.render(fb.Scene([geometry]), camera, size=(48, 48), device="cpu").object_id
        for geometry in (volume, volume.quantize("snorm16"), volume.to_sparse(tolerance=None))
    ]
    assert (pictures[0] == 0).any()
    for picture in pictures[1:]:
        assert np.array_equal(picture, pictures[0])
