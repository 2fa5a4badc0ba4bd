"""Many assets: one field, or one file of training samples, for each."""

from __future__ import annotations

import contextlib
import inspect
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from ..baking.dense import bake
from ..base import checks
from ..base.errors import ArgumentError, Error, FormatError
from ..base.progress import Progress, progress_callback
from . import content, executors, recipes, records, results
from .process import Child, Portable, UnsendableError
from .recipes import Recipe
from .results import Asset, process
from .stores.store import import_zarr

#: The function of each kind of run, and the options of that function, which all items share.
OPTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "bake": ("bake", tuple(name for name in inspect.signature(bake).parameters if name not in ("mesh", "progress"))),
    "sample": ("sample_training", ("n", "near", "uniform", "seed", "sign", "dtype", "normalize")),
}

#: Progress reaches a callback at most this often, seconds.
INTERVAL = 0.1


def bake_many(
    items: Iterable[Any] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    executor: Any = None,
    on_error: Literal["record", "raise"] = "record",
    resume: bool = True,
    limit_s: float | None = None,
    workers: int | None = None,
    format: str = "npz",
    encoding: str | None = None,
    progress: Progress = None,
    **options: Any,
) -> list[dict[str, Any]]:
    """Bake each item of a library into a file of its own.

    Parameters
    ----------
    items : iterable of mesh files, meshes, (vertices, faces), shapes or callables; or a mapping of stems to those
        Everything that :func:`bake` takes, except shapes that contain a volume. A callable without arguments returns
        such a mesh or shape; it runs where the item is baked. The result is ``out/STEM.npz``. The stem is the stem of
        the file, the key of a mapping, the name of a function, or else ``item-`` and the position of the item. Files
        with equal stems keep their ending: ``out/STEM.obj.npz`` and ``out/STEM.ply.npz``.
    out : path
        Folder for the results and for ``ledger.jsonl``; it is made if it is missing.
    executor : optional
        As for :func:`bake_to_zarr`. By default the items are baked in processes of this machine.
    on_error : "record" or "raise", default "record"
        Record the error of an item and continue, or raise the first one.
    resume : bool, default True
        Skip items with the content and options of a finished result. Failed items are tried again.
    limit_s : float, optional
        Time limit of an item, seconds. An item that takes longer is stopped and counts as failed.
    workers : int, optional
        Number of items that are baked at the same time without an `executor`. By default the number of cores.
    format : str, default "npz"
        Ending of the results; :meth:`Volume.save` lists the endings.
    encoding : str, optional
        Encoding of the results, as for :meth:`Volume.save`. In ``.npz`` files it is the encoding of
        :meth:`Volume.quantize`, with `band` or 4 voxels.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction of items.
    **options
        Options of :func:`bake`, for all items: `resolution`, `voxel_size`, `bounds`, `margin`, `sign`, `band`,
        `two_sided`, `thickness` and `device`.

    Returns
    -------
    list of dict
        One row for each item, in the order of the items: ``item`` (the path as it came, or the stem), ``path`` (the
        result), ``status`` (``"done"``, ``"skipped"`` or ``"failed"``), ``seconds``, ``error`` (text or None) and
        ``report`` (dict of the bake's report, or None).

    Raises
    ------
    ArgumentError
        If two items would have the same result, an option is unknown or out of range, or the folder has results of
        :func:`sample_training`; nothing is baked then.
    Exception
        The error of an item, with `on_error` ``"raise"``. Finished results stay.

    Notes
    -----
    Each item is baked in a child process of its worker. An item that crashes, runs out of memory or exceeds `limit_s`
    ends that process and no other item. Functions of scripts and notebooks need the package cloudpickle for that;
    without it they are baked in the worker itself, and fail if there is a `limit_s`. Results are
    written to a temporary file and renamed, so no result file is ever incomplete. The ledger has one line for each item
    that was done or has failed.

    Examples
    --------
    >>> import tempfile, fieldbake
    >>> knot = fieldbake.models.torus_knot(segments=64, sides=8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     first = fieldbake.bake_many({"knot": knot}, folder, resolution=16)
    ...     second = fieldbake.bake_many({"knot": knot}, folder, resolution=16)
    >>> first[0]["status"], second[0]["status"]
    ('done', 'skipped')
    """
    shared = (executor, on_error, resume, limit_s, workers, progress, format, encoding)
    return Run("bake", checks.path(out, "out"), options, *shared).rows(items)


def sample_many(
    items: Iterable[Any] | Mapping[str, Any],
    out: str | os.PathLike[str],
    recipe: str | Recipe | None = None,
    **options: Any,
) -> list[dict[str, Any]]:
    """Draw training samples of each item; arguments and rows as for :func:`bake_many`.

    Items are meshes; for a shape, pass ``shape.to_mesh()``. The options are the options of :func:`sample_training`, and
    `normalize`: ``"unit cube"`` or ``"unit sphere"``, the target of :func:`normalize` for each mesh. A result is an
    .npz file of ``points`` (n, 3), float64 or `dtype`, and the float32 ``distances`` (n,) and ``gradients`` (n, 3) at
    these points. With `normalize` it has the ``transform`` (4, 4), float64, from the positions of the mesh to the
    positions of the points. If `out` ends in ``.zarr``, it is a group of these arrays in one Zarr store. In the report
    of a row, ``undecided_voxels`` is the number of points whose sign is uncertain.

    With a `recipe`, the options are its numbers, ``seed``, ``sign`` and ``device``; see
    :func:`fieldbake.training.sample_many`.
    """
    if recipe is not None:
        options["recipe"] = recipes.checked_recipe(recipe)
    else:
        # The type of the points is an option of every run, so that results with another type are drawn again.
        options.setdefault("dtype", "float64")
    shared = {field.name: options.pop(field.name) for field in fields(Run) if field.name in options}
    return Run("sample", checks.path(out, "out"), options, **shared).rows(items)


@dataclass
class Run:
    """One call of :func:`bake_many` or :func:`sample_many`, whose arguments are its fields."""

    kind: Literal["bake", "sample"]
    out: Path
    options: Mapping[str, Any]
    executor: Any = None
    on_error: Literal["record", "raise"] = "record"
    resume: bool = True
    limit_s: float | None = None
    workers: int | None = None
    progress: Progress = None
    format: str = "npz"
    encoding: str | None = None
    recipe: Recipe | None = None

    def __post_init__(self) -> None:
        if self.recipe is not None:
            # All numbers are options of the run, so that the results change with the numbers of a recipe.
            # Devices round differently, and a sample must not depend on its worker.
            defaults = {"seed": 0, "device": "cpu"}
            self.options = {**defaults, **self.options, **recipes.checked_options(self.recipe, self.options)}
        else:
            self._check_names()
        self.executor = executors.checked_executor(self.executor)
        checks.choice("on_error", self.on_error, ("record", "raise"))
        checks.flag("resume", self.resume)
        if self.limit_s is not None:
            checks.number("limit_s", self.limit_s, above=0)
        if self.workers is not None:
            checks.integer("workers", self.workers, least=1, most=1024)
            if self.executor is not None:
                raise ArgumentError("workers: does not apply with an executor, which has its own workers")
        self.ending, self.encoding = results.checked_format(self.kind, self.out, self.format, self.encoding)
        if self.recipe is None:
            results.check_options(self.kind, self.options)
        #: Word for the results of the run in the ledger.
        self.label = self.kind if self.recipe is None else self.recipe.name
        self.options_hash = content.of_options({"kind": self.label, "encoding": self.encoding, **self.options})

    def _check_names(self) -> None:
        function, known = OPTIONS[self.kind]
        for name in self.options:
            if name not in known:
                raise ArgumentError(f"{name}: is no option of {function}; its options are {', '.join(known)}")

    def rows(self, items: Iterable[Any] | Mapping[str, Any]) -> list[dict[str, Any]]:
        """Bake or sample all items."""
        named = named_items(items)
        check_stems(named, self.ending)
        earlier = records.read(self.out)
        self._check_kind(earlier[name] for name in (self._result(stem).name for stem, _ in named) if name in earlier)
        if not self.resume:
            earlier = {}
        self.out.mkdir(parents=True, exist_ok=True)
        if not self.ending:
            zarr = import_zarr()
            try:
                zarr.open_group(self.out, mode="a", zarr_format=3)
            except zarr.errors.ContainsArrayError:
                raise FormatError(f"out: {self.out} has other contents than training samples; they stay") from None
        rows: list[dict[str, Any]] = []
        assets: list[tuple[int, Asset]] = []
        first_error: Exception | None = None
        for index, (stem, item) in enumerate(named):
            row = self._first_row(stem, item)
            rows.append(row)
            last = earlier.get(self._result(stem).name)
            start = time.perf_counter()
            try:
                found = None if callable(item) and not is_mesh(item) else content.of_item(item)
            except Exception as error:  # a missing or damaged file is an error of this item alone
                row.update(error=_text(error), seconds=time.perf_counter() - start)
                records.append(self.out, {**row, "kind": self.label})
                first_error = first_error or _named(error, row)
                continue
            targets = self._targets(stem)
            if found is not None and records.is_done(last, targets, found, self.options_hash):
                assert last is not None
                row.update(status="skipped", seconds=0.0, report=last.get("report"))
                continue
            known = last.get("content") if last is not None and found is None else None
            if last is not None and records.is_done(last, targets, known, self.options_hash):
                row["report"] = last.get("report")
            else:
                known = None
            if found is None:
                item = Portable(item)
            options = self.options
            if self.recipe is not None:
                options = {**options, "seed": recipes.item_seed(options["seed"], stem, 0)}
            recipe = None if self.recipe is None else self.recipe.name
            assets.append((index, Asset(item, tuple(targets), self.kind, options, self.encoding, found, known, recipe)))
        if first_error is not None and self.on_error == "raise":
            raise first_error
        self._work(rows, assets)
        return rows

    def _first_row(self, stem: str, item: Any) -> dict[str, Any]:
        label = item if isinstance(item, (str, os.PathLike)) else stem
        path = os.fspath(self._result(stem))
        return {"item": label, "path": path, "status": "failed", "seconds": 0.0, "error": None, "report": None}

    def _result(self, stem: str) -> Path:
        """Path of the result of an item: a file, a group, or a folder of several files."""
        if self.recipe is None or not self.ending:
            return self.out / f"{stem}{self.ending}"
        return recipes.result(self.recipe, self.out, stem, self.options)

    def _targets(self, stem: str) -> list[Path]:
        """Paths of all files of the result of an item, or of its group."""
        if self.recipe is None or not self.ending:
            return [self._result(stem)]
        return list(recipes.paths(self.recipe, self.out, stem, self.options).values())

    def _check_kind(self, earlier: Iterable[Mapping[str, Any]]) -> None:
        for row in earlier:
            if row.get("status") == "done" and row.get("kind", self.label) != self.label:
                raise ArgumentError(
                    f"out: {Path(row['path']).name} in {self.out} is a result of '{row['kind']}', which '{self.label}' "
                    "would overwrite; choose another folder"
                )

    def _work(self, rows: list[dict[str, Any]], assets: list[tuple[int, Asset]]) -> None:
        if not assets:
            if rows and callable(self.progress):
                self.progress(1.0)
            return
        done = len(rows) - len(assets)
        lost: list[tuple[int, Asset]] = []
        with (
            progress_callback(self.progress, self.kind) as callback,
            executors.opened(self.executor) as executor,
        ):
            report = _throttled(callback, len(rows))
            for place, facts, error in self._results(executor, [asset for _, asset in assets]):
                if isinstance(error, BrokenExecutor):
                    lost.append(assets[place])
                    continue
                self._finish(rows[assets[place][0]], facts, error)
                done += 1
                report(done)
            # A pool whose worker was killed accepts no more tasks. Children of this process bake the rest.
            for place, facts, error in self._results(None, [asset for _, asset in lost]):
                self._finish(rows[lost[place][0]], facts, error)
                done += 1
                report(done)

    def _results(self, executor: Any, assets: list[Asset]) -> Iterable[tuple[int, Any, BaseException | None]]:
        if not assets:
            return
        if executor is not None:
            threads = executors.threads_per_worker(executor)
            if executors.is_local(executor):
                threads = max(1, executors.available_cores() // executors.worker_count(executor))
            tasks = [(asset, self.limit_s, threads) for asset in assets]
            yield from executors.run_tasks(executor, work, tasks)
            return
        cores = executors.available_cores()
        workers = min(self.workers or cores, len(assets))
        children: list[Child] = []
        local = threading.local()

        def here(asset: Asset) -> dict[str, Any]:
            if not hasattr(local, "child"):
                local.child = Child(max(1, cores // workers))
                children.append(local.child)
            return work_in(local.child, asset, self.limit_s)

        def stop() -> None:
            for child in children:
                child.stop()

        with ThreadPoolExecutor(workers, thread_name_prefix="fieldbake") as pool:
            yield from executors.run_tasks(pool, here, [(asset,) for asset in assets], stop)

    def _finish(self, row: dict[str, Any], facts: dict[str, Any] | None, error: BaseException | None) -> None:
        if facts is None:
            assert error is not None
            row.update(error=_text(error), report=None)
        else:
            error = facts.pop("exception", None)
            if facts["status"] == "skipped":
                facts["report"] = row["report"]
            row.update((key, facts[key]) for key in ("status", "seconds", "error", "report") if key in facts)
        if row["status"] != "skipped":
            proof = {
                "content": None,
                "bytes": None,
                **{k: v for k, v in (facts or {}).items() if k in ("content", "bytes")},
            }
            records.append(self.out, {**row, **proof, "options": self.options_hash, "kind": self.label})
        if error is not None and self.on_error == "raise":
            raise _named(error, row)


def named_items(items: Iterable[Any] | Mapping[str, Any]) -> list[tuple[str, Any]]:
    """List each item with the stem of its result."""
    if isinstance(items, (str, os.PathLike)):
        raise ArgumentError(f"items: must be a list of meshes, got the path {os.fspath(items)!r}; put it in a list")
    if isinstance(items, Mapping):
        for stem in items:
            if not isinstance(stem, str) or not stem or Path(stem).name != stem:
                raise ArgumentError(f"items: keys must be stems of file names, got {checks.describe(stem)}")
        return list(items.items())
    named = []
    for index, item in enumerate(checks.items("items", items, "meshes")):
        name = getattr(item, "__name__", "")
        if isinstance(item, (str, os.PathLike)):
            stem = Path(item).stem
        elif callable(item) and name.isidentifier():
            stem = name
        else:
            stem = f"item-{index:05d}"
        named.append((stem, item))
    return distinct_stems(named)


def distinct_stems(named: Sequence[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Keep the endings of files whose stems are equal: ``a.obj`` and ``a.ply`` replace two stems ``a``."""
    stems = [stem for stem, _ in named]
    while True:
        counts = Counter(stem.casefold() for stem in stems)
        longer = [
            Path(item).name if counts[stem.casefold()] > 1 and isinstance(item, (str, os.PathLike)) else stem
            for stem, (_, item) in zip(stems, named, strict=True)
        ]
        # A longer stem may be equal to another stem. Every round but the last makes at least one longer.
        if longer == stems:
            return [(stem, item) for stem, (_, item) in zip(stems, named, strict=True)]
        stems = longer


def check_stems(named: Sequence[tuple[str, Any]], ending: str) -> None:
    """Raise an error if two results would have the same name, also on file systems that ignore case."""
    seen: dict[str, int] = {}
    for index, (stem, _) in enumerate(named):
        if not stem:
            raise ArgumentError(f"items[{index}]: has no name for its result")
        first = seen.setdefault(stem.casefold(), index)
        if first != index:
            one, other = (_place(i, named[i][1]) for i in (first, index))
            raise ArgumentError(
                f"items: {one} and {other} would both be written as '{stem}{ending}'; rename one, or pass a mapping of "
                "stems to items"
            )


def _place(index: int, item: Any) -> str:
    """Return the position of an item, with its path if it has one."""
    name = f" ({os.fspath(item)})" if isinstance(item, (str, os.PathLike)) else ""
    return f"items[{index}]{name}"


def is_mesh(item: Any) -> bool:
    """Whether an item is a mesh or a scene of some library, which may also be callable."""
    return hasattr(item, "vertices") or hasattr(item, "geometry")


def _throttled(callback: Callable[[float], object] | None, count: int) -> Callable[[int], None]:
    last = [0.0]

    def report(done: int) -> None:
        now = time.monotonic()
        if callback is not None and (done == count or now - last[0] >= INTERVAL):
            last[0] = now
            callback(done / count)

    return report


def _text(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{type(error).__name__}: {error.strerror}" + (f": {error.filename}" if error.filename else "")
    return f"{type(error).__name__}: {error}"


def _named(error: BaseException, row: Mapping[str, Any]) -> Exception:
    """Return the error with the name of the item in its message."""
    if not isinstance(error, Exception):
        return Error(f"{row['item']}: {error}")
    if str(row["item"]) in str(error):
        return error
    if isinstance(error, Error):
        with contextlib.suppress(TypeError):
            return type(error)(f"{row['item']}: {error}")
    if hasattr(error, "add_note"):
        error.add_note(f"in item {row['item']}")
    return error


#: The child of each thread that works on items.
_local = threading.local()


def work(asset: Asset, limit_s: float | None, threads: int | None) -> dict[str, Any]:
    """Work on an item in the child of this thread of a worker."""
    if not hasattr(_local, "child"):
        _local.child = Child(threads)
    return work_in(_local.child, asset, limit_s)


def work_in(child: Child, asset: Asset, limit_s: float | None) -> dict[str, Any]:
    """Work on an item in a child, or in this process if it cannot be sent there. Errors are part of the result."""
    start = time.perf_counter()
    facts: dict[str, Any] = {"status": "failed", "error": None, "report": None, "content": asset.content}
    try:
        try:
            facts |= child.call(process, asset, limit_s=limit_s)
        except UnsendableError as error:
            if limit_s is not None:
                raise Error(
                    f"limit_s needs a process of its own for each item, and this one cannot be sent there ({error}); "
                    "install cloudpickle, or import the function from a module"
                ) from None
            facts |= process(asset)
    except Exception as error:  # it becomes the result of the item
        facts |= {"error": _text(error), "exception": error}
    facts["seconds"] = time.perf_counter() - start
    return facts
