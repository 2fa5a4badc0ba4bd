"""Updates of volumes and sequences of frames have the bits of whole bakes."""

import pickle

import numpy as np
import pytest

import fieldbake as fb
import meshes

SHAPE = (21, 19, 23)


def waves(vertices, phase=0.0, size=0.1):
    """Every vertex moved along a wave."""
    return vertices + size * np.sin(3 * np.roll(vertices, 1, axis=1) + phase)


def pushed(vertices, count, size=0.15, seed=0):
    """The vertices next to a random one moved."""
    random = np.random.default_rng(seed)
    center = vertices[random.integers(len(vertices))]
    moved = vertices.copy()
    near = np.argsort(np.linalg.norm(vertices - center, axis=1))[:count]
    moved[near] += random.uniform(-size, size, (count, 3))
    return moved


def assert_fresh(volume, mesh, vertices, faces, **options):
    """The volume equals a whole bake of a new mesh in its box."""
    fresh = fb.bake(fb.Mesh(vertices, faces), volume.resolution, bounds=volume.bounds, **options)
    assert volume.distances.tobytes() == fresh.distances.tobytes()
    assert volume.bounds.tobytes() == fresh.bounds.tobytes()
    assert volume.inner_bounds.tobytes() == fresh.inner_bounds.tobytes()
    ours, theirs = volume.report, fresh.report
    for name in (
        "sign_method",
        "inside_voxels",
        "undecided_voxels",
        "closed",
        "warnings",
        "faces",
        "thickness",
        "band",
    ):
        assert getattr(ours, name) == getattr(theirs, name), name


OPTIONS = {
    "auto": {},
    "winding": {"sign": "winding"},
    "parity": {"sign": "parity"},
    "pseudonormal": {"sign": "pseudonormal"},
    "normal": {"sign": "normal"},
    "unsigned": {"sign": "unsigned"},
    "sheet": {"two_sided": True},
    "thick sheet": {"two_sided": True, "thickness": 0.3},
    "band": {"band": 3},
}


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize(
    "kept",
    [slice(None), slice(10, None), slice(None, None, 2), slice(400, None)],
    ids=["closed", "open", "long opening", "soup"],
)
def test_an_update_has_the_bits_of_a_bake(options, kept):
    vertices, faces = meshes.icosphere(3)
    faces = faces[kept]
    mesh = fb.Mesh(vertices, faces)
    # The winding number of many open edges is a sum over the faces, at every sample.
    volume = fb.bake(mesh, (11, 10, 12) if kept.start == 400 else SHAPE, **options)
    thickness = {"thickness": volume.report.thickness} if "two_sided" in options else {}
    bits = volume.distances.tobytes()
    positions = vertices
    for step, (count, size) in enumerate([(20, 0.15), (1, 0.8), (len(vertices), 0.05), (150, 0.1)]):
        positions = pushed(positions, count, size, seed=step)
        mesh = mesh.moved(positions)
        first, volume = volume, volume.update(mesh)
        assert_fresh(volume, mesh, positions, faces, **{**options, **thickness})
        assert first is not volume
    assert fb.bake(fb.Mesh(vertices, faces), volume.resolution, **options).distances.tobytes() == bits


def test_an_update_on_a_device_has_the_bits_of_a_bake(device):
    vertices, faces = meshes.icosphere(2)
    mesh = fb.Mesh(vertices, faces)
    volume = fb.bake(mesh, 20, device=device)
    positions = pushed(vertices, 12)
    updated = volume.update(mesh.moved(positions))
    assert updated.report.device == volume.report.device
    assert_fresh(updated, mesh, positions, faces, device=device)


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
def test_any_mesh_may_follow():
    """A new mesh object, another mesh, a mesh that leaves the box, and one whose faces lost their area."""
    vertices, faces = meshes.icosphere(2)
    volume = fb.bake(fb.Mesh(vertices, faces), SHAPE)
    flat = vertices.copy()
    flat[faces[0][0]] = flat[faces[0][1]]
    for positions, triangles in (
        (pushed(vertices, 10), faces),
        (flat, faces),
        meshes.box(),
        (vertices + np.array([5, 0, 0]), faces),
        (vertices, faces[:, ::-1]),
        (vertices, faces),
    ):
        volume = volume.update((positions, triangles))
        assert_fresh(volume, None, positions, triangles)


@pytest.mark.filterwarnings("ignore::fieldbake.SurfaceWarning")
@pytest.mark.parametrize("options", [{}, {"sign": "parity"}, {"two_sided": True, "thickness": 0.3}, {"band": 2.3}])
def test_a_volume_from_a_file_bakes_whole_with_its_options(tmp_path, options):
    vertices, faces = meshes.icosphere(2)
    volume = fb.bake((vertices, faces), SHAPE, **options)
    volume.save(tmp_path / "sphere.npz")
    for copy in (fb.load(tmp_path / "sphere.npz"), pickle.loads(pickle.dumps(volume))):
        positions = waves(vertices)
        assert_fresh(copy.update((positions, faces)), None, positions, faces, **options)


def test_a_volume_of_an_array_or_a_shape_bakes_a_mesh():
    vertices, faces = meshes.icosphere(2)
    for volume in (fb.Volume(np.ones((20, 21, 22)), [(-2, -2, -2), (2, 2, 2)]), fb.bake(fb.sphere(1), 20)):
        assert_fresh(volume.update((vertices, faces)), None, vertices, faces)


def test_mistakes_are_named():
    volume = fb.bake(meshes.box(), 8)
    with pytest.raises(FileNotFoundError):
        volume.update("no such mesh")
    with pytest.raises(fb.MeshError):
        volume.update(None)
    vertices, faces = meshes.box()
    with pytest.raises(fb.ArgumentError, match="bounds"):
        volume.update((vertices * 1e-18, faces))


def test_the_box_of_a_volume_makes_its_own_grid():
    vertices, faces = meshes.icosphere(1)
    random = np.random.default_rng(0)
    for _ in range(50):
        volume = fb.bake((vertices * random.uniform(0.1, 3, 3) + random.uniform(-9, 9, 3), faces), 7)
        again = fb.bake((vertices, faces), volume.resolution, bounds=volume.bounds)
        assert again.bounds.tobytes() == volume.bounds.tobytes()


# --- sequences


def frames_of(count=4):
    vertices, faces = meshes.icosphere(2)
    return faces, [waves(vertices, 0.4 * step) for step in range(count)]


@pytest.mark.parametrize("bounds", ["common", "follow", [(-1.5, -1.4, -1.3), (1.5, 1.4, 1.3)]])
@pytest.mark.parametrize("kind", ["arrays", "meshes", "pairs", "generator"])
def test_a_sequence_has_the_bits_of_bakes(bounds, kind):
    faces, positions = frames_of()
    frames = [fb.Mesh(positions[0], faces), *positions[1:]]
    if kind == "meshes":
        frames = [fb.Mesh(vertices, faces) for vertices in positions]
    elif kind == "pairs":
        frames = [(vertices, faces) for vertices in positions]
    volumes = list(fb.bake_sequence(iter(frames) if kind == "generator" else frames, 18, bounds))

    assert len(volumes) == len(positions)
    for volume, vertices in zip(volumes, positions, strict=True):
        assert_fresh(volume, None, vertices, faces)
    boxes = {volume.bounds.tobytes() for volume in volumes}
    if bounds == "follow":
        for volume, vertices in zip(volumes, positions, strict=True):
            alone = fb.bake((vertices, faces), 18)
            assert volume.bounds.tobytes() == alone.bounds.tobytes()
            assert volume.distances.tobytes() == alone.distances.tobytes()
    else:
        assert len(boxes) == 1
    if bounds == "common":
        lower, upper = volumes[0].bounds
        assert (lower < np.min(positions, axis=(0, 1))).all()
        assert (upper > np.max(positions, axis=(0, 1))).all()


@pytest.mark.parametrize("options", [{"two_sided": True}, {"sign": "unsigned", "band": 2}, {"voxel_size": 0.11}])
def test_a_sequence_has_the_options_of_a_bake(options):
    faces, positions = frames_of(3)
    frames = [(positions[0], faces), *positions[1:]]
    kept = {name: value for name, value in options.items() if name != "voxel_size"}
    for bounds in ("common", "follow"):
        for volume, vertices in zip(fb.bake_sequence(frames, bounds=bounds, **options), positions, strict=True):
            thickness = {"thickness": volume.report.thickness} if "two_sided" in options else {}
            assert_fresh(volume, None, vertices, faces, **kept, **thickness)


def test_a_generator_is_read_one_frame_at_a_time_unless_the_box_is_common():
    faces, positions = frames_of()
    read = []

    def frames():
        buffer = positions[0].copy()
        for vertices in positions:
            buffer[:] = vertices
            read.append(len(read))
            yield buffer if len(read) > 1 else (buffer.copy(), faces)

    following = fb.bake_sequence(frames(), 12, "follow")
    assert read == []
    next(following)
    assert read == [0]

    read.clear()
    common = fb.bake_sequence(frames(), 12, "common")
    for volume, vertices in zip(common, positions, strict=True):
        # The one array of the generator was filled again before the first bake.
        assert read == [0, 1, 2, 3]
        assert_fresh(volume, None, vertices, faces)


def test_a_sequence_on_a_device_has_the_bits_of_bakes(device):
    faces, positions = frames_of(2)
    volumes = fb.bake_sequence([(positions[0], faces), positions[1]], 16, device=device)
    for volume, vertices in zip(volumes, positions, strict=True):
        assert_fresh(volume, None, vertices, faces, device=device)


def test_sequences_name_their_mistakes():
    faces, positions = frames_of(2)
    assert list(fb.bake_sequence([], 16)) == []
    with pytest.raises(fb.ArgumentError, match="bounds"):
        fb.bake_sequence([], 16, "nearby")
    with pytest.raises(fb.ArgumentError, match="bounds"):
        fb.bake_sequence([], 16, [(0, 0, 0), (0, 1, 1)])
    with pytest.raises(fb.ArgumentError, match="sign"):
        fb.bake_sequence([], 16, sign="odd")
    for frames in (None, 3, "bunny.obj", fb.Mesh(*meshes.box())):
        with pytest.raises(fb.ArgumentError, match="frames"):
            fb.bake_sequence(frames)
    with pytest.raises(fb.MeshError, match=r"frames\[0\]: must be a mesh"):
        list(fb.bake_sequence([positions[0]]))
    broken = positions[1].copy()
    broken[3] = np.nan
    for bounds in ("common", "follow"):
        with pytest.raises(fb.MeshError, match=r"frames\[1\]: vertices\[3\] ="):
            list(fb.bake_sequence([(positions[0], faces), broken], 8, bounds))
        with pytest.raises(fb.MeshError, match=r"frames\[1\]: vertices: must have one row for each of the 162"):
            list(fb.bake_sequence([(positions[0], faces), broken[1:]], 8, bounds))


@pytest.mark.slow
def test_a_hundred_frames_of_a_bending_bunny_have_the_bits_of_bakes(sample_path):
    bunny = fb.load_mesh(sample_path("bunny.obj"))
    vertices, faces = np.array(bunny.vertices), bunny.faces
    lower, upper = bunny.bounds
    height = (vertices[:, 1] - lower[1]) / (upper[1] - lower[1])

    def bent(frame):
        angle = 0.8 * np.sin(2 * np.pi * frame / 100) * height**2
        x, y = vertices[:, 0], vertices[:, 1]
        return np.stack(
            [x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), vertices[:, 2]], 1
        )

    positions = [bent(frame) for frame in range(100)]
    frames = [fb.Mesh(positions[0], faces), *positions[1:]]
    for volume, current in zip(fb.bake_sequence(frames, 32), positions, strict=True):
        fresh = fb.bake(fb.Mesh(current, faces), volume.resolution, bounds=volume.bounds)
        assert volume.distances.tobytes() == fresh.distances.tobytes()
