"""Pictures of scenes: the primary pass, then the light pass through the distance fields."""

from __future__ import annotations

from collections.abc import Sequence
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
from ..scenes.lights import DirectionalLight, Light, key_light
from ..scenes.materials import scattering_rgb
from ..scenes.scene import Scene
from ..volumes.volume import Volume
from .frame import Frame
from .options import checked_size

Primary = Literal["auto", "raster", "raymarch"]
SceneShadows = Literal["soft", "hard", "none", "area"]

#: Range of ambient occlusion for True, as a fraction of the diagonal of the scene.
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
    """Draw a scene: find the visible surfaces, then light them through the distance fields.

    Parameters
    ----------
    scene : Scene
        The scene. An object that :class:`Instance` accepts, or a list of objects and instances, is converted to one.
    camera : Camera, optional
        The view. The default is the first camera of the scene, or else a camera that fits the bounds of the scene.
    size : (width, height), default (512, 512)
        Size of the picture, pixels.
    primary : "auto", "raster" or "raymarch", default "auto"
        Search for visible surfaces. ``"auto"`` rasterises meshes and traces rays through other objects; ``"raster"``
        draws meshes only; ``"raymarch"`` draws fields only.
    shadows : "soft", "hard", "none" or "area", default "soft"
        ``"soft"`` estimates penumbrae in proportion to the sizes of the lights, by cone tracing. ``"hard"`` treats
        lights as points. ``"area"`` casts `area_samples` rays to each light; it is slow, and the reference for
        ``"soft"``.
    ambient_occlusion : bool or float, default False
        Whether nearby surfaces darken ambient light, by seven cones over the hemisphere. A number is the largest
        distance of such surfaces, world units. True uses 0.15 of the diagonal of the scene.
    samples : int, default 1
        Colour samples per pixel, a square number up to 64: 1, 4, 9, 16, ... Higher values smooth edges. Depth,
        normals and ids are taken at the pixel centre. Lighting is interpolated from neighbouring centres where they
        agree, and evaluated elsewhere.
    light_scale : 1 or 2, default 1
        2 evaluates lighting at a quarter of the pixels and upsamples it (joint bilateral upsampling). Pixels whose
        neighbours lie on another surface, or differ by more than 1/8, are evaluated exactly.
    exposure : float, default 1
        Factor of all light in the picture.
    area_samples : int, default 64
        Number of rays to each light for ``shadows="area"``.
    far : Volume or NestedField, optional
        A coarse field of the whole scene in world space, from :func:`merge`. Past `far_distance`, shadow and occlusion
        rays evaluate it instead of the opaque instances. Merge occluders only: every merged object casts a shadow.
        Translucent instances, and instances outside its box, are evaluated themselves.
    far_distance : float, optional
        Distance along the ray from which `far` is used, world units. The default is 8 voxels of `far` at the start
        of the ray.
    method : "fieldbake" or "article", default "fieldbake"
        ``"article"`` computes shadows by the march of the article *Mesh Distance Field + Shadow* for comparison:
        100 steps, hits at 0.01 and a bias of 0.05 world units, one loop over all instances.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`. Both passes run on the
        device. At most 0.5 % of the pixels differ from the CPU's picture by more than 1/255. Translucent surfaces are
        found on the CPU. A pass with an object that the device cannot draw runs on the CPU; ``report["devices"]``
        names the device of each pass.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1. By default a bar appears on a
        terminal once the work has taken 3 seconds. False never draws one.

    Returns
    -------
    Frame
        Colour, depth, normals, object ids, shadows and steps as arrays. ``report`` has ``device``, the total
        ``seconds``, ``devices`` and ``milliseconds`` of the passes, ``sheets``, the number of instances whose triangles
        are traced for light (by the CPU, for pictures of every device), and two counters: ``rays``, the number of
        shadow, occlusion and scattering rays and cones, and ``far_rays``, the number of those that entered the far
        field.

    Raises
    ------
    SceneError
        For an unusable scene, camera or size, or an option out of range.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    ``color = exposure * (ambient * open * albedo + sum of arrives * light * (max(0, n.l) * albedo + specular * max(0,
    n.h)^shininess + through * albedo))``, in linear RGB. ``through`` is the light that passes through the object
    itself, see :class:`Material`. Lights have no falloff with distance. Penumbrae follow S. Aaltonen, GPU-based clay
    simulation and ray-tracing tech in Claybook, GDC 2018, and are centred on the hard edge. Where one cone does not
    decide, 16 cones divide the disc of the light.

    Shadows and occlusion of open sheets, of flat meshes and of meshes with a mask or a translucent texture are those of
    their triangles, with the opacity of the material at each hit; such meshes need no field. Each crossing of a blended
    surface absorbs a fraction of the light equal to its opacity.

    A merged field keeps walls of at least two of its voxels closed. Past `far_distance` the edges of shadows deviate
    by up to about one of its voxels, and thinner objects may cast no shadow. Nearer occluders are unaffected.

    Examples
    --------
    >>> import fieldbake as fb
    >>> floor = fb.box((4, 0.2, 4)).translate((0, -1.2, 0))
    >>> scene = fb.Scene([fb.Instance(fb.sphere()), fb.Instance(floor)], lights=[fb.PointLight((2, 4, 2), radius=0.5)])
    >>> frame = fb.render(scene, size=(64, 64), shadows="soft")
    >>> frame.shadow.shape, sorted(set(frame.object_id.ravel().tolist()))
    ((64, 64), [-1, 0, 1])
    """
    if not isinstance(scene, Scene):
        scene = Scene(scene if isinstance(scene, list) else [scene])
    width, height = checked_size(size)
    checks.text("device", device)
    checks.choice("primary", primary, get_args(Primary), SceneError)
    checks.choice("shadows", shadows, get_args(SceneShadows), SceneError)
    checks.choice("method", method, ("fieldbake", "article"), SceneError)
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
    lights = (key_light(camera.pose),) if scene.lights is None else scene.lights
    march = "article" if method == "article" and shadows != "none" else shadows
    core = scene._core(_fields_of(scene, primary, march, has_occlusion=occlusion is not None), device)
    with progress_callback(progress, "render") as callback:
        result = _core.render(
            core,
            camera.pose,
            fov_deg=camera.fov_deg,
            size=(width, height),
            lights=_light_table(lights),
            primary=primary,
            shadows=march,
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
    return _frame_of(result, scene, len(lights))


def _fields_of(scene: Scene, primary: Primary, shadows: str, *, has_occlusion: bool) -> Fields:
    """Decide which meshes of a scene need distance fields; `shadows` may be "article"."""
    scatters = any(
        instance.material is not None and any(scattering_rgb(instance.material)) for instance in scene.instances
    )
    is_marched = primary == "raymarch"
    return Fields(
        of_solids=shadows != "none" or has_occlusion or is_marched or scatters,
        of_sheets=is_marched or shadows == "article",
    )


def _frame_of(result: dict[str, Any], scene: Scene, lights: int) -> Frame:
    """Make a frame of the arrays in a result of the core; the other entries become its report."""
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    seconds = result["seconds"]
    report = {
        "device": result["device"],
        "seconds": sum(seconds.values()),
        "devices": {"primary": result["primary_on"], "light": result["light_on"]},
        "milliseconds": {stage: 1e3 * duration for stage, duration in seconds.items()},
        "instances": len(scene.instances),
        "lights": lights,
        "sheets": result["sheets"],
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
        raise ArgumentError('far: the march of the article has no far field; leave it out, or use method="fieldbake"')
    return None if distance is None else checks.number("far_distance", distance, least=0)


def _light_table(lights: Sequence[Light]) -> NDArray[np.float64]:
    """Convert lights to the table of the core, three rows of three for each light."""
    rows: list[Sequence[float]] = []
    for light in lights:
        if isinstance(light, DirectionalLight):
            rows += [(0.0, np.tan(np.radians(min(light.angle_deg, 170.0) / 2)), 0.0), light.direction]
        else:
            rows += [(1.0, 0.0, light.radius), light.position]
        rows.append(np.multiply(light.color, light.intensity).tolist())
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
