"""Packing of meshes and shapes, which are baked first."""

import numpy as np
import pytest

import fieldbake as fb


def test_pack_bakes_meshes_and_shapes():
    gear, ball = fb.models.gear(), fb.sphere(1)
    aside = np.eye(4)
    aside[0, 3] = 5
    items = [gear, (ball, aside), (gear.vertices, gear.faces), fb.bake(ball, 9), fb.bake(ball, 9).to_sparse()]
    atlas = fb.pack(items, resolution=12, page_size="fit")
    for i, expected in enumerate([fb.bake(gear, 12), fb.bake(ball, 12), fb.bake(gear, 12), *items[3:4]]):
        assert np.array_equal(atlas.unpack(i).distances, expected.distances)
    assert np.array_equal(atlas[1].transform, aside)
    strips = fb.pack([gear, ball], resolution=8, layout="strips", page_size=64)
    assert strips.unpack(0).resolution == strips.unpack(1).resolution == (8, 8, 8)


def test_pack_names_what_it_cannot_bake():
    with pytest.raises(fb.ArgumentError, match=r"volumes\[1\]: must be a volume, a mesh, a shape"):
        fb.pack([fb.sphere(1), 7], resolution=4, page_size=64)
    field = fb.merge([fb.bake(fb.sphere(1), 16)], 16, levels=2, center=(0, 0, 0))
    with pytest.raises(fb.ArgumentError, match=r"volumes\[0\].*to_volume"):
        fb.pack([field], page_size=64)
    assert fb.pack([field.to_volume()], page_size="fit").unpack(0).resolution == field.resolution


def test_parts_write_their_own_text():
    shape = fb.sphere(1) | fb.box(1).translate((5, 0, 0))
    for part in fb.csg.decompose(shape):
        assert "fn distance_to_shape" in part.shader("wgsl")
        assert np.array_equal(part.shader_numbers(), part.shape.shader_numbers())
