"""Sliders of pages: parameters that a page changes without Python, and the pictures that follow."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from browser import after_first_picture, visit

SIZE = (96, 72)
CAMERA = fb.Camera((4.0, -6.0, 4.0), (0, 0, 0), up=(0, 0, 1), fov_deg=40)


def part(radius: float = 0.5, width: float = 2.0, angle: float = 20.0, k: float = 0.2, copies: float = 3.0) -> fb.Shape:
    plate = fb.box((width, 2.0, 0.6)).rotate("z", angle)
    return (plate | fb.sphere(0.8).translate((0, 0, 0.4))).smooth(k) - fb.cylinder(radius, 4).circular_array(
        round(copies), 0.7
    )


RANGES = {"radius": (0.1, 0.5), "width": (1.5, 3.0), "angle": (0.0, 40.0), "k": (0.1, 0.4), "copies": (1.0, 5.0)}


def description(page: str) -> dict:
    data = re.search(r'id="fieldbake-data">([^<]*)<', page)
    assert data is not None
    packed = gzip.decompress(b64decode(data[1]))
    length = int.from_bytes(packed[:4], "little")
    found: dict = json.loads(packed[4 : 4 + length])
    return found


def test_linear_parameters_have_sliders_and_others_are_named():
    found = description(fb.sphere().to_html(size=SIZE, parameters=RANGES, model=part))
    sliders = found["sliders"]["parameters"]
    assert [slider["name"] for slider in sliders] == ["radius", "width", "k"]
    assert [slider["range"] for slider in sliders] == [list(RANGES[name]) for name in ("radius", "width", "k")]
    assert "angle, copies would need Python" in found["note"]
    # The box contains the shape at all values.
    assert found["bounds"][1][0] >= part(width=3.0, angle=20).bounds[1, 0] - 1e-9


def test_parameters_of_a_shape_are_found_by_name():
    shape = fb.box((2, 2, 1)) - fb.cylinder(0.5, 2)
    found = description(shape.to_html(size=SIZE, parameters={"cylinder.radius": (0.2, 0.8)}))
    (slider,) = found["sliders"]["parameters"]
    assert slider["value"] == 0.5
    assert description(shape.to_html(size=SIZE))["sliders"] is None


def test_products_of_parameters_keep_the_first_slider():
    def model(length: float, share: float) -> fb.Shape:
        return fb.box((length, 1, 1)) - fb.sphere(0.3).translate((length * share, 0, 0))

    found = description(fb.sphere().to_html(size=SIZE, parameters={"length": (1, 3), "share": (0, 0.5)}, model=model))
    assert [slider["name"] for slider in found["sliders"]["parameters"]] == ["length"]
    assert "share would need Python" in found["note"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.sphere().to_html(parameters={"size": (1, 2)}), "parameters: the shape has no number 'size'"),
        (lambda: fb.sphere().to_html(parameters={"radius": (2, 1)}), r"parameters\['radius'\]: the largest"),
        (lambda: fb.sphere().to_html(model=part), "model: needs parameters="),
        (lambda: fb.bake(fb.sphere(), 8).to_html(parameters={"radius": (1, 2)}), "parameters: .* needs model="),
        (
            lambda: fb.sphere().to_html(parameters={"n": (8, 9)}, model=lambda n: fb.bake(fb.sphere(), int(n))),
            "model: must return a Shape",
        ),
    ],
)
def test_mistakes_name_the_argument(make, message):
    with pytest.raises(fb.ArgumentError, match=f"^{message}"):
        make()


#: Moves the sliders of a page and resolves to the pixels of the picture at rest.
MOVE = after_first_picture("""
  const values = VALUES;
  for (const input of document.querySelectorAll(".fb-bar input[type=range]")) {
    if (!(input.title in values)) continue;
    input.value = String(values[input.title]);
    input.dispatchEvent(new Event("input"));
  }
  await view.settled;
  const note = document.querySelector(".fb-note").textContent;
  const { color, depth } = await fieldbake.pixels();
  return { width, height, color: text(color), depth: text(new Uint8Array(depth.buffer)), note };
""")


def test_moved_sliders_draw_the_shape_of_their_values(tmp_path: Path):
    page = tmp_path / "part.html"
    fb.sphere().to_html(page, camera=CAMERA, size=SIZE, parameters=RANGES, model=part)
    cases = [{}, {"radius": 0.15, "width": 2.9, "k": 0.35}, {"width": 1.6}]
    jobs = [{"url": page.as_uri(), "expression": MOVE.replace("VALUES", json.dumps(case))} for case in cases]
    start = {name: 0.5 * (least + most) for name, (least, most) in RANGES.items()}
    pictures = []
    for case, result in zip(cases, visit(jobs, timeout=300), strict=True):
        assert result.value is not None, result.errors
        assert result.errors == []
        assert result.requests == []
        color, depth = result.picture
        frame = fb.raymarch(part(**{**start, **case}), CAMERA, size=color.shape[1::-1], device="cpu")
        both = np.isfinite(depth) & np.isfinite(frame.depth)
        assert both.mean() > 0.05
        assert (np.isfinite(depth) != np.isfinite(frame.depth)).mean() <= 0.005
        assert (np.abs(color.astype(int) - frame.image).max(axis=-1) <= 2).mean() >= 0.99
        assert np.abs(depth[both] - frame.depth[both]).max() <= 0.02
        assert "would need Python" in result.value["note"]
        pictures.append(color)
    assert (pictures[0] != pictures[1]).any(axis=-1).mean() > 0.05
