"""Pictures of shapes: closed forms against sphere tracing, special cameras, and kernels that are compiled meanwhile."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fieldbake as fb
import truth_trees as truth
from compare import exceeds
from pictures import DEPTH_TOLERANCE, differing_pixels, has_volume

#: The tree of the article.
ARTICLE = "(union (cube 3) (diff (cube 4) (move -2 -2 2 (sphere 5))))"

PLAIN = {
    "sphere": fb.sphere(0.8),
    "ellipsoid": fb.ellipsoid((1, 0.5, 0.7)),
    "box": fb.box((1.6, 1.2, 0.9)),
    "cylinder": fb.cylinder(0.6, 1.4),
    "capsule": fb.capsule(0.4, 1.0),
    "cone": fb.cone(0.7, 1.6),
    "wide cone": fb.truncated_cone(0.2, 1.1, 0.5),
    "pyramid": fb.pyramid(1.4, 1.2),
    "octahedron": fb.octahedron(1.0),
    "hex_prism": fb.hex_prism(0.8, 1.0),
    "disc": fb.extrude(fb.circle(0.7), 0.6),
    "slab": fb.extrude(fb.rectangle((1.5, 0.8)), 0.6),
    "half space": fb.sphere(0.9) & fb.plane((1, 2, -1), 0.2),
}


def pictures(shape, size, **options):
    """The whole shape marched, and drawn as `options` say."""
    camera = fb.Camera.fit(shape.bounds, direction=(-0.3, 0.4, -1))
    whole = fb.raymarch(shape, camera, size=size, method="whole", shadows="none", device="cpu")
    return whole, fb.raymarch(shape, camera, size=size, shadows="none", **options)


def differing(first, second):
    """Pixels whose depths differ by more than a ten thousandth, or that only one of the pictures has hit."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(first.depth - second.depth) > DEPTH_TOLERANCE
    return int((apart | (np.isfinite(first.depth) != np.isfinite(second.depth))).sum())


@pytest.mark.parametrize("name", PLAIN)
def test_closed_forms_are_the_roots(name):
    shape = PLAIN[name].rotate((1, -2, 0.5), 33)
    others = fb.box(0.7).translate((0.5, 0.2, 0.3)), fb.sphere(0.5).translate((0, 0, 0.5))
    leaves = 2 if name == "half space" else 1
    # Each model with the number of literals of its normal form: `a ^ b` is `(a & !b) | (!a & b)`.
    for model, literals in (
        (shape, leaves),
        (shape - others[0], leaves + 1),
        (shape | others[1], leaves + 1),
        (shape ^ others[0], 2 * (leaves + 1)),
        (others[1] - (others[0] - shape), leaves + 2),
    ):
        whole, plain = pictures(model, (40, 40), device="cpu")

        # 0.1 % of 1600 pixels, where a ray only grazes the surface.
        assert differing(whole, plain) <= 1
        assert np.isfinite(plain.depth).any()
        # In each box that it enters, a ray intersects each literal once at most. A march takes many times as much.
        assert 0 < plain.report["leaf_evaluations"] < 40 * 40 * literals * plain.report["boxes"]
        hit = np.isfinite(whole.depth) & np.isfinite(plain.depth)
        slopes = np.abs(whole.normal - plain.normal).max(axis=-1)[hit]
        # Except in pixels on an edge, where the normal of either side is right.
        assert exceeds(slopes, 1e-2).mean() < 0.02


def test_closed_forms_are_the_roots_on_the_device(gpu):
    """All kinds in one picture."""
    places = [(3.0 * (i % 4), 3.0 * (i // 4), 0) for i in range(len(PLAIN))]
    row = [shape.rotate((1, 2, 3), 40).translate(at) for shape, at in zip(PLAIN.values(), places, strict=True)]
    whole, plain = pictures(fb.Shape.union(*row) - fb.box((20, 0.6, 0.6)), (64, 64), device=gpu)

    assert differing(whole, plain) <= 4
    assert plain.report["structures"] == 0


@pytest.mark.parametrize("method", ["whole", "aabb", "octree"])
def test_the_camera_may_be_anywhere(method, device):
    shape = fb.csg.parse(ARTICLE)

    def depth(eye, target, side=1):
        size = (side, side)
        return fb.raymarch(shape, fb.Camera(eye, target), size=size, method=method, device=device).depth

    # In the solid.
    assert (depth((0, 0, 0), (0, 0, -1), 4) == 0).all()
    # In the hollow that the sphere left, inside the boxes: the nearest wall belongs to the small cube, at z = 1.5.
    assert depth((-1.2, -1.2, 1.9), (-1.2, -1.2, 0))[0, 0] == pytest.approx(0.4, abs=1e-5)
    # Along the faces of the boxes, and in the planes in which they meet.
    for eye in ((0.5, 0.5, 9), (-2, 0, 9), (0.5, 2, 9), (1.5, 1.5, 9)):
        found = depth(eye, (*eye[:2], 0))[0, 0]
        assert np.isinf(found) or found == pytest.approx(7, abs=1e-5)
    assert np.isinf(depth((9, 9, 9), (9, 9, 0))).all()


def test_a_method_is_checked_and_followed_in_every_picture() -> None:
    """A picture drawn as a scene once took any text as its method."""
    shape, size = fb.csg.parse(ARTICLE), (24, 24)
    leaves = [
        fb.raymarch(shape, size=size, method=method, device="cpu").report["leaf_evaluations"]
        for method in ("whole", "octree")
    ]
    assert leaves[0] > leaves[1] > 0
    lamp = fb.PointLight((0, 9, 9))
    scene_only = ({"samples": 4}, {"lights": [lamp]}, {"lights": [fb.DirectionalLight((0, -1, 0), angle_deg=4)]})
    for options in ({}, *scene_only):
        with pytest.raises(fb.ShapeError, match=r"^method: must be one of .*, got 'nonsense'"):
            fb.raymarch(shape, size=size, method="nonsense", device="cpu", **options)
    for options in scene_only:
        with pytest.raises(
            fb.ArgumentError, match=r'^method: "octree" needs samples=1 and directional lights, .*; leave it out'
        ):
            fb.raymarch(shape, size=size, method="octree", device="cpu", **options)
    others = fb.Quadric.sphere(), [fb.Quadric.sphere()], fb.Scene([shape]), fb.bake(shape, 8), fb.models.gear()
    for other in others:
        with pytest.raises(fb.ArgumentError, match=r"^method: 'octree' applies to shapes only, got a "):
            fb.raymarch(other, size=size, method="octree", device="cpu")


def test_boxes_that_share_faces_leave_no_gap(device):
    """Rays in the plane between two cells, and along the edge between four, hit what is there."""
    shape = fb.Shape.union(*(fb.sphere(0.4).translate((x, y, 0)) for x in (-1, 0, 1) for y in (-1, 0, 1)))
    middle = shape.bounds.mean(axis=0)
    assert (middle == 0).all()
    frame = fb.raymarch(shape, fb.Camera((0, 0, 5), (0, 0, 0)), size=(1, 1), method="octree", device=device)
    assert frame.depth[0, 0] == pytest.approx(4.6, abs=1e-5)
    # Rows and columns of an odd picture that is centred on the planes.
    whole = fb.raymarch(shape, fb.Camera((0, 0, 5), (0, 0, 0)), size=(33, 33), method="whole", device="cpu")
    split = fb.raymarch(shape, fb.Camera((0, 0, 5), (0, 0, 0)), size=(33, 33), method="octree", device=device)
    assert differing(whole, split) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("method", ["aabb", "octree"])
@given(tree=truth.trees)
@settings(max_examples=200)
def test_the_device_draws_the_parts_of_any_tree(tree, method):
    if not has_volume(tree.shape):
        return
    camera = fb.Camera.fit(tree.shape.bounds, direction=(0.07, 0.04, -1.2))
    wrong, _ = differing_pixels(tree, camera, (12, 12), method, "gpu")

    assert wrong == 0, tree.text


def blend(radius, tube):
    """A torus with a fillet, minus a box: its parts have no closed form, so they are sphere traced."""
    ring = fb.torus(radius, tube).union(fb.sphere(0.5).translate((0.6, 0, 0)), k=0.2)
    return ring - fb.box((0.3, 4, 4))


def row(radius):
    """A row of balls, which may overlap, minus a bar."""
    return fb.Shape.union(*(fb.sphere(radius).translate((0.5 * i - 2, 0, 0)) for i in range(9))) - fb.box((9, 0.1, 0.1))


def draw_until_compiled(shape, device, camera=None, size=(24, 24)):
    """Return the first picture, and the first picture by the specialised kernel of the shape."""
    camera = camera or fb.Camera((0, -3, 2), (0, 0, 0))
    first = frame = fb.raymarch(shape, camera, size=size, device=device)
    patience = time.monotonic() + 120
    while not frame.report["compiled"] and time.monotonic() < patience:
        frame = fb.raymarch(shape, camera, size=size, device=device)
    return first, frame


def test_edits_recompile_only_for_a_new_structure(gpu):
    # In a process of its own: kernels that other tests left to be compiled would be counted.
    check = f"import sys; sys.path[:0] = {sys.path!r}; import test_csg_draw; test_csg_draw.check_edits({gpu!r})"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", check],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


def check_edits(gpu):
    first, compiled = draw_until_compiled(blend(0.8, 0.3), gpu)
    assert compiled.report["compiled"]
    assert compiled.report["structures"] == 1
    # The interpreter and the kernel draw the same.
    assert differing(first, compiled) == 0
    assert np.abs(first.color - compiled.color).max() < 0.02

    # Another radius: the same kernel, at once.
    edited = draw_until_compiled(blend(0.7, 0.2), gpu)[0]
    assert edited.report["compiled"]
    assert edited.report["pipelines"] == compiled.report["pipelines"]
    truth = fb.raymarch(blend(0.7, 0.2), fb.Camera((0, -3, 2), (0, 0, 0)), size=(24, 24), device="cpu")
    assert differing(truth, edited) == 0

    # The same where hits have a closed form, though other parts come out.
    before, after = (draw_until_compiled(row(radius), gpu) for radius in (0.2, 0.35))
    assert before[0].report["boxes"] != after[0].report["boxes"]
    assert after[0].report["compiled"]
    assert after[1].report["pipelines"] == before[1].report["pipelines"] == edited.report["pipelines"] + 1
    edited = after[1]

    # Another tree: drawn at once by the interpreter, then by one more kernel.
    first, compiled = draw_until_compiled(blend(0.8, 0.3)._changed("shell", 0.05), gpu)
    assert not first.report["compiled"]
    assert compiled.report["compiled"]
    assert compiled.report["pipelines"] == edited.report["pipelines"] + 1
    assert differing(first, compiled) == 0


@pytest.mark.parametrize(
    "joined",
    [
        # Closed forms alone, and under an operator whose sides depend on the place.
        lambda row: fb.Shape.union(*row) ^ fb.box((12, 0.6, 0.6)),
        # Beside a part that is marched by a function of its own.
        lambda row: fb.Shape.union(*row[:6]) | blend(0.8, 0.3).translate((0, -3, 0)),
        # Beside one that is interpreted.
        lambda row: fb.Shape.union(*row[:2]) | fb.volume_shape(fb.bake(fb.models.torus_knot(), resolution=16)),
    ],
    ids=["closed", "marched", "interpreted"],
)
def test_written_kernels_draw_what_the_cpu_draws(joined, gpu):
    places = [(3.0 * (i % 4), 3.0 * (i // 4), 0) for i in range(len(PLAIN))]
    row = [shape.rotate((1, 2, 3), 40).translate(at) for shape, at in zip(PLAIN.values(), places, strict=True)]
    shape = joined(row)
    camera = fb.Camera.fit(shape.bounds, direction=(-0.3, 0.4, -1))
    truth = fb.raymarch(shape, camera, size=(64, 64), device="cpu")
    written = draw_until_compiled(shape, gpu, camera=camera, size=(64, 64))[1]

    assert written.report["compiled"]
    # 0.1 % of 4096 pixels.
    assert differing(truth, written) <= 4
    hit = np.isfinite(truth.depth) & np.isfinite(written.depth)
    # But for pixels on an edge, where either side is right.
    assert exceeds(np.abs(truth.normal - written.normal).max(axis=-1)[hit], 1e-2).mean() < 0.02
    assert exceeds(np.abs(truth.color - written.color).max(axis=-1)[hit], 1 / 255).mean() < 0.02


@given(
    st.tuples(*[st.sampled_from([0.02, 0.3, 0.5, 1.0, 2.0])] * 3),
    st.integers(0, 2**16),
    st.sampled_from([1, 1e-3, 1e-9, 0]),
)
@settings(max_examples=60)
def test_ellipsoids_are_exact(radii, seed, flat):
    """At points everywhere, and close to the plane in which the nearest point jumps from side to side."""
    points = np.random.default_rng(seed).normal(0, 1, (300, 3)) * np.maximum(radii, 0.3)
    points[:, np.argmin(radii)] *= flat
    found = fb.ellipsoid(radii).distance(points).astype(float)
    expected = truth.ellipsoid(radii).field(points)

    # Never farther than the surface; below it by what 12 steps leave at worst, see src/csg/evaluation/field.rs.
    assert (np.abs(found) <= np.abs(expected) + 8 * 2.0**-24).all()
    assert np.abs(found - expected).max() <= 1e-6
    slopes = np.linalg.norm(fb.ellipsoid(radii).gradient(points), axis=1)
    if flat == 1:
        assert (np.abs(slopes - 1) < 1e-4).mean() > 0.99
