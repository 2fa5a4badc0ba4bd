"""The views of an object: a picture, a page, and a widget of a notebook."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Mapping
from typing import Any

from .encodings import PageEncoding

#: The functions ``picture``, ``to_html`` and ``show``, which the package `viewing` registers when it is imported.
_FUNCTIONS: dict[str, Callable[..., Any]] = {}


def register(**functions: Callable[..., Any]) -> None:
    """Register functions of live views, whose first argument is the object."""
    _FUNCTIONS.update(functions)


def _view(name: str) -> Callable[..., Any]:
    """The registered function `name`. The first use of a view imports the package that registers them."""
    if not _FUNCTIONS:
        importlib.import_module("fieldbake.viewing.hosts")
    return _FUNCTIONS[name]


class Pictured:
    """Base class of objects that notebooks show as a picture."""

    __slots__ = ()

    def _repr_png_(self) -> bytes | None:
        """Draw the object for notebooks, as PNG; None if there is no surface."""
        found: bytes | None = _view("picture")(self)
        return found


class Viewable(Pictured):
    """Base class of objects that have a live view."""

    __slots__ = ()

    def to_html(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        camera: Any = None,
        encoding: PageEncoding = "snorm8",
        size: tuple[int, int] = (640, 480),
        parameters: Mapping[str, tuple[float, float]] | None = None,
        model: Callable[..., Any] | None = None,
    ) -> str:
        """Write a live view as one HTML page, which needs no network and no server.

        The page draws the surface by WebGL 2 or WebGPU, as :func:`fieldbake.raymarch` does: with the same roots,
        lights, background and camera. The view can be turned, moved and zoomed, the field sliced along any axis, and
        another level set drawn. A double click reports a point with its normal and distance.

        Parameters
        ----------
        path : str or path, optional
            The file to write. The text is returned in any case.
        camera : fieldbake.Camera, optional
            The first view, a perspective camera. The default is the same as in :func:`fieldbake.raymarch`: it fits the
            surface. A scene has its own first camera; if its objects cover less than half of the picture, the view has
            the direction of that camera and fits them.
        encoding : "snorm8", "float16" or "float32", default "snorm8"
            How samples are stored on the page, as :meth:`Volume.quantize` does: 1, 2 or 4 bytes each before
            compression. Quantised volumes stay as they are; quadrics, and shapes of at most 64 nodes, have no samples.
        size : (width, height), default (640, 480)
            Size of the canvas, CSS pixels.
        parameters : mapping from names to (least, largest), optional
            Parameters of a shape, as for :meth:`show`. A parameter gets a slider if the structure of the shape stays in
            its range and the numbers of the shape are linear in it: sizes, places, widths of joints and colours mostly
            are. This is checked at five values, and at joint values of all sliders, to 1e-6 of the shape's size. The
            line below the picture names the other parameters, which would need Python.
        model : callable, optional
            A function of the parameters that returns the shape; the page shows the shape at the middle of the ranges.

        Returns
        -------
        str
            The text of the page.

        Raises
        ------
        SceneError
            For an unusable camera or size, or an object without a view.
        ArgumentError
            For an unknown encoding, or parameters that the shape does not have.
        OSError
            If the file cannot be written.

        Warns
        -----
        UserWarning
            If the page has more than 5 MB, with the option that makes it smaller.

        Notes
        -----
        A mesh is drawn by its field of 128 voxels along the longest side, as :func:`fieldbake.raymarch` draws it, and a
        mesh in a Scene by the field of its instance. A shape with more than 64 nodes, or with a baked volume in it, is
        drawn by a volume of 192 voxels along the longest side. The title on the page states the field that is drawn in
        place of the object, and the line below the picture states that a mesh is open or has textures. Shadows are
        hard, colours come from materials and paint; only :func:`fieldbake.render` has textures, opacity and scattering.
        Where the browser has no WebGL 2, or forbids scripts, the page shows a picture.
        """
        text: str = _view("to_html")(self, path, camera, encoding, size, parameters, model)
        return text

    def show(self, **options: Any) -> Any:
        """Show a live view in a notebook.

        Parameters
        ----------
        **options
            ``camera``, ``encoding`` and ``size`` as for :meth:`to_html`. ``parameters`` is a mapping from names to
            (least, largest): each parameter gets a slider, and moving it rebuilds the object. For a shape, use the
            names of its parameters, such as ``"radius"`` or ``"cylinder.radius"``. With ``model``, a function that
            returns an object, use the names of its arguments.

        Returns
        -------
        widget
            An anywidget with the traits ``camera``, ``level``, ``slice``, ``light`` and ``picked``, which follow the
            view and change it. Without the package anywidget, an object that shows the page of :meth:`to_html`.

        Raises
        ------
        SceneError, ArgumentError
            As for :meth:`to_html`.
        """
        return _view("show")(self, **options)
