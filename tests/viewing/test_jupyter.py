"""Widgets in JupyterLab, driven by Chromium with a live kernel, and notebooks that nbconvert has turned into pages."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from browser import visit

pytestmark = pytest.mark.slow

nbformat = pytest.importorskip("nbformat")

#: Shows a ball with a slider for its radius, and writes the traits of the widget to a file after each change.
CELL = """
import json
import fieldbake as fb
model = lambda radius: fb.sphere(radius=radius)
view = model(1).show(parameters={"radius": (0.5, 1.5)}, model=model, size=(300, 220))
changes = {}
def write(change):
    value = change["new"]
    if change["name"] == "camera":
        value = value.eye.tolist()
    changes[change["name"]] = value
    with open("changes.json", "w") as file:
        json.dump(changes, file)
view.observe(write, ["camera", "level", "slice", "picked", "parameters"])
view
"""

#: Waits until the widget has drawn, drags it, moves a slider and the slice, and picks the middle.
SCRIPT = """
  const wait = (selector) => page.waitForSelector(selector, { timeout: 120_000 });
  await wait(".jp-Notebook .cm-content");
  const isIdle = () => document.querySelector(".jp-Notebook-ExecutionIndicator")?.dataset.status === "idle";
  await page.waitForFunction(isIdle, null, { timeout: 120_000 });
  // Dialogs of other packages may take the first keys. A cell has the prompt "[*]" while it runs, and then its number.
  const isRun = () => !document.querySelector(".jp-InputPrompt").textContent.includes("[ ]");
  for (let i = 0; i < 30 && !(await page.evaluate(isRun)); i++) {
    if (await page.$(".jp-Dialog .jp-mod-reject")) await page.click(".jp-Dialog .jp-mod-reject");
    await page.click(".jp-Notebook .cm-content");
    await page.keyboard.press("Control+Enter");
    await page.waitForTimeout(2000);
  }
  const canvas = await wait(".fb-view canvas");
  const image = () => canvas.evaluate((it) => it.toDataURL());
  const changed = async (before) => {
    for (let i = 0; i < 600 && (await image()) === before; i++) await page.waitForTimeout(100);
    return (await image()) !== before;
  };
  const steps = [];
  const empty = await canvas.evaluate((it) => {
    const blank = Object.assign(document.createElement("canvas"), { width: it.width, height: it.height });
    return blank.toDataURL();
  });
  steps.push(["show", await changed(empty)]);
  await page.waitForTimeout(3000);
  await canvas.scrollIntoViewIfNeeded();
  const box = await canvas.boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.mouse.dblclick(x, y);
  const hasPick = () => document.querySelector(".fb-note").textContent.includes("point");
  await page.waitForFunction(hasPick, null, { timeout: 60_000 });
  let before = await image();
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 60, y + 5, { steps: 4 });
  await page.mouse.up();
  await page.selectOption(".fb-bar select", "x");
  steps.push(["drag and slice", await changed(before)]);
  const slide = (title, share) => page.$eval(`.fb-bar input[title^="${title}"]`, (input, share) => {
    input.value = String(Number(input.min) + share * (Number(input.max) - Number(input.min)));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, share);
  await slide("Level", 0.75);
  before = await image();
  const slider = await page.$('.fb-bar input[title="radius"]');
  await slide("radius", 0.9);
  steps.push(["parameter", await changed(before)]);
  // The slider that is being moved stays in the document while the model changes.
  steps.push(["same slider", await slider.evaluate((it) => it.isConnected)]);
  await page.waitForTimeout(2000);
  return steps;
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def jupyter_lab(folder: Path) -> Iterator[str]:
    """A server of JupyterLab in a folder; its address."""
    pytest.importorskip("jupyterlab", reason="JupyterLab is missing: pip install --group long")
    port = free_port()
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", f"--port={port}"]
    command.append("--IdentityProvider.token=")
    places = ("JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR", "JUPYTERLAB_SETTINGS_DIR")
    settings = {name: str(folder / name.lower()) for name in places}
    config = folder / "jupyter_config_dir" / "labconfig"
    config.mkdir(parents=True)
    (config / "page_config.json").write_text('{"buildCheck": false, "buildAvailable": false}')
    environment = {**os.environ, **settings}
    with (folder / "server.log").open("w") as log:
        server = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True)
    try:
        address = f"http://127.0.0.1:{port}"
        for _ in range(600):
            with contextlib.suppress(OSError):
                urllib.request.urlopen(f"{address}/api", timeout=5).close()
                break
            assert server.poll() is None, (folder / "server.log").read_text()[-2000:]
            time.sleep(0.2)
        yield address
    finally:
        # The session has the server and its kernels.
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def notebook(path: Path, cell: str) -> None:
    made = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell.strip())])
    made.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(made, path)


def test_input_in_jupyterlab_reaches_python(tmp_path: Path) -> None:
    notebook(tmp_path / "look.ipynb", CELL)
    with jupyter_lab(tmp_path) as address:
        job = {"url": f"{address}/lab/tree/look.ipynb", "script": SCRIPT, "online": True, "width": 1100, "height": 800}
        (result,) = visit([job], timeout=500)
    assert result.value is not None, result.errors
    assert dict(result.value) == {"show": True, "drag and slice": True, "parameter": True, "same slider": True}
    assert not [error for error in result.errors if re.search(r"fieldbake|anywidget|WebGL|shader", error, re.I)]
    changes = json.loads((tmp_path / "changes.json").read_text())
    # The middle of the first picture is on the ball of radius 1.
    assert sum(x * x for x in changes["picked"][0]) == pytest.approx(1, abs=1e-3)
    assert len(changes["camera"]) == 3
    assert changes["slice"][0] == "x"
    assert changes["level"] != 0
    assert changes["parameters"]["radius"] == pytest.approx(1.4)


def test_a_page_of_nbconvert_shows_the_view_offline(tmp_path: Path) -> None:
    path = tmp_path / "look.ipynb"
    notebook(path, "import fieldbake as fb\nfb.sphere(radius=1).show(size=(300, 220))")
    pytest.importorskip("nbconvert")
    convert = [sys.executable, "-m", "nbconvert", "--to"]
    subprocess.run([*convert, "notebook", "--execute", str(path)], check=True, capture_output=True, timeout=240)
    executed = path.with_suffix(".nbconvert.ipynb")
    subprocess.run(
        [*convert, "html", "--output", path.with_suffix(".html").name, str(executed)], check=True, timeout=240
    )
    script = """
      const canvas = await page.waitForSelector(".fb-view canvas", { timeout: 120_000 });
      const isDrawn = () => {
        const [it] = document.querySelectorAll(".fb-view canvas");
        const blank = Object.assign(document.createElement("canvas"), { width: it.width, height: it.height });
        return it.toDataURL() !== blank.toDataURL();
      };
      await page.waitForFunction(isDrawn, null, { timeout: 120_000 });
      const box = await canvas.boundingBox();
      return [box.width, box.height, (await page.$$(".fb-view")).length];
    """
    (result,) = visit([{"url": path.with_suffix(".html").as_uri(), "script": script}])
    assert result.value == [300, 220, 1], result.errors
    # Without the saved state of the widget the page has its picture.
    made = nbformat.read(path.with_suffix(".nbconvert.ipynb"), as_version=4)
    del made.metadata["widgets"]
    nbformat.write(made, path)
    subprocess.run([*convert, "html", str(path)], check=True, capture_output=True, timeout=240)
    expression = """(async () => {
      const shown = () => [...document.images].find((image) => image.id.startsWith("fb-") && image.width > 0);
      while (!shown()) await new Promise((done) => setTimeout(done, 50));
      return shown().naturalWidth;
    })()"""
    (result,) = visit([{"url": path.with_suffix(".html").as_uri(), "expression": expression}])
    assert result.value == 300, result.errors
