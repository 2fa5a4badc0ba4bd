"""Slices of solids: areas against closed forms, pixels against the inside, files against other readers."""

from __future__ import annotations

import io
import json
import pickle
import re
import zipfile

import numpy as np
import pytest
import shapely
from PIL import Image

import fieldbake as fb
import meshes
from browser import visit
from fieldbake.meshes.loops import area, cut

#: Relative error of areas at 200 pixels across: the sagitta of a chord of one pixel is 3e-6 of the diameter.
COARSE = 1e-3

#: Float64 sections against trimesh's, whose positions are float64 too; it merges vertices at 1e-8 of the size.
SAME = 1e-4


def pipe() -> fb.Shape:
    return fb.cylinder(radius=1, height=2) - fb.cylinder(radius=0.5, height=3)


def lens(z):
    """Area of the section at z of a torus with the radii 2 and 0.5."""
    return 8 * np.pi * np.sqrt(np.maximum(0.25 - z**2, 0))


SHAPES = {
    "ball": lambda: (fb.sphere(1), lambda z: np.pi * (1 - z**2), 4 / 3 * np.pi),
    "torus": lambda: (fb.torus(2, 0.5), lens, np.pi**2),
    "turned_box": lambda: (fb.box((2, 1.5, 1)).rotate("z", 30), lambda z: 3 + 0 * z, 3),
    "cone": lambda: (fb.cone(1, 2), lambda z: np.pi * ((1 - z) / 2) ** 2, 2 / 3 * np.pi),
    "pipe": lambda: (pipe(), lambda z: 0.75 * np.pi + 0 * z, 1.5 * np.pi),
    "volume": lambda: (fb.bake(fb.sphere(1), 200), lambda z: np.pi * (1 - z**2), 4 / 3 * np.pi),
    "sparse": lambda: (
        fb.bake(fb.sphere(1), 200).to_sparse(tolerance=None), lambda z: np.pi * (1 - z**2), 4 / 3 * np.pi
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_areas_are_closed_forms(name):
    solid, truth, volume = SHAPES[name]()
    is_grid = name in ("volume", "sparse")
    size = np.ptp(solid.inner_bounds if is_grid else solid.bounds, axis=0)
    # The trilinear field of a grid has an error of its own, of a quarter of a voxel^2 / radius.
    pixel = size.max() / (100 if is_grid else 200)
    layers = fb.slices(solid, size[2] / 200, pixel=pixel)
    exact = truth(layers.z)

    assert len(layers) == 200
    # Chords of a circle of any radius lose about half a pixel, so small circles have larger relative errors.
    assert (np.abs(layers.areas - exact) <= COARSE * np.maximum(exact, np.pi * (20 * pixel) ** 2)).all()
    assert abs(layers.areas.sum() * layers.layer - volume) <= COARSE * volume


@pytest.mark.parametrize("name", ["icosphere", "torus", "knot", "hollow_sphere", "capsule"])
def test_areas_of_meshes_are_those_of_trimesh(name):
    mesh = fb.Mesh(*meshes.CLOSED[name]())
    height = float(np.ptp(mesh.bounds[:, 2]))
    layers = fb.slices(mesh, height / 50, pixel=height / 100)
    sections = mesh.to_trimesh().section_multiplane((0, 0, 0), (0, 0, 1), layers.z)

    assert len(layers) == 50
    for found, section in zip(layers.areas, sections, strict=True):
        assert abs(found - section.area) <= SAME * section.area
    fine = fb.slices(mesh, height / 500, pixel=height / 100)
    assert abs(fine.areas.sum() * fine.layer - mesh.volume) <= COARSE * mesh.volume


def test_real_meshes_have_the_areas_of_trimesh(model_path):
    mesh = fb.load_mesh(model_path("fandisk.obj"))
    layers = fb.slices(mesh, float(np.ptp(mesh.bounds[:, 2])) / 20, pixel=0.02)
    sections = mesh.to_trimesh().section_multiplane((0, 0, 0), (0, 0, 1), layers.z)
    assert all(abs(a - b.area) <= SAME * b.area for a, b in zip(layers.areas, sections, strict=True))


def centers(layers, index) -> np.ndarray:
    """World positions of the pixels of an image, row by row."""
    width, height = layers.size
    x = layers.bounds[0, 0] + (np.arange(width) + 0.5) * layers.pixel[0]
    y = layers.bounds[0, 1] + (np.arange(height) + 0.5) * layers.pixel[1]
    grid = np.stack(np.meshgrid(x, y[::-1]), axis=-1).reshape(-1, 2)
    return np.c_[grid, np.full(len(grid), layers.z[index])]


@pytest.mark.parametrize("name", ["knot", "flipped_faces", "open_box", "overlapping_boxes", "nested_shells"])
def test_a_bright_pixel_is_exactly_the_inside(name):
    mesh = fb.Mesh(*{**meshes.CLOSED, **meshes.OPEN}[name]())
    size = np.ptp(mesh.bounds, axis=0)
    layers = fb.slices(mesh, size[2] / 3, pixel=size[:2] / (590, 570))
    count = 0
    for index in range(3):
        image = layers.image(index)
        assert ((image >= 128).ravel() == fb.contains(mesh, centers(layers, index))).all()
        count += image.size
    assert count >= 1_000_000


def ball_with_windows() -> meshes.Geometry:
    """A ball without a cap at two sides. Its winding number passes 1/2 many pixels away from the faces."""
    vertices, faces = meshes.icosphere(4)
    heights = vertices[faces].mean(axis=1)[:, 0]
    return vertices, faces[(heights < 0.6) & (heights > -0.9)]


def wrong_pixels(mesh, layers) -> int:
    sides = (fb.contains(mesh, centers(layers, index)) for index in range(len(layers)))
    return sum(((layers.image(i) >= 128).ravel() != inside).sum() for i, inside in enumerate(sides))


def test_the_side_changes_in_the_openings_of_a_mesh():
    mesh = fb.Mesh(*ball_with_windows())
    layers = fb.slices(mesh, 0.1, pixel=0.02)
    assert wrong_pixels(mesh, layers) == 0
    bright = sum((layers.image(i) >= 128).sum() for i in range(len(layers)))
    assert layers.areas.sum() == pytest.approx(bright * 0.02**2, rel=2e-3)


def test_the_side_changes_everywhere_in_loose_triangles():
    mesh = fb.Mesh(*meshes.soup(400))
    assert wrong_pixels(mesh, fb.slices(mesh, 0.1, pixel=0.02)) == 0


def test_the_side_changes_in_the_openings_of_a_real_mesh(model_path):
    mesh = fb.load_mesh(model_path("stanford-bunny.obj"))
    size = np.ptp(mesh.bounds, axis=0)
    layers = fb.slices(mesh, size[2] / 12, pixel=size[:2].max() / 150)
    assert wrong_pixels(mesh, layers) == 0


@pytest.mark.parametrize("depth", [1e-6, 1e-7, 1e-8, 1e-10, -1e-10, -1e-8, -1e-7])
@pytest.mark.parametrize("degrees", [0, 1, 45, 89])
def test_the_center_of_a_bright_pixel_is_just_inside(depth, degrees):
    """The middle of the wall x = 0.5 of a box, turned about y, is beside the centre of the pixel (0, 0)."""
    turned = fb.box(1).translate((-0.5, 0, 0)).rotate("y", degrees)
    solid = turned.translate((depth / np.cos(np.radians(degrees)), 0, 0))
    layers = fb.slices(solid, 0.1, pixel=0.05, bounds=[(-0.025, -0.025, -0.05), (0.025, 0.025, 0.05)])
    exact = solid.distance([(0, 0, 0)], dtype="float64")[0]
    assert (exact < 0) == (depth > 0)
    assert (layers.image(0)[0, 0] >= 128) == (depth > 0)


@pytest.mark.parametrize("field", [lambda solid: solid, lambda solid: fb.bake(solid, 32)])
def test_fields_of_any_scale_have_the_same_layers(field):
    solid = fb.sphere(1) | fb.box((1, 1, 0.5)).translate((1.5, 0, 0))
    truth = fb.slices(field(solid), 0.25, pixel=0.05)
    for factor in (1e-6, 1e-3):
        layers = fb.slices(field(solid.times(factor)), 0.25, pixel=0.05)
        assert layers.areas.tolist() == pytest.approx(truth.areas.tolist(), rel=1e-4)
        for index in range(len(truth)):
            different = (layers.image(index) >= 128) != (truth.image(index) >= 128)
            assert (np.abs(truth.image(index)[different] - 127.5) < 1).all()  # rounding at centres on the surface
    # No layer has so few pixels that it is traced in parts of pixels.
    one = fb.slices(fb.sphere(1), 0.25, pixel=0.02)
    mixed = fb.slices(fb.sphere(1).times(1e-6) | fb.sphere(1).translate((3, 0, 0)), 0.25, pixel=0.02)
    assert mixed.areas.tolist() == pytest.approx((2 * one.areas).tolist(), rel=1e-4)


@pytest.mark.parametrize("name", ["turned_box", "volume", "sparse"])
def test_images_are_distances_in_pixels(name):
    solid, _, _ = SHAPES[name]()
    layers = fb.slices(solid, 0.21, pixel=0.013)
    for index in (0, len(layers) // 2):
        points = centers(layers, index)
        found = solid.distance(points) if isinstance(solid, fb.Shape) else solid.sample(points)
        image = layers.image(index).ravel()
        assert ((image >= 128) == (found < 0)).all()
        # Half a step of rounding, and one step of the shift to the right side of 127.5.
        assert np.abs(image - 255 * np.clip(0.5 - found / 0.013, 0, 1)).max() <= 1.01


def test_images_on_a_device_are_those_of_the_cpu(gpu):
    mesh = fb.Mesh(*meshes.knot(48, 8))
    on_cpu, on_gpu = (fb.slices(mesh, 0.5, pixel=0.05, device=device).image(2) for device in ("cpu", gpu))
    assert ((on_cpu >= 128) == (on_gpu >= 128)).all()
    assert np.abs(on_cpu.astype(int) - on_gpu).max() <= 1


def test_row_zero_has_the_largest_y():
    corner = fb.box(1).translate((0.5, 0.5, 0.5))
    layers = fb.slices(corner, 1, pixel=(0.1, 0.2), bounds=[(0, 0, 0), (2, 3, 1)])
    image = layers.image(0)

    assert layers.size == (20, 15)
    assert image.shape == (15, 20)
    assert (image[10:, :10] >= 128).all()
    assert (image >= 128).sum() == 50
    assert layers.z.tolist() == [0.5]


@pytest.mark.parametrize(
    "solid",
    [
        lambda: fb.torus(2, 0.5),
        pipe,
        lambda: fb.box(2).rotate("z", 30) & fb.gyroid(0.8, 0.15),
        lambda: fb.Mesh(*meshes.knot(96, 10)),
        lambda: fb.Mesh(*meshes.overlapping_boxes()),
        lambda: fb.Mesh(*meshes.flip_some(meshes.icosphere(), 0.1)),
    ],
)
def test_loops_are_simple_nested_and_never_cross(solid):
    layers = fb.slices(solid(), 0.17, pixel=0.03)
    assert len(layers) > 3
    for index in range(len(layers)):
        rings = [shapely.LinearRing(loop) for loop in layers.outlines(index)]
        assert all(shapely.Polygon(ring).is_valid for ring in rings)
        for ring in rings:
            around = sum(shapely.Polygon(other).contains(ring) for other in rings if other is not ring)
            assert ring.is_ccw == (around % 2 == 0)
        assert not any(a.crosses(b) for i, a in enumerate(rings) for b in rings[:i])


def test_the_hole_of_a_pipe_is_clockwise():
    outer, hole = sorted(fb.slices(pipe(), 0.5, pixel=0.02).outlines(1), key=len, reverse=True)
    assert area(outer) > 0 > area(hole)


def test_vertices_lie_on_the_zero_level():
    solid = fb.Shape.union(fb.box(2).rotate("z", 30), fb.sphere(1.2), fb.torus(1.5, 0.2))
    layers = fb.slices(solid, 0.2, pixel=0.02)
    for index in range(len(layers)):
        flat = np.concatenate(layers.outlines(index))
        found = solid.distance(np.c_[flat, np.full(len(flat), layers.z[index])])
        assert np.abs(found).max() <= 1e-3 * 0.02


def test_bodies_that_overlap_are_united():
    """The boxes have faces in common planes, so no pair of faces passes through each other."""
    layers = fb.slices(fb.Mesh(*meshes.overlapping_boxes()), 0.5, pixel=0.05)
    assert layers.areas.tolist() == pytest.approx([6.0] * 4, rel=1e-6)


def test_an_open_mesh_is_closed_and_warns():
    with pytest.warns(fb.SurfaceWarning, match="boundary edges"):
        layers = fb.slices(fb.Mesh(*meshes.open_box()), 0.5, pixel=0.05)
    assert layers.areas[0] == pytest.approx(4, rel=1e-3)


def test_parts_of_a_shape_that_share_a_face_have_a_layer_there():
    stack = fb.box((2, 2, 1)).translate((0, 0, 0.5)) | fb.box((1, 1, 1)).translate((0, 0, 1.5))
    layers = fb.slices(stack, 0.4, pixel=0.05)
    assert layers.areas.tolist() == pytest.approx([4, 4, 1, 1, 1], rel=1e-5)
    assert (layers.image(2) >= 128).sum() == 400


def test_a_layer_between_the_sides_of_a_foil_is_inside():
    foil = fb.slices(fb.Mesh(*meshes.box((-5e3, -0.5, 0), (5e3, 0.5, 0.01))), 0.002, pixel=(50, 0.05))
    assert foil.areas.tolist() == pytest.approx([1e4] * 5)
    assert (foil.image(2) >= 128).sum() == 200 * 20


PLATE = fb.box((1, 1, 0.6))


@pytest.mark.parametrize(
    "solid",
    [PLATE, PLATE.rotate("z", 30), PLATE.times(1e-6), fb.bake(PLATE, 40), fb.bake(PLATE.times(1e-6), 40)],
)
def test_the_image_and_the_outlines_agree_in_a_flat_face(solid):
    for height in (0.3, 0.3 - 1e-10):
        flat = fb.slices(solid, 0.1, pixel=0.05, bounds=[(-1, -1, height - 0.05), (1, 1, height + 0.05)])
        assert flat.areas.tolist() == [0]
        assert flat.image(0).max() < 128


def test_a_layer_in_a_flat_face_is_sliced_outside_it():
    """The boxes meet at z = 0.5, the middle of the first layer, and the upper one ends in the middle of the last."""
    cubes = meshes.join(meshes.box((0, 0, 0), (2, 2, 0.5)), meshes.box((0.5, 0.5, 0.5), (1.5, 1.5, 2.5)))
    layers = fb.slices(fb.Mesh(*cubes), 1, pixel=0.05)
    assert layers.z.tolist() == [0.5, 1.5, 2.5]
    assert layers.areas.tolist() == pytest.approx([1, 1, 0])
    corners, faces = meshes.box()
    for solid in (fb.box(2), fb.Mesh(corners, faces), fb.box(2).to_mesh(32), fb.Mesh(corners, faces[:, ::-1])):
        flat = fb.slices(solid, 1, pixel=0.1, bounds=[(-1.5, -1.5, -1.5), (1.5, 1.5, 1.5)])
        assert flat.z.tolist() == [-1.0, 0.0, 1.0]
        # Outlines of fields lie within 1e-3 pixels of the surface, over a length of 8.
        assert flat.areas.tolist() == pytest.approx([0, 4, 0], abs=1e-3)
        assert [(flat.image(i) >= 128).sum() * 0.01 for i in range(3)] == pytest.approx([0, 4, 0])
    flat = fb.slices(fb.bake(meshes.box(), 33), 2, pixel=0.1, bounds=[(-1.5, -1.5, 0), (1.5, 1.5, 2)])
    # The samples of the field are rounded to float32.
    assert min(abs(flat.areas[0] - 4), abs(flat.areas[0])) <= 1e-3


def test_bounds_cut_the_outlines():
    box = [(0.0, -0.7, -0.5), (1.8, 0.8, 0.5)]
    half = shapely.box(0, -0.7, 1.8, 0.8)
    for solid in (fb.sphere(1).to_mesh(48), fb.sphere(1)):
        layers = fb.slices(solid, 0.25, pixel=0.02, bounds=box)
        for z, loops in zip(layers.z, map(layers.outlines, range(4)), strict=True):
            disk = shapely.Point(0, 0).buffer(np.sqrt(1 - z**2), 256)
            (loop,) = loops
            assert shapely.Polygon(loop).is_valid
            assert area(loop) == pytest.approx(half.intersection(disk).area, rel=2e-3)
    everywhere = fb.slices(fb.plane("z", 0), 0.5, pixel=0.1, bounds=[(0, 0, -1), (2, 1, 1)])
    assert everywhere.areas.tolist() == pytest.approx([2, 2, 0, 0])
    assert len(everywhere.outlines(0)[0]) == 4


def test_loops_are_cut_like_polygons_of_shapely():
    random = np.random.default_rng(5)
    for _ in range(100):
        angle = np.sort(random.uniform(0, 2 * np.pi, random.integers(5, 60)))
        star = np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.uniform(0.3, 1.5, len(angle))[:, None]
        hole = 0.1 * star[::-1]
        lower, upper = random.uniform(-1, 0, 2), random.uniform(0, 1, 2)
        whole = shapely.Polygon(star, [hole])
        if not whole.is_valid:
            continue
        found = cut([star, hole], lower, upper)
        truth = whole.intersection(shapely.box(*lower, *upper))
        assert sum(map(area, found)) == pytest.approx(truth.area, abs=1e-12)
        assert all(shapely.Polygon(loop).is_valid for loop in found)


def test_the_archive_has_a_manifest_and_images(tmp_path):
    layers = fb.slices(pipe(), 0.5, pixel=(0.02, 0.04))
    layers.save(tmp_path / "pipe.zip")
    with zipfile.ZipFile(tmp_path / "pipe.zip") as archive:
        names = archive.namelist()
        facts = json.loads(archive.read("manifest.json"))
        assert names == ["manifest.json", *(f"layer_{index:05}.png" for index in range(4))]
        for index, name in enumerate(names[1:]):
            with Image.open(io.BytesIO(archive.read(name))) as image:
                assert (image.size, image.mode) == (layers.size, "L")
                assert (np.asarray(image) == layers.image(index)).all()
    assert facts["z"] == layers.z.tolist()
    assert (facts["layer"], facts["pixel"], facts["size"]) == (0.5, [0.02, 0.04], [100, 50])
    assert (facts["bounds"], facts["unit"]) == (layers.bounds.tolist(), "millimeter")
    fb.slices(pipe(), 0.5, pixel=(0.02, 0.04)).save(tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == (tmp_path / "pipe.zip").read_bytes()


def test_the_svg_has_valid_polygons_and_opens_in_a_browser(tmp_path):
    layers = fb.slices(fb.box((3, 2, 1)).rotate("z", 20) - fb.cylinder(radius=0.5, height=3), 0.25, pixel=0.02)
    layers.save(tmp_path / "plate.svg")
    text = (tmp_path / "plate.svg").read_text()
    groups = re.findall(r'<g id="layer_\d+" data-z="([^"]+)"><path fill-rule="evenodd" d="([^"]*)"', text)

    assert [float(z) for z, _ in groups] == layers.z.tolist()
    for (_, path), truth in zip(groups, layers.areas, strict=True):
        rings = [
            [tuple(map(float, pair.split(","))) for pair in part.strip("M").split("L")] for part in path.split("Z")[:-1]
        ]
        hole, outer = sorted(rings, key=lambda ring: shapely.Polygon(ring).area)
        polygon = shapely.Polygon(outer, [hole])
        assert polygon.is_valid
        assert polygon.area == pytest.approx(truth)
    expression = """(() => {
      const paths = [...document.querySelectorAll("g[data-z] path")];
      const box = paths[0].getBBox();
      const point = (x, y) => { const p = document.documentElement.createSVGPoint(); p.x = x; p.y = y; return p; };
      const inside = [[0, 0], [1, 0], [1.6, -1.2]].map(([x, y]) => paths[1].isPointInFill(point(x, y)));
      return { count: paths.length, box: [box.width, box.height], inside };
    })()"""
    (page,) = visit([{"url": (tmp_path / "plate.svg").as_uri(), "expression": expression}])
    assert page.errors == []
    assert page.value["count"] == 4
    assert page.value["inside"] == [False, True, False]
    # Chromium measures in float32.
    assert page.value["box"] == pytest.approx(np.ptp(np.concatenate(layers.outlines(0)), axis=0), rel=1e-4)
    fb.slices(fb.box((3, 2, 1)).rotate("z", 20) - fb.cylinder(radius=0.5, height=3), 0.25, pixel=0.02).save(
        tmp_path / "again.svg"
    )
    assert (tmp_path / "again.svg").read_bytes() == (tmp_path / "plate.svg").read_bytes()


def test_layers_are_kept_and_pickle():
    layers = fb.slices(fb.sphere(1), 0.5, pixel=0.05)
    copy = pickle.loads(pickle.dumps(layers))
    assert layers.image(1) is layers.image(1)
    assert (copy.image(1) == layers.image(1)).all()
    assert copy.areas.tolist() == layers.areas.tolist()
    assert (layers.layer, layers.pixel, len(layers)) == (0.5, (0.05, 0.05), 4)
    assert repr(layers) == "Slices(4 layers of 0.5 units, 40 x 40 pixels)"
    assert "<path" in layers._repr_svg_()
    for array in (layers.image(0), layers.outlines(0)[0], layers.areas, layers.z, layers.bounds):
        assert not array.flags.writeable


def test_progress_reaches_one():
    shares: list[float] = []
    fb.slices(fb.sphere(1), 0.5, pixel=0.05, progress=shares.append).areas  # noqa: B018 - computes the areas
    assert shares == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"layer": 0}, fb.ArgumentError, "layer: must be a finite number above 0"),
        ({"layer": 1e-9}, fb.ArgumentError, "layer: .* are more than"),
        ({"pixel": -1}, fb.ArgumentError, "pixel: must be a finite number above 0"),
        ({"pixel": (1, 2, 3)}, fb.ArgumentError, "pixel: must have shape"),
        ({"pixel": "fine"}, fb.ArgumentError, "pixel: must be a finite number"),
        ({"pixel": 1e-5}, fb.ArgumentError, r"pixel: 200000 x 200000 pixels are more than 2\^31"),
        ({"bounds": [(0, 0, 0), (1, 0, 1)]}, fb.ArgumentError, "bounds: the upper corner must exceed"),
        ({"geometry": fb.plane("z", 0)}, fb.ShapeError, "bounds"),
        ({"geometry": fb.Mesh(*meshes.flat_sheet())}, fb.ArgumentError, "bounds: the upper corner must exceed"),
        ({"geometry": 3}, fb.MeshError, "3"),
        ({"device": "abacus"}, fb.DeviceError, "device: 'abacus' is unknown"),
        ({"device": 7}, fb.ArgumentError, "device: must be text"),
    ],
)
def test_mistakes_name_the_argument(options, kind, words):
    given = {"geometry": fb.sphere(1), "layer": 0.1, "pixel": 0.1, **options}
    with pytest.raises(kind, match=words):
        fb.slices(given.pop("geometry"), given.pop("layer"), **given)


def test_mistakes_of_layers_and_files(tmp_path):
    layers = fb.slices(fb.sphere(1), 0.5, pixel=0.1)
    with pytest.raises(fb.ArgumentError, match="index: must be from 0 to 3, got 4"):
        layers.image(4)
    with pytest.raises(fb.FormatError, match=r"written as .zip or .svg, got the ending '.png'"):
        layers.save(tmp_path / "ball.png")


def test_images_that_do_not_fit_are_refused(monkeypatch):
    def refuse(what, needed, advice):
        raise fb.CapacityError(f"{what}: {needed} bytes; {advice}")

    layers = fb.slices(fb.sphere(1), 1, pixel=2 / 40_000)
    monkeypatch.setattr("fieldbake._core.require_memory", refuse)
    with pytest.raises(fb.CapacityError, match="a layer of 40000 x 40000 pixels: 44800000000 bytes; use larger pixels"):
        layers.image(0)


def test_the_areas_of_layers_of_few_pixels_are_exact():
    """The last layers below the tip of a cone are six and two pixels across."""
    layers = fb.slices(fb.cone(1, 2), 2 / 50, pixel=2 / 200, bounds=[(-1, -1, -1), (1, 1, 1)])
    radii = (1 - layers.z) / 2
    assert radii[-1] == pytest.approx(0.01)
    assert np.abs(layers.areas / (np.pi * radii**2) - 1).max() <= 1e-3
