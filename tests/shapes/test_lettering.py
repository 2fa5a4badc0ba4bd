"""Text: areas and holes of letters in three fonts, kerning, lines, OpenType outlines, and mistakes."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.areaPen import AreaPen
from fontTools.pens.qu2cuPen import Qu2CuPen
from fontTools.pens.t2CharStringPen import T2CharStringPen
from fontTools.ttLib import TTFont

import fieldbake as fb
from fieldbake.shapes.outlines.fonts import Font

FOLDER = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
FONTS = [FOLDER / name for name in ("DejaVuSans.ttf", "DejaVuSerif.ttf", "STIXGeneral.ttf")]

#: Letters with their numbers of polygons: an outline and its holes.
LETTERS = {"B": 3, "8": 3, "@": 2, "Å": 4}


def signed_area(loop: np.ndarray) -> float:
    x, y = (loop - loop[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def pen_area(path: Path, letter: str) -> float:
    """Area of a glyph by fontTools, ems squared."""
    font = TTFont(BytesIO(path.read_bytes()))
    glyphs = font.getGlyphSet()
    pen = AreaPen(glyphs)
    glyphs[font.getBestCmap()[ord(letter)]].draw(pen)
    return abs(pen.value) / font["head"].unitsPerEm ** 2


@pytest.mark.parametrize("letter", LETTERS)
@pytest.mark.parametrize("path", FONTS, ids=lambda path: path.stem)
def test_letters_have_the_area_of_their_outlines(path, letter):
    profile = fb.text(letter, 10, font=path)
    truth = 100 * pen_area(path, letter)
    assert abs(profile.area - truth) <= 1e-6 * truth
    areas = [signed_area(loop) for loop in profile.polygons]
    holes = sum(area < 0 for area in areas)
    # The ring of Å is one polygon with a hole, or part of the A below it.
    assert len(areas) in ((LETTERS[letter], 3) if letter == "Å" else (LETTERS[letter],))
    assert holes == {"B": 2, "8": 2, "@": 1, "Å": 2}[letter]
    solid = profile.extrude(2)
    assert solid.exact
    for loop, area in zip(profile.polygons, areas, strict=True):
        # Beside an edge the inside is to the left, of outer loops and of holes.
        middle, along = 0.5 * (loop[0] + loop[1]), loop[1] - loop[0]
        left = middle + 1e-4 * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        assert solid.distance([(*left, 0)])[0] < 0, area


def test_polylines_are_within_the_tolerance_of_the_curves():
    path = FONTS[0]
    font = Font(path)
    (outer, *_) = font.loops(font.glyph("O"))
    glyphs = TTFont(BytesIO(path.read_bytes())).getGlyphSet()
    from fontTools.pens.basePen import BasePen

    class Samples(BasePen):
        def __init__(self, glyph_set):
            super().__init__(glyph_set)
            self.points = []

        def _moveTo(self, _point):
            self.points.append([])

        def _lineTo(self, point):
            self.points[-1].append(np.linspace(self._getCurrentPoint(), point, 200))

        def _qCurveToOne(self, control, end):
            t = np.linspace(0, 1, 2000)[:, None]
            a, b, c = (np.array(p) for p in (self._getCurrentPoint(), control, end))
            self.points[-1].append((1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c)

        def _curveToOne(self, *_):
            raise AssertionError

    pen = Samples(glyphs)
    glyphs["O"].draw(pen)
    import shapely

    curve = shapely.LinearRing(np.concatenate(pen.points[0]))
    away = shapely.hausdorff_distance(shapely.LinearRing(outer), curve, densify=0.001)
    assert away <= 1e-4 * font.em * 1.01


def test_kerning_of_both_tables_is_the_same():
    # This font has its pairs in the table kern and in the table GPOS.
    font = TTFont(BytesIO(FONTS[0].read_bytes()))
    table = font["kern"].kernTables[0].kernTable
    face = Font(FONTS[0])
    pairs = sorted(table)[:: max(1, len(table) // 400)]
    assert len(pairs) >= 200
    assert all(face.kerning(*pair) == table[pair] for pair in pairs)
    close, wide = fb.text("AV", 10, font=FONTS[0]), fb.text("A V", 10, font=FONTS[0])
    advance = sum(font["hmtx"][glyph][0] for glyph in "AV") / font["head"].unitsPerEm * 10
    bearing = fb.text("V", 10, font=FONTS[0]).bounds[1, 0] - font["hmtx"]["V"][0] / font["head"].unitsPerEm * 10
    moved = table["A", "V"] / font["head"].unitsPerEm * 10
    assert moved < 0
    assert close.bounds[1, 0] == pytest.approx(advance + bearing + moved, abs=1e-9)
    assert wide.bounds[1, 0] > close.bounds[1, 0] + 2


def test_lines_are_aligned():
    single = fb.text("Bolt", 10)
    left, center, right = (fb.text("Bolt\nM4", 10, align=align) for align in ("left", "center", "right"))
    assert left.bounds[0, 1] == pytest.approx(-12, abs=0.2)
    assert left.area == pytest.approx(center.area, rel=1e-9)
    assert left.bounds[1, 0] == pytest.approx(single.bounds[1, 0], abs=1e-9)
    assert center.bounds.sum(axis=0)[0] == pytest.approx(0, abs=1)
    assert right.bounds[1, 0] <= 0
    assert fb.text("B\nB", 10, line_height=2).bounds[0, 1] == pytest.approx(-20, abs=1e-9)


def test_overlapping_letters_are_united():
    both = fb.text("AV", 10, font=FONTS[0])
    assert both.area == pytest.approx(sum(fb.text(letter, 10, font=FONTS[0]).area for letter in "AV"), rel=1e-6)


def test_an_opentype_font_has_the_same_letters(tmp_path):
    source = TTFont(BytesIO(FONTS[0].read_bytes()))
    glyphs, em = source.getGlyphSet(), source["head"].unitsPerEm
    names = [".notdef", "B", "eight"]
    outlines = {}
    for name in names:
        pen = T2CharStringPen(glyphs[name].width, glyphs)
        glyphs[name].draw(Qu2CuPen(pen, 0.5, all_cubic=True))
        outlines[name] = pen.getCharString()
    font = FontBuilder(em, isTTF=False)
    font.setupGlyphOrder(names)
    font.setupCharacterMap({ord("B"): "B", ord("8"): "eight"})
    font.setupCFF("Own", {}, outlines, {})
    font.setupHorizontalMetrics({name: (glyphs[name].width, 0) for name in names})
    font.setupHorizontalHeader(ascent=em, descent=0)
    font.setupNameTable({"familyName": "Own", "styleName": "Regular"})
    font.setupOS2()
    font.setupPost()
    file = tmp_path / "own.otf"
    font.save(file)
    for letter in "B8":
        made = fb.text(letter, 10, font=file)
        assert made.area == pytest.approx(100 * pen_area(file, letter), rel=1e-6)
        truth = fb.text(letter, 10, font=FONTS[0])
        assert made.area == pytest.approx(truth.area, rel=1e-3)
        assert len(made.polygons) == len(truth.polygons)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: fb.text("Å", 3), r"string: the font Aileron.* has no letter 'Å' \(U\+00C5\); pass font="),
        (lambda: fb.text("  ", 3), "string: no letter of '  ' has an outline"),
        (lambda: fb.text("a", 0), "size: must be above 0"),
        (lambda: fb.text("a", 1, align="middle"), "align: must be"),
        (lambda: fb.text("a", 1, font=__file__), "font: .* is no readable"),
    ],
)
def test_mistakes_name_the_argument(make, message):
    with pytest.raises(fb.ShapeError, match=f"^{message}"):
        make()


def test_other_mistakes_name_the_argument(tmp_path):
    with pytest.raises(fb.ArgumentError, match=r"^string: must be text"):
        fb.text(3, 1)
    with pytest.raises(FileNotFoundError):
        fb.text("a", 1, font=tmp_path / "none.ttf")


def test_engraved_text_is_as_deep_as_it_is_cut():
    plate = fb.box((30, 12, 2)) - fb.text("B8@", 8, align="center").extrude(1).translate((0, -3, 1))
    mesh = plate.to_mesh(160)
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(30 * 12 * 2 - 0.5 * fb.text("B8@", 8).area, rel=1e-3)
