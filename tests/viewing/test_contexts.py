"""WebGL contexts of views in Chromium: many views, lost contexts, closed views, and pages without WebGL 2."""

from __future__ import annotations

import base64
import html
from pathlib import Path

import pytest

import fieldbake as fb
from browser import WEB, visit
from fieldbake.viewing.content import content_of
from fieldbake.viewing.html import page_of
from fieldbake.viewing.output import frame_html

SIZE = (120, 90)

#: Keeps all WebGL contexts of a frame in `contexts`.
COUNT_CONTEXTS = """
  window.contexts = [];
  window.live = () => contexts.filter((gl) => !gl.isContextLost()).length;
  const getContext = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    const found = getContext.call(this, kind, ...rest);
    if (kind === "webgl2" && found && !contexts.includes(found)) contexts.push(found);
    return found;
  };
"""

#: Hides WebGL 2 from a page.
NO_WEBGL = """
  const getContext = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    return kind === "webgl2" ? null : getContext.call(this, kind, ...rest);
  };
"""

#: Functions of the scripts below; `spread` is the largest difference of a colour on the canvas of a frame.
COMMON = """
  const isReady = () => document.documentElement.dataset.fieldbake === "ready";
  const spread = () => {
    const canvas = document.querySelector("canvas");
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const reds = data.filter((_, i) => i % 4 === 0);
    return Math.max(...reds) - Math.min(...reds);
  };
  const bytes = () => document.querySelector("canvas").toDataURL();
  const until = (frame, test) => frame.waitForFunction(test, null, { timeout: 280_000, polling: 100 });
  const drag = async (frame) => {
    const box = await (await frame.$("canvas")).boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + 40, y + 10, { steps: 3 });
    await page.mouse.up();
  };
"""


def ball() -> fb.Volume:
    return fb.bake(fb.sphere(radius=1), 16, device="cpu")


@pytest.mark.slow
def test_twenty_pages_of_one_document_keep_their_pictures(tmp_path: Path) -> None:
    frames = frame_html(ball().to_html(size=SIZE), SIZE)
    path = tmp_path / "twenty.html"
    path.write_text("<!doctype html><body>" + 20 * frames, encoding="utf-8")
    script = (
        COMMON
        + """
      await page.waitForLoadState();
      const frames = page.frames().slice(1);
      await Promise.all(frames.map((frame) => until(frame, isReady)));
      const spreads = await Promise.all(frames.map((frame) => frame.evaluate(spread)));
      const rest = (await Promise.all(frames.map((frame) => frame.evaluate(() => live())))).reduce((a, b) => a + b);
      // A view that has released its context takes one when it is turned, and releases it again.
      const before = await frames[7].evaluate(bytes);
      await drag(frames[7]);
      const isTaken = await frames[7].evaluate(() => live());
      await until(frames[7], () => fieldbake.view.isComplete && live() === 0);
      const after = await frames[7].evaluate(bytes);
      return { spreads, rest, isTaken, hasTurned: before !== after, left: await frames[7].evaluate(spread) };
    """
    )
    job = {"url": path.as_uri(), "script": script, "before": COUNT_CONTEXTS, "width": 1300, "height": 900}
    (result,) = visit([job], timeout=400)
    assert result.errors == []
    assert result.requests == []
    assert len(result.value["spreads"]) == 20
    # The lit ball is brighter than the background by more than 100 steps of 255.
    assert min(*result.value["spreads"], result.value["left"]) > 100
    assert result.value["rest"] == 0
    assert result.value["isTaken"] == 1
    assert result.value["hasTurned"]


@pytest.mark.slow
def test_pages_outside_the_screen_do_not_delay_the_others(tmp_path: Path) -> None:
    # Chromium paints nothing in frames outside the screen, so that they get no animation frames.
    frame = frame_html(ball().to_html(size=SIZE), SIZE)
    path = tmp_path / "long.html"
    path.write_text("<!doctype html><body>" + 7 * f"{frame}<div style='height: 3000px'></div>", encoding="utf-8")
    script = (
        COMMON
        + """
      await page.waitForLoadState();
      await page.evaluate(() => document.querySelectorAll("iframe")[6].scrollIntoView());
      const frames = page.frames().slice(1);
      const wait = { timeout: 60_000, polling: 100 };
      return Promise.all(frames.map((frame) => frame.waitForFunction(isReady, null, wait).then(() => 1, () => 0)));
    """
    )
    (result,) = visit([{"url": path.as_uri(), "script": script}])
    assert result.errors == []
    assert result.value == [1] * 7


@pytest.mark.slow
def test_lost_contexts_are_rebuilt(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    ball().to_html(page, size=SIZE)
    script = (
        COMMON
        + """
      const lose = () => contexts.at(-1).getExtension("WEBGL_lose_context").loseContext();
      // During the first picture, ...
      await until(page, () => window.contexts.length > 0);
      await page.evaluate(lose);
      await until(page, isReady);
      const first = await page.evaluate(spread);
      // ... at rest, where the canvas keeps the picture, ...
      await until(page, () => live() === 0);
      await drag(page);
      await until(page, () => fieldbake.view.isComplete);
      const before = await page.evaluate(bytes);
      await page.evaluate(lose);
      const kept = before === (await page.evaluate(bytes));
      // ... and while the camera turns.
      await drag(page);
      await page.evaluate(lose);
      await until(page, () => fieldbake.view.isComplete);
      return { first, kept, hasTurned: before !== (await page.evaluate(bytes)), last: await page.evaluate(spread) };
    """
    )
    (result,) = visit([{"url": page.as_uri(), "script": script, "before": COUNT_CONTEXTS}])
    assert result.errors == []
    assert result.value["kept"]
    assert result.value["hasTurned"]
    assert min(result.value["first"], result.value["last"]) > 100


@pytest.mark.slow
def test_closed_views_release_contexts_and_memory(tmp_path: Path) -> None:
    data = base64.b64encode(content_of(ball(), None, "snorm8", SIZE).packed()).decode()
    bundle = base64.b64encode((WEB.parent / "python/fieldbake/viewing/viewer.js").read_bytes()).decode()
    page = tmp_path / "widgets.html"
    page.write_text("<!doctype html><body>", encoding="utf-8")
    expression = f"""(async () => {{
      const {{ default: viewer }} = await import("data:text/javascript;base64,{bundle}");
      const data = new DataView(Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0)).buffer);
      const values = {{ data, camera: null, level: 0, slice: null, light: null, parameters: {{}}, _ranges: {{}} }};
      const model = {{ get: (name) => values[name], set() {{}}, save_changes() {{}}, on() {{}}, off() {{}} }};
      const wait = (ms) => new Promise((done) => setTimeout(done, ms));
      const heaps = [];
      let most = 0;
      for (let i = 0; i <= 50; i++) {{
        const closes = await Promise.all([0, 1, 2].map(() => viewer.render({{ model, el: document.body }})));
        const canvas = document.querySelector("canvas");
        const empty = canvas.toDataURL();
        const isDrawn = () => canvas.toDataURL() !== empty;
        // Every tenth time the views draw; the other times they close while they draw.
        for (let k = 0; k < 1000 && (i % 10 ? k < 1 : !isDrawn()); k++) await wait(30);
        if (i % 10 === 0 && !isDrawn()) throw new Error("no picture");
        most = Math.max(most, live());
        for (const close of closes) close();
        contexts = contexts.filter((gl) => !gl.isContextLost());
        if (i % 10) continue;
        await wait(200);
        gc();
        heaps.push(performance.memory.usedJSHeapSize);
      }}
      return {{ most, live: live(), left: document.querySelectorAll("canvas, .fb-view").length, heaps }};
    }})()"""
    (result,) = visit([{"url": page.as_uri(), "expression": expression, "before": COUNT_CONTEXTS}], timeout=400)
    assert result.errors == []
    assert result.value["most"] == 1
    assert result.value["live"] == result.value["left"] == 0
    # The data of a view have 30 kB, so that 120 kept views would have 3.6 MB.
    _, second, *_, last = result.value["heaps"]
    assert last - second <= 1_000_000, result.value["heaps"]


def test_a_page_that_cannot_draw_keeps_its_picture_and_the_reason(tmp_path: Path) -> None:
    hostile = "</b></script><img src=x onerror='window.isHacked = true'>"
    content = content_of(ball(), None, "snorm8", SIZE)
    content.title = hostile
    still, strict = tmp_path / "still.html", tmp_path / "strict.html"
    still.write_text(page_of(content), encoding="utf-8")
    policy = "<meta http-equiv='Content-Security-Policy' content=\"script-src 'none'\">"
    strict.write_text(page_of(content).replace("<head>", f"<head>{policy}"), encoding="utf-8")
    picture = """
      const picture = () => {
        const image = document.querySelector("#fieldbake-view img");
        const title = document.querySelector(".fb-note b")?.textContent;
        const text = document.body.innerText;
        return { width: image.getBoundingClientRect().width, pixels: image.naturalWidth, alt: image.alt, title, text,
          isHacked: window.isHacked ?? false };
      };"""
    wait = 'await page.waitForFunction(() => document.documentElement.dataset.fieldbake === "still");'
    jobs = [
        {"url": still.as_uri(), "script": f"{picture} {wait} return page.evaluate(picture);", "before": NO_WEBGL},
        {"url": strict.as_uri(), "script": f"{picture} await page.waitForLoadState(); return page.evaluate(picture);"},
    ]
    first, second = visit(jobs)
    assert first.errors == []
    assert first.value["title"] == hostile
    assert "This browser has no WebGL 2" in first.value["text"]
    # The policy is reported, and nothing else.
    assert second.errors
    assert all("Content Security Policy" in error for error in second.errors), second.errors
    for value in (first.value, second.value):
        assert value["width"] == value["pixels"] == SIZE[0]
        assert value["alt"] == hostile
        assert not value["isHacked"]
    assert html.escape(hostile) in still.read_text(encoding="utf-8")
