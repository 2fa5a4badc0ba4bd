"""The GLSL text of an atlas, compiled and run in a browser: WebGL 2 in Chromium, without a window."""

import numpy as np
import pytest

import fieldbake as fb
from browser import Texture, glsl_job, run_glsl

#: Weights and positions in float32: a voxel coordinate below 16 is off by 2^-20, and neighbours differ by up to 2.
FLOAT32_SAMPLE = 2 * 3 * 2.0**-20 + 16 * 2.0**-24
#: Weights of a hardware filter have 8 bits: half a step on each axis, between neighbours that differ by up to 2.
FILTERED_SAMPLE = 3 * 2 / 256

#: Kind of gl.uniform for the members of an entry.
UNIFORMS = {
    "inner_min": "4fv",
    "inner_max": "4fv",
    "outer_min": "4fv",
    "outer_max": "4fv",
    "atlas_index": "1iv",
    "atlas_offset": "1iv",
    "columns": "1uiv",
    "scale": "1fv",
    "shape": "3uiv",
    "gutter": "1uiv",
    "corner": "2uiv",
    "tile": "2uiv",
}


@pytest.mark.parametrize("layout", ["shelves", "strips"])
def test_the_glsl_samples_like_numpy(layout, tmp_path, random):
    shape = (7, 7, 7) if layout == "strips" else (7, 5, 9)
    values = random.uniform(-1, 1, (5, *shape))
    volumes = [fb.Volume(v, [(-1, 0, 0.5), (1, 2, 3)]) for v in values]
    atlas = fb.pack(volumes, layout=layout, page_size=49)
    i = 4
    lower, upper = volumes[i].bounds
    points = random.uniform(lower, upper, (256, 3))
    points[:32] = np.where(random.random((32, 3)) < 0.5, lower, upper)  # corners of the box
    points = points.astype(np.float32)
    entry = atlas.entries[i]

    text = atlas.shader("glsl") + "uniform AtlasEntry entry;\n"
    functions = ("atlas_sample", "atlas_sample_filtered", "atlas_sample_nearest")
    result = ", ".join(f"{function}(entry, p)" for function in functions)
    pages = Texture(
        "atlas_pages", "r32float", (atlas.page_size, atlas.page_size, len(atlas.pages)), atlas.pages, "filtered pages"
    )
    # Members that no function reads have no location, and WebGL ignores values for them.
    uniforms = [
        (f"entry.{name}", kind, np.atleast_1d(entry[name]).tolist())
        for name, kind in UNIFORMS.items()
        if name in entry.dtype.names
    ]

    job = glsl_job(text, f"vec4({result}, atlas_texture_coordinates(entry, p).x)", [pages], points, uniforms=uniforms)
    (values,) = run_glsl(tmp_path, [job])

    exact, filtered, nearest, u = values.T
    assert np.abs(exact - volumes[i].sample(points)).max() <= FLOAT32_SAMPLE
    assert np.abs(filtered - volumes[i].sample(points)).max() <= FILTERED_SAMPLE
    # At a boundary between voxels either may be taken.
    grid = (points - lower) / volumes[i].spacing
    clear = (np.abs(grid - np.round(grid)) > 1e-4).all(axis=1)
    assert np.array_equal(nearest[clear], volumes[i].sample(points, filter="nearest")[clear])
    assert np.allclose(u[clear], atlas.texture_coordinates(i, points)[clear, 0], atol=1e-6)


@pytest.mark.parametrize("layout", ["shelves", "strips"])
def test_the_integers_of_snorm16_pages_need_no_extension(layout, tmp_path, random):
    values = random.uniform(-1, 1, (3, 6, 6, 6))
    atlas = fb.pack([fb.Volume(v, [(-1, 0, 0.5), (1, 2, 3)]) for v in values], layout=layout, encoding="snorm16")
    points = random.uniform((-1, 0, 0.5), (1, 2, 3), (256, 3)).astype(np.float32)
    entry = atlas.entries[2]
    text = atlas.shader("glsl", texels="integers") + "uniform AtlasEntry entry;\n"
    assert "isampler2DArray" in text
    assert "atlas_sample_filtered" not in text
    size = (atlas.page_size, atlas.page_size, len(atlas.pages))
    pages = Texture("atlas_pages", "r16sint", size, atlas.pages, "pages")
    uniforms = [
        (f"entry.{name}", kind, np.atleast_1d(entry[name]).tolist())
        for name, kind in UNIFORMS.items()
        if name in entry.dtype.names
    ]

    (values,) = run_glsl(tmp_path, [glsl_job(text, "vec4(atlas_sample(entry, p))", [pages], points, uniforms=uniforms)])

    assert np.abs(values[:, 0] - atlas.sample(2, points)).max() <= FLOAT32_SAMPLE
    with pytest.raises(fb.ArgumentError, match='texels: "integers" are those of snorm16 and snorm8'):
        fb.pack([fb.bake(fb.sphere(), 8)]).shader(texels="integers")
    # The texts of normalised 16-bit texels state the feature that they need.
    for texels in ("pages", "png"):
        assert "TEXTURE_FORMAT_16BIT_NORM" in atlas.shader("wgsl", texels=texels)
    assert "TEXTURE_FORMAT_16BIT_NORM" not in atlas.shader("wgsl", texels="integers")
