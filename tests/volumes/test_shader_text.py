"""Shader text of stored fields: GLSL in a browser beside NumPy, and the buffers that the texts read."""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

import fieldbake as fb

LANGUAGES = ("wgsl", "glsl", "hlsl", "msl")
COUNT = 256

PAGE = """<!doctype html><pre id="out">nothing ran</pre><script>
const jobs = JOBS;
const out = document.getElementById("out");
const run = job => {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) throw "no WebGL 2";
  if (!gl.getExtension("EXT_color_buffer_float")) throw "no float targets";
  const compile = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw gl.getShaderInfoLog(shader);
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, job.vertex));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, job.fragment));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw gl.getProgramInfoLog(program);
  gl.useProgram(program);
  job.textures.forEach(({name, format, size, values}, unit) => {
    const [inner, outer, kind, list] = {
      r32float: [gl.R32F, gl.RED, gl.FLOAT, Float32Array],
      rgba32float: [gl.RGBA32F, gl.RGBA, gl.FLOAT, Float32Array],
      r32uint: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, Uint32Array],
    }[format];
    const target = size.length === 3 ? gl.TEXTURE_3D : gl.TEXTURE_2D;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    const data = new list(values);
    if (size.length === 3) gl.texImage3D(target, 0, inner, ...size, 0, outer, kind, data);
    else gl.texImage2D(target, 0, inner, ...size, 0, outer, kind, data);
    gl.uniform1i(gl.getUniformLocation(program, name), unit);
  });
  gl.activeTexture(gl.TEXTURE0 + job.textures.length);
  const target = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, job.count, 1, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, job.count, 1);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const values = new Float32Array(4 * job.count);
  gl.readPixels(0, 0, job.count, 1, gl.RGBA, gl.FLOAT, values);
  if (gl.getError()) throw "GL error";
  return Array.from(values);
};
try {
  out.textContent = JSON.stringify({values: jobs.map(run)});
} catch (problem) {
  out.textContent = JSON.stringify({problem: String(problem)});
}
</script>"""

VERTEX = """#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }
"""

MAIN = """
uniform highp sampler2D points;
out vec4 values;
void main() {
    vec3 p = texelFetch(points, ivec2(int(gl_FragCoord.x), 0), 0).xyz;
    vec3 q = texelFetch(points, ivec2(int(gl_FragCoord.x), 1), 0).xyz;
    values = RESULT;
}
"""


def job(text, result, buffers, points, others=None):
    """One program for the page: the text and a main that evaluates `result` at points p, with vectors q."""
    others = points if others is None else others
    rows = np.zeros((2, len(points), 4), np.float32)
    rows[0, :, :3], rows[1, :, :3] = points, others
    textures = [
        {"name": name, "format": form, "size": list(size), "values": np.ravel(array).tolist()}
        for name, form, size, array in [*buffers, ("points", "rgba32float", (len(points), 2), rows)]
    ]
    fragment = text + MAIN.replace("RESULT", result)
    return {"vertex": VERTEX, "fragment": fragment, "textures": textures, "count": len(points)}


def run_in_browser(tmp_path, jobs):
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium: install the package chromium to run the GLSL in a browser")
    page = tmp_path / "page.html"
    page.write_text(PAGE.replace("JOBS", json.dumps(jobs)), encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += ["--disable-dev-shm-usage", f"--user-data-dir={tmp_path / 'profile'}"]
    result = subprocess.run(
        [browser, *flags, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=180, check=False
    )
    written = re.search(r'<pre id="out">(.*?)</pre>', result.stdout, re.DOTALL)
    assert written is not None, f"the browser said nothing (exit code {result.returncode}): {result.stderr[-500:]}"
    answer = json.loads(html.unescape(written[1]))
    if answer.get("problem") == "no WebGL 2":
        pytest.skip("this Chromium has no WebGL 2")
    assert "problem" not in answer, answer["problem"]
    return [np.array(values).reshape(-1, 4) for values in answer["values"]]


def listed(buffers):
    return [(one.name, one.format, one.size, one.array) for one in buffers]


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
    texels = [("quadric_texels", "rgba32float", (6, len(quadrics)), packed)]
    center = np.array((1.0, 2.0, 3.0))
    eyes = center + random.normal(size=(COUNT, 3)) + random.choice([-8, 8], (COUNT, 1))
    ways = center + random.normal(size=(COUNT, 3)) * 0.3 - eyes
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    volume.shader("glsl")
    far, level, brick, hit = run_in_browser(
        tmp_path,
        [
            job(
                volume.shader("glsl"),
                "vec4(field_distance(p), field_gradient(p))",
                listed(volume.shader_buffers()),
                inside,
            ),
            job(nested.shader("glsl"), "vec4(nested_distance(p))", listed(nested.shader_buffers()), around),
            job(sparse.shader("glsl"), "vec4(sparse_distance(p))", listed(sparse.shader_buffers()), inside),
            job(
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
