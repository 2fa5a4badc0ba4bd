"""The command ``sample``: training samples of many meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..meshes.normalization import Target
from ..queries.sampling import SampleType
from ..scaling.library import sample_many
from .application import app, err
from .folders import finish


@app.command()
def sample(
    mesh: Annotated[list[Path], typer.Argument(help="Mesh files.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for one .npz for each mesh, or one .zarr.")],
    count: Annotated[int, typer.Option("--count", "-n", help="Number of points for each mesh.")] = 500_000,
    uniform: Annotated[
        float, typer.Option(help="Fraction of the points that are uniform in the box; the others are near the surface.")
    ] = 0.1,
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
        SampleType,
        typer.Option(
            help="Type of the points. float32 rounds them first and evaluates the distances at the rounded points."
        ),
    ] = "float64",
    jobs: Annotated[
        int | None, typer.Option(help="Number of meshes sampled at the same time. The default is one per core.")
    ] = None,
    limit_s: Annotated[float | None, typer.Option("--limit", help="Time limit for each mesh, seconds.")] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Sample all meshes again, even if their results are up to date.")
    ] = False,
) -> None:
    """Write training samples of many meshes: points, and the signed distances and gradients there."""
    options: dict[str, Any] = {"n": count, "uniform": uniform, "seed": seed, "dtype": dtype, "normalize": normalize}
    if near:
        options["near"] = near
    bar = err.is_terminal
    rows = sample_many(mesh, output, threads=jobs, limit_s=limit_s, resume=not fresh, progress=bar, **options)
    finish(rows, output)
