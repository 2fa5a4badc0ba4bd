"""Shadows of closed meshes with walls thinner than the voxels of their fields, against closed-form areas."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fieldbake as fb
import meshes

#: Rotations that turn no face of a box onto a plane of the grid.
TURNS = [meshes.rotation(seed) for seed in range(3)]

#: Side of the plate and of the picture, world units; pixels along the picture.
SIDE, HEIGHT, PIXELS = 4.0, 8.0, 96

#: The outline of the plate lies on borders of pixels, so that only rounding remains.
AREA_ERROR = 0.01 * SIDE**2


def box(size: Any, center: Any = (0, 0, 0)) -> meshes.Geometry:
    half = np.array(size) / 2
    return meshes.box(center - half, center + half)


def turned(geometry: meshes.Geometry, turn: np.ndarray) -> fb.Mesh:
    vertices, faces = geometry
    return fb.Mesh(vertices @ turn.T, faces)


def plate(thickness: float, turn: np.ndarray = TURNS[0]) -> fb.Mesh:
    return turned(box((SIDE, SIDE, thickness)), turn)


def pose(turn: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    return matrix


def shadow_area(instance: fb.Instance, turn: np.ndarray = TURNS[0], **options: Any) -> tuple[float, fb.Frame]:
    """The area that an instance darkens on a floor under light along the third axis of `turn`, and the frame."""
    down = -turn[:, 2]
    floor = fb.Instance(fb.box((12, 12, 0.2)).translate((0, 0, -2.4)), pose(turn))
    camera = fb.Camera.orthographic(1.2 * down, 2 * down, up=turn[:, 1], height=HEIGHT)
    scene = fb.Scene([instance, floor], lights=[fb.DirectionalLight(down)])
    frame = fb.render(scene, camera, size=(PIXELS, PIXELS), **{"device": "cpu", "shadows": "hard"} | options)
    assert (frame.object_id == 1).all()
    return float((1 - frame.shadow).sum()) * (HEIGHT / PIXELS) ** 2, frame


@pytest.mark.parametrize("shadows", ["hard", "soft"])
@pytest.mark.parametrize("thickness", [0.02, 0.05, 0.08, 0.11, 0.2])
@pytest.mark.parametrize("turn", TURNS)
def test_a_plate_of_any_thickness_casts_its_whole_shadow(turn: np.ndarray, thickness: float, shadows: str) -> None:
    area, _ = shadow_area(fb.Instance(plate(thickness, turn)), turn, shadows=shadows)

    assert abs(area - SIDE**2) <= AREA_ERROR


@pytest.mark.parametrize("thickness", [0.02, 0.05, 0.2])
def test_a_plate_turned_by_its_instance_casts_the_same_shadow(thickness: float) -> None:
    area, _ = shadow_area(fb.Instance(plate(thickness, np.eye(3)), pose(TURNS[0])))

    assert abs(area - SIDE**2) <= AREA_ERROR


def test_a_plate_that_is_wound_inside_out_casts_the_same_shadow() -> None:
    area, _ = shadow_area(fb.Instance(turned(meshes.flip(box((SIDE, SIDE, 0.05))), TURNS[0])))

    assert abs(area - SIDE**2) <= AREA_ERROR


def test_a_device_draws_the_shadow_of_a_thin_plate(gpu: str) -> None:
    area, frame = shadow_area(fb.Instance(plate(0.05)), device=gpu)

    assert frame.report["devices"]["light"] != "cpu"
    assert abs(area - SIDE**2) <= AREA_ERROR


@pytest.mark.parametrize("shadows", ["hard", "soft"])
@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("thickness", [0.1, 0.2, 0.5])
def test_no_light_enters_a_closed_room(thickness: float, joined: bool, shadows: str) -> None:
    turn, inside = TURNS[1], np.array([10.0, 10.0, 3.0])
    walls = []
    for axis, side in np.ndindex(3, 2):
        size, center = inside + 2 * thickness, np.zeros(3)
        size[axis], center[axis] = thickness, (side - 0.5) * (inside[axis] + thickness)
        walls.append(box(size, center))
    solids = [turned(wall, turn) for wall in ([meshes.join(*walls)] if joined else walls)]
    sun = fb.DirectionalLight(turn @ (0.3, 0.2, -1), angle_deg=3)
    camera = fb.Camera(turn @ (-4.5, -4.5, 1.2), turn @ (3, 3, -1), up=turn[:, 2], fov_deg=80)

    frame = fb.render(fb.Scene(solids, [sun]), camera, size=(64, 48), shadows=shadows, device="cpu")

    assert (frame.object_id >= 0).all()
    assert (frame.shadow == 0).all()


def sheets(mesh: Any, **options: Any) -> int:
    scene = fb.Scene([fb.Instance(mesh, **options)])
    return fb.render(scene, size=(16, 12), device="cpu").report["sheets"]


@pytest.mark.parametrize("make", [meshes.box, meshes.icosphere, meshes.torus, meshes.hollow_sphere, fb.models.gear])
def test_an_ordinary_solid_keeps_the_shadow_of_its_field(make: Callable[[], Any]) -> None:
    assert sheets(fb.as_mesh(make())) == 0


@pytest.mark.parametrize("name", ["stanford-bunny.obj", "suzanne.obj", "spot/spot.obj"])
def test_an_ordinary_model_keeps_the_shadow_of_its_field(name: str, model_path: Callable[[str], Any]) -> None:
    assert sheets(fb.load_mesh(model_path(name))) == 0


def test_a_wall_counts_by_the_voxels_of_its_field() -> None:
    assert sheets(plate(0.05)) == 1
    assert sheets(plate(0.05), resolution=256) == 0


@pytest.mark.parametrize("of_instance", [False, True])
def test_a_thin_solid_that_needs_its_field_warns_with_a_resolution_that_has_its_walls(of_instance: bool) -> None:
    options: dict[str, Any] = {"opacity": 0.5} if of_instance else {"material": fb.Material(color=(1, 1, 1, 0.5))}
    with pytest.warns(fb.SurfaceWarning, match=r"instances\[0\]: .* thinner than 1\.5 voxels") as caught:
        shadow_area(fb.Instance(plate(0.05), **options))
    needed = int(str(caught[0].message).partition("resolution=")[2].partition(")")[0])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        area, _ = shadow_area(fb.Instance(plate(0.05), resolution=needed, **options))

    assert abs(area - SIDE**2 / 2) <= AREA_ERROR


@pytest.mark.parametrize("options", [{"primary": "raymarch"}])
def test_a_picture_of_the_field_of_a_thin_solid_warns(options: dict[str, str]) -> None:
    with pytest.warns(fb.SurfaceWarning, match="thinner than"):
        fb.render(fb.Scene([plate(0.05)]), size=(16, 12), device="cpu", **options)
