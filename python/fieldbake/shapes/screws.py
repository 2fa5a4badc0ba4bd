"""Screw threads."""

from __future__ import annotations

import math
from typing import Literal

from .. import _core
from ..base import checks
from ..base.errors import ShapeError
from .arguments import number
from .primitives import cone, cylinder, slab
from .profiles import polygon, revolve
from .shape import Shape

#: The public names; the package exports all of them.
__all__ = ["thread"]

#: Depth of the basic profile over the pitch: ISO 68-1 and ISO 2904.
DEPTHS = {"iso": 0.625 * math.sqrt(0.75), "trapezoidal": 0.5}


def thread(
    diameter: float,
    pitch: float,
    length: float | None,
    *,
    internal: bool = False,
    profile: Literal["iso", "trapezoidal"] = "iso",
    clearance: float = 0.0,
    lead_in: float = 0.0,
) -> Shape:
    """Make a right-handed threaded rod about z, centred at z = 0, or the solid to subtract for a threaded hole.

    Parameters
    ----------
    diameter : float
        Major diameter, world units: 10 for M10.
    pitch : float
        Height of a turn, world units, at most the minor radius.
    length : float or None
        Length along z, world units; None makes a rod without ends.
    internal : bool, default False
        Whether the shape is to be subtracted, so that `clearance` makes it larger instead of smaller.
    profile : "iso" or "trapezoidal", default "iso"
        The basic profile of ISO 68-1 (metric, flanks of 30 degrees) or of ISO 2904 (flanks of 15 degrees). It has
        neither the roundings nor the tolerances of these standards.
    clearance : float, default 0
        Distance by which crests, flanks and roots move along their normals into the material, world units, at most a
        quarter of the minor radius. The ends stay in their places. A rod and a hole of clearance c are 2 c apart.
    lead_in : float, default 0
        Radial length of a cone of 45 degrees at both ends, world units. The end faces of a rod have the diameter
        ``diameter - 2 * lead_in``. A hole has countersinks, whose diameter in the end planes is
        ``minor diameter + 2 * lead_in``; they go on beyond the ends by one pitch, so that nothing of a nut of this
        length covers them.

    Returns
    -------
    Shape
        The rod. Near its surface the field is the distance to 1e-6 of the pitch; elsewhere it is at most
        :attr:`Shape.lipschitz` times the distance.

    Raises
    ------
    ShapeError
        For a value out of range.

    Examples
    --------
    >>> import fieldbake as fb
    >>> bolt = fb.thread(10, 1.5, 20, clearance=0.1, lead_in=1) | fb.hex_prism(9, 6).translate((0, 0, -12))
    >>> nut = fb.hex_prism(9, 8) - fb.thread(10, 1.5, 12, internal=True, clearance=0.1)
    >>> (bolt.distance([(0, 0, 0), (4.8, 0, 0), (0, 4.8, 0)]) < 0).tolist()
    [True, True, False]
    """
    kind = checks.choice("profile", profile, tuple(DEPTHS), ShapeError)
    wide, turn, gap, lead = (
        number(name, value)
        for name, value in (("diameter", diameter), ("pitch", pitch), ("clearance", clearance), ("lead_in", lead_in))
    )
    for name, value in (("clearance", gap), ("lead_in", lead)):
        if value < 0:
            raise ShapeError(f"{name}: must be at least 0, got {value:g}")
    is_hole = checks.flag("internal", internal)
    moved = gap if is_hole else -gap
    rod = Shape._wrap(_core.Shape.primitive(f"{kind}_thread", [0.5 * wide, turn, moved]))
    if length is None:
        if lead:
            raise ShapeError(f"lead_in: needs a length, got {lead:g} without ends")
        return rod
    tall = number("length", length)
    if not tall > 0:
        raise ShapeError(f"length: must be above 0, got {tall:g}")
    crest = 0.5 * wide + moved
    if not lead:
        return rod & cylinder(crest, tall)
    if is_hole:
        radius = 0.5 * wide - DEPTHS[kind] * turn + lead + moved
        # The cone ends one pitch beyond the end plane, where it is wider by one pitch.
        sink = cone(radius + turn, radius + turn).translate((0.0, 0.0, 0.5 * (radius - turn - tall)))
        sinks = sink | sink.reflect("z")
        return (rod & cylinder(crest, tall)) | (sinks & slab(tall + 2 * turn))
    end = crest - lead
    if not end > 0:
        raise ShapeError(f"lead_in: must be below half the diameter, got {lead:g}")
    # The cylinder around the crests with chamfers, which meet in the middle of a short rod.
    outer = min(crest, end + 0.5 * tall)
    flat = 0.5 * tall - (outer - end)
    # Both halves of the section, because an edge on the axis would be a face inside the solid.
    side = [(end, -0.5 * tall), (outer, -flat)] + ([] if flat == 0 else [(outer, flat)]) + [(end, 0.5 * tall)]
    corners = side + [(-x, z) for x, z in reversed(side)]
    return rod & revolve(polygon(corners))
