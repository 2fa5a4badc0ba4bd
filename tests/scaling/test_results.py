"""Results of libraries: formats, encodings, shapes, samples in one store, and options that are checked before work."""

import numpy as np
import pytest

import assets
import fieldbake as fb
import meshes
import truth
from fieldbake.scaling.library import sample_many


@pytest.fixture
def boxes():
    return {"a": assets.box(1), "b": assets.box(1.2)}


def many(items, out, function=fb.bake_many, **options):
    return function(items, out, **{"workers": 1, **options})


def statuses(rows):
    return [row["status"] for row in rows]


@pytest.mark.parametrize(
    ("form", "encoding"), [("vdb", None), pytest.param(".dds", "snorm8", marks=pytest.mark.slow), ("npz", "snorm16")]
)
def test_results_have_the_format_and_the_encoding(boxes, tmp_path, form, encoding):
    rows = many(boxes, tmp_path, resolution=8, format=form, encoding=encoding, band=3)
    ending = "." + form.lstrip(".")
    assert [row["path"] for row in rows] == [str(tmp_path / f"{stem}{ending}") for stem in boxes]
    exact = fb.bake(boxes["b"], 8)
    found = fb.load(rows[1]["path"])
    if ending != ".vdb":
        assert found.encoding == encoding
    width = 3 * exact.spacing[0]
    # Half a step of snorm8, and the float16 values of a level set.
    assert np.abs(found.distances - exact.distances.clip(-width, width)).max() <= width / 127
    assert statuses(many(boxes, tmp_path, resolution=8, format=form, encoding=encoding, band=3)) == ["skipped"] * 2


def test_shapes_are_items(tmp_path):
    items = {"ball": fb.sphere(1), "two": [fb.sphere(1), fb.box((1, 1, 1))], "made": lambda: fb.sphere(2)}
    rows = many(items, tmp_path, resolution=8)
    assert statuses(rows) == ["done"] * 3
    assert fb.load(rows[0]["path"]).distances.tobytes() == fb.bake(fb.sphere(1), 8).distances.tobytes()
    assert statuses(many({**items, "ball": fb.sphere(1.5)}, tmp_path, resolution=8)) == ["done", "skipped", "skipped"]


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"resolution": -4}, "resolution"),
        ({"resolution": 8, "voxel_size": 0.1}, "voxel_size"),
        ({"voxel_size": -1}, "voxel_size"),
        ({"sign": "foo"}, "sign"),
        ({"sign": None}, "sign"),
        ({"device": 3}, "device"),
        ({"margin": -1}, "margin"),
        ({"band": 0}, "band"),
        ({"bounds": [0, 1]}, "bounds"),
        ({"thickness": 1}, "thickness"),
        ({"format": "stl"}, "format"),
        ({"encoding": "int4"}, "encoding"),
        ({"format": "vdb", "encoding": "snorm8"}, "encoding"),
    ],
)
def test_wrong_options_are_errors_before_any_work(boxes, tmp_path, options, name):
    with pytest.raises(fb.ArgumentError, match=name):
        many(boxes, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_options_in_units_of_the_meshes_are_right_for_all_sizes(tmp_path):
    tiny = {"tiny": assets.box(1e-9)}
    assert statuses(many(tiny, tmp_path / "a", voxel_size=2e-10)) == ["done"]
    assert statuses(many(tiny, tmp_path / "b", resolution=8, two_sided=True, thickness=4e-10)) == ["done"]


@pytest.mark.parametrize("options", [{}, {"n": -5}, {"n": 2.5}, {"n": 5, "uniform": 2}, {"n": 5, "near": [-1]}])
def test_wrong_options_of_samples_are_errors_before_any_work(boxes, tmp_path, options):
    with pytest.raises(fb.ArgumentError):
        many(boxes, tmp_path / "out", sample_many, **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [{"format": "vdb"}, {"encoding": "snorm8"}])
def test_formats_of_fields_do_not_apply_to_samples(boxes, tmp_path, options):
    with pytest.raises(fb.ArgumentError, match="format, encoding: do not apply to samples"):
        many(boxes, tmp_path / "out", sample_many, n=5, **options)


def test_a_foreign_array_is_not_a_store_of_samples(boxes, tmp_path):
    zarr = pytest.importorskip("zarr")
    zarr.create_array(tmp_path / "s.zarr", shape=(3,), dtype="f4", zarr_format=3)[:] = 7
    with pytest.raises(fb.FormatError, match="other contents"):
        many(boxes, tmp_path / "s.zarr", sample_many, n=5)
    assert zarr.open_array(tmp_path / "s.zarr", mode="r")[0] == 7


def test_bounds_and_voxels_have_the_same_units(tmp_path):
    large = {"large": assets.box(1e12)}
    options = {"bounds": [[-1e12] * 3, [1e12] * 3], "voxel_size": 4e11}
    assert statuses(many(large, tmp_path, **options)) == ["done"]


def test_samples_and_fields_do_not_overwrite_each_other(boxes, tmp_path):
    many(boxes, tmp_path, resolution=8)
    before = (tmp_path / "a.npz").read_bytes()
    with pytest.raises(fb.ArgumentError, match=r"out: a\.npz in .* is a result of 'bake'"):
        many(boxes, tmp_path, sample_many, n=5)
    assert (tmp_path / "a.npz").read_bytes() == before
    with pytest.raises(fb.ArgumentError, match=r"out: must be a folder or end in \.zarr"):
        many(boxes, tmp_path / "s.parquet", sample_many, n=5)


def test_samples_go_into_one_store(boxes, tmp_path):
    zarr = pytest.importorskip("zarr")
    out = tmp_path / "s.zarr"
    assert statuses(many(boxes, out, sample_many, n=50, seed=3)) == ["done"] * 2
    group = zarr.open_group(out, mode="r")
    direct = fb.sample_training(boxes["b"], 50, seed=3)
    assert np.array_equal(group["b"]["points"][...], direct.points)
    for name in ("distances", "gradients"):
        assert np.array_equal(group["b"][name][...], getattr(direct, name).astype(np.float32))
    assert statuses(many(boxes, out, sample_many, n=50, seed=3)) == ["skipped"] * 2
    boxes["b"] = assets.box(2)
    assert statuses(many(boxes, out, sample_many, n=50, seed=3)) == ["skipped", "done"]
    assert not list(out.glob(".*"))
    (out / "c").mkdir()
    (out / "c" / "thesis.txt").write_text("work")
    (row,) = many({"c": boxes["a"]}, out, sample_many, n=50)
    assert "other contents" in row["error"]
    assert (out / "c" / "thesis.txt").read_text() == "work"


@pytest.mark.parametrize("dtype", [None, "float32"])
def test_distances_of_stored_samples_belong_to_the_stored_points(tmp_path, dtype):
    sphere = meshes.icosphere(3, center=(512345, 4187654, 100))
    (row,) = many({"a": sphere}, tmp_path, sample_many, n=500, **({} if dtype is None else {"dtype": dtype}))
    with np.load(row["path"]) as found:
        points, distances = found["points"], found["distances"]
    assert (points.dtype.name, distances.dtype.name) == (dtype or "float64", "float32")
    expected = truth.closest_point(*sphere, points.astype(np.float64)).distances
    # Rounding of distances below 4 to float32, and of positions of 4e6 in float64.
    assert np.abs(np.abs(distances) - expected).max() <= 4 * np.finfo(np.float32).eps + 1e-8
    other = "float32" if dtype is None else "float64"
    assert statuses(many({"a": sphere}, tmp_path, sample_many, n=500, dtype=other)) == ["done"]


def test_rows_of_samples_have_the_report_of_their_mesh(tmp_path):
    items = {"closed": assets.box(1), "open": meshes.open_box(), "made": meshes.open_box}
    rows = many(items, tmp_path, sample_many, n=2000, uniform=0.5)
    assert [row["report"]["boundary_edges"] for row in rows] == [0, 4, 4]
    assert [len(row["report"]["warnings"]) for row in rows] == [0, 1, 1]
    with np.load(rows[1]["path"]) as found:
        winding = fb.winding_number(items["open"], found["points"], error=1e-6)
    uncertain = np.count_nonzero(np.abs(winding - 0.5) < 0.05)
    assert uncertain > 0
    assert [row["report"]["undecided_voxels"] for row in rows] == [0, uncertain, uncertain]
    assert [row["report"] for row in many(items, tmp_path, sample_many, n=2000, uniform=0.5)] == [
        row["report"] for row in rows
    ]


@pytest.mark.parametrize("target", ["unit cube", "unit sphere"])
@pytest.mark.parametrize("out", ["out", "out.zarr"])
def test_samples_of_normalized_meshes_have_the_transform(tmp_path, out, target):
    box = meshes.scale_and_shift(meshes.box(), 3.0, (50, -20, 7))
    if out == "out.zarr":
        pytest.importorskip("zarr")
    assert statuses(many({"a": box}, tmp_path / out, sample_many, n=400)) == ["done"]
    (row,) = many({"a": box}, tmp_path / out, sample_many, n=400, normalize=target)
    assert (row["status"], row["error"]) == ("done", None)
    if out == "out.zarr":
        import zarr

        found = {name: array[...] for name, array in zarr.open_group(row["path"], mode="r").arrays()}
    else:
        found = dict(np.load(row["path"]))
    # Half the side of the box becomes 1/2, or 1/sqrt(3).
    scale = (0.5 if target == "unit cube" else 1 / np.sqrt(3)) / 3
    assert np.abs(found["transform"][:3, :3] - scale * np.eye(3)).max() <= 1e-15
    world = (found["points"] - found["transform"][:3, 3]) / scale
    distances = truth.closest_point(*box, world).distances * scale
    assert np.abs(np.abs(found["distances"]) - distances).max() <= 1e-7
    with pytest.raises(fb.ArgumentError, match='normalize: must be one of "unit cube", "unit sphere"'):
        many({"a": box}, tmp_path / out, sample_many, n=400, normalize="unit box")


def broken():
    raise ValueError("boom")


def test_errors_of_callables_name_the_item(tmp_path):
    with pytest.raises(ValueError, match="boom") as caught:
        many({"one": lambda: broken()}, tmp_path, resolution=8, on_error="raise")
    if hasattr(caught.value, "add_note"):  # Python 3.11
        assert caught.value.__notes__ == ["in item one"]


def test_progress_reaches_1_when_nothing_is_left(boxes, tmp_path):
    many(boxes, tmp_path, resolution=8)
    shares = []
    many(boxes, tmp_path, resolution=8, progress=shares.append)
    assert shares == [1.0]
