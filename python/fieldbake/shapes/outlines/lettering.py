"""Text as a flat profile."""

from __future__ import annotations

import os
from typing import Literal

from ...base import checks
from ...base.errors import ShapeError
from ..arguments import number
from ..profiles import Profile, region
from .curves import Array
from .fonts import Font

#: The public names; the package exports all of them.
__all__ = ["text"]

Align = Literal["left", "center", "right"]


def text(
    string: str,
    size: float,
    *,
    font: str | os.PathLike[str] | None = None,
    align: Align = "left",
    line_height: float = 1.2,
) -> Profile:
    """Make a profile of the outlines of text. Needs the extra ``text`` (fontTools).

    Parameters
    ----------
    string : str
        The letters. A newline begins another line.
    size : float
        The em of the font, world units. A capital letter has about 0.7 of this height.
    font : path, optional
        A ``.ttf`` or ``.otf`` file. The default is the face that Pillow carries, Aileron, which has the letters of
        ASCII and few others.
    align : "left", "center" or "right", default "left"
        The place of x = 0 in each line: its start, its middle or its end. The baseline of the first line is y = 0.
    line_height : float, default 1.2
        Distance between baselines, in ems.

    Returns
    -------
    Profile
        Letters with their holes. Kerning of the font is applied, and letters that overlap are united.

    Raises
    ------
    ShapeError
        If the font lacks a letter, cannot be read, or if no letter has an outline.
    FileNotFoundError
        If there is no such file.

    Notes
    -----
    Curves become polylines within 1e-4 of the em, of the same area as the curves. Pairs of glyphs are kerned by the
    OpenType feature ``kern`` or by the table ``kern``. Ligatures, marks and scripts that need shaping are not
    supported.

    Examples
    --------
    >>> import fieldbake as fb
    >>> plate = fb.box((20, 8, 2)) - fb.text("M4", 6, align="center").extrude(1).translate((0, -2, 1))
    >>> len(fb.text("8", 10).polygons)
    3
    """
    lines = checks.text("string", string).split("\n")
    em = number("size", size)
    if not em > 0:
        raise ShapeError(f"size: must be above 0, got {em:g}")
    share = {"left": 0.0, "center": 0.5, "right": 1.0}[
        checks.choice("align", align, ("left", "center", "right"), ShapeError)
    ]
    spacing = number("line_height", line_height)
    face = Font(font)
    scale = em / face.em
    outlines: dict[str, list[Array]] = {}
    loops: list[Array] = []
    for row, line in enumerate(lines):
        glyphs = [face.glyph(letter) for letter in line]
        at, starts = 0.0, []
        for i, glyph in enumerate(glyphs):
            at += face.kerning(glyphs[i - 1], glyph) if i else 0.0
            starts.append(at)
            at += face.width(glyph)
        for glyph, start in zip(glyphs, starts, strict=True):
            if glyph not in outlines:
                outlines[glyph] = face.loops(glyph)
            place = ((start - share * at) * scale, -row * spacing * em)
            loops += [loop * scale + place for loop in outlines[glyph]]
    if not loops:
        raise ShapeError(f"string: no letter of {string!r} has an outline")
    return region(loops, "nonzero")
