"""Where a view is shown: a page, or the output of a notebook's cell."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from ..atlases.atlas import Atlas
from ..base import checks
from ..base.encodings import PAGE_NAMES
from ..base.errors import ArgumentError, SceneError
from ..base.notices import warn
from ..base.viewable import register
from ..drawing.options import checked_size
from ..drawing.raymarching import PICTURE_SAMPLES, raymarch
from ..drawing.rendering import render
from ..files.container import atomic_write
from ..merging.nested import NestedField
from ..meshes.mesh import Mesh
from ..scenes.camera import Camera
from ..scenes.scene import Scene
from ..shapes.shape import Shape
from ..volumes.volume import Volume, plain_field
from .content import Content, content_of
from .html import page_of
from .output import PageOutput
from .parameters import model_of
from .sliders import add_sliders

#: Size of the picture of an object in a notebook, pixels.
PICTURE_SIZE = (256, 256)

#: Pages above this size, bytes, are slow to load and to save in a notebook.
LARGE_PAGE = 5_000_000


def checked_content(geometry: Any, camera: Camera | None, encoding: str, size: tuple[int, int]) -> Content:
    """The content of a view, its options checked."""
    checks.choice("encoding", encoding, PAGE_NAMES)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    return content_of(geometry, camera, encoding, checked_size(size))


def picture(geometry: Any) -> bytes | None:
    """The picture of an object for notebooks, PNG; None for a field without a surface."""
    if isinstance(geometry, (Mesh, Scene)):
        # Triangles need no field, and shadows would.
        scene = geometry if isinstance(geometry, Scene) else Scene([geometry])
        return render(scene, size=PICTURE_SIZE, shadows="none", samples=PICTURE_SAMPLES, device="cpu")._repr_png_()
    geometry = plain_field(geometry)
    levels = (
        geometry.levels if isinstance(geometry, NestedField) else [geometry] if isinstance(geometry, Volume) else None
    )
    if levels and not any(level.distances.min() <= 0 <= level.distances.max() for level in levels):
        return None
    if isinstance(geometry, NestedField):
        return raymarch(geometry, size=PICTURE_SIZE, samples=PICTURE_SAMPLES, device="cpu")._repr_png_()
    if isinstance(geometry, Atlas) and not len(geometry):
        return None
    return content_of(geometry, None, "float32", PICTURE_SIZE).frame(max(PICTURE_SIZE))._repr_png_()


def to_html(
    geometry: Any,
    path: str | os.PathLike[str] | None,
    camera: Camera | None,
    encoding: str,
    size: tuple[int, int],
    parameters: Mapping[str, tuple[float, float]] | None,
    model: Callable[..., Any] | None,
) -> str:
    """The page of an object; see :meth:`fieldbake.Volume.to_html`."""
    target = None if path is None else checks.path(path)
    found = _parametric(geometry, parameters, model)
    if found is None:
        content = checked_content(geometry, camera, encoding, size)
    else:
        model, ranges, values = found
        content = checked_content(model(**values), camera, encoding, size)
        add_sliders(content, model, ranges, values)
        if camera is None:
            # The first view fits the shape at all values.
            content.camera = Camera.fit(content.bounds, aspect=content.size[0] / content.size[1])
    text = page_of(content)
    if len(text) > LARGE_PAGE:
        advice = "a sparse or coarser volume" if encoding == "snorm8" else 'encoding="snorm8"'
        warn(
            f"the page has {len(text) / 1e6:.1f} MB, which browsers load slowly; {advice} makes it smaller", UserWarning
        )
    if target is not None:
        with atomic_write(target) as stream:
            stream.write(text.encode())
    return text


def show(
    geometry: Any,
    *,
    camera: Camera | None = None,
    encoding: str = "snorm8",
    size: tuple[int, int] = (640, 480),
    parameters: Mapping[str, tuple[float, float]] | None = None,
    model: Callable[..., Any] | None = None,
) -> Any:
    """The widget of an object, or its page where anywidget is missing; see :meth:`fieldbake.Volume.show`."""
    found = _parametric(geometry, parameters, model)
    content = checked_content(geometry, camera, encoding, size)
    try:
        from .widget import ViewWidget
    except ImportError:
        return PageOutput(content)
    if found is None:
        return ViewWidget(content)
    make, ranges, values = found

    def remake(values: Mapping[str, float]) -> Content:
        return checked_content(make(**values), camera or content.camera, encoding, size)

    return ViewWidget(remake(values), remake, ranges, values)


def _parametric(
    geometry: Any, parameters: Mapping[str, tuple[float, float]] | None, model: Callable[..., Any] | None
) -> tuple[Callable[..., Any], dict[str, tuple[float, float]], dict[str, float]] | None:
    """The function of the parameters, their ranges and their first values; None without parameters."""
    if model is not None and parameters is None:
        raise ArgumentError("model: needs parameters=, the least and largest value of each of its parameters")
    ranges = {name: _range(name, value) for name, value in (parameters or {}).items()}
    if not ranges:
        return None
    if model is not None:
        return model, ranges, {name: 0.5 * (least + largest) for name, (least, largest) in ranges.items()}
    if not isinstance(geometry, Shape):
        raise ArgumentError(f"parameters: {checks.describe(geometry)} needs model=, a function of the parameters")
    made, own = model_of(geometry, list(ranges))
    return made, ranges, {name: min(max(own[name], least), largest) for name, (least, largest) in ranges.items()}


def _range(name: str, value: Any) -> tuple[float, float]:
    try:
        least, largest = value
        least, largest = checks.number(name, least), checks.number(name, largest)
    except (TypeError, ValueError):
        raise ArgumentError(f"parameters[{name!r}]: must be (least, largest), got {value!r}") from None
    if not least < largest:
        raise ArgumentError(f"parameters[{name!r}]: the largest must be above the least, got {value!r}")
    return least, largest


register(picture=picture, to_html=to_html, show=show)
