"""Shadows of scenes against closed forms, rays through triangles, and exact traces of fields."""

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


def test_the_hard_shadows_of_opaque_and_translucent_spheres_multiply() -> None:
    # Neighbouring rays first test the occluder that blocked the last one. It must not darken the others.
    to_light = -np.array(SUN) / np.linalg.norm(SUN)
    ball = fb.bake(fb.Mesh(*meshes.icosphere(4)), 48)
    centers = [
        1.5 * i * to_light + aside
        for i, aside in enumerate([(0.9, 0.6, 0), (0, 0.6, 0.8), (0, 0.6, 0), (-0.7, 0.6, 0.3)])
    ]
    opacities = [0.5, 1.0, 0.25, 1.0]
    balls = [fb.Instance(ball, moved(*p), opacity=opacity) for p, opacity in zip(centers, opacities, strict=True)]
    scene = fb.Scene([*balls, fb.Instance(plane())], lights=[fb.DirectionalLight(SUN)])
    camera = fb.Camera((-7.0, 5.0, 3.0), (-0.5, -1.0, -0.2), fov_deg=40)
    frame = fb.render(scene, camera, size=(200, 150), shadows="hard", device="cpu")
    on_plane = frame.object_id == len(balls)
    p = positions(frame, camera)
    share = np.ones(on_plane.shape)
    for center, opacity in zip(centers, opacities, strict=True):
        share *= np.where(miss_distance(p, center, to_light) < 1, 1 - opacity, 1)
    assert set(np.unique(share[on_plane])) == {0, 0.375, 0.5, 0.75, 1}
    assert (frame.shadow == share)[on_plane].mean() > 0.99


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


BALL = fb.sphere(1)


@pytest.mark.parametrize("shadows", ["soft", "area"])
@pytest.mark.parametrize("kind", ["shape", "mesh", "volume", "volume on a device"])
def test_a_light_is_cut_off_by_the_horizon(kind: str, shadows: str, request: pytest.FixtureRequest) -> None:
    # The visible part of the disc is cut off by the tangent plane, `height` radii below the centre of the light.
    solid = {"shape": BALL, "mesh": BALL.to_mesh(96)}.get(kind) or fb.bake(BALL, 128)
    light, radius = np.array((5.0, 0, 0)), 0.5
    scene = fb.Scene([solid], lights=[fb.PointLight(tuple(light), radius=radius)])
    camera = fb.Camera((0, 0, 6), (0, 0, 0), fov_deg=24)

    device = request.getfixturevalue("gpu") if kind == "volume on a device" else "cpu"
    frame = fb.render(scene, camera, size=(160, 120), shadows=shadows, device=device)

    to_light = light - positions(frame, camera)
    height = (frame.normal * to_light).sum(axis=-1) / radius
    near = (frame.object_id == 0) & (height > 0) & (height < 1.5)
    assert near.sum() > 500
    x = height[near].clip(-1, 1)
    share = 0.5 + (np.arcsin(x) + x * np.sqrt(1 - x * x)) / np.pi
    error = frame.shadow[near] - share
    # The series of the share is accurate to 0.004, and normals of the mesh and the volume to a few thousandths. A part
    # of a disc has up to half the root of the 64 points more or fewer than its share, which is 0.0625.
    assert np.abs(error).max() <= (0.01 if shadows == "soft" else 0.07)
    assert abs(error.mean()) <= 0.01


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
    # The penumbra follows from the distances: the scene divides the samples by their largest slope, which rounding
    # makes larger than 4.
    assert np.abs(frames[0].shadow - frames[1].shadow).max() <= 0.02


def tilted_plane(factor: float, resolution: int, half: float) -> fb.Volume:
    """A plane, tilted against all axes, whose samples are distances times a factor."""
    x, y, z = np.meshgrid(*[((np.arange(resolution) + 0.5) / resolution * 2 - 1) * half] * 3, indexing="ij")
    return fb.Volume(factor * ((x + y + z) / np.sqrt(3)).astype(np.float32), [(-half,) * 3, (half,) * 3])


KINDS = {
    "dense": lambda factor: tilted_plane(factor, 64, 1),
    "sparse": lambda factor: tilted_plane(factor, 64, 1).to_sparse(band=6 * factor),
    "sparse snorm8": lambda factor: tilted_plane(factor, 64, 1).to_sparse(band=6 * factor, encoding="snorm8"),
    "nested": lambda factor: fb.NestedField([tilted_plane(factor, 65, 0.5), tilted_plane(factor, 65, 1)]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_steep_field_casts_the_penumbra_of_its_distance(kind: str) -> None:
    """A plane of a slope of 3 casts the penumbra of its distance."""
    camera = fb.Camera((2.0, 5.0, 3.0), (0.9, -1.0, 0.0), fov_deg=40)
    frames = []
    for factor in (1, 3):
        field = KINDS[kind](factor)
        scene = fb.Scene([fb.Instance(field), plane(y=-1.2)], lights=[fb.DirectionalLight(SUN, angle_deg=10)])
        frames.append(fb.render(scene, camera, size=(200, 150), device="cpu"))
    penumbra = (frames[0].shadow > 0.1) & (frames[0].shadow < 0.9)
    assert penumbra.sum() > 50
    assert np.abs(frames[0].shadow - frames[1].shadow).max() <= 0.02


def test_hard_shadows_of_a_field_that_is_steep_along_diagonals() -> None:
    # Neighbouring samples along the axes differ as in a distance field, but the slope across a face is sqrt(3).
    x, y, z = np.meshgrid(*[(np.arange(64) + 0.5) / 32 - 1] * 3, indexing="ij")
    steep = (np.abs(x) + np.abs(y) + np.abs(z) - 0.6).T.astype(np.float32)
    camera = fb.Camera((0.4, 5.0, 3.0), (0.4, -1.0, 0.0), fov_deg=40)
    frames = []
    for values in (steep, steep / 2):
        field = fb.Volume(values, [(-1, -1, -1), (1, 1, 1)])
        # No face is parallel to the light: rounding would decide there.
        scene = fb.Scene([fb.Instance(field), plane(y=-0.7)], lights=[fb.DirectionalLight((1.0, -1.3, 0.1))])
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


def test_a_box_on_a_floor_has_no_dark_row_at_its_foot() -> None:
    box, floor = fb.Mesh(*meshes.box((-1, -1, -1), (1, 1, 1))), plane()
    scene = fb.Scene([box, floor], lights=[fb.DirectionalLight((-1, -2, -0.6), angle_deg=3)])
    camera = fb.Camera((2, 2, 7), (0, -0.5, 0), fov_deg=30)
    frame = fb.render(scene, camera, size=(960, 720), device="cpu")
    front = (frame.object_id == 0) & (np.abs(positions(frame, camera)[..., 2] - 1) < 1e-6)
    # Within half the thickness of the floor's field, 2e-5, the foot is dark: a pixel in 500 columns sees that.
    assert front.sum() > 10_000
    assert (~(frame.shadow[front] >= 1)).sum() <= 3


def test_a_leaf_card_casts_the_shadow_of_a_leaf(model_path) -> None:
    plant = fb.load_scene(model_path("foliage_cards.glb"))
    bounds = plant.bounds
    size, center = np.ptp(bounds, axis=0).max(), bounds.mean(axis=0)
    ground = bounds[0, 1] - 0.02 * size
    sun = np.array((-0.4, -1.0, -0.3))
    foot = center + sun * (center[1] - ground)
    floor = fb.Instance(plane(3 * size, ground))
    unseen = [fb.Instance(item.geometry, item.transform, visible=False) for item in plant.instances]
    scene = fb.Scene([*unseen, floor], lights=[fb.DirectionalLight(sun)])
    above = np.array((0, 3 * size, 0.001))
    camera = fb.Camera(foot + above, foot, fov_deg=40)
    frame = fb.render(scene, camera, size=(96, 96), shadows="hard", device="cpu")
    points = positions(frame, camera).reshape(-1, 3)
    leaves = np.zeros(len(points), bool)
    for item in plant.instances:
        leaves |= masked_hits(item.geometry, np.asarray(item.transform), points, -sun)
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
