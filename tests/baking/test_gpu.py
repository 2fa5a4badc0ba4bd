"""Bakes, queries and pictures on a graphics device: the results of the CPU, and clear errors."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import trimesh

import fieldbake as fb
from compare import exceeds
from fieldbake import arrays


@pytest.fixture(autouse=True)
def adapter(request: pytest.FixtureRequest) -> None:
    if not request.node.get_closest_marker("no_gpu"):
        request.getfixturevalue("gpu")


def knot(sections: int = 12, along: int = 120) -> trimesh.Trimesh:
    t = np.linspace(0, 2 * np.pi, along, endpoint=False)[:, None]
    a = np.linspace(0, 2 * np.pi, sections, endpoint=False)[None, :]
    x, y, z = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)
    size = np.hypot(x, y)
    r = 0.4 + 0.05 * np.sin(5 * a)
    rim = np.stack([x + r * np.cos(a) * x / size, y + r * np.cos(a) * y / size, z + r * np.sin(a)], -1)
    i, j = np.meshgrid(np.arange(along), np.arange(sections), indexing="ij")

    def index(u, v):
        return (u % along) * sections + v % sections

    corners = [index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)]
    faces = np.concatenate([np.stack([corners[k] for k in row], -1).reshape(-1, 3) for row in ((0, 1, 2), (0, 2, 3))])
    return trimesh.Trimesh(rim.reshape(-1, 3), faces, process=False)


def half_sphere() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.update_faces(ball.triangles_center[:, 2] < 0.3)
    return ball


MESHES = {
    "cube": lambda: trimesh.creation.box((1, 2, 3)),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=3),
    "knot": knot,
    "open": half_sphere,
    "far": lambda: trimesh.creation.icosphere(subdivisions=2, radius=1e-3).apply_translation((1e4, -2e4, 5)),
    "one triangle": lambda: trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]),
}


def assert_same_field(a: fb.Volume, b: fb.Volume) -> None:
    # The error bound of both bakes, and twice the rounding of one float32 search.
    diagonal = np.linalg.norm(a.bounds[1] - a.bounds[0])
    assert np.abs(a.distances - b.distances).max() <= 1e-6 * diagonal
    assert np.array_equal(np.signbit(a.distances), np.signbit(b.distances))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("resolution", [24, (9, 30, 5), (1, 1, 1)])
def test_bake_agrees_with_the_cpu(name, resolution):
    mesh = fb.Mesh(*(lambda m: (m.vertices, m.faces))(MESHES[name]()))
    cpu, gpu = (fb.bake(mesh, resolution, device=device) for device in ("cpu", "gpu"))
    assert_same_field(cpu, gpu)
    assert gpu.report.device != "cpu"
    assert gpu.report.sign_method == cpu.report.sign_method
    assert gpu.report.inside_voxels == cpu.report.inside_voxels


@pytest.mark.parametrize(
    "options",
    [
        {"band": 2.0},
        {"band": 0.3},
        {"two_sided": True},
        {"two_sided": True, "thickness": 0.25},
        {"sign": "parity"},
        {"sign": "pseudonormal"},
        {"sign": "normal"},
        {"sign": "unsigned"},
    ],
)
def test_options_mean_the_same(options):
    mesh = knot()
    cpu, gpu = (fb.bake(mesh, 26, device=device, **options) for device in ("cpu", "gpu"))
    diagonal = np.linalg.norm(cpu.bounds[1] - cpu.bounds[0])
    assert np.abs(cpu.distances - gpu.distances).max() <= 1e-6 * diagonal


@pytest.mark.parametrize("name", ["spot/spot.obj", "fandisk.obj", "rocker-arm.obj"])
def test_closed_models_agree_with_the_cpu(model_path, name):
    mesh = fb.load_mesh(model_path(name))
    assert_same_field(*(fb.bake(mesh, 48, device=device) for device in ("cpu", "gpu")))


def test_more_faces_than_a_software_adapter_loops_over():
    mesh = fb.Mesh(*(lambda m: (m.vertices, m.faces))(knot(100, 360)))
    assert len(mesh.faces) > 70_000
    assert_same_field(*(fb.bake(mesh, 14, device=device) for device in ("cpu", "gpu")))


@pytest.mark.parametrize("sign", ["unsigned", "parity", "normal"])
def test_brute_force_agrees(sign):
    job = knot().vertices, knot().faces, (-4, -4, -2), (4, 4, 2), (12, 12, 6)
    brute = arrays.bake(*job, sign=sign, method="brute", device="gpu")
    exact = arrays.bake(*job, sign=sign, device="cpu")
    assert np.abs(np.abs(brute) - np.abs(exact)).max() <= 1e-6 * 12
    if sign == "parity":
        assert np.array_equal(np.signbit(brute), np.signbit(exact))


def test_brute_force_runs_on_a_device_only():
    job = knot().vertices, knot().faces, (-4, -4, -2), (4, 4, 2), (2, 2, 2)
    with pytest.raises(fb.DeviceError, match="brute force"):
        arrays.bake(*job, sign="parity", method="brute", device="cpu")
    with pytest.raises(fb.ArgumentError, match="sign"):
        arrays.bake(*job, sign="winding", method="brute", device="gpu")
    with pytest.raises(fb.ArgumentError, match="method"):
        arrays.bake(*job, method="guess")


def test_points_agree_with_the_cpu(random):
    mesh = knot()
    points = random.uniform(-4, 4, (3000, 3))
    cpu, gpu = (fb.closest_point(mesh, points, device=device) for device in ("cpu", "gpu"))
    assert np.abs(cpu.distances - gpu.distances).max() <= 1e-6 * 14
    assert np.linalg.norm(points - gpu.points, axis=1) == pytest.approx(gpu.distances, abs=1e-6)
    cpu, gpu = (fb.signed_distance(mesh, points, device=device) for device in ("cpu", "gpu"))
    assert np.abs(cpu - gpu).max() <= 1e-6 * 14


def test_a_picture_agrees_with_the_cpu():
    volume = fb.bake(knot(), 48, device="cpu")
    camera = fb.Camera.fit(volume.inner_bounds)
    cpu, gpu = (fb.raymarch(volume, camera, size=(200, 150), device=device) for device in ("cpu", "gpu"))
    differ = np.count_nonzero(cpu.object_id != gpu.object_id)
    assert differ <= cpu.object_id.size / 10_000
    both = (cpu.object_id == 0) & (gpu.object_id == 0)
    assert both.sum() > 1000
    diagonal = np.linalg.norm(volume.bounds[1] - volume.bounds[0])
    assert np.abs(cpu.depth[both] - gpu.depth[both]).max() <= 1e-4 * diagonal


def test_a_large_picture_agrees_with_the_cpu():
    volume = fb.bake(trimesh.creation.icosphere(subdivisions=2), 6, device="cpu")
    cpu, gpu = (fb.raymarch(volume, size=(1500, 1000), shadows="none", device=device) for device in ("cpu", "gpu"))
    assert np.count_nonzero(cpu.object_id != gpu.object_id) <= cpu.object_id.size / 10_000
    assert np.mean(exceeds(np.abs(cpu.color - gpu.color), 1e-3)) < 1e-4


def test_a_field_stays_on_the_device_until_it_is_asked_for():
    volume = fb.bake(knot(), 32, device="gpu")
    field = volume._field
    assert field is not None
    before = field._transfers()
    first = volume.distances
    once = field._transfers()
    assert once["readback_bytes"] - before["readback_bytes"] == first.nbytes
    assert np.array_equal(volume.distances, first)
    assert np.asarray(volume) is not None
    assert field._transfers() == once


def test_a_lost_device_is_told_and_the_next_call_opens_it_again():
    volume = fb.bake(trimesh.creation.box(), 8, device="gpu")
    volume._field._destroy_device()
    with pytest.raises(fb.DeviceError, match="lost"):
        _ = volume.distances
    again = fb.bake(trimesh.creation.box(), 8, device="gpu")
    assert_same_field(again, fb.bake(trimesh.creation.box(), 8, device="cpu"))


def test_too_large_a_grid_is_refused_with_its_size():
    with pytest.raises((fb.DeviceError, fb.CapacityError), match="bytes"):
        fb.bake(trimesh.creation.box(), (60_000, 60_000, 4), device="gpu")


def test_unknown_devices_are_named():
    with pytest.raises(fb.DeviceError, match="abacus"):
        fb.bake(trimesh.creation.box(), 8, device="abacus")


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(code)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.no_gpu
def test_without_a_driver_gpu_is_an_error_and_auto_is_the_cpu():
    nowhere = {"VK_ICD_FILENAMES": "/nonexistent", "VK_DRIVER_FILES": "/nonexistent", "FIELDBAKE_DEVICE": ""}
    done = python(
        """
        import fieldbake as fb, trimesh
        box = trimesh.creation.box()
        try:
            fb.bake(box, 8, device="gpu")
        except fb.DeviceError as error:
            assert "no Vulkan" in str(error), error
        else:
            raise SystemExit("no error")
        assert fb.bake(box, 8).report.device == "cpu"
        """,
        **nowhere,
    )
    assert done.returncode == 0, done.stderr


def test_the_environment_overrides_auto_alone():
    code = "import fieldbake as fb, trimesh; print(fb.bake(trimesh.creation.box(), 8, device={}).report.device)"
    assert python(code.format("'auto'"), FIELDBAKE_DEVICE="gpu").stdout.strip() != "cpu"
    assert python(code.format("'cpu'"), FIELDBAKE_DEVICE="gpu").stdout.strip() == "cpu"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_gets_an_error():
    done = python(
        """
        import os
        import fieldbake as fb, trimesh
        box = trimesh.creation.box()
        fb.bake(box, 8, device="gpu")
        child = os.fork()
        if child == 0:
            try:
                fb.bake(box, 8, device="gpu")
            except fb.DeviceError as error:
                os._exit(0 if "fork" in str(error) else 2)
            os._exit(3)
        raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        """
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit and the size of the process are Linux's")
def test_memory_that_runs_out_is_an_error_and_the_next_bake_works():
    done = python(
        """
        import pathlib, resource
        import fieldbake as fb
        knot = fb.models.torus_knot(segments=64, sides=8)
        fb.bake(knot, 8, device="gpu")
        pages = int(pathlib.Path("/proc/self/statm").read_text().split()[0])
        free = resource.RLIM_INFINITY
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (300 << 20), free))
        try:
            fb.bake(knot, (640, 640, 640), device="gpu")
        except fb.DeviceError as error:
            assert "memory" in str(error), error
        else:
            raise SystemExit("a gigabyte in 300 MiB")
        resource.setrlimit(resource.RLIMIT_AS, (free, free))
        fb.bake(knot, 8, device="gpu").distances
        """
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(os.name == "nt", reason="interrupts are sent another way there")
def test_an_interrupt_stops_a_long_bake_and_the_next_one_works():
    done = python(
        """
        import os, signal, threading, time
        import fieldbake as fb, trimesh
        # A shell that starts the tests in the background has them ignore it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        ball = fb.Mesh(*(lambda m: (m.vertices, m.faces))(trimesh.creation.icosphere(subdivisions=4)))
        fb.bake(ball, 4, device="gpu")
        sent = []
        def interrupt():
            sent.append(time.perf_counter())
            os.kill(os.getpid(), signal.SIGINT)
        threading.Timer(0.5, interrupt).start()
        try:
            fb.bake(ball, 600, device="gpu")
        except KeyboardInterrupt:
            late = time.perf_counter() - sent[0]
        else:
            raise SystemExit("not interrupted")
        assert late < 2.0, late
        fb.bake(ball, 4, device="gpu").distances
        """
    )
    assert done.returncode == 0, done.stderr
