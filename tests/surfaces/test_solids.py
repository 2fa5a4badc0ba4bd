"""Solids, offsets, shells and Booleans: closed two-manifolds, volumes and distances in closed form, errors."""

import sys

import numpy as np
import pytest
import trimesh

import fieldbake as fb
import meshes
import truth
from manifold import faults


def assert_solid(mesh):
    assert faults(mesh.vertices, mesh.faces) == []
    assert truth.volume(mesh.vertices, mesh.faces) > 0
    assert mesh.report.volume == pytest.approx(truth.volume(mesh.vertices, mesh.faces))


def box_distance(points, half):
    """Signed distance of an axis-aligned box about the origin."""
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def surface_samples(mesh, count=200_000):
    return fb.sample_surface(mesh, count, seed=3).points


# --- solid


@pytest.mark.parametrize("name", ["knot", "hollow_sphere", "torus"])
def test_a_closed_mesh_comes_back(name):
    geometry = meshes.CLOSED[name]()
    mesh = fb.solid(geometry, 48)
    assert_solid(mesh)
    assert mesh.volume == pytest.approx(truth.volume(*geometry), rel=0.01)
    assert mesh.report.genus == {"knot": 1, "hollow_sphere": 0, "torus": 1}[name]
    assert mesh.report.bodies == (2 if name == "hollow_sphere" else 1)


def test_an_open_mesh_is_closed_across_its_opening():
    mesh = fb.solid(meshes.open_box(), 40)
    assert_solid(mesh)
    assert mesh.volume == pytest.approx(8, rel=0.01)


def test_an_inside_that_reaches_the_box_is_closed_there():
    for resolution in (40, 57):
        mesh = fb.solid(meshes.stacked_sheets(), resolution)
        assert_solid(mesh)
        # The winding number is 1/2 at the height 1.29 above the squares, and the box ends at 0.9 and a voxel.
        assert np.abs(mesh.bounds[:, 2]).min() >= 0.9


def test_a_soup_gives_a_closed_mesh_or_an_error():
    random = np.random.default_rng(4)
    corners = random.normal(size=(60, 1, 3)) + 0.6 * random.normal(size=(60, 3, 3))
    soup = (corners.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    for options in ({}, {"fill": "outer"}, {"fill": "outer", "seal": 3}):
        try:
            mesh = fb.solid(soup, 16, **options)
        except fb.MeshError:
            continue
        assert_solid(mesh)


@pytest.mark.parametrize("fill", ["winding", "outer"])
@pytest.mark.parametrize(("inner", "resolution"), [(0.5, 16), (0.5, 48), (0.3, 32), (0.9, 32)])
def test_faces_inside_a_solid_leave_no_voids(inner: float, resolution: int, fill: str) -> None:
    # Faces of the inner box pass through voxel centres at several of these resolutions.
    box = trimesh.creation.box((2, 2, 2))
    nested = np.r_[box.vertices, inner * box.vertices], np.r_[box.faces, box.faces + len(box.vertices)]
    made = fb.solid(nested, resolution, fill=fill)
    assert made.topology()["components"] == 1
    # Planes of faces come back to the rounding of float32 vertices.
    assert abs(made.volume - 8) <= 1e-6


def test_the_outer_fill_drops_what_lies_inside():
    junk = meshes.join(meshes.box(), meshes.icosphere(2, 0.5), meshes.flip(meshes.icosphere(2, 0.3)))
    mesh = fb.solid(junk, 40, fill="outer")
    assert_solid(mesh)
    assert mesh.report.bodies == 1
    assert mesh.volume == pytest.approx(8, rel=1e-3)
    assert mesh.report.distance_to_source <= 0.02 * mesh.report.voxel_size
    # The centre of the cavity of the junk is farthest from the box.
    assert mesh.report.distance_from_source >= 0.49


def test_a_seal_closes_a_leak():
    # Two boxes inside each other, each with a hole of 0.4 in its top: the outside reaches the inner one.
    frame = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    vertices = np.concatenate([np.c_[frame, [-1] * 4], np.c_[frame, [1] * 4], np.c_[0.2 * frame, [1] * 4]])
    quads = [(0, 3, 2, 1)]
    quads += [(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)]
    quads += [(i + 4, (i + 1) % 4 + 4, (i + 1) % 4 + 8, i + 8) for i in range(4)]
    holed = (vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    with pytest.raises(fb.MeshError, match="close them by a larger seal=, got 0"):
        fb.solid(holed, 40, fill="outer")
    # The hole is 8 voxels wide.
    mesh = fb.solid(holed, 40, fill="outer", seal=10)
    assert_solid(mesh)
    assert mesh.volume == pytest.approx(8, rel=0.01)


@pytest.mark.parametrize("seal", [10, 40, 75.5, 120])
def test_a_wide_seal_keeps_the_voxels_and_fills_no_more_than_the_solid(seal):
    ball = fb.Mesh(*meshes.icosphere(3))
    plain = fb.solid(ball, 40, fill="outer")

    mesh = fb.solid(ball, 40, fill="outer", seal=seal)

    assert_solid(mesh)
    # The samples are the same, but for the rounding of their positions.
    assert mesh.report.voxel_size == pytest.approx(plain.report.voxel_size)
    assert mesh.volume == pytest.approx(plain.volume, rel=1e-6)


@pytest.mark.parametrize(("scale", "shift", "moved"), [(1e-3, 0, 0), (3, 0, 2), (1e3, 1e6, 0)])
def test_scale_and_place_change_no_triangle(scale, shift, moved):
    here = fb.solid(meshes.knot(), 40)
    there = fb.solid(meshes.scale_and_shift(meshes.knot(), scale, (shift, -shift, shift)), 40)
    assert_solid(there)
    assert len(there.vertices) == len(here.vertices)
    assert there.volume == pytest.approx(here.volume * scale**3, rel=1e-4)
    # The float32 samples round differently, which exchanges the nearest face of a probe that is equally far from two
    # parts of the mesh. At a scale of 3 two of the 3,738 vertices have such a probe.
    back = (there.vertices - [shift, -shift, shift]) / scale
    stays = np.linalg.norm(back - here.vertices, axis=1) <= 1e-3 * here.report.voxel_size
    assert np.count_nonzero(~stays) <= moved


# --- offset


@pytest.mark.parametrize("distance", [-0.4, -0.05, 0.1, 0.7])
def test_the_offset_of_a_sphere_is_a_sphere(distance):
    mesh = fb.offset(meshes.icosphere(5), distance, 64)
    assert_solid(mesh)
    # The icosphere lies up to 3.3e-4 inside the sphere.
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - (1 + distance)).max() <= 1e-3 * (1 + distance) + 3.3e-4


def test_the_planes_of_a_far_offset_are_those_of_the_query():
    # Offsets above two voxels take their planes from the nearest points, smaller ones from the query with its side.
    shape = meshes.box()
    for distance in (0.3, -0.3):
        mesh = fb.offset(shape, distance, 40)
        assert_solid(mesh)
        assert abs(distance) > 2 * mesh.report.voxel_size
        off = np.abs(fb.signed_distance(shape, mesh.vertices) - distance)
        # A tangent plane of a sphere of this radius is h^2 / (2 r) away from it at a distance h, here the diagonal.
        assert off.max() <= 3 * mesh.report.voxel_size**2 / (2 * abs(distance))


def test_the_offset_of_a_box_has_round_edges_outside_and_sharp_ones_inside():
    grown, shrunk = fb.offset(meshes.box(), 0.3, 48), fb.offset(meshes.box(), -0.3, 48)
    assert_solid(grown)
    assert_solid(shrunk)
    # Steiner's formula for a cube of side 2.
    r = 0.3
    assert grown.volume == pytest.approx(8 + 24 * r + 6 * np.pi * r**2 + 4 / 3 * np.pi * r**3, rel=1e-3)
    assert shrunk.volume == pytest.approx(1.4**3, rel=1e-4)
    assert grown.bounds == pytest.approx(np.array([[-1.3] * 3, [1.3] * 3]), abs=1e-3)


def test_the_report_of_an_offset_bounds_dense_samples():
    mesh = fb.offset(meshes.box(), 0.3, 24)
    report = mesh.report
    samples = surface_samples(mesh)
    deviation = np.abs(box_distance(samples, 1.0) - 0.3).max()
    assert deviation <= report.distance_to_source * (1 + 1e-3)
    assert report.distance_to_source <= 0.5 * report.voxel_size
    # The ideal surface: points of the box pushed outwards along directions of its normal cone.
    random = np.random.default_rng(1)
    points = random.normal(size=(100_000, 3))
    ideal = np.clip(points * 10, -1, 1)
    ideal += (
        0.3
        * (points - np.clip(points, -1e-3, 1e-3))
        / np.linalg.norm(points - np.clip(points, -1e-3, 1e-3), axis=1, keepdims=True)
    )
    ideal = ideal[np.abs(box_distance(ideal, 1.0) - 0.3) <= 1e-9]
    assert len(ideal) > 10_000
    missed = fb.closest_point(mesh, ideal).distances.max()
    assert missed <= report.distance_from_source * (1 + 1e-3)


# --- shell


def test_shells_have_the_volume_of_their_walls():
    box, r = meshes.box(), 0.3
    inward = fb.shell(box, r, 32)
    outward = fb.shell(box, r, 32, side="outward")
    both = fb.shell(box, 2 * r, 32, side="both")
    steiner = 24 * r + 6 * np.pi * r**2 + 4 / 3 * np.pi * r**3
    for mesh, expected in ((inward, 8 - 1.4**3), (outward, steiner), (both, steiner + 8 - 1.4**3)):
        assert_solid(mesh)
        assert mesh.report.bodies == 2
        assert mesh.volume == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("open", "openings"), [("z", 1), (["z", "-z"], 2), ((0, 0, 1), 1), ([(0, 0, 1), "x"], 2)])
def test_a_shell_is_open_in_the_directions_asked_for(open, openings):
    mesh = fb.shell(meshes.box(), 0.25, 40, open=open)
    assert_solid(mesh)
    assert mesh.report.bodies == 1
    if openings == 1:
        assert mesh.volume == pytest.approx(8 - 1.5 * 1.5 * 1.75, rel=2e-3)
    elif open == ["z", "-z"]:
        assert mesh.report.genus == 1
        assert mesh.volume == pytest.approx(8 - 1.5 * 1.5 * 2, rel=2e-3)


def test_a_sheet_gets_a_wall_on_both_sides():
    sheet = ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    with pytest.raises(fb.MeshError, match="thickness"):
        fb.solid(sheet, 32)
    mesh = fb.shell(sheet, 0.3, 40, side="both")
    assert_solid(mesh)
    r = 0.15
    assert mesh.volume == pytest.approx(4 * 2 * r + np.pi * r**2 / 2 * 8 + 4 / 3 * np.pi * r**3, rel=5e-3)


# --- boolean

OTHER = ((0.1, 0.2, 0.3), (1.6, 1.7, 1.8))


@pytest.mark.parametrize(
    ("op", "volume"), [("union", 8 + 3.375 - 0.504), ("intersection", 0.504), ("difference", 8 - 0.504)]
)
def test_booleans_of_boxes_have_exact_volumes(op, volume):
    mesh = fb.boolean(op, meshes.box(), meshes.box(*OTHER), resolution=32)
    assert_solid(mesh)
    assert mesh.volume == pytest.approx(volume, rel=2e-3)
    assert mesh.report.distance_to_source <= 0.5 * mesh.report.voxel_size


def turned_box(half: tuple[float, float, float], angles: tuple[float, float, float], shift: tuple[float, float, float]):
    """A box, and a function for the signed distance from it."""
    made = trimesh.creation.box(2 * np.array(half))
    turn = trimesh.transformations.euler_matrix(*angles)[:3, :3]
    distance = lambda points: box_distance((points - shift) @ turn, np.array(half))  # noqa: E731
    return (made.vertices @ turn.T + shift, made.faces), distance


@pytest.mark.parametrize("resolution", [32, 64])
def test_the_distance_from_a_difference_is_at_most_a_thousandth_low(resolution: int) -> None:
    a, in_a = turned_box((1.0, 0.6, 0.4), (0, 0, 0), (0, 0, 0))
    b, in_b = turned_box((0.5, 0.5, 0.5), (0.4, 0.5, 0.6), (0.8, 0.3, 0.2))
    made = fb.boolean("difference", a, b, resolution=resolution)
    # The farthest points lie on edges of the operands that bound the exact difference.
    edges = np.concatenate([v[np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))] for v, f in (a, b)])
    share = np.linspace(0, 1, 4001)[:, None, None]
    points = (edges[:, 0] * (1 - share) + edges[:, 1] * share).reshape(-1, 3)
    points = points[np.abs(np.maximum(in_a(points), -in_b(points))) <= 1e-12]
    missed = fb.closest_point(made, points).distances.max()
    assert missed <= made.report.distance_from_source * (1 + 1e-3)


def test_the_distance_to_a_shell_is_at_most_a_thousandth_low() -> None:
    box, distance = turned_box((1.0, 0.6, 0.4), (0.31, 1.17, -2.2), (0, 0, 0))
    inner = turned_box((0.88, 0.48, 0.28), (0.31, 1.17, -2.2), (0, 0, 0))[1]
    made = fb.shell(box, 0.12, 24)
    corners = made.vertices[made.faces]
    steps = np.stack(np.meshgrid(*[np.arange(31)] * 2), axis=-1).reshape(-1, 2)
    steps = steps[steps.sum(axis=1) <= 30] / 30
    weights = np.column_stack([steps, 1 - steps.sum(axis=1)])

    def largest(corners):
        points = np.einsum("ij,fjk->fik", weights, corners)
        flat = points.reshape(-1, 3)
        found = np.minimum(np.abs(distance(flat)), np.abs(inner(flat))).reshape(points.shape[:2])
        return found.max(axis=1)

    centers = corners.mean(axis=1)
    farthest = np.argsort(-np.minimum(np.abs(distance(centers)), np.abs(inner(centers))))[:2000]
    assert largest(corners[farthest]).max() <= made.report.distance_to_source * (1 + 1e-3)


def test_booleans_agree_with_manifold():
    manifold3d = pytest.importorskip("manifold3d")

    def solid_of(geometry):
        vertices, faces = geometry
        parts = np.array(vertices, np.float32, order="C"), np.array(faces, np.uint32, order="C")
        return manifold3d.Manifold(manifold3d.Mesh(*parts))

    a, b = meshes.torus(), meshes.icosphere(3, 0.6, (1, 0, 0))
    for op, exact in (
        ("union", solid_of(a) + solid_of(b)),
        ("intersection", solid_of(a) ^ solid_of(b)),
        ("difference", solid_of(a) - solid_of(b)),
    ):
        mesh = fb.boolean(op, a, b, resolution=64)
        assert_solid(mesh)
        assert mesh.volume == pytest.approx(exact.volume(), rel=5e-3)
        assert mesh.report.genus == exact.genus()
        assert solid_of((mesh.vertices, mesh.faces)).status() == manifold3d.Error.NoError


def test_a_smooth_union_adds_a_fillet():
    a, b = meshes.box(), meshes.box((0, 0, 0), (2, 2, 2))
    sharp, smooth = (fb.boolean("union", a, b, resolution=40, smooth=k) for k in (0, 0.4))
    assert_solid(smooth)
    assert smooth.volume > sharp.volume
    corner = [(0.97, 0.97, 1.03)]
    assert fb.contains(smooth, [(-0.02, 0.5, 1.02)])[0]
    assert not fb.contains(sharp, [(-0.04, 0.5, 1.04)])[0]
    assert fb.contains(smooth, corner)[0] == fb.contains(sharp, corner)[0]


@pytest.mark.parametrize(
    ("op", "lower", "upper"),
    [
        ("union", (1, 0, 0), (2, 1, 1)),
        ("union", (1, 0.2, 0.2), (2, 0.8, 0.8)),
        ("difference", (0, 0, 0), (0.5, 1, 1)),
        ("difference", (0, 0.2, 0.2), (0.5, 0.8, 0.8)),
        ("difference", (-0.2, 0, 0), (0.5, 1, 1)),
    ],
)
def test_common_faces_of_the_operands_are_no_source(op, lower, upper):
    first, second = (trimesh.creation.box(bounds=box) for box in (((0, 0, 0), (1, 1, 1)), (lower, upper)))
    made = fb.boolean(op, first, second, resolution=32)
    # A source point counts up to 2e-3 voxels along each axis from a change of sign, and its place has 1e-3 voxels.
    assert made.report.distance_from_source <= 5e-3 * made.report.voxel_size


# --- results and mistakes


def test_results_are_the_same_on_any_number_of_threads():
    first = fb.boolean("difference", meshes.torus(), meshes.icosphere(2, 0.9), resolution=24)
    fb.set_threads(1)
    try:
        second = fb.boolean("difference", meshes.torus(), meshes.icosphere(2, 0.9), resolution=24)
    finally:
        fb.set_threads(2)
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)


def far_box():
    return meshes.box((5, 5, 5), (6, 6, 6))


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: fb.offset(meshes.box(), -1.5, 24), "distance"),
        (lambda: fb.offset(meshes.box(), float("nan"), 24), "distance"),
        (lambda: fb.offset(meshes.box(), None, 24), "distance"),
        (lambda: fb.shell(meshes.box(), 0, 24), "thickness"),
        (lambda: fb.shell(meshes.box(), -0.1, 24), "thickness"),
        (lambda: fb.shell(meshes.box(), float("nan"), 24), "thickness"),
        (lambda: fb.shell(meshes.box(), 0.1, 24, side="left"), "side"),
        (lambda: fb.shell(meshes.box(), 0.1, 24, open="up"), "open"),
        (lambda: fb.shell(meshes.box(), 0.1, 24, open=[(0, 0, 0)]), "open"),
        (lambda: fb.shell(meshes.box(), 0.1, 24, open=3), "open"),
        (lambda: fb.shell(meshes.box(), 0.1, 24, open=["x", "-x", "y", "-y", "z", "-z"]), "open"),
        (lambda: fb.boolean("xor", meshes.box(), far_box(), resolution=24), "op"),
        (lambda: fb.boolean("intersection", meshes.box(), far_box(), resolution=24), "empty"),
        (lambda: fb.boolean("difference", meshes.box(), meshes.box((-2,) * 3, (2,) * 3), resolution=24), "empty"),
        (lambda: fb.boolean("union", meshes.box(), far_box(), resolution=24, smooth=-1), "smooth"),
        (lambda: fb.boolean("union", meshes.box(), far_box(), resolution=24, smooth=float("nan")), "smooth"),
        (lambda: fb.solid(meshes.box(), 24, fill="inner"), "fill"),
        (lambda: fb.solid(meshes.box(), 24, fill="outer", seal=-1), "seal"),
        (lambda: fb.solid(meshes.box(), 24, seal=2), "seal"),
        (lambda: fb.solid(object(), 24), "mesh"),
        (lambda: fb.solid(fb.box(2)), r"^mesh: must be a mesh, got a Shape; shape.to_mesh\(\) makes"),
        (lambda: fb.offset(fb.box(2), 1), r"^mesh: must be a mesh, got a Shape; shape.to_mesh\(\) makes"),
        (lambda: fb.boolean("union", meshes.box(), fb.box(2)), r"^b: must be a mesh, got a Shape; shape.to_mesh\(\)"),
        (lambda: fb.solid(fb.bake(fb.box(2), 9)), r"^mesh: must be a mesh, got a Volume; volume.to_mesh\(\)"),
        (
            lambda: fb.solid([fb.bake_sparse(fb.box(2), 9)]),
            r"^mesh\[0\]: must be a mesh, got a SparseVolume; volume.to_m",
        ),
    ],
)
def test_mistakes_are_mesh_errors(call, match):
    with pytest.raises(fb.MeshError, match=match):
        call()


@pytest.mark.parametrize("resolution", [0, -3, 2.5, None, (8, 8)])
def test_a_resolution_must_be_whole_numbers(resolution):
    with pytest.raises(fb.Error, match="resolution"):
        fb.solid(meshes.box(), resolution)


# --- fewer faces and thin parts


@pytest.mark.parametrize("tolerance", [0.002, 0.02])
def test_simplified_solids_stay_closed_and_near(tolerance):
    pytest.importorskip("manifold3d")
    cube = fb.box(2).to_mesh(24)
    cases = {
        "solid": lambda simplify: fb.solid(fb.models.torus_knot(), 40, simplify=simplify),
        "offset": lambda simplify: fb.offset(cube, 0.3, 32, simplify=simplify),
        "shell": lambda simplify: fb.shell(cube, 0.3, 32, open="z", simplify=simplify),
        "boolean": lambda simplify: fb.boolean(
            "difference", cube, fb.sphere(1.2).to_mesh(24), resolution=32, simplify=simplify
        ),
    }
    for name, make in cases.items():
        full, made = make(0), make(tolerance)
        assert_solid(made)
        assert len(made.faces) < len(full.faces), name
        assert made.report.genus == full.report.genus, name
        moved = made.report.distance_to_source
        # A reported distance is at most 0.1 % below the true one.
        assert moved <= full.report.distance_to_source / 0.999 + tolerance, name
        # The deviation belongs to the simplified mesh: its own samples are nowhere farther from the source.
        samples = surface_samples(made, 20_000)
        if name == "offset":
            assert np.abs(box_distance(samples, 1) - 0.3).max() <= moved + 1e-6


def test_flat_faces_need_few_triangles():
    pytest.importorskip("manifold3d")
    cube = fb.solid(fb.box(2).to_mesh(24), 32, simplify=1e-3)
    assert len(cube.faces) <= 50
    assert cube.volume == pytest.approx(8, rel=1e-3)


def test_a_tolerance_beyond_the_size_of_the_mesh_removes_faces():
    pytest.importorskip("manifold3d")
    full = fb.solid(fb.models.gear(), 32)
    for tolerance in (10, 1e6):
        assert len(fb.solid(fb.models.gear(), 32, simplify=tolerance).faces) < len(full.faces) / 2


@pytest.mark.parametrize("bad", [-1, np.nan, "much", None])
def test_a_wrong_tolerance_is_refused(bad):
    with pytest.raises(fb.MeshError, match="simplify"):
        fb.solid(fb.models.torus_knot(), 16, simplify=bad)


def test_simplify_without_manifold3d_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(fb.Error, match=r"simplify needs the package manifold3d.*fieldbake\[simplify\]"):
        fb.solid(fb.models.torus_knot(), 16, simplify=0.01)


def test_the_thinnest_part_of_a_shell_is_its_wall():
    made = fb.shell(fb.box(2).to_mesh(24), 0.3, 40)
    # Each side of the wall may be off by the distance between the result and the ideal shell.
    off = max(made.report.distance_to_source, made.report.distance_from_source)
    assert abs(made.report.thinnest_part - 0.3) <= 2 * off + 1e-6


# --- joints of touching shapes


@pytest.mark.parametrize("resolution", [30, 32, 33, 48, 64, 99])
def test_touching_shapes_are_one_solid(resolution):
    plate_with_boss = fb.box(2) | fb.cylinder(0.5, 1).translate((0, 0, 1.5))
    mesh = plate_with_boss.to_mesh(resolution)
    assert mesh.topology()["components"] == 1
    assert faults(mesh.vertices, mesh.faces) == []
    # The boss adds its side to the surface. The rim of the mesh is a polygon.
    assert mesh.area == pytest.approx(24 + np.pi, rel=0.002)


@pytest.mark.parametrize("resolution", range(20, 30))
@pytest.mark.parametrize("shift", [(1, 0.3, 0.2), (0, -1, 0), (0.25, 0.25, 1)])
def test_boxes_with_a_common_face_are_one_solid(resolution, shift):
    pair = fb.box(1) | fb.box(1).translate(shift)
    mesh = pair.to_mesh(resolution)
    assert mesh.topology()["components"] == 1
    assert mesh.volume == pytest.approx(2, rel=1e-6)


def test_a_gap_stays_open():
    apart = fb.box(1) | fb.box(1).translate((1.2, 0, 0))
    # A voxel of 0.1, with samples in the middle of the gap.
    mesh = apart.to_mesh(bounds=[(-0.75, -0.75, -0.75), (1.95, 0.75, 0.75)], voxel_size=0.1)
    assert mesh.topology()["components"] == 2
