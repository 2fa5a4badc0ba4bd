"""Depth and normal of each kind of picture against the closed form of the ray and the sphere, in float64."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
from compare import close, exceeds
from pictures import directions

CENTER, RADIUS = np.array([0.3, -0.2, 0.1]), 1.0
SIZE = (40, 32)
CAMERA = fb.Camera((3.1, -2.4, 2.2), CENTER, up=(0, 0, 1), fov_deg=40)
#: Voxels along the longest side.
RESOLUTION = 48


def sphere_hits():
    """Depth along the viewing axis (inf: no hit), unit normal, and the cosine between ray and normal of each pixel."""
    rays = directions(CAMERA, SIZE)
    to_eye = CAMERA.eye - CENTER
    a, b = (rays**2).sum(axis=-1), (rays * to_eye).sum(axis=-1)
    discriminant = b**2 - a * ((to_eye**2).sum() - RADIUS**2)
    hit = discriminant > 0
    # The rays advance by 1 along the viewing axis, so their parameter is the depth.
    depth = np.where(hit, (-b - np.sqrt(np.where(hit, discriminant, 0))) / a, np.inf)
    normal = (to_eye + np.where(hit, depth, 0)[..., None] * rays) / RADIUS
    facing = np.where(hit, np.sqrt(np.where(hit, discriminant, 0) / a) / RADIUS, 0)
    return depth, normal, facing


@pytest.fixture(scope="module")
def mesh():
    vertices, faces = meshes.icosphere(4)
    return fb.Mesh(RADIUS * vertices + CENTER, faces)


@pytest.fixture(scope="module")
def volume(mesh):
    return fb.bake(mesh, RESOLUTION, device="cpu")


def nested(volume):
    return fb.merge([volume], RESOLUTION, levels=2, center=tuple(CENTER), device="cpu")


#: Objects that `raymarch` draws.
FIELDS = {
    "volume": lambda volume: volume,
    "sparse": lambda volume: volume.to_sparse(),
    "float16": lambda volume: volume.quantize("float16"),
    "snorm16": lambda volume: volume.quantize("snorm16"),
    "quadric": lambda _: fb.Quadric.sphere(tuple(CENTER)),
    "merged": lambda volume: fb.merge([volume], RESOLUTION, device="cpu"),
    "nested": nested,
}
#: Objects that are drawn as instances of a scene, besides the mesh.
INSTANCES = {
    "volume": lambda volume: volume,
    "sparse": lambda volume: volume.to_sparse(),
    "atlas entry": lambda volume: fb.pack([volume], page_size=1024)[0],
    "quadric": lambda _: fb.Quadric.sphere(tuple(CENTER)),
}


@pytest.mark.parametrize("kind", FIELDS)
def test_raymarch_draws_the_sphere(kind, volume, device):
    frame = fb.raymarch(FIELDS[kind](volume), CAMERA, size=SIZE, device=device)
    assert_is_the_sphere(frame, kind, float(volume.spacing.max()))


@pytest.mark.parametrize("kind", ["mesh", *INSTANCES])
def test_render_draws_the_sphere(kind, mesh, volume, device):
    geometry = mesh if kind == "mesh" else INSTANCES[kind](volume)
    frame = fb.render(fb.Scene([fb.Instance(geometry)]), CAMERA, size=SIZE, shadows="none", device=device)
    assert_is_the_sphere(frame, kind, float(volume.spacing.max()))


def assert_is_the_sphere(frame, kind, voxel):
    depth, normal, facing = sphere_hits()
    assert not np.isnan(frame.depth).any()
    # Rays that graze may hit or miss: the facets of the icosphere, of 0.04 radians circumradius, lie up to 8e-4 inside
    # the sphere, and a field moves the surface by less than a voxel.
    clear = facing > 0.5
    assert np.isfinite(frame.depth[clear]).all()
    missing = np.isinf(depth)
    assert (np.isfinite(frame.depth) & missing).mean() <= 0.02
    if kind == "quadric":
        # Float32 over a scene of 6 units.
        close(frame.depth[clear], depth[clear], 2e-5)
        close(frame.normal[clear], normal[clear], 1e-5)
        return
    # Facets lie 8e-4 inside. A trilinear field of a sphere of radius 1 is off by h^2 / 2 between samples, and a merged
    # field is lower by up to half the diagonal of a voxel. A ray at 60 degrees meets that surface twice as far off.
    shift = np.sqrt(3) / 2 * voxel if kind in ("merged", "nested") else 8e-4 + voxel**2
    close(frame.depth[clear], depth[clear], 2 * shift + 1e-5)
    if kind in ("merged", "nested"):
        # The bound is not smooth between samples; its normals lean by some degrees (see `merge`).
        lean = np.degrees(np.arccos(np.clip((frame.normal * normal).sum(axis=-1)[clear], -1, 1)))
        assert lean.mean() <= 10
        return
    # A facet turns by its half width, 0.04 radians; a central difference over a voxel turns by less than a voxel.
    error = np.linalg.norm(frame.normal - normal, axis=-1)[clear]
    assert exceeds(error, 0.05 + voxel).sum() == 0
