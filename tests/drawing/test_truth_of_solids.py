"""Depth and normal of a tilted box, torus and cylinder in each kind of picture, against float64 ray intervals."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth_rays as rays
from compare import close
from pictures import directions

SIZE = (64, 52)
#: Voxels along the longest side.
RESOLUTION = 48
#: Segments of curved meshes.
SEGMENTS = 256
AXIS, ANGLE, OFFSET = (1, 2, 0.5), 35, (0.2, -0.1, 0.3)
CAMERA = fb.Camera((2.6, -2.2, 2.1), OFFSET, up=(0, 0, 1), fov_deg=30)
#: Each solid, and its two principal curvatures where they are largest, 1 / world units.
SOLIDS = {
    "box": (rays.box((1.4, 1.1, 0.9)), (0, 0)),
    "torus": (rays.torus(0.8, 0.4), (2.5, 2.5)),
    "cylinder": (rays.cylinder(0.6, 1.3), (1 / 0.6, 0)),
}
MESHES = {
    "box": meshes.box((-0.7, -0.55, -0.45), (0.7, 0.55, 0.45)),
    "torus": meshes.torus(0.8, 0.4, SEGMENTS, SEGMENTS),
}


def placed(name):
    return rays.placed(SOLIDS[name][0], OFFSET, AXIS, ANGLE)


def as_mesh(name):
    vertices, faces = MESHES[name]
    return fb.Mesh(vertices @ rays.turn(AXIS, ANGLE).T + OFFSET, faces)


def comparable(truth):
    """Pixels 2 away from silhouettes and creases, on surfaces that the ray meets at 24 degrees or more."""
    hit = np.isfinite(truth.depth)
    along = directions(CAMERA, SIZE)
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    good = hit & (-(truth.normal * along).sum(axis=-1) >= 0.4)
    apart = np.zeros_like(hit)
    for axis in (0, 1):
        first = (slice(None),) * axis + (slice(None, -1),)
        second = (slice(None),) * axis + (slice(1, None),)
        differs = (hit[first] != hit[second]) | (np.abs(truth.normal[first] - truth.normal[second]).max(axis=-1) > 0.5)
        apart[first] |= differs
        apart[second] |= differs
    padded = np.pad(apart, 2)
    height, width = hit.shape
    near = np.any([padded[y : y + height, x : x + width] for y in range(5) for x in range(5)], axis=0)
    return good & ~near


def field_of(name):
    return fb.bake(placed(name).shape, RESOLUTION, device="cpu")


#: Objects that `raymarch` draws.
FIELDS = {
    "shape": lambda name: placed(name).shape,
    "volume": field_of,
    "sparse": lambda name: field_of(name).to_sparse(),
    "float16": lambda name: field_of(name).quantize("float16"),
    "snorm16": lambda name: field_of(name).quantize("snorm16"),
    "merged": lambda name: fb.merge([field_of(name)], RESOLUTION, device="cpu"),
    "nested": lambda name: fb.merge([field_of(name)], RESOLUTION, levels=2, center=OFFSET, device="cpu"),
}
#: Objects that are drawn as instances of a scene, besides meshes.
INSTANCES = {
    "shape": FIELDS["shape"],
    "volume": FIELDS["volume"],
    "sparse": FIELDS["sparse"],
    "atlas entry": lambda name: fb.pack([field_of(name)], page_size=1024)[0],
}


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("kind", FIELDS)
def test_raymarch_draws_the_solid(kind, name, device):
    assert_is_the_solid(fb.raymarch(FIELDS[kind](name), CAMERA, size=SIZE, device=device), kind, name)


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("kind", INSTANCES)
def test_render_draws_the_solid(kind, name, device):
    scene = fb.Scene([fb.Instance(INSTANCES[kind](name))])
    assert_is_the_solid(fb.render(scene, CAMERA, size=SIZE, shadows="none", device=device), kind, name)


@pytest.mark.parametrize("name", MESHES)
def test_render_draws_the_mesh(name, device):
    scene = fb.Scene([fb.Instance(as_mesh(name))])
    assert_is_the_solid(fb.render(scene, CAMERA, size=SIZE, shadows="none", device=device), "mesh", name)


def assert_is_the_solid(frame, kind, name):
    truth = rays.picture(placed(name), CAMERA, SIZE)
    clear = comparable(truth)
    assert clear.sum() >= 150
    assert not np.isnan(frame.depth).any()
    # Silhouettes may differ by a pixel on either side.
    assert (np.isfinite(frame.depth) != np.isfinite(truth.depth)).mean() <= 0.02
    depth, normal = tolerances(kind, name)
    close(frame.depth[clear], truth.depth[clear], depth)
    if kind not in ("merged", "nested"):
        close(frame.normal[clear], truth.normal[clear], normal)
        return
    # The bound is not smooth between samples; its normals lean by some degrees (see `merge`).
    lean = np.degrees(np.arccos(np.clip((frame.normal * truth.normal).sum(axis=-1)[clear], -1, 1)))
    assert lean.mean() <= 10


def tolerances(kind, name):
    """Largest error of depth, world units, and of a component of the normal."""
    curvatures = SOLIDS[name][1]
    if kind == "shape":
        return rays.DEPTH_TOLERANCE, rays.NORMAL_TOLERANCE
    if kind == "mesh":
        # A facet spans an angle of 2 pi / SEGMENTS; its middle lies inside by the radius times 1 - cos(pi / SEGMENTS).
        half = np.pi / SEGMENTS
        return 1.2 * 2 * (1 - np.cos(half)) / 0.4 + 1e-4, 2 * half + 1e-3
    volume = field_of(name)
    voxel = float(volume.spacing.max())
    # Linear interpolation along each axis is off by h^2 / 8 times the second derivative; the second derivatives of a
    # distance add up to the sum of the curvatures, which a voxel inside is larger by the factor 1 / (1 - h k).
    shift = voxel**2 / 8 * sum(k / (1 - voxel * k) for k in curvatures) + 1e-4
    if kind in ("float16", "snorm16"):
        # Half a step of 11 bits of a voxel, and of 15 bits of the largest distance.
        shift += voxel / 2**11 + float(np.abs(volume.distances).max()) / 2**15
    if kind in ("merged", "nested"):
        # A merged field is lower by up to half the diagonal of a voxel.
        shift += np.sqrt(3) / 2 * voxel
    # A central difference over one voxel of an interpolated field turns by the angle over half a voxel.
    return shift / 0.4, voxel * max(curvatures) / 2 + 0.02


@pytest.mark.parametrize("angle", [0, 30, 60])
def test_a_masked_card_is_drawn_where_its_mask_is(angle, device):
    image = np.zeros((128, 128, 4), np.uint8)
    row, column = (np.mgrid[:128, :128] + 0.5) / 128 - 0.5
    image[..., :3], image[..., 3] = 200, 255 * (np.hypot(row, column) < 0.4)
    vertices = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    matrix = rays.turn((1, 0.3, 0), angle)
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)]
    part = fb.Part("leaf", range(2), image=image, alpha_mode="mask")
    card = fb.Mesh(vertices @ matrix.T + OFFSET, [(0, 1, 2), (0, 2, 3)], uv=uv, parts=[part])
    frame = fb.render(fb.Scene([fb.Instance(card)]), CAMERA, size=SIZE, shadows="none", device=device)

    along, normal = directions(CAMERA, SIZE), matrix[:, 2]
    depth = ((np.asarray(OFFSET) - CAMERA.eye) @ normal) / (along @ normal)
    radius = np.linalg.norm(CAMERA.eye + depth[..., None] * along - OFFSET, axis=-1)
    # The disc has the radius 0.8; bilinear interpolation of the mask moves its rim by a texel, 1/64. A mip
    # level that is as coarse as a pixel, about 0.06, moves it by that.
    inside, outside = radius <= 0.8 - 0.08, radius >= 0.8 + 0.08
    assert inside.sum() > 100
    assert np.isinf(frame.depth[outside]).all()
    close(frame.depth[inside], depth[inside], 2e-5)
    toward_eye = normal * -np.sign((along * normal).sum(axis=-1))[..., None]
    close(frame.normal[inside], toward_eye[inside], 1e-5)
