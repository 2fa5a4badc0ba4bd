"""Level sets as closed meshes: topology, edges and corners, bounds, levels, every kind of field."""

import copy
import importlib.util
import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth
from manifold import faults

#: Corners and edges come back to this share of a voxel; the margin to the cell is a thousandth of a voxel, the pull to
#: the mean less than a hundredth.
SHARP = 0.02


def turned_box(turn=(1.0, 2.0, 3.0), degrees=40):
    return fb.box(2).rotate(turn, degrees)


def assert_solid(mesh, bounds=None):
    assert faults(mesh.vertices, mesh.faces) == []
    assert truth.volume(mesh.vertices, mesh.faces) > 0
    if bounds is not None:
        assert (mesh.vertices >= bounds[0]).all()
        assert (mesh.vertices <= bounds[1]).all()


def random_field(seed, shape=(9, 10, 11)):
    random = np.random.default_rng(seed)
    return fb.Volume(random.uniform(-1, 1, shape), [(0, 0, 0), (2, 3, 4)])


def assert_two_manifold_on_noise(seeds):
    for seed in seeds:
        volume = random_field(seed)
        for sharp in (True, False):
            mesh = volume.to_mesh(level=0.3 * np.sin(seed), sharp=sharp)
            assert faults(mesh.vertices, mesh.faces) == [], seed
            assert (mesh.vertices >= volume.bounds[0]).all()
            assert (mesh.vertices <= volume.bounds[1]).all()


def test_noise_gives_closed_two_manifolds():
    assert_two_manifold_on_noise(range(20))


@pytest.mark.slow
def test_a_thousand_fields_of_noise_give_closed_two_manifolds():
    assert_two_manifold_on_noise(range(1000))


@pytest.mark.parametrize("name", ["icosphere", "torus", "knot", "cube", "hollow_sphere"])
def test_the_surface_comes_back_closed_and_near(name):
    geometry = meshes.CLOSED[name]()
    volume = fb.bake(geometry, resolution=48)

    surface = volume.to_mesh()

    assert_solid(surface, volume.bounds)
    distances = np.abs(fb.signed_distance(geometry, surface.vertices)) / volume.spacing.max()

    assert distances.mean() <= 0.02
    assert distances.max() <= 0.5
    found, expected = truth.volume(surface.vertices, surface.faces), truth.volume(*geometry)
    assert found == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("resolution", [16, 33, 64])
def test_a_cube_keeps_corners_edges_and_faces(resolution):
    geometry = meshes.box()
    for mesh in (fb.bake(geometry, resolution), fb.bake(fb.box(2), resolution)):
        surface = mesh.to_mesh()
        assert_solid(surface, mesh.bounds)
        voxel = mesh.spacing.max()
        for corner in geometry[0]:
            assert np.linalg.norm(surface.vertices - corner, axis=1).min() <= SHARP * voxel
        # All vertices lie on the cube, so edges are straight and faces flat.
        assert np.abs(np.abs(surface.vertices).max(axis=1) - 1).max() <= SHARP * voxel


@pytest.mark.parametrize("resolution", [16, 33, 64])
def test_a_turned_cube_keeps_corners_edges_and_faces(resolution):
    matrix = turn_matrix((1.0, 2.0, 3.0), 40)
    geometry = meshes.box()
    from_mesh = fb.bake((geometry[0] @ matrix.T, geometry[1]), resolution)
    from_shape = fb.bake(turned_box(), resolution)
    fields = ((from_mesh, from_mesh.to_mesh()), (from_shape, from_shape.to_mesh()))
    for volume, mesh in fields:
        assert_solid(mesh, volume.bounds)
        voxel = volume.spacing.max()
        local = mesh.vertices @ matrix
        off = np.abs(np.abs(local).max(axis=1) - 1)
        assert off.max() <= SHARP * voxel
        for corner in geometry[0]:
            assert np.linalg.norm(local - corner, axis=1).min() <= SHARP * voxel


class Field:
    """A field and its gradient, evaluated in Python."""

    def __init__(self, shape):
        self.distance, self.gradient = shape.distance, shape.gradient


@pytest.mark.parametrize("resolution", [32, 64])
def test_the_rims_of_a_cut_cylinder_are_sharp(resolution):
    # The cut meets the side at angles from 70 to 110 degrees.
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    shape = fb.cylinder(1, 3) & fb.plane(normal.tolist(), -0.4)
    volume = fb.bake(shape, resolution)
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rims = np.concatenate(
        [
            np.column_stack([circle, (-0.4 - circle @ normal[:2]) / normal[2]]),
            np.column_stack([circle, np.full(400, -1.5)]),
        ]
    )
    voxel = volume.spacing.max()
    for mesh in (shape.to_mesh(resolution), volume.to_mesh(), volume.to_mesh(source=Field(shape))):
        assert_solid(mesh)
        radius, height = np.hypot(*mesh.vertices[:, :2].T), mesh.vertices[:, 2]
        off = np.max([radius - 1, np.abs(height) - 1.5, mesh.vertices @ normal + 0.4], axis=0)
        assert np.abs(off).max() <= SHARP * voxel
        # The edges of the mesh are chords of the rims.
        assert fb.closest_point(mesh, rims).distances.max() <= SHARP * voxel + voxel**2 / 8


@pytest.mark.parametrize(
    ("axis", "degrees", "resolution"),
    [((1, 2, 3), 10, 32), ((1, 2, 3), 10, 40), ((1, 2, 3), 40, 24), ((1, 2, 3), 40, 40), ((3, 1, 2), 12, 36)],
)
def test_straight_edges_of_a_curved_face_are_sharp_in_every_cell(axis, degrees, resolution):
    # Half of a cylinder. Its edges touch many cells only a little, and its normal turns by 3 to 5 degrees a voxel.
    count = 129
    angles = np.linspace(0, np.pi, count)
    arc = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    i, j = np.arange(count), np.roll(np.arange(count), -1)
    inner = np.arange(1, count - 1)
    sides = np.concatenate([np.column_stack((i, j, j + count)), np.column_stack((i, j + count, i + count))])
    lid = np.column_stack((0 * inner, inner + 1, inner))
    faces = np.concatenate([sides, lid, lid[:, ::-1] + count])
    matrix = turn_matrix(axis, degrees)
    vertices = np.concatenate([np.column_stack([arc, np.full(count, z)]) for z in (-1.0, 1.0)]) @ matrix.T
    volume = fb.bake((vertices, faces), resolution)
    mesh = volume.to_mesh()
    assert_solid(mesh, volume.bounds)
    voxel = volume.spacing.max()
    heights = np.linspace(1.25 * voxel - 1, 1 - 1.25 * voxel, 400)
    for x in (-1.0, 1.0):
        edge = np.column_stack([np.full(400, x), np.zeros(400), heights]) @ matrix.T
        assert fb.closest_point(mesh, edge).distances.max() <= SHARP / 2 * voxel


def test_vertices_lie_on_facets_smaller_than_a_voxel():
    # A prism with 48 sides; a side is 0.13 wide, and so is a voxel at this resolution.
    angles = 2 * np.pi * np.arange(48) / 48
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate([np.column_stack([rim, np.full(48, z)]) for z in (-1, 1)] + [[(0, 0, -1), (0, 0, 1)]])
    i, j = np.arange(48), np.roll(np.arange(48), -1)
    corners = ((i, j, j + 48), (i, j + 48, i + 48), (j, i, np.full(48, 96)), (i + 48, j + 48, np.full(48, 97)))
    faces = np.concatenate([np.column_stack(columns) for columns in corners])
    geometry = vertices @ turn_matrix((1.0, 2.0, 3.0), 40).T, faces
    volume = fb.bake(geometry, 24)
    mesh = volume.to_mesh()
    assert_solid(mesh, volume.bounds)
    off = np.abs(fb.signed_distance(geometry, mesh.vertices)) / volume.spacing.max()
    assert off.max() <= SHARP
    assert off.mean() <= SHARP / 20


def turn_matrix(axis, degrees):
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_without_a_source_the_surface_is_that_of_the_samples():
    volume = fb.bake(meshes.icosphere(4), 32)
    loaded = fb.Volume(volume.distances, volume.bounds)
    for mesh in (loaded.to_mesh(), loaded.to_mesh(sharp=False)):
        assert_solid(mesh, volume.bounds)
        # A sphere of radius 1: the trilinear surface is off by h^2 / 8 along each axis, the planes by as much again.
        error = np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1)
        assert error.max() <= 0.75 * volume.spacing.max() ** 2 + 2e-3
    # Smooth vertices lie on the trilinear surface itself.
    assert np.abs(loaded.sample(loaded.to_mesh(sharp=False).vertices)).max() <= 1e-4


def test_another_field_or_mesh_can_be_the_source():
    shape = turned_box()
    samples = fb.bake(shape, 24)
    loaded = fb.Volume(samples.distances, samples.bounds)
    blunt, sharp = loaded.to_mesh(), loaded.to_mesh(source=shape)
    # The mean distance from the surface of the shape, voxels.
    off = [np.abs(shape.distance(mesh.vertices)).mean() / samples.spacing.max() for mesh in (blunt, sharp)]
    assert off[1] <= SHARP / 4
    assert off[0] >= 2 * off[1]
    with pytest.raises(fb.MeshError):
        loaded.to_mesh(source=object())


def test_edges_that_the_source_does_not_cross_keep_the_planes_of_the_samples():
    volume = fb.bake(fb.sphere(1), 32)
    # Half of the radius, seven voxels, lies between the surface of the samples and the surface of the source.
    mesh = volume.to_mesh(source=fb.sphere(0.5))
    assert_solid(mesh, volume.bounds)
    blunt = fb.Volume(volume.distances, volume.bounds).to_mesh()
    assert len(mesh.vertices) == len(blunt.vertices)
    # A tangent plane of the unit sphere is d^2 / 2 off at the distance d; crossings are at most a voxel from a vertex,
    # and the slope of the samples errs by as much again.
    for vertices in (mesh.vertices, blunt.vertices):
        error = np.abs(np.linalg.norm(vertices, axis=1) - 1)
        assert error.max() <= volume.spacing.max() ** 2


@pytest.mark.parametrize("level", [-0.3, -0.05, 0.04, 0.2])
def test_a_level_grows_and_shrinks(level):
    volume = fb.bake(meshes.icosphere(4), 48, margin=0.5)
    mesh = volume.to_mesh(level)
    assert_solid(mesh, volume.bounds)
    # The icosphere lies up to 1.3e-3 inside the sphere.
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - (1 + level)).max() <= 0.5 * volume.spacing.max() ** 2 + 2e-3


def test_a_sheet_comes_back_with_its_thickness():
    sheet = ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    volume = fb.bake(sheet, 48, two_sided=True, thickness=0.2)
    mesh = volume.to_mesh()
    assert_solid(mesh, volume.bounds)
    over = np.abs(mesh.vertices[:, :2]).max(axis=1) < 0.9
    assert np.abs(np.abs(mesh.vertices[over, 2]) - 0.1).max() <= SHARP * volume.spacing.max()


def test_a_surface_that_leaves_the_box_is_capped_there_or_left_open():
    half = fb.bake(meshes.icosphere(3), resolution=(20, 40, 40), bounds=[(0, -2, -2), (2, 2, 2)])
    mesh = half.to_mesh()
    assert_solid(mesh, half.bounds)
    assert mesh.bounds[0][0] == 0
    # Half of an icosphere, whose volume is 1.7 % below the volume of the ball.
    ball = truth.volume(*meshes.icosphere(3))
    assert truth.volume(mesh.vertices, mesh.faces) == pytest.approx(ball / 2, rel=0.01)
    opened = half.to_mesh(capped=False)
    assert opened.topology()["boundary_edges"] > 0
    assert 0 < len(opened.faces) < len(mesh.faces)


@pytest.mark.parametrize("level", [-5.0, 5.0])
def test_without_a_surface_there_are_no_faces(level):
    volume = fb.Volume(np.linspace(-1, 1, 8).repeat(64).reshape(8, 8, 8), [(-1, -1, -1), (1, 1, 1)])
    mesh = volume.to_mesh(-5.0)
    assert mesh.faces.shape == (0, 3)
    assert mesh.vertices.shape == (0, 3)
    assert repr(mesh) == "Mesh(0 vertices, 0 faces)"
    with pytest.raises(fb.MeshError, match="no faces"):
        fb.bake(mesh, 8)
    # Everything is inside: the solid is the box itself.
    assert_solid(volume.to_mesh(5.0), volume.bounds)


def test_a_sample_at_the_level_is_outside():
    values = np.full((3, 3, 3), 1.0)
    values[1, 1, 1] = 0.0
    volume = fb.Volume(values, [(0, 0, 0), (1, 1, 1)])
    # A sample within the rounding of the level, 1/16384 of a voxel, counts as the level.
    for level in (0.0, 1e-6, -1e-6):
        assert len(volume.to_mesh(level).faces) == 0
    assert_solid(volume.to_mesh(1e-4))


@pytest.mark.parametrize("level", [float("nan"), float("inf"), "zero", None])
def test_a_level_must_be_a_number(level):
    with pytest.raises(fb.ArgumentError, match="level"):
        fb.bake(fb.sphere(), 8).to_mesh(level)


def test_a_level_beyond_the_band_is_an_error():
    volume = fb.bake(meshes.icosphere(2), 32, band=3)
    voxel = volume.spacing.max()
    assert_solid(volume.to_mesh(2 * voxel))
    with pytest.raises(fb.ArgumentError, match="level"):
        volume.to_mesh(3.5 * voxel)
    quantized = fb.bake(meshes.icosphere(2), 32).quantize("snorm16", band=4)
    assert_solid(quantized.to_mesh(2 * voxel))
    with pytest.raises(fb.ArgumentError, match="level"):
        quantized.to_mesh(4.5 * voxel)
    sparse = fb.bake_sparse(meshes.icosphere(2), 32, band=4)
    assert_solid(sparse.to_mesh(2 * voxel))
    with pytest.raises(fb.ArgumentError, match="level"):
        sparse.to_mesh(4.5 * voxel)


@pytest.mark.parametrize("tolerance", [None, 0.05])
def test_a_sparse_volume_gives_the_mesh_of_its_samples(tolerance):
    sparse = fb.bake_sparse(meshes.knot(), 96, tolerance=tolerance)
    mesh = sparse.to_mesh()
    assert_solid(mesh, sparse.bounds)
    dense = sparse.to_volume().to_mesh()
    assert np.array_equal(mesh.vertices, dense.vertices)
    assert np.array_equal(mesh.faces, dense.faces)


@pytest.mark.parametrize("tolerance", [None, 0.05])
def test_a_sparse_field_that_the_box_cuts_is_capped(tolerance):
    # The box cuts the ball deep inside, where no brick is stored.
    options = {"resolution": (40, 80, 80), "bounds": [(0, -2, -2), (2, 2, 2)]}
    ball = meshes.icosphere(3)
    sparse = fb.bake_sparse(ball, tolerance=tolerance, **options)
    mesh = sparse.to_mesh()
    assert_solid(mesh, sparse.bounds)
    assert mesh.bounds[0][0] == 0
    assert truth.volume(mesh.vertices, mesh.faces) == pytest.approx(truth.volume(*ball) / 2, rel=0.01)
    assert_solid(sparse.to_mesh(-sparse.band / 2), sparse.bounds)


def test_a_sparse_field_follows_the_surface_across_openings():
    # Far from the sheets the surface of the winding number 1/2 passes through bricks whose corners have one side.
    sheets = meshes.stacked_sheets()
    for resolution in (40, 57):
        dense, sparse = fb.bake(sheets, resolution), fb.bake_sparse(sheets, resolution, tolerance=None)
        mesh = sparse.to_mesh()
        assert_solid(mesh, sparse.bounds)
        assert len(mesh.faces) == len(dense.to_mesh().faces)
        assert np.array_equal(sparse.distances < 0, dense.distances < 0)


def equal_positions(mesh):
    """Number of vertices at the float32 position of another one."""
    vertices = mesh.vertices.astype(np.float32)
    return len(vertices) - len(np.unique(vertices, axis=0))


def test_no_two_vertices_have_one_position_in_single_precision():
    for seed in range(200):
        volume = random_field(seed, np.random.default_rng(seed).integers(3, 8, 3))
        assert equal_positions(volume.to_mesh()) == 0, seed


def test_an_stl_file_of_thin_sheets_is_read_back_as_a_two_manifold(tmp_path):
    # The sheets grow from a fraction of a voxel, so many cells hold a vertex of either side.
    ramp = fb.plane("x", -1.0).times(0.08)
    core = fb.sphere(1.0) & fb.gyroid(0.5, ramp)
    mesh = core.to_mesh(40)
    assert_solid(mesh)
    assert equal_positions(mesh) == 0
    mesh.save(tmp_path / "core.stl")
    read = fb.load_mesh(tmp_path / "core.stl")
    assert read.topology()["closed"]
    # The file repeats each vertex in every face.
    assert len(np.unique(read.vertices, axis=0)) == len(mesh.vertices)


@pytest.mark.parametrize("encoding", ["float16", "snorm16", "snorm8"])
def test_a_quantized_volume_gives_a_closed_mesh(encoding):
    volume = fb.bake(meshes.torus(), 40)
    quantized = volume.quantize(encoding)
    mesh = quantized.to_mesh()
    assert_solid(mesh, volume.bounds)
    assert np.abs(fb.signed_distance(meshes.torus(), mesh.vertices)).mean() <= SHARP * volume.spacing.max()


def test_a_shape_gives_the_mesh_of_its_bake():
    drilled = fb.box((2, 1.6, 1.2)) - fb.cylinder(radius=0.4, height=3).rotate("x", 90)
    shape = drilled | fb.sphere(0.5).translate((1, 0, 0))
    baked, direct = fb.bake(shape, 48).to_mesh(), shape.to_mesh(48)
    assert_solid(baked)
    assert_solid(direct)
    # Both place one vertex in each patch; samples that differ in the last bit may change a patch.
    assert abs(len(baked.vertices) - len(direct.vertices)) <= 4
    for mesh in (baked, direct):
        assert np.abs(shape.distance(mesh.vertices)).mean() <= SHARP * 2.2 / 48


def test_a_shape_with_no_bounds_needs_a_box():
    with pytest.raises(fb.ShapeError):
        fb.plane().to_mesh(8)
    assert_solid(fb.plane().to_mesh(8, bounds=[(-1, -1, -1), (1, 1, 1)]))


def test_the_report_counts_clamped_vertices():
    mesh = random_field(3).to_mesh()
    assert 0 < mesh.report.clamped_vertices <= len(mesh.vertices)
    assert fb.Mesh(*meshes.box()).report is None


@pytest.mark.parametrize("resolution", [32, 64, pytest.param(128, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["spot/spot.obj", "stanford-bunny.obj", "fandisk.obj", "suzanne.obj", "teapot.obj"])
def test_real_meshes_come_back_closed(name, resolution, model_path):
    volume = fb.bake(model_path(name), resolution)
    mesh = volume.to_mesh()
    assert_solid(mesh, volume.bounds)
    assert mesh.to_trimesh().is_watertight


@pytest.mark.parametrize("copied", [lambda mesh: mesh, copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))])
def test_a_mesh_without_faces_has_empty_properties(copied):
    mesh = copied(fb.Volume(np.ones((2, 2, 2)), [(0, 0, 0), (1, 1, 1)]).to_mesh())

    assert mesh.faces.shape == mesh.face_normals.shape == mesh.vertex_normals.shape == (0, 3)
    assert (mesh.area, mesh.volume, mesh.nbytes) == (0, 0, 0)
    assert mesh.is_closed
    assert mesh.vertex_colors is None
    assert mesh.face_colors is None
    assert mesh.report.clamped_vertices == 0


def wrong_sides(volume, mesh):
    """Number of samples on the wrong side of the mesh. A sample equal to the level is outside."""
    places = np.moveaxis(np.indices(volume.resolution), 0, -1)
    inside = fb.contains(mesh, volume.origin + places * volume.spacing)
    return np.count_nonzero(inside != (np.asarray(volume.distances) < 0))


def test_samples_of_noise_keep_their_sides():
    for seed in range(120):
        shape = np.random.default_rng(seed).integers(2, 5, 3)
        volume = random_field(seed, shape)
        for sharp in (True, False):
            mesh = volume.to_mesh(sharp=sharp)
            assert not len(mesh.faces) or wrong_sides(volume, mesh) == 0, seed


def test_samples_keep_their_sides_beside_sharp_edges_of_the_source():
    blade = fb.box((2, 0.3, 1.5)).rotate((1, 2, 3), 50) - fb.box(1.1).rotate((3, 1, 2), 20)
    spikes = (fb.octahedron(1.2) | fb.cone(0.4, 2.4).rotate((1, 1, 0), 70)) & fb.box((3, 1.1, 3)).rotate("z", 33)
    for shape in (blade, spikes, turned_box()):
        for resolution in (9, 17, 30):
            volume = fb.bake(shape, resolution)
            assert wrong_sides(volume, volume.to_mesh()) == 0, resolution


def test_a_surface_gives_its_mesh_once():
    volume = fb.bake(meshes.icosphere(2), 12)
    surface = volume._surface(0.0)
    surface.mesh()
    with pytest.raises(fb.ArgumentError, match="made already"):
        surface.mesh()


def scan_of_a_ball(radius=1.0, resolution=64, half=1.3):
    """Intensities as in a CT scan: 1000 in a ball, -1000 around it, with a soft border."""
    grid = fb.Volume(np.zeros((resolution,) * 3, np.float32), [(-half,) * 3, (half,) * 3])
    places = np.stack(np.meshgrid(*grid.coordinates, indexing="ij"), axis=-1)
    below = np.clip((radius - np.linalg.norm(places, axis=-1)) / 0.2, -1, 1)
    return fb.Volume((1000 * below).astype(np.int16), grid.bounds)


def test_intensities_are_solid_above_the_level():
    scan = scan_of_a_ball()
    ball = scan.to_mesh(0, inside="above")
    assert_solid(ball, scan.bounds)
    assert ball.volume == pytest.approx(4 * np.pi / 3, rel=1e-3)
    assert np.abs(np.linalg.norm(ball.vertices, axis=1) - 1).max() <= 0.02 * scan.spacing.max()
    # The border of intensities falls by 5000 for each world unit.
    assert scan.to_mesh(-500, inside="above").volume == pytest.approx(4 * np.pi / 3 * 1.1**3, rel=2e-3)
    assert ball.report.warnings == ()


def test_a_field_whose_border_is_inside_names_the_option():
    scan = scan_of_a_ball()
    with pytest.warns(fb.SurfaceWarning, match=r'100% of the border .* level 0, .*inside="above"'):
        negative = scan.to_mesh(0)
    box = np.prod(scan.bounds[1] - scan.bounds[0])
    assert negative.volume == pytest.approx(box - 4 * np.pi / 3, rel=1e-3)
    assert len(negative.report.warnings) == 1


@pytest.mark.filterwarnings("error::fieldbake.SurfaceWarning")
def test_fields_of_distances_give_no_warning_of_their_border():
    ball = fb.bake(fb.sphere(1), 24)
    for volume in (ball, fb.Volume(ball.distances, ball.bounds), ball.to_sparse(), fb.merge([ball], 24)):
        volume.to_mesh()


@pytest.mark.parametrize("level", [0.0, 0.1])
@pytest.mark.parametrize("geometry", ["mesh", "shape", "file"])
def test_the_solid_above_is_the_rest_of_the_box(geometry, level):
    shape = turned_box()
    volume = fb.bake(shape.to_mesh(24) if geometry == "mesh" else shape, 24)
    if geometry == "file":
        volume = fb.Volume(volume.distances, volume.bounds)
    box = np.prod(volume.bounds[1] - volume.bounds[0])
    expected = box - volume.to_mesh(level).volume
    fields = [volume, volume.quantize("snorm16"), volume.quantize("float16"), volume.to_sparse(band=6)]
    for field in fields:
        rest = field.to_mesh(level, inside="above")
        assert_solid(rest, volume.bounds)
        assert rest.volume == pytest.approx(expected, rel=2e-3)
    if geometry != "file" and level == 0:
        rest = volume.to_mesh(inside="above")
        local = np.abs(rest.vertices @ turn_matrix((1.0, 2.0, 3.0), 40)).max(axis=1)
        hole = local[local < 1 + 0.4 * volume.spacing.max()]
        assert len(hole) > 500
        assert np.abs(hole - 1).max() <= SHARP * volume.spacing.max()


def test_merged_fields_and_stores_have_a_solid_above(tmp_path):
    ball = fb.bake(meshes.icosphere(3), 32)
    merged = fb.merge([ball], 32)
    fields = [merged]
    if importlib.util.find_spec("zarr") is not None:
        fields.append(fb.bake_to_zarr(meshes.icosphere(3), tmp_path / "ball.zarr", 32, shard=32, chunk=16))
    for field in fields:
        rest = field.to_mesh(inside="above")
        assert_solid(rest, field.bounds)
        assert rest.volume == pytest.approx(np.prod(field.bounds[1] - field.bounds[0]) - 4 * np.pi / 3, rel=0.01)


def test_the_side_of_the_solid_is_one_of_two_words():
    with pytest.raises(fb.ArgumentError, match='inside: must be one of "below", "above"'):
        fb.bake(fb.sphere(), 8).to_mesh(inside="over")
