"""Clearances at contact: normals, shallow overlaps, proofs and sheets, under random motions."""

import numpy as np
import pytest

import fieldbake as fb
import meshes


def rigid(rotation, translation):
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, translation
    return made


def motions(random, count=4):
    return [rigid(meshes.rotation(int(random.integers(10000))), random.uniform(-2, 2, 3)) for _ in range(count)]


#: The axes x, y and z become z, y and -x.
LYING = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float)
#: A quarter of a half-turn about x: a box stands on an edge.
ON_EDGE = np.array([[1, 0, 0], [0, np.sqrt(0.5), -np.sqrt(0.5)], [0, np.sqrt(0.5), np.sqrt(0.5)]])
#: The diagonal of a cube becomes z: a box stands on a corner.
ON_CORNER = np.array([[1, -1, 0], [1, 1, -2], [1, 1, 1]]) / np.sqrt([[2], [6], [3]])

CUBE = fb.Mesh(*meshes.box())
#: A solid, its rotation, and the height of its centre at contact with the half-space z < 0.
RESTING = {
    "ball": (fb.sphere(1), np.eye(3), 1.0),
    "box": (fb.box(2), np.eye(3), 1.0),
    "mesh": (CUBE, np.eye(3), 1.0),
    "cylinder": (fb.cylinder(0.5, 2), np.eye(3), 1.0),
    "cone": (fb.cone(0.5, 1), np.eye(3), 0.5),
    "torus": (fb.torus(1, 0.25), np.eye(3), 0.25),
    "lying cylinder": (fb.cylinder(0.5, 2), LYING, 0.5),
    "lying capsule": (fb.capsule(0.3, 1), LYING, 0.3),
}
#: As above. The ball in the overlap is smaller than the depth.
POINTED = {
    "box on a corner": (fb.box(2), ON_CORNER, np.sqrt(3)),
    "mesh on a corner": (CUBE, ON_CORNER, np.sqrt(3)),
    "box on an edge": (fb.box(2), ON_EDGE, np.sqrt(2)),
    "mesh on an edge": (CUBE, ON_EDGE, np.sqrt(2)),
}
GROUNDS = {
    "plane": fb.plane((0, 0, 1), 0),
    "box": fb.box((8, 8, 2)).translate((0, 0, -1)),
    "mesh": fb.Mesh(*meshes.box((-4, -4, -2), (4, 4, 0))),
}
#: The least tolerance of a clearance, relative to the size of the smaller solid, times the largest size here.
FLOOR = 1e-9 * 4


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("name", [*RESTING, *POINTED])
def test_the_normal_at_contact_is_that_of_the_ground(name, ground, random):
    solid, rotation, height = {**RESTING, **POINTED}[name]
    for depth in (-1e-6, 0.0, 1e-9, 1e-3, 1e-2):
        for i, motion in enumerate(motions(random)):
            own = motion @ rigid(rotation, (*random.uniform(-0.3, 0.3, 2), height - depth))
            pair, sign = [(solid, own), (GROUNDS[ground], motion)], 1.0
            if i % 2:
                pair, sign = pair[::-1], -1.0
            (a, pose_a), (b, pose_b) = pair
            found = fb.clearance(a, b, pose_a=pose_a, pose_b=pose_b)

            # A minimum to 1e-9 of the size is off by up to the root, 3e-5, along a surface of radius 1.
            assert np.abs(sign * found.normals[0] - motion[:3, 2]).max() <= 1e-4
            if name in RESTING:
                assert abs(found.distances[0] + depth) <= FLOOR
            else:
                assert -depth - FLOOR <= found.distances[0] <= max(0.0, -depth) + FLOOR


@pytest.mark.parametrize("solid", [fb.box(2), CUBE], ids=["box", "mesh"])
@pytest.mark.parametrize("depth", [0.0, 1e-3])
def test_the_normal_of_boxes_side_by_side_is_the_derivative(solid, depth, random):
    for motion in motions(random):

        def moved(shift, motion=motion):
            return fb.clearance(solid, solid, pose_a=motion, pose_b=motion @ rigid(np.eye(3), shift))

        side = np.array([2.0 - depth, 0.0, 0.0])
        found = moved(side)
        assert np.abs(found.normals[0] + motion[:3, 0]).max() <= 1e-6
        # The second box moves along its axis. The distance is linear, so the differences have rounding alone.
        step = 1e-4
        ends = [moved(side + np.array([s * step, 0, 0])).distances[0] for s in (1, -1)]
        slope = found.normals[0] @ -motion[:3, 0]
        assert abs((ends[0] - ends[1]) / (2 * step) - slope) <= 1e-6


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("depth", [1e-4, 1e-3, 1e-2])
def test_a_torus_in_the_ground_has_its_depth(ground, depth, random):
    for motion in motions(random, 2):
        own = motion @ rigid(np.eye(3), (0.2, 0.1, 0.25 - depth))
        found = fb.clearance(fb.torus(1, 0.25), GROUNDS[ground], pose_a=own, pose_b=motion, relative_tolerance=1e-6)
        # The overlap is wide and thin, so its depth is found by a descent; the proof remains coarse.
        assert abs(found.distances[0] + depth) <= FLOOR
        assert found.distances[0] - found.errors[0] <= -depth + FLOOR


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("depth", [1e-3, 1e-2])
def test_the_depth_of_a_convex_mesh_is_proven(ground, depth, random):
    for motion in motions(random):
        own = motion @ rigid(np.eye(3), (0.1, 0, 1 - depth))
        found = fb.clearance(CUBE, GROUNDS[ground], pose_a=own, pose_b=motion)
        assert abs(found.distances[0] + depth) <= FLOOR
        assert found.errors[0] <= 1e-3 * depth


SHEETS = {
    "triangle": fb.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]),
    "square": fb.Mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)]),
}


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
@pytest.mark.parametrize("sheet", SHEETS)
@pytest.mark.parametrize(
    "solid", [fb.sphere(0.5), fb.box(1), CUBE, fb.cylinder(0.5, 1), fb.torus(0.5, 0.2), fb.sphere(4)], ids=repr
)
def test_a_sheet_through_a_solid_has_no_distance(sheet, solid, random):
    for i, motion in enumerate(motions(random)):
        pair = (solid, SHEETS[sheet]) if i % 2 else (SHEETS[sheet], solid)
        found = fb.clearance(*pair, pose_a=motion, pose_b=motion)

        assert found.distances[0] == 0
        assert found.errors[0] == 0
        p, q = found.points_a[0], found.points_b[0]
        assert np.linalg.norm(p - q) <= 1e-12
        local = motion[:3, :3].T @ (p - motion[:3, 3])
        assert abs(local[2]) <= 1e-12
        depth = (
            solid.distance(local, dtype="float64") if isinstance(solid, fb.Shape) else fb.signed_distance(solid, local)
        )
        assert depth <= 1e-12
        assert abs(np.linalg.norm(found.normals[0]) - 1) <= 1e-12


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_a_sheet_apart_from_a_solid_has_its_distance(random):
    for motion in motions(random):
        # The sheet contains the point above the centre of each solid.
        lifted = motion @ rigid(np.eye(3), (-0.3, -0.3, 1.25))
        for solid in (fb.sphere(1), CUBE, fb.cylinder(0.5, 2)):
            found = fb.clearance(SHEETS["square"], solid, pose_a=lifted, pose_b=motion)
            assert abs(found.distances[0] - 0.25) <= FLOOR
            assert found.errors[0] <= FLOOR


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_the_clearance_of_stacked_triangles_has_no_proof():
    # The winding number between equal triangles one upon the other exceeds 1/2.
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.9, 0, 0)]
    stacked = fb.Mesh(corners, [(0, 1, 2), (0, 3, 2)])
    assert fb.clearance(stacked, fb.sphere(0.5)).errors[0] == np.inf
