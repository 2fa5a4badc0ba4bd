"""The GLSL that an atlas gives, compiled and run in a browser: WebGL 2 in Chromium, without a window."""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

import fieldbake as fb

#: Weights and positions in float32: a voxel coordinate below 16 is off by 2^-20, and neighbours differ by up to 2.
FLOAT32_SAMPLE = 2 * 3 * 2.0**-20 + 16 * 2.0**-24
#: Weights of a hardware filter have 8 bits: half a step on each axis, between neighbours that differ by up to 2.
FILTERED_SAMPLE = 3 * 2 / 256

PAGE = """<!doctype html><pre id="out">nothing ran</pre><script>
const job = JOB;
const out = document.getElementById("out");
try {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) throw "no WebGL 2";
  if (!gl.getExtension("EXT_color_buffer_float")) throw "no float targets";
  const canFilter = gl.getExtension("OES_texture_float_linear") !== null;
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

  const texture = (unit, target) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, side, gl.CLAMP_TO_EDGE);
    for (const size of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(target, size, unit === 0 && canFilter ? gl.LINEAR : gl.NEAREST);
  };
  texture(0, gl.TEXTURE_2D_ARRAY);
  gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.R32F, job.size, job.size, job.layers, 0, gl.RED, gl.FLOAT,
    new Float32Array(job.texels));
  texture(1, gl.TEXTURE_2D);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, job.count, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(job.points));
  texture(2, gl.TEXTURE_2D);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, job.count, 1, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  const target = gl.getParameter(gl.TEXTURE_BINDING_2D);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.uniform1i(gl.getUniformLocation(program, "atlas_pages"), 0);
  gl.uniform1i(gl.getUniformLocation(program, "points"), 1);
  for (const [name, kind, values] of job.uniforms) {
    const place = gl.getUniformLocation(program, "entry." + name);
    if (place !== null) gl["uniform" + kind](place, values);
  }
  gl.viewport(0, 0, job.count, 1);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const values = new Float32Array(4 * job.count);
  gl.readPixels(0, 0, job.count, 1, gl.RGBA, gl.FLOAT, values);
  out.textContent = JSON.stringify({error: gl.getError(), canFilter, values: Array.from(values)});
} catch (problem) {
  out.textContent = JSON.stringify({problem: String(problem)});
}
</script>"""

VERTEX = """#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }
"""

# All that is ours to add: a uniform entry and a main.
MAIN = """
uniform AtlasEntry entry;
uniform highp sampler2D points;
out vec4 values;
void main() {
    vec3 p = texelFetch(points, ivec2(gl_FragCoord.xy), 0).xyz;
    values = vec4(atlas_sample(entry, p), atlas_sample_filtered(entry, p), atlas_sample_nearest(entry, p),
        atlas_texture_coordinates(entry, p).x);
}
"""

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


def run_in_browser(tmp_path, job):
    """Load the page in Chromium and read what it wrote."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium: install the package chromium to run the GLSL in a browser")
    page = tmp_path / "page.html"
    page.write_text(PAGE.replace("JOB", json.dumps(job)), encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += ["--disable-dev-shm-usage", f"--user-data-dir={tmp_path / 'profile'}"]
    result = subprocess.run(
        [browser, *flags, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120, check=False
    )
    written = re.search(r'<pre id="out">(.*?)</pre>', result.stdout, re.DOTALL)
    assert written is not None, f"the browser said nothing (exit code {result.returncode}): {result.stderr[-500:]}"
    answer = json.loads(html.unescape(written[1]))
    if answer.get("problem") == "no WebGL 2":
        pytest.skip("this Chromium has no WebGL 2")
    return answer


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

    answer = run_in_browser(
        tmp_path,
        {
            "vertex": VERTEX,
            "fragment": atlas.shader("glsl") + MAIN,
            "size": atlas.page_size,
            "layers": len(atlas.pages),
            "texels": atlas.pages.ravel().tolist(),
            "count": len(points),
            "points": np.column_stack([points, np.zeros(len(points))]).ravel().tolist(),
            "uniforms": [
                [name, kind, np.atleast_1d(entry[name]).tolist()]
                for name, kind in UNIFORMS.items()
                if name in entry.dtype.names
            ],
        },
    )

    assert "problem" not in answer, answer["problem"]
    assert answer["error"] == 0
    exact, filtered, nearest, u = np.array(answer["values"]).reshape(-1, 4).T
    assert np.abs(exact - volumes[i].sample(points)).max() < FLOAT32_SAMPLE
    if answer["canFilter"]:
        assert np.abs(filtered - volumes[i].sample(points)).max() < FILTERED_SAMPLE
    # At a boundary between voxels either may be taken.
    grid = (points - lower) / volumes[i].spacing
    clear = (np.abs(grid - np.round(grid)) > 1e-4).all(axis=1)
    assert np.array_equal(nearest[clear], volumes[i].sample(points, filter="nearest")[clear])
    assert np.allclose(u[clear], atlas.texture_coordinates(i, points)[clear, 0], atol=1e-6)
