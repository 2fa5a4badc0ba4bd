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
    """The area that an instance darkens on a floor under light along the third axis of `turn`, and the frame.

    Soft and area shadows have a light of 5 degrees. The plate and the floor are parallel, so each point of the light
    casts the whole plate, and the penumbra moves no light from one place to another.
    """
    down = -turn[:, 2]
    floor = fb.Instance(fb.box((12, 12, 0.2)).translate((0, 0, -2.4)), pose(turn))
    camera = fb.Camera.orthographic(1.2 * down, 2 * down, up=turn[:, 1], height=HEIGHT)
    options = {"device": "cpu", "shadows": "hard"} | options
    scene = fb.Scene([instance, floor], lights=[fb.DirectionalLight(down, angle_deg=5)])
    frame = fb.render(scene, camera, size=(PIXELS, PIXELS), **options)
    assert (frame.object_id == 1).all()
    return float((1 - frame.shadow).sum()) * (HEIGHT / PIXELS) ** 2, frame


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
@pytest.mark.parametrize("thickness", [0.005, 0.02, 0.05, 0.08, 0.11, 0.2])
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


def closed_room(thickness: float, joined: bool, turn: np.ndarray) -> tuple[list[fb.Mesh], fb.Camera]:
    """Six walls around a space of 10 x 10 x 3, and a camera in it."""
    inside, walls = np.array([10.0, 10.0, 3.0]), []
    for axis, side in np.ndindex(3, 2):
        size, center = inside + 2 * thickness, np.zeros(3)
        size[axis], center[axis] = thickness, (side - 0.5) * (inside[axis] + thickness)
        walls.append(box(size, center))
    camera = fb.Camera(turn @ (-4.5, -4.5, 1.2), turn @ (3, 3, -1), up=turn[:, 2], fov_deg=80)
    return [turned(wall, turn) for wall in ([meshes.join(*walls)] if joined else walls)], camera


def outside_lights(turn: np.ndarray) -> list[Any]:
    """A sun, a ball, a point and a spot light outside a closed room."""
    return [
        fb.DirectionalLight(turn @ (0.3, 0.2, -1), angle_deg=3),
        fb.PointLight(turn @ (2.0, 1.0, 4.0), radius=0.5),
        fb.PointLight(turn @ (-7.0, 2.0, 0.0)),
        fb.SpotLight(turn @ (0.0, -9.0, 0.5), turn @ (0.0, 1.0, 0.0), range=50),
    ]


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("thickness", [0.1, 0.2, 0.5])
def test_no_light_enters_a_closed_room(thickness: float, joined: bool, shadows: str) -> None:
    solids, camera = closed_room(thickness, joined, TURNS[1])
    scene = fb.Scene(solids, outside_lights(TURNS[1]))

    frame = fb.render(scene, camera, size=(64, 48), shadows=shadows, area_samples=16, device="cpu")

    assert (frame.object_id >= 0).all()
    assert (frame.shadow == 0).all()


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("thickness", [0.1, 0.2])
def test_no_indirect_light_enters_a_closed_room(thickness: float, joined: bool) -> None:
    turn = TURNS[1]
    solids, camera = closed_room(thickness, joined, turn)
    lamp = fb.Instance(fb.sphere(0.5).translate(turn @ (2.0, 1.0, 4.0)), material=fb.Material(emission=(9, 9, 9)))
    panel = fb.Mesh(np.array([(-3, -3, 3), (3, -3, 3), (3, 3, 3), (-3, 3, 3)]) @ turn.T, [(0, 2, 1), (0, 3, 2)])
    glow = fb.Instance(panel, material=fb.Material(emission=(9, 9, 9)))
    scene = fb.Scene([*solids, lamp, glow], outside_lights(turn), ambient=1.0)

    frame = fb.render(scene, camera, size=(48, 36), bounces=2, bounce_samples=32, device="cpu")

    assert (frame.object_id >= 0).all()
    assert (frame.color[..., :3] == 0).all()


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
def test_no_light_enters_a_closed_room_on_a_device(shadows: str, gpu: str) -> None:
    solids, camera = closed_room(0.1, False, TURNS[1])
    scene = fb.Scene(solids, outside_lights(TURNS[1]))

    frame = fb.render(scene, camera, size=(32, 24), shadows=shadows, area_samples=4, device=gpu)

    assert frame.report["devices"]["light"] != "cpu"
    assert (frame.shadow == 0).all()


def test_the_reflected_light_beside_a_thin_wall_is_that_of_its_shape() -> None:
    size, center = (0.2, 100.0, 3.0), (0.0, 0.0, 1.5)
    floor = fb.Instance(fb.box((40, 120, 0.2)).translate((0, 0, -0.1)))
    sun = fb.DirectionalLight((-1, 0, -1))
    camera = fb.Camera.orthographic((1.5, 0, 8), (1.5, 0, 0), up=(0, 1, 0), height=2.4)
    pictures = [
        fb.render(
            fb.Scene([wall, floor], [sun], ambient=0),
            camera,
            size=(24, 24),
            bounces=1,
            bounce_samples=256,
            device="cpu",
        )
        for wall in (fb.Mesh(*box(size, center)), fb.box(size).translate(center))
    ]
    on_floor = (pictures[0].object_id == 1) & (pictures[1].object_id == 1)
    mesh, shape = (picture.color[on_floor][:, :3].mean() for picture in pictures)

    assert on_floor.sum() >= 400
    assert abs(mesh - shape) <= 0.03 * shape
    assert np.abs(pictures[0].color - pictures[1].color)[on_floor].max() <= 0.03 * shape


@pytest.mark.parametrize("shadows", ["hard", "area"])
@pytest.mark.parametrize("steps", [1, 2])
def test_a_coarse_smooth_ball_shows_no_facets_where_the_light_grazes_it(steps: int, shadows: str) -> None:
    light = np.array([-1.0, -0.3, -0.2])
    ball = fb.Scene([fb.Mesh(*meshes.icosphere(steps))], [fb.DirectionalLight(light)])
    frame = fb.render(ball, fb.Camera((0, 0, 4), (0, 0, 0), fov_deg=40), size=(96, 96), shadows=shadows, device="cpu")
    cosine = frame.normal @ (-light / np.linalg.norm(light)).astype(np.float32)
    grazed = (frame.object_id == 0) & (cosine > 0) & (cosine < 0.3)

    assert grazed.sum() >= 200
    assert (frame.shadow[grazed] == 1).all()


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


@pytest.mark.parametrize("shadows", ["hard", "soft", "area"])
@pytest.mark.parametrize("of_instance", [False, True])
def test_a_thin_translucent_solid_is_one_layer(of_instance: bool, shadows: str) -> None:
    options: dict[str, Any] = {"opacity": 0.5} if of_instance else {"material": fb.Material(color=(1, 1, 1, 0.5))}

    area, frame = shadow_area(fb.Instance(plate(0.05), **options), shadows=shadows)

    assert abs(area - SIDE**2 / 2) <= AREA_ERROR
    assert frame.shadow.min() == 0.5


def test_a_thin_solid_that_scatters_light_warns_with_a_resolution_that_has_its_walls() -> None:
    material = fb.Material(scattering=0.1)
    with pytest.warns(fb.SurfaceWarning, match=r"instances\[0\]: .* thinner than 1\.5 voxels") as caught:
        shadow_area(fb.Instance(plate(0.05), material=material))
    needed = int(str(caught[0].message).partition("resolution=")[2].partition(")")[0])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        area, _ = shadow_area(fb.Instance(plate(0.05), material=material, resolution=needed))

    assert abs(area - SIDE**2) <= AREA_ERROR


@pytest.mark.parametrize("options", [{"primary": "raymarch"}])
def test_a_picture_of_the_field_of_a_thin_solid_warns(options: dict[str, str]) -> None:
    with pytest.warns(fb.SurfaceWarning, match="thinner than"):
        fb.render(fb.Scene([plate(0.05)]), size=(16, 12), device="cpu", **options)


@pytest.mark.parametrize("width", [10, 1e4, 1e6, 1e9])
@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_a_mesh_shades_a_floor_of_any_width(shadows: str, width: float) -> None:
    corners = np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)])
    ball = fb.sphere(0.5).translate((0, 0.55, 0))
    dark = []
    for occluder, side in ((ball, 10), (ball.to_mesh(48), width)):
        scene = fb.Scene([occluder, fb.Mesh(side * corners, [(0, 2, 1), (0, 3, 2)])], [fb.PointLight((1, 3, 1))])
        camera = fb.Camera((1.5, 2, 3), (0, 0.3, 0))
        frame = fb.render(scene, camera, size=(160, 120), shadows=shadows, device="cpu")
        dark.append((frame.object_id == 1) & (frame.shadow < 0.5))
    assert dark[0].sum() > 300
    # The mesh has a chord error of 1/48 of the ball at most, which moves its outline by less than a pixel.
    assert (dark[0] != dark[1]).sum() <= 0.02 * dark[0].sum()
