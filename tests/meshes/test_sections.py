"""Plane sections: of meshes against exact rational arithmetic, of fields against closed forms."""

from __future__ import annotations

import pickle
import warnings
from fractions import Fraction

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation

import fieldbake as fb
import meshes
from fieldbake.meshes.loops import area

#: Rounding of float64 positions of about 1, with a factor for the few operations behind each.
EXACT = 1e-9

#: Vertices lie on the zero level of a float32 field, and 1,000 chords of a circle are within 5e-6 of its radius.
CLOSE = 1e-4

#: A point and a whole-number normal of each plane.
PLANES = [((0.1, 0.05, 0.02), (0, 0, 1)), ((0.02, -0.03, 0.1), (1, 2, 3)), ((-0.1, 0.2, 0.05), (-3, 1, 1))]

CLEAN = {name: meshes.CLOSED[name] for name in meshes.CLOSED if name not in ("nested_shells", "overlapping_boxes")}


def exact_segments(vertices, faces, origin, normal) -> np.ndarray:
    """Where triangles cross a plane, (n, 2, 3): computed in fractions, and directed with the material on the left."""
    point, direction = ([Fraction(float(x)) for x in each] for each in (origin, normal))
    found = []
    for corners in vertices[faces].tolist():
        places = [[Fraction(x) for x in corner] for corner in corners]
        heights = [sum(n * (x - o) for n, x, o in zip(direction, place, point, strict=True)) for place in places]
        if min(heights) >= 0 or max(heights) < 0:
            continue
        ends: list = [None, None]
        for i in range(3):
            a, b = heights[i], heights[(i + 1) % 3]
            if (a >= 0) != (b >= 0):
                share = a / (a - b)
                place = [p + (q - p) * share for p, q in zip(places[i], places[(i + 1) % 3], strict=True)]
                ends[int(a < 0)] = [float(x) for x in place]
        found.append(ends)
    return np.array(found)


def in_plane(points, section) -> np.ndarray:
    return ((points - section.plane[:3, 3]) @ section.plane[:3, :3])[..., :2]


def borders(section) -> shapely.Geometry:
    return shapely.MultiLineString([np.vstack([loop, loop[:1]]) for loop in section.polygons])


def distances(points, section) -> np.ndarray:
    return shapely.distance(shapely.points(points), borders(section))


@pytest.mark.parametrize("plane", PLANES, ids=str)
@pytest.mark.parametrize("name", CLEAN)
def test_sections_of_meshes_are_exact(name, plane):
    origin, normal = plane
    mesh = fb.Mesh(*CLEAN[name]())
    truth = exact_segments(mesh.vertices, mesh.faces.astype(int), origin, normal)
    section = mesh.section(origin, normal)

    assert len(truth)
    assert np.abs(section.plane[:3, 2] - np.array(normal) / np.linalg.norm(normal)).max() <= EXACT
    flat = in_plane(truth, section)
    # The vertices are exact crossings, and all crossings lie on the polygons.
    corners = np.concatenate(section.polygons)
    crossings = shapely.MultiPoint(flat.reshape(-1, 2))
    assert shapely.distance(shapely.points(corners), crossings).max() <= EXACT
    assert distances(flat.reshape(-1, 2), section).max() <= EXACT
    exact = 0.5 * (flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0]).sum()
    assert abs(section.area - exact) <= EXACT
    assert abs(section.perimeter - np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1).sum()) <= EXACT
    assert len(section.open_chains) == 0
    assert all(shapely.Polygon(loop).is_valid for loop in section.polygons)


def test_a_section_of_a_cube_is_a_regular_hexagon():
    section = fb.Mesh(*meshes.box()).section((0, 0, 0), (1, 1, 1))
    (hexagon,) = section.polygons
    corners = np.array([(1, -1, 0), (0, -1, 1), (-1, 0, 1), (-1, 1, 0), (0, 1, -1), (1, 0, -1)], float)

    assert distances(in_plane(corners, section), section).max() <= EXACT
    assert np.abs(np.linalg.norm(hexagon, axis=1) <= np.sqrt(2) + EXACT).all()
    assert abs(section.area - 3 * np.sqrt(3)) <= EXACT


def test_the_frame_of_a_section_is_rigid():
    for normal in [*np.eye(3), *-np.eye(3), (1, 2, 3), (1e-200, 0, 0)]:
        section = fb.Mesh(*meshes.box()).section((0.1, 0.2, 0.3), normal)
        turn = section.plane[:3, :3]
        assert np.abs(turn.T @ turn - np.eye(3)).max() <= 1e-15
        assert np.linalg.det(turn) > 0
        assert section.plane[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert fb.sphere(1).section((0, 0, 0), "z").plane.tolist() == np.eye(4).tolist()


def test_holes_are_clockwise_and_outer_loops_are_not():
    section = fb.Mesh(*meshes.hollow_sphere()).section((0.01, 0, 0), "x")

    assert sorted(np.sign([area(loop) for loop in section.polygons])) == [-1, 1]
    assert all((loop[0] != loop[-1]).any() for loop in section.polygons)


@pytest.mark.parametrize("make", [meshes.nested_shells, lambda: meshes.flip(meshes.icosphere())])
def test_a_point_is_inside_where_the_winding_number_is_not_zero(make):
    section = fb.Mesh(*make()).section((0, 0, 0.01), "z")

    assert [area(loop) > 0 for loop in section.polygons] == [True]
    assert 0.9 * np.pi < section.area < np.pi


def test_faces_and_vertices_in_the_plane_take_one_side():
    cube = fb.Mesh(*meshes.box())
    top, bottom, nearly = cube.sections([(0, 0, 1), (0, 0, -1), (0, 0, 1 - 1e-12)], "z")

    assert (top.area, bottom.area) == (4, 0)
    assert abs(nearly.area - 4) <= EXACT
    assert cube.section((0, 0, -1), (0, 0, -1)).area == 4
    # The plane x = 0 passes through a ring of vertices of the sphere and of edges of the box with a diagonal.
    for geometry in (meshes.icosphere(), meshes.uv_sphere(), meshes.tetrahedron()):
        for normal in "xyz":
            section = fb.Mesh(*geometry).section((0, 0, 0), normal)
            assert len(section.polygons) == 1
            assert shapely.Polygon(section.polygons[0]).is_valid


def test_a_flat_face_of_a_turned_mesh_takes_one_side(random):
    corners, faces = meshes.box((-1, -0.5, -0.25), (1, 0.5, 0.25))
    for turn in np.linalg.qr(random.normal(size=(50, 3, 3)))[0]:
        turn = turn * np.sign(np.linalg.det(turn))
        solid = fb.Mesh(corners @ turn.T, faces)
        for axis, size in zip(np.eye(3), (0.5, 1, 2), strict=True):
            for normal in (turn @ axis, -turn @ axis):
                place = np.abs(axis * (1, 0.5, 0.25)).sum() * normal
                assert solid.section(place, normal).area == pytest.approx(size)
                assert solid.section(-place, normal).area == 0


def test_parts_that_share_a_face_have_a_section_there():
    stack = fb.box((2, 2, 1)).translate((0, 0, 0.5)) | fb.box((1, 1, 1)).translate((0, 0, 1.5))
    axis = np.array([1, 2, 3]) / np.sqrt(14)
    for angle in (0, 40):
        up = Rotation.from_rotvec(np.radians(angle) * axis).as_matrix()[:, 2]
        turned = stack.rotate(axis, angle)
        for normal in (up, -up):
            assert turned.section(up, normal).area == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("resolution", [32, 64])
def test_a_section_in_the_tread_of_a_step_has_the_riser_as_its_border(resolution):
    """The field of the shape is zero on the whole tread."""
    step = fb.box((2, 2, 1)) | fb.box((1, 1, 2))
    assert step.section((0, 0, 0.5), "z", resolution=resolution).area == pytest.approx(1, abs=1e-5)


def test_bodies_that_touch_at_an_edge_or_a_corner_have_simple_loops():
    edge = meshes.join(meshes.box(), meshes.box((1, 1, -1), (3, 3, 1)))
    section = fb.Mesh(*edge).section((0, 0, 0.1), "z")

    assert [round(area(loop), 9) for loop in section.polygons] == [4, 4]
    assert all(shapely.Polygon(loop).is_valid for loop in section.polygons)


def test_split_vertices_and_repeated_faces_change_nothing():
    whole = fb.Mesh(*meshes.icosphere()).section((0, 0, 0.1), (1, 2, 3))
    for damage in (meshes.split_vertices, meshes.doubled):
        section = fb.Mesh(*damage(meshes.icosphere())).section((0, 0, 0.1), (1, 2, 3))
        assert len(section.polygons) == 1
        assert abs(section.area - whole.area) <= EXACT


@pytest.mark.parametrize("step", [1, 2, 5, 1000])
@pytest.mark.parametrize("order", [1, -1], ids=["copies_last", "copies_first"])
def test_copies_of_faces_with_reversed_winding_change_nothing(order, step):
    vertices, faces = meshes.icosphere()
    plane = (0, 0, 0.1), (1, 2, 3)
    whole = fb.Mesh(vertices, faces).section(*plane)
    # The first copy is of a face that the plane crosses.
    crossed = whole.plane[:3, :2] @ whole.polygons[0][:2].mean(axis=0) + whole.plane[:3, 3]
    row = int(fb.closest_point((vertices, faces), crossed).faces)
    copies = np.roll(faces, -row, axis=0)[: len(faces) // 2 : step, ::-1]
    # The copies share the vertices of the faces, or have their own at the same places.
    for extra in (copies, copies + len(vertices)):
        twice = np.concatenate([faces, extra][::order])
        section = fb.Mesh(np.concatenate([vertices, vertices]), twice).section(*plane)
        assert len(section.polygons) == 1
        assert abs(section.area - whole.area) <= EXACT


#: The box that is mirrored in its wall x = 1 has the same triangles there; the moved box has the other diagonal.
MIRROR = [(-1, 0, 0, 2), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]
NEIGHBOURS = {
    "mirrored": meshes.flip(meshes.move(meshes.box(), MIRROR)),
    "moved": meshes.box((1, -1, -1), (3, 1, 1)),
}


@pytest.mark.parametrize("name", NEIGHBOURS)
def test_a_copied_face_of_a_shared_wall_keeps_both_bodies(name):
    points, rows = meshes.join(meshes.box(), NEIGHBOURS[name])
    for row in range(len(rows)):
        section = fb.Mesh(points, np.concatenate([rows, rows[[row], ::-1]])).section((0, 0, 0.1), "z")
        assert len(section.open_chains) == 0
        assert abs(section.area - 8) <= EXACT


@pytest.mark.parametrize("turn", [np.eye(3), meshes.rotation(1)], ids=["straight", "turned"])
@pytest.mark.parametrize(
    ("other", "area"),
    [
        (NEIGHBOURS["mirrored"], 8),
        (NEIGHBOURS["moved"], 8),
        (meshes.box((1, 0.25, -1), (2, 3, 1)), 6.75),
        (meshes.box((-0.5, 1, -1), (0.5, 2, 1)), 5),
    ],
    ids=["mirrored", "moved", "beside", "above"],
)
def test_bodies_that_touch_along_a_wall_do_not_warn(other, area, turn):
    vertices, faces = meshes.join(meshes.box(), other)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        section = fb.Mesh(vertices @ turn.T, faces).section(turn @ (0, 0, 0.1), turn[:, 2])
    assert abs(section.area - area) <= EXACT


def test_an_inconsistent_mesh_warns_and_is_divided_by_nesting():
    whole = fb.Mesh(*meshes.hollow_sphere()).section((0, 0, 0.1), (1, 2, 3))
    with pytest.warns(fb.SurfaceWarning, match="winding of the faces is inconsistent"):
        section = fb.Mesh(*meshes.flip_some(meshes.hollow_sphere(), 0.3)).section((0, 0, 0.1), (1, 2, 3))

    assert len(section.polygons) == 2
    assert abs(section.area - whole.area) <= EXACT


def test_an_open_mesh_warns_and_keeps_its_open_chains():
    with pytest.warns(fb.SurfaceWarning, match="open chains"):
        section = fb.Mesh(*meshes.open_box()).section((0, 0, 0), "x")

    (chain,) = section.open_chains
    assert section.polygons == ()
    assert section.area == 0
    assert abs(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() - 6) <= EXACT
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert abs(fb.Mesh(*meshes.open_box()).section((0, 0, 0), "z").area - 4) <= EXACT


def test_bodies_that_pass_through_each_other_warn():
    crossed = meshes.join(meshes.box(), meshes.box((0, 0.5, -1), (3, 3, 1)))
    with pytest.warns(fb.SurfaceWarning, match="loops of the section cross"):
        assert len(fb.Mesh(*crossed).section((0, 0, 0.1), "z").polygons) == 2


def ellipse(a, b, turn=0.0, center=(0, 0)) -> np.ndarray:
    t = np.linspace(0, 2 * np.pi, 1001)[:-1]
    x, y = a * np.cos(t), b * np.sin(t)
    return np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], axis=1) + center


def polygon(*corners) -> np.ndarray:
    corners = np.array(corners, float)
    t = np.linspace(0, 1, 1001 // len(corners))[:-1, None]
    return np.concatenate([a + (b - a) * t for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


def turned(points, degrees) -> np.ndarray:
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T


SQUARE = polygon((1, 1), (-1, 1), (-1, -1), (1, -1))
#: Name: field, origin, normal, and the closed curves of the section.
FIELDS = {
    "sphere": lambda: (fb.sphere(1), (0, 0, 0.6), "z", [ellipse(0.8, 0.8)]),
    "torus": lambda: (fb.torus(2, 0.5), (0, 0, 0), "z", [ellipse(2.5, 2.5), ellipse(1.5, 1.5)]),
    "torus_upright": lambda: (
        fb.torus(2, 0.5), (0, 0, 0), "x", [ellipse(0.5, 0.5, center=(s * 2, 0)) for s in (-1, 1)]
    ),
    "ellipsoid": lambda: (fb.ellipsoid((1, 2, 0.7)), (0, 0, 0), "z", [ellipse(1, 2)]),
    "tilted_cylinder": lambda: (
        fb.cylinder(radius=1, height=8), (0, 0, 0), (0, 1, 1), [ellipse(1, np.sqrt(2))]
    ),
    "turned_box": lambda: (fb.box(2).rotate("z", 30), (0, 0, 0.1), "z", [turned(SQUARE, 30)]),
    "box_along_the_axes": lambda: (fb.box(2), (0, 0, 0.1), "z", [SQUARE]),
    "pipe": lambda: (
        fb.cylinder(radius=1, height=2) - fb.cylinder(radius=0.5, height=3), (0, 0, 0), "z",
        [ellipse(1, 1), ellipse(0.5, 0.5)],
    ),
    "volume": lambda: (fb.bake(fb.sphere(1), 320), (0, 0, 0), "y", [ellipse(1, 1)]),
    "sparse": lambda: (fb.bake(fb.sphere(1), 320).to_sparse(tolerance=None), (0, 0, 0), (1, 1, 1), [ellipse(1, 1)]),
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_sections_of_fields_are_closed_forms(name):
    field, origin, normal, curves = FIELDS[name]()
    options = {"resolution": 1300} if isinstance(field, fb.Shape) else {}
    section = field.section(origin, normal, **options)

    assert len(section.polygons) == len(curves)
    for curve in curves:
        assert distances(in_plane_of(section, curve, normal), section).max() <= CLOSE
    # The second curve of these two is a hole.
    signs = (1, -1) if name in ("torus", "pipe") else (1, 1)
    inside = sum(sign * shapely.Polygon(curve).area for sign, curve in zip(signs, curves, strict=False))
    assert abs(section.area - inside) <= 2 * CLOSE * inside
    for loop in section.polygons:
        assert shapely.Polygon(loop).is_valid
        assert len(loop) >= 1000 or "box" in name


def in_plane_of(section, curve, normal) -> np.ndarray:
    """The curves are symmetric about the axes of the plane, except the upright torus, whose plane has y first."""
    if isinstance(normal, str):
        return curve
    # The tilted ellipse has its long axis along (0, 1, -1).
    axes = np.array([(1, 0, 0), (0, np.sqrt(0.5), -np.sqrt(0.5))])
    return curve @ (axes @ section.plane[:3, :2]) if tuple(normal) == (0, 1, 1) else curve


@pytest.mark.parametrize("factor", [1e-6, 1e-3])
def test_fields_of_any_scale_have_the_same_sections(factor):
    solid = fb.sphere(1).times(factor)
    assert solid.section((0, 0, 0), "z").area == pytest.approx(np.pi, rel=1e-3)
    volume = fb.bake(solid, 64)
    assert volume.section((0, 0, 0), "z").area == pytest.approx(np.pi, rel=3e-3)


def test_vertices_lie_on_the_zero_level():
    shape = (fb.box(2) - fb.sphere(1.2)).rotate("x", 20)
    section = shape.section((0, 0, 0.1), (1, 2, 3))
    flat = np.concatenate(section.polygons)
    points = flat @ section.plane[:3, :2].T + section.plane[:3, 3]

    assert np.abs(shape.distance(points)).max() <= 1e-5


def test_loops_of_random_solids_are_simple_and_do_not_cross():
    random = np.random.default_rng(3)

    def some(make):
        return [make().rotate("x", random.uniform(0, 90)).translate(random.uniform(-1, 1, 3)) for _ in range(6)]

    for _ in range(30):
        solid = fb.Shape.union(*some(lambda: fb.box(random.uniform(0.2, 1, 3)).rotate("z", random.uniform(0, 90))))
        solid -= fb.Shape.union(*some(lambda: fb.sphere(random.uniform(0.1, 0.5))))
        section = solid.section((0, 0, 0), random.normal(size=3), resolution=int(random.integers(10, 150)))
        rings = [shapely.LinearRing(loop) for loop in section.polygons]
        assert all(shapely.Polygon(ring).is_valid for ring in rings)
        assert not any(a.crosses(b) for i, a in enumerate(rings) for b in rings[:i])


def test_a_solid_that_leaves_the_box_is_closed_there():
    full = fb.Volume(np.full((8, 8, 8), -1.0), [(-1, -1, -1), (1, 1, 1)])
    (square,) = full.section((0, 0, 0), "x").polygons
    assert np.abs(np.abs(square) - 1).max() <= 1e-5
    half = fb.plane("z", 0).section((0, 0, 0), "x", bounds=[(-1, -1, -1), (1, 1, 1)])
    assert abs(half.area - 2) <= 1e-5


def test_planes_beside_the_solid_have_no_polygons():
    for solid in (fb.sphere(1), fb.bake(fb.sphere(1), 16), fb.Mesh(*meshes.box())):
        section = solid.section((0, 0, 9), "z")
        assert (section.polygons, section.area, section.perimeter) == ((), 0, 0)
        assert "<svg" in section.to_svg()


def test_an_empty_shape_has_empty_sections():
    nothing = fb.sphere(1) & fb.sphere(1).translate((5, 0, 0))
    for origin in ((0, 0, 0), (0, 0, 9)):
        assert nothing.section(origin, "z").area == 0


@pytest.mark.parametrize("axis", range(3))
def test_a_sign_before_an_axis_reverses_the_normal(axis):
    for solid in (fb.box((1, 2, 3)), fb.Mesh(*meshes.box())):
        named, given = solid.section((0, 0, 0), "-" + "xyz"[axis]), solid.section((0, 0, 0), -np.eye(3)[axis])
        assert named.plane.tolist() == given.plane.tolist()
        assert [loop.tolist() for loop in named.polygons] == [loop.tolist() for loop in given.polygons]


def test_the_svg_has_millimetres_and_upward_y(tmp_path):
    section = fb.Mesh(*meshes.box((0, 0, 0), (3, 2, 1))).section((0, 0, 0.5), "z")
    text = section.to_svg(tmp_path / "plate.svg")

    assert (tmp_path / "plate.svg").read_text() == text
    assert 'width="3mm" height="2mm" viewBox="0 -2 3 2"' in text
    assert 'fill-rule="evenodd"' in text
    assert "320" in section._repr_svg_()


def test_sections_pickle_and_are_immutable():
    section = pickle.loads(pickle.dumps(fb.sphere(1).section((0, 0, 0), "z", resolution=16)))
    assert abs(section.area - np.pi) < 0.1
    assert not section.polygons[0].flags.writeable
    with pytest.raises(AttributeError):
        section.polygons = ()


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        (((0, 0), "z"), {}, "origin: must have shape"),
        (((0, 0, np.nan), "z"), {}, "origin: must be finite"),
        (((0, 0, 0), "w"), {}, "normal: must be one of"),
        (((0, 0, 0), (0, 0, 0)), {}, "normal: must not be zero"),
        (((0, 0, 0), "z"), {"resolution": 0}, "resolution: must be from 1"),
        (((0, 0, 0), "z"), {"bounds": [(0, 0, 0), (1, 0, 1)]}, "bounds: the upper corner"),
    ],
)
def test_mistakes_name_the_argument(arguments, options, words):
    with pytest.raises(fb.ArgumentError, match=words):
        fb.sphere(1).section(*arguments, **options)


def test_unbounded_shapes_need_a_box():
    with pytest.raises(fb.ShapeError):
        fb.plane("z", 0).section((0, 0, 0), "x")
    with pytest.raises(fb.ArgumentError, match="origins: must have shape"):
        fb.sphere(1).sections(np.zeros((2, 2, 3)), "z")
    with pytest.raises(fb.CapacityError):
        fb.sphere(1).section((0, 0, 0), "z", resolution=1 << 20)
