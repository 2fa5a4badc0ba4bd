"""Properties that hold for every mesh, tested by hypothesis with random triangles, points and invalid values.

`HYPOTHESIS_PROFILE=search pytest tests/baking/test_properties.py` runs more and other examples.
"""

import contextlib

import numpy as np
from hypothesis import assume, example, given, reject
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import fieldbake as fb
import meshes
import truth

coordinates = st.floats(-1, 1, width=32).map(lambda x: 0.0 if abs(x) < 1e-30 else x)


def positions(count):
    return hnp.arrays(np.float64, (count, 3), elements=coordinates)


@st.composite
def surfaces(draw, most=8):
    """A few triangles over a few shared vertices: touching, crossing, doubled, degenerate, anything."""
    vertices = draw(st.integers(3, 10).flatmap(positions))
    faces = draw(
        hnp.arrays(np.int64, st.tuples(st.integers(1, most), st.just(3)), elements=st.integers(0, len(vertices) - 1))
    )
    return meshes.Geometry(vertices, faces)


def as_mesh(geometry):
    """Make the mesh. An example without a surface raises an error, which another test covers, and is skipped."""
    try:
        return fb.Mesh(*geometry)
    except fb.MeshError:
        return reject()


def kept(mesh):
    """The triangles that the mesh kept. Triangles without area are dropped, which may change the nearest one."""
    return meshes.Geometry(mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64))


@given(surfaces(), positions(40))
def test_distances_equal_brute_force(geometry, points):
    mesh = as_mesh(geometry)

    found = fb.closest_point(mesh, 3 * points).distances

    # The kept vertices are float32 roundings of those given, of coordinates up to 1.
    exact = truth.closest_point(*kept(mesh), 3 * points).distances
    rounding = np.sqrt(3) * truth.FLOAT32_ROUNDING
    assert (np.abs(found - exact) <= truth.tolerance(*kept(mesh), exact) + rounding).all()


@given(surfaces(), positions(40), positions(40))
def test_the_distance_is_1_lipschitz(geometry, p, q):
    mesh = as_mesh(geometry)

    unsigned = [fb.signed_distance(mesh, x, sign="unsigned").astype(np.float64) for x in (p, q)]

    error = sum(truth.tolerance(*kept(mesh), d) for d in unsigned)
    assert (np.abs(unsigned[0] - unsigned[1]) <= np.linalg.norm(p - q, axis=1) + error).all()


@given(st.sampled_from(sorted(meshes.CLOSED)), positions(40), positions(40))
def test_the_signed_distance_of_a_solid_is_1_lipschitz(name, p, q):
    geometry = meshes.CLOSED[name]()

    # Overlapping and nested shells have surfaces inside the solid, where the signed distance is not the distance to
    # the solid's boundary, yet it stays continuous only where no sign changes: leave those out.
    assume(name not in ("overlapping_boxes", "nested_shells"))
    signed = [fb.signed_distance(geometry, 1.5 * x).astype(np.float64) for x in (p, q)]

    error = sum(truth.tolerance(*geometry, d) for d in signed)
    assert (np.abs(signed[0] - signed[1]) <= 1.5 * np.linalg.norm(p - q, axis=1) + error).all()


@given(surfaces(), positions(30), st.integers(0, 1_000), st.tuples(*[st.floats(-100, 100)] * 3))
def test_a_rigid_motion_changes_nothing_beyond_rounding(geometry, points, seed, shift):
    mesh = as_mesh(geometry)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = meshes.rotation(seed), shift
    moved = as_mesh(meshes.move(geometry, matrix))  # a sliver may lose its area to rounding
    assume(len(moved.faces) == len(mesh.faces))

    here = fb.closest_point(mesh, points).distances
    there = fb.closest_point(moved, points @ matrix[:3, :3].T + matrix[:3, 3]).distances

    # Float64 keeps positions near 200 to 2e-14; each field is exact within its own tolerance.
    tolerance = truth.tolerance(*kept(mesh), here) + truth.tolerance(*kept(mesh), there) + 1e-12
    rounding = 2 * np.sqrt(3) * truth.FLOAT32_ROUNDING
    assert (np.abs(here.astype(float) - there) <= tolerance + rounding).all()


@given(
    st.sampled_from(["icosphere", "torus", "knot", "hollow_sphere", "overlapping_boxes"]),
    st.integers(0, 1_000),
    st.floats(-3, 3),
    st.tuples(*[st.floats(-1e3, 1e3)] * 3),
)
def test_a_similarity_keeps_the_inside(name, seed, exponent, shift):
    geometry = meshes.CLOSED[name]()
    scale = 10.0**exponent
    points = meshes.points_around(geometry, 200, seed)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * meshes.rotation(seed), shift

    here = fb.signed_distance(geometry, points)
    there = fb.signed_distance(meshes.move(geometry, matrix), points @ matrix[:3, :3].T + matrix[:3, 3])

    # A point at 1e3 is rounded by 1e-13, which is worth more to a mesh of size 1e-3.
    tolerance = truth.tolerance(*geometry, here) + truth.tolerance(*geometry, there / scale) + 1e-12 / scale
    assert (np.abs(here.astype(float) - there / scale) <= tolerance).all()


@given(
    surfaces(), st.sampled_from(["auto", "winding", "parity", "pseudonormal", "normal", "unsigned"]), st.integers(1, 9)
)
def test_a_bake_is_never_undefined(geometry, sign, resolution):
    mesh = as_mesh(geometry)

    volume = fb.bake(mesh, resolution=resolution, sign=sign)

    assert np.isfinite(volume.distances).all()
    exact = truth.closest_point(
        *kept(mesh), truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    ).distances
    error = np.abs(np.abs(volume.distances.ravel()) - exact)
    assert (error <= truth.tolerance(*kept(mesh), exact) + np.sqrt(3) * truth.FLOAT32_ROUNDING).all()


@given(surfaces(), st.floats(0.5, 6))
def test_a_band_never_overestimates_and_keeps_the_sign(geometry, band):
    mesh = as_mesh(geometry)

    full, banded = fb.bake(mesh, resolution=10), fb.bake(mesh, resolution=10, band=band)

    tolerance = truth.tolerance(*kept(mesh), np.abs(full.distances))
    off_surface = np.abs(full.distances) > tolerance
    assert np.array_equal((banded.distances < 0)[off_surface], (full.distances < 0)[off_surface])
    assert (np.abs(banded.distances) <= np.abs(full.distances) + tolerance).all()


@given(st.sampled_from(["knot", "cube", "torus", "soup"]), positions(60))
def test_samples_never_exceed_the_distance_outside_the_box(name, points):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    volume = fb.bake(geometry, resolution=12)
    points = points * 30
    points = points[((points < volume.bounds[0]) | (points > volume.bounds[1])).any(axis=1)]
    assume(len(points))

    exact = truth.Reference(*geometry).distance(points)

    assert (volume.sample(points) <= exact + truth.tolerance(*geometry, exact)).all()


@given(
    hnp.arrays(np.float32, st.tuples(*[st.integers(1, 4)] * 3), elements=st.floats(-1e6, 1e6, width=32)), positions(20)
)
def test_samples_lie_between_the_stored_values(distances, points):
    volume = fb.Volume(distances, [(-1, -1, -1), (1, 1, 1)])

    found = volume.sample(points)

    rounding = 17 * truth.FLOAT32_ROUNDING * np.abs(distances).max()
    assert (found >= distances.min() - rounding).all()
    assert (found <= distances.max() + rounding).all()
    assert np.isfinite(volume.gradient(points)).all()


# --- garbage

numbers = st.one_of(
    st.floats(), st.integers(-(2**63), 2**63 - 1), st.booleans(), st.none(), st.text(max_size=3), st.complex_numbers()
)
arrays = st.one_of(
    hnp.arrays(
        st.one_of(
            hnp.boolean_dtypes(),
            hnp.integer_dtypes(),
            hnp.floating_dtypes(),
            hnp.complex_number_dtypes(),
            hnp.unicode_string_dtypes(),
        ),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    ),
    hnp.arrays(st.sampled_from([np.float64, np.float32]), st.tuples(st.integers(0, 5), st.just(3))),
    hnp.arrays(st.sampled_from([np.int64, np.uint8, np.int32]), st.tuples(st.integers(0, 5), st.just(3))),
    st.lists(st.lists(numbers, max_size=4), max_size=4),
    numbers,
)


@given(arrays, arrays)
@example(np.zeros((3, 3)), np.zeros((1, 3), np.int64))
@example(np.full((3, 3), np.nan), np.zeros((1, 3), np.int64))
@example(np.eye(3) * 1e308, np.array([[0, 1, 2]]))
@example(np.eye(3) * 5e-324, np.array([[0, 1, 2]]))
@example(np.eye(3), np.array([[0, 1, -(2**63)]]))
def test_garbage_meshes_are_refused_cleanly_or_baked(vertices, faces):
    try:
        volume = fb.bake((vertices, faces), resolution=3)
    except (fb.MeshError, fb.ArgumentError):
        return
    assert np.isfinite(volume.distances).all()


@given(arrays)
def test_garbage_points_are_refused_cleanly_or_measured(points):
    try:
        found = fb.signed_distance(meshes.tetrahedron(), points)
    except fb.ArgumentError:
        return
    assert not np.isnan(found).any()
    # An empty list is no points, not one point without coordinates.
    assert found.shape == (np.shape(points)[:-1] if np.shape(points) != (0,) else (0,))


@given(arrays)
def test_garbage_fields_are_refused_cleanly_or_kept(distances):
    try:
        volume = fb.Volume(distances, [(-1, -1, -1), (1, 1, 1)])
    except fb.ArgumentError:
        return
    assert np.isfinite(volume.sample([[0, 0, 0]])).all()


@given(st.sampled_from(["bounds", "margin", "band", "two_sided", "thickness", "progress"]), arrays)
def test_garbage_options_are_refused_cleanly(option, value):
    with contextlib.suppress(fb.ArgumentError, fb.CapacityError):
        fb.bake(meshes.tetrahedron(), 2, **{"two_sided": option == "thickness", option: value})


@given(st.binary(max_size=300), st.sampled_from(["npz", "obj", "ply", "stl", "off", "glb"]))
def test_garbage_files_are_refused_cleanly(tmp_path_factory, content, suffix):
    path = tmp_path_factory.mktemp("garbage") / f"x.{suffix}"
    path.write_bytes(content)
    with contextlib.suppress(fb.FormatError, fb.MeshError):
        fb.load(path) if suffix == "npz" else fb.load_mesh(path)
