"""Shader text of stored fields: GLSL in a browser beside NumPy, and the buffers that the texts read."""

import numpy as np
import pytest

import fieldbake as fb
from browser import Texture, glsl_job, run_glsl

LANGUAGES = ("wgsl", "glsl", "hlsl", "msl")
COUNT = 256


def listed(buffers):
    return [Texture(one.name, one.format, one.size, one.array, f"{len(one.size)}d") for one in buffers]


@pytest.fixture(scope="module")
def volume():
    return fb.bake(fb.box((2, 1, 0.5)).rotate("z", 20).translate((1, -1, 0.5)), (24, 20, 18))


@pytest.fixture(scope="module")
def nested():
    ball = fb.bake(fb.sphere(1), 16)
    aside = np.eye(4)
    aside[0, 3] = 6
    return fb.merge([ball, (ball, aside)], 16, levels=3, center=(0, 0, 0))


def test_the_glsl_of_every_field_is_the_field_of_numpy(volume, nested, tmp_path):
    random = np.random.default_rng(5)
    sparse = volume.to_sparse(band=2)
    assert min(list(sparse.brick_counts.values())[:1]) > 0
    inside = random.uniform(*volume.bounds, (COUNT, 3)).astype(np.float32)
    around = random.uniform(*nested.bounds, (COUNT, 3)).astype(np.float32)
    quadrics = [fb.Quadric.sphere((1, 2, 3), 0.5), fb.Quadric.cylinder(), fb.Quadric.cone()]
    packed = fb.pack_quadrics(quadrics)
    texels = [Texture("quadric_texels", "rgba32float", (6, len(quadrics)), packed, "2d")]
    center = np.array((1.0, 2.0, 3.0))
    eyes = center + random.normal(size=(COUNT, 3)) + random.choice([-8, 8], (COUNT, 1))
    ways = center + random.normal(size=(COUNT, 3)) * 0.3 - eyes
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    far, level, brick, hit = run_glsl(
        tmp_path,
        [
            glsl_job(
                volume.shader("glsl"),
                "vec4(field_distance(p), field_gradient(p))",
                listed(volume.shader_buffers()),
                inside,
            ),
            glsl_job(nested.shader("glsl"), "vec4(nested_distance(p))", listed(nested.shader_buffers()), around),
            glsl_job(sparse.shader("glsl"), "vec4(sparse_distance(p))", listed(sparse.shader_buffers()), inside),
            glsl_job(
                fb.Quadric.shader("glsl"),
                "vec4(intersect_quadric(load_quadric(0), p, q, 0.0))",
                texels,
                eyes,
                ways,
            ),
        ],
    )
    # Positions on the grid are below 32, so float32 rounds a weight by 2^-19; neighbours differ by up to a voxel.
    rounding = 3 * 2.0**-19 * float(volume.spacing.max()) * 2
    assert np.abs(far[:, 0] - volume.sample(inside)).max() <= rounding
    lengths = np.linalg.norm(far[:, 1:], axis=1)
    assert abs(np.median(lengths) - 1) <= 0.02
    # At the borders between levels either may be taken, and positions reach 8 units.
    scale = float(nested.levels[-1].spacing.max())
    assert np.quantile(np.abs(level[:, 0] - nested.sample(around)), 0.99) <= 3 * 2.0**-19 * scale * 4
    # Bounds are square roots of differences, whose rounding grows with their size.
    assert np.abs(brick[:, 0] - sparse.sample(inside)).max() <= 1e-5
    # A ray and a sphere in closed form, float64.
    eyes, ways = eyes.astype(np.float32).astype(np.float64), ways.astype(np.float32).astype(np.float64)
    along = np.einsum("ij,ij->i", center - eyes, ways)
    gap = np.sum((eyes + along[:, None] * ways - center) ** 2, axis=1)
    root = np.sqrt(np.maximum(0.25 - gap, 0))
    exact = np.where(along - root >= 0, along - root, along + root)
    exact = np.where((gap < 0.25) & (exact >= 0), exact, -1)
    # Near the outline the root of a small difference amplifies the rounding of the form.
    clear = np.abs(gap - 0.25) > 0.01
    assert clear.sum() > COUNT // 2
    assert np.abs(hit[clear, 0] - exact[clear]).max() <= 1e-4


def fields_of_every_kind(volume, nested):
    # Narrow bands leave most bricks empty; the box of the last one cuts the surface.
    fine = fb.bake(fb.models.torus_knot(), 40)
    cut = fb.bake(fb.sphere(1), 16, bounds=[(-2, -2, -0.3), (2, 2, 0.4)])
    return {
        "volume": (volume, "field_distance"),
        "snorm16 volume": (volume.quantize("snorm16"), "field_distance"),
        "cut volume": (cut, "field_distance"),
        "sparse": (fine.to_sparse(band=2), "sparse_distance"),
        "snorm16 sparse": (fine.to_sparse(band=2).quantize("snorm16"), "sparse_distance"),
        "cut sparse": (cut.to_sparse(), "sparse_distance"),
        "oblong sparse": (fb.bake(fb.models.gear(), (40, 30, 60)).to_sparse(), "sparse_distance"),
        "nested": (nested, "nested_distance"),
    }


def test_the_glsl_has_the_bounds_of_sample_inside_and_outside_the_box(volume, nested, tmp_path):
    random = np.random.default_rng(6)
    jobs, expected = [], []
    for name, (field, function) in fields_of_every_kind(volume, nested).items():
        lower, upper = field.bounds
        for growth in (0.0, 1.0):
            grown = growth * (upper - lower)
            points = random.uniform(lower - grown, upper + grown, (COUNT, 3)).astype(np.float32)
            jobs.append(glsl_job(field.shader("glsl"), f"vec4({function}(p))", listed(field.shader_buffers()), points))
            expected.append((name, growth, field.sample(points), float(np.linalg.norm(upper - lower))))
    for (name, growth, values, diagonal), result in zip(expected, run_glsl(tmp_path, jobs), strict=True):
        error = np.abs(result[:, 0] - values)
        # A bound is the root of a difference of squares of up to 4 diagonals, each rounded several times.
        bound = 32 * 2.0**-24 * 4 * diagonal
        if name == "nested":
            # At the borders between levels either may be taken.
            error = np.sort(error)[: int(0.97 * COUNT)]
        assert error.max() <= bound, (name, growth)


def test_no_format_of_a_texture_needs_a_feature(volume, nested):
    core = {"r32float", "r16float", "r16sint", "r8snorm", "r32uint"}
    for encoding in ("float32", "float16", "snorm16", "snorm8"):
        for field in (volume, volume.to_sparse()):
            encoded = field if encoding == "float32" else field.quantize(encoding)
            assert {one.format for one in encoded.shader_buffers()} <= core
    (encoded,) = volume.quantize("snorm16").shader_buffers()
    assert (encoded.format, encoded.array.dtype) == ("r16sint", np.int16)
    assert "texture_3d<i32>" in volume.quantize("snorm16").shader("wgsl")
    assert "format r16sint" in volume.quantize("snorm16").shader("glsl")


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_language_has_the_functions(volume, nested, language):
    texts = {
        "field_distance(": volume.shader(language),
        "field_gradient(": volume.quantize("snorm8").shader(language),
        "sparse_distance(": volume.to_sparse().shader(language),
        "nested_distance(": nested.shader(language),
        "load_quadric(": fb.Quadric.shader(language),
        "intersect_quadric(": fb.Quadric.shader(language),
    }
    for function, text in texts.items():
        assert function in text
        assert text.count("{") == text.count("}")
        other = {"wgsl": "texelFetch", "glsl": "textureLoad", "hlsl": "vec3", "msl": "texelFetch"}[language]
        assert other not in text
    with pytest.raises(fb.ArgumentError, match="language"):
        volume.shader("spirv")


def test_buffers_have_the_bytes_of_an_upload(volume):
    (dense,) = volume.shader_buffers()
    assert dense.to_bytes() == volume.distances.tobytes(order="F")
    assert (dense.format, dense.size) == ("r32float", volume.resolution)
    (encoded,) = volume.quantize("snorm8").shader_buffers()
    assert (encoded.format, len(encoded.to_bytes())) == ("r8snorm", volume.distances.size)
    buffers = volume.to_sparse().shader_buffers()
    assert [one.binding for one in buffers] == [0, 1, 2]
    assert "sparse_bricks" in str(buffers)
