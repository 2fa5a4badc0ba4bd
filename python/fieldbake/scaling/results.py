"""The work on one item of a library: bake or sample it, and write the result."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..baking.dense import bake
from ..base import checks, encodings
from ..base.errors import ArgumentError, FormatError
from ..base.grid import make_grid
from ..base.report import Report
from ..files.container import atomic_write
from ..files.registry import ENDINGS, format_of
from ..meshes import normalization
from ..meshes.convert import as_mesh
from ..meshes.normalization import Target
from ..queries.sampling import TrainingSamples, count_uncertain, draw_training
from ..volumes import writers
from ..volumes.volume import Volume
from . import content, recipes
from .stores.store import import_zarr

#: Half width of the band of normalised encodings in .npz files, voxels.
BAND = 4.0

#: Number of points of the samples by which options are checked.
FEW = 8


@dataclass(frozen=True)
class Asset:
    """One item, and the paths of its result."""

    item: Any
    targets: tuple[Path, ...]
    kind: Literal["bake", "sample"]
    options: Mapping[str, Any]
    encoding: str | None
    #: Hash of the item; None for a callable, whose mesh is hashed after the call.
    content: str | None
    #: Hash of the mesh of a callable at the last run. If the hash is the same, the result of that run is kept.
    known: str | None = None
    #: Name of the recipe of samples; None for samples of `draw_training`.
    recipe: str | None = None


def process(asset: Asset) -> dict[str, Any]:
    """Bake or sample an item and write the result."""
    item = asset.item
    found = asset.content
    if found is None:
        item = item()
        found = content.of_item(item)
        if found == asset.known:
            return {"status": "skipped", "content": found}
    target = asset.targets[0]
    if asset.kind == "bake":
        volume = bake(item, **asset.options)
        _save(volume, target, asset.encoding, asset.options.get("band"))
        report = volume.report
    elif asset.recipe is not None:
        recipe = recipes.checked_recipe(asset.recipe)
        arrays, drawing = recipes.draw(recipe, item, **asset.options)
        report = drawing.report()
        if in_zarr(target):
            _save_group(target, arrays, recipe.arrays)
        else:
            save_files(recipe, asset.targets, arrays)
    else:
        arrays, report = _draw(item, **asset.options)
        if in_zarr(target):
            _save_group(target, arrays, TrainingSamples._fields)
        else:
            _save_arrays(target, arrays)
    return {"status": "done", "content": found, "report": report.to_dict(), "bytes": size_of(asset.targets)}


def _draw(item: Any, normalize: Target | None = None, **options: Any) -> tuple[dict[str, NDArray[Any]], Report]:
    """Draw the arrays of a result and their report. The points keep their type; their fields are float32."""
    mesh = as_mesh(item)
    arrays: dict[str, NDArray[Any]] = {}
    if normalize is not None:
        mesh, arrays["transform"] = normalization.normalize(mesh, normalize)
    samples, report = draw_training(mesh, **options)
    arrays |= {
        "points": samples.points,
        "distances": samples.distances.astype(np.float32),
        "gradients": samples.gradients.astype(np.float32),
    }
    return arrays, replace(report, undecided_voxels=count_uncertain(mesh, samples.points, report))


def _save(volume: Volume, target: Path, encoding: str | None, band: float | None) -> None:
    ending = target.suffix
    if ending == ".npz":
        if encoding is not None:
            volume = volume.quantize(encoding, band=BAND if band is None else band)  # type: ignore[arg-type]
        volume.save(target)
        return
    # A texture without an encoding keeps all distances.
    has_band = ending in writers.BANDED and not (ending in writers.MIPMAPPED and encoding is None)
    volume.save(target, encoding=encoding, band=band if has_band else None)


def _save_arrays(target: Path, arrays: Mapping[str, Any]) -> None:
    with atomic_write(target) as stream:
        np.savez(stream, **arrays)


def save_files(recipe: recipes.Recipe, targets: Sequence[Path], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays of a recipe into its files."""
    for target, inner in zip(targets, recipes.by_file(recipe, arrays).values(), strict=True):
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.suffix == ".npy":
            with atomic_write(target) as stream:
                np.save(stream, inner[""])
        else:
            _save_arrays(target, inner)


def in_zarr(target: Path) -> bool:
    """Whether a result is a group in a Zarr store."""
    return target.parent.suffix == ".zarr"


def _save_group(target: Path, arrays: Mapping[str, Any], names: Iterable[str]) -> None:
    """Write the arrays as a group, under another name first. An existing group with arrays of the names is replaced."""
    if target.exists() and not all((target / name / "zarr.json").is_file() for name in names):
        raise FormatError(f"{target} has other contents than training samples; they stay as they are")
    partial = target.with_name(f".{target.name}.partial")
    group = import_zarr().open_group(partial, mode="w", zarr_format=3)
    for name, array in arrays.items():
        group.create_array(name=name, data=array)
    if target.exists():
        shutil.rmtree(target)
    partial.rename(target)


def size_of(targets: Sequence[Path]) -> int | None:
    """Bytes of a result, files or a group; None if one of them does not exist."""
    size = 0
    for target in targets:
        if target.is_dir():
            size += sum(part.stat().st_size for part in target.rglob("*") if part.is_file())
        elif target.is_file():
            size += target.stat().st_size
        else:
            return None
    return size


def checked_format(kind: str, out: Path, form: object, encoding: object) -> tuple[str, str | None]:
    """The ending of the results and their encoding, None for float32."""
    ending = "." + checks.text("format", form).lower().lstrip(".")
    if kind == "sample":
        if ending != ".npz" or encoding is not None:
            raise ArgumentError(
                "format, encoding: do not apply to samples, which are arrays in .npz files or a .zarr store"
            )
        if out.suffix in (".npz", ".parquet"):
            raise ArgumentError(f"out: must be a folder or end in .zarr, got {str(out)!r}")
        return ("" if out.suffix == ".zarr" else ".npz"), None
    if ending not in ENDINGS["volume"]:
        raise ArgumentError(f"format: must be one of {', '.join(ENDINGS['volume'])}, got {form!r}")
    if encoding is None:
        return ending, None
    form = format_of(ending, "volume")
    known = encodings.NAMES if form is None or ending == ".npz" else form.encodings
    checks.choice("encoding", encoding, known)
    return ending, None if encoding == "float32" else str(encoding)


def check_options(kind: str, options: Mapping[str, Any]) -> None:
    """Check the options of all items by a small solid, before any work.

    Lengths in world units are checked by themselves, since the size of the meshes is not known here.
    """
    solid = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float), [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    # None is the default of these alone.
    optional = ("voxel_size", "bounds", "band", "thickness")
    chosen = {name: value for name, value in options.items() if value is not None or name not in optional}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if kind == "sample":
            count = checks.integer("n", chosen.pop("n", None), least=0, most=2**40)
            if (target := chosen.pop("normalize", None)) is not None:
                checks.choice("normalize", target, get_args(Target))
            draw_training(solid, min(count, FEW), **chosen)
            return
        grid = {name: chosen.pop(name) for name in ("resolution", "voxel_size", "bounds") if name in chosen}
        margin = chosen.get("margin", 0.1)
        if "voxel_size" in grid and "bounds" not in grid:
            # A voxel is a length in the units of the meshes. The default margin keeps this grid small.
            checks.number("voxel_size", grid["voxel_size"], above=0)
            checks.number("margin", margin, least=0)
            grid["voxel_size"], margin = 0.5, 0.1
        make_grid(np.array([(0.0, 0, 0), (1, 1, 1)]), margin=margin, **grid)
        if "thickness" in chosen:
            checks.number("thickness", chosen["thickness"], above=0)
            chosen["thickness"] = 0.5
        # Workers may have other devices than this machine.
        checks.text("device", chosen.get("device", "auto"))
        bake(solid, **{**chosen, "resolution": 4, "device": "cpu"})
