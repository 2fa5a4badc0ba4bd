"""Pages of live views: their pixels in Chromium against pictures of raymarch, their text, and the bundle."""

from __future__ import annotations

import gzip
import math
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
from browser import PIXELS, WEB, node_tool, visit
from fieldbake.viewing.content import Content, content_of
from fieldbake.viewing.html import bundle

#: Pixels of the pictures here.
SIZE = (96, 80)


def knot(resolution: int = 40) -> fb.Volume:
    return fb.bake(fb.models.torus_knot(), resolution, device="cpu")


def shape() -> fb.Shape:
    painted = fb.sphere(radius=1.1).paint((0.9, 0.2, 0.1)) | fb.box((2, 2, 2))
    return painted - fb.cylinder(radius=0.4, height=4).rotate("x", 90)


def scene() -> fb.Scene:
    place = np.eye(4)
    place[:3, 3] = 2.4, 0.2, 0.3
    place[:3, :3] *= 0.8
    geometries = [
        fb.Instance(knot(), material=fb.Material(color=(0.9, 0.5, 0.1))),
        fb.Instance(fb.torus(1, 0.3), place),
        fb.Instance(fb.Quadric.sphere((0, 2.2, 0), radius=0.7, reflectance=(0.2, 0.5, 0.9))),
        fb.Instance(fb.box((9, 0.2, 9)).translate((0, -1.6, 0))),
    ]
    lights = [
        fb.DirectionalLight((-1, -2, -0.7), intensity=0.5),
        fb.PointLight((3, 5, 4), intensity=0.2),
        fb.PointLight((-3, 3, 2), (0.3, 1, 0.3), 4, range=9),
        fb.SpotLight((1, 6, 5), (0, -0.8, -0.6), 8, 20, (1, 0.4, 0.4), 16, range=math.inf),
    ]
    return fb.Scene(geometries, lights)


#: Objects, the encoding of their page, and the object that raymarch draws.
CASES = {
    "dense, float32": lambda: (knot(), "float32", knot()),
    "dense, snorm8": lambda: (knot(), "snorm8", knot().quantize("snorm8")),
    "dense, float16": lambda: (knot(), "float16", knot().quantize("float16")),
    "sparse": lambda: (knot().to_sparse(), "float32", knot().to_sparse()),
    "sparse, float16": lambda: (knot().to_sparse(), "float16", knot().to_sparse(encoding="float16")),
    "shape": lambda: (shape(), "snorm8", shape()),
    "scene": lambda: (scene(), "float32", scene()),
    "quadric": lambda: ((q := fb.Quadric.ellipsoid(radii=(1, 0.6, 0.4))), "snorm8", q),
    "dense, snorm8 against exact": lambda: (knot(), "snorm8", knot()),
}

QUICK = ("dense, snorm8", "scene")


def differences(
    tmp_path: Path, cases: Sequence[str], size: tuple[int, int]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each case: the differences of the page's colours, 8 bits, and of its depths, world units, from raymarch.

    The depths are compared at the pixels that both hit. The silhouettes differ in at most 0.5 % of the pixels.
    """
    camera = fb.Camera((3.5, 3.0, 7.5), (0.4, 0, 0), fov_deg=40)
    expected, jobs = [], []
    for number, name in enumerate(cases):
        geometry, encoding, drawn = CASES[name]()
        page = tmp_path / f"{number}.html"
        text = geometry.to_html(page, camera=camera, encoding=encoding, size=size)
        assert page.read_text(encoding="utf-8") == text
        jobs.append({"url": page.as_uri(), "expression": PIXELS})
        expected.append(fb.raymarch(drawn, camera, size=size, device="cpu"))
    found = {}
    for name, result, frame in zip(cases, visit(jobs, timeout=580), expected, strict=True):
        assert result.errors == [], name
        assert result.requests == [], name
        color, depth = result.picture
        assert color.shape[:2] == size[::-1]
        both = np.isfinite(depth) & np.isfinite(frame.depth)
        assert both.mean() > 0.02, name
        assert (np.isfinite(depth) != np.isfinite(frame.depth)).mean() <= 0.005, name
        found[name] = np.abs(color.astype(int) - frame.image).max(axis=-1), np.abs(depth[both] - frame.depth[both])
    return found


def check_pages(tmp_path: Path, cases: Sequence[str]) -> None:
    # Shapes and quadrics have no voxels: the knot's are the measure.
    voxel = float(knot().spacing.max())
    for name, (color, depth) in differences(tmp_path, cases, SIZE).items():
        assert (color <= 2).mean() >= 0.995, (name, (color <= 2).mean())
        assert depth.max() <= 0.01 * voxel, (name, depth.max() / voxel)


def test_pages_show_the_pictures_of_raymarch(tmp_path: Path) -> None:
    # The compilation of the programs takes most of the time. The scene has dense grids, shapes and quadrics.
    check_pages(tmp_path, QUICK)


@pytest.mark.slow
def test_pages_of_all_fields_show_the_pictures_of_raymarch(tmp_path: Path) -> None:
    check_pages(tmp_path, [name for name in [*CASES][:-1] if name not in QUICK])


@pytest.mark.slow
def test_large_pages_show_the_pictures_of_raymarch(tmp_path: Path) -> None:
    voxel = float(knot().spacing.max())
    cases = ["dense, float32", "dense, snorm8", "sparse", "shape", "scene", "dense, snorm8 against exact"]
    for name, (color, depth) in differences(tmp_path, cases, (256, 256)).items():
        if name == cases[-1]:
            # A step of snorm8 is 8 voxels / 127, which moves normals and silhouettes.
            assert (color <= 16).mean() >= 0.95, (name, (color <= 16).mean())
            continue
        assert (color <= 2).mean() >= 0.995, (name, (color <= 2).mean())
        assert depth.max() <= 0.01 * voxel, (name, depth.max() / voxel)


def test_the_bundle_is_built_from_its_source_and_small() -> None:
    command = [node_tool(".bin/esbuild"), "src/main.ts", "--bundle", "--minify", "--format=esm", "--target=es2022"]
    built = subprocess.run([*command, "--legal-comments=none"], cwd=WEB, capture_output=True, text=True, check=True)
    assert built.stdout == bundle(), "viewer.js is older than its source: run npm run build in web/"
    assert len(bundle().encode()) <= 60_000
    assert len(gzip.compress(bundle().encode(), 9)) <= 20_000
    assert "</script" not in bundle()


@pytest.mark.slow
def test_the_source_of_the_bundle_has_the_right_types() -> None:
    subprocess.run([node_tool(".bin/tsc"), "--noEmit"], cwd=WEB, check=True)


def test_the_page_is_the_same_text_every_time_and_names_nothing_outside() -> None:
    text = knot(16).to_html(size=(32, 24))
    assert text == knot(16).to_html(size=(32, 24))
    assert "http" not in text.replace("http-equiv", "")
    assert 'width="32" height="24"' in text


def test_mistakes_are_named(tmp_path: Path) -> None:
    volume = knot(16)
    with pytest.raises(fb.ArgumentError, match="encoding: "):
        volume.to_html(encoding="snorm7")
    with pytest.raises(fb.SceneError, match="camera: "):
        volume.to_html(camera=np.eye(4))
    with pytest.raises(fb.SceneError, match="size: "):
        volume.to_html(size=640)
    with pytest.raises(FileNotFoundError):
        volume.to_html(tmp_path / "nowhere" / "page.html", size=(16, 16))


def test_a_large_page_warns() -> None:
    noise = fb.Volume(np.random.default_rng(3).uniform(-1, 1, (110, 110, 110)), [(0, 0, 0), (1, 1, 1)])
    with pytest.warns(UserWarning, match='encoding="snorm8"'):
        noise.to_html(encoding="float32", size=(16, 16))


def content(geometry: object) -> Content:
    return content_of(geometry, None, "snorm8", SIZE)


def test_the_page_of_a_large_shape_says_that_a_field_is_drawn() -> None:
    few, many = (
        fb.Shape.union(*[fb.sphere(0.1).translate((x, y, 0)) for x in range(side) for y in range(side)])
        for side in (3, 10)
    )
    assert content(few).title == "Shape"
    title = content(many).title
    assert re.fullmatch(r"Shape, 100 leaves, drawn by its field of 192 x 192 x \d+", title)
    assert f"<title>{title}</title>" in many.to_html(size=SIZE)
    names = [placed.name for placed in content(fb.Scene([few, many])).placed]
    assert names == ["Shape", "Shape, drawn by its field of 192 voxels along the longest side"]


def test_the_page_states_open_meshes_and_missing_textures() -> None:
    closed = fb.models.torus_knot()
    opened = fb.Mesh(closed.vertices, closed.faces[:-40])
    texture = np.zeros((4, 4, 3), np.uint8)
    textured = fb.Mesh(closed.vertices, closed.faces, uv=np.zeros((len(closed.vertices), 2)), texture=texture)
    assert content(closed).remarks == []
    assert content(opened).remarks == ["the mesh is open, and its field closes the openings"]
    assert content(textured).remarks == ["textures are not drawn"]
    assert content(fb.Scene([closed, opened])).remarks == [
        "1 of 2 meshes are open, and their fields close the openings"
    ]
    note = content(opened)._description([[0.0]])["note"]
    assert note.endswith("; the mesh is open, and its field closes the openings")


def test_the_first_view_of_a_scene_shows_it_large() -> None:
    ball = fb.sphere()
    near, far = fb.Camera((0, 0, 4), (0, 0, 0), fov_deg=40), fb.Camera((3, 20, 30), (0, 1, 0), fov_deg=40)
    assert np.array_equal(content(fb.Scene([ball], cameras=[near])).camera.pose, near.pose)
    fitted = content(fb.Scene([ball], cameras=[far])).camera
    assert np.abs(fitted.pose[:3, :3] - far.pose[:3, :3]).max() <= 1e-12
    assert fitted.fov_deg == far.fov_deg
    frame = fb.raymarch(fb.Scene([ball]), fitted, size=SIZE, device="cpu")
    rows = np.isfinite(frame.depth).any(axis=1).sum()
    assert rows >= 0.5 * SIZE[1]
    # The camera of an argument is kept.
    assert np.array_equal(content_of(fb.Scene([ball]), far, "snorm8", SIZE).camera.pose, far.pose)
    # A camera among the objects of a room stays where it is.
    inside = fb.Camera((0, 0, 0), (0, 0, -1))
    assert np.array_equal(content(fb.Scene([fb.box(9).shell(0.1)], cameras=[inside])).camera.pose, inside.pose)
