"""SVG pictures as profiles: names of files, elements that are not drawn, positions, and units."""

import numpy as np
import pytest

import fieldbake as fb

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'


@pytest.fixture
def read(tmp_path):
    """Read a picture from the attributes of its outermost element and its content."""

    def profile_of(attributes, content):
        file = tmp_path / "picture.svg"
        file.write_text(f"{HEAD} {attributes}>{content}</svg>")
        return fb.Profile.from_svg(file)

    return profile_of


@pytest.mark.parametrize("name", ["middle.svg", "M1.svg", "m 3.SVG", "M0", "m0 0"])
def test_names_that_begin_with_m_are_files(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(f'{HEAD}><rect width="3" height="2"/></svg>')
    assert fb.Profile.from_svg(name).area == pytest.approx(6, rel=1e-12)


@pytest.mark.parametrize("name", ["missing.svg", "Missing", "Math", "M3.svg"])
def test_a_missing_file_is_not_the_data_of_a_path(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=name):
        fb.Profile.from_svg(name)


@pytest.mark.parametrize(
    "data", ["M0 0H3V2H0Z", " m0,0 h3e0 v+2 h-3 z", "M 0,0 3,0\n3,2 0,2", "M.0.0L3 .0 3 2 0 2z" * 99]
)
def test_the_data_of_a_path_is_no_name(data):
    assert fb.Profile.from_svg(data, rule="nonzero").area == pytest.approx(6, rel=1e-12)


@pytest.mark.parametrize(
    "content",
    [
        '<symbol id="a"><rect x="5" width="2" height="2"/></symbol>',
        '<mask id="a"><rect x="5" width="2" height="2"/></mask>',
        '<marker id="a"><path d="M5 0H7V2H5Z"/></marker>',
        '<g><marker id="a"><symbol id="b"><path d="M5 0H7V2H5Z"/></symbol></marker></g>',
        '<defs><mask id="a"><rect x="5" width="2" height="2"/></mask></defs>',
        '<rect x="5" width="2" height="2" fill="transparent"/>',
        '<rect x="5" width="2" height="2" style="fill: transparent"/>',
        '<g fill="rgba(1, 2, 3, 0)"><rect x="5" width="2" height="2"/></g>',
        '<rect x="5" width="2" height="2" fill-opacity="0"/>',
        '<rect x="5" width="2" height="2" opacity="0"/>',
        '<rect x="5" width="2" height="2" style="opacity: 0%"/>',
        '<g opacity="0.0"><g opacity="1"><rect x="5" width="2" height="2" opacity="1"/></g></g>',
        '<style>.a { opacity: 0 }</style><g class="a"><rect x="5" width="2" height="2"/></g>',
    ],
)
def test_what_a_picture_does_not_show_is_not_filled(read, content):
    profile = read('viewBox="0 0 9 9"', f'<rect width="1" height="3"/>{content}')
    assert profile.bounds == pytest.approx(np.array([(0, -3), (1, 0)]), abs=1e-12)
    assert profile.area == pytest.approx(3, rel=1e-12)


@pytest.mark.parametrize("link", ["href", "xlink:href"])
@pytest.mark.parametrize("before", [True, False])
def test_a_symbol_is_filled_where_it_is_used(read, link, before):
    symbol = '<symbol id="a"><mask><rect width="50" height="50"/></mask><rect x="1" width="2" height="2"/></symbol>'
    use = f'<use {link}="#a" x="4"/>'
    profile = read('viewBox="0 0 9 9"', symbol + use if before else use + symbol)
    assert profile.bounds == pytest.approx(np.array([(5, -2), (7, 0)]), abs=1e-12)
    assert profile.area == pytest.approx(4, rel=1e-12)


def test_gradients_and_translucent_colours_are_filled(read):
    gradient = '<linearGradient id="g"><stop offset="0"/></linearGradient><rect width="1" height="1" fill="url(#g)"/>'
    assert read("", gradient + '<rect x="3" width="1" height="1" fill="rgba(0,0,0,0.5)"/>').area == pytest.approx(2)


@pytest.mark.parametrize(
    ("size", "scale"),
    [
        ('width="100mm" height="50mm"', 10),
        ('width="10cm" height="5cm"', 10),
        ('style="width: 10cm; height: 50mm"', 10),
        ('width="400Q" height="200q"', 10),
        ('width="1in" height=".5in"', 2.54),
        ('width="1e-6mm" height="5e-7mm"', 1e-7),
        ('width="20" height="10px"', 2),
        ('width="30pt" height="5pc"', 4),
        ('width="200%" height="100vh"', 1),
        ('width="100mm"', 10),
        ("", 1),
    ],
)
@pytest.mark.parametrize("corner", [(0, 0), (-3, 7)])
def test_units_are_exact_and_the_origin_is_that_of_the_user_space(read, size, scale, corner):
    x, y = corner
    profile = read(f'{size} viewBox="{x} {y} 10 5"', f'<rect x="{x}" y="{y}" width="10" height="5"/>')
    truth = scale * np.array([(x, -y - 5), (x + 10, -y)])
    assert np.abs(profile.bounds - truth).max() <= 1e-12 * np.abs(truth).max()


def test_a_physical_length_in_a_picture_is_exact(read):
    profile = read("", '<rect x="2mm" y="1cm" width="100mm" height="1in"/>')
    assert np.abs(profile.bounds - np.array([(2, -35.4), (102, -10)])).max() <= 1e-10


def test_the_sides_of_a_picture_may_have_scales_of_their_own(read):
    sides, content = 'viewBox="2 0 10 10" width="20" height="30"', '<rect x="2" width="10" height="10"/>'
    assert read(f'{sides} preserveAspectRatio="none"', content).bounds.tolist() == [[4, -30], [24, 0]]
    assert read(f'{sides} preserveAspectRatio="xMinYMin slice"', content).bounds.tolist() == [[6, -30], [36, 0]]
    assert read(sides, content).bounds.tolist() == [[4, -20], [24, 0]]
    # The transform of the outermost element moves the picture after its scale.
    moved = read(f'{sides} transform="translate(1 -1)"', content)
    assert moved.bounds.tolist() == [[5, -19], [25, 1]]


def test_a_size_that_is_relative_to_fonts_or_zero_is_an_error(read):
    with pytest.raises(fb.ShapeError, match="the width '3em' has no absolute unit; write mm, cm, in or px"):
        read('width="3em" viewBox="0 0 1 1"', '<rect width="1" height="1"/>')
    with pytest.raises(fb.ShapeError, match="no filled outline"):
        read('width="0" height="1" viewBox="0 0 1 1"', '<rect width="1" height="1"/>')
    with pytest.raises(fb.ShapeError, match="no filled outline"):
        read('viewBox="0 0 0 1"', '<rect width="1" height="1"/>')


@pytest.mark.parametrize(
    ("size", "scale"),
    [
        ('width="200" height="100"', 96 / 25.4),
        ('viewBox="0 0 200 100"', 96 / 25.4),
        ('width="100mm" height="50mm" viewBox="0 0 200 100"', 48 / 25.4),
        ('width="100mm" height="50mm"', 1),
        ('style="width: 10cm"', 1),
    ],
)
@pytest.mark.parametrize(
    "content",
    [
        '<rect x="1mm" y="0" width=".2cm" height="1mm"/>',
        '<rect style="x: 1mm; width: 2mm; height: 1mm"/>',
        "<style>rect { x: 1mm; width: 2mm; height: 1mm }</style><rect/>",
        f'<rect x="{96 / 25.4}" width="{192 / 25.4}" height="{96 / 25.4}px"/>',
    ],
)
def test_a_millimetre_inside_a_picture_has_96_25th_user_units(read, size, scale, content):
    # Each number has a relative rounding error of some 1e-16.
    assert np.abs(read(size, content).bounds - scale * np.array([(1, -1), (3, 0)])).max() <= 1e-12


@pytest.mark.parametrize(
    ("frame", "lower", "upper"),
    [
        ('x="10" y="10" width="20" height="20" viewBox="0 0 10 10"', (10, -30), (30, -10)),
        ('x="10" y="10" width="20" height="20" viewBox="5 5 10 10"', (0, -20), (20, 0)),
        ('x="10" y="10" width="20" height="20"', (10, -20), (20, -10)),
        ('x="10" width="20" height="40" viewBox="0 0 10 10"', (10, -30), (30, -10)),
        ('width="20" height="40" viewBox="0 0 10 10" preserveAspectRatio="xMinYMax"', (0, -40), (20, -20)),
        ('width="20" height="40" viewBox="0 0 10 10" preserveAspectRatio="none"', (0, -40), (20, 0)),
        ('x="10%" y="10%" width="50%" viewBox="0 0 10 10"', (20, -110), (120, -10)),
        ('transform="translate(1)" viewBox="0 0 10 5"', (1, -200), (201, 0)),
    ],
)
def test_a_nested_picture_and_a_used_symbol_fill_their_viewport(read, frame, lower, upper):
    size = 'width="200mm" height="100mm" viewBox="0 0 200 100"'
    rectangle = '<rect width="10" height="10"/>'
    nested = read(size, f"<svg {frame}>{rectangle}</svg>")
    assert nested.bounds == pytest.approx(np.array([lower, upper]), abs=1e-12)
    words = frame.split("viewBox")
    if len(words) == 2:
        symbol = f'<symbol id="s" viewBox{words[1]}>{rectangle}</symbol><use href="#s" {words[0]}/>'
        assert read(size, symbol).bounds == pytest.approx(np.array([lower, upper]), abs=1e-12)


def test_percentages_inside_a_nested_picture_refer_to_it(read):
    content = '<svg x="5" width="50" height="20"><rect x="10%" width="50%" height="100%"/></svg>'
    assert read('width="200" height="100"', content).bounds.tolist() == [[10, -20], [35, 0]]


def test_a_symbol_that_uses_itself_is_drawn_once(read):
    symbol = '<symbol id="s"><rect width="2" height="2"/><use href="#s" x="5"/></symbol><use href="#s"/>'
    assert read("", symbol).area == pytest.approx(4, rel=1e-12)


@pytest.mark.parametrize("name", ["clip-path", "mask"])
def test_clip_paths_and_masks_are_ignored_with_a_warning(read, name):
    clip = '<clipPath id="c"><rect width="1" height="1"/></clipPath><mask id="c"/>'
    with pytest.warns(fb.SurfaceWarning, match="clip-path or mask of 1 element is ignored"):
        profile = read("", f'{clip}<g {name}="url(#c)"><rect width="3" height="1"/></g><g {name}="none"/>')
    assert profile.area == pytest.approx(3, rel=1e-12)


def test_another_document_is_an_error(tmp_path):
    file = tmp_path / "page.svg"
    file.write_text("<html/>")
    with pytest.raises(fb.ShapeError, match="its outermost element is <html>, not <svg>"):
        fb.Profile.from_svg(file)


@pytest.mark.parametrize("center", [(0, 0, 0), (30, -20, 0), (-1e4, 0.125, 0)])
def test_a_section_keeps_its_place_through_a_file(tmp_path, center):
    section = fb.box((4, 2, 2)).translate(center).section((0, 0, 0), "z")
    section.to_svg(tmp_path / "middle.svg")
    profile = fb.Profile.from_svg(tmp_path / "middle.svg")
    corners = np.concatenate(section.polygons)
    truth = np.stack([corners.min(axis=0), corners.max(axis=0)])
    # The file has ten digits.
    tolerance = 1e-9 * np.abs(truth).max()
    assert np.abs(profile.bounds - truth).max() <= tolerance
    assert profile.area == pytest.approx(section.area, abs=12 * tolerance)
