"""Derivatives of poses and distances by PyTorch and JAX."""

import importlib

import numpy as np
import pytest

import fieldbake as fb
import robots


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return fb.Assembly.from_urdf(robots.write(tmp_path_factory.mktemp("robots"))["arm"])


@pytest.fixture(scope="module")
def jax():
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    jax.config.update("jax_enable_x64", True)
    return jax


@pytest.fixture
def inputs(arm, random):
    values = random.uniform(-1, 1, (3, 8))
    return values, random.uniform((-0.6, -0.6, 0), (0.6, 0.6, 1.2), (5, 3))


def differences(function, values, step=1e-6):
    """Central differences of a number by an array."""
    result = np.zeros_like(values)
    for place in np.ndindex(values.shape):
        low, high = values.copy(), values.copy()
        low[place] -= step
        high[place] += step
        result[place] = (function(high) - function(low)) / (2 * step)
    return result


def test_jax_has_the_derivatives_by_values_and_points(jax, arm, inputs):
    from fieldbake.jax import assembly_distance, assembly_poses

    values, points = inputs
    weights = np.linspace(0.5, 1.5, 15).reshape(3, 5)

    def loss(values, points):
        return (weights * assembly_distance(arm, assembly_poses(arm, values), points)).sum()

    of_values, of_points = jax.jit(jax.grad(loss, argnums=(0, 1)))(values, points)
    poses = assembly_poses(arm, jax.numpy.asarray(values))
    assert np.abs(np.asarray(poses) - arm.poses(values)).max() <= 1e-14
    assert of_values.dtype == np.float64

    def plain(values, points):
        return float((weights * arm.distance(points, arm.poses(values))).sum())

    # Central differences: step^2 times the third derivative, and the rounding of a sum of 15 over the step.
    assert np.abs(of_values - differences(lambda v: plain(v, points), values)).max() <= 1e-7
    assert np.abs(of_points - differences(lambda p: plain(values, p), points)).max() <= 1e-7


def test_jax_takes_one_configuration_and_float32(jax, arm, inputs):
    from fieldbake.jax import assembly_distance, assembly_poses

    values, points = inputs
    poses = assembly_poses(arm, jax.numpy.asarray(values[0], dtype=np.float32))

    found = assembly_distance(arm, poses, jax.numpy.asarray(points, dtype=np.float32))

    assert found.shape == (5,)
    assert found.dtype == np.float32
    assert np.abs(np.asarray(found) - arm.distance(points, arm.poses(values[0]))).max() <= 1e-5
    gradient = jax.grad(lambda poses: assembly_distance(arm, poses, points.astype(np.float32)).sum())(poses)
    assert gradient.shape == (11, 4, 4)
    assert (np.asarray(gradient)[:, 3] == 0).all()
    with pytest.raises(fb.ArgumentError, match=r"values: must have shape \(..., 8\), got \(2,\)"):
        assembly_poses(arm, np.zeros(2))


@pytest.fixture
def apart(arm):
    """Two configurations, and three pairs that are apart by one pair of nearest points."""
    values = np.array([[0.3, -0.4, 0.5, -1.2, 0.3, 0.9, 0.2, 0.03], [-0.5, 0.2, -0.3, -0.7, 0.6, 0.5, -0.4, 0.01]])
    pairs = [("link0", "hand"), ("link1", "link5"), ("link2", "link7")]
    assert (arm.clearance(arm.poses(values), pairs=pairs).distances > 0.01).all()
    return values, pairs


def test_jax_has_the_derivatives_of_clearances(jax, arm, apart):
    from fieldbake.jax import assembly_clearance, assembly_poses

    values, pairs = apart
    weights = np.linspace(0.5, 1.5, 6).reshape(2, 3)

    def loss(values):
        return (weights * assembly_clearance(arm, assembly_poses(arm, values), pairs)).sum()

    def plain(values):
        return float((weights * arm.clearance(arm.poses(values), pairs=pairs).distances).sum())

    # Central differences: step^2 times the third derivative, and the rounding of a sum of 6 over the step.
    assert np.abs(jax.jit(jax.grad(loss))(values) - differences(plain, values)).max() <= 1e-7
    one = assembly_clearance(arm, jax.numpy.asarray(arm.poses(values[0]), dtype=np.float32))
    assert (one.shape, one.dtype) == ((len(arm.pairs),), np.float32)
    assert np.abs(np.asarray(one) - arm.clearance(arm.poses(values[0])).distances).max() <= 1e-5
    gradient = jax.grad(lambda poses: assembly_clearance(arm, poses, []).sum())(arm.poses(values))
    assert (gradient == 0).all()
    with pytest.raises(fb.ArgumentError, match=r"pairs\[0\]: 'none' is no body"):
        assembly_clearance(arm, arm.home, [("none", "hand")])


def test_the_derivative_of_a_clearance_by_a_pose_is_that_of_a_moved_body():
    from fieldbake.assemblies.derivatives import linearize_clearance

    robot = fb.Assembly({"box": fb.box((1, 2, 3)), "ball": fb.sphere(0.5), "none": ()})
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1, :3, 3] = 1.5, 2, 2.5
    distances, slopes = linearize_clearance(robot, poses, [(0, 1), (1, 2)])

    # The nearest points are the corner and the point of the ball towards its centre.
    normal = -np.ones(3) / np.sqrt(3)
    assert distances == pytest.approx([np.sqrt(3) - 0.5, np.inf])
    assert slopes[0, 0] == pytest.approx(np.outer(normal, (0.5, 1, 1.5, 1)))
    assert slopes[0, 1] == pytest.approx(-np.outer(normal, (*(0.5 * normal), 1)))
    assert (slopes[1] == 0).all()


def test_torch_has_the_derivatives_of_clearances(arm, apart):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    functions = importlib.import_module("fieldbake.torch")
    values, pairs = apart

    def loss(values):
        return functions.assembly_clearance(arm, functions.assembly_poses(arm, values), pairs)

    assert torch.autograd.gradcheck(loss, torch.tensor(values, requires_grad=True), eps=1e-6, atol=1e-6)
    one = functions.assembly_clearance(arm, arm.home.astype(np.float32))
    assert (one.shape, one.dtype) == ((len(arm.pairs),), torch.float32)
    none = functions.assembly_clearance(arm, functions.assembly_poses(arm, torch.zeros(2, 8, requires_grad=True)), [])
    none.sum().backward()


def test_the_derivative_by_a_pose_is_that_of_a_moved_body():
    from fieldbake.assemblies.derivatives import linearize_assembly, pose_changes

    robot = fb.Assembly({"box": fb.box((1, 2, 3)), "ball": fb.sphere(0.5).translate((4, 0, 0)), "none": ()})
    points = np.array([[1.5, 0.2, 0.1], [3.0, 0.1, 0.3], [0.1, 1.7, 1.8]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    found = linearize_assembly(robot, poses, points)

    of_poses, of_points = pose_changes(found, np.ones(3))

    # Rigid motions of each body about each axis, as directions in the space of poses.
    step = 1e-6
    for body in range(3):
        for axis in range(3):
            spin = np.zeros((4, 4))
            spin[(axis + 1) % 3, (axis + 2) % 3], spin[(axis + 2) % 3, (axis + 1) % 3] = -1, 1
            slide = np.zeros((4, 4))
            slide[axis, 3] = 1
            for direction in (spin, slide):
                sides = []
                for sign in (-1, 1):
                    moved = poses.copy()
                    moved[body] += sign * step * direction
                    sides.append(robot.distance(points, moved).sum())
                assert (of_poses[body] * direction).sum() == pytest.approx((sides[1] - sides[0]) / (2 * step), abs=1e-7)
    assert of_points == pytest.approx(found.gradients)


def test_torch_has_the_derivatives_by_values_and_points(arm, inputs):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    functions = importlib.import_module("fieldbake.torch")
    values, points = (torch.tensor(array, requires_grad=True) for array in inputs)

    def loss(values, points):
        return functions.assembly_distance(arm, functions.assembly_poses(arm, values), points)

    assert np.abs(functions.assembly_poses(arm, values).detach().numpy() - arm.poses(inputs[0])).max() <= 1e-14
    assert torch.autograd.gradcheck(loss, (values, points), eps=1e-6, atol=1e-6)
    one = functions.assembly_distance(arm, functions.assembly_poses(arm, values[0]).float(), points.float())
    assert one.dtype == torch.float32
    assert one.shape == (5,)
