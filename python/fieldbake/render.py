"""Draw a volume."""

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
from .lights import DirectionalLight, Light, PointLight
from .progress import Progress, progress_callback
from .sparse import SparseVolume
from .volume import Volume

Shadows = Literal["hard", "none", "soft", "area"]
Filter = Literal["linear", "hardware"]

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
    ambient: float | None = None,
    color: ArrayLike | None = None,
    specular: float | None = None,
    shininess: float | None = None,
    background: ArrayLike | None = None,
    device: str = "auto",
    progress: Progress = None,
) -> Frame:
    """Draw the zero level set of a volume, or all fields of a scene, by marching rays.

    Parameters
    ----------
    thing : Volume, Scene, or anything :func:`bake` takes
        What is not a Volume is baked first, with 128 voxels along its longest side. A Scene brings its own lights and
        materials and is drawn by :func:`render` with ``primary="raymarch"``.
    camera : Camera, optional
        Fits the surface if not given: ``Camera.fit(volume.inner_bounds)``.
    size : (width, height), default (512, 512)
        In pixels.
    shadows : "hard", "soft", "area" or "none", default "hard"
        Whether the surface shades itself, and how; ``"soft"`` and ``"area"`` as for :func:`render`.
    filter : "linear" or "hardware", default "linear"
        How the field is read between its samples: exactly, or by the texture units of a graphics device (see Notes).
    lights : sequence of DirectionalLight and PointLight, optional
        If not given, one white light over the right shoulder of who looks.
    ambient : float, optional
        Light from everywhere, as a share of the colour; 0.2 if not given.
    color : (3,), optional
        Of the surface, linear RGB; light grey if not given.
    specular, shininess : float, optional
        Strength and sharpness of the highlight (Blinn-Phong); 0.25 and 32 if not given.
    background : (3,) or (4,), optional
        Where nothing is hit, linear RGB and opacity; opaque white if not given.
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

    ``filter="hardware"`` reads half floats through weights of 8 bits or so: at a hit the trilinear field is within 0.01
    voxels of zero on the devices that were tested; WebGPU promises no number. It takes the samples for distances, and
    where they are not, or where a ray is in the solid for less than half a voxel, it can miss a hit. A field too large
    for one buffer of the device is drawn this way only.

    References
    ----------
    H. Hansson-Soderlund, A. Evans, T. Akenine-Moller, Ray tracing of signed distance function grids, JCGT 11(3), 2022.
    """
    from .materials import Material
    from .scene import Instance, Scene, render

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
    width, height = _size(size)
    _checks.text("shadows", shadows)
    _checks.text("filter", filter)
    _checks.text("device", device)
    if camera is not None and not isinstance(camera, Camera):
        raise SceneError(f"camera: must be a Camera, got {_checks.describe(camera)}; see Camera.from_pose")
    shade = {
        "ambient": _checks.number("ambient", 0.2 if ambient is None else ambient, least=0),
        "specular": _checks.number("specular", 0.25 if specular is None else specular, least=0),
        "shininess": _checks.number("shininess", 32.0 if shininess is None else shininess, above=0),
    }
    surface = _checks.triple(_color("color", (0.8, 0.8, 0.8) if color is None else color, 3))
    behind = _color("background", (1.0, 1.0, 1.0, 1.0) if background is None else background, 4)
    is_baked = isinstance(thing, (Volume, SparseVolume))
    volume = thing if is_baked else bake(thing, PICTURE_RESOLUTION, device=device, progress=progress)
    if camera is None:
        camera = Camera.fit(volume.inner_bounds, aspect=width / height)
    if shadows in ("soft", "area") or any(isinstance(light, PointLight) for light in lights or ()):
        if filter != "linear":
            raise ArgumentError('filter: "hardware" goes with directional lights and shadows "hard" or "none"')
        material = Material(color=surface, specular=shade["specular"], shininess=shade["shininess"])
        whole = volume if isinstance(volume, Volume) else volume.to_volume()
        scene = Scene([Instance(whole, material=material)], lights, ambient=shade["ambient"], background=behind)
        return render(scene, camera, size=size, primary="raymarch", shadows=shadows, device=device, progress=progress)
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
            scale=volume._scale,
            filter=filter,
            device=device,
            progress=callback,
            **shade,
        )
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
