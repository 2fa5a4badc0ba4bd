"""Options of pictures of scenes: their checks, and the call of the core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.progress import Progress, progress_callback
from ..merging.nested import NestedField
from ..scenes import field_cache
from ..scenes.camera import Camera
from ..scenes.core_scene import Fields
from ..scenes.instance import Instance
from ..scenes.lights import DirectionalLight, Light, SpotLight, cone_cosines, key_light
from ..scenes.materials import scattering_rgb
from ..scenes.scene import Scene
from ..volumes.volume import Volume
from .frame import Frame
from .options import checked_size

Primary = Literal["auto", "raster", "raymarch"]
SceneShadows = Literal["soft", "hard", "none", "area"]

#: Range of ambient occlusion for True, as a fraction of the diagonal of the scene.
OCCLUSION_SHARE = 0.15


@dataclass(frozen=True)
class Options:
    """The checked options of a picture; :func:`render` documents them."""

    size: tuple[int, int]
    primary: Primary
    #: Kind of shadows in the core: also "article".
    march: str
    #: Range of occlusion, world units. True for a fraction of the diagonal of the scene, False for none.
    occlusion: bool | float
    bounces: int
    bounce_samples: int
    samples: int
    light_scale: int
    exposure: float
    area_samples: int
    far: Volume | NestedField | None
    far_distance: float | None
    device: str
    progress: Progress

    @classmethod
    def checked(
        cls,
        *,
        size: tuple[int, int],
        primary: Primary,
        shadows: SceneShadows,
        ambient_occlusion: bool | float,
        bounces: int,
        bounce_samples: int,
        samples: int,
        light_scale: int,
        exposure: float,
        area_samples: int,
        far: Volume | NestedField | None,
        far_distance: float | None,
        method: Literal["fieldbake", "article"],
        device: str,
        progress: Progress,
    ) -> Options:
        """Check the options of a picture; raise SceneError for a wrong one."""
        size = checked_size(size)
        checks.text("device", device)
        checks.choice("primary", primary, get_args(Primary), SceneError)
        checks.choice("shadows", shadows, get_args(SceneShadows), SceneError)
        checks.choice("method", method, ("fieldbake", "article"), SceneError)
        try:
            if isinstance(ambient_occlusion, (bool, np.bool_)):
                ambient_occlusion = bool(ambient_occlusion)
            else:
                ambient_occlusion = checks.number("ambient_occlusion", ambient_occlusion, above=0)
            bounces = checks.integer("bounces", bounces, least=0, most=4)
            if bounces and ambient_occlusion is not False:
                raise ArgumentError("ambient_occlusion: bounces contain the occlusion already; leave it out")
            return cls(
                size,
                primary,
                "article" if method == "article" and shadows != "none" else shadows,
                ambient_occlusion,
                bounces,
                checks.integer("bounce_samples", bounce_samples, least=1, most=65536),
                checks.integer("samples", samples, least=1, most=64),
                checks.integer("light_scale", light_scale, least=1, most=2),
                checks.number("exposure", exposure, least=0),
                checks.integer("area_samples", area_samples, least=1, most=4096),
                far,
                _far_distance(far, far_distance, method),
                device,
                progress,
            )
        except ArgumentError as error:
            raise SceneError(str(error)) from None

    def fields_of(self, instances: Sequence[Instance]) -> Fields:
        """Decide which meshes of the instances need distance fields."""
        scatters = any(
            instance.material is not None and any(scattering_rgb(instance.material)) for instance in instances
        )
        is_marched = self.primary == "raymarch"
        return Fields(
            of_solids=self.march != "none" or bool(self.occlusion) or self.bounces > 0 or is_marched or scatters,
            of_sheets=is_marched or self.march == "article",
        )

    def draw(
        self,
        renderer: _core.Renderer,
        core: _core.Scene,
        scene: Scene,
        camera: Camera | None,
        lights: Sequence[Light] | None,
        bounds: NDArray[np.float64],
    ) -> Frame:
        """Draw the scene `core`, which has the objects of `scene` and these bounds.

        The camera None is the default camera of the scene, and the lights None are the default light of the camera.
        """
        width, height = self.size
        if camera is None:
            camera = scene.cameras[0] if scene.cameras else Camera.fit(bounds, aspect=width / height)
        if lights is None:
            lights = (key_light(camera.pose),)
        occlusion = None if self.occlusion is False else float(self.occlusion)
        if self.occlusion is True:
            occlusion = OCCLUSION_SHARE * float(np.linalg.norm(np.diff(bounds, axis=0)))
        with progress_callback(self.progress, "render") as callback:
            result = renderer.frame(
                core,
                camera.pose,
                fov_deg=camera.fov_deg,
                height=camera.height,
                size=self.size,
                lights=[_light_row(light) for light in lights],
                primary=self.primary,
                shadows=self.march,
                area_samples=self.area_samples,
                ambient=scene._ambient_form,
                occlusion=occlusion,
                bounces=self.bounces,
                bounce_samples=self.bounce_samples,
                far=[] if self.far is None else field_cache.levels_of(self.far),
                far_distance=self.far_distance,
                background=scene._background,
                exposure=self.exposure,
                samples=self.samples,
                light_scale=self.light_scale,
                device=self.device,
                progress=callback,
            )
        return _frame_of(result, scene, len(lights))


def as_scene(scene: Any) -> Scene:
    """Convert an object, or a list of objects and instances, to a scene."""
    return scene if isinstance(scene, Scene) else Scene(scene if isinstance(scene, list) else [scene])


def checked_camera(camera: Camera | None) -> Camera | None:
    """Check a camera; None passes."""
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    return camera


def _frame_of(result: dict[str, Any], scene: Scene, lights: int) -> Frame:
    """Make a frame from a result of the core: arrays become its arrays, and the other entries its report."""
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    seconds = result["seconds"]
    report = {
        "device": result["device"],
        "seconds": sum(seconds.values()),
        "devices": {"primary": result["primary_on"], "light": result["light_on"]},
        "milliseconds": {stage: 1e3 * duration for stage, duration in seconds.items()},
        "device_milliseconds": {stage: 1e3 * duration for stage, duration in result["device_seconds"].items()},
        "reused": result["reused"],
        "instances": len(scene.instances),
        "lights": lights,
        "sheets": result["sheets"],
        "rays": result["ray_count"],
        "far_rays": result["far_rays"],
    }
    return Frame(arrays, report)


def _far_distance(far: Volume | NestedField | None, distance: float | None, method: str) -> float | None:
    if far is None:
        if distance is not None:
            raise ArgumentError("far_distance: needs far, a field from merge()")
        return None
    if not isinstance(far, (Volume, NestedField)):
        raise ArgumentError(f"far: must be a Volume or NestedField from merge(), got {checks.describe(far)}")
    if method == "article":
        raise ArgumentError('far: the march of the article has no far field; leave it out, or use method="fieldbake"')
    return None if distance is None else checks.number("far_distance", distance, least=0)


def _light_row(light: Light) -> _core.DirectionalRow | _core.PointRow:
    """Convert a light to the row of the core."""
    red, green, blue = (channel * light.intensity for channel in light.color)
    if isinstance(light, DirectionalLight):
        slope = float(np.tan(np.radians(min(light.angle_deg, 170.0) / 2)))
        return {"direction": light.direction, "slope": slope, "color": (red, green, blue)}
    return {
        "position": light.position,
        "radius": light.radius,
        "color": (red, green, blue),
        "range": light.range,
        "spot": (light.direction, cone_cosines(light)) if isinstance(light, SpotLight) else None,
    }
