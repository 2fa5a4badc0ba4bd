"""Pages in Chromium without a network, driven by playwright-core (web/browse.mjs), and GLSL that is run there."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

WEB = Path(__file__).parents[2] / "web"

#: Flags of Chromium for WebGPU without a graphics processor.
WEBGPU_FLAGS = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader")


def after_first_picture(script: str) -> str:
    """An expression that runs the script after the first picture of a page; `text` encodes bytes, `drawn` a picture."""
    return (
        """(async () => {
  while (!window.fieldbake) await new Promise((done) => setTimeout(done, 20));
  await fieldbake.ready;
  const { view } = fieldbake;
  const { width, height } = view.canvas;
  const text = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  const drawn = async (picture, isMotion, settings) => {
    const resources = view.acquire();
    resources.prepare(view.camera, { ...view.settings, ...settings }, width, height, picture, isMotion);
    resources.draw(0, height);
    return text(await resources.read(width, height));
  };
"""
        + script
        + "})()"
    )


#: Resolves to the colours and depths of a page's view, after its first picture.
PIXELS = after_first_picture("""
  const { color, depth } = await fieldbake.pixels();
  return { width, height, color: text(color), depth: text(new Uint8Array(depth.buffer)) };
""")


class Visit(NamedTuple):
    """Results of a page: the value of the expression, errors and warnings of the console, requests to a network."""

    value: Any
    errors: list[str]
    requests: list[str]

    @property
    def picture(self) -> tuple[np.ndarray, np.ndarray]:
        """Colours (h, w, 4) uint8 and depths (h, w) float32 of `PIXELS`."""
        assert self.value is not None, self.errors
        height, width = self.value["height"], self.value["width"]
        color = np.frombuffer(base64.b64decode(self.value["color"]), np.uint8)
        depth = np.frombuffer(base64.b64decode(self.value["depth"]), np.float32)
        return color.reshape(height, width, 4), depth.reshape(height, width)


def missing(what: str) -> None:
    """Skip the test; in CI, where the set-up installs everything, fail."""
    if os.environ.get("CI") == "true":
        pytest.fail(f"{what}; CI must have it")
    pytest.skip(what)


def node_tool(name: str) -> str:
    """A program of web/node_modules, or a skip with the reason."""
    if shutil.which("node") is None:
        missing("there is no Node.js: install the packages nodejs and npm, then run npm ci in web/")
    tool = WEB / "node_modules" / name
    if not tool.exists():
        missing("the packages of web/package.json are missing: run npm ci in web/")
    return str(tool)


def visit(jobs: list[dict[str, Any]], timeout: float = 240, flags: Sequence[str] = ()) -> list[Visit]:
    """Open the pages of all jobs in one browser with more flags; web/browse.mjs describes a job."""
    node_tool("playwright-core")
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        missing("there is no Chromium: install the package chromium")
    order = json.dumps({"executable": browser, "flags": list(flags), "jobs": jobs})
    command = ["node", str(WEB / "browse.mjs")]
    done = subprocess.run(command, input=order, capture_output=True, text=True, timeout=timeout, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return [Visit(**result) for result in json.loads(done.stdout)]


#: Runs fragment shaders in WebGL 2; each makes one row of RGBA float32. `results` is a list of these rows.
GLSL_PAGE = """<!doctype html><script>
const run = (job) => {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl?.getExtension("EXT_color_buffer_float")) throw new Error("no WebGL 2 with float targets");
  const filter = gl.getExtension("OES_texture_float_linear") ? gl.LINEAR : null;
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, job.vertex], [gl.FRAGMENT_SHADER, job.fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  const texture = (unit, target, isLinear) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    if (isLinear && filter === null) throw new Error("no linear filter of float textures");
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R])
      gl.texParameteri(target, side, gl.CLAMP_TO_EDGE);
    for (const size of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(target, size, isLinear ? filter : gl.NEAREST);
  };
  job.textures.forEach(({ name, format, size, values, kind }, unit) => {
    const [inner, outer, type, list] = {
      r32float: [gl.R32F, gl.RED, gl.FLOAT, Float32Array],
      rgba32float: [gl.RGBA32F, gl.RGBA, gl.FLOAT, Float32Array],
      r16sint: [gl.R16I, gl.RED_INTEGER, gl.SHORT, Int16Array],
      r32uint: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, Uint32Array],
    }[format];
    const pages = gl.TEXTURE_2D_ARRAY;
    const target = { "2d": gl.TEXTURE_2D, "3d": gl.TEXTURE_3D, "pages": pages, "filtered pages": pages }[kind];
    texture(unit, target, kind === "filtered pages");
    const data = new list(values);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (kind === "2d") gl.texImage2D(target, 0, inner, ...size, 0, outer, type, data);
    else gl.texImage3D(target, 0, inner, ...size, 0, outer, type, data);
    gl.uniform1i(gl.getUniformLocation(program, name), unit);
  });
  texture(job.textures.length, gl.TEXTURE_2D, false);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, job.count, 1, 0, gl.RGBA, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  const target = gl.getParameter(gl.TEXTURE_BINDING_2D);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  for (const [name, kind, values] of job.uniforms) gl["uniform" + kind](gl.getUniformLocation(program, name), values);
  gl.viewport(0, 0, job.count, 1);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const values = new Float32Array(4 * job.count);
  gl.readPixels(0, 0, job.count, 1, gl.RGBA, gl.FLOAT, values);
  if (gl.getError()) throw new Error("GL error");
  return Array.from(values);
};
const results = () => JOBS.map(run);
</script>"""

GLSL_VERTEX = """#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }
"""

GLSL_MAIN = """
uniform highp sampler2D points;
out vec4 values;
void main() {
    vec3 p = texelFetch(points, ivec2(int(gl_FragCoord.x), 0), 0).xyz;
    vec3 q = texelFetch(points, ivec2(int(gl_FragCoord.x), 1), 0).xyz;
    values = RESULT;
}
"""


class Texture(NamedTuple):
    """A float or integer texture; `kind` is "2d", "3d", "pages", which is an array, or "filtered pages"."""

    name: str
    format: str
    size: tuple[int, ...]
    values: np.ndarray
    kind: str = "3d"


def glsl_job(
    text: str,
    result: str,
    textures: Iterable[Texture],
    points: np.ndarray,
    others: np.ndarray | None = None,
    uniforms: Iterable[tuple[str, str, list[float]]] = (),
) -> dict[str, Any]:
    """A program for :func:`run_glsl`: `result` is a vec4 of functions of the text at a point p and a vector q."""
    rows = np.zeros((2, len(points), 4), np.float32)
    rows[0, :, :3], rows[1, :, :3] = points, points if others is None else others
    every = [*textures, Texture("points", "rgba32float", (len(points), 2), rows, "2d")]
    return {
        "vertex": GLSL_VERTEX,
        "fragment": text + GLSL_MAIN.replace("RESULT", result),
        "textures": [{**one._asdict(), "values": np.ravel(one.values).tolist()} for one in every],
        "uniforms": list(uniforms),
        "count": len(points),
    }


def run_glsl(folder: Path, jobs: list[dict[str, Any]]) -> list[np.ndarray]:
    """Values of each job at its points, (n, 4) float32, computed by WebGL 2 in Chromium."""
    page = folder / "glsl.html"
    page.write_text(GLSL_PAGE.replace("JOBS", json.dumps(jobs)), encoding="utf-8")
    (done,) = visit([{"url": page.as_uri(), "expression": "results()"}])
    assert done.value is not None, done.errors
    return [np.array(values, np.float32).reshape(-1, 4) for values in done.value]
