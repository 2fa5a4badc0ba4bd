"""A view as a widget of a notebook, by anywidget. Importing this module needs the extra "notebook"."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import anywidget
import numpy as np
import traitlets

from ..base.errors import ArgumentError
from ..scenes.camera import Camera
from .content import Content, check_perspective
from .html import bundle, page_of
from .output import STATIC, frame_html

#: Longest side of the picture in the output of a cell, pixels.
PICTURE_PX = 640

#: Axes of a slice.
AXES = ("x", "y", "z")


class Picked(NamedTuple):
    """The point under a double click.

    Attributes
    ----------
    point, normal : (3,)
        World units; the normal has length 1.
    distance : float
        The value of the field at the point, world units: the level on the surface, the distance on a slice.
    depth : float
        Distance from the camera along the viewing axis, world units.
    object : int
        Index of the instance; -1 for a slice.
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    distance: float
    depth: float
    object: int


def _camera_to_json(camera: Camera | None, _: Any) -> dict[str, Any] | None:
    if camera is None:
        return None
    distance = float(np.linalg.norm(camera.pose[:3, 3] - camera._target))
    return {"pose": camera.pose.ravel().tolist(), "fov": camera.fov_deg, "distance": distance}


def _camera_from_json(state: dict[str, Any] | None, _: Any) -> Camera | None:
    if not state:
        return None
    pose = np.array(state["pose"], dtype=np.float64).reshape(4, 4)
    eye, up, back = pose[:3, 3], pose[:3, 1], pose[:3, 2]
    return Camera(eye, eye - state["distance"] * back, up, state["fov"])


def _slice_to_json(place: tuple[str, float] | None, _: Any) -> dict[str, Any] | None:
    return None if place is None else {"axis": place[0], "at": place[1]}


def _slice_from_json(state: dict[str, Any] | None, _: Any) -> tuple[str, float] | None:
    return None if not state else (state["axis"], float(state["at"]))


def _picked_from_json(state: dict[str, Any] | None, _: Any) -> Picked | None:
    if not state:
        return None
    x, y, z = state["point"]
    nx, ny, nz = state["normal"]
    return Picked((x, y, z), (nx, ny, nz), state["distance"], state["depth"], int(state["object"]))


class ViewWidget(anywidget.AnyWidget):
    """A live view in a notebook. Its traits follow the view, and setting one changes the view.

    Attributes
    ----------
    camera : Camera
        The pinhole camera of the view.
    level : float
        Level of the drawn surface, world units; 0 is the surface itself.
    slice : tuple of str and float, or None
        Axis and place of the slice plane, such as ``("x", 0.5)``, world units.
    light : (3,) or None
        The way the light travels, in camera space; None for the lights of :func:`fieldbake.raymarch`.
    picked : Picked or None
        The point of the last double click.
    parameters : dict
        Parameters of the model, where the view was made with some.
    """

    _esm = bundle()
    data = traitlets.Bytes().tag(sync=True)
    camera = traitlets.Instance(Camera, allow_none=True).tag(
        sync=True, to_json=_camera_to_json, from_json=_camera_from_json
    )
    level = traitlets.Float(0.0).tag(sync=True)
    slice = traitlets.Tuple(traitlets.Enum(AXES), traitlets.CFloat(), allow_none=True, default_value=None).tag(
        sync=True, to_json=_slice_to_json, from_json=_slice_from_json
    )
    light = traitlets.List(traitlets.CFloat(), allow_none=True, default_value=None).tag(sync=True)
    picked = traitlets.Instance(Picked, allow_none=True).tag(
        sync=True, to_json=lambda picked, _: None if picked is None else picked._asdict(), from_json=_picked_from_json
    )
    parameters = traitlets.Dict().tag(sync=True)
    _ranges = traitlets.Dict().tag(sync=True)

    def __init__(
        self,
        content: Content,
        remake: Callable[[Mapping[str, float]], Content] | None = None,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        values: Mapping[str, float] | None = None,
    ) -> None:
        self._content = content
        self._remake = remake
        super().__init__(
            data=content.packed(), camera=content.camera, parameters=dict(values or {}), _ranges=dict(ranges or {})
        )

    def on_pick(self, callback: Callable[[Picked], object]) -> None:
        """Call a function with every point that is picked by a double click."""
        self.observe(lambda change: callback(change["new"]) if change["new"] is not None else None, "picked")

    @traitlets.validate("camera")
    def _check_camera(self, proposal: Any) -> Any:
        return None if proposal["value"] is None else check_perspective(proposal["value"])

    @traitlets.validate("light")
    def _check_light(self, proposal: Any) -> Any:
        light = proposal["value"]
        if light is not None and (len(light) != 3 or not math.hypot(*light) > 0):
            raise ArgumentError(f"light: must be three numbers, not all 0, got {light}")
        return light

    @traitlets.observe("parameters")
    def _on_parameters(self, change: Any) -> None:
        if self._remake is not None and change["old"] is not traitlets.Undefined and change["new"] != change["old"]:
            self._content = self._remake(change["new"])
            self.data = self._content.packed()

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        """The widget, a page in a frame, and a picture: every host shows one of them."""
        made: Any = super()._repr_mimebundle_(**kwargs)
        data, metadata = made if isinstance(made, tuple) else (made or {}, {})
        still = {"text/html": frame_html(page_of(self._content), self._content.size), "image/png": self._picture()}
        return {**data, **still}, metadata

    def _ipython_display_(self) -> None:
        """Display the widget, and beside it what static pages of the notebook show in its place."""
        from IPython.display import publish_display_data

        publish: Callable[..., object] = publish_display_data
        publish(*self._repr_mimebundle_())
        publish({"text/html": STATIC.format(model=self.model_id, picture=self._picture())})

    def _picture(self) -> str:
        """The picture of the first view, PNG in base64."""
        return base64.b64encode(self._content.frame(PICTURE_PX)._repr_png_()).decode()
