"""Every shader text of a stored field, an atlas, a quadric and a part compiles in its language."""

import numpy as np
import pytest

import fieldbake as fb
from compilers import glsl_errors, hlsl_errors, metal_errors, wgsl_errors

#: Calls of the functions of each text at a position p.
CALLS = {
    "volume": ("field_distance(p)", "field_gradient(p).x"),
    "snorm": ("field_distance(p)", "field_gradient(p).x"),
    "snorm16": ("field_distance(p)", "field_gradient(p).x"),
    "sparse": ("sparse_distance(p)",),
    "sparse snorm": ("sparse_distance(p)",),
    "sparse snorm16": ("sparse_distance(p)",),
    "nested": ("nested_distance(p)",),
    "quadrics": ("intersect_quadric(load_quadric(0), p, p, 0.0)", "quadric_normal(load_quadric(0), p, p).x"),
    "part": ("part(p)",),
    "default part": ("distance_to_shape(p)",),
    "atlas": (),
    "png atlas": (),
    "integer atlas": (),
}


@pytest.fixture(scope="module")
def functions():
    volume = fb.bake(fb.box((2, 1, 0.5)), 8)
    aside = np.eye(4)
    aside[0, 3] = 6
    atlas = fb.pack([volume, volume], page_size="fit")
    integers = fb.pack([volume, volume], page_size="fit", encoding="snorm16")
    part = fb.csg.decompose((fb.box(2) | fb.sphere(1.2)) - fb.cylinder(0.4, 4))[0]
    return {
        "volume": volume.shader,
        "snorm": volume.quantize("snorm8").shader,
        "snorm16": volume.quantize("snorm16").shader,
        "sparse": volume.to_sparse().shader,
        "sparse snorm": volume.to_sparse().quantize("snorm8").shader,
        "sparse snorm16": volume.to_sparse().quantize("snorm16").shader,
        "nested": fb.merge([volume, (volume, aside)], 8, levels=2, center=(0, 0, 0)).shader,
        "quadrics": fb.Quadric.shader,
        "part": lambda language: part.shader(language, name="part"),
        "default part": part.shader,
        "atlas": atlas.shader,
        "png atlas": lambda language: atlas.shader(language, texels="png"),
        "integer atlas": lambda language: integers.shader(language, texels="integers"),
    }


def sum_of(name, *, words="p"):
    return " + ".join(CALLS[name] or ("0.0",)).replace("(p", f"({words}").replace(", p", f", {words}")


@pytest.mark.parametrize("name", CALLS)
def test_naga_compiles_the_wgsl(functions, name):
    text = functions[name]("wgsl")
    if name == "quadrics":
        # naga is called through these functions; the text has them already.
        assert "fn intersect_quadric" in text
        return
    caller = f"\nfn caller(p: vec3f) -> f32 {{ return {sum_of(name)}; }}\n"
    # The bindings of the text and the bindings of the functions that come with the call of naga are of different
    # groups.
    text = text.replace("@group(0)", "@group(1)") + caller
    assert wgsl_errors(text) == ""
    assert wgsl_errors(text.replace("-> f32", "-> vec2f", 1)) != ""


@pytest.mark.parametrize("name", CALLS)
def test_glslang_compiles_the_glsl_and_the_hlsl(functions, name, tmp_path):
    main = f"\nout vec4 color;\nvoid main() {{ vec3 p = gl_FragCoord.xyz; color = vec4({sum_of(name)}); }}\n"
    text = functions[name]("glsl") + main
    assert glsl_errors(tmp_path, "frag", text) == ""
    assert glsl_errors(tmp_path, "frag", text.replace("vec3 p", "vec2 p")) != "" or not CALLS[name]
    main = (
        f"\nfloat4 main(float4 at : SV_Position) : SV_Target {{ float3 p = at.xyz; return ({sum_of(name)}).xxxx; }}\n"
    )
    text = functions[name]("hlsl") + main
    assert hlsl_errors(tmp_path, "frag", text) == ""
    assert hlsl_errors(tmp_path, "frag", text.replace("float3 p", "float9 p")) != ""


@pytest.mark.parametrize("name", CALLS)
def test_clang_parses_the_msl(functions, name):
    text = functions[name]("msl")
    assert metal_errors(text) == []
    assert metal_errors(text.replace("return ", "return undefined_", 1)) != []
