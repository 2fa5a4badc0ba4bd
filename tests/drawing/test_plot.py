"""Plots: slices, iso-lines and frames of volumes at the right positions."""

import io

import numpy as np
import pytest

import fieldbake as fb

pytest.importorskip("matplotlib")


def pixels(figure):
    """The drawn figure as an array."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=50)
    return np.asarray(Image.open(buffer).convert("RGB"))


@pytest.fixture(scope="module")
def gear():
    return fb.bake(fb.models.gear(), 16)


def test_slices_go_through_the_point(gear):
    figure = gear.plot_slices(at=(0.1, 0.2, 0.05))

    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:3] == ["z = 0.05", "y = 0.2", "x = 0.1"]
    assert pixels(figure).std() > 10


def test_slices_without_a_surface(gear):
    assert pixels(fb.Volume(np.ones((3, 4, 5)), [(0, 0, 0), (1, 1, 1)]).plot_slices()).size
    with pytest.raises(fb.ArgumentError, match="at"):
        gear.plot_slices(at=(0, 0))


def test_a_page_shows_its_volumes(gear):
    atlas = fb.pack([gear] * 6, page_size=128)
    atlas.remove(1)

    figure = atlas.plot()

    here = [i for i in atlas.indices if atlas.entries["atlas_index"][i] == 0]
    assert [text.get_text() for text in figure.axes[0].texts] == [str(i) for i in here]
    assert pixels(figure).std() > 10


def test_pages_that_are_not_there(gear):
    with pytest.raises(fb.ArgumentError, match="page"):
        fb.pack([gear], page_size=128).plot(3)
    with pytest.raises(fb.Error, match="empty"):
        fb.pack([], page_size=128).plot()
