"""The lines of docs/migration.md give the numbers of the libraries that they replace."""

import re
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


def test_trimesh_distances(theirs):
    import trimesh

    signed = trimesh.proximity.signed_distance(theirs, POINTS)
    points, distances, _ = trimesh.proximity.closest_point(theirs, POINTS)
    ours = fb.closest_point(theirs, POINTS)

    assert np.abs(-fb.signed_distance(theirs, POINTS) - signed).max() <= SINGLE
    assert np.abs(ours.distances - distances).max() <= DOUBLE
    assert np.abs(ours.points - points).max() <= 1e-5
    assert np.array_equal(fb.contains(theirs, POINTS), signed > 0)


def test_trimesh_rays(theirs):
    locations, rays, faces = theirs.ray.intersects_location(POINTS, DIRECTIONS)[0:3]
    ours = fb.all_intersections(theirs, POINTS, DIRECTIONS)

    assert np.array_equal(np.sort(rays), ours.rays)
    order = np.lexsort((np.linalg.norm(locations - POINTS[rays], axis=1), rays))
    found = POINTS[ours.rays] + ours.t[:, None] * DIRECTIONS[ours.rays]
    assert np.abs(found - locations[order]).max() <= DOUBLE
    assert np.array_equal(ours.faces, faces[order])
    assert np.array_equal(fb.occluded(theirs, POINTS, DIRECTIONS), theirs.ray.intersects_any(POINTS, DIRECTIONS))


def test_trimesh_facts(theirs, mesh, tmp_path):
    assert mesh.area == pytest.approx(theirs.area, rel=1e-12)
    assert mesh.volume == pytest.approx(theirs.volume, rel=1e-12)
    assert mesh.is_closed == theirs.is_watertight
    assert np.abs(mesh.face_normals - theirs.face_normals).max() <= DOUBLE
    mesh.save(tmp_path / "x.stl")
    assert len(fb.load_mesh(tmp_path / "x.stl").faces) == len(mesh.faces)


def test_trimesh_samples(theirs):
    ours = fb.sample_surface(theirs, 20_000)

    mean = (theirs.triangles_center * theirs.area_faces[:, None]).sum(axis=0) / theirs.area
    assert ours.points.mean(axis=0) == pytest.approx(mean, abs=0.1)


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


def test_pyvista():
    pv = pytest.importorskip("pyvista")
    surface = pv.PolyData.from_regular_faces(*GEOMETRY)
    theirs = pv.PolyData(POINTS).compute_implicit_distance(surface)["implicit_distance"]

    assert np.abs(fb.signed_distance(surface, POINTS) - theirs).max() <= SINGLE


def test_point_cloud_utils():
    pcu = pytest.importorskip("point_cloud_utils")
    theirs = pcu.signed_distance_to_mesh(POINTS, *GEOMETRY)[0]
    difference = np.abs(fb.query(GEOMETRY, POINTS).distances - theirs)

    # Its distances differ from float64 brute force by up to 0.15 %, ours by 1e-15.
    assert difference.max() <= APPROXIMATE


def test_fogleman_sdf():
    sdf = pytest.importorskip("sdf")
    pairs = [
        (sdf.sphere(1), fb.sphere(1)),
        (sdf.box((1, 2, 3)), fb.box((1, 2, 3))),
        (sdf.torus(1, 0.25), fb.torus(1, 0.25)),
        ((sdf.sphere(1) & sdf.box(1.5)) - sdf.cylinder(0.5), (fb.sphere(1) & fb.box(1.5)) - fb.cylinder(0.5, 10)),
        (sdf.sphere(1).union(sdf.box(1.5), k=0.2), fb.csg.union(fb.sphere(1), fb.box(1.5), k=0.2)),
        (sdf.sphere(0.5).translate((0, 0, 1)), fb.sphere(0.5).translate((0, 0, 1))),
        (sdf.sphere(1).shell(0.1), fb.sphere(1).shell(0.1)),
    ]
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (2000, 3))
    for theirs, ours in pairs:
        # Theirs is float64, ours float32.
        assert np.abs(np.asarray(theirs(points)).reshape(-1) - ours.distance(points)).max() <= SINGLE
