"""Shapes: primitives against points on their surface, the language, decomposition, pictures, and errors."""

import functools
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from typer.testing import CliRunner

import fieldbake as fb
import truth_csg as truth
import truth_trees
from fieldbake.cli.application import app

#: The tree of the article.
ARTICLE = "(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))"

#: A float32 distance of up to 4 units, rounded once.
ROUNDING = 4 * 2.0**-24


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(3).uniform(-1.6, 1.6, (3000, 3))


# --- primitives


@pytest.mark.parametrize("solid", truth.SOLIDS, ids=lambda solid: solid.name)
def test_primitives_have_the_right_sign_and_distance(solid, points):
    distance = solid.shape.distance(points).astype(float)
    to_samples, _ = cKDTree(solid.surface).query(points)

    assert ((distance < 0) == solid.inside(points)).all()
    # Samples lie on the surface: none is nearer than the surface. One lies within the gap of the nearest point.
    assert (np.abs(distance) <= to_samples + ROUNDING).all()
    if solid.shape.exact:
        assert (np.abs(distance) >= to_samples - solid.gap).all()


@pytest.mark.parametrize("solid", truth.SOLIDS, ids=lambda solid: solid.name)
def test_exact_fields_have_unit_slope(solid, points):
    if not solid.shape.exact:
        pytest.skip("declared a bound")
    slopes = np.linalg.norm(solid.shape.gradient(points), axis=1)

    # But for the few points whose difference stencil, 1e-5 wide, straddles a crease.
    assert (np.abs(slopes - 1) < 1e-5).mean() > 0.998


@pytest.mark.parametrize("solid", truth.SOLIDS, ids=lambda solid: solid.name)
def test_boxes_are_tight_under_any_turn(solid):
    if solid.name == "thread":
        pytest.skip("the box of the rod is the box of its cylinder")
    shape = solid.shape.rotate((1, 2, -1), 37).translate((0.3, -2, 5))
    surface = solid.surface @ truth_trees.turn((1, 2, -1), 37).T + (0.3, -2, 5)

    assert (surface >= shape.bounds[0] - 1e-12).all()
    assert (surface <= shape.bounds[1] + 1e-12).all()
    assert np.abs(shape.bounds - (surface.min(axis=0), surface.max(axis=0))).max() <= solid.gap


@pytest.mark.parametrize(("name", "shape", "inside"), truth.MEMBERSHIPS, ids=lambda value: str(value)[:12])
def test_frames_and_rounded_boxes_have_the_right_sign(name, shape, inside, points):
    assert ((shape.distance(points) < 0) == inside(points)).all()


def test_a_gyroid_sheet_is_a_bound():
    shape = fb.gyroid(1.0, 0.1)
    random = np.random.default_rng(1)
    first = random.uniform(-2, 2, (4000, 3))
    second = first + random.normal(0, 0.05, first.shape)
    change = np.abs(shape.distance(first).astype(float) - shape.distance(second))

    assert (change <= np.linalg.norm(first - second, axis=1) + ROUNDING).all()
    # On the gyroid itself the sheet is half its thickness deep.
    assert shape.distance([(0, 0, 0)])[0] == pytest.approx(-0.05, abs=1e-7)


def test_far_and_tiny_shapes_keep_their_accuracy():
    shape = fb.torus(1e-6, 2e-7).translate((1e3, 0, 0))
    assert shape.distance([(1e3, 0, 0)])[0] == pytest.approx(8e-7, rel=1e-6)
    assert fb.sphere(1e20).distance([(3e20, 0, 0)])[0] == pytest.approx(2e20, rel=1e-6)


# --- operators and changes


def test_operators_are_the_named_ones():
    a, b = fb.sphere(1), fb.box((1, 1, 3))
    assert a | b == a.union(b) == fb.Shape.union(a, b)
    assert a & b == fb.Shape.intersection(a, b)
    assert a - b == fb.Shape.difference(a, b)
    assert a ^ b == a.xor(b)
    assert (a | b).smooth(0.2) == a.union(b, k=0.2)
    assert (a - b).chamfer(0.2) == a.difference(b, chamfer=0.2)
    assert (~a).distance([(0, 0, 0)])[0] == 1


def test_rotation_is_right_handed():
    shape = fb.sphere(0.1).translate((1, 0, 0)).rotate("z", 90)
    assert shape.distance([(0, 1, 0)])[0] == pytest.approx(-0.1)


def test_repeat_is_a_union_of_copies():
    row = fb.sphere(0.3).repeat((1, 0, 0), (4, 1, 1))
    centres = np.array([(x, 0, 0) for x in (-1.5, -0.5, 0.5, 1.5)])
    points = np.random.default_rng(0).uniform(-2, 2, (200, 3))
    expected = np.linalg.norm(points[:, None] - centres, axis=-1).min(axis=1) - 0.3

    assert np.abs(row.distance(points) - expected).max() <= ROUNDING


def test_align_moves_by_the_box_without_fillets():
    blended = fb.box(1).union(fb.box(1).translate((1.2, 0, 0)), k=0.8)
    assert blended.bounds[0, 0] == -0.5
    moved = blended.align((-1, -1, -1))
    assert np.abs(moved.distance([(0, 0.5, 0.5)])).max() < 1e-6
    assert fb.csg.parse("(align 0 0 0 (move-x 10 (cube 1)))").bounds.tolist() == fb.box(1).bounds.tolist()


def test_a_bent_bar_bends_and_never_overestimates():
    # About z by 20 degrees a unit of x: the tip of the bar, 2 units out, rises.
    bent = fb.box((4, 0.4, 0.4)).bend(per_unit_deg=20)
    assert bent.distance([(0, 0, 0)])[0] < 0
    points = np.random.default_rng(5).uniform(-2.5, 2.5, (3000, 3))
    inside = bent.distance(points) < 0
    assert (bent.bounds[0] <= points[inside].min(axis=0)).all()
    assert (bent.bounds[1] >= points[inside].max(axis=0)).all()
    # The distance to the nearest inside sample is no less than what the field claims.
    nearest, _ = cKDTree(points[inside]).query(points[~inside])
    assert (bent.distance(points[~inside]) <= nearest).all()


def test_pitch_and_radius_are_lengths_of_a_deformation():
    bar, points = fb.box((1, 0.5, 4)), np.random.default_rng(6).uniform(-2, 2, (500, 3))
    for deformed, angle in (
        (bar.twist(pitch=8), lambda p: 2 * np.pi * p[:, 2] / 8),
        (bar.twist(pitch=-8), lambda p: -2 * np.pi * p[:, 2] / 8),
        (bar.twist(per_unit_deg=45), lambda p: np.radians(45) * p[:, 2]),
        (bar.bend(radius=5), lambda p: p[:, 0] / 5),
        (bar.bend(per_unit_deg=-10), lambda p: np.radians(-10) * p[:, 0]),
    ):
        # The inside of the deformed solid, by the rotation of each point back to the bar.
        back = -angle(points)
        x, y, z = points.T
        turned = np.stack([np.cos(back) * x - np.sin(back) * y, np.sin(back) * x + np.cos(back) * y, z], axis=-1)
        assert np.array_equal(deformed.distance(points) < 0, bar.distance(turned) < 0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda ball: ball.twist(), "per_unit_deg, pitch: exactly one of the two must be given, got none"),
        (lambda ball: ball.twist(per_unit_deg=1, pitch=1), "per_unit_deg, pitch: exactly one .* got both"),
        (lambda ball: ball.twist(pitch=0), "pitch: must not be 0"),
        (lambda ball: ball.twist(pitch=float("nan")), "pitch: must be a finite number"),
        (lambda ball: ball.bend(), "per_unit_deg, radius: exactly one of the two must be given, got none"),
        (lambda ball: ball.bend(radius=0), "radius: must not be 0"),
        (lambda ball: ball.bend(radius="2"), "radius: must be a finite number"),
        (lambda ball: ball.bend(per_unit_deg=float("inf")), "per_unit_deg: must be a finite number"),
    ],
)
def test_deformations_take_one_measure(call, message):
    with pytest.raises(fb.ShapeError, match=f"^{message}"):
        call(fb.sphere())


def test_volumes_are_leaves():
    volume = fb.bake(fb.sphere(1.0), 48)
    ball = fb.volume_shape(volume)
    points = np.random.default_rng(2).uniform(-1, 1, (500, 3))
    assert np.abs(ball.distance(points) - volume.sample(points)).max() <= 1e-6
    far = np.random.default_rng(2).normal(0, 3, (500, 3))
    far = far[np.abs(far).max(axis=1) > 1.2]
    assert (ball.distance(far) <= np.linalg.norm(far, axis=1) - 1 + 1e-3).all()
    assert ((ball - fb.box(1)).distance([(0, 0, 0)]) > 0).all()
    with pytest.raises(fb.ShapeError, match="baked volume"):
        ball.to_sexpr()


# --- paint


def test_paint_goes_to_what_is_not_painted():
    red, blue = (1, 0, 0), (0, 0, 1)
    pair = fb.sphere(1).paint(red) | fb.sphere(1).translate((3, 0, 0))
    ends = [(1, 0, 0), (4, 0, 0)]
    assert np.isnan(fb.sphere(1).color(ends)).all()
    assert pair.paint(blue).color(ends).tolist() == [[1, 0, 0], [0, 0, 1]]
    assert pair.paint(blue, over=True).color(ends).tolist() == [[0, 0, 1], [0, 0, 1]]


def test_stencil_and_mask_paint_inside_and_outside():
    ball = fb.sphere(1).paint((1, 1, 1))
    half = fb.plane("x")
    ends = [(-1, 0, 0), (1, 0, 0)]
    assert ball.stencil(half, (1, 0, 0)).color(ends).tolist() == [[1, 0, 0], [1, 1, 1]]
    assert ball.mask(half, (1, 0, 0)).color(ends).tolist() == [[1, 1, 1], [1, 0, 0]]
    # The stencil moves with the shape.
    moved = ball.stencil(half, (1, 0, 0)).translate((5, 0, 0))
    assert moved.color([(4, 0, 0), (6, 0, 0)]).tolist() == [[1, 0, 0], [1, 1, 1]]


def test_pictures_are_painted():
    shape = fb.sphere(1).paint((0.9, 0.1, 0.1))
    camera = fb.Camera((0, 0, 4), (0, 0, 0))
    red, green, _ = fb.raymarch(shape, camera, size=(9, 9), device="cpu").color[4, 4, :3]
    assert red > 3 * green


# --- baking


def test_baking_samples_the_field():
    shape = fb.torus(1, 0.3).rotate("x", 30) - fb.box(1)
    volume = fb.bake(shape, 24)
    centres = volume.bounds[0] + (np.argwhere(np.ones(volume.resolution)) + 0.5) * volume.spacing
    expected = shape.distance(centres).reshape(volume.resolution)
    assert np.abs(volume.distances - expected).max() <= 1e-6
    assert (volume.inner_bounds == shape.bounds).all()
    assert volume.report.sign_method == "shape"


def test_a_list_of_shapes_is_baked_as_their_union():
    a, b = fb.sphere(0.5), fb.box(0.5).translate((1, 0, 0))
    assert (fb.bake([a, b], 16).distances == fb.bake(a | b, 16).distances).all()


def test_what_means_nothing_for_a_shape_is_refused():
    for options in ({"sign": "parity"}, {"band": 3}, {"two_sided": True}):
        with pytest.raises(fb.ArgumentError, match=next(iter(options))):
            fb.bake(fb.sphere(), 8, **options)


def test_without_bounds_the_leaf_is_named():
    for shape in (fb.plane("z"), fb.box(1) | fb.gyroid(1, 0.1), ~fb.sphere(1)):
        with pytest.raises(fb.ShapeError, match=r"plane|gyroid|complement"):
            _ = shape.bounds
        with pytest.raises(fb.ShapeError, match="no bounds"):
            fb.bake(shape)
        with pytest.raises(fb.ShapeError, match="no bounds"):
            fb.raymarch(shape)
        with pytest.raises(fb.ShapeError, match="no bounds"):
            fb.csg.decompose(shape)
    assert fb.bake(fb.plane("z"), 8, bounds=[(-1, -1, -1), (1, 1, 1)]).sample([(0, 0, 0)])[0] == pytest.approx(
        0, abs=1e-6
    )
    assert (fb.box(1) & fb.plane("z")).bounds.tolist() == [[-0.5, -0.5, -0.5], [0.5, 0.5, 0.0]]


# --- decomposition


def test_the_article_gives_three_parts():
    parts = fb.csg.decompose(fb.csg.parse(ARTICLE), method="aabb")
    counts = {part.shape.to_sexpr(): len(part.boxes) for part in parts}
    assert counts == {"(cube 3)": 1, "(cube 4)": 7, "(diff (cube 4) (move -2 -2 2 (sphere 5)))": 1}
    # The cubes differ in a number alone.
    assert parts.structures == 2


def test_an_empty_shape_has_no_parts_and_an_empty_picture():
    nothing = fb.sphere(1) & fb.sphere(1).translate((5, 0, 0))
    assert fb.csg.decompose(nothing) == []
    frame = fb.raymarch(nothing, fb.Camera((0, 0, 5), (0, 0, 0)), size=(8, 8))
    assert np.isinf(frame.depth).all()


@pytest.mark.parametrize("call", [lambda e: e.to_mesh(8), fb.bake, fb.raymarch, lambda e: e.save("empty.stl")])
def test_an_empty_shape_is_named_as_such(call):
    with pytest.raises(fb.Error, match=r"empty.*parts do not overlap"):
        call(fb.sphere(1) & fb.sphere(1).translate((5, 0, 0)))


def test_a_thousand_leaves_fall_into_small_parts():
    random = np.random.default_rng(0)
    shape = fb.Shape.union(*(fb.sphere(0.1).translate(random.uniform(-2, 2, 3)) for _ in range(1000)))
    parts = fb.csg.decompose(shape)
    assert max(part.shape._core.leaf_count for part in parts) < 20
    assert parts.structures < 20


@pytest.mark.parametrize("method", ["aabb", "octree"])
def test_points_in_no_box_are_outside_or_wholly_inside(method):
    random = np.random.default_rng(3)
    shape = fb.box(2) | fb.Shape.union(*(fb.sphere(0.3).translate(random.uniform(-1.5, 1.5, 3)) for _ in range(40)))
    points = random.uniform(*shape.bounds, (4000, 3))
    boxes = np.concatenate([part.boxes for part in fb.csg.decompose(shape, method=method)])
    in_box = ((points[:, None] >= boxes[:, 0]) & (points[:, None] < boxes[:, 1])).all(axis=-1).any(axis=1)
    distances = shape.distance(points)
    # The boxes of "octree" leave out cells in which the field keeps its sign, the boxes of "aabb" none inside.
    inside = ~in_box & (distances < 0)
    assert inside.any() == (method == "octree")
    assert np.abs(distances[inside]).min(initial=1) > 0.01


def test_the_middle_planes_of_cells_have_no_holes():
    frame = fb.raymarch(fb.box(2), fb.Camera((0, 0, 5), (0, 0, 0), fov_deg=10), size=(65, 65))
    assert np.abs(frame.depth - 4).max() < 1e-5


# --- the language


@pytest.mark.parametrize(
    "text",
    [
        ARTICLE,
        "(blend union 0.5 (sphere 1) (move 1 0 0 (ellipsoid 1 2 3)) (torus 3 1))",
        "(chamfer diff 0.25 (box 1 2 3) (rotate-x 90 (cylinder 0.5 4)) (cone 1 2))",
        "(inter (plane 0 0 1) (coninder 2 1 3) (capsule 1 2) (rounded-box 2 2 2 0.25))",
        "(xor (box-frame 2 2 2 0.125) (capped-torus 3 0.5 180) (pyramid 2 2) (octahedron 2))",
        "(repeat 1 0 0 3 1 1 (shell 0.125 (flate 0.25 (scale 2 (elongate 0.5 0 0 (cube 1))))))",
        "(twist 30 (bend 10 (extrude 2 (polygon 0 0 1 0 0 1))))",
        "(mirror 1 0 0 (reflect 0 1 0 (revolve 1 (rectangle 0.5 0.25))))",
        "(stencil 1 0 0 (paint 0 1 0 (cube 1)) (not (sphere 1)))",
        "(diff (gyroid 1 0.125) (revolve 0 (circle 1)))",
    ],
)
def test_what_is_written_reads_back(text):
    shape = fb.csg.parse(text)
    assert shape.to_sexpr() == text
    assert fb.csg.parse(shape.to_sexpr()) == shape


def test_sizes_are_full_lengths_and_diameters():
    assert fb.csg.parse("(sphere 5)") == fb.sphere(2.5)
    assert fb.csg.parse("(torus 3 1)") == fb.torus(1, 0.5)
    assert fb.csg.parse("(cylinder 3 5)") == fb.cylinder(1.5, 5)
    assert fb.csg.parse("(coninder 2 1 3)") == fb.truncated_cone(1, 0.5, 3)
    assert fb.csg.parse("'(move_z 1 ; a comment\n (rotate_y 45 (cube 2)))") == fb.box(2).rotate("y", 45).translate(
        (0, 0, 1)
    )


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ("", "line 1, column 1", "empty"),
        ("(sphere 1", "line 1, column 1", "never closed"),
        ("(sphere 1))", "line 1, column 11", "ends before"),
        (")", "line 1, column 1", "closes nothing"),
        ("(union (cube 1)\n  (spere 2))", "line 2, column 3", "'spere'"),
        ("(cube 1 2)", "line 1, column 1", "cube does not take 2 numbers"),
        ("(cube x)", "line 1, column 1", "does not take 'x'"),
        ("(cube 1x)", "line 1, column 7", "'1x' is no number"),
        ("(cube -1)", "line 1, column 1", "size must be a number above 0, got -1"),
        ("(move 1 2 3)", "line 1, column 1", "takes one shape, got 0"),
        ("(union)", "line 1, column 1", "at least 1, got 0"),
        ("()", "line 1, column 1", "expected a name"),
        ("hello", "line 1, column 1", "expected '('"),
        ("(blend onion 1 (cube 1))", "line 1, column 1", "union, inter, diff or xor"),
        ("(extrude 1 (cube 1))", "line 1, column 1", "circle, rectangle, polygon"),
        ("(union (circle 1) (cube 1))", "line 1, column 1", "flat profile"),
        ("(cube 1e999)", "line 1, column 7", "no number"),
    ],
)
def test_mistakes_are_placed_and_named(text, where, what):
    with pytest.raises(fb.ShapeError) as caught:
        fb.csg.parse(text)
    assert where in str(caught.value)
    assert what in str(caught.value)


WORDS = st.sampled_from(
    ["(", ")", "union", "diff", "blend", "sphere", "cube", "move", "polygon", "extrude", "paint", "#ff00ff", "1",
    "-2.5",
     "0", "1e300", "nan", "'", ";", "\n", "align", "twist", "not", "repeat", "circle", "é", "\x00", "(sphere 1)"]
)  # fmt: skip


@given(st.one_of(st.text(max_size=60), st.lists(WORDS, max_size=40).map(" ".join)))
def test_any_text_is_read_or_refused(text):
    try:
        shape = fb.csg.parse(text)
    except fb.ShapeError:
        return
    assert fb.csg.parse(shape.to_sexpr()) == shape


def test_nesting_is_limited_by_memory_alone():
    depth = 100_000
    with pytest.raises(fb.ShapeError, match="100000 are open"):
        fb.csg.parse("(" * depth)
    with pytest.raises(fb.ShapeError):
        fb.csg.parse("(union " * depth + ")" * depth)
    deep = fb.csg.parse("(move-x 1 " * depth + "(sphere 2)" + ")" * depth)
    assert deep.distance([(depth, 0, 0)])[0] == -1
    assert deep == fb.csg.parse(deep.to_sexpr())


def test_deep_and_lopsided_trees_are_built_asked_and_dropped():
    shape = fb.sphere(1)
    for i in range(20_000):
        other = fb.sphere(0.5).translate((i % 10, 0, 0))
        shape = other - shape if i % 2 else shape | other
    assert np.isfinite(shape.distance([(1, 2, 3)])).all()
    assert np.isfinite(shape.bounds).all()
    del shape


def test_a_shape_in_itself_many_times_is_refused_before_it_explodes():
    shape = fb.sphere(1)
    with pytest.raises(fb.ShapeError, match="more leaves than the limit"):
        shape = functools.reduce(lambda shape, _: shape | shape, range(100), shape)


# --- shaders


def test_shaders_share_a_text_and_differ_in_numbers():
    def model(radius):
        return fb.box(1) - fb.sphere(radius).translate((radius, 0, 0))

    assert model(0.5).shader("wgsl") == model(0.7).shader("wgsl")
    assert not np.array_equal(model(0.5).shader_numbers(), model(0.7).shader_numbers())
    assert "fn distance_to_shape" in model(0.5).shader()
    for language, word in (("glsl", "void main"), ("hlsl", "numthreads"), ("msl", "kernel")):
        assert word in fb.csg.parse(ARTICLE).shader(language)
    with pytest.raises(fb.ShapeError, match="language"):
        fb.sphere().shader("cg")
    with pytest.raises(fb.ShapeError, match="volume"):
        fb.volume_shape(fb.bake(fb.sphere(), 8)).shader()


@pytest.mark.parametrize("solid", truth.SOLIDS, ids=lambda solid: solid.name)
def test_every_primitive_has_a_shader(solid):
    # Translating it parses and validates it.
    text = solid.shape.to_sexpr()
    text = f"(blend union 0.1 (mirror 1 0 0 (flate 0.1 (twist 20 {text}))) (not (shell 0.1 {text})))"
    with pytest.warns(fb.SurfaceWarning, match="flate, shell or blend"):
        changed = fb.csg.parse(text)
    assert "main" in changed.shader("msl")


# --- examples and the command line

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "csg").glob("*.csg"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_read_and_drawn(path):
    shape = fb.csg.parse(path.read_text(encoding="utf-8"))
    camera = fb.Camera.fit(shape.bounds, direction=(-0.6, 0.8, -0.6), up=(0, 0, 1))
    frame = fb.raymarch(shape, camera, size=(24, 24), device="cpu")
    # A chain is thin: it covers a fifteenth of its picture.
    assert np.isfinite(frame.depth).mean() > 0.03


def test_there_are_examples_large_and_small():
    leaves = [fb.csg.parse(path.read_text(encoding="utf-8"))._core.leaf_count for path in EXAMPLES]
    assert len(leaves) >= 9
    assert max(leaves) > 1000


def test_the_command_line_draws_bakes_and_meshes(tmp_path):
    model = tmp_path / "model.csg"
    model.write_text(ARTICLE)
    runner = CliRunner()
    for name in ("out.png", "out.npz", "out.stl"):
        result = runner.invoke(app, ["csg", str(model), "-o", str(tmp_path / name), "--size", "32x24", "-r", "16"])
        assert result.exit_code == 0, result.output
    assert fb.load(tmp_path / "out.npz").resolution == (16, 16, 16)
    assert len(fb.load_mesh(tmp_path / "out.stl").faces) > 100
    listed = runner.invoke(app, ["csg", str(model), "-o", str(tmp_path / "a.png"), "--method", "aabb", "--parts"])
    assert "3 parts" in listed.output
    model.write_text("(cube")
    assert runner.invoke(app, ["csg", str(model), "-o", "x.png"]).exit_code == 1


# --- what is refused


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: fb.sphere(0), "radius"),
        (lambda: fb.sphere(float("nan")), "radius"),
        (lambda: fb.sphere("1"), "radius"),
        (lambda: fb.box((1, 2)), "size"),
        (lambda: fb.box((1, 2, -3)), "size"),
        (lambda: fb.rounded_box((1, 1, 1), 0.6), "radius"),
        (lambda: fb.capped_torus(1, 0.2, 400), "angle_deg"),
        (lambda: fb.cone(0, 1), "radius"),
        (lambda: fb.plane((0, 0, 0)), "normal"),
        (lambda: fb.polygon([(0, 0), (1, 1)]), "points"),
        (lambda: fb.polygon([(0, 0), (1, 1), (2, 2)]), "points"),
        (lambda: fb.circle(1).revolve(-2), "offset"),
        (lambda: fb.volume_shape(3), "volume"),
        (lambda: fb.sphere().translate((1, 2)), "offset"),
        (lambda: fb.sphere().rotate("w", 3), "axis"),
        (lambda: fb.sphere().scale(0), "factor"),
        (lambda: fb.sphere().repeat((1, 1, 1), (0, 1, 1)), "counts"),
        (lambda: fb.sphere().shell(0), "thickness"),
        (lambda: fb.sphere().paint((1, 0)), "color"),
        (lambda: fb.sphere().smooth(0.1), "shape"),
        (lambda: fb.Shape.union(fb.sphere(), fb.sphere(), k=0.1, chamfer=0.1), "chamfer"),
        (lambda: fb.Shape.union(fb.sphere(), 3), r"shapes\[1\]"),
        (lambda: fb.csg.decompose(fb.sphere(), method="quadtree"), "method"),
        (lambda: fb.raymarch(fb.sphere(), method="quadtree"), "method"),
        (lambda: fb.plane().twist(per_unit_deg=20).bounds, "shape"),
        (lambda: fb.csg.parse(3), "text"),
    ],
)
def test_mistakes_name_the_argument(make, named):
    with pytest.raises(fb.ShapeError, match=f"^{named}: "):
        make()


def test_shapes_do_not_change():
    shape = fb.sphere(1)
    with pytest.raises(AttributeError):
        shape.radius = 2
    with pytest.raises(TypeError):
        _ = shape | 3
    assert pickle.loads(pickle.dumps(shape.translate((1, 2, 3)))) == shape.translate((1, 2, 3))
    assert "sphere" in repr(shape)


def test_turned_and_nested_shapes_are_equal_to_their_copies(tmp_path) -> None:
    random, shape = np.random.default_rng(8), fb.box((1, 2, 3))
    for _ in range(200):
        axis, angle = random.normal(size=3), random.uniform(-800, 800)
        turned = shape.rotate(axis, angle)
        copy = pickle.loads(pickle.dumps(turned))
        assert copy == turned
        assert copy.to_sexpr() == turned.to_sexpr()
        # Rodrigues' formula.
        x, y, z = axis / np.linalg.norm(axis)
        cross, radians = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.radians(angle)
        rotation = np.eye(3) + np.sin(radians) * cross + (1 - np.cos(radians)) * cross @ cross
        points = random.normal(size=(20, 3))
        error = turned.distance(points @ rotation.T) - shape.distance(points)
        assert np.abs(error).max() <= 1e-12
    turned.save(tmp_path / "turned.3mf", implicit=True)
    assert fb.load(tmp_path / "turned.3mf").to_sexpr() == turned.to_sexpr()
    nested = fb.box() & fb.sphere(0.6) & fb.torus(0.4, 0.2)
    assert pickle.loads(pickle.dumps(nested)) == nested
    assert nested != fb.box() & (fb.sphere(0.6) & fb.torus(0.4, 0.2))
    assert fb.box().rotate((0, 0, -1), 30) == fb.box().rotate((0, 0, 1), -30)


@pytest.mark.parametrize("call", [lambda shape: shape.to_mesh(16), lambda shape: fb.bake(shape, 16)])
def test_a_shape_of_parts_that_do_not_overlap_has_no_grid(call):
    with pytest.raises(fb.ArgumentError, match="parts do not overlap"):
        call(fb.sphere() & fb.sphere().translate((5, 0, 0)))
