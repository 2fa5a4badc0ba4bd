"""Outlines, widths and kerning of the glyphs of a font, by fontTools."""

from __future__ import annotations

import os
from io import BytesIO
from typing import Any

import numpy as np

from ...base import checks
from ...base.errors import ShapeError
from ...base.optional import optional_module
from .curves import TOLERANCE, Array, bezier_points


class Font:
    """A TrueType or OpenType font; None is the face that Pillow carries."""

    def __init__(self, source: str | os.PathLike[str] | None) -> None:
        library = optional_module("fontTools.ttLib", "text", extra="text")
        try:
            path = None if source is None else checks.path(source, "font", ShapeError)
            file = _default_face() if path is None else BytesIO(path.read_bytes())
            # Kerning needs one table of a font, and damage elsewhere does not matter.
            self._font = library.TTFont(file, lazy=True)
            self._letters: dict[int, str] = self._font.getBestCmap() or {}
            self._glyphs = self._font.getGlyphSet()
            self.em = int(self._font["head"].unitsPerEm)
        except (library.TTLibError, KeyError, AttributeError, ValueError) as error:
            raise ShapeError(f"font: {source} is no readable .ttf or .otf file: {error}") from error
        self._kerning = _Kerning(self._font)

    def glyph(self, letter: str) -> str:
        """The name of the glyph of a letter."""
        name = self._letters.get(ord(letter))
        if name is None:
            own = self._font["name"].getDebugName(4) if "name" in self._font else "given"
            advice = "pass font=, the path of a .ttf or .otf file with this letter"
            raise ShapeError(f"string: the font {own} has no letter {letter!r} (U+{ord(letter):04X}); {advice}")
        return name

    def width(self, glyph: str) -> float:
        """The advance of a glyph, font units."""
        return float(self._glyphs[glyph].width)

    def kerning(self, left: str, right: str) -> float:
        """The change of the distance between two glyphs, font units."""
        return self._kerning.between(left, right)

    def loops(self, glyph: str) -> list[Array]:
        """The contours of a glyph as polygons (m, 2), font units, within `TOLERANCE` of the em."""
        base: Any = optional_module("fontTools.pens.basePen", "text", extra="text").BasePen
        tolerance = TOLERANCE * self.em

        class Pen(base):  # type: ignore[misc]
            def __init__(self, glyphs: Any) -> None:
                super().__init__(glyphs)
                self.loops: list[list[Array]] = []

            def _moveTo(self, point: Any) -> None:  # noqa: N802
                self.loops.append([np.array([point], dtype=np.float64)])

            def _lineTo(self, point: Any) -> None:  # noqa: N802
                self.loops[-1].append(np.array([point], dtype=np.float64))

            def _curveToOne(self, *points: Any) -> None:  # noqa: N802
                self.loops[-1].append(bezier_points([self._getCurrentPoint(), *points], tolerance))

            def _qCurveToOne(self, *points: Any) -> None:  # noqa: N802
                self.loops[-1].append(bezier_points([self._getCurrentPoint(), *points], tolerance))

        pen = Pen(self._glyphs)
        self._glyphs[glyph].draw(pen)
        return [np.concatenate(pieces) for pieces in pen.loops]


def _default_face() -> BytesIO:
    """The TrueType face inside Pillow."""
    from PIL import ImageFont

    face: Any = ImageFont.load_default(10)
    file = getattr(face, "path", None)
    if not isinstance(file, BytesIO):
        raise ShapeError("font: this build of Pillow carries no TrueType face; pass the path of a .ttf or .otf file")
    return BytesIO(file.getvalue())


class _Kerning:
    """Pair kerning of a font: the feature ``kern`` of its table GPOS, else its table ``kern``.

    Source: OpenType specification 1.9, chapters GPOS (lookup types 2 and 9) and kern.
    """

    def __init__(self, font: Any) -> None:
        self._lookups: list[list[Any]] = []
        self._pairs: list[dict[tuple[str, str], float]] = []
        if "GPOS" in font:
            table = font["GPOS"].table
            features = table.FeatureList.FeatureRecord if table.FeatureList else []
            indices = {i for record in features if record.FeatureTag == "kern" for i in record.Feature.LookupListIndex}
            self._lookups = [_pair_tables(table.LookupList.Lookup[i]) for i in sorted(indices)]
        if not self._lookups and "kern" in font:
            self._pairs = [table.kernTable for table in font["kern"].kernTables if hasattr(table, "kernTable")]

    def between(self, left: str, right: str) -> float:
        found = sum(_adjustment(tables, left, right) for tables in self._lookups)
        return found + sum(float(pairs.get((left, right), 0.0)) for pairs in self._pairs)


def _pair_tables(lookup: Any) -> list[Any]:
    tables = [table.ExtSubTable if table.LookupType == 9 else table for table in lookup.SubTable]
    return [table for table in tables if table.LookupType == 2]


def _adjustment(tables: list[Any], left: str, right: str) -> float:
    """The change of the advance by the first table that has the pair."""
    for table in tables:
        if left not in table.Coverage.glyphs:
            continue
        if table.Format == 1:
            pairs = table.PairSet[table.Coverage.glyphs.index(left)].PairValueRecord
            record = next((pair for pair in pairs if pair.SecondGlyph == right), None)
            if record is None:
                continue
        else:
            first = table.ClassDef1.classDefs.get(left, 0)
            record = table.Class1Record[first].Class2Record[table.ClassDef2.classDefs.get(right, 0)]
        return float(getattr(record.Value1, "XAdvance", 0) or 0)
    return 0.0
