"""Octrees of MuJoCo models: MuJoCo's own values where its rule is right, and the closed form where it is wrong."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth
from fieldbake.physics.octree import Octree
from octrees import BOXES, distance_to_boxes, leaf_corners, overlapping_boxes

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

#: Largest difference of two distances to a surface whose vertices are float32, as in MuJoCo, in diagonals of the box.
FLOAT32_VERTICES = 1e-6


def model_of(mesh, depth=5, **asset):
    """A model with one SDF geom whose octree MuJoCo fills."""
    spec = mujoco.MjSpec()
    made = spec.add_mesh(
        name="mesh", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel().astype(np.int32), **asset
    )
    made.octree_maxdepth = depth
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SDF, meshname="mesh")
    return spec.compile()


def diagonal(model):
    return 2 * np.linalg.norm(model.oct_aabb[0, 3:])


def read(model, points):
    """MuJoCo's rule: descend to the leaf that contains a point of the root box, and interpolate trilinearly."""
    nodes = np.zeros(len(points), dtype=int)
    while True:
        inner = model.oct_child[nodes, 0] >= 0
        if not inner.any():
            break
        upper = points[inner] >= model.oct_aabb[nodes[inner], :3]
        nodes[inner] = model.oct_child[nodes[inner], upper @ (1, 2, 4)]
    boxes = model.oct_aabb[nodes]
    t = (points - boxes[:, :3]) / (2 * boxes[:, 3:]) + 0.5
    values = np.zeros(len(points))
    for j in range(8):
        weights = [t[:, a] if j >> a & 1 else 1 - t[:, a] for a in range(3)]
        values += np.prod(weights, axis=0) * model.oct_coeff[nodes, j]
    return values


@pytest.mark.parametrize("depth", [3, 5])
@pytest.mark.parametrize(
    "mesh",
    [
        fb.Mesh(*meshes.torus()),
        fb.models.gear(),
        fb.cone(1, 2).to_mesh(24),
        fb.Mesh(*meshes.hollow_sphere()),
        fb.Mesh(*meshes.box((0, 0, 0), (3, 2, 1))),
    ],
    ids=["torus", "gear", "cone", "hollow sphere", "box"],
)
def test_the_values_of_closed_meshes_are_those_of_mujoco(mesh, depth):
    model = model_of(mesh, depth)
    before = model.oct_coeff.copy()

    (field,) = fb.mujoco.refine(model)

    assert field.wrong_signs == 0
    assert field.largest_change <= FLOAT32_VERTICES * diagonal(model)
    assert np.abs(model.oct_coeff - before)[(model.oct_child < 0).all(axis=1)].max() == field.largest_change


def test_overlapping_boxes_get_the_signs_of_their_closed_form():
    model = model_of(overlapping_boxes(), depth=6)
    points, before = leaf_corners(model)
    exact = distance_to_boxes(points)
    certain = np.abs(exact) > FLOAT32_VERTICES * diagonal(model)
    outside = exact > 0

    (field,) = fb.mujoco.refine(model)

    after = leaf_corners(model)[1]
    assert field.wrong_signs > 50_000
    assert field.wrong_signs == ((before < 0) != (exact < 0))[certain].sum()
    assert ((after < 0) != (exact < 0))[certain].sum() == 0
    assert field.corners == after.size
    # Hanging corners have the mean of their neighbours, which differs from the distance.
    hanging = np.abs(after - exact) > FLOAT32_VERTICES * diagonal(model)
    assert (hanging & outside).mean() <= 0.2
    # Distances inside are depths in one of the boxes at least.
    assert (after <= exact + FLOAT32_VERTICES)[~outside & ~hanging].all()


@pytest.mark.parametrize(
    "mesh", [overlapping_boxes(), fb.models.torus_knot(segments=60, sides=12)], ids=["boxes", "knot"]
)
def test_the_field_is_continuous_across_leaves(mesh, random):
    model = model_of(mesh, depth=6)
    fb.mujoco.refine(model)
    # Points on the faces of random leaves, read from both sides.
    leaves = random.choice(np.flatnonzero((model.oct_child < 0).all(axis=1)), 20_000)
    axis, side = random.integers(0, 3, len(leaves)), random.choice((-1, 1), len(leaves))
    place = random.uniform(-1, 1, (len(leaves), 3))
    place[np.arange(len(leaves)), axis] = side
    boxes = model.oct_aabb[leaves]
    points = boxes[:, :3] + place * boxes[:, 3:]
    step = np.zeros_like(points)
    step[np.arange(len(leaves)), axis] = 1e-13 * diagonal(model)
    lower, upper = model.oct_aabb[0, :3] - model.oct_aabb[0, 3:], model.oct_aabb[0, :3] + model.oct_aabb[0, 3:]
    inner = ((points - step > lower) & (points + step < upper)).all(axis=1)
    points, step = points[inner], step[inner]

    jump = np.abs(read(model, points - step) - read(model, points + step))

    # The points are 2e-13 diagonals apart, and the slope of the field is at most 2.
    assert jump.max() <= 1e-12 * diagonal(model)
    assert len(points) > 15_000


def test_without_means_the_field_jumps():
    """The test of continuity fails for a tree whose hanging corners have distances of their own."""
    model = model_of(overlapping_boxes(), depth=6)
    tree = Octree.of_arrays(model.oct_aabb, model.oct_child)
    hanging = np.unique(np.concatenate([rows for rows, _ in tree.hanging]))
    mesh = fb.Mesh(*meshes.join(*(meshes.box(*corners) for corners in BOXES)))

    jumps = 0.0
    for rows, mean_rows in tree.hanging:
        points = tree.lower + tree.lattice * tree.step
        own = fb.query(mesh, points[rows] + model.mesh_pos[0]).distances
        mean = fb.query(mesh, points[mean_rows] + model.mesh_pos[0]).distances.mean(axis=1)
        jumps = max(jumps, np.abs(own - mean).max(initial=0))

    assert len(hanging) > 1_000
    assert jumps > 1e-3


def test_fields_are_in_the_coordinates_of_the_mesh_file():
    ball = fb.sphere(0.5).translate((3, -2, 1))
    mesh = ball.to_mesh(48)
    place = {"refpos": (1, 2, 3), "refquat": (0.5, 0.5, -0.5, 0.5)}
    model = model_of(fb.Mesh(mesh.vertices / 2, mesh.faces), scale=(2, 2, 2), **place)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, place["refquat"])
    moved = 2 * turn.reshape(3, 3).T @ (np.array((3, -2, 1)) / 2 - place["refpos"])

    (field,) = fb.mujoco.refine(model, {"mesh": fb.sphere(0.5).translate(moved)})

    # A flat face lies below the sphere by its sagitta, h^2 / 8r, with edges up to two voxels long.
    assert field.largest_change <= (2 * 1.1 / 48) ** 2 / (8 * 0.5) * 4
    points, values = leaf_corners(model)
    tree = Octree.of_arrays(model.oct_aabb, model.oct_child)
    free = ~np.isin(tree.rows[tree.leaves], np.concatenate([rows for rows, _ in tree.hanging]))
    exact = truth.sphere(points, 0.5, moved)
    assert np.abs(values - exact)[free].max() <= 1e-6  # the shape is evaluated in float32


def test_a_mesh_may_replace_another_one():
    model = model_of(fb.Mesh(*meshes.box((0, 0, 0), (1, 1, 1))))

    (field,) = fb.mujoco.refine(model, {"mesh": meshes.box((0.1, 0.1, 0.1), (0.9, 0.9, 0.9))})

    assert field.largest_change == pytest.approx(0.1 * np.sqrt(3), abs=1e-6)


def test_every_mesh_with_an_octree_has_a_row():
    spec = mujoco.MjSpec()
    for name in ("a", "b"):
        fb.mujoco.add(spec, fb.sphere(1), name=name, resolution=12, depth=2)
    ball = meshes.icosphere(1)
    spec.add_mesh(name="plain", uservert=ball[0].ravel(), userface=ball[1].ravel().astype(np.int32))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="plain")
    shares = []

    fields = fb.mujoco.refine(spec.compile(), progress=shares.append)

    assert [field.name for field in fields] == ["a", "b"]
    assert shares[-1] == 1.0
    assert shares == sorted(shares)


def test_mistakes_name_the_argument():
    model = model_of(fb.Mesh(*meshes.box()))

    with pytest.raises(fb.ArgumentError, match=r"model: must be a mujoco.MjModel, got 'robot.xml'"):
        fb.mujoco.refine("robot.xml")
    with pytest.raises(fb.ArgumentError, match=r"fields: 'nut' is no mesh with an octree; these are \['mesh'\]"):
        fb.mujoco.refine(model, {"nut": fb.sphere(1)})
    with pytest.raises(fb.MeshError):
        fb.mujoco.refine(model, {"mesh": 3})
    with pytest.warns(fb.SurfaceWarning, match="open"):
        fb.mujoco.refine(model, {"mesh": meshes.open_box()})


@pytest.mark.parametrize("damage", ["box", "nan", "deep"])
def test_another_layout_is_an_error(damage):
    model = model_of(fb.Mesh(*meshes.box()), depth=3)
    boxes, children = model.oct_aabb.copy(), model.oct_child.copy()
    if damage == "box":
        boxes[5, 0] += 0.4 * boxes[0, 3] / 2**15
    elif damage == "nan":
        boxes[5, 1] = np.nan
    else:
        boxes[-1, 3:] = boxes[0, 3:] / 2**17

    with pytest.raises(fb.Error, match="another layout"):
        Octree.of_arrays(boxes, children)
