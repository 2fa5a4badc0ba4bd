"""The text below a view: distances below the pointer, picks, and their errors."""

from __future__ import annotations

from pathlib import Path

import fieldbake as fb
from browser import after_first_picture, visit

SIZE = (240, 120)

#: Resolves to the text below the view and its overflow in pixels, for large values and for errors.
NOTES = after_first_picture("""
  const note = document.querySelector(".fb-note");
  const center = () => {
    const box = view.canvas.getBoundingClientRect();
    return { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, bubbles: true };
  };
  const until = async (test) => {
    for (let i = 0; i < 1000 && !test(); i++) await new Promise((done) => setTimeout(done, 20));
    const { textContent, scrollWidth, clientWidth } = note;
    return { text: textContent, overflow: scrollWidth - clientWidth };
  };
  const hover = () => view.canvas.dispatchEvent(new PointerEvent("pointermove", center()));
  view.settings.slice = { axis: 2, at: 0, cut: true };
  view.redraw();
  await view.settled;

  const found = [];
  const { sliceValue } = view;
  for (const value of [-0.00001234567, 1.23456789e20, -0.1234567, 123456.7]) {
    note.lastChild.textContent = "";
    view.sliceValue = async () => value;
    hover();
    found.push(await until(() => note.lastChild.textContent));
  }
  // While one value is on its way, only the latest of the next pixels gets one.
  let reads = 0;
  view.sliceValue = async () => {
    reads++;
    await new Promise((done) => setTimeout(done, 100));
    return reads;
  };
  for (let i = 0; i < 20; i++) hover();
  await until(() => note.textContent.includes("distance 2"));
  view.sliceValue = sliceValue;

  view.acquire().engine.read = () => {
    throw new Error("no bytes");
  };
  const problems = [];
  for (const act of [hover, () => view.canvas.dispatchEvent(new MouseEvent("dblclick", center()))]) {
    note.lastChild.textContent = "";
    act();
    problems.push(await until(() => note.textContent.includes("no bytes")));
  }
  return { found, reads, problems };
""")


def test_values_are_short_and_errors_are_shown(tmp_path: Path) -> None:
    page = tmp_path / "ball.html"
    fb.bake(fb.sphere(radius=1), 16, device="cpu").to_html(page, size=SIZE)
    (result,) = visit([{"url": page.as_uri(), "expression": NOTES}])
    assert result.value is not None, result.errors
    assert result.errors == []
    shown = [found["text"].partition("distance ")[2] for found in result.value["found"]]
    assert shown == ["-1.235e-5", "1.235e+20", "-0.1235", "123500"]
    assert result.value["reads"] == 2
    for found in (*result.value["found"], *result.value["problems"]):
        assert found["overflow"] <= 0, found
    for found in result.value["problems"]:
        assert found["text"].endswith("Error: no bytes"), found
