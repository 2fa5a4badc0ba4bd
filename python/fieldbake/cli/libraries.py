"""The command ``sample``: training samples of many meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..meshes.normalization import Target
from ..queries.sampling import SampleType
from ..scaling.library import sample_many
from ..scaling.recipes import RECIPES
from .application import app, err
from .shared.folders import finish

#: Values of options for runs without a recipe. A recipe has its own numbers.
DEFAULTS = {"n": 500_000, "uniform": 0.1, "dtype": "float64", "normalize": None}


@app.command()
def sample(
    mesh: Annotated[list[Path], typer.Argument(help="Mesh files.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for one .npz for each mesh, or one .zarr.")],
    count: Annotated[
        int | None,
        typer.Option(
            "--count", "-n", help="Number of points for each mesh. The default is 500000, or the recipe's number."
        ),
    ] = None,
    uniform: Annotated[
        float | None,
        typer.Option(
            help="Fraction of the points that are uniform in the box; the others are near the surface. The default is "
            "0.1."
        ),
    ] = None,
    near: Annotated[
        list[float] | None,
        typer.Option(
            metavar="FRACTION",
            help="Standard deviation of the points near the surface, fractions of the diagonal of the mesh's box; "
            "may be repeated.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 0,
    normalize: Annotated[
        Target | None,
        typer.Option(
            help="Move and scale each mesh to a unit cube or a unit sphere about the origin first. The results store "
            "the transform."
        ),
    ] = None,
    dtype: Annotated[
        SampleType | None,
        typer.Option(
            help="Type of the points. float32 rounds them first and evaluates the distances at the rounded points. The "
            "default is float64."
        ),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            help=f"Write the points, labels and files of a published project: {', '.join(RECIPES)}. Only --count and "
            "--seed change its numbers."
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Number of meshes sampled at the same time. The default is one per core.")
    ] = None,
    limit_s: Annotated[float | None, typer.Option("--limit", help="Time limit for each mesh, seconds.")] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Sample all meshes again, even if their results are up to date.")
    ] = False,
) -> None:
    """Write training samples of many meshes: points, and the signed distances and gradients there."""
    chosen = {"n": count, "uniform": uniform, "near": near or None, "dtype": dtype, "normalize": normalize}
    options: dict[str, Any] = {name: value for name, value in chosen.items() if value is not None}
    if recipe is None:
        options = {**DEFAULTS, **options}
    for name in ("uniform", "near", "dtype", "normalize"):
        if recipe is not None and name in options:
            raise typer.BadParameter(f"does not apply to the recipe '{recipe}'", param_hint=f"--{name}")
    bar = err.is_terminal
    rows = sample_many(
        mesh, output, recipe, workers=jobs, limit_s=limit_s, resume=not fresh, progress=bar, seed=seed, **options
    )
    finish(rows, output)
