"""Pictures of a view besides the lit one at rest: in motion, steps and errors of samples, pages of an atlas."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fieldbake as fb
from browser import PIXELS, Visit, after_first_picture, visit

SIZE = (80, 64)

#: Resolves to the colours of the view drawn in motion, of its errors and steps, and to its depths.
MODES = after_first_picture("""
  const made = {};
  for (const [name, picture] of [["motion", 0], ["error", 8], ["steps", 1], ["depth", 2]])
    made[name] = await drawn(picture, name === "motion");
  const buttons = [...document.querySelectorAll(".fb-bar button")];
  const press = (name) => buttons.find((it) => it.textContent === name).click();
  const legends = ["steps", "error"].map((name) => {
    press(name);
    const legend = document.querySelector(".fb-scale").textContent;
    press(name);
    return legend;
  });
  const scale = view.data.description.error;
  press("reset");
  // A pick interrupts the picture, which is drawn again after it.
  view.pick(1, 1);
  await view.settled;
  return { ...made, legends, scale };
""")

#: Resolves to what the layer of pages shows after its button was pressed.
PAGES = after_first_picture("""
  const [layer] = document.querySelectorAll(".fb-pages");
  const before = layer.getBoundingClientRect().height;
  [...document.querySelectorAll(".fb-bar button")].find((it) => it.textContent === "pages").click();
  await Promise.all([...layer.querySelectorAll("img")].map((image) => image.decode()));
  const box = (it) => {
    const { left, top, width, height } = it.getBoundingClientRect();
    return [left, top, width, height];
  };
  const figures = [...layer.querySelectorAll("figure")].map((figure) => ({
    title: figure.querySelector("figcaption").textContent,
    image: box(figure.querySelector("img")),
    names: [...figure.querySelectorAll("span")].map((it) => it.textContent),
    boxes: [...figure.querySelectorAll("span")].map(box),
  }));
  return { before, after: layer.getBoundingClientRect().height, figures };
""")


def knot(resolution: int = 40) -> fb.Volume:
    return fb.bake(fb.models.torus_knot(), resolution, device="cpu")


def decoded(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(SIZE[1], SIZE[0], 4)


def heat(share: np.ndarray) -> np.ndarray:
    """The colours of Frame.heatmap, sRGB in [0, 1]."""
    colors = [(0.03, 0.03, 0.12), (0.25, 0.12, 0.45), (0.70, 0.20, 0.42), (0.96, 0.50, 0.25), (1.00, 0.92, 0.60)]
    return np.stack([np.interp(share, np.linspace(0, 1, 5), channel) for channel in zip(*colors, strict=True)], axis=-1)


#: Resolves to the colours of the view drawn in motion: at level 0, at another one, and with the triangles of meshes.
MOTION = after_first_picture("""
  const resources = view.acquire();
  // The least and the largest place of the corners of triangles on each axis, field space.
  const limits = [];
  const shape = resources.engine.shape.bind(resources.engine);
  resources.engine.shape = (triangles) => {
    const { corners } = triangles;
    for (const axis of [0, 1, 2]) {
      const places = corners.filter((_, i) => i % 6 === axis);
      limits.push([places.reduce((a, b) => Math.min(a, b)), places.reduce((a, b) => Math.max(a, b))]);
    }
    return shape(triangles);
  };
  const pictures = [];
  for (const [level, mesh] of [[0, false], [LEVEL, false], [0, true]]) {
    pictures.push(await drawn(0, true, { level, mesh }));
  }
  const button = [...document.querySelectorAll(".fb-bar button")].find((it) => it.textContent === "mesh");
  button?.click();
  await view.settled;
  const copy = view.canvas.getContext("2d").getImageData(0, 0, width, height).data;
  const isSurface = resources.isSurface(view.settings);
  return { pictures, limits, rest: text(copy), hasButton: button !== undefined, isSurface };
""")


def camera() -> fb.Camera:
    return fb.Camera((3.5, 3.0, 7.5), (0.4, 0, 0), fov_deg=40)


def beside() -> NDArray[np.float64]:
    """A place beside the knot, smaller."""
    place = np.eye(4)
    place[:3, 3] = 2.4, 0.2, 0.3
    place[:3, :3] *= 0.8
    return place


def check_motion(found: NDArray[np.uint8], frame: fb.Frame) -> None:
    """Compare a picture in motion with one of raymarch.

    Filters round their weights to 8 bits, snorm8 has steps of 4 voxels / 127, and triangles lie beside the
    surface between their corners. So normals and silhouettes move.
    """
    difference = np.abs(found.astype(int) - frame.image).max(axis=-1)
    assert (difference <= 16).mean() >= 0.93, (difference <= 16).mean()
    assert difference.mean() <= 4, difference.mean()


@pytest.mark.slow
def test_rays_in_motion_and_the_modes_of_sparse_volumes_and_scenes(tmp_path: Path) -> None:
    ball = fb.bake(fb.sphere(radius=0.9), 24, device="cpu")
    scene = fb.Scene([fb.Instance(knot()), fb.Instance(ball, beside()), fb.Instance(fb.torus(1.9, 0.1))])
    geometries = {"sparse": knot().to_sparse(), "scene": scene}
    jobs = []
    for name, geometry in geometries.items():
        page = tmp_path / f"{name}.html"
        geometry.to_html(page, camera=camera(), size=SIZE)
        jobs.append({"url": page.as_uri(), "expression": MODES})
    for geometry, result in zip(geometries.values(), visit(jobs), strict=True):
        check_modes(result)
        check_motion(decoded(result.value["motion"]), fb.raymarch(geometry, camera(), size=SIZE, device="cpu"))


def test_dense_grids_in_motion_and_meshes_are_triangles(tmp_path: Path) -> None:
    # The mesh is turned and smaller; the lights are of all kinds. Pictures in motion have no shadows.
    lights = [
        fb.DirectionalLight((-1, -2, -0.7), intensity=0.6),
        fb.PointLight((3, 5, 4), intensity=0.2),
        fb.SpotLight((0, 4, 3), (0, -0.8, -0.6), 5, 25, intensity=7, range=20),
    ]
    orange = fb.Material(color=(0.9, 0.5, 0.1))
    coarse = fb.models.torus_knot(segments=24, sides=5)
    place = beside() @ np.diag([0.6, -0.6, -0.6, 1])
    scene = fb.Scene([fb.Instance(knot(), material=orange), fb.Instance(coarse, place, resolution=32)], lights)
    # The box cuts this field, so that its surface has flat parts.
    x, y, z = np.meshgrid(*[(np.arange(32) + 0.5) / 16 - 1] * 3, indexing="ij")
    cut = fb.Volume(np.sqrt((x - 0.8) ** 2 + y**2 + (z - 0.3) ** 2) - 0.75, [(-1, -1, -1), (1, 1, 1)])
    near = fb.Camera((3.2, 1.4, 2.6), (0.2, 0, 0), fov_deg=40)
    level = 0.05
    jobs = []
    for name, geometry, view in (("scene", scene, camera()), ("cut", cut, near)):
        page = tmp_path / f"{name}.html"
        geometry.to_html(page, camera=view, size=SIZE, encoding="float32")
        jobs.append({"url": page.as_uri(), "expression": MOTION.replace("LEVEL", str(level))})
    first, second = visit(jobs)
    for result, has_button in ((first, True), (second, False)):
        assert result.value is not None, result.errors
        assert result.errors == []
        assert result.value["isSurface"]
        assert result.value["hasButton"] is has_button
    options = {"size": SIZE, "shadows": "none", "device": "cpu"}
    check_motion(decoded(first.value["pictures"][0]), fb.raymarch(scene, camera(), **options))
    check_motion(decoded(first.value["pictures"][2]), fb.render(scene, camera(), **options))
    hard = fb.render(scene, camera(), **{**options, "shadows": "hard"})
    check_motion(decoded(first.value["rest"]), hard)
    # The mesh is in shadow in places, which pictures in motion light.
    rest, motion = (decoded(text)[..., :3].astype(int) for text in (first.value["rest"], first.value["pictures"][2]))
    assert (np.abs(motion - rest).max(axis=-1) > 16).mean() >= 0.003
    for text, own in zip(second.value["pictures"], (0, level), strict=False):
        frame = fb.raymarch(fb.Volume(cut.distances - own, cut.bounds), near, **options)
        check_motion(decoded(text), frame)
        assert np.isfinite(frame.depth).mean() > 0.1


def test_triangles_are_whole_near_the_eye_within_their_box_and_on_both_sides(tmp_path: Path) -> None:
    options = {"size": SIZE, "shadows": "none", "device": "cpu"}
    # The surface at this level lies outside the box of the solid, 0.6 before the eye, and the box 0.9 before it.
    padded = fb.bake(fb.box((2, 2, 2)), 24, margin=1, device="cpu")
    front = fb.Camera((0, 0, 1.9), (0, 0, 0), fov_deg=70)
    level = 0.3
    # A coarse grid keeps every second sample of this one, whose box cuts the ball of this level.
    x, y, z = np.meshgrid(*[(np.arange(72) + 0.5) / 36 - 1] * 3, indexing="ij")
    cut = fb.Volume(np.sqrt((x - 0.6) ** 2 + y**2 + (z + 0.6) ** 2) - 0.75, [(-1, -1, -1), (1, 1, 1)])
    side = fb.Camera((3.2, 1.4, 2.6), (0.2, 0, 0), fov_deg=40)
    knot = fb.models.torus_knot(segments=24, sides=5)
    inverted = fb.Scene([fb.Instance(fb.Mesh(knot.vertices, knot.faces[:, ::-1]), resolution=32)])
    jobs = []
    for name, geometry, view in (("near", padded, front), ("cut", cut, side), ("inverted", inverted, camera())):
        page = tmp_path / f"{name}.html"
        geometry.to_html(page, camera=view, size=SIZE, encoding="float32")
        jobs.append({"url": page.as_uri(), "expression": MOTION.replace("LEVEL", str(level))})
    near, edge, back = visit(jobs)
    for result in (near, edge, back):
        assert result.value is not None, result.errors
        assert result.errors == []
    grown = fb.Volume(padded.distances - level, padded.bounds)
    check_motion(decoded(near.value["pictures"][1]), fb.raymarch(grown, front, **options))
    # The ball of radius 1.05 ends at two sides of the box along y, and at one along x and z.
    (x0, x1), (y0, y1), (z0, z1) = edge.value["limits"][:3]
    assert (x1, y0, y1, z0) == (71.5, -0.5, 71.5, -0.5)
    assert x0 == pytest.approx((1 + 0.6 - 1.05) * 36 - 0.5, abs=0.5)
    assert z1 == pytest.approx((1 - 0.6 + 1.05) * 36 - 0.5, abs=0.5)
    # A mesh that is wound inside out has the lighting of the same mesh the right way round. fb.render smooths
    # normals, so that 1 % of the pixels differ by more than 16 steps; the knot covers 10 %.
    right = fb.render(fb.Scene([fb.Instance(knot, resolution=32)]), camera(), **{**options, "shadows": "hard"})
    difference = np.abs(decoded(back.value["rest"]).astype(int) - right.image).max(axis=-1)
    assert (difference <= 16).mean() >= 0.975


#: Resolves to the numbers of triangles of a picture in motion and of the picture at rest that follows.
STEADY = after_first_picture("""
  view.rest();
  const { engine } = view.acquire();
  const counts = [];
  const shape = engine.shape.bind(engine);
  engine.shape = (triangles) => {
    counts.push(triangles.indices.length / 3);
    return shape(triangles);
  };
  view.settings.mesh = true;
  view.redraw("moving");
  await view.settled;
  return counts;
""")


def test_pictures_at_rest_have_the_triangles_of_fine_grids(tmp_path: Path) -> None:
    knot = fb.models.torus_knot(segments=24, sides=5)
    # A coarse grid keeps every second sample of this one.
    ball = fb.bake(fb.sphere(radius=0.9), 72, device="cpu")
    page = tmp_path / "scene.html"
    fb.Scene([fb.Instance(knot, resolution=32), fb.Instance(ball, beside())]).to_html(page, size=SIZE)
    (result,) = visit([{"url": page.as_uri(), "expression": STEADY}])
    assert result.value is not None, result.errors
    assert result.errors == []
    # Both pictures have the triangles of the mesh.
    mesh, coarse, fine = result.value
    assert mesh == len(knot.faces)
    # The number of triangles goes with the square of the resolution: by 4 from one grid to the other.
    assert fine >= 3 * coarse


#: Resolves to the canvas after the first picture, and after smooth ones: the one that follows by itself for the name ""
#: and the one that follows a click on the button of another name.
SMOOTH = after_first_picture("""
  const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  const shown = () => {
    copy.drawImage(view.canvas, 0, 0);
    return text(copy.getImageData(0, 0, width, height).data);
  };
  const pictures = [shown()];
  for (const name of NAMES) {
    // A loaded machine may take longer than the limit for the exact picture. Then it is drawn again.
    for (view.times.smooth = 0; view.times.smooth === 0; ) {
      const button = [...document.querySelectorAll(".fb-bar button")].find((it) => it.textContent === name);
      if (button) button.click();
      else if (view.times.still >= 1000) view.redraw();
      await view.settled;
      if (name === "mesh" && !view.settings.mesh) continue;
      for (let i = 0; i < 20 && view.times.smooth === 0; i++) await new Promise((done) => setTimeout(done, 100));
    }
    pictures.push(shown());
  }
  return pictures;
""")


@pytest.mark.slow
def test_pictures_at_rest_are_smooth(tmp_path: Path) -> None:
    # The view has shadows of fields, and the picture has shadows of triangles. A light in the eye has no visible ones
    # but for the error of the field, whose voxels are finer than pixels.
    knotted = fb.Instance(fb.models.torus_knot(segments=96, sides=16), resolution=128)
    mesh = fb.Scene([knotted], lights=[fb.PointLight(camera().eye)])
    jobs = []
    for name, geometry, names in (("field", knot(), [""]), ("mesh", mesh, ["mesh"])):
        page = tmp_path / f"{name}.html"
        geometry.to_html(page, camera=camera(), size=SIZE, encoding="float32")
        jobs.append({"url": page.as_uri(), "expression": SMOOTH.replace("NAMES", str(names))})
    field, triangles = visit(jobs)
    for result, draw, geometry in ((field, fb.raymarch, knot()), (triangles, fb.render, mesh)):
        assert result.value is not None, result.errors
        assert result.errors == []
        first, smooth = (decoded(text)[..., :3].astype(float) for text in result.value)
        # 64 samples for each pixel, averaged in sRGB as the view averages.
        large = draw(geometry, camera(), size=(8 * SIZE[0], 8 * SIZE[1]), shadows="hard", device="cpu").image
        samples = large[..., :3].astype(float).reshape(SIZE[1], 8, SIZE[0], 8, 3)
        truth = samples.mean(axis=(1, 3))
        if draw is fb.raymarch:
            # The first picture has one sample in the centre of each pixel.
            center = draw(geometry, camera(), size=SIZE, shadows="hard", device="cpu").image
            assert (np.abs(first - center[..., :3]) <= 2).mean() >= 0.995
        else:
            first = draw(geometry, camera(), size=SIZE, shadows="hard", device="cpu").image[..., :3].astype(float)
        # An edge divides 16 well spread samples with an error of about 1/16 of its contrast, and one sample with one of
        # about 1/2. Half of that gain is left for edges that are thinner than a pixel.
        edges = np.ptp(samples, axis=(1, 3)).max(axis=-1) > 32
        assert edges.sum() > 100
        before, after = (np.sqrt(((found - truth)[edges] ** 2).mean()) for found in (first, smooth))
        assert after <= 0.25 * before, (after, before)


def check_modes(result: Visit) -> None:
    """The legends of steps and errors, and that steps differ."""
    assert result.value is not None, result.errors
    assert result.errors == []
    steps, error = result.value["legends"]
    assert steps.endswith("64 steps of a ray")
    assert error.startswith("0")
    assert error.endswith("world units, error of the nearest sample")
    assert len(np.unique(decoded(result.value["steps"])[..., 0])) > 4


def test_modes_of_a_view(tmp_path: Path) -> None:
    page = tmp_path / "dense.html"
    knot().to_html(page, camera=camera(), size=SIZE)
    (result,) = visit([{"url": page.as_uri(), "expression": MODES}])
    check_modes(result)
    check_motion(
        decoded(result.value["motion"]),
        fb.raymarch(knot(), camera(), size=SIZE, shadows="none", device="cpu"),
    )

    # The colour of the errors, up to the brightness of the surface, against the errors of the nearest samples.
    volume, value = knot(), result.value
    stored = volume.quantize("snorm8").distances
    errors = np.abs(stored - volume.distances)
    depth = decoded(value["depth"]).copy().view(np.float32)[..., 0]
    hit = depth < 1e38
    points = points_of(camera(), depth)
    grid = (points - volume.bounds[0]) / volume.spacing - 0.5
    nearest = tuple(np.clip(np.rint(grid), 0, np.array(volume.resolution) - 1).astype(int).T)
    near = np.abs(volume.distances) <= 0.5 * np.linalg.norm(volume.spacing)
    assert value["scale"] == pytest.approx(errors[near].max(), rel=1e-6)
    # Errors are stored in five steps.
    expected = heat(np.rint(5 * errors[nearest] / value["scale"]) / 5)
    seen = decoded(value["error"])[hit][:, :3] / 255
    ratio = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    wanted = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    # A point half way between two samples may take either.
    assert (np.abs(ratio - wanted).max(axis=1) <= 0.03).mean() >= 0.97
    assert len(np.unique(expected, axis=0)) >= 4


def test_a_cut_removes_the_whole_half_before_the_slice(tmp_path: Path) -> None:
    # The first eye is near the plane, so that many rays on its side go away from the plane. The rays of the second
    # one in the middle column are parallel to the plane.
    near = fb.Camera((0.3, 0.2, 4), (0.1, 0, 0), fov_deg=40)
    middle = fb.Camera((0, 0, 4), (0, 0, 0), fov_deg=40)
    cases = [(near, SIZE, 0.05), (middle, (81, 64), -0.05)]
    jobs = []
    for number, (eye, size, at) in enumerate(cases):
        page = tmp_path / f"{number}.html"
        fb.bake(fb.sphere(radius=1), 24, device="cpu").to_html(page, camera=eye, size=size)
        cut = f"fieldbake.view.settings.slice = {{ axis: 0, at: {at}, cut: true }};"
        jobs.append({"url": page.as_uri(), "expression": PIXELS.replace("const {", f"{cut} const {{", 1)})
    for (eye, _, at), result in zip(cases, visit(jobs), strict=True):
        _, depth = result.picture
        points = points_of(eye, depth)
        assert (points[..., 0] <= at + 1e-3).all()
        # The half behind the plane remains.
        assert np.isfinite(depth).sum() > 200


def points_of(view: fb.Camera, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """The points of a picture's surfaces, world units, (n, 3)."""
    hit = np.isfinite(depth) & (depth < 1e38)
    height, width = depth.shape
    pixel = 2 * np.tan(np.radians(view.fov_deg) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    right, up, back, eye = view.pose[:3].T
    rays = x[None, :, None] * right + y[:, None, None] * up - back
    return np.asarray(eye + rays[hit] * depth[hit][:, None], dtype=np.float64)


def test_the_pages_of_an_atlas_are_shown(tmp_path: Path) -> None:
    volumes = [fb.bake(fb.sphere(radius=1), n, device="cpu") for n in (24, 16, 20)]
    atlas = fb.pack(volumes, page_size=256)
    atlas.remove(1)
    page = tmp_path / "atlas.html"
    atlas.to_html(page, size=(320, 240))
    (result,) = visit([{"url": page.as_uri(), "expression": PAGES}])
    assert result.errors == []
    assert result.value["before"] == 0
    assert result.value["after"] == 240
    (figure,) = result.value["figures"]
    assert figure["title"] == f"page 0 of 1, 256 x 256 {atlas.encoding}, {atlas.layout}"
    sizes = {i: " x ".join(map(str, atlas.resolution(i))) for i in (0, 2)}
    assert figure["names"] == [f"0: {sizes[0]}", f"2: {sizes[2]}"]
    left, top, width, height = figure["image"]
    for x, y, across, down in figure["boxes"]:
        assert left - 1 <= x <= x + across <= left + width + 1
        assert top - 1 <= y <= y + down <= top + height + 1
    (x0, y0, w0, h0), (x1, y1, w1, h1) = figure["boxes"]
    # The frames do not overlap by more than their lines.
    assert x0 + w0 <= x1 + 2 or x1 + w1 <= x0 + 2 or y0 + h0 <= y1 + 2 or y1 + h1 <= y0 + 2
