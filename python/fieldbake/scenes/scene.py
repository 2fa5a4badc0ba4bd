"""Scenes: instances, lights and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import MeshError, SceneError
from ..base.progress import Progress
from ..base.report import count_text
from ..base.viewable import Viewable
from ..queries.nearest import Query
from .camera import Camera
from .core_scene import Fields, SceneBuilder
from .instance import Instance, box_of, placed_bounds
from .lights import AMBIENT, BACKGROUND, Light, check_lights
from .queries import SceneGeometry
from .surroundings import Ambient, checked_ambient, form_of


class Scene(Viewable):
    """Instances, lights and cameras. Immutable.

    Parameters
    ----------
    instances : sequence of Instance
        Instances in order. Any other object in the sequence becomes an instance with default options.
    lights : sequence of PointLight, SpotLight and DirectionalLight, optional
        At most 16 lights. The default is one white light of intensity 0.64 from above, over the viewer's right
        shoulder.
    ambient : float, (3,) or (height, width, 3), default 0.2
        Light from everywhere, as a fraction of the colour: a number, a colour, or an image of the surroundings, linear
        RGB. The top edge of the image is the direction +Y, the bottom edge -Y. The middle of the picture is the
        direction -Z, and a quarter of its width to the right is +X. Two rows, such as
        ``[[[1, 1, 1]], [[0.2, 0.2, 0.2]]]``, are a sky and a ground. Surfaces reflect the light of all directions
        around their normal, smoothed by spherical harmonics of degree 2: the error is at most 6.2 % of the range of the
        image. Occlusion reduces it as a whole.
    background : (3,) or (4,), default (0.025, 0.03, 0.04)
        Colour of pixels without a hit, linear RGB and opacity. The default is a dark slate, against which the outlines
        of both white and black objects are visible.
    cameras : sequence of Camera, optional
        Views of the scene. :func:`render` uses the first one by default.

    Raises
    ------
    SceneError
        For an empty scene, an object that is not a light, or too many lights.

    Examples
    --------
    >>> import fieldbake as fb
    >>> knot = fb.models.torus_knot(segments=96, sides=12)
    >>> floor = ([(-3, -2, -3), (3, -2, -3), (3, -2, 3), (-3, -2, 3)], [(0, 2, 1), (0, 3, 2)])
    >>> scene = fb.Scene([fb.Instance(knot, material=fb.Material(color=(0.9, 0.5, 0.1))), fb.Instance(floor)],
    ...                  lights=[fb.DirectionalLight((-1, -2, -1), angle_deg=4)])
    >>> frame = fb.render(scene, fb.Camera((4, 3, 6), (0, -0.5, 0)), size=(48, 32), device="cpu")
    >>> frame.color.shape, sorted(set(frame.object_id.ravel().tolist()))
    ((32, 48, 4), [-1, 0, 1])
    """

    def __init__(
        self,
        instances: Sequence[Any],
        lights: Sequence[Light] | None = None,
        *,
        ambient: ArrayLike = AMBIENT,
        background: ArrayLike = BACKGROUND,
        cameras: Sequence[Camera] = (),
    ) -> None:
        if isinstance(instances, (str, bytes)) or not isinstance(instances, Sequence):
            raise SceneError(f"instances: must be a list of Instance, got {checks.describe(instances)}")
        if not instances:
            raise SceneError("instances: the scene is empty; give at least one Instance")
        self._instances = tuple(_instance(number, item) for number, item in enumerate(instances))
        self._lights = None if lights is None else check_lights(lights)
        self._ambient = checked_ambient(ambient)
        self._ambient_form = form_of(self._ambient)
        self._background = _background(background)
        for camera in cameras:
            if not isinstance(camera, Camera):
                raise SceneError(f"cameras: must hold Cameras, got {checks.describe(camera)}")
        self._cameras = tuple(cameras)
        # Scenes of the core, by the fields that they contain, and the objects that they share.
        self._cores: dict[Fields, _core.Scene] = {}
        self._builder = SceneBuilder()
        #: The search trees of queries, made by the first one.
        self._geometry: SceneGeometry | None = None
        #: Draws single pictures of the scene, and keeps it on the device that drew the last one.
        self._renderer = _core.Renderer()

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Instances of the scene; the index of an instance is its `Frame.object_id`."""
        return self._instances

    @property
    def lights(self) -> tuple[Light, ...] | None:
        """Lights of the scene; None for the default light, which depends on the camera."""
        return self._lights

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Views of the scene."""
        return self._cameras

    @property
    def ambient(self) -> Ambient:
        """Light from everywhere, as a fraction of the colour: a number, or an image (height, width, 3), read-only."""
        return self._ambient

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around all instances, (2, 3), world units."""
        return self._bounds_at(self._transforms)

    @cached_property
    def _transforms(self) -> NDArray[np.float64]:
        """Transforms of the instances, (n, 4, 4)."""
        return np.stack([np.asarray(instance.transform) for instance in self._instances])

    @cached_property
    def _boxes(self) -> NDArray[np.float64]:
        """Boxes of the instances in their own coordinates, (n, 2, 3)."""
        return np.stack([box_of(instance.geometry) for instance in self._instances])

    def _bounds_at(self, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
        """Box around all instances, (2, 3), world units, under other transforms, (n, 4, 4)."""
        return placed_bounds(self._boxes, transforms)

    def _query(self, points: ArrayLike, *, sign: str, device: str, progress: Progress) -> Query:
        """Evaluate :func:`fieldbake.query` of the instances."""
        if self._geometry is None:
            self._geometry = SceneGeometry(self._instances)
        return self._geometry.query(points, sign, device, progress)

    def _core_of(self, instances: Sequence[Instance], fields: Fields, device: str) -> _core.Scene:
        """Make the scene of the core for other instances of the same objects."""
        return self._builder.build(instances, fields, device)

    def _core(self, fields: Fields, device: str) -> _core.Scene:
        """Make the scene of the core, baking fields where needed."""
        if fields not in self._cores:
            self._cores[fields] = self._builder.build(self._instances, fields, device)
        return self._cores[fields]

    def __reduce__(self) -> tuple[Any, ...]:
        # The copy makes the objects of the core again when it is drawn.
        return _copy, (self._instances, self._lights, self._ambient, self._background, self._cameras)

    def __repr__(self) -> str:
        lights = "the default light" if self._lights is None else count_text(len(self._lights), "light")
        return f"Scene({count_text(len(self._instances), 'instance')}, {lights})"


def _copy(
    instances: Sequence[Instance],
    lights: Sequence[Light] | None,
    ambient: Ambient,
    background: ArrayLike,
    cameras: Sequence[Camera],
) -> Scene:
    return Scene(instances, lights, ambient=ambient, background=background, cameras=cameras)


def _instance(number: int, item: Any) -> Instance:
    if isinstance(item, Instance):
        return item
    try:
        return Instance(item)
    except (SceneError, MeshError) as error:
        raise SceneError(f"instances[{number}]: {error}") from error


def _background(value: ArrayLike) -> tuple[float, float, float, float]:
    length = 3 if np.shape(value) == (3,) else 4
    color = checks.vector("background", value, length, SceneError)
    if color.min() < 0:
        raise SceneError(f"background: must not be negative, got {color.tolist()}")
    r, g, b, a = (*color.tolist(), 1.0)[:4]
    return r, g, b, a
