"""Widgets of notebooks, the faces of objects there, and the command that opens a view."""

from __future__ import annotations

import html
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldbake as fb
from fieldbake.cli.application import app

PNG = b"\x89PNG"


def ball() -> fb.Volume:
    return fb.bake(fb.sphere(radius=1), 16, device="cpu")


def test_a_widget_carries_a_page_and_a_picture() -> None:
    widget = ball().show(size=(64, 48))
    data, _ = widget._repr_mimebundle_()
    assert {"application/vnd.jupyter.widget-view+json", "text/html", "image/png"} <= set(data)
    page = html.unescape(data["text/html"].split('srcdoc="')[1].split('" width=')[0])
    assert page == ball().to_html(size=(64, 48))
    widget.close()


def test_traits_go_both_ways() -> None:
    widget = ball().show(size=(64, 48))
    assert isinstance(widget.camera, fb.Camera)
    sent = widget.get_state(["camera", "slice", "picked"])
    assert len(sent["camera"]["pose"]) == 16
    assert sent["slice"] is None
    widget.slice = ("x", 0.25)
    assert widget.get_state("slice")["slice"] == {"axis": "x", "at": 0.25}
    widget.camera = fb.Camera((0, 0, 5), (0, 0, 1))
    assert widget.get_state("camera")["camera"]["distance"] == 4

    # As the browser sends them.
    found = []
    widget.on_pick(found.append)
    pick = {"point": [1, 0, 0], "normal": [1, 0, 0], "distance": 0, "depth": 4, "object": 0}
    camera = {"pose": np.eye(4).ravel().tolist(), "fov": 30, "distance": 2}
    widget.set_state({"picked": pick, "camera": camera, "slice": {"axis": "z", "at": 0.5, "cut": True}, "level": 0.1})
    assert found[0].point == (1, 0, 0)
    assert widget.camera.fov_deg == 30
    assert widget.slice == ("z", 0.5)
    assert widget.level == 0.1
    widget.close()


def test_parameters_rebuild_the_model() -> None:
    widget = fb.sphere(radius=1).show(
        parameters={"radius": (0.5, 1.5)}, model=lambda radius: fb.sphere(radius=radius), size=(32, 24)
    )
    before = widget.data
    widget.parameters = {"radius": 0.75}
    assert widget.data != before
    assert widget.camera is not None
    widget.close()


def test_numbers_of_a_shape_are_parameters() -> None:
    shape = (fb.sphere(radius=1).translate((0.5, 0, 0)) - fb.cylinder(radius=0.4, height=4)).offset(0.1)
    ranges = {"sphere.radius": (0.5, 1.5), "height": (1, 5), "distance": (0, 0.2)}
    widget = shape.show(parameters=ranges, size=(32, 24))
    assert widget.parameters == {"sphere.radius": 1, "height": 4, "distance": 0.1}
    before = widget._content
    widget.parameters = {"sphere.radius": 1.25, "height": 3, "distance": 0.05}
    made = (fb.sphere(radius=1.25).translate((0.5, 0, 0)) - fb.cylinder(radius=0.4, height=3)).offset(0.05)
    assert widget._content.shapes[0] == made
    # Numbers are data: the program stays the same, so that the browser compiles nothing.
    assert widget._content._programs() == before._programs()
    widget.close()
    blend = fb.sphere(radius=1).union(fb.box(1), k=0.2).show(parameters={"k": (0.1, 0.5)}, size=(16, 16))
    assert blend.parameters == {"k": 0.2}
    blend.close()
    with pytest.raises(fb.ArgumentError, match=r"'radius' names arguments with the values 0.4, 1; pass model="):
        shape.show(parameters={"radius": (0, 1)})
    with pytest.raises(fb.ArgumentError, match=r"no number 'size'; it has .*cylinder.height"):
        shape.show(parameters={"size": (0, 1)})
    with pytest.raises(fb.ArgumentError, match=r"Volume.* needs model="):
        ball().show(parameters={"radius": (0, 1)})
    with pytest.raises(fb.ArgumentError, match="needs parameters="):
        shape.show(model=fb.sphere)


def test_ranges_of_parameters_are_checked() -> None:
    with pytest.raises(fb.ArgumentError, match="radius"):
        fb.sphere(radius=1).show(parameters={"radius": (1, 0)}, model=fb.sphere)


def test_without_anywidget_the_page_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "fieldbake.viewing.widget", raising=False)
    shown = ball().show(size=(32, 24))
    data = shown._repr_mimebundle_()
    assert "<iframe srcdoc=" in data["text/html"]
    assert "fieldbake[notebook]" in data["text/plain"]


def test_every_object_has_a_face() -> None:
    knot = fb.models.torus_knot(segments=32, sides=6)
    quadric = fb.Quadric.sphere(radius=1)
    nested = fb.merge([ball()], 16, levels=2, center=(0, 0, 0))
    geometries = [ball(), ball().to_sparse(), fb.sphere(radius=1), knot, quadric, fb.Scene([knot, quadric]), nested]
    for geometry in [*geometries, fb.pack([ball()], page_size=256)]:
        assert geometry._repr_png_().startswith(PNG), geometry
    assert fb.Volume(np.ones((3, 3, 3)), [(0, 0, 0), (1, 1, 1)])._repr_png_() is None
    assert ball().report._repr_html_().startswith("<table")
    assert "self-intersections</td>" in fb.solid(knot, 12).report._repr_html_()
    assert ball().plot_slices()._repr_png_().startswith(PNG)


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    hostile = "</script><script>alert(1)</script>"
    shown = ball().show(size=(16, 16))
    shown._content.title = hostile
    assert hostile not in shown._repr_mimebundle_()[0]["text/html"]
    shown.close()


def test_the_command_writes_pages(tmp_path: Path) -> None:
    ball().save(tmp_path / "ball.npz")
    fb.models.torus_knot(segments=32, sides=6).save(tmp_path / "knot.obj")
    files = [str(tmp_path / name) for name in ("ball.npz", "knot.obj")]
    page = tmp_path / "page.html"
    done = CliRunner().invoke(app, ["view", files[0], "-o", str(page), "--no-open", "--size", "64x48"])
    assert done.exit_code == 0, done.output
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    done = CliRunner().invoke(app, ["view", *files, "-o", str(tmp_path / "out"), "--no-open", "--size", "64x48"])
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["ball.html", "knot.html"]
    assert CliRunner().invoke(app, ["view", files[0], "--size", "64"]).exit_code == 2


@pytest.mark.slow
def test_the_notebook_runs() -> None:
    import nbformat
    from nbclient import NotebookClient

    path = Path(__file__).parents[2] / "examples" / "notebooks" / "first_look.ipynb"
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=240, kernel_name="python3").execute()
    outputs = [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("application/vnd.jupyter.widget-view+json" in data and "text/html" in data for data in outputs) == 2
    assert sum("image/png" in data for data in outputs) == 4
    assert any("<table" in data.get("text/html", "") for data in outputs)
