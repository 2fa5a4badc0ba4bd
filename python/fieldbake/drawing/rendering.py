"""Draw scenes: what the camera sees first, then light through the distance fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.progress import Progress, progress_callback
from ..merging.nested import NestedField
from ..scenes import field_cache
from ..scenes.camera import Camera
from ..scenes.lights import DirectionalLight, Light, key_light
from ..scenes.materials import scattering_rgb
from ..scenes.scene import Scene
from ..volumes.volume import Volume
from .frame import Frame
from .options import checked_size

Primary = Literal["auto", "raster", "raymarch"]
SceneShadows = Literal["soft", "hard", "none", "area"]

#: How far ambient occlusion looks if only True is given, as a share of the scene's diagonal.
OCCLUSION_SHARE = 0.15


def render(
    scene: Any,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    primary: Primary = "auto",
    shadows: SceneShadows = "soft",
    ambient_occlusion: bool | float = False,
    samples: int = 1,
    light_scale: int = 1,
    exposure: float = 1.0,
    area_samples: int = 64,
    far: Volume | NestedField | None = None,
    far_distance: float | None = None,
    method: Literal["fieldbake", "article"] = "fieldbake",
    device: str = "auto",
    progress: Progress = None,
) -> Frame:
    """Draw a scene: what the camera sees first, then light through the distance fields.

    Parameters
    ----------
    scene : Scene
        Or a thing, or a list of things and Instances.
    camera : Camera, optional
        The scene's first camera, or one that fits its box, if not given.
    size : (width, height), default (512, 512)
        In pixels.
    primary : "auto", "raster" or "raymarch", default "auto"
        How surfaces are found: triangles where there are some, triangles only, or fields only.
    shadows : "soft", "hard", "none" or "area", default "soft"
        ``"soft"``: penumbrae as wide as the lights' sizes make them, by cones. ``"hard"``: lights are points.
        ``"area"``: `area_samples` rays to each light, slow, the reference for soft.
    ambient_occlusion : bool or float, default False
        Darken what is shut in; a number says how far matter counts, world units (True: 0.15 of the scene's
        diagonal).
    samples : int, default 1
        Rays a pixel for its colour: 1, 4, 9, 16, ... for clean edges. Depth and the like are of the pixel's centre;
        light is that of the centres around, where those agree.
    light_scale : 1 or 2, default 1
        2: light is asked for at every second pixel of every second row, and at the others only where those around
        them are of other surfaces or disagree by more than 1/8. At 240 x 160 with soft shadows, 0.7 % of the pixels of
        200 trees and 0.2 % of a monkey over a floor then differ by more than 8/255.
    exposure : float, default 1
        Factor of the picture's light.
    area_samples : int, default 64
        Rays to each light for ``shadows="area"``.
    far : Volume or NestedField, optional
        A coarse field of the whole scene in world space, from :func:`merge`: it answers shadow and occlusion rays past
        `far_distance` in place of the opaque instances. What throws no shadow should not be merged into it; translucent
        instances and what lies outside its box are still asked themselves.
    far_distance : float, optional
        From where on it does, world units along the ray; if not given, 8 of the voxels that it has where the ray
        starts.
    method : "fieldbake" or "article", default "fieldbake"
        ``"article"``: shadows by the article's own march (100 steps, hit at 0.01, bias 0.05 world units, one loop over
        all instances), for comparison.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. Both passes run there; the picture is the CPU's
        to 1/255 but for half a percent of the pixels. Translucent surfaces are found on the CPU. A
        pass that cannot run there, because a thing is of a kind that the device does not know, runs on the CPU, and
        ``report["devices"]`` says so.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable gets a share from 0 to 1.

    Returns
    -------
    Frame
        Colour, depth, normals, object ids, shadows and steps as arrays. ``report`` has the device, the seconds in all,
        of each pass its device and its milliseconds, and the number of rays to lights and surroundings (``rays``,
        narrow and wide ones) and of those that went on in the far field (``far_rays``).

    Raises
    ------
    SceneError
        For a scene, camera, size or option that makes no sense.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    ``color = exposure * (ambient * open * albedo + sum of arrives * light * (max(0, n.l) * albedo + specular * max(0,
    n.h)^shininess + through * albedo))``, linear. ``through`` is light that comes through the object itself, see
    :class:`Material`. Lights do not fade with distance. Penumbrae follow S. Aaltonen, GPU-based clay
    simulation and ray-tracing tech in Claybook, GDC 2018, centred on the hard edge; the light's disc is shared by 16
    cones where one does not decide.

    A merged field keeps closed every wall of two of its voxels or more. Past `far_distance` the edges of shadows are
    off by up to about one of its voxels, and what is thinner may be lost; nearer to the surface nothing changes.

    Examples
    --------
    See :class:`Scene`.
    """
    if not isinstance(scene, Scene):
        scene = Scene(scene if isinstance(scene, list) else [scene])
    width, height = checked_size(size)
    checks.text("device", device)
    for name, value, words in (
        ("primary", primary, ("auto", "raster", "raymarch")),
        ("shadows", shadows, ("soft", "hard", "none", "area")),
        ("method", method, ("fieldbake", "article")),
    ):
        if value not in words:
            raise SceneError(f"{name}: must be one of {', '.join(words)}, got {value!r}")
    try:
        exposure = checks.number("exposure", exposure, least=0)
        samples = checks.integer("samples", samples, least=1, most=64)
        light_scale = checks.integer("light_scale", light_scale, least=1, most=2)
        area_samples = checks.integer("area_samples", area_samples, least=1, most=4096)
        occlusion = _occlusion(ambient_occlusion, scene)
        far_distance = _far_distance(far, far_distance, method)
    except ArgumentError as error:
        raise SceneError(str(error)) from None
    if camera is None:
        camera = scene.cameras[0] if scene.cameras else Camera.fit(scene.bounds, aspect=width / height)
    if not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    lights = scene.lights
    if lights is None:
        lights = (key_light(camera.pose),)

    scatters = any(
        instance.material is not None and any(scattering_rgb(instance.material)) for instance in scene.instances
    )
    with_fields = shadows != "none" or occlusion is not None or primary == "raymarch" or scatters
    core = scene._core(with_fields, device)
    with progress_callback(progress, "render") as callback:
        result = _core.render(
            core,
            camera.pose,
            fov_deg=camera.fov_deg,
            size=(width, height),
            lights=_light_table(lights),
            primary=primary,
            shadows="article" if method == "article" and shadows != "none" else shadows,
            area_samples=area_samples,
            ambient=scene.ambient,
            occlusion=occlusion,
            far=[] if far is None else field_cache.levels_of(far),
            far_distance=far_distance,
            background=scene._background,
            exposure=exposure,
            samples=samples,
            light_scale=light_scale,
            device=device,
            progress=callback,
        )
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    seconds = result["seconds"]
    report = {
        "device": result["device"],
        "seconds": sum(seconds.values()),
        "devices": {"primary": result["primary_on"], "light": result["light_on"]},
        "milliseconds": {stage: 1e3 * duration for stage, duration in seconds.items()},
        "instances": len(scene.instances),
        "lights": len(lights),
        "rays": result["rays"],
        "far_rays": result["far_rays"],
    }
    return Frame(arrays, report)


def _occlusion(wanted: bool | float, scene: Scene) -> float | None:
    if isinstance(wanted, (bool, np.bool_)):
        return OCCLUSION_SHARE * float(np.linalg.norm(np.diff(scene.bounds, axis=0))) if wanted else None
    return checks.number("ambient_occlusion", wanted, above=0)


def _far_distance(far: Volume | NestedField | None, distance: float | None, method: str) -> float | None:
    if far is None:
        if distance is not None:
            raise ArgumentError("far_distance: needs far, a field from merge()")
        return None
    if not isinstance(far, (Volume, NestedField)):
        raise ArgumentError(f"far: must be a Volume or NestedField from merge(), got {checks.describe(far)}")
    if method == "article":
        raise ArgumentError('far: the article\'s march knows no far field; leave it out, or use method="fieldbake"')
    return None if distance is None else checks.number("far_distance", distance, least=0)


def _light_table(lights: Sequence[Light]) -> NDArray[np.float64]:
    """Three rows a light, as the core takes them."""
    rows: list[Sequence[float]] = []
    for light in lights:
        if isinstance(light, DirectionalLight):
            rows += [(0.0, np.tan(np.radians(min(light.angle_deg, 170.0) / 2)), 0.0), light.direction]
        else:
            rows += [(1.0, 0.0, light.radius), light.position]
        rows.append(np.multiply(light.color, light.intensity).tolist())
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
