"""Draw a volume, a shape or quadrics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..baking.dense import bake
from ..base import checks
from ..base.errors import ArgumentError, SceneError
from ..base.progress import Progress, progress_callback
from ..merging.nested import NestedField
from ..scenes.camera import Camera
from ..scenes.instance import Instance
from ..scenes.lights import AMBIENT, BACKGROUND, DirectionalLight, Light, PointLight, key_light
from ..scenes.materials import PLAIN, SHININESS, SPECULAR, Material
from ..scenes.scene import Scene
from ..shapes.quadric import bounds_of, check_quadrics, core_of, is_quadrics
from ..shapes.shape import Shape
from ..volumes.sparse import SparseVolume
from ..volumes.volume import Volume
from .frame import Frame
from .options import checked_color, checked_size, frame_of
from .rendering import render

Shadows = Literal["hard", "none", "soft", "area"]
Filter = Literal["linear", "hardware"]
Method = Literal["auto", "whole", "aabb", "octree"]

#: What is not a Volume yet is baked with so many voxels along its longest side.
PICTURE_RESOLUTION = 128


def raymarch(
    thing: Any,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    shadows: Shadows = "hard",
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
    """Draw the zero level set of a volume, or all fields of a scene, by marching rays.

    Parameters
    ----------
    thing : Volume, SparseVolume, NestedField, Shape, Scene, Quadric, list of Quadric, or anything :func:`bake` takes
        A Scene brings its own lights and materials and is drawn by :func:`render` with ``primary="raymarch"``.
        Quadrics are drawn as they are, each in its reflectance; `object_id` is the place in the list. What else is
        neither volume nor Shape is baked first, with 128 voxels along its longest side.
    camera : Camera, optional
        Fits the surface if not given: ``Camera.fit(volume.inner_bounds)``.
    size : (width, height), default (512, 512)
        In pixels.
    shadows : "hard", "soft", "area" or "none", default "hard"
        Whether the surface shades itself, and how; ``"soft"`` and ``"area"`` as for :func:`render`.
    filter : "linear" or "hardware", default "linear"
        How the field is read between its samples: exactly, or by the texture units of a graphics device (see Notes).
    lights : sequence of DirectionalLight and PointLight, optional
        If not given, one white light of intensity 0.64 from above, over the viewer's right shoulder.
    ambient : float, optional
        Light from everywhere, as a share of the colour; 0.2 if not given.
    color : (3,), optional
        Of the surface, linear RGB; light grey if not given.
    specular, shininess : float, optional
        Strength and sharpness of the highlight (Blinn-Phong); 0.25 and 32 if not given.
    background : (3,) or (4,), optional
        Colour of pixels that hit nothing, linear RGB and opacity; (0.025, 0.03, 0.04), a dark slate, if not given.
    method : "auto", "whole", "aabb" or "octree", default "auto"
        For a shape: whether rays march the whole of it or the parts of :func:`fieldbake.csg.decompose`; ``"auto"``
        takes what promises to cost a ray least. The picture is the same.
    device : str, default "auto"
        ``"auto"``, ``"cpu"``, ``"gpu"`` or a name from :func:`devices`.
    progress : bool or callable, optional
        True draws a bar on stderr; a callable gets a share from 0 to 1.

    Returns
    -------
    Frame
        Colour, depth, normals, shadow and steps as arrays.

    Raises
    ------
    SceneError
        For a camera, light or size that makes no sense.
    ArgumentError
        For any other option that makes no sense.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    A hit is a root of the trilinear field, not a place closer than some epsilon: in each voxel the field along the
    ray is a cubic polynomial. What lies outside the volume's box is not seen and casts no shadow.

    Quantized and sparse volumes are read as they are stored, on the CPU and on a graphics device, which holds as many
    bytes of them. A device takes sparse volumes, and nested fields, whose sides have at most 16380 voxels together;
    nested fields it draws under directional lights with shadows ``"hard"`` or ``"none"``, else the CPU does.

    ``filter="hardware"`` reads half floats through weights of 8 bits or so: at a hit the trilinear field is within
    0.01 voxels of zero on the devices that were tested; WebGPU promises no number. It takes the samples for distances,
    and where they are not, or where a ray is in the solid for less than half a voxel, it can miss a hit. Quantized and
    sparse volumes are decoded to the whole grid for it. A field too large for one buffer of the device is drawn this
    way only.

    References
    ----------
    H. Hansson-Soderlund, A. Evans, T. Akenine-Moller, Ray tracing of signed distance function grids, JCGT 11(3), 2022.
    """
    surface_options = {
        "lights": lights,
        "ambient": ambient,
        "color": color,
        "specular": specular,
        "shininess": shininess,
        "background": background,
    }
    if isinstance(thing, Scene):
        for name, value in surface_options.items():
            if value is not None:
                raise SceneError(f"{name}: a Scene brings its own; make the Scene or its Material with it")
        if filter != "linear":
            raise SceneError('filter: scenes are drawn with "linear" only')
        return render(thing, camera, size=size, primary="raymarch", shadows=shadows, device=device, progress=progress)
    width, height = checked_size(size)
    checks.text("shadows", shadows)
    checks.text("filter", filter)
    checks.text("method", method)
    checks.text("device", device)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {checks.describe(camera)}; see Camera.from_pose")
    shade: dict[str, Any] = {
        "ambient": checks.number("ambient", AMBIENT if ambient is None else ambient, least=0),
        "specular": checks.number("specular", SPECULAR if specular is None else specular, least=0),
        "shininess": checks.number("shininess", SHININESS if shininess is None else shininess, above=0),
    }
    surface = checks.triple(checked_color("color", PLAIN[:3] if color is None else color, 3))
    behind = checked_color("background", BACKGROUND if background is None else background, 4)
    needs_scene = shadows in ("soft", "area") or any(isinstance(light, PointLight) for light in lights or ())
    if is_quadrics(thing):
        if filter != "linear":
            raise ArgumentError(f"filter: quadrics are not sampled, got {filter!r}; leave it out")
        if color is not None:
            raise ArgumentError("color: each quadric has its own reflectance; leave it out")
        quadrics = check_quadrics(thing)
        if camera is None:
            camera = Camera.fit(bounds_of(quadrics), aspect=width / height)
        if needs_scene:
            material = Material(specular=shade["specular"], shininess=shade["shininess"])
            instances = [Instance(quadric, material=material) for quadric in quadrics]
            scene = Scene(instances, lights, ambient=shade["ambient"], background=behind)
            return render(scene, camera, size=size, shadows=shadows, device=device, progress=progress)
        picture = picture_arguments(camera, (width, height), lights, background=behind, shadows=shadows, **shade)
        with progress_callback(progress, "raymarch") as callback:
            return frame_of(core_of(quadrics).draw(picture, device, callback))
    if not isinstance(thing, Shape) and method != "auto":
        raise ArgumentError(f"method: {method!r} is for shapes; a volume has one way to be drawn")
    if isinstance(thing, Shape) and filter != "linear":
        raise ArgumentError('filter: "hardware" reads a volume, and this is a shape; bake it first')
    field = thing
    if not isinstance(thing, (Volume, SparseVolume, NestedField, Shape)):
        field = bake(thing, PICTURE_RESOLUTION, device=device, progress=progress)
    if camera is None:
        bounds = field.bounds if isinstance(field, Shape) else field.inner_bounds
        camera = Camera.fit(bounds, aspect=width / height)
    is_nested = isinstance(field, NestedField)
    if is_nested or needs_scene:
        if filter != "linear":
            raise ArgumentError('filter: "hardware" goes with directional lights and shadows "hard" or "none"')
        if not needs_scene:
            assert isinstance(field, NestedField)
            picture = picture_arguments(
                camera, (width, height), lights, color=surface, background=behind, shadows=shadows, **shade
            )
            with progress_callback(progress, "raymarch") as callback:
                drawn = _core.raymarch_nested(field._stored(), picture, device=device, progress=callback)
            if drawn is not None:
                return frame_of(drawn)
        # Without a colour of its own a shape keeps its paint.
        paint = None if color is None else surface
        material = Material(color=paint, specular=shade["specular"], shininess=shade["shininess"])
        scene = Scene([Instance(field, material=material)], lights, ambient=shade["ambient"], background=behind)
        # In a scene nested fields are marched on the CPU.
        place = "cpu" if is_nested and device == "auto" else device
        return render(scene, camera, size=size, primary="raymarch", shadows=shadows, device=place, progress=progress)
    picture = picture_arguments(
        camera, (width, height), lights, color=surface, background=behind, shadows=shadows, **shade
    )
    with progress_callback(progress, "raymarch") as callback:
        if isinstance(field, Shape):
            return frame_of(field._core.draw(method, picture, device, callback))
        lower, upper = field._corners()
        return frame_of(
            _core.raymarch(
                field._source(device),
                lower,
                upper,
                picture,
                scale=field._scale,
                filter=filter,
                device=device,
                progress=callback,
            )
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
    directions, colors = _lights(lights, camera)
    return {
        "pose": camera.pose,
        "fov_deg": camera.fov_deg,
        "size": size,
        "light_directions": directions,
        "light_colors": colors,
        "ambient": ambient,
        "color": (*color,),
        "specular": specular,
        "shininess": shininess,
        "background": (*background,),
        "shadows": shadows,
    }


def _lights(lights: Sequence[Light] | None, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions and colours, (k, 3) each."""
    if lights is None:
        lights = [key_light(camera.pose)]
    if not isinstance(lights, Sequence):
        raise SceneError(f"lights: must be a list of DirectionalLight, got {checks.describe(lights)}")
    for number, light in enumerate(lights):
        if not isinstance(light, DirectionalLight):
            raise SceneError(f"lights[{number}]: raymarch draws DirectionalLight only, got {checks.describe(light)}")
    directions = [light.direction for light in lights if isinstance(light, DirectionalLight)]
    colors = [np.multiply(light.color, light.intensity) for light in lights]
    return (
        np.array(directions, dtype=np.float32).reshape(-1, 3),
        np.array(colors, dtype=np.float32).reshape(-1, 3),
    )
