"""Shapes between points, arrays, Booleans of profiles, volumes as operands, Python text of shapes, and mesh files."""

import copy
import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes
from manifold import faults

RANDOM = np.random.default_rng(5)
POINTS = RANDOM.uniform(-3, 3, (4000, 3))


def to_segment(points, a, b):
    a, b = np.asarray(a, float), np.asarray(b, float)
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)


@pytest.mark.parametrize(("a", "b"), [((0, 0, 0), (1, 2, 1)), ((1, 0, 0), (1, 0, -2)), ((0.5, -1, 0), (0.5, 1, 0))])
def test_round_primitives_lie_between_two_points(a, b):
    a, b = np.array(a, float), np.array(b, float)
    assert np.abs(fb.capsule(a, b, 0.4).distance(POINTS) - (to_segment(POINTS, a, b) - 0.4)).max() <= 1e-5
    axis = (b - a) / np.linalg.norm(b - a)
    along = (POINTS - a) @ axis
    across = np.linalg.norm(POINTS - a - along[:, None] * axis, axis=1)
    within = (along >= 0) & (along <= np.linalg.norm(b - a))
    length = np.linalg.norm(b - a)
    assert ((fb.cylinder(a, b, 0.7).distance(POINTS) < 0) == (within & (across < 0.7))).all()
    assert ((fb.cone(a, b, 0.7).distance(POINTS) < 0) == (within & (across < 0.7 * (1 - along / length)))).all()
    radius = 0.7 + (0.2 - 0.7) * along / length
    assert ((fb.cone(a, b, 0.7, 0.2).distance(POINTS) < 0) == (within & (across < radius))).all()


@pytest.mark.parametrize(
    "call",
    [
        lambda: fb.capsule((0, 0, 0), (0, 0, 0), 1),
        lambda: fb.capsule((0, 0, 0), (0, 0, 1)),
        lambda: fb.capsule((0, 0), (0, 1), 1),
        lambda: fb.cylinder(1, 2, 3),
        lambda: fb.cylinder((0, 0, 0), (0, 0, 1), 1, 2),
        lambda: fb.cone((0, 0, 0), (0, 0, float("nan")), 1),
        lambda: fb.sphere().orient("w"),
        lambda: fb.sphere().orient((0, 0, 0)),
        lambda: fb.sphere().circular_array(0),
        lambda: fb.sphere().circular_array(2.5),
        lambda: fb.sphere().union(3),
        lambda: fb.sphere().rotate(90, "x"),
        lambda: fb.circle(1).scale(0),
    ],
)
def test_mistakes_name_the_argument(call):
    with pytest.raises(fb.ShapeError, match=r"^\w+(\[\d\])?:"):
        call()


@pytest.mark.parametrize("axis", ["x", "-x", "y", "z", "-z", (1, 2, -3)])
def test_orient_turns_z_to_the_axis(axis):
    part = fb.cylinder(0.3, 2).translate((0, 0, 2))
    letters = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    direction = np.array(letters[axis[-1]], float) * (-1 if axis[0] == "-" else 1) if isinstance(axis, str) else axis
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    assert part.orient(axis).distance([2 * direction])[0] == pytest.approx(-0.3, abs=1e-5)
    assert part.orient(axis).distance([3.5 * direction])[0] == pytest.approx(0.5, abs=1e-5)


def test_a_circular_array_has_copies_at_equal_angles():
    ring = fb.sphere(0.3).circular_array(5, 2)
    angles = np.radians(72) * np.arange(5)
    centres = np.stack([2 * np.cos(angles), 2 * np.sin(angles), 0 * angles], axis=1)
    truth = np.linalg.norm(POINTS[:, None] - centres, axis=2).min(axis=1) - 0.3
    assert np.abs(ring.distance(POINTS) - truth).max() <= 1e-5


@pytest.mark.parametrize("sign", [-1, 1])
def test_no_film_closes_the_hole_of_a_profile(sign):
    holes = (fb.circle(1) - fb.circle(0.4), fb.circle(1) ^ fb.circle(0.4))

    for profile in holes:
        # The axis of the hole is 0.4 away from its wall, also in the planes of both end faces.
        assert profile.extrude(1).distance([(0, 0, sign * 0.5), (0, 0, 0)]) == pytest.approx([0.4, 0.4], abs=1e-6)


def test_profiles_are_combined_and_moved():
    washer = fb.circle(1) - fb.circle(0.4).translate((0.2, 0))
    solid = washer.extrude(1)
    x, y, z = POINTS.T
    truth = (np.hypot(x, y) < 1) & ~(np.hypot(x - 0.2, y) < 0.4) & (np.abs(z) < 0.5)
    assert ((solid.distance(POINTS) < 0) == truth).all()

    frame = (fb.rectangle((2, 1)) ^ fb.rectangle((1, 0.5))).rotate(30).scale(1.5).translate((0.3, -0.2))
    turn = np.radians(30)
    u = ((x - 0.3) * np.cos(turn) + (y + 0.2) * np.sin(turn)) / 1.5
    v = (-(x - 0.3) * np.sin(turn) + (y + 0.2) * np.cos(turn)) / 1.5
    truth = ((np.abs(u) < 1) & (np.abs(v) < 0.5)) ^ ((np.abs(u) < 0.5) & (np.abs(v) < 0.25))
    assert ((frame.extrude(2).distance(POINTS) < 0) == (truth & (np.abs(z) < 1))).all()

    vase = (fb.circle(0.5).translate((1.5, 0.4)) | fb.rectangle((0.4, 2)).translate((1.5, 0))).revolve()
    r = np.hypot(x, y)
    truth = (np.hypot(r - 1.5, z - 0.4) < 0.5) | ((np.abs(r - 1.5) < 0.2) & (np.abs(z) < 1))
    assert ((vase.distance(POINTS) < 0) == truth).all()
    with pytest.raises(TypeError):
        fb.circle(1) | fb.sphere(1)


@pytest.mark.parametrize("offset", [0.0, 0.7, -1.3])
def test_a_profile_at_the_axis_revolves_to_a_distance(offset):
    # An edge on the axis is inside the solid: the distance on the axis is the distance to the walls.
    half = np.array([(0, -0.6), (0.9, -0.6), (0.9, 0.6), (0, 0.6)])
    r, h = np.hypot(*POINTS[:, :2].T), np.abs(POINTS[:, 2])
    r[:100] = 0.0
    points = np.column_stack([r, np.zeros_like(r), POINTS[:, 2]])
    beyond = np.maximum(np.column_stack([r - 0.9, h - 0.6]), 0)
    truth = np.linalg.norm(beyond, axis=1) + np.minimum(np.maximum(r - 0.9, h - 0.6), 0)
    for profile in (
        fb.polygon(half - (offset, 0)),
        fb.rectangle((0.9, 1.2)).translate((0.45 - offset, 0)),
        fb.rectangle((1.1, 1.2)).translate((0.35 - offset, 0)),
    ):
        solid = profile.revolve(offset)
        assert solid.exact
        assert np.abs(solid.distance(points) - truth).max() <= 1e-6
        assert np.array_equal(fb.csg.parse(solid.to_sexpr()).distance(points), solid.distance(points))

    # Two parts of a profile meet at the axis around a hollow.
    bowl = np.array([(0, -1), (1, -1), (1, 1), (0.8, 1), (0.8, 0.2), (0, 0.2)])
    assert np.allclose(fb.polygon(bowl).revolve().distance([(0, 0, 0), (0, 0, 0.4), (0, 0, -0.9)]), [-0.2, 0.2, -0.1])


def test_a_volume_is_an_operand_on_either_side():
    volume = fb.bake(meshes.icosphere(3), 24)
    leaf, cube = fb.volume_shape(volume), fb.box(1.4)
    for mixed, plain in (
        (volume | cube, leaf | cube),
        (cube | volume, cube | leaf),
        (volume - cube, leaf - cube),
        (cube - volume, cube - leaf),
        (volume & cube, leaf & cube),
        (volume ^ cube, leaf ^ cube),
    ):
        assert np.array_equal(mixed.distance(POINTS), plain.distance(POINTS))
    assert cube.union(volume, k=0.1).distance([(0, 0, 0)])[0] < 0


def test_a_mesh_is_no_operand():
    mesh = fb.sphere(1).to_mesh(8)
    for combine in (lambda: fb.box(1) - mesh, lambda: mesh | fb.box(1)):
        with pytest.raises(fb.ShapeError, match=r"operand: .* got a Mesh; fb\.boolean .* fb\.volume_shape"):
            combine()


def test_any_number_of_shapes_are_united():
    parts = [fb.sphere(0.5).translate((i, 0, 0)) for i in range(4)]
    pairs = parts[0] | parts[1] | parts[2] | parts[3]
    assert np.array_equal(fb.Shape.union(*parts).distance(POINTS), pairs.distance(POINTS))


SHAPES = [
    fb.sphere(1),
    fb.box((1, 2, 3)) - fb.cylinder(0.4, 4).rotate("x", 90),
    (fb.box(2) | fb.sphere(1.2) | fb.torus(2, 0.3)) & fb.plane("x", 0.5),
    fb.sphere(1) - (fb.box(1) | fb.cone(1, 2)),
    (fb.sphere(1) | fb.box(1)).smooth(0.2).translate((1, 2, 3)).scale(2),
    ~fb.capsule(0.5, 2).rotate((1, 2, 3), 40),
    fb.gyroid(1, 0.1) & fb.octahedron(1),
    fb.extrude(fb.polygon([(0, 0), (1, 0), (0, 1)]), 2) ^ fb.revolve(fb.circle(0.2), 1),
    fb.box(1).shell(0.1).offset(0.05).twist(per_unit_deg=20).bend(per_unit_deg=10).elongate((1, 0, 0)),
    fb.hex_prism(1, 2).mirror("x").reflect((0, 1, 0)).repeat((3, 3, 3), (2, 1, 1)),
    fb.sphere(1).paint((1, 0, 0)).stencil(fb.box(1), (0, 0, 1)),
    fb.truncated_cone(1, 0.5, 2) | fb.capped_torus(1, 0.2, 90) | fb.pyramid(1, 1) | fb.ellipsoid((1, 2, 3)),
]


@pytest.mark.parametrize("shape", SHAPES, ids=range(len(SHAPES)))
def test_repr_is_the_python_that_makes_the_shape(shape):
    text = repr(shape)
    assert text.startswith("Shape(")
    again = eval(text[6:-1], {name: getattr(fb, name) for name in fb.__all__})
    np.testing.assert_allclose(again.distance(POINTS), shape.distance(POINTS), atol=1e-5, equal_nan=False)


def test_the_text_of_a_deep_shape_has_an_end():
    shape = fb.box(1)
    for turn in range(1000):
        shape = shape.rotate("x", 1).paint((turn / 1024, 0, 0))
    text = repr(shape)
    assert text.startswith("Shape((...).")
    assert text.endswith('.rotate("x", 1).paint((0.9755859375, 0, 0)))')
    assert len(text) < 10_000


def test_copies_of_shapes_are_the_same_and_volumes_in_them_are_not_pickled():
    grown = fb.box((1, 1, 4)).twist(pitch=8).offset(0.1, resolution=8)
    for shape in (fb.sphere(1), grown):
        assert copy.copy(shape) is shape
        assert copy.deepcopy([shape])[0] is shape
    with pytest.raises(fb.ShapeError, match="save the volume and make the shape of it again"):
        pickle.dumps(grown)


@pytest.mark.parametrize(
    "text",
    [
        "difference(){cube(3);sphere(2);}",
        "// a part\n$fn = 64;\nunion() { cube([1, 2, 3]); }",
        "/* head */ module part(a) { cube(a); }\npart(3);",
        "use <lib.scad>\ncube(3);",
        "#translate([1,0,0]) sphere(r=2);",
    ],
)
def test_openscad_is_recognised(text):
    with pytest.raises(fb.ShapeError, match="OpenSCAD"):
        fb.csg.parse(text)


def test_s_expressions_are_not_taken_for_openscad():
    assert fb.csg.parse("; a cube\n'(cube 3)") == fb.box(3)
    with pytest.raises(fb.ShapeError, match="expected"):
        fb.csg.parse("cube 3")


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".glb", ".3mf"])
def test_a_shape_is_saved_as_a_mesh(ending, tmp_path):
    import trimesh

    part = fb.box(2) - fb.sphere(1.2)
    part.save(tmp_path / f"part{ending}", 24)
    if ending == ".3mf":
        return
    loaded = trimesh.load(tmp_path / f"part{ending}", force="mesh")
    assert loaded.is_watertight
    assert loaded.volume == pytest.approx(part.to_mesh(24).volume, rel=1e-5)


def test_endings_are_checked_before_any_work(tmp_path):
    everything = fb.sphere(1).repeat((3, 3, 3), (40, 40, 40))
    for path, error in ((tmp_path / "a.step", fb.MeshError), (tmp_path / "no" / "a.stl", FileNotFoundError)):
        with pytest.raises(error):
            everything.save(path, 4096)
    with pytest.raises(fb.ShapeError):
        fb.plane().save(tmp_path / "a.stl")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["gyroid", "schwarz_p", "diamond", "iwp"])
def test_sheets_about_minimal_surfaces_have_the_slope_1_at_most(name):
    sheet = getattr(fb, name)(1.3, 0.2)
    step = 1e-3
    there = POINTS + step * RANDOM.normal(size=POINTS.shape)
    change = np.abs(sheet.distance(there).astype(float) - sheet.distance(POINTS))
    assert (change <= np.linalg.norm(there - POINTS, axis=1) * (1 + 1e-4) + 1e-6).all()
    np.testing.assert_allclose(
        sheet.distance(POINTS + np.array([1.3, -2.6, 1.3])), sheet.distance(POINTS), atol=1e-5, equal_nan=False
    )
    # The middle surface lies in the sheet, half the thickness deep.
    assert sheet.distance(POINTS).min() >= -0.1 - 1e-6
    assert faults(*_arrays((sheet & fb.sphere(1)).to_mesh(32))) == []


def _arrays(mesh):
    return mesh.vertices, mesh.faces


def test_the_gradient_of_iwp_is_at_most_the_root_of_27():
    """Branch and bound over the cube of the cosines (a, b, c) with interval arithmetic."""
    boxes = np.array([[[-1.0, 1.0]] * 3])
    for _ in range(60):
        lower, upper = boxes[..., 0], boxes[..., 1]
        total = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            smallest = np.where(lower[:, i] * upper[:, i] <= 0, 0, np.minimum(lower[:, i] ** 2, upper[:, i] ** 2))
            low = lower[:, j] + lower[:, k] - 2 * upper[:, i]
            high = upper[:, j] + upper[:, k] - 2 * lower[:, i]
            total = total + 4 * (1 - smallest) * np.maximum(low**2, high**2)
        boxes = boxes[total > 27 * 1.002]
        if not len(boxes):
            return
        widest = np.argmax(boxes[..., 1] - boxes[..., 0], axis=1)
        rows = np.arange(len(boxes))
        middle = boxes[rows, widest].mean(axis=1)
        first, second = boxes.copy(), boxes.copy()
        first[rows, widest, 1] = middle
        second[rows, widest, 0] = middle
        boxes = np.concatenate([first, second])
    raise AssertionError("not decided")


def level_function(name, points, cell):
    """The level function of a periodic surface, and the bound of its gradient at the cell 2 pi."""
    x, y, z = (2 * np.pi / cell * points).T
    a, b, c = np.cos(x), np.cos(y), np.cos(z)
    return {
        "gyroid": (np.sin(x) * b + np.sin(y) * c + np.sin(z) * a, np.sqrt(3)),
        "schwarz_p": (a + b + c, np.sqrt(3)),
        "diamond": (np.sin(x) * np.cos(y - z) + a * np.sin(y + z), np.sqrt(3)),
        "iwp": (2 * (a * b + b * c + c * a) - np.cos(2 * x) - np.cos(2 * y) - np.cos(2 * z), np.sqrt(27)),
    }[name]


THICKNESSES = {
    "ramp": fb.plane("z", -1.0).times(0.05, add=0.02),
    "ball": fb.sphere(0.7),
    "hollow": ~fb.sphere(0.7),
    "volume": fb.Volume(RANDOM.uniform(-0.02, 0.3, (9, 9, 9)), [(-1.5,) * 3, (1.5,) * 3]),
}


@pytest.mark.parametrize("kind", THICKNESSES)
@pytest.mark.parametrize("name", ["gyroid", "schwarz_p", "diamond", "iwp"])
def test_the_thickness_of_a_sheet_is_a_field(name, kind):
    thickness, points = THICKNESSES[kind], POINTS / 3
    wanted = thickness.distance(points) if isinstance(thickness, fb.Shape) else thickness.sample(points)
    value, slope = level_function(name, points, 0.6)
    from_sheet = np.abs(value) * 0.6 / (2 * np.pi * slope) - wanted / 2
    # Where the thickness is below 0 there is no sheet. Float32 is 2e-6 exact in the units of the cell.
    sheet = getattr(fb, name)(0.6, thickness)
    found = sheet.distance(points)
    clear = np.abs(from_sheet) > 1e-5
    assert ((found < 0) == ((from_sheet < 0) & (wanted > 0)))[clear].all()
    there = points + 1e-3 * RANDOM.normal(size=points.shape)
    change = np.abs(sheet.distance(there).astype(float) - found)
    assert (change <= np.linalg.norm(there - points, axis=1) * sheet.lipschitz * (1 + 1e-4) + 1e-6).all()
    on_device = sheet.distance(points[:200], device="gpu")
    np.testing.assert_allclose(on_device, found[:200], atol=1e-5, equal_nan=False)


def test_a_graded_sheet_has_the_expected_volume():
    ramp = fb.plane("z", -1.0).times(0.08, add=0.05)
    core = fb.sphere(1.0) & fb.gyroid(0.7, ramp)
    points = np.random.default_rng(2).uniform(-1, 1, (400_000, 3))
    points = points[np.linalg.norm(points, axis=1) < 1]
    value, slope = level_function("gyroid", points, 0.7)
    thickness = 0.05 + 0.08 * (points[:, 2] + 1)
    share = np.mean(np.abs(value) * 0.7 / (2 * np.pi * slope) < thickness / 2)
    # The standard deviation of the share is 0.2 % of it.
    assert core.to_mesh(96).volume / (4 / 3 * np.pi) == pytest.approx(share, rel=0.01)


@pytest.mark.parametrize("offsets", [(0.3, -0.9), (-0.9, 0.3), (0.3, -0.6, -0.3)])
def test_bounds_of_a_steeper_field_contain_its_offsets(offsets):
    ball = fb.sphere(radius=1).times(3)
    for offset in offsets:
        ball = ball.offset(offset)
    # The field is 3 (r - 1 + 0.6). The sum of the offsets is rounded.
    np.testing.assert_allclose(ball.bounds, [[-0.4] * 3, [0.4] * 3], rtol=1e-12, equal_nan=False)
    assert ball.to_mesh(32).volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.01)


def test_times_changes_the_slope_alone():
    ball = fb.sphere(1)
    for factor in (0.2, 5.0):
        field = ball.times(factor)
        np.testing.assert_allclose(field.distance(POINTS), factor * ball.distance(POINTS), atol=1e-5, equal_nan=False)
        assert field.lipschitz == factor
        assert fb.csg.parse(field.to_sexpr()) == field
        for level in (0.1, -0.1):
            # The level set of 5 d at 0.1 is the level set of d at 0.02, and an offset of 0.1 is in world units. A dual
            # mesh of 24 voxels bulges by 0.01 at most.
            grown, radius = ball.times(factor, add=-level), 1 + level / factor
            np.testing.assert_allclose(
                field.offset(level).distance(POINTS),
                factor * (ball.distance(POINTS) - level),
                atol=1e-5,
                equal_nan=False,
            )
            assert (grown.bounds[1] >= radius - 1e-9).all()
            assert grown.to_mesh(24).bounds[1].max() == pytest.approx(radius, abs=0.02)
    with pytest.raises(fb.ShapeError, match="factor"):
        ball.times(0)


LATTICES = [((1.1, 1.2, 1.3), (5, 4, 6)), ((1.5, 1, 1), (70, 1, 1)), ((-1.2, 1.3, 2), (9, 1, 9))]


@pytest.mark.parametrize(("spacing", "counts"), LATTICES)
@pytest.mark.parametrize(
    "child", [fb.sphere(0.4), fb.box((0.5, 0.3, 0.7)).translate((0.3, -1, 0.2))], ids=["ball", "box"]
)
def test_many_copies_have_the_field_of_their_union(child, spacing, counts):
    places = np.moveaxis(np.indices(counts), 0, -1).reshape(-1, 3) - (np.array(counts) - 1) / 2
    union = fb.Shape.union(*[child.translate(place) for place in places * np.array(spacing)])
    many = child.repeat(spacing, counts)
    lower, upper = many.bounds
    np.testing.assert_allclose(many.bounds, union.bounds, atol=1e-9, equal_nan=False)
    points = np.random.default_rng(1).uniform(lower - 1, upper + 1, (2000, 3))
    # Float32 rounds positions of 50 units to 4e-6.
    np.testing.assert_allclose(many.distance(points), union.distance(points), atol=2e-5, equal_nan=False)
    np.testing.assert_allclose(
        many.distance(points[:100], device="gpu"), many.distance(points[:100]), atol=2e-5, equal_nan=False
    )
    assert fb.csg.parse(many.to_sexpr()) == many
    volume = fb.bake(many, 40)
    centres = volume.origin + np.moveaxis(np.indices(volume.resolution), 0, -1) * volume.spacing
    np.testing.assert_allclose(volume.distances, union.distance(centres), atol=4e-5, equal_nan=False)


def test_parts_of_many_copies_have_the_signs_of_the_whole():
    dented = (fb.box(0.8) - fb.cylinder(0.2, 2)).rotate("x", 20)
    for child in (fb.sphere(0.4), dented):
        many = child.repeat((1.2, 1.3, 1.3), (5, 5, 5))
        for part in fb.csg.decompose(many, method="octree")[:40]:
            middle = part.boxes.mean(axis=1)
            assert ((part.shape.distance(middle) < 0) == (many.distance(middle) < 0)).all()
        assert many.to_mesh(48).volume == pytest.approx(125 * child.to_mesh(64).volume, rel=0.03)


def test_the_cost_of_copies_does_not_depend_on_their_number():
    few, many = (fb.sphere(0.4).repeat((1, 1, 1), (n, n, n)) for n in (5, 10_000))
    assert len(many.to_sexpr()) < 100
    # Float32 has steps of 5e-4 at 5,000.
    assert many.distance([(4999.5, -0.5, 0.5), (5000.5, 0.5, 0.5)]) == pytest.approx([-0.4, 0.6], abs=2e-3)
    assert few.distance([(2.0, 1.0, 0.0)])[0] == pytest.approx(-0.4, abs=1e-6)
    with pytest.raises(fb.ShapeError, match="leaves"):
        fb.sphere(0.6).repeat((1, 1, 1), (1000, 1000, 1000)).distance([(0, 0, 0)])
    rows = fb.sphere(radius=0.1).repeat((0.01, 0, 0), (1000, 1, 1))
    with pytest.raises(fb.ShapeError, match="leaves"):
        assert rows.repeat((0, 0.01, 0), (1, 100_000, 1)).bounds is None
