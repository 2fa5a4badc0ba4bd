"""Screw threads: exact distances, the dimensions of ISO 68-1 and ISO 2904 on meshes, clearances and volumes."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import fieldbake as fb

RANDOM = np.random.default_rng(3)

#: Diameter, pitch and profile of M10, M3, and Tr 20x4.
THREADS = [(10, 1.5, "iso"), (3, 0.5, "iso"), (20, 4, "trapezoidal")]


def profile(diameter: float, pitch: float, kind: str) -> np.ndarray:
    """Corners (r, u) of the basic profile over one period, from the middle of a crest."""
    if kind == "iso":
        height = math.sqrt(3) / 2 * pitch
        minor, crest, root = diameter / 2 - 5 / 8 * height, pitch / 8, pitch / 4
    else:
        minor = diameter / 2 - pitch / 2
        crest = root = pitch / 2 - pitch / 2 * math.tan(math.radians(15))
    major = diameter / 2
    return np.array(
        [
            (major, -crest / 2),
            (major, crest / 2),
            (minor, pitch / 2 - root / 2),
            (minor, pitch / 2 + root / 2),
            (major, pitch - crest / 2),
        ]
    )


def flat_distance(corners: np.ndarray, pitch: float, r: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Distance to the periodic profile in its plane."""
    nearest = np.full(np.broadcast(r, u).shape, np.inf)
    at = (u + corners[1, 1]) % pitch - corners[1, 1]
    for shift in (-pitch, 0, pitch):
        for a, b in itertools.pairwise(corners):
            edge = b - a
            x, y = r - a[0], at + shift - a[1]
            share = np.clip((x * edge[0] + y * edge[1]) / (edge @ edge), 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - share * edge[0], y - share * edge[1]))
    return nearest


def truth(diameter: float, pitch: float, kind: str, points: np.ndarray) -> np.ndarray:
    """Signed distance to the thread by a search over the screw angle, refined twice."""
    corners, rise = profile(diameter, pitch, kind), pitch / (2 * math.pi)
    r, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2] - rise * np.arctan2(points[:, 1], points[:, 0])

    def squared(turn: np.ndarray) -> np.ndarray:
        flat = flat_distance(corners, pitch, r[:, None] * np.cos(turn), height[:, None] - rise * turn)
        return (r[:, None] * np.sin(turn)) ** 2 + flat**2

    turn, step = np.zeros((len(points), 1)), np.pi
    for count in (721, 41, 41, 41):
        around = turn + step * np.linspace(-1, 1, count)
        found = squared(around)
        turn = around[np.arange(len(points)), found.argmin(axis=1)][:, None]
        step *= 3 / count
    limit = np.interp((height + corners[1, 1]) % pitch - corners[1, 1], corners[:, 1], corners[:, 0])
    return np.where(r < limit, -1, 1) * np.sqrt(found.min(axis=1))


@pytest.mark.parametrize(("diameter", "pitch", "kind"), THREADS)
def test_fields_of_threads_are_exact_near_and_bounded_far(diameter, pitch, kind, device):
    rod = fb.thread(diameter, pitch, None, profile=kind)
    far = RANDOM.uniform(-0.8 * diameter, 0.8 * diameter, (600, 3))
    axis = RANDOM.normal(scale=0.05 * diameter, size=(300, 3))
    radii = RANDOM.uniform(0.38 * diameter, 0.58 * diameter, 900)
    angles = RANDOM.uniform(-np.pi, np.pi, 900)
    near = np.stack([radii * np.cos(angles), radii * np.sin(angles), RANDOM.uniform(-diameter, diameter, 900)], axis=1)
    points = np.concatenate([far, axis, near])
    expected = truth(diameter, pitch, kind, points)
    found = rod.distance(points, dtype="float64")
    assert ((found < 0) == (expected < 0))[np.abs(expected) > 1e-9].all()
    assert (np.abs(found) <= rod.lipschitz * np.abs(expected) + 1e-9).all()
    is_near = (np.abs(expected) <= 0.5 * pitch) & (np.hypot(points[:, 0], points[:, 1]) >= 0.3 * diameter)
    assert is_near.sum() >= 500
    # The search of the truth ends at steps of 1e-4 of a turn, whose effect is quadratic.
    assert np.abs(found - expected)[is_near].max() <= 1e-6 * pitch
    single = rod.distance(points, device=device)
    assert np.abs(single - found).max() <= 4e-6 * diameter


@pytest.mark.parametrize(("diameter", "pitch", "kind"), THREADS)
def test_meshes_have_the_dimensions_of_the_standards(diameter, pitch, kind):
    length = 4 * pitch
    mesh = fb.thread(diameter, pitch, length, profile=kind).to_mesh(voxel_size=pitch / 16)
    assert mesh.is_closed
    section = mesh.section((0, 0, 0), "y")
    (loop,) = section.polygons
    # World coordinates of the section: the axis of the thread and the distance from it.
    world = loop @ section.plane[:3, :2].T + section.plane[:3, 3]
    r, z = world[:, 0], world[:, 2]
    side = (r > 0) & (np.abs(z) < 0.5 * length - 0.01 * pitch)
    r, z = r[side], z[side]
    minor = {"iso": diameter - 1.0825318 * pitch, "trapezoidal": diameter - pitch}[kind]
    assert 2 * r.max() == pytest.approx(diameter, abs=2e-3 * pitch)
    assert 2 * r.min() == pytest.approx(minor, abs=2e-3 * pitch)
    # Flanks: straight lines between both diameters.
    depth = 0.5 * (diameter - minor)
    flank = (r > 0.5 * minor + 0.1 * depth) & (r < 0.5 * diameter - 0.1 * depth)
    order = np.argsort(z[flank])
    fr, fz = r[flank][order], z[flank][order]
    groups = np.split(np.arange(len(fz)), np.flatnonzero(np.diff(fz) > 0.1 * pitch) + 1)
    lines = [np.polyfit(fr[group], fz[group], 1) for group in groups if len(group) >= 4]
    assert len(lines) >= 5
    angles = np.degrees(np.arctan(np.abs([line[0] for line in lines])))
    assert np.abs(angles - {"iso": 30, "trapezoidal": 15}[kind]).max() <= 0.1
    # On the pitch diameter, flanks of the same direction are a pitch apart, and neighbours are half a pitch apart.
    pitch_radius = 0.5 * (diameter - {"iso": 0.6495191, "trapezoidal": 0.5}[kind] * pitch)
    places = np.array([np.polyval(line, pitch_radius) for line in lines])
    assert np.abs(np.diff(places[::2]) - pitch).max() <= 2e-3 * pitch
    assert np.abs(np.diff(places) - 0.5 * pitch).max() <= 2e-3 * pitch
    # Right-handed: a quarter turn later the crest is a quarter of the pitch higher.
    assert places.size


def test_threads_are_right_handed():
    rod = fb.thread(10, 1.5, None)
    at = lambda turn, z: (4.9 * math.cos(2 * math.pi * turn), 4.9 * math.sin(2 * math.pi * turn), z)  # noqa: E731
    assert (rod.distance([at(t, 1.5 * t) for t in (0, 0.25, 0.5, 0.75, 1, 7.3)]) < 0).all()
    assert (rod.distance([at(t, 1.5 * t + 0.75) for t in (0, 0.25, 0.5, 0.75, 1, 7.3)]) > 0).all()


@pytest.mark.parametrize(("diameter", "pitch", "kind"), THREADS)
@pytest.mark.parametrize("clearance", [0.02, 0.1])
def test_the_clearance_is_the_same_everywhere(diameter, pitch, kind, clearance):
    gap = clearance * pitch
    length = 6 * pitch
    bolt = fb.thread(diameter, pitch, length, profile=kind, clearance=gap)
    hole = fb.thread(diameter, pitch, length, internal=True, profile=kind)
    nut = fb.cylinder(0.8 * diameter, length - pitch) - hole
    inner, outer = bolt.to_mesh(voxel_size=pitch / 24), nut.to_mesh(voxel_size=pitch / 24)

    def away(mesh, field):
        """Largest distance of a mesh from the surface of its thread, at random points beside it."""
        points = fb.sample_surface(mesh, 20000, seed=1).points
        radius = np.hypot(points[:, 0], points[:, 1])
        points = points[(np.abs(points[:, 2]) < 1.5 * pitch) & (radius > 0.3 * diameter) & (radius < 0.6 * diameter)]
        return points, np.abs(field.distance(points, dtype="float64")).max()

    samples, of_bolt = away(inner, bolt)
    _, of_nut = away(outer, hole)
    assert len(samples) > 3000
    measured = fb.closest_point(outer, samples).distances
    # Chords of the triangulation leave the helical edges by 1 % of the pitch at most, elsewhere by a tenth of that.
    assert max(of_bolt, of_nut) <= 0.01 * pitch
    assert measured.min() >= 0.99 * gap - of_bolt - of_nut
    assert measured.max() <= 1.01 * gap + of_bolt + of_nut
    # Four helical edges with a voxel around each are a tenth of the profile.
    assert (np.abs(measured - gap) <= 0.01 * gap + 5e-4 * pitch).mean() >= 0.9
    # Exact points of the surface of the rod, by the field of the hole.
    exact = samples - bolt.gradient(samples) * bolt.distance(samples, dtype="float64")[:, None]
    assert np.abs(-hole.distance(exact, dtype="float64") - gap).max() <= 0.01 * gap


@pytest.mark.parametrize(("diameter", "pitch", "kind"), THREADS)
def test_volumes_are_those_of_the_integral(diameter, pitch, kind):
    corners = profile(diameter, pitch, kind)
    # A section across the axis has the area pi/pitch times the integral of r^2 over a period.
    a, b = corners[:-1], corners[1:]
    square = ((b - a)[:, 1] * (a[:, 0] ** 2 + a[:, 0] * b[:, 0] + b[:, 0] ** 2) / 3).sum()
    length = 5 * pitch
    mesh = fb.thread(diameter, pitch, length, profile=kind).to_mesh(voxel_size=pitch / 12)
    assert mesh.volume == pytest.approx(math.pi / pitch * square * length, rel=1e-3)


def test_lead_ins_taper_rods_and_sink_holes():
    rod = fb.thread(10, 1.5, 20, lead_in=1.2)
    assert rod.bounds[:, 2].tolist() == [-10, 10]
    radius = np.hypot(*rod.to_mesh(128).vertices.T[:2])
    tops = radius[rod.to_mesh(128).vertices[:, 2] > 9.999]
    assert tops.max() == pytest.approx(3.8, abs=0.05)
    hole = fb.thread(10, 1.5, 8, internal=True, lead_in=1)
    minor = 5 - 0.625 * math.sqrt(0.75) * 1.5
    nut = fb.hex_prism(9, 8) - hole
    assert (nut.distance([(minor + 0.9, 0, 3.99), (0, minor + 0.9, -3.99)]) > 0).all()
    assert (nut.distance([(minor + 1.1, 0, 3.99), (0, minor + 1.1, -3.99)]) < 0).all()
    # Nothing of the plane of the end covers the hole, which goes on for a pitch.
    assert nut.distance([(0, 0, 4)])[0] == pytest.approx(1.5, abs=1e-5)
    mesh = nut.to_mesh(128)
    assert mesh.is_closed
    # A ring, by Euler's formula.
    assert len(mesh.vertices) == len(mesh.faces) / 2
    short = fb.thread(10, 1.5, 1.0, lead_in=2)
    assert short.to_mesh(64).is_closed


def test_threads_are_written_and_read_again():
    for made in (
        fb.thread(10, 1.5, None),
        fb.thread(20, 4, None, profile="trapezoidal", clearance=0.1),
        fb.thread(10, 1.5, None, internal=True, clearance=0.2),
    ):
        assert fb.csg.parse(made.to_sexpr()) == made
        text = repr(made)[6:-1]
        assert eval(text, {"thread": fb.thread}) == made


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.thread(0, 1, 5), "diameter: must be"),
        (lambda: fb.thread(10, 0, 5), "pitch: must be"),
        (lambda: fb.thread(10, 4, 5), "pitch: must be at most the minor radius"),
        (lambda: fb.thread(10, 1.5, 0), "length: must be above 0"),
        (lambda: fb.thread(10, 1.5, 5, profile="buttress"), "profile: must be"),
        (lambda: fb.thread(10, 1.5, 5, clearance=-0.1), "clearance: must be at least 0"),
        (lambda: fb.thread(10, 1.5, 5, clearance=2), "clearance: must be at most a quarter"),
        (lambda: fb.thread(10, 1.5, 5, lead_in=-1), "lead_in: must be at least 0"),
        (lambda: fb.thread(10, 1.5, 5, lead_in=6), "lead_in: must be below half"),
        (lambda: fb.thread(10, 1.5, None, lead_in=1), "lead_in: needs a length"),
    ],
)
def test_mistakes_name_the_argument(make, message):
    with pytest.raises(fb.ShapeError, match=f"^{message}"):
        make()
