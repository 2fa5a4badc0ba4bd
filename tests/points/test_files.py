"""Files of points and splats, and clouds of other libraries."""

import json
import time
from types import SimpleNamespace

import laspy
import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import fieldbake as fb
import meshes
from fieldbake.cli.application import app

SAMPLES = fb.sample_surface(meshes.torus(), 300)


def write_ply(path, columns, binary=True):
    """Write a PLY file of vertices with float properties."""
    kind = "binary_little_endian" if binary else "ascii"
    names = "".join(f"property float {name}\n" for name in columns)
    rows = np.stack(list(columns.values()), axis=1).astype("<f4")
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(rows)}\n{names}end_header\n"
    body = rows.tobytes() if binary else "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    path.write_bytes(header.encode() + body)


def splats(points, normals, scales, opacities):
    """Columns of the original layout: logarithms of scales, logits of opacities, rotations with z along the normal."""
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(z, normals)
    rotations = np.column_stack([1 + normals[:, 2], axis])
    rotations[normals[:, 2] < -1 + 1e-9] = (0, 1, 0, 0)
    columns = dict(zip("xyz", points.T, strict=True))
    columns |= {name: np.zeros(len(points)) for name in ("nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0")}
    columns["opacity"] = np.log(opacities / (1 - opacities))
    columns |= {f"scale_{i}": np.log(scales[:, i]) for i in range(3)}
    # Any length of the quaternion is valid.
    return columns | {f"rot_{i}": 3 * rotations[:, i] for i in range(4)}


@pytest.mark.parametrize("ending", ["ply", "ascii.ply", "xyz", "npy", "npz"])
def test_points_and_normals_are_read(tmp_path, ending):
    path = tmp_path / f"cloud.{ending}"
    points, normals = SAMPLES.points, SAMPLES.normals
    if ending.endswith("ply"):
        columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), np.hstack([points, normals]).T, strict=True))
        write_ply(path, columns, binary=ending == "ply")
    elif ending == "npz":
        np.savez(path, points=points, normals=normals, areas=np.full(300, 0.1))
    else:
        save = np.save if ending == "npy" else np.savetxt
        save(path, np.hstack([points, normals]))

    cloud = fb.load_points(path)

    rounding = 1e-6 if ending.endswith("ply") else 1e-12
    assert np.abs(cloud.points - points).max() <= rounding
    assert np.abs(cloud.normals - normals).max() <= rounding
    assert (cloud.areas == 0.1).all() == (ending == "npz")


def test_other_columns_are_not_normals(tmp_path):
    colors = np.random.default_rng(0).integers(0, 256, (300, 3))
    np.savetxt(tmp_path / "colors.xyz", np.hstack([SAMPLES.points, colors]))
    assert fb.load_points(tmp_path / "colors.xyz").normals is None
    np.savetxt(tmp_path / "both.xyz", np.hstack([SAMPLES.points, colors, SAMPLES.normals]))
    assert np.abs(fb.load_points(tmp_path / "both.xyz").normals - SAMPLES.normals).max() <= 1e-12
    np.savetxt(tmp_path / "plain.xyz", SAMPLES.points)
    assert fb.load_points(tmp_path / "plain.xyz").report.normals == "none"


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_las_files_keep_their_coordinates(tmp_path, ending):
    path = tmp_path / f"cloud.{ending}"
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = (5e6, 4e6, 0), (1e-4,) * 3
    file = laspy.LasData(header)
    file.xyz = SAMPLES.points + np.array([5e6, 4e6, 0])
    file.write(path)
    cloud = fb.load_points(path)
    assert np.abs(cloud.points - SAMPLES.points - (5e6, 4e6, 0)).max() <= 1e-4
    half = tmp_path / f"half.{ending}"
    half.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(fb.FormatError, match="half"):
        fb.load_points(half)


def test_las_without_laspy_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    (tmp_path / "cloud.las").write_bytes(b"LASF")
    with pytest.raises(fb.Error, match=r"needs the package laspy; install it with: pip install 'fieldbake\[points\]'"):
        fb.load_points(tmp_path / "cloud.las")


def test_splats_of_a_sphere_make_its_ball(tmp_path):
    random = np.random.default_rng(3)
    normals = random.normal(size=(4_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scales = np.tile([0.05, 0.04, 0.004], (4_000, 1))
    opacities = np.full(4_000, 0.9)
    opacities[::10] = 0.1
    columns = splats(2 * normals, normals, scales, opacities)
    write_ply(tmp_path / "ball.ply", columns)

    cloud = fb.load_points(tmp_path / "ball.ply")

    assert len(cloud) == 3_600
    assert (cloud.report.low_opacity, cloud.report.round_splats, cloud.normals) == (400, 0, None)
    assert len(fb.load_points(tmp_path / "ball.ply", opacity=0.05)) == 4_000
    with pytest.raises(fb.MeshError, match="no normals, so no inside"):
        fb.contains(cloud, [(0, 0, 0)])
    oriented = cloud.oriented()
    kept = normals[opacities > 0.5]
    assert np.einsum("ij,ij->i", oriented.normals, kept).min() > 1 - 1e-5
    assert oriented.report.low_opacity == 400
    made = fb.solid(oriented, 48)
    assert made.is_closed
    radius = np.linalg.norm(fb.sample_surface(made, 2_000).points, axis=1)
    assert abs(radius.mean() / 2 - 1) <= 0.02

    columns["scale_2"] = columns["scale_1"].copy()
    write_ply(tmp_path / "round.ply", columns)
    round_cloud = fb.load_points(tmp_path / "round.ply")
    assert round_cloud.report.round_splats == 3_600
    # Their lines come from the neighbours.
    assert np.einsum("ij,ij->i", round_cloud.oriented().normals, kept).min() > 0.9


def test_a_room_of_splats_has_its_air_inside(tmp_path):
    samples = fb.sample_surface(meshes.box((-2, -1.5, -1), (2, 1.5, 1)), 6_000)
    scales = np.tile([0.06, 0.05, 0.003], (6_000, 1))
    write_ply(tmp_path / "room.ply", splats(samples.points, samples.normals, scales, np.full(6_000, 0.95)))

    room = fb.load_points(tmp_path / "room.ply").oriented(viewpoints=(0.3, 0.1, 0))

    assert room.report.normals == "viewpoints"
    assert room.report.inside_out
    assert np.einsum("ij,ij->i", room.normals, samples.normals).max() < -0.99
    assert fb.contains(room, [(0, 0, 0), (1.5, 1, 0.5), (2.5, 0, 0), (0, 0, 1.3)]).tolist() == [
        True,
        True,
        False,
        False,
    ]
    made = fb.solid(room, 48)
    assert made.is_closed
    assert made.volume == pytest.approx(24, rel=0.03)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.xyz", b"", "has no points"),
        ("comments.xyz", b"# x y z\n", "has no points"),
        ("words.xyz", b"a b c\n", "points: line 1 must be numbers separated by spaces, got 'a b c'"),
        ("commas.xyz", b"# x\n\n1,2,3\n", "points: line 3 must be numbers separated by spaces, got '1,2,3'"),
        ("semicolons.xyz", b"1;2;3\n", "points: line 1 must be numbers separated by spaces, got '1;2;3'"),
        ("ragged.xyz", b"1 2 3\n1 2\n", "points: line 2 has 2 numbers, the lines above have 3"),
        ("bytes.xyz", b"\xff\xfe\x00", "points: line 1 must be numbers separated by spaces"),
        ("two.xyz", b"1 2\n3 4\n", "must hold rows of three numbers"),
        ("empty.ply", b"", "cannot be read as points"),
        ("cloud.pcd", b"1 2 3", "points are read from .ply, .xyz, .npy, .npz, .las, .laz, got '.pcd'"),
        ("empty.npy", b"", "cannot be read as points"),
        ("cloud.npz", b"PK", "cannot be read as points"),
        ("nan.xyz", b"0 0 0\nnan 0 0\n" + b"1 2 3\n" * 9, r"points\[1\]: must be finite"),
    ],
)
def test_damaged_files_are_named_at_once(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    start = time.perf_counter()
    with pytest.raises((fb.FormatError, fb.ArgumentError), match=message) as caught:
        fb.load_points(tmp_path / name)
    assert time.perf_counter() - start < 1
    assert name in str(caught.value)


def test_truncated_and_mesh_files_are_refused(tmp_path):
    write_ply(tmp_path / "cloud.ply", dict(zip("xyz", SAMPLES.points.T, strict=True)))
    whole = (tmp_path / "cloud.ply").read_bytes()
    for length in range(0, len(whole), 97):
        (tmp_path / "cut.ply").write_bytes(whole[:length])
        with pytest.raises(fb.FormatError, match="cut"):
            fb.load_points(tmp_path / "cut.ply")
    fb.Mesh(*meshes.tetrahedron()).save(tmp_path / "mesh.ply")
    with pytest.raises(fb.FormatError, match="is a mesh: use"):
        fb.load_points(tmp_path / "mesh.ply")
    for read in (fb.load_mesh, fb.bake):
        with pytest.raises(fb.MeshError, match="read points by"):
            read(tmp_path / "cloud.ply")
    with pytest.raises(FileNotFoundError):
        fb.load_points(tmp_path / "missing.ply")
    with pytest.raises(fb.ArgumentError, match="opacity: must be"):
        fb.load_points(tmp_path / "cloud.ply", opacity=1.5)
    columns = splats(SAMPLES.points, SAMPLES.normals, np.ones((300, 3)), np.full(300, 0.2))
    write_ply(tmp_path / "faint.ply", columns)
    with pytest.raises(fb.FormatError, match="no splat with an opacity of at least"):
        fb.load_points(tmp_path / "faint.ply")
    write_ply(tmp_path / "zero.ply", columns | {f"rot_{i}": np.zeros(300) for i in range(4)})
    with pytest.raises(fb.FormatError, match="rotation is zero"):
        fb.load_points(tmp_path / "zero.ply", opacity=0)


def test_clouds_of_other_libraries_are_taken():
    cloud = fb.PointCloud(SAMPLES.points, SAMPLES.normals)
    queries = np.zeros((1, 3))
    expected = fb.closest_point(fb.PointCloud(SAMPLES.points), queries).distances
    assert np.array_equal(fb.closest_point(trimesh.PointCloud(SAMPLES.points), queries).distances, expected)
    # Objects with the attributes of Open3D's clouds.
    legacy = SimpleNamespace(points=SAMPLES.points, normals=SAMPLES.normals, has_normals=lambda: True)
    bare = SimpleNamespace(points=SAMPLES.points, normals=np.empty((0, 3)), has_normals=lambda: False)
    assert np.array_equal(fb.query(legacy, queries).distances, fb.query(cloud, queries).distances)
    assert np.array_equal(fb.closest_point(bare, queries).distances, expected)

    class Point(dict):
        __getattr__ = dict.__getitem__

    tensor = SimpleNamespace(point=Point(positions=SAMPLES.points, normals=SAMPLES.normals))
    assert np.array_equal(fb.query(tensor, queries).distances, fb.query(cloud, queries).distances)
    for other in (legacy, tensor, trimesh.PointCloud(SAMPLES.points)):
        with pytest.raises(fb.MeshError, match="is a cloud of points"):
            fb.as_mesh(other)


def test_pyvista_clouds_are_taken():
    pyvista = pytest.importorskip("pyvista")
    data = pyvista.PolyData(SAMPLES.points)
    data.point_data["Normals"] = SAMPLES.normals
    cloud = fb.PointCloud(SAMPLES.points, SAMPLES.normals)
    queries = np.zeros((1, 3))
    assert np.allclose(fb.query(data, queries).distances, fb.query(cloud, queries).distances, atol=1e-6)


@pytest.mark.parametrize("ending", ["ply", "xyz"])
def test_the_command_info_describes_points(tmp_path, ending):
    path = tmp_path / f"cloud.{ending}"
    if ending == "ply":
        write_ply(path, dict(zip("xyz", SAMPLES.points.T, strict=True)))
    else:
        np.savetxt(path, np.hstack([SAMPLES.points, SAMPLES.normals]))

    text = CliRunner().invoke(app, ["info", str(path)])
    facts = CliRunner().invoke(app, ["info", "--json", str(path)])

    assert text.exit_code == facts.exit_code == 0
    assert "300 points" in text.output
    assert json.loads(facts.output)["normals"] == ("none" if ending == "ply" else "given")
