"""Shapes as implicit functions of 3MF files: the graph is evaluated here, in NumPy, and by no code of the package."""

import io
import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import scipy.ndimage
from hypothesis import given, settings
from PIL import Image

import fieldbake as fb
import meshes
import truth_csg
import truth_trees

MODEL = "3D/3dmodel.model"
IMPLICIT = "{http://schemas.3mf.io/3dmanufacturing/implicit/2023/12}"
VOLUMETRIC = "{http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01}"
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"

OPERATIONS = {
    "addition": np.add,
    "subtraction": np.subtract,
    "multiplication": np.multiply,
    "division": np.divide,
    "min": np.minimum,
    "max": np.maximum,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "sin": np.sin,
    "cos": np.cos,
    "floor": np.floor,
    "atan2": np.arctan2,
    "select": lambda a, b, c, d: np.where(a < b, c, d),
}


def model_of(path):
    with zipfile.ZipFile(path) as archive:
        return archive.read(MODEL)


def texels(resources, function, uvw, archive):
    """Trilinear samples of an image at positions (n, 3) from 0 to 1, clamped to the centres of its outer texels."""
    made = next(one for one in resources if one.get("id") == function)
    assert made.tag == f"{VOLUMETRIC}functionfromimage3d"
    assert [made.get(f"tilestyle{axis}") for axis in "uvw"] == ["clamp"] * 3
    assert made.get("filter") == "linear"
    image = next(one for one in resources if one.get("id") == made.get("image3did"))
    sheets = [sheet.get("path")[1:] for sheet in image.find(f"{VOLUMETRIC}imagestack")]
    with zipfile.ZipFile(archive) as package:
        rows = np.stack([np.asarray(Image.open(io.BytesIO(package.read(path)))) for path in sheets], axis=-1)
    # Row 0 is the largest v.
    values = rows[::-1].transpose(1, 0, 2) / 65535
    at = np.clip(uvw * values.shape - 0.5, 0, np.array(values.shape) - 1)
    found = scipy.ndimage.map_coordinates(values, at.T, order=1)
    return float(made.get("valueoffset")) + float(made.get("valuescale")) * found


def evaluated(archive, points):
    """The function of a file at points (n, 3), and its number of operations."""
    model = model_of(archive)
    resources = ElementTree.fromstring(model).find(f"{CORE}resources")
    function = resources.find(f"{IMPLICIT}implicitfunction")
    values = {}
    *_, out = function
    with np.errstate(divide="ignore", invalid="ignore"):
        for node in list(function)[1:-1]:
            kind, name = node.tag.removeprefix(IMPLICIT), node.get("identifier")
            if kind == "decomposevector":
                assert node.find(f"{IMPLICIT}in/*").get("ref") == "inputs.pos"
                values |= {f"{name}.{axis}": points[:, i] for i, axis in enumerate("xyz")}
            elif kind == "constant":
                values[f"{name}.value"] = np.float64(node.get("value"))
            elif kind == "constresourceid":
                values[f"{name}.value"] = node.get("value")
            elif kind == "composevector":
                parts = {one.get("identifier"): values[one.get("ref")] for one in node.find(f"{IMPLICIT}in")}
                values[f"{name}.result"] = np.stack([parts[axis] for axis in "xyz"], axis=-1)
            elif kind == "functioncall":
                inputs = {one.get("identifier"): values[one.get("ref")] for one in node.find(f"{IMPLICIT}in")}
                values[f"{name}.red"] = texels(resources, inputs["functionID"], inputs["pos"], archive)
            else:
                inputs = {one.get("identifier"): values[one.get("ref")] for one in node.find(f"{IMPLICIT}in")}
                values[f"{name}.result"] = OPERATIONS[kind](*(inputs[letter] for letter in "ABCD"[: len(inputs)]))
    result = out.find(f"{IMPLICIT}scalarref")
    assert result.get("identifier") == "shape"
    return np.broadcast_to(values[result.get("ref")], len(points)), len(function) - 2


BALL, CUBE = fb.sphere(0.8), fb.box(1.1)
STAR = [(np.cos(a) * r, np.sin(a) * r) for a, r in zip(np.linspace(0, 5.6, 10), [1, 0.4] * 5, strict=True)]

SHAPES = {
    **{solid.name: solid.shape for solid in truth_csg.SOLIDS},
    "gyroid": fb.gyroid(1, 0.1),
    "schwarz_p": fb.schwarz_p(1, 0.1),
    "diamond": fb.diamond(1, 0.1),
    "iwp": fb.iwp(1, 0.1),
    "plane": fb.plane((1, 2, 2)),
    "rod": fb.thread(1.6, 0.4, 2),
    "nut": fb.thread(1.6, 0.4, 2, internal=True),
    "taper and chamfer": fb.polygon(STAR).extrude(1, taper_deg=10, chamfer=0.1),
    "revolved at the axis": fb.polygon([(0, -0.5), (0.7, -0.4), (0.3, 0.5), (0, 0.5)]).revolve(),
    "text": fb.text("8", 1.5).extrude(0.5),
    "union": BALL | CUBE,
    "intersection": BALL & CUBE,
    "difference": CUBE - BALL,
    "xor": BALL ^ CUBE,
    "fillet": BALL.union(CUBE, k=0.3),
    "smooth difference": CUBE.difference(BALL, k=0.3),
    "chamfered union": BALL.union(CUBE, chamfer=0.2),
    "placed": CUBE.scale(0.7).rotate((1, 2, 3), 40).translate((0.3, -0.2, 0.1)),
    "twist": CUBE.twist(per_unit_deg=40),
    "bend": CUBE.bend(per_unit_deg=30),
    "elongate": BALL.elongate((0.5, 0, 0.2)),
    "repeat": CUBE.scale(0.3).repeat((0.5, 0.6, 0.7), (3, 2, 1)),
    "offset": CUBE.offset(0.1),
    "shell": CUBE.shell(0.1),
    "mirror": CUBE.translate((1, 0, 0)).mirror("x"),
}


def check_values(shape, path, box=1.5):
    points = np.random.default_rng(1).uniform(-box, box, (1000, 3))
    shape.save(path, implicit=True, within=CUBE.scale(2).to_mesh(8))
    found, count = evaluated(path, points)
    assert np.abs(found - shape.distance(points, dtype="float64")).max() <= 1e-9 * 2 * box
    assert fb.load(path).to_sexpr() == fb.csg.parse(shape.to_sexpr()).to_sexpr()
    return count


@pytest.mark.parametrize("name", SHAPES)
def test_the_graph_has_the_values_of_the_shape(name, tmp_path):
    check_values(SHAPES[name], tmp_path / "part.3mf")


@settings(max_examples=20, deadline=None)
@given(truth_trees.trees)
def test_the_graphs_of_random_trees(tmp_path_factory, tree):
    check_values(tree.shape, tmp_path_factory.mktemp("tree") / "part.3mf", box=3)


def test_equal_parts_are_one_part_of_the_graph(tmp_path):
    solid = fb.ellipsoid((1, 0.8, 0.6))
    one = check_values(solid, tmp_path / "one.3mf")
    both = check_values(solid - solid.shell(0.1), tmp_path / "both.3mf")
    assert one < both <= one + 10


def test_a_baked_volume_is_an_image_of_16_bits(tmp_path):
    volume = fb.bake(fb.torus(0.7, 0.25), (20, 22, 14))
    shape = fb.volume_shape(volume).rotate((1, 2, 3), 40).translate((0.2, 0.1, 0)) | fb.sphere(0.3)
    shape.save(tmp_path / "part.3mf", implicit=True)
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (1000, 3))
    found, _ = evaluated(tmp_path / "part.3mf", points)
    step = 2 * np.abs(volume.distances).max() / 65535
    assert np.abs(found - shape.distance(points)).max() <= step + 1e-6  # the field is float32
    with pytest.raises(fb.FormatError, match="baked volume"):
        fb.load(tmp_path / "part.3mf")


def test_divided_cells_of_a_baked_distance_are_in_its_image(tmp_path):
    shape = (fb.sphere(0.6) ^ fb.box(1)).offset(0.1, resolution=24)
    shape.save(tmp_path / "part.3mf", implicit=True)
    lower, upper = shape.bounds
    points = np.random.default_rng(1).uniform(lower - 0.1, upper + 0.1, (20_000, 3))
    found, _ = evaluated(tmp_path / "part.3mf", points)
    step = 2 * np.abs(shape.distance(points)).max() / 65535
    assert np.abs(found - shape.distance(points)).max() <= 2 * step + 1e-6  # the field is float32


@pytest.fixture
def warnings_of_lib3mf():
    """A function that reads a file in strict mode, and returns the warnings."""
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf has no wheel for this system")
    wrapper = lib3mf.get_wrapper()

    def read(path, is_strict=True):
        model = wrapper.CreateModel()
        reader = model.QueryReader("3mf")
        reader.SetStrictModeActive(is_strict)
        reader.ReadFromFile(str(path))
        level_sets = model.GetLevelSets()
        assert level_sets.MoveNext()
        assert level_sets.GetCurrentLevelSet().GetMesh().GetTriangleCount() > 0
        return [reader.GetWarning(i) for i in range(reader.GetWarningCount())]

    return read


def test_lib3mf_reads_every_operation_without_a_warning(warnings_of_lib3mf, tmp_path):
    clip = CUBE.to_mesh(8)
    for name, shape in SHAPES.items():
        shape.save(tmp_path / "part.3mf", implicit=True, within=clip)
        assert warnings_of_lib3mf(tmp_path / "part.3mf") == [], name
    BALL.save(tmp_path / "part.3mf", implicit=True, unit="inch", min_feature=0.25)
    assert warnings_of_lib3mf(tmp_path / "part.3mf") == []


def test_lib3mf_reads_images(warnings_of_lib3mf, tmp_path):
    fb.volume_shape(fb.bake(BALL, 8)).save(tmp_path / "part.3mf", implicit=True)
    # lib3mf 2.5 warns of every image3d, its own included, and refuses them in strict mode.
    found = {text for _, text in warnings_of_lib3mf(tmp_path / "part.3mf", is_strict=False)}
    assert found <= {"Invalid Element in namespace."}


def test_a_clipping_mesh_makes_a_small_file(tmp_path):
    clip = fb.Mesh(*meshes.icosphere(3))
    lattice = fb.gyroid(0.5, 0.06)
    lattice.save(tmp_path / "part.3mf", implicit=True, within=clip)
    (lattice & fb.sphere(1)).save(tmp_path / "part.stl", 256)
    assert 20 * (tmp_path / "part.3mf").stat().st_size <= (tmp_path / "part.stl").stat().st_size

    level_set = ElementTree.fromstring(model_of(tmp_path / "part.3mf")).find(f".//{VOLUMETRIC}levelset")
    assert level_set.get("meshbboxonly") == "false"
    mesh = ElementTree.fromstring(model_of(tmp_path / "part.3mf")).find(f".//{CORE}mesh")
    vertices = [[float(one.get(axis)) for axis in "xyz"] for one in mesh.find(f"{CORE}vertices")]
    faces = [[int(one.get(corner)) for corner in ("v1", "v2", "v3")] for one in mesh.find(f"{CORE}triangles")]
    points = np.random.default_rng(2).uniform(-1.1, 1.1, (10_000, 3))
    found, _ = evaluated(tmp_path / "part.3mf", points)
    inside = (found < 0) & fb.contains(fb.Mesh(vertices, faces), points)
    assert np.array_equal(inside, (lattice.distance(points) < 0) & fb.contains(clip, points))


def test_changed_and_foreign_functions_are_refused(tmp_path):
    path = tmp_path / "part.3mf"
    BALL.save(path, implicit=True)
    model = model_of(path).decode()

    def written(text):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(MODEL, text)
        return path

    foreign = re.sub(r'<metadata name="fieldbake:.*?</metadata>', "", model).replace("fieldbake 0", "Another 0")
    entities = '<!DOCTYPE model [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>'
    for text, problem in (
        (foreign, "written by Another"),
        (model.replace("<model", entities + "<model", 1), "document type"),
        (model[:900], "not valid XML"),
        (model[: model.index("</i:implicitfunction>")], "not valid XML"),
        (" " * (1 << 28), "not safe to read"),
    ):
        with pytest.raises(fb.FormatError, match=problem):
            fb.load(written(text))
    assert fb.load(written(model)) == fb.csg.parse(BALL.to_sexpr())
    double = 'transform="2 0 0 0 2 0 0 0 2 0 0 0"'
    for old, new in (
        ('value="0.8"', 'value="0.9"'),
        ("(sphere 1.6)", "(sphere 1.8)"),
        ('unit="millimeter"', 'unit="inch"'),
        ('<vertex x="-0.8"', '<vertex x="-0.7"'),
        ("<v:levelset ", f"<v:levelset {double} "),
        ('functionid="1"', 'functionid="7"'),
        ("<item ", f"<item {double} "),
        ("</model>", "<!-- --></model>"),
    ):
        assert old in model
        with pytest.raises(fb.FormatError, match="was changed after fieldbake wrote it"):
            fb.load(written(model.replace(old, new)))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(fb.FormatError, match="damaged"):
        fb.load(path)
    CUBE.to_mesh(8).save(path)
    with pytest.raises(fb.FormatError, match="load_mesh"):
        fb.load(path)
    BALL.save(path, implicit=True)
    with pytest.raises(fb.MeshError, match="implicit function"):
        fb.load_mesh(path)


def test_equal_shapes_make_equal_files(tmp_path):
    for name in ("a", "b"):
        (BALL | CUBE).save(tmp_path / f"{name}.3mf", implicit=True)
    assert (tmp_path / "a.3mf").read_bytes() == (tmp_path / "b.3mf").read_bytes()


@pytest.mark.parametrize(
    ("shape", "name", "options", "error", "problem"),
    [
        (BALL, "a.stl", {"implicit": True}, fb.ArgumentError, "implicit"),
        (BALL, "a.3mf", {"implicit": True, "resolution": 64}, fb.ArgumentError, "resolution"),
        (BALL, "a.3mf", {"implicit": True, "unit": "mile"}, fb.ArgumentError, "unit"),
        (BALL, "a.3mf", {"implicit": True, "min_feature": 0}, fb.ArgumentError, "min_feature"),
        (BALL, "a.3mf", {"within": CUBE.to_mesh(8)}, fb.ShapeError, "within"),
        (BALL & CUBE.translate((5, 0, 0)), "a.3mf", {"implicit": True}, fb.ShapeError, "is empty"),
        (BALL, "a.3mf", {"unit": "inch"}, fb.ArgumentError, "unit"),
        (BALL, "a.3mf", {"min_feature": 1}, fb.ArgumentError, "min_feature"),
        (fb.gyroid(1, 0.1), "a.3mf", {"implicit": True}, fb.ShapeError, "within"),
        (fb.polygon(np.array(STAR).repeat(200, axis=0) * np.linspace(0.9, 1, 2000)[:, None]).extrude(1), "a.3mf",
         {"implicit": True}, fb.ShapeError, r"nodes, and has at most 20,000"),
    ],
)  # fmt: skip
def test_errors_name_the_argument(shape, name, options, error, problem, tmp_path):
    with pytest.raises(error, match=problem):
        shape.save(tmp_path / name, **options)
    assert list(Path(tmp_path).iterdir()) == []
