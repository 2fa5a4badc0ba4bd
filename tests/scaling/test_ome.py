"""Stores opened by the reader of the package ome-zarr: levels and world coordinates."""

import numpy as np
import pytest

import fieldbake as fb

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def test_ome_zarr_finds_the_distances_at_their_world_coordinates(tmp_path):
    io = pytest.importorskip("ome_zarr.io", reason="needs ome-zarr: pip install --group long")
    from ome_zarr.reader import Multiscales, Reader

    radius, center = 1.0, np.array((3.0, -2.0, 7.0))
    mesh = fb.sphere(radius).translate(center).to_mesh(96)
    volume = fb.bake_to_zarr(mesh, tmp_path / "ball.zarr", (150, 140, 130), shard=64, chunk=16)

    (node,) = Reader(io.parse_url(tmp_path / "ball.zarr"))()

    assert any(isinstance(spec, Multiscales) for spec in node.specs)
    assert [axis["name"] for axis in node.metadata["axes"]] == ["z", "y", "x"]
    assert len(node.data) == len(volume.levels) >= 2
    # Distances of the mesh differ from the distances of the sphere by the sagitta of its triangles.
    chord = np.abs(np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1) - center, axis=1) - radius).max()
    for array, transforms, shape in zip(
        node.data, node.metadata["coordinateTransformations"], volume.levels, strict=True
    ):
        (scale,) = [one["scale"] for one in transforms if one["type"] == "scale"]
        (translation,) = [one["translation"] for one in transforms if one["type"] == "translation"]
        assert array.shape == shape[::-1]
        distances = np.asarray(array) / 32767 * volume.scale
        index = np.argwhere(np.abs(distances) < 0.9 * volume.band)
        world = (index * scale + translation)[:, ::-1]
        exact = np.linalg.norm(world - center, axis=1) - radius
        assert len(index) > 500
        # One step of the encoding, and the difference between the mesh and the sphere.
        assert np.abs(distances[tuple(index.T)] - exact).max() <= volume.scale / 32767 + 4 * chord
