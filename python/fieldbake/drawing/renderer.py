"""Frames of one scene: data that does not change between them is prepared once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base import checks
from ..base.errors import SceneError
from ..base.former_names import former_names
from ..scenes.camera import Camera
from ..scenes.instance import Instance
from ..scenes.lights import Light, check_lights
from ..scenes.materials import Material
from ..scenes.scene import Scene
from .frame import Frame
from .rendering import METHOD, Options, RenderOptions, as_scene, checked_camera, takes_options

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Renderer:
    """A scene prepared for many frames.

    Fields are baked when the renderer is made. Meshes, fields, textures and compiled kernels stay in the memory of the
    device as long as the renderer exists. A frame uploads only what differs from the frame before, and the rays to
    lights that the CPU makes: those from fields and translucent surfaces, those through objects that scatter light, and
    all of them with `ambient_occlusion`, ``shadows="area"``, ``light_scale=2`` or a camera with parallel rays. The CPU
    also makes the colours, and the indirect light of `bounces`.

    Parameters
    ----------
    scene : Scene
        The scene. An object that :class:`Instance` accepts, or a list of objects and instances, is converted to one.
    size, primary, shadows, ambient_occlusion, bounces, bounce_samples, denoise, samples
        As for :func:`render`.
    light_scale, exposure, area_samples, far, far_distance, device
        As for :func:`render`.
    progress : bool or callable, optional
        As for :func:`render`, for each frame.

    Raises
    ------
    SceneError
        For an unusable scene or size, or an option out of range.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    A frame is the picture that :func:`render` draws of the scene with the same camera, lights, transforms and
    materials: bit for bit on the CPU.

    A frame reuses the visible surfaces of the frame before if the camera, the transforms and the materials are the
    same. If the lights have the same places and sizes too, it reuses their shadows and the occlusion:
    other colours and intensities of the lights cost little. ``report["reused"]`` lists these stages. For this the
    renderer keeps 100 bytes of host memory for each visible surface of the last frame, and 16 for each light but the
    first. It keeps nothing of a frame that would need more than 256 MiB.

    Examples
    --------
    >>> import fieldbake as fb
    >>> renderer = fb.Renderer(fb.models.gear(teeth=6), size=(48, 32), device="cpu")
    >>> frames = list(renderer.frames(fb.Camera((4 * x, 2, 4), (0, 0, 0)) for x in (-1, 0, 1)))
    >>> len(frames), frames[0].image.shape
    (3, (32, 48, 4))
    """

    @former_names(method=METHOD)
    @takes_options
    def __init__(self, scene: Any, **options: Unpack[RenderOptions]) -> None:
        self._scene = as_scene(scene)
        self._options = Options.of("Renderer", options)
        device = self._options.device
        self._renderer = _core.Renderer(device, keeps_pictures=True)
        instances = self._scene.instances
        self._core = self._scene._core(self._options.fields_of(instances), device)
        # The core has one instance for each quadric of a list.
        self._rows = np.array([len(i.geometry) if isinstance(i.geometry, tuple) else 1 for i in instances])
        # The materials of the last frame that replaced any, and the scene of the core with them.
        self._varied: tuple[tuple[Material | None, ...], _core.Scene] | None = None
        # The last scene of the core that was moved, its transforms, and the moved scene.
        self._moved: tuple[_core.Scene, NDArray[np.float64], _core.Scene] | None = None

    @property
    def scene(self) -> Scene:
        """The scene that the renderer was made with."""
        return self._scene

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames, pixels."""
        return self._options.size

    @property
    def counters(self) -> dict[str, int]:
        """Transfers to and from the device since the renderer was made; all are 0 on the CPU.

        ``uploads`` is the number of writes to device memory, ``upload_bytes`` their size, ``submits`` the number of
        submissions of commands, and ``readbacks`` the number of results that were copied to host memory.
        """
        return self._renderer.counters

    def frame(
        self,
        camera: Camera | None = None,
        lights: Sequence[Light] | None = None,
        transforms: ArrayLike | Sequence[ArrayLike | None] | None = None,
        materials: Sequence[Material | None] | None = None,
    ) -> Frame:
        """Draw one frame. The arguments apply to this frame only; None selects the property of the scene.

        Parameters
        ----------
        camera : Camera, optional
            The view. The default is the first camera of the scene, or else a camera that fits the bounds of the
            instances in this frame.
        lights : sequence of PointLight, SpotLight and DirectionalLight, optional
            At most 16 lights in place of the lights of the scene.
        transforms : (n, 4, 4), optional
            World from the object's own coordinates, one matrix for each instance of the scene. In a list, None is the
            instance's own transform.
        materials : sequence of Material, length n, optional
            The material of each instance. None is the instance's own material.

        Returns
        -------
        Frame
            As from :func:`render`. Its arrays are new; later frames do not change them.

        Raises
        ------
        SceneError
            For a wrong type, number of items or matrix; the message names the argument.
        """
        camera = checked_camera(camera)
        lights = self._scene.lights if lights is None else check_lights(lights)
        matrices = None if transforms is None else self._matrices(transforms)
        core = self._core if materials is None else self._with_materials(materials)
        bounds = self._scene.bounds
        if matrices is not None and not np.array_equal(matrices, self._scene._transforms):
            core = self._moved_to(core, matrices)
            bounds = self._scene._bounds_at(matrices)
        return self._options.draw(self._renderer, core, self._scene, camera, lights, bounds)

    def frames(self, cameras: Iterable[Camera]) -> Iterator[Frame]:
        """Draw a frame for each camera. Each frame is drawn when the iterator is advanced.

        Parameters
        ----------
        cameras : iterable of Camera
            The views: a list, or a generator of any length.

        Returns
        -------
        iterator of Frame
            The frames in order.

        Raises
        ------
        SceneError
            If `cameras` is not iterable; and, when its frame is drawn, for an item that is not a Camera.
        """
        return self._frames(checks.items("cameras", cameras, "Camera", SceneError))

    def _frames(self, cameras: Iterator[Camera]) -> Iterator[Frame]:
        for number, camera in enumerate(cameras):
            if not isinstance(camera, Camera):
                raise SceneError(f"cameras[{number}]: must be a Camera, got {checks.describe(camera)}")
            yield self.frame(camera)

    def _matrices(self, transforms: Any) -> NDArray[np.float64]:
        """Check transforms, (n, 4, 4)."""
        instances = self._scene.instances
        if isinstance(transforms, (list, tuple)):
            self._check_count("transforms", transforms)
            transforms = [
                own.transform if matrix is None else checks.matrix(f"transforms[{i}]", matrix, (4, 4), SceneError)
                for i, (own, matrix) in enumerate(zip(instances, transforms, strict=True))
            ]
        return checks.affine_list("transforms", transforms, len(instances), SceneError)

    def _moved_to(self, core: _core.Scene, matrices: NDArray[np.float64]) -> _core.Scene:
        """The scene of the core with other transforms."""
        last = self._moved
        if last is None or last[0] is not core or not np.array_equal(last[1], matrices):
            last = core, matrices, core.moved(np.repeat(matrices, self._rows, axis=0))
            self._moved = last
        return last[2]

    def _with_materials(self, materials: Any) -> _core.Scene:
        """The scene of the core with other materials."""
        if isinstance(materials, (str, bytes)) or not isinstance(materials, Sequence):
            raise SceneError(f"materials: must be a list of Material, got {checks.describe(materials)}")
        self._check_count("materials", materials)
        for number, material in enumerate(materials):
            if material is not None and not isinstance(material, Material):
                raise SceneError(f"materials[{number}]: must be a Material, got {checks.describe(material)}")
        if all(material is None for material in materials):
            return self._core
        last = self._varied
        if last is None or any(a is not b for a, b in zip(last[0], materials, strict=True)):
            instances = [
                _with_material(instance, material)
                for instance, material in zip(self._scene.instances, materials, strict=True)
            ]
            fields = self._options.fields_of(instances)
            last = tuple(materials), self._scene._core_of(instances, fields, self._options.device)
            # The moved scene may be one with the former materials.
            self._varied, self._moved = last, None
        return last[1]

    def _check_count(self, name: str, items: Sequence[object]) -> None:
        count = len(self._scene.instances)
        if len(items) != count:
            raise SceneError(f"{name}: must have {count} items, one for each instance of the scene, got {len(items)}")

    def __repr__(self) -> str:
        width, height = self.size
        return f"Renderer({self._scene!r}, {width} x {height} pixels, device={self._options.device!r})"


def _with_material(instance: Instance, material: Material | None) -> Instance:
    return instance if material is None else replace(instance, material=material)
