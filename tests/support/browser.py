"""Pages in Chromium without a network, driven by playwright-core (web/browse.mjs)."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

WEB = Path(__file__).parents[2] / "web"

#: Resolves to the colours and depths of a page's view, after its first picture.
PIXELS = """(async () => {
  while (!window.fieldbake) await new Promise((done) => setTimeout(done, 20));
  await fieldbake.ready;
  const { width, height, color, depth } = fieldbake.pixels();
  const text = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  return { width, height, color: text(color), depth: text(new Uint8Array(depth.buffer)) };
})()"""


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


def visit(jobs: list[dict[str, Any]], timeout: float = 240) -> list[Visit]:
    """Open the pages of all jobs in one browser; see web/browse.mjs for what a job has."""
    node_tool("playwright-core")
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        missing("there is no Chromium: install the package chromium")
    order = json.dumps({"executable": browser, "jobs": jobs})
    command = ["node", str(WEB / "browse.mjs")]
    done = subprocess.run(command, input=order, capture_output=True, text=True, timeout=timeout, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return [Visit(**result) for result in json.loads(done.stdout)]
