"""Pictures of scenes: the primary pass, then the light pass through the distance fields."""

from __future__ import annotations

from typing import Any, Literal

from ..base.progress import Progress
from ..merging.nested import NestedField
from ..scenes.camera import Camera
from ..volumes.volume import Volume
from .frame import Frame
from .scene_options import Options, Primary, SceneShadows, as_scene, checked_camera


def render(
    scene: Any,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = (512, 512),
    primary: Primary = "auto",
    shadows: SceneShadows = "soft",
    ambient_occlusion: bool | float = False,
    bounces: int = 0,
    bounce_samples: int = 256,
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
        distance of such surfaces, world units. True uses 0.15 of the diagonal of the scene. Occlusion is evaluated at
        every eighth pixel of every eighth row and interpolated in between, on lattices of 4, 2 and 1 pixels. Pixels
        are evaluated too if another surface is visible near them, if their neighbours lie on another surface, or if
        the neighbours differ by more than interpolation can follow: at most 1/2 at every second pixel, 1/8 at every
        eighth.
    bounces : int from 0 to 4, default 0
        Largest number of diffuse reflections on the way of the light to the visible surface. 0 draws the light of the
        lights alone, with ambient light that arrives everywhere. 1 and more trace paths from each surface through the
        distance fields and sheets. The paths collect the reflected light of the lights, the emission of surfaces, so
        that emissive materials are area lights, and the ambient light where it is not blocked. They replace
        `ambient_occlusion` and do not use `far`. Paths are evaluated on the CPU for pictures of every device, and
        interpolated between pixels like occlusion.
    bounce_samples : int, default 256
        Number of paths for each evaluated surface with `bounces`. All surfaces use the same directions, relative to
        their normals, so too few paths cause faint bands instead of noise. The time is proportional to the number.
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
        Colour, depth, normals, object ids, shadows, steps and rays as arrays. ``report`` has ``device``, the total
        ``seconds``, ``devices`` of the passes, ``milliseconds`` of the stages (``"primary"``, ``"light"``,
        ``"bounces"`` where there are any and, for a graphics device, ``"upload"``), ``device_milliseconds``, the time
        of the kernels on a device with timestamps (``"primary"``; ``"beams"``, ``"rays"``, ``"cones"``, ``"parts"`` and
        ``"edges"`` of the light; ``"thicknesses"`` of objects that scatter light; empty for more than 2,048 passes),
        ``reused``, the stages whose results are those of the last frame of a :class:`Renderer`, ``sheets``, the number
        of instances whose triangles are traced for light (by the CPU, for pictures of every device), and two counters:
        ``rays``, the number of shadow, occlusion, scattering and bounce rays and cones, and ``far_rays``, the number of
        those that entered the far field.

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
    directions. A path continues at the first instance that casts shadows and whose opacity is at least 1/2. It
    collects emission there, and the light of the lights as with ``shadows="hard"``. Each vertex of a path also has one
    point on the emissive faces of meshes; the balance heuristic combines both techniques. Surfaces of an opacity below
    1/2 and instances without shadows light nothing. Paths ignore highlights and scattering. Surroundings given as an
    image are smoothed as described for :class:`Scene`. In a closed room, 256 paths differ from a path tracer by 2 % in
    the mean.

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
    scene = as_scene(scene)
    options = Options.checked(
        size=size,
        primary=primary,
        shadows=shadows,
        ambient_occlusion=ambient_occlusion,
        bounces=bounces,
        bounce_samples=bounce_samples,
        samples=samples,
        light_scale=light_scale,
        exposure=exposure,
        area_samples=area_samples,
        far=far,
        far_distance=far_distance,
        method=method,
        device=device,
        progress=progress,
    )
    core = scene._core(options.fields_of(scene.instances), device)
    return options.draw(scene._renderer, core, scene, checked_camera(camera), scene.lights, scene.bounds)
