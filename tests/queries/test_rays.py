"""Rays: first hits, occlusion, counts and lists against float64 brute force; no ray leaves a closed surface."""

import threading

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

ZOO = {**meshes.CLOSED, **meshes.OPEN}
#: Weights below this are too near an edge for Cramer's rule to decide.
EDGE = 1e-9
FUNCTIONS = [fb.cast_rays, fb.occluded, fb.count_intersections, fb.all_intersections]


def random_rays(geometry, count, seed=6):
    """Rays from around the mesh to points near it, some from inside."""
    origins = meshes.points_around(geometry, count, seed, spread=3)
    targets = meshes.points_around(geometry, count, seed + 1, spread=0.8)
    return origins, targets - origins


@pytest.mark.parametrize("place", [(1, 0), (1, 1e4), (1e-3, 0), (1e3, 0), (1e3, 1e4)])
@pytest.mark.parametrize("name", ZOO)
def test_hits_are_those_of_brute_force(name, place):
    scale, shift = place
    geometry = meshes.scale_and_shift(ZOO[name](), scale, (shift, -shift, shift))
    origins, directions = random_rays(geometry, 300)

    hits = fb.cast_rays(geometry, origins, directions)
    found = fb.all_intersections(geometry, origins, directions)

    t, least = truth.all_intersections(*geometry, origins, directions)
    t[t < 0] = np.inf
    # At 1e4 with a mesh of size 1, positions are rounded by 1e-12 of the size; edges within that are not decidable.
    clear = (np.abs(least) > max(EDGE, 1e-15 * shift / scale)).all(axis=1)
    assert clear.mean() > 0.9
    expected = np.sort(t, axis=1)
    assert np.array_equal(hits.hit[clear], np.isfinite(expected[clear, 0]))
    both = clear & hits.hit
    assert np.abs(hits.t[both] / expected[both, 0] - 1).max(initial=0) <= 1e-6
    counts = np.isfinite(t).sum(axis=1)
    assert np.array_equal(np.bincount(found.rays, minlength=300)[clear], counts[clear])
    assert np.array_equal(fb.count_intersections(geometry, origins, directions)[clear], counts[clear])
    assert np.array_equal(fb.occluded(geometry, origins, directions), hits.hit)
    for row in np.flatnonzero(clear):
        of_row = found.t[found.rays == row]
        assert np.abs(of_row - expected[row, : counts[row]]).max(initial=0) <= 1e-6 * expected[row, : counts[row]].max(
            initial=1
        )


@pytest.mark.parametrize("name", ["icosphere", "knot", "needle_fan"])
def test_the_weights_and_normals_are_those_of_the_hit(name):
    geometry = ZOO[name]()
    origins, directions = random_rays(geometry, 300)

    hits = fb.cast_rays(geometry, origins, directions)

    at = hits.hit
    corners = truth.corners(*geometry)[hits.faces[at]]
    points = (hits.barycentric[at][:, :, None] * corners).sum(axis=1)
    assert np.abs(points - origins[at] - hits.t[at][:, None] * directions[at]).max() <= 1e-9
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(hits.normals[at] - normals / np.linalg.norm(normals, axis=1, keepdims=True)).max() <= 1e-12
    assert (hits.barycentric[at] >= 0).all()
    assert np.abs(hits.barycentric[at].sum(axis=1) - 1).max() <= 1e-12
    missed = ~at
    assert (hits.faces[missed] == -1).all()
    assert np.isinf(hits.t[missed]).all()
    assert (hits.barycentric[missed] == 0).all()
    assert (hits.normals[missed] == 0).all()


def leaks(geometry, origin):
    """Number of rays from a point inside through all vertices and edge midpoints that hit nothing.

    The rounded rays may pass a target on the silhouette of a fold and hit a face behind it.
    """
    corners = truth.corners(*geometry)
    targets = np.concatenate([geometry.vertices, (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2])
    hits = fb.cast_rays(geometry, np.asarray(origin, np.float64), targets - origin)
    assert np.array_equal(fb.occluded(geometry, origin, targets - origin), hits.hit)
    return int((~hits.hit).sum())


@pytest.mark.parametrize("place", [(1, 0), (1, 1e4), (1e-3, 1), (1e3, 7)])
@pytest.mark.parametrize(
    ("name", "inside"), [("icosphere", (0.1, 0.2, 0.05)), ("knot", (3, 0, 0)), ("cube", (0, 0, 0))]
)
def test_no_ray_leaves_through_a_vertex_or_an_edge(name, inside, place):
    scale, shift = place
    geometry = meshes.scale_and_shift(ZOO[name](), scale, (shift, shift, shift))

    assert leaks(geometry, np.array(inside, np.float64) * scale + shift) == 0


@pytest.mark.parametrize("name", ["fandisk.obj", "rocker-arm.obj", "spot/spot.obj"])
def test_no_ray_leaves_a_real_model(name, model_path):
    mesh = fb.load_mesh(model_path(name))
    assert mesh.is_closed
    samples = meshes.points_around(meshes.Geometry(mesh.vertices, mesh.faces), 400, spread=0.9)
    distances = fb.signed_distance(mesh, samples)

    assert leaks(meshes.Geometry(mesh.vertices, mesh.faces.astype(np.int64)), samples[distances.argmin()]) == 0


def test_a_shared_edge_or_vertex_counts_once():
    cube = meshes.box()
    # Through a diagonal of two sides, through two edges' midpoints, through two corners.
    origins = np.array([(0.5, 0.5, 3), (0, 3, 3), (3, 3, 3)], np.float64)
    directions = np.array([(0, 0, -1), (0, -1, -1), (-1, -1, -1)], np.float64)

    found = fb.all_intersections(cube, origins, directions)

    assert found.rays.tolist() == [0, 0, 1, 1, 2, 2]
    assert found.t == pytest.approx([2, 4] * 3, abs=1e-12)
    assert fb.count_intersections(cube, origins, directions).tolist() == [2, 2, 2]
    # From inside there is one way out, through every vertex and edge midpoint.
    corners = truth.corners(*meshes.icosphere(3))
    targets = np.concatenate([corners[:, 0], corners[:, 1:].mean(axis=1)])
    assert (fb.count_intersections(meshes.icosphere(3), (0.01, 0.02, 0.03), targets - (0.01, 0.02, 0.03)) == 1).all()


def test_split_vertices_count_once_too():
    sphere = meshes.split_vertices(meshes.icosphere(2))

    assert (fb.count_intersections(sphere, (0, 0, 0), sphere.vertices) == 1).all()


def test_limits_are_included_and_in_lengths_of_the_direction():
    square = meshes.flat_sheet(1)
    origin, direction = (0.25, 0.5, 4), (0, 0, -2)

    assert fb.cast_rays(square, origin, direction).t == 2
    assert fb.cast_rays(square, origin, direction, t_min=2, t_max=2).hit
    assert not fb.cast_rays(square, origin, direction, t_max=1.999).hit
    assert not fb.cast_rays(square, origin, direction, t_min=2.001).hit
    assert fb.cast_rays(square, origin, (0, 0, 2), t_min=-3).t == -2
    assert not fb.occluded(square, origin, direction, t_max=1.999)
    assert fb.count_intersections(square, origin, direction, t_min=2.001) == 0


def test_a_hit_does_not_depend_on_the_lower_limit(random):
    ball = fb.sphere(1).to_mesh(12)
    origins = random.normal(size=(300, 3))
    origins *= random.uniform(2, 5, size=(300, 1)) / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = 0.3 * random.normal(size=(300, 3)) - origins
    first = fb.cast_rays(ball, origins, directions, device="cpu")
    assert first.hit.sum() > 200

    for i in np.flatnonzero(first.hit):
        at = fb.cast_rays(ball, origins[i], directions[i], t_min=first.t[i], t_max=first.t[i], device="cpu")
        assert (at.t, at.faces) == (first.t[i], first.faces[i])
        # A ray that goes on after a hit leaves the ball through another face.
        after = fb.cast_rays(ball, origins[i], directions[i], t_min=np.nextafter(first.t[i], np.inf), device="cpu")
        assert after.hit
        assert after.faces != first.faces[i]
        assert fb.occluded(ball, origins[i], directions[i], t_min=first.t[i], t_max=first.t[i], device="cpu")


@pytest.mark.parametrize("length", [1e-12, 1e12])
def test_the_length_of_the_direction_does_not_matter(length):
    cube = meshes.box()

    assert fb.cast_rays(cube, (0.2, 0.3, 5), (0, 0, -length)).t * length == pytest.approx(4, rel=1e-12)


@pytest.mark.parametrize("tiny", [1e-20, 1e-35, 1e-300, 5e-324, 0.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_nearly_axis_parallel_rays_hit(tiny, sign):
    """Float32 rounds such a component to a subnormal number or to zero, whose inverse is not finite."""
    tiny *= sign
    directions = np.array([(tiny, 0, 1), (0, 1, tiny), (1, tiny, 0), (tiny, -1, tiny), (-1, tiny, tiny)])

    hits = fb.cast_rays(meshes.box(), (0.3, 0.2, -0.1), directions)

    assert np.allclose(hits.t, [1.1, 0.8, 0.7, 1.2, 1.3], rtol=1e-12)
    assert (fb.count_intersections(meshes.box(), (0.3, 0.2, -0.1), directions) == 1).all()


def test_directions_are_divided_safely():
    cube = meshes.box()

    assert fb.cast_rays(cube, (0, 0, 0), (0, 0, 1e-300)).t == pytest.approx(1e300, rel=1e-12)
    # The distance in lengths of the direction, 3e304, is near the largest float64.
    small = meshes.scale_and_shift(cube, 1e-3, (0, 0, 0))
    assert fb.cast_rays(small, (0, 0, 0), (0, 3e-308, 0)).t == pytest.approx(1e-3 / 3e-308, rel=1e-12)
    for function in FUNCTIONS:
        with pytest.raises(fb.ArgumentError, match=r"directions\[1\].*short"):
            function(cube, np.zeros((2, 3)), [(0, 0, 1), (5e-324, 0, 0)])


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9])
def test_far_origins_hit(far):
    direction = np.array([0.3, -0.5, 0.8])
    origin = -far * direction

    hit = fb.cast_rays(meshes.icosphere(4), origin, direction)

    length = np.linalg.norm(direction)
    assert hit.hit
    # The facets of the sphere lie up to 2e-3 within it; the origin is rounded to 1e-16 of its distance.
    assert (far - hit.t) * length == pytest.approx(1, abs=2e-3 + 1e-15 * far)


def test_shapes_broadcast():
    cube = meshes.box()
    origins = np.zeros((4, 1, 3))
    directions = np.ones((1, 5, 3))

    assert fb.cast_rays(cube, origins, directions).normals.shape == (4, 5, 3)
    assert fb.cast_rays(cube, (0, 0, 0), (0, 0, 1)).t.shape == ()
    assert fb.occluded(cube, (0, 0, 0), np.ones((7, 3))).shape == (7,)
    assert fb.count_intersections(cube, np.empty((0, 3)), (0, 0, 1)).shape == (0,)
    assert fb.all_intersections(cube, np.empty((0, 3)), np.empty((0, 3))).t.shape == (0,)
    assert fb.all_intersections(cube, origins, directions).rays.tolist() == list(range(20))


def test_faces_are_rows_of_what_was_passed():
    vertices, faces = meshes.triangle()
    padded = np.concatenate([[[0, 0, 1], [1, 1, 1]], faces])

    assert fb.cast_rays((vertices, padded), (0.2, 0.2, 1), (0, 0, -1)).faces == 2
    assert fb.all_intersections((vertices, padded), (0.2, 0.2, 1), (0, 0, -1)).faces.tolist() == [2]
    assert fb.cast_rays((vertices, padded), (5, 5, 1), (0, 0, -1)).faces == -1


def test_threads_change_no_bit_of_the_hits():
    mesh = fb.Mesh(*meshes.knot(400, 40))
    rays = random_rays(meshes.Geometry(mesh.vertices, mesh.faces), 20_000)
    results = []
    for threads in (1, 2, 5):
        fb.set_threads(threads)
        results.append((*fb.cast_rays(mesh, *rays), fb.occluded(mesh, *rays), *fb.all_intersections(mesh, *rays)))
    fb.set_threads(2)

    for result in results[1:]:
        assert all(one.tobytes() == other.tobytes() for one, other in zip(result, results[0], strict=True))


def test_many_rays_answer_as_one(random):
    mesh = fb.Mesh(*meshes.knot(400, 40))
    origins, directions = random_rays(meshes.Geometry(mesh.vertices, mesh.faces), 20_000)
    together = fb.cast_rays(mesh, origins, directions)

    for row in range(0, 20_000, 997):
        alone = fb.cast_rays(mesh, origins[row], directions[row])
        assert np.array_equal(alone.t, together.t[row])
        assert np.array_equal(alone.faces, together.faces[row])


def test_threads_may_cast_at_once():
    mesh = fb.Mesh(*meshes.knot(64, 8))
    origins, directions = random_rays(meshes.Geometry(mesh.vertices, mesh.faces), 2000)
    expected = fb.cast_rays(mesh, origins, directions).t
    results = [None] * 4

    def cast(i):
        results[i] = fb.cast_rays(mesh, origins, directions).t

    threads = [threading.Thread(target=cast, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(result, expected) for result in results)


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize(
    ("origins", "directions", "options", "message"),
    [
        (np.zeros((3, 3)), np.ones((2, 3)), {}, "directions"),
        (np.zeros((3, 2)), np.ones((3, 3)), {}, "origins"),
        (np.zeros((3, 3)), np.ones((3, 4)), {}, "directions"),
        ((0, 0, np.nan), (0, 0, 1), {}, "origins"),
        ((0, 0, 0), (0, 0, np.inf), {}, "directions"),
        (np.zeros((2, 3)), [(0, 0, 1), (0, 0, 0)], {}, r"directions\[1\].*length"),
        ((0, 0, 0), (0, 0, 1), {"t_min": 2, "t_max": 1}, "t_min"),
        ((0, 0, 0), (0, 0, 1), {"t_min": np.nan}, "t_min"),
        ((0, 0, 0), (0, 0, 1), {"t_max": "far"}, "t_max"),
        (None, (0, 0, 1), {}, "origins"),
        ((0, 0, 0), np.ones((1, 3), complex), {}, "directions"),
    ],
)
def test_mistakes_are_named(function, origins, directions, options, message):
    with pytest.raises(fb.ArgumentError, match=message):
        function(meshes.box(), origins, directions, **options)
