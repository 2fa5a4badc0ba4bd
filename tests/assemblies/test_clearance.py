"""Clearances: closed forms, coal, brute force on grids, and the proven gap."""

import pickle

import numpy as np
import pytest
from scipy.optimize import minimize

import fieldbake as fb
import meshes
import robots


def pose(translation=(0, 0, 0), rotation=None):
    made = np.eye(4)
    made[:3, 3] = translation
    if rotation is not None:
        made[:3, :3] = rotation
    return made


def one(a, b, **options):
    """The distance, the error, both points and the normal of a pair."""
    found = fb.clearance(a, b, **options)
    assert found.distances.shape == (1,)
    assert found.pairs.tolist() == [[-1, -1]]
    return found.distances[0], found.errors[0], found.points_a[0], found.points_b[0], found.normals[0]


BALL, TILT = fb.sphere(0.5), meshes.rotation(3)
AXIS = np.array([1.0, 2.0, 2.0]) / 3

#: Two solids, the pose of the second, the exact value and the accuracy.
CLOSED_FORMS = {
    "balls": (fb.sphere(1), BALL, pose(2 * AXIS, TILT), 0.5, 1e-12),
    "overlapping balls": (fb.sphere(1), BALL, pose(1.2 * AXIS, TILT), -0.3, 1e-12),
    "a ball in a ball": (fb.sphere(1), BALL, pose(0.2 * AXIS), -1.0, 1e-9),
    "touching balls": (fb.sphere(1), BALL, pose((1.5, 0, 0)), 0.0, 1e-9),
    "ball and box": (BALL, fb.box((2, 2, 2)), pose((2, 2, 2)), np.sqrt(3) - 0.5, 1e-12),
    "ball and capsule": (BALL, fb.capsule(0.25, 2), pose((0, 3, 0.5)), 3 - 0.75, 1e-12),
    "capsules": (fb.capsule(0.2, 2), fb.capsule(0.3, 4), pose((0, 1, 0), meshes.rotation(7)), None, 1e-12),
    "crossed capsules": (fb.capsule(0.2, 2), fb.capsule(0.3, 2).rotate((1, 0, 0), angle_deg=90), pose((0.4, 0, 0)),
                         -0.1, 1e-12),
    "ball above a half-space": (BALL, fb.plane((0, 0, 1), -1), pose(), 0.5, 1e-12),
    "ball in a half-space": (BALL, fb.plane((0, 0, 1), -0.3), pose(), -0.2, 2e-4),
    "flat boxes": (fb.box((2, 2, 2)), fb.box((1, 1, 1)), pose((0.2, 0.1, 1.45)), -0.05, 1e-9),
    "flat meshes": (fb.Mesh(*meshes.box()), fb.Mesh(*meshes.box()), pose((0.3, 0.1, 1.95)), -0.05, 5e-5),
    "touching boxes": (fb.box((2, 2, 2)), fb.box((1, 1, 1)), pose((0.2, 0.1, 1.5)), 0.0, 1e-9),
    "cylinders": (fb.cylinder(0.5, 2), fb.cylinder(0.25, 2), pose((2, 0, 0.3)), 1.25, 1e-9),
    "cylinder and plane": (fb.cylinder(0.5, 2), fb.plane((0, 0, 1), -3), pose(), 2.0, 1e-9),
    "torus and ball": (fb.torus(1, 0.25), BALL, pose((3, 0, 0)), 1.25, 1e-9),
    "a lid over a lip": (fb.rectangle((20, 10)).extrude(4) - fb.rectangle((18, 8)).extrude(5),
                         fb.rectangle((17.6, 7.6)).extrude(4) - fb.rectangle((15, 5)).extrude(5), pose(), 0.2, 1e-9),
    "a tube in a bore": (fb.circle(13).extrude(10) - fb.cylinder(11.5, 20),
                         (fb.circle(15) - fb.circle(13.2)).extrude(10), pose(), 0.2, 1e-9),
    # The walls of both cross, and the thinner one limits the ball. The search ends at a thousandth of the depth.
    "tubes through each other": (fb.circle(13).extrude(10) - fb.cylinder(11.5, 20),
                                 (fb.circle(15) - fb.circle(13.2)).extrude(10), pose((3, 0, 0)), -1.5, 1.5e-3),
    "a box in the rim of a tube": (fb.circle(5).extrude(4) - fb.circle(3).extrude(9), fb.box((2, 2, 2)),
                                   pose((4, 0, 2.5)), -0.5, 5e-4),
    "a box in a mesh": (fb.Mesh(*meshes.box((-3, -3, -3), (3, 3, 3))), fb.box((1, 2, 3)), pose((0.2, 0, 0)), -1, 1e-3),
    "a mesh in a ball": (fb.sphere(9), fb.Mesh(*meshes.box()), pose(), -2, 2e-3),
}  # fmt: skip


def segment_distance(a, b):
    """The distance of two segments by dense parameters and a local search."""

    def gap(x):
        return np.linalg.norm(a[0] + (a[1] - a[0]) * x[0] - b[0] - (b[1] - b[0]) * x[1])

    grid = np.linspace(0, 1, 21)
    start = min(((s, t) for s in grid for t in grid), key=gap)
    return minimize(lambda x: gap(x) ** 2, start, bounds=[(0, 1)] * 2, options={"ftol": 1e-16, "gtol": 1e-14}).x, gap


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_closed_forms(name):
    a, b, place, truth, accuracy = CLOSED_FORMS[name]
    if truth is None:
        ends = np.array([[0, 0, -1], [0, 0, 1]]), np.array([[0, 0, -2], [0, 0, 2]]) @ place[:3, :3].T + place[:3, 3]
        best, gap = segment_distance(*ends)
        truth, accuracy = gap(best) - 0.5, 1e-7
    distance, error, p, q, normal = one(a, b, pose_b=place)

    assert distance == pytest.approx(truth, abs=accuracy)
    assert distance - error - 1e-9 <= truth <= distance + 1e-9
    swapped = one(b, a, pose_a=place)
    assert swapped[0] == pytest.approx(distance, abs=max(accuracy, error, swapped[1]))
    assert np.linalg.norm(normal) == pytest.approx(1)
    if distance > 1e-6:
        assert np.linalg.norm(p - q) == pytest.approx(distance, abs=1e-9)
        assert normal == pytest.approx((p - q) / distance, abs=1e-6)
        moved = pose((5, -3, 2), meshes.rotation(9))
        again = one(a, b, pose_a=moved, pose_b=moved @ place)
        assert again[0] == pytest.approx(distance, abs=1e-9)
        assert again[2] == pytest.approx(moved[:3, :3] @ p + moved[:3, 3], abs=1e-6)


def test_the_flanks_of_a_thread_have_their_clearance():
    bolt = fb.thread(8, 1.25, 12, clearance=0.1)
    nut = fb.circle(7.5).extrude(6.5) - fb.thread(8, 1.25, 8, internal=True)

    distance, error, p, q, _ = one(bolt, nut)

    assert distance == pytest.approx(0.1, abs=1e-6)
    assert distance - error <= 0.1
    assert np.abs([bolt.distance([p])[0], nut.distance([q])[0]]).max() <= 1e-9
    joined = fb.Assembly({"bolt": bolt, "nut": nut})
    for assembly in (joined, pickle.loads(pickle.dumps(joined))):
        assert assembly.clearance().distances == pytest.approx([distance], abs=1e-9)
        # The proof does not reach a cutoff between the bound and the distance, so nothing is left out.
        near = assembly.clearance(cutoff=0.05)
        assert near.distances == pytest.approx([distance], abs=1e-9)
        assert np.isfinite(near.points_a).all()


def coal_model(coal, mesh):
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(mesh.vertices)
    model.addTriangles(mesh.faces)
    model.endModel()
    return model


def parts():
    pieces = [meshes.torus(segments=24, sides=10), meshes.knot(segments=60, sides=8), meshes.icosphere(2), meshes.box()]
    return [fb.Mesh(*piece) for piece in pieces] + [fb.models.gear(teeth=9)]


def test_separate_meshes_have_the_distance_of_coal(random):
    coal = pytest.importorskip("coal")
    solids = parts()
    models = [coal_model(coal, mesh) for mesh in solids]
    apart = 0
    for _ in range(150):
        i, j = random.integers(0, len(solids), 2)
        place = pose(random.uniform(-3.5, 3.5, 3), meshes.rotation(int(random.integers(1000))))
        distance, error, p, q, normal = one(solids[i], solids[j], pose_b=place)

        transform = coal.Transform3s(place[:3, :3], place[:3, 3])
        truth = coal.distance(models[i], coal.Transform3s(), models[j], transform, coal.DistanceRequest(),
                              coal.DistanceResult())  # fmt: skip
        if truth <= 1e-4:
            # coal returns 0 for surfaces that cross.
            assert distance <= 1e-4
            continue
        if distance < 0:
            # One solid is inside the other: coal sees the surfaces only.
            continue
        apart += 1
        assert distance == pytest.approx(truth, rel=1e-9)
        assert error == 0
        assert np.linalg.norm(p - q) == pytest.approx(distance, rel=1e-12)
        assert fb.closest_point(solids[i], p).distances == pytest.approx(0, abs=1e-12)
        local = place[:3, :3].T @ (q - place[:3, 3])
        assert fb.closest_point(solids[j], local).distances == pytest.approx(0, abs=1e-12)
        assert normal == pytest.approx((p - q) / distance)
    assert apart > 60


@pytest.mark.parametrize("shape", [fb.cylinder(0.4, 1), fb.cone(0.5, 1), fb.ellipsoid((0.9, 0.4, 0.6))], ids=repr)
@pytest.mark.parametrize("mesh_first", [True, False])
def test_a_mesh_and_a_convex_shape_have_the_distance_of_an_optimiser(shape, mesh_first, random):
    mesh = fb.models.gear(teeth=9)
    corners = mesh.vertices[mesh.faces]
    for seed in range(4):
        place = pose(random.uniform(1.2, 2, 3) * random.choice([-1, 1], 3), meshes.rotation(seed))
        if mesh_first:
            distance, error, p, q, _ = one(mesh, shape, pose_b=place)
        else:
            distance, error, q, p, _ = one(shape, mesh, pose_a=place)

        local = (corners - place[:3, 3]) @ place[:3, :3]
        center, radius = (
            local.mean(axis=1),
            np.linalg.norm(local - local.mean(axis=1, keepdims=True), axis=2).max(axis=1),
        )
        from_center = shape.distance(center)
        near = np.flatnonzero(from_center - radius < (from_center + radius).min())

        def least(triangle):
            def place_of(x):
                return triangle[0] + x[0] * (triangle[1] - triangle[0]) + x[1] * (triangle[2] - triangle[0])

            found = minimize(lambda x: shape.distance(place_of(x), dtype="float64"), (0.3, 0.3), method="SLSQP",
                             bounds=[(0, 1)] * 2, constraints={"type": "ineq", "fun": lambda x: 1 - x[0] - x[1]},
                             options={"ftol": 1e-15, "maxiter": 300})  # fmt: skip
            return found.fun

        truth = min(least(triangle) for triangle in local[near])
        assert distance == pytest.approx(truth, abs=1e-8)
        assert distance <= truth + 1e-12
        assert error <= 1e-8
        assert np.linalg.norm(p - q) == pytest.approx(distance, abs=1e-12)
        assert fb.closest_point(mesh, p).distances == pytest.approx(0, abs=1e-12)
        assert shape.distance(place[:3, :3].T @ (q - place[:3, 3]), dtype="float64") == pytest.approx(0, abs=1e-12)


def brute_force(a, b, place, count=60):
    """The smallest larger distance on a grid, and the distance between its points."""
    lower, upper = np.min([a.bounds[0], [-3, -3, -3]], axis=0), np.max([a.bounds[1], [3, 3, 3]], axis=0)
    for _ in range(3):
        grid = np.stack(np.meshgrid(*np.linspace(lower, upper, count).T, indexing="ij"), -1).reshape(-1, 3)
        field_a = a.distance(grid) if isinstance(a, fb.Shape) else fb.query(a, grid).distances
        local = (grid - place[:3, 3]) @ place[:3, :3]
        field_b = b.distance(local) if isinstance(b, fb.Shape) else fb.query(b, local).distances
        larger = np.maximum(field_a, field_b)
        best = grid[larger.argmin()]
        step = (upper - lower) / (count - 1)
        lower, upper = best - 3 * step, best + 3 * step
    return 2 * larger.min(), 2 * np.linalg.norm(step)


@pytest.mark.parametrize("seed", range(6))
def test_overlaps_and_other_pairs_are_those_of_brute_force(seed):
    random = np.random.default_rng(seed)
    solids = [fb.torus(1, 0.4), fb.Mesh(*meshes.torus(minor=0.4, segments=32, sides=12)), fb.cylinder(0.6, 1.5),
              fb.ellipsoid((1, 0.5, 0.7)), fb.Mesh(*meshes.box()), fb.box((1, 2, 1.5)), fb.cone(0.8, 1.5)]  # fmt: skip
    a, b = solids[seed], solids[(3 * seed + 2) % 7]
    place = pose(random.uniform(-0.7, 0.7, 3), meshes.rotation(seed))

    distance, error, *_ = one(a, b, pose_b=place)

    truth, step = brute_force(a, b, place)
    # The grid may miss the best point by a step, and begins with the best cell of a coarse one.
    assert distance - error - 1e-9 <= truth
    assert distance <= truth + 1e-3 * abs(distance) + 1e-9
    assert error <= 1.1e-3 * abs(distance) or isinstance(a, fb.Mesh) or isinstance(b, fb.Mesh)
    assert truth - step <= distance


@pytest.mark.parametrize("other", [fb.sphere(0.5).translate((0, 0, 0.3)), fb.cylinder(0.5, 1).translate((0, 0, 0.3))])
def test_a_cone_on_the_axis_of_another_solid_has_its_depth(other):
    """Several points of the cone are nearest to its axis, so the distance has no gradient there."""
    cone = fb.cone(0.3, 4)
    sine = 0.3 / np.hypot(0.3, 4)
    # The depths in the cone and above the lower end of the other solid are equal at this height.
    height = (2 * sine - 0.2) / (1 + sine)
    for pair in ((cone, other), (other, cone)):
        found = fb.clearance(*pair)
        assert found.distances[0] - found.errors[0] <= -2 * (0.2 + height) <= found.distances[0] + 1e-9
        assert found.errors[0] <= 1e-3 * abs(found.distances[0])


def test_a_ball_beside_an_edge_of_a_pyramid_has_its_distance():
    """The point nearest to it lies on the edge from (0.5, 0.5, -0.5) to the top, where |x| = |y|."""
    start, edge = np.array([0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 1.0])
    center = np.array([0.9, 0.9, 0.2])
    foot = start + np.dot(center - start, edge) / np.dot(edge, edge) * edge
    found = fb.clearance(fb.pyramid(1, 1), fb.sphere(0.1).translate(center))
    assert found.distances[0] == pytest.approx(np.linalg.norm(center - foot) - 0.1, rel=1e-9)
    assert found.points_a[0] == pytest.approx(foot, abs=1e-9)


def test_the_depth_is_at_most_that_of_the_way_out(random):
    coal = pytest.importorskip("coal")
    for _ in range(40):
        sizes = random.uniform(0.4, 1.5, (2, 3))
        place = pose(random.uniform(-0.5, 0.5, 3), meshes.rotation(int(random.integers(1000))))
        distance, error, *_ = one(fb.box(sizes[0]), fb.box(sizes[1]), pose_b=place)
        transform = coal.Transform3s(place[:3, :3], place[:3, 3])
        depth = -coal.distance(coal.Box(sizes[0]), coal.Transform3s(), coal.Box(sizes[1]), transform,
                               coal.DistanceRequest(), coal.DistanceResult())  # fmt: skip
        if depth > 1e-6:
            assert 0 < -distance <= depth + 1e-6
            assert error <= 1e-3 * -distance


def test_the_value_has_no_jump_through_contact():
    gear, box = fb.models.gear(teeth=9), fb.box((0.5, 0.4, 0.3))
    shifts = np.linspace(0.9, 1.6, 36)
    found = [fb.clearance(gear, box, pose_b=pose((x, 0.1, 0.05), TILT)) for x in shifts]
    values, errors = np.array([f.distances[0] for f in found]), np.array([f.errors[0] for f in found])
    assert values[0] < 0 < values[-1]
    # The value changes by at most the length of a translation.
    assert (np.abs(np.diff(values)) <= np.diff(shifts) + errors[1:] + errors[:-1] + 1e-9).all()


@pytest.mark.parametrize("cutoff", [0.1, 0.6, 2.0])
def test_beyond_the_cutoff_the_value_is_a_bound(cutoff):
    for a, b in ((BALL, fb.sphere(0.3)), (fb.Mesh(*meshes.torus()), BALL), (fb.torus(1, 0.2), fb.cylinder(0.2, 1))):
        for x in (1.9, 2.6, 4.0):
            truth = one(a, b, pose_b=pose((x, 0, 0)))[0]
            distance, error, p, _, normal = one(a, b, pose_b=pose((x, 0, 0)), cutoff=cutoff)
            if truth < cutoff:
                assert distance == pytest.approx(truth, abs=1e-9)
            else:
                assert cutoff <= distance <= truth + 1e-9
                assert error == np.inf
                assert np.isnan([p, normal]).all()


def test_an_assembly_has_the_clearance_of_its_pairs(tmp_path, random):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["arm"])
    poses = robot.poses(random.uniform(-1.2, 1.2, (3, 8)) * (1, 1, 1, 1, 1, 1, 1, 0.05))
    found = robot.clearance(poses)

    assert found.distances.shape == found.errors.shape == (3, len(robot.pairs))
    assert found.points_a.shape == found.normals.shape == (3, len(robot.pairs), 3)
    assert np.array_equal(found.pairs, robot.pairs)
    bodies = list(robot.bodies.values())
    for configuration, pair in ((0, 3), (1, 10), (2, -1)):
        i, j = robot.pairs[pair]
        single = fb.clearance(list(bodies[i]), list(bodies[j]), pose_a=poses[configuration, i],
                              pose_b=poses[configuration, j])  # fmt: skip
        assert found.distances[configuration, pair] == single.distances[0]
    # A batch has the same bits as its configurations, and pairs may have names.
    again = robot.clearance(poses[1], pairs=[("link0", "hand")])
    row = next(i for i, pair in enumerate(robot.pairs) if tuple(pair) == (0, robot.body_names.index("hand")))
    assert again.distances.tolist() == [found.distances[1, row]]
    # The nearest points are surface points of the bodies.
    apart = found.distances[0] > 0
    gaps = np.linalg.norm(found.points_a[0] - found.points_b[0], axis=-1)
    assert gaps[apart] == pytest.approx(found.distances[0][apart], abs=1e-6)


def test_the_environment_is_one_body(tmp_path):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["two"])
    poses = robot.poses([0.3, 0.5])
    wall = [fb.plane((0, 0, 1), -0.4), (fb.box((0.2, 0.2, 0.2)), pose((0.9, 0, 0.5)))]
    found = robot.clearance(poses, pairs=[], environment=wall)

    assert found.pairs.tolist() == [[0, -1], [1, -1], [2, -1]]
    for i, elements in enumerate(robot.bodies.values()):
        expected = fb.clearance(list(elements), wall, pose_a=poses[i]).distances
        assert found.distances[i] == expected[0]
    assert robot.clearance(poses, environment=wall).distances.shape == (len(robot.pairs) + 3,)


def test_the_normals_are_the_derivative_by_the_joint_values(tmp_path, random):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["two"])
    obstacle = fb.sphere(0.2).translate((0.9, 0.3, 0.6))
    for values in random.uniform(-1, 1, (5, 2)):
        found = robot.clearance(robot.poses(values), pairs=[], environment=obstacle)
        rows = found.pairs[:, 0]
        slope = np.einsum("ki,kim->km", found.normals, robot.jacobian(values, rows, found.points_a))
        step = 1e-6
        for j in range(2):
            change = np.eye(2)[j] * step
            ends = [robot.clearance(robot.poses(values + s * change), pairs=[], environment=obstacle) for s in (1, -1)]
            expected = (ends[0].distances - ends[1].distances) / (2 * step)
            moves = np.linalg.norm(ends[0].points_a - ends[1].points_a, axis=-1)
            smooth = (found.distances > 0) & (moves < 1e-4)
            assert slope[smooth, j] == pytest.approx(expected[smooth], abs=1e-5)


def test_the_results_do_not_depend_on_the_number_of_threads(tmp_path):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["arm"])
    poses = robot.poses(np.linspace(-1, 1, 4)[:, None] * np.array([1, 1, 1, -1, 1, 1, 1, 0.01]))
    made = []
    for threads in (1, 2):
        fb.set_threads(threads)
        made.append(robot.clearance(poses))
    for first, second in zip(made[0][:5], made[1][:5], strict=True):
        assert first.tobytes() == second.tobytes()


def test_mistakes_name_the_argument():
    robot = fb.Assembly({"a": BALL, "b": BALL, "c": ()})
    cases = [
        (lambda: fb.clearance(BALL, BALL, pose_a=np.zeros((4, 4))), "pose_a: must be a rotation and a translation"),
        (lambda: fb.clearance(BALL, BALL, pose_b=np.zeros((3, 4))), "pose_b"),
        (lambda: fb.clearance(BALL, BALL, cutoff=0), "cutoff: must be above 0, got 0"),
        (lambda: fb.clearance(BALL, BALL, cutoff=np.nan), "cutoff: must be a number, got nan"),
        (lambda: fb.clearance(BALL, BALL, relative_tolerance=0), "relative_tolerance: must be a finite number above 0"),
        (lambda: fb.clearance(BALL, ()), "b: has no geometry"),
        (
            lambda: fb.clearance(BALL, robot),
            r"b\[0\]: must be one solid, got Assembly.*clearance\(poses, environment=solid",
        ),
        (lambda: robot.clearance(pairs=[("a", "x")]), r"pairs\[0\]: 'x' is no body"),
        (lambda: robot.clearance(pairs=[(0, 3)]), r"pairs\[0\]"),
        (lambda: robot.clearance(pairs=3), "pairs: must be an iterable of two bodies"),
        (lambda: robot.clearance(np.zeros((2, 4, 4))), "poses: must have shape"),
        (lambda: robot.clearance(environment=()), "environment: has no geometry"),
    ]
    for call, message in cases:
        with pytest.raises(fb.ArgumentError, match=message):
            call()
    with pytest.raises(fb.MeshError):
        fb.clearance((np.zeros((3, 3)), [[0, 1, 2]]), BALL)
    with pytest.raises(fb.ArgumentError, match=r"^a, b: both solids are unbounded.*intersect one"):
        fb.clearance(fb.plane((0, 0, 1)), fb.slab(1))
    # There is no proof for the overlap of an open mesh.
    with pytest.warns(fb.SurfaceWarning, match="open"):
        overlap = fb.clearance(fb.Mesh(*meshes.open_box()), BALL)
    assert overlap.distances[0] < 0
    assert overlap.errors[0] == np.inf
    assert fb.clearance(fb.Mesh(*meshes.open_box()), BALL, pose_b=pose((3, 0, 0))).errors[0] == 0
    # Bodies without geometry are infinitely far.
    far = robot.clearance(pairs=[("a", "c")])
    assert far.distances.tolist() == [np.inf]
    assert robot.clearance(pairs=[]).distances.shape == (0,)
