"""Arrays that do not fit the memory end in an error; the process goes on."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import fieldbake as fb

#: The child leaves itself 160 MB of addresses above what it uses, and makes calls whose arrays take more.
CHILD = """
import resource
import numpy as np
import fieldbake as fb

mesh = fb.models.gear()
shape = fb.sphere() | fb.box(1)
volume, sparse = fb.bake(mesh, 16), fb.bake_sparse(mesh, 32)
few = np.zeros((10, 3))
fb.query(mesh, few), fb.cast_rays(mesh, few, few + 1), fb.all_intersections(mesh, few, few + 1)
scene = fb.Scene([fb.Instance(mesh)])
camera = fb.Camera.fit(scene.bounds)
points = np.zeros((15_000_000, 3))
rays = points, np.broadcast_to([1.0, 0.0, 0.0], points.shape).copy()
with open("/proc/self/status") as status:
    used = next(int(line.split()[1]) for line in status if line.startswith("VmSize")) * 1024
resource.setrlimit(resource.RLIMIT_AS, (used + 160_000_000, used + 160_000_000))

calls = {
    "signed_distance": lambda: fb.signed_distance(mesh, points),
    "closest_point": lambda: fb.closest_point(mesh, points),
    "query": lambda: fb.query(mesh, points),
    "contains": lambda: fb.contains(mesh, points, sign="parity"),
    "winding_number": lambda: fb.winding_number(mesh, points),
    "thickness": lambda: fb.thickness(mesh, points),
    "cast_rays": lambda: fb.cast_rays(mesh, *rays, device="cpu"),
    "all_intersections": lambda: fb.all_intersections(mesh, *rays, device="cpu"),
    "sample_surface": lambda: fb.sample_surface(mesh, 20_000_000),
    "sample_training": lambda: fb.sample_training(mesh, 20_000_000),
    "bake": lambda: fb.bake(mesh, 512, device="cpu"),
    "Shape.distance": lambda: shape.distance(points),
    "Shape.gradient": lambda: shape.gradient(points),
    "Volume.sample": lambda: volume.sample(np.broadcast_to(points[:1], (50_000_000, 3))),
    "SparseVolume.gradient": lambda: sparse.gradient(points),
    "raymarch": lambda: fb.raymarch(volume, size=(8000, 8000), device="cpu"),
    "render": lambda: fb.render(scene, camera, size=(8000, 8000), device="cpu"),
    "merge": lambda: fb.merge(scene, 512, device="cpu"),
    "pack": lambda: fb.pack([volume], page_size=16384),
    "to_volume": lambda: fb.bake_sparse(fb.box(2), 512).to_volume(),
}
for name, call in calls.items():
    try:
        call()
        print(name, "done")
    except MemoryError as error:
        print(name, type(error).__name__)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="address spaces are limited on Linux only")
def test_calls_beyond_the_address_space_raise_memory_errors() -> None:
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    outcomes = dict(line.split() for line in done.stdout.splitlines())
    assert len(outcomes) == 20, done.stdout
    # A NumPy array of the Python layer may be the first that does not fit.
    assert set(outcomes.values()) <= {"CapacityError", "MemoryError"}, outcomes


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_broadcast_points_are_refused_before_a_copy(dtype: type) -> None:
    """A trillion points in 24 bytes: their copy would take 24 TB."""
    points = np.broadcast_to(np.zeros(3, dtype), (10**12, 3))
    with pytest.raises(fb.CapacityError, match=r"array of shape \(1000000000000, 3\) needs 24000000000000 bytes"):
        fb.signed_distance(fb.box(2).to_mesh(8), points)
