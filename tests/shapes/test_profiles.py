"""Profiles: polygons with holes, Booleans, offsets, SVG paths, tapers, chamfers, twists and sweeps."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon, Polygon

import fieldbake as fb

RANDOM = np.random.default_rng(11)


def star(count: int, seed: int = 0, around: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A star-shaped polygon of many edges."""
    angles = 2 * np.pi * np.arange(count) / count
    radii = 1 + 0.3 * np.sin(7 * angles) + 0.05 * np.random.default_rng(seed).uniform(size=count)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1) + around


def flat_distance(loops, points: np.ndarray) -> np.ndarray:
    """Signed distance (n,) to all edges of all loops by brute force in float64; the sign is the parity of crossings."""
    nearest, inside = np.full(len(points), np.inf), np.zeros(len(points), bool)
    for loop in loops:
        for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
            spans = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
            rise = b[1] - a[1] if b[1] != a[1] else 1.0
            inside ^= spans & (points[:, 0] < a[0] + (points[:, 1] - a[1]) * (b[0] - a[0]) / rise)
    return np.where(inside, -nearest, nearest)


def shape_of(loops) -> shapely.Geometry:
    """The region of loops under the even-odd rule."""
    region: shapely.Geometry = Polygon()
    for loop in loops:
        region = region.symmetric_difference(Polygon(loop).buffer(0))
    return region


def signed_area(loop: np.ndarray) -> float:
    x, y = (loop - loop[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def genus(mesh: fb.Mesh) -> float:
    """The genus of a closed mesh of one body, by Euler's formula."""
    return 1 - (len(mesh.vertices) - len(mesh.faces) / 2) / 2


FRAME = [np.array([(-3, -2), (3, -2), (3, 2), (-3, 2)]), np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])]
CASES = {
    "star of 2000 edges": [star(2000)],
    "stars with holes": [star(400), 0.5 * star(300, 1), 0.2 * star(7, 2), star(50, 3, (4, 1))],
    "frame": FRAME,
    # Points above the middle of a straight edge are nearest to a corner at which nothing turns.
    "straight corners": [np.array([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (1.5, 1 + 1e-9), (0, 1)])],
    "needle": [np.array([(0, 0), (5, 1e-4), (0, 2e-4)])],
    "far away": [star(200, 4, (1e5, -2e5))],
}


@pytest.mark.parametrize("name", CASES)
def test_extruded_polygons_are_exact(name, device):
    loops = CASES[name]
    profile = fb.polygon(loops)
    solid = profile.extrude(1.0)
    assert solid.exact
    lower, upper = profile.bounds
    size = float((upper - lower).max())
    flat = np.concatenate(
        [RANDOM.uniform(lower - size, upper + size, (3000, 2)), RANDOM.uniform(lower, upper, (3000, 2))]
        + [corner + RANDOM.normal(scale=1e-3 * size, size=(20, 2)) for corner in np.concatenate(loops)[:40]]
    )
    truth = flat_distance(loops, flat)
    # The points lie so close to z = 0 that the ends of the extrusion are farther than the sides, within the height.
    points = np.column_stack([flat, np.zeros(len(flat))])
    expected = np.maximum(truth, -0.5)
    found = solid.distance(points, dtype="float64")
    assert np.abs(found - expected).max() <= 1e-12 * (np.abs(lower).max() + size) * 10
    single = solid.distance(points, device=device)
    assert np.abs(single - expected).max() <= 2e-6 * size + 1e-7 * np.abs(flat).max()
    clear = np.abs(truth) > 4e-6 * size
    assert ((single < 0) == (truth < 0))[clear].all()


def test_gradients_of_polygons_have_length_1():
    solid = fb.polygon(CASES["stars with holes"]).extrude(20)
    flat = RANDOM.uniform((-1.5, -1.5), (5.5, 2), (2000, 2))
    points = np.column_stack([flat, np.zeros(len(flat))])
    lengths = np.linalg.norm(solid.gradient(points), axis=1)
    assert np.abs(lengths - 1)[solid.distance(points) > 0.01].max() <= 1e-4


@pytest.mark.parametrize("rule", ["even-odd", "nonzero"])
def test_rules_are_those_of_winding_numbers(rule):
    for seed in range(20):
        loops = [np.random.default_rng(seed + 100 * i).uniform(-1, 1, (6, 2)) for i in range(3)]
        profile = fb.polygon(loops, rule=rule)
        points = RANDOM.uniform(-1.1, 1.1, (4000, 2))
        turns = np.zeros(len(points), int)
        for loop in loops:
            for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                side = (b[0] - a[0]) * (points[:, 1] - a[1]) - (points[:, 0] - a[0]) * (b[1] - a[1])
                turns += ((a[1] <= points[:, 1]) & (b[1] > points[:, 1]) & (side > 0)).astype(int)
                turns -= ((b[1] <= points[:, 1]) & (a[1] > points[:, 1]) & (side < 0)).astype(int)
        inside = turns % 2 == 1 if rule == "even-odd" else turns != 0
        found = profile.extrude(2).distance(np.column_stack([points, 0 * points[:, 0]]), dtype="float64")
        clear = np.abs(found) > 1e-9
        assert ((found < 0) == inside)[clear].all()
        # Outer loops are counter-clockwise and holes clockwise, so that their areas add up.
        assert profile.area > 0
        assert abs(profile.area - sum(signed_area(loop) for loop in profile.polygons)) <= 1e-12
        if rule == "even-odd":
            whole = shapely.Polygon()
            for loop in loops:
                pieces = shapely.polygonize([shapely.node(shapely.LinearRing(loop))]).geoms
                odd = [piece for piece in pieces if _is_odd(loop, piece.representative_point())]
                whole = whole.symmetric_difference(shapely.union_all(odd))
            assert profile.area == pytest.approx(whole.area, abs=1e-9)


def _is_odd(loop, point):
    return flat_distance([loop], np.array([(point.x, point.y)]))[0] < 0


def test_resolved_polygons_keep_their_corners():
    # 1/3 has no short binary expansion. Corners of clean input are the same float64 numbers.
    loop = np.array([(1 / 3, 0), (1, 1 / 7), (0.2, 0.9)])
    assert np.array_equal(fb.polygon(loop).polygons[0], loop)
    assert np.array_equal(fb.polygon(loop[::-1]).polygons[0][::-1], loop[::-1][::-1][::-1])
    united = fb.polygon(loop) | fb.polygon(loop + 5)
    corners = {tuple(p) for p in np.concatenate(united.polygons).round(12)}
    assert corners == {tuple(p) for p in np.concatenate([loop, loop + 5]).round(12)}


def test_booleans_match_shapely():
    a, b = CASES["stars with holes"], [loop * 0.8 + (0.4, 0.1) for loop in FRAME]
    p, q = fb.polygon(a), fb.polygon(b)
    s, t = shape_of(a), shape_of(b)
    for made, truth in ((p | q, s | t), (p & q, s & t), (p - q, s - t), (p ^ q, s ^ t)):
        assert made.area == pytest.approx(truth.area, rel=1e-9)
        assert shape_of(made.polygons).symmetric_difference(truth).area <= 1e-9
        for loop in made.polygons:
            assert Polygon(loop).is_valid
        solid = made.extrude(3)
        inside = shapely.contains_xy(truth, *(points := RANDOM.uniform(-3, 6, (3000, 2))).T)
        assert ((solid.distance(np.column_stack([points, 0 * points[:, 0]])) < 0) == inside).all()


@pytest.mark.parametrize("distance", [0.3, -0.15, 0.05])
def test_offsets_lie_at_their_distance(distance):
    loops = CASES["stars with holes"]
    profile = fb.polygon(loops)
    moved = profile.offset(distance)
    # Arcs are within 1.3e-4 of the distance.
    for loop in moved.polygons:
        dense = np.concatenate([loop, 0.5 * (loop + np.roll(loop, -1, axis=0))])
        assert np.abs(flat_distance(loops, dense) - distance).max() <= 1.3e-4 * abs(distance)
    truth = shape_of(loops).buffer(distance, quad_segs=200)
    assert moved.area == pytest.approx(truth.area, rel=1e-4)
    assert shape_of(moved.polygons).symmetric_difference(truth).area <= 2e-4 * abs(distance) * truth.length


def test_offsets_of_discs_and_rectangles_are_exact():
    assert fb.circle(2).offset(0.5).extrude(1) == fb.circle(2.5).extrude(1)
    assert fb.rectangle((4, 3)).offset(-1).extrude(1) == fb.rectangle((2, 1)).extrude(1)
    rounded = fb.rectangle((4, 3)).offset(0.5)
    assert rounded.area == pytest.approx(12 + 7 + math.pi / 4, rel=2e-5)
    with pytest.raises(fb.ShapeError, match=r"^distance: nothing is left"):
        fb.rectangle((4, 3)).offset(-1.5)
    with pytest.raises(fb.ShapeError, match=r"^distance: nothing is left"):
        fb.circle(1).offset(-1)


def test_an_opening_removes_thin_parts():
    handle = fb.rectangle((4, 4)) | fb.rectangle((10, 0.2))
    opened = handle.offset(-0.2).offset(0.2)
    # A disc of the radius 0.2 reaches between the corners of the handle, which are 0.2 apart.
    assert opened.bounds.max() == pytest.approx(2.2 - math.sqrt(0.03), abs=1e-3)


def test_discs_as_polygons_have_the_area_of_discs():
    assert fb.circle(3).area == pytest.approx(9 * math.pi, rel=1e-12)
    corners = np.linalg.norm(fb.circle(3).polygons[0], axis=1)
    assert np.abs(corners - 3).max() <= 3e-4


@pytest.mark.parametrize("taper", [25, -25, 0])
@pytest.mark.parametrize("chamfer", [0.0, 0.2, (0.3, 0.0), (0.1, 0.4)])
def test_tapers_and_chamfers_shrink_the_sections(taper, chamfer, device):
    loops = CASES["stars with holes"]
    profile = fb.polygon(loops)
    solid = profile.extrude(2, taper_deg=taper, chamfer=chamfer)
    points = RANDOM.uniform((-2, -2, -1.3), (5.5, 2, 1.3), (6000, 3))
    _x, _y, z = points.T
    flat = flat_distance(loops, points[:, :2])
    low, high = (chamfer, chamfer) if np.ndim(chamfer) == 0 else chamfer
    angle = math.radians(taper)
    side = flat * math.cos(angle) + (z + math.copysign(1, taper)) * math.sin(angle)
    inside = (side < 0) & (np.abs(z) < 1) & (side + high + z < 1) & (side + low - z < 1)
    found = solid.distance(points, device=device)
    clear = np.abs(found) > 1e-5
    assert ((found < 0) == inside)[clear].all()
    assert solid.exact == (taper == 0 and chamfer == 0.0)
    assert (points[inside] >= solid.bounds[0]).all()
    assert (points[inside] <= solid.bounds[1]).all()
    # The field is a lower bound: its slope is at most 1.
    near = points + RANDOM.normal(scale=0.01, size=points.shape)
    moved = np.linalg.norm(near - points, axis=1)
    assert (
        np.abs(solid.distance(near, dtype="float64") - solid.distance(points, dtype="float64")) <= moved * (1 + 1e-9)
    ).all()
    again = fb.csg.parse(solid.to_sexpr())
    assert np.abs(again.distance(points) - found).max() <= 1e-6


def test_discs_with_tapers_are_cones_and_combined_ones_are_whole():
    cone = fb.circle(2).extrude(2, taper_deg=45)
    assert cone.to_mesh(48).volume == pytest.approx(math.pi * 2 / 3 * (4 + 0), rel=2e-3)
    frame = (fb.rectangle((8, 8)) - fb.circle(2)).extrude(2, chamfer=0.5)
    # The hole is wider at its ends, by the chamfer.
    points = [(2.3, 0, 0.99), (2.3, 0, 0), (2.6, 0, 0.99)]
    assert (frame.distance(points) < 0).tolist() == [False, True, True]


def test_chamfered_discs_are_drawn_like_their_meshes():
    # Rays find plain discs in closed form; chamfers are no part of it.
    disc = fb.circle(1).extrude(1, chamfer=0.3)
    frame = fb.raymarch(disc, fb.Camera((0, 0, 5), (0, 0, 0), up=(0, 1, 0), fov_deg=30), size=(96, 96), device="cpu")
    hit = np.isfinite(frame.depth)
    radius = 0.9
    step = 2 * 5 * math.tan(math.radians(15)) / 96
    depth = frame.depth[48, 48 + round(radius / (step * 4.7 / 5))]
    assert hit.mean() > 0.1
    # At the radius 0.9 the chamfer is 0.2 below the end face, which is at depth 4.5.
    assert depth == pytest.approx(4.7, abs=0.06)


def test_twists_turn_the_ends():
    bar = fb.rectangle((4, 1)).extrude(3, twist_deg=90)
    assert bar.distance([(1.2, 1.2, 1.4), (-1.2, 1.2, 1.4)]).tolist()[0] < 0 < bar.distance([(-1.2, 1.2, 1.4)])[0]
    assert bar.distance([(-1.2, 1.2, -1.4), (1.2, 1.2, -1.4)]).tolist()[0] > -1
    assert (bar.distance([(1.2, -1.2, -1.4), (1.2, 1.2, -1.4)]) < 0).tolist() == [True, False]


def test_a_disc_swept_along_a_corner_is_a_mitred_pipe():
    path = np.array([(0, 0, 0), (6, 0, 0), (6, 5, 0), (6, 5, 4)])
    pipe = fb.circle(0.7).sweep(path)
    points = RANDOM.uniform((-1, -2, -2), (8, 7, 5), (20000, 3))
    inside = np.zeros(len(points), bool)
    steps = np.diff(path, axis=0)
    along = steps / np.linalg.norm(steps, axis=1)[:, None]
    for i, (start, direction, length) in enumerate(zip(path, along, np.linalg.norm(steps, axis=1), strict=False)):
        from_start = points - start
        at = from_start @ direction
        within = np.linalg.norm(from_start - at[:, None] * direction, axis=1) < 0.7
        before = at > 0 if i == 0 else from_start @ (along[i - 1] + direction) > 0
        after = at < length if i == 2 else (points - path[i + 1]) @ (direction + along[i + 1]) < 0
        inside |= within & before & after
    found = pipe.distance(points)
    assert ((found < 0) == inside)[np.abs(found) > 1e-5].all()
    # No face is left inside: the middle of each corner is as deep as the pipe.
    assert pipe.distance(path[1:3]) == pytest.approx([-0.7, -0.7], abs=1e-5)
    mesh = pipe.to_mesh(96)
    assert mesh.is_closed
    assert genus(mesh) == 0
    assert mesh.volume == pytest.approx(math.pi * 0.49 * 15, rel=2e-3)


def test_profiles_keep_their_direction_along_a_sweep():
    rail = fb.rectangle((0.4, 2)).sweep([(0, 0, 0), (5, 0, 0), (5, 5, 0)])
    # y of the profile is z of the world.
    assert (rail.distance([(2, 0, 0.9), (5, 3, 0.9), (2, 0.9, 0)]) < 0).tolist() == [True, True, False]
    ring = fb.rectangle((0.4, 2)).sweep([(0, 0, 0), (5, 0, 0), (5, 5, 0), (0, 5, 0), (0, 0, 0)])
    assert genus(ring.to_mesh(64)) == 1
    truth = 2 * (5.4**2 - 4.6**2)
    assert ring.to_mesh(64).volume == pytest.approx(truth, rel=2e-3)


def test_a_spring_is_a_tube_around_its_helix():
    path = fb.helix(4, 2.5, 2)
    spring = fb.circle(0.5).sweep(path)
    at = np.linspace(0, 2, 20001)
    curve = np.stack([4 * np.cos(2 * np.pi * at), 4 * np.sin(2 * np.pi * at), 2.5 * at], axis=1)
    turns = RANDOM.uniform(0.1, 1.9, 400)
    middle = np.stack([4 * np.cos(2 * np.pi * turns), 4 * np.sin(2 * np.pi * turns), 2.5 * turns], axis=1)
    points = middle + RANDOM.normal(scale=0.4, size=middle.shape)
    truth = np.array([np.linalg.norm(curve - p, axis=1).min() for p in points]) - 0.5
    found = spring.distance(points)
    # The segments are within 0.22 % of the radius of the helix.
    assert ((found < 0) == (truth < 0))[np.abs(truth) > 0.012].all()
    assert (np.abs(found) <= np.abs(truth) + 0.012).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.polygon([]), "points"),
        (lambda: fb.polygon([[(0, 0), (1, 0)], [(0, 0), (1, 0), (1, 1)]]), r"points\[0\]: must have shape"),
        (lambda: fb.polygon([(0, 0), (1, 0), (np.nan, 1)]), "points"),
        (lambda: fb.polygon([(0, 0), (1, 0), (1, 1)], rule="odd"), "rule: must be"),
        (lambda: fb.polygon(np.tile([(0.0, 0), (1, 0), (1, 1)], (30000, 1))), "points: a profile has at most 65536"),
        (lambda: fb.circle(1).extrude(1, taper_deg=90), "taper_deg: must be -89 to 89"),
        (lambda: fb.circle(1).extrude(1, chamfer=-1), "chamfer: must be"),
        (lambda: fb.circle(1).extrude(1, chamfer=(0.6, 0.5)), "chamfer: takes 1.1 off the height of 1"),
        (lambda: fb.circle(1).extrude(1, chamfer=(1, 2, 3)), "chamfer"),
        (lambda: fb.circle(1).sweep([(0, 0, 0)]), "path: must have shape"),
        (lambda: fb.circle(1).sweep([(0, 0, 0), (0, 0, 0)]), r"path: \[0\] and \[1\] are the same"),
        (lambda: fb.circle(1).sweep([(0, 0, 0), (1, 0, 0), (0, 0, 0)]), r"path: turns back at \[1\]"),
        (lambda: fb.circle(1).sweep([(0, 0, 0), (0.5, 0, 0), (0.5, 2, 0)]), r"path: the segment from \[0\]"),
        (lambda: fb.helix(1, 1, 0), "turns: must be above 0"),
        (lambda: fb.Profile.from_svg("M0 0"), "source"),
        (lambda: fb.Profile.from_svg("M0 0 H1 V1", tolerance=0), "tolerance: must be above 0"),
        (lambda: fb.Profile.from_svg("M0 0 H1 V1", rule="odd"), "rule: must be"),
    ],
)
def test_mistakes_name_the_argument(make, message):
    with pytest.raises(fb.ShapeError, match=f"^{message}"):
        make()


def test_svg_paths_have_the_area_of_their_curves():
    disc = fb.Profile.from_svg("M-5 0 A5 5 0 0 1 5 0 A5 5 0 0 1 -5 0 Z")
    assert disc.area == pytest.approx(25 * math.pi, rel=1e-7)
    radii = np.linalg.norm(disc.polygons[0], axis=1)
    assert np.abs(radii - 5).max() <= 1e-3  # 1e-4 of the longest side
    # A cubic with the area 3/10 (x1 y2 - ...) by Green's theorem: control points (0, 0), (0, 1), (1, 1), (1, 0).
    hill = fb.Profile.from_svg("M0 0 C0 -1 1 -1 1 0 Z")
    assert hill.area == pytest.approx(0.6, rel=1e-12)
    assert hill.bounds[1, 1] == pytest.approx(0.75, abs=2e-4)
    finer = fb.Profile.from_svg("M0 0 C0 -1 1 -1 1 0 Z", tolerance=1e-6)
    t = np.linspace(0, 1, 100001)[:, None]
    curve = 3 * (1 - t) ** 2 * t * (0, 1) + 3 * (1 - t) * t**2 * (1, 1) + t**3 * (1, 0)
    for profile, tolerance in ((hill, 1e-4), (finer, 1e-6)):
        assert (
            shapely.hausdorff_distance(shapely.LinearRing(curve), shapely.LinearRing(profile.polygons[0]))
            <= tolerance * 1.01 + 1e-6
        )
    assert fb.Profile.from_svg("M0 0 Q1 -2 2 0 Z").area == pytest.approx(4 / 3, rel=1e-12)


def test_svg_pictures_have_their_fill_rules_and_transforms(tmp_path):
    file = tmp_path / "part.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 40 40" width="40" height="40">'
        '<g transform="translate(10 10) scale(2)"><path fill-rule="evenodd" d="M0 0H4V4H0Z M1 1H3V3H1Z"/></g>'
        '<rect x="30" y="30" width="4" height="2"/><circle cx="5" cy="35" r="3" fill="none" stroke="black"/></svg>'
    )
    profile = fb.Profile.from_svg(file)
    assert profile.area == pytest.approx(4 * 12 + 8)
    assert profile.bounds == pytest.approx(np.array([(10, -32), (34, -10)]))
    assert fb.Profile.from_svg(file, rule="nonzero").area == pytest.approx(4 * 16 + 8)
    with pytest.raises(FileNotFoundError):
        fb.Profile.from_svg(tmp_path / "none.svg")


def test_sections_become_profiles_again():
    mesh = fb.models.gear()
    section = mesh.section((0, 0, 0), "z")
    again = fb.polygon(section.polygons)
    assert again.area == pytest.approx(section.area, rel=1e-12)
    assert len(again.polygons) == len(section.polygons)


def test_the_cost_of_a_polygon_depends_little_on_its_edges():
    points = np.column_stack([RANDOM.uniform(-1.5, 1.5, (40000, 2)), np.zeros(40000)])

    def seconds(count: int) -> float:
        angles = 2 * np.pi * np.arange(count) / count
        radii = 1 + 0.3 * np.sin(9 * angles)
        solid = fb.polygon(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)).extrude(1)
        solid.distance(points[:100], device="cpu")
        runs = []
        for _ in range(3):
            start = time.perf_counter()
            solid.distance(points, device="cpu")
            runs.append(time.perf_counter() - start)
        return min(runs)

    # A search among all edges takes 100 times as long.
    assert seconds(20000) <= 30 * seconds(200)


def test_polygons_are_drawn_on_devices_as_on_the_cpu(device):
    letters = (fb.polygon(CASES["stars with holes"]).extrude(1) - fb.polygon(FRAME).scale(0.3).extrude(3)).paint(
        (1, 0, 0)
    )
    camera = fb.Camera((3, -6, 6), (1.5, 0, 0), up=(0, 0, 1))
    truth = fb.raymarch(letters, camera, size=(64, 48), device="cpu")
    found = fb.raymarch(letters, camera, size=(64, 48), device=device)
    both = np.isfinite(truth.depth) & np.isfinite(found.depth)
    assert both.mean() > 0.1
    assert (np.isfinite(truth.depth) != np.isfinite(found.depth)).mean() <= 0.005
    assert np.abs(truth.depth[both] - found.depth[both]).max() <= 1e-3


def test_profiles_show_themselves():
    assert "<svg" in fb.polygon(FRAME)._repr_svg_()
    assert repr(fb.polygon(FRAME)) == "Profile(2 polygons, 8 corners)"
    assert isinstance(shape_of(fb.polygon(FRAME).polygons), (Polygon, MultiPolygon))
