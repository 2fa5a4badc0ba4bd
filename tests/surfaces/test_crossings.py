"""Meshes of fields do not cross themselves, stay in the box of their shape, and stay near its surface."""

import contextlib

import numpy as np
import pytest

import fieldbake as fb
from fieldbake.meshes.isosurface import with_thin_features
from manifold import faults


def crossings(mesh):
    return mesh._core.self_intersections()


def lattices():
    """Sheets in bodies, with walls of 1.2 to 4 voxels of the resolution beside them."""
    ball, plate = fb.sphere(1), fb.box((2, 1.2, 0.3)).rotate((1, 2, 3), 25)
    return {
        "gyroid ball": (fb.gyroid(0.5, thickness=0.08) & ball, 64),
        "thin gyroid": (fb.gyroid(0.35, thickness=1.2 * 2.2 / 48) & ball, 48),
        "schwarz plate": (fb.schwarz_p(0.4, thickness=0.06) & plate, 72),
        "diamond plate": (fb.diamond(0.6, thickness=0.06) & plate, 56),
        "iwp ball": (fb.iwp(0.6, thickness=0.09) & ball, 56),
    }


@pytest.mark.parametrize("sharp", [True, False])
@pytest.mark.parametrize("name", lattices())
def test_lattices_do_not_cross_themselves(name, sharp):
    shape, resolution = lattices()[name]
    mesh = shape.to_mesh(resolution, sharp=sharp)
    assert faults(mesh.vertices, mesh.faces) == []
    assert crossings(mesh) == 0
    assert (mesh.bounds[0] >= shape.bounds[0]).all()
    assert (mesh.bounds[1] <= shape.bounds[1]).all()


@pytest.mark.parametrize(
    ("name", "share"), [("gyroid ball", 0.999), ("schwarz plate", 0.999), ("iwp ball", 0.999), ("diamond plate", 0.997)]
)
def test_the_surface_of_a_lattice_is_near_the_field(name, share):
    shape, resolution = lattices()[name]
    mesh = shape.to_mesh(resolution)
    fine = shape.to_mesh(300)
    voxel = max(np.ptp(shape.bounds, axis=0)) * 1.1 / resolution
    nearest = fb.closest_point(fine, fb.sample_surface(mesh, 20_000, seed=1).points)
    away = nearest.distances / voxel
    # Where the sheets end at an acute angle, their walls are thinner than a voxel, and samples miss parts of them.
    normals = fine.face_normals[nearest.faces]
    within = [shape.distance(nearest.points - depth * voxel * normals) < 0 for depth in (0.25, 0.5, 0.75, 1.0)]
    is_thick = np.all(within, axis=0)
    assert is_thick.mean() >= 0.8
    assert (away[is_thick] <= 0.1).mean() >= share
    # Sharp fins between two samples are cut off.
    assert away.max() <= 0.5


@pytest.mark.parametrize(("pitch", "lead_in", "resolution"), [(0.75, 0, 64), (0.75, 0, 100), (1.25, 0.6, 128)])
def test_vertices_of_a_fine_thread_are_near_its_surface(pitch, lead_in, resolution):
    """Flanks meet the end faces outside the crest, which has less than a voxel there."""
    rod = fb.thread(8, pitch, 10, lead_in=lead_in)
    distances = np.abs(rod.distance(rod.to_mesh(resolution).vertices))

    # Crests are narrower than a voxel, so that a vertex between two flanks may lie half a voxel beyond its crest.
    assert distances.max() <= 0.6 * 10 / resolution


def test_faces_without_an_area_have_no_walls():
    # The cross product of edges of 1e-170 is 0 in float64, and warnings are errors.
    mesh = fb.Mesh(np.concatenate([np.eye(3), 1e-170 * np.eye(3)]), np.arange(6).reshape(2, 3))
    assert with_thin_features(mesh, fb.sphere(3)._core, 0.1, 0) is mesh


def test_walls_thinner_than_a_voxel_are_a_warning():
    lattice = fb.gyroid(0.3, thickness=0.05) & fb.sphere(1)
    with pytest.warns(fb.SurfaceWarning, match="resolution: .* % of the surface .* than a voxel") as caught:
        mesh = lattice.to_mesh(24)
    assert mesh.report.warnings == (str(caught[0].message),)
    assert lattice.to_mesh(128).report.warnings == ()

    # Parts of a plate without a sample inside are no part of the mesh.
    plate = fb.box((1, 1, 0.004)).rotate("z", 20).translate((0, 0, 0.0035))
    for shape in (plate, plate | fb.box(0.2), fb.box((1, 1, 0.004)).rotate((1, 2, 3), 40)):
        with pytest.warns(fb.SurfaceWarning, match="thinner than a voxel"):
            shape.to_mesh(64)

    for voxels, warnings in ((0.5, 1), (0.8, 1), (1.2, 0)):
        plate = fb.box((4, 4, voxels * 0.1)).rotate("x", 30).rotate("z", 20)
        assert len(plate.to_mesh(voxel_size=0.1).report.warnings) == warnings


@pytest.mark.parametrize(("voxels", "warnings"), [(0.5, 1), (0.8, 1), (1.2, 0)])
def test_gaps_thinner_than_a_voxel_are_a_warning(voxels, warnings):
    gap = fb.box((3, 3, voxels * 0.05))
    halves = (fb.box((2, 2, 1)) - gap).rotate((1, 2, 3), 40)
    with pytest.warns(fb.SurfaceWarning, match="gaps thinner") if warnings else contextlib.nullcontext():
        mesh = halves.to_mesh(voxel_size=0.05)
    assert len(mesh.report.warnings) == warnings


@pytest.mark.parametrize("wall", [0.5, 1.2, 3])
def test_shells_and_booleans_do_not_cross_themselves(wall):
    ball, knot = fb.sphere().to_mesh(40), fb.models.torus_knot()
    with pytest.warns(fb.SurfaceWarning, match="thinner than a voxel") if wall < 1 else contextlib.nullcontext():
        shell = fb.shell(ball, wall * 2 / 38, 40, side="both")
    assert faults(shell.vertices, shell.faces) == []
    assert shell.report.self_intersections == 0
    made = fb.boolean("difference", ball, knot, resolution=48)
    assert faults(made.vertices, made.faces) == []
    assert made.report.self_intersections == 0
