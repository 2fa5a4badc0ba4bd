"""Labels of recipes against libigl in float64: exact distances, and the side by the exact winding number."""

import numpy as np
import pytest

import fieldbake as fb
import meshes
import truth
from fieldbake.scaling import recipes, rules
from project_loaders import label_groups

#: Bound of the acceptance on labels in the space of a recipe, whose size is about 1.
EXACT = 1e-5

#: A sign is compared where the winding number is farther than this from 1/2, and the point farther than `EXACT` from
#: the surface. In between both sides are right.
UNDECIDED = 1e-6


def placed(geometry, seed):
    """The geometry, turned and at another place with another size."""
    turn = np.eye(4)
    turn[:3, :3] = meshes.rotation(seed) * (1 + seed % 3)
    turn[:3, 3] = (seed, -2 * seed, 5)
    return meshes.move(meshes.Geometry(*geometry), turn)


CLOSED = {
    "box": meshes.box(),
    "slab": meshes.box((-1, -1, -0.01), (1, 1, 0.01)),
    "bar": meshes.box((-3, -0.1, -0.1), (3, 0.1, 0.1)),
    "tetrahedron": meshes.tetrahedron(),
    "ball": meshes.icosphere(3),
    "coarse ball": meshes.icosphere(1),
    "uv ball": meshes.uv_sphere(),
    "capsule": meshes.capsule(rings=8, segments=24),
    "long capsule": meshes.capsule(4.0, 0.2, rings=6, segments=16),
    "torus": meshes.torus(segments=48, sides=16),
    "thin torus": meshes.torus(1.0, 0.03, segments=64, sides=8),
    "knot": meshes.knot(100, 12),
    "gear": (fb.models.gear().vertices, fb.models.gear().faces.astype(np.int64)),
    "trefoil": (fb.models.torus_knot(segments=80, sides=12).vertices,
                fb.models.torus_knot(segments=80, sides=12).faces.astype(np.int64)),
    "hollow ball": meshes.hollow_sphere(),
    "two balls": meshes.join(meshes.icosphere(2), meshes.icosphere(2, center=(3, 0, 0))),
    "ball and bar": meshes.join(meshes.icosphere(2, center=(0, 5, 0)), meshes.box((-3, -0.1, -0.1), (3, 0.1, 0.1))),
    "split box": meshes.split_vertices(meshes.box()),
    "split ball": meshes.split_vertices(meshes.icosphere(2)),
    "fin": meshes.sliver_fin(),
}  # fmt: skip

OPEN = {
    "open box": meshes.open_box(),
    "triangle": meshes.triangle(),
    "sheet": meshes.flat_sheet(),
    "half ball": (meshes.icosphere(3)[0], meshes.icosphere(3)[1][: len(meshes.icosphere(3)[1]) // 2]),
    "knot with holes": (meshes.knot(100, 12)[0], np.delete(meshes.knot(100, 12)[1], np.s_[::37], axis=0)),
}

SMALL = {
    "deepsdf": {"n": 4000},
    "onet": {"n": 4000, "surface_n": 10},
    "vecset": {"n": 2000, "near_n": 2000, "surface_n": 10},
    "dora": {"n": 2000, "surface_n": 2000, "uniform_n": 1000},
}


def wrong_labels(name, found, vertices, faces):
    """Largest error of the distances beyond the rounding of their type, and the number of wrong sides."""
    reference = truth.Reference(vertices, faces)
    worst, wrong = 0.0, 0
    for points, labels in label_groups(name, found):
        points = points.astype(np.float64)
        distances, winding = reference.distance(points), reference.winding_number(points)
        decided = (np.abs(winding - 0.5) > UNDECIDED) & (distances > EXACT)
        wrong += int((((labels < 0) != (winding > 0.5)) & decided).sum())
        if name not in ("onet", "vecset"):
            # Half a unit of float16 where a label is stored in that type.
            half = np.spacing(np.abs(labels).astype(np.float16)).astype(np.float64) / 2 if name == "hunyuan" else 0.0
            error = np.abs(np.abs(labels) - distances) - half
            assert not np.isnan(error).any()
            worst = max(worst, float(error.max(initial=0.0)))
    return worst, wrong


@pytest.mark.parametrize("name", list(SMALL))
@pytest.mark.parametrize("shape", [*CLOSED, *OPEN])
def test_labels_are_exact_at_the_stored_points(name, shape):
    vertices, faces = placed({**CLOSED, **OPEN}[shape], 1 + len(shape))
    found = fb.training.sample((vertices, faces), name, **SMALL[name])
    matrix = fb.training.recipes()[name].transform((vertices, faces))
    worst, wrong = wrong_labels(name, found, vertices @ matrix[:3, :3].T + matrix[:3, 3], faces)
    assert worst <= EXACT
    assert wrong == 0


@pytest.mark.parametrize(
    "shape",
    [
        name if name in ("slab", "ball", "half ball", "sheet") else pytest.param(name, marks=pytest.mark.slow)
        for name in (*CLOSED, *OPEN)
    ],
)
def test_labels_of_hunyuan_belong_to_its_shell(shape):
    vertices, faces = {**CLOSED, **OPEN}[shape]
    recipe = fb.training.recipes()["hunyuan"]
    numbers = {"n": 1200, "shell_resolution": 64, "shell_width": 1 / 16}
    found = fb.training.sample((vertices, faces), recipe, **numbers)
    matrix = recipe.transform((vertices, faces))
    source = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    shell = rules._shell(fb.Mesh(source, faces), 1 / 16, 64)
    assert shell.is_closed
    worst, wrong = wrong_labels("hunyuan", found, shell.vertices, shell.faces.astype(np.int64))
    assert worst <= EXACT
    assert wrong == 0
    # The vertices of the shell lie at its width, up to the linear interpolation between samples of a bent field.
    spacing = (1 + 2 / 16 + 4 / 64) / 63
    gaps = truth.Reference(source, faces).distance(shell.vertices)
    assert np.abs(gaps - 1 / 16).max() <= spacing / 2
    assert np.abs(gaps - 1 / 16).mean() <= spacing / 20


def test_seeds_of_items_are_bytes_of_a_hash():
    # The first 8 bytes of the SHA-256 of "7/chair/2", computed by sha256sum.
    assert recipes.item_seed(7, "chair", 2).to_bytes(8, "little").hex() == "98c1677aad684cd6"
