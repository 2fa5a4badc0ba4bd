"""Zarr stores: opening, creating, listing and the errors of damaged ones."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base import checks, encodings
from ..base.errors import ArgumentError, Error, FormatError
from ..base.optional import optional_module
from ..meshes.mesh import Mesh, restore
from . import layout as layouts
from .layout import Layout

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
        if isinstance(store, os.PathLike):
            store = os.fspath(store)
        if isinstance(store, str):
            if not store:
                raise ArgumentError("store: the path is empty")
            if "://" not in store:
                store = os.path.abspath(store)  # noqa: PTH100 - workers may have another working directory
            return cls(store, None if options is None else dict(options))
        if isinstance(store, zarr.abc.store.Store):
            return cls(store)
        raise ArgumentError(f"store: must be a path, a URL or a Zarr store, got {checks.describe(store)}")

    @property
    def is_shared(self) -> bool:
        """Whether other processes can read the same contents."""
        zarr = import_zarr()
        if isinstance(self.store, str):
            return not self.store.startswith("memory:")
        return not isinstance(self.store, zarr.storage.MemoryStore)

    def __str__(self) -> str:
        return str(self.store)

    @property
    def name(self) -> str:
        """The last part of the path."""
        return str(self.store).rstrip("/").rsplit("/", 1)[-1].partition(".")[0] or "field"

    def open(self, mode: str) -> Any:
        """Open the group; FileNotFoundError without one."""
        zarr = import_zarr()
        try:
            options = {"storage_options": self.options} if self.options else {}
            return zarr.open_group(self.store, mode=mode, zarr_format=3, **options)
        except ImportError as error:
            raise Error(f"store: '{self}' needs a package for its kind of storage: {error}") from error

    def existing(self, mode: str) -> Any:
        """Open the group, or return None if there is none."""
        zarr = import_zarr()
        try:
            return self.open(mode)
        except (FileNotFoundError, zarr.errors.GroupNotFoundError):
            return None

    def create(self) -> Any:
        """Create a new group. Existing contents are deleted."""
        return self.open("w")


def create(place: Place, layout: Layout, mesh: Mesh, report: Mapping[str, Any]) -> Any:
    """Create the group with its empty levels and the mesh. The attributes come last: they make the store valid."""
    zarr = import_zarr()
    group = place.create()
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
    vertices, faces, rows = mesh._core.state()
    parts = group.require_group("mesh")
    parts.create_array(name="vertices", data=np.asarray(vertices))
    parts.create_array(name="faces", data=np.asarray(faces))
    if rows is not None:
        parts.create_array(name="rows", data=np.asarray(rows))
    group.attrs.update(layouts.attributes(layout, place.name, report))
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


def read_mesh(group: Any) -> Mesh:
    """Read the mesh that a store was baked from. It has the bits of the original."""
    parts = group["mesh"]
    rows = np.asarray(parts["rows"][...]) if "rows" in parts else None
    vertices, faces = np.asarray(parts["vertices"][...]), np.asarray(parts["faces"][...])
    return restore(vertices, faces, rows)


def stored_keys(group: Any, level: int) -> set[str]:
    """Keys of the shards of a level that are stored, relative to the group. Remains of broken writes are deleted."""
    array = group[layouts.path_of(level)]
    prefix = group.store_path.path
    start = f"{prefix}/" if prefix else ""
    keys = set()
    for key in _listed(array.store_path.store, f"{array.store_path.path}/c/"):
        if key.endswith(".partial"):
            _sync(array.store_path.store.delete(key))
        else:
            keys.add(key.removeprefix(start))
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


def size_of(group: Any, key: str) -> int | None:
    """Bytes of a key of the store, relative to the group; None if it is missing."""
    prefix = group.store_path.path
    try:
        return int(_sync(group.store_path.store.getsize(f"{prefix}/{key}" if prefix else key)))
    except FileNotFoundError:
        return None
