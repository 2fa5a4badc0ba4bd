"""Where a view is shown: a page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..base import checks
from ..base.errors import SceneError
from ..base.notices import warn
from ..drawing.options import checked_size
from ..files.container import atomic_write
from ..scenes.camera import Camera
from .content import Content, content_of
from .page import page_of

#: Encodings of the samples on a page.
ENCODINGS = ("snorm8", "float16", "float32")

#: Pages above this size, bytes, are slow to load and to save in a notebook.
LARGE_PAGE = 5_000_000


def checked_content(thing: Any, camera: Camera | None, encoding: str, size: tuple[int, int]) -> Content:
    """The content of a view, its options checked."""
    checks.choice("encoding", encoding, ENCODINGS)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    return content_of(thing, camera, encoding, checked_size(size))


def to_html(
    thing: Any, path: str | os.PathLike[str] | None, camera: Camera | None, encoding: str, size: tuple[int, int]
) -> str:
    """The page of an object; see :meth:`fieldbake.Volume.to_html`."""
    text = page_of(checked_content(thing, camera, encoding, size))
    if len(text) > LARGE_PAGE:
        advice = "a sparse or coarser volume" if encoding == "snorm8" else 'encoding="snorm8"'
        warn(
            f"the page has {len(text) / 1e6:.1f} MB, which browsers load slowly; {advice} makes it smaller", UserWarning
        )
    if path is not None:
        with atomic_write(Path(path)) as stream:
            stream.write(text.encode())
    return text
