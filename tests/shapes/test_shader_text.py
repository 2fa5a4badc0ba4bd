"""The texts of shapes, parts and atlases in every shading language: bindings, compilers, and values in a browser."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from browser import Texture, glsl_job, run_glsl
from compilers import glsl_errors, hlsl_errors, metal_errors, wgsl_errors

#: Positions of the distances that a browser computes.
POINTS = np.random.default_rng(8).uniform(-2, 2, (128, 3)).astype(np.float32)


def shapes() -> dict[str, fb.Shape]:
    box, tube = fb.box((1, 2, 3)), fb.cylinder(radius=0.4, height=4)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0.2, 0.7)])
    return {
        "leaf": fb.sphere(1),
        "solid": (box | tube.rotate("x", 90)) - fb.torus(1, 0.2) & fb.sphere(4),
        "smooth": fb.Shape.union(box, fb.sphere(1).translate((1, 0, 0)), k=0.2),
        "warped": box.shell(0.1).twist(per_unit_deg=30) | fb.ellipsoid((1, 0.5, 0.3)),
        "flat": fb.polygon(corners).extrude(1),
        "repeated": fb.capsule(0.1, 0.3).repeat((0.6, 0.7, 0.8), (3, 2, 4)) | fb.cone(0.2, 0.6).circular_array(5, 1.4),
    }


def kernel_arguments(text: str) -> list[str]:
    """The arguments of the entry point of an MSL text."""
    found = re.search(r"\nkernel void \w+\((.*?)\n\) \{", text, re.DOTALL)
    assert found is not None
    return [line.lstrip(" ,") for line in found[1].strip().splitlines()]


@pytest.mark.parametrize("name", shapes())
def test_every_argument_of_the_metal_kernel_has_a_valid_attribute(name: str) -> None:
    text = shapes()[name].shader("msl")
    arguments = kernel_arguments(text)
    assert re.search(r" id \[\[thread_position_in_grid\]\]$", arguments[0])
    slots = {}
    for argument in arguments[1:]:
        bound = re.search(r"& (\w+) \[\[buffer\((\d+)\)\]\]$", argument)
        assert bound is not None, argument
        slots[bound[1]] = int(bound[2])
    # The WGSL bindings, and the sizes of the buffers after them.
    assert slots == {"numbers": 0, "points": 1, "distances": 2, "_buffer_sizes": 3}
    assert "fake" not in text


@pytest.mark.parametrize("name", shapes())
def test_buffers_of_other_languages_have_the_bindings_of_the_wgsl(name: str) -> None:
    shape = shapes()[name]
    bindings = [int(n) for n in re.findall(r"@binding\((\d+)\)", shape.shader("wgsl"))]
    assert bindings == [0, 1, 2]
    glsl = shape.shader("glsl")
    blocks = re.findall(r"^layout\((.*?)\)[\w ]* buffer \w+", glsl, re.MULTILINE)
    assert blocks == [f"std430, binding = {n}" for n in bindings]
    registers = re.findall(r"register\((\w+)\)", shape.shader("hlsl"))
    assert registers == ["t0", "t1", "u2"]


def atlas(layout: str, encoding: str) -> fb.Atlas:
    volume = fb.bake(fb.models.gear(), (8, 8, 8), device="cpu")
    return fb.pack([volume], layout=layout, page_size=64, encoding=encoding)  # type: ignore[arg-type]


TEXELS = [("float32", "pages"), ("float16", "pages"), ("snorm16", "pages"), ("float32", "png"), ("snorm8", "png")]


def atlas_texts(language: str) -> dict[str, str]:
    return {
        f"{layout} {encoding} {texels}": atlas(layout, encoding).shader(language, texels=texels)  # type: ignore[arg-type]
        for layout in ("strips", "shelves")
        for encoding, texels in TEXELS
    }


def test_atlas_texts_have_no_placeholders() -> None:
    for text in atlas_texts("msl").values():
        assert "fake" not in text
        # Functions take texture and sampler; the entry point of the user has the attributes.
        assert "metal::texture2d_array<float, metal::access::sample> atlas_pages" in text
    for text in atlas_texts("hlsl").values():
        assert re.search(r"^Texture2DArray<float4> atlas_pages : register\(t0\);", text, re.MULTILINE)
        assert re.search(r"^SamplerState atlas_sampler : register\(s0\);", text, re.MULTILINE)
    for text in atlas_texts("glsl").values():
        # GLSL ES 3.00 has no layout(binding=) for samplers.
        assert re.search(r"^uniform highp sampler2DArray atlas_pages;", text, re.MULTILINE)


@pytest.mark.parametrize("name", shapes())
def test_clang_parses_the_metal_text_of_a_shape(name: str) -> None:
    text = shapes()[name].shader("msl")
    assert metal_errors(text) == []
    # The parser does find mistakes.
    assert metal_errors(text.replace("distance_to_shape(_", "distance_of_shape(_"))


def test_clang_parses_the_metal_texts_of_atlases() -> None:
    for name, text in atlas_texts("msl").items():
        assert metal_errors(text) == [], name
        assert metal_errors(text.replace("atlas_share(", "atlas_part(", 1))


@pytest.mark.parametrize("name", shapes())
def test_the_reference_compiler_takes_the_glsl_of_a_shape(name: str, tmp_path: Path) -> None:
    text = shapes()[name].shader("glsl")
    assert glsl_errors(tmp_path, "comp", text) == ""
    assert glsl_errors(tmp_path, "comp", text.replace("binding = 2", "binding = two")) != ""


def test_the_reference_compiler_takes_the_glsl_of_atlases(tmp_path: Path) -> None:
    main = """
uniform AtlasEntry entry;
out highp vec4 color;
void main() {
    vec3 p = gl_FragCoord.xyz;
    color = vec4(atlas_sample(entry, p), atlas_sample_filtered(entry, p), atlas_texture_coordinates(entry, p));
}
"""
    for name, text in atlas_texts("glsl").items():
        assert glsl_errors(tmp_path, "frag", text + main) == "", name


@pytest.mark.parametrize("name", shapes())
def test_every_language_compiles_the_function_of_a_part(name: str, tmp_path: Path) -> None:
    part = next(iter(fb.csg.decompose(shapes()[name])))
    assert wgsl_errors(part.shader()) == ""
    main = "\nout vec4 color;\nvoid main() { color = vec4(leaf(gl_FragCoord.xyz)); }\n"
    assert glsl_errors(tmp_path, "frag", part.shader("glsl", name="leaf") + main) == ""
    main = "\nfloat4 main(float4 p : SV_Position) : SV_Target { return leaf(p.xyz).xxxx; }\n"
    assert hlsl_errors(tmp_path, "frag", part.shader("hlsl", name="leaf") + main) == ""
    assert metal_errors(part.shader("msl", name="leaf")) == []


def test_the_text_has_the_leaves_of_the_part_only() -> None:
    ball, block = fb.csg.decompose(fb.sphere() | fb.box(1).translate((4, 0, 0)), method="aabb")
    for language in ("wgsl", "glsl", "hlsl", "msl"):
        for part, has_sphere in ((ball, True), (block, False)):
            text = part.shader(language)
            assert ("sphere(" in text) == has_sphere
            assert ("rounded_box(" in text) != has_sphere
            assert not any(word in text for word in ("torus(", "ellipsoid(", "binding", "register", "main", "kernel"))


def test_parts_in_one_shader_have_the_distances_of_numpy(tmp_path: Path) -> None:
    parts = [next(iter(fb.csg.decompose(shape))) for shape in shapes().values()]
    texts = [part.shader("glsl", name=f"part{i}") for i, part in enumerate(parts)]
    # One version line at the start of the shader.
    joined = texts[0] + "".join(text.partition("\n")[2] for text in texts[1:])
    calls = ("vec4(part0(p), part1(p), part2(p), part3(p))", "vec4(part4(p), part5(p), 0.0, 0.0)")
    results = run_glsl(tmp_path, [glsl_job(joined, call, [], POINTS) for call in calls])
    values = np.concatenate([results[0], results[1][:, :2]], axis=1)
    for name, column, part in zip(shapes(), values.T, parts, strict=True):
        # Distances reach 4 units, and sums of products round by some 2^-22 of that. Vulkan allows sines of devices an
        # error of 2^-11, and the twist turns points up to 3 units from its axis.
        bound = 3 * 2.0**-11 if name == "warped" else 4 * 2.0**-18
        assert np.abs(column - part.shape.distance(POINTS)).max() <= bound


@pytest.mark.parametrize("name", shapes())
def test_every_language_compiles_the_function_of_a_whole_shape(name: str, tmp_path: Path) -> None:
    shape = shapes()[name]
    assert shape.shader("glsl", form="kernel") == shape.shader("glsl")
    texts = {
        language: shape.shader(language, form="function", name="leaf") for language in ("wgsl", "glsl", "hlsl", "msl")
    }
    assert texts["glsl"].startswith("#version 300 es\n")
    for text in texts.values():
        assert not re.search(r"\bbuffer\b|register|binding|kernel|void main", text)
    assert wgsl_errors(texts["wgsl"]) == ""
    main = "\nout vec4 color;\nvoid main() { color = vec4(leaf(gl_FragCoord.xyz)); }\n"
    assert glsl_errors(tmp_path, "frag", texts["glsl"] + main) == ""
    main = "\nfloat4 main(float4 p : SV_Position) : SV_Target { return leaf(p.xyz).xxxx; }\n"
    assert hlsl_errors(tmp_path, "frag", texts["hlsl"] + main) == ""
    assert metal_errors(texts["msl"]) == []


def test_the_functions_of_shapes_have_the_distances_of_numpy(tmp_path: Path) -> None:
    jobs = [
        glsl_job(shape.shader("glsl", form="function"), "vec4(distance_to_shape(p))", [], POINTS)
        for shape in shapes().values()
    ]
    for (name, shape), values in zip(shapes().items(), run_glsl(tmp_path, jobs), strict=True):
        # The bounds of the distances of parts, above.
        bound = 3 * 2.0**-11 if name == "warped" else 4 * 2.0**-18
        assert np.abs(values[:, 0] - shape.distance(POINTS)).max() <= bound, name


def test_a_name_that_is_no_identifier_is_an_error() -> None:
    part = fb.csg.decompose(fb.sphere())[0]
    for name in ("a b", "1a", "", None, 3):
        with pytest.raises(fb.Error, match="name"):
            part.shader("glsl", name=name)
        if name is not None:
            with pytest.raises(fb.Error, match="name"):
                part.shape.shader("glsl", form="function", name=name)
    with pytest.raises(fb.ShapeError, match="language"):
        part.shader("cg")
    with pytest.raises(fb.ShapeError, match="form"):
        part.shape.shader("glsl", form="fragment")  # type: ignore[arg-type]
    with pytest.raises(fb.ShapeError, match='name: is for form="function"'):
        part.shape.shader("glsl", name="ball")
    holds_volume = fb.sphere() | fb.volume_shape(fb.bake(fb.sphere(), 8))
    with pytest.raises(fb.ShapeError, match="needs a texture"):
        holds_volume.shader("glsl", form="function")


def test_quadrics_near_the_origin_are_hit_and_far_ones_after_a_move(tmp_path: Path) -> None:
    random = np.random.default_rng(7)
    radius, way = 0.1, np.array((0.6, 0.0, 0.8))
    jobs, centers = [], []
    # 100 radii from the origin, and 10,000 radii with the rows and the rays about a point one radius away.
    for distance, moved in ((10.0, 0.0), (1000.0, 1.0)):
        center = distance * way
        shift = np.eye(4)
        shift[:3, 3] = -moved * (center - radius * way)
        (row,) = fb.pack_quadrics([fb.Quadric.sphere(center, radius).transformed(shift)])
        center = center + shift[:3, 3]
        origins = (center + 0.5 * random.normal(size=(len(POINTS), 3))).astype(np.float32)
        directions = center + random.uniform(-0.05, 0.05, (len(POINTS), 3)) - origins
        directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
        texels = Texture("quadric_texels", "rgba32float", (6, 1), row, "2d")
        call = "vec4(intersect_quadric(load_quadric(0), p, q, 0.0))"
        jobs.append(glsl_job(fb.Quadric.shader("glsl"), call, [texels], origins, directions))
        centers.append((center, origins.astype(np.float64), directions.astype(np.float64)))
    for result, (center, origins, directions), bound in zip(
        run_glsl(tmp_path, jobs), centers, (2e-3, 1e-4), strict=True
    ):
        offset = origins - center
        b = np.einsum("ij,ij->i", offset, directions)
        root = np.sqrt(b * b - (np.einsum("ij,ij->i", offset, offset) - radius**2))
        t = np.where(-b - root >= 0, -b - root, -b + root)
        hit = t >= 1e-2
        assert hit.sum() > len(POINTS) // 2
        assert np.abs(result[hit, 0] - t[hit]).max() <= bound * radius
