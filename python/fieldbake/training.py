"""Training data by the recipes of published projects, with the names, types and files that their loaders read.

>>> import fieldbake as fb
>>> arrays = fb.training.sample(fb.models.gear(), "deepsdf", n=1000)
>>> arrays["pos"].shape[1], len(arrays["pos"]) + len(arrays["neg"])
(4, 1000)

The module never imports PyTorch. A :class:`Dataset` is a map-style data set for its ``DataLoader`` all the same.
"""

from __future__ import annotations

import copy
import operator
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .base import checks
from .base.errors import ArgumentError, FormatError
from .base.progress import Progress, watched
from .files.container import atomic_write
from .meshes.convert import MeshLike
from .queries.common import Sign
from .scaling import content, library
from .scaling import recipes as catalogue
from .scaling.recipes import Recipe
from .scaling.stores.store import import_zarr

__all__ = ["Dataset", "Recipe", "recipes", "sample", "sample_many"]

Arrays = dict[str, NDArray[Any]]


def __dir__() -> list[str]:
    return sorted(__all__)


def recipes() -> Mapping[str, Recipe]:
    """List the recipes by name: ``"deepsdf"``, ``"onet"``, ``"vecset"``, ``"hunyuan"`` and ``"dora"``.

    Returns
    -------
    mapping of str to Recipe
        Read-only. Each recipe names its source, its numbers and its deviations from the project.

    Examples
    --------
    >>> import fieldbake as fb
    >>> for name, recipe in fb.training.recipes().items():
    ...     print(name, recipe.source.partition(":")[0])
    deepsdf facebookresearch/DeepSDF
    onet autonomousvision/occupancy_networks
    vecset 1zb/3DShape2VecSet
    hunyuan Tencent-Hunyuan/Hunyuan3D-2.1
    dora Seed3D/Dora
    """
    return catalogue.RECIPES


def sample(
    mesh: MeshLike,
    recipe: str | Recipe,
    *,
    seed: int = 0,
    sign: Sign = "auto",
    device: str = "auto",
    progress: Progress = None,
    **numbers: Any,
) -> Arrays:
    """Draw the training samples of a mesh by the recipe of a published project.

    Parameters
    ----------
    mesh : Mesh or anything :func:`fieldbake.bake` takes as a mesh
        The mesh, in any units. It is normalised as in the project; :meth:`Recipe.transform` is the matrix.
    recipe : str or Recipe
        ``"deepsdf"``, ``"onet"``, ``"vecset"``, ``"hunyuan"`` or ``"dora"``.
    seed : int, default 0
        From 0 to 2^64 - 1. The same seed gives the same arrays on any number of threads.
    sign : str, default "auto"
        As for :func:`fieldbake.bake`, except ``"unsigned"``.
    device : str, default "auto"
        As for :func:`fieldbake.closest_point`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.
    **numbers
        Values that replace numbers of the recipe, such as ``n`` or ``sigmas``; `Recipe.numbers` has all of them.

    Returns
    -------
    dict of str to array
        Arrays by the names of the project. For a recipe of several files the keys are ``file/array``.

    Raises
    ------
    ArgumentError
        For an unknown recipe, a number that the recipe does not have, or a value out of range.
    MeshError
        If the mesh cannot be read or has no faces.
    Error
        If the recipe ``"dora"`` is used without the package fpsample: ``pip install 'fieldbake[training]'``.

    Warns
    -----
    SurfaceWarning
        If the surface is open, inside out, or has flipped or one-sided parts, and if a recipe wants sharp edges and the
        mesh has none.

    Notes
    -----
    The table has the rules. Where the code of a project and its paper differ, the code is taken. `Recipe.deviations`
    has both, with everything else that differs from the project or could not be checked.

    ===========  ====================================================================================================
    recipe       rule
    ===========  ====================================================================================================
    ``deepsdf``  47 / 50 of 500,000 points near the surface, with variances of 0.005 and 0.0005, the rest uniform in
                 [-1, 1]^3. Rows are positions and distances, positive outside. ``split="test"`` has variances of 0.05
                 and 0.0005, and 250,000 points.
    ``onet``     Occupancies, packed into bits, of 100,000 points in a cube of side 1.1, and 100,000 points with normals
                 of the surface; float16.
    ``vecset``   Occupancies of points in [-1, 1]^3 and near the surface. Only the layout follows the project.
    ``hunyuan``  A closed shell around the mesh; 124,928 points of its surface and as many of its creases, with normals;
                 distances, positive inside, of 249,856 points in [-1.05, 1.05]^3, of 249,856 near the surface and of
                 124,928 near the creases; float16.
    ``dora``     Farthest-point subsets of the surface and of the edges whose dihedral angle exceeds 15 degrees, 32,768
                 points each, with normals; distances, positive inside, of points near both and of 200,000 points in
                 [-1.05, 1.05]^3.
    ===========  ====================================================================================================

    Examples
    --------
    >>> import fieldbake as fb
    >>> arrays = sample(fb.models.gear(), "onet", n=800, surface_n=100)
    >>> {name: array.shape for name, array in arrays.items() if name.endswith(("points", "occupancies"))}
    {'points/points': (800, 3), 'points/occupancies': (100,), 'pointcloud/points': (100, 3)}
    """
    chosen = catalogue.checked_recipe(recipe)
    with watched(progress, "sample"):
        arrays, _ = catalogue.draw(chosen, mesh, seed=seed, sign=sign, device=device, **numbers)
    return arrays


def sample_many(
    items: Iterable[Any] | Mapping[str, Any],
    out: str | os.PathLike[str],
    recipe: str | Recipe,
    *,
    seed: int = 0,
    executor: Any = None,
    resume: bool = True,
    on_error: Literal["record", "raise"] = "record",
    limit_s: float | None = None,
    workers: int | None = None,
    progress: Progress = None,
    **numbers: Any,
) -> list[dict[str, Any]]:
    """Draw the training samples of each mesh into the files that the loader of the project reads.

    Parameters
    ----------
    items, executor, resume, on_error, limit_s, workers, progress
        As for :func:`fieldbake.bake_many`. Items are meshes; for a shape, pass ``shape.to_mesh()``.
    out : path
        Folder for the results, with the paths of `Recipe.files` inside it, and for ``ledger.jsonl``. If it ends in
        ``.zarr``, each item is a group in one Zarr store.
    recipe : str or Recipe
        As for :func:`sample`.
    seed : int, default 0
        The seed of an item is the first 8 bytes, little endian, of the SHA-256 of ``f"{seed}/{stem}/0"``. So its
        samples depend neither on the other items, nor on their order, nor on the workers. They are drawn on the CPU.
    **numbers
        As for :func:`sample`.

    Returns
    -------
    list of dict
        Rows as of :func:`fieldbake.bake_many`. The path names the only file, or the folder of the files.

    Raises
    ------
    ArgumentError
        As for :func:`sample`, if two items would have the same result, or if the folder has results of another recipe;
        nothing is sampled then.
    Exception
        The error of an item, with `on_error` ``"raise"``.

    Examples
    --------
    >>> import tempfile, fieldbake as fb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     rows = sample_many({"gear": fb.models.gear()}, folder, "deepsdf", n=1000)
    ...     print(rows[0]["status"], sorted(os.listdir(folder)))
    done ['gear.npz', 'ledger.jsonl']
    """
    shared = {"executor": executor, "resume": resume, "on_error": on_error, "limit_s": limit_s, "workers": workers}
    return library.sample_many(
        items, out, catalogue.checked_recipe(recipe), seed=seed, progress=progress, **shared, **numbers
    )


class Dataset:
    """A map-style data set of the samples of many meshes, for ``torch.utils.data.DataLoader`` or any loop.

    Parameters
    ----------
    items_or_folder : folder, or items of :func:`sample_many`
        A folder that :func:`sample_many` wrote, whose files are read, or meshes, whose samples are drawn when they are
        read.
    recipe : str or Recipe
        As for :func:`sample`.
    seed : int, default 0
        The seed of an item is the first 8 bytes, little endian, of the SHA-256 of ``f"{seed}/{stem}/{epoch}"``.
    epoch : int, default 0
        Number of the epoch, at least 0; each has other samples of the same meshes. A folder has epoch 0 only.
    cache : path, optional
        Folder in which drawn samples are kept. A later read of the same mesh with the same seed, epoch and numbers
        reads the file.
    **numbers
        As for :func:`sample`; none for a folder.

    Raises
    ------
    ArgumentError
        As for :func:`sample_many`; also for seeds, epochs, numbers or a cache with a folder.
    FormatError
        If the folder has no results of the recipe, or a file is damaged.
    FileNotFoundError
        If the folder does not exist.

    Notes
    -----
    An item is the dict of arrays of :func:`sample`, drawn on the CPU. The same seed gives the same bytes in any
    process, with any number of workers, shuffled or not. The data set can be pickled, which workers that are spawned
    need; items that are functions must be importable then. Stores that end in ``.zarr`` need spawned workers.

    Examples
    --------
    >>> import fieldbake as fb
    >>> data = Dataset({"gear": fb.models.gear(), "knot": fb.models.torus_knot()}, "vecset", n=100, near_n=50)
    >>> len(data), data[1]["points/near_label"].shape
    (2, (50,))
    >>> bool((data[0]["points/vol_points"] == data.with_epoch(1)[0]["points/vol_points"]).all())
    False
    """

    def __init__(
        self,
        items_or_folder: Any,
        recipe: str | Recipe,
        *,
        seed: int = 0,
        epoch: int = 0,
        cache: str | os.PathLike[str] | None = None,
        **numbers: Any,
    ) -> None:
        self.recipe = catalogue.checked_recipe(recipe)
        self.seed = checks.integer("seed", seed, least=0, most=2**64 - 1)
        self.epoch = checks.integer("epoch", epoch, least=0, most=2**63 - 1)
        self._numbers = catalogue.checked_numbers(self.recipe, numbers)
        self._folder: Path | None = None
        self._cache = None if cache is None else checks.path(cache, "cache")
        if isinstance(items_or_folder, (str, bytes, os.PathLike)):
            self._folder = checks.path(items_or_folder, "items_or_folder")
            given = [name for name, value in (("seed", seed), ("epoch", epoch), ("cache", cache)) if value]
            self._check_folder(*given, *(name for name in numbers if name != "category"))
            self._named: list[tuple[str, Any]] = [(stem, None) for stem in self._stems()]
        else:
            self._named = library.named_items(items_or_folder)
            library.check_stems(self._named, "")

    @property
    def stems(self) -> list[str]:
        """Names of the items, in order."""
        return [stem for stem, _ in self._named]

    def with_epoch(self, epoch: int) -> Dataset:
        """Make the data set of another epoch: the same meshes with other samples."""
        other = copy.copy(self)
        other.epoch = checks.integer("epoch", epoch, least=0, most=2**63 - 1)
        if epoch:
            other._check_folder("epoch")
        return other

    def __len__(self) -> int:
        return len(self._named)

    def __getitem__(self, index: int) -> Arrays:
        stem, item = self._named[operator.index(index)]
        return self._draw(stem, item) if self._folder is None else self._read(stem)

    def __getitems__(self, indices: Sequence[int]) -> list[Arrays]:
        """Items at several indices, as loaders request the items of a batch."""
        return [self[index] for index in indices]

    def __repr__(self) -> str:
        return f"Dataset({len(self)} items, recipe={self.recipe.name!r}, seed={self.seed}, epoch={self.epoch})"

    def _check_folder(self, *given: str) -> None:
        """Refuse arguments that change how samples are drawn, if the samples come from a folder."""
        if self._folder is not None and given:
            raise ArgumentError(f"{given[0]}: does not apply to the finished samples of a folder; pass the meshes")

    def _draw(self, stem: str, item: Any) -> Arrays:
        """Draw the samples of an item, or read them from the cache."""
        if callable(item) and not library.is_mesh(item):
            item = item()
        seed = catalogue.item_seed(self.seed, stem, self.epoch)
        file = None
        if self._cache is not None:
            options = {"kind": self.recipe.name, "content": content.of_item(item), "seed": seed, **self._numbers}
            file = self._cache / f"{stem}-{content.of_options(options)[:16]}.npz"
            if file.is_file():
                return _load(file)
        arrays, _ = catalogue.draw(self.recipe, item, seed=seed, device="cpu", **self._numbers)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(file) as stream:
                np.savez(stream, allow_pickle=False, **arrays)
        return arrays

    def _stems(self) -> list[str]:
        """Names of the results in the folder, sorted."""
        assert self._folder is not None
        if not self._folder.is_dir():
            raise FileNotFoundError(f"{self._folder}: no such folder of samples")
        if self._folder.suffix == ".zarr":
            found = [path.name for path in self._folder.iterdir() if path.is_dir() and path.name[0] != "."]
        else:
            first = next(iter(self.recipe.files.values()))
            # Every {stem} of a path must be the same text.
            text = re.escape(first.format_map({**self._numbers, "stem": "\0"}))
            text = text.replace("\0", "([^/]+)", 1).replace("\0", r"\1")
            paths = self._folder.glob(first.format_map({**self._numbers, "stem": "*"}))
            matches = (re.fullmatch(text, path.relative_to(self._folder).as_posix()) for path in paths)
            found = [match[1] for match in matches if match]
        if not found:
            raise FormatError(f"{self._folder}: has no results of the recipe '{self.recipe.name}'")
        return sorted(found)

    def _read(self, stem: str) -> Arrays:
        """Read the samples of an item from its files, or from its group."""
        assert self._folder is not None
        arrays: Arrays = {}
        if self._folder.suffix == ".zarr":
            group = import_zarr().open_group(self._folder / stem, mode="r")
            arrays = {key: group[key][...] for key in self.recipe.arrays if key in group}
        else:
            for name, path in catalogue.paths(self.recipe, self._folder, stem, self._numbers).items():
                found = _load(path)
                arrays.update({catalogue.key_of(name, inner): array for inner, array in found.items()})
        missing = self.recipe.arrays.keys() - arrays.keys()
        if missing:
            raise FormatError(f"{self._folder}: the result {stem!r} has no array {sorted(missing)[0]!r}")
        return {key: arrays[key] for key in self.recipe.arrays}


def _load(file: Path) -> Arrays:
    """Read the arrays of a file; the only one of an ``.npy`` file has an empty name."""
    try:
        with file.open("rb") as stream:  # NumPy leaves a damaged file open
            if file.suffix == ".npy":
                return {"": np.load(stream, allow_pickle=False)}
            with np.load(stream, allow_pickle=False) as found:
                return {name: found[name] for name in found}
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile and NumPy raise many kinds for damaged files
        raise FormatError(f"{file}: cannot be read as arrays: {error}") from error
