"""Swept volumes: closed forms, containment between the poses, topology and the cost of the proof."""

import pickle
import time
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm, logm

import fieldbake as fb
import meshes
import robots

#: Capsule: the segment of the centre of a ball, and its radius.
ENDS, RADIUS = np.array([[0.0, 0, 0], [2.0, 0.3, 0.1]]), 0.5


def pose(translation=(0, 0, 0), rotation=None):
    made = np.eye(4)
    made[:3, 3] = translation
    if rotation is not None:
        made[:3, :3] = rotation
    return made


def turned(axis, angle, translation=(0, 0, 0)):
    """A rotation by an angle about an axis through the origin, then a translation."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    return pose(translation, expm(angle * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])))


def capsule_distance(points):
    along = ENDS[1] - ENDS[0]
    share = np.clip((points - ENDS[0]) @ along / (along @ along), 0, 1)
    return np.linalg.norm(points - ENDS[0] - share[..., None] * along, axis=-1) - RADIUS


def torus_distance(points, major=1.0, minor=0.3):
    return np.hypot(np.linalg.norm(points[..., :2], axis=-1) - major, points[..., 2]) - minor


SIDES = np.array([1.0, 0.6, 0.4])
QUARTER = np.pi / 2


def sector_distance(points):
    """The distance from a box with one edge on the z axis, turned by a quarter, over 2,000 angles."""
    least = np.full(len(points), np.inf)
    for angle in np.linspace(0, QUARTER, 2000):
        c, s = np.cos(angle), np.sin(angle)
        local = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        away = np.abs(local - SIDES / 2) - SIDES / 2
        own = np.linalg.norm(np.maximum(away, 0), axis=1) + np.minimum(away.max(axis=1), 0)
        np.minimum(least, own, out=least)
    return least


BALL_ON_LINE = (fb.sphere(RADIUS), [pose(ENDS[0]), pose(ENDS[1])], {})
BALL_ON_CIRCLE = (
    fb.sphere(0.3).translate((1, 0, 0)), [turned((0, 0, 1), i * np.pi / 4) for i in range(8)], {"closed": True}
)  # fmt: skip
BOX_ON_EDGE = (fb.box(SIDES).translate(SIDES / 2), [pose(), turned((0, 0, 1), QUARTER)], {})


def stored(volume):
    """Positions and values of all samples of bricks."""
    arrays = volume._core_field.arrays()
    words = arrays["index"]
    places = np.argwhere(words >> 30 == 0)
    samples = places[:, None, None, None] * 7 - 1 + np.stack(np.mgrid[:8, :8, :8], -1)
    values = arrays["bricks"][words[tuple(places.T)] & (2**30 - 1)]
    kept = ((samples >= 0) & (samples < volume.resolution)).all(axis=-1)
    return volume.bounds[0] + (samples[kept] + 0.5) * volume.spacing, values[kept]


@pytest.mark.parametrize(
    ("motion", "distance", "slack"),
    [(BALL_ON_LINE, capsule_distance, 0), (BALL_ON_CIRCLE, torus_distance, 0), (BOX_ON_EDGE, sector_distance, 8e-4)],
    ids=["capsule", "torus", "sector"],
)
@pytest.mark.parametrize("contain", [False, True])
def test_samples_in_the_band_are_lower_bounds_within_the_tolerance(motion, distance, slack, contain, random):
    geometry, poses, options = motion
    volume = fb.sweep(geometry, poses, 64, contain=contain, tolerance=0.2, **options)

    points, values = stored(volume)
    chosen = random.permutation(len(points))[:20_000]
    voxel = volume.report.voxel_size
    truth = distance(points[chosen]) - volume.report.offset
    # Beyond the band samples are bounds: samples that the truth or the field puts there are left out.
    near = np.maximum(np.abs(truth), np.abs(values[chosen])) < volume.band
    error = (values[chosen] - truth)[near] / voxel
    assert near.sum() > 5000
    # The minimum over 2,000 angles exceeds that over all by up to half a step of the angle times the radius, `slack`.
    assert error.max() <= 1e-6
    assert error.min() >= -0.2 - slack / voxel
    far = ~near & (np.abs(truth) > volume.band)
    assert (np.sign(values[chosen][far]) == np.sign(truth[far])).all()
    # Everywhere else the field is a lower bound of the magnitude, with the right sign.
    anywhere = random.uniform(*volume.bounds, (2000, 3))
    truth, found = distance(anywhere) - volume.report.offset, volume.sample(anywhere)
    far = np.abs(truth) > volume.band + 2 * voxel
    assert (np.sign(found[far]) == np.sign(truth[far])).all()
    assert (np.abs(found[far]) <= np.abs(truth[far]) + (0.2 + 1e-3) * voxel).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "volume"),
    [
        (BALL_ON_LINE, np.pi * RADIUS**2 * np.linalg.norm(ENDS[1] - ENDS[0]) + 4 / 3 * np.pi * RADIUS**3),
        (BALL_ON_CIRCLE, 2 * np.pi**2 * 0.3**2),
        (BOX_ON_EDGE, SIDES[2] * (SIDES[0] * SIDES[1] + QUARTER / 2 * (SIDES[0] ** 2 + SIDES[1] ** 2))),
    ],
    ids=["capsule", "torus", "sector"],
)
def test_the_volume_without_an_offset_is_that_of_the_closed_form(motion, volume):
    geometry, poses, options = motion
    swept = fb.sweep(geometry, poses, 128, contain=False, tolerance=0.05, **options).to_mesh(sharp=False)
    assert swept.volume == pytest.approx(volume, rel=0.01)


@pytest.mark.parametrize(
    ("motion", "distance", "most"),
    [(BALL_ON_LINE, capsule_distance, 2.1), (BALL_ON_CIRCLE, torus_distance, 2.1), (BOX_ON_EDGE, sector_distance, 3.8)],
    ids=["capsule", "torus", "sector"],
)
def test_the_surface_of_a_contained_solid_is_outside_and_near(motion, distance, most):
    geometry, poses, options = motion
    volume = fb.sweep(geometry, poses, 64, **options)
    swept = volume.to_mesh(sharp=False)

    away = distance(swept.vertices) / volume.report.voxel_size
    assert swept.is_closed
    assert away.min() > 0
    assert away.max() <= most
    euler = 0 if distance is torus_distance else 2
    assert len(swept.vertices) - len(swept.faces) // 2 == euler


def between(first, second, share):
    """The pose on the screw from one pose to another, by matrix functions."""
    return np.real(expm(share * logm(second @ np.linalg.inv(first)))) @ first


def points_inside(mesh, count, random):
    points = random.uniform(*mesh.bounds, (20 * count, 3))
    return points[fb.contains(mesh, points)][:count]


def random_poses(count, random):
    return [turned(random.normal(size=3), random.uniform(0, 2.5), random.uniform(-1, 1, 3)) for _ in range(count)]


def assert_contained(volume, swept, points):
    assert (volume.sample(points) < 0).all()
    assert fb.contains(swept, points).all()


@pytest.mark.parametrize(
    ("name", "encoding"), [("gear", "float32"), ("torus", "snorm8"), ("box", "float16"), ("knot", "snorm16")]
)
def test_every_point_of_the_body_stays_inside_between_the_poses(name, encoding, random):
    mesh = fb.models.gear(teeth=9) if name == "gear" else fb.Mesh(*getattr(meshes, name)())
    motion = random_poses(3, random)
    volume = fb.sweep(mesh, motion, 40, encoding=encoding)
    swept = volume.to_mesh(sharp=False)

    body = np.concatenate([points_inside(mesh, 300, random), mesh.vertices[::7]])
    places = [
        body @ (at := between(motion[step], motion[step + 1], share))[:3, :3].T + at[:3, 3]
        for step in range(2)
        for share in random.uniform(0, 1, 20)
    ]
    points = np.concatenate(places)
    assert_contained(volume, swept, points)
    igl = pytest.importorskip("igl")
    some = np.ascontiguousarray(points[::20])
    assert (igl.fast_winding_number(swept.vertices, swept.faces, some) > 0.5).all()


def test_every_point_of_a_robot_stays_inside_between_the_values(tmp_path, random):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["arm"])
    values = np.cumsum(random.uniform(-0.25, 0.25, (6, 8)), axis=0)
    values[:, 7] = random.uniform(0, 0.1, 6)
    volume = fb.sweep(robot, values, 56)
    swept = volume.to_mesh(sharp=False)

    for row, share in zip(random.integers(0, 5, 40), random.uniform(0, 1, 40), strict=True):
        poses = robot.poses(values[row] * (1 - share) + values[row + 1] * share)
        for place, elements in zip(poses, robot.bodies.values(), strict=True):
            for shape, own in elements:
                local = random.uniform(*shape.bounds, (60, 3))
                local = local[shape.distance(local) <= 0]
                at = place @ own
                assert_contained(volume, swept, local @ at[:3, :3].T + at[:3, 3])
    # The poses of the same rows are another motion, with screws between them.
    again = fb.sweep(robot, robot.poses(values), 40)
    assert_contained(again, again.to_mesh(sharp=False), np.array([robot.poses(v)[8, :3, 3] for v in values]))


@pytest.mark.slow
def test_the_sweep_of_a_robot_has_the_topology_of_the_union(tmp_path):
    robot = fb.Assembly.from_urdf(robots.write(tmp_path)["two"])
    values = np.stack([np.linspace(-1, 1, 12), np.linspace(0, 2.5, 12)], axis=1)
    swept = fb.sweep(robot, values, 40, contain=False, tolerance=0.02)
    dense = swept.to_volume()

    shares = np.linspace(0, 11, 400)
    at = np.stack([np.interp(shares, np.arange(12), column) for column in values.T], axis=1)
    grid = np.stack(np.meshgrid(*dense.coordinates, indexing="ij"), -1)
    least = np.min([robot.distance(grid, pose) for pose in robot.poses(at)], axis=0)
    union = fb.Volume(least.astype(np.float32), dense.bounds)

    def facts(volume):
        made = volume.to_mesh(sharp=False)
        return made.topology()["components"], len(made.vertices) - len(made.faces) // 2

    assert facts(swept) == facts(union)


def test_a_sweep_has_no_inner_shells():
    # The cube of libigl's issue 2562, whose sampled sweeps leave shells inside: it moves by less than its size.
    swept = fb.sweep(fb.Mesh(*meshes.box()), [pose((0.3 * i, 0, 0.1 * i)) for i in range(8)], 48).to_mesh(sharp=False)
    assert swept.topology()["components"] == 1
    assert len(swept.vertices) - len(swept.faces) // 2 == 2


def test_one_row_is_a_bake():
    mesh = fb.models.gear(teeth=7)
    volume = fb.sweep(mesh, [pose()], 40, contain=False)
    points, values = stored(volume)
    truth = fb.query(mesh, points).distances
    near = np.abs(truth) < volume.band
    assert near.sum() > 5000
    assert values[near] == pytest.approx(truth[near], abs=1e-6)
    assert volume.report.segments == 1


@pytest.mark.parametrize("resolution", [(40, 40, 40), (120, 31, 26)])
def test_oblong_voxels_leave_space_for_a_slender_body(resolution):
    rod = fb.capsule(0.05, 1)
    swept = fb.sweep(rod, [np.eye(4)], resolution)
    assert (swept.sample(rod.to_mesh(64).vertices) < 0).all()


def test_the_proof_costs_a_tenth_of_uniform_steps(random):
    mesh = fb.models.gear(teeth=9)
    motion = random_poses(4, random)
    volume = fb.sweep(mesh, motion, 64)
    # A distance at one time proves the tolerance while the point moves by that much before and after, in the frame of
    # the body.
    points = random.choice(stored(volume)[0], 300)
    shares = np.linspace(0, 1, 60)
    inverse = [np.linalg.inv(between(a, b, share)) for a, b in pairwise(motion) for share in shares]
    paths = np.stack([points @ at[:3, :3].T + at[:3, 3] for at in inverse])
    length = np.linalg.norm(np.diff(paths, axis=0), axis=2).sum(axis=0).mean()
    uniform = length / (2 * 0.25 * volume.report.voxel_size)
    assert volume.report.evaluations <= uniform / 10


def test_many_poses_of_a_path_cost_less_than_five_times_few():
    mesh = fb.models.gear(teeth=9)
    seconds = []
    for count in (50, 1000):
        motion = [turned((0.2, 0.5, 1), 2 * s, (s, 0.3 * s * s, 0)) for s in np.linspace(0, 1, count)]
        start = time.process_time()
        fb.sweep(mesh, motion, 40)
        seconds.append(time.process_time() - start)
    assert seconds[1] < 5 * seconds[0]


def test_the_samples_do_not_depend_on_the_number_of_threads(random):
    motion = random_poses(3, random)
    made = []
    for threads in (1, 2):
        fb.set_threads(threads)
        made.append(fb.sweep(fb.Mesh(*meshes.torus()), motion, 40)._core_field.arrays())
    for name in ("index", "nodes", "bricks"):
        assert made[0][name].tobytes() == made[1][name].tobytes()


def test_the_inside_of_a_given_box_is_the_same_solid(random):
    box = np.array([[0.5, -1, -1], [1.5, 1, 1]])
    geometry, motion, _ = BALL_ON_LINE
    volume = fb.sweep(geometry, motion, voxel_size=0.05, bounds=box)
    points = random.uniform(*box, (4000, 3))
    points = points[capsule_distance(points) <= 0]
    assert_contained(volume, volume.to_mesh(sharp=False), points)


def test_shapes_that_are_not_exact_are_contained_by_the_deviation_of_their_mesh(random):
    shape = fb.box((1, 0.6, 0.4)) - fb.sphere(0.35)
    motion = [pose(), turned((1, 0, 1), 1.0, (1, 0.5, 0))]
    volume = fb.sweep(shape, motion, 48)
    points = random.uniform(*shape.bounds, (4000, 3))
    points = points[shape.distance(points) <= 0]
    for share in (0.0, 0.3, 0.7):
        at = between(*motion, share)
        assert_contained(volume, volume.to_mesh(sharp=False), points @ at[:3, :3].T + at[:3, 3])
    assert volume.report.offset > np.linalg.norm(volume.spacing)


def test_an_open_mesh_is_swept_as_a_sheet():
    sheet = fb.Mesh(*meshes.flat_sheet())
    with pytest.raises(fb.MeshError, match="the mesh is open, so it is no solid that can be swept; close it by"):
        fb.sweep(sheet, [pose(), pose((0, 0, 1))])
    swept = fb.sweep(sheet, [pose(), pose((0, 0, 1))], 40, sign="unsigned")
    assert (swept.report.sign_method, swept.report.sign_reason) == ("unsigned", "chosen by the caller")
    points = sheet.vertices[:, None] + np.linspace(0, 1, 20)[:, None] * (0, 0, 1)
    assert_contained(swept, swept.to_mesh(sharp=False), points.reshape(-1, 3))
    with pytest.raises(fb.ArgumentError, match='contain: must be True with sign="unsigned"'):
        fb.sweep(sheet, [pose()], sign="unsigned", contain=False)
    with pytest.raises(fb.ArgumentError, match="sign: does not apply to a shape"):
        fb.sweep(fb.sphere(1), [pose()], sign="unsigned")


def test_the_report_names_the_motion():
    volume = fb.sweep(fb.sphere(1), [pose(), pose((1, 0, 0)), pose((1, 1, 0))], 32, closed=True)
    report = volume.report
    assert report.segments == 3
    assert report.offset == pytest.approx(np.linalg.norm(volume.spacing), rel=1e-4)
    assert report.voxel_size == pytest.approx(volume.spacing.max())
    assert report.evaluations > 1
    assert "3 steps" in str(report)
    assert pickle.loads(pickle.dumps(report)) == report
    assert (pickle.loads(pickle.dumps(volume)).sample([(0, 0, 0)]) < 0).all()


def test_mistakes_name_the_argument():
    ball = fb.sphere(1)
    robot = fb.Assembly({"a": ball, "b": ball}, [fb.Joint("j", "revolute", "a", "b")])
    shear = pose()
    shear[0, 1] = 0.1
    cases = [
        ((ball, pose()), {}, r"motion: must have shape \(t, 4, 4\) with at least one row"),
        ((ball, np.zeros((0, 4, 4))), {}, "motion: must have shape"),
        ((ball, [shear]), {}, r"motion\[0\]: must be a rotation and a translation"),
        ((ball, np.full((2, 4, 4), np.nan)), {}, r"motion\[0\]: must be a rotation and a translation"),
        ((ball, [pose(), turned((1, 0, 0), np.pi)]), {}, "motion: rows 0 and 1 differ by half a turn"),
        ((robot, np.zeros((2, 2))), {}, r"values: must have shape \(\.\.\., 1\)"),
        ((robot, np.zeros((0, 1))), {}, "motion: must be joint values"),
        ((robot, [0.0]), {}, "motion: must be joint values"),
        ((robot, np.zeros((2, 3, 4, 4))), {}, r"motion: must have shape \(t, 2, 4, 4\)"),
        ((ball, [pose()]), {"tolerance": 0}, "tolerance: must be a finite number above 0"),
        ((ball, [pose()]), {"tolerance": np.nan}, "tolerance: must be a finite number above 0"),
        ((ball, [pose()]), {"band": 1}, "band: must be a finite number of at least 2"),
        ((ball, [pose()]), {"sign": "parity"}, "sign: must be one of"),
        ((ball, [pose()]), {"closed": "yes"}, "closed: must be"),
        ((ball, [pose()]), {"encoding": "float8"}, "encoding: must be one of"),
        ((ball, [pose()], 8), {}, "resolution: 8 voxels leave no space for the surface"),
        ((ball, [pose()], 64), {"voxel_size": 0.1}, "voxel_size: give either"),
    ]
    for arguments, options, message in cases:
        with pytest.raises(fb.ArgumentError, match=message):
            fb.sweep(*arguments, **options)
    closing = [pose(), turned((0, 0, 1), np.pi / 2), turned((0, 0, 1), np.pi)]
    fb.sweep(ball, closing, 32)
    with pytest.raises(fb.ArgumentError, match="motion: rows 2 and 0 differ by half a turn"):
        fb.sweep(ball, closing, 32, closed=True)
    with pytest.raises(fb.ShapeError, match="unbounded"):
        fb.sweep(fb.plane((0, 0, 1)), [pose()])
    with pytest.raises(fb.ShapeError, match="unbounded, or there is none"):
        fb.sweep(fb.Assembly({"empty": ()}), [[pose()]])
    below = fb.sweep(fb.plane((0, 0, 1)), [pose(), pose((0, 0, 0.5))], 32, bounds=[(-1, -1, -1), (1, 1, 1)])
    assert (below.sample([(0, 0, 0.4), (0, 0, -0.9)]) < 0).all()
    assert below.sample([(0, 0, 0.9)]) > 0
