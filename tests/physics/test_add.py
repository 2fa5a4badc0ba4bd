"""`fieldbake.mujoco.add`: meshes for which MuJoCo's own rule is right, and the place and mass of their geoms."""

import subprocess
import sys

import numpy as np
import pytest

import fieldbake as fb
import meshes
from fieldbake.physics.closing import has_one_side
from octrees import BOXES, distance_to_boxes, leaf_corners, overlapping_boxes

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")


def test_overlapping_boxes_have_the_right_side_without_a_fill():
    spec = mujoco.MjSpec()
    fb.mujoco.add(spec, overlapping_boxes(), name="boxes", resolution=64)
    model = spec.compile()
    voxel = 2.2 / 64

    points, values = leaf_corners(model)
    exact = distance_to_boxes(points)
    wrong = ((values < 0) != (exact < 0)) & (np.abs(exact) > voxel)

    assert wrong.mean() <= 1e-4
    fb.mujoco.refine(model)
    values = leaf_corners(model)[1]
    assert (((values < 0) != (exact < 0)) & (np.abs(exact) > voxel)).sum() == 0


@pytest.mark.parametrize(
    ("geometry", "has"),
    [
        (meshes.box(), True),
        (meshes.split_vertices(meshes.box()), True),
        (meshes.hollow_sphere(), True),
        (meshes.join(meshes.box(), meshes.box((2, 2, 2), (3, 3, 3))), True),
        (meshes.open_box(), False),
        (meshes.flip(meshes.box()), False),
        (meshes.flip_some(meshes.icosphere(2), 0.2), False),
        (meshes.doubled(meshes.box()), False),
        (meshes.nested_shells(), False),
        (meshes.join(*(meshes.box(*corners) for corners in BOXES)), False),
    ],
    ids=["box", "soup", "hollow", "two", "open", "inside out", "flipped", "doubled", "nested", "overlapping"],
)
def test_only_meshes_with_one_side_keep_their_triangles(geometry, has):
    mesh = fb.Mesh(*geometry)
    spec = mujoco.MjSpec()

    fb.mujoco.add(spec, mesh, name="part", resolution=24)

    assert has_one_side(mesh) == has
    assert (len(spec.mesh("part").userface) == 3 * len(mesh.faces)) == has


def test_the_geom_has_its_place_its_body_and_its_mass():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="arm", pos=(5, 0, 0)).add_freejoint()
    place = np.eye(4)
    place[:3, :3] = meshes.rotation(3)
    place[:3, 3] = 1, 2, 3
    frame = fb.box((2, 1, 1)) - fb.box((1, 0.5, 2))

    geom = fb.mujoco.add(
        spec, frame, name="frame", body="arm", transform=place, resolution=64, density=10.0, rgba=(1, 0, 0, 1)
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    assert geom.rgba.tolist() == [1, 0, 0, 1]
    assert model.geom("frame").type[0] == mujoco.mjtGeom.mjGEOM_SDF
    assert data.body("arm").xipos == pytest.approx((6, 2, 3), abs=1e-4)
    # A convex hull would have the volume 2.
    assert model.body("arm").mass[0] == pytest.approx(10 * 1.5, rel=1e-3)
    corners = model.mesh_vert @ data.geom("frame").xmat.reshape(3, 3).T + data.geom("frame").xpos
    local = (corners - (6, 2, 3)) @ place[:3, :3]
    assert local.max(axis=0) == pytest.approx((1, 0.5, 0.5), abs=1e-3)


def test_depth_is_that_of_the_smallest_leaves():
    for depth in (2, 4):
        spec = mujoco.MjSpec()
        fb.mujoco.add(spec, fb.models.gear(), name="gear", depth=depth)
        model = spec.compile()
        assert model.oct_aabb[0, 3] / model.oct_aabb[:, 3].min() == pytest.approx(2**depth)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spec": "robot.xml"}, "spec: must be a mujoco.MjSpec"),
        ({"name": ""}, "name: must not be empty"),
        ({"name": "taken"}, "name: the specification has a mesh or geom 'taken' already"),
        ({"body": "leg"}, r"body: the specification has no body 'leg'; it has \['world'\]"),
        ({"depth": 0}, "depth: must be from 1 to 12, got 0"),
        ({"depth": 2.0}, "depth: must be a whole number"),
        ({"resolution": (64, 64, 64)}, "resolution: must be a whole number"),
        ({"transform": np.diag([2.0, 2, 2, 1])}, "transform: must be a rotation and a translation"),
        ({"transform": np.diag([-1.0, 1, 1, 1])}, "transform: must be a rotation and a translation"),
        ({"transform": np.full((4, 4), np.nan)}, "transform: must be finite"),
        ({"pos": (1, 2, 3)}, r"pos: is set by name=, geometry and transform="),
        ({"colour": (1, 0, 0, 1)}, "colour: is no attribute of a geom"),
        ({"friction": "rough"}, r"geom: MuJoCo refuses the attributes \['friction'\]"),
    ],
)
def test_mistakes_name_the_argument_and_add_nothing(arguments, message):
    spec = mujoco.MjSpec()
    fb.mujoco.add(spec, fb.models.gear(), name="taken")
    call = {"spec": spec, "geometry": fb.models.gear(), "name": "gear", **arguments}

    with pytest.raises(fb.ArgumentError, match=message):
        fb.mujoco.add(**call)
    assert [mesh.name for mesh in spec.meshes] == ["taken"]
    assert len(spec.geoms) == 1


def test_geometry_without_a_surface_is_an_error():
    spec = mujoco.MjSpec()
    with pytest.raises(fb.MeshError, match="no surface at the resolution 8"):
        fb.mujoco.add(spec, fb.sphere(1) & fb.sphere(1).translate((1.99, 0, 0)), name="lens", resolution=8)
    with pytest.raises(fb.ShapeError):
        fb.mujoco.add(spec, fb.plane("z", 0), name="floor")
    with pytest.raises(fb.MeshError, match=r"^geometry: cannot make a mesh of 3"):
        fb.mujoco.add(spec, 3, name="three")
    with pytest.raises(fb.MeshError, match=r"^geometry: must be a mesh, got a Volume; volume.to_mesh\(\) makes a mesh"):
        fb.mujoco.add(spec, fb.bake(fb.box(1), 9), name="volume")


def test_without_mujoco_the_error_names_the_extra():
    script = """
import sys
sys.modules["mujoco"] = None
import fieldbake as fb
try:
    fb.mujoco.refine(None)
except fb.Error as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)

    assert "pip install 'fieldbake[mujoco]'" in done.stdout


def test_the_module_loads_mujoco_at_the_first_call():
    script = "import fieldbake as fb, sys; fb.mujoco; print('mujoco' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)

    assert done.stdout.strip() == "False"
