"""Distances and samples that JAX and PyTorch differentiate, against central differences in float64."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import fieldbake as fb
import meshes

#: A step of central differences: rounding 1e-16 / 1e-6 and curvature 1e-12 / d^2 are both small beside the tolerance.
STEP = 1e-6
TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def jax():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    return jax


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


def smooth_points(geometry, count):
    """Points whose nearest face stays the same nearby: closest points inside faces, off the medial axis."""
    points = meshes.points_around(geometry, 20 * count)
    found = fb.query(geometry, points)
    # Neighbours along the axes must have the same face.
    steady = found.barycentric.min(axis=1) > 1e-2
    for axis in np.eye(3):
        for sign in (1, -1):
            steady &= fb.query(geometry, points + sign * 1e-3 * axis).faces == found.faces
    return points[steady][:count]


def differences(function, value):
    """Central differences of a scalar function by every entry of an array."""
    found = np.empty_like(value)
    for place in np.ndindex(value.shape):
        up, down = value.copy(), value.copy()
        up[place] += STEP
        down[place] -= STEP
        found[place] = (function(up) - function(down)) / (2 * STEP)
    return found


def test_jax_derivatives_are_those_of_differences(jax):
    from fieldbake.jax import signed_distance

    geometry = meshes.icosphere(1)
    points = smooth_points(geometry, 20)
    weights = np.linspace(0.5, 1.5, len(points))

    def total(vertices, points):
        return float((weights * fb.query((vertices, geometry.faces), points).distances).sum())

    def of_jax(vertices, points):
        return (weights * signed_distance(vertices, geometry.faces, points)).sum()

    value, (of_vertices, of_points) = jax.value_and_grad(of_jax, (0, 1))(geometry.vertices, points)

    assert value == pytest.approx(total(geometry.vertices, points), rel=1e-14)
    expected = differences(lambda x: total(x, points), geometry.vertices)
    assert np.abs(of_vertices - expected).max() <= TOLERANCE
    assert np.abs(of_points - differences(lambda x: total(geometry.vertices, x), points)).max() <= TOLERANCE


def test_jax_checks_its_gradients(jax):
    from jax.test_util import check_grads

    from fieldbake.jax import sample, signed_distance

    geometry = meshes.icosphere(1)
    points = smooth_points(geometry, 10)
    check_grads(
        lambda v, p: signed_distance(v, geometry.faces, p), (geometry.vertices, points), 1, modes=["rev"], atol=1e-6
    )
    random = np.random.default_rng(4)
    distances = random.uniform(size=(4, 5, 3))
    bounds = np.array([(-1, -1, -1), (1, 2, 1.5)])
    inside = random.uniform((-0.7, -0.65, -0.5), (0.7, 1.6, 1.0), (20, 3))
    check_grads(sample, (distances, bounds, inside), 1, modes=["rev"], atol=1e-6)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_jax_keeps_the_type_and_compiles(jax, kind):
    from fieldbake.jax import signed_distance

    mesh = fb.Mesh(*meshes.knot(48, 8))
    points = meshes.points_around(meshes.Geometry(mesh.vertices, mesh.faces), 60).reshape(3, 20, 3).astype(kind)

    plain = signed_distance(mesh.vertices.astype(kind), mesh.faces, points, mesh)
    compiled = jax.jit(lambda p: signed_distance(mesh.vertices.astype(kind), mesh.faces, p, mesh))(points)
    mapped = jax.vmap(lambda p: signed_distance(mesh.vertices.astype(kind), mesh.faces, p, mesh))(points)

    assert plain.dtype == kind
    assert plain.shape == (3, 20)
    expected = fb.query(mesh, points).distances.astype(kind)
    for found in (plain, compiled, mapped):
        assert np.array_equal(np.asarray(found), expected)


def test_jax_samples_as_the_volume(jax):
    from fieldbake.jax import sample

    volume = fb.bake(meshes.knot(48, 8), (9, 8, 7))
    random = np.random.default_rng(2)
    low, high = volume.origin, volume.bounds[1] - volume.spacing / 2
    points = random.uniform(low, high, (500, 3))

    found = sample(volume.distances, volume.bounds, points)

    assert np.abs(np.asarray(found) - volume.sample(points)).max() <= 1e-6 * np.abs(volume.distances).max()


def test_jax_fits_a_sphere(jax):
    from fieldbake.jax import signed_distance

    numbers = jax.numpy
    vertices, faces = meshes.icosphere(2, 0.7)
    random = np.random.default_rng(1)
    points = random.uniform(-1.5, 1.5, (400, 3))
    target = np.linalg.norm(points, axis=1) - 1

    def loss(vertices):
        return numbers.mean((signed_distance(vertices, faces, points) - target) ** 2)

    first = float(loss(vertices))
    step = jax.value_and_grad(loss)
    for _ in range(60):
        value, slope = step(vertices)
        vertices = np.asarray(vertices - 20 * slope)
    assert float(value) < 0.02 * first
    assert np.linalg.norm(vertices, axis=1).mean() == pytest.approx(1, abs=0.05)


def test_a_mesh_that_does_not_belong_is_refused():
    from fieldbake.queries.derivatives import linearize

    vertices, faces = meshes.box()
    with pytest.raises(fb.ArgumentError, match="mesh"):
        linearize(vertices, faces, np.zeros((1, 3)), meshes.box())
    with pytest.raises(fb.ArgumentError, match="mesh"):
        linearize(vertices, faces[:2], np.full((40, 3), 0.9), fb.Mesh(*meshes.icosphere(3)))


def test_a_mesh_of_other_vertices_is_refused():
    from fieldbake.queries.derivatives import linearize

    mesh = fb.Mesh(*meshes.icosphere(1))
    points = np.full((1, 3), 2.0)
    single = mesh.vertices.astype(np.float32)
    assert linearize(single, mesh.faces, points, mesh).distances == fb.query(mesh, points).distances
    for vertices, faces in ((2 * mesh.vertices, mesh.faces), (mesh.vertices, mesh.faces[:-1]),
                            (mesh.vertices[:-1], mesh.faces), (mesh.vertices, mesh.faces[::-1])):  # fmt: skip
        with pytest.raises(fb.ArgumentError, match="mesh: its 42 vertices and 80 faces differ from vertices of shape"):
            linearize(vertices, faces, points, mesh)


def test_integer_points_have_distances_in_float64():
    from fieldbake.queries.derivatives import linearize

    found = linearize(*meshes.icosphere(1), np.array([(1, 2, 0)]), None)

    assert found.distances.dtype == found.gradients.dtype == found.weights.dtype == np.float64
    assert found.distances == fb.query(meshes.icosphere(1), [(1, 2, 0)]).distances


def test_jax_converts_integers_and_bfloat16(jax):
    from fieldbake.jax import assembly_distance, sample, signed_distance

    numbers = jax.numpy
    geometry = meshes.icosphere(1)
    exact = fb.query(geometry, [(1, 2, 0)]).distances

    assert signed_distance(*geometry, [(1, 2, 0)]).tolist() == exact.tolist()
    rounded = signed_distance(*geometry, numbers.array([(1, 2, 0)], numbers.bfloat16))
    assert (rounded.dtype, rounded.tolist()) == (np.float32, exact.astype(np.float32).tolist())
    slope = jax.grad(lambda points: signed_distance(*geometry, points))(numbers.array([1, 2, 0], numbers.bfloat16))
    assert slope.dtype == numbers.bfloat16
    ball = fb.Assembly({"ball": fb.sphere(1)})
    # Distances of 2 + rounding of the square root.
    assert abs(assembly_distance(ball, np.eye(4, dtype=int)[None], [(0, 0, 3)])[0] - 2) <= 1e-15
    corners = sample(np.arange(8).reshape(2, 2, 2), [(0, 0, 0), (2, 2, 2)], [(1, 1, 1)])
    assert corners.tolist() == [3.5]


@pytest.mark.parametrize("wrap", ["plain", "grad", "jit"])
def test_jax_raises_the_errors_of_the_package(jax, wrap, capfd):
    from fieldbake.jax import assembly_distance, sample, signed_distance

    vertices, faces = meshes.box()
    points = np.zeros((1, 3))
    wrapped = {"plain": lambda f: f, "grad": jax.grad, "jit": jax.jit}[wrap]

    def refused(function, value, error, text):
        with pytest.raises(error, match=text):
            wrapped(lambda value: function(value).sum())(value)

    refused(lambda p: signed_distance(vertices, faces, p), points[:, :2], fb.ArgumentError,
            r"points: must have shape \(..., 3\), got \(1, 2\)")  # fmt: skip
    refused(lambda p: signed_distance(vertices, faces * 1.0, p), points, fb.MeshError,
            "faces: must be whole numbers, got dtype float64")  # fmt: skip
    refused(lambda p: signed_distance(p, faces, points), vertices[:, 0], fb.MeshError,
            r"vertices: must have shape \(n, 3\), got \(8,\)")  # fmt: skip
    refused(lambda b: sample(np.zeros((2, 2, 2)), b, points), np.ones(3), fb.ArgumentError,
            r"bounds: must have shape \(2, 3\), got \(3,\)")  # fmt: skip
    refused(lambda p: assembly_distance(fb.Assembly({"ball": fb.sphere(1)}), p, points), np.eye(4), fb.ArgumentError,
            r"poses: must have shape \(..., n, 4, 4\), got \(4, 4\)")  # fmt: skip
    if wrap != "jit":
        refused(lambda p: signed_distance(vertices, faces, p), np.nan * points, fb.ArgumentError, r"points\[0\]: must")
        refused(lambda p: signed_distance(vertices, faces + 9, p), points, fb.MeshError, "the mesh has 8 vertices")
    assert "Traceback" not in capfd.readouterr().err


def test_derivatives_are_exact_where_faces_were_dropped():
    from fieldbake.queries.derivatives import linearize

    vertices, faces = meshes.box()
    padded = np.concatenate([[[0, 0, 1], [3, 3, 3]], faces])

    found = linearize(vertices, padded, np.array([(0.2, 0.3, 2.0)]), None)

    corners = vertices[found.corners[0]]
    assert (corners[:, 2] == 1).all()
    assert found.weights[0] @ corners == pytest.approx([0.2, 0.3, 1])
    # A mesh may come with the faces of the input or with its own.
    mesh = fb.Mesh(vertices, padded)
    for rows in (padded, mesh.faces):
        again = linearize(vertices, rows, np.array([(0.2, 0.3, 2.0)]), mesh)
        assert np.array_equal(again.corners, found.corners)


@pytest.mark.slow
def test_torch_checks_its_gradients(torch):
    from fieldbake.torch import sample, signed_distance

    geometry = meshes.icosphere(1)
    points = torch.tensor(smooth_points(geometry, 10), requires_grad=True)
    vertices = torch.tensor(geometry.vertices, requires_grad=True)
    faces = torch.tensor(geometry.faces)
    assert torch.autograd.gradcheck(lambda v, p: signed_distance(v, faces, p), (vertices, points))
    random = np.random.default_rng(4)
    grid = torch.tensor(random.uniform(size=(4, 5, 3)), requires_grad=True)
    bounds = torch.tensor([(-1, -1, -1), (1, 2, 1.5)], dtype=torch.float64, requires_grad=True)
    inside = torch.tensor(random.uniform((-0.7, -0.65, -0.5), (0.7, 1.6, 1.0), (20, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(sample, (grid, bounds, inside))


@pytest.mark.slow
@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_torch_loads_samples_of_meshes_in_workers(torch, start):
    from datasets import TrainingSets

    dataset = TrainingSets([fb.Mesh(*meshes.icosphere(2)), fb.Mesh(*meshes.knot(48, 8))], 500)
    loader = torch.utils.data.DataLoader(dataset, batch_size=1, num_workers=2, multiprocessing_context=start)

    for i, (points, distances) in enumerate(loader):
        assert points.shape == (1, 500, 3)
        expected = fb.signed_distance(dataset.meshes[i], points[0].numpy())
        # The points were rounded to float32 after their distances were found.
        assert np.abs(distances[0].numpy() - expected).max() <= 1e-6 * np.abs(points[0].numpy()).max()


@pytest.mark.slow
def test_torch_keeps_the_type(torch):
    from fieldbake.torch import signed_distance

    vertices, faces = (torch.tensor(array) for array in meshes.box())
    for kind in (torch.float32, torch.float64):
        found = signed_distance(vertices.to(kind), faces, torch.zeros((2, 3), dtype=kind))
        assert found.dtype == kind
        assert found.tolist() == [-1, -1]


def test_the_modules_wait_until_they_are_used():
    script = """
import sys
import fieldbake as fb
assert "torch" not in sys.modules and "jax" not in sys.modules
names = ["assembly_clearance", "assembly_distance", "assembly_poses", "sample", "signed_distance"]
assert dir(fb.jax) == fb.jax.__all__ == names == dir(fb.torch)
assert "torch" not in sys.modules and "jax" not in sys.modules
assert {"jax", "torch"} <= set(dir(fb))
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_without_the_library_the_error_says_what_to_install():
    script = """
import sys
sys.modules["torch"] = sys.modules["jax"] = None
import fieldbake as fb
for module in (fb.torch, fb.jax):
    try:
        module.sample([[[0.0]]], [[0, 0, 0], [1, 1, 1]], [0, 0, 0])
    except fb.Error as error:
        assert "pip install" in str(error), error
    else:
        raise AssertionError
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_the_example_fits(jax, tmp_path):
    import importlib.util
    from pathlib import Path

    path = Path(__file__).parents[2] / "examples" / "fit_mesh_to_samples.py"
    spec = importlib.util.spec_from_file_location("fit_mesh_to_samples", path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)

    mesh, losses = example.fit(steps=25, count=200)

    assert losses[-1] < 0.2 * losses[0]
    assert mesh.is_closed
    example.draw(mesh, losses, tmp_path / "fit.png", size=64)
    pixels = np.asarray(Image.open(tmp_path / "fit.png").convert("L"), dtype=int)
    # Each quarter of the width has a body or a curve: dark pixels on a white background.
    assert all((part < 160).sum() > 50 for part in np.array_split(pixels, 4, axis=1))
