"""Scenes: things in places, lights, and the picture of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..atlases.atlas import AtlasEntry
from ..base import checks
from ..base.errors import ArgumentError, MeshError, SceneError
from ..base.progress import Progress, progress_callback
from ..drawing.frame import Frame
from ..merging.nested import NestedField
from ..meshes.convert import as_mesh
from ..meshes.mesh import Mesh
from ..shapes.quadric import Quadric, bounds_of, check_quadrics, is_quadrics
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume
from . import field_cache
from .camera import Camera
from .core_scene import build_scene
from .lights import DirectionalLight, Light, PointLight
from .materials import Material, scattering_rgb

#: What stands in scenes: meshes are rastered, the others drawn by rays.
Thing = Mesh | Volume | SparseVolume | NestedField | AtlasEntry | Shape | tuple[Quadric, ...]

Primary = Literal["auto", "raster", "raymarch"]
SceneShadows = Literal["soft", "hard", "none", "area"]

#: Lights of a scene at most.
MAX_LIGHTS = 16

#: Voxels along the longest side of a mesh instance's field.
INSTANCE_RESOLUTION = 64

#: The usual light: over the right shoulder of who looks. Camera space.
KEY_LIGHT = np.array([-0.45, -0.7, -0.55])

#: How far ambient occlusion looks if only True is given, as a share of the scene's diagonal.
OCCLUSION_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Instance:
    """A thing in a place.

    Parameters
    ----------
    thing : Mesh, Volume, SparseVolume, NestedField, ``atlas[i]``, Shape, Quadric, list of Quadric, or any mesh
        A mesh is rastered and throws the shadow of its field, which is baked when needed and kept. All others are met
        by rays as they are: a volume by the roots of its cells, a shape by those of its parts (``fb.bake(shape)``
        makes a volume of it), a quadric by its closed form. Quadrics of a list are one object.
    transform : (4, 4), optional
        World from the thing's own coordinates: any affine map that can be undone. If not given the identity, or the
        model matrix of an atlas entry.
    material : Material, optional
        If not given, or without a colour, the thing's own: a mesh's colours and textures, a shape's paint, a quadric's
        reflectance; light grey for what has none.
    casts_shadow : bool, default True
        Whether light meets it.
    visible : bool, default True
        Whether the camera sees it.
    opacity : float, default 1
        Share of light that it keeps, for the camera and for shadows. A quadric's own opacity is for shadows alone, and
        multiplies.
    resolution : int, default 64
        Voxels along the longest side of a mesh's field.

    Raises
    ------
    SceneError
        For a transform that cannot be undone or a value out of range.
    ShapeError
        For a shape without bounds; it names the leaf.
    MeshError
        If there is no usable mesh in the thing.

    Examples
    --------
    >>> import fieldbake as fb
    >>> move = np.eye(4)
    >>> move[:3, 3] = 0, 1, 0
    >>> fb.Instance(fb.models.gear(teeth=6), transform=move).bounds.round(3).tolist()
    [[-0.995, 0.005, -0.175], [0.995, 1.995, 0.175]]
    """

    thing: Any
    transform: ArrayLike | None = None
    material: Material | None = None
    casts_shadow: bool = True
    visible: bool = True
    opacity: float = 1.0
    resolution: int = INSTANCE_RESOLUTION

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        usual = self.thing.transform if isinstance(self.thing, AtlasEntry) else np.eye(4)
        matrix = usual if self.transform is None else checks.affine("transform", self.transform, SceneError)
        put("transform", checks.frozen(matrix))
        if self.material is not None and not isinstance(self.material, Material):
            raise SceneError(f"material: must be a Material, got {checks.describe(self.material)}")
        try:
            put("casts_shadow", checks.flag("casts_shadow", self.casts_shadow))
            put("visible", checks.flag("visible", self.visible))
            put("opacity", checks.number("opacity", self.opacity, least=0))
        except ArgumentError as error:
            raise SceneError(str(error)) from None
        if self.opacity > 1:
            raise SceneError(f"opacity: must be from 0 to 1, got {self.opacity:g}")
        put("resolution", checks.integer("resolution", self.resolution, least=4, most=1024, error=SceneError))
        put("thing", _thing(self.thing))

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around the surface, (2, 3), world units."""
        box = _box_of(self.thing)
        corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
        matrix = np.asarray(self.transform)
        placed = corners @ matrix[:3, :3].T + matrix[:3, 3]
        return np.stack([placed.min(axis=0), placed.max(axis=0)])

    def __repr__(self) -> str:
        return f"Instance({self.thing!r})"


class Scene:
    """Instances and lights. Immutable.

    Parameters
    ----------
    instances : sequence of Instance
        Anything else in it becomes an instance of its own, in its place.
    lights : sequence of PointLight and DirectionalLight, optional
        At most 16. If not given, one white light over the right shoulder of who looks.
    ambient : float, default 0.2
        Light from everywhere, as a share of the colour.
    background : (3,) or (4,), default opaque white
        Where nothing is hit, linear RGB and opacity.
    cameras : sequence of Camera, optional
        Views that come with the scene; :func:`render` takes the first if it is given none.

    Raises
    ------
    SceneError
        For an empty scene, a light that is none, or too many.

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
        ambient: float = 0.2,
        background: ArrayLike = (1.0, 1.0, 1.0, 1.0),
        cameras: Sequence[Camera] = (),
    ) -> None:
        if isinstance(instances, (str, bytes)) or not isinstance(instances, Sequence):
            raise SceneError(f"instances: must be a list of Instance, got {checks.describe(instances)}")
        if not instances:
            raise SceneError("instances: the scene is empty; give at least one Instance")
        self._instances = tuple(_instance(number, item) for number, item in enumerate(instances))
        self._lights = None if lights is None else check_lights(lights)
        try:
            self._ambient = checks.number("ambient", ambient, least=0)
        except ArgumentError as error:
            raise SceneError(str(error)) from None
        self._background = _background(background)
        for camera in cameras:
            if not isinstance(camera, Camera):
                raise SceneError(f"cameras: must hold Cameras, got {checks.describe(camera)}")
        self._cameras = tuple(cameras)
        # The core's scene, with and without fields.
        self._cores: dict[bool, _core.Scene] = {}

    @property
    def instances(self) -> tuple[Instance, ...]:
        """What stands in it; an instance's place here is its `Frame.object_id`."""
        return self._instances

    @property
    def lights(self) -> tuple[Light, ...] | None:
        """The lights; None: one that comes with the camera."""
        return self._lights

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Views that come with the scene."""
        return self._cameras

    @property
    def ambient(self) -> float:
        """Light from everywhere, as a share of the colour."""
        return self._ambient

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Box around everything, (2, 3), world units."""
        boxes = np.stack([instance.bounds for instance in self._instances])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def _core(self, with_fields: bool, device: str) -> _core.Scene:
        """The scene as the core has it; fields are baked here."""
        if with_fields not in self._cores:
            self._cores[with_fields] = build_scene(self._instances, with_fields, device)
        return self._cores[with_fields]

    def __repr__(self) -> str:
        lights = "a light at the camera" if self._lights is None else f"{len(self._lights)} lights"
        return f"Scene({len(self._instances)} instances, {lights})"


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
    n.h)^shininess))``, linear; lights do not fade with distance. Penumbrae follow S. Aaltonen, GPU-based clay
    simulation and ray-tracing tech in Claybook, GDC 2018, centred on the hard edge; the light's disc is shared by 16
    cones where one does not decide.

    A merged field keeps closed every wall of two of its voxels or more. Past `far_distance` the edges of shadows are
    off by up to about one of its voxels, and what is thinner may be lost; nearer to the surface nothing changes.

    Examples
    --------
    See :class:`Scene`.
    """
    from ..drawing.raymarching import _size

    if not isinstance(scene, Scene):
        scene = Scene(scene if isinstance(scene, list) else [scene])
    width, height = _size(size)
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
        lights = (DirectionalLight(checks.triple(camera.pose[:3, :3] @ KEY_LIGHT)),)

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
            far=[] if far is None else far._far() if isinstance(far, NestedField) else [field_cache.of_thing(far)],
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


def check_lights(lights: Sequence[Light]) -> tuple[Light, ...]:
    """A list of lights, or SceneError."""
    if isinstance(lights, (PointLight, DirectionalLight)) or not isinstance(lights, Sequence):
        raise SceneError(f"lights: must be a list of lights, got {checks.describe(lights)}")
    if len(lights) > MAX_LIGHTS:
        raise SceneError(f"lights: at most {MAX_LIGHTS}, got {len(lights)}")
    for number, light in enumerate(lights):
        if not isinstance(light, (PointLight, DirectionalLight)):
            raise SceneError(
                f"lights[{number}]: must be a PointLight or DirectionalLight, got {checks.describe(light)}"
            )
    return tuple(lights)


def _instance(number: int, item: Any) -> Instance:
    if isinstance(item, Instance):
        return item
    try:
        return Instance(item)
    except (SceneError, MeshError) as error:
        raise SceneError(f"instances[{number}]: {error}") from error


def _thing(thing: Any) -> Thing:
    """What the core can draw."""
    if isinstance(thing, Shape):
        # One without bounds is refused, by name.
        _ = thing.bounds
        return thing
    if isinstance(thing, (Mesh, Volume, SparseVolume, NestedField, AtlasEntry)):
        return thing
    return tuple(check_quadrics(thing)) if is_quadrics(thing) else as_mesh(thing)


def _box_of(thing: Thing) -> NDArray[np.float64]:
    """Box around the surface, (2, 3), the thing's own coordinates."""
    if isinstance(thing, tuple):
        return bounds_of(thing)
    return thing.bounds if isinstance(thing, (Mesh, Shape)) else thing.inner_bounds


def _background(value: ArrayLike) -> tuple[float, float, float, float]:
    length = 3 if np.shape(value) == (3,) else 4
    color = checks.vector("background", value, length, SceneError)
    if color.min() < 0:
        raise SceneError(f"background: must not be negative, got {color.tolist()}")
    r, g, b, a = (*color.tolist(), 1.0)[:4]
    return r, g, b, a


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
