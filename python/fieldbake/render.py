"""Draw a volume or a shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _checks, _core
from .bake import bake
from .camera import Camera
from .errors import ArgumentError, SceneError
from .frame import Frame
from .lights import DirectionalLight, Light
from .progress import Progress, progress_callback
from .shapes import Shape
from .volume import Volume

Shadows = Literal["hard", "none", "soft", "area"]
Filter = Literal["linear", "hardware"]
Method = Literal["auto", "whole", "aabb", "octree"]

#: What is not a Volume yet is baked with so many voxels along its longest side.
PICTURE_RESOLUTION = 128

#: The usual light: over the right shoulder of who looks, so that form and shadow are both seen. Camera space.
KEY_LIGHT = np.array([-0.45, -0.7, -0.55])

#: Pixels along one side of a picture.
MAX_SIDE_PX = 16384


def raymarch(
    thing: Any,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    shadows: Shadows = "hard",
    filter: Filter = "linear",
    lights: Sequence[Light] | None = None,
    ambient: float = 0.2,
    color: ArrayLike = (0.8, 0.8, 0.8),
    specular: float = 0.25,
    shininess: float = 32.0,
    background: ArrayLike = (1.0, 1.0, 1.0, 1.0),
    method: Method = "auto",
    device: str = "auto",
    progress: Progress = None,
) -> Frame:
    """Draw the zero level set of a volume, a shape, or all fields of a scene, by marching rays.

    Parameters
    ----------
    thing : Volume, Shape, Scene, or anything :func:`bake` takes
        What is none of the three is baked first, with 128 voxels along its longest side. A Scene brings its own
        lights and
        materials and is drawn by :func:`render` with ``primary="raymarch"``; for it `shadows` may be ``"soft"`` too.
    camera : Camera, optional
        Fits the surface if not given: ``Camera.fit(volume.inner_bounds)``.
    size : (width, height), default (512, 512)
        In pixels.
    shadows : "hard" or "none", default "hard"
        Whether the surface shades itself.
    filter : "linear" or "hardware", default "linear"
        How the field is read between its samples: exactly, or by the texture units of a graphics device (see Notes).
    lights : sequence of DirectionalLight, optional
        If not given, one white light over the right shoulder of who looks.
    ambient : float, default 0.2
        Light from everywhere, as a share of the colour.
    color : (3,), default light grey
        Of the surface, linear RGB.
    specular, shininess : float, default 0.25 and 32
        Strength and sharpness of the highlight (Blinn-Phong).
    background : (3,) or (4,), default opaque white
        Where nothing is hit, linear RGB and opacity.
    method : "auto", "whole", "aabb" or "octree", default "auto"
        For a shape: whether rays march the whole of it or the parts of :func:`fieldbake.csg.decompose`. The picture is
        the same.
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
    ShapeError
        For a shape without bounds, or an unknown `method`.
    MeshError, CapacityError, DeviceError
        As for :func:`bake`.

    Notes
    -----
    A hit is a root of the trilinear field, not a place closer than some epsilon: in each voxel the field along the
    ray is a cubic polynomial. What lies outside the volume's box is not seen and casts no shadow.

    ``filter="hardware"`` reads half floats through weights of 8 bits or so: at a hit the trilinear field is within 0.01
    voxels of zero on the devices that were tested; WebGPU promises no number. It takes the samples for distances, and
    where they are not, or where a ray is in the solid for less than half a voxel, it can miss a hit. A field too large
    for one buffer of the device is drawn this way only.

    References
    ----------
    H. Hansson-Soderlund, A. Evans, T. Akenine-Moller, Ray tracing of signed distance function grids, JCGT 11(3), 2022.
    """
    from .scene import Scene, render

    if isinstance(thing, Scene):
        usual = (lights, ambient, specular, shininess, np.shape(color), np.shape(background)) == (
            None,
            0.2,
            0.25,
            32.0,
            (3,),
            (4,),
        )
        if (
            not usual
            or tuple(np.ravel(color)) != (0.8, 0.8, 0.8)
            or tuple(np.ravel(background)) != (1.0, 1.0, 1.0, 1.0)
        ):
            raise SceneError("lights, ambient, color, specular, shininess and background belong to the Scene")
        return render(thing, camera, size=size, primary="raymarch", shadows=shadows, device=device, progress=progress)
    width, height = _size(size)
    _checks.text("shadows", shadows)
    _checks.text("filter", filter)
    _checks.text("device", device)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {_checks.describe(camera)}; see Camera.from_pose")
    shade = {
        "ambient": _checks.number("ambient", ambient, least=0),
        "specular": _checks.number("specular", specular, least=0),
        "shininess": _checks.number("shininess", shininess, above=0),
    }
    surface = _checks.triple(_color("color", color, 3))
    behind = _color("background", background, 4)
    _checks.text("method", method)
    if isinstance(thing, Shape):
        if camera is None:
            camera = Camera.fit(thing.bounds, aspect=width / height)
        return _draw_shape(
            thing, camera, (width, height), method, shadows, lights, shade, surface, behind, device, progress
        )
    if method != "auto":
        raise ArgumentError(f"method: {method!r} is for shapes; a volume has one way to be drawn")
    volume = thing if isinstance(thing, Volume) else bake(thing, PICTURE_RESOLUTION, device=device, progress=progress)
    if camera is None:
        camera = Camera.fit(volume.inner_bounds, aspect=width / height)
    directions, colors = _lights(lights, camera)
    lower, upper = volume._corners()
    with progress_callback(progress, "raymarch") as callback:
        result = _core.raymarch(
            volume._source(device),
            lower,
            upper,
            camera.pose,
            fov_deg=camera.fov_deg,
            size=(width, height),
            light_directions=directions,
            light_colors=colors,
            color=surface,
            background=(*behind.tolist(),),
            shadows=shadows,
            filter=filter,
            device=device,
            progress=callback,
            **shade,
        )
    return _frame(result)


def _draw_shape(
    shape: Shape,
    camera: Camera,
    size: tuple[int, int],
    method: str,
    shadows: str,
    lights: Sequence[Light] | None,
    shade: dict[str, float],
    surface: tuple[float, float, float],
    behind: NDArray[np.float64],
    device: str,
    progress: Progress,
) -> Frame:
    directions, colors = _lights(lights, camera)
    picture = {
        "pose": camera.pose,
        "fov_deg": camera.fov_deg,
        "size": size,
        "light_directions": directions,
        "light_colors": colors,
        "color": surface,
        "background": (*behind.tolist(),),
        "shadows": shadows,
        **shade,
    }
    with progress_callback(progress, "raymarch") as callback:
        result = shape._core.draw(method, picture, device, callback)
    return _frame(result)


def _frame(result: dict[str, Any]) -> Frame:
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    return Frame(arrays, {name: value for name, value in result.items() if name not in arrays})


def _size(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise SceneError(f"size: must be (width, height), got {_checks.describe(size)}") from None
    return (
        _checks.integer("size", width, least=1, most=MAX_SIDE_PX, error=SceneError),
        _checks.integer("size", height, least=1, most=MAX_SIDE_PX, error=SceneError),
    )


def _color(name: str, value: ArrayLike, channels: int) -> NDArray[np.float64]:
    """Linear colour; a missing opacity is 1."""
    if channels == 4 and np.shape(value) == (3,):
        return np.append(_checks.vector(name, value, 3), 1.0)
    color = _checks.vector(name, value, channels)
    if color.min() < 0:
        raise ArgumentError(f"{name}: must not be negative, got {color.tolist()}")
    return color


def _lights(lights: Sequence[Light] | None, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Directions and colours, (k, 3) each."""
    if lights is None:
        key = camera.pose[:3, :3] @ KEY_LIGHT
        lights = [DirectionalLight(_checks.triple(key))]
    if not isinstance(lights, Sequence):
        raise SceneError(f"lights: must be a list of DirectionalLight, got {_checks.describe(lights)}")
    for number, light in enumerate(lights):
        if not isinstance(light, DirectionalLight):
            raise SceneError(f"lights[{number}]: raymarch draws DirectionalLight only, got {_checks.describe(light)}")
    directions = [light.direction for light in lights if isinstance(light, DirectionalLight)]
    colors = [np.multiply(light.color, light.intensity) for light in lights]
    return (
        np.array(directions, dtype=np.float32).reshape(-1, 3),
        np.array(colors, dtype=np.float32).reshape(-1, 3),
    )
