"""The bake: positions and values of samples, memory and time, progress and cancellation."""

import os
import re
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth

CUBE = meshes.box()
SLAB = meshes.box((0, 0, 0), (4, 2, 1))


def run_python(script, *, env=None, **options):
    """Run a script in a process of its own, with the test helpers on its path."""
    preamble = f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1] / 'support')!r})\n"
    return subprocess.Popen(
        [sys.executable, "-c", preamble + textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **(env or {})},
        **options,
    )


# --- the grid


def test_samples_sit_at_voxel_centres(device):
    volume = fb.bake(SLAB, resolution=20, device=device)

    assert volume.spacing == pytest.approx((volume.bounds[1] - volume.bounds[0]) / volume.resolution)
    assert volume.origin == pytest.approx(volume.bounds[0] + volume.spacing / 2)
    points = truth.grid_points(*volume.bounds, volume.resolution)
    assert np.abs(volume.distances - truth.box(points, (0, 0, 0), (4, 2, 1))).max() <= truth.tolerance(*SLAB).item()


def test_x_comes_first_in_the_shape_and_is_fastest_in_memory():
    volume = fb.bake(SLAB, resolution=20)

    assert volume.distances.shape == volume.resolution
    assert volume.resolution[0] > volume.resolution[1] > volume.resolution[2]
    assert volume.distances.strides[0] == 4
    assert volume.distances.T.flags.c_contiguous
    assert volume.distances.dtype == np.float32


def test_one_number_gives_cubic_voxels_along_the_longest_side():
    volume = fb.bake(SLAB, resolution=40)

    assert volume.resolution[0] == 40
    assert volume.spacing == pytest.approx([4 * 1.1 / 40] * 3)
    assert volume.bounds.mean(axis=0) == pytest.approx((2, 1, 0.5))
    wanted = np.array([[0, 0, 0], [4, 2, 1]]) + np.array([[-0.05], [0.05]]) * (4, 2, 1)
    assert (volume.bounds[0] <= wanted[0] + 1e-9).all()
    assert (volume.bounds[1] >= wanted[1] - 1e-9).all()
    assert ((volume.bounds[1] - volume.bounds[0]) - (wanted[1] - wanted[0]) < 2 * volume.spacing + 1e-9).all()


def test_three_numbers_are_taken_as_given():
    volume = fb.bake(SLAB, resolution=(32, 32, 32))

    assert volume.resolution == (32, 32, 32)
    assert volume.bounds[1] - volume.bounds[0] == pytest.approx(np.array((4, 2, 1)) * 1.1)
    assert volume.bounds.mean(axis=0) == pytest.approx((2, 1, 0.5))


def test_voxel_size_is_the_side_of_a_cubic_voxel():
    volume = fb.bake(SLAB, voxel_size=0.25)

    assert volume.spacing == pytest.approx([0.25] * 3)
    assert (volume.bounds[0] <= (-0.2, -0.1, -0.05)).all()
    assert volume.resolution == (18, 10, 6)  # 4.4 / .25, and at least one voxel on each side


def test_bounds_with_three_numbers_are_taken_as_given():
    volume = fb.bake(SLAB, resolution=(5, 6, 7), bounds=[(-1, -2, -3), (4, 4, 4)])

    assert np.array_equal(volume.bounds, [(-1, -2, -3), (4, 4, 4)])
    assert volume.resolution == (5, 6, 7)


def test_bounds_with_one_number_grow_about_their_centre():
    volume = fb.bake(SLAB, resolution=10, bounds=[(0, 0, 0), (10, 4.5, 1)])

    assert volume.resolution == (10, 5, 1)
    assert volume.bounds == pytest.approx(np.array([(0, -0.25, 0), (10, 4.75, 1)]))


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.5, 3.0])
def test_margin_scales_the_box_and_leaves_a_voxel_on_each_side(margin):
    volume = fb.bake(CUBE, resolution=20, margin=margin)

    assert volume.bounds[1][0] >= 1 + margin - 1e-9
    assert (volume.bounds[1] - 1 >= volume.spacing * (1 - 1e-6)).all()
    assert (-1 - volume.bounds[0] >= volume.spacing * (1 - 1e-6)).all()


def test_inner_bounds_are_the_box_of_the_surface():
    assert np.array_equal(fb.bake(SLAB, resolution=8).inner_bounds, [(0, 0, 0), (4, 2, 1)])


@pytest.mark.parametrize("resolution", [16, (16, 16, 16)])
def test_a_flat_mesh_gets_a_box_with_thickness(resolution):
    volume = fb.bake(meshes.flat_sheet(), resolution=resolution)

    assert (volume.bounds[1] - volume.bounds[0] > 0).all()
    assert volume.bounds[0][2] <= -volume.spacing[2] * (1 - 1e-6)
    assert volume.bounds[1][2] >= volume.spacing[2] * (1 - 1e-6)


@pytest.mark.parametrize("resolution", [1, 2, 3, (1, 1, 1), (1, 9, 2)])
def test_grids_of_a_few_voxels(resolution):
    volume = fb.bake(CUBE, resolution=resolution)

    expected = truth.box(truth.grid_points(*volume.bounds, volume.resolution))
    assert np.abs(volume.distances - expected).max() <= truth.tolerance(*CUBE).item()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resolution": 0}, "resolution"),
        ({"resolution": -4}, "resolution"),
        ({"resolution": 64.0}, "resolution"),
        ({"resolution": "64"}, "resolution"),
        ({"resolution": True}, "resolution"),
        ({"resolution": (8, 8)}, "resolution"),
        ({"resolution": (8, 0, 8)}, "resolution"),
        ({"resolution": 2**40}, "resolution"),
        ({"voxel_size": 0}, "voxel_size"),
        ({"voxel_size": -1.0}, "voxel_size"),
        ({"voxel_size": float("nan")}, "voxel_size"),
        ({"voxel_size": 1e-300}, "voxel_size"),
        ({"voxel_size": 0.1, "resolution": 8}, "voxel_size"),
        ({"margin": -0.1}, "margin"),
        ({"margin": float("inf")}, "margin"),
        ({"bounds": [(0, 0, 0), (1, 1, 0)]}, "bounds"),
        ({"bounds": [(1, 1, 1), (0, 0, 0)]}, "bounds"),
        ({"bounds": [(0, 0, 0), (1, 1, float("nan"))]}, "bounds"),
        ({"bounds": 3}, "bounds"),
        ({"band": 0}, "band"),
        ({"band": -1.0}, "band"),
        ({"band": "wide"}, "band"),
        ({"thickness": 0.1}, "thickness"),
        ({"thickness": -0.1, "two_sided": True}, "thickness"),
        ({"progress": 3}, "progress"),
    ],
    ids=str,
)
def test_an_option_that_makes_no_sense_is_named(options, message):
    with pytest.raises(fb.ArgumentError, match=message):
        fb.bake(CUBE, **{"resolution": 8, **options} if "voxel_size" not in options else options)


def test_an_unknown_device_is_refused():
    with pytest.raises(fb.DeviceError, match=r"abacus"):
        fb.bake(CUBE, resolution=8, device="abacus")


# --- the samples


@pytest.mark.parametrize(
    ("geometry", "closed_form", "curvature"),
    [
        (meshes.icosphere(4), truth.sphere, 1.0),
        (meshes.uv_sphere(48, 96), truth.sphere, 1.0),
        (meshes.box((-1, -2, -3), (1, 2, 3)), lambda p: truth.box(p, (-1, -2, -3), (1, 2, 3)), None),
        (meshes.torus(1.0, 0.4, 128, 64), lambda p: truth.torus(p, 1.0, 0.4), 1 / 0.4),
        (meshes.capsule(1.0, 0.5, 24, 96), lambda p: truth.capsule(p, 1.0, 0.5), 1 / 0.5),
    ],
    ids=["icosphere", "uv sphere", "box", "torus", "capsule"],
)
def test_closed_forms(device, geometry, closed_form, curvature):
    volume = fb.bake(geometry, resolution=32, device=device)

    facets = 0.0 if curvature is None else truth.facet_error(*geometry, curvature)
    expected = closed_form(truth.grid_points(*volume.bounds, volume.resolution))
    assert np.abs(volume.distances - expected).max() <= facets + truth.tolerance(*geometry).item()


@pytest.mark.parametrize("name", [*meshes.CLOSED, *meshes.OPEN])
def test_a_whole_grid_is_exact(device, name):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()

    volume = fb.bake(geometry, resolution=24, device=device)

    points = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    expected = truth.Reference(*geometry).distance(points)
    assert np.abs(np.abs(volume.distances.ravel()) - expected).max() <= truth.tolerance(*geometry).item()


ADVERSARIAL = {
    "box around the centre of a sphere": (meshes.icosphere(4), [(-1e-3,) * 3, (1e-3,) * 3]),
    "box far from the mesh": (meshes.knot(64, 8), [(1e3, 1e3, 1e3), (1e3 + 1, 1e3 + 2, 1e3 + 3)]),
    "box within one triangle": (meshes.triangle(), [(0.2, 0.2, -1e-3), (0.3, 0.3, 1e-3)]),
    "box that cuts the mesh": (meshes.knot(64, 8), [(0, -1, -0.5), (4, 2, 0.5)]),
    "box much larger than the mesh": (meshes.torus(segments=32, sides=12), [(-50, -40, -30), (60, 70, 80)]),
    "box around the smaller of two balls": (
        meshes.size_ratio(),
        [(1.5 - 3e-6, -3e-6, -3e-6), (1.5 + 3e-6, 3e-6, 3e-6)],
    ),
    "needles from end to end": (meshes.needle_fan(), [(-1.2, -1.2, -0.3), (1.2, 1.2, 0.3)]),
    "faces doubled in place": (meshes.doubled(meshes.flat_sheet()), [(-1, -1, -1), (1, 1, 1)]),
    "oblong voxels": (meshes.knot(64, 8), [(-4, -4, -0.01), (4, 4, 0.01)]),
}


@pytest.mark.parametrize("name", ADVERSARIAL)
def test_awkward_boxes_are_exact(device, name):
    geometry, bounds = ADVERSARIAL[name]

    volume = fb.bake(geometry, resolution=(17, 16, 15), bounds=bounds, device=device)

    points = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    expected = truth.Reference(*geometry).distance(points)
    assert (np.abs(np.abs(volume.distances.ravel()) - expected) <= truth.tolerance(*geometry, expected)).all()


@pytest.mark.parametrize("name", ["knot", "open_box", "cracked"])
def test_the_box_does_not_change_the_field(name):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    whole = fb.bake(geometry, resolution=(16, 16, 16), bounds=[(-4, -4, -4), (4, 4, 4)])

    part = fb.bake(geometry, resolution=(8, 8, 8), bounds=[(0, 0, 0), (4, 4, 4)])

    assert np.abs(part.distances - whole.distances[8:, 8:, 8:]).max() <= truth.tolerance(*geometry, 8).item()


def test_a_grid_and_single_points_agree():
    knot = meshes.knot(64, 8)

    volume = fb.bake(knot, resolution=16)

    points = truth.grid_points(*volume.bounds, volume.resolution)
    assert np.abs(fb.signed_distance(knot, points) - volume.distances).max() <= truth.tolerance(*knot).item()


def test_arrays_bake_is_the_same_bake(device):
    knot = meshes.knot(64, 8)
    volume = fb.bake(knot, resolution=(9, 10, 11), device=device)

    bare = fb.arrays.bake(*knot, volume.bounds[0], volume.bounds[1], (9, 10, 11), device=device)

    assert np.array_equal(bare, volume.distances)
    assert bare.strides[0] == 4


def test_asarray_is_a_read_only_view():
    volume = fb.bake(CUBE, resolution=8)

    view = np.asarray(volume)

    assert np.shares_memory(view, volume.distances)
    with pytest.raises(ValueError, match="read-only"):
        view[0, 0, 0] = 1


def test_repr_tells_shape_size_and_device():
    text = repr(fb.bake(CUBE, resolution=16))

    assert "16 x 16 x 16" in text
    assert "16.0 KiB" in text
    assert "cpu" in text


# --- band and two-sided


@pytest.mark.parametrize("band", [1, 3, 7.5])
@pytest.mark.parametrize("name", ["knot", "hollow_sphere", "open_box", "soup"])
def test_a_band_is_exact_within_and_a_lower_bound_outside(device, name, band):
    geometry = {**meshes.CLOSED, **meshes.OPEN}[name]()
    full = fb.bake(geometry, resolution=40, device=device)

    banded = fb.bake(geometry, resolution=40, band=band, device=device)

    width = band * float(full.spacing.max())
    tolerance = truth.tolerance(*geometry).item()
    exact, stored = np.abs(full.distances), np.abs(banded.distances)
    within = exact < width - tolerance
    assert np.array_equal(banded.distances < 0, full.distances < 0)
    assert np.abs(stored - exact)[within].max() <= tolerance
    assert (stored <= exact + tolerance).all()
    assert (stored[~within] >= width - 2 * tolerance).all()


def test_two_sided_is_a_sheet_of_the_given_thickness(random):
    sheet = meshes.flat_sheet()

    volume = fb.bake(sheet, resolution=24, two_sided=True, thickness=0.2)

    points = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    expected = truth.closest_point(*sheet, points).distances - 0.1
    assert np.abs(volume.distances.ravel() - expected).max() <= truth.tolerance(*sheet).item()
    assert (volume.distances < 0).any()


@pytest.mark.parametrize("options", [{"resolution": 16}, {"resolution": (24, 9, 13)}, {"voxel_size": 0.05}])
def test_two_sided_is_as_thick_as_the_diagonal_of_a_voxel_by_default(options):
    volume = fb.bake(meshes.triangle(), **options, two_sided=True)

    half = 1.001 * np.linalg.norm(volume.spacing) / 2
    points = truth.grid_points(*volume.bounds, volume.resolution).reshape(-1, 3)
    expected = truth.closest_point(*meshes.triangle(), points).distances - half
    assert np.abs(volume.distances.ravel() - expected).max() <= truth.tolerance(*meshes.triangle()).item()
    assert volume.inner_bounds == pytest.approx(np.array([(-half, -half, -half), (1 + half, 1 + half, half)]))
    # The sheet ends inside the box.
    outermost = [volume.distances.take(i, axis) for axis in range(3) for i in (0, -1)]
    assert all((side > 0).all() for side in outermost)


@pytest.mark.parametrize("resolution", [5, 32, 48, 63, 64, 65, 100, (40, 23, 11)])
@pytest.mark.parametrize("turn", ["level", "tilted", "diagonal"])
def test_a_two_sided_sheet_is_inside_its_field_at_every_resolution_and_offset(resolution, turn, random):
    axis = {"level": (0, 0, 1), "tilted": (0, 0.34, 0.94), "diagonal": (1, 1, 1)}[turn]
    normal = np.array(axis) / np.linalg.norm(axis)
    right = np.cross(normal, (1, -2, 0.5)) if turn == "diagonal" else np.array([1.0, 0, 0])
    right /= np.linalg.norm(right)
    corners = np.array([x * right + y * np.cross(normal, right) for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)]])
    sheet = corners + random.uniform(-1, 1, 3), [(0, 1, 2), (0, 2, 3)]

    volume = fb.bake(sheet, resolution, two_sided=True)

    weights = random.dirichlet((1, 1, 1), 500)
    points = np.concatenate([weights @ sheet[0][list(face)] for face in sheet[1]])
    # See `sheet_thickness`: the interpolated field is negative on all of the sheet, its rim included.
    assert (volume.sample(points) < 0).all()
    assert volume.report.inside_voxels == (volume.distances < 0).sum() > 0
    assert volume.report.warnings == ()


def test_a_box_that_cuts_a_sheet_between_two_layers_of_samples():
    box = [(-1, -1, -1), (1, 1, 1)]

    volume = fb.bake(meshes.flat_sheet(), (64, 64, 64), bounds=box, two_sided=True)
    thin = fb.bake(meshes.flat_sheet(), (64, 64, 64), bounds=box, two_sided=True, thickness=0.03)

    assert (volume.distances[:, :, 31:33] < 0).all()
    assert volume.report.warnings == ()
    assert thin.report.inside_voxels == 0
    assert any("thinner than the voxel" in w and " 0 samples are inside" in w for w in thin.report.warnings)


@pytest.mark.parametrize("sign", ["auto", "winding", "unsigned"])
def test_a_field_without_an_inside_is_a_warning(sign, device):
    far = [(4, 4, 4), (5, 5, 5)]

    baked = [
        fb.bake(CUBE, 8, bounds=far, sign=sign, device=device),
        fb.bake(CUBE, 8, bounds=far, two_sided=True, device=device),
        fb.bake_sparse(CUBE, 8, bounds=far, sign=sign),
        fb.bake(fb.sphere(1), 8, bounds=far),
    ]

    for volume in baked:
        assert any("no sample is inside" in warning for warning in volume.report.warnings)


def test_the_box_of_a_thick_sheet_holds_all_of_it():
    volume = fb.bake(meshes.flat_sheet(), resolution=24, two_sided=True, thickness=0.5)

    assert volume.inner_bounds == pytest.approx(np.array([(-1.25, -1.25, -0.25), (1.25, 1.25, 0.25)]))
    outermost = [volume.distances[i, :, :] for i in (0, -1)] + [volume.distances[:, :, i] for i in (0, -1)]
    assert all((side > 0).all() for side in outermost)


# --- same bytes


BYTES = """
    import hashlib, meshes, fieldbake as fb
    knot, ball = meshes.knot(64, 8), meshes.icosphere(4)
    cases = [
        (knot, {}), (meshes.open_box(), {}), (meshes.soup(), {}), (meshes.cracked(ball), {"band": 3}),
        (knot, {"sign": "pseudonormal"}), (ball, {"sign": "parity"}),
    ]
    for geometry, options in cases:
        print(hashlib.sha256(fb.bake(geometry, 40, **options).distances.tobytes()).hexdigest())
    print(hashlib.sha256(fb.raymarch(fb.bake(knot, 40), size=(40, 40)).color.tobytes()).hexdigest())
"""


def test_the_same_bytes_on_any_number_of_threads():
    runs = [run_python(BYTES, env={"RAYON_NUM_THREADS": threads}) for threads in ("1", "2", "5")]

    outputs = [run.communicate(timeout=60) for run in runs]

    assert all(run.returncode == 0 for run in runs), outputs
    assert len(outputs[0][0].splitlines()) == 7
    assert len({stdout for stdout, _ in outputs}) == 1


def test_the_same_bytes_in_any_order_of_work():
    knot = fb.Mesh(*meshes.knot(64, 8))
    first = fb.bake(knot, resolution=24).distances.tobytes()

    fb.signed_distance(knot, [[0, 0, 0]])
    fb.bake(knot, resolution=31, sign="pseudonormal")

    assert fb.bake(knot, resolution=24).distances.tobytes() == first


# --- cost and manners


def test_a_request_that_cannot_fit_fails_first_with_its_bytes():
    with pytest.raises(fb.CapacityError, match=r"needs (\d+) bytes") as caught:
        fb.bake(CUBE, resolution=(8000, 8000, 8000))

    needed = int(re.search(r"needs (\d+) bytes", str(caught.value))[1])
    assert 4 * 8000**3 <= needed <= 4 * 8000**3 + (64 << 20)
    assert isinstance(caught.value, MemoryError)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/self/status")
@pytest.mark.parametrize("options", [{}, {"band": 3}, {"sign": "winding"}], ids=str)
def test_memory_is_output_and_mesh_and_tree_and_64_mib(options):
    script = f"""
        import meshes, fieldbake as fb
        def status(name):
            return next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith(name))
        mesh = fb.Mesh(*meshes.knot(1500, 40))
        fb.bake(mesh, 8)                       # threads and tree
        open("/proc/self/clear_refs", "w").write("5")
        before = status("VmRSS")
        volume = fb.bake(mesh, (192, 192, 192), **{options!r})
        print(status("VmHWM") - before, volume.nbytes, mesh.nbytes)
    """
    run = run_python(script)
    stdout, stderr = run.communicate(timeout=100)

    assert run.returncode == 0, stderr
    grown, output, mesh = map(int, stdout.split())
    assert output == 4 * 192**3
    assert grown <= output + mesh + (64 << 20)


def test_progress_rises_to_one():
    shares = []

    fb.bake(meshes.knot(400, 40), resolution=128, progress=shares.append)

    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] == 1


@pytest.mark.parametrize("function", ["bake", "signed_distance", "closest_point", "raymarch"])
def test_everything_long_takes_progress(function):
    shares = []
    knot = meshes.knot(64, 8)
    if function in ("signed_distance", "closest_point"):
        getattr(fb, function)(knot, np.zeros((10, 3)), progress=shares.append)
    elif function == "raymarch":
        fb.raymarch(fb.bake(knot, 16), size=(16, 16), progress=shares.append)
    else:
        fb.bake(knot, 16, progress=shares.append)

    assert shares[-1] == 1


def test_an_exception_in_progress_stops_the_bake():
    class StopError(Exception):
        pass

    def stop(share):
        raise StopError

    with pytest.raises(StopError):
        fb.bake(meshes.knot(400, 40), resolution=160, progress=stop)
    assert fb.bake(CUBE, resolution=8).distances.shape == (8, 8, 8)


def test_progress_true_draws_on_stderr_only(capfd):
    fb.bake(CUBE, resolution=8, progress=True)

    assert capfd.readouterr().out == ""


def test_other_threads_run_while_a_bake_works():
    baking = threading.Thread(target=fb.bake, args=(meshes.knot(400, 40), 160))
    baking.start()
    turns = 0
    while baking.is_alive():
        turns += 1
        time.sleep(0.001)

    # Were the interpreter held, this loop would turn once or twice.
    assert turns >= 5


def test_two_bakes_at_once_do_not_disturb_each_other():
    mesh = fb.Mesh(*meshes.knot(64, 8))
    expected = fb.bake(mesh, resolution=32).distances
    found = [None] * 4

    def work(i):
        found[i] = fb.bake(mesh, resolution=32).distances

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(found))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert all(np.array_equal(distances, expected) for distances in found)


INTERRUPTED = {
    "bake": "fb.bake(mesh, 700, progress=ready)",
    "bake with winding numbers": "fb.bake(meshes.cracked(meshes.knot(400, 40)), 500, progress=ready)",
    "band": "fb.bake(mesh, 1200, band=20, progress=ready)",
    "signed_distance": "fb.signed_distance(mesh, points, progress=ready)",
    "closest_point": "fb.closest_point(mesh, points, progress=ready)",
    "raymarch": "fb.raymarch(fb.bake(mesh, 64), size=(4000, 4000), progress=ready)",
    # The search for visible surfaces is a thirteenth of the progress, so this is within the light pass.
    "render": "fb.render([mesh], size=(4000, 4000), ambient_occlusion=True, progress=lambda share: ready(share - 0.2))",
}

#: Largest delay after Ctrl-C that the interface guarantees, seconds.
CTRL_C = 0.5


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is a signal of POSIX here")
@pytest.mark.parametrize("name", INTERRUPTED)
def test_ctrl_c_stops_within_half_a_second(name):
    script = f"""
        import signal, time, numpy as np, meshes, fieldbake as fb
        signal.signal(signal.SIGINT, signal.default_int_handler)
        mesh = fb.Mesh(*meshes.knot(1000, 40))
        count = 5_000_000 if "points" in {INTERRUPTED[name]!r} else 0
        points = np.random.default_rng(0).uniform(-3, 3, size=(count, 3))
        told = []
        def ready(share):
            if not told and share > 0:
                told.append(share)
                print("ready", flush=True)
        try:
            {INTERRUPTED[name]}
        except KeyboardInterrupt:
            print(time.monotonic())
    """
    latencies = []
    for _ in range(3):  # Other work on the machine can only make it slower.
        run = run_python(script)
        assert run.stdout.readline() == "ready\n", run.communicate()
        sent = time.monotonic()
        run.send_signal(2)
        stdout, stderr = run.communicate(timeout=60)
        assert run.returncode == 0, stderr
        latencies.append(float(stdout) - sent)
        if latencies[-1] <= CTRL_C:
            return
    assert min(latencies) <= CTRL_C


def test_every_bake_takes_a_voxel_size_alone():
    assert fb.box(2).to_mesh(voxel_size=0.25).is_closed
    assert fb.bake_sparse(SLAB, voxel_size=0.25).spacing == pytest.approx([0.25] * 3)
    assert fb.bake_sparse(fb.box(2), voxel_size=0.25).spacing == pytest.approx([0.25] * 3)
    for make in (
        lambda: fb.box(2).to_mesh(64, voxel_size=0.25),
        lambda: fb.bake_sparse(SLAB, 64, voxel_size=0.25),
        lambda: fb.bake_sparse(fb.box(2), 64, voxel_size=0.25),
        lambda: fb.bake(SLAB, np.array([8, 8, 8]), voxel_size=0.25),
        lambda: fb.bake(SLAB, [[1], [1, 2]], voxel_size=0.25),
    ):
        with pytest.raises(fb.ArgumentError, match="either voxel_size"):
            make()


def test_sparse_and_dense_reports_state_the_same_thickness():
    sheet = ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    dense, sparse = fb.bake(sheet, 24, two_sided=True), fb.bake_sparse(sheet, 24, two_sided=True)
    assert 0 < dense.report.thickness == sparse.report.thickness
