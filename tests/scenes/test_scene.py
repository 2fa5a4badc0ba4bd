"""Scenes: visible surfaces against other renderers, lights and materials against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import fieldbake as fb
import meshes
from compare import exceeds
from scenes import SUN, moved, plane, positions

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
    for geometry, transform in ((knot, matrix), (anew, np.eye(4))):
        instance = fb.Instance(geometry, transform, resolution=96)
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


def sheet(z: float, opacity: float, color: tuple[float, float, float] = (0, 0, 0)) -> fb.Instance:
    corners = [(-1, -1, z), (1, -1, z), (1, 1, z), (-1, 1, z)]
    material = fb.Material(color=(*color, opacity), specular=0)
    return fb.Instance(fb.Mesh(corners, [(0, 1, 2), (0, 2, 3)]), material=material)


@pytest.mark.parametrize("behind", ["background", "a mesh", "a shape"])
@pytest.mark.parametrize("count", [1, 16, 17, 60, 200])
def test_all_translucent_layers_count(count: int, behind: str) -> None:
    opaque = {"a mesh": sheet(-2, 1, (1, 1, 1)), "a shape": fb.box((3, 3, 1)).translate((0, 0, -2))}.get(behind)
    sheets = [sheet(0.001 * i, 0.03) for i in range(count)]
    camera = fb.Camera((0, 0, 5), (0, 0, 0))

    def draw(*instances):
        scene = fb.Scene([*instances, *([opaque] if opaque else [])], lights=[], ambient=1.0, background=(1, 1, 1))
        return fb.render(scene, camera, size=(9, 9), device="cpu").color[4, 4, :3]

    bare = draw() if opaque else np.ones(3)
    assert draw(*sheets) == pytest.approx(0.97**count * bare, abs=2e-4)


@pytest.mark.parametrize("background", [(0, 0, 0, 0), (1, 1, 1, 0), (0, 0, 1, 0.5)])
@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_colours_before_a_transparent_background_are_not_mixed_with_it(
    background: tuple[float, ...], opacity: float
) -> None:
    material = fb.Material(color=(1, 0, 0), unlit=True)
    scene = fb.Scene([fb.Instance(fb.sphere(), material=material, opacity=opacity)], background=background)

    frame = fb.render(scene, size=(48, 48), samples=16, device="cpu")

    color, alpha = frame.color[..., :3], frame.color[..., 3]
    assert color[0, 0] == pytest.approx(background[:3])
    assert alpha[24, 24] == pytest.approx(opacity + (1 - opacity) * background[3])
    assert ((alpha > 0.02) & (alpha < 0.48)).any() == (background[3] == 0)
    # Red over the background by the rule of Porter and Duff, at every share of coverage.
    covered = (alpha - background[3]) / (1 - background[3])
    expected = covered[..., None] * (1, 0, 0) + (1 - covered[..., None]) * background[3] * np.array(background[:3])
    assert np.abs(color * alpha[..., None] - expected).max() <= 1e-5


@pytest.mark.parametrize("ending", ["png", "jpg", "bmp"])
def test_files_without_opacity_have_the_picture_over_the_background(ending: str, tmp_path) -> None:
    scene = fb.Scene([sheet(0, 0.25, (1, 0, 0))], lights=[], ambient=1.0, background=(1, 1, 1, 0))
    frame = fb.render(scene, fb.Camera((0, 0, 5), (0, 0, 0)), size=(32, 32), device="cpu")

    frame.save(tmp_path / f"a.{ending}")

    pixels = Image.open(tmp_path / f"a.{ending}")
    expected = {"png": [(255, 0, 0, 64), (255, 255, 255, 0)]}.get(ending, [(255, 225, 225), (255, 255, 255)])
    for place, color in zip([(16, 16), (0, 0)], expected, strict=True):
        assert pixels.getpixel(place) == pytest.approx(color, abs=4)


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
        geometries = [fb.Instance(fb.Mesh(vertices * unit, faces), material=jade), wide]
        camera = fb.Camera((4 * unit, 3 * unit, 6 * unit), (0, -0.5 * unit, 0))
        scene = fb.Scene(geometries, lights=lights)
        return fb.render(scene, camera, size=(60, 45), ambient_occlusion=2 * unit, device=device).color

    one, other = picture(1.0), picture(unit)
    # Only what rounding turns, at silhouettes.
    assert (~(np.abs(one - other) <= 1 / 255)).any(axis=-1).sum() <= 3


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
        (
            lambda: fb.render(scene, shadow="soft"),
            r"shadow: is no option of render\(\); its options are size, primary, shadows",
        ),
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
    geometries = [
        (meshes.icosphere(3), moved(x=-0.9)),
        (meshes.icosphere(2), moved(x=0.6, z=-0.5, scale=(1.2, 0.7, 0.4), turn=0.6)),
        ((plane().vertices, plane().faces), np.eye(4)),
    ]
    camera = fb.Camera((1.0, 3.0, 5.0), (0.0, -0.3, 0.0), fov_deg=45)
    scene = pyrender.Scene()
    colors = {}
    for i, ((vertices, faces), transform) in enumerate(geometries):
        mesh = pyrender.Mesh.from_trimesh(fb.Mesh(vertices, faces).to_trimesh(), smooth=False)
        colors[scene.add(mesh, pose=transform)] = (i + 1, 0, 0)
    scene.add(pyrender.PerspectiveCamera(np.radians(45), znear=0.1, zfar=50.0), pose=camera.pose)
    renderer = pyrender.OffscreenRenderer(256, 256)
    try:
        theirs, _ = renderer.render(scene, flags=pyrender.RenderFlags.SEG, seg_node_map=colors)
    finally:
        renderer.delete()
    instances = [fb.Instance(fb.Mesh(*mesh), transform) for mesh, transform in geometries]
    ours = fb.render(fb.Scene(instances), camera, size=(256, 256), shadows="none", device="cpu")
    assert (ours.object_id == theirs[..., 0].astype(int) - 1).mean() > 0.998
    assert set(np.unique(ours.object_id)) == {-1, 0, 1, 2}


def test_the_options_of_a_directional_light_are_in_the_order_of_its_signature() -> None:
    light = fb.DirectionalLight((0, -2, 0), (1, 0.5, 0), 3, 10)

    assert light == fb.DirectionalLight((0, -1, 0), color=(1, 0.5, 0), intensity=3, angle_deg=10)
