"""The preprocessing of published projects as recipes: rules with their sources, numbers and files.

Only numbers and names are taken from the projects. ``rules.py`` has the functions that draw the points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ..base import checks
from ..base.errors import ArgumentError, MeshError
from ..meshes.convert import MeshLike, as_mesh
from ..meshes.mesh import Mesh
from ..queries.common import Sign
from . import rules
from .rules import Arrays, Drawing

#: Upper ends of the ranges of numbers that have one.
AT_MOST = {"near_share": 1.0, "uniform_ratio": 1.0, "angle_deg": 179.0, "crease": 1.0, "shell_resolution": 1024}


class Layout(NamedTuple):
    """Shape and type of an array of a recipe. A side is a number, or an expression of numbers of the recipe."""

    shape: tuple[int | str, ...]
    dtype: str


@dataclass(frozen=True)
class Recipe:
    """The preprocessing of a published project: its rule, its source and its layout of files.

    Examples
    --------
    >>> import fieldbake as fb
    >>> recipe = fb.training.recipes()["deepsdf"]
    >>> recipe.numbers["n"], recipe.arrays["pos"].dtype
    (500000, 'float32')
    """

    #: Name of the recipe.
    name: str
    #: Repository and files of the project from which the rule was read.
    source: str
    #: State of the repository that was read.
    commit: str
    #: How the mesh is moved and scaled, in words; `transform` is the matrix.
    normalization: str
    #: Shape and type of each array, by the key in :func:`fieldbake.training.sample`: ``array``, or ``file/array``
    #: for recipes of several files.
    arrays: Mapping[str, Layout]
    #: The numbers of the rule with the values of the project. A call may replace each by its name.
    numbers: Mapping[str, Any]
    #: Sentences on all that differs from the project, and on all that could not be checked.
    deviations: tuple[str, ...]
    #: Path of each file in the output folder, with ``{stem}`` for the name of the item; the key "" for a single file.
    files: Mapping[str, str]
    #: The position that becomes the origin, and the length that becomes 1 if the recipe has no padding.
    _frame: Callable[[Mesh], tuple[NDArray[Any], float]] = field(repr=False)
    _rule: Callable[[Drawing, Mapping[str, Any]], Arrays] = field(repr=False)
    #: Values of other numbers, by the value of the number `split`.
    _splits: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, repr=False)

    def transform(self, mesh: MeshLike, **numbers: Any) -> NDArray[np.float64]:
        """Compute the matrix (4, 4) from positions of the mesh to positions of the recipe; column vectors.

        Parameters
        ----------
        mesh : Mesh or anything :func:`fieldbake.bake` takes as a mesh
            The mesh.
        **numbers
            Values that replace the values of `numbers`.

        Raises
        ------
        MeshError
            If the mesh cannot be read or has no faces.
        ArgumentError
            For a number that the recipe does not have, or that is out of range.
        """
        origin, size = _frame_of(self, _with_faces(mesh), checked_numbers(self, numbers))
        matrix = np.eye(4)
        matrix[:3, :3] /= size
        matrix[:3, 3] = -origin / size + 0.0  # no negative zeros
        return matrix

    def __reduce__(self) -> tuple[Any, ...]:
        return checked_recipe, (self.name,)


def draw(
    recipe: Recipe, mesh: MeshLike, *, seed: int = 0, sign: Sign = "auto", device: str = "auto", **numbers: Any
) -> tuple[Arrays, Drawing]:
    """Draw the arrays of a mesh. The drawing has the report of their labels."""
    chosen = checked_options(recipe, {"seed": seed, "sign": sign, "device": device, **numbers})
    source = _with_faces(mesh)
    origin, size = _frame_of(recipe, source, chosen)
    moved = source.moved((source.vertices - origin) / size)
    # Samples of edges and offsets of training samples use the seed with other second numbers.
    drawing = Drawing(moved, origin, size, np.random.default_rng([seed, 3]), sign, device)
    return recipe._rule(drawing, chosen), drawing


def paths(recipe: Recipe, folder: Path, stem: str, numbers: Mapping[str, Any]) -> dict[str, Path]:
    """Path of each file of an item in the output folder."""
    chosen = {**recipe.numbers, **numbers}
    return {name: folder / pattern.format(stem=stem, **chosen) for name, pattern in recipe.files.items()}


def result(recipe: Recipe, folder: Path, stem: str, numbers: Mapping[str, Any]) -> Path:
    """Path of the result of an item: the folder of its files, or else the first file."""
    if next(iter(recipe.files.values())).startswith("{stem}/"):
        return folder / stem
    return next(iter(paths(recipe, folder, stem, numbers).values()))


def by_file(recipe: Recipe, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Arrays]:
    """Group arrays by file and by the name inside it. The name of the only array of an ``.npy`` file is empty."""
    files: dict[str, Arrays] = {name: {} for name in recipe.files}
    for key, array in arrays.items():
        name, _, inner = ("", "", key) if "" in files else key.partition("/")
        files[name][inner] = array
    return files


def key_of(name: str, inner: str) -> str:
    """Key of an array in a file; the inverse of `by_file`."""
    return f"{name}/{inner}".strip("/")


def checked_options(recipe: Recipe, options: Mapping[str, Any]) -> dict[str, Any]:
    """Check all arguments of a call that do not depend on the mesh; return all numbers."""
    numbers = {name: value for name, value in options.items() if name not in ("seed", "sign", "device")}
    checks.integer("seed", options.get("seed", 0), least=0, most=2**64 - 1)
    checks.text("device", options.get("device", "auto"))
    sign = checks.choice("sign", options.get("sign", "auto"), get_args(Sign))
    if sign == "unsigned":
        raise ArgumentError("sign: the labels of a recipe need a side, got 'unsigned'")
    return checked_numbers(recipe, numbers)


def checked_numbers(recipe: Recipe, numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Check the numbers of a call and add the numbers of the recipe."""
    for name in numbers:
        if name not in recipe.numbers:
            raise ArgumentError(
                f"{name}: is no number of the recipe '{recipe.name}'; its numbers are {', '.join(recipe.numbers)}"
            )
    given = {name: _checked_number(name, value, recipe.numbers[name]) for name, value in numbers.items()}
    if "split" in given:
        checks.choice("split", given["split"], tuple(recipe._splits))
    chosen = {**recipe.numbers, **recipe._splits.get(given.get("split", ""), {}), **given}
    if recipe.name == "dora" and not 1 <= chosen["n"] // 2 <= chosen["surface_n"]:
        raise ArgumentError(f"n: half of it must be from 1 to surface_n ({chosen['surface_n']}), got {chosen['n']}")
    if recipe.name == "hunyuan" and chosen["cut"] < max(chosen["sigmas"]):
        raise ArgumentError(f"cut: must be at least the largest of sigmas, {max(chosen['sigmas'])}")
    return chosen


def _frame_of(recipe: Recipe, mesh: Mesh, numbers: Mapping[str, Any]) -> tuple[NDArray[Any], float]:
    origin, size = recipe._frame(mesh)
    return origin, size * numbers.get("padding", 1.0)


def _with_faces(mesh: MeshLike) -> Mesh:
    checked = as_mesh(mesh)
    if not len(checked.faces):
        raise MeshError("mesh: has no faces, so it has no surface to sample")
    return checked


def _checked_number(name: str, value: Any, default: Any) -> Any:
    """Check a number by the type of its default value."""
    most = AT_MOST.get(name)
    if isinstance(default, str):
        word = checks.text(name, value)
        if Path(word).name != word or word.startswith("."):
            raise ArgumentError(f"{name}: must be the name of a folder, got {word!r}")
        return word
    if isinstance(default, tuple):
        values = tuple(checks.number(name, one, above=0) for one in checks.items(name, value, "numbers"))
        if not values:
            raise ArgumentError(f"{name}: must hold a number above 0")
        return values
    if isinstance(default, int):
        return checks.integer(name, value, least=1, most=2**31 - 1 if most is None else int(most))
    result = checks.number(name, value, **({"above": 0.0} if most is None else {"least": 0.0}))
    if most is not None and result > most:
        raise ArgumentError(f"{name}: must be from 0 to {most:g}, got {value}")
    return result


def item_seed(seed: int, stem: str, epoch: int) -> int:
    """Derive the seed of an item, which depends neither on the order nor on the number of the other items."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{stem}/{epoch}".encode()).digest()[:8], "little")


def _recipe(**fields: Any) -> Recipe:
    """Make a recipe whose tables cannot be changed."""
    for name in ("arrays", "numbers", "files", "_splits"):
        fields[name] = MappingProxyType(fields.get(name, {}))
    return Recipe(**fields)


#: Deviations of several recipes.
_LABELS = "Labels are exact distances with the side by winding number or by an exact rule for closed meshes, {project}."
_STORED = "Labels belong to the stored points. {project}"

_DEEPSDF = _recipe(
    name="deepsdf",
    source="facebookresearch/DeepSDF: src/PreprocessMesh.cpp, deep_sdf/data.py; Park et al. 2019",
    commit="48c19b8d49ed5293da4edd7da8c3941444bc5cd7",
    normalization="The centre of the box moves to the origin; the largest radius of a used vertex becomes 1 / 1.03.",
    arrays={"pos": Layout(("k", 4), "float32"), "neg": Layout(("n - k", 4), "float32")},
    numbers={"n": 500_000, "variances": (0.005, 0.0005), "near_share": 0.94, "padding": 1.03, "split": "train"},
    deviations=(
        _LABELS.format(
            project="in place of votes of the 11 nearest rendered points, which drop points whose votes differ"
        ),
        "No mesh is rejected. The project rejects meshes whose rendered faces are seen from behind.",
        "The paper states variances of 0.0025 and 0.00025; the code has 0.005 and 0.0005, which are taken.",
        'With split="test" the code sets 0.05 and 0.0005, and n = 250,000. It also sets a share of 45 / 50, but never '
        "uses this variable, so the share stays 47 / 50.",
        "Surface points are uniform by area, as in the project. A point at distance 0 is in neg.",
    ),
    files={"": "{stem}.npz"},
    _frame=rules.deepsdf_frame,
    _rule=rules.deepsdf,
    _splits={"train": {}, "test": {"n": 250_000, "variances": (0.05, 0.0005)}},
)

_ONET = _recipe(
    name="onet",
    source="autonomousvision/occupancy_networks: scripts/sample_mesh.py, scripts/dataset_shapenet/build.sh; "
    "Mescheder et al. 2019",
    commit="406f79468fb8b57b3e76816aaa73b1915c53ad22",
    normalization="The centre of the box moves to the origin; its longest side becomes 1.",
    arrays={
        "points/points": Layout(("n", 3), "float16"),
        "points/occupancies": Layout(("ceil(n / 8)",), "uint8"),
        "points/loc": Layout((3,), "float64"),
        "points/scale": Layout((), "float64"),
        "pointcloud/points": Layout(("surface_n", 3), "float16"),
        "pointcloud/normals": Layout(("surface_n", 3), "float16"),
        "pointcloud/loc": Layout((3,), "float64"),
        "pointcloud/scale": Layout((), "float64"),
    },
    numbers={"n": 100_000, "uniform_ratio": 1.0, "sigma": 0.01, "points_padding": 0.1, "surface_n": 100_000},
    deviations=(
        _LABELS.format(project="in place of parities of crossings; the project skips meshes with openings"),
        _STORED.format(project="The project evaluates them before the points are rounded to float16."),
        "The mesh itself is sampled. The project first fuses depth images into a closed mesh, and takes loc and scale "
        "from the mesh before that.",
        "Types follow the options --float16 and --packbits of build.sh. The loader adds noise of 1e-4 to points.",
    ),
    files={"points": "{stem}/points.npz", "pointcloud": "{stem}/pointcloud.npz"},
    _frame=rules.onet_frame,
    _rule=rules.onet,
)

_VECSET = _recipe(
    name="vecset",
    source="1zb/3DShape2VecSet: util/shapenet.py, eval.py; Zhang et al. 2023",
    commit="04d6d9cc348891cc62b84691ce367be8fba2dd09",
    normalization="The centre of the box moves to the origin; its longest side becomes 2.",
    arrays={
        "points/vol_points": Layout(("n", 3), "float32"),
        "points/vol_label": Layout(("n",), "bool"),
        "points/near_points": Layout(("near_n", 3), "float32"),
        "points/near_label": Layout(("near_n",), "bool"),
        "scale": Layout((), "float64"),
        "pointcloud/points": Layout(("surface_n", 3), "float32"),
    },
    numbers={
        "n": 100_000,
        "near_n": 100_000,
        "sigmas": (0.01, 0.1),
        "surface_n": 100_000,
        "category": "03001627",
    },
    deviations=(
        "Only the layout follows the project, which published samples but not its sampler. Counts, offsets, types "
        "and the normalisation are choices of fieldbake; they could not be compared with the published samples.",
        "The cube of vol_points is [-1, 1]^3, in which eval.py evaluates. Half of near_points has each deviation.",
        "The loader also opens lists of models in the folder of a category: train.lst, val.lst and test.lst. They are "
        "a choice of the user and not written.",
    ),
    files={
        "points": "ShapeNetV2_point/{category}/{stem}.npz",
        "scale": "ShapeNetV2_point/{category}/{stem}.npy",
        "pointcloud": "ShapeNetV2_watertight/{category}/4_pointcloud/{stem}.npz",
    },
    _frame=rules.vecset_frame,
    _rule=rules.vecset,
)

_HUNYUAN = _recipe(
    name="hunyuan",
    source="Tencent-Hunyuan/Hunyuan3D-2.1: hy3dshape/tools/watertight/watertight_and_sample.py",
    commit="2d460fa51c7aa7ce38468d6b9f9e5a65a5f41c60",
    normalization="The lower corner of the box moves to the origin; its longest side becomes 1 / 1.01.",
    arrays={
        "surface/random_surface": Layout(("n", 6), "float16"),
        "surface/sharp_surface": Layout(("n", 6), "float16"),
        "sdf/vol_points": Layout(("2 * n", 3), "float16"),
        "sdf/vol_label": Layout(("2 * n",), "float16"),
        "sdf/random_near_points": Layout(("len(sigmas) * n", 3), "float16"),
        "sdf/random_near_label": Layout(("len(sigmas) * n",), "float16"),
        "sdf/sharp_near_points": Layout(("n", 3), "float16"),
        "sdf/sharp_near_label": Layout(("n",), "float16"),
    },
    numbers={
        "n": 124_928,
        "sigmas": (0.005, 0.05),
        "cut": 0.25,
        "edge_sigmas": (0.001, 0.003, 0.06, 0.01, 0.02, 0.04),
        "crease": 0.985,
        "box": 1.05,
        "padding": 1.01,
        "shell_width": 2 / 256,
        "shell_resolution": 256,
    },
    deviations=(
        _LABELS.format(
            project="in place of libigl's, which are distances times 1 - 2 |w| of an approximate winding number w"
        ),
        _STORED.format(
            project="The project evaluates them before the points are rounded to float16, which moves a point by up to "
            "2.4e-4 in [0.5, 1), a quarter of the smallest offset."
        ),
        "The shell has outer and inner walls, as in the project. Its faces come from dual contouring in place of "
        "marching cubes. The margin of the grid is larger where 5 % of a side are less than the shell.",
        "Mesh and volume have different centres, as in the project: the box is [0, 0.99], the volume [-1.05, 1.05]^3.",
        "A vertex belongs to a crease if any of its faces is steep. The code overwrites the cosines of faces that "
        "share a vertex, so its result depends on the order of the faces.",
        "Without creases the arrays for edges hold points of the surface, with a warning; the project fails.",
        "The README of the tools says that labels are positive outside. The code negates libigl's distances, so labels "
        "are positive inside.",
        "The loader, hy3dshape/hy3dshape/data/dit_asl.py at 5e3ec6d, opens the file of the surface only. In the "
        "configurations it draws up to 30,720 points of each kind without repetition, and n must be at least as large. "
        "It also needs the pictures of a model in render_cond, which fieldbake does not make.",
    ),
    files={
        "surface": "{stem}/geo_data/{stem}_surface.npz",
        "sdf": "{stem}/geo_data/{stem}_sdf.npz",
    },
    _frame=rules.hunyuan_frame,
    _rule=rules.hunyuan,
)

_DORA = _recipe(
    name="dora",
    source="Seed3D/Dora: sharp_edge_sampling/sharp_sample.py, to_watertight_mesh.py, README.md; Chen et al. 2025",
    commit="a166e21e900cf1e1230a67db2efc8b5a2c022e7d",
    normalization="The centre of the box moves to the origin; its longest side becomes 2.",
    arrays={
        "fps_sharp_surface": Layout(("n // 2", 1, 6), "float32"),
        "sharp_near_surface": Layout(("len(edge_sigmas) * k", 4), "float32"),
        "fps_coarse_surface": Layout(("n // 2", 1, 6), "float32"),
        "rand_points": Layout(("len(sigmas) * surface_n + uniform_n", 4), "float32"),
    },
    numbers={
        "n": 65_536,
        "angle_deg": 15.0,
        "edge_sigmas": (0.001, 0.005, 0.007, 0.01),
        "sigmas": (0.001, 0.005),
        "surface_n": 200_000,
        "uniform_n": 200_000,
        "box": 1.05,
    },
    deviations=(
        _LABELS.format(project="in place of pysdf"),
        _STORED.format(project="The project evaluates them before the points are rounded to float32."),
        "The mesh itself is sampled, with the normals of its faces. The project first makes a closed shell on "
        "a device, by to_watertight_mesh.py, and keeps its largest component.",
        "Edges belong to the welded mesh, and edges without exactly two faces are sharp. The project takes the "
        "sharp edges of Blender, which have two faces.",
        "Without sharp edges the arrays for edges hold points of the surface, with a warning; the project writes no "
        "file.",
        "The number k is n / 2, or the number of vertices of sharp edges if that is larger.",
        "The published sample of the project could not be compared, since its file was not available.",
    ),
    files={"": "{stem}.npz"},
    _frame=rules.vecset_frame,
    _rule=rules.dora,
)

#: The recipes by name.
RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {recipe.name: recipe for recipe in (_DEEPSDF, _ONET, _VECSET, _HUNYUAN, _DORA)}
)


def checked_recipe(recipe: object) -> Recipe:
    """Check the name of a recipe, or a recipe."""
    if isinstance(recipe, Recipe):
        return recipe
    found: Recipe = RECIPES[checks.choice("recipe", recipe, tuple(RECIPES))]
    return found
