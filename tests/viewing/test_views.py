"""Several views in one document: they share one device, whose target has the picture of one view at a time."""

from __future__ import annotations

import base64
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fieldbake as fb
from browser import WEB, WEBGPU_FLAGS, node_tool, visit
from fieldbake.viewing.content import content_of

#: Sizes of the two views.
SIZES = ((80, 64), (116, 92))

#: The pixel of the first view that is picked.
PIXEL = (40, 37)

#: Opens two views at once, turns them at once, and interrupts their pictures.
PROGRAM = """
import { inflated, mount } from "WEB/src/main";
import { requestDevice } from "WEB/src/view";
import { isForced } from "WEB/src/webgpu";

const text = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
const shown = ({ canvas }) => {
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  return text(copy.getImageData(0, 0, width, height).data);
};
const until = async (test) => {
  for (let i = 0; i < 4000 && !test(); i++) await new Promise((done) => setTimeout(done, 5));
  return test();
};

window.run = async (contents, cameras, [x, y]) => {
  if (isForced) await requestDevice();
  const bytes = contents.map((content) => Uint8Array.from(atob(content), (one) => one.charCodeAt(0)));
  const buffers = await Promise.all(bytes.map(inflated));
  const [first, second] = buffers.map((buffer) => {
    const root = document.createElement("div");
    document.body.append(root);
    return mount(root, buffer).view;
  });
  const settled = async () => {
    await first.settled;
    await second.settled;
  };
  await settled();
  const start = [shown(first), shown(second)];

  // Both turn at once, and the first one has a pick that was requested before.
  const pick = first.pick(x, y);
  first.camera.set(cameras[0]);
  second.camera.set(cameras[1]);
  first.redraw("moving");
  second.redraw("moving");
  const picked = await pick;
  await settled();
  const turned = [shown(first), shown(second)];

  // The second view moves while the first one draws its picture at rest.
  const { engine } = first.acquire();
  const draw = engine.draw.bind(engine);
  engine.draw = (...place) => {
    draw(...place);
    engine.draw = draw;
    second.redraw("moving");
  };
  let isFirst = null;
  second.onChange = () => (isFirst ??= !first.isComplete);
  first.redraw();
  await settled();
  const after = [shown(first), shown(second)];

  // New levels have the triangles of the coarse grid. The level at which the slider rests has the triangles of the
  // fine one.
  const sizes = [];
  const shape = engine.shape.bind(engine);
  engine.shape = (triangles) => {
    sizes.push(triangles.indices.length);
    return shape(triangles);
  };
  const moved = async () => {
    second.times.moving = 0;
    second.redraw("moving");
    await until(() => second.times.moving > 0 && !second.isBusy);
  };
  const finished = engine.finished.bind(engine);
  // Frames with a new level take longer than the 80 ms of a frame in motion, and do not decide about the next frame.
  engine.finished = async () => {
    await finished();
    await new Promise((done) => setTimeout(done, 100));
  };
  let isSteady = true;
  second.isCoarse = false;
  for (const level of [0.02, 0.04, 0.06]) {
    second.settings.level = level;
    await moved();
    isSteady &&= second.times.moving > 80 && !second.isCoarse;
  }
  delete engine.finished;
  await moved();
  await second.settled;

  // A parameter slider replaces the data. Its frames in motion have the triangles of the coarse grid.
  second.isCoarse = false;
  second.replace(buffers[1]);
  await until(() => sizes.length > 4 && !second.isBusy);
  await second.settled;

  // Input does not wait for the program of a picture at rest.
  engine.compiled = () => new Promise(() => {});
  first.times.moving = 0;
  first.redraw();
  first.redraw("moving");
  const isMoved = await until(() => first.times.moving > 0);
  delete engine.compiled;
  await first.settled;

  // A value of the slice interrupts the smooth picture, which is drawn again.
  first.settings.slice = { axis: 2, at: 0, cut: false };
  const redraw = first.redraw.bind(first);
  let value = null;
  first.redraw = (kind) => {
    redraw(kind);
    if (kind === "smooth") value ??= first.sliceValue(x, y);
  };
  // A picture is smoothed if it took less than a second, which the compilation of its program may exceed.
  for (let i = 0; i < 10 && !value; i++) {
    first.redraw();
    await first.settled;
    await new Promise((done) => setTimeout(done, 600));
  }
  const isSmooth = await until(() => first.times.smooth > 0);
  const api = "device" in engine ? "WebGPU" : "WebGL 2";
  return { api, start, turned, after, picked, isFirst, sizes, isSteady, isMoved, isSmooth, value: await value };
};
"""


def visit_views(tmp_path: Path, contents: list[bytes], cameras: list[fb.Camera], end: str = "") -> dict[str, Any]:
    """Run the program above on a page with two views; `end` is the end of its address."""
    program = tmp_path / "program.js"
    program.write_text(PROGRAM.replace("WEB", WEB.as_posix()), encoding="utf-8")
    command = [node_tool(".bin/esbuild"), str(program), "--bundle", "--format=esm", "--target=es2022"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html><meta charset=utf-8><script type=module>{built.stdout}</script>", encoding="utf-8")
    texts = [base64.b64encode(content).decode() for content in contents]
    states = [{"pose": one.pose.ravel().tolist(), "fov": one.fov_deg, "distance": 5} for one in cameras]
    script = f"await page.waitForLoadState(); return page.evaluate({f'run({texts}, {states}, {list(PIXEL)})'!r});"
    (result,) = visit([{"url": page.as_uri() + end, "script": script}], flags=WEBGPU_FLAGS if end else ())
    assert result.value is not None, result.errors
    assert result.errors == []
    return dict(result.value)


def check_views(tmp_path: Path, end: str, api: str) -> None:
    knot = fb.bake(fb.models.torus_knot(), 32, device="cpu")
    # A coarse grid keeps every second sample of this one.
    ball = fb.bake(fb.sphere(radius=1), 72, device="cpu")
    volumes = [volume.quantize("snorm8") for volume in (knot, ball)]
    before = [fb.Camera((3.5, 3.0, 7.5), (0.4, 0, 0), fov_deg=40), fb.Camera((1, 2, 4), (0, 0, 0), fov_deg=40)]
    after = [fb.Camera((-6.5, 1.0, 4.5), (0.4, 0, 0), fov_deg=40), fb.Camera((-2, -1, 3), (0.3, 0, 0), fov_deg=40)]
    contents = [
        content_of(volume, camera, "snorm8", size).packed()
        for volume, camera, size in zip((knot, ball), before, SIZES, strict=True)
    ]
    found = visit_views(tmp_path, contents, after, end)
    assert found["api"] == api
    for name, cameras in (("start", before), ("turned", after), ("after", after)):
        for text, volume, camera, size in zip(found[name], volumes, cameras, SIZES, strict=True):
            frame = fb.raymarch(volume, camera, size=size, device="cpu")
            difference = np.abs(decoded(text, size).astype(int) - frame.image).max(axis=-1)
            # The bounds of the contract for the page beside `raymarch`.
            assert (difference <= 2).mean() >= 0.995, (name, size, (difference <= 2).mean())
            assert np.ptp(frame.image[..., 0]) > 50
    # The point that was picked is the one of the camera at that time.
    column, row = PIXEL
    camera, size = before[0], SIZES[0]
    depth = fb.raymarch(volumes[0], camera, size=size, device="cpu").depth[row, column]
    pixel = 2 * np.tan(np.radians(camera.fov_deg) / 2) / size[1]
    right, up, back, eye = camera.pose[:3].T
    way = (column + 0.5 - size[0] / 2) * pixel * right + (size[1] / 2 - row - 0.5) * pixel * up - back
    voxel = float(knot.spacing.max())
    # The bound of the contract for depths.
    assert found["picked"]["depth"] == pytest.approx(depth, abs=0.01 * voxel)
    assert found["picked"]["point"] == pytest.approx(eye + depth * way, abs=0.01 * voxel)
    assert found["isFirst"] is True
    # The number of triangles goes with the square of the resolution: by 4 from one grid to the other.
    *coarse, fine, replaced = found["sizes"]
    assert len(coarse) == 3
    assert fine >= 3 * max(*coarse, replaced)
    assert found["isSteady"]
    assert found["isMoved"]
    assert found["isSmooth"]
    assert found["value"] is not None


def decoded(text: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(size[1], size[0], 4)


def test_views_of_one_document_draw_their_own_pictures(tmp_path: Path) -> None:
    check_views(tmp_path, "", "WebGL 2")


@pytest.mark.slow
def test_views_of_one_document_draw_their_own_pictures_by_webgpu(tmp_path: Path) -> None:
    check_views(tmp_path, "#webgpu", "WebGPU")
