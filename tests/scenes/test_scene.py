"""Scenes: visible surfaces against other renderers, shadows against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import exceeds
from scenes import SUN, disc_share, miss_distance, moved, plane, positions


def over_plane(light, shadows="soft", scale=1.0, size=(160, 120), resolution=64, lift=0.6, **options):
    """A sphere of radius 1 over a plane, seen from above, both times `scale`."""
    ball = fb.Mesh(*meshes.icosphere(4))
    zoom = np.diag([scale, scale, scale, 1.0])
    scene = fb.Scene(
        [fb.Instance(ball, zoom @ moved(y=lift), resolution=resolution), fb.Instance(plane(), zoom)], lights=[light]
    )
    camera = fb.Camera(np.array([2.5, 7.0, 5.0]) * scale, np.array([0.6, -1.0, 0.2]) * scale, fov_deg=40)
    frame = fb.render(scene, camera, size=size, shadows=shadows, device="cpu", **options)
    return frame, camera


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_the_hard_shadow_of_a_sphere_is_the_closed_form(scale: float) -> None:
    frame, camera = over_plane(fb.DirectionalLight(SUN), "hard", scale)
    on_plane = frame.object_id == 1
    p = positions(frame, camera) / scale
    to_light = -np.array(SUN) / np.linalg.norm(SUN)
    dark = miss_distance(p, np.array([0, 0.6, 0]), to_light) < 1
    assert (frame.shadow[on_plane] == np.where(dark, 0, 1)[on_plane]).mean() > 0.995
    # No acne: the side of the sphere that faces the light is lit.
    n_l = frame.normal @ to_light.astype(np.float32)
    cap = (frame.object_id == 0) & (n_l > 0.05)
    assert cap.sum() > 500
    assert (frame.shadow[cap] == 1).all()


@pytest.mark.parametrize(("angle_deg", "scale"), [(2.0, 1.0), (6.0, 1.0), (15.0, 1.0), (6.0, 0.01), (6.0, 100.0)])
def test_penumbrae_are_as_wide_as_the_light_is_large(angle_deg: float, scale: float) -> None:
    light = fb.DirectionalLight(SUN, angle_deg=angle_deg)
    soft, camera = over_plane(light, "soft", scale)
    area, _ = over_plane(light, "area", scale)
    on_plane = soft.object_id == 1
    p = positions(soft, camera) / scale
    to_light = -np.array(SUN) / np.linalg.norm(SUN)
    center = np.array([0, 0.6, 0])
    rmse = np.sqrt(((soft.shadow - area.shadow)[on_plane] ** 2).mean())
    assert rmse < 0.05
    # Truth: the share of the light's disc not behind the sphere's, by counting directions.
    truth = disc_share(p[on_plane], center, 1.0, to_light, np.tan(np.radians(angle_deg / 2)))
    assert np.sqrt(((soft.shadow[on_plane] - truth) ** 2).mean()) < 0.05
    # The area of partial shadow measures the width; 5 % to 95 %, as the last bits have long tails.
    partial = lambda share: ((share > 0.05) & (share < 0.95)).sum()  # noqa: E731
    assert partial(soft.shadow[on_plane]) == pytest.approx(partial(truth), rel=0.15)


def test_a_point_light_with_a_radius() -> None:
    light = fb.PointLight((2.0, 5.0, 1.0), radius=0.4)
    soft, _ = over_plane(light, "soft")
    area, _ = over_plane(light, "area")
    on_plane = soft.object_id == 1
    assert np.sqrt(((soft.shadow - area.shadow)[on_plane] ** 2).mean()) < 0.03
    hard, _ = over_plane(fb.PointLight((2.0, 5.0, 1.0)), "soft")
    assert set(np.unique(hard.shadow[on_plane])) == {0.0, 1.0}


@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_a_closed_room_is_dark(shadows: str) -> None:
    # Walls of 2 voxels: 64 voxels over 4.4 units, 0.1375 thick.
    voxel = 4.4 / 64
    walls = meshes.join(
        meshes.box((-2, -2, -2), (2, 2, 2)),
        meshes.flip(meshes.box(*np.array([[-1], [1]]) * (2 - 2 * voxel) * np.ones(3))),
    )
    room = fb.Instance(fb.Mesh(*walls), resolution=64)
    lights = [fb.DirectionalLight(SUN, angle_deg=5), fb.PointLight((6, 7, 5), radius=0.5)]
    scene = fb.Scene([room], lights=lights)
    frame = fb.render(
        scene, fb.Camera((1.2, 0.9, 1.5), (-1, -0.8, -1), fov_deg=80), size=(96, 72), shadows=shadows, device="cpu"
    )
    assert np.isfinite(frame.depth).all()
    assert frame.shadow.shape == (72, 96, 2)
    assert frame.shadow.max() == 0


TRANSFORMS = {
    "rotated": moved(turn=0.7),
    "scaled": moved(scale=(1.6, 1.6, 1.6)),
    "not uniform": moved(scale=(1.4, 0.6, 1.0), turn=0.4),
    "mirrored": moved(scale=(-1.0, 1.0, 1.2), turn=-0.3),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_an_instance_is_the_mesh_transformed_and_baked_anew(name: str) -> None:
    matrix = moved(y=0.9) @ TRANSFORMS[name]
    knot = fb.models.torus_knot(segments=160, sides=16)
    anew = fb.as_mesh((knot, matrix))
    camera = fb.Camera((3, 5, 5), (0, 0, 0), fov_deg=50)
    pictures = []
    for thing, transform in ((knot, matrix), (anew, np.eye(4))):
        instance = fb.Instance(thing, transform, resolution=96)
        scene = fb.Scene([instance, plane()], lights=[fb.DirectionalLight(SUN, angle_deg=3)])
        pictures.append(fb.render(scene, camera, size=(128, 96), device="cpu"))
    a, b = pictures
    assert (a.object_id == b.object_id).all()
    np.testing.assert_allclose(a.depth, b.depth, equal_nan=False, rtol=1e-6)
    if name in ("rotated", "scaled"):
        np.testing.assert_allclose(a.normal, b.normal, equal_nan=False, atol=2e-3)
    else:
        # Means of normals, and which edges are sharp, depend on the shape.
        agree = (a.normal * b.normal).sum(-1)[a.object_id == 0]
        assert (agree > 0.95).mean() > 0.97
    assert exceeds(np.abs(a.shadow - b.shadow), 0.25).mean() < 0.02
    # Seen through their fields they are the same too, but for the silhouette.
    marched = fb.render(
        fb.Scene([fb.Instance(knot, matrix, resolution=96)]),
        camera,
        size=(128, 96),
        primary="raymarch",
        shadows="none",
        device="cpu",
    )
    both = (marched.object_id == 0) & (a.object_id == 0)
    assert both.sum() > 0.97 * (a.object_id == 0).sum()
    voxel = np.ptp(anew.bounds, axis=0).max() / 90
    assert (np.abs(marched.depth[both] - a.depth[both]) < 1.5 * voxel).mean() > 0.98


def test_lit_surfaces_follow_blinn_phong() -> None:
    spot = fb.models.torus_knot(segments=160, sides=16)
    material = fb.Material(color=(0.8, 0.3, 0.1), specular=0.6, shininess=20)
    lights = [fb.DirectionalLight(SUN, (1.0, 0.9, 0.7), 0.8), fb.PointLight((3, 2, 4), intensity=0.5)]
    scene = fb.Scene([fb.Instance(spot, material=material)], lights=lights, ambient=0.15)
    camera = fb.Camera((2, 2, 5), (0, 0, 0))
    frame = fb.render(scene, camera, size=(128, 96), shadows="hard", exposure=1.3, device="cpu")
    hit = frame.object_id == 0
    n, p = frame.normal[hit].astype(np.float64), positions(frame, camera)[hit]
    v = camera.eye - p
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    color = 0.15 * np.array(material.color[:3]) * np.ones((len(p), 1))
    ways = [np.broadcast_to(-np.array(lights[0].direction), p.shape), np.array(lights[1].position) - p]
    for number, (light, way) in enumerate(zip(lights, ways, strict=True)):
        l = way / np.linalg.norm(way, axis=1, keepdims=True)
        h = (l + v) / np.linalg.norm(l + v, axis=1, keepdims=True)
        cosine = (n * l).sum(1).clip(0)
        highlight = 0.6 * (n * h).sum(1).clip(0) ** 20 * (cosine > 0)
        response = cosine[:, None] * np.array(material.color[:3]) + highlight[:, None]
        color += frame.shadow[hit][:, number, None] * np.array(light.color) * light.intensity * response
    np.testing.assert_allclose(frame.color[hit][:, :3], 1.3 * color, equal_nan=False, atol=1e-4)
    behind = 1.3 * np.array([0.025, 0.03, 0.04])
    np.testing.assert_allclose(
        frame.color[~hit][:, :3], np.broadcast_to(behind, (int((~hit).sum()), 3)), equal_nan=False, rtol=1e-6
    )


def test_raster_is_what_rays_through_the_triangles_find(random) -> None:
    knot = fb.models.torus_knot(segments=120, sides=12)
    camera = fb.Camera((1.5, 2, 4.5), (0, 0, 0))
    frame = fb.render(fb.Scene([knot]), camera, size=(64, 48), shadows="none", device="cpu")
    far = positions(
        fb.Frame(
            {
                **{n: np.array(getattr(frame, n)) for n in ("color", "normal", "object_id", "shadow", "steps")},
                "depth": np.ones((48, 64), np.float32),
            },
            {},
        ),
        camera,
    )
    rays = (far - camera.eye).reshape(-1, 3)
    found, index, _ = knot.to_trimesh().ray.intersects_location(
        np.broadcast_to(camera.eye, rays.shape), rays, multiple_hits=False
    )
    depth = np.full(64 * 48, np.inf)
    depth[index] = ((found - camera.eye) * -camera.pose[:3, 2]).sum(1)
    same = np.isclose(frame.depth.ravel(), depth, atol=1e-4 * 6) | (np.isinf(depth) & np.isinf(frame.depth.ravel()))
    assert same.mean() > 0.998


def test_mixed_scenes_compose_by_depth() -> None:
    ball = fb.bake(meshes.icosphere(4), 64, device="cpu")
    box = fb.Mesh(*meshes.box((-0.6, -0.6, -0.6), (0.6, 0.6, 0.6)))
    scene = fb.Scene([fb.Instance(ball), fb.Instance(box, moved(x=0.9)), fb.Instance(ball, moved(x=-2.5))])
    camera = fb.Camera((0, 0, 8), (-0.5, 0, 0), fov_deg=35)
    frame = fb.render(scene, camera, size=(120, 90), device="cpu")
    p = positions(frame, camera)
    for number, inside in (
        (0, lambda q: np.abs(np.linalg.norm(q, axis=1) - 1) < 0.01),
        (1, lambda q: np.abs(np.abs(q - (0.9, 0, 0)).max(axis=1) - 0.6) < 1e-5),
        (2, lambda q: np.abs(np.linalg.norm(q - (-2.5, 0, 0), axis=1) - 1) < 0.01),
    ):
        assert (frame.object_id == number).sum() > 150
        assert inside(p[frame.object_id == number]).all()
    # Where both are hit, the nearer one is seen: the box's right half sticks out of the ball.
    assert p[frame.object_id == 1][:, 0].max() == pytest.approx(1.5, abs=0.06)  # a pixel there


def test_textures_masks_and_blending() -> None:
    quad = ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)]
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, 0] = 255, 0, 0, 255
    pixels[0, 1] = 0, 255, 0, 255
    pixels[1, 0] = 0, 0, 255, 255
    pixels[1, 1] = 255, 255, 255, 0
    picture = fb.Mesh(*quad, uv=uv, texture=pixels)
    camera = fb.Camera((0, 0, 3), (0, 0, 0), fov_deg=40)

    def look(**kw):
        material = fb.Material(texture=pixels, **kw)
        scene = fb.Scene([fb.Instance(picture, material=material)], lights=[], ambient=1.0, background=(0, 0, 0, 0))
        return fb.render(scene, camera, size=(64, 64), device="cpu", shadows="none")

    opaque = look(alpha_mode="opaque")
    # The corner texels' centres are at a quarter and three quarters of the quad.
    at = lambda frame, u, v: frame.color[int(32 - (v - 0.5) * 58.6), int(32 + (u - 0.5) * 58.6)]  # noqa: E731
    assert at(opaque, 0.25, 0.75)[:3] == pytest.approx((1, 0, 0), abs=0.05)
    assert at(opaque, 0.75, 0.75)[:3] == pytest.approx((0, 1, 0), abs=0.05)
    assert at(opaque, 0.25, 0.25)[:3] == pytest.approx((0, 0, 1), abs=0.05)
    masked = look(alpha_mode="mask")
    assert at(masked, 0.75, 0.25).tolist() == [0, 0, 0, 0]
    assert at(masked, 0.25, 0.25)[3] == 1
    blended = look(alpha_mode="blend")
    assert 0.2 < at(blended, 0.5, 0.25)[3] < 0.8
    assert at(blended, 0.78, 0.25)[3] < 0.1


def test_opacity_takes_its_share_of_light_and_sight() -> None:
    glass = fb.Instance(
        fb.Mesh(*meshes.icosphere(3)), moved(y=1), opacity=0.4, material=fb.Material(color=(1, 0, 0), specular=0)
    )
    scene = fb.Scene([glass, plane()], lights=[fb.DirectionalLight((0, -1, 0))], ambient=0)
    frame = fb.render(
        scene, fb.Camera((0.01, 9, 3), (0, -1, 0), fov_deg=40), size=(96, 96), shadows="hard", device="cpu"
    )
    shadows = np.unique(frame.shadow[frame.object_id == 1].round(4))
    assert shadows.tolist() == pytest.approx([0.6, 1.0])
    # The pixel belongs to what is behind: less than half is kept.
    assert set(np.unique(frame.object_id)) == {1}
    assert frame.color[48, 48, 0] > frame.color[48, 48, 1]


def test_flags() -> None:
    ball = fb.Mesh(*meshes.icosphere(3))

    def look(**kw):
        scene = fb.Scene([fb.Instance(ball, moved(y=1), **kw), plane()], lights=[fb.DirectionalLight((0, -1, 0))])
        return fb.render(scene, fb.Camera((0, 6, 6), (0, 0, 0)), size=(64, 48), shadows="hard", device="cpu")

    ghost = look(casts_shadow=False)
    assert (ghost.object_id == 0).any()
    assert (ghost.shadow[ghost.object_id == 1] == 1).all()
    hidden = look(visible=False)
    assert not (hidden.object_id == 0).any()
    assert (hidden.shadow == 0).any()


def test_samples_smooth_the_edges_alone() -> None:
    scene = fb.Scene([fb.Mesh(*meshes.box())], lights=[], background=(0, 0, 0))
    camera = fb.Camera((3, 2, 5), (0, 0, 0))
    plain, smooth = (fb.render(scene, camera, size=(40, 30), samples=n, device="cpu") for n in (1, 4))
    assert np.array_equal(plain.depth, smooth.depth)
    inside = np.unique(plain.color[..., 0])
    assert len(inside) == 2
    assert len(np.unique(smooth.color[..., 0].round(5))) == 5


def test_samples_share_the_light_that_pixels_found() -> None:
    light = fb.DirectionalLight(SUN, angle_deg=6)
    smooth, _ = over_plane(light, samples=4)
    # Four samples a pixel are the pixels of a picture of twice the size.
    large, _ = over_plane(light, size=(320, 240))
    exact = large.color.reshape(120, 2, 160, 2, 4).mean(axis=(1, 3))
    off = np.abs(smooth.color - exact).max(axis=-1)
    # Values are shared where neighbours agree to 1/8, and interpolated there: a sixteenth of that is the usual error.
    assert exceeds(off, 2 / 255).mean() < 0.01
    assert off.mean() < 1e-3
    assert smooth.steps.mean() < 1.01 * large.steps.mean()


@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_shadows_end_at_the_surface_of_a_field_of_any_values(shadows: str) -> None:
    ball = fb.bake(fb.Mesh(*meshes.icosphere(4)), 32)
    # Steps by such values would cross the ball. A factor of 4 keeps the bits of the surface.
    steep = fb.Volume(4 * ball.distances, ball.bounds, inner_bounds=ball.inner_bounds)
    camera = fb.Camera((2.5, 7.0, 5.0), (0.6, -1.0, 0.2), fov_deg=40)
    frames = []
    for field in (ball, steep):
        scene = fb.Scene([fb.Instance(field, moved(y=0.6)), plane()], lights=[fb.DirectionalLight(SUN, angle_deg=2)])
        frames.append(fb.render(scene, camera, size=(160, 120), shadows=shadows, device="cpu"))
    umbra = (frames[0].object_id == 1) & (frames[0].shadow == 0)
    assert umbra.sum() > 100
    assert (frames[1].shadow[umbra] == 0).all()
    if shadows == "hard":
        assert np.array_equal(frames[0].shadow, frames[1].shadow)


def test_hard_shadows_of_a_field_that_is_steep_along_diagonals() -> None:
    # Neighbouring samples along the axes differ as those of a distance, but the slope across a face is sqrt(3).
    x, y, z = np.meshgrid(*[(np.arange(64) + 0.5) / 32 - 1] * 3, indexing="ij")
    steep = (np.abs(x) + np.abs(y) + np.abs(z) - 0.6).T.astype(np.float32)
    camera = fb.Camera((0.4, 5.0, 3.0), (0.4, -1.0, 0.0), fov_deg=40)
    frames = []
    for values in (steep, steep / 2):
        field = fb.Volume(values, [(-1, -1, -1), (1, 1, 1)])
        scene = fb.Scene([fb.Instance(field), plane(y=-0.7)], lights=[fb.DirectionalLight((1.0, -1.0, 0.0))])
        frames.append(fb.render(scene, camera, size=(240, 180), shadows="hard", device="cpu"))
    assert (frames[0].shadow[frames[0].object_id == 1] == 0).sum() > 500
    assert np.array_equal(frames[0].shadow, frames[1].shadow)


@pytest.mark.parametrize("seed", range(4))
def test_a_tiny_light_casts_the_shadows_of_a_point(seed: int) -> None:
    # Rods, balls and walls of 0.1 to 2 voxels. Cones of 1e-4 radians walk past them by distances.
    random = np.random.default_rng(seed)
    voxel = 2.4 / 48
    parts = []
    for _ in range(24):
        size, place = voxel * random.uniform(0.1, 2), random.uniform(-0.9, 0.9, 3).tolist()
        shapes = (fb.sphere(size), fb.cylinder(size, 1.2), fb.box((1, size, 1)))
        part = shapes[random.integers(3)].rotate(random.normal(size=3).tolist(), random.uniform(0, 360))
        parts.append(part.translate(place))
    field = fb.bake(parts[0].union(*parts[1:]), 48, bounds=[(-1.2,) * 3, (1.2,) * 3])
    frames = {}
    for shadows in ("hard", "soft"):
        light = fb.DirectionalLight(SUN, angle_deg=0.01)
        scene = fb.Scene([fb.Instance(field, moved(y=0.4)), plane()], lights=[light])
        camera = fb.Camera((1.5, 6.0, 4.0), (0.6, -1.0, 0.2), fov_deg=50)
        frames[shadows] = fb.render(scene, camera, size=(160, 120), shadows=shadows, device="cpu")
    on_plane = frames["hard"].object_id == 1
    hard, soft = (frames[shadows].shadow[on_plane] for shadows in ("hard", "soft"))
    assert (hard == 0).sum() > 100
    # On the plane, the disc of the light is a hundredth of a voxel wide, so that few pixels lie on an edge.
    assert exceeds(np.abs(hard - soft), 0.01).sum() <= 4


@pytest.mark.parametrize("shadows", ["hard", "soft"])
def test_light_at_half_resolution_keeps_edges(shadows: str) -> None:
    light = fb.DirectionalLight(SUN, angle_deg=6)
    full, _ = over_plane(light, shadows)
    half, _ = over_plane(light, shadows, light_scale=2)
    assert np.array_equal(full.depth, half.depth)
    off = np.abs(full.shadow - half.shadow)
    assert exceeds(off, 1 / 8).mean() < 0.005
    assert off.mean() < 2e-3
    # Rays start at a quarter of the pixels and at the edges: a cone and its 16 parts in the penumbra, one ray at hard
    # edges and silhouettes, which are fewer than a hundredth of the pixels.
    penumbra = ((full.shadow > 0) & (full.shadow < 1)).sum()
    assert half.report["rays"] <= full.report["rays"] / 4 + 17 * penumbra + half.shadow.size / 100


def test_ambient_occlusion_darkens_corners() -> None:
    room = meshes.join(plane_arrays(), meshes.box((-3, -1, -3.2), (3, 3, -3)))
    scene = fb.Scene([fb.Instance(fb.Mesh(*room), resolution=96)], lights=[], ambient=1.0)
    camera = fb.Camera((0, 3, 6), (0, 0, -2))
    frame = fb.render(scene, camera, size=(64, 48), ambient_occlusion=1.5, device="cpu")
    p = positions(frame, camera)
    floor = (np.abs(p[..., 1] + 1) < 1e-3) & (np.abs(p[..., 0]) < 2)
    light = frame.color[..., 0]
    near, far = floor & (p[..., 2] < -2.7), floor & (p[..., 2] > -1)
    # A wall takes half of the sky of a floor at its foot; a floor in the open sees all of it.
    assert light[far].mean() == pytest.approx(0.8, rel=0.05)
    assert 0.3 * 0.8 < light[near].mean() < 0.8 * 0.8


def plane_arrays():
    return meshes.box((-3, -1.3, -3), (3, -1, 3))


def test_light_scatters_through_thin_parts() -> None:
    slab = lambda z: fb.Mesh(*meshes.box((-1, -1, -z), (1, 1, z)))  # noqa: E731
    glow = []
    for half in (0.1, 0.2, 0.4):
        material = fb.Material(color=(1, 1, 1), scattering=0.3, specular=0)
        scene = fb.Scene(
            [fb.Instance(slab(half), material=material, resolution=96)],
            lights=[fb.DirectionalLight((0, 0, 1))],
            ambient=0,
        )
        frame = fb.render(scene, fb.Camera((0, 0, 4), (0, 0, 0)), size=(33, 33), device="cpu")
        glow.append(frame.color[16, 16, 0])
    # Against the light: exp(-thickness / 0.3).
    np.testing.assert_allclose(glow, np.exp(-2 * np.array([0.1, 0.2, 0.4]) / 0.3), equal_nan=False, rtol=1e-3)


@pytest.mark.parametrize("unit", [1e-7, 1e-3, 1e5, 1e9, 1e12])
def test_a_picture_does_not_depend_on_the_unit(unit: float, device: str) -> None:
    def picture(unit: float) -> np.ndarray:
        vertices, faces = meshes.icosphere(3)
        wide = fb.Mesh(plane().vertices.astype(np.float64) * unit, plane().faces)
        lights = [
            fb.DirectionalLight(SUN, angle_deg=3),
            fb.PointLight((3 * unit, 4 * unit, 2 * unit), radius=0.3 * unit),
        ]
        jade = fb.Material(color=(0.5, 0.9, 0.6), scattering=0.3 * unit)
        things = [fb.Instance(fb.Mesh(vertices * unit, faces), material=jade), wide]
        camera = fb.Camera((4 * unit, 3 * unit, 6 * unit), (0, -0.5 * unit, 0))
        scene = fb.Scene(things, lights=lights)
        return fb.render(scene, camera, size=(60, 45), ambient_occlusion=2 * unit, device=device).color

    one, other = picture(1.0), picture(unit)
    # Only what rounding turns, at silhouettes.
    assert (~(np.abs(one - other) <= 1 / 255)).any(axis=-1).sum() <= 3


def test_a_box_on_a_floor_has_no_dark_row_at_its_foot() -> None:
    box, floor = fb.Mesh(*meshes.box((-1, -1, -1), (1, 1, 1))), plane()
    scene = fb.Scene([box, floor], lights=[fb.DirectionalLight((-1, -2, -0.6), angle_deg=3)])
    camera = fb.Camera((2, 2, 7), (0, -0.5, 0), fov_deg=30)
    frame = fb.render(scene, camera, size=(960, 720), device="cpu")
    front = (frame.object_id == 0) & (np.abs(positions(frame, camera)[..., 2] - 1) < 1e-6)
    # Within half the thickness of the floor's field, 2e-5, the foot is dark: a pixel in 500 columns sees that.
    assert front.sum() > 10_000
    assert (~(frame.shadow[front] >= 1)).sum() <= 3


def test_the_articles_march_is_there_to_compare() -> None:
    frame, camera = over_plane(fb.DirectionalLight(SUN), "hard")
    ball = fb.Mesh(*meshes.icosphere(4))
    scene = fb.Scene([fb.Instance(ball, moved(y=0.6)), plane()], lights=[fb.DirectionalLight(SUN)])
    article = fb.render(scene, camera, size=frame.size, shadows="hard", method="article", device="cpu")
    assert (frame.shadow == article.shadow).mean() > 0.9
    assert article.steps.mean() > 3 * frame.steps.mean()


def test_what_makes_no_sense_is_refused() -> None:
    ball = fb.Mesh(*meshes.icosphere(1))
    scene = fb.Scene([ball])
    singular = np.diag([1.0, 0.0, 1.0, 1.0])
    cases = [
        (lambda: fb.Scene([]), "empty"),
        (lambda: fb.Scene(ball), "instances: must be a list"),
        (lambda: fb.Instance(ball, singular), "transform: cannot be undone"),
        (lambda: fb.Instance(ball, np.full((4, 4), np.nan)), "transform: must be finite"),
        (lambda: fb.Instance(ball, opacity=2), "opacity"),
        (lambda: fb.Instance(ball, material="red"), "material: must be a Material"),
        (lambda: fb.Material(color=(1, 2)), "color"),
        (lambda: fb.Material(alpha_mode="cut"), "alpha_mode"),
        (lambda: fb.Material(texture=np.zeros((2, 2))), "texture"),
        (lambda: fb.Material(scattering=-1), "scattering"),
        (lambda: fb.Scene([ball], lights=[fb.DirectionalLight(SUN)] * 17), "at most 16"),
        (lambda: fb.Scene([ball], lights=["sun"]), r"lights\[0\]"),
        (lambda: fb.Scene([ball], ambient=-1), "ambient"),
        (lambda: fb.Scene([ball], background=(1, 2)), "background"),
        (lambda: fb.render(scene, "front"), "camera: must be a Camera"),
        (lambda: fb.Camera((np.nan, 0, 0), (1, 1, 1)), "eye: must be finite"),
        (lambda: fb.render(scene, size=(0, 10)), "size"),
        (lambda: fb.render(scene, primary="fast"), "primary"),
        (lambda: fb.render(scene, shadows="blurry"), "shadows"),
        (lambda: fb.render(scene, method="other"), "method"),
        (lambda: fb.render(scene, samples=3, device="cpu"), "samples"),
        (lambda: fb.render(scene, light_scale=3), "light_scale"),
        (lambda: fb.render(scene, exposure=-1), "exposure"),
        (lambda: fb.render(scene, ambient_occlusion=-1), "ambient_occlusion"),
        (
            lambda: fb.render(fb.Scene([fb.bake(ball, 8, device="cpu")]), primary="raster", device="cpu"),
            "has no triangles",
        ),
    ]
    for call, message in cases:
        with pytest.raises(fb.SceneError, match=message):
            call()
    with pytest.raises(fb.MeshError):
        fb.Instance("nowhere.obj" if False else ([], []))


def test_fields_are_kept_by_content(tmp_path, monkeypatch) -> None:
    from fieldbake.scenes import field_cache as fields

    fields.clear()
    monkeypatch.setattr(fields, "_disk", None)
    monkeypatch.setenv("FIELDBAKE_CACHE", str(tmp_path))
    ball, same, other = (fb.Mesh(*meshes.icosphere(2, radius)) for radius in (1.0, 1.0, 1.5))
    first = fields.of_mesh(ball, 16, "cpu")
    assert fields.of_mesh(same, 16, "cpu") is first
    assert fields.of_mesh(other, 16, "cpu") is not first
    assert fields.of_mesh(ball, 24, "cpu") is not first
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 3
    # Another process finds it on disk; a damaged file is baked again.
    fields.clear()
    monkeypatch.setattr(fields, "bake_for_scene", lambda *_: pytest.fail("baked although it is on disk"))
    fields.of_mesh(ball, 16, "cpu")
    fields.clear()
    for file in files:
        file.write_bytes(b"damaged")
    with pytest.raises(pytest.fail.Exception):
        fields.of_mesh(ball, 16, "cpu")
    fields.clear()


def test_a_leaf_card_casts_the_shadow_of_a_leaf(model_path) -> None:
    plant = fb.load_scene(model_path("foliage_cards.glb"))
    bounds = plant.bounds
    size, center = np.ptp(bounds, axis=0).max(), bounds.mean(axis=0)
    ground = bounds[0, 1] - 0.02 * size
    sun = np.array((-0.4, -1.0, -0.3))
    foot = center + sun * (center[1] - ground)
    floor = fb.Instance(plane(3 * size, ground))
    unseen = [fb.Instance(item.thing, item.transform, visible=False) for item in plant.instances]
    scene = fb.Scene([*unseen, floor], lights=[fb.DirectionalLight(sun)])
    above = np.array((0, 3 * size, 0.001))
    camera = fb.Camera(foot + above, foot, fov_deg=40)
    frame = fb.render(scene, camera, size=(96, 96), shadows="hard", device="cpu")
    points = positions(frame, camera).reshape(-1, 3)
    leaves = np.zeros(len(points), bool)
    for item in plant.instances:
        leaves |= masked_hits(item.thing, np.asarray(item.transform), points, -sun)
    dark = frame.shadow.ravel() == 0
    assert dark.sum() == pytest.approx(leaves.sum(), rel=0.1)
    assert (dark == leaves).mean() > 0.97


def masked_hits(mesh: fb.Mesh, transform: np.ndarray, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Test which rays hit a triangle at a texel that its mask keeps."""
    import trimesh

    vertices = mesh.vertices @ transform[:3, :3].T + transform[:3, 3]
    solid = trimesh.Trimesh(vertices, mesh.faces.astype(np.int64), process=False)
    places, rays, faces = solid.ray.intersects_location(points, np.broadcast_to(direction, points.shape))
    stands = np.ones(len(rays), bool)
    if mesh.uv is not None:
        weights = trimesh.triangles.points_to_barycentric(solid.triangles[faces], places)
        uv = (mesh.uv[mesh.faces[faces]] * weights[..., None]).sum(axis=1) % 1.0
        for part in mesh.parts:
            if part.alpha is not None:
                own = (faces >= part.faces.start) & (faces < part.faces.stop)
                height, width = part.alpha.shape
                rows = ((1 - uv[own, 1]) * height).astype(int).clip(0, height - 1)
                stands[own] = part.alpha[rows, (uv[own, 0] * width).astype(int).clip(0, width - 1)] >= 0.5
    hits = np.zeros(len(points), bool)
    hits[rays[stands]] = True
    return hits


@pytest.mark.parametrize("name", ["spot/spot.obj", "suzanne.obj", "stanford-bunny.obj"])
def test_depth_and_silhouette_are_pyrenders(name: str, model_path) -> None:
    pyrender = pytest.importorskip("pyrender")
    mesh = fb.load_mesh(model_path(name))
    size = np.ptp(mesh.bounds, axis=0).max()
    camera = fb.Camera.fit(mesh.bounds, fov_deg=45)
    scene = pyrender.Scene()
    scene.add(pyrender.Mesh.from_trimesh(mesh.to_trimesh(), smooth=False))
    reach = np.linalg.norm(camera.eye - mesh.bounds.mean(axis=0))
    scene.add(pyrender.PerspectiveCamera(np.radians(45), znear=0.2 * reach, zfar=3 * reach), pose=camera.pose)
    renderer = pyrender.OffscreenRenderer(256, 256)
    try:
        theirs = renderer.render(scene, flags=pyrender.RenderFlags.DEPTH_ONLY)
    finally:
        renderer.delete()
    seen = theirs > 0
    raster = fb.render(fb.Scene([mesh]), camera, size=(256, 256), shadows="none", device="cpu")
    off = np.where(
        seen, exceeds(np.abs(np.where(seen, raster.depth, 0) - theirs), 1e-4 * size), np.isfinite(raster.depth)
    )
    assert off.mean() < 0.002
    marched = fb.render(
        fb.Scene([fb.Instance(mesh, resolution=128)]),
        camera,
        size=(256, 256),
        primary="raymarch",
        shadows="none",
        device="cpu",
    )
    for frame in (raster, marched):
        hit = np.isfinite(frame.depth)
        assert (hit & seen).sum() / (hit | seen).sum() > 0.99
    # A grazing ray meets a surface half a voxel off much earlier or later: the silhouettes are left out.
    both = np.isfinite(marched.depth) & seen
    close = np.abs(marched.depth[both] - theirs[both]) < 1.5 * 1.1 * size / 128
    assert close.mean() > 0.98


def test_object_ids_are_pyrenders() -> None:
    pyrender = pytest.importorskip("pyrender")
    things = [
        (meshes.icosphere(3), moved(x=-0.9)),
        (meshes.icosphere(2), moved(x=0.6, z=-0.5, scale=(1.2, 0.7, 0.4), turn=0.6)),
        ((plane().vertices, plane().faces), np.eye(4)),
    ]
    camera = fb.Camera((1.0, 3.0, 5.0), (0.0, -0.3, 0.0), fov_deg=45)
    scene = pyrender.Scene()
    colors = {}
    for i, ((vertices, faces), transform) in enumerate(things):
        mesh = pyrender.Mesh.from_trimesh(fb.Mesh(vertices, faces).to_trimesh(), smooth=False)
        colors[scene.add(mesh, pose=transform)] = (i + 1, 0, 0)
    scene.add(pyrender.PerspectiveCamera(np.radians(45), znear=0.1, zfar=50.0), pose=camera.pose)
    renderer = pyrender.OffscreenRenderer(256, 256)
    try:
        theirs, _ = renderer.render(scene, flags=pyrender.RenderFlags.SEG, seg_node_map=colors)
    finally:
        renderer.delete()
    instances = [fb.Instance(fb.Mesh(*mesh), transform) for mesh, transform in things]
    ours = fb.render(fb.Scene(instances), camera, size=(256, 256), shadows="none", device="cpu")
    assert (ours.object_id == theirs[..., 0].astype(int) - 1).mean() > 0.998
    assert set(np.unique(ours.object_id)) == {-1, 0, 1, 2}


def test_the_options_of_a_directional_light_are_in_the_order_of_its_signature() -> None:
    light = fb.DirectionalLight((0, -2, 0), (1, 0.5, 0), 3, 10)

    assert light == fb.DirectionalLight((0, -1, 0), color=(1, 0.5, 0), intensity=3, angle_deg=10)
