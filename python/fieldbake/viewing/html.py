"""A view as one HTML page that needs no network."""

from __future__ import annotations

import base64
import html
from functools import cache
from importlib import resources
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from .content import Content

#: Longest side of the picture that a page shows before, or instead of, the live one, pixels.
STILL_PX = 480

#: The page may run its own script and nothing else; pictures are its own.
POLICY = "default-src 'none'; img-src data: blob:; script-src 'unsafe-inline'; style-src 'unsafe-inline'"

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{title}</title>
<style>body{{margin:0}}#fieldbake-view img{{display:block}}</style>
</head>
<body>
<div id="fieldbake-view">
<img src="data:image/png;base64,{picture}" width="{width}" height="{height}" alt="{title}">
</div>
<noscript>{title}: the page needs JavaScript to turn the picture.</noscript>
<script type="text/plain" id="fieldbake-data">{data}</script>
<script type="module">{script}</script>
</body>
</html>
"""


def page_of(content: Content) -> str:
    """The text of the page."""
    width, height = content.size
    return PAGE.format(
        policy=POLICY,
        title=html.escape(content.title),
        picture=base64.b64encode(small_png(content.frame(STILL_PX).image)).decode(),
        width=width,
        height=height,
        data=base64.b64encode(content.packed()).decode(),
        script=bundle(),
    )


def small_png(image: NDArray[np.uint8]) -> bytes:
    """Encode an image as PNG without an unused alpha channel.

    The optimised compression is slower and saves about a tenth.
    """
    from PIL import Image

    is_opaque = bool((image[..., 3] == 255).all())
    buffer = BytesIO()
    Image.fromarray(image[..., :3] if is_opaque else image).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


@cache
def bundle() -> str:
    """The text of the viewer: an ES module that `web/` is built into."""
    return resources.files(__package__).joinpath("viewer.js").read_text(encoding="utf-8")
