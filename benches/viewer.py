"""Live views in Chromium without a graphics device: size of a page, time to its first picture, time of a moving frame.

python benches/viewer.py bunny.obj --resolution 128 --size 512
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import fieldbake as fb

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from browser import visit

#: Milliseconds from the load of the page, and the processor time of all processes of the browser.
SCRIPT = """
  const fs = process.getBuiltinModule("fs");
  const spent = () => {
    const rows = fs.readdirSync("/proc").filter((name) => /^[0-9]+$/.test(name)).flatMap((name) => {
      try {
        const text = fs.readFileSync(`/proc/${name}/stat`, "utf8");
        const words = text.slice(text.lastIndexOf(")") + 2).split(" ");
        return [{ id: Number(name), parent: Number(words[1]), ticks: Number(words[11]) + Number(words[12]) }];
      } catch {
        return [];
      }
    });
    const own = new Set([process.pid]);
    for (let before = 0; before < own.size; ) {
      before = own.size;
      for (const { id, parent } of rows) if (own.has(parent)) own.add(id);
    }
    return 10 * rows.filter(({ id }) => own.has(id) && id !== process.pid).reduce((sum, { ticks }) => sum + ticks, 0);
  };
  await page.waitForLoadState();
  const shown = await page.evaluate(async () => {
    const entries = () => performance.getEntriesByName("first-contentful-paint");
    while (!entries().length) await new Promise((done) => setTimeout(done, 5));
    return entries()[0].startTime;
  });
  const still = spent();
  await page.waitForFunction(() => window.fieldbake?.view.times.first, null, { timeout: 300_000, polling: 10 });
  const live = spent();
  const ready = await page.evaluate(() => fieldbake.ready.then(() => performance.now()));
  const exact = spent();
  const times = await page.evaluate((ready) => {
    const load = performance.getEntriesByType("navigation")[0].loadEventEnd;
    const { first } = fieldbake.view.times;
    return { first: first - load, load, still: ready - first };
  }, ready);
  const moving = [];
  for (let i = 0; i < 40; i++) {
    const before = spent();
    const [ms, width] = await page.evaluate(async () => {
      const { view } = fieldbake;
      view.camera.orbit(0.05, 0);
      view.times.moving = 0;
      view.redraw("moving");
      while (view.times.moving === 0) await new Promise((done) => setTimeout(done, 1));
      return [view.times.moving, view.times.width];
    });
    moving.push([ms, spent() - before, width]);
  }
  return { shown, ...times, live_cpu: live - still, exact_cpu: exact - live, moving };
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--size", type=int, default=512)
    options = parser.parse_args()
    volume = fb.bake(options.mesh, options.resolution)
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        for encoding in ("snorm8", "float16", "float32"):
            text = volume.to_html(encoding=encoding, size=(options.size, options.size))
            print(f"page, {encoding}: {len(text) / 1e3:.0f} kB")
        volume.to_html(page, size=(options.size, options.size))
        # The browser starts its processes with the first page; the second one gives the least time of this machine.
        paint = (
            "new Promise((d) => setTimeout(d, 3000)).then(() => performance.getEntriesByType('paint').at(-1).startTime)"
        )
        empty = {"url": "data:text/html,<p>text", "expression": paint}
        _, least, result = visit([empty, empty, {"url": page.as_uri(), "script": SCRIPT, "width": 700, "height": 700}])
    assert result.value, result.errors
    value = result.value
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; processor time in brackets")
    print(f"load event: {value['load']:.0f} ms; first picture on the screen: {value['shown']:.0f} ms")
    print(f"one word on an empty page: {least.value:.0f} ms")
    print(f"first live picture: {value['first']:.0f} ms after the load event ({value['live_cpu']} ms)")
    print(f"exact live picture: {value['still']:.0f} ms after that ({value['exact_cpu']} ms)")
    wall = sorted(ms for ms, _, _ in value["moving"][10:])
    cpu = sum(ticks for _, ticks, _ in value["moving"][10:]) / len(wall)
    print(f"moving frame: {wall[len(wall) // 2]:.0f} ms ({cpu:.0f} ms), width {value['moving'][-1][2]} pixels")


if __name__ == "__main__":
    main()
