"""Meshes of fields do not cross themselves, stay in the box of their shape, and stay near its surface."""

import contextlib

import numpy as np
import pytest

import fieldbake as fb
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


def test_the_surface_of_a_lattice_is_near_the_field():
    shape, resolution = lattices()["gyroid ball"]
    mesh = shape.to_mesh(resolution)
    fine = shape.to_mesh(256)
    voxel = 2.2 / resolution
    away = fb.closest_point(fine, fb.sample_surface(mesh, 20_000, seed=1).points).distances / voxel
    # Chords of the sheets, whose radius of curvature is about four voxels, and edges between the sheets and the ball
    # that pass beside the vertices.
    assert np.quantile(away, 0.99) <= 0.1
    assert away.max() <= 0.5


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
