"""Every mistake with clouds of points ends in an error that names the argument, at once."""

import numpy as np
import pytest

import fieldbake as fb
import meshes

NINE = np.random.default_rng(0).normal(size=(9, 3))
CLOUD = fb.PointCloud(NINE, NINE)


@pytest.mark.parametrize(
    ("error", "message", "arguments"),
    [
        (fb.MeshError, "points: the cloud is empty", ([],)),
        (fb.MeshError, "points: the cloud is empty", (np.empty((0, 3)), np.empty((0, 3)))),
        (fb.MeshError, "points: 1 distinct points are too few for areas, at least 9 are needed", (np.ones((20, 3)),)),
        (fb.MeshError, "points: 8 distinct points are too few", (NINE[:8],)),
        (fb.MeshError, "points: span 1e-33, less than", (NINE / np.ptp(NINE, axis=0).max() * 1e-33,)),
        (fb.ArgumentError, r"points\[2\]: must be finite", ([(0, 0, 0), (1, 0, 0), (0, np.nan, 0)],)),
        (fb.ArgumentError, r"points\[1\]: must be finite", ([(0, 0, 0), (np.inf, 0, 0)],)),
        (fb.ArgumentError, "points: must hold real numbers", (NINE + 1j,)),
        (fb.ArgumentError, r"points: must have shape \(n, 3\)", (NINE[:, :2],)),
        (fb.ArgumentError, r"points: must have shape \(n, 3\)", (NINE[None],)),
        (fb.ArgumentError, r"normals: must have shape \(9, 3\), one row for each point", (NINE, NINE[:5])),
        (fb.ArgumentError, r"normals\[4\]: must not be zero", (NINE, np.arange(9)[:, None] != [[4, 4, 4]])),
        (fb.ArgumentError, r"normals\[0\]: must be finite", (NINE, np.full((9, 3), np.nan))),
        (fb.ArgumentError, r"areas\[0\]: must be finite and not negative", (NINE, NINE, -1.0)),
        (fb.ArgumentError, r"areas\[3\]: must be finite and not negative", (NINE, NINE, [1, 1, 1, np.nan, *[1] * 5])),
        (fb.ArgumentError, "areas: must be a number or have shape", (NINE, NINE, [1, 2])),
    ],
)
def test_wrong_arrays_are_named(error, message, arguments):
    arguments = [a.astype(float) if isinstance(a, np.ndarray) and a.dtype == bool else a for a in arguments]
    with pytest.raises(error, match=message):
        fb.PointCloud(*arguments)


@pytest.mark.parametrize(
    "call",
    [
        lambda cloud: fb.contains(cloud, [(0, 0, 0)]),
        lambda cloud: fb.signed_distance(cloud, [(0, 0, 0)]),
        lambda cloud: fb.query(cloud, [(0, 0, 0)]),
        lambda cloud: fb.bake(cloud, 8),
        lambda cloud: fb.bake_sparse(cloud, 8),
    ],
)
@pytest.mark.parametrize(
    ("cloud", "message"),
    [
        (fb.PointCloud(NINE), r"no normals, so no inside; cloud.oriented\(\) computes them"),
        (fb.PointCloud(NINE, NINE, areas=0), "no areas, so no inside; areas=None computes them"),
    ],
)
def test_a_side_needs_normals_and_areas(call, cloud, message):
    with pytest.raises(fb.MeshError, match=f'{message}, or use sign="unsigned"$'):
        call(cloud)
    # These two have no option `sign`.
    for call in (lambda: fb.winding_number(cloud, [(0, 0, 0)]), lambda: fb.solid(cloud, 8)):
        with pytest.raises(fb.MeshError, match=f"{message}$"):
            call()


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ('sign: must be "auto", "winding" or "unsigned"', lambda: fb.contains(CLOUD, NINE, sign="parity")),
        ('sign: must be "auto", "winding" or "unsigned"', lambda: fb.bake(CLOUD, 8, sign="pseudonormal")),
        ("device: clouds of points are evaluated on the CPU", lambda: fb.query(CLOUD, NINE, device="gpu")),
        ("band: does not apply to a cloud", lambda: fb.bake(CLOUD, 8, band=3)),
        ("two_sided: does not apply to a cloud", lambda: fb.bake(CLOUD, 8, two_sided=True)),
        ("thickness: does not apply to a cloud", lambda: fb.bake_sparse(CLOUD, 8, thickness=1.0)),
        ("seal: does not apply to a cloud", lambda: fb.solid(CLOUD, 8, seal=2)),
        ("fill: does not apply to a cloud", lambda: fb.solid(CLOUD, 8, fill="outer")),
        ("error: must be a finite number above 0", lambda: fb.winding_number(CLOUD, NINE, error=0)),
        (r"points\[0\]", lambda: fb.query(CLOUD, [(np.nan, 0, 0)])),
        (r"points\[0\].*too far", lambda: fb.query(CLOUD, [(1e30, 0, 0)])),
        ('dtype: must be one of "float32"', lambda: fb.signed_distance(CLOUD, NINE, dtype="half")),
    ],
)
def test_wrong_options_are_named(message, call):
    with pytest.raises(fb.ArgumentError, match=message):
        call()


@pytest.mark.parametrize(
    "call",
    [
        lambda cloud: fb.as_mesh(cloud),
        lambda cloud: fb.cast_rays(cloud, [(0, 0, 0)], [(0, 0, 1)]),
        lambda cloud: fb.boolean("union", cloud, meshes.tetrahedron()),
        lambda cloud: fb.thickness(cloud, [(0, 0, 0)]),
        lambda cloud: fb.sample_surface(cloud, 10),
        lambda cloud: fb.offset(cloud, 0.1),
        lambda cloud: fb.bake([cloud, meshes.tetrahedron()], 8),
    ],
)
def test_other_functions_name_the_solid(call):
    with pytest.raises(fb.MeshError, match=r"a cloud of points, which has no triangles; use fb.solid\(cloud\) first"):
        call(CLOUD)


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_three_equal_points_and_one_plane_have_results():
    same = fb.PointCloud(np.ones((3, 3)), [(0, 0, 1)] * 3, areas=1.0)
    assert fb.closest_point(same, [(1, 1, 3)]).distances.tolist() == [2.0]
    assert fb.winding_number(same, [(1, 1, 0)], error=1e-9)[0] == pytest.approx(3 / (4 * np.pi))
    assert np.isfinite(fb.query(same, [(1, 1, 1), (5, 0, 0)]).gradients).all()
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)), axis=-1).reshape(-1, 2)
    plane = fb.PointCloud(np.column_stack([grid, np.zeros(400)]), [(0, 0, 1)] * 400)
    assert not fb.contains(plane, [(0.5, 0.5, 0.5), (0.5, 0.5, -5.0)]).any()
    assert np.isfinite(fb.bake(plane, 8).distances).all()
