"""The exceptions of fieldbake: one base class, and one class for each kind of failure.

Errors about a value also derive from :class:`ValueError`, so code that handles built-in exceptions catches them. A
missing file raises :class:`FileNotFoundError`.
"""


class Error(Exception):
    """Base of every exception that fieldbake raises on purpose.

    Examples
    --------
    >>> import fieldbake as fb
    >>> try:
    ...     fb.bake(fb.models.gear(), resolution=-1)
    ... except fb.Error as error:
    ...     print(type(error).__name__, isinstance(error, ValueError))
    ArgumentError True
    """


class ArgumentError(Error, ValueError):
    """An option or array that is out of range or has the wrong type. The message starts with the argument's name.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.bake(fb.models.gear(), resolution=-1)
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.ArgumentError: resolution: must be from 1 to 2147483647, got -1
    """


class MeshError(Error, ValueError):
    """A mesh, or the file it comes from, that cannot be used.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3)])
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.MeshError: faces[0] refers to vertex 3, the mesh has 3 vertices (valid: 0 to 2)
    """


class ShapeError(Error, ValueError):
    """A CSG shape that cannot be built or evaluated.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.csg.parse("(sphere 1")
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.ShapeError: line 1, column 1: this '(' is never closed (1 are open at the end)
    """


class SceneError(Error, ValueError):
    """A camera, light or instance that cannot be drawn.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.Camera((0, 0, 0), (0, 0, 0))
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.SceneError: target: must differ from eye, both are [0.0, 0.0, 0.0]
    """


class AtlasError(Error, ValueError):
    """Volumes that do not fit an atlas.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.pack([fb.bake(fb.sphere(), 32)], page_size=64)
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.AtlasError: volumes[0]: 32 x 32 x 32 voxels do not fit a page of 64 x 64 ...
    """


class FormatError(Error, ValueError):
    """A file that fieldbake did not write, that is damaged, or that a newer version wrote.

    Examples
    --------
    >>> import tempfile
    >>> import fieldbake as fb
    >>> with tempfile.NamedTemporaryFile(suffix=".npz") as file:
    ...     fb.load(file.name)
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.FormatError: ...npz: is damaged or not an .npz file ...
    """


class SurfaceWarning(UserWarning):
    """A surface whose inside is ambiguous, or a solid with faces that pass through each other or a wall below a voxel.

    The inside is ambiguous if the surface is open, inside out, or has flipped or one-sided parts. The outlines of a
    picture with clip paths or masks, which are ignored, have this warning too.

    Examples
    --------
    >>> import warnings
    >>> import fieldbake as fb
    >>> triangle = [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     volume = fb.bake(triangle, 16)
    >>> caught[0].category.__name__
    'SurfaceWarning'
    """


class MaterialWarning(UserWarning):
    """Properties of the materials of a file that pictures do not show."""


class DeviceError(Error, RuntimeError):
    """A compute device that is missing, too small, or has failed.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.bake(fb.models.gear(), 16, device="abacus")
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.DeviceError: device: 'abacus' is unknown; use "auto", "cpu", "gpu" or a name ...
    """


class PerformanceWarning(UserWarning):
    """A call that works, but much more slowly than necessary; `warnings.filterwarnings` can silence it.

    Examples
    --------
    >>> import warnings
    >>> import fieldbake as fb
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", fb.PerformanceWarning)
    ...     volume = fb.bake(fb.models.gear(), 16)
    """


class CapacityError(Error, MemoryError):
    """A request that does not fit in memory, refused before it starts.

    Examples
    --------
    >>> import fieldbake as fb
    >>> fb.bake(fb.sphere(), resolution=10_000)
    Traceback (most recent call last):
        ...
    fieldbake.base.errors.CapacityError: a field of 10000 x 10000 x 10000 samples needs 4000000000000 ...
    """
