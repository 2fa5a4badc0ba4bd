"""Pictures of scenes: the primary pass, then the light pass past triangles and through distance fields.

Each option of a picture is one row of :class:`Options`, from which the signatures of :func:`render` and
:class:`fieldbake.Renderer`, the options of the command line and the arguments of the core follow.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.former_names import former_names
from ..base.progress import Progress, progress_callback
from ..merging.merged import MergedField
from ..merging.nested import NestedField
from ..scenes import field_cache
from ..scenes.camera import Camera
from ..scenes.core_scene import Fields
from ..scenes.instance import Instance
from ..scenes.lights import Light, key_light, row_of
from ..scenes.materials import scattering_rgb
from ..scenes.scene import Scene
from ..volumes.volume import Volume, plain_field
from .frame import Frame
from .options import checked_size

if TYPE_CHECKING:
    from typing_extensions import Unpack

Primary = Literal["auto", "raster", "raymarch"]
Shadows = Literal["soft", "hard", "none", "area"]

#: Range of ambient occlusion for True, as a fraction of the diagonal of the scene.
OCCLUSION_SHARE = 0.15

#: The replacement of the former option `method`.
METHOD = "the page docs/articles/mesh_distance_field, which computes the march of the article"

_Function = TypeVar("_Function", bound=Callable[..., Any])


class RenderOptions(TypedDict, total=False):
    """The types of the options for type checkers."""

    size: tuple[int, int]
    primary: Primary
    shadows: Shadows
    ambient_occlusion: bool | float
    bounces: int
    bounce_samples: int
    denoise: bool
    samples: int
    light_scale: int
    exposure: float
    area_samples: int
    far: Volume | MergedField | NestedField | None
    far_distance: float | None
    device: str
    progress: Progress


PRIMARY_HELP = "auto: rasterise meshes, march fields; raster: draw meshes only; raymarch: draw fields only."
BOUNCES_HELP = "Diffuse reflections of light between surfaces, 0 to 4. Emissive surfaces then light others."
DEVICE_HELP = 'Compute device: "auto", "cpu", "gpu" or a name from `fieldbake devices`.'


def row(check: Callable[[str, Any], Any], help: str = "") -> dict[str, Any]:
    """Describe an option: its check, and its help on the command line, which has no option without help."""
    return {"check": check, "help": help}


def _one_of(words: Any) -> Callable[[str, Any], Any]:
    return lambda name, value: checks.choice(name, value, get_args(words))


def _integer(least: int, most: int) -> Callable[[str, Any], int]:
    return lambda name, value: checks.integer(name, value, least=least, most=most)


def _least_0(name: str, value: Any) -> float:
    return checks.number(name, value, least=0)


def _occlusion(name: str, value: Any) -> bool | float:
    return bool(value) if isinstance(value, (bool, np.bool_)) else checks.number(name, value, above=0)


def _size(_: str, value: Any) -> tuple[int, int]:
    return checked_size(value)


def _distance(name: str, value: Any) -> float | None:
    return None if value is None else _least_0(name, value)


def _far(name: str, value: Any) -> Any:
    value = plain_field(value)
    if value is not None and not isinstance(value, (Volume, NestedField)):
        raise ArgumentError(f"{name}: must be a Volume or NestedField from merge(), got {checks.describe(value)}")
    return value


@dataclass(frozen=True, kw_only=True)
class Options:
    """The checked options of a picture; :func:`render` documents them."""

    size: tuple[int, int] = field(default=(512, 512), metadata=row(_size, "Size of the picture, pixels."))
    primary: Primary = field(default="auto", metadata=row(_one_of(Primary), PRIMARY_HELP))
    shadows: Shadows = field(
        default="soft", metadata=row(_one_of(Shadows), "Kind of shadows; area is slow, and the reference for soft.")
    )
    ambient_occlusion: bool | float = field(default=False, metadata=row(_occlusion, "Add ambient occlusion."))
    bounces: int = field(default=0, metadata=row(_integer(0, 4), BOUNCES_HELP))
    bounce_samples: int = field(
        default=256, metadata=row(_integer(1, 65536), "Paths of light for each surface with --bounces.")
    )
    denoise: bool = field(default=True, metadata=row(checks.flag, "Remove the noise of sampled light."))
    samples: int = field(
        default=1, metadata=row(_integer(1, 64), "Colour samples per pixel for smooth edges: 1, 4, 9, 16, ...")
    )
    light_scale: int = field(
        default=1, metadata=row(_integer(1, 2), "2 evaluates light at a quarter of the pixels and upsamples it.")
    )
    exposure: float = field(default=1.0, metadata=row(_least_0, "Factor of all light in the picture."))
    area_samples: int = field(default=64, metadata=row(_integer(1, 4096), "Rays to each light with --shadows area."))
    far: Volume | NestedField | None = field(default=None, metadata=row(_far))
    far_distance: float | None = field(default=None, metadata=row(_distance))
    device: str = field(default="auto", metadata=row(checks.text, DEVICE_HELP))
    progress: Progress = field(default=None, metadata=row(lambda _, value: value))

    def __post_init__(self) -> None:
        try:
            for option in fields(self):
                value = option.metadata["check"](option.name, getattr(self, option.name))
                object.__setattr__(self, option.name, value)
            if self.bounces and self.ambient_occlusion is not False:
                raise ArgumentError("ambient_occlusion: bounces contain the occlusion already; leave it out")
            if self.far is None and self.far_distance is not None:
                raise ArgumentError("far_distance: needs far, a field from merge()")
        except ArgumentError as error:
            raise SceneError(str(error)) from None

    @classmethod
    def of(cls, owner: str, options: RenderOptions) -> Options:
        """Check the options of a call of the function `owner`; raise SceneError for a wrong one."""
        known = [option.name for option in fields(cls)]
        for name in options:
            if name not in known:
                raise SceneError(f"{name}: is no option of {owner}(); its options are {', '.join(known)}")
        values: dict[str, Any] = {**options}
        return cls(**values)

    def fields_of(self, instances: Sequence[Instance]) -> Fields:
        """Decide which meshes of the instances need distance fields."""
        scatters = any(
            instance.material is not None and any(scattering_rgb(instance.material)) for instance in instances
        )
        is_marched = self.primary == "raymarch"
        return Fields(
            of_solids=self.shadows == "soft" or is_marched or scatters,
            of_sheets=is_marched,
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
        options = {option.name: getattr(self, option.name) for option in fields(self)}
        device, progress = options.pop("device"), options.pop("progress")
        options["far"] = [] if self.far is None else field_cache.levels_of(self.far)
        occlusion = OCCLUSION_SHARE * float(np.linalg.norm(np.diff(bounds, axis=0)))
        if self.ambient_occlusion is not True:
            occlusion = float(self.ambient_occlusion)
        options["ambient_occlusion"] = occlusion or None
        with progress_callback(progress, "render") as callback:
            result = renderer.frame(
                core,
                camera.pose,
                fov_deg=camera.fov_deg,
                height=camera.height,
                lights=[row_of(light) for light in lights],
                ambient=scene._ambient_form,
                background=scene._background,
                options=options,
                device=device,
                progress=callback,
            )
        return _frame_of(result, scene, len(lights))


def takes_options(function: _Function) -> _Function:
    """Write the options of a picture into the signature of a function that takes them as ``**options``."""
    signature = inspect.signature(function)
    own = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
    added = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default, annotation=option.type)
        for option in fields(Options)
    ]
    function.__signature__ = signature.replace(parameters=own + added)  # type: ignore[attr-defined]
    notes = {one.name: one.annotation for one in own + added if one.annotation is not inspect.Parameter.empty}
    function.__annotations__ = {**notes, "return": signature.return_annotation}
    return function


@former_names(method=METHOD)
@takes_options
def render(scene: Any, camera: Camera | None = None, **options: Unpack[RenderOptions]) -> Frame:
    """Draw a scene: find the visible surfaces, then light them past triangles and through distance fields.

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
        ``"soft"`` estimates penumbrae in proportion to the sizes of the lights, by cone tracing; a light without a size
        has hard shadows. ``"hard"`` treats all lights as points. ``"area"`` casts `area_samples` rays to each light; it
        is slow, and the reference for ``"soft"``.
    ambient_occlusion : bool or float, default False
        Whether nearby surfaces darken ambient light, by 128 rays over the hemisphere. A number is the largest
        distance of such surfaces, world units. True uses 0.15 of the diagonal of the scene. Occlusion is evaluated at
        every eighth pixel of every eighth row, of at least 24 along the shorter side, and interpolated in between, on
        lattices of 4, 2 and 1 pixels. Pixels are evaluated too if another surface is visible near them, if their
        neighbours lie on another surface, or if the neighbours differ by more than interpolation can follow: at most
        1/2 at every second pixel, 1/8 at every eighth.
    bounces : int from 0 to 4, default 0
        Largest number of diffuse reflections on the way of the light to the visible surface. 0 draws the light of the
        lights alone, with ambient light that arrives everywhere. 1 and more trace paths from each surface to the
        triangles of meshes and the surfaces of all other objects. The paths collect the reflected light of the lights,
        the emission of surfaces, so that emissive materials are area lights, and the ambient light where it is not
        blocked. They replace `ambient_occlusion` and do not use `far`. Paths are evaluated on the CPU for pictures of
        every device.
    bounce_samples : int, default 256
        Number of paths for each visible surface with `bounces`, of which each pixel has a part with `denoise`. The time
        is proportional to the number.
    denoise : bool, default True
        Whether the noise of the paths of `bounces` is removed by a filter over the picture, whose width grows until the
        light changes by more than its noise. Pixels then share their paths, so each has a part of them: 9/32 in a
        picture of 128 pixels along its shorter side, 9/64 for 256, an eighth from 288. False leaves the mean of all its
        own paths at each pixel, which takes several times longer.
    samples : int, default 1
        Colour samples per pixel, a square number up to 64: 1, 4, 9, 16, ... Higher values smooth edges. A pixel has
        one sample where the displayed colours of neighbouring pixels change evenly, to 1/32, on one object without an
        edge, for the mean over such a pixel is the colour at its centre (adaptive sampling: D. P. Mitchell, Generating
        antialiased images at low sampling densities, SIGGRAPH 1987). Depth, normals and ids are taken at the pixel
        centre. Lighting is interpolated from neighbouring centres where they agree, and evaluated elsewhere.
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
        Colour, depth, normals, object ids, shadows, steps and rays as arrays. ``report`` has ``device``, the total
        ``seconds``, ``devices`` of the passes, ``milliseconds`` of the stages (``"primary"``, ``"light"``,
        ``"bounces"`` where there are any and, for a graphics device, ``"upload"``), ``device_milliseconds``, the time
        of the kernels on a device with timestamps (``"primary"``; ``"beams"``, ``"rays"``, ``"cones"``, ``"parts"`` and
        ``"edges"`` of the light; ``"thicknesses"`` of objects that scatter light; empty for more than 2,048 passes),
        ``reused``, the stages whose results are reused from the last frame of a :class:`Renderer`, ``sheets``, the
        number of instances whose triangles are traced for cones of light too, and two counters: ``rays``, the number of
        shadow, occlusion, scattering and bounce rays and cones, and ``far_rays``, the number of those that entered the
        far field.

    Raises
    ------
    SceneError
        For an unusable scene, camera or size, or an option out of range.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    ``color = exposure * (ambient * open * albedo + sum of arrives * light * (max(0, n.l) * albedo + specular * max(0,
    n.h)^shininess + through * albedo))``, in linear RGB. ``ambient`` is the ambient light of the scene around the
    normal, ``open`` the fraction of the hemisphere that occluders leave open, and ``arrives`` the visible fraction of a
    light. ``n``, ``l`` and ``h`` are unit vectors: the normal, the direction to the light and the half vector.
    ``through`` is the light that passes through the object itself, see :class:`Material`. ``light`` is colour times
    intensity, and for a :class:`PointLight` or :class:`SpotLight` also the falloff with distance and the share of the
    cone, which ``frame.shadow`` does not contain. Penumbrae follow S. Aaltonen, GPU-based clay simulation and
    ray-tracing tech in Claybook, GDC 2018, and are centred on the hard edge. Where one cone gives no clear result, 16
    cones divide the disc of the light.

    With `bounces`, ``ambient * open`` is the mean of the light that arrives along `bounce_samples` cosine-weighted
    directions. A path continues at the first instance that casts shadows and whose opacity is at least 1/2. It collects
    emission there, and the light of the lights as with ``shadows="hard"``. Each vertex of a path also has one direction
    to an emitter: to a point on an emissive face of a mesh, or into the box of another emissive object. The power
    heuristic combines both techniques. Surfaces of an opacity below 1/2 and instances without shadows light nothing.
    Paths ignore highlights and scattering. Surroundings given as an image are smoothed as described for :class:`Scene`.
    In a closed room, 256 paths differ from a path tracer by 2 % in the mean.

    Hard and ``"area"`` shadows, occlusion and `bounces` trace the triangles of meshes, on the CPU for pictures of every
    device. Soft shadows evaluate distance fields, except for open sheets, for flat and thin meshes and for meshes
    with a mask or a translucent texture: they trace their triangles, with the opacity of the material at each hit. Each
    crossing of a blended surface absorbs a fraction of the light equal to its opacity. Rays past the triangles of a
    mesh with smooth normals start on the smooth surface above its faces (J. Hanika, Hacking the shadow terminator, Ray
    Tracing Gems II, 2021).

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
    scene = as_scene(scene)
    checked = Options.of("render", options)
    core = scene._core(checked.fields_of(scene.instances), checked.device)
    return checked.draw(scene._renderer, core, scene, checked_camera(camera), scene.lights, scene.bounds)


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
