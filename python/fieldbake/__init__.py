"""Exact signed distance fields from triangle meshes.

>>> import fieldbake as fb
>>> knot = fb.models.torus_knot()
>>> volume = fb.bake(knot, resolution=32)
>>> frame = fb.raymarch(volume, size=(64, 64))
>>> frame.image.shape
(64, 64, 4)

Distances are negative inside and in the mesh's own units. ``distances[x, y, z]`` is the sample at ``bounds[0] + (index
+ 0.5) * spacing``. Space is right-handed, and triangles are counter-clockwise as seen from outside.
"""

import lazy_loader as _lazy_loader

#: Former functions, and the place of their work.
_FORMER_NAMES = {"sphere_intersection": "the page docs/articles/fields_in_unity, which computes the circle"}

# The stub `__init__.pyi` lists the public names. A module is imported at the first use of one of its names, so `import
# fieldbake` loads neither NumPy nor the compiled core, and a program loads only the parts that it uses.
_public, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name not in __all__:
        from .base.former_names import refusal

        raise refusal(name, __name__, _FORMER_NAMES)
    # The next access finds the name in the module and does not come here.
    found: object = _public(name)
    globals()[name] = found
    return found
