"""Views drawn by WebGPU in Chromium: the same pictures as by WebGL 2, and WebGL 2 where the device is lost."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from browser import WEBGPU_FLAGS, after_first_picture, visit

pytestmark = pytest.mark.slow

SIZE = (128, 96)

#: Resolves to the name of the device, to the canvas, and to pictures: at rest, in motion, depths, a slice, meshes.
PICTURES = after_first_picture("""
  const api = () => ("device" in view.acquire().engine ? "WebGPU" : "WebGL 2");
  const found = { api: api(), canvas: text(view.canvas.getContext("2d").getImageData(0, 0, width, height).data) };
  const slice = { axis: 2, at: 0.1, cut: true };
  const [motion, depth, sliced, mesh] = [{ isMotion: true }, { picture: 2 }, { slice }, { mesh: true }];
  const cases = { rest: {}, motion, depth, sliced, mesh };
  for (const [name, { picture = 0, isMotion = false, ...settings }] of Object.entries(cases)) {
    found[name] = await drawn(picture, isMotion, settings);
  }
  const pick = await view.pick(width / 2 - 12, height / 2);
  found.pick = pick && pick.point;
  return found;
""")

#: Loses the device and resolves to the name of the one that draws the next picture.
LOSE = after_first_picture("""
  const api = () => ("device" in view.acquire().engine ? "WebGPU" : "WebGL 2");
  const before = api();
  view.acquire().engine.device.destroy();
  await new Promise((done) => setTimeout(done, 500));
  view.camera.orbit(0.3, 0);
  view.redraw();
  await view.settled;
  const reds = view.canvas.getContext("2d").getImageData(0, 0, width, height).data.filter((_, i) => i % 4 === 0);
  return { before, after: api(), spread: Math.max(...reds) - Math.min(...reds), hasFailed: view.hasFailed };
""")

#: Loses the device in a call of WebGPU while the view draws. Resolves to the state of the view after the next picture.
LOSE_IN = after_first_picture("""
  const api = () => ("device" in view.acquire().engine ? "WebGPU" : "WebGL 2");
  const before = api();
  const { device } = view.acquire().engine;
  let isLost = false;
  const own = CLASS.prototype.METHOD;
  CLASS.prototype.METHOD = function (...values) {
    CLASS.prototype.METHOD = own;
    const done = own.apply(this, values);
    device.destroy();
    isLost = true;
    return done;
  };
  view.camera.orbit(0.3, 0);
  view.redraw();
  while (!isLost) await new Promise((done) => setTimeout(done, 5));
  await new Promise((done) => setTimeout(done, 200));
  const hasFailed = view.hasFailed;
  await view.settled;
  view.camera.orbit(0.3, 0);
  view.redraw();
  await view.settled;
  const reds = view.canvas.getContext("2d").getImageData(0, 0, width, height).data.filter((_, i) => i % 4 === 0);
  const spread = Math.max(...reds) - Math.min(...reds);
  return { before, after: api(), spread, hasFailed, note: document.querySelector(".fb-note").textContent };
""")

#: Counts the compilations of each program in `compiled`, and makes those beside the page take 300 ms longer.
COUNT_PROGRAMS = """
  window.compiled = {};
  const create = GPUDevice.prototype.createShaderModule;
  GPUDevice.prototype.createShaderModule = function (description) {
    // Every program of rays has the same vertex shader.
    const { code } = description;
    if (code.includes("@fragment")) compiled[code] = (compiled[code] ?? 0) + 1;
    return create.call(this, description);
  };
  const compile = GPUDevice.prototype.createRenderPipelineAsync;
  GPUDevice.prototype.createRenderPipelineAsync = async function (...values) {
    await new Promise((done) => setTimeout(done, 300));
    return compile.apply(this, values);
  };
"""

#: Interrupts a picture at rest and a pick that wait for their program, and draws eight pictures. Resolves to the
#: compilations of each program, and to the callbacks that the pictures leave on the promise of the loss of the device.
INTERRUPT = after_first_picture("""
  view.settings.slice = { axis: 2, at: 0, cut: true };
  view.redraw();
  await new Promise((done) => setTimeout(done, 50));
  view.redraw();
  const pick = view.pick(width / 2, height / 2);
  await view.settled;
  await pick;
  const api = "device" in view.acquire().engine ? "WebGPU" : "WebGL 2";
  const { lost } = view.acquire().engine.device;
  let callbacks = 0;
  lost.then = (...values) => {
    callbacks++;
    return Promise.prototype.then.apply(lost, values);
  };
  for (let i = 0; i < 8; i++) {
    view.camera.orbit(0.1, 0);
    view.redraw();
    await view.settled;
  }
  return { api, counts: Object.values(compiled), callbacks };
""")

#: Resolves to the text of a page that shows its picture only.
STILL = """(async () => {
  const state = () => document.documentElement.dataset.fieldbake;
  for (let i = 0; i < 1000 && !state(); i++) await new Promise((done) => setTimeout(done, 20));
  return { state: state(), text: document.body.innerText };
})()"""

#: Limits the textures of the device to one row.
ONE_ROW = """
  const limits = Object.getOwnPropertyDescriptor(GPUSupportedLimits.prototype, "maxTextureDimension2D");
  Object.defineProperty(GPUSupportedLimits.prototype, "maxTextureDimension2D", { ...limits, get: () => 1 });
"""


def pixels(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(SIZE[1], SIZE[0], 4)


def test_webgpu_draws_the_pictures_of_webgl(tmp_path: Path) -> None:
    knot = fb.models.torus_knot(segments=64, sides=8)
    volume = fb.bake(knot, 32, device="cpu")
    place = np.eye(4)
    place[:3, 3] = 2.4, 0.2, 0.3
    camera = fb.Camera((3.5, 3.0, 7.5), (0.4, 0, 0), fov_deg=40)
    mixed = fb.Scene(
        [volume.to_sparse(), fb.Instance(fb.torus(1, 0.3), place), fb.Quadric.sphere((0, 2, 0), radius=0.6)]
    )
    meshes = fb.Scene([fb.Instance(knot, resolution=32), fb.Instance(volume, place)])
    jobs = []
    for number, scene in enumerate((mixed, meshes)):
        page = tmp_path / f"{number}.html"
        scene.to_html(page, camera=camera, size=SIZE)
        jobs += [{"url": page.as_uri() + end, "expression": PICTURES} for end in ("", "#webgpu")]
    results = visit(jobs, timeout=500, flags=WEBGPU_FLAGS)
    for gl, gpu in zip(results[::2], results[1::2], strict=True):
        assert gl.value is not None, gl.errors
        assert gpu.value is not None, gpu.errors
        assert gl.errors == gpu.errors == []
        assert (gl.value.pop("api"), gpu.value.pop("api")) == ("WebGL 2", "WebGPU")
        assert gl.value.pop("pick") == pytest.approx(gpu.value.pop("pick"), abs=1e-5)
        depths = [pixels(result.value.pop("depth")).copy().view(np.float32) for result in (gl, gpu)]
        assert np.isclose(*depths, rtol=1e-5, atol=0).mean() >= 0.999
        assert (depths[0] < 1e38).mean() > 0.05
        for name, text in gl.value.items():
            difference = np.abs(pixels(text).astype(int) - pixels(gpu.value[name])).max(axis=-1)
            assert (difference <= 1).mean() >= 0.999, (name, (difference <= 1).mean())
            assert np.ptp(pixels(text)[..., 0]) > 50, name


def test_each_program_is_compiled_once_and_pictures_leave_no_callback(tmp_path: Path) -> None:
    page = tmp_path / "ball.html"
    fb.bake(fb.sphere(radius=1), 16, device="cpu").to_html(page, size=SIZE)
    job = {"url": page.as_uri() + "#webgpu", "expression": INTERRUPT, "before": COUNT_PROGRAMS}
    (result,) = visit([job], flags=WEBGPU_FLAGS)
    assert result.value is not None, result.errors
    assert result.value["api"] == "WebGPU"
    # Triangles in motion, rays without and with a slice.
    assert result.value["counts"] == [1, 1, 1]
    assert result.value["callbacks"] == 0


def test_a_lost_device_is_replaced_by_webgl(tmp_path: Path) -> None:
    page = tmp_path / "ball.html"
    fb.bake(fb.sphere(radius=1), 16, device="cpu").to_html(page, size=SIZE)
    (lost,) = visit([{"url": page.as_uri() + "#webgpu", "expression": LOSE}], flags=WEBGPU_FLAGS)
    assert lost.value is not None, lost.errors
    assert (lost.value["before"], lost.value["after"]) == ("WebGPU", "WebGL 2")
    assert lost.value["spread"] > 100
    assert not lost.value["hasFailed"]
    # Without an adapter the browser writes a warning of its own, and WebGL 2 draws.
    (without,) = visit([{"url": page.as_uri() + "#webgpu", "expression": PICTURES}])
    assert without.value is not None, without.errors
    assert without.value["api"] == "WebGL 2"


def test_a_device_that_is_lost_during_a_drawing_is_no_problem_of_the_view(tmp_path: Path) -> None:
    page = tmp_path / "ball.html"
    fb.bake(fb.sphere(radius=1), 16, device="cpu").to_html(page, size=SIZE)
    calls = (("GPUQueue", "onSubmittedWorkDone"), ("GPUBuffer", "mapAsync"))
    texts = [LOSE_IN.replace("CLASS", name).replace("METHOD", method) for name, method in calls]
    for lost in visit(
        [{"url": page.as_uri() + "#webgpu", "expression": text} for text in texts], timeout=120, flags=WEBGPU_FLAGS
    ):
        assert lost.value is not None, lost.errors
        assert (lost.value["before"], lost.value["after"]) == ("WebGPU", "WebGL 2")
        assert lost.value["spread"] > 100
        assert not lost.value["hasFailed"]
        assert "Error" not in lost.value["note"]


def test_a_view_that_exceeds_the_limits_of_its_device_states_the_reason(tmp_path: Path) -> None:
    page = tmp_path / "ball.html"
    fb.bake(fb.sphere(radius=1), 32, device="cpu").to_html(page, size=SIZE)
    (still,) = visit([{"url": page.as_uri() + "#webgpu", "expression": STILL, "before": ONE_ROW}], flags=WEBGPU_FLAGS)
    assert still.value is not None, still.errors
    assert still.value["state"] == "still"
    assert "The samples exceed the textures of this graphics device" in still.value["text"]
