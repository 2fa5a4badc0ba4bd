"""Indirect diffuse light and emissive surfaces against a path tracer in float64 and against closed forms."""

from __future__ import annotations

import math
import pickle
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fieldbake as fb
import meshes
from scenes import plane, positions

room = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[2] / "examples" / "room.py")))
PathTracer, Surface, scene_of, CAMERA = room.PathTracer, room.Surface, room.scene_of, room.CAMERA

ABOVE = fb.Camera((0, 30, 0), (0, 0, 0), up=(0, 0, 1), fov_deg=12)
LAMP = fb.PointLight((0.1, 0.45, 0.15), intensity=0.6, range=math.inf)


def errors(surfaces, scene, tracer, bounces, *, size=96, pixels=100, paths=4096, **options):
    """Differences of indirect light at random pixels from the path tracer, relative to its mean, (n, 3)."""
    options = {"size": (size, size), "shadows": "hard", "device": "cpu"} | options
    frame = fb.render(scene, CAMERA, bounces=bounces, **options)
    dark = fb.Scene(scene.instances, scene.lights, ambient=0)
    direct = fb.render(dark, CAMERA, **options).color
    emission = np.array([surface.emission for surface in surfaces])
    seen = frame.object_id >= 0
    chosen = np.random.default_rng(5).choice(np.count_nonzero(seen), pixels, replace=False)
    points, normals = (values[chosen] for values in room.surface_points(frame, CAMERA))
    owner = frame.object_id[seen][chosen]
    albedo = np.array([surface.albedo for surface in surfaces])[owner]
    assert (emission[owner] == 0).all()
    expected = albedo * tracer.indirect(points, normals, bounces, paths, seed=6)
    found = (frame.color - direct)[seen][chosen][:, :3].astype(float)
    return (found - expected) / expected.mean(), found / expected.mean()


def check(errors, mean, beyond):
    """At most these values: the mean of the errors, and the fraction of pixels with an error above 10 %."""
    errors, found = errors
    assert np.isfinite(found).all()
    assert found.mean() == pytest.approx(1, abs=0.02)
    assert np.abs(errors).mean() <= mean
    assert (np.abs(errors).max(axis=1) <= 0.1).mean() >= 1 - beyond


def test_one_bounce_in_a_room_is_that_of_a_path_tracer():
    surfaces = room.room()
    scene, tracer = scene_of(surfaces, [LAMP]), PathTracer(surfaces, [LAMP])

    found = errors(surfaces, scene, tracer, 1)

    # 4,096 random paths have a mean error of 1.5 %, and 256 even ones, interpolated between pixels, one of 2 %.
    check(found, 0.03, 0.05)


def test_colours_bleed():
    surfaces = room.room()
    scene = scene_of(surfaces, [LAMP])

    frame = fb.render(scene, CAMERA, size=(64, 64), bounces=1, device="cpu")

    # The back wall is red near the red wall and green near the green one.
    back = np.where((frame.object_id == 4)[..., None], frame.color[..., :3], np.nan)
    left, right = (np.nanmean(back[20:44, columns], axis=(0, 1)) for columns in (slice(12, 18), slice(46, 52)))
    assert left[0] / left[1] > 1.15 * right[0] / right[1]


def test_two_bounces_of_emission_and_ambient_light_are_those_of_a_path_tracer():
    # A room without a front wall, below a large panel.
    walls = [surface for number, surface in enumerate(room.room()) if number != room.FRONT]
    surfaces = [*walls, room.panel(0.8, (1.0, 0.8, 0.5))]
    scene = scene_of(surfaces, ambient=0.25, hidden=[len(walls)])
    tracer = PathTracer(surfaces, ambient=0.25)

    # The paths of the reference find the panel by chance. With 6,144 of them their noise alone reaches the bounds.
    found = errors(surfaces, scene, tracer, 2, shadows="none", paths=12288)

    check(found, 0.035, 0.06)


def disc(radius, height, corners=128):
    """A disc of triangles that faces down."""
    angle = 2 * np.pi * np.arange(corners) / corners
    rim = np.stack([radius * np.cos(angle), np.full(corners, height), radius * np.sin(angle)], axis=1)
    faces = [(0, 1 + i, 1 + (i + 1) % corners) for i in range(corners)]
    return fb.Mesh(np.concatenate([[(0, height, 0)], rim]), faces)


def share_of_disc(x):
    """Form factor of a disc of radius 0.7 from a parallel plane 1 below, at the distance `x` from its axis."""
    z = x**2 + 1 + 0.7**2
    return (1 - (x**2 + 1 - 0.7**2) / np.sqrt(z**2 - 4 * (0.7 * x) ** 2)) / 2


def share_of_ball(x):
    """Form factor of a ball of radius 0.5 from a plane 1 below its centre."""
    return 0.5**2 / (1 + x**2) ** 1.5


def ball(step=1):
    """A ball of triangles above the floor; with the step -1 the normals point inwards."""
    vertices, faces = meshes.icosphere(4, 0.5, (0, 1, 0))
    return fb.Mesh(vertices, np.asarray(faces)[:, ::step])


#: Each emitter, its form factor, and properties of its material.
EMITTERS = {
    "disc": (lambda: disc(0.7, 1.0), share_of_disc, {}),
    "two-sided disc": (lambda: disc(0.7, 1.0), share_of_disc, {"two_sided": True}),
    "cut-out disc": (lambda: disc(0.7, 1.0), np.zeros_like, {"color": (0, 0, 0, 0.2), "alpha_mode": "mask"}),
    "mesh of a ball": (ball, share_of_ball, {}),
    "two-sided ball": (ball, share_of_ball, {"two_sided": True}),
    "ball wound inside out": (lambda: ball(-1), share_of_ball, {}),
    "translucent ball": (ball, np.zeros_like, {"color": (0, 0, 0, 0.3)}),
    "shape of a ball": (lambda: fb.sphere(0.5).translate((0, 1, 0)), share_of_ball, {}),
    "quadric": (lambda: fb.Quadric.sphere((0, 1, 0), 0.5), share_of_ball, {}),
}


@pytest.mark.parametrize("name", EMITTERS)
def test_emissive_surfaces_light_a_floor_by_their_form_factor(name):
    make, share, look = EMITTERS[name]
    emission, albedo = np.array((2.0, 1.0, 0.5)), np.array((0.9, 0.6, 0.3))
    floor = fb.Instance(plane(4, 0), material=fb.Material(color=albedo, specular=0))
    material = fb.Material(**{"color": (0, 0, 0), "emission": emission, "specular": 0, **look})
    scene = fb.Scene([floor, fb.Instance(make(), material=material, visible=False)], [], ambient=0)

    frame = fb.render(scene, ABOVE, size=(48, 48), bounces=1, bounce_samples=1024, device="cpu")

    points = positions(frame, ABOVE)
    x = np.hypot(points[..., 0], points[..., 2])
    relative = frame.color[..., :3] / (emission * albedo) - share(x)[..., None]
    # At the axis sin^2 of the half angle.
    assert share_of_disc(0.0) == pytest.approx(0.49 / 1.49)
    assert share_of_ball(0.0) == pytest.approx(0.25)
    # Each of 1,024 directions has a weight of 0.001, and up to 10 too many or too few hit the emitter.
    assert np.abs(relative).max() <= 0.01
    # Random directions would have a mean error of about 0.15.
    assert np.abs(relative).mean() <= 0.04 * share(x).mean()


def distance_from_axis(pixels):
    """Distance of the points of a floor below `ABOVE` from its axis, world units, (pixels, pixels)."""
    along = (np.arange(pixels) + 0.5 - pixels / 2) * (2 * 30 * math.tan(math.radians(6)) / pixels)
    return np.hypot(*np.meshgrid(along, along))


def lit_floor(lamp, paths, **options):
    """The reflected light of a lamp on a floor, (h, w)."""
    floor = fb.Instance(plane(4, 0), material=fb.Material(color=(1, 1, 1), specular=0))
    glow = fb.Instance(lamp, material=fb.Material(emission=(1, 1, 1), color=(0, 0, 0)), visible=False)
    scene = fb.Scene([floor, glow], [], ambient=0)
    options = {"size": (40, 40), "bounces": 1, "bounce_samples": paths, "device": "cpu"} | options
    return fb.render(scene, ABOVE, **options).color[..., 0]


#: Emissive objects without faces, and meshes of the same form.
LAMPS = {
    "shape": lambda: (fb.sphere(0.15).translate((0, 1, 0)), meshes.icosphere(3, 0.15, (0, 1, 0))),
    "quadric": lambda: (fb.Quadric.sphere((0, 1, 0), 0.15), meshes.icosphere(3, 0.15, (0, 1, 0))),
    "volume": lambda: (fb.bake(fb.sphere(0.15).translate((0, 1, 0)), 32), meshes.icosphere(3, 0.15, (0, 1, 0))),
    "tube": lambda: (fb.box((2, 0.1, 0.1)).translate((0, 1, 0)), meshes.box((-1, 0.95, -0.05), (1, 1.05, 0.05))),
}


@pytest.mark.parametrize("name", LAMPS)
def test_lamps_without_faces_have_the_noise_of_the_directions_that_miss_them(name):
    lamp, (vertices, faces) = LAMPS[name]()
    mesh = fb.Mesh(vertices, faces)
    truth = lit_floor(mesh, 8192)
    paths = 256
    errors = [(lit_floor(one, paths) - truth) / truth.mean() for one in (lamp, mesh)]
    noise, of_mesh = (np.sqrt(np.mean(error**2)) for error in errors)

    assert abs(errors[0].mean()) <= 0.02
    if name == "tube":
        # It fills its box.
        assert noise <= 1.3 * of_mesh
    else:
        # A ball covers pi / (4 sqrt 3) of its box along a diagonal, and more along other directions. The standard
        # deviation of the number of hits is the one of a binomial distribution.
        hits = math.pi / (4 * math.sqrt(3))
        assert noise <= math.sqrt((1 - hits) / hits / paths)


def test_denoised_light_has_the_mean_of_the_samples_and_a_fraction_of_their_noise():
    lamp = fb.Mesh(*meshes.icosphere(3, 0.15, (0, 1, 0)))
    truth = 0.15**2 / (1 + distance_from_axis(40) ** 2) ** 1.5
    noisy, smooth = (lit_floor(lamp, 32, denoise=denoise) for denoise in (False, True))
    errors = [light / truth - 1 for light in (noisy, smooth)]

    # The mesh of the ball is 1 % smaller than the ball.
    assert abs(noisy.mean() / truth.mean() - 1) <= 0.01
    assert abs(smooth.mean() / noisy.mean() - 1) <= 0.005
    assert errors[1].std() <= errors[0].std()
    assert np.diff(errors[1]).std() <= np.diff(errors[0]).std() / 3
    # Each pixel has paths of its own. The errors of common paths would have a correlation of nearly 1.
    off = errors[0] - errors[0].mean()
    assert abs((off[:, 1:] * off[:, :-1]).mean()) <= 0.5 * off.var()
    # Light with little noise is not made worse.
    precise, filtered = (lit_floor(lamp, 256, denoise=denoise) / truth - 1 for denoise in (False, True))
    assert filtered.std() <= precise.std() <= errors[0].std() / 3


def test_denoised_light_of_a_room_is_nearer_to_the_truth():
    surfaces = [*room.room(), Surface(fb.Mesh(*meshes.icosphere(3, 0.15, (0, 0.6, 0.1))), emission=(9, 9, 9))]
    options = {"size": (32, 32), "bounces": 1, "device": "cpu"}

    def light(paths, denoise):
        frame = fb.render(scene_of(surfaces), CAMERA, bounce_samples=paths, denoise=denoise, **options)
        return frame.color[(frame.object_id >= 0) & (frame.object_id < len(surfaces) - 1)][:, :3].astype(float)

    truth = light(4096, denoise=False)
    noisy, smooth = (light(64, denoise) - truth for denoise in (False, True))

    # The mean of n independent errors has 1 / sqrt(n) of their deviation; five of these are beyond chance.
    rms = np.sqrt(np.mean(noisy**2))
    assert abs(noisy.mean()) <= 5 * rms / math.sqrt(len(noisy))
    assert abs(smooth.mean()) <= 5 * rms / math.sqrt(len(noisy))
    assert np.sqrt(np.mean(smooth**2)) <= rms / 2


def test_rays_that_can_hit_no_emitter_add_no_light():
    ball = Surface(fb.Mesh(*meshes.icosphere(2, 0.15, (0, 0.6, 0.1))), emission=(9, 9, 9))
    bar = fb.Instance(fb.box((0.4, 0.05, 0.05)), material=fb.Material(color=(0, 0, 0), emission=(4, 2, 1)))

    def frame(ambient):
        scene = fb.Scene([*scene_of([*room.room(), ball]).instances, bar], [], ambient=ambient)
        return fb.render(scene, CAMERA, size=(24, 24), bounces=1, bounce_samples=64, device="cpu")

    # Dim surroundings need all rays, and their light is lost in the rounding.
    dark, dim = frame(0), frame(1e-20)
    assert np.array_equal(dark.color, dim.color)
    assert dark.report["rays"] <= 0.9 * dim.report["rays"]


def test_denoised_light_keeps_the_edge_of_a_shadow():
    # Under a luminous strip of the width 0.04 the shadow of the edge of a table ends at x = 0 within a pixel.
    strip = fb.Mesh([(-0.02, 1, -2), (0.02, 1, -2), (0.02, 1, 2), (-0.02, 1, 2)], [(0, 1, 2), (0, 2, 3)])
    top = fb.Mesh([(0, 0.5, -3), (2, 0.5, -3), (2, 0.5, 3), (0, 0.5, 3)], [(0, 2, 1), (0, 3, 2)])
    floor = fb.Instance(plane(4, 0), material=fb.Material(color=(1, 1, 1), specular=0))
    glow = fb.Instance(strip, material=fb.Material(emission=(9, 9, 9)), visible=False)
    table = fb.Instance(top, material=fb.Material(color=(0, 0, 0), specular=0), visible=False)
    scene = fb.Scene([floor, glow, table], [], ambient=0)

    frame = fb.render(scene, ABOVE, size=(64, 64), bounces=1, device="cpu")
    x = positions(frame, ABOVE)[32, :, 0]
    light = frame.color[24:40, :, 0].mean(axis=0)
    pixel = abs(x[1] - x[0])
    beside = [light[(side * x > pixel) & (side * x < 6 * pixel)].mean() for side in (-1, 1)]
    lit, dark = max(beside), min(beside)

    assert dark <= 0.1 * lit
    halfway = np.flatnonzero(np.diff(light > (lit + dark) / 2))
    assert len(halfway) >= 1
    assert np.abs((x[halfway] + x[halfway + 1]) / 2).min() <= pixel


def test_denoised_light_is_the_same_on_any_number_of_threads():
    pictures = []
    for threads in (1, 3):
        fb.set_threads(threads)
        pictures.append(lit_floor(fb.sphere(0.15).translate((0, 1, 0)), 32))
    fb.set_threads(2)
    assert (pictures[0] == pictures[1]).all()


@pytest.mark.parametrize("side", [4.0, 400.0])
def test_a_sheet_near_a_large_floor_lights_it_by_its_form_factor(side):
    above = np.array([(-1, 2, -1), (1, 2, -1), (1, 2, 1), (-1, 2, 1)]) / 4
    panel = fb.Mesh(above, [(0, 1, 2), (0, 2, 3)])
    floor = fb.Instance(plane(side, 0), material=fb.Material(color=(1, 1, 1), specular=0))
    lit = fb.Instance(panel, material=fb.Material(emission=(1, 1, 1), specular=0), visible=False)
    camera = fb.Camera((0, 3, 0), (0, 0, 0), up=(0, 0, 1), fov_deg=1)

    frame = fb.render(fb.Scene([floor, lit], [], ambient=0), camera, size=(8, 8), bounces=1, device="cpu")

    # A square of the side 0.5 at the height 0.5, from the point below its centre.
    expected = 4 / math.tau * 2 * math.sqrt(0.2) * math.atan(math.sqrt(0.2))
    assert np.abs(frame.color[..., :3] - expected).max() <= 0.01


def test_surfaces_beside_unlit_ones_have_their_light():
    # Strips of the floor, lit and unlit in turns, are narrower than the distance between evaluated pixels.
    edges = np.linspace(-2, 2, 49)
    corners = np.array([(x, 0, z) for x in edges for z in (-2, 2)])
    rows = 2 * np.arange(48)
    faces = np.stack([rows, rows + 1, rows + 3, rows, rows + 3, rows + 2], axis=1).reshape(-1, 3)
    strips = faces.reshape(24, 2, 2, 3)
    faces = np.concatenate([strips[:, 0], strips[:, 1]])
    parts = [
        fb.Part("lit", range(48), color=(1, 1, 1, 1)),
        fb.Part("unlit", range(48, 96), color=(1, 0, 0, 1), unlit=True),
    ]
    floor = fb.Instance(fb.Mesh(corners, faces.reshape(-1, 3), parts=parts))

    frame = fb.render(fb.Scene([floor], [], ambient=0.5), ABOVE, size=(256, 256), bounces=1, device="cpu")

    colors = frame.color[frame.object_id == 0][:, :3]
    shows_unlit = np.abs(colors - (1, 0, 0)).max(axis=1) <= 1e-6
    assert 0.3 <= shows_unlit.mean() <= 0.7
    assert np.abs(colors[~shows_unlit] - 0.5).max() <= 0.01


def test_a_convex_object_under_even_light_has_its_albedo_times_the_light():
    ball = fb.Instance(fb.sphere(1.0), material=fb.Material(color=(0.9, 0.6, 0.3), specular=0))
    scene = fb.Scene([ball], [], ambient=0.5)

    frame = fb.render(scene, size=(48, 48), bounces=2, bounce_samples=64, device="cpu")

    assert np.abs(frame.color[frame.object_id == 0][:, :3] - (0.45, 0.3, 0.15)).max() <= 1e-5


def test_surroundings_light_an_open_surface_as_without_bounces():
    image = np.random.default_rng(3).random((4, 8, 3))
    ball = fb.Instance(fb.Mesh(*meshes.icosphere(4)), material=fb.Material(color=(1, 1, 1), specular=0))
    scene = fb.Scene([ball], [], ambient=image)

    plain = fb.render(scene, size=(48, 48), device="cpu")
    bounced = fb.render(scene, size=(48, 48), bounces=1, bounce_samples=1024, device="cpu")

    # A quadratic form is integrated by 1,024 even directions, whose second moments are good to 0.2 %.
    assert np.abs(bounced.color - plain.color).max() <= 0.01
    assert np.ptp(plain.color[plain.object_id == 0][:, 0]) > 0.1


def test_light_that_surfaces_reflect_has_the_colours_of_a_texture():
    # The left half of the wall behind a floor is red, and the right half is blue.
    texels = np.zeros((4, 8, 3), np.uint8)
    texels[:, :4, 0], texels[:, 4:, 2] = 255, 255
    corners = [(-2, 0, -1), (2, 0, -1), (2, 2, -1), (-2, 2, -1)]
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)]
    wall = fb.Mesh(corners, [(0, 1, 2), (0, 2, 3)], uv=uv)
    floor = fb.Instance(plane(1, 0), material=fb.Material(color=(1, 1, 1), specular=0))
    lit = fb.Instance(wall, material=fb.Material(texture=texels, specular=0))
    scene = fb.Scene([floor, lit], [fb.DirectionalLight((0, 0, -1))], ambient=0)

    frame = fb.render(scene, ABOVE, size=(64, 64), bounces=1, device="cpu")

    points = positions(frame, ABOVE)
    for side, channel in ((-1, 0), (1, 2)):
        near = (frame.object_id == 0) & (points[..., 2] < -0.7) & (side * points[..., 0] > 0.7)
        colors = frame.color[near].mean(axis=0)
        assert colors[channel] > 0.2
        assert colors[channel] > 4 * colors[2 - channel]
        assert colors[1] <= 1e-6


def test_surfaces_without_lighting_emit_their_colour_and_glass_lets_light_pass():
    def floor_under(material, **options):
        above = fb.Instance(plane(50, 1), material=material, visible=False)
        floor = fb.Instance(plane(1, 0), material=fb.Material(color=(1, 1, 1), specular=0))
        scene = fb.Scene([floor, above], [], **options)
        return fb.render(scene, ABOVE, size=(8, 8), bounces=1, device="cpu").color[4, 4, :3]

    # All but 1 / 2501 of the light of a hemisphere comes through the plane.
    unlit = floor_under(fb.Material(color=(0.5, 0.25, 0.1), unlit=True), ambient=0)
    assert np.abs(unlit - (0.5, 0.25, 0.1)).max() <= 1e-2
    assert np.abs(floor_under(fb.Material(color=(0, 0, 0, 0.4)), ambient=0.5) - 0.5).max() <= 1e-6
    assert np.abs(floor_under(fb.Material(color=(0, 0, 0, 0.6)), ambient=0.5)).max() <= 1e-2


def test_frames_of_a_renderer_have_bounces():
    scene = scene_of(room.room(), [LAMP], ambient=0.1)
    options = {"size": (48, 36), "bounces": 1, "bounce_samples": 64, "device": "cpu"}

    frame = fb.render(scene, CAMERA, **options)
    renderer = fb.Renderer(scene, **options)
    again = renderer.frame(CAMERA)
    glow = [fb.Material(emission=(1, 1, 1))] + [None] * (len(scene.instances) - 1)
    glowing = renderer.frame(CAMERA, materials=glow)

    assert np.array_equal(again.color, frame.color)
    others = glowing.object_id > 0
    assert glowing.color[others][:, :3].mean() > 1.5 * frame.color[others][:, :3].mean()
    assert np.array_equal(renderer.frame(CAMERA).color, frame.color)
    assert frame.report["milliseconds"]["bounces"] > 0
    assert "bounces" not in fb.render(scene, CAMERA, size=(8, 8), device="cpu").report["milliseconds"]


def test_several_samples_for_each_pixel_agree_with_a_large_picture():
    scene = scene_of(room.room(), [LAMP])
    options = {"bounces": 1, "shadows": "hard", "device": "cpu"}

    small = fb.render(scene, CAMERA, size=(48, 48), samples=4, **options).color[..., :3]
    large = fb.render(scene, CAMERA, size=(96, 96), **options).color[..., :3]

    mean = large.reshape(48, 2, 48, 2, 3).mean(axis=(1, 3))
    # Edges of shadows differ by the positions of the samples.
    assert np.median(np.abs(small - mean)) <= 0.01 * mean.mean()
    assert np.abs(small - mean).mean() <= 0.03 * mean.mean()


def test_all_devices_draw_the_same_bounces(device):
    scene = scene_of(room.room(), [LAMP], ambient=0.1)
    options = {"size": (64, 64), "bounces": 1, "bounce_samples": 64}

    expected = fb.render(scene, CAMERA, device="cpu", **options)
    found = fb.render(scene, CAMERA, device=device, **options)

    differs = np.abs(found.image.astype(int) - expected.image.astype(int)).max(axis=-1) > 1
    assert differs.mean() <= 0.005


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("bounces", {"bounces": -1}),
        ("bounces", {"bounces": 5}),
        ("bounces", {"bounces": 0.5}),
        ("bounces", {"bounces": "1"}),
        ("bounces", {"bounces": None}),
        ("bounce_samples", {"bounces": 1, "bounce_samples": 0}),
        ("bounce_samples", {"bounces": 1, "bounce_samples": 1e9}),
        ("ambient_occlusion", {"bounces": 1, "ambient_occlusion": True}),
    ],
)
def test_unusable_bounces_are_refused(name, options):
    with pytest.raises(fb.SceneError, match=name):
        fb.render(fb.sphere(), size=(8, 8), device="cpu", **options)


def test_more_emissive_faces_than_memory_are_refused_with_their_size():
    # A sheet of a million faces, 40,000 times.
    side = 708
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1), indexing="ij")
    corners = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = [corners + np.array(offsets)[:, None] for offsets in ((0, 1, side + 2), (0, side + 2, side + 1))]
    sheet = fb.Mesh(np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3), np.concatenate(faces, axis=1).T)
    scene = fb.Scene([fb.Instance(sheet, material=fb.Material(emission=(1, 1, 1)))] * 40_000, [])
    count = 40_000 * len(sheet.faces)

    # An entry of 16 bytes before and after it is sorted with a key of 8, an index, and two nodes for a face.
    needed = (16 + 24 + 4) * count + 2 * 88 * count
    with pytest.raises(fb.CapacityError, match=rf"{count} emissive faces needs {needed} bytes .*bounces"):
        fb.render(scene, ABOVE, size=(2, 2), bounces=1, device="cpu")


def test_the_heat_map_of_rays_counts_those_of_each_pixel(device):
    scene = scene_of(room.room(), [LAMP], ambient=0.1)
    occluded = fb.render(scene, CAMERA, size=(32, 24), ambient_occlusion=True, device=device)
    bounced = fb.render(scene, CAMERA, size=(32, 24), bounces=1, bounce_samples=16, device=device)

    for frame in (occluded, bounced):
        assert (frame.rays.shape, frame.rays.dtype) == ((24, 32), np.uint32)
        assert frame.rays.sum() == frame.report["rays"]
        assert frame.heatmap("rays").shape == (24, 32, 3)
        assert np.array_equal(pickle.loads(pickle.dumps(frame)).rays, frame.rays)
        with pytest.raises(ValueError, match="read-only"):
            frame.rays[0, 0] = 1
    # Each evaluated pixel has 16 paths of at least two rays.
    evaluated = bounced.rays >= 32
    assert 0.1 < evaluated.mean() < 1


def test_pictures_without_counted_rays_have_no_heat_map_of_them():
    frame = fb.raymarch(fb.sphere(), size=(8, 8), device="cpu")

    assert frame.rays is None
    with pytest.raises(fb.ArgumentError, match="render"):
        frame.heatmap("rays")
