"""Pictures of the pages of an atlas, with the places of its volumes, for the viewer."""

from __future__ import annotations

import base64
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atlases.atlas import Atlas
from ..drawing.plot import frame_of

#: Longest side of the picture of a page, pixels.
PAGE_PX = 512

#: Largest number of pages with a picture.
MOST_PAGES = 8

#: Colours from the most negative distance over 0 to the most positive one, sRGB, as in a slice in the viewer.
COLORS = ((18, 72, 133), (168, 217, 235), (255, 255, 255), (245, 209, 143), (189, 74, 26))

#: Shades of a picture. Few shades compress well.
SHADES = 33


def pages_of(atlas: Atlas) -> list[dict[str, Any]]:
    """One entry per page, at most :data:`MOST_PAGES`: a title, a picture, and the name and rectangle of each volume.

    The rectangles are left, top, width and height as shares of the part that is shown, which ends at the last volume.
    """
    pages = atlas.pages
    found = []
    for page in range(min(len(pages), MOST_PAGES)):
        frames = {i: frame_of(atlas._blocks[i]) for i in atlas.indices if atlas._blocks["page"][i] == page}
        right = max((x + width for x, _, width, _ in frames.values()), default=atlas.page_size)
        bottom = max((y + height for _, y, _, height in frames.values()), default=atlas.page_size)
        volumes = [
            {
                "name": f"{i}: {' x '.join(map(str, atlas.resolution(i)))}",
                "box": [x / right, y / bottom, width / right, height / bottom],
            }
            for i, (x, y, width, height) in frames.items()
        ]
        title = f"page {page} of {len(pages)}, {atlas.page_size} x {atlas.page_size} {atlas.encoding}, {atlas.layout}"
        picture = base64.b64encode(_picture(pages[page][:bottom, :right])).decode()
        found.append({"title": title, "picture": f"data:image/png;base64,{picture}", "volumes": volumes})
    return found


def _picture(texels: NDArray[Any]) -> bytes:
    """A picture of distances as a PNG with a palette, reduced to at most :data:`PAGE_PX` pixels."""
    from PIL import Image

    step = -(-max(texels.shape) // PAGE_PX)
    values = texels[::step, ::step].astype(np.float32)
    reach = float(np.abs(values).max()) or 1.0
    shades = np.rint((values / reach + 1) / 2 * (SHADES - 1)).astype(np.uint8)
    image = Image.fromarray(shades)
    places = np.linspace(0, len(COLORS) - 1, SHADES)
    channels = [np.interp(places, np.arange(len(COLORS)), channel) for channel in zip(*COLORS, strict=True)]
    image.putpalette(np.rint(np.stack(channels, axis=1)).astype(np.uint8).tobytes())
    out = BytesIO()
    image.save(out, "PNG", optimize=True)
    return out.getvalue()
