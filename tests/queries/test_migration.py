"""The lines of docs/migration.md give the results of the libraries that they replace."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
import meshes

PAGE = Path(__file__).parents[2] / "docs" / "migration.md"
GEOMETRY = meshes.knot(96, 12)
POINTS = meshes.points_around(GEOMETRY, 400)
TARGETS = meshes.points_around(GEOMETRY, 400, seed=9, spread=0.7)
DIRECTIONS = TARGETS - POINTS
#: Distances of the others: float32 in Open3D and pysdf, on a mesh of size 7.
SINGLE = 2e-6
#: Errors of pysdf and point_cloud_utils on this mesh, in its units: 1.4e-3 and 3.2e-3 were measured.
APPROXIMATE = 5e-3
DOUBLE = 1e-7


@pytest.fixture(scope="module")
def mesh():
    return fb.Mesh(*GEOMETRY)


@pytest.fixture(scope="module")
def theirs():
    trimesh = pytest.importorskip("trimesh")
    return trimesh.Trimesh(*GEOMETRY, process=False)


def test_every_function_of_the_page_exists():
    names = set(re.findall(r"`-?fb\.(\w+)", PAGE.read_text(encoding="utf-8")))

    assert len(names) > 8
    assert names <= set(fb.__all__)


def test_every_call_of_another_library_is_in_this_file():
    rows = re.findall(r"^\| [^|*]+ \| ((?:[^|\\]|\\.)+) \| `", PAGE.read_text(encoding="utf-8"), re.M)
    calls = {name.rpartition(".")[2] for row in rows for name in re.findall(r"([\w.]+)\(", row)}
    kernels = PAGE.parents[1] / "tests" / "support" / "warp_kernels.py"
    tested = "".join(path.read_text(encoding="utf-8") for path in (Path(__file__), kernels))

    assert len(rows) > 40
    assert {name for name in calls if len(name) > 1 and not re.search(rf"\b{name}\(", tested)} == set()


def test_trimesh_distances(theirs):
    import trimesh

    signed = trimesh.proximity.signed_distance(theirs, POINTS)
    points, distances, _ = trimesh.proximity.closest_point(theirs, POINTS)
    ours = fb.closest_point(theirs, POINTS)

    assert np.abs(-fb.signed_distance(theirs, POINTS) - signed).max() <= SINGLE
    assert np.abs(ours.distances - distances).max() <= DOUBLE
    assert np.abs(ours.points - points).max() <= 1e-5
    assert np.array_equal(fb.contains(theirs, POINTS), theirs.contains(POINTS))
    # The ball that touches a point from inside; the tube has a radius, so most balls are as wide as it.
    surface = fb.sample_surface(theirs, 50, seed=4)
    normals = surface.normals
    thick = trimesh.proximity.thickness(theirs, surface.points, normals=normals, method="max_sphere")
    balls = fb.thickness(theirs, surface.points, normals)
    assert np.quantile(np.abs(balls - thick), 0.5) <= 1e-3


def test_trimesh_rays(theirs):
    locations, rays, faces = theirs.ray.intersects_location(POINTS, DIRECTIONS)[0:3]
    ours = fb.all_intersections(theirs, POINTS, DIRECTIONS)

    assert np.array_equal(np.sort(rays), ours.rays)
    order = np.lexsort((np.linalg.norm(locations - POINTS[rays], axis=1), rays))
    found = POINTS[ours.rays] + ours.t[:, None] * DIRECTIONS[ours.rays]
    assert np.abs(found - locations[order]).max() <= DOUBLE
    assert np.array_equal(ours.faces, faces[order])
    first, first_rays, _ = theirs.ray.intersects_location(POINTS, DIRECTIONS, multiple_hits=False)
    hits = fb.cast_rays(theirs, POINTS, DIRECTIONS)
    assert np.array_equal(np.flatnonzero(hits.hit), np.sort(first_rays))
    nearest = POINTS[first_rays] + hits.t[first_rays, None] * DIRECTIONS[first_rays]
    assert np.abs(nearest - first).max() <= DOUBLE
    assert np.array_equal(fb.occluded(theirs, POINTS, DIRECTIONS), theirs.ray.intersects_any(POINTS, DIRECTIONS))


def test_trimesh_facts(theirs, mesh, tmp_path):
    assert mesh.area == pytest.approx(theirs.area, rel=1e-12)
    assert mesh.volume == pytest.approx(theirs.volume, rel=1e-12)
    assert mesh.is_closed == theirs.is_watertight
    assert np.abs(mesh.face_normals - theirs.face_normals).max() <= DOUBLE
    mesh.save(tmp_path / "x.stl")
    theirs.export(tmp_path / "y.stl")
    for name in ("x.stl", "y.stl"):
        assert len(fb.load_mesh(tmp_path / name).faces) == len(mesh.faces)


def test_trimesh_samples(theirs):
    import trimesh

    mean = (theirs.triangles_center * theirs.area_faces[:, None]).sum(axis=0) / theirs.area
    for points in (fb.sample_surface(theirs, 20_000).points, trimesh.sample.sample_surface(theirs, 20_000, seed=1)[0]):
        assert points.mean(axis=0) == pytest.approx(mean, abs=0.1)


def test_igl():
    igl = pytest.importorskip("igl")
    vertices, faces = GEOMETRY
    squared, rows, points = igl.point_mesh_squared_distance(POINTS, vertices, faces)
    ours = fb.query(GEOMETRY, POINTS)

    assert np.abs(np.abs(ours.distances) - np.sqrt(squared)).max() <= DOUBLE
    assert np.abs(ours.points - points).max() <= 1e-5
    # On edges and vertices any of their faces is right.
    within = ours.barycentric.min(axis=1) > 1e-6
    assert np.array_equal(ours.faces[within], rows[within])
    signed, nearest, feet = igl.signed_distance(POINTS, vertices, faces)[:3]
    assert np.abs(np.abs(ours.distances) - np.abs(signed)).max() <= DOUBLE
    assert np.array_equal(ours.faces[within], nearest[within])
    assert np.abs(ours.points - feet).max() <= 1e-5
    fast = igl.fast_winding_number(vertices, faces, POINTS)
    # The approximation of the other side.
    assert np.abs(fb.winding_number(GEOMETRY, POINTS) - fast).max() <= 0.05


def test_open3d(mesh):
    o3d = pytest.importorskip("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(GEOMETRY.vertices.astype(np.float32)), o3d.core.Tensor(GEOMETRY.faces.astype(np.uint32))
    )
    single = POINTS.astype(np.float32)
    rays = np.concatenate([single, DIRECTIONS.astype(np.float32)], axis=1)
    o, d = rays[:, :3], rays[:, 3:]

    assert np.abs(fb.signed_distance(mesh, single) - scene.compute_signed_distance(single).numpy()).max() <= SINGLE
    assert np.array_equal(fb.contains(mesh, single), scene.compute_occupancy(single).numpy() > 0)
    closest, nearest = scene.compute_closest_points(single), fb.closest_point(mesh, single)
    assert np.abs(nearest.points - closest["points"].numpy()).max() <= 1e-5
    same = nearest.faces == closest["primitive_ids"].numpy()
    assert same.mean() > 0.6
    uv = closest["primitive_uvs"].numpy()
    assert np.abs(nearest.barycentric[same, 1:] - uv[same]).max() <= 1e-4
    theirs = scene.cast_rays(rays)
    ours = fb.cast_rays(mesh, o, d)
    hit = np.isfinite(theirs["t_hit"].numpy())
    assert np.array_equal(ours.hit, hit)
    assert np.abs(ours.t[hit] - theirs["t_hit"].numpy()[hit]).max() <= 1e-5
    assert np.abs(ours.normals[hit] - theirs["primitive_normals"].numpy()[hit]).max() <= 1e-4
    assert np.array_equal(fb.occluded(mesh, o, d), scene.test_occlusions(rays).numpy())
    assert np.array_equal(fb.count_intersections(mesh, o, d), scene.count_intersections(rays).numpy())
    listed = scene.list_intersections(rays)
    assert np.array_equal(fb.all_intersections(mesh, o, d).rays, listed["ray_ids"].numpy())


def test_pysdf(mesh):
    pysdf = pytest.importorskip("pysdf")
    sdf = pysdf.SDF(GEOMETRY.vertices.astype(np.float32), GEOMETRY.faces.astype(np.uint32))
    difference = np.abs(-fb.signed_distance(mesh, POINTS) - sdf(POINTS.astype(np.float32)))

    # pysdf measures the faces around the nearest vertices only, which may miss the nearest face by a part of an edge.
    assert np.median(difference) <= SINGLE
    assert difference.max() <= APPROXIMATE
    far = difference < np.abs(fb.signed_distance(mesh, POINTS))
    assert np.array_equal(fb.contains(mesh, POINTS)[far], sdf.contains(POINTS.astype(np.float32))[far])
    ours, theirs = fb.sample_surface(mesh, 20_000).points, sdf.sample_surface(20_000)
    assert ours.mean(axis=0) == pytest.approx(theirs.mean(axis=0), abs=0.1)


def test_pyvista():
    pv = pytest.importorskip("pyvista")
    surface = pv.PolyData.from_regular_faces(*GEOMETRY)
    theirs = pv.PolyData(POINTS).compute_implicit_distance(surface)["implicit_distance"]

    assert np.abs(fb.signed_distance(surface, POINTS) - theirs).max() <= SINGLE
    inside = pv.PolyData(POINTS).select_interior_points(surface)["selected_points"].astype(bool)
    assert np.array_equal(fb.contains(surface, POINTS), inside)


def test_point_cloud_utils():
    pcu = pytest.importorskip("point_cloud_utils")
    theirs = pcu.signed_distance_to_mesh(POINTS, *GEOMETRY)[0]
    difference = np.abs(fb.query(GEOMETRY, POINTS).distances - theirs)

    # Its distances differ from float64 brute force by up to 0.15 %, ours by 1e-15.
    assert difference.max() <= APPROXIMATE

    ours, pair = fb.closest_point(GEOMETRY, POINTS), pcu.closest_points_on_mesh(POINTS, *GEOMETRY)
    assert np.abs(ours.distances - pair[0]).max() <= APPROXIMATE
    faces, weights = pcu.sample_mesh_random(*GEOMETRY, 20_000, random_seed=1)
    theirs = pcu.interpolate_barycentric_coords(GEOMETRY[1], faces, weights, GEOMETRY[0])
    assert fb.sample_surface(GEOMETRY, 20_000).points.mean(axis=0) == pytest.approx(theirs.mean(axis=0), abs=0.1)


@pytest.mark.slow
def test_warp(mesh, tmp_path):
    wp = pytest.importorskip("warp")
    import warp_kernels

    wp.config.quiet = True
    single = POINTS.astype(np.float32)
    ways = DIRECTIONS.astype(np.float32)
    theirs = wp.Mesh(
        wp.array(GEOMETRY.vertices.astype(np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(GEOMETRY.faces.astype(np.int32).ravel(), dtype=int, device="cpu"),
        support_winding_number=True,
    )
    signed, feet, t = warp_kernels.measure(theirs, single, ways)

    # Points of warp are float32 on a mesh of size 7.
    assert np.abs(fb.signed_distance(mesh, single) - signed).max() <= 1e-5
    # Between two faces that are nearly equally far, float32 may take the other one.
    assert np.quantile(np.abs(fb.closest_point(mesh, single).points - feet), 0.98) <= 1e-5
    hits = fb.cast_rays(mesh, single, ways / np.linalg.norm(ways, axis=1, keepdims=True))
    assert np.array_equal(hits.hit, np.isfinite(t))
    assert np.abs(hits.t[hits.hit] - t[hits.hit]).max() <= 1e-4

    volume = fb.bake(mesh, 32)
    volume.save(tmp_path / "m.nvdb")
    loaded = wp.Volume.load_from_nvdb((tmp_path / "m.nvdb").read_bytes(), device="cpu")
    grid = wp.Volume.load_from_numpy(volume.distances, tuple(volume.origin), float(volume.spacing[0]), device="cpu")
    assert loaded.get_voxel_size()[0] == pytest.approx(grid.get_voxel_size()[0], rel=1e-6)
    # The eight samples around a point of the surface lie in the band of the file, 3 voxels. A position of up to 32
    # voxels has four roundings to float32, and the trilinear field changes by at most sqrt(3) voxels per voxel.
    near = fb.sample_surface(mesh, 500, seed=2).points.astype(np.float32)
    for theirs in (grid, loaded):
        error = np.abs(warp_kernels.sample(theirs, near) - volume.sample(near))
        assert error.max() <= 4 * 32 * 2**-23 * 3**0.5 * volume.spacing[0]


def test_mesh_to_sdf(mesh):
    package = pytest.importorskip("mesh_to_sdf")
    trimesh = pytest.importorskip("trimesh")
    # A tube of radius 0.3 that closes a circle; the samples cover it densely.
    torus = fb.bake(fb.torus(1, 0.3), 24).to_mesh()
    theirs = trimesh.Trimesh(torus.vertices, torus.faces, process=False)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (300, 3))
    distances = package.mesh_to_sdf(
        theirs, points, surface_point_method="sample", sign_method="normal", sample_point_count=200_000
    )
    # 200,000 samples on 11.8 square units lie about 0.008 apart.
    assert np.abs(fb.signed_distance(torus, points) - distances).max() <= 0.02

    ball, _ = fb.normalize(torus, "unit sphere")
    unit = package.scale_to_unit_sphere(theirs)
    assert np.linalg.norm(ball.vertices, axis=1).max() == pytest.approx(
        np.linalg.norm(unit.vertices, axis=1).max(), 0.01
    )
    options = {"surface_point_method": "sample", "sign_method": "normal", "sample_point_count": 50_000}
    voxels = package.mesh_to_voxels(theirs, 16, **options)
    cube = package.utils.scale_to_unit_cube(theirs)
    # Their samples lie at the corners of the cube from -1 to 1.
    half = 1 + 1 / 15
    ours = fb.bake((cube.vertices, cube.faces), (16, 16, 16), bounds=((-half,) * 3, (half,) * 3))
    assert np.abs(ours.distances - voxels).max() <= 0.03
    drawn, values = package.sample_sdf_near_surface(theirs, number_of_points=400, **options)
    assert np.abs(fb.signed_distance((unit.vertices, unit.faces), drawn) - values).max() <= 0.03
    assert len(fb.sample_training(torus, 400).points) == 400


def openscad(folder, text):
    """The mesh that OpenSCAD makes of a program."""
    (folder / "a.scad").write_text(f"$fn = 64;\n{text}\n", encoding="utf-8")
    command = ["openscad", "-o", str(folder / "x.stl"), str(folder / "a.scad")]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return fb.load_mesh(folder / "x.stl")


@pytest.mark.skipif(shutil.which("openscad") is None, reason="OpenSCAD is not installed: apt install openscad")
def test_openscad(tmp_path):
    box, ball, tube = fb.box((1, 2, 3)), fb.sphere(1), fb.cylinder(0.5, 2)
    corners = [(0.5, 0), (1.5, 0), (1.5, 1), (0.8, 0.6)]
    c = str([list(corner) for corner in corners])
    a, b = "cube([1, 2, 3], center = true);", "sphere(r = 1);"
    fb.bake(box, 32).to_mesh().save(tmp_path / "box.stl")
    pairs = [
        (a, box),
        ("sphere(r = 1);", ball),
        ("cylinder(h = 2, r = 0.5, center = true);", tube),
        (f"union() {{{a} {b}}}", box | ball),
        (f"intersection() {{{a} {b}}}", box & ball),
        (f"difference() {{{a} {b}}}", box - ball),
        (f"translate([1, 0, 0]) {a}", box.translate((1, 0, 0))),
        (f"rotate([0, 0, 30]) {a}", box.rotate("z", 30)),
        (f"scale(2) {a}", box.scale(2)),
        (f"translate([0, 0, -1]) linear_extrude(2) polygon({c});", fb.polygon(corners).extrude(2)),
        (f"rotate_extrude() polygon({c});", fb.polygon(corners).revolve()),
        (f'import("{tmp_path / "box.stl"}");', fb.volume_shape(fb.bake(tmp_path / "box.stl", 64))),
    ]
    for text, ours in pairs:
        theirs = openscad(tmp_path, text)
        # Chords of circles in 64 parts, up to 2 units of radius, leave 2 * (1 - cos(pi / 64)); the trilinear
        # field of the mesh is off by up to half a voxel of 0.052 at corners.
        bound = 0.0025 if "import" not in text else 0.026
        assert np.abs(ours.distance(theirs.vertices)).max() <= bound, text
        assert np.abs(theirs.bounds - ours.to_mesh(32).bounds).max() <= 0.11, text
    box.save(tmp_path / "ours.stl", 24)
    assert fb.load_mesh(tmp_path / "ours.stl").volume == pytest.approx(openscad(tmp_path, a).volume, rel=1e-3)


# Their pools of threads are left open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_fogleman_sdf(tmp_path):
    sdf = pytest.importorskip("sdf")
    pairs = [
        (sdf.sphere(1), fb.sphere(1)),
        (sdf.box((1, 2, 3)), fb.box((1, 2, 3))),
        (sdf.torus(1, 0.25), fb.torus(1, 0.25)),
        ((sdf.sphere(1) & sdf.box(1.5)) - sdf.cylinder(0.5), (fb.sphere(1) & fb.box(1.5)) - fb.cylinder(0.5, 10)),
        (sdf.sphere(1).union(sdf.box(1.5), k=0.2), fb.Shape.union(fb.sphere(1), fb.box(1.5), k=0.2)),
        (sdf.sphere(0.5).translate((0, 0, 1)), fb.sphere(0.5).translate((0, 0, 1))),
        (sdf.sphere(1).shell(0.1), fb.sphere(1).shell(0.1)),
    ]
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (2000, 3))
    for theirs, ours in pairs:
        # Theirs is float64, ours float32.
        assert np.abs(np.asarray(theirs(points)).reshape(-1) - ours.distance(points)).max() <= SINGLE
    pairs[3][0].save(str(tmp_path / "theirs.stl"), samples=2**15, verbose=False)
    pairs[3][1].save(tmp_path / "ours.stl", 48)
    theirs, ours = (fb.load_mesh(tmp_path / name) for name in ("theirs.stl", "ours.stl"))
    # Marching cubes cuts the edges of their mesh by up to half a voxel.
    assert ours.volume == pytest.approx(theirs.volume, rel=0.02)
