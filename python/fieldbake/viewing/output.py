"""A view in the output of a notebook's cell without widgets: a page in a frame, and a picture."""

from __future__ import annotations

import base64
import html
from typing import Any

from .content import Content
from .page import page_of

#: Height of the controls below the canvas, CSS pixels.
CONTROLS_PX = 84


def frame_html(page: str, size: tuple[int, int]) -> str:
    """An iframe with a whole page inside, which needs no file and no network."""
    width, height = size
    return (
        f'<iframe srcdoc="{html.escape(page, quote=True)}" width="{width}" height="{height + CONTROLS_PX}" '
        'style="border:0;max-width:100%" sandbox="allow-scripts allow-downloads"></iframe>'
    )


class PageOutput:
    """The page of a view as the output of a cell. Made by ``show`` where anywidget is not installed."""

    def __init__(self, content: Content) -> None:
        self._content = content

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        picture = base64.b64encode(self._content.frame(max(self._content.size))._repr_png_()).decode()
        page = frame_html(page_of(self._content), self._content.size)
        return {"text/plain": repr(self), "text/html": page, "image/png": picture}

    def __repr__(self) -> str:
        return f'PageOutput({self._content.title}; pip install "fieldbake[notebook]" for a widget that answers Python)'
