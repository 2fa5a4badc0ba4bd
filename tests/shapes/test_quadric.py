"""Quadrics: hits against closed forms and float64 roots, shadows as products, records byte by byte."""

from __future__ import annotations

import pickle
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fieldbake as fb
from fieldbake import Quadric

#: Relative error bound of depths where a ray crosses a surface at a slope above GRAZING.
DEPTH = 1e-5
#: Slope along the ray, in units of the gradient's length at the hit: float32 roots move by some roundings over it.
GRAZING = 0.05


def rays(camera: fb.Camera, size: tuple[int, int]) -> np.ndarray:
    """World directions through pixel centres, one unit along the viewing axis."""
    width, height = size
    pixel = 2 * np.tan(np.radians(camera.fov_deg) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - 0.5 - np.arange(height)) * pixel
    local = np.stack([*np.meshgrid(x, y), np.full((height, width), -1.0)], axis=-1)
    return local @ camera.pose[:3, :3].T


def nearest_root(f, origin, directions, center, radius):
    """First t > 0 with f(origin + t direction) = 0 inside the trim sphere, and how certain it is; f is quadratic.

    Coefficients from three values of `f` about the point of the ray that is nearest to the centre. The certainty is the
    smallest of: slope at the root and clearance from the trim sphere, both relative.
    """
    length = np.linalg.norm(directions, axis=-1)
    middle = np.sum((center - origin) * directions, axis=-1) / length**2
    start = origin + middle[..., None] * directions
    step = (radius / length)[..., None] * directions
    below, here, above = f(start - step), f(start), f(start + step)
    a, b, c = (above + below) / 2 - here, (above - below) / 4, here
    size = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.maximum(np.abs(c), 1e-300))
    discriminant = b * b - a * c
    with np.errstate(all="ignore"):
        k = -(b + np.copysign(np.sqrt(np.maximum(discriminant, 0)), b))
        candidates = np.stack([k / a, c / k])
        candidates[:, discriminant < 0] = np.nan
        candidates[0, np.abs(a) < 1e-12 * np.abs(k)] = np.nan
        t = middle + candidates * radius / length
        points = origin + t[..., None] * directions
        apart = np.linalg.norm(points - center, axis=-1) / radius
        valid = (apart <= 1 + 1e-9) & (t > 0)
    t = np.where(valid, t, np.inf)
    with np.errstate(all="ignore"):
        slope = np.abs(2 * (a * candidates + b)) / size
    unclear = (np.abs(discriminant) < GRAZING**2 * size**2) | (np.abs(apart - 1) < 1e-3).any(axis=0)
    pick = t.argmin(axis=0)[None]
    return (
        np.take_along_axis(t, pick, 0)[0],
        np.take_along_axis(np.nan_to_num(slope), pick, 0)[0],
        unclear,
    )


def sides(p, *powers):
    return [np.abs(p[..., i]) ** power for i, power in enumerate(powers)]


#: Each kind with its implicit function, in its own coordinates, written without a matrix.
KINDS = {
    "sphere": (
        Quadric.sphere((0.1, 0.2, -0.3), 0.9),
        lambda p: np.sum((p - (0.1, 0.2, -0.3)) ** 2, axis=-1) - 0.81,
    ),
    "ellipsoid": (
        Quadric.ellipsoid(radii=(1, 0.5, 0.3)),
        lambda p: np.sum((p / (1, 0.5, 0.3)) ** 2, axis=-1) - 1,
    ),
    "cylinder": (Quadric.cylinder(radius=0.5, height=1.6), lambda p: p[..., 0] ** 2 + p[..., 1] ** 2 - 0.25),
    "cone": (
        Quadric.cone(radius=0.5, height=1),
        lambda p: p[..., 0] ** 2 + p[..., 1] ** 2 - (0.5 * p[..., 2]) ** 2,
    ),
    "double cone": (
        Quadric.cone(radius=0.5, height=1, sheets=2),
        lambda p: p[..., 0] ** 2 + p[..., 1] ** 2 - (0.5 * p[..., 2]) ** 2,
    ),
    "paraboloid": (
        Quadric.paraboloid(radius=0.8, height=1.1),
        lambda p: p[..., 0] ** 2 + p[..., 1] ** 2 - 0.64 / 1.1 * p[..., 2],
    ),
    "one sheet": (
        Quadric.hyperboloid(radii=(0.3, 0.4, 0.5), height=1.6),
        lambda p: (p[..., 0] / 0.3) ** 2 + (p[..., 1] / 0.4) ** 2 - (p[..., 2] / 0.5) ** 2 - 1,
    ),
    "two sheets": (
        Quadric.hyperboloid(radii=(0.3, 0.4, 0.25), height=1.6, sheets=2),
        lambda p: (p[..., 0] / 0.3) ** 2 + (p[..., 1] / 0.4) ** 2 - (p[..., 2] / 0.25) ** 2 + 1,
    ),
    "saddle": (
        Quadric.hyperbolic_paraboloid(radii=(0.6, 0.8)),
        lambda p: (p[..., 0] / 0.6) ** 2 - (p[..., 1] / 0.8) ** 2 - p[..., 2],
    ),
    "planes": (Quadric.plane_pair(separation=0.6, radius=0.7), lambda p: p[..., 2] ** 2 - 0.09),
}
CAMERA = fb.Camera((1.5, 2.2, 3.1), (0.05, 0, 0.1), fov_deg=40)
SIZE = (64, 64)


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_is_hit_where_its_closed_form_says(name, device):
    quadric, implicit = KINDS[name]
    frame = fb.raymarch(quadric, CAMERA, size=SIZE, device=device)

    directions = rays(CAMERA, SIZE)
    t, slope, unclear = nearest_root(implicit, CAMERA.eye, directions, quadric.center, quadric.radius)
    # The trim sphere of a closed kind is invisible. For other kinds, rounding decides on its outline.
    clear = ~unclear if name not in ("sphere",) else np.abs(slope) > GRAZING
    hit = np.isfinite(t)
    assert (hit & clear & (slope > GRAZING)).sum() > 100
    assert np.array_equal(np.isfinite(frame.depth)[clear & (slope > GRAZING)], hit[clear & (slope > GRAZING)])
    steep = clear & hit & (slope > GRAZING)
    assert np.abs(frame.depth[steep] / t[steep] - 1).max() <= DEPTH


def test_normals_are_those_of_the_gradient_and_face_the_eye(device):
    for quadric, implicit in KINDS.values():
        frame = fb.raymarch(quadric, CAMERA, size=SIZE, device=device)
        directions = rays(CAMERA, SIZE)
        hit = np.isfinite(frame.depth)
        points = CAMERA.eye + np.where(hit, frame.depth, 0)[..., None].astype(np.float64) * directions
        h = 1e-4
        gradient = np.stack([implicit(points + e) - implicit(points - e) for e in h * np.eye(3)], axis=-1)
        length = np.linalg.norm(gradient, axis=-1)
        clear = hit & (length > 0.2 * h)  # away from the tip of a cone
        expected = gradient[clear] / length[clear][:, None]
        expected *= -np.sign(np.sum(expected * directions[clear], axis=-1))[:, None]
        # A normal turns by the error of the position over the radius of curvature, here above 0.03.
        assert np.abs(frame.normal[clear] - expected).max() <= 5 * DEPTH / 0.03


def random_rows(random, count):
    """Random quadrics as the core takes them, and their matrices about the centres of their trim spheres."""
    forms = random.normal(size=(count, 4, 4))
    forms *= 10.0 ** random.uniform(-3, 3, (count, 1, 1))
    forms += np.swapaxes(forms, 1, 2)
    # Some with a linear part alone, or nearly.
    forms[:, :3, :3] *= random.choice([1, 1e-7, 0], (count, 1, 1))
    centers = random.normal(size=(count, 3)) * 10.0 ** random.uniform(-1, 2, (count, 1))
    radii = 10.0 ** random.uniform(-1, 1, count)
    matrices = moved(forms, -centers)
    surface = np.broadcast_to([0.8, 0.8, 0.8, 1.0], (count, 4))
    rows = np.concatenate([matrices.reshape(count, 16), centers, radii[:, None], surface], axis=1)
    # The same polynomial, without the cancellation of a far place, as rounding has left it.
    return np.ascontiguousarray(rows), moved(matrices, centers)


def moved(forms, by):
    shift = np.broadcast_to(np.eye(4), forms.shape).copy()
    shift[:, :3, 3] = by
    return np.swapaxes(shift, 1, 2) @ forms @ shift


def random_quadrics(random, count):
    return quadrics_of(random_rows(random, count)[0])


def quadrics_of(rows):
    return [Quadric(row[:16].reshape(4, 4), row[16:19], row[19]) for row in rows]


def test_ten_thousand_random_matrices_against_float64_roots(random):
    count = 10_000
    rows, forms = random_rows(random, count)
    radii = rows[:, 19]
    eyes = random.normal(size=(count, 3)) * 3 * radii[:, None]
    directions = 0.6 * radii[:, None] * random.uniform(-1, 1, (count, 3)) - eyes
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    right = np.cross(directions, random.normal(size=(count, 3)))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    poses[:, :3, :3] = np.stack([right, np.cross(right, directions), -directions], axis=2)
    poses[:, :3, 3] = eyes + rows[:, 16:19]
    drawn = (
        fb.raymarch(quadric, fb.Camera.from_pose(pose, fov_deg=45), size=(1, 1), shadows="none", device="cpu")
        for quadric, pose in zip(quadrics_of(rows), poses, strict=True)
    )
    depths = np.array([frame.depth[0, 0] for frame in drawn])

    def form(p):
        x = np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1)
        return np.einsum("...i,...ij,...j->...", x, forms, x)

    t, slope, unclear = nearest_root(form, eyes, directions, 0.0, radii)
    certain = ~unclear & (np.isinf(t) | (slope > GRAZING))
    assert certain.sum() > 6_000
    assert np.array_equal(np.isinf(t[certain]), np.isinf(depths[certain]))
    hit = certain & np.isfinite(t)
    assert hit.sum() > 2_000
    assert np.abs(depths[hit] / t[hit] - 1).max() <= DEPTH


def test_devices_agree_on_random_matrices(random, gpu):
    quadrics = random_quadrics(random, 5)
    for quadric in quadrics:
        camera = fb.Camera.fit(quadric.bounds)
        cpu, other = (fb.raymarch(quadric, camera, size=(32, 32), device=device) for device in ("cpu", gpu))
        both = (cpu.object_id == 0) & (other.object_id == 0)
        # Pixels on an outline may differ: at most two on each row on each side of each of two sheets' outlines.
        assert (cpu.object_id != other.object_id).sum() <= 16
        direct = rays(camera, (32, 32))
        direct /= np.linalg.norm(direct, axis=-1, keepdims=True)
        steep = both & (np.abs(np.sum(direct * cpu.normal, axis=-1)) > 0.2)
        if steep.any():
            assert np.abs(cpu.depth[steep] / other.depth[steep] - 1).max() <= DEPTH


def test_a_far_small_sphere_is_round(device):
    place = np.array([1e5, -2e5, 3e4])
    camera = fb.Camera(place + np.array([0, 0, 4]), place, fov_deg=40)
    frame = fb.raymarch(Quadric.sphere(place, 1.0), camera, size=SIZE, device=device)
    near = fb.raymarch(Quadric.sphere((0, 0, 0), 1.0), fb.Camera((0, 0, 4), (0, 0, 0), fov_deg=40), size=SIZE)
    # The matrix itself is rounded by 2^-53 of |place|^2, 5e-6 here; the middle of the picture meets it head on.
    middle = slice(16, 48), slice(16, 48)
    assert np.abs(frame.depth[middle] - near.depth[middle]).max() <= 3e-5


def test_a_linear_and_a_doubled_plane_are_seen(device):
    plane = np.zeros((4, 4))
    plane[2, 3] = plane[3, 2] = 0.5
    doubled = np.diag([0.0, 0, 1, 0])
    camera = fb.Camera((0, 0, 2), (0, 0, 0))
    for matrix in (plane, doubled):
        frame = fb.raymarch(Quadric(matrix, radius=5), camera, size=(16, 16), device=device)
        assert np.allclose(frame.depth, 2, rtol=1e-3 if matrix is doubled else 1e-6)
        assert np.allclose(frame.normal, (0, 0, 1), atol=1e-6)


def test_nothing_is_seen_of_an_imaginary_quadric_or_behind_the_eye(device):
    assert (fb.raymarch(Quadric(np.eye(4)), CAMERA, size=(8, 8), device=device).object_id == -1).all()
    away = fb.Camera(CAMERA.eye, 2 * CAMERA.eye)
    assert (fb.raymarch(Quadric.sphere(), away, size=(8, 8), device=device).object_id == -1).all()


# --- many


def many(random, count, size=0.02):
    kinds = [lambda **k: Quadric.sphere(radius=1, **k), lambda **k: Quadric.ellipsoid(radii=(1, 0.4, 0.6), **k)]
    kinds += [lambda **k: Quadric.cylinder(radius=0.6, height=1.4, **k), lambda **k: Quadric.cone(**k)]
    quadrics = []
    for i in range(count):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        transform = np.eye(4)
        transform[:3, :3] = turn * size
        transform[:3, 3] = random.uniform(-1, 1, 3)
        quadrics.append(kinds[i % 4](reflectance=random.uniform(0.2, 1, 3), opacity=0.5).transformed(transform))
    return quadrics


def test_the_tree_finds_what_a_loop_finds(random, device):
    quadrics = many(random, 300, size=0.12)
    camera = fb.Camera.fit([(-1, -1, -1), (1, 1, 1)])
    light = [fb.DirectionalLight((-1, -2, -0.5))]
    whole = fb.raymarch(quadrics, camera, size=(48, 48), lights=light, device=device)
    depth, owner = np.full((48, 48), np.inf, np.float32), np.full((48, 48), -1)
    for i, quadric in enumerate(quadrics):
        one = fb.raymarch(quadric, camera, size=(48, 48), shadows="none", device="cpu")
        owner = np.where(one.depth < depth, i, owner)
        depth = np.minimum(depth, one.depth)
    if device == "cpu":
        assert np.array_equal(whole.depth, depth)
        assert np.array_equal(whole.object_id, owner)
    else:
        assert (whole.object_id != owner).mean() <= 0.01
        same = (whole.object_id == owner) & (owner >= 0)
        assert np.percentile(np.abs(whole.depth[same] / depth[same] - 1), 99) <= DEPTH


def test_shadows_multiply_what_each_lets_through(device):
    floor = Quadric(_plane_y(0), radius=20, opacity=1)
    opacities = [0.5, 0.25, 1.0, 0.0]
    light = [fb.DirectionalLight((0, -1, 0))]
    camera = fb.Camera((0, 0.4, 6), (0, 0, 0))
    for count in range(1, 5):
        discs = [Quadric(_plane_y(1 + i), (0, 1 + i, 0), 3, opacity=o) for i, o in enumerate(opacities[:count])]
        frame = fb.raymarch([floor, *discs], camera, size=(33, 33), lights=light, device=device)
        seen = (frame.object_id == 0).nonzero()
        points = camera.eye + frame.depth[seen][:, None] * rays(camera, (33, 33))[seen]
        below = np.hypot(points[:, 0], points[:, 2]) < 2.9
        assert below.sum() > 10
        expected = np.prod([1 - o for o in opacities[:count]])
        assert np.allclose(frame.shadow[seen][below], expected, atol=1e-6)
        assert (frame.shadow[seen][np.hypot(points[:, 0], points[:, 2]) > 3.1] == 1).all()


def test_a_ball_counts_once_and_not_for_itself(device):
    ball = Quadric.sphere(radius=0.5, opacity=0.5)
    floor = Quadric(_plane_y(-2), radius=20)
    camera = fb.Camera((0, 1.0, 6), (0, -1, 0))
    frame = fb.raymarch([floor, ball], camera, size=(65, 65), lights=[fb.DirectionalLight((0, -1, 0))], device=device)
    on_floor, on_ball = frame.object_id == 0, frame.object_id == 1
    assert {*np.unique(frame.shadow[on_floor]).tolist()} == {0.5, 1.0}
    # Lit above, turned away below.
    upper = on_ball & (frame.normal[..., 1] > 1e-3)
    assert upper.any()
    assert (frame.shadow[upper] == 1).all()
    assert (frame.shadow[on_ball & (frame.normal[..., 1] < -1e-3)] == 0).all()


def test_a_bowl_shades_its_own_inside(device):
    bowl = Quadric.paraboloid(radius=1, height=1.5, opacity=0.75).transformed(
        [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
    )
    camera = fb.Camera((0, 6, 0.01), (0, 0, 0), up=(0, 0, -1))
    light = [fb.DirectionalLight((1, -1, 0))]
    frame = fb.raymarch(bowl, camera, size=(65, 65), lights=light, device=device)
    # Light comes from the left. The left wall turns away from it and keeps it from the floor; the right wall is lit.
    assert frame.shadow[32, 16] == 0
    assert frame.shadow[32, 30] == 0.25
    assert (frame.shadow == 0.25).sum() > 50
    assert frame.shadow[32, 48] == 1


def test_a_hundred_thousand_are_drawn(random, device):
    random_places = random.uniform(-1, 1, (100_000, 3))
    balls = np.broadcast_to(Quadric.sphere(radius=0.004)._row(), (100_000, 24)).copy()
    balls[:, :16] = moved(balls[:, :16].reshape(-1, 4, 4), -random_places).reshape(-1, 16)
    balls[:, 16:19] = random_places
    camera = fb.Camera.fit([(-1, -1, -1), (1, 1, 1)])
    frame = fb.raymarch(quadrics_of(balls), camera, size=(24, 24), device=device)
    directions = rays(camera, (24, 24)).reshape(-1, 3)
    expected = np.full(len(directions), np.inf)
    for i, d in enumerate(directions):
        from_eye = random_places - camera.eye
        along = from_eye @ d / (d @ d)
        gap = 0.004**2 - np.sum((from_eye - along[:, None] * d) ** 2, axis=1)
        t = along - np.sqrt(np.maximum(gap, 0) / (d @ d))
        expected[i] = np.where((gap > 0) & (t > 0), t, np.inf).min()
    got = frame.depth.ravel()
    same = np.isfinite(got) == np.isfinite(expected)
    assert same.mean() > 0.99
    hit = same & np.isfinite(expected)
    assert hit.sum() > 200
    assert np.percentile(np.abs(got[hit] / expected[hit] - 1), 98) <= DEPTH
    # The tree culls: a ray tries few of the 100,000 spheres.
    assert frame.steps.mean() < 30


def _plane_y(height):
    matrix = np.zeros((4, 4))
    matrix[1, 3] = matrix[3, 1] = 0.5
    matrix[3, 3] = -height
    return matrix


# --- records


def test_a_record_is_the_articles_struct_byte_by_byte(random):
    quadrics = random_quadrics(random, 20)
    quadrics = [Quadric(q.matrix, q.center, q.radius, random.uniform(0, 1, 3), random.uniform()) for q in quadrics]
    packed = fb.pack_quadrics(quadrics)
    assert packed.shape == (20, 6, 4)
    assert packed.dtype == np.float32
    # struct quadric_object { mat4 A; vec3 center; float radius; vec3 reflectance; float opacity; };
    expected = b"".join(
        struct.pack("<24f", *q.matrix.T.ravel(), *q.center, q.radius, *q.reflectance, q.opacity) for q in quadrics
    )
    assert packed.tobytes() == expected


def test_unpacking_returns_the_same(random):
    packed = fb.pack_quadrics(random_quadrics(random, 7))
    back = fb.unpack_quadrics(packed)
    assert np.array_equal(fb.pack_quadrics(back), packed)
    assert fb.pack_quadrics([]).shape == (0, 6, 4)
    assert fb.unpack_quadrics(packed[:0]) == []


@given(
    matrix=st.lists(st.floats(-1e37, 1e37), min_size=16, max_size=16),
    center=st.tuples(*[st.floats(-1e37, 1e37)] * 3),
    radius=st.floats(1e-40, 1e37),
    reflectance=st.tuples(*[st.floats(0, 1e37)] * 3),
    opacity=st.floats(0, 1),
)
def test_any_quadric_is_equal_to_what_comes_back(matrix, center, radius, reflectance, opacity):
    matrix[0] = 1.0  # A matrix of zeros is no quadric.
    quadrics = [Quadric(np.reshape(matrix, (4, 4)), center, radius, reflectance, opacity)]
    back = fb.unpack_quadrics(fb.pack_quadrics(quadrics))
    assert back == quadrics
    assert hash(back[0]) == hash(quadrics[0])
    assert back[0] in set(quadrics)


def test_every_kind_of_quadric_is_equal_to_what_comes_back(random):
    quadrics = random_quadrics(random, 50)
    assert fb.unpack_quadrics(fb.pack_quadrics(quadrics)) == quadrics
    ball = Quadric.sphere((0.1, 0.2, 0.3), 0.7)
    assert ball != Quadric.sphere((0.1, 0.2, 0.3), 0.7 * (1 + 2.0**-22))
    assert ball != Quadric.sphere((0.1, 0.2, 0.3), 0.7, opacity=0.5)
    assert ball == Quadric.sphere((0.1, 0.2, 0.3), 0.7 * (1 + 2.0**-30))


def test_many_records_wrap_into_rows(random):
    packed = random.normal(size=(50, 6, 4)).astype(np.float32)
    assert np.array_equal(fb.wrap_quadrics(packed), packed)
    texture = fb.wrap_quadrics(packed, max_side=20)
    assert texture.shape == (17, 18, 4)
    for i in range(50):
        assert np.array_equal(texture[i // 3, 6 * (i % 3) :][:6], packed[i])
    with pytest.raises(fb.ShapeError, match="50 quadrics do not fit 12 x 12"):
        fb.wrap_quadrics(packed, max_side=12)


# --- moving


@given(st.integers(0, 2**32 - 1))
def test_a_transformed_quadric_is_seen_as_from_the_other_side(seed):
    random = np.random.default_rng(seed)
    quadric = list(KINDS.values())[seed % len(KINDS)][0]
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    move = np.eye(4)
    move[:3, :3] = turn * np.sign(np.linalg.det(turn))
    move[:3, 3] = random.normal(size=3)
    still = fb.raymarch(quadric, CAMERA, size=(9, 9), shadows="none", device="cpu")
    moved_camera = fb.Camera.from_pose(move @ CAMERA.pose, CAMERA.fov_deg)
    moved = fb.raymarch(quadric.transformed(move), moved_camera, size=(9, 9), shadows="none", device="cpu")
    both = np.isfinite(still.depth) & np.isfinite(moved.depth)
    assert (np.isfinite(still.depth) != np.isfinite(moved.depth)).sum() <= 1
    assert np.allclose(still.depth[both], moved.depth[both], rtol=1e-6)


def test_transforms_change_the_trim_sphere_as_they_must():
    quadric = Quadric.cylinder(radius=1, height=2).transformed(np.diag([2, 1, 1, 1]))
    assert quadric.radius == pytest.approx(2 * np.sqrt(2))
    on_rim = np.array([2.0, 0, 1, 1])
    assert on_rim @ quadric.matrix @ on_rim == pytest.approx(0, abs=1e-12)


# --- distance


def test_the_distance_bound_is_never_above_the_distance(random):
    for name, (quadric, _) in KINDS.items():
        camera_points = []
        for _ in range(12):  # the surface, as many points of it as pictures from all sides show
            eye = random.normal(size=3)
            camera = fb.Camera(quadric.center + 3 * quadric.radius * eye / np.linalg.norm(eye), quadric.center)
            frame = fb.raymarch(quadric, camera, size=(96, 96), shadows="none", device="cpu")
            hit = np.isfinite(frame.depth)
            camera_points.append(
                camera.eye + frame.depth[hit][:, None].astype(np.float64) * rays(camera, (96, 96))[hit]
            )
        surface = np.concatenate(camera_points)
        # Merged fields have the bound at their samples.
        corners = quadric.center + 2 * quadric.radius * np.array([[-1.0] * 3, [1.0] * 3])
        merged = fb.merge([quadric], 15, bounds=corners, device="cpu")
        steps = (np.indices(merged.resolution).reshape(3, -1).T + 0.5) / merged.resolution
        points, bound = corners[0] + steps * (corners[1] - corners[0]), merged.distances.astype(np.float64).ravel()
        distance = np.array([np.linalg.norm(surface - p, axis=1).min() for p in points])
        # Depths of the pictures are float32 at 3 radii.
        assert (bound <= distance + 4 * quadric.radius * 2.0**-22).all(), name
        assert (bound >= 0).all()
        # And it is of use: on average a third of the distance at least.
        assert (bound / distance).mean() > 0.33, name


# --- mistakes


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"matrix": np.zeros((4, 4))}, "matrix: must not be zero"),
        ({"matrix": np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])}, "matrix: must not be zero"),
        ({"matrix": np.full((4, 4), np.nan)}, "matrix: must be finite"),
        ({"matrix": np.full((4, 4), 1e300)}, "matrix: entries"),
        ({"matrix": np.eye(3)}, r"matrix: must have shape \(4, 4\)"),
        ({"matrix": "ball"}, "matrix: must"),
        ({"matrix": np.eye(4), "radius": 0}, "radius: must be a finite number above 0"),
        ({"matrix": np.eye(4), "radius": -1}, "radius"),
        ({"matrix": np.eye(4), "radius": np.inf}, "radius"),
        ({"matrix": np.eye(4), "center": (0, 0)}, "center"),
        ({"matrix": np.eye(4), "center": (0, np.nan, 0)}, "center"),
        ({"matrix": np.eye(4), "reflectance": (1, -1, 0)}, "reflectance"),
        ({"matrix": np.eye(4), "opacity": 1.5}, "opacity: must be from 0 to 1"),
        ({"matrix": np.eye(4), "opacity": -0.5}, "opacity"),
    ],
)
def test_a_quadric_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(fb.ShapeError, match=message):
        Quadric(**arguments)


def test_kinds_refuse_what_they_cannot_be():
    for make in (
        lambda: Quadric.sphere(radius=0),
        lambda: Quadric.ellipsoid(radii=(1, 0, 1)),
        lambda: Quadric.cylinder(height=-1),
        lambda: Quadric.cone(sheets=3),
        lambda: Quadric.hyperboloid(height=1, sheets=2),
        lambda: Quadric.hyperbolic_paraboloid(radii=(1, 1, 1)),
        lambda: Quadric.plane_pair(separation=0),
        lambda: Quadric.sphere().transformed(np.zeros((4, 4))),
        lambda: fb.pack_quadrics([Quadric.sphere(), "ball"]),
        lambda: fb.pack_quadrics("balls"),
        lambda: fb.pack_quadrics([Quadric(np.diag([1e-30, 1e-30, 1e-30, 0]) * 1e-30)]),
        lambda: fb.unpack_quadrics(np.zeros((2, 6, 4))),
        lambda: fb.unpack_quadrics(np.zeros((2, 24))),
    ):
        with pytest.raises(fb.ShapeError):
            make()
    with pytest.raises(TypeError, match="colour"):
        Quadric.sphere(colour=(1, 0, 0))


def test_only_the_symmetric_part_of_a_matrix_matters():
    skew = np.arange(16.0).reshape(4, 4)
    assert np.array_equal(Quadric(skew).matrix, (skew + skew.T) / 2)


def test_a_quadric_is_a_value():
    a = Quadric.cone(reflectance=(0.1, 0.2, 0.3), opacity=0.5)
    assert pickle.loads(pickle.dumps(a)) == a
    assert len({a, pickle.loads(pickle.dumps(a))}) == 1
    with pytest.raises(AttributeError):
        a.opacity = 1
    with pytest.raises(ValueError, match="read-only"):
        a.matrix[0, 0] = 2
    assert "opacity=0.5" in repr(a)
