"""The exceptions of fieldbake: one base class, and one class for each kind of failure.

Errors about a value also derive from :class:`ValueError`, so code that does not know fieldbake can catch them. A
missing file raises :class:`FileNotFoundError`.
"""


class Error(Exception):
    """Base of every exception that fieldbake raises on purpose."""


class ArgumentError(Error, ValueError):
    """An option or array that is out of range or has the wrong type. The message starts with the argument's name."""


class MeshError(Error, ValueError):
    """A mesh, or the file it comes from, that cannot be used."""


class ShapeError(Error, ValueError):
    """A CSG shape that cannot be built or evaluated."""


class SceneError(Error, ValueError):
    """A camera, light or instance that cannot be drawn."""


class AtlasError(Error, ValueError):
    """Volumes that do not fit an atlas."""


class FormatError(Error, ValueError):
    """A file that fieldbake did not write, that is damaged, or that a newer version wrote."""


class SurfaceWarning(UserWarning):
    """A surface whose inside had to be interpreted: it is open, inside out, or has flipped or one-sided parts."""


class DeviceError(Error, RuntimeError):
    """A compute device that is missing, too small, or has failed."""


class PerformanceWarning(UserWarning):
    """A call that works, but much more slowly than necessary; `warnings.filterwarnings` can silence it."""


class CapacityError(Error, MemoryError):
    """A request that does not fit in memory, refused before it starts."""
