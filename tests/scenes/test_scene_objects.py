"""Quadrics, shapes, sparse and packed fields in scenes: visible surfaces and shadows of each."""

from __future__ import annotations

import numpy as np
import pytest

import fieldbake as fb
from compare import exceeds
from scenes import SUN, disc_share, miss_distance, moved, plane, positions

TO_LIGHT = -np.array(SUN) / np.linalg.norm(SUN)
CENTER = np.array([0, 0.6, 0])
CAMERA = fb.Camera((2.5, 7.0, 5.0), (0.6, -1.0, 0.2), fov_deg=40)
ABOVE = fb.Camera((0, 9, 0.01), (0, 0, 0), fov_deg=50)


def bowl(**surface) -> fb.Quadric:
    return fb.Quadric.paraboloid(radius=0.8, height=0.7, **surface)


def tube() -> fb.Shape:
    """Painted, with a fillet, and not exact."""
    hole = fb.cylinder(radius=0.6, height=4)
    ball = fb.rounded_box((2, 2, 2), 0.3) & fb.sphere(1.35)
    return (ball - hole - hole.rotate("x", 90)).smooth(0.1).paint((0.9, 0.5, 0.1))


def field() -> fb.Volume:
    return fb.bake(fb.models.torus_knot(), 32)


#: A ball of radius 1 as every kind of geometry, with its transform.
BALLS = {
    "quadric": lambda: (fb.Quadric.sphere(), moved(y=0.6)),
    "quadric, unevenly scaled": lambda: (fb.Quadric.ellipsoid(radii=(2, 0.5, 1)), moved(y=0.6, scale=(0.5, 2, 1))),
    "shape": lambda: (fb.sphere(1), moved(y=0.6)),
    "shape, unevenly scaled": lambda: (fb.ellipsoid((2, 0.5, 1)), moved(y=0.6, scale=(0.5, 2, 1))),
    "sparse": lambda: (fb.bake(fb.sphere(1), 64).to_sparse(), moved(y=0.6)),
    "packed": lambda: (fb.pack([fb.bake(fb.sphere(1), 64)])[0], moved(y=0.6)),
}


def over_plane(kind: str, light: fb.DirectionalLight, shadows: str, device: str = "cpu") -> fb.Frame:
    geometry, transform = BALLS[kind]()
    scene = fb.Scene([fb.Instance(geometry, transform), plane()], lights=[light])
    return fb.render(scene, CAMERA, size=(160, 120), shadows=shadows, device=device)


@pytest.mark.parametrize("kind", BALLS)
def test_the_hard_shadow_of_a_ball_is_the_closed_form(kind: str) -> None:
    frame = over_plane(kind, fb.DirectionalLight(SUN), "hard")
    p = positions(frame, CAMERA)
    on_plane = frame.object_id == 1
    dark = miss_distance(p, CENTER, TO_LIGHT) < 1
    assert (frame.shadow[on_plane] == np.where(dark, 0, 1)[on_plane]).mean() > 0.995
    # Depths agree with the depths of the sphere; fields of 64 voxels are off by their interpolation, some 1e-3 of the
    # radius.
    on_ball = frame.object_id == 0
    tolerance = 2e-5 if kind.startswith(("quadric", "shape")) else 5e-3
    assert np.abs(np.linalg.norm(p[on_ball] - CENTER, axis=1) - 1).max() < tolerance
    # No acne where the ball faces the light, and nothing lit where it is turned away.
    n_l = (p[on_ball] - CENTER) @ TO_LIGHT
    assert (frame.shadow[on_ball][n_l > 0.05] == 1).all()
    assert (frame.shadow[on_ball][n_l < -0.05] == 0).all()


@pytest.mark.parametrize("angle_deg", [3.0, 12.0])
@pytest.mark.parametrize("kind", BALLS)
def test_penumbrae_are_as_wide_as_the_light_is_large(kind: str, angle_deg: float) -> None:
    frame = over_plane(kind, fb.DirectionalLight(SUN, angle_deg=angle_deg), "soft")
    on_plane = frame.object_id == 1
    p = positions(frame, CAMERA)[on_plane]
    truth = disc_share(p, CENTER, 1.0, TO_LIGHT, np.tan(np.radians(angle_deg / 2)))
    assert np.sqrt(((frame.shadow[on_plane] - truth) ** 2).mean()) < 0.03
    partial = lambda share: ((share > 0.05) & (share < 0.95)).sum()  # noqa: E731
    assert partial(frame.shadow[on_plane]) == pytest.approx(partial(truth), rel=0.15)


GEOMETRIES = {
    "quadrics": lambda: [
        bowl(),
        fb.Quadric.cylinder((0, 0, 0.3), 0.4, 1.2),
        fb.Quadric.hyperbolic_paraboloid((0.5, 0, 1.2)),
    ],
    "shape": tube,
    # More leaves than the limit up to which distances are evaluated.
    "large shape": lambda: fb.box_frame((2, 2, 2), 0.1).repeat((0.4, 0.4, 0.4), (4, 4, 4)).scale(0.5) & fb.sphere(1),
}


@pytest.mark.parametrize("name", GEOMETRIES)
def test_soft_is_near_the_area_reference(name: str) -> None:
    place = moved(y=0.4, scale=(1.2, 0.8, 1.0), turn=0.5)
    scene = fb.Scene(
        [fb.Instance(GEOMETRIES[name](), place), plane()],
        lights=[fb.DirectionalLight(SUN, angle_deg=8), fb.PointLight((2, 5, 1), radius=0.4)],
    )
    soft, area = (fb.render(scene, CAMERA, size=(80, 60), shadows=s, device="cpu") for s in ("soft", "area"))
    seen = np.isfinite(soft.depth)
    assert np.sqrt(((soft.shadow - area.shadow)[seen] ** 2).mean()) < 0.05


def test_opacities_multiply() -> None:
    shares = [0.5, 0.25, 0.6]
    lid = {"separation": 0.01, "radius": 1.0}
    discs = [fb.Quadric.plane_pair((0, 0, z), opacity=share, **lid) for z, share in enumerate(shares)]
    flat = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    sun = [fb.DirectionalLight((0, -1, 0), angle_deg=4)]
    # The camera looks from below a floor that it does not see, so nothing but the floor's upper side counts.
    for geometries, kept in (([discs], 1.0), (discs, 1.0), ([discs], 0.5)):
        instances = [fb.Instance(geometry, flat, opacity=kept, visible=False) for geometry in geometries]
        scene = fb.Scene([*instances, plane()], lights=sun)
        middle = fb.render(scene, ABOVE, size=(9, 9), shadows="soft", device="cpu").shadow[4, 4]
        # A plane pair is one quadric: its two sheets count once.
        assert middle == pytest.approx(np.prod([1 - kept * share for share in shares]), abs=1e-6)
    hard = fb.render(scene, ABOVE, size=(9, 9), shadows="hard", device="cpu").shadow[4, 4]
    assert hard == pytest.approx(middle, abs=1e-6)


def test_sheets_that_meet_let_nothing_through() -> None:
    # A drum of two tubes, one on the other: there is no inside and no depth, but no light falls through the seam.
    tubes = [fb.Quadric.cylinder((0, 0, z), 0.8, 1.0) for z in (-0.5, 0.5)]
    lying = np.array([[0, 0, 1, 0], [0, 1, 0, 0.4], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    scene = fb.Scene(
        [fb.Instance(tubes, lying, visible=False), plane()], lights=[fb.DirectionalLight((0, -1, 0), angle_deg=4)]
    )
    frame = fb.render(scene, ABOVE, size=(96, 96), shadows="soft", device="cpu")
    p = positions(frame, ABOVE)
    middle = (np.abs(p[..., 0]) < 0.8) & (np.abs(p[..., 2]) < 0.6)
    assert middle.sum() > 150
    assert frame.shadow[middle].max() == 0


def test_a_shape_is_drawn_as_raymarch_draws_it() -> None:
    shape = tube()
    camera = fb.Camera.fit(shape.bounds, aspect=1)
    # Light from everywhere is another formula there.
    alone = fb.raymarch(shape, camera, size=(96, 96), shadows="none", ambient=0, device="cpu")
    scene = fb.Scene([fb.Instance(shape)], ambient=0)
    frame = fb.render(scene, camera, size=(96, 96), shadows="none", device="cpu")
    hit = np.isfinite(frame.depth)
    # A ray on the silhouette may be decided by its last bit.
    assert (hit == np.isfinite(alone.depth)).mean() > 0.999
    both = hit & np.isfinite(alone.depth)
    assert np.abs(frame.depth[both] - alone.depth[both]).max() < 1e-4
    assert np.abs(frame.color - alone.color)[both].max() < 1 / 255
    blue = fb.render(
        [fb.Instance(shape, material=fb.Material((0, 0, 1), specular=0))], camera, size=(32, 32), device="cpu"
    )
    assert (blue.color[blue.object_id == 0][:, :2] == 0).all()


def test_quadrics_of_a_list_keep_their_colours_unless_the_material_has_one() -> None:
    red, green = (
        fb.Quadric.sphere((x, 0, 0), 0.6, reflectance=color) for x, color in ((-1, (1, 0, 0)), (1, (0, 1, 0)))
    )
    camera = fb.Camera((0, 0, 6), (0, 0, 0))
    options = {"size": (64, 32), "device": "cpu"}
    light = [fb.DirectionalLight((0, 0, -1), angle_deg=4)]
    alone = fb.raymarch([red, green], camera, lights=light, specular=0, samples=4, **options)
    assert set(np.unique(alone.object_id)) == {-1, 0, 1}
    # A shape of the same form has the same picture.
    balls = [fb.sphere(0.6).translate((x, 0, 0)).paint(color) for x, color in ((-1, (1, 0, 0)), (1, (0, 1, 0)))]
    scene = fb.Scene([fb.Instance(ball, material=fb.Material(specular=0)) for ball in balls], light)
    shapes = fb.render(scene, camera, samples=4, **options)
    assert np.array_equal(alone.object_id, shapes.object_id)
    assert np.abs(alone.color - shapes.color).max() <= 1 / 255
    # In one instance the quadrics are one object, and a colour of the material replaces theirs.
    for color, channels in ((None, {0, 1}), ((0, 0, 1), {2})):
        instance = fb.Instance([red, green], material=fb.Material(color=color, specular=0))
        frame = fb.render(fb.Scene([instance], light, ambient=0), camera, **options)
        assert set(np.unique(frame.object_id)) == {-1, 0}
        lit = frame.color[frame.object_id == 0][:, :3].max(axis=0)
        assert {channel for channel in range(3) if lit[channel] > 0.5} == channels


def test_quadrics_are_drawn_as_raymarch_draws_them() -> None:
    quadrics = [bowl(reflectance=(0.2, 0.5, 1.0)), fb.Quadric.sphere((1, 0.2, 0.5), 0.4, reflectance=(1, 1, 1))]
    camera = fb.Camera((2, -4, 3), (0.3, 0, 0.3), up=(0, 0, 1))
    alone = fb.raymarch(quadrics, camera, size=(96, 96), shadows="none", ambient=0, device="cpu")
    frame = fb.render(fb.Scene(quadrics, ambient=0), camera, size=(96, 96), shadows="none", device="cpu")
    assert (frame.object_id == alone.object_id).mean() > 0.999
    same = (frame.object_id == alone.object_id) & np.isfinite(alone.depth)
    assert np.abs(frame.depth[same] / alone.depth[same] - 1).max() < 1e-5
    # Normals of both sides of the sheet look at the eye.
    assert np.abs(frame.normal - alone.normal)[same].max() < 1e-3
    assert np.abs(frame.color - alone.color)[same].max() < 1 / 255
    # In one list they are one object; `raymarch` draws them with soft shadows.
    assert set(np.unique(fb.render([quadrics], camera, size=(32, 32), device="cpu").object_id)) == {-1, 0}
    soft = fb.raymarch(quadrics, camera, size=(32, 32), shadows="soft", device="cpu")
    assert set(np.unique(soft.object_id)) == {-1, 0, 1}


def kinds(place: float = 1.0) -> list[fb.Instance]:
    """One object of each kind, side by side; they overlap if `place` is below 1."""
    geometries = [
        fb.models.torus_knot(segments=96, sides=12),
        field(),
        tube(),
        [bowl(reflectance=(0.3, 0.5, 0.9), opacity=0.5), fb.Quadric.sphere((0, 0, 0.6), 0.5)],
        field().to_sparse(),
        fb.pack([field()], encoding="snorm16")[0],
        field().quantize("snorm8"),
    ]
    angle = 2 * np.pi / len(geometries)
    return [
        fb.Instance(geometry, moved(2 * place * np.cos(i * angle), 0, 2 * place * np.sin(i * angle), scale=(0.6,) * 3))
        for i, geometry in enumerate(geometries)
    ]


def test_the_nearest_of_all_kinds_is_seen() -> None:
    instances = kinds(place=0.4)
    camera = fb.Camera((1, 5, 4), (0, 0, 0), fov_deg=40)
    together = fb.render(fb.Scene(instances), camera, size=(64, 64), shadows="none", device="cpu")
    alone = [fb.render([item], camera, size=(64, 64), shadows="none", device="cpu").depth for item in instances]
    nearest = np.min(alone, axis=0)
    assert (together.depth == nearest).all()
    hit = np.isfinite(nearest)
    assert (together.object_id[hit] == np.argmin(alone, axis=0)[hit]).all()
    assert set(np.unique(together.object_id)) == {-1, *range(len(instances))}


def test_each_kind_shades_the_others() -> None:
    # Every object hides the floor from the light, so the floor is dark where a picture from the light shows an object.
    instances = kinds()
    sun = fb.DirectionalLight((0, -1, 0))
    scene = fb.Scene([*instances, plane()], lights=[sun], ambient=0)
    hidden = [fb.Instance(item.geometry, item.transform, visible=False) for item in instances]
    floor = fb.render(fb.Scene([*hidden, plane()], lights=[sun]), ABOVE, size=(96, 96), shadows="hard", device="cpu")
    p = positions(floor, ABOVE)
    # A camera far up the light sees what a parallel light meets, to a pixel.
    far = fb.Camera((0, 400, 0), (0, 0, 0), up=(0, 0, -1), fov_deg=np.degrees(2 * np.arctan(4 / 400)))
    view = fb.render(scene, far, size=(256, 256), shadows="none", device="cpu")
    column, row = (np.clip(((c / 4 + 1) * 128).astype(int), 0, 255) for c in (p[..., 0], p[..., 2]))
    seen = view.object_id[row, column]
    shade = np.where(seen == len(instances), 1.0, np.where(seen == 3, floor.shadow, 0.0))
    assert (floor.shadow == shade).mean() > 0.97
    # The half-opaque bowl lets half through, unless the ball in it takes it all.
    assert set(np.unique(floor.shadow[seen == 3])) >= {0.0, 0.5}


def test_a_sparse_field_looks_as_the_dense_one() -> None:
    dense = fb.bake(fb.models.torus_knot(), 48)
    sparse = dense.to_sparse(tolerance=0)
    camera = fb.Camera((1.5, 2, 3), (0, 0, 0))
    a, b = (
        fb.render([geometry, plane()], camera, size=(80, 60), shadows="hard", device="cpu")
        for geometry in (dense, sparse)
    )
    assert (a.object_id == b.object_id).mean() > 0.999
    both = np.isfinite(a.depth) & np.isfinite(b.depth)
    assert np.abs(a.depth[both] - b.depth[both]).max() < 1e-4
    assert (a.shadow == b.shadow).mean() > 0.995


def test_an_entry_of_an_atlas_stands_where_it_was_packed() -> None:
    atlas = fb.pack([field(), (field(), moved(x=3))])
    assert [entry.index for entry in atlas] == [0, 1]
    assert np.array_equal(fb.Instance(atlas[1]).transform, moved(x=3))
    assert np.allclose(fb.Instance(atlas[1]).bounds, field().inner_bounds + np.array([3, 0, 0]))
    camera = fb.Camera((1.5, 2, 9), (1.5, 0, 0))
    packed = fb.render(list(atlas), camera, size=(64, 48), device="cpu")
    plain = fb.render([field(), fb.Instance(field(), moved(x=3))], camera, size=(64, 48), device="cpu")
    assert (packed.color == plain.color).all()
    marched = fb.render([atlas[1]], camera, size=(64, 48), primary="raymarch", shadows="hard", device="cpu")
    alone = fb.raymarch(atlas[1], camera, size=(64, 48), device="cpu")
    assert (alone.color == marched.color).all()
    first = fb.Camera.fit(field().inner_bounds)
    alone, plain = (fb.raymarch(one, first, size=(64, 48), device="cpu") for one in (atlas[0], field()))
    assert (alone.color == plain.color).all()
    with pytest.raises(fb.ArgumentError, match=r'^filter: "nearest" needs a volume without a transform'):
        fb.raymarch(atlas[1], filter="nearest", device="cpu")
    entry = atlas[1]
    atlas.remove(1)
    with pytest.raises(fb.AtlasError, match="no volume 1"):
        fb.render([entry], device="cpu")


def test_the_eye_may_be_inside() -> None:
    for shape in (fb.sphere(2), fb.box_frame((1, 1, 1), 0.1).repeat((0.9, 0.9, 0.9), (5, 5, 5)) | fb.sphere(2)):
        frame = fb.render([shape], fb.Camera((0.1, 0.2, 0.05), (1, 0, 0)), size=(16, 16), device="cpu")
        assert (frame.depth == 0).all()
    inside = fb.render([fb.Quadric.sphere()], fb.Camera((0, 0, 0), (1, 0, 0)), size=(16, 16), device="cpu")
    assert (np.abs(inside.depth) <= 1).all()
    assert (inside.depth > 0.7).all()


def test_surroundings_are_shut_out_by_every_kind() -> None:
    camera = fb.Camera((0.5, 2.5, 3.0), (0, -0.8, 0), fov_deg=35)
    ball = moved(y=-0.5, scale=(0.5,) * 3)
    frames = []
    for geometry in (fb.bake(fb.sphere(1), 64), fb.Quadric.sphere(), fb.sphere(1)):
        scene = fb.Scene([fb.Instance(geometry, ball), plane()], lights=[], ambient=1)
        frames.append(fb.render(scene, camera, size=(64, 48), ambient_occlusion=1.5, device="cpu"))
    # Thin rays and cones agree on how open the floor is, within what cones are off by near contact.
    assert frames[0].color.min() < 0.5
    for other in frames[1:]:
        assert np.abs(other.color - frames[0].color).mean() < 0.02


def test_a_scene_of_all_kinds_is_merged() -> None:
    instances = kinds()
    merged = fb.merge(fb.Scene(instances), 32)
    # Points on what the camera sees are on surfaces: no merged distance there is above zero by more than half a voxel's
    # diagonal, what trilinear interpolation between lower bounds may exceed.
    frame = fb.render(fb.Scene(instances), ABOVE, size=(64, 64), shadows="none", device="cpu")
    on = positions(frame, ABOVE)[np.isfinite(frame.depth)]
    assert merged.sample(on).max() < 0.5 * np.linalg.norm(merged.spacing)
    moved_on = [(3, moved(y=1.0)), (0, moved(y=1.0))]
    updated = merged.update(moved_on)
    items = [(item.geometry, item.transform) for item in instances]
    now = [fb.Instance(geometry, dict(moved_on).get(i, place)) for i, (geometry, place) in enumerate(items)]
    assert (updated.distances == fb.merge(fb.Scene(now), merged.resolution, bounds=merged.bounds).distances).all()


def test_a_far_field_stands_for_solids_and_leaves_sheets_their_shadows() -> None:
    ball = fb.Instance(fb.Quadric.sphere(), moved(y=0.6))
    box = fb.Instance(fb.box((0.8, 0.8, 0.8)), moved(x=1.8, y=0.9))
    scene = fb.Scene([ball, box, plane()], lights=[fb.DirectionalLight(SUN)])
    far = fb.merge([ball, box], 48)
    with_far, without = (
        fb.render(scene, CAMERA, size=(80, 60), shadows="hard", far=field, far_distance=0.3, device="cpu")
        if field is not None
        else fb.render(scene, CAMERA, size=(80, 60), shadows="hard", device="cpu")
        for field in (far, None)
    )
    assert with_far.report["far_rays"] > 100
    # Edges may move by a voxel of the merged field; nothing more.
    assert (with_far.shadow == without.shadow).mean() > 0.97
    p = positions(with_far, CAMERA)
    core = (with_far.object_id == 2) & (miss_distance(p, CENTER, TO_LIGHT) < 0.9)
    assert core.sum() > 20
    assert (with_far.shadow[core] == 0).all()


def test_what_cannot_stand_in_a_scene() -> None:
    with pytest.raises(fb.ShapeError, match="plane"):
        fb.Instance(fb.plane("y"))
    with pytest.raises(fb.MeshError):
        fb.Instance([])
    with pytest.raises(fb.SceneError, match=r"instances\[1\] has no triangles"):
        fb.render([fb.models.gear(teeth=6), fb.sphere(1)], primary="raster", device="cpu")


def test_devices_draw_the_same_picture(gpu: str) -> None:
    scene = fb.Scene([*kinds(), plane()], lights=[fb.DirectionalLight(SUN, angle_deg=6)])
    pictures = {}
    for device in ("cpu", gpu):
        frame = fb.render(scene, CAMERA, size=(80, 60), ambient_occlusion=True, device=device)
        pictures[device] = frame.color
        assert set(frame.report["devices"]) == {"primary", "light"}
    assert exceeds(np.abs(pictures["cpu"] - pictures[gpu]).max(axis=2), 1 / 255).mean() < 0.005
