"""Contacts of MuJoCo with our fields: balls in overlapping boxes, a ball in a bowl, a nut on a bolt."""

import numpy as np
import pytest

import fieldbake as fb
import truth
from octrees import BOXES, overlapping_boxes

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

RADIUS = 0.04


def contacts(model, data, centers):
    """The number of contacts of the ball with its centre at each position."""
    counts = []
    for center in centers:
        data.qpos[:3] = center
        mujoco.mj_forward(model, data)
        counts.append(data.ncon)
    return np.array(counts)


def test_every_ball_in_overlapping_boxes_has_a_contact(random):
    mesh = overlapping_boxes()
    spec = mujoco.MjSpec()
    asset = spec.add_mesh(name="boxes", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel().astype(np.int32))
    asset.octree_maxdepth = 6
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SDF, meshname="boxes")
    ball = spec.worldbody.add_body(name="ball")
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(RADIUS, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    lower, upper = mesh.bounds
    centers = random.uniform(lower - RADIUS, upper + RADIUS, (400, 3))
    inside = np.any([truth.box(centers, *corners) < 0 for corners in BOXES], axis=0)

    before = contacts(model, data, centers)
    fb.mujoco.refine(model)
    after = contacts(model, data, centers)

    assert inside.sum() > 200
    assert (before[inside] == 0).sum() >= 20
    assert (after[inside] == 0).sum() == 0
    # A ball farther from the boxes than its radius touches nothing.
    far = np.min([truth.box(centers, *corners) for corners in BOXES], axis=0) > 1.02 * RADIUS
    assert (after[far] > 0).sum() == 0
    assert far.sum() > 20


@pytest.mark.slow
def test_a_ball_rests_in_a_bowl_of_shapes():
    spec = mujoco.MjSpec()
    bowl = (fb.sphere(1.0) & fb.plane("z", 0)) - fb.sphere(0.8)
    fb.mujoco.add(spec, bowl, name="bowl", resolution=64)
    ball = spec.worldbody.add_body(name="ball", pos=(0.3, 0.1, -0.2))
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.15, 0, 0), condim=6, friction=(1, 0.01, 0.01))
    model = spec.compile()
    data = mujoco.MjData(model)
    distances = []
    while data.time < 8:
        mujoco.mj_step(model, data)
        if data.time > 4:
            distances.append(np.linalg.norm(data.body("ball").xpos))

    # The inner radius is 0.8, and the ball has the radius 0.15.
    assert np.abs(np.array(distances) - 0.65).max() <= 0.005


#: Radial clearance between nut and bolt.
CLEARANCE = 0.04


def thread(radius, height, pitch):
    """A rod whose axis is a helix around z."""
    return fb.extrude(fb.circle(radius), height).translate((0.15, 0, 0)).twist(pitch=pitch)


def fall(pitch, seconds, level=1.0):
    """Heights, turns and radial positions of a nut that falls along a bolt; the contact is reached after 0.3 s."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.001
    spec.option.sdf_iterations, spec.option.sdf_initpoints = 20, 40
    nut = spec.worldbody.add_body(name="nut", pos=(0, 0, level * pitch))
    nut.add_freejoint()
    fb.mujoco.add(spec, thread(0.5, 3.0, pitch), name="bolt", resolution=64, depth=5, condim=1)
    hole = thread(0.5 + CLEARANCE, 1.2, pitch)
    fb.mujoco.add(spec, fb.hex_prism(1.0, 0.8) - hole, name="nut", body="nut", resolution=64, depth=5, condim=1)
    model = spec.compile()
    assert model.nplugin == 0
    data = mujoco.MjData(model)
    rows = []
    while data.time < seconds:
        mujoco.mj_step(model, data)
        if data.time > 0.3:
            x, y, z = data.body("nut").xpos
            turn = data.body("nut").xmat.reshape(3, 3)
            rows.append((z, np.arctan2(turn[1, 0], turn[0, 0]), np.hypot(x, y)))
    heights, angles, radii = np.array(rows).T
    return heights, np.unwrap(angles) / (2 * np.pi), radii


@pytest.mark.slow
@pytest.mark.parametrize(("pitch", "seconds"), [(0.6, 2.4), (0.5, 3.0)])
def test_a_nut_turns_down_a_bolt(pitch, seconds):
    heights, turns, radii = fall(pitch, seconds)

    assert turns[0] - turns[-1] > 0.5
    # A turn is a descent by the pitch.
    assert np.abs((turns - turns[0]) - (heights - heights[0]) / pitch).max() <= 0.02
    assert radii.max() <= CLEARANCE
