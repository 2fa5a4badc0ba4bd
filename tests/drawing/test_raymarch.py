"""Pictures of one field: hits, depths, lighting, and the layout of the arrays."""

import os

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth
from compare import exceeds

BACKGROUND = (0.25, 0.5, 0.75, 0.5)


def field(closed_form, resolution=48, half=1.5):
    """A closed form sampled on a cube around the origin."""
    bounds = np.array([(-half,) * 3, (half,) * 3])
    return fb.Volume(closed_form(truth.grid_points(*bounds, (resolution,) * 3)), bounds)


def rays(camera, size):
    """World direction through each pixel's centre, one unit long along the viewing axis, (h, w, 3)."""
    width, height = size
    slope = np.tan(np.radians(camera.fov_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1)
    return local @ camera.pose[:3, :3].T


def hit_points(frame, camera):
    """World positions of the hits, (k, 3), and the mask they came from."""
    hit = np.isfinite(frame.depth)
    return camera.eye + frame.depth[hit].astype(float)[:, None] * rays(camera, frame.size)[hit], hit


@pytest.fixture(scope="module")
def ball():
    return field(truth.sphere)


@pytest.fixture(scope="module")
def camera():
    return fb.Camera((1.0, 1.5, 3.0), (0, 0, 0))


# --- what is hit


def interpolation_error(volume, radius):
    """Error bound of a trilinear sphere field near its surface: h^2 / 8 times the sum of second derivatives, 2 / r."""
    h = float(volume.spacing.max())
    return h**2 / 8 * 2 / (radius - np.sqrt(3) * h)


def test_hits_lie_on_the_sphere(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(96, 96), device=device)

    points, hit = hit_points(frame, camera)
    assert hit.sum() > 500
    assert np.abs(truth.sphere(points)).max() <= interpolation_error(ball, 1.0)


def test_depth_is_the_closed_form(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(96, 96), device=device)

    directions = rays(camera, (96, 96))
    length = np.linalg.norm(directions, axis=-1)
    unit = directions / length[..., None]
    expected = truth.ray_sphere(np.broadcast_to(camera.eye, unit.shape), unit, 1.0)
    # Where the ray meets the surface at 60 degrees or less, an error across it is at most doubled along the ray.
    seen = np.isfinite(expected)
    points = camera.eye + np.where(seen, expected, 0)[..., None] * unit
    steep = seen & (truth.dot(points, unit) <= -0.5)
    assert steep.sum() > 500
    assert np.abs(frame.depth[steep] - (expected / length)[steep]).max() <= 2.1 * interpolation_error(ball, 1.0)


def test_hit_or_miss_is_right_but_for_the_outline(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(96, 96), device=device)

    directions = rays(camera, (96, 96))
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    passing = np.linalg.norm(np.cross(-camera.eye, unit), axis=-1)  # how close each ray comes to the centre
    clear = np.abs(passing - 1) > interpolation_error(ball, 1.0)
    hit = np.isfinite(frame.depth)
    assert np.array_equal(hit[clear], (passing < 1)[clear])
    assert np.array_equal(hit, frame.object_id >= 0)


def test_depth_of_a_box_is_exact_on_its_sides(device):
    half = 0.8
    volume = field(lambda p: truth.box(p, (-half,) * 3, (half,) * 3), resolution=48)
    camera = fb.Camera((2.0, 2.5, 4.0), (0, 0, 0))

    frame = fb.raymarch(volume, camera, size=(96, 96), device=device)

    directions = rays(camera, (96, 96))
    expected = truth.ray_box(np.broadcast_to(camera.eye, directions.shape), directions, (-half,) * 3, (half,) * 3)
    points = camera.eye + np.where(np.isfinite(expected), expected, 0)[..., None] * directions
    # Two voxels from every edge the field is linear around the side, so interpolation is exact.
    from_edges = np.sort(half - np.abs(points), axis=-1)[..., 1]
    plain = np.isfinite(expected) & (from_edges > 2 * volume.spacing.max())
    assert plain.sum() > 500
    # Depth, position in the grid and eight samples in float32, met at 70 degrees at most.
    rounding = 3 * 17 * truth.FLOAT32_ROUNDING * 6
    assert np.abs(frame.depth[plain] - expected[plain]).max() <= rounding


@pytest.mark.parametrize("name", ["knot", "torus", "hollow_sphere", "sliver_fin", "tetrahedron"])
def test_a_hit_is_a_root_of_the_trilinear_field(name, device):
    volume = fb.bake(meshes.CLOSED[name](), resolution=40)
    camera = fb.Camera.fit(volume.inner_bounds)

    frame = fb.raymarch(volume, camera, size=(96, 96), device=device)

    points, hit = hit_points(frame, camera)
    assert hit.sum() > 100
    # A position is known to a few roundings of the distance it was measured over; the field's slope is at most sqrt(3).
    reach = np.linalg.norm(volume.bounds[1] - volume.bounds[0]) + np.linalg.norm(
        camera.eye - volume.bounds.mean(axis=0)
    )
    assert np.abs(volume.sample(points)).max() <= 8 * truth.FLOAT32_ROUNDING * reach * np.sqrt(3)


def test_a_hit_is_the_first_root(device):
    volume = fb.bake(meshes.knot(96, 10), resolution=40)
    camera = fb.Camera.fit(volume.inner_bounds)

    frame = fb.raymarch(volume, camera, size=(48, 48), device=device)

    # March in steps far smaller than a voxel: nothing inside may lie before the hit.
    directions, hit = rays(camera, (48, 48)), np.isfinite(frame.depth)
    far = np.where(hit, frame.depth, np.linalg.norm(camera.eye) * 2)
    for share in np.linspace(0, 0.999, 400):
        values = volume.sample(camera.eye + (share * far)[..., None] * directions)
        assert values.min() >= -1e-5 * np.linalg.norm(volume.spacing)


def test_a_device_finds_the_roots_of_noise(gpu: str) -> None:
    """The cubics of random cells have their first roots in each of their three monotone pieces."""
    samples = np.random.default_rng(3).normal(0.3, 1, (12, 12, 12))
    noise = fb.Volume(samples, [(-1, -1, -1), (1, 1, 1)])
    camera = fb.Camera((1.5, 1.2, 3), (0, 0, 0), fov_deg=40)
    here, there = (fb.raymarch(noise, camera, size=(240, 180), shadows="none", device=at).depth for at in ("cpu", gpu))
    assert (np.isfinite(here) == np.isfinite(there)).all()
    assert 0.3 < np.isfinite(here).mean() < 1
    hit = np.isfinite(here)
    # Rounding moves a root by 2e-5, but by more where a ray grazes the surface. The bound allows 2 of 26,738 hits.
    assert exceeds(np.abs(here[hit] - there[hit]), 1e-3).mean() <= 1e-4


def test_thin_features_are_not_stepped_over(device):
    # A sheet a hundredth of a voxel thick, between two layers of samples: no sample is inside, no root, no hit. One
    # layer of samples inside, and every ray hits.
    values = np.full((16, 16, 16), 0.5)
    values[:, :, 8] = -0.001
    volume = fb.Volume(values, [(-1, -1, -1), (1, 1, 1)])

    frame = fb.raymarch(volume, fb.Camera((0, 0, 3), (0, 0, 0), fov_deg=20), size=(32, 32), device=device)

    assert np.isfinite(frame.depth).all()


def test_nothing_to_see(camera, device):
    empty = fb.Volume(np.ones((8, 8, 8)), [(-1, -1, -1), (1, 1, 1)])

    frame = fb.raymarch(empty, camera, size=(16, 12), background=BACKGROUND, device=device)

    assert np.isposinf(frame.depth).all()
    assert (frame.object_id == -1).all()
    assert (frame.normal == 0).all()
    assert np.allclose(frame.color, BACKGROUND)


def test_looking_away_sees_nothing(ball, device):
    frame = fb.raymarch(ball, fb.Camera((0, 0, 3), (0, 0, 6)), size=(16, 16), device=device)

    assert np.isposinf(frame.depth).all()


def test_from_inside_the_solid_the_surface_is_right_here(ball, device):
    frame = fb.raymarch(ball, fb.Camera((0, 0, 0), (0, 0, -1)), size=(16, 16), device=device)

    assert (frame.depth == 0).all()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_scale_and_offset_do_not_change_the_picture(scale, shift, device):
    values = truth.sphere(truth.grid_points((-1.5,) * 3, (1.5,) * 3, (32,) * 3))
    at_home = fb.Volume(values, [(-1.5,) * 3, (1.5,) * 3])
    moved = fb.Volume(values * scale, np.array([(-1.5,) * 3, (1.5,) * 3]) * scale + shift * scale)
    eye = np.array((1.0, 1.5, 3.0))

    here = fb.raymarch(at_home, fb.Camera(eye, (0, 0, 0)), size=(48, 48), device=device)
    there = fb.raymarch(
        moved, fb.Camera(eye * scale + shift * scale, np.full(3, shift * scale)), size=(48, 48), device=device
    )

    both = np.isfinite(here.depth) & np.isfinite(there.depth)
    assert (np.isfinite(here.depth) != np.isfinite(there.depth)).sum() <= 4  # rounding on the outline
    assert np.abs(here.depth[both] - there.depth[both] / scale).max() <= 1e-4
    assert np.abs(here.normal - there.normal)[both].max() <= 1e-3


# --- normals and light


def test_normals_are_those_of_the_sphere(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(96, 96), device=device)

    points, hit = hit_points(frame, camera)
    normals = frame.normal[hit]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)), abs=1e-5)
    # A difference over a voxel, of a field interpolated between samples a voxel apart: two voxels of curvature 1.
    aligned = truth.dot(normals, points / np.linalg.norm(points, axis=1, keepdims=True))
    assert aligned.min() >= np.cos(2 * ball.spacing.max())


def test_normals_of_a_plane_are_exact(device):
    normal = np.array([1, 2, 2]) / 3
    volume = field(lambda p: truth.plane(p, normal), resolution=24)
    camera = fb.Camera((1, 2, 2.5), (0, 0, 0), fov_deg=20)

    frame = fb.raymarch(volume, camera, size=(32, 32), device=device)

    assert np.abs(frame.normal - normal).max() <= 17 * truth.FLOAT32_ROUNDING * 24 * 2


def test_normals_face_the_camera(device):
    volume = fb.bake(meshes.knot(96, 10), resolution=48)
    camera = fb.Camera.fit(volume.inner_bounds)

    frame = fb.raymarch(volume, camera, size=(64, 64), device=device)

    hit = np.isfinite(frame.depth)
    facing = truth.dot(frame.normal, rays(camera, (64, 64)))[hit]
    assert (facing < 0).mean() > 0.98  # a normal averaged over a voxel may lean over at the outline


def test_a_ball_over_a_floor_throws_its_shadow(device):
    def scene(p):
        return np.minimum(truth.sphere(p, 0.4, (0, 0.5, 0)), truth.box(p, (-1.3, -0.8, -1.3), (1.3, -0.4, 1.3)))

    volume = field(scene, resolution=64)
    camera = fb.Camera((0, 3, 3), (0, -0.4, 0))
    light = fb.DirectionalLight((0, -1, 0))

    frame = fb.raymarch(volume, camera, size=(96, 96), lights=[light], device=device)

    points, hit = hit_points(frame, camera)
    shadow = frame.shadow[hit]
    floor = np.abs(points[:, 1] + 0.4) < volume.spacing.max() / 10
    from_axis = np.hypot(points[:, 0], points[:, 2])
    voxel = volume.spacing.max()
    under, open_floor = floor & (from_axis < 0.4 - voxel), floor & (from_axis > 0.4 + voxel) & (from_axis < 1.2)
    assert under.sum() > 20
    assert open_floor.sum() > 500
    assert (shadow[under] == 0).all()
    assert (shadow[open_floor] == 1).all()


def test_the_side_turned_away_from_the_light_is_dark(ball, device):
    camera = fb.Camera((0, 0, 4), (0, 0, 0))

    frame = fb.raymarch(ball, camera, size=(64, 64), lights=[fb.DirectionalLight((1, 0, 0))], device=device)

    points, hit = hit_points(frame, camera)
    shadow = frame.shadow[hit]
    assert (shadow[points[:, 0] < -0.2] == 1).all()
    assert (shadow[points[:, 0] > 0.2] == 0).all()


def test_without_shadows_all_light_arrives(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(32, 32), shadows="none", device=device)

    assert (frame.shadow == 1).all()


def test_each_light_has_its_shadow(ball, camera, device):
    lights = [fb.DirectionalLight((0, -1, 0)), fb.DirectionalLight((-1, 0, 0)), fb.DirectionalLight((0, 0, -1))]

    frame = fb.raymarch(ball, camera, size=(24, 16), lights=lights, device=device)

    assert frame.shadow.shape == (16, 24, 3)


def test_lambert_on_a_plane(device):
    volume = field(lambda p: truth.plane(p, (0, 1, 0)), resolution=24)
    camera = fb.Camera((0, 2, 0.5), (0, 0, 0), fov_deg=20)
    light = fb.DirectionalLight((0, -1, -1), color=(1.0, 0.5, 0.25), intensity=0.8)

    frame = fb.raymarch(
        volume, camera, size=(16, 16), lights=[light], ambient=0, specular=0, color=(0.5, 0.6, 0.7), device=device
    )

    expected = np.array((0.5, 0.6, 0.7)) * (1.0, 0.5, 0.25) * 0.8 * np.cos(np.pi / 4)
    assert np.abs(frame.color[..., :3] - expected).max() <= 1e-5
    assert (frame.color[..., 3] == 1).all()


def test_no_lights_and_no_ambient_is_black(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(16, 16), lights=[], ambient=0, device=device)

    assert (frame.color[np.isfinite(frame.depth)][:, :3] == 0).all()


# --- how the arrays lie


def test_shapes_and_types(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(40, 24), device=device)

    assert frame.size == (40, 24)
    assert (frame.color.shape, frame.color.dtype) == ((24, 40, 4), np.float32)
    assert (frame.image.shape, frame.image.dtype) == ((24, 40, 4), np.uint8)
    assert (frame.depth.shape, frame.depth.dtype) == ((24, 40), np.float32)
    assert (frame.normal.shape, frame.normal.dtype) == ((24, 40, 3), np.float32)
    assert (frame.object_id.shape, frame.object_id.dtype) == ((24, 40), np.int32)
    assert frame.shadow.shape == (24, 40)
    assert frame.steps.shape == (24, 40)
    assert (frame.report["device"] == "cpu") == (device == "cpu")


def test_row_0_is_on_top_and_x_goes_right(device):
    volume = field(lambda p: truth.sphere(p, 0.2, (0.6, 0.9, 0)))

    frame = fb.raymarch(volume, fb.Camera((0, 0, 5), (0, 0, 0)), size=(64, 64), device=device)

    rows, columns = np.nonzero(np.isfinite(frame.depth))
    assert rows.max() < 32
    assert columns.min() > 32


@pytest.mark.parametrize("size", [(120, 40), (40, 120)])
def test_pixels_are_square_in_any_picture(ball, size, device):
    frame = fb.raymarch(ball, fb.Camera((0, 0, 8), (0, 0, 0), fov_deg=60), size=size, device=device)

    rows, columns = np.nonzero(np.isfinite(frame.depth))
    assert frame.depth.shape == size[::-1]
    assert abs((rows.max() - rows.min()) - (columns.max() - columns.min())) <= 1


def test_fov_is_vertical(ball, device):
    frame = fb.raymarch(ball, fb.Camera((0, 0, 8), (0, 0, 0), fov_deg=30), size=(300, 100), device=device)

    rows, _ = np.nonzero(np.isfinite(frame.depth))
    # The ball's outline is seen under asin(1 / 8), half the picture's height under 15 degrees.
    expected = 100 * np.tan(np.arcsin(1 / 8)) / np.tan(np.radians(15))
    assert rows.max() - rows.min() + 1 == pytest.approx(expected, abs=2)


@pytest.mark.parametrize("size", [(80, 80), (120, 60), (60, 120)])
def test_no_camera_fits_the_surface(size, device):
    volume = fb.bake(meshes.knot(96, 10), resolution=32)

    frame = fb.raymarch(volume, size=size, device=device)

    hit = np.isfinite(frame.depth)
    border = np.concatenate([hit[0], hit[-1], hit[:, 0], hit[:, -1]])
    assert not border.any()
    rows, columns = np.nonzero(hit)
    assert max((np.ptp(rows) + 1) / size[1], (np.ptp(columns) + 1) / size[0]) > 0.5


def test_the_image_is_srgb_of_the_colour(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(32, 32), background=BACKGROUND, device=device)

    linear = np.clip(frame.color[..., :3].astype(float), 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(frame.image[..., :3] - srgb * 255).max() <= 0.5 + 1e-3
    assert frame.image[0, 0, 3] == 128  # 0.5 * 255 rounds to even


def test_save_writes_the_image(ball, camera, tmp_path, device):
    image = pytest.importorskip("PIL.Image")
    frame = fb.raymarch(ball, camera, size=(32, 20), device=device)

    frame.save(tmp_path / "ball.png")

    with image.open(tmp_path / "ball.png") as picture:
        assert np.array_equal(np.asarray(picture), frame.image)


def test_save_to_an_unknown_kind_is_refused(ball, camera, tmp_path):
    with pytest.raises(fb.FormatError, match="xyz"):
        fb.raymarch(ball, camera, size=(8, 8)).save(tmp_path / "ball.xyz")
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_shows_the_frame(ball, camera):
    assert fb.raymarch(ball, camera, size=(8, 8))._repr_png_().startswith(b"\x89PNG")


def test_frames_are_read_only(ball, camera):
    frame = fb.raymarch(ball, camera, size=(8, 8))

    with pytest.raises(ValueError, match="read-only"):
        frame.depth[0, 0] = 1


@pytest.mark.parametrize("quantity", ["steps", "depth", "shadow"])
def test_heat_maps(ball, camera, quantity):
    picture = fb.raymarch(ball, camera, size=(24, 16)).heatmap(quantity)

    assert (picture.shape, picture.dtype) == ((16, 24, 3), np.uint8)
    with pytest.raises(fb.ArgumentError, match="quantity"):
        fb.raymarch(ball, camera, size=(8, 8)).heatmap("colour")


@pytest.mark.parametrize("quantity", ["steps", "depth"])
def test_tiles_of_heat_maps_show_means(ball, camera, quantity):
    frame = fb.raymarch(ball, camera, size=(21, 13))
    values = np.array(getattr(frame, quantity), np.float64)
    means = np.full(values.shape, np.inf)
    for y in range(0, 13, 8):
        for x in range(0, 21, 8):
            tile = values[y : y + 8, x : x + 8]
            if np.isfinite(tile).any():
                means[y : y + 8, x : x + 8] = tile[np.isfinite(tile)].mean()
    arrays = {name: getattr(frame, name) for name in ("color", "depth", "normal", "object_id", "shadow", "steps")}
    expected = fb.Frame({**arrays, quantity: means}, frame.report).heatmap(quantity)

    assert np.abs(frame.heatmap(quantity, tile=8).astype(int) - expected).max() <= 1
    assert (frame.heatmap(quantity, tile=1) == frame.heatmap(quantity)).all()
    assert len(np.unique(frame.heatmap(quantity, tile=100).reshape(-1, 3), axis=0)) == 1
    for tile in (0, 2.5):
        with pytest.raises(fb.ArgumentError, match="tile"):
            frame.heatmap(quantity, tile=tile)


def test_arrays_raymarch_gives_the_same_picture(ball, camera, device):
    frame = fb.raymarch(ball, camera, size=(40, 24), device=device)

    color, depth = fb.arrays.raymarch(
        ball.distances, *ball.bounds, camera.pose, fov_deg=camera.fov_deg, size=(40, 24), device=device
    )

    assert np.array_equal(depth, frame.depth)
    assert np.array_equal(color, frame.color)


def test_what_is_no_volume_is_baked_first(camera):
    frame = fb.raymarch(meshes.icosphere(3), camera, size=(32, 32))

    points, hit = hit_points(frame, camera)
    assert hit.any()
    assert np.abs(truth.sphere(points)).max() <= 0.02  # 128 voxels, facets of 3 subdivisions


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"size": 64}, fb.SceneError, "size"),
        ({"size": (0, 64)}, fb.SceneError, "size"),
        ({"size": (64, -1)}, fb.SceneError, "size"),
        ({"size": (64.0, 64)}, fb.SceneError, "size"),
        ({"size": (10**6, 10**6)}, fb.SceneError, "size"),
        ({"camera": np.eye(4)}, fb.SceneError, "camera"),
        ({"shadows": "soft-ish"}, fb.ArgumentError, "shadows"),
        ({"ambient": -1}, fb.ArgumentError, "ambient"),
        ({"specular": float("nan")}, fb.ArgumentError, "specular"),
        ({"shininess": 0}, fb.ArgumentError, "shininess"),
        ({"color": (1, 1)}, fb.ArgumentError, "color"),
        ({"color": (1, 1, -1)}, fb.ArgumentError, "color"),
        ({"background": (1, 1)}, fb.ArgumentError, "background"),
        ({"lights": ["sun"]}, fb.SceneError, r"lights\[0\]: must be a PointLight, SpotLight or DirectionalLight"),
        ({"lights": [fb.DirectionalLight((0, -1, 0))] * 17}, fb.SceneError, "lights: at most 16, got 17"),
        ({"device": "abacus"}, fb.DeviceError, "abacus"),
    ],
    ids=str,
)
def test_an_option_that_makes_no_sense_is_named(ball, options, error, message):
    with pytest.raises(error, match=message):
        fb.raymarch(ball, **options)


# --- other programs


@pytest.fixture(scope="module")
def cow(sample_path):
    """A real model, what trimesh makes of it, and where to look from."""
    trimesh = pytest.importorskip("trimesh")
    mesh = fb.load_mesh(sample_path("cow.obj"))
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return mesh, body, fb.Camera.fit(mesh.bounds)


def test_depth_agrees_with_rays_cast_at_the_mesh(cow, device):
    mesh, body, camera = cow
    size = (48, 48)
    volume = fb.bake(mesh, resolution=96)

    frame = fb.raymarch(volume, camera, size=size, device=device)

    directions = rays(camera, size).reshape(-1, 3)
    origins = np.broadcast_to(camera.eye, directions.shape)
    locations, ray, _ = body.ray.intersects_location(origins, directions, multiple_hits=False)
    expected = np.full(len(directions), np.inf)
    expected[ray] = truth.dot(locations - camera.eye, -np.broadcast_to(camera.pose[:3, 2], locations.shape))
    expected = expected.reshape(size)
    # Every hit lies on the mesh within a voxel, and where both hit, almost everywhere at its depth: the outline and
    # what hides behind it may differ.
    points, hit = hit_points(frame, camera)
    voxel = volume.spacing.max()
    assert fb.closest_point(mesh, points).distances.max() <= voxel
    assert (hit != np.isfinite(expected)).mean() <= 0.02
    both = hit & np.isfinite(expected)
    assert (np.abs(frame.depth[both] - expected[both]) <= 2 * voxel).mean() >= 0.97


def test_depth_agrees_with_pyrender(cow, device, monkeypatch):
    if "PYOPENGL_PLATFORM" not in os.environ:
        monkeypatch.setenv("PYOPENGL_PLATFORM", "osmesa")
    monkeypatch.setattr("numpy.infty", np.inf, raising=False)  # pyrender 0.1.45 was written for NumPy 1
    try:
        pyrender = pytest.importorskip("pyrender", reason="pyrender is not installed", exc_type=ImportError)
        renderer = pyrender.OffscreenRenderer(64, 64)
    except pytest.skip.Exception:
        raise
    except Exception as reason:  # no OSMesa, or a PyOpenGL without it
        pytest.skip(f"pyrender cannot draw without a screen here: {reason}")
    mesh, body, camera = cow
    volume = fb.bake(mesh, resolution=96)
    scene = pyrender.Scene()
    scene.add(pyrender.Mesh.from_trimesh(body))
    scene.add(pyrender.PerspectiveCamera(yfov=np.radians(camera.fov_deg)), pose=camera.pose)
    _, expected = renderer.render(scene)
    renderer.delete()

    frame = fb.raymarch(volume, camera, size=(64, 64), device=device)

    both = np.isfinite(frame.depth) & (expected > 0)
    assert (np.isfinite(frame.depth) != (expected > 0)).mean() <= 0.02
    assert (np.abs(frame.depth[both] - expected[both]) <= 2 * volume.spacing.max()).mean() >= 0.97


def test_a_volume_is_lit_by_lamps_and_softly_too(ball):
    lamp = fb.PointLight((0, 6, 0), radius=0.5)
    frame = fb.raymarch(ball, size=(48, 48), shadows="soft", lights=[lamp], color=(0.9, 0.1, 0.1), device="cpu")
    hit = frame.object_id == 0
    assert hit.any()
    assert frame.shadow[hit].max() == 1
    assert frame.shadow[hit].min() == 0
    assert np.all(frame.color[hit][:, 0] >= frame.color[hit][:, 1])


def test_a_scene_is_marched_and_brings_its_own_surface(ball):
    scene = fb.Scene([fb.Instance(ball)])
    frame = fb.raymarch(scene, size=(32, 32), device="cpu")
    assert (frame.object_id == 0).any()
    for name, value in {"lights": [], "ambient": 0.1, "color": (1, 0, 0), "background": (0, 0, 0)}.items():
        with pytest.raises(fb.SceneError, match=name):
            fb.raymarch(scene, size=(8, 8), **{name: value})
