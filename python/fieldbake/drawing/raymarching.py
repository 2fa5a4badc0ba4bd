"""Pictures of volumes, nested fields, shapes and quadrics by ray marching and closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..atlases.atlas import AtlasEntry
from ..baking.dense import bake
from ..base import checks
from ..base.errors import ArgumentError, SceneError, ShapeError
from ..base.former_names import former_names
from ..base.progress import Progress, progress_callback
from ..merging.nested import NestedField
from ..scaling.stores.zarr_volume import ZarrVolume
from ..scenes.camera import Camera
from ..scenes.core_scene import SceneBuilder
from ..scenes.instance import Instance
from ..scenes.lights import (
    AMBIENT,
    BACKGROUND,
    DirectionalLight,
    Light,
    PointLight,
    SpotLight,
    check_lights,
    key_light,
    row_of,
)
from ..scenes.materials import PLAIN, SHININESS, SPECULAR, Material
from ..scenes.scene import Scene
from ..shapes.quadric import Quadric, bounds_of, check_quadrics, is_quadrics
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume, plain_field
from .frame import Frame
from .options import checked_color, checked_size, frame_of
from .rendering import Options, Shadows, render

Filter = Literal["linear", "nearest"]
Method = Literal["auto", "whole", "aabb", "octree"]

#: Voxels along the longest side of a mesh that is baked for a picture.
PICTURE_RESOLUTION = 128

#: Colour samples per pixel of pictures in notebooks, pages and the demonstration.
PICTURE_SAMPLES = 4


@former_names(thing="geometry")
def raymarch(
    geometry: Any,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    shadows: Shadows = "soft",
    samples: int = 1,
    filter: Filter = "linear",
    lights: Sequence[Light] | None = None,
    ambient: float | None = None,
    color: ArrayLike | None = None,
    specular: float | None = None,
    shininess: float | None = None,
    background: ArrayLike | None = None,
    method: Method = "auto",
    device: str = "auto",
    progress: Progress = None,
) -> Frame:
    """Draw the zero level set of a field, or all fields of a scene, by marching rays.

    Parameters
    ----------
    geometry : Volume, SparseVolume, ZarrVolume, NestedField, ``atlas[i]``, Shape, Scene, Quadric, list of Quadric, mesh
        A Scene has its own lights and materials; :func:`render` draws it with ``primary="raymarch"``. Quadrics are
        drawn in closed form, each in its own reflectance, and `object_id` is the index in the list. Meshes are baked
        first, with 128 voxels along the longest side. A ZarrVolume is drawn from the level whose voxels are about as
        large as a pixel. An entry of an atlas is drawn at its model matrix, as in scenes.
    camera : Camera, optional
        The view. The default fits the surface: ``Camera.fit(volume.inner_bounds)``.
    size : (width, height), default (512, 512)
        Size of the picture, pixels.
    shadows : "soft", "hard", "none" or "area", default "soft"
        Kind of shadows that the surface casts on itself, as for :func:`render`. A light without a size, such as the
        default light, has hard shadows.
    samples : int, default 1
        Colour samples per pixel, a square number up to 64, as for :func:`render`. Higher values smooth edges.
    filter : "linear" or "nearest", default "linear"
        Interpolation between samples: trilinear or none.
        ``"nearest"`` draws the voxels whose samples are not positive, as cubes or boxes, on the CPU.
    lights : sequence of DirectionalLight, PointLight and SpotLight, optional
        At most 16 lights. If not given, one white light of intensity 0.64 from above, over the viewer's right shoulder.
    ambient : float, optional
        Ambient light as a fraction of the colour; the default is 0.2.
    color : (3,), optional
        Colour of the surface, linear RGB. The default is light grey; shapes keep their paint.
    specular, shininess : float, optional
        Strength and sharpness of the highlight (Blinn-Phong); 0.25 and 32 if not given.
    background : (3,) or (4,), optional
        Colour of pixels without a hit, linear RGB and opacity. The default is (0.025, 0.03, 0.04), a dark slate.
    method : "auto", "whole", "aabb" or "octree", default "auto"
        For shapes only: rays are traced through the whole shape or through the parts of
        :func:`fieldbake.csg.decompose`. ``"auto"`` chooses the method with the lowest estimated cost per ray. All
        methods give the same picture. Pictures with more than one sample per pixel, point lights, spot lights or
        penumbrae are drawn as scenes. They require ``"auto"``.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable receives the finished fraction from 0 to 1.

    Returns
    -------
    Frame
        Colour, depth, normals, object ids, shadow and steps as arrays.

    Raises
    ------
    SceneError
        For an unusable camera, light, size or number of samples.
    ShapeError
        For an unknown method of a shape, or a shape that cannot be drawn.
    ArgumentError
        For any other option that is out of range or not applicable to the object.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    A hit is a root of the trilinear field, not a point within some epsilon: in each voxel the field along the ray is
    a cubic polynomial. Surfaces outside the box of the volume are invisible and cast no shadow.

    A ray hits a shape where its depth inside exceeds 1e-6 of the frame. The frame is the least power of two that is not
    below the longest side of the shape. A wall thinner than 2e-6 of the frame is not hit, and no film remains between
    coincident faces. Sphere tracing, in some parts and with ``method="whole"``, may miss an interval inside that is
    shorter than 3e-5 of the frame.

    The CPU reads quantised and sparse volumes in their stored form. A graphics device draws a field as a scene of one
    instance, and stores its samples as float32.

    With ``filter="nearest"`` the value at a point is the sample of the voxel that contains it, as in
    ``volume.sample(points, filter="nearest")``. The solid is then a union of voxels, so this picture is both the
    picture of a point filter and a view of the voxels. It has hard shadows or none, and the CPU draws it.

    References
    ----------
    H. Hansson-Soderlund, A. Evans, T. Akenine-Moller, Ray tracing of signed distance function grids, JCGT 11(3), 2022.

    Examples
    --------
    >>> import fieldbake as fb
    >>> frame = fb.raymarch(fb.bake(fb.models.torus_knot(), 32), size=(64, 64))
    >>> frame.image.shape
    (64, 64, 4)
    >>> float(frame.depth[0, 0])  # the corner of the picture shows the background
    inf
    """
    checks.text("method", method)
    if isinstance(geometry, Shape):
        checks.choice("method", method, get_args(Method), ShapeError)
    elif method != "auto":
        raise ArgumentError(f"method: {method!r} applies to shapes only, got a {type(geometry).__name__}; leave it out")
    if isinstance(geometry, Scene):
        own = {"lights": lights, "ambient": ambient, "color": color, "specular": specular, "shininess": shininess}
        for name, value in {**own, "background": background}.items():
            if value is not None:
                raise SceneError(f"{name}: does not apply to a Scene; set it in the Scene or in a Material")
        if checks.choice("filter", filter, get_args(Filter)) != "linear":
            raise SceneError('filter: scenes are drawn with "linear" only')
        return render(
            geometry,
            camera,
            size=size,
            primary="raymarch",
            shadows=shadows,
            samples=samples,
            device=device,
            progress=progress,
        )
    geometry = plain_field(geometry)
    checked = checked_size(size)
    checks.choice("shadows", shadows, get_args(Shadows))
    checks.choice("filter", filter, get_args(Filter))
    checks.text("device", device)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    options = _Options(
        camera=camera,
        size=checked,
        shadows=shadows,
        samples=checks.integer("samples", samples, least=1, most=64, error=SceneError),
        filter=filter,
        lights=None if lights is None else check_lights(lights),
        ambient=checks.number("ambient", AMBIENT if ambient is None else ambient, least=0),
        specular=checks.number("specular", SPECULAR if specular is None else specular, least=0),
        shininess=checks.number("shininess", SHININESS if shininess is None else shininess, above=0),
        color=None if color is None else checks.triple(checked_color("color", color, 3)),
        background=checked_color("background", BACKGROUND if background is None else background, 4),
        device=device,
        progress=progress,
    )
    if is_quadrics(geometry):
        return _draw_quadrics(check_quadrics(geometry), options)
    if isinstance(geometry, Shape):
        return _draw_shape(geometry, method, options)
    if isinstance(geometry, NestedField):
        return _draw_nested(geometry, options)
    if isinstance(geometry, ZarrVolume):
        return _draw_zarr(geometry, options)
    if isinstance(geometry, AtlasEntry):
        return _draw_entry(geometry, options)
    if not isinstance(geometry, (Volume, SparseVolume)):
        geometry = bake(geometry, PICTURE_RESOLUTION, device=device, progress=progress)
    return _draw_volume(geometry, options)


@dataclass(frozen=True)
class _Options:
    """The checked options of one picture."""

    camera: Camera | None
    size: tuple[int, int]
    shadows: Shadows
    samples: int
    filter: Filter
    lights: Sequence[Light] | None
    ambient: float
    specular: float
    shininess: float
    color: tuple[float, float, float] | None
    background: NDArray[np.float64]
    device: str
    progress: Progress

    @property
    def needs_scene(self) -> bool:
        """Whether only scenes are drawn with these samples, shadows and lights."""
        lights = self.lights or ()
        if self.samples > 1 or any(isinstance(light, (PointLight, SpotLight)) for light in lights):
            return True
        has_size = any(isinstance(light, DirectionalLight) and light.angle_deg > 0 for light in lights)
        return self.shadows in ("soft", "area") and has_size

    def view_of(self, bounds: NDArray[np.float64]) -> Camera:
        """The camera, or the default camera for a box."""
        return self.camera or Camera.fit(bounds, aspect=self.size[0] / self.size[1])

    def arguments(self, camera: Camera) -> dict[str, Any]:
        """Arguments of the picture for the core."""
        return picture_arguments(
            camera,
            self.size,
            self.lights,
            ambient=self.ambient,
            color=PLAIN[:3] if self.color is None else self.color,
            specular=self.specular,
            shininess=self.shininess,
            background=self.background,
            # Lights without a size have hard shadows.
            shadows="none" if self.shadows == "none" else "hard",
        )

    def render(self, geometry: Any, camera: Camera) -> Frame:
        """Draw an object as a scene of one instance. Without a colour it keeps its own paint or reflectance."""
        material = Material(color=self.color, specular=self.specular, shininess=self.shininess)
        scene = Scene(
            [Instance(geometry, material=material)], self.lights, ambient=self.ambient, background=self.background
        )
        checked = Options(
            size=self.size,
            primary="raymarch",
            shadows=self.shadows,
            samples=self.samples,
            device=self.device,
            progress=self.progress,
        )
        core = SceneBuilder().build(scene.instances, checked.fields_of(scene.instances), self.device, numbered=True)
        return checked.draw(scene._renderer, core, scene, camera, self.lights, scene.bounds)


def _draw_quadrics(quadrics: Sequence[Quadric], options: _Options) -> Frame:
    if options.filter != "linear":
        raise ArgumentError(f"filter: quadrics are not sampled, got {options.filter!r}; leave it out")
    if options.color is not None:
        raise ArgumentError("color: each quadric has its own reflectance; leave it out")
    return options.render(quadrics, options.view_of(bounds_of(quadrics)))


def _draw_shape(shape: Shape, method: Method, options: _Options) -> Frame:
    if options.filter != "linear":
        raise ArgumentError(f'filter: "{options.filter}" needs a volume, got a Shape; bake it first')
    camera = options.view_of(shape.bounds)
    if options.needs_scene:
        if method != "auto":
            raise ArgumentError(
                f'method: "{method}" needs samples=1 and directional lights, without a size if shadows are "soft" or '
                '"area"; leave it out for other pictures'
            )
        return options.render(shape, camera)
    with progress_callback(options.progress, "raymarch") as callback:
        return frame_of(shape._core.draw(method, options.arguments(camera), options.device, callback))


def _draw_nested(field: NestedField, options: _Options) -> Frame:
    if options.filter != "linear":
        raise ArgumentError(f'filter: "{options.filter}" needs a volume, got a NestedField')
    return options.render(field, options.view_of(field.inner_bounds))


def _draw_volume(volume: Volume | SparseVolume, options: _Options) -> Frame:
    camera = options.view_of(volume.inner_bounds)
    if options.needs_scene:
        _refuse_filter(options)
    else:
        with progress_callback(options.progress, "raymarch") as callback:
            result = _core.raymarch(
                volume._core_field if isinstance(volume, SparseVolume) else volume._texels,
                *volume._corners(),
                options.arguments(camera),
                scale=volume._scale,
                filter=options.filter,
                device=options.device,
                progress=callback,
            )
        if result is not None:
            return frame_of(result)
    return options.render(volume, camera)


def _draw_entry(entry: AtlasEntry, options: _Options) -> Frame:
    if (entry.transform == np.eye(4)).all():
        return _draw_volume(entry.to_volume(), options)
    if options.filter != "linear":
        raise ArgumentError(f'filter: "{options.filter}" needs a volume without a transform; draw atlas[i].to_volume()')
    return options.render(entry, options.view_of(Instance(entry).bounds))


def _draw_zarr(volume: ZarrVolume, options: _Options) -> Frame:
    """Draw the level whose voxels are about as large as a pixel at the near side of the box of the surface."""
    camera = options.view_of(volume.inner_bounds)
    if camera.height is not None:
        return _draw_volume(volume.picture_field(camera.height / options.size[1]), options)
    nearest = np.clip(camera.eye, *volume.inner_bounds)
    pixel = 2 * np.tan(np.deg2rad(camera.fov_deg) / 2) / options.size[1]
    return _draw_volume(volume.picture_field(float(np.linalg.norm(camera.eye - nearest) * pixel)), options)


def _refuse_filter(options: _Options) -> None:
    if options.filter != "linear":
        raise ArgumentError(
            f'filter: "{options.filter}" needs a volume, one sample per pixel, and directional lights without a size '
            'or with shadows="hard"'
        )


def picture_arguments(
    camera: Camera,
    size: tuple[int, int],
    lights: Sequence[Light] | None = None,
    *,
    ambient: float = AMBIENT,
    color: Sequence[float] = PLAIN[:3],
    specular: float = SPECULAR,
    shininess: float = SHININESS,
    background: Sequence[float] | NDArray[np.float64] = BACKGROUND,
    shadows: str = "hard",
) -> dict[str, Any]:
    """Collect the arguments of a picture for the core, whose own functions have no defaults."""
    return {
        "pose": camera.pose,
        "fov_deg": camera.fov_deg,
        "height": camera.height,
        "size": size,
        "lights": [row_of(light) for light in ((key_light(camera.pose),) if lights is None else lights)],
        "ambient": ambient,
        "color": (*color,),
        "specular": specular,
        "shininess": shininess,
        "background": (*background,),
        "shadows": shadows,
    }
