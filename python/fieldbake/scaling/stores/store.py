"""Zarr stores: opening, creating, listing and the errors of damaged ones."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...base import checks, encodings
from ...base.errors import ArgumentError, Error, FormatError
from ...base.optional import optional_module
from ...meshes.mesh import Mesh, restore
from .. import content
from . import layout as layouts
from .layout import Layout

#: Attribute of a group while its arrays are created. A run that finds it deletes the group and starts again.
UNFINISHED = "fieldbake_unfinished"

#: The part of a store that is read at its opening.
METADATA = "its metadata"

#: Advice for damage outside the levels.
REPAIR = "call bake_to_zarr with the same mesh and options to repair it"

#: Compression of the chunks. Its checksum finds damage.
ZSTD_LEVEL = 3


def import_zarr() -> Any:
    """Import the package zarr, or raise an error that states how to install it."""
    for module in ("zarr.codecs", "zarr.storage"):
        optional_module(module, "a Zarr store", extra="zarr")
    return optional_module("zarr", "a Zarr store", extra="zarr")


@dataclass(frozen=True)
class Place:
    """Location of a store. Worker processes receive it, and each opens the store itself."""

    #: A path, a URL or a Zarr store.
    store: Any
    #: Options of the file system of a URL.
    options: dict[str, Any] | None = None

    @classmethod
    def of(cls, store: Any, options: Mapping[str, Any] | None) -> Place:
        """Check the argument `store` of a user."""
        zarr = import_zarr()
        if options is not None and not isinstance(options, Mapping):
            raise ArgumentError(f"storage_options: must be a mapping, got {checks.describe(options)}")
        if isinstance(store, os.PathLike):
            store = os.fspath(store)
        if isinstance(store, str):
            if not store:
                raise ArgumentError("store: the path is empty")
            store = store.removeprefix("file://").removeprefix("local://")
            if "://" in store:
                return cls(store, None if options is None else dict(options))
            store = os.path.abspath(store)  # noqa: PTH100 - workers may have another working directory
        if options:
            raise ArgumentError(f"storage_options: apply to URLs such as s3://bucket/name, not to {store}")
        if isinstance(store, (str, zarr.abc.store.Store)):
            return cls(store)
        raise ArgumentError(f"store: must be a path, a URL or a Zarr store, got {checks.describe(store)}")

    @property
    def is_shared(self) -> bool:
        """Whether other processes can read the same contents."""
        zarr = import_zarr()
        if isinstance(self.store, str):
            return not any(part.startswith("memory:") for part in self.store.split("::"))
        inner = self.store
        while inner is not None:
            if isinstance(inner, zarr.storage.MemoryStore) or type(inner).__name__ == "MemoryFileSystem":
                return False
            # The store of a wrapper, the file system of a store, and the file system of a cache.
            parts = getattr(inner, "__dict__", {})
            inner = next((parts[name] for name in ("_store", "sync_fs", "fs") if name in parts), None)
        return True

    def __str__(self) -> str:
        return str(self.store)

    @property
    def folder(self) -> str | None:
        """The folder of a store of files; None for other stores."""
        if isinstance(self.store, str):
            return None if "://" in self.store else self.store
        root = getattr(self.store, "root", None)
        return os.fspath(root) if isinstance(root, os.PathLike) else None

    def has_files(self) -> bool:
        """Whether the place is a folder of this machine with contents."""
        return self.folder is not None and Path(self.folder).is_dir() and any(Path(self.folder).iterdir())

    @property
    def name(self) -> str:
        """The last part of the path."""
        return str(self.store).rstrip("/").rsplit("/", 1)[-1].partition(".")[0] or "field"

    def open(self, mode: str, **attributes: Any) -> Any:
        """Open the group, or create it with attributes; FileNotFoundError without one."""
        zarr = import_zarr()
        if mode != "r" and not getattr(self.store, "supports_deletes", True):
            raise ArgumentError(f"store: {self} cannot replace its contents, as a bake must; bake into a folder")
        try:
            options = {"storage_options": self.options} if self.options else {}
            return zarr.open_group(self.store, mode=mode, zarr_format=3, attributes=attributes or None, **options)
        except ImportError as error:
            raise Error(f"store: '{self}' needs a package for its kind of storage: {error}") from error
        except (FileNotFoundError, zarr.errors.GroupNotFoundError):
            raise
        except (FileExistsError, NotADirectoryError, zarr.errors.ContainsArrayError):
            raise self.occupied() from None
        except OSError:
            raise
        except Exception as error:
            if self._is_unknown_url():
                raise ArgumentError(f"store: {self} cannot be opened: {error}") from error
            raise FormatError(f"{self}: {METADATA} is damaged: {error!r}; {REPAIR}") from error

    def _is_unknown_url(self) -> bool:
        """Whether fsspec finds no file system for the store, which is a URL."""
        if self.folder is not None or not isinstance(self.store, str):
            return False
        try:
            optional_module("fsspec", "a URL", extra="zarr").core.url_to_fs(self.store, **(self.options or {}))
        except (TypeError, ValueError):
            return True
        return False

    def existing(self, mode: str) -> Any:
        """Open the group, or return None if there is none."""
        zarr = import_zarr()
        try:
            return self.open(mode)
        except (FileNotFoundError, zarr.errors.GroupNotFoundError) as error:
            # Zarr finds no group where the kind of the node is damaged.
            if self.folder is not None and Path(self.folder, "zarr.json").is_file():
                raise FormatError(f"{self}: {METADATA} is damaged: {error!r}; {REPAIR}") from error
            return None

    def occupied(self) -> FormatError:
        """The error for a place with contents that fieldbake has not written."""
        return FormatError(f"store: {self} has other contents than a field of fieldbake; they stay as they are")


@contextmanager
def reading(place: object, part: str = METADATA) -> Iterator[None]:
    """Translate the errors of zarr and of its codecs while a part of a store is read; each codec has its own ones."""
    try:
        yield
    except (Error, OSError, MemoryError):
        raise
    except Exception as error:
        raise FormatError(f"{place}: {part} is damaged: {error!r}; {REPAIR}") from error


def checked_array(group: Any, path: str, shape: tuple[int, ...], dtype: Any, shard: int, chunk: int, fill: Any) -> Any:
    """Open an array of the plan whose metadata are those that :func:`create` wrote, or raise FormatError."""
    array = group[path]
    expected = {"shape": shape, "dtype": np.dtype(dtype)}
    expected |= {"fill_value": fill} if fill is not None else {}
    expected |= {"shards": (shard,) * 3, "chunks": (chunk,) * 3} if shard else {}
    for name, value in expected.items():
        found = getattr(array, name)
        if not np.array_equal(found, value, equal_nan=name == "fill_value"):
            raise FormatError(f"{group.store_path}: {path} has the {name} {found}, not {value}; {REPAIR}")
    keys = array.metadata.chunk_key_encoding
    if keys.encode_chunk_key((1,) * len(shape)) != "/".join("c" + "1" * len(shape)):
        raise FormatError(f"{group.store_path}: the chunks of {path} have unknown keys; {REPAIR}")
    return array


def is_ours(group: Any) -> bool:
    """Whether fieldbake has written a group, or has begun to."""
    return "fieldbake" in group.attrs or bool(group.attrs.get(UNFINISHED))


def create(place: Place, group: Any, layout: Layout, mesh: Mesh, report: Mapping[str, Any]) -> Any:
    """Create the group with its empty levels and the mesh. The attributes come last: they make the store valid.

    `group` is the group at the place, or None. Its contents are deleted if fieldbake has written them.
    """
    zarr = import_zarr()
    if group is None or is_ours(group):
        group = place.open("w-" if group is None else "w", **{UNFINISHED: True})
    elif group.attrs or any(True for _ in group.members()):
        raise place.occupied()
    else:
        group.attrs.update({UNFINISHED: True})
    for level in range(layout.level_count):
        parent = group if level == 0 else group.require_group("levels")
        nx, ny, nz = layout.level(level).shape
        parent.create_array(
            name=str(level),
            shape=(nz, ny, nx),
            chunks=(layout.chunk,) * 3,
            shards=(layout.shard,) * 3,
            dtype=encodings.DTYPES[layout.encoding],
            fill_value=layout.fill,
            compressors=zarr.codecs.ZstdCodec(level=ZSTD_LEVEL, checksum=True),
            dimension_names=("z", "y", "x"),
            attributes={"scale": float(layout.scale)},
        )
    write_mesh(group, mesh)
    group.attrs.put(layouts.attributes(layout, place.name, report))
    return group


def read_layout(group: Any, place: Place) -> Layout:
    """The layout of an open group, or FormatError."""
    facts = group.attrs.get("fieldbake")
    if not isinstance(facts, Mapping):
        raise FormatError(f"{place}: is a Zarr group that fieldbake has not written, or has not written completely")
    if facts.get("layout") != layouts.VERSION:
        raise FormatError(
            f"{place}: has layout {facts.get('layout')}, this fieldbake reads {layouts.VERSION}; it was written by "
            f"fieldbake {facts.get('version')}"
        )
    return Layout.from_dict(facts)


def write_mesh(group: Any, mesh: Mesh) -> None:
    """Store the arrays of a mesh, and their hash: a lost chunk of an array is read as zeros."""
    arrays = _mesh_arrays(mesh)
    parts = group.create_group("mesh", overwrite=True, attributes={"hash": content.of_arrays(*arrays.values())})
    for name, array in arrays.items():
        parts.create_array(name=name, data=array)


def _mesh_arrays(mesh: Mesh) -> dict[str, NDArray[Any]]:
    state = zip(("vertices", "faces", "rows"), mesh._core.state(), strict=True)
    return {name: np.asarray(array) for name, array in state if array is not None}


def has_mesh(group: Any) -> bool:
    """Whether the arrays of the mesh in a store are complete."""
    try:
        _read_mesh_arrays(group)
    except FormatError:
        return False
    return True


def read_mesh(group: Any) -> Mesh:
    """Read the mesh that a store was baked from. It has the bits of the original."""
    arrays = _read_mesh_arrays(group)
    return restore(arrays["vertices"], arrays["faces"], arrays.get("rows"))


def _read_mesh_arrays(group: Any) -> dict[str, NDArray[Any]]:
    with reading(group.store_path, "the mesh"):
        parts = group["mesh"]
        arrays = {name: read_array(group, f"mesh/{name}") for name in ("vertices", "faces", "rows") if name in parts}
        if content.of_arrays(*arrays.values()) == parts.attrs.get("hash"):
            return arrays
    raise FormatError(f"{group.store_path}: the mesh is damaged; {REPAIR}")


def read_array(group: Any, path: str) -> NDArray[Any]:
    """Read a whole array besides the levels."""
    with reading(group.store_path, path):
        array = group[path]
        _core.require_memory(f"the array {path}", int(array.nbytes), "Check the metadata of the store.")
        return np.asarray(array[...])


def complete(
    group: Any,
    path: str,
    shape: tuple[int, ...],
    dtype: Any,
    fill: float,
    values: Callable[[NDArray[Any]], NDArray[Any]],
) -> NDArray[Any]:
    """Store ``values(found)`` in an array of the plan, where `found` is what the store has; return the values.

    The array is created if it is missing. Lost and damaged chunks are found as `fill`.
    """
    if path not in group:
        group.create_array(name=path, shape=shape, dtype=dtype, fill_value=fill, dimension_names=("z", "y", "x"))
    try:
        found = read_array(group, path)
    except FormatError:
        found = np.full(shape, fill, dtype)
    computed = values(found)
    if not np.array_equal(found, computed, equal_nan=True):
        group[path][...] = computed
    return computed


def stored_keys(group: Any, level: int, *, clean: bool = False) -> set[str]:
    """Keys of the shards of a level that are stored, relative to the group.

    With `clean`, the remains of broken writes are deleted.
    """
    array = group[layouts.path_of(level)]
    prefix = group.store_path.path
    start = f"{prefix}/" if prefix else ""
    keys = set()
    for key in _listed(array.store_path.store, f"{array.store_path.path}/c/"):
        if not key.endswith(".partial"):
            keys.add(key.removeprefix(start))
        elif clean:
            _sync(array.store_path.store.delete(key))
    return keys


def _listed(store: Any, prefix: str) -> list[str]:
    async def collect() -> list[str]:
        return [key async for key in store.list_prefix(prefix)]

    try:
        return list(_sync(collect()))
    except FileNotFoundError:
        return []


def _sync(work: Any) -> Any:
    from zarr.core.sync import sync

    return sync(work)


def size_of(place: Place, group: Any, key: str) -> int | None:
    """Bytes of a key of the store, relative to the group; None if it is missing."""
    prefix = group.store_path.path
    try:
        if place.folder is not None:
            return Path(place.folder, key).stat().st_size
        return int(_sync(group.store_path.store.getsize(f"{prefix}/{key}" if prefix else key)))
    except FileNotFoundError:
        return None
